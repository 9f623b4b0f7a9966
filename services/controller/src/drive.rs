//! One drive of one vehicle: reference, error, law, measures, and the end.

use config::{Parameters, RunConfig};
use tracking::{
    Covered, DriveRecord, DriveRecorder, EndReason, PathFollower, Pose, Reference, TickMeasures,
    TrackingError, tracking_error,
};

use crate::clock::Phase;
use crate::laws::{ControlLaw, LawState, RawCommand};
use crate::sight::{Points, Sight};

/// What the controller sees of the vehicle at one tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Seen {
    /// Pose as measured: the law reads only this one.
    pub measured: Pose,
    /// Forward speed.
    pub speed_mps: f64,
    /// Yaw rate, counter-clockwise.
    pub yaw_rate_radps: f64,
    /// True pose, if the vehicle knows it: the record of the drive is made from this one.
    pub truth: Option<Pose>,
    /// Whether the vehicle reports a collision.
    pub collision: bool,
}

/// What the vehicle's gate reports of the drive.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct GateWord {
    /// Bits: what is wrong now, or was when the vehicle was stopped.
    pub reasons: u32,
    /// The vehicle is being stopped, or stands.
    pub is_stopped: bool,
    /// It stands.
    pub stands: bool,
    /// The stop ends the drive: the vehicle is not to be rearmed.
    pub is_final: bool,
}

/// What the controller computes in one tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Decision {
    /// The command of this tick.
    pub command: RawCommand,
    /// The error that the law read.
    pub error: TrackingError,
    /// Progress of the reference along the path.
    pub reference_along_m: f64,
    /// Distance of the pose (the true one if it is known) from the nearest point of the path.
    pub path_distance_m: f64,
    /// The record of the drive, if this tick is its last.
    pub ended: Option<DriveRecord>,
}

/// One drive of one vehicle.
#[derive(Debug, Clone)]
pub struct DriveController {
    reference: Reference,
    law: ControlLaw,
    recorder: DriveRecorder,
    follower: PathFollower,
    parameters: Parameters,
    trace: Trace,
    /// Where the law's last projection was, along the path.
    near_m: f64,
    ticks: u64,
    /// Ticks that the reference's clock had run before it last started from rest.
    ticks_before: f64,
    /// Share of the path that had been covered when the reference reached its end, once it has.
    covered_in_time: Option<f64>,
    gate: GateWord,
    stopped_for: u32,
    slowed_for: u32,
    /// Ticks since the stop that ends the drive.
    stop_ticks: u64,
    /// Ticks for which it waits, in all, for a vehicle that does not follow.
    wait_limit_ticks: f64,
    goal_radius_m: f64,
    /// How far to the side a vehicle that passes the end may be.
    beside_the_end_m: f64,
    steering_limit_rad: f64,
    /// How far the gate lets the steering angle turn in a tick.
    turn_limit_rad: f64,
    /// The steering angle as the gate lets it through.
    passed_rad: f64,
    tick_s: f64,
    points: Points,
}

impl DriveController {
    /// How long a vehicle that is being stopped may take to stand.
    const LONGEST_STOP_S: f64 = 10.0;

    /// A drive with parameters of 0, at its first tick; [`DriveController::reset`] gives others.
    pub fn new(config: &RunConfig) -> Self {
        Self {
            reference: Reference::new(config),
            law: ControlLaw::new(config),
            recorder: DriveRecorder::new(config.drive.tick_s),
            follower: PathFollower::default(),
            parameters: Parameters::default(),
            trace: Trace::default(),
            near_m: 0.0,
            ticks: config.ticks(),
            ticks_before: 0.0,
            covered_in_time: None,
            gate: GateWord::default(),
            stopped_for: 0,
            slowed_for: 0,
            stop_ticks: 0,
            wait_limit_ticks: config.reference.wait_limit_s / config.drive.tick_s,
            goal_radius_m: config.drive.goal_radius_m,
            beside_the_end_m: if config.path.is_closed() {
                config.drive.goal_radius_m.max(config.vehicle.wheelbase_m)
            } else {
                config.drive.goal_radius_m
            },
            steering_limit_rad: config.controller.steering_limit_rad,
            turn_limit_rad: config.vehicle.safety.steering_rate_limit_radps * config.drive.tick_s,
            passed_rad: 0.0,
            tick_s: config.drive.tick_s,
            points: Points::new(&config.vehicle),
        }
    }

