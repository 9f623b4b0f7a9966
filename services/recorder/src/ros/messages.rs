//! The messages themselves: their fields, their schemas, their bytes.

use byteorder::LittleEndian;
use ipc_types::{Odometry, WirePose};
use serde::Serialize;
use tracking::{Path, Pose};

/// The first bytes of every message: plain CDR, little endian.
pub(crate) const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];
/// Distance between two poses of a [`path`] that is long enough, 2,000 of them on a shorter one.
const POSES_EVERY_M: f64 = 0.5;
/// The most intervals of a [`path`].
const MOST_POSES: f64 = 20_000.0;

/// A message for one of the ROS channels.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct RosMessage {
    pub(crate) topic: String,
    pub(crate) kind: Kind,
    pub(crate) cdr: Vec<u8>,
}

/// The kinds of ROS messages.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    Odometry,
    AckermannDriveStamped,
    Vector3Stamped,
    DiagnosticArray,
    TfMessage,
    Path,
}

impl Kind {
    /// Name and text of the schema.
    pub(crate) fn schema(self) -> (&'static str, &'static str) {
        match self {
            Kind::Odometry => ("nav_msgs/msg/Odometry", include_str!("../msg/Odometry.msg")),
            Kind::AckermannDriveStamped => (
                "ackermann_msgs/msg/AckermannDriveStamped",
                include_str!("../msg/AckermannDriveStamped.msg"),
            ),
            Kind::Vector3Stamped => {
                ("geometry_msgs/msg/Vector3Stamped", include_str!("../msg/Vector3Stamped.msg"))
            }
            Kind::TfMessage => ("tf2_msgs/msg/TFMessage", include_str!("../msg/TFMessage.msg")),
            Kind::Path => ("nav_msgs/msg/Path", include_str!("../msg/Path.msg")),
            Kind::DiagnosticArray => {
                ("diagnostic_msgs/msg/DiagnosticArray", include_str!("../msg/DiagnosticArray.msg"))
            }
        }
    }
}

#[derive(Clone, Serialize)]
struct RosTime {
    sec: i32,
    nanosec: u32,
}

#[derive(Clone, Serialize)]
pub(super) struct Header {
    stamp: RosTime,
    frame_id: &'static str,
}

#[derive(Serialize)]
pub(super) struct Vector3 {
    pub(super) x: f64,
    pub(super) y: f64,
    pub(super) z: f64,
}

#[derive(Serialize)]
struct Quaternion {
    x: f64,
    y: f64,
    z: f64,
    w: f64,
}

#[derive(Serialize)]
struct RosPose {
    position: Vector3,
    orientation: Quaternion,
}

/// 36 numbers: an unknown covariance is 0.
type Covariance = [[f64; 6]; 6];

#[derive(Serialize)]
struct RosOdometry<'a> {
    header: Header,
    child_frame_id: &'a str,
    pose: RosPose,
    pose_covariance: Covariance,
    linear: Vector3,
    angular: Vector3,
    twist_covariance: Covariance,
}

#[derive(Serialize)]
pub(super) struct TransformStamped {
    header: Header,
    child_frame_id: String,
    translation: Vector3,
    rotation: Quaternion,
}

#[derive(Serialize)]
struct PoseStamped {
    header: Header,
    pose: RosPose,
}

#[derive(Serialize)]
struct RosPath {
    header: Header,
    poses: Vec<PoseStamped>,
}

#[derive(Serialize)]
pub(super) struct Ackermann {
    pub(super) header: Header,
    pub(super) steering_angle: f32,
    pub(super) steering_angle_velocity: f32,
    pub(super) speed: f32,
    pub(super) acceleration: f32,
    pub(super) jerk: f32,
}

#[derive(Serialize)]
pub(super) struct Vector3Stamped {
    pub(super) header: Header,
    pub(super) vector: Vector3,
}

#[derive(Serialize)]
pub(super) struct KeyValue {
    pub(super) key: &'static str,
    pub(super) value: String,
}

#[derive(Serialize)]
pub(super) struct DiagnosticStatus {
    pub(super) level: u8,
    pub(super) name: &'static str,
    pub(super) message: String,
    pub(super) hardware_id: String,
    pub(super) values: Vec<KeyValue>,
}

#[derive(Serialize)]
pub(super) struct DiagnosticArray {
    pub(super) header: Header,
    pub(super) status: Vec<DiagnosticStatus>,
}

