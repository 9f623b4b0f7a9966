//! The record of a drive: mean errors, distances from the path, and why it ended.

use serde::{Deserialize, Serialize};

use crate::TrackingError;

/// Why a drive ended.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EndReason {
    /// The drive's time was over.
    #[default]
    Time,
    /// The vehicle reached the end of the path.
    Goal,
    /// The vehicle reported a collision.
    Collision,
    /// The vehicle did not follow: the reference had waited for it as long as it may.
    Held,
    /// The gate stopped the vehicle, because of how it drove.
    Stopped,
}

/// The record of a drive.
///
/// Every mean is over the ticks of the drive. If a collision or the gate cut the drive short, each tick that was
/// cut off counts with the last error; otherwise an early crash would be rewarded. Poses are true ones if the vehicle
/// knows them, otherwise measured ones.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DriveRecord {
    /// Ticks driven.
    pub ticks: u64,
    /// Why the drive ended.
    pub reason: EndReason,
    /// Mean absolute along-track error.
    pub mean_abs_along_m: f64,
    /// Mean absolute cross-track error: the paper's E_y.
    pub mean_abs_cross_m: f64,
    /// Mean absolute heading error: the paper's E_θ.
    pub mean_abs_heading_rad: f64,
    /// Along-track share of the paper's mse (its equation 6): mean of e_x²/2.
    pub along_mse_m2: f64,
    /// Cross-track share of the paper's mse: mean of e_y²/2.
    pub cross_mse_m2: f64,
    /// Largest absolute cross-track error.
    pub max_abs_cross_m: f64,
    /// Ticks on which the steering angle was at its limit.
    pub steering_limited_ticks: u64,
    /// Hash over every pose that was seen and every command that was given, bit for bit.
    pub trace: u64,
    /// Mean distance of the pose from the nearest point of the path.
    pub path_mean_m: f64,
    /// Its 95th percentile.
    pub path_p95_m: f64,
    /// Its largest value.
    pub path_max_m: f64,
    /// Share of the path, 0 to 1, that had been covered when the drive ended.
    pub progress: f64,
    /// Share of the path, 0 to 1, that had been covered when the reference reached its end, or when the drive ended if
    /// that was earlier: how well the vehicle keeps up.
    pub progress_in_time: f64,
    /// Mean absolute rate of the steering angle that is commanded, as the gate's limit lets it through.
    pub steering_travel_radps: f64,
    /// The absolute rate of that angle that 95 % of the ticks do not exceed.
    pub steering_rate_p95_radps: f64,
    /// The absolute lateral acceleration that 95 % of the ticks do not exceed: speed times yaw rate, as the odometry
    /// reports them.
    pub lateral_acceleration_p95_mps2: f64,
    /// Its largest value.
    pub lateral_acceleration_max_mps2: f64,
    /// The absolute lateral jerk that 95 % of the times do not exceed: the change of the lateral acceleration over 0.1 s.
    pub lateral_jerk_p95_mps3: f64,
    /// Its largest value.
    pub lateral_jerk_max_mps3: f64,
    /// What the gate stopped the vehicle for, as bits of its reasons; 0 if it did not.
    #[serde(default)]
    pub stopped_for: u32,
    /// What it slowed the vehicle down for, or only told, as bits of its reasons.
    #[serde(default)]
    pub slowed_for: u32,
    /// In the record of several drives: how much those that did not arrive missed, 0 to 1; see
    /// [`Objective::mean_of`](crate::Objective::mean_of). 0 in that of one drive, whose own measures tell it.
    #[serde(default)]
    pub missed: f64,
}

impl DriveRecord {
    /// The paper's figure of merit: mean of (e_x² + e_y²)/2.
    pub fn mse_m2(&self) -> f64 {
        self.along_mse_m2 + self.cross_mse_m2
    }

    /// Distance of the drive's state to the goal; see [`state_distance`].
    pub fn distance(&self, heading_weight: f64) -> f64 {
        state_distance(self.mean_abs_cross_m, self.mean_abs_heading_rad, heading_weight)
    }