    /// Returns to the first tick, with these parameters and this length.
    pub fn reset(&mut self, parameters: Parameters, ticks: u64) {
        self.reference.reset();
        self.law.reset();
        self.recorder.reset();
        self.trace = Trace::default();
        self.look_around(0.0);
        self.parameters = parameters;
        self.ticks = ticks;
        self.ticks_before = 0.0;
        self.covered_in_time = None;
        self.gate = GateWord::default();
        (self.stopped_for, self.slowed_for, self.stop_ticks) = (0, 0, 0);
        self.passed_rad = 0.0;
    }

    /// Takes what the gate has reported since the last tick.
    pub fn hear_gate(&mut self, word: GateWord) {
        self.gate = word;
        let whether = if word.is_stopped { &mut self.stopped_for } else { &mut self.slowed_for };
        *whether |= word.reasons;
    }

    /// Goes on with a drive of which only this is known: where the reference's clock last started, for how long it has
    /// run, where the vehicle is, the steering angle that was commanded last, and the state that the law's predecessor
    /// left.
    pub fn join(
        &mut self,
        origin_m: f64,
        phase: Phase,
        measured: Pose,
        steering_rad: f64,
        state: Option<&LawState>,
    ) {
        self.reference.resume_from(origin_m);
        // On a path of several laps, the vehicle is in the lap in which the reference is.
        self.reference.advance(phase.ticks, measured);
        self.look_around(self.reference.projection_m(measured));
        match state {
            Some(state) => self.law.resume(state),
            None => self.law.restart(steering_rad),
        }
        self.passed_rad = steering_rad;
    }

    /// Lets the reference's clock start again from rest, where the vehicle stands: at its projection on the path. The
    /// clock had run for `after_ticks`.
    pub fn restart(&mut self, after_ticks: f64, measured: Pose, steering_rad: f64) {
        self.ticks_before += after_ticks;
        let along_m = self.reference.projection_m(measured);
        self.reference.restart_at(along_m);
        self.look_around(along_m);
        self.law.restart(steering_rad);
        self.passed_rad = steering_rad;
    }

    /// The next projection is looked for around this place.
    fn look_around(&mut self, along_m: f64) {
        self.near_m = along_m;
        self.follower = PathFollower::new(self.reference.path(), along_m);
    }

    /// Where the reference's clock last started from rest, along the path.
    pub fn origin_m(&self) -> f64 {
        self.reference.origin_m()
    }

    /// What a successor of the law needs to go on.
    pub fn law_state(&self) -> LawState {
        self.law.state()
    }

    /// Other parameters from this tick on; the law's state carries over.
    pub fn switch_parameters(&mut self, parameters: Parameters) {
        self.parameters = parameters;
    }

    /// One tick, at this phase of the reference's clock. Call it for each tick of the vehicle from 0 on, until the drive
    /// has ended.
    // Inlined, its results stay in registers: written to memory in halves and read back whole, they stall.
    #[inline]
    pub fn tick(&mut self, phase: Phase, seen: Seen) -> Decision {
        let reference_pose = self.reference.advance(phase.ticks, seen.measured);
        let Seen { measured, speed_mps, yaw_rate_radps, truth, .. } = seen;
        let sight = Sight::of_vehicle(self.points, &self.reference, phase.ticks).with(
            reference_pose,
            measured,
            speed_mps,
            yaw_rate_radps,
            self.near_m,
        );
        let mut command = self.law.command(&self.parameters, &sight);
        command.speed_mps = command.speed_mps.min(self.reference.bound_mps());
        let error = sight.error;
        self.near_m = sight.near_m();

        // What a law asks for in vain moves no wheel.
        let reach_rad = self.turn_limit_rad;
        self.passed_rad =
            command.steering_rad.clamp(self.passed_rad - reach_rad, self.passed_rad + reach_rad);
        let scored = truth.unwrap_or(measured);
        let path_distance_m =
            self.follower.distance_m(self.reference.path(), scored.x_m, scored.y_m);
        self.recorder.add(TickMeasures {
            error: truth.map_or(error, |truth| tracking_error(reference_pose, truth)),
            path_distance_m,
            steering_rad: self.passed_rad,
            steering_limited: command.steering_rad.abs() >= self.steering_limit_rad,
            lateral_acceleration_mps2: speed_mps * yaw_rate_radps,
        });
        self.trace.add_pose(measured);
        self.trace.add_pose(truth.unwrap_or_default());
        self.trace.add(command.speed_mps);
        self.trace.add(command.yaw_rate_radps);
        self.trace.add(command.steering_rad);

        self.stop_ticks += u64::from(self.gate.is_final);
        let ended = self.end_reason(phase, seen, scored).map(|reason| self.end(reason, scored));
        let reference_along_m = self.reference.along_m();
        Decision { command, error, reference_along_m, path_distance_m, ended }
    }

