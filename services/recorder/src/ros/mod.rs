//! The ROS 2 messages of a recording: CDR with `ros2msg` schemas, as Foxglove and PlotJuggler want them.
//!
//! | topic | message | holds |
//! |---|---|---|
//! | `/odom` | `nav_msgs/msg/Odometry` | the measured pose, speed and yaw rate of slot 0 |
//! | `/truth` | `nav_msgs/msg/Odometry` | the true pose, where the vehicle knows it |
//! | `/vehicle_I/odom`, `/vehicle_I/truth` | `nav_msgs/msg/Odometry` | the same of slots 1 to 7 of a fleet |
//! | `/tf` | `tf2_msgs/msg/TFMessage` | the measured poses of the slots above |
//! | `/path` | `nav_msgs/msg/Path` | the path; once in each file, kept for late subscribers |
//! | `/cmd`, `/vehicle_I/cmd` | `ackermann_msgs/msg/AckermannDriveStamped` | the command that the gate passed |
//! | `/tracking_error` | `geometry_msgs/msg/Vector3Stamped` | x along track, y cross track, z heading, of slot 0 |
//! | `/diagnostics` | `diagnostic_msgs/msg/DiagnosticArray` | starts and ends of batches and attempts, what the gate changed |
//!
//! Poses are those of the tracked point (`tracked_point`, and `vehicle_I/tracked_point` of further slots) in the map
//! frame (`map`). A vehicle whose drive has ended
//! does not appear any more. Stamps are those of the [timeline](crate::timeline).

mod messages;

use ipc_types::layout::Bytes;
use ipc_types::{
    BatchHeader, Command, DriveReport, DriveRequest, Odometry, TickHeader, TrackingError, has,
};
use tracking::Path;

use messages::{
    Ackermann, DiagnosticArray, DiagnosticStatus, KeyValue, OK, Vector3, Vector3Stamped, WARN, cdr,
    header, odometry, path, transform,
};
pub(crate) use messages::{ENCAPSULATION, Kind, RosMessage};

/// How many slots of a fleet are written as ROS messages; our own channels contain all slots.
pub const SLOTS: usize = 8;

/// The path, if the vehicle follows one, and the earlier messages on which a ROS message depends.
#[derive(Debug)]
pub(crate) struct Teller {
    path: Option<Path>,
    /// Whether the file has the path already.
    is_path_told: bool,
    ended: [bool; SLOTS],
    gate: [u32; SLOTS],
}

impl Teller {
    pub(crate) fn new(path: Option<Path>) -> Self {
        Self { path, is_path_told: false, ended: [false; SLOTS], gate: [0; SLOTS] }
    }

    /// Whether there is a path to tell.
    pub(crate) fn follows_path(&self) -> bool {
        self.path.is_some()
    }

    /// Another file begins.
    pub(crate) fn begin_file(&mut self) {
        self.is_path_told = false;
    }

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
        let mut told = Vec::with_capacity(2 * all.len() + 1);
        let mut transforms = Vec::with_capacity(all.len());
        for (slot, seen) in all.iter().enumerate() {
            self.ended[slot] = has(seen.status, Odometry::ENDED);
            if self.ended[slot] {
                continue;
            }
            let (prefix, frame) = (prefix(slot), frame(slot));
            let kind = Kind::Odometry;
            told.push(RosMessage {
                topic: format!("{prefix}/odom"),
                kind,
                cdr: odometry(stamp_ns, &frame, seen.measured, seen),
            });
            if has(seen.status, Odometry::HAS_TRUTH) {
                told.push(RosMessage {
                    topic: format!("{prefix}/truth"),
                    kind,
                    cdr: odometry(stamp_ns, &frame, seen.truth, seen),
                });
            }
            transforms.push(transform(stamp_ns, frame, seen.measured));
        }
        if !transforms.is_empty() {
            told.push(RosMessage {
                topic: "/tf".to_owned(),
                kind: Kind::TfMessage,
                cdr: cdr(&transforms),
            });
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
        (self.ended, self.gate) = ([false; SLOTS], [0; SLOTS]);
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
        let mut told = vec![diagnostic(stamp_ns, level, "batch", what.to_owned(), 0, values)];
        let is_told = std::mem::replace(&mut self.is_path_told, true);
        if let Some(followed) = self.path.as_ref().filter(|_| !is_told) {
            told.push(RosMessage {
                topic: "/path".to_owned(),
                kind: Kind::Path,
                cdr: path(stamp_ns, followed),
            });
        }
        told
    }
}

/// The prefix of a slot's topics.
fn prefix(slot: usize) -> String {
    if slot == 0 { String::new() } else { format!("/vehicle_{slot}") }
}

/// The frame of a slot's tracked point.
fn frame(slot: usize) -> String {
    if slot == 0 { "tracked_point".to_owned() } else { format!("vehicle_{slot}/tracked_point") }
}

fn tell_report(bytes: &[u8], stamp_ns: u64) -> Vec<RosMessage> {
    let Some((batch, all)) = parse::<BatchHeader, DriveReport>(bytes, usize::MAX) else {
        return Vec::new();
    };
    let reason = |report: &DriveReport| match report.reason {
        DriveReport::TIME => "ended by time",
        DriveReport::GOAL => "ended at the goal",
        DriveReport::HELD => "ended: the vehicle did not follow",
        DriveReport::STOPPED => "stopped by the gate",
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