    /// Whether the vehicle reached the end of the path.
    pub fn arrived(&self) -> bool {
        self.reason == EndReason::Goal
    }

    /// Whether the drive ended in a collision.
    pub fn collided(&self) -> bool {
        self.reason == EndReason::Collision
    }

    /// One record of several drives with the same parameters: the means of their errors and shares, the largest of their
    /// largest values, and the reason of the first that does not arrive, if there is one.
    ///
    /// # Panics
    /// If there is no drive.
    pub fn mean_of(drives: &[Self]) -> Self {
        let mean = |of: fn(&Self) -> f64| drives.iter().map(of).sum::<f64>() / drives.len() as f64;
        let most = |of: fn(&Self) -> f64| drives.iter().map(of).fold(0.0, f64::max);
        let late = drives.iter().find(|it| !it.arrived());
        Self {
            ticks: drives.iter().map(|it| it.ticks).max().expect("a drive"),
            reason: late.map_or(EndReason::Goal, |it| it.reason),
            mean_abs_along_m: mean(|it| it.mean_abs_along_m),
            mean_abs_cross_m: mean(|it| it.mean_abs_cross_m),
            mean_abs_heading_rad: mean(|it| it.mean_abs_heading_rad),
            along_mse_m2: mean(|it| it.along_mse_m2),
            cross_mse_m2: mean(|it| it.cross_mse_m2),
            max_abs_cross_m: most(|it| it.max_abs_cross_m),
            steering_limited_ticks: drives
                .iter()
                .map(|it| it.steering_limited_ticks)
                .max()
                .expect("a drive"),
            // Changes with every one of them, and with their order.
            trace: drives.iter().fold(0, |trace: u64, it| trace.rotate_left(7) ^ it.trace),
            path_mean_m: mean(|it| it.path_mean_m),
            path_p95_m: mean(|it| it.path_p95_m),
            path_max_m: most(|it| it.path_max_m),
            progress: mean(|it| it.progress),
            progress_in_time: mean(|it| it.progress_in_time),
            steering_travel_radps: mean(|it| it.steering_travel_radps),
            steering_rate_p95_radps: mean(|it| it.steering_rate_p95_radps),
            lateral_acceleration_p95_mps2: mean(|it| it.lateral_acceleration_p95_mps2),
            lateral_acceleration_max_mps2: most(|it| it.lateral_acceleration_max_mps2),
            lateral_jerk_p95_mps3: mean(|it| it.lateral_jerk_p95_mps3),
            lateral_jerk_max_mps3: most(|it| it.lateral_jerk_max_mps3),
            stopped_for: drives.iter().fold(0, |bits, it| bits | it.stopped_for),
            slowed_for: drives.iter().fold(0, |bits, it| bits | it.slowed_for),
            missed: 0.0,
        }
    }

    /// Whether every number is one that a drive can have.
    pub fn is_plausible(&self) -> bool {
        [
            self.mean_abs_along_m,
            self.mean_abs_cross_m,
            self.mean_abs_heading_rad,
            self.along_mse_m2,
            self.cross_mse_m2,
            self.max_abs_cross_m,
            self.path_mean_m,
            self.path_p95_m,
            self.path_max_m,
            self.steering_travel_radps,
            self.steering_rate_p95_radps,
            self.lateral_acceleration_p95_mps2,
            self.lateral_acceleration_max_mps2,
            self.lateral_jerk_p95_mps3,
            self.lateral_jerk_max_mps3,
        ]
        .into_iter()
        .all(|number| number.is_finite() && number >= 0.0)
            && [self.progress, self.progress_in_time, self.missed]
                .iter()
                .all(|it| (0.0..=1.0).contains(it))
    }
}

/// Distance of a state to the goal: d = √(E_y² + w·E_θ²), the paper's equation 4 with w = 10.
pub fn state_distance(cross_m: f64, heading_rad: f64, heading_weight: f64) -> f64 {
    (cross_m * cross_m + heading_weight * (heading_rad * heading_rad)).sqrt()
}

