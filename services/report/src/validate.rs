//! A validation: the paper's table next to ours.

use config::RunConfig;
use maud::{Markup, html};
use outcome::{ValidateResult, ValidatedRow};

use crate::axis::{integer, number, optional};
use crate::page::{Page, parameter_cells_of_all, parameter_heads, table};
use crate::standings::{
    PATH_GROUP, arrived, is_objective, objective_title, path_cells, path_heads,
};
use crate::switches::{SwitchesOf, switch_table};

/// Adds the sections of a validation to the page.
pub(crate) fn sections(page: &mut Page, validate: &ValidateResult, config: &RunConfig) {
    let rows = &validate.rows;
    let has_paper = rows
        .iter()
        .any(|row| row.noise_free.paper_mse_m2.is_some() || row.noisy.paper_mse_m2.is_some());
    let title = if has_paper { "The paper’s table, and ours" } else { "With noise and without" };
    page.section(
        title,
        html! {
            (beside(rows, config, has_paper))
            (notes(validate))
            h3 { "More about the noise-free drives" }
            (noise_free(rows, config))
            h3 { "More about the noisy drives" }
            (noisy(rows, config))
        },
    );
    if rows.iter().any(|row| !row.switches.is_empty()) {
        let drives: Vec<_> = rows
            .iter()
            .enumerate()
            .map(|(index, row)| SwitchesOf {
                name: name_of(index, row),
                is_chosen: row.chosen_by_paper,
                switches: &row.switches,
            })
            .collect();
        page.section("Changes of parameters during the drive", switch_table(config, &drives));
    }
}

fn name_of(index: usize, row: &ValidatedRow) -> String {
    format!("{}{}", index + 1, if row.chosen_by_paper { " ★" } else { "" })
}

/// One row of a table: its name, its sets (one line for each manoeuvre of the path), and its other cells.
fn row_of(config: &RunConfig, index: usize, row: &ValidatedRow, cells: Markup) -> Markup {
    html! {
        tr class=[row.chosen_by_paper.then_some("chosen")] {
            td { (name_of(index, row)) }
            (parameter_cells_of_all(&config.law, &row.gains))
            (cells)
        }
    }
}

fn factor(factor: Option<f64>) -> String {
    factor.map_or_else(|| "–".to_owned(), |factor| format!("× {}", number(factor, 2)))
}

fn beside(rows: &[ValidatedRow], config: &RunConfig, has_paper: bool) -> Markup {
    let paper_heads = html! {
        @if has_paper { th.number { "paper" } th.number { "ours ÷ paper" } }
    };
    let paper_cells = |mse_m2: Option<f64>, by: Option<f64>| {
        html! {
            @if has_paper { td.number { (optional(mse_m2, 3)) } td.number { (factor(by)) } }
        }
    };
    let papers = if has_paper { 2 } else { 0 };
    table(
        html! {
            tr {
                th {} th.group colspan=(config.law.count()) { "parameters" }
                th.group colspan=(1 + papers) { "noise-free mse [m²]" }
                th.group colspan=(3 + papers) { "noisy mse [m²]" }
                th.group colspan="3" { (PATH_GROUP) ", noise-free" }
            }
            tr {
                th { "row" } (parameter_heads(&config.law))
                th.number { "ours" } (paper_heads)
                th.number { "ours, mean" } th.number { "from – to" } th.number { "worst" } (paper_heads)
                (path_heads())
            }
        },
        html! {
            @for (index, row) in rows.iter().enumerate() {
                @let (free, noisy) = (&row.noise_free, &row.noisy);
                (row_of(config, index, row, html! {
                    td.number { (number(free.measures.mse_m2, 3)) }
                    (paper_cells(free.paper_mse_m2, free.factor))
                    td.number { (number(noisy.mse_m2_mean, 3)) }
                    td.number { (number(noisy.mse_m2_low, 3)) " – " (number(noisy.mse_m2_high, 3)) }
                    td.number { (number(noisy.mse_m2_worst, 3)) }
                    (paper_cells(noisy.paper_mse_m2, noisy.factor))
                    (path_cells(&free.measures))
                }))
            }
        },
    )
}

fn notes(validate: &ValidateResult) -> Markup {
    let most = validate.rows.iter().map(|row| row.gains.len()).max().unwrap_or(0);
    html! {
        ul {
            @if validate.rows.iter().any(|row| row.chosen_by_paper) { li { "★ The row that the paper chose." } }
            @if most > 1 { li { "A row holds one set for each manoeuvre of the path, in their order." } }
            @if let Some(rms) = validate.rms_factor {
                li { "Over all rows our mse differs from the paper’s by a factor of " (number(rms, 2)) ", root mean square." }
            }
            li { "Noisy figures are from " (integer(validate.repeats)) " drives for each row, each with its own noise." }
            li {
                "The mse is that of the error against the moving reference. The distance from the path is the distance of the "
                "vehicle’s pose (the true one, where it is known) to the nearest point of the path."
            }
        }
    }
}

fn noise_free(rows: &[ValidatedRow], config: &RunConfig) -> Markup {
    let shows_distance = !is_objective(config, "distance");
    table(
        html! {
            tr {
                th {} th.group colspan=(config.law.count()) { "parameters" }
                th.group { "objective" }
                @if shows_distance { th.group { "the paper’s distance" } }
                th.group colspan="2" { "mse [m²]" }
                th.group { "cross-track error [m]" }
                th.group colspan="4" { "drive" }
            }
            tr {
                th { "row" } (parameter_heads(&config.law))
                th.number { (objective_title(config)) }
                @if shows_distance { th.number { "[m]" } }
                th.number { "along" } th.number { "across" }
                th.number { "largest" }
                th.number { "steering limited" } th.number { "driven" } th { "arrived" } th { "collided" }
            }
        },
        html! {
            @for (index, row) in rows.iter().enumerate() {
                @let drive = &row.noise_free;
                (row_of(config, index, row, html! {
                    td.number { (number(drive.measures.value, 4)) }
                    @if shows_distance { td.number { (number(drive.measures.distance, 4)) } }
                    td.number { (number(drive.along_m2, 3)) }
                    td.number { (number(drive.cross_m2, 3)) }
                    td.number { (number(drive.max_cross_track_m, 3)) }
                    td.number { (number(drive.steering_limited * 100.0, 1)) " %" }
                    td.number { (number(drive.driven * 100.0, 0)) " %" }
                    td { (arrived(&drive.measures)) }
                    td { @if drive.collisions > 0 { "yes" } @else { "no" } }
                }))
            }
        },
    )
}

fn noisy(rows: &[ValidatedRow], config: &RunConfig) -> Markup {
    table(
        html! {
            tr {
                th {} th.group colspan=(config.law.count()) { "parameters" }
                th.group colspan="2" { (PATH_GROUP) }
                th {}
            }
            tr {
                th { "row" } (parameter_heads(&config.law))
                th.number { "mean of all" } th.number { "largest of all" }
                th.number { "collisions" }
            }
        },
        html! {
            @for (index, row) in rows.iter().enumerate() {
                (row_of(config, index, row, html! {
                    td.number { (number(row.noisy.path_mean_m, 3)) }
                    td.number { (number(row.noisy.path_max_m, 3)) }
                    td.number { (integer(row.noisy.collisions.into())) }
                }))
            }
        },
    )
}
