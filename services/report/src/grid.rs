//! The exhaustive grid: its best sets, how flat it is around them, and what each parameter does.

use std::path::Path;

use config::RunConfig;
use maud::{Markup, html};
use outcome::{Flatness, GridResult, MainEffect, NamedSet, RankedSet, ValueMean};
use serde::Deserialize;

use crate::ReportError;
use crate::axis::{Axis, integer, number};
use crate::canvas::{COLOURS, Marker, NAVY, Stroke, WIDE};
use crate::chart::{Chart, Line};
use crate::files::{check_numbers, read_table};
use crate::page::{Page, parameter_title, table};
use crate::panels::{Panel, Shown, panels};
use crate::standings::{Row, is_objective, objective_title, standings};

/// Name of the file in a run's folder that holds every set.
const GRID_FILE: &str = "grid.csv";
/// How many sets a table lists.
const TOP: usize = 10;

/// The values of every set that the figures show.
#[derive(Debug, Default)]
pub(crate) struct Sets {
    values: Vec<f64>,
    path_mean_m: Vec<f64>,
}

/// Reads every set of the grid, of which there are `size`; `None` if the run's folder has no such file.
pub(crate) fn read_sets(run: &Path, size: usize) -> Result<Option<Sets>, ReportError> {
    #[derive(Deserialize)]
    struct Row {
        value: f64,
        path_mean_m: f64,
    }
    let path = run.join(GRID_FILE);
    let mut sets = Sets::default();
    let is_there = read_table(&path, |row: Row| {
        check_numbers([("value", row.value), ("path_mean_m", row.path_mean_m)])?;
        sets.values.push(row.value);
        sets.path_mean_m.push(row.path_mean_m);
        Ok(())
    })?;
    if is_there && sets.values.len() != size {
        let problem = format!("holds {} sets, but result.json lists {size}", sets.values.len());
        return Err(ReportError::malformed(&path, None, problem));
    }
    Ok(is_there.then_some(sets))
}

/// Adds the sections of a grid to the page.
pub(crate) fn sections(
    page: &mut Page,
    grid: &GridResult,
    sets: Option<Sets>,
    config: &RunConfig,
) -> Result<(), ReportError> {
    page.section("Best sets", best_sets(grid, config));
    if let Some(check) = &grid.plants {
        page.section("The best set on plants like this car", crate::plants::section(check, config));
    }
    let figures = match sets {
        Some(sets) => Some(sorted(page, grid, sets, config)?),
        None => None,
    };
    page.section(
        "How flat the grid is",
        html! {
            @if !grid.flatness.is_empty() { (flatness(grid.size, &grid.flatness, config)) }
            @if let Some(figures) = figures { div.figures { (figures) } }
            @else {
                p { "The run’s folder holds no " code { (GRID_FILE) } ", so there is no figure of all sets in order." }
            }
        },
    );
    if config.law.keys().any(|key| grid.main_effects.contains_key(key)) {
        let body = main_effects(page, grid, config)?;
        page.section("Main effects", body);
    }
    Ok(())
}

fn best_sets(grid: &GridResult, config: &RunConfig) -> Markup {
    let size = grid.size;
    let named = |sets: &[NamedSet]| {
        standings(config, Some(size), sets.iter().map(|it| Row::of_grid(&it.name, &it.set)))
    };
    let best = |sets: &[RankedSet]| {
        let rows = sets.iter().take(TOP).enumerate();
        let rows = rows.map(|(index, set)| Row::of_grid((index + 1).to_string(), set));
        standings(config, Some(size), rows)
    };
    let others = [
        ("distance", "By distance", &grid.best_by_distance),
        ("mse", "By mse", &grid.best_by_mse),
        ("path", "By mean distance from the path", &grid.best_by_path),
    ];
    let is_on_bound = |set: &RankedSet| !set.on_bound.is_empty();
    let any_on_bound = grid.sets.iter().any(|it| is_on_bound(&it.set))
        || [&grid.best, &grid.best_by_distance, &grid.best_by_mse, &grid.best_by_path]
            .into_iter()
            .any(|sets| sets.iter().take(TOP).any(is_on_bound));
    html! {
        p {
            @if size == config.grid().len() { "All " (integer(size as u64)) } @else {
                (integer(size as u64)) " of the " (integer(config.grid().len() as u64))
            }
            " sets of the grid were driven, noise-free."
        }
        @if any_on_bound { p { "† On a bound of the grid; better values may lie beyond it." } }
        @if !grid.sets.is_empty() { h3 { "Named sets" } (named(&grid.sets)) }
        h3 { "By " (config.objective.name) ", the objective" }
        (best(&grid.best))
        @for (measure, title, sets) in others {
            @if !sets.is_empty() && !is_objective(config, measure) { h3 { (title) } (best(sets)) }
        }
    }
}

fn flatness(size: usize, rows: &[Flatness], config: &RunConfig) -> Markup {
    let share = |sets: usize| {
        let share = 100.0 * sets as f64 / size.max(1) as f64;
        format!("{} ({} %)", integer(sets as u64), number(share, 1))
    };
    let shows_distance = !is_objective(config, "distance");
    let shows_mse = !is_objective(config, "mse");
    let shows_path = !is_objective(config, "path");
    table(
        html! { tr {
            th.number { "at most worse than the best by" }
            th.number { "sets, by " (config.objective.name) }
            @if shows_path { th.number { "sets, by mean distance from the path" } }
            @if shows_distance { th.number { "sets, by distance" } }
            @if shows_mse { th.number { "sets, by mse" } }
        } },
        html! {
            @for row in rows {
                tr {
                    td.number { (number(row.within * 100.0, 1)) " %" }
                    td.number { (share(row.sets_by_value)) }
                    @if shows_path { td.number { (share(row.sets_by_path)) } }
                    @if shows_distance { td.number { (share(row.sets_by_distance)) } }
                    @if shows_mse { td.number { (share(row.sets_by_mse)) } }
                }
            }
        },
    )
}

