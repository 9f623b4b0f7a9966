//! From an odometry message to the tracked point in the map frame.

use config::{Align, PoseConfig, Vehicle};
use nalgebra::Rotation2;
use serde::{Deserialize, Serialize};
use tracking::{Pose, wrap_angle};

use crate::messages::{Odometry, Quaternion, Time};

/// What an odometry message says about the car.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reading {
    /// Pose of the tracked point in the odometry's frame; yaw not wrapped.
    pub pose: Pose,
    /// Forward speed.
    pub speed_mps: f64,
    /// Yaw rate, counter-clockwise.
    pub yaw_rate_radps: f64,
    /// The time for which the car reports this.
    pub stamp: Time,
    /// How long before it was sent that was; `None` if its stamp does not tell.
    pub age_ns: Option<u64>,
}

/// Why the contents of an odometry message cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Unusable {
    /// A number is not finite.
    #[error("its {0} is not finite")]
    NotFinite(&'static str),
    /// The orientation is not a rotation.
    #[error("its orientation is not a rotation: the quaternion's length is 0")]
    NotARotation,
    /// It is in another frame than expected.
    #[error("its {name} is {seen:?}; vehicle.ros2.{key} asks for {expected:?}")]
    Frame {
        /// The field's name.
        name: &'static str,
        /// The key that names the frame.
        key: &'static str,
        /// What it holds.
        seen: String,
        /// What it should hold.
        expected: String,
    },
}

/// Reads odometry messages of one car.
#[derive(Debug, Clone, PartialEq)]
pub struct Reader {
    frame: String,
    child_frame: String,
    /// How far the tracked point is ahead of the point whose pose is reported.
    ahead_m: f64,
    last_yaw_rad: f64,
}

impl Reader {
    /// A reader whose first yaw is the one nearest to the path's start.
    pub fn new(vehicle: &Vehicle, start: PoseConfig) -> Self {
        let ros2 = &vehicle.ros2;
        Self {
            frame: ros2.odometry_frame.clone(),
            child_frame: ros2.odometry_child_frame.clone(),
            ahead_m: vehicle.tracked_point_m - ros2.odometry_point_m,
            last_yaw_rad: start.yaw_rad,
        }
    }

    /// What the message says, which was sent at this time by its sender's clock.
    ///
    /// # Errors
    /// If its numbers or its frames cannot be used.
    pub fn read(&mut self, odometry: &Odometry, sent: Time) -> Result<Reading, Unusable> {
        for (name, key, seen, expected) in [
            ("frame_id", "odometry_frame", &odometry.header.frame_id, &self.frame),
            ("child_frame_id", "odometry_child_frame", &odometry.child_frame_id, &self.child_frame),
        ] {
            if !expected.is_empty() && seen != expected {
                let (seen, expected) = (seen.clone(), expected.clone());
                return Err(Unusable::Frame { name, key, seen, expected });
            }
        }
        let at = odometry.pose.pose.position;
        let twist = odometry.twist.twist;
        let (vx, vy, yaw_rate_radps) = (twist.linear.x, twist.linear.y, twist.angular.z);
        let yaw_rad = yaw_of(odometry.pose.pose.orientation)?;
        let yaw_rad = self.last_yaw_rad + wrap_angle(yaw_rad - self.last_yaw_rad);
        let told = Pose { x_m: at.x, y_m: at.y, yaw_rad };
        let tracked = told.ahead(self.ahead_m);
        let pose = Pose { x_m: tracked.x, y_m: tracked.y, yaw_rad };
        let speed_mps = libm::hypot(vx, vy).copysign(vx);
        for (what, is_finite) in [
            ("position", pose.is_finite()),
            ("linear speed", speed_mps.is_finite()),
            ("yaw rate", yaw_rate_radps.is_finite()),
        ] {
            if !is_finite {
                return Err(Unusable::NotFinite(what));
            }
        }
        self.last_yaw_rad = yaw_rad;
        let stamp = odometry.header.stamp;
        let age_ns = crate::arrivals::age_ns(stamp, sent);
        Ok(Reading { pose, speed_mps, yaw_rate_radps, stamp, age_ns })
    }
}

/// The yaw of a rotation.
fn yaw_of(q: Quaternion) -> Result<f64, Unusable> {
    let norm2 = q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w;
    if !norm2.is_finite() {
        return Err(Unusable::NotFinite("orientation"));
    }
    // A message that was never filled in has 0 everywhere.
    if norm2 <= 1e-6 {
        return Err(Unusable::NotARotation);
    }
    let yaw_rad =
        libm::atan2(2.0 * (q.w * q.z + q.x * q.y), q.w * q.w + q.x * q.x - q.y * q.y - q.z * q.z);
    Ok(yaw_rad)
}

/// How the odometry's frame lies in the map.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Alignment {
    /// Angle from the odometry's x axis to the map's, counter-clockwise.
    pub turn_rad: f64,
    /// x of the odometry's origin in the map.
    pub x_m: f64,
    /// y of the odometry's origin in the map.
    pub y_m: f64,
}

impl Alignment {
    /// The alignment that `align` asks for, with which a car that stands at `pose` is at `start`.
    pub fn new(align: Align, pose: Pose, start: Pose) -> Self {
        match align {
            Align::Map => Self::default(),
            Align::Start => {
                let turn_rad = start.yaw_rad - pose.yaw_rad;
                let at = start.position() - Rotation2::new(turn_rad) * pose.position();
                Self { turn_rad, x_m: at.x, y_m: at.y }
            }
        }
    }

