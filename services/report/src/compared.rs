//! Tuners compared, by a study or by `pathtune compare`: tables, after how many drives each had a good set, and regret over
//! drives; and what the laws come to beside each other.

use maud::{Markup, html};
use outcome::{CompareResult, Compared, StudyComparison};

use crate::ReportError;
use crate::axis::{Axis, number};
use crate::canvas::{Picture, Stroke, WIDE};
use crate::chart::{Chart, Line};
use crate::page::{Page, table};

/// The page of a comparison with each of some laws.
pub(crate) fn page_of(laws: &[Compared]) -> Result<(String, Vec<Picture>), ReportError> {
    let names: Vec<&str> = laws.iter().map(|it| it.result.law.as_str()).collect();
    let facts = html! { dl.facts { dt { "Laws" } dd { (names.join(", ")) } } };
    let maneuver = laws.first().map_or("", |it| it.result.maneuver.as_str());
    let mut page = Page::titled(&format!("{maneuver}: tuners compared"), facts);
    if let [first, _, ..] = laws {
        let tuner = first.result.tuners.first().map_or("", |it| it.tuner.as_str());
        let words = format!(
            "The best set driven so far by {tuner}, with each law: median over the trainings, and the middle half of them. \
             Level lines: textbook parameters."
        );
        let figure = page.figure(of_laws(laws, tuner)?, &words);
        page.section("Laws", html! { div.figures { (figure) } });
    }
    let all: Vec<StudyComparison> = laws
        .iter()
        .map(|it| StudyComparison { of: String::new(), lacking: Vec::new(), compared: it.clone() })
        .collect();
    sections(&mut page, &all)?;
    Ok(page.finish_without_config())
}

/// Adds a section for each comparison.
pub(crate) fn sections(page: &mut Page, all: &[StudyComparison]) -> Result<(), ReportError> {
    for it in all {
        let result = &it.compared.result;
        let regret = page.figure(
            regret_curves(&it.compared)?,
            "Regret: by how much the best set driven so far was truly above the best. Median over the trainings, and the \
             middle half of them. What is above 100 % is drawn there.",
        );
        let figure = page.figure(
            curves(&it.compared)?,
            "The share of trainings that had driven a set as good as the best 1 % of the grid, by the number of drives.",
        );
        let body = html! {
            p {
                (result.maneuver) ", " (result.vehicle) ", " @if result.noise { "with" } @else { "without" }
                " noise" @if result.plants > 1 { ", over " (result.plants) " plants" } ", law " (result.law) ": " (result.seeds) " trainings with each tuner, " (result.drives)
                " drives in each" @if !it.of.is_empty() { "; " (it.of) } "."
            }
            (drives_table(result)) (regret_table(result))
            p.small {
                "In brackets 95 % intervals. The best set has the value " (number(result.best_value, 4)) " ("
                (result.objective) ")"
                @if let Some(value) = result.textbook_value { ", the textbook parameters " (number(value, 4)) } "."
                @if !it.lacking.is_empty() {
                    " Left out, because jobs have no result: " (it.lacking.join(", ")) "."
                }
            }
            div.figures { (regret) (figure) }
        };
        page.section("Tuners compared", body);
    }
    Ok(())
}

fn drives_table(result: &CompareResult) -> Markup {
    let budget = result.drives;
    table(
        html! {
            tr { th { "drives to a set" } th.group colspan="2" { "within 2 % of the best" } th.group colspan="3" { "in the top 1 %" } }
            tr {
                th {} th.number { "median" } th.number { "95 % of seeds" } th.number { "median" }
                th.number { "95 % of seeds" } th.number { "seeds that reached it" }
            }
        },
        html! {
            @for it in &result.tuners {
                @let (near, top) = (&it.to_within_2_percent, &it.to_top_1_percent);
                tr {
                    td { (it.tuner) }
                    @for quantile in [&near.median, &near.q95, &top.median, &top.q95] {
                        td.number { (quantile.as_drives(budget)) }
                    }
                    td.number { (top.reached.as_percent()) }
                }
            }
        },
    )
}

