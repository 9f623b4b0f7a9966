//! What commands and gates say, in names and in words.

use crate::messages::{Command, Safety, has};

impl Command {
    /// The names of the bits that are set in [`Command::flags`].
    pub fn flag_names(flags: u32) -> Vec<&'static str> {
        let names = [
            (Self::ENDED, "ended"),
            (Self::SPEED_LIMITED, "speed_limited"),
            (Self::STEERING_LIMITED, "steering_limited"),
            (Self::REJECTED, "rejected"),
            (Self::ACCELERATION_LIMITED, "acceleration_limited"),
            (Self::STEERING_RATE_LIMITED, "steering_rate_limited"),
            (Self::LATERAL_LIMITED, "lateral_limited"),
            (Self::DEGRADED, "degraded"),
            (Self::STOPPING, "stopping"),
            (Self::STOPPED, "stopped"),
            (Self::BRAKED, "braked"),
            (Self::STEERED, "steered"),
            (Self::SWITCH_REFUSED, "switch_refused"),
        ];
        those(flags, &names)
    }
}

impl Safety {
    /// The name of a gate's state.
    pub fn state_name(state: u32) -> &'static str {
        match state {
            Self::NORMAL => "normal",
            Self::DEGRADED => "degraded",
            Self::STOPPING => "stopping",
            Self::STOPPED => "stopped",
            _ => "unknown",
        }
    }

    /// The bits of `reasons`, each with its name and what it says.
    const REASONS: &[(u32, &str, &str)] = &[
        (Self::COMMAND_STALE, "command_stale", "no answer from the controller"),
        (Self::COMMAND_INVALID, "command_invalid", "the controller's answer is not finite"),
        (Self::ODOMETRY_STALE, "odometry_stale", "no odometry"),
        (Self::ODOMETRY_INVALID, "odometry_invalid", "the odometry is not finite"),
        (Self::ODOMETRY_JUMP, "odometry_jump", "the measured pose jumped"),
        (Self::TIME_BACK, "time_back", "the odometry's time went back"),
        (Self::RESTARTED, "restarted", "the supervisor was restarted while it stopped the vehicle"),
        (
            Self::PATH_DISTANCE,
            "path_distance",
            "it is too far from the path (vehicle.safety.path_distance_limit_m)",
        ),
        (
            Self::PATH_HEADING,
            "path_heading",
            "it heads away from the path (vehicle.safety.path_heading_limit_rad)",
        ),
        (
            Self::STEERING_REVERSED,
            "steering_reversed",
            "the car turns right when told to turn left, and left when told to turn right (steering_sign?)",
        ),
        (
            Self::STEERING_IGNORED,
            "steering_ignored",
            "it does not turn as its steering angle is commanded",
        ),
        (Self::SPEED_IGNORED, "speed_ignored", "it drives faster than it is commanded to"),
        (
            Self::STANDS,
            "stands",
            "it stands although it is commanded to drive (something holds it, or it ignores commands)",
        ),
        (
            Self::OUT_BY_QUALITY,
            "envelope_quality",
            "it tracks worse than the calibrated drives did (quality)",
        ),
        (
            Self::OUT_BY_LATERAL_ERROR,
            "envelope_lateral_error",
            "it is farther beside the reference than the calibrated drives were",
        ),
        (
            Self::OUT_BY_ALONG,
            "envelope_along",
            "it comes forward otherwise than its speed says, and than in the calibrated drives",
        ),
        (
            Self::OUT_BY_LATERAL,
            "envelope_lateral",
            "it is carried to the side more than in the calibrated drives",
        ),
        (
            Self::OUT_BY_YAW,
            "envelope_yaw",
            "it turns otherwise than it is steered, more than in the calibrated drives",
        ),
        (
            Self::OUT_BY_NOISE,
            "envelope_noise",
            "its measured pose jumps more than in the calibrated drives",
        ),
        (
            Self::ROAD_EDGE,
            "road_edge",
            "it passes an edge of the road, as the path's file tells it",
        ),
        (Self::AREA, "area", "it would leave the area in which it may drive (drive.area_m)"),
        (
            Self::STEERING_UNSEEN,
            "steering_unseen",
            "its yaw rate is computed from the commanded steering angle: a fault of the steering would not be seen",
        ),
        (
            Self::POSE_STANDS,
            "pose_stands",
            "its measured pose stands, or falls behind, although it drives by its own speed",
        ),
        (Self::TIME_AHEAD, "time_ahead", "the odometry's tick or stamp is ahead of the clock"),
        (Self::NO_LEG, "no_leg", "no leg of the path within its reach fits its heading"),
    ];

    /// What the gate does to stop a vehicle, each with its name and in words.
    const ACTIONS: &[(&str, &str)] = &[
        ("rest", "by bringing its reference to rest, steered"),
        ("brake", "by a full brake, steered"),
        ("brake_straight", "by a full brake, its wheels straight"),
    ];

    /// The name of what the gate does to stop a vehicle for these bits of `reasons`.
    pub fn action_name(reasons: u32) -> &'static str {
        if reasons & Self::STRAIGHTENS != 0 {
            "brake_straight"
        } else if reasons & Self::RESTS != 0 && reasons & Self::BRAKES == 0 {
            "rest"
        } else {
            "brake"
        }
    }

    /// What the gate does to stop a vehicle, in words.
    pub fn words_of_action(name: &str) -> &str {
        Self::ACTIONS.iter().find(|it| it.0 == name).map_or(name, |it| it.1)
    }

    /// The names of what is wrong, as [`Safety::reasons`] has it.
    pub fn reason_names(reasons: u32) -> Vec<&'static str> {
        Self::REASONS.iter().filter(|it| has(reasons, it.0)).map(|it| it.1).collect()
    }

    /// What is wrong, in words, as [`Safety::reasons`] has it.
    pub fn describe(reasons: u32) -> Vec<&'static str> {
        Self::REASONS.iter().filter(|it| has(reasons, it.0)).map(|it| it.2).collect()
    }

    /// What the reason of this name says, in words.
    pub fn words_of(name: &str) -> &str {
        Self::REASONS.iter().find(|it| it.1 == name).map_or(name, |it| it.2)
    }
}

fn those(bits: u32, names: &[(u32, &'static str)]) -> Vec<&'static str> {
    names.iter().filter(|(bit, _)| has(bits, *bit)).map(|(_, name)| *name).collect()
}
