//! A bag of ROS 2 as a drive: `nav_msgs/Odometry`, and the commands that the car was given. Times are those of arrival.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Result, anyhow, bail, ensure};
use byteorder::{BigEndian, LittleEndian};
use config::{DriveMessage, Vehicle};
use identification::{Command, Drive, Odometry, Point};
use orchestrator::cli::{CommandType, IdentifyArgs};
use recorder::reading::AnyMessage;
use ros2_vehicle::messages;
use serde::de::DeserializeOwned;

use super::{MOST_SAMPLES, Read, fill_gaps, is_finite};
use crate::cut_off::blame;

/// Slower, a twist tells no steering angle.
const TELLING_MPS: f64 = 0.05;

/// Reads a bag.
pub(super) fn read(file: &Path, vehicle: &Vehicle, args: &IdentifyArgs) -> Result<Read> {
    let odometry_topic = args.odometry.as_deref().unwrap_or(&vehicle.ros2.odometry_topic);
    let command_topic = args.command.as_deref().unwrap_or(&vehicle.ros2.drive_topic);
    // As the file of the car says, unless the bag tells its type or the user does.
    let mut kind = args.command_type.unwrap_or(match vehicle.ros2.drive_message {
        DriveMessage::Stamped => CommandType::Stamped,
        DriveMessage::Bare => CommandType::Bare,
        DriveMessage::Twist => CommandType::Twist,
        DriveMessage::TwistStamped => CommandType::TwistStamped,
    });
    let sign = vehicle.ros2.steering_sign as f64;
    let mut drive = Drive::default();
    let mut topics: BTreeMap<String, usize> = BTreeMap::new();
    let mut origin_ns = None;
    let cut_off = recorder::reading::read_any(file, |message| {
        let AnyMessage { topic, log_time_ns: time_ns, data, .. } = message;
        *topics.entry(topic.to_owned()).or_default() += 1;
        let origin_ns = *origin_ns.get_or_insert(time_ns);
        // From the first message on, so that nanoseconds since 1970 keep their precision.
        let time_s = (i128::from(time_ns) - i128::from(origin_ns)) as f64 * 1e-9;
        if topic == odometry_topic {
            let told: messages::Odometry = decode(data, topic, "nav_msgs/Odometry")?;
            drive.odometry.push(of_message(&told, time_s));
        } else if topic == command_topic {
            if let Some(told) = type_named(message.kind) {
                ensure!(
                    args.command_type.is_none_or(|wanted| wanted == told),
                    "--command-type: the commands on {topic} are {} by the bag's own word; leave it out",
                    message.kind
                );
                kind = told;
            }
            let (steering_rad, speed_mps) = match kind {
                CommandType::Stamped => {
                    let it: messages::AckermannDriveStamped =
                        decode(data, topic, "ackermann_msgs/AckermannDriveStamped")?;
                    (it.drive.steering_angle.into(), it.drive.speed.into())
                }
                CommandType::Bare => {
                    let it: messages::AckermannDrive =
                        decode(data, topic, "ackermann_msgs/AckermannDrive")?;
                    (it.steering_angle.into(), it.speed.into())
                }
                CommandType::Twist | CommandType::TwistStamped => {
                    let it: messages::Twist = match kind {
                        CommandType::TwistStamped => {
                            decode::<messages::TwistStamped>(
                                data,
                                topic,
                                "geometry_msgs/TwistStamped",
                            )?
                            .twist
                        }
                        _ => decode(data, topic, "geometry_msgs/Twist")?,
                    };
                    let last = drive.commands.last().map_or(0.0, |it| sign * it.steering_rad);
                    let speed_mps = it.linear.x;
                    let angle = vehicle.wheelbase_m * it.angular.z / speed_mps;
                    let angle =
                        if speed_mps.abs() > TELLING_MPS { libm::atan(angle) } else { last };
                    (angle, speed_mps)
                }
            };
            let steering_rad: f64 = sign * steering_rad;
            drive.commands.push(Command { time_s, steering_rad, speed_mps });
        }
        ensure!(
            drive.odometry.len().max(drive.commands.len()) <= MOST_SAMPLES,
            "holds more than {MOST_SAMPLES} messages of a topic; cut it"
        );
        Ok(())
    })?;
    if let (true, Some(why)) = (topics.is_empty(), &cut_off) {
        bail!("holds nothing that can be read: it {why}");
    }
    for (what, topic, option, count) in [
        ("odometry", odometry_topic, "--odometry", drive.odometry.len()),
        ("commands", command_topic, "--command", drive.commands.len()),
    ] {
        if count == 0 {
            let names: Vec<&str> = topics.keys().map(String::as_str).take(30).collect();
            let why = anyhow!(
                "has no {what} on {topic}; name the topic with {option}; the bag has {}",
                names.join(", ")
            );
            return blame(Err(why), cut_off.as_deref());
        }
    }
    drive.odometry.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
    drive.odometry.dedup_by(|next, last| next.time_s <= last.time_s);
    drive.odometry.retain(is_finite);
    // A driver without a gyro tells NaN: then the heading has to do.
    fill_gaps(&mut drive.odometry);
    drive.commands.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
    drive.commands.retain(|it| it.steering_rad.is_finite() && it.speed_mps.is_finite());
    let warnings = cut_off
        .map(|why| vec![format!("{} {why}; what comes before is used", file.display())])
        .unwrap_or_default();
    let are_twists = matches!(kind, CommandType::Twist | CommandType::TwistStamped);
    Ok(Read {
        drives: vec![drive],
        point: Point::Odometry,
        is_simulated: false,
        are_twists,
        warnings,
        ..Read::default()
    })
}

/// The type of a command by the name of its schema, with or without the `msg` of ROS 2.
fn type_named(kind: &str) -> Option<CommandType> {
    Some(match kind.replace("/msg/", "/").as_str() {
        "ackermann_msgs/AckermannDriveStamped" => CommandType::Stamped,
        "ackermann_msgs/AckermannDrive" => CommandType::Bare,
        "geometry_msgs/Twist" => CommandType::Twist,
        "geometry_msgs/TwistStamped" => CommandType::TwistStamped,
        _ => return None,
    })
}

/// A message from its bytes: CDR behind a header of four bytes, whose second says the order of bytes.
fn decode<T: DeserializeOwned>(data: &[u8], topic: &str, kind: &str) -> Result<T> {
    let told = match data {
        [0, 1, _, _, rest @ ..] => cdr_encoding::from_bytes::<T, LittleEndian>(rest).ok(),
        [0, 0, _, _, rest @ ..] => cdr_encoding::from_bytes::<T, BigEndian>(rest).ok(),
        _ => None,
    };
    match told {
        Some((message, _)) => Ok(message),
        None => bail!("holds a message on {topic} that is no {kind}; see --command-type"),
    }
}

fn of_message(told: &messages::Odometry, time_s: f64) -> Odometry {
    let (at, q) = (told.pose.pose.position, told.pose.pose.orientation);
    let twist = told.twist.twist;
    let yaw_rad =
        libm::atan2(2.0 * (q.w * q.z + q.x * q.y), q.w * q.w + q.x * q.x - q.y * q.y - q.z * q.z);
    Odometry {
        time_s,
        x_m: at.x,
        y_m: at.y,
        yaw_rad,
        speed_mps: libm::hypot(twist.linear.x, twist.linear.y).copysign(twist.linear.x),
        yaw_rate_radps: twist.angular.z,
    }
}
