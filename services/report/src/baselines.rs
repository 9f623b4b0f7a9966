//! The textbook sets beside a tuned one, and what less distance costs in turning the wheels.

use config::{LawConfig, RunConfig};
use maud::{Markup, html};
use outcome::{Baseline, Baselines, Measures, TradeOff, TrainResult};

use crate::ReportError;
use crate::axis::{Axis, number};
use crate::canvas::{GREY, Marker, NAVY, ORANGE, Stroke, WIDE};
use crate::chart::{Chart, Line};
use crate::page::{Page, parameters_text, table};
use crate::standings::{PATH_GROUP, arrived, path_cells, path_heads};

/// The table of textbook sets, with the verdict on the tuned one.
pub(crate) fn section(beside: &Baselines, train: &TrainResult, config: &RunConfig) -> Markup {
    let tuned = &train.measures;
    let Some(best) = beside.sets.get(beside.best) else { return html! {} };
    let row = |name: &str, it: &Measures, set: String| {
        html! { tr {
            td { (name) } (path_cells(it)) td.number { (number(it.steering_travel_radps, 3)) } td { (arrived(it)) }
            td { (set) }
        } }
    };
    html! {
        p {
            @if beside.beaten { "The tuned set " b { "beats" } " the best textbook set, " }
            @else if best.measures.arrived && !tuned.arrived {
                "The tuned set " b { "does not arrive" } " at the end of the path, and the best textbook set does, "
            }
            @else { "The tuned set " b { "does not beat" } " the best textbook set, " }
            (name_of(best)) ": " (number(tuned.path_mean_m, 4)) " m against " (number(best.measures.path_mean_m, 4))
            " m from the path on average"
            @if let Some(ratio) = beside.ratio { " (" (number(100.0 * ratio, 0)) " % of its distance)" }
            ", at a steering travel of " (number(tuned.steering_travel_radps, 3)) " against "
            (number(best.measures.steering_travel_radps, 3)) " rad/s."
        }
        (table(
            html! {
                tr { th {} th.group colspan="3" { (PATH_GROUP) } th {} th {} th {} }
                tr { th {} (path_heads()) th.number { "steering travel [rad/s]" } th { "arrived" } th { "set" } }
            },
            html! {
                @for set in &beside.sets { (row(&name_of(set), &set.measures, text_of(set))) }
                (row("tuned", tuned, parameters_text(&config.law, &train.gains)))
            },
        ))
        p { "Driven by our simulator, without noise; steering travel is the mean absolute rate of the steering angle that the gate passes." }
    }
}

pub(crate) fn name_of(set: &Baseline) -> String {
    let compensated = match set.compensated {
        None => "",
        Some(true) => ", dead time compensated",
        Some(false) => ", not compensated",
    };
    format!("{}{compensated}", set.law)
}

fn text_of(set: &Baseline) -> String {
    let law: Option<LawConfig> = config::law_preset(&set.law);
    law.map_or(set.gains.to_string(), |law| parameters_text(&law, &set.gains))
}

/// The curve of distance against steering travel, with the tuned set and the paper's.
pub(crate) fn curve(
    page: &mut Page,
    curve: &TradeOff,
    train: &TrainResult,
    config: &RunConfig,
) -> Result<Markup, ReportError> {
    let is_paper_s = config.objective.name == "distance";
    let place = |it: &Measures| {
        (it.steering_travel_radps, if is_paper_s { it.distance } else { it.path_mean_m })
    };
    let single = |colour, marker| Stroke {
        marker: Some(marker),
        hidden: true,
        ..Stroke::solid(colour, 1.5)
    };
    let mut lines =
        vec![Line::new("tuned", [place(&train.measures)], single(ORANGE, Marker::Square))];
    if let Some(paper) = &train.paper {
        let look = single(GREY, Marker::Triangle);
        lines.push(Line::new("the paper’s set", [place(&paper.measures)], look));
    }
    // Those of another law's training stand among the textbook sets.
    let beside = train.baselines.iter().flat_map(|it| &it.sets);
    for (index, set) in beside.filter(|_| train.paper.is_none()).enumerate() {
        let name = match set.law.as_str() {
            "paper" => name_of(set).replacen("paper", "the paper’s set", 1),
            _ => format!("textbook {}", name_of(set)),
        };
        let look = single(GREY, Marker::ALL[(index + 1) % Marker::ALL.len()]);
        lines.push(Line::new(name, [place(&set.measures)], look));
    }
    let points = curve.sets.iter().map(|it| (it.steering_travel_radps, it.distance_m));
    let look = Stroke { marker: Some(Marker::Disc), ..Stroke::solid(NAVY, 1.5) };
    lines.push(Line::new("best of the grid", points, look));
    let y_name = if is_paper_s { "distance [m]" } else { "mean distance from the path [m]" };
    let all = || lines.iter().flat_map(|line| &line.points);
    let picture = Chart {
        name: "trade-off",
        words: "Distance against steering travel: the sets of the grid that no other beats by both.",
        width: WIDE,
        height: 270.0,
        x: Axis::around(all().map(|point| point.0), 6),
        x_name: "steering travel [rad/s]",
        y_name,
        lines: &lines,
        legend_rows: 1,
        borders: &[],
    }
    .draw()?;
    let figure = page.figure(
        picture,
        "What less distance costs: the sets of the grid than which no other is both nearer and calmer, without noise.",
    );
    Ok(html! { div.figures { (figure) } })
}
