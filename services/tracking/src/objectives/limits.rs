//! Limits of a drive beside its objective: a price on turning the wheels, and bounds that a drive is to keep.
//!
//! A further limit is a key of `config::ObjectiveLimits`, a row of [`Limits::bounds`], and a row of `broken_limits` in
//! `services/outcome`, by which it is told that a set breaks it.

use config::ObjectiveLimits;

use crate::DriveRecord;

/// The price doubles the objective where the travel is above its threshold by one part of this many.
const STEEPNESS: f64 = 5.0;

/// The limits of a configuration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Limits(pub(super) ObjectiveLimits);

impl Limits {
    /// Whether there is a limit that a drive can break; a price is none.
    pub(super) fn are_hard(&self) -> bool {
        let with_price_alone = ObjectiveLimits {
            steering_travel_price_radps: self.0.steering_travel_price_radps,
            ..ObjectiveLimits::default()
        };
        self.0 != with_price_alone
    }

    /// What the objective is multiplied by, with the excess e = travel / threshold − 1:
    ///
    ///   1 below the threshold, 1 + (5·e)² up to e = 1/5, and from there on along the tangent, 10·e
    ///
    /// Value and slope are continuous. So steep because a car that is shaken a little more may well be nearer to the path
    /// by half: with 1 + e² sets were chosen that turn the wheels half as much again. And no steeper, so that all that
    /// shake are told apart.
    pub(super) fn price(&self, drive: &DriveRecord) -> f64 {
        let from = self.0.steering_travel_price_radps;
        if from <= 0.0 || drive.steering_travel_radps <= from {
            return 1.0;
        }
        let excess = STEEPNESS * (drive.steering_travel_radps / from - 1.0);
        if excess <= 1.0 { 1.0 + excess * excess } else { 2.0 * excess }
    }

    /// How much a drive misses the limits by: 0 if it keeps them all, at most 1 for each that it breaks.
    pub(super) fn missed(&self, drive: &DriveRecord) -> f64 {
        let over: f64 = self.bounds(drive).iter().map(|&(value, limit)| over(value, limit)).sum();
        over + (self.0.progress - drive.progress_in_time).max(0.0)
    }

    /// What [`Limits::missed`] does not exceed: 1 for each limit that is set.
    pub(super) fn most_missed(&self) -> f64 {
        let bounds = self.bounds(&DriveRecord::default());
        let set = bounds.iter().map(|&(_, limit)| limit).chain([self.0.progress]);
        set.filter(|&limit| limit > 0.0).count() as f64
    }

    /// What a drive is to keep below: its value, and the limit.
    fn bounds(&self, drive: &DriveRecord) -> [(f64, f64); 6] {
        let limits = &self.0;
        [
            (drive.steering_travel_radps, limits.steering_travel_radps),
            (drive.steering_rate_p95_radps, limits.steering_rate_p95_radps),
            (drive.lateral_acceleration_p95_mps2, limits.lateral_acceleration_p95_mps2),
            (drive.lateral_acceleration_max_mps2, limits.lateral_acceleration_max_mps2),
            (drive.lateral_jerk_p95_mps3, limits.lateral_jerk_p95_mps3),
            (drive.lateral_jerk_max_mps3, limits.lateral_jerk_max_mps3),
        ]
    }
}

/// How much a value is over its limit: 0 within it, towards 1 far beyond.
fn over(value: f64, limit: f64) -> f64 {
    if limit <= 0.0 || value <= limit {
        return 0.0;
    }
    (value - limit) / value
}