    /// The record of the drive, which ends with the vehicle at this pose.
    #[cold]
    fn end(&mut self, reason: EndReason, pose: Pose) -> DriveRecord {
        let progress = match reason {
            // A vehicle within the goal's radius is at the end.
            EndReason::Goal => 1.0,
            _ => self.covered(pose),
        };
        let covered =
            Covered { at_end: progress, in_time: self.covered_in_time.unwrap_or(progress) };
        let record = self.recorder.finish(reason, self.ticks, self.tick_s, covered, self.trace.0);
        DriveRecord { stopped_for: self.stopped_for, slowed_for: self.slowed_for, ..record }
    }

    /// The share of the path that lies behind this pose, which is that of the present tick.
    fn covered(&self, pose: Pose) -> f64 {
        let path = self.reference.path();
        let along_m = self.follower.along_m(path, pose.x_m, pose.y_m);
        (along_m / path.length_m()).clamp(0.0, 1.0)
    }

    /// Whether the vehicle has passed the end of the path, no farther to the side than the goal's radius. Where speeds fall
    /// towards the end, it is there before the reference, and may no longer be near when the reference comes. The end of a
    /// closed path is a line that is crossed: a vehicle that is as far from the path as on the laps before, up to its
    /// wheelbase, has crossed it.
    fn has_passed_the_end(&self, at: Pose) -> bool {
        let path = self.reference.path();
        let end = self.reference.end();
        let (dx, dy) = (at.x_m - end.x_m, at.y_m - end.y_m);
        let (sin, cos) = (libm::sin(end.yaw_rad), libm::cos(end.yaw_rad));
        // On a closed path, the beginning of the last lap lies ahead of the end, too.
        dx * cos + dy * sin > 0.0
            && (dy * cos - dx * sin).abs() <= self.beside_the_end_m
            && self.follower.along_m(path, at.x_m, at.y_m) >= path.length_m()
    }

    fn end_reason(&mut self, phase: Phase, seen: Seen, scored: Pose) -> Option<EndReason> {
        if seen.collision {
            return Some(EndReason::Collision);
        }
        if self.gate.is_final {
            // A vehicle that does not obey cannot be stopped either.
            let is_over =
                self.gate.stands || self.stop_ticks as f64 * self.tick_s >= Self::LONGEST_STOP_S;
            return is_over.then_some(EndReason::Stopped);
        }
        if self.has_passed_the_end(seen.measured) {
            return Some(EndReason::Goal);
        }
        // Only after the reference: a closed path must not end where it begins.
        if self.reference.at_end() {
            let end = self.reference.end();
            let (dx, dy) = (seen.measured.x_m - end.x_m, seen.measured.y_m - end.y_m);
            if libm::hypot(dx, dy) <= self.goal_radius_m {
                return Some(EndReason::Goal);
            }
            if self.covered_in_time.is_none() && self.reference.advances_by_time() {
                self.covered_in_time = Some(self.covered(scored));
            }
        }
        // The drive's time is that of the reference's clock, so that a vehicle which was held can still arrive.
        if self.ticks_before + phase.ticks + 1.0 >= self.ticks as f64 {
            return Some(EndReason::Time);
        }
        (phase.waited_ticks >= self.wait_limit_ticks).then_some(EndReason::Held)
    }
}

