//! One drive with given parameters: what `pathtune drive` makes.

use std::collections::BTreeMap;

use config::{ConfigError, Parameters, RunConfig, SweepPlan};
use ipc_types::{DriveReport, Odometry, Safety, has};
use outcome::Switch;
use tracking::{EndReason, Objective};

use crate::along::{Interrupted, SingleSums};
use crate::digest::digest_of_drives;
use crate::ranking::measures_of;
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

    /// The drive that was interrupted, by what was recorded of it; `None` if there is nothing.
    pub(crate) fn interrupted(&self, sums: &SingleSums) -> Option<Driven> {
        let Interrupted { record, has_truth, joined } = sums.interrupted()?;
        let report = DriveReport {
            parameters: self.sets.first()?.0,
            ticks: record.ticks,
            flags: if has_truth { Odometry::HAS_TRUTH } else { 0 }
                | if joined { DriveReport::JOINED } else { 0 },
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

/// Names of what was wrong.
fn reasons_of(reasons: u32) -> Vec<String> {
    Safety::reason_names(reasons).into_iter().map(str::to_owned).collect()
}
