//! The page of an identified car: the table of its values, and what was measured beside what is predicted.

use identification::{Compared, Series, Window};
use maud::html;

use crate::ReportError;
use crate::axis::Axis;
use crate::canvas::{DASHES, GREY, NAVY, ORANGE, Picture, Stroke, WIDE};
use crate::chart::{Chart, Line, Map};
use crate::page::{Page, table};

/// What is told of an identified car.
#[derive(Debug, Clone, Copy)]
pub struct IdentifiedCar<'a> {
    /// Name of the vehicle.
    pub vehicle: &'a str,
    /// The recordings.
    pub drives: &'a [String],
    /// Key, value before, value after, interval, verdict.
    pub rows: &'a [[String; 5]],
    /// What is said below the table.
    pub notes: &'a [String],
    /// What the user should know.
    pub warnings: &'a [String],
    /// What was measured beside what is predicted.
    pub compared: &'a Compared,
}

/// The page, and its pictures.
pub(crate) fn page_of(car: IdentifiedCar<'_>) -> Result<(String, Vec<Picture>), ReportError> {
    let facts = html! {
        dl.facts {
            dt { "Vehicle" } dd { (car.vehicle) }
            dt { "Drives" } dd { (car.drives.join(", ")) }
            @for warning in car.warnings { dt { "Warning" } dd { (warning) } }
        }
    };
    let mut page = Page::titled(&format!("{}: identified", car.vehicle), facts);
    let head = html! {
        tr { th { "key" } th.number { "before" } th.number { "after" } th { "95 % interval" } th { "identified" } }
    };
    let body = html! {
        @for [key, before, after, interval, verdict] in car.rows {
            tr {
                td { code { (key) } }
                td.number { (before) } td.number { (after) } td { (interval) } td { (verdict) }
            }
        }
    };
    page.section(
        "Values",
        html! { (table(head, body)) ul { @for note in car.notes { li { (note) } } } },
    );
    let it = car.compared;
    if it.time_s.is_empty() {
        return Ok(page.finish_without_config());
    }
    let map = page.figure(way(it)?, "The measured way, and pieces of 3 s that are predicted from the commands alone. Each begins where the car was.");
    page.section("Way", html! { div.figures { (map) } });
    for (title, name, y_name, series, what) in [
        ("Speed", "speed", "v [m/s]", &it.speed_mps, "Speed: predicted from the commands alone."),
        (
            "Yaw rate",
            "yaw-rate",
            "ω [rad/s]",
            &it.yaw_rate_radps,
            "Yaw rate: predicted from the commanded steering angle and the measured speed.",
        ),
    ] {
        if !series.measured.iter().any(|value| value.is_finite()) {
            continue;
        }
        let both = page.figure(over_time(it, series, (name, y_name), false)?, what);
        let left = "What the prediction leaves: measured less predicted.";
        let left = page.figure(over_time(it, series, (name, y_name), true)?, left);
        page.section(title, html! { div.figures { (both) (left) } });
    }
    Ok(page.finish_without_config())
}

const BEFORE: &str = "with the file's values";
const AFTER: &str = "with the new ones";

fn over_time(
    it: &Compared,
    series: &Series,
    (name, y_name): (&str, &str),
    residuals: bool,
) -> Result<Picture, ReportError> {
    let points = |values: &[f64]| -> Vec<(f64, f64)> {
        let shown = it.time_s.iter().zip(values).zip(&series.measured);
        let shown = shown.map(|((time, value), measured)| match residuals {
            true => (*time, measured - value),
            false => (*time, *value),
        });
        shown.filter(|point| point.1.is_finite()).collect()
    };
    let mut lines = vec![
        Line::new(AFTER, points(&series.after), Stroke::solid(NAVY, 1.3)),
        Line::new(BEFORE, points(&series.before), Stroke::dashed(ORANGE, 1.2, DASHES[1])),
    ];
    if !residuals {
        lines.push(Line::new("measured", points(&series.measured), Stroke::solid(GREY, 2.0)));
    }
    let kind = if residuals { "residuals" } else { "predicted" };
    Chart {
        name: &format!("{name}-{kind}"),
        words: &format!("{name}, {kind}, over time"),
        width: WIDE,
        height: if residuals { 170.0 } else { 260.0 },
        x: Axis::tight(it.time_s.iter().copied(), 8),
        x_name: "time [s]",
        y_name,
        lines: &lines,
        legend_rows: 0,
        borders: &[],
    }
    .draw()
}

/// One line for all pieces of a kind would join them: each is a line of its own, and only the first is named.
fn way(it: &Compared) -> Result<Picture, ReportError> {
    let mut lines = Vec::new();
    type Piece = fn(&Window) -> &Vec<[f64; 2]>;
    let kinds: [(&str, Stroke, Piece); 2] = [
        (AFTER, Stroke::solid(NAVY, 1.4), |it| &it.after),
        (BEFORE, Stroke::dashed(ORANGE, 1.3, DASHES[1]), |it| &it.before),
    ];
    let pairs = |points: &[[f64; 2]]| points.iter().map(|[x, y]| (*x, *y)).collect::<Vec<_>>();
    for (label, look, piece) in kinds {
        for (index, window) in it.windows.iter().enumerate() {
            let label = if index == 0 { label } else { "" };
            lines.push(Line::new(label, pairs(piece(window)), look));
        }
    }
    lines.push(Line::new("measured", pairs(&it.way_m), Stroke::solid(GREY, 2.6)));
    Map {
        name: "way",
        words: "The measured way and its predictions",
        lines: &lines,
        ends: &[],
        borders: &[],
    }
    .draw()
}
