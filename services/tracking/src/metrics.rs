//! What is remembered of a drive: mean absolute errors, mean squared errors, and why it ended.

use crate::TrackingError;

/// Why a drive ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EndReason {
    /// The drive's time was over.
    Time,
    /// The vehicle reached the end of the path.
    Goal,
    /// The vehicle reported a collision.
    Collision,
}

/// What is remembered of a drive.
///
/// Every mean is over the ticks of the drive; where a collision cut the drive short, the ticks that it
/// cut off score the last error, else crashing early would pay.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DriveMetrics {
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
}

impl DriveMetrics {
    /// The paper's figure of merit: mean of (e_x² + e_y²)/2.
    pub fn mse_m2(&self) -> f64 {
        self.along_mse_m2 + self.cross_mse_m2
    }

    /// Distance of the drive's state to the goal; see [`state_distance`].
    pub fn distance(&self, heading_weight: f64) -> f64 {
        state_distance(self.mean_abs_cross_m, self.mean_abs_heading_rad, heading_weight)
    }
}

/// Distance of a state to the goal: d = √(E_y² + w·E_θ²), the paper's equation 4 with w = 10.
pub fn state_distance(cross_m: f64, heading_rad: f64, heading_weight: f64) -> f64 {
    (cross_m * cross_m + heading_weight * (heading_rad * heading_rad)).sqrt()
}

/// Adds up a drive, tick by tick.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct MetricsRecorder {
    ticks: u64,
    last: TrackingError,
    abs_along: f64,
    abs_cross: f64,
    abs_heading: f64,
    along_squared: f64,
    cross_squared: f64,
    max_abs_cross: f64,
    steering_limited_ticks: u64,
}

impl MetricsRecorder {
    /// Adds one tick.
    pub fn add(&mut self, error: TrackingError, steering_limited: bool) {
        self.ticks += 1;
        self.last = error;
        self.weigh(error, 1.0);
        self.max_abs_cross = self.max_abs_cross.max(error.cross_track_m.abs());
        self.steering_limited_ticks += u64::from(steering_limited);
    }

    /// Ends the drive, which would have lasted `full_ticks`.
    pub fn finish(mut self, reason: EndReason, full_ticks: u64) -> DriveMetrics {
        let mut ticks = self.ticks;
        if reason == EndReason::Collision {
            self.weigh(self.last, full_ticks.saturating_sub(ticks) as f64);
            ticks = full_ticks.max(ticks);
        }
        let count = ticks.max(1) as f64;
        DriveMetrics {
            ticks: self.ticks,
            reason,
            mean_abs_along_m: self.abs_along / count,
            mean_abs_cross_m: self.abs_cross / count,
            mean_abs_heading_rad: self.abs_heading / count,
            along_mse_m2: self.along_squared / 2.0 / count,
            cross_mse_m2: self.cross_squared / 2.0 / count,
            max_abs_cross_m: self.max_abs_cross,
            steering_limited_ticks: self.steering_limited_ticks,
        }
    }

    fn weigh(&mut self, error: TrackingError, ticks: f64) {
        let TrackingError { along_track_m: along, cross_track_m: cross, heading_rad } = error;
        self.abs_along += along.abs() * ticks;
        self.abs_cross += cross.abs() * ticks;
        self.abs_heading += heading_rad.abs() * ticks;
        self.along_squared += along * along * ticks;
        self.cross_squared += cross * cross * ticks;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error(cross_track_m: f64) -> TrackingError {
        TrackingError { along_track_m: 1.0, cross_track_m, heading_rad: -0.5 }
    }

    #[test]
    fn means_are_over_the_ticks() {
        let mut recorder = MetricsRecorder::default();
        recorder.add(error(1.0), false);
        recorder.add(error(-3.0), true);
        let metrics = recorder.finish(EndReason::Time, 2);
        assert_eq!(metrics.mean_abs_cross_m, 2.0);
        assert_eq!(metrics.mean_abs_heading_rad, 0.5);
        assert_eq!(metrics.mse_m2(), 0.5 + 2.5);
        assert_eq!(metrics.max_abs_cross_m, 3.0);
        assert_eq!(metrics.steering_limited_ticks, 1);
        assert_eq!(metrics.distance(10.0), (4.0f64 + 2.5).sqrt());
    }

    #[test]
    fn crashing_early_does_not_pay() {
        let mut recorder = MetricsRecorder::default();
        recorder.add(error(0.0), false);
        recorder.add(error(4.0), false);
        let crashed = recorder.finish(EndReason::Collision, 10);
        assert_eq!(crashed.ticks, 2);
        assert_eq!(crashed.mean_abs_cross_m, 3.6);
        assert_eq!(recorder.finish(EndReason::Goal, 10).mean_abs_cross_m, 2.0);
    }
}
