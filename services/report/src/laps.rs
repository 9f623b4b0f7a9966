//! The table of the laps.

use std::collections::BTreeMap;

use maud::html;
use outcome::Lap;

use crate::axis::number;
use crate::page::{Page, table};

/// Adds the laps of each recorded drive to the page; nothing if the path is driven once.
pub(crate) fn section(page: &mut Page, laps: &BTreeMap<String, Vec<Lap>>) {
    if laps.is_empty() {
        return;
    }
    let rows = html! {
        @for (name, laps) in laps {
            @for (index, lap) in laps.iter().enumerate() {
                tr {
                    td { (name.replace('_', " ")) }
                    td.number { (index + 1) }
                    td.number { @match lap.time_s { Some(time_s) => (number(time_s, 2)), None => "–" } }
                    td.number { (number(lap.path_mean_m, 4)) }
                    td.number { (number(lap.path_max_m, 3)) }
                }
            }
        }
    };
    page.section(
        "Laps",
        html! {
            (table(
                html! { tr {
                    th { "drive" } th.number { "lap" } th.number { "time [s]" }
                    th.number { "path, mean [m]" } th.number { "path, largest [m]" }
                } },
                rows,
            ))
            p { "Lap times are exact to a tick. The first lap of a drive from rest holds its start." }
        },
    );
}
