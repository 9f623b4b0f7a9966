//! One drive of one vehicle: reference, error, law, metrics, and the end.

use config::{Gains, RunConfig};
use tracking::{
    DriveMetrics, EndReason, MetricsRecorder, Pose, Reference, TrackingError, tracking_error,
};

use crate::law::{ControlLaw, RawCommand};

/// What the controller sees of the vehicle at one tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Seen {
    /// Pose as measured: the law reads this one alone.
    pub measured: Pose,
    /// Pose in truth, where the vehicle knows it: metrics read this one.
    pub truth: Option<Pose>,
    /// Whether the vehicle reports a collision.
    pub collision: bool,
}

/// What the controller makes of one tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Decision {
    /// The command of this tick.
    pub command: RawCommand,
    /// The error that the law read.
    pub error: TrackingError,
    /// Progress of the reference along the path.
    pub reference_along_m: f64,
    /// The end of the drive, if this tick is its last.
    pub ended: Option<Ended>,
}

/// The end of a drive.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ended {
    /// What is remembered of it.
    pub metrics: DriveMetrics,
    /// Hash over every pose that was seen and every command that was given, bit for bit.
    pub trace: u64,
}

/// One drive of one vehicle.
#[derive(Debug, Clone)]
pub struct DriveController {
    reference: Reference,
    law: ControlLaw,
    metrics: MetricsRecorder,
    goal_radius_m: f64,
    ticks: u64,
    /// Ticks that the reference's clock had run before it last started from rest.
    ticks_before: u64,
    gains: Gains,
    trace: Trace,
}

impl DriveController {
    /// A drive with these gains, at its first tick.
    pub fn new(config: &RunConfig) -> Self {
        Self {
            reference: Reference::new(config),
            law: ControlLaw::new(config),
            metrics: MetricsRecorder::default(),
            goal_radius_m: config.drive.goal_radius_m,
            ticks: config.ticks(),
            ticks_before: 0,
            gains: Gains::default(),
            trace: Trace::default(),
        }
    }

    /// Back to the first tick, with these gains and this length.
    pub fn reset(&mut self, gains: Gains, ticks: u64) {
        self.reference.reset();
        self.law.reset();
        self.metrics = MetricsRecorder::default();
        self.trace = Trace::default();
        self.gains = gains;
        self.ticks = ticks;
        self.ticks_before = 0;
    }

    /// Goes on with a drive of which only this is known: where the reference's clock last started from rest, and the
    /// steering angle that was commanded last. The next tick tells how long the clock has run.
    pub fn join(&mut self, origin_m: f64, steering_rad: f64) {
        self.reference.restart_at(origin_m);
        self.law.resume(steering_rad);
    }

    /// Lets the reference's clock start again from rest, where the vehicle stands: at its projection on the path. The
    /// clock had run for `phase` ticks.
    pub fn restart(&mut self, phase: u64, measured: Pose, steering_rad: f64) {
        self.ticks_before += phase;
        self.reference.restart_at(self.reference.projection_m(measured));
        self.law.resume(steering_rad);
    }

    /// Where the reference's clock last started from rest, along the path.
    pub fn origin_m(&self) -> f64 {
        self.reference.origin_m()
    }

    /// Other gains from this tick on; the filter's state carries over.
    pub fn switch_gains(&mut self, gains: Gains) {
        self.gains = gains;
    }

    /// One tick, named by the ticks that the reference's clock has run. Call it for each from 0 on, until the drive
    /// has ended.
    // Inlined, its results stay in registers: written to memory in halves and read back whole, they stall.
    #[inline]
    pub fn tick(&mut self, tick: u64, seen: Seen) -> Decision {
        let reference = self.reference.advance(tick, seen.measured);
        let error = tracking_error(reference, seen.measured);
        let command = self.law.command(self.gains, error);

        let scored = seen.truth.map_or(error, |truth| tracking_error(reference, truth));
        self.metrics.add(scored, self.law.is_steering_limited());
        self.trace.add_pose(seen.measured);
        self.trace.add_pose(seen.truth.unwrap_or_default());
        self.trace.add(command.speed_mps);
        self.trace.add(command.yaw_rate_radps);
        self.trace.add(command.steering_rad);

        let ended = self.end_reason(tick, seen).map(|reason| Ended {
            metrics: self.metrics.finish(reason, self.ticks),
            trace: self.trace.0,
        });
        Decision { command, error, reference_along_m: self.reference.along_m(), ended }
    }

