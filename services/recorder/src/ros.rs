//! The ROS 2 messages of a recording: CDR with `ros2msg` schemas, as Foxglove and PlotJuggler want them.
//!
//! | topic | message | holds |
//! |---|---|---|
//! | `/odom` | `nav_msgs/msg/Odometry` | the measured pose, speed and yaw rate of slot 0 |
//! | `/truth` | `nav_msgs/msg/Odometry` | the true pose, where the vehicle knows it |
//! | `/vehicle_I/odom`, `/vehicle_I/truth` | `nav_msgs/msg/Odometry` | the same of slots 1 to 7 of a fleet |
//! | `/cmd`, `/vehicle_I/cmd` | `ackermann_msgs/msg/AckermannDriveStamped` | the command that the gate passed |
//! | `/tracking_error` | `geometry_msgs/msg/Vector3Stamped` | x along track, y cross track, z heading, of slot 0 |
//! | `/diagnostics` | `diagnostic_msgs/msg/DiagnosticArray` | starts and ends of batches and attempts, what the gate changed |
//!
//! Poses are those of the tracked point (`tracked_point`) in the map frame (`map`). A vehicle whose drive has ended
//! does not appear any more. Stamps are those of the [timeline](crate::timeline).

use byteorder::LittleEndian;
use ipc_types::layout::Bytes;
use ipc_types::{
    BatchHeader, Command, DriveReport, DriveRequest, Odometry, TickHeader, TrackingError, WirePose,
    has,
};
use serde::Serialize;

/// How many slots of a fleet are written as ROS messages; our own channels contain all slots.
pub const SLOTS: usize = 8;

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
}

impl Kind {
    /// Name and text of the schema.
    pub(crate) fn schema(self) -> (&'static str, &'static str) {
        match self {
            Kind::Odometry => ("nav_msgs/msg/Odometry", include_str!("msg/Odometry.msg")),
            Kind::AckermannDriveStamped => (
                "ackermann_msgs/msg/AckermannDriveStamped",
                include_str!("msg/AckermannDriveStamped.msg"),
            ),
            Kind::Vector3Stamped => {
                ("geometry_msgs/msg/Vector3Stamped", include_str!("msg/Vector3Stamped.msg"))
            }
            Kind::DiagnosticArray => {
                ("diagnostic_msgs/msg/DiagnosticArray", include_str!("msg/DiagnosticArray.msg"))
            }
        }
    }
}

#[derive(Serialize)]
struct RosTime {
    sec: i32,
    nanosec: u32,
}

#[derive(Serialize)]
struct Header {
    stamp: RosTime,
    frame_id: &'static str,
}

