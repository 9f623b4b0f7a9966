//! What is made of a recorded drive while it is recorded: its file, its laps, and what the result says of a single drive.
//!
//! A drive by the clock may last for hours: a row is written, added up, and forgotten.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use config::RunConfig;
use ipc_types::{Command, Safety, has};
use outcome::Lap;
use supervisor::Movement;
use supervisor::envelope::{Alarm, Envelope};
use tracking::{
    Covered, DriveRecord, DriveRecorder, EndReason, LapRecorder, PathFollower, Pose, Reference,
    TickMeasures, TrackingError,
};

use crate::recording::Row;

/// The quality of tracking is told as often.
const QUALITY_EVERY_S: f64 = 1.0;

/// What is added up of a recording beside its rows.
#[derive(Debug, Clone, Default)]
pub(crate) struct Sums {
    /// `None` if the path is driven once.
    pub(crate) laps: Option<LapRecorder>,
    /// `None` unless the drive is a single one.
    pub(crate) single: Option<Box<SingleSums>>,
}

impl Sums {
    fn add(&mut self, row: &Row) {
        // Nobody believes such odometry, and a single number of it would make all sums unreadable.
        if !row.is_finite() {
            return;
        }
        if let Some(laps) = &mut self.laps {
            laps.add(row.tick, row.x_m, row.y_m, row.speed_mps);
        }
        if let Some(single) = &mut self.single {
            single.add(row);
        }
    }

    /// The laps; `None` if the path is driven once.
    pub(crate) fn finish_laps(&mut self, arrived: bool) -> Option<Vec<Lap>> {
        let lap = |it: tracking::Lap| Lap {
            time_s: it.time_s,
            path_mean_m: it.path_mean_m,
            path_max_m: it.path_max_m,
            stood: it.stood,
        };
        Some(self.laps.take()?.finish(arrived).into_iter().map(lap).collect())
    }
}

/// A recording that grows. Its file has another name until it is whole.
#[derive(Debug)]
pub(crate) struct Growing {
    part: PathBuf,
    /// Made with the first row.
    writer: Option<csv::Writer<fs::File>>,
    pub(crate) rows: u64,
    /// The tick after the last one that was recorded.
    pub(crate) next_tick: u64,
    /// The drive is over: by the clock the vehicle goes on.
    pub(crate) is_ended: bool,
    pub(crate) sums: Sums,
}

impl Growing {
    /// A recording without a row, in this file for the time being.
    pub(crate) fn new(part: PathBuf, sums: Sums) -> Self {
        Self { part, writer: None, rows: 0, next_tick: 0, is_ended: false, sums }
    }

    /// Whether nothing more belongs to a drive of so many ticks.
    pub(crate) fn is_whole(&self, ticks: u64) -> bool {
        self.is_ended || self.rows >= ticks
    }

    /// Adds a row, unless the drive is over.
    pub(crate) fn add(&mut self, row: &Row) -> Result<()> {
        if self.is_ended {
            return Ok(());
        }
        let write = |writer: &mut Option<_>| -> Result<()> {
            let writer = match writer {
                Some(writer) => writer,
                None => writer.insert(csv::Writer::from_writer(make(&self.part)?)),
            };
            Ok(writer.serialize(row)?)
        };
        write(&mut self.writer).with_context(|| failed(&self.part))?;
        self.sums.add(row);
        (self.rows, self.next_tick) = (self.rows + 1, row.tick + 1);
        self.is_ended = has(row.flags, Command::ENDED);
        Ok(())
    }

    /// Gives the recording, which is whole or as far as it comes, its name.
    pub(crate) fn keep(&mut self, path: &Path) -> Result<()> {
        let mut keep = || -> Result<()> {
            match self.writer.take() {
                Some(mut writer) => writer.flush()?,
                None => drop(make(&self.part)?),
            }
            Ok(fs::rename(&self.part, path)?)
        };
        keep().with_context(|| failed(path))
    }
}

impl Drop for Growing {
    /// Nobody asks for a recording that was not kept: its drive is made again.
    fn drop(&mut self) {
        if self.writer.is_some() {
            let _ = fs::remove_file(&self.part);
        }
    }
}

