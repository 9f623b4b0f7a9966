//! The messages. Change a field, and the build tells the new hash for the type's name.

use std::cmp::Ordering;

// The derive of the transport wants it in scope.
#[cfg(feature = "transport")]
use crate::layout::ZeroCopySend;
use crate::layout::{constants, message};
use crate::{MAX_PARAMETERS, MAX_STATE};

/// Values of [`Odometry::status`] and of the command's flags are bits; this tests one.
pub const fn has(bits: u32, bit: u32) -> bool {
    bits & bit != 0
}

message!(
    /// Which attempt at which batch of which run: what every header says first.
    ///
    /// Two of them are compared as a whole. What names another attempt than the one under way is dropped.
    #[name = "pathtune.Attempt#6ea4f031"]
    pub struct Attempt {
        /// The run.
        pub run: u64,
        /// The batch of drives, counted from 1; 0 where none is meant.
        pub batch: u64,
        /// The attempt at this batch, counted from 1; 0 where none is meant.
        pub attempt: u32,
        /// Explicit padding; 0.
        pub reserved: u32,
    }
);

impl Attempt {
    /// What belongs to a run, and to none of its batches.
    pub const fn between_batches(run: u64) -> Self {
        Self { run, batch: 0, attempt: 0, reserved: 0 }
    }

    /// Whether it belongs to this run.
    pub const fn is_of(&self, run: u64) -> bool {
        self.run == run
    }

    /// Whether it is of the same run, and comes later: of a later batch, or of a later attempt at the same.
    pub fn is_ahead_of(&self, other: &Self) -> bool {
        self.is_of(other.run) && self > other
    }
}

impl Eq for Attempt {}

impl Ord for Attempt {
    /// By run, then batch, then attempt: those of one run in the order in which they are driven.
    fn cmp(&self, other: &Self) -> Ordering {
        let key = |it: &Self| (it.run, it.batch, it.attempt, it.reserved);
        key(self).cmp(&key(other))
    }
}