#[derive(Serialize)]
struct Vector3 {
    x: f64,
    y: f64,
    z: f64,
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
struct RosOdometry {
    header: Header,
    child_frame_id: &'static str,
    pose: RosPose,
    pose_covariance: Covariance,
    linear: Vector3,
    angular: Vector3,
    twist_covariance: Covariance,
}

#[derive(Serialize)]
struct Ackermann {
    header: Header,
    steering_angle: f32,
    steering_angle_velocity: f32,
    speed: f32,
    acceleration: f32,
    jerk: f32,
}

#[derive(Serialize)]
struct Vector3Stamped {
    header: Header,
    vector: Vector3,
}

#[derive(Serialize)]
struct KeyValue {
    key: &'static str,
    value: String,
}

#[derive(Serialize)]
struct DiagnosticStatus {
    level: u8,
    name: &'static str,
    message: String,
    hardware_id: String,
    values: Vec<KeyValue>,
}

#[derive(Serialize)]
struct DiagnosticArray {
    header: Header,
    status: Vec<DiagnosticStatus>,
}

const OK: u8 = 0;
const WARN: u8 = 1;

fn header(stamp_ns: u64) -> Header {
    let stamp = RosTime {
        sec: (stamp_ns / 1_000_000_000) as i32,
        nanosec: (stamp_ns % 1_000_000_000) as u32,
    };
    Header { stamp, frame_id: "map" }
}

fn cdr(message: &impl Serialize) -> Vec<u8> {
    // These four bytes mean plain CDR, little endian.
    let mut bytes = vec![0, 1, 0, 0];
    let body = cdr_encoding::to_vec::<_, LittleEndian>(message);
    bytes.extend(body.expect("our own structs can be serialized"));
    bytes
}

fn odometry(stamp_ns: u64, pose: WirePose, odometry: &Odometry) -> Vec<u8> {
    let half_rad = 0.5 * pose.yaw_rad;
    let nothing = || Vector3 { x: 0.0, y: 0.0, z: 0.0 };
    cdr(&RosOdometry {
        header: header(stamp_ns),
        child_frame_id: "tracked_point",
        pose: RosPose {
            position: Vector3 { x: pose.x_m, y: pose.y_m, z: 0.0 },
            orientation: Quaternion {
                x: 0.0,
                y: 0.0,
                z: libm::sin(half_rad),
                w: libm::cos(half_rad),
            },
        },
        pose_covariance: Covariance::default(),
        linear: Vector3 { x: odometry.speed_mps, ..nothing() },
        angular: Vector3 { z: odometry.yaw_rate_radps, ..nothing() },
        twist_covariance: Covariance::default(),
    })
}

/// The earlier messages on which a ROS message depends.
#[derive(Debug, Default)]
pub(crate) struct Teller {
    ended: [bool; SLOTS],
    gate: [u32; SLOTS],
}

impl Teller {
    /// The ROS messages that are made from a message of ours; `topic` is its topic's name.
    pub(crate) fn tell(&mut self, topic: &str, bytes: &[u8], stamp_ns: u64) -> Vec<RosMessage> {
        match topic {
            "odometry" => self.tell_odometry(bytes, stamp_ns),
            "command" => self.tell_commands(bytes, stamp_ns),
            "tracking_error" => self.tell_error(bytes, stamp_ns),
            "drive_request" => self.tell_request(bytes, stamp_ns),
            "drive_report" => tell_report(bytes, stamp_ns),
            _ => Vec::new(),
        }
    }

    fn tell_odometry(&mut self, bytes: &[u8], stamp_ns: u64) -> Vec<RosMessage> {
        let Some((_, all)) = parse::<TickHeader, Odometry>(bytes, SLOTS) else { return Vec::new() };
        let mut told = Vec::with_capacity(2 * all.len());
        for (slot, seen) in all.iter().enumerate() {
            self.ended[slot] = has(seen.status, Odometry::ENDED);
            if self.ended[slot] {
                continue;
            }
            let prefix = prefix(slot);
            let kind = Kind::Odometry;
            told.push(RosMessage {
                topic: format!("{prefix}/odom"),
                kind,
                cdr: odometry(stamp_ns, seen.measured, seen),
            });
            if has(seen.status, Odometry::HAS_TRUTH) {
                told.push(RosMessage {
                    topic: format!("{prefix}/truth"),
                    kind,
                    cdr: odometry(stamp_ns, seen.truth, seen),
                });
            }
        }
        told
    }

    fn tell_commands(&mut self, bytes: &[u8], stamp_ns: u64) -> Vec<RosMessage> {
        let Some((_, all)) = parse::<TickHeader, Command>(bytes, SLOTS) else { return Vec::new() };
        let mut told = Vec::with_capacity(all.len());
        for (slot, command) in all.iter().enumerate().filter(|(slot, _)| !self.ended[*slot]) {
            told.push(RosMessage {
                topic: format!("{}/cmd", prefix(slot)),
                kind: Kind::AckermannDriveStamped,
                cdr: cdr(&Ackermann {
                    header: header(stamp_ns),
                    steering_angle: command.steering_rad as f32,
                    steering_angle_velocity: 0.0,
                    speed: command.speed_mps as f32,
                    acceleration: 0.0,
                    jerk: 0.0,
                }),
            });
        }
        for (slot, command) in all.iter().enumerate() {
            let gate = command.flags & !Command::ENDED;
            if std::mem::replace(&mut self.gate[slot], gate) == gate {
                continue;
            }
            let set = Command::flag_names(gate).join(", ").replace('_', " ");
            let message = if set.is_empty() { "passes".to_owned() } else { set };
            let own = Command::DEGRADED | Command::STOPPING | Command::STOPPED;
            let level = if has(gate, Command::REJECTED | own) { WARN } else { OK };
            told.push(diagnostic(stamp_ns, level, "gate", message, slot, Vec::new()));
        }
        told
    }

