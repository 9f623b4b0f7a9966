//! The ROS 2 messages that the car and we exchange, field by field as CDR has them.

use config::{CollisionMessage, DriveMessage};
use serde::{Deserialize, Serialize};

use crate::stop::Setpoint;

/// `builtin_interfaces/Time`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Time {
    /// Seconds.
    pub sec: i32,
    /// Nanoseconds beyond them.
    pub nanosec: u32,
}

/// `std_msgs/Header`.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Header {
    /// When it was measured.
    pub stamp: Time,
    /// In which frame.
    pub frame_id: String,
}

/// `geometry_msgs/Vector3` and `geometry_msgs/Point`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "coordinates")]
pub struct Vector3 {
    pub x: f64,
    pub y: f64,
    pub z: f64,
}

/// `geometry_msgs/Quaternion`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "coordinates")]
pub struct Quaternion {
    pub x: f64,
    pub y: f64,
    pub z: f64,
    pub w: f64,
}

/// `geometry_msgs/Pose`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// In metres.
    pub position: Vector3,
    /// Its length is 1.
    pub orientation: Quaternion,
}

/// 36 numbers; serde supports arrays of up to 32 only.
pub type Covariance = [[f64; 6]; 6];

/// `geometry_msgs/PoseWithCovariance`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "named after their types")]
pub struct PoseWithCovariance {
    pub pose: Pose,
    pub covariance: Covariance,
}

/// `geometry_msgs/Twist`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Twist {
    /// In metres per second.
    pub linear: Vector3,
    /// In radians per second.
    pub angular: Vector3,
}

/// `geometry_msgs/TwistStamped`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct TwistStamped {
    /// When it was sent.
    pub header: Header,
    /// The speeds.
    pub twist: Twist,
}

/// `geometry_msgs/TwistWithCovariance`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "named after their types")]
pub struct TwistWithCovariance {
    pub twist: Twist,
    pub covariance: Covariance,
}

/// `nav_msgs/Odometry`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Odometry {
    /// When, and in which frame the pose is.
    pub header: Header,
    /// The frame of the car, in which its speeds are.
    pub child_frame_id: String,
    /// Of the car.
    pub pose: PoseWithCovariance,
    /// Speeds.
    pub twist: TwistWithCovariance,
}

/// `ackermann_msgs/AckermannDrive`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct AckermannDrive {
    /// Angle of the road wheels, rad, positive to the left.
    pub steering_angle: f32,
    /// Its rate, rad/s; 0: as fast as possible.
    pub steering_angle_velocity: f32,
    /// Forward speed, m/s.
    pub speed: f32,
    /// Limit of the acceleration, m/s²; 0: as fast as possible.
    pub acceleration: f32,
    /// Limit of the jerk, m/s³; 0: as fast as possible.
    pub jerk: f32,
}

/// `ackermann_msgs/AckermannDriveStamped`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct AckermannDriveStamped {
    /// When it was sent.
    pub header: Header,
    /// The command.
    pub drive: AckermannDrive,
}

/// `carla_msgs/CarlaCollisionEvent`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct CarlaCollisionEvent {
    /// When.
    pub header: Header,
    /// With whom.
    pub other_actor_id: u32,
    /// How hard, Ns.
    pub normal_impulse: Vector3,
}

/// `std_msgs/Bool`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Bool {
    /// The value.
    pub data: bool,
}

/// Package and name of the odometry's type.
pub const ODOMETRY: (&str, &str) = ("nav_msgs", "Odometry");

/// Package and name of a drive command's type.
pub fn drive_type(message: DriveMessage) -> (&'static str, &'static str) {
    match message {
        DriveMessage::Stamped => ("ackermann_msgs", "AckermannDriveStamped"),
        DriveMessage::Bare => ("ackermann_msgs", "AckermannDrive"),
        DriveMessage::Twist => ("geometry_msgs", "Twist"),
        DriveMessage::TwistStamped => ("geometry_msgs", "TwistStamped"),
    }
}

/// Package and name of a collision's type.
pub fn collision_type(message: CollisionMessage) -> (&'static str, &'static str) {
    match message {
        CollisionMessage::CarlaEvent => ("carla_msgs", "CarlaCollisionEvent"),
        CollisionMessage::Bool => ("std_msgs", "Bool"),
    }
}

/// The command that makes a car do this; `steering_sign` is 1 where a positive angle steers to the left.
pub fn to_drive(setpoint: Setpoint, steering_sign: i8) -> AckermannDrive {
    // A car might take -0 for the reverse gear.
    let angle = f64::from(steering_sign) * setpoint.steering_rad + 0.0;
    AckermannDrive {
        steering_angle: angle as f32,
        steering_angle_velocity: 0.0,
        speed: setpoint.speed_mps as f32,
        acceleration: setpoint.acceleration_mps2 as f32,
        jerk: 0.0,
    }
}

/// The same as a speed and a yaw rate, for a car with this wheelbase: v·tan δ/L, so that one that stands cannot be told
/// an angle.
pub fn to_twist(setpoint: Setpoint, steering_sign: i8, wheelbase_m: f64) -> Twist {
    let Setpoint { speed_mps, steering_rad, .. } = setpoint;
    let yaw_rate_radps = speed_mps * libm::tan(steering_rad) / wheelbase_m;
    let mut twist = Twist::default();
    twist.linear.x = speed_mps;
    twist.angular.z = f64::from(steering_sign) * yaw_rate_radps + 0.0;
    twist
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_twist_has_the_yaw_rate_of_the_angle() {
        let setpoint = Setpoint { speed_mps: 2.0, steering_rad: 0.25, acceleration_mps2: 0.0 };
        let twist = to_twist(setpoint, 1, 2.5);
        assert!((twist.angular.z - 0.8 * 0.25f64.tan()).abs() < 1e-12, "{twist:?}");
        assert_eq!(to_twist(setpoint, -1, 2.5).angular.z, -twist.angular.z);
        let stop = Setpoint { speed_mps: 0.0, ..setpoint };
        assert_eq!(to_twist(stop, -1, 2.5), Twist::default());
    }

    #[test]
    fn the_sign_turns_the_angle_and_nothing_else() {
        let setpoint = Setpoint { speed_mps: 2.0, steering_rad: 0.25, acceleration_mps2: 1.5 };
        let left = to_drive(setpoint, 1);
        assert_eq!((left.steering_angle, left.speed, left.acceleration), (0.25, 2.0, 1.5));
        assert_eq!((left.steering_angle_velocity, left.jerk), (0.0, 0.0));
        assert_eq!(to_drive(setpoint, -1), AckermannDrive { steering_angle: -0.25, ..left });
        let straight = to_drive(Setpoint::default(), -1);
        assert!(straight.steering_angle.is_sign_positive());
    }
}
