//! The laps of the drives that were recorded.

use std::collections::BTreeMap;

use outcome::{Lap, alike};

use crate::words::Failure;
use crate::words::tables::{digits, or_dash, table_of};
use crate::words::terminal::say;

/// Prints the laps of each recorded drive; nothing if the path is driven once.
pub(super) fn print(laps: &BTreeMap<String, Vec<Lap>>) -> Result<(), Failure> {
    for (name, laps) in laps {
        let mut table =
            table_of(&[&format!("laps of {name}"), "time s", "path mean m", "path max m"]);
        for (index, lap) in laps.iter().enumerate() {
            let mean_m = digits(lap.path_mean_m, 4);
            let number = (index + 1).to_string();
            table.add_row([number, or_dash(lap.time_s, 2), mean_m, digits(lap.path_max_m, 3)]);
        }
        say!("{table}");
        if let Some(alike) = alike(laps) {
            say!(
                "the {} laps without a standstill: {} m from the path at the mean, each within {:.1} % of that",
                alike.count,
                digits(alike.path_mean_m, 4),
                100.0 * alike.apart
            );
        }
    }
    Ok(())
}
