//! One drive with given parameters: what `pathtune drive` makes.

use std::collections::BTreeMap;

use config::{ConfigError, Parameters, RunConfig, SweepPlan};
use ipc_types::{Command, DriveReport, Odometry, Safety, has};
use outcome::Switch;
use supervisor::Movement;
use tracking::{
    Covered, DriveRecorder, EndReason, Objective, PathFollower, Pose, Reference, TickMeasures,
    TrackingError,
};

use crate::digest::digest_of_drives;
use crate::ranking::measures_of;
use crate::recording::Row;
use crate::sweep::PlannedDrive;
use crate::wire::Driven;

/// One drive with given parameters.
#[derive(Debug, Clone)]
pub struct SingleDrive {
    config: RunConfig,
    objective: Objective,
    sets: Vec<Parameters>,
}

impl SingleDrive {
    /// The drive of a plan, made with the plan's only set.
    ///
    /// # Errors
    /// If the plan's set is not of the configuration's law.
    pub fn new(config: &RunConfig, plan: &SweepPlan) -> Result<Self, ConfigError> {
        let sets = plan.parameters(&config.law)?.into_iter().next().unwrap_or_default();
        Ok(Self { config: config.clone(), objective: crate::objective_of(config), sets })
    }

    /// The drive, as a list of one drive.
    pub fn drives(&self) -> Vec<PlannedDrive> {
        let noise = self.config.noise.enabled;
        vec![PlannedDrive {
            by_zone: match &self.sets[..] {
                [_] => self.sets.clone(),
                sets => self.config.sets_by_zone(sets),
            },
            seed: noise.then_some(self.config.run.seed),
            plant: 0,
            record: Some("drive".to_owned()),
        }]
    }

    /// The drive that was interrupted after these ticks; `None` if there are none.
    pub(crate) fn interrupted(&self, rows: &[Row]) -> Option<Driven> {
        let (first, last) = (rows.first()?, rows.last()?);
        let tick_s = self.config.drive.tick_s;
        let mut recorder = DriveRecorder::new(tick_s);
        let reference = Reference::new(&self.config);
        let path = reference.path();
        let mut follower = PathFollower::default();
        for row in rows {
            follower.distance_m(path, row.x_m, row.y_m);
            recorder.add(TickMeasures {
                error: TrackingError {
                    along_track_m: row.along_track_m,
                    cross_track_m: row.cross_track_m,
                    heading_rad: row.heading_rad,
                },
                path_distance_m: row.path_distance_m,
                steering_rad: row.command_steering_rad,
                steering_limited: row.command_steering_rad.abs()
                    >= self.config.controller.steering_limit_rad,
                lateral_acceleration_mps2: row.speed_mps * row.yaw_rate_radps,
            });
        }
        let along_m = follower.along_m(path, last.x_m, last.y_m);
        let progress = (along_m / path.length_m()).clamp(0.0, 1.0);
        let covered = Covered { at_end: progress, in_time: progress };
        let record = recorder.finish(EndReason::Time, last.tick + 1, tick_s, covered, 0);
        let has_truth =
            rows.iter().any(|row| (row.x_m, row.y_m) != (row.measured_x_m, row.measured_y_m));
        let report = DriveReport {
            parameters: self.sets.first()?.0,
            ticks: record.ticks,
            flags: if has_truth { Odometry::HAS_TRUTH } else { 0 }
                | if first.tick > 0 { DriveReport::JOINED } else { 0 },
            ..DriveReport::default()
        };
        Some(Driven { report, record })
    }

    /// The result of the report.
    pub fn result(&self, driven: &Driven, switches: Vec<Switch>) -> outcome::SingleDrive {
        let Driven { report, record } = driven;
        let law = &self.config.law;
        outcome::SingleDrive {
            digest: digest_of_drives(std::slice::from_ref(driven), law.count()),
            gains: self.sets.iter().map(|set| law.named(set)).collect(),
            reason: match record.reason {
                EndReason::Goal => "goal",
                EndReason::Collision => "collision",
                EndReason::Held => "held",
                EndReason::Stopped => "stopped",
                EndReason::Time => "time",
            }
            .to_owned(),
            stopped_for: reasons_of(record.stopped_for),
            stopped_how: (record.stopped_for != 0)
                .then(|| Safety::action_name(record.stopped_for).to_owned()),
            slowed_for: reasons_of(record.slowed_for),
            driven_s: record.ticks as f64 * self.config.drive.tick_s,
            progress: record.progress,
            measures: measures_of(&self.objective, self.config.learning.heading_weight, record),
            along_m2: record.along_mse_m2,
            cross_m2: record.cross_mse_m2,
            mean_abs_cross_track_m: record.mean_abs_cross_m,
            max_cross_track_m: record.max_abs_cross_m,
            fastest: None,
            true_poses: has(report.flags, Odometry::HAS_TRUTH),
            envelope: None,
            joined: has(report.flags, DriveReport::JOINED),
            switches,
            refused: Vec::new(),
            drives_recorded: Vec::new(),
            drives_lacking: BTreeMap::new(),
            laps: BTreeMap::new(),
        }
    }
}

