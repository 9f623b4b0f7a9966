//! Gain sets beside the paper's: without noise, and with it.

use config::{Gains, PaperSet, RunConfig, SweepPlan};
use ipc_types::DriveReport;
use serde::{Deserialize, Serialize};

use crate::digest::digest_of_reports;
use crate::statistics::Estimate;
use crate::sweep::PlannedDrive;

/// What a validation drives, and what its reports come to.
#[derive(Debug, Clone)]
pub struct Validation {
    config: RunConfig,
    rows: Vec<Vec<Gains>>,
    repeats: u64,
}

/// What a validation has come to.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "the keys of result.json, described in the README")]
pub struct ValidationOutcome {
    /// Over the reports of all drives.
    pub digest: String,
    pub repeats: u64,
    pub rows: Vec<RowOutcome>,
    /// exp of the root mean square of ln(ours / paper's), over all figures that the paper has.
    pub rms_factor: Option<f64>,
    pub drives_recorded: Vec<String>,
}

/// One gain set, or one set for each manoeuvre of the path.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "the keys of result.json, described in the README")]
pub struct RowOutcome {
    pub gains: Vec<Gains>,
    pub chosen_by_paper: bool,
    pub noise_free: NoiseFree,
    pub noisy: Noisy,
    /// Where the gains changed, in the drive without noise.
    pub switches: Vec<Switch>,
}

/// The drive without noise.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "the keys of result.json, described in the README")]
pub struct NoiseFree {
    pub mse_m2: f64,
    pub along_m2: f64,
    pub cross_m2: f64,
    pub distance: f64,
    pub max_cross_track_m: f64,
    /// Share of the ticks on which the steering angle was at its limit.
    pub steering_limited: f64,
    pub collisions: u32,
    /// Share of the drive's time after which it ended: in a collision, at the goal, or with its time.
    pub driven: f64,
    pub paper_mse_m2: Option<f64>,
    /// Ours over the paper's, or the paper's over ours: 1 or more.
    pub factor: Option<f64>,
}

/// The drives with noise.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "the keys of result.json, described in the README")]
pub struct Noisy {
    pub mse_m2_mean: f64,
    /// The 95 % bootstrap interval of the mean.
    pub mse_m2_low: f64,
    pub mse_m2_high: f64,
    pub mse_m2_worst: f64,
    pub collisions: u32,
    pub paper_mse_m2: Option<f64>,
    /// The worst over the paper's worst, or the other way round: 1 or more.
    pub factor: Option<f64>,
}

/// A change of the gains with the zone.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "the keys of result.json, described in the README")]
pub struct Switch {
    /// The first tick with the new gains.
    pub tick: u64,
    /// Number of the zone along the path, and name of its manoeuvre.
    pub zone: u32,
    pub name: String,
    pub gains: Gains,
}

impl Validation {
    /// The rows of a plan; those of the paper's table where it names none.
    pub fn new(config: &RunConfig, plan: &SweepPlan) -> Self {
        let mut rows = plan.sets.clone();
        if rows.is_empty() {
            rows.extend(config.paper_rows().map(|row| row.gains.clone()));
        }
        Self { config: config.clone(), rows, repeats: plan.repeats.into() }
    }

    /// The drives: row by row, first without noise, then with the noise seeds 1, 2, …. The row that the paper
    /// chose is recorded, or the first one where it is not among them.
    pub fn drives(&self) -> Vec<PlannedDrive> {
        let chosen = self.rows.iter().position(|row| self.paper(row).is_some_and(|it| it.chosen));
        let shown = chosen.unwrap_or_default();
        let name = if chosen.is_some() { "paper" } else { "first" };
        let mut drives = Vec::new();
        for (index, row) in self.rows.iter().enumerate() {
            let by_zone = if row.len() == 1 { row.clone() } else { self.config.gains_by_zone(row) };
            for seed in std::iter::once(None).chain((1..=self.repeats).map(Some)) {
                let record = match seed {
                    None => Some(format!("{name}_noise_free")),
                    Some(1) => Some(format!("{name}_noisy")),
                    Some(_) => None,
                };
                drives.push(PlannedDrive {
                    by_zone: by_zone.clone(),
                    seed,
                    record: record.filter(|_| index == shown),
                });
            }
        }
        drives
    }

