//! The exhaustive grid: its best sets, how flat it is around them, and what each gain does.

use config::Gains;
use maud::{Markup, html};

use crate::ReportError;
use crate::axis::{Axis, integer, number};
use crate::canvas::{COLOURS, Marker, NAVY, Stroke, WIDE};
use crate::chart::{Chart, Line};
use crate::page::{GAIN_UNITS, Page, gain_cells, gain_heads, table};
use crate::panels::{Panel, Shown, panels};
use crate::result::{EffectValue, Flatness, Grid, MainEffect, SetStanding};

/// Sets of a table.
const TOP: usize = 10;

/// Adds the sections of a grid to the page.
pub(crate) fn sections(page: &mut Page, grid: &Grid) -> Result<(), ReportError> {
    page.section(
        "Best sets",
        html! {
            p { "All " (integer(grid.size)) " sets of the grid were driven, noise-free." }
            @if !grid.sets.is_empty() {
                h3 { "Sets with a name" }
                (standings(grid.size, grid.sets.iter().map(|named| (named.name.clone(), &named.set))))
            }
            @if !grid.best_by_distance.is_empty() { h3 { "By distance" } (best(grid.size, &grid.best_by_distance)) }
            @if !grid.best_by_mse.is_empty() { h3 { "By mse" } (best(grid.size, &grid.best_by_mse)) }
        },
    );
    let sorted = sorted(page, grid)?;
    if sorted.is_some() || !grid.flatness.is_empty() {
        page.section(
            "How flat the grid is",
            html! {
                @if !grid.flatness.is_empty() { (flatness(grid.size, &grid.flatness)) }
                @if let Some(sorted) = sorted { div.figures { (sorted) } }
            },
        );
    }
    if !grid.main_effects.is_empty() {
        let body = main_effects(page, grid)?;
        page.section("Main effects", body);
    }
    Ok(())
}

fn best(size: u64, sets: &[SetStanding]) -> Markup {
    standings(size, sets.iter().take(TOP).enumerate().map(|(i, set)| ((i + 1).to_string(), set)))
}

fn standings<'a>(size: u64, sets: impl Iterator<Item = (String, &'a SetStanding)>) -> Markup {
    let rank = |rank: Option<u64>| match rank {
        Some(rank) => format!("{} / {}", integer(rank), integer(size)),
        None => "–".to_owned(),
    };
    table(
        html! { tr {
            th {} (gain_heads())
            th.number { "distance" } th.number { "rank" } th.number { "mse [m²]" } th.number { "rank" }
        } },
        html! {
            @for (name, set) in sets {
                tr {
                    td { (name) }
                    (gain_cells(&set.gains))
                    td.number { (number(set.distance, 4)) }
                    td.number { (rank(set.rank_distance)) }
                    td.number { (number(set.mse_m2, 4)) }
                    td.number { (rank(set.rank_mse)) }
                }
            }
        },
    )
}

fn flatness(size: u64, rows: &[Flatness]) -> Markup {
    let share = |sets: Option<u64>| match sets {
        Some(sets) => {
            let share = 100.0 * sets as f64 / size.max(1) as f64;
            format!("{} ({} %)", integer(sets), number(share, 1))
        }
        None => "–".to_owned(),
    };
    table(
        html! { tr {
            th.number { "at most worse than the best by" } th.number { "sets, by distance" } th.number { "sets, by mse" }
        } },
        html! {
            @for row in rows {
                tr {
                    td.number { (number(row.within * 100.0, 1)) " %" }
                    td.number { (share(row.sets_by_distance)) }
                    td.number { (share(row.sets_by_mse)) }
                }
            }
        },
    )
}

/// The distances of all sets in their order, and where the sets with a name stand among them.
fn sorted(page: &mut Page, grid: &Grid) -> Result<Option<Markup>, ReportError> {
    if grid.distances.is_empty() {
        return Ok(None);
    }
    let mut distances = grid.distances.clone();
    distances.sort_by(f64::total_cmp);
    let points = distances.iter().enumerate().map(|(place, it)| ((place + 1) as f64, *it));
    let mut lines = vec![Line::new("all sets", points, Stroke::solid(NAVY, 1.4))];
    for (index, named) in grid.sets.iter().enumerate() {
        let Some(rank) = named.set.rank_distance else { continue };
        let marker = Some(Marker::ALL[(index + 2) % Marker::ALL.len()]);
        let colour = COLOURS[(index + 1) % COLOURS.len()];
        let look = Stroke { marker, hidden: true, ..Stroke::solid(colour, 1.0) };
        lines.push(Line::new(named.name.clone(), [(rank as f64, named.set.distance)], look));
    }
    for line in &mut lines {
        line.points.iter_mut().for_each(|point| point.0 = point.0.max(1.0).log10());
    }
    let picture = Chart {
        name: "sorted-distances",
        words: "Distances of the sets in their order, over the rank.",
        width: WIDE,
        height: 250.0,
        x: Axis::of_ranks(grid.size as f64),
        x_name: "rank by distance [count, logarithmic]",
        y_name: "distance [m]",
        lines: &lines,
        legend_rows: 1,
        borders: &[],
    }
    .draw()?;
    Ok(Some(page.figure(picture, "Distances of the sets, in their order.")))
}

fn main_effects(page: &mut Page, grid: &Grid) -> Result<Markup, ReportError> {
    let effects: Vec<(&str, &MainEffect)> = Gains::NAMES
        .iter()
        .zip(GAIN_UNITS)
        .filter_map(|(name, title)| Some((title, grid.main_effects.get(*name)?)))
        .collect();
    let plots = |height: fn(&EffectValue) -> f64| -> Vec<Panel> {
        effects
            .iter()
            .map(|(title, effect)| Panel {
                name: (*title).to_owned(),
                points: effect.values.iter().map(|value| (value.value, height(value))).collect(),
            })
            .collect()
    };
    let words = "Mean over all other gains, for each value of each gain.";
    let distance = panels(
        "effects-distance",
        words,
        "mean distance [m]",
        &plots(|v| v.mean_distance),
        Shown::Points,
    )?;
    let distance = page
        .figure(distance, "Mean distance over all sets with a value, for each value of each gain.");
    let mse =
        panels("effects-mse", words, "mean mse [m²]", &plots(|v| v.mean_mse_m2), Shown::Points)?;
    let mse = page.figure(mse, "Mean mse over all sets with a value, for each value of each gain.");
    let share = |share: Option<f64>| match share {
        Some(share) => format!("{} %", number(share * 100.0, 1)),
        None => "–".to_owned(),
    };
    Ok(html! {
        p { "The share of the variance over the grid that each gain explains alone; what is missing to 100 % is their interplay." }
        (table(
            html! { tr { th { "gain" } th.number { "share, distance" } th.number { "share, mse" } } },
            html! {
                @for (title, effect) in &effects {
                    tr {
                        td { (title) }
                        td.number { (share(effect.share_distance)) }
                        td.number { (share(effect.share_mse)) }
                    }
                }
            },
        ))
        div.figures { (distance) (mse) }
    })
}