fn failed(path: &Path) -> String {
    format!("failed to write {}", path.display())
}

/// Makes a file anew. What an earlier process has left there goes, and no link is followed.
fn make(path: &Path) -> Result<fs::File> {
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder)?;
    }
    let _ = fs::remove_file(path);
    Ok(fs::File::create_new(path)?)
}

/// What the result of a single drive says of its rows.
#[derive(Debug, Clone)]
pub(crate) struct SingleSums {
    tick_s: f64,
    steering_limit_rad: f64,
    reference: Reference,
    follower: PathFollower,
    recorder: DriveRecorder,
    first_tick: Option<u64>,
    last: (u64, f64, f64),
    has_truth: bool,
    fastest: Option<outcome::Fastest>,
    in_envelope: Option<InEnvelope>,
    /// Where changes of the parameters were put off.
    refused: Vec<outcome::RefusedSwitch>,
    waits: bool,
}

/// Where a drive is in the configuration's envelope, as the supervisor sees it.
#[derive(Debug, Clone)]
struct InEnvelope {
    envelope: Envelope,
    follower: PathFollower,
    /// The first one.
    alarm: Option<Alarm>,
    /// Ticks between two places where the quality of tracking is told, and what it was there.
    every: u64,
    quality: Vec<outcome::QualityAt>,
}

impl SingleSums {
    /// Before the first row.
    pub(crate) fn new(config: &RunConfig) -> Self {
        let envelope = config.envelope.as_ref().and_then(|_| Envelope::new(config));
        Self {
            tick_s: config.drive.tick_s,
            steering_limit_rad: config.controller.steering_limit_rad,
            reference: Reference::new(config),
            follower: PathFollower::default(),
            recorder: DriveRecorder::new(config.drive.tick_s),
            first_tick: None,
            last: (0, 0.0, 0.0),
            has_truth: false,
            fastest: None,
            in_envelope: envelope.map(|envelope| InEnvelope {
                envelope,
                follower: PathFollower::default(),
                alarm: None,
                every: (QUALITY_EVERY_S / config.drive.tick_s).round().max(1.0) as u64,
                quality: Vec::new(),
            }),
            refused: Vec::new(),
            waits: false,
        }
    }

    fn add(&mut self, row: &Row) {
        let path = self.reference.path();
        self.follower.distance_m(path, row.x_m, row.y_m);
        self.recorder.add(TickMeasures {
            error: TrackingError {
                along_track_m: row.along_track_m,
                cross_track_m: row.cross_track_m,
                heading_rad: row.heading_rad,
            },
            path_distance_m: row.path_distance_m,
            steering_rad: row.command_steering_rad,
            steering_limited: row.command_steering_rad.abs() >= self.steering_limit_rad,
            lateral_acceleration_mps2: row.speed_mps * row.yaw_rate_radps,
        });
        let along_m = self.follower.along_m(path, row.x_m, row.y_m);
        let now = outcome::Fastest {
            speed_mps: row.speed_mps,
            path_speed_mps: self.reference.path_speed_mps(along_m),
        };
        if self.fastest.as_ref().is_none_or(|most| share(&now).total_cmp(&share(most)).is_ge()) {
            self.fastest = Some(now);
        }
        if let Some(seen) = &mut self.in_envelope {
            seen.add(path, row);
        }
        match (self.waits, has(row.flags, Command::SWITCH_REFUSED)) {
            (false, true) => {
                let refused = outcome::RefusedSwitch { from_tick: row.tick, until_tick: None };
                self.refused.push(refused);
            }
            (true, false) => {
                if let Some(last) = self.refused.last_mut() {
                    last.until_tick = Some(row.tick);
                }
            }
            _ => {}
        }
        self.waits = has(row.flags, Command::SWITCH_REFUSED);
        self.first_tick.get_or_insert(row.tick);
        self.last = (row.tick, row.x_m, row.y_m);
        self.has_truth |= (row.x_m, row.y_m) != (row.measured_x_m, row.measured_y_m);
    }