impl PartialOrd for Attempt {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

message!(
    /// Header of the topics that are sent once a tick.
    ///
    /// Each hop copies the header of what it answers, and adds its own stamps.
    #[name = "pathtune.TickHeader#9a86e751"]
    pub struct TickHeader {
        /// The attempt that it belongs to.
        pub attempt: Attempt,
        /// The tick of the batch, counted from 0.
        pub tick: u64,
        /// When the command of the tick before was applied; 0 at tick 0.
        pub applied_ns: u64,
        /// When the vehicle published the odometry.
        pub odometry_sent_ns: u64,
        /// When the controller had taken the odometry.
        pub controller_received_ns: u64,
        /// When the controller published the raw command.
        pub controller_sent_ns: u64,
        /// When the supervisor had taken the raw command.
        pub supervisor_received_ns: u64,
        /// When the supervisor published the command.
        pub supervisor_sent_ns: u64,
    }
);

message!(
    /// Header of the topics that are sent between ticks.
    #[name = "pathtune.BatchHeader#b266e9a6"]
    pub struct BatchHeader {
        /// The attempt that it belongs to.
        pub attempt: Attempt,
        /// Bits of the message, as its description says.
        pub flags: u32,
        /// Explicit padding; 0.
        pub reserved: u32,
        /// When it was sent.
        pub sent_ns: u64,
    }
);

message!(
    /// A pose in the map frame (REP-103: x forward, y left, yaw counter-clockwise, not wrapped).
    #[name = "pathtune.WirePose#a8bd35a0"]
    pub struct WirePose {
        /// x in the map frame.
        pub x_m: f64,
        /// y in the map frame.
        pub y_m: f64,
        /// Yaw in the map frame.
        pub yaw_rad: f64,
    }
);

message!(
    /// What a vehicle's sensors tell at one tick. Sent by the vehicle.
    #[name = "pathtune.Odometry#cebfaf2b"]
    pub struct Odometry {
        /// Pose of the tracked point as measured.
        pub measured: WirePose,
        /// Pose of the tracked point in truth, where `status` has [`Odometry::HAS_TRUTH`]; else 0.
        pub truth: WirePose,
        /// Forward speed.
        pub speed_mps: f64,
        /// Yaw rate, counter-clockwise.
        pub yaw_rate_radps: f64,
        /// Angle of the road wheels, positive to the left.
        pub steering_rad: f64,
        /// The bits below.
        pub status: u32,
        /// Explicit padding; 0.
        pub reserved: u32,
    }
);

constants!(
    Odometry:
    /// `truth` holds the true pose.
    pub const HAS_TRUTH: u32 = 1;
    /// The vehicle has collided.
    pub const COLLISION: u32 = 2;
    /// This slot's drive has ended; in lockstep the other fields stand still.
    pub const ENDED: u32 = 4;
    /// The newest command is older than `vehicle.safety.command_age_limit_s`: the vehicle stops on its own.
    pub const OWN_STOP: u32 = 8;
);

message!(
    /// What the control law wants. Sent by the controller.
    #[name = "pathtune.RawCommand#ad4a13a3"]
    pub struct RawCommand {
        /// v: forward speed; may be negative.
        pub speed_mps: f64,
        /// ω: wanted yaw rate, before the law's filter.
        pub yaw_rate_radps: f64,
        /// φ: angle of the road wheels, positive to the left.
        pub steering_rad: f64,
        /// Progress of the reference along the path.
        pub reference_along_m: f64,
        /// Where along the path the reference's clock last started from rest; 0 at the start of a drive.
        pub origin_m: f64,
        /// How far the reference's clock has run since then, in ticks; see [`Safety::clock_rate`].
        pub phase_ticks: f64,
        /// The bits below, and [`Command::ENDED`].
        pub flags: u32,
        /// Explicit padding; 0.
        pub reserved: u32,
    }
);

constants!(
    RawCommand:
    /// The controller has heard that the gate stops the vehicle: the reference comes to rest, or stands.
    pub const FROZEN: u32 = 1 << 16;
    /// With `FROZEN`: the stop is one with the wheels straight.
    pub const STRAIGHTENED: u32 = 1 << 17;
);

message!(
    /// What the vehicle is to do. Sent by the supervisor.
    #[name = "pathtune.Command#8945e2f9"]
    pub struct Command {
        /// Forward speed; a negative one only brakes.
        pub speed_mps: f64,
        /// The yaw rate of this speed and this steering angle, v·tan φ/L.
        pub yaw_rate_radps: f64,
        /// Angle of the road wheels, positive to the left.
        pub steering_rad: f64,
        /// The bits below: what the gate did to the raw command, and why.
        pub flags: u32,
        /// The zone that the vehicle is in.
        pub zone: u32,
    }
);

constants!(
    Command:
    /// This slot's drive has ended: in lockstep the vehicle stands still, in real time the command brings it to a stop.
    pub const ENDED: u32 = 1;
    /// The gate lowered the speed to its limit.
    pub const SPEED_LIMITED: u32 = 2;
    /// The gate brought the steering angle into its range.
    pub const STEERING_LIMITED: u32 = 4;
    /// The raw command was not finite; the gate put one of its own in its place.
    pub const REJECTED: u32 = 8;
    /// The gate bounded how fast the speed changes: acceleration, deceleration or jerk.
    pub const ACCELERATION_LIMITED: u32 = 16;
    /// The gate bounded how fast the steering angle changes.
    pub const STEERING_RATE_LIMITED: u32 = 32;
    /// The gate bounded speed or steering angle for the lateral acceleration.
    pub const LATERAL_LIMITED: u32 = 64;
    /// The gate slows down, and goes on when what is wrong has passed.
    pub const DEGRADED: u32 = 128;
    /// The gate brings the vehicle to a stop, and then holds it until it is rearmed.
    pub const STOPPING: u32 = 256;
    /// The vehicle stands, and is held until it is rearmed.
    pub const STOPPED: u32 = 512;
    /// The gate brakes the vehicle as hard as its limits allow.
    pub const BRAKED: u32 = 1024;
    /// Degraded or stopping, the law goes on steering, and the reference's clock comes to rest.
    pub const STEERED: u32 = 2048;
    /// The vehicle is in a zone whose gains are not certain to hold it as it drives now: it keeps the gains that it has.
    pub const SWITCH_REFUSED: u32 = 4096;
);

message!(
    /// What the gate of one vehicle does, and why. Sent by the supervisor before every command in real time, in lockstep
    /// when `state`, `reasons` or `clock_rate` changes; the last one is kept for late joiners.
    #[name = "pathtune.Safety#cc6e30aa"]
    pub struct Safety {
        /// Tick of the odometry that it rests on.
        pub tick: u64,
        /// [`RawCommand::origin_m`] of the last answer.
        pub origin_m: f64,
        /// Steering angle that was commanded last.
        pub steering_rad: f64,
        /// Commands that were changed since the start of the drive.
        pub changed: u64,
        /// Commands of the gate's own since the start of the drive: degraded, stopping or stopped.
        pub own: u64,
        /// [`RawCommand::phase_ticks`] of the last answer.
        pub phase_ticks: f64,
        /// The rate at which the reference's clock is to run on from the tick after `tick`, in ticks of the clock in a
        /// tick of the vehicle: 1, less while the reference waits for a vehicle that does not follow; it falls to 0 while
        /// the gate slows down or stops the vehicle, and is up to 16 beside one that drives on although it is braked.
        pub clock_rate: f64,
        /// [`Safety::NORMAL`] or one of the values that follow it.
        pub state: u32,
        /// Bits of what is wrong now, or was when the vehicle was stopped.
        pub reasons: u32,
        /// 1 if an answer has been heard, so that `origin_m` and `phase_ticks` mean something; else 0.
        pub has_reference: u32,
        /// Explicit padding; 0.
        pub reserved: u32,
    }
);

constants!(
    Safety:
    /// Value of `state`: commands pass, within limits.
    pub const NORMAL: u32 = 0;
    /// Value of `state`: slowing down, for a moment.
    pub const DEGRADED: u32 = 1;
    /// Value of `state`: coming to a stop; nothing but a rearm leads back to normal.
    pub const STOPPING: u32 = 2;
    /// Value of `state`: standing, until it is rearmed.
    pub const STOPPED: u32 = 3;

    /// Bit of `reasons`: no answer of the controller that is young enough.
    pub const COMMAND_STALE: u32 = 1;
    /// Bit of `reasons`: the controller's answer is not finite.
    pub const COMMAND_INVALID: u32 = 2;
    /// Bit of `reasons`: no odometry that is young enough.
    pub const ODOMETRY_STALE: u32 = 4;
    /// Bit of `reasons`: the odometry is not finite.
    pub const ODOMETRY_INVALID: u32 = 8;
    /// Bit of `reasons`: the measured pose jumped.
    pub const ODOMETRY_JUMP: u32 = 16;
    /// Bit of `reasons`: the odometry's tick or stamp went back.
    pub const TIME_BACK: u32 = 32;
    /// Bit of `reasons`: the supervisor was restarted, and does not know what was before.
    pub const RESTARTED: u32 = 64;
    /// Bit of `reasons`: the vehicle is farther from its path than `vehicle.safety.path_distance_limit_m`.
    pub const PATH_DISTANCE: u32 = 128;
    /// Bit of `reasons`: its heading differs from the path's by more than `vehicle.safety.path_heading_limit_rad`.
    pub const PATH_HEADING: u32 = 256;
    /// Bit of `reasons`: the vehicle turns right when it is told to turn left, and left when it is told to turn right.
    pub const STEERING_REVERSED: u32 = 512;
    /// Bit of `reasons`: the vehicle does not turn as its commanded steering angle says.
    pub const STEERING_IGNORED: u32 = 1024;
    /// Bit of `reasons`: the vehicle drives faster than it is told to.
    pub const SPEED_IGNORED: u32 = 2048;
    /// Bit of `reasons`: the vehicle stands although it is told to drive. It is only told: `state` stays as it is, so
    /// that a vehicle that something else holds drives on when it is let go.
    pub const STANDS: u32 = 4096;

    /// Bit of `reasons`: out of the envelope of calibrated drives by the quality of tracking.
    pub const OUT_BY_QUALITY: u32 = 1 << 17;
    /// Bit of `reasons`: out of the envelope by the mean lateral tracking error.
    pub const OUT_BY_LATERAL_ERROR: u32 = 1 << 18;
    /// Bit of `reasons`: out of the envelope by how far it came along its heading.
    pub const OUT_BY_ALONG: u32 = 1 << 19;
    /// Bit of `reasons`: out of the envelope by how far it came to the side.
    pub const OUT_BY_LATERAL: u32 = 1 << 20;
    /// Bit of `reasons`: out of the envelope by how far it turned.
    pub const OUT_BY_YAW: u32 = 1 << 21;
    /// Bit of `reasons`: out of the envelope by how much the measured pose jumps from tick to tick.
    pub const OUT_BY_NOISE: u32 = 1 << 22;
    /// Bit of `reasons`: the vehicle's body is beyond an edge of the road, as the path's file tells it.
    pub const ROAD_EDGE: u32 = 1 << 23;
    /// Bit of `reasons`: the vehicle would leave the area in which it may drive, `drive.area_m`, if it braked now.
    pub const AREA: u32 = 1 << 24;
    /// Bit of `reasons`: the yaw rate is that of the commanded steering angle, without any lag: it is not measured, and a
    /// fault of the steering would not be seen. It is only told: `state` stays as it is.
    pub const STEERING_UNSEEN: u32 = 1 << 25;

    /// Bit of `reasons`: the measured pose stands, or falls behind, although the vehicle drives by its own speed.
    pub const POSE_STANDS: u32 = 1 << 26;
    /// Bit of `reasons`: the odometry's tick lies ahead of the time that has passed since the drive was requested, or its
    /// stamp ahead of the clock.
    pub const TIME_AHEAD: u32 = 1 << 27;

    /// Bit of `reasons`: the vehicle was not rearmed, because no leg of the path within its reach fits its heading.
    pub const NO_LEG: u32 = 1 << 16;

    /// The bits of `reasons` that say something about how the vehicle drives: a stop for one of them ends the drive.
    pub const OF_THE_DRIVE: u32 = Self::PATH_DISTANCE
        | Self::PATH_HEADING
        | Self::STEERING_REVERSED
        | Self::STEERING_IGNORED
        | Self::SPEED_IGNORED
        | Self::ROAD_EDGE
        | Self::AREA
        | Self::OUT_OF_ENVELOPE;

    /// The bits of `reasons` that are only told: a vehicle that stands is safe, and one whose steering cannot be watched may
    /// steer well.
    pub const TOLD: u32 = Self::STANDS | Self::STEERING_UNSEEN;
    /// The bits of `reasons` for a vehicle that is out of the envelope of calibrated drives. Any of them stops it at once.
    pub const OUT_OF_ENVELOPE: u32 = Self::OUT_BY_QUALITY
        | Self::OUT_BY_LATERAL_ERROR
        | Self::OUT_BY_ALONG
        | Self::OUT_BY_LATERAL
        | Self::OUT_BY_YAW
        | Self::OUT_BY_NOISE;
    /// The bits of `reasons` that say that pose or answers are missing.
    pub const BLIND: u32 = Self::COMMAND_STALE
        | Self::COMMAND_INVALID
        | Self::ODOMETRY_STALE
        | Self::ODOMETRY_INVALID
        | Self::ODOMETRY_JUMP
        | Self::TIME_BACK
        | Self::POSE_STANDS
        | Self::TIME_AHEAD;
    /// A stop for one of these bits of `reasons` is a full brake with the wheels straight.
    pub const STRAIGHTENS: u32 = Self::BLIND | Self::STEERING_REVERSED;
    /// A stop for one of these bits of `reasons`, and none of those, is a full brake that the law goes on steering.
    pub const BRAKES: u32 = Self::RESTARTED
        | Self::PATH_DISTANCE
        | Self::PATH_HEADING
        | Self::STEERING_IGNORED
        | Self::SPEED_IGNORED
        | Self::ROAD_EDGE
        | Self::AREA
        | Self::OUT_BY_QUALITY
        | Self::OUT_BY_LATERAL_ERROR
        | Self::OUT_BY_YAW;
    /// For one of these bits of `reasons`, and none of those, the reference comes to rest, and the vehicle with it.
    pub const RESTS: u32 = Self::OUT_BY_ALONG | Self::OUT_BY_LATERAL | Self::OUT_BY_NOISE;
);

message!(
    /// What a law must not lose when its process is replaced during a drive. Sent by the controller with each raw command
    /// where the vehicle paces by the clock; in lockstep a drive is driven again instead.
    #[name = "pathtune.LawState#9c74370b"]
    pub struct LawState {
        /// Tick of the raw command that left the law in this state.
        pub tick: u64,
        /// The slot of the fleet.
        pub slot: u32,
        /// How many of the numbers the law uses; 0 if nothing is known.
        pub count: u32,
        /// The law's numbers, in an order and in units of its own; unused ones 0.
        pub numbers: [f64; MAX_STATE],
    }
);

message!(
    /// The newest [`LawState`] of a slot, for a controller that joins the drive. Sent by the supervisor before [`Safety`],
    /// where the vehicle paces by the clock.
    #[name = "pathtune.KeptLawState#9c74370b"]
    pub struct KeptLawState {
        /// Tick of the raw command that left the law in this state.
        pub tick: u64,
        /// The slot of the fleet.
        pub slot: u32,
        /// How many of the numbers the law uses; 0 if nothing is known.
        pub count: u32,
        /// The law's numbers, as [`LawState::numbers`].
        pub numbers: [f64; MAX_STATE],
    }
);

message!(
    /// Lets a stopped vehicle drive again. Sent by `pathtune rearm`, under a header whose `batch` is 0.
    #[name = "pathtune.Rearm#c6f12acf"]
    pub struct Rearm {
        /// The slot of the fleet.
        pub slot: u32,
        /// Explicit padding; 0.
        pub reserved: u32,
    }
);

message!(
    /// The error that the law read. Sent by the controller, for observers.
    #[name = "pathtune.TrackingError#34bb665d"]
    pub struct TrackingError {
        /// Forward: positive where the vehicle is behind its reference.
        pub along_track_m: f64,
        /// To the left: positive where the vehicle is to the right of its reference.
        pub cross_track_m: f64,
        /// Counter-clockwise.
        pub heading_rad: f64,
        /// Progress of the reference along the path.
        pub reference_along_m: f64,
        /// Distance of the true pose, or of the measured one if no truth is known, from the nearest point of the path.
        pub path_distance_m: f64,
    }
);

message!(
    /// The zone that a vehicle is in. Sent by the supervisor when it changes.
    #[name = "pathtune.Zone#70050f27"]
    pub struct Zone {
        /// The first tick for which it holds.
        pub from_tick: u64,
        /// The slot of the fleet.
        pub slot: u32,
        /// Number of the zone along the path.
        pub zone: u32,
    }
);

message!(
    /// The parameters of a zone: the gain schedule's answer to a [`Zone`]. Sent by whoever fills the trainer's role.
    #[name = "pathtune.GainSwitch#d0e6a29d"]
    pub struct GainSwitch {
        /// The configured law's parameters, in its order and units; unused ones 0.
        pub parameters: [f64; MAX_PARAMETERS],
        /// The first tick for which they hold.
        pub from_tick: u64,
        /// The slot of the fleet.
        pub slot: u32,
        /// The zone that they belong to.
        pub zone: u32,
    }
);

message!(
    /// How far a recorder has got. Sent by the recorder; a vehicle in lockstep does not run ahead of it.
    #[name = "pathtune.Credit#8bf7c056"]
    pub struct Credit {
        /// Ticks of the batch that the recorder has taken over.
        pub ticks: u64,
        /// Which recorder it is: the bit of [`DriveRequest::flags`] that asks for it.
        pub source: u32,
        /// Explicit padding; 0.
        pub reserved: u32,
    }
);

constants!(
    Credit:
    /// A vehicle in lockstep publishes tick k of a recorded batch only when `ticks + AHEAD > k`, for the newest
    /// credit of each recorder that the batch's flags ask for. Half of an observer's buffer: nothing is lost,
    /// and the vehicle does not wait as long as the recorders keep up.
    pub const AHEAD: u64 = crate::topics::OBSERVER_BUFFER as u64 / 2;
);

message!(
    /// A drive that a learner asks for. Sent by the trainer, all that are wanted in one message.
    #[name = "pathtune.Proposal#b0075c53"]
    pub struct Proposal {
        /// The configured law's parameters, in its order and units; unused ones 0.
        pub parameters: [f64; MAX_PARAMETERS],
        /// Seed of the noise.
        pub seed: u64,
        /// Full length in ticks.
        pub ticks: u64,
        /// The learner that asks.
        pub learner: u32,
        /// Its step.
        pub step: u32,
        /// The bits of [`DriveRequest::flags`].
        pub flags: u32,
        /// Which plant is to be driven: 0 for the configured vehicle, n for the n-th of `RunConfig::plant_changes`.
        pub plant: u32,
    }
);

constants!(
    Proposal:
    /// In [`BatchHeader::flags`]: the training is over, its outcome written.
    pub const FINISHED: u32 = 1;
);

message!(
    /// One slot of a batch: the drive that one vehicle makes. Sent by the orchestrator, one a vehicle.
    #[name = "pathtune.DriveRequest#9c8a9e96"]
    pub struct DriveRequest {
        /// Where the tracked point is to stand, at rest.
        pub start: WirePose,
        /// The configured law's parameters, in its order and units, unused ones 0; those of the first zone, where `flags`
        /// has [`DriveRequest::SCHEDULED`].
        pub parameters: [f64; MAX_PARAMETERS],
        /// Seed of the noise, where `flags` has [`DriveRequest::NOISE`].
        pub seed: u64,
        /// Full length in ticks.
        pub ticks: u64,
        /// The learner that asked.
        pub learner: u32,
        /// Its step.
        pub step: u32,
        /// The bits below.
        pub flags: u32,
        /// Which plant is to be driven: 0 for the configured vehicle, n for the n-th of `RunConfig::plant_changes`.
        pub plant: u32,
    }
);

constants!(
    DriveRequest:
    /// The measured pose is to carry noise.
    pub const NOISE: u32 = 1;
    /// The parameters change with the zone: after each [`Zone`] the controller waits for a [`GainSwitch`].
    pub const SCHEDULED: u32 = 2;
    /// The drive is recorded without a gap by whoever asked for it: a vehicle in lockstep waits for the
    /// trainer's [`Credit`].
    pub const RECORDED: u32 = 4;
    /// The whole run is recorded without a gap: a vehicle in lockstep waits for the recorder's [`Credit`], tick 0
    /// included.
    pub const LOGGED: u32 = 8;
    /// The vehicle paces by the clock: no process waits for another, answers can be too old, and a restarted process
    /// joins the drive under way.
    pub const REAL_TIME: u32 = 16;
);

message!(
    /// What is remembered of a drive. Sent by the controller when the batch has ended, one a slot.
    ///
    /// Errors are those of the true poses where the vehicle knows them, else of the measured ones.
    #[name = "pathtune.DriveReport#e272dd09"]
    pub struct DriveReport {
        /// The parameters of the request, as [`DriveRequest::parameters`].
        pub parameters: [f64; MAX_PARAMETERS],
        /// Seed of the request.
        pub seed: u64,
        /// Ticks driven.
        pub ticks: u64,
        /// Ticks on which the steering angle was at its limit.
        pub steering_limited_ticks: u64,
        /// Hash over every pose seen and every command given.
        pub trace: u64,
        /// Mean absolute along-track error.
        pub mean_abs_along_m: f64,
        /// Mean absolute cross-track error.
        pub mean_abs_cross_m: f64,
        /// Mean absolute heading error.
        pub mean_abs_heading_rad: f64,
        /// Mean of half the squared along-track error.
        pub along_mse_m2: f64,
        /// Mean of half the squared cross-track error.
        pub cross_mse_m2: f64,
        /// Largest absolute cross-track error.
        pub max_abs_cross_m: f64,
        /// Mean distance from the path: of the true pose, else of the measured one, to the nearest point of the path.
        pub path_mean_m: f64,
        /// The distance from the path that 95 % of the ticks do not exceed.
        pub path_p95_m: f64,
        /// Largest distance from the path.
        pub path_max_m: f64,
        /// The share of the path, from 0 to 1, at which the drive ended.
        pub progress: f64,
        /// The share of the path, from 0 to 1, that had been covered when the reference reached the path's end, or when
        /// the drive ended if that was earlier.
        pub progress_in_time: f64,
        /// Mean absolute rate of the commanded steering angle.
        pub steering_travel_radps: f64,
        /// The absolute rate of the commanded steering angle that 95 % of the ticks do not exceed.
        pub steering_rate_p95_radps: f64,
        /// The absolute lateral acceleration that 95 % of the ticks do not exceed: speed times yaw rate of the odometry.
        pub lateral_acceleration_p95_mps2: f64,
        /// Its largest value.
        pub lateral_acceleration_max_mps2: f64,
        /// The absolute change of the lateral acceleration over 0.1 s, a second, that 95 % of the times do not exceed.
        pub lateral_jerk_p95_mps3: f64,
        /// Its largest value.
        pub lateral_jerk_max_mps3: f64,
        /// The learner that asked.
        pub learner: u32,
        /// Its step.
        pub step: u32,
        /// Why it ended: one of the values below.
        pub reason: u32,
        /// What the gate stopped the vehicle for, as bits of [`Safety::reasons`]; 0 if it did not.
        pub stopped_for: u32,
        /// What it slowed the vehicle down for, or only told, as bits of [`Safety::reasons`].
        pub slowed_for: u32,
        /// [`Odometry::HAS_TRUTH`] if the errors are those of true poses, and the bits below.
        pub flags: u32,
    }
);

constants!(
    DriveReport:
    /// The drive's time was over.
    pub const TIME: u32 = 1;
    /// The vehicle reached the end of the path.
    pub const GOAL: u32 = 2;
    /// The vehicle reported a collision.
    pub const COLLISION: u32 = 3;
    /// The vehicle did not follow: the reference had waited for it as long as it may (`reference.wait_limit_s`).
    pub const HELD: u32 = 4;
    /// The gate stopped the vehicle, because of how it drove or, in lockstep, for anything else.
    pub const STOPPED: u32 = 5;
    /// Bit of `flags`: the controller was restarted on the way; errors are those since then.
    pub const JOINED: u32 = 256;
);

message!(
    /// A finished drive, as the trainer is told of it. Sent by the orchestrator, again when asked again.
    #[name = "pathtune.DriveOutcome#359fdd2e"]
    pub struct DriveOutcome {
        /// The controller's report.
        pub report: DriveReport,
        /// The attempt that succeeded.
        pub attempt: Attempt,
    }
);

message!(
    /// Where one learner stands. Sent by the trainer, one a learner.
    #[name = "pathtune.LearnerProgress#9db66e06"]
    pub struct LearnerProgress {
        /// Exploration rate of the current episode.
        pub epsilon: f64,
        /// Least value of the objective so far; infinite before the first drive.
        pub best_value: f64,
        /// Drives asked for.
        pub asked: u64,
        /// The current episode, counted from 0; what is done of something else, as the header's flags say.
        pub episode: u32,
        /// Episodes of the training; all of that.
        pub episodes: u32,
    }
);

constants!(
    LearnerProgress:
    /// In [`BatchHeader::flags`]: no learners, but the drives of a list.
    pub const DRIVES: u32 = 1;
    /// In [`BatchHeader::flags`]: no learners, but the sets of a ranking.
    pub const RANKING: u32 = 2;
    /// In [`BatchHeader::flags`]: no learners, but the sets that are simulated before the first drive.
    pub const SIMULATING: u32 = 4;
);

message!(
    /// A sign of life. Sent by every process, when it becomes ready and then at least every 100 ms.
    #[name = "pathtune.Status#414291dd"]
    pub struct Status {
        /// Which start of this role it is, from the environment.
        pub incarnation: u64,
        /// The batch that is or was last under way; 0 before the first.
        pub batch: u64,
        /// Its next tick.
        pub tick: u64,
        /// Samples that did not match attempt and tick, and were dropped.
        pub dropped: u64,
        /// Samples that were not finite or out of range, and were rejected.
        pub rejected: u64,
        /// Samples that came too late in real time: odometry that was not answered, answers and commands beyond
        /// their age limit, ticks driven before their zone's parameters had come.
        pub late: u64,
        /// The role: one of the values below.
        pub role: u32,
        /// [`Status::READY`] once all ports exist, else 0.
        pub state: u32,
        /// Vehicles that the process can drive in one tick; only of the vehicle.
        pub capacity: u32,
        /// Bits: how the vehicle paces; only of the vehicle.
        pub pacing: u32,
    }
);

constants!(
    Status:
    /// Value of `role`.
    pub const VEHICLE: u32 = 1;
    /// Value of `role`.
    pub const SUPERVISOR: u32 = 2;
    /// Value of `role`.
    pub const CONTROLLER: u32 = 3;
    /// Value of `role`.
    pub const TRAINER: u32 = 4;
    /// Value of `role`.
    pub const RECORDER: u32 = 5;
    /// Value of `state`: all ports exist.
    pub const READY: u32 = 1;
    /// Bit of `pacing`: publishes at its own rate, does not wait for commands.
    pub const REAL_TIME: u32 = 1;
    /// Bit of `pacing`: stands at the start of the path, ready to be reset.
    pub const AT_START: u32 = 2;
);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_attempt_is_ahead_only_in_its_own_run() {
        let at = |run, batch, attempt| Attempt { run, batch, attempt, reserved: 0 };
        let now = at(7, 2, 3);
        assert!(now.is_of(7) && !now.is_of(8));
        assert!(at(7, 2, 4).is_ahead_of(&now) && at(7, 3, 1).is_ahead_of(&now));
        assert!(!now.is_ahead_of(&now) && !at(7, 1, 9).is_ahead_of(&now));
        assert!(!at(8, 9, 9).is_ahead_of(&now) && !at(6, 9, 9).is_ahead_of(&now));
        assert!(now.is_ahead_of(&Attempt::between_batches(7)));
    }
}