/// FNV-1a over the bits of numbers: two drives with the same trace saw and did the same.
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
        let measured = Pose { x_m, ..Pose::default() };
        Seen { measured, speed_mps: 0.0, yaw_rate_radps: 0.0, truth: None, collision: false }
    }

    #[test]
    fn a_drive_ends_with_its_last_tick() {
        let mut drive = drive(&[]);
        for tick in 0..499 {
            assert!(drive.tick(Phase::from(tick), still(0.0)).ended.is_none());
        }
        let ended = drive.tick(Phase::from(499), still(0.0)).ended.unwrap();
        assert_eq!((ended.ticks, ended.reason), (500, EndReason::Time));
    }

    #[test]
    fn progress_is_the_share_of_the_path_that_lies_behind() {
        let mut drive =
            drive(&["drive.loop_time_s=0.01", "path.pieces=[{kind='straight',length_m=8.0}]"]);
        let record = drive.tick(Phase::default(), still(2.0)).ended.unwrap();
        assert_eq!((record.progress, record.arrived()), (0.25, false));
    }

    #[test]
    fn the_goal_counts_only_once_the_reference_is_there() {
        let mut drive = drive(&["path.pieces=[{kind='straight',length_m=0.75}]"]);
        assert!(drive.tick(Phase::default(), still(0.75)).ended.is_none());
        let ended = drive.tick(Phase::from(100), still(0.6)).ended.unwrap();
        assert_eq!(ended.reason, EndReason::Goal);
    }

    #[test]
    fn who_has_passed_the_end_has_arrived_before_the_reference() {
        let reason = |pieces: &str, x_m: f64, y_m: f64| {
            let mut drive = drive(&[&format!("path.pieces=[{pieces}]")]);
            let mut seen = still(x_m);
            seen.measured.y_m = y_m;
            drive.tick(Phase::default(), seen).ended.map(|it| it.reason)
        };
        let straight = "{kind='straight',length_m=0.75}";
        assert_eq!(reason(straight, 0.8, 0.0), Some(EndReason::Goal));
        assert_eq!(reason(straight, 1.8, 0.1), Some(EndReason::Goal));
        assert_eq!(reason(straight, 0.8, 0.3), None);
        // A circle begins where it ends.
        let circle = "{kind='arc',radius_m=5.0,angle_deg=360.0}";
        assert_eq!(reason(circle, 0.1, 0.0), None);
    }

    #[test]
    fn a_collision_ends_a_drive() {
        let mut drive = drive(&[]);
        let ended =
            drive.tick(Phase::default(), Seen { collision: true, ..still(0.0) }).ended.unwrap();
        assert_eq!(ended.reason, EndReason::Collision);
    }

    #[test]
    fn the_steering_travels_as_far_as_the_gate_lets_it() {
        let travel = |limit_radps: &str| {
            let limit = format!("vehicle.safety.steering_rate_limit_radps={limit_radps}");
            let mut drive = drive(&["drive.loop_time_s=1.0", &limit]);
            drive.reset(Parameters::of(&[3.0, 21.0, 21.0, 0.7]), 100);
            let at = |tick: u64| {
                // To the left and to the right of the path in turn.
                let y_m = if tick.is_multiple_of(2) { 0.5 } else { -0.5 };
                Seen { measured: Pose { y_m, ..Pose::default() }, speed_mps: 1.0, ..still(0.0) }
            };
            let end = (0..100).find_map(|tick| drive.tick(Phase::from(tick), at(tick)).ended);
            let record = end.unwrap();
            (record.steering_travel_radps, record.steering_rate_p95_radps)
        };
        let (free, limited) = (travel("inf"), travel("0.3"));
        assert!(free.0 > 1.0, "{free:?}");
        assert!(limited.0 > 0.1 && limited.0 <= 0.3 + 1e-6, "{limited:?}");
        assert!(limited.1 <= 0.3 + 1e-6, "{limited:?}");
    }

    #[test]
    fn the_trace_sees_every_bit() {
        let trace = |x_m: f64| {
            let mut drive = drive(&["drive.loop_time_s=0.02"]);
            drive.tick(Phase::from(0), still(x_m));
            drive.tick(Phase::from(1), still(0.0)).ended.unwrap().trace
        };
        assert_eq!(trace(0.5), trace(0.5));
        assert_ne!(trace(0.5), trace(0.5 + f64::EPSILON));
        assert_ne!(trace(0.0), trace(-0.0));
    }

    #[test]
    fn the_record_reads_the_truth_and_the_law_the_measurement() {
        let mut drive = drive(&["drive.loop_time_s=0.01"]);
        let truth = Some(Pose { y_m: -2.0, ..Pose::default() });
        let decision = drive.tick(Phase::default(), Seen { truth, ..still(0.0) });
        assert_eq!(decision.error.cross_track_m, 0.0);
        let record = decision.ended.unwrap();
        assert_eq!((record.mean_abs_cross_m, record.path_mean_m), (2.0, 2.0));
    }
}
