//! The table of the laps.

use std::collections::BTreeMap;

use maud::html;
use outcome::{Lap, alike};

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
            @for (name, laps) in laps {
                @if let Some(alike) = alike(laps) {
                    p {
                        (name.replace('_', " ")) ": the " (alike.count) " laps without a standstill are "
                        (number(alike.path_mean_m, 4)) " m from the path at the mean, each within "
                        (number(100.0 * alike.apart, 1)) " % of that."
                    }
                }
            }
            p {
                "Lap times are exact to a tick. The stretch on which the car comes up to speed at the start is left out of the "
                "mean distance of every lap, so that laps can be compared."
            }
        },
    );
}
