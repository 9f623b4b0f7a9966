//! One drive with given gains: what `pathtune drive` makes.

use config::{Gains, RunConfig, SweepPlan};
use ipc_types::{DriveReport, Odometry, has};
use serde::{Deserialize, Serialize};

use crate::digest::digest_of_reports;
use crate::sweep::PlannedDrive;
use crate::validation::Switch;

/// One drive with given gains.
#[derive(Debug, Clone)]
pub struct SingleDrive {
    config: RunConfig,
    gains: Vec<Gains>,
}

/// What the drive has come to.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "the keys of result.json, described in the README")]
pub struct SingleOutcome {
    /// Over the drive's report; in real time no two are alike.
    pub digest: String,
    pub gains: Vec<Gains>,
    /// Why it ended: `time`, `goal` or `collision`.
    pub reason: String,
    /// Time that was driven, stops left out.
    pub driven_s: f64,
    pub mse_m2: f64,
    pub along_m2: f64,
    pub cross_m2: f64,
    pub mean_abs_cross_track_m: f64,
    pub max_cross_track_m: f64,
    /// Whether the errors are those of true poses, which only a simulator knows.
    pub true_poses: bool,
    /// Whether the controller was restarted on the way: then the errors are those since.
    pub joined: bool,
    pub switches: Vec<Switch>,
    pub drives_recorded: Vec<String>,
}

impl SingleDrive {
    /// The drive of a plan, whose only set it is made with.
    pub fn new(config: &RunConfig, plan: &SweepPlan) -> Self {
        Self { config: config.clone(), gains: plan.sets.first().cloned().unwrap_or_default() }
    }

    /// The drive, as the list of drives that it is.
    pub fn drives(&self) -> Vec<PlannedDrive> {
        let noise = self.config.noise.enabled;
        vec![PlannedDrive {
            by_zone: match &self.gains[..] {
                [_] => self.gains.clone(),
                sets => self.config.gains_by_zone(sets),
            },
            seed: noise.then_some(self.config.run.seed),
            record: Some("drive".to_owned()),
        }]
    }

    /// What the report comes to.
    pub fn outcome(&self, report: &DriveReport, switches: Vec<Switch>) -> SingleOutcome {
        SingleOutcome {
            digest: digest_of_reports(std::slice::from_ref(report)),
            gains: self.gains.clone(),
            reason: match report.reason {
                DriveReport::GOAL => "goal",
                DriveReport::COLLISION => "collision",
                _ => "time",
            }
            .to_owned(),
            driven_s: report.ticks as f64 * self.config.drive.tick_s,
            mse_m2: report.along_mse_m2 + report.cross_mse_m2,
            along_m2: report.along_mse_m2,
            cross_m2: report.cross_mse_m2,
            mean_abs_cross_track_m: report.mean_abs_cross_m,
            max_cross_track_m: report.max_abs_cross_m,
            true_poses: has(report.flags, Odometry::HAS_TRUTH),
            joined: has(report.flags, DriveReport::JOINED),
            switches,
            drives_recorded: Vec::new(),
        }
    }
}