/// What one tick adds to the record of a drive.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct TickMeasures {
    /// The error that is scored.
    pub error: TrackingError,
    /// Distance of the pose from the nearest point of the path.
    pub path_distance_m: f64,
    /// The steering angle that was commanded, as the gate's limit lets it through.
    pub steering_rad: f64,
    /// Whether it was at its limit.
    pub steering_limited: bool,
    /// Speed times yaw rate.
    pub lateral_acceleration_mps2: f64,
}

/// Adds up a drive, tick by tick.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct DriveRecorder {
    ticks: u64,
    last: TickMeasures,
    abs_along: f64,
    abs_cross: f64,
    abs_heading: f64,
    along_squared: f64,
    cross_squared: f64,
    max_abs_cross: f64,
    steering_limited_ticks: u64,
    path: f64,
    path_max: f64,
    path_distances: Samples,
    steering_travel: f64,
    /// Changes of the steering angle from tick to tick.
    turns: Samples,
    lateral_accelerations: Samples,
    lateral_acceleration_max: f64,
    jerk: Jerk,
}

/// How far a drive had come, as shares of the path from 0 to 1.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Covered {
    /// When the drive ended.
    pub at_end: f64,
    /// When the reference reached the path's end, or when the drive ended if that was earlier.
    pub in_time: f64,
}

/// The change of the lateral acceleration from one sample to the next, a tenth of a second later.
#[derive(Debug, Clone, Default, PartialEq)]
struct Jerk {
    /// Ticks between two samples, from their length on.
    every: u64,
    last_mps2: f64,
    changes: Samples,
    max_mps2: f64,
}

impl Jerk {
    /// Time between two samples: a change from tick to tick would be the odometry's noise.
    const OVER_S: f64 = 0.1;

    #[inline]
    fn add(&mut self, tick: u64, lateral_acceleration_mps2: f64) {
        if self.every == 0 || !tick.is_multiple_of(self.every) {
            return;
        }
        let change_mps2 = (lateral_acceleration_mps2 - self.last_mps2).abs();
        self.last_mps2 = lateral_acceleration_mps2;
        self.changes.add(change_mps2);
        self.max_mps2 = self.max_mps2.max(change_mps2);
    }
}

impl DriveRecorder {
    /// Before the first tick of a drive with ticks of this length.
    pub fn new(tick_s: f64) -> Self {
        let every = libm::round(Jerk::OVER_S / tick_s).max(1.0) as u64;
        Self { jerk: Jerk { every, ..Jerk::default() }, ..Self::default() }
    }

    /// Returns to the start, for another drive.
    pub fn reset(&mut self) {
        let cleared = |samples: &mut Samples| std::mem::take(samples).cleared();
        let path_distances = cleared(&mut self.path_distances);
        let turns = cleared(&mut self.turns);
        let lateral_accelerations = cleared(&mut self.lateral_accelerations);
        let changes = cleared(&mut self.jerk.changes);
        let jerk = Jerk { every: self.jerk.every, changes, ..Jerk::default() };
        *self = Self { path_distances, turns, lateral_accelerations, jerk, ..Self::default() };
    }

    /// Adds one tick.
    #[inline]
    pub fn add(&mut self, tick: TickMeasures) {
        self.ticks += 1;
        self.weigh(&tick, 1.0);
        self.max_abs_cross = self.max_abs_cross.max(tick.error.cross_track_m.abs());
        self.steering_limited_ticks += u64::from(tick.steering_limited);
        self.path_max = self.path_max.max(tick.path_distance_m);
        self.path_distances.add(tick.path_distance_m);
        // Starts from 0: at the start of a drive the wheels are straight.
        let turn_rad = (tick.steering_rad - self.last.steering_rad).abs();
        self.steering_travel += turn_rad;
        self.turns.add(turn_rad);
        let lateral_acceleration_mps2 = tick.lateral_acceleration_mps2.abs();
        self.lateral_accelerations.add(lateral_acceleration_mps2);
        self.lateral_acceleration_max =
            self.lateral_acceleration_max.max(lateral_acceleration_mps2);
        self.jerk.add(self.ticks, tick.lateral_acceleration_mps2);
        self.last = tick;
    }

