//! A recording of ours as drives: one for each attempt at a drive of each slot of a fleet.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result, anyhow, bail, ensure};
use config::launch::{Launch, Role};
use identification::{Command, Drive, Odometry, Point};
use ipc_types::layout::Bytes;
use ipc_types::{Attempt, TickHeader, has};
use recorder::reading::Recording;

use super::{MOST_SAMPLES, Read, Seen, fill_gaps, is_finite};
use crate::cut_off::blame;

type Key = (Attempt, usize);

/// Reads a recording and the files that continue it, but for those that are among the files that were `seen`.
pub(super) fn read(file: &Path, seen: &mut Seen) -> Result<Read> {
    let mut drives: BTreeMap<Key, Drive> = BTreeMap::new();
    let mut kept = 0;
    let mut path = file.to_owned();
    let mut first = None;
    let mut warnings = Vec::new();
    loop {
        let recording = Recording::read_with(&path, |topic, time_ns, data| {
            note(&mut drives, topic, time_ns, data, &mut kept)
        })?;
        if let Some(why) = &recording.cut_off {
            warnings.push(format!("{} {why}; what comes before is used", path.display()));
        }
        let next = recording.end.as_ref().and_then(|end| end.get("continued_in")).cloned();
        first.get_or_insert(recording);
        let Some(next) = next else { break };
        // A name without a folder: the parts are in the same folder.
        let name = Path::new(&next).file_name().context("names no file that continues it")?;
        let next = path.with_file_name(name);
        if next == path {
            bail!("is damaged: it says that it continues itself");
        }
        if !seen.is_new(&next) {
            break;
        }
        path = next;
    }
    let first = first.context("holds nothing")?;
    let cut_off = first.cut_off.as_deref();
    let drives: Vec<Drive> = drives
        .into_values()
        .filter(|it| !it.commands.is_empty() && !it.odometry.is_empty())
        .collect();
    if drives.is_empty() {
        return blame(Err(anyhow!("holds no drive")), cut_off);
    }
    let mut read = Read { drives, warnings, ..Read::default() };
    read.drives.iter_mut().for_each(|drive| fill_gaps(&mut drive.odometry));
    let launch = first.attachments.get("launch.toml").and_then(|it| std::str::from_utf8(it).ok());
    let launch = launch.and_then(|text| Launch::parse("launch.toml", text).ok());
    let vehicle = launch
        .and_then(|launch| launch.process.into_iter().find(|entry| entry.role == Role::Vehicle));
    if let Some(entry) = vehicle {
        let service = entry.service.as_deref();
        read.is_simulated = entry.command.is_none() && matches!(service, None | Some("simulator"));
        if service == Some("ros2-vehicle") {
            as_the_adapter_drove(&mut read, &first)?;
        }
    }
    Ok(read)
}

/// Keeps a message that belongs to a drive.
fn note(
    drives: &mut BTreeMap<Key, Drive>,
    topic: &str,
    time_ns: u64,
    data: &[u8],
    kept: &mut usize,
) -> Result<()> {
    if !matches!(topic, "/pathtune/odometry" | "/pathtune/command") {
        return Ok(());
    }
    let mut bytes = data;
    let header = TickHeader::take(&mut bytes).context("is damaged: a message has no header")?;
    let time_s = time_ns as f64 * 1e-9;
    for slot in 0.. {
        let key = (header.attempt, slot);
        if topic == "/pathtune/odometry" {
            let Some(seen) = ipc_types::Odometry::take(&mut bytes) else { break };
            if has(seen.status, ipc_types::Odometry::ENDED) {
                continue;
            }
            let drive = drives.entry(key).or_default();
            let odometry = Odometry {
                time_s,
                x_m: seen.measured.x_m,
                y_m: seen.measured.y_m,
                yaw_rad: seen.measured.yaw_rad,
                speed_mps: seen.speed_mps,
                yaw_rate_radps: seen.yaw_rate_radps,
            };
            let is_new = drive.odometry.last().is_none_or(|it| it.time_s < time_s);
            if is_new && is_finite(&odometry) {
                drive.odometry.push(odometry);
            }
        } else {
            let Some(passed) = ipc_types::Command::take(&mut bytes) else { break };
            if has(passed.flags, ipc_types::Command::ENDED) {
                continue;
            }
            let (steering_rad, speed_mps) = (passed.steering_rad, passed.speed_mps);
            if !(steering_rad.is_finite() && speed_mps.is_finite()) {
                continue;
            }
            drives.entry(key).or_default().commands.push(Command {
                time_s,
                steering_rad,
                speed_mps,
            });
        }
        *kept += 1;
        ensure!(
            *kept <= 2 * MOST_SAMPLES,
            "holds more than {MOST_SAMPLES} ticks of drives; record fewer in one run"
        );
    }
    Ok(())
}

/// The adapter of a ROS 2 car has moved poses from the odometry's point to the tracked one: moves them back, so that what
/// is identified is where the odometry's point lies. It may have sent twists.
fn as_the_adapter_drove(read: &mut Read, recording: &Recording) -> Result<()> {
    let config = recording.attachments.get("config.toml").context("holds no configuration")?;
    let config: toml::Table = std::str::from_utf8(config)?.parse()?;
    let number = |table: &toml::Table, key: &str| table.get(key).and_then(toml::Value::as_float);
    let vehicle = config.get("vehicle").and_then(toml::Value::as_table);
    let ros2 = vehicle.and_then(|it| it.get("ros2")).and_then(toml::Value::as_table);
    let tracked_m = vehicle.and_then(|it| number(it, "tracked_point_m"));
    let odometry_m = ros2.and_then(|it| number(it, "odometry_point_m"));
    let (Some(tracked_m), Some(odometry_m)) = (tracked_m, odometry_m) else {
        bail!("holds a configuration without tracked_point_m and odometry_point_m");
    };
    for seen in read.drives.iter_mut().flat_map(|drive| &mut drive.odometry) {
        let pose = tracking::Pose { x_m: seen.x_m, y_m: seen.y_m, yaw_rad: seen.yaw_rad };
        let told = pose.ahead(odometry_m - tracked_m);
        (seen.x_m, seen.y_m) = (told.x, told.y);
    }
    read.point = Point::Odometry;
    let message = ros2.and_then(|it| it.get("drive_message")).and_then(toml::Value::as_str);
    read.are_twists = message.is_some_and(|it| it.starts_with("twist"));
    Ok(())
}
