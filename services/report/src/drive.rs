//! A single drive: what it has come to.

use maud::html;

use crate::axis::number;
use crate::page::{Page, gain_cells, gain_heads, table};
use crate::result::Drive;

/// Adds the section of a drive to the page.
pub(crate) fn section(page: &mut Page, drive: &Drive) {
    let poses = if drive.true_poses { "true" } else { "measured" };
    page.section(
        "The drive",
        html! {
            (table(
                html! { tr { (gain_heads()) } },
                html! { @for set in &drive.gains { tr { (gain_cells(set)) } } },
            ))
            p {
                (number(drive.driven_s, 1)) " s driven; ended by: " (drive.reason) ". mse "
                (number(drive.mse_m2, 4)) " m² (along the track " (number(drive.along_m2, 4))
                ", across " (number(drive.cross_m2, 4)) "), at most "
                (number(drive.max_cross_track_m, 2)) " m off the path, of the " (poses) " poses."
                @if drive.joined { " The controller was restarted on the way; errors are those since then." }
            }
        },
    );
}