    fn end_reason(&self, tick: u64, seen: Seen) -> Option<EndReason> {
        if seen.collision {
            return Some(EndReason::Collision);
        }
        // Only behind the reference: a closed path must not end where it begins.
        if self.reference.at_end() {
            let end = self.reference.end();
            let (dx, dy) = (seen.measured.x_m - end.x_m, seen.measured.y_m - end.y_m);
            if libm::hypot(dx, dy) <= self.goal_radius_m {
                return Some(EndReason::Goal);
            }
        }
        (self.ticks_before + tick + 1 >= self.ticks).then_some(EndReason::Time)
    }
}

/// FNV-1a over the bits of numbers: two drives with one trace saw and did the same.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Trace(u64);

impl Default for Trace {
    fn default() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }
}

impl Trace {
    fn add(&mut self, number: f64) {
        // A word at a time, and the upper half folded in: a multiplication alone never carries down.
        let mixed = (self.0 ^ number.to_bits()).wrapping_mul(0x0000_0100_0000_01b3);
        self.0 = mixed ^ (mixed >> 32);
    }

    fn add_pose(&mut self, pose: Pose) {
        self.add(pose.x_m);
        self.add(pose.y_m);
        self.add(pose.yaw_rad);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::Layers;

    fn drive(sets: &[&str]) -> DriveController {
        let mut layers = Layers::maneuver("lane_change").unwrap();
        for set in sets {
            layers.set(set).unwrap();
        }
        DriveController::new(&layers.resolve().unwrap())
    }

    fn still(x_m: f64) -> Seen {
        Seen { measured: Pose { x_m, ..Pose::default() }, truth: None, collision: false }
    }

    #[test]
    fn a_drive_ends_with_its_last_tick() {
        let mut drive = drive(&[]);
        for tick in 0..499 {
            assert!(drive.tick(tick, still(0.0)).ended.is_none());
        }
        let ended = drive.tick(499, still(0.0)).ended.unwrap();
        assert_eq!((ended.metrics.ticks, ended.metrics.reason), (500, EndReason::Time));
    }

    #[test]
    fn the_goal_counts_only_behind_the_reference() {
        let mut drive = drive(&["path.pieces=[{kind='straight',length_m=0.75}]"]);
        assert!(drive.tick(0, still(0.75)).ended.is_none());
        let ended = drive.tick(100, still(0.6)).ended.unwrap();
        assert_eq!(ended.metrics.reason, EndReason::Goal);
    }

    #[test]
    fn a_collision_ends_a_drive() {
        let mut drive = drive(&[]);
        let ended = drive.tick(0, Seen { collision: true, ..still(0.0) }).ended.unwrap();
        assert_eq!(ended.metrics.reason, EndReason::Collision);
    }

    #[test]
    fn the_trace_sees_every_bit() {
        let trace = |x_m: f64| {
            let mut drive = drive(&["drive.loop_time_s=0.02"]);
            drive.tick(0, still(x_m));
            drive.tick(1, still(0.0)).ended.unwrap().trace
        };
        assert_eq!(trace(0.5), trace(0.5));
        assert_ne!(trace(0.5), trace(0.5 + f64::EPSILON));
        assert_ne!(trace(0.0), trace(-0.0));
    }

    #[test]
    fn metrics_read_the_truth_and_the_law_the_measurement() {
        let mut drive = drive(&["drive.loop_time_s=0.01"]);
        let truth = Some(Pose { y_m: -2.0, ..Pose::default() });
        let decision = drive.tick(0, Seen { truth, ..still(0.0) });
        assert_eq!(decision.error.cross_track_m, 0.0);
        assert_eq!(decision.ended.unwrap().metrics.mean_abs_cross_m, 2.0);
    }
}