    /// A pose of the odometry's frame, in the map.
    pub fn to_map(&self, pose: Pose) -> Pose {
        let at = Rotation2::new(self.turn_rad) * pose.position();
        let yaw_rad = pose.yaw_rad + self.turn_rad;
        Pose { x_m: at.x + self.x_m, y_m: at.y + self.y_m, yaw_rad }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::Vector3;
    use proptest::prelude::*;
    use std::f64::consts::PI;

    const SENT: Time = Time { sec: 1_700_000_000, nanosec: 0 };

    fn vehicle() -> Vehicle {
        let mut layers = config::Layers::maneuver("lane_change").unwrap();
        layers.set_vehicle("--vehicle", "ackermann").unwrap();
        layers.resolve().unwrap().vehicle
    }

    fn odometry(x: f64, y: f64, yaw: f64, vx: f64, vy: f64) -> Odometry {
        let mut odometry = Odometry::default();
        odometry.pose.pose.position = Vector3 { x, y, z: 0.3 };
        odometry.pose.pose.orientation =
            Quaternion { x: 0.0, y: 0.0, z: libm::sin(yaw / 2.0), w: libm::cos(yaw / 2.0) };
        odometry.twist.twist.linear = Vector3 { x: vx, y: vy, z: 0.0 };
        odometry.twist.twist.angular.z = 0.1;
        odometry
    }

    proptest! {
        #[test]
        fn a_car_that_turns_on_and_on_never_jumps(step in -3.0..3.0f64, first in -20.0..20.0f64) {
            let mut reader = Reader::new(&vehicle(), PoseConfig::default());
            let mut last = reader.read(&odometry(0.0, 0.0, first, 1.0, 0.0), SENT).unwrap().pose.yaw_rad;
            prop_assert!(last.abs() <= PI + 1e-9);
            for k in 1..100 {
                let yaw = first + step * f64::from(k);
                let now = reader.read(&odometry(0.0, 0.0, yaw, 1.0, 0.0), SENT).unwrap().pose.yaw_rad;
                prop_assert!((now - last - step).abs() < 1e-9);
                last = now;
            }
        }

        #[test]
        fn alignment_puts_the_car_on_the_start_and_keeps_distances(
            x in -1e3..1e3f64, y in -1e3..1e3f64, yaw in -10.0..10.0f64,
            sx in -1e3..1e3f64, sy in -1e3..1e3f64, syaw in -10.0..10.0f64,
            ahead in -50.0..50.0f64,
        ) {
            let pose = Pose { x_m: x, y_m: y, yaw_rad: yaw };
            let start = Pose { x_m: sx, y_m: sy, yaw_rad: syaw };
            let alignment = Alignment::new(Align::Start, pose, start);
            let there = alignment.to_map(pose);
            prop_assert!((there.position() - start.position()).norm() < 1e-8);
            prop_assert!((there.yaw_rad - syaw).abs() < 1e-9);
            let further = pose.ahead(ahead);
            let further = alignment.to_map(Pose { x_m: further.x, y_m: further.y, yaw_rad: yaw });
            prop_assert!((further.position() - start.ahead(ahead)).norm() < 1e-8);
            prop_assert_eq!(Alignment::new(Align::Map, pose, start).to_map(pose), pose);
        }

        #[test]
        fn no_message_is_read_into_what_is_not_finite(
            x in any::<f64>(), y in any::<f64>(), yaw in any::<f64>(), vx in any::<f64>(), vy in any::<f64>(),
        ) {
            let mut reader = Reader::new(&vehicle(), PoseConfig::default());
            if let Ok(reading) = reader.read(&odometry(x, y, yaw, vx, vy), SENT) {
                prop_assert!(reading.pose.is_finite() && reading.speed_mps.is_finite());
            }
            // A wrong message leaves nothing behind.
            prop_assert!(reader.read(&odometry(0.0, 0.0, 0.0, 1.0, 0.0), SENT).is_ok());
        }
    }

    #[test]
    fn the_pose_is_that_of_the_tracked_point() {
        let mut vehicle = vehicle();
        (vehicle.tracked_point_m, vehicle.ros2.odometry_point_m) = (0.5, 1.5);
        let mut reader = Reader::new(&vehicle, PoseConfig::default());
        let reading = reader.read(&odometry(10.0, 20.0, PI / 2.0, 3.0, 4.0), SENT).unwrap();
        assert!((reading.pose.x_m - 10.0).abs() < 1e-12, "{reading:?}");
        assert!((reading.pose.y_m - 19.0).abs() < 1e-12, "{reading:?}");
        assert_eq!((reading.speed_mps, reading.yaw_rate_radps), (5.0, 0.1));
        let back = reader.read(&odometry(0.0, 0.0, 0.0, -3.0, 4.0), SENT).unwrap();
        assert_eq!(back.speed_mps, -5.0);
    }

    #[test]
    fn what_cannot_be_used_says_why() {
        let mut vehicle = vehicle();
        vehicle.ros2.odometry_frame = "map".to_owned();
        let mut reader = Reader::new(&vehicle, PoseConfig::default());
        let told = |result: Result<Reading, Unusable>| result.unwrap_err().to_string();
        let message = told(reader.read(&odometry(0.0, 0.0, 0.0, 0.0, 0.0), SENT));
        assert_eq!(message, "its frame_id is \"\"; vehicle.ros2.odometry_frame asks for \"map\"");
        let mut reader = Reader::new(&self::vehicle(), PoseConfig::default());
        assert_eq!(reader.read(&Odometry::default(), SENT), Err(Unusable::NotARotation));
        for (message, what) in [
            (odometry(f64::NAN, 0.0, 0.0, 0.0, 0.0), "position"),
            (odometry(0.0, 0.0, f64::NAN, 0.0, 0.0), "orientation"),
            (odometry(0.0, 0.0, 0.0, f64::INFINITY, 0.0), "linear speed"),
        ] {
            assert_eq!(reader.read(&message, SENT), Err(Unusable::NotFinite(what)));
        }
    }
}
