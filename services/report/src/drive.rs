//! The result of a single drive.

use config::RunConfig;
use maud::html;
use outcome::SingleDrive;

use crate::axis::number;
use crate::page::{Page, parameter_cells, parameter_heads, table};
use crate::standings::{
    PATH_GROUP, arrived, is_objective, objective_title, path_cells, path_heads,
};
use crate::switches::{SwitchesOf, switch_table};

/// Adds the sections of a drive to the page.
pub(crate) fn sections(page: &mut Page, drive: &SingleDrive, config: &RunConfig) {
    let poses = if drive.true_poses { "true" } else { "measured" };
    let measures = &drive.measures;
    let shows_distance = !is_objective(config, "distance");
    page.section(
        "The drive",
        html! {
            (table(
                html! { tr { (parameter_heads(&config.law)) } },
                html! { @for set in &drive.gains { tr { (parameter_cells(&config.law, set)) } } },
            ))
            @if drive.gains.len() > 1 { p { "One set for each manoeuvre of the path, in their order." } }
            (table(
                html! {
                    tr {
                        th.group { "objective" }
                        th.group colspan="3" { (PATH_GROUP) }
                        @if shows_distance { th.group { "the paper’s distance" } }
                        th.group colspan="3" { "mse [m²]" }
                        th.group colspan="2" { "cross-track error [m]" }
                        th {}
                    }
                    tr {
                        th.number { (objective_title(config)) }
                        (path_heads())
                        @if shows_distance { th.number { "[m]" } }
                        th.number { "all" } th.number { "along" } th.number { "across" }
                        th.number { "mean" } th.number { "largest" }
                        th { "arrived" }
                    }
                },
                html! { tr {
                    td.number { (number(measures.value, 4)) }
                    (path_cells(measures))
                    @if shows_distance { td.number { (number(measures.distance, 4)) } }
                    @for share in [measures.mse_m2, drive.along_m2, drive.cross_m2] { td.number { (number(share, 4)) } }
                    @for metres in [drive.mean_abs_cross_track_m, drive.max_cross_track_m] { td.number { (number(metres, 3)) } }
                    td { (arrived(measures)) }
                } },
            ))
            p {
                (number(drive.driven_s, 1)) " s driven, ended by: " (drive.reason) ", at "
                (number(drive.progress * 100.0, 1)) " % of the path. All figures are of the " (poses)
                " poses; the cross-track error is measured against the current reference."
                @if drive.joined { " The controller was restarted during the drive; the measures cover the time since then." }
            }
            @let how = drive.stopped_how.as_deref().map(|it| format!(" ({})", it.replace('_', " ")));
            @for (what, how, reasons) in [
                ("stopped the vehicle", how.unwrap_or_default(), &drive.stopped_for),
                ("slowed down the vehicle, or noticed", String::new(), &drive.slowed_for),
            ] {
                @if !reasons.is_empty() {
                    p { "The gate " (what) (how) ": " (reasons.join(", ").replace('_', " ")) "." }
                }
            }
            p {
                (crate::standings::effort(&drive.measures))
            }
        },
    );
    if !drive.switches.is_empty() {
        let of = SwitchesOf { name: String::new(), is_chosen: false, switches: &drive.switches };
        page.section("Changes of parameters during the drive", switch_table(config, &[of]));
    }
}
