//! The result of a single drive.

use config::RunConfig;
use maud::html;
use outcome::{InEnvelope, SingleDrive};

use crate::ReportError;
use crate::axis::{Axis, number};
use crate::canvas::{DASHES, GREY, NAVY, Stroke, WIDE};
use crate::chart::{Chart, Line};
use crate::page::{Page, parameter_cells, parameter_heads, table};
use crate::standings::{
    PATH_GROUP, arrived, is_objective, objective_title, path_cells, path_heads,
};
use crate::switches::{SwitchesOf, switch_table};

/// Adds the sections of a drive to the page.
pub(crate) fn sections(
    page: &mut Page,
    drive: &SingleDrive,
    config: &RunConfig,
) -> Result<(), ReportError> {
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
    match &drive.envelope {
        Some(envelope) => in_envelope(page, envelope),
        None => Ok(()),
    }
}

/// How the drive was beside calibrated ones: its score, and the paper's quality of tracking as observed and as recorded.
fn in_envelope(page: &mut Page, it: &InEnvelope) -> Result<(), ReportError> {
    let words = |name: &str| name.replace('_', " ");
    let observed = it.quality.iter().map(|it| (it.at_s, it.observed));
    let of_calibrated = |sds: f64| {
        let all = it.quality.iter();
        all.filter_map(move |it| Some((it.at_s, (it.calibrated? + sds * it.sd?).min(1.0))))
    };
    let band = Stroke::dashed(GREY, 0.9, DASHES[2]);
    let lines = [
        Line::new("this drive", observed, Stroke::solid(NAVY, 1.4)),
        Line::new("calibrated drives, mean", of_calibrated(0.0), Stroke::solid(GREY, 1.4)),
        Line::new("mean + 2 standard deviations", of_calibrated(2.0), band),
        Line::new("mean − 2 standard deviations", of_calibrated(-2.0), band),
    ];
    let picture = if it.quality.len() < 2 {
        None
    } else {
        let chart = Chart {
            name: "quality",
            words: "The quality of tracking over time: of this drive, and of the calibrated ones",
            width: WIDE,
            height: 210.0,
            x: Axis::tight(it.quality.iter().map(|it| it.at_s), 6),
            x_name: "time [s]",
            y_name: "quality Q",
            lines: &lines,
            legend_rows: 1,
            borders: &[],
        };
        Some(page.figure(chart.draw()?, "Q = 1/(1 + √(Ē_y² + 10 Ē_θ²)) over one second: what was observed, and what the calibrated drives had as long after take-off."))
    };
    page.section(
        "In its envelope",
        html! {
            p {
                "Score " (number(it.score, 3)) " by " (words(&it.worst)) " over " (number(it.over_s, 0)) " s, where "
                (number(it.threshold, 3)) " is the limit. "
                @match (it.out_at_s, &it.out_by) {
                    (Some(at_s), Some(by)) => {
                        "Out of it after " (number(at_s, 2)) " s, by " (words(by)) "; "
                        @match &it.action {
                            Some(action) => { "the gate’s answer: " (words(action)) "." }
                            None => { "it was not stopped for that." }
                        }
                    }
                    _ => { "It was never out of it." }
                }
            }
            @if let Some(picture) = picture { (picture) }
        },
    );
    Ok(())
}