/// Values of all sets in order, and the places of the named sets among them.
fn sorted(
    page: &mut Page,
    grid: &GridResult,
    sets: Sets,
    config: &RunConfig,
) -> Result<Markup, ReportError> {
    let objective = &config.objective.name;
    let mut chart = |name: &str,
                     by: &str,
                     y_name: &str,
                     mut heights: Vec<f64>,
                     place: fn(&RankedSet) -> (usize, f64)| {
        heights.sort_by(f64::total_cmp);
        let points = heights.iter().enumerate().map(|(index, it)| ((index + 1) as f64, *it));
        let mut lines = vec![Line::new("all sets", points, Stroke::solid(NAVY, 1.4))];
        for (index, named) in grid.sets.iter().enumerate() {
            let marker = Some(Marker::ALL[(index + 2) % Marker::ALL.len()]);
            let colour = COLOURS[(index + 1) % COLOURS.len()];
            let look = Stroke { marker, hidden: true, ..Stroke::solid(colour, 1.0) };
            let (rank, height) = place(&named.set);
            lines.push(Line::new(named.name.clone(), [(rank as f64, height)], look));
        }
        for line in &mut lines {
            line.points.iter_mut().for_each(|point| point.0 = point.0.max(1.0).log10());
        }
        let picture = Chart {
            name,
            words: &format!("All sets in order of their {by}, over the rank."),
            width: WIDE,
            height: 250.0,
            x: Axis::of_ranks(grid.size as f64),
            x_name: &format!("rank by {by} [count, logarithmic]"),
            y_name,
            lines: &lines,
            legend_rows: 1,
            borders: &[],
        }
        .draw()?;
        Ok::<_, ReportError>(page.figure(picture, &format!("All sets in order of their {by}.")))
    };
    let values = chart("sorted-values", objective, &objective_title(config), sets.values, |set| {
        (set.rank_value, set.measures.value)
    })?;
    let path = if is_objective(config, "path") {
        None
    } else {
        let (by, title) = ("mean distance from the path", "mean distance [m]");
        Some(chart("sorted-path", by, title, sets.path_mean_m, |set| {
            (set.rank_path, set.measures.path_mean_m)
        })?)
    };
    Ok(html! { (values) @if let Some(path) = path { (path) } })
}

/// One of the measures whose means are shown.
struct Effect<'a> {
    /// The objective that would show the same; `None` for the objective itself.
    same_as: Option<&'static str>,
    picture: &'static str,
    /// Its name in the column's title and in the caption.
    by: &'a str,
    y_name: String,
    share: fn(&MainEffect) -> f64,
    mean: fn(&ValueMean) -> f64,
}

/// The objective, and the measures that are not the objective.
fn effects(config: &RunConfig) -> Vec<Effect<'_>> {
    let effects = [
        Effect {
            same_as: None,
            picture: "effects-value",
            by: &config.objective.name,
            y_name: format!("mean {}", objective_title(config)),
            share: |it| it.share_value,
            mean: |it| it.mean_value,
        },
        Effect {
            same_as: Some("path"),
            picture: "effects-path",
            by: "distance from the path",
            y_name: "mean distance [m]".to_owned(),
            share: |it| it.share_path,
            mean: |it| it.mean_path_m,
        },
        Effect {
            same_as: Some("distance"),
            picture: "effects-distance",
            by: "distance",
            y_name: "mean distance [m]".to_owned(),
            share: |it| it.share_distance,
            mean: |it| it.mean_distance,
        },
        Effect {
            same_as: Some("mse"),
            picture: "effects-mse",
            by: "mse",
            y_name: "mean mse [m²]".to_owned(),
            share: |it| it.share_mse,
            mean: |it| it.mean_mse_m2,
        },
    ];
    let is_shown = |effect: &Effect| effect.same_as.is_none_or(|it| !is_objective(config, it));
    effects.into_iter().filter(is_shown).collect()
}

fn main_effects(
    page: &mut Page,
    grid: &GridResult,
    config: &RunConfig,
) -> Result<Markup, ReportError> {
    let parameters: Vec<(String, &MainEffect)> = config
        .law
        .parameters
        .iter()
        .filter_map(|it| Some((parameter_title(it), grid.main_effects.get(&it.key)?)))
        .collect();
    let effects = effects(config);
    let mut figures = Vec::new();
    for effect in &effects {
        let plots: Vec<Panel> = parameters
            .iter()
            .map(|(title, of)| Panel {
                name: title.clone(),
                points: of.values.iter().map(|it| (it.value, (effect.mean)(it))).collect(),
            })
            .collect();
        let words = "Mean over all other parameters, for each value of each parameter.";
        let picture = panels(effect.picture, words, &effect.y_name, &plots, Shown::Points)?;
        let caption = format!(
            "Mean {} over all sets with a value, for each value of each parameter.",
            effect.by
        );
        figures.push(page.figure(picture, &caption));
    }
    Ok(html! {
        p { "The share of the variance over the grid that each parameter explains alone; the remainder to 100 % is due to their interaction." }
        (table(
            html! { tr {
                th { "parameter" }
                @for effect in &effects { th.number { "share, " (effect.by) } }
            } },
            html! {
                @for (title, of) in &parameters {
                    tr {
                        td { (title) }
                        @for effect in &effects { td.number { (number((effect.share)(of) * 100.0, 1)) " %" } }
                    }
                }
            },
        ))
        div.figures { @for figure in figures { (figure) } }
    })
}