    /// Whether drive number `index` is without noise, and whose: the row's number.
    pub fn noise_free_row(&self, index: usize) -> Option<usize> {
        let drives_of_row = self.repeats as usize + 1;
        index.is_multiple_of(drives_of_row).then_some(index / drives_of_row)
    }

    /// Rows of the table.
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// Whether there is no row.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// What the reports of [`Validation::drives`] come to; `switches` are those of each row.
    pub fn outcome(&self, reports: &[DriveReport], switches: &[Vec<Switch>]) -> ValidationOutcome {
        let rows: Vec<RowOutcome> = self
            .rows
            .iter()
            .zip(reports.chunks(self.repeats as usize + 1))
            .zip(switches)
            .map(|((gains, reports), switches)| self.row(gains, reports, switches))
            .collect();
        let logs: Vec<f64> = rows
            .iter()
            .flat_map(|row| [row.noise_free.factor, row.noisy.factor])
            .flatten()
            .map(libm::log)
            .collect();
        let square = logs.iter().map(|log| log * log).sum::<f64>() / logs.len() as f64;
        ValidationOutcome {
            digest: digest_of_reports(reports),
            repeats: self.repeats,
            rms_factor: (!logs.is_empty()).then(|| libm::exp(square.sqrt())),
            rows,
            drives_recorded: Vec::new(),
        }
    }

    fn row(&self, gains: &[Gains], reports: &[DriveReport], switches: &[Switch]) -> RowOutcome {
        let paper = self.paper(gains);
        let (plain, noisy) = reports.split_first().expect("each row has a drive without noise");
        let mse = |report: &DriveReport| report.along_mse_m2 + report.cross_mse_m2;
        let collided = |report: &DriveReport| u32::from(report.reason == DriveReport::COLLISION);
        let weight = self.config.learning.heading_weight;
        let distance =
            tracking::state_distance(plain.mean_abs_cross_m, plain.mean_abs_heading_rad, weight);
        let factor = |ours: f64, paper: Option<f64>| paper.map(|it| (ours / it).max(it / ours));
        let noisy_mse: Vec<f64> = noisy.iter().map(mse).collect();
        let Estimate { mean, low, high } = Estimate::of(&noisy_mse);
        let worst = noisy_mse.iter().copied().fold(0.0, f64::max);
        let (plain_paper, noisy_paper) =
            (paper.map(|row| row.mse_m2), paper.map(|row| row.noisy_mse_m2));
        RowOutcome {
            gains: gains.to_vec(),
            chosen_by_paper: paper.is_some_and(|row| row.chosen),
            noise_free: NoiseFree {
                mse_m2: mse(plain),
                along_m2: plain.along_mse_m2,
                cross_m2: plain.cross_mse_m2,
                distance,
                max_cross_track_m: plain.max_abs_cross_m,
                steering_limited: plain.steering_limited_ticks as f64 / plain.ticks.max(1) as f64,
                collisions: collided(plain),
                driven: plain.ticks as f64 / self.config.ticks() as f64,
                paper_mse_m2: plain_paper,
                factor: factor(mse(plain), plain_paper),
            },
            noisy: Noisy {
                mse_m2_mean: mean,
                mse_m2_low: low,
                mse_m2_high: high,
                mse_m2_worst: worst,
                collisions: noisy.iter().map(collided).sum(),
                paper_mse_m2: noisy_paper,
                factor: factor(worst, noisy_paper),
            },
            switches: switches.to_vec(),
        }
    }

    /// The paper's row with these gains.
    fn paper(&self, gains: &[Gains]) -> Option<&PaperSet> {
        self.config.paper_rows().find(|row| row.gains == gains)
    }
}
