//! The table of where the parameters changed with the zone.

use config::RunConfig;
use maud::{Markup, html};
use outcome::Switch;

use crate::axis::number;
use crate::page::{parameter_cells, parameter_heads, table};

/// The drive that changed its parameters.
#[derive(Debug)]
pub(crate) struct SwitchesOf<'a> {
    /// Its name in the table; empty if it is the only one.
    pub(crate) name: String,
    /// Whether its rows are highlighted.
    pub(crate) is_chosen: bool,
    pub(crate) switches: &'a [Switch],
}

/// A row for each change.
pub(crate) fn switch_table(config: &RunConfig, drives: &[SwitchesOf]) -> Markup {
    let is_named = drives.iter().any(|drive| !drive.name.is_empty());
    table(
        html! { tr {
            @if is_named { th { "row" } }
            th.number { "time [s]" } th.number { "zone" } th { "manoeuvre" } (parameter_heads(&config.law))
        } },
        html! {
            @for drive in drives {
                @for switch in drive.switches {
                    tr class=[drive.is_chosen.then_some("chosen")] {
                        @if is_named { td { (drive.name) } }
                        td.number { (number(switch.tick as f64 * config.drive.tick_s, 2)) }
                        td.number { (u64::from(switch.zone) + 1) }
                        td { (switch.name) }
                        (parameter_cells(&config.law, &switch.gains))
                    }
                }
            }
        },
    )
}
