//! A validation: the paper's table beside ours.

use config::{Gains, RunConfig};
use maud::{Markup, html};

use crate::axis::{gain, integer, number, optional};
use crate::page::{Page, gain_cells, gain_heads, table};
use crate::result::{Validate, ValidateRow};

/// Adds the sections of a validation to the page.
pub(crate) fn sections(page: &mut Page, validate: &Validate, config: &RunConfig) {
    let has_noisy = validate.rows.iter().any(|row| row.noisy.is_some());
    page.section(
        "The paper’s table, and ours",
        html! {
            (beside(&validate.rows, has_noisy))
            (notes(validate, has_noisy))
            h3 { "More about the noise-free drives" }
            (more(&validate.rows))
        },
    );
    if validate.rows.iter().any(|row| !row.switches.is_empty()) {
        page.section("Changes of gains on the way", switches(&validate.rows, config));
    }
}

/// The sets of a row, one line a manoeuvre of the path.
fn sets(gains: &[Gains]) -> Markup {
    html! {
        @for axis in 0..4 {
            td.number {
                @for (index, set) in gains.iter().enumerate() {
                    @if index > 0 { br; }
                    (gain(set.to_array()[axis]))
                }
            }
        }
    }
}

fn row_of(index: usize, row: &ValidateRow, cells: Markup) -> Markup {
    html! {
        tr class=[row.chosen_by_paper.then_some("chosen")] {
            td { (index + 1) @if row.chosen_by_paper { " ★" } }
            (sets(&row.gains))
            (cells)
        }
    }
}

fn factor(factor: Option<f64>) -> String {
    factor.map_or_else(|| "–".to_owned(), |factor| format!("× {}", number(factor, 2)))
}

fn beside(rows: &[ValidateRow], has_noisy: bool) -> Markup {
    table(
        html! {
            tr {
                th {} th.group colspan="4" { "gains" }
                th.group colspan="3" { "noise-free mse [m²]" }
                @if has_noisy { th.group colspan="5" { "noisy mse [m²]" } }
            }
            tr {
                th { "row" } (gain_heads())
                th.number { "ours" } th.number { "paper" } th.number { "ours ÷ paper" }
                @if has_noisy {
                    th.number { "ours, mean" } th.number { "from – to" } th.number { "worst" }
                    th.number { "paper" } th.number { "ours ÷ paper" }
                }
            }
        },
        html! {
            @for (index, row) in rows.iter().enumerate() {
                (row_of(index, row, html! {
                    td.number { (number(row.noise_free.mse_m2, 3)) }
                    td.number { (optional(row.noise_free.paper_mse_m2, 3)) }
                    td.number { (factor(row.noise_free.factor)) }
                    @if let Some(noisy) = &row.noisy {
                        td.number { (number(noisy.mse_m2_mean, 3)) }
                        td.number { (optional(noisy.mse_m2_low, 3)) " – " (optional(noisy.mse_m2_high, 3)) }
                        td.number { (optional(noisy.mse_m2_worst, 3)) }
                        td.number { (optional(noisy.paper_mse_m2, 3)) }
                        td.number { (factor(noisy.factor)) }
                    } @else if has_noisy {
                        @for _ in 0..5 { td.number { "–" } }
                    }
                }))
            }
        },
    )
}

fn notes(validate: &Validate, has_noisy: bool) -> Markup {
    let most = validate.rows.iter().map(|row| row.gains.len()).max().unwrap_or(0);
    html! {
        ul {
            @if validate.rows.iter().any(|row| row.chosen_by_paper) { li { "★ The row that the paper chose." } }
            @if most > 1 { li { "A row holds one set for each manoeuvre of the path, in their order." } }
            @if let Some(rms) = validate.rms_factor {
                li { "Over all rows our mse differs from the paper’s by a factor of " (number(rms, 2)) ", root mean square." }
            }
            @if let Some(repeats) = validate.repeats.filter(|_| has_noisy) {
                li { "Noisy figures are those of " (integer(repeats)) " drives a row, each with a noise of its own." }
            }
        }
    }
}

fn more(rows: &[ValidateRow]) -> Markup {
    table(
        html! { tr {
            th { "row" } (gain_heads())
            th.number { "along [m²]" } th.number { "cross [m²]" } th.number { "distance" }
            th.number { "largest cross-track error [m]" } th.number { "steering limited" } th.number { "collisions" }
            @if rows.iter().any(|row| row.noisy.is_some()) { th.number { "noisy collisions" } }
        } },
        html! {
            @for (index, row) in rows.iter().enumerate() {
                (row_of(index, row, html! {
                    @let drive = &row.noise_free;
                    td.number { (optional(drive.along_m2, 3)) }
                    td.number { (optional(drive.cross_m2, 3)) }
                    td.number { (optional(drive.distance, 4)) }
                    td.number { (optional(drive.max_cross_track_m, 3)) }
                    td.number { (drive.steering_limited.map_or_else(|| "–".to_owned(), |share| format!("{} %", number(share * 100.0, 1)))) }
                    td.number { (drive.collisions.map_or_else(|| "–".to_owned(), integer)) }
                    @if rows.iter().any(|row| row.noisy.is_some()) {
                        td.number { (row.noisy.as_ref().and_then(|noisy| noisy.collisions).map_or_else(|| "–".to_owned(), integer)) }
                    }
                }))
            }
        },
    )
}

fn switches(rows: &[ValidateRow], config: &RunConfig) -> Markup {
    table(
        html! { tr {
            th { "row" } th.number { "time [s]" } th.number { "zone" } th { "manoeuvre" } (gain_heads())
        } },
        html! {
            @for (index, row) in rows.iter().enumerate() {
                @for switch in &row.switches {
                    tr class=[row.chosen_by_paper.then_some("chosen")] {
                        td { (index + 1) @if row.chosen_by_paper { " ★" } }
                        td.number { (number(switch.tick as f64 * config.drive.tick_s, 2)) }
                        td.number { (switch.zone + 1) }
                        td { (switch.name) }
                        (gain_cells(&switch.gains))
                    }
                }
            }
        },
    )
}
