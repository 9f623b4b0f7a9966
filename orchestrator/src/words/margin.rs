//! How much later the steering may act: what is said of gains that were chosen.

use crate::words::Failure;
use crate::words::terminal::{say, tell};

/// How much later the steering may act until the loop oscillates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Margin {
    /// The highest speed of the path's reference, for which this holds.
    pub speed_mps: f64,
    /// The additional dead time: 0 if the loop is unstable, infinite if there is no bound.
    pub additional_dead_time_s: f64,
    /// Below this a set is fragile.
    pub fragile_below_s: f64,
}

impl Margin {
    /// Says it, and warns if it is small.
    pub(crate) fn print(&self) -> Result<(), Failure> {
        let Self { speed_mps, additional_dead_time_s, fragile_below_s } = *self;
        if additional_dead_time_s.is_finite() {
            say!(
                "additional dead time at {speed_mps} m/s: {:.0} ms",
                1000.0 * additional_dead_time_s
            );
        }
        if additional_dead_time_s == 0.0 {
            tell!(
                "pathtune: warning: with this vehicle's steering these gains are unstable at {speed_mps} m/s"
            );
        } else if additional_dead_time_s < fragile_below_s {
            tell!(
                "pathtune: warning: fragile: with this vehicle at {speed_mps} m/s the steering may act only {:.0} ms later \
                 until the loop oscillates; below {:.0} ms noisy drives are often lost",
                1000.0 * additional_dead_time_s,
                1000.0 * fragile_below_s
            );
        }
        Ok(())
    }
}
