//! How to communicate with a ROS 2 vehicle. Every key is documented next to its value in vehicles/tesla_model_3.toml.

use std::net::IpAddr;

use serde::{Deserialize, Serialize};

use crate::validate::{Problem, above, within};

/// How to communicate with a ROS 2 vehicle.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs, reason = "documented key by key in vehicles/tesla_model_3.toml")]
pub struct Ros2 {
    pub domain_id: u16,
    pub network: String,
    pub odometry_topic: String,
    pub odometry_reliability: Ros2Reliability,
    pub odometry_frame: String,
    pub odometry_child_frame: String,
    pub odometry_point_m: f64,
    pub odometry_age_limit_s: f64,
    pub drive_topic: String,
    pub drive_message: DriveMessage,
    pub drive_reliability: Ros2Reliability,
    pub drive_frame: String,
    pub drive_acceleration: bool,
    pub steering_sign: i8,
    pub collision_topic: String,
    pub collision_message: CollisionMessage,
    pub collision_reliability: Ros2Reliability,
    pub align: Align,
    pub start_distance_m: f64,
    pub start_heading_rad: f64,
}

/// The reliability that a reader asks for, and a writer offers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Ros2Reliability {
    /// Lost messages stay lost.
    BestEffort,
    /// Lost messages are sent again.
    Reliable,
}

/// The message that carries speed and steering angle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DriveMessage {
    /// `ackermann_msgs/AckermannDriveStamped`.
    Stamped,
    /// `ackermann_msgs/AckermannDrive`.
    Bare,
    /// `geometry_msgs/Twist`, whose yaw rate stands for the angle.
    Twist,
    /// `geometry_msgs/TwistStamped`, likewise.
    TwistStamped,
}

/// The message that reports a collision.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CollisionMessage {
    /// `carla_msgs/CarlaCollisionEvent`: each one is a collision.
    CarlaEvent,
    /// `std_msgs/Bool`: true is a collision.
    Bool,
}

/// How the odometry's frame lies in the map.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Align {
    /// The pose at the time of a request becomes that of the path's start.
    Start,
    /// The odometry's frame is the map's.
    Map,
}

/// The longest name of a topic or frame.
const MAX_NAME: usize = 200;

pub(crate) fn validate(ros2: &Ros2) -> Result<(), Problem> {
    let key = |name: &str| format!("vehicle.ros2.{name}");
    // Domains above this would need port numbers that do not exist.
    within(&key("domain_id"), ros2.domain_id.into(), 0.0, 232.0)?;
    if !ros2.network.is_empty() && ros2.network.parse::<IpAddr>().is_err() {
        let problem = format!(
            "is {:?}, but must be the IP address of an interface of this machine, or empty for all",
            ros2.network
        );
        return Err((key("network"), problem));
    }
    for (name, topic, may_be_empty) in [
        ("odometry_topic", &ros2.odometry_topic, false),
        ("drive_topic", &ros2.drive_topic, false),
        ("collision_topic", &ros2.collision_topic, true),
    ] {
        if !(is_topic(topic) || may_be_empty && topic.is_empty()) {
            let problem = format!(
                "is {topic:?}, but must be a full ROS name, as in \"/car/odom\": words of letters, digits and \
                 single underscores, each after a slash"
            );
            return Err((key(name), problem));
        }
    }
    for (name, frame) in [
        ("odometry_frame", &ros2.odometry_frame),
        ("odometry_child_frame", &ros2.odometry_child_frame),
        ("drive_frame", &ros2.drive_frame),
    ] {
        if frame.len() > MAX_NAME || frame.chars().any(char::is_control) {
            let problem = format!("must be a name of at most {MAX_NAME} characters on one line");
            return Err((key(name), problem));
        }
    }
    if ros2.steering_sign.abs() != 1 {
        let problem = format!("is {}, but must be 1 or -1", ros2.steering_sign);
        return Err((key("steering_sign"), problem));
    }
    within(&key("odometry_point_m"), ros2.odometry_point_m, -20.0, 20.0)?;
    above(&key("odometry_age_limit_s"), ros2.odometry_age_limit_s, 0.0, 10.0)?;
    above(&key("start_distance_m"), ros2.start_distance_m, 0.0, 100.0)?;
    above(&key("start_heading_rad"), ros2.start_heading_rad, 0.0, 3.2)
}

/// Whether it is the full name of a ROS topic.
fn is_topic(name: &str) -> bool {
    let is_word = |word: &str| {
        word.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
            && word.chars().next().is_some_and(|c| !c.is_ascii_digit())
            && !word.contains("__")
    };
    name.len() <= MAX_NAME
        && name.strip_prefix('/').is_some_and(|rest| rest.split('/').all(is_word))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Layers;

    #[test]
    fn names_of_topics_are_whole() {
        for name in ["/odom", "/carla/ego_vehicle/odometry", "/_x/y1"] {
            assert!(is_topic(name), "{name}");
        }
        for name in ["", "/", "odom", "/odom/", "//odom", "/1odom", "/a b", "/a__b", "~/odom", "/ä"]
        {
            assert!(!is_topic(name), "{name}");
        }
    }

    #[test]
    fn every_vehicle_that_speaks_ros_2_has_limits() {
        for name in ["ackermann", "carla", "f1tenth"] {
            let mut layers = Layers::maneuver("lane_change").unwrap();
            layers.set_vehicle("--vehicle", name).unwrap();
            let config = layers.resolve().unwrap();
            assert_eq!(config.vehicle.name, name);
            let s = config.vehicle.safety;
            for limit in [
                s.acceleration_limit_mps2,
                s.deceleration_limit_mps2,
                s.jerk_limit_mps3,
                s.reverse_limit_mps,
                s.steering_rate_limit_radps,
                s.lateral_acceleration_limit_mps2,
                s.jump_limit_m,
                s.jump_limit_rad,
            ] {
                assert!(limit.is_finite(), "{name}: {s:?}");
            }
        }
    }

    #[test]
    fn mistakes_are_named() {
        for (assignment, part) in [
            ("vehicle.ros2.domain_id=233", "[0, 232]"),
            ("vehicle.ros2.network=home", "IP address"),
            ("vehicle.ros2.odometry_topic=odom", "\"/car/odom\""),
            ("vehicle.ros2.drive_topic=''", "\"/car/odom\""),
            ("vehicle.ros2.steering_sign=0", "1 or -1"),
            ("vehicle.ros2.align=road", "road"),
            ("vehicle.ros2.drive_message=joy", "joy"),
            ("vehicle.ros2.odometry_age_limit_s=0.0", "(0, 10]"),
            ("vehicle.ros2.odometry=x", "did you mean"),
        ] {
            let mut layers = Layers::maneuver("lane_change").unwrap();
            let result = layers.set(assignment).and_then(|()| layers.resolve());
            let message = result.unwrap_err().to_string();
            assert!(message.contains(part), "{message:?} lacks {part:?}");
            assert!(message.contains("vehicle.ros2."), "{message}");
        }
    }
}