    fn tell_error(&mut self, bytes: &[u8], stamp_ns: u64) -> Vec<RosMessage> {
        let Some((_, all)) = parse::<TickHeader, TrackingError>(bytes, 1) else {
            return Vec::new();
        };
        let Some(error) = all.first().filter(|_| !self.ended[0]) else { return Vec::new() };
        let vector =
            Vector3 { x: error.along_track_m, y: error.cross_track_m, z: error.heading_rad };
        vec![RosMessage {
            topic: "/tracking_error".to_owned(),
            kind: Kind::Vector3Stamped,
            cdr: cdr(&Vector3Stamped { header: header(stamp_ns), vector }),
        }]
    }

    fn tell_request(&mut self, bytes: &[u8], stamp_ns: u64) -> Vec<RosMessage> {
        *self = Self::default();
        let Some((batch, all)) = parse::<BatchHeader, DriveRequest>(bytes, usize::MAX) else {
            return Vec::new();
        };
        let again = batch.attempt.attempt > 1;
        let what = if again { "driven again" } else { "starts" };
        let values = vec![
            KeyValue { key: "batch", value: batch.attempt.batch.to_string() },
            KeyValue { key: "attempt", value: batch.attempt.attempt.to_string() },
            KeyValue { key: "vehicles", value: all.len().to_string() },
        ];
        let level = if again { WARN } else { OK };
        vec![diagnostic(stamp_ns, level, "batch", what.to_owned(), 0, values)]
    }
}

/// The prefix of a slot's topics.
fn prefix(slot: usize) -> String {
    if slot == 0 { String::new() } else { format!("/vehicle_{slot}") }
}

fn tell_report(bytes: &[u8], stamp_ns: u64) -> Vec<RosMessage> {
    let Some((batch, all)) = parse::<BatchHeader, DriveReport>(bytes, usize::MAX) else {
        return Vec::new();
    };
    let reason = |report: &DriveReport| match report.reason {
        DriveReport::TIME => "ended by time",
        DriveReport::GOAL => "ended at the goal",
        DriveReport::COLLISION => "ended by a collision",
        _ => "ended",
    };
    let collided = all.iter().any(|report| report.reason == DriveReport::COLLISION);
    let mut values = vec![
        KeyValue { key: "batch", value: batch.attempt.batch.to_string() },
        KeyValue { key: "attempt", value: batch.attempt.attempt.to_string() },
    ];
    if let Some(first) = all.first() {
        values.push(KeyValue { key: "ticks", value: first.ticks.to_string() });
        values
            .push(KeyValue { key: "mean_abs_cross_m", value: first.mean_abs_cross_m.to_string() });
    }
    let what = all.first().map_or("ended", reason).to_owned();
    vec![diagnostic(stamp_ns, if collided { WARN } else { OK }, "batch", what, 0, values)]
}

fn diagnostic(
    stamp_ns: u64,
    level: u8,
    name: &'static str,
    message: String,
    slot: usize,
    values: Vec<KeyValue>,
) -> RosMessage {
    let status =
        DiagnosticStatus { level, name, message, hardware_id: format!("vehicle_{slot}"), values };
    let array = DiagnosticArray { header: header(stamp_ns), status: vec![status] };
    RosMessage { topic: "/diagnostics".to_owned(), kind: Kind::DiagnosticArray, cdr: cdr(&array) }
}

/// The header and at most `at_most` elements.
fn parse<H: Bytes, M: Bytes>(mut bytes: &[u8], at_most: usize) -> Option<(H, Vec<M>)> {
    let header = H::take(&mut bytes)?;
    let mut all = Vec::new();
    while all.len() < at_most && !bytes.is_empty() {
        all.push(M::take(&mut bytes)?);
    }
    Some((header, all))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_odometry_has_its_numbers_where_ros_looks_for_them() {
        let pose = WirePose { x_m: 1.0, y_m: -2.0, yaw_rad: 3.0 };
        let seen = Odometry { speed_mps: 4.0, yaw_rate_radps: 0.5, ..Odometry::default() };
        let bytes = odometry(12_345_678_901, pose, &seen);
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