/// Where a recorded drive was fastest, compared with the path's speed.
pub(crate) fn fastest(config: &RunConfig, rows: &[Row]) -> Option<outcome::Fastest> {
    let reference = Reference::new(config);
    let path = reference.path();
    let mut follower = PathFollower::default();
    let speeds = rows.iter().map(|row| {
        follower.distance_m(path, row.x_m, row.y_m);
        let along_m = follower.along_m(path, row.x_m, row.y_m);
        let path_speed_mps = reference.path_speed_mps(along_m);
        outcome::Fastest { speed_mps: row.speed_mps, path_speed_mps }
    });
    // Where the path ends at rest, any speed would be many times its own.
    let share = |it: &outcome::Fastest| it.speed_mps / it.path_speed_mps.max(0.2);
    speeds.max_by(|a, b| share(a).total_cmp(&share(b)))
}

/// The quality of tracking is told as often.
const QUALITY_EVERY_S: f64 = 1.0;

/// Where a recorded drive was in the configuration's envelope, as the supervisor saw it; `None` if there is none.
/// `stopped_for` is what the gate stopped it for.
pub(crate) fn in_envelope(
    config: &RunConfig,
    rows: &[Row],
    stopped_for: u32,
) -> Option<outcome::InEnvelope> {
    const STOPPED: u32 = Command::STOPPING | Command::STOPPED;
    let file = config.envelope.as_deref()?;
    let mut envelope = supervisor::envelope::Envelope::new(config)?;
    let reference = Reference::new(config);
    let path = reference.path();
    let mut follower = PathFollower::default();
    let (mut alarm, mut quality) = (None, Vec::new());
    let every = (QUALITY_EVERY_S / config.drive.tick_s).round().max(1.0) as u64;
    for row in rows.iter().take_while(|row| row.flags & Command::ENDED == 0) {
        if row.flags & STOPPED != 0 {
            envelope.lose();
            continue;
        }
        let pose =
            Pose { x_m: row.measured_x_m, y_m: row.measured_y_m, yaw_rad: row.measured_yaw_rad };
        let (speed_mps, yaw_rate_radps) = (row.speed_mps, row.yaw_rate_radps);
        envelope.see(row.tick, Movement { pose, speed_mps, yaw_rate_radps }, true);
        let (x_m, y_m) = (row.reference_x_m, row.reference_y_m);
        follower.distance_m(path, x_m, y_m);
        envelope.follow(follower.along_m(path, x_m, y_m));
        envelope.tell(row.command_steering_rad);
        alarm = alarm.or(envelope.alarm());
        let observed = envelope.quality();
        if row.tick % every == every - 1 && !observed.is_nan() {
            let (calibrated, sd) = envelope.calibrated_quality().unzip();
            quality.push(outcome::QualityAt { at_s: row.time_s, observed, calibrated, sd });
        }
    }
    let (score, worst) = envelope.score();
    let channel = &file.channels[worst];
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
        quality,
        action: acted.map(|it| Safety::action_name(it.channel.reason()).to_owned()),
    })
}

/// Where changes of the parameters were put off in a recorded drive.
pub(crate) fn refused(rows: &[Row]) -> Vec<outcome::RefusedSwitch> {
    let mut refused: Vec<outcome::RefusedSwitch> = Vec::new();
    let mut waits = false;
    for row in rows {
        match (waits, has(row.flags, Command::SWITCH_REFUSED)) {
            (false, true) => {
                refused.push(outcome::RefusedSwitch { from_tick: row.tick, until_tick: None });
            }
            (true, false) => {
                if let Some(last) = refused.last_mut() {
                    last.until_tick = Some(row.tick);
                }
            }
            _ => {}
        }
        waits = has(row.flags, Command::SWITCH_REFUSED);
    }
    refused
}

/// Names of what was wrong.
fn reasons_of(reasons: u32) -> Vec<String> {
    Safety::reason_names(reasons).into_iter().map(str::to_owned).collect()
}