fn regret_table(result: &CompareResult) -> Markup {
    let marks: Vec<u32> =
        result.tuners.iter().take(1).flat_map(|it| &it.after).map(|it| it.drives).collect();
    table(
        html! {
            tr {
                th { "recommended, above the best" }
                @for drives in &marks { th.group colspan="3" { "after " (drives) } }
            }
            tr {
                th {}
                @for _ in &marks { th.number { "median" } th.number { "95 % of seeds" } th.number { "within 5 %" } }
            }
        },
        html! {
            @for it in &result.tuners {
                tr {
                    td { (it.tuner) }
                    @for after in &it.after {
                        td.number { (after.regret_median.as_percent()) }
                        td.number { (after.regret_q95.as_percent()) }
                        td.number { (after.within_5_percent.as_percent()) }
                    }
                }
            }
        },
    )
}

/// A rising line for each tuner.
fn curves(compared: &Compared) -> Result<Picture, ReportError> {
    let result = &compared.result;
    let lines: Vec<Line> = result
        .tuners
        .iter()
        .enumerate()
        .map(|(place, it)| {
            let rows = compared.rows.iter().filter(|row| row.tuner == it.tuner);
            let mut reached: Vec<u32> = rows.filter_map(|row| row.to_top_1_percent).collect();
            reached.sort_unstable();
            let points = (0..=result.drives).map(|drives| {
                let count = reached.partition_point(|it| *it <= drives);
                (f64::from(drives), 100.0 * count as f64 / result.seeds as f64)
            });
            let look = Stroke { marker: None, ..Stroke::of_many(place) };
            Line::new(&it.tuner, points, look)
        })
        .collect();
    Chart {
        name: "study-compared",
        words: "The share of trainings with a set of the best 1 %, by the number of drives",
        width: WIDE,
        height: 270.0,
        x: Axis::tight([0.0, f64::from(result.drives)], 6),
        x_name: "drives",
        y_name: "trainings with a set of the best 1 % [%]",
        lines: &lines,
        legend_rows: 1,
        borders: &[],
    }
    .draw()
}

/// The regret of the best set driven so far, for each tuner.
fn regret_curves(compared: &Compared) -> Result<Picture, ReportError> {
    let result = &compared.result;
    let mut lines = Vec::new();
    for (place, it) in result.tuners.iter().enumerate() {
        let percent = |regret: f64| 100.0 * regret.min(1.0);
        lines.extend(band(compared, &it.tuner, &it.tuner, place, percent));
    }
    Chart {
        name: "regret",
        words: "Regret of the best set driven so far, by the number of drives",
        width: WIDE,
        height: 270.0,
        x: Axis::tight([0.0, f64::from(result.drives)], 6),
        x_name: "drives",
        y_name: "above the best [%]",
        lines: &lines,
        legend_rows: 1,
        borders: &[],
    }
    .draw()
}

/// The objective of the best set driven so far by one tuner, for each law.
fn of_laws(laws: &[Compared], tuner: &str) -> Result<Picture, ReportError> {
    let drives = laws.iter().map(|it| it.result.drives).max().unwrap_or(0);
    let objective = laws.first().map_or("", |it| it.result.objective.as_str());
    let mut lines = Vec::new();
    // A textbook set that does not arrive has a value far above all others, and early drives have, too.
    let best = laws.iter().map(|it| it.result.best_value).fold(0.0, f64::max);
    let most = 3.0 * best;
    for (place, it) in laws.iter().enumerate() {
        let result = &it.result;
        let value = |regret: f64| (result.best_value * (1.0 + regret)).min(most);
        lines.extend(band(it, tuner, &result.law, place, value));
        if let Some(textbook) = result.textbook_value.filter(|it| *it <= most) {
            let look = Stroke { width: 0.9, marker: None, ..Stroke::of_many(place) };
            let level = [(0.0, textbook), (f64::from(drives), textbook)];
            lines.push(Line::new("", level, look));
        }
    }
    Chart {
        name: "laws",
        words: "The objective of the best set driven so far with each law, by the number of drives",
        width: WIDE,
        height: 270.0,
        x: Axis::tight([0.0, f64::from(drives)], 6),
        x_name: "drives",
        y_name: objective,
        lines: &lines,
        legend_rows: 1,
        borders: &[],
    }
    .draw()
}