    /// Ends the drive, which would have lasted `full_ticks` of `tick_s` each.
    pub fn finish(
        &mut self,
        reason: EndReason,
        full_ticks: u64,
        tick_s: f64,
        covered: Covered,
        trace: u64,
    ) -> DriveRecord {
        let mut ticks = self.ticks;
        if matches!(reason, EndReason::Collision | EndReason::Stopped) {
            let cut_off = full_ticks.saturating_sub(ticks);
            let last = self.last;
            self.weigh(&last, cut_off as f64);
            for _ in 0..cut_off {
                self.path_distances.add(last.path_distance_m);
            }
            ticks = full_ticks.max(ticks);
        }
        let count = ticks.max(1) as f64;
        let driven = self.ticks.max(1) as f64;
        let jerk_s = self.jerk.every.max(1) as f64 * tick_s;
        DriveRecord {
            ticks: self.ticks,
            reason,
            mean_abs_along_m: self.abs_along / count,
            mean_abs_cross_m: self.abs_cross / count,
            mean_abs_heading_rad: self.abs_heading / count,
            along_mse_m2: self.along_squared / 2.0 / count,
            cross_mse_m2: self.cross_squared / 2.0 / count,
            max_abs_cross_m: self.max_abs_cross,
            steering_limited_ticks: self.steering_limited_ticks,
            trace,
            path_mean_m: self.path / count,
            path_p95_m: self.path_distances.percentile(0.95).min(self.path_max),
            path_max_m: self.path_max,
            progress: covered.at_end,
            progress_in_time: covered.in_time,
            steering_travel_radps: self.steering_travel / (driven * tick_s),
            steering_rate_p95_radps: self.turns.percentile(0.95) / tick_s,
            lateral_acceleration_p95_mps2: self
                .lateral_accelerations
                .percentile(0.95)
                .min(self.lateral_acceleration_max),
            lateral_acceleration_max_mps2: self.lateral_acceleration_max,
            lateral_jerk_p95_mps3: self.jerk.changes.percentile(0.95) / jerk_s,
            lateral_jerk_max_mps3: self.jerk.max_mps2 / jerk_s,
            stopped_for: 0,
            slowed_for: 0,
            missed: 0.0,
        }
    }

    #[inline]
    fn weigh(&mut self, tick: &TickMeasures, ticks: f64) {
        let TrackingError { along_track_m: along, cross_track_m: cross, heading_rad } = tick.error;
        self.abs_along += along.abs() * ticks;
        self.abs_cross += cross.abs() * ticks;
        self.abs_heading += heading_rad.abs() * ticks;
        self.along_squared += along * along * ticks;
        self.cross_squared += cross * cross * ticks;
        self.path += tick.path_distance_m * ticks;
    }
}

/// Values of which a percentile is wanted: all of them, or every second, fourth, … of very many.
#[derive(Debug, Clone, PartialEq)]
struct Samples {
    values: Vec<f32>,
    /// One of every `stride` values is kept.
    stride: u32,
    /// How many values are skipped until the next is kept.
    passing: u32,
}

impl Default for Samples {
    fn default() -> Self {
        Self { values: Vec::new(), stride: 1, passing: 0 }
    }
}

impl Samples {
    /// Ten minutes at 100 Hz are kept whole. More would take memory without a better percentile.
    const MOST: usize = 65_536;

    fn cleared(mut self) -> Self {
        self.values.clear();
        Self { values: self.values, ..Self::default() }
    }

    #[inline]
    fn add(&mut self, value: f64) {
        if self.passing > 0 {
            self.passing -= 1;
            return;
        }
        if self.values.len() == Self::MOST {
            let mut place = 0;
            self.values.retain(|_| {
                place += 1;
                place % 2 == 1
            });
            self.stride *= 2;
        }
        self.values.push(value as f32);
        self.passing = self.stride - 1;
    }

