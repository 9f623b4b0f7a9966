//! Limits of a drive beside its objective: a price on turning the wheels, and bounds that a drive is to keep.
//!
//! A further limit is a key of `config::ObjectiveLimits` and a term of [`Limits::missed`].

use config::ObjectiveLimits;

use crate::DriveRecord;

/// The limits of a configuration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Limits(pub(super) ObjectiveLimits);

impl Limits {
    /// Whether there is a limit that a drive can break; a price is none.
    pub(super) fn are_hard(&self) -> bool {
        self.0.steering_travel_radps > 0.0 || self.0.progress > 0.0
    }

    /// What the objective is multiplied by: 1 + e², with the excess e = travel / threshold − 1, or 1 below the
    /// threshold. Value and slope are continuous there.
    pub(super) fn price(&self, drive: &DriveRecord) -> f64 {
        let from = self.0.steering_travel_price_radps;
        if from <= 0.0 || drive.steering_travel_radps <= from {
            return 1.0;
        }
        let excess = drive.steering_travel_radps / from - 1.0;
        1.0 + excess * excess
    }

    /// How much a drive misses the limits by: 0 if it keeps them all, at most 1 for each that it breaks.
    pub(super) fn missed(&self, drive: &DriveRecord) -> f64 {
        over(drive.steering_travel_radps, self.0.steering_travel_radps)
            + (self.0.progress - drive.progress).max(0.0)
    }
}

/// How much a value is over its limit: 0 within it, towards 1 far beyond.
fn over(value: f64, limit: f64) -> f64 {
    if limit <= 0.0 || value <= limit {
        return 0.0;
    }
    (value - limit) / value
}