/// The median over a tuner's trainings of the best set driven so far, and the band of the middle half of them behind it.
fn band(
    compared: &Compared,
    tuner: &str,
    label: &str,
    place: usize,
    shown: impl Fn(f64) -> f64,
) -> [Line; 2] {
    let rows: Vec<_> = compared.rows.iter().filter(|row| row.tuner == tuner).collect();
    let quartiles = |drives: u32| -> [f64; 3] {
        let so_far = |better: &[(u32, f64)]| {
            let count = better.partition_point(|(drive, _)| *drive <= drives);
            better[..count].last().map_or(f64::INFINITY, |(_, regret)| *regret)
        };
        let mut all: Vec<f64> = rows.iter().map(|row| so_far(&row.better)).collect();
        all.sort_unstable_by(f64::total_cmp);
        // By nearest rank.
        [0.25, 0.5, 0.75].map(|share: f64| {
            let rank = ((share * all.len() as f64).ceil() as usize).max(1);
            shown(all.get(rank - 1).copied().unwrap_or(f64::INFINITY))
        })
    };
    let each: Vec<(f64, [f64; 3])> =
        (1..=compared.result.drives).map(|it| (f64::from(it), quartiles(it))).collect();
    let look = Stroke { marker: None, ..Stroke::of_many(place) };
    let median = Line::new(label, each.iter().map(|(x, it)| (*x, it[1])), look);
    let around = each.iter().map(|(x, it)| (*x, it[2]));
    let around = around.chain(each.iter().rev().map(|(x, it)| (*x, it[0]))).collect();
    // As it is: what thins a line out takes points along it for granted.
    let band = Line { label: String::new(), points: around, look: Stroke { area: true, ..look } };
    [median, band]
}

#[cfg(test)]
mod tests {
    use super::*;
    use outcome::{AfterDrives, CompareRow, DrivesTo, Quantile, Share, TunerComparison};

    #[test]
    fn a_comparison_has_its_tables_and_a_line_for_each_tuner() {
        let share = Share { count: 1, share: 0.5, low: 0.1, high: 0.9 };
        let median = Quantile { value: Some(3.0), low: Some(1.0), high: None };
        let to = DrivesTo {
            reached: share,
            median,
            q95: Quantile { value: None, low: None, high: None },
        };
        let after = AfterDrives {
            drives: 12,
            regret_median: median,
            regret_q95: median,
            within_5_percent: share,
        };
        let tuner = |name: &str| TunerComparison {
            tuner: name.to_owned(),
            to_within_2_percent: to,
            to_top_1_percent: to,
            after: vec![after],
        };
        let row = |tuner: &str, seed, to_top_1_percent| CompareRow {
            tuner: tuner.to_owned(),
            seed,
            to_within_2_percent: None,
            to_top_1_percent,
            regret: vec![0.1],
            better: vec![(1, 0.5), (4, 0.1)],
        };
        let result = CompareResult {
            schema: outcome::SCHEMA,
            maneuver: "lane_change".to_owned(),
            vehicle: "car".to_owned(),
            law: "paper".to_owned(),
            objective: "distance".to_owned(),
            first_seed: 1,
            seeds: 2,
            drives: 12,
            noise: false,
            plants: 1,
            drives_of_truth: 1,
            grid_size: 750,
            best_value: 0.5,
            best_gains: config::NamedParameters::default(),
            textbook_value: Some(0.75),
            tuners: vec![tuner("gp"), tuner("<q>")],
        };
        let rows = vec![
            row("gp", 1, Some(3)),
            row("gp", 2, None),
            row("<q>", 1, Some(9)),
            row("<q>", 2, Some(10)),
        ];
        let compared = Compared { result, rows };
        let mut page = Page::titled("study", html! {});
        let of = "set.x = 1".to_owned();
        let lacking = vec!["cem (1 of 2 jobs)".to_owned()];
        sections(&mut page, &[StudyComparison { of, lacking, compared }]).unwrap();
        let (html, pictures) = page.finish_without_config();
        assert_eq!(pictures.len(), 2);
        for part in [
            "3 [1, &gt; 12]",
            "&gt; 12",
            "50 % [10, 90]",
            "&lt;q&gt;",
            "set.x = 1",
            "cem (1 of 2 jobs)",
            "textbook parameters 0.7500",
        ] {
            assert!(html.contains(part), "{part}: {html}");
        }
        assert!(!html.contains("<q>"), "{html}");
    }
}
