//! Drives of recordings of ours, as the envelope sees them.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use config::{MadeFor, RunConfig};
use ipc_types::layout::Bytes;
use ipc_types::{Attempt, Command, Odometry, RawCommand, TickHeader, WirePose, has};
use recorder::reading::Recording;
use supervisor::Movement;
use supervisor::envelope::{DriveTrace, Evidence};

use crate::cut_off::blame;
use tracking::{Path as DrivenPath, PathFollower, Pose};
use trainer::calibration::far_m;

/// Ticks that are kept in memory, in all.
const MOST_TICKS: usize = 4_000_000;
/// What a command tells of a gate that does not let the vehicle drive.
const HELD: u32 = Command::DEGRADED | Command::STOPPING | Command::STOPPED;

/// What recordings hold.
#[derive(Debug, Default)]
pub(super) struct Recorded {
    pub(super) traces: Vec<DriveTrace>,
    /// Drives that are no examples of good ones.
    pub(super) left_out: u64,
    /// What the user should know.
    pub(super) warnings: Vec<String>,
}

#[derive(Debug, Default)]
struct Drive {
    ticks: BTreeMap<u64, Tick>,
    /// The tick that ended it. By the clock the vehicle goes on telling where it is, while it rolls out.
    ended_at: Option<u64>,
    /// The first tick at which the gate did not let it drive.
    held_at: Option<u64>,
}

#[derive(Debug, Default)]
struct Tick {
    movement: Option<Movement>,
    obeys: bool,
    /// The true position, or the measured one.
    at: (f64, f64),
    along_m: Option<f64>,
    steering_rad: Option<f64>,
}

/// Reads recordings of drives of this configuration.
pub(super) fn read(files: &[PathBuf], config: &RunConfig) -> Result<Recorded, String> {
    let mut recorded = Recorded::default();
    let mut kept = 0;
    for file in files {
        add(&mut recorded, file, config, &mut kept)
            .map_err(|why| format!("--from {}: {why:#}", file.display()))?;
    }
    Ok(recorded)
}

fn add(recorded: &mut Recorded, file: &Path, config: &RunConfig, kept: &mut usize) -> Result<()> {
    let mut drives: BTreeMap<(Attempt, usize), Drive> = BTreeMap::new();
    let recording =
        Recording::read_with(file, |topic, _, data| note(&mut drives, topic, data, kept))?;
    if let Some(why) = &recording.cut_off {
        recorded.warnings.push(format!("{} {why}; what comes before is used", file.display()));
    }
    let cut_off = recording.cut_off.clone();
    blame(add_drives(recorded, &recording, drives, config), cut_off.as_deref())
}

fn add_drives(
    recorded: &mut Recorded,
    recording: &Recording,
    drives: BTreeMap<(Attempt, usize), Drive>,
    config: &RunConfig,
) -> Result<()> {
    let text = recording.attachments.get("config.toml").context("holds no configuration")?;
    let theirs = RunConfig::from_resolved(std::str::from_utf8(text)?)?;
    let made_for = |config: &RunConfig| MadeFor::of(config, Vec::new());
    if let Some((what, here, there)) = made_for(config).difference(&made_for(&theirs)) {
        anyhow::bail!("is a drive of another kind: its {what} is {there}, and here it is {here}");
    }
    let before = recorded.traces.len();
    for drive in drives.into_values() {
        match trace(&drive, config) {
            Some(trace) => recorded.traces.push(trace),
            None => recorded.left_out += 1,
        }
    }
    ensure!(recorded.traces.len() > before || recorded.left_out > 0, "holds no drive");
    Ok(())
}