    /// What the rows show of a drive that was interrupted; `None` if there are none.
    pub(crate) fn interrupted(&self) -> Option<Interrupted> {
        let first_tick = self.first_tick?;
        let (tick, x_m, y_m) = self.last;
        let path = self.reference.path();
        let along_m = self.follower.along_m(path, x_m, y_m);
        let progress = (along_m / path.length_m()).clamp(0.0, 1.0);
        let covered = Covered { at_end: progress, in_time: progress };
        let record =
            self.recorder.clone().finish(EndReason::Time, tick + 1, self.tick_s, covered, 0);
        Some(Interrupted { record, has_truth: self.has_truth, joined: first_tick > 0 })
    }

    /// Where the drive was fastest, compared with the path's speed.
    pub(crate) fn fastest(&self) -> Option<outcome::Fastest> {
        self.fastest
    }

    /// Where changes of the parameters were put off.
    pub(crate) fn refused(&self) -> Vec<outcome::RefusedSwitch> {
        self.refused.clone()
    }

    /// Where the drive was in the configuration's envelope, as the supervisor saw it; `None` if there is none. `stopped_for`
    /// is what the gate stopped it for.
    pub(crate) fn in_envelope(
        &self,
        config: &RunConfig,
        stopped_for: u32,
    ) -> Option<outcome::InEnvelope> {
        let (file, seen) = (config.envelope.as_deref()?, self.in_envelope.as_ref()?);
        let (score, worst) = seen.envelope.score();
        let channel = &file.channels[worst];
        let alarm = seen.alarm;
        let by = alarm.map(|it| &file.channels[it.index]);
        let acted = alarm.filter(|it| has(stopped_for, it.channel.reason()));
        Some(outcome::InEnvelope {
            score,
            threshold: file.threshold,
            worst: channel.kind.clone(),
            over_s: channel.over_s,
            out_at_s: alarm.map(|it| it.tick as f64 * config.drive.tick_s),
            out_at_tick: alarm.map(|it| it.tick),
            out_by: by.map(|it| it.kind.clone()),
            out_over_s: by.map(|it| it.over_s),
            quality: seen.quality.clone(),
            action: acted.map(|it| Safety::action_name(it.channel.reason()).to_owned()),
        })
    }
}

/// A drive that was interrupted.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Interrupted {
    pub(crate) record: DriveRecord,
    /// Its poses are not the measured ones.
    pub(crate) has_truth: bool,
    /// It began before its first row.
    pub(crate) joined: bool,
}

impl InEnvelope {
    fn add(&mut self, path: &tracking::Path, row: &Row) {
        const STOPPED: u32 = Command::STOPPING | Command::STOPPED;
        if has(row.flags, Command::ENDED) {
            return;
        }
        if row.flags & STOPPED != 0 {
            self.envelope.lose();
            return;
        }
        let pose =
            Pose { x_m: row.measured_x_m, y_m: row.measured_y_m, yaw_rad: row.measured_yaw_rad };
        let (speed_mps, yaw_rate_radps) = (row.speed_mps, row.yaw_rate_radps);
        self.envelope.see(row.tick, Movement { pose, speed_mps, yaw_rate_radps }, true);
        let (x_m, y_m) = (row.reference_x_m, row.reference_y_m);
        self.follower.distance_m(path, x_m, y_m);
        self.envelope.follow(self.follower.along_m(path, x_m, y_m));
        self.envelope.tell(row.command_steering_rad);
        self.alarm = self.alarm.or(self.envelope.alarm());
        let observed = self.envelope.quality();
        if row.tick % self.every == self.every - 1 && !observed.is_nan() {
            let (calibrated, sd) = self.envelope.calibrated_quality().unzip();
            self.quality.push(outcome::QualityAt { at_s: row.time_s, observed, calibrated, sd });
        }
    }
}

/// Where the path ends at rest, any speed would be many times its own.
fn share(it: &outcome::Fastest) -> f64 {
    it.speed_mps / it.path_speed_mps.max(0.2)
}