/// Levels of a [`DiagnosticStatus`].
pub(super) const OK: u8 = 0;
pub(super) const WARN: u8 = 1;

pub(super) fn header(stamp_ns: u64) -> Header {
    let stamp = RosTime {
        sec: (stamp_ns / 1_000_000_000) as i32,
        nanosec: (stamp_ns % 1_000_000_000) as u32,
    };
    Header { stamp, frame_id: "map" }
}

pub(super) fn cdr(message: &impl Serialize) -> Vec<u8> {
    let mut bytes = ENCAPSULATION.to_vec();
    let body = cdr_encoding::to_vec::<_, LittleEndian>(message);
    bytes.extend(body.expect("our own structs can be serialized"));
    bytes
}

fn position(pose: WirePose) -> Vector3 {
    Vector3 { x: pose.x_m, y: pose.y_m, z: 0.0 }
}

fn orientation(pose: WirePose) -> Quaternion {
    let half_rad = 0.5 * pose.yaw_rad;
    Quaternion { x: 0.0, y: 0.0, z: libm::sin(half_rad), w: libm::cos(half_rad) }
}

pub(super) fn odometry(
    stamp_ns: u64,
    child_frame_id: &str,
    pose: WirePose,
    odometry: &Odometry,
) -> Vec<u8> {
    let nothing = || Vector3 { x: 0.0, y: 0.0, z: 0.0 };
    cdr(&RosOdometry {
        header: header(stamp_ns),
        child_frame_id,
        pose: RosPose { position: position(pose), orientation: orientation(pose) },
        pose_covariance: Covariance::default(),
        linear: Vector3 { x: odometry.speed_mps, ..nothing() },
        angular: Vector3 { z: odometry.yaw_rate_radps, ..nothing() },
        twist_covariance: Covariance::default(),
    })
}

/// Where a frame stands in that of the map.
pub(super) fn transform(stamp_ns: u64, child_frame_id: String, pose: WirePose) -> TransformStamped {
    TransformStamped {
        header: header(stamp_ns),
        child_frame_id,
        translation: position(pose),
        rotation: orientation(pose),
    }
}

/// Poses along a path, from its start to its end, at equal distances.
pub(super) fn path(stamp_ns: u64, path: &Path) -> Vec<u8> {
    let length_m = path.length_m();
    let intervals = (length_m / POSES_EVERY_M).clamp(2_000.0, MOST_POSES).ceil() as u32;
    let pose_at = |index: u32| {
        let Pose { x_m, y_m, yaw_rad } =
            path.at(length_m * f64::from(index) / f64::from(intervals));
        let pose = WirePose { x_m, y_m, yaw_rad };
        let pose = RosPose { position: position(pose), orientation: orientation(pose) };
        PoseStamped { header: header(stamp_ns), pose }
    };
    let poses = (0..=intervals).map(pose_at).collect();
    cdr(&RosPath { header: header(stamp_ns), poses })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_odometry_has_its_numbers_where_ros_looks_for_them() {
        let pose = WirePose { x_m: 1.0, y_m: -2.0, yaw_rad: 3.0 };
        let seen = Odometry { speed_mps: 4.0, yaw_rate_radps: 0.5, ..Odometry::default() };
        let bytes = odometry(12_345_678_901, "tracked_point", pose, &seen);
        let number = |at: usize| f64::from_le_bytes(bytes[at..at + 8].try_into().unwrap());
        assert_eq!(bytes[4..8], 12i32.to_le_bytes());
        assert_eq!(bytes[8..12], 345_678_901u32.to_le_bytes());
        // "map" with its length and a closing 0, "tracked_point" likewise, then padding to a multiple of 8 after the
        // four bytes of encapsulation.
        assert_eq!(&bytes[12..20], b"\x04\0\0\0map\0");
        assert_eq!(&bytes[20..38], b"\x0e\0\0\0tracked_point\0");
        assert_eq!((number(44), number(52)), (1.0, -2.0));
        assert_eq!((number(84), number(92)), (libm::sin(1.5), libm::cos(1.5)));
        assert_eq!(number(100 + 288), 4.0);
        assert_eq!(number(100 + 288 + 40), 0.5);
        assert_eq!(bytes.len(), 100 + 288 + 48 + 288);
    }
}