fn note(
    drives: &mut BTreeMap<(Attempt, usize), Drive>,
    topic: &str,
    data: &[u8],
    kept: &mut usize,
) -> Result<()> {
    if !matches!(topic, "/pathtune/odometry" | "/pathtune/raw_command" | "/pathtune/command") {
        return Ok(());
    }
    let mut bytes = data;
    let header = TickHeader::take(&mut bytes).context("is damaged: a message has no header")?;
    for slot in 0.. {
        let key = (header.attempt, slot);
        match topic {
            "/pathtune/odometry" => {
                let Some(seen) = Odometry::take(&mut bytes) else { break };
                *kept += 1;
                ensure!(*kept <= MOST_TICKS, "holds more than {MOST_TICKS} ticks, with the others");
                let has_truth = has(seen.status, Odometry::HAS_TRUTH);
                let at = if has_truth { seen.truth } else { seen.measured };
                let WirePose { x_m, y_m, yaw_rad } = seen.measured;
                let (speed_mps, yaw_rate_radps) = (seen.speed_mps, seen.yaw_rate_radps);
                let pose = Pose { x_m, y_m, yaw_rad };
                let tick = drives.entry(key).or_default().ticks.entry(header.tick).or_default();
                tick.at = (at.x_m, at.y_m);
                tick.obeys = !has(seen.status, Odometry::OWN_STOP);
                tick.movement = Some(Movement { pose, speed_mps, yaw_rate_radps });
            }
            "/pathtune/raw_command" => {
                let Some(raw) = RawCommand::take(&mut bytes) else { break };
                let drive = drives.entry(key).or_default();
                if has(raw.flags, Command::ENDED) {
                    drive.ended_at.get_or_insert(header.tick);
                }
                drive.ticks.entry(header.tick).or_default().along_m = Some(raw.reference_along_m);
            }
            _ => {
                let Some(passed) = Command::take(&mut bytes) else { break };
                let drive = drives.entry(key).or_default();
                if has(passed.flags, Command::ENDED) {
                    drive.ended_at.get_or_insert(header.tick);
                    continue;
                }
                if passed.flags & HELD != 0 {
                    drive.held_at.get_or_insert(header.tick);
                }
                let tick = drive.ticks.entry(header.tick).or_default();
                tick.steering_rad = Some(passed.steering_rad);
            }
        }
    }
    Ok(())
}

/// What is kept of a drive; `None` if it is no example of a good one.
fn trace(drive: &Drive, config: &RunConfig) -> Option<DriveTrace> {
    let ended_at = drive.ended_at?;
    if drive.held_at.is_some_and(|tick| tick <= ended_at) {
        return None;
    }
    let path = DrivenPath::new(&config.path);
    let mut follower = PathFollower::new(&path, 0.0);
    let mut evidence = Evidence::new(config);
    let mut trace = DriveTrace::default();
    for (tick, it) in drive.ticks.range(..=ended_at) {
        let Some(movement) = it.movement else { continue };
        if follower.distance_m(&path, it.at.0, it.at.1) > far_m(config) {
            return None;
        }
        evidence.see(*tick, movement, it.obeys);
        if let Some(along_m) = it.along_m {
            evidence.follow(along_m);
        }
        if let Some(steering_rad) = it.steering_rad
            && let Some(look) = evidence.tell(steering_rad)
        {
            trace.add(&look);
        }
    }
    Some(trace)
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::Layers;

    /// A car on the path's straight for 20 ticks, and from then on far beside it.
    fn drive(ended_at: Option<u64>, held_at: Option<u64>) -> Drive {
        let tick = |tick: u64| {
            let at = (0.01 * tick as f64, if tick < 20 { 0.0 } else { -9.0 });
            let pose = Pose { x_m: at.0, y_m: at.1, yaw_rad: 0.0 };
            let movement = Some(Movement { pose, speed_mps: 1.0, yaw_rate_radps: 0.0 });
            let (along_m, steering_rad) = (Some(at.0), Some(0.0));
            (tick, Tick { movement, obeys: true, at, along_m, steering_rad })
        };
        Drive { ticks: (0..40).map(tick).collect(), ended_at, held_at }
    }

    #[test]
    fn what_comes_after_the_end_of_a_drive_does_not_count() {
        let config = Layers::maneuver("smooth_lane").unwrap().resolve().unwrap();
        let is_kept = |ended_at, held_at| trace(&drive(ended_at, held_at), &config).is_some();
        assert!(is_kept(Some(19), None));
        assert!(is_kept(Some(19), Some(20)));
        assert!(!is_kept(Some(20), None));
        assert!(!is_kept(Some(19), Some(10)));
        assert!(!is_kept(None, None));
    }
}