    /// The value below which a share of all values lies, interpolated between two values; 0 if there are none.
    fn percentile(&mut self, share: f64) -> f64 {
        let Some(last) = self.values.len().checked_sub(1) else { return 0.0 };
        let place = share * last as f64;
        let below = place as usize;
        let (_, &mut low, above) = self.values.select_nth_unstable_by(below, f32::total_cmp);
        let high = above.iter().copied().fold(f32::INFINITY, f32::min);
        let high = if above.is_empty() { low } else { high };
        f64::from(low) + (place - below as f64) * (f64::from(high) - f64::from(low))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tick(cross_track_m: f64) -> TickMeasures {
        TickMeasures {
            error: TrackingError { along_track_m: 1.0, cross_track_m, heading_rad: -0.5 },
            path_distance_m: cross_track_m.abs(),
            ..TickMeasures::default()
        }
    }

    #[test]
    fn means_are_over_the_ticks() {
        let mut recorder = DriveRecorder::new(0.1);
        recorder.add(TickMeasures { steering_rad: 0.1, ..tick(1.0) });
        recorder.add(TickMeasures {
            steering_limited: true,
            steering_rad: -0.1,
            lateral_acceleration_mps2: -2.0,
            ..tick(-3.0)
        });
        let covered = Covered { at_end: 0.5, in_time: 0.25 };
        let record = recorder.finish(EndReason::Time, 2, 0.1, covered, 7);
        assert_eq!(record.mean_abs_cross_m, 2.0);
        assert_eq!(record.mean_abs_heading_rad, 0.5);
        assert_eq!(record.mse_m2(), 0.5 + 2.5);
        assert_eq!(record.max_abs_cross_m, 3.0);
        assert_eq!(record.steering_limited_ticks, 1);
        assert_eq!(record.distance(10.0), (4.0f64 + 2.5).sqrt());
        assert_eq!((record.path_mean_m, record.path_max_m), (2.0, 3.0));
        assert!((record.path_p95_m - 2.9).abs() < 1e-6);
        assert!((record.steering_travel_radps - 0.3 / 0.2).abs() < 1e-12);
        assert!((record.steering_rate_p95_radps - (0.1 + 0.95 * 0.1) / 0.1).abs() < 1e-6);
        assert_eq!((record.progress, record.progress_in_time), (0.5, 0.25));
        assert_eq!(record.lateral_acceleration_max_mps2, 2.0);
        assert!((record.lateral_acceleration_p95_mps2 - 1.9).abs() < 1e-6);
        // From 0 to -2 m/s² within a tenth of a second.
        assert_eq!(record.lateral_jerk_max_mps3, 20.0);
        assert!((record.lateral_jerk_p95_mps3 - 19.0).abs() < 1e-6);
        assert!(record.is_plausible());
        recorder.reset();
        assert_eq!(recorder, DriveRecorder::new(0.1));
    }

    #[test]
    fn crashing_early_does_not_pay() {
        let finish = |reason| {
            let mut recorder = DriveRecorder::default();
            recorder.add(tick(0.0));
            recorder.add(tick(4.0));
            recorder.finish(reason, 10, 0.01, Covered::default(), 0)
        };
        let crashed = finish(EndReason::Collision);
        assert_eq!(crashed.ticks, 2);
        assert_eq!((crashed.mean_abs_cross_m, crashed.path_mean_m), (3.6, 3.6));
        assert_eq!(crashed.path_p95_m, 4.0);
        assert_eq!(finish(EndReason::Stopped).mean_abs_cross_m, 3.6);
        assert_eq!(finish(EndReason::Goal).mean_abs_cross_m, 2.0);
    }

    #[test]
    fn a_percentile_is_that_of_all_values_also_of_very_many() {
        let of = |count: u32| {
            let mut samples = Samples::default();
            // Scattered: a prime's multiples visit every residue.
            (0..count).for_each(|index| samples.add(f64::from(index * 7919 % count)));
            assert!(samples.values.len() <= Samples::MOST);
            samples.percentile(0.95) / f64::from(count - 1)
        };
        assert_eq!(of(101), 0.95);
        assert!((of(1000) - 0.95).abs() < 1e-6);
        assert!((of(500_000) - 0.95).abs() < 1e-3);
        assert_eq!(Samples::default().percentile(0.95), 0.0);
    }
}
