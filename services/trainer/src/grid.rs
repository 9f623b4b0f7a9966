//! Every gain set of the grid: the best of them, how flat the optimum is, and which gain matters.

use std::collections::BTreeMap;

use config::{Gains, RunConfig, SweepPlan};
use ipc_types::DriveReport;
use serde::{Deserialize, Serialize};

use crate::digest::digest_of_reports;
use crate::outcome::on_bound;
use crate::statistics::mean;
use crate::sweep::PlannedDrive;

/// What a sweep of the grid drives, and what its reports come to.
#[derive(Debug, Clone)]
pub struct GridSweep {
    config: RunConfig,
    /// Sets to be ranked among those of the grid, each with its name.
    named: Vec<(&'static str, Gains)>,
}

/// What a sweep of the grid has come to.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "the keys of result.json, described in the README")]
pub struct GridSweepOutcome {
    /// Over the reports of all drives.
    pub digest: String,
    pub size: usize,
    pub best_by_distance: Vec<RankedSet>,
    pub best_by_mse: Vec<RankedSet>,
    /// The paper's set, and those that were named.
    pub sets: Vec<NamedSet>,
    pub flatness: Vec<Flatness>,
    pub main_effects: BTreeMap<String, MainEffect>,
    /// Distance and mse of every set, in the order of the grid, the last gain running fastest.
    pub distances: Vec<f64>,
    pub mses_m2: Vec<f64>,
}

/// A gain set among all of the grid.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "the keys of result.json, described in the README")]
pub struct RankedSet {
    pub gains: Gains,
    pub distance: f64,
    pub mse_m2: f64,
    /// 1 + the number of sets of the grid that are strictly better.
    pub rank_distance: usize,
    pub rank_mse: usize,
    pub on_bound: Vec<String>,
}

/// A set that was asked for by name.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "the keys of result.json, described in the README")]
pub struct NamedSet {
    pub name: String,
    #[serde(flatten)]
    pub set: RankedSet,
}

/// How many sets lie near the best one.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "the keys of result.json, described in the README")]
pub struct Flatness {
    /// Above the best by at most this share of it.
    pub within: f64,
    pub sets_by_distance: usize,
    pub sets_by_mse: usize,
}

/// What one gain alone explains.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "the keys of result.json, described in the README")]
pub struct MainEffect {
    /// Share of the variance over the grid that the means of the gain's values explain (η²).
    pub share_distance: f64,
    pub share_mse: f64,
    pub values: Vec<ValueMean>,
}

/// Means over all sets in which a gain has one value.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "the keys of result.json, described in the README")]
pub struct ValueMean {
    pub value: f64,
    pub mean_distance: f64,
    pub mean_mse_m2: f64,
}

/// Sets of each list of the best.
const BEST: usize = 10;

impl GridSweep {
    /// The grid of a configuration, the paper's set, and the sets of a plan.
    pub fn new(config: &RunConfig, plan: &SweepPlan) -> Self {
        let paper = config.paper_gains().map(|gains| ("paper", gains));
        let yours = plan.sets.iter().map(|set| ("yours", set[0]));
        Self { config: config.clone(), named: paper.into_iter().chain(yours).collect() }
    }

    /// The drives: every set of the grid in its order, then the named ones.
    pub fn drives(&self) -> Vec<PlannedDrive> {
        let grid = self.config.grid;
        let of_grid = grid.positions().map(|position| grid.gains(position));
        let named = self.named.iter().map(|(_, gains)| *gains);
        of_grid
            .chain(named)
            .map(|gains| PlannedDrive { by_zone: vec![gains], seed: None, record: None })
            .collect()
    }

    /// What the reports of [`GridSweep::drives`] come to.
    pub fn outcome(&self, reports: &[DriveReport]) -> GridSweepOutcome {
        let grid = self.config.grid;
        let weight = self.config.learning.heading_weight;
        let distance = |report: &DriveReport| {
            let (cross_m, heading_rad) = (report.mean_abs_cross_m, report.mean_abs_heading_rad);
            tracking::state_distance(cross_m, heading_rad, weight)
        };
        let mse = |report: &DriveReport| report.along_mse_m2 + report.cross_mse_m2;
        let (of_grid, of_named) = reports.split_at(grid.len());
        let distances: Vec<f64> = of_grid.iter().map(distance).collect();
        let mses_m2: Vec<f64> = of_grid.iter().map(mse).collect();
        let rank = |all: &[f64], value: f64| 1 + all.iter().filter(|it| **it < value).count();
        let ranked = |gains: Gains, distance: f64, mse_m2: f64| RankedSet {
            gains,
            distance,
            mse_m2,
            rank_distance: rank(&distances, distance),
            rank_mse: rank(&mses_m2, mse_m2),
            on_bound: on_bound(&self.config, gains),
        };
        // Ties go to the other measure, then to the lower number.
        let best = |first: &[f64], second: &[f64]| -> Vec<RankedSet> {
            let mut order: Vec<usize> = (0..grid.len()).collect();
            order.sort_by(|&a, &b| {
                first[a].total_cmp(&first[b]).then(second[a].total_cmp(&second[b])).then(a.cmp(&b))
            });
            let sets = order.into_iter().take(BEST);
            sets.map(|it| ranked(grid.gains(grid.position(it)), distances[it], mses_m2[it]))
                .collect()
        };
        let within = |all: &[f64], share: f64| {
            let least = all.iter().copied().fold(f64::INFINITY, f64::min);
            all.iter().filter(|value| **value <= (1.0 + share) * least).count()
        };
        GridSweepOutcome {
            digest: digest_of_reports(reports),
            size: grid.len(),
            best_by_distance: best(&distances, &mses_m2),
            best_by_mse: best(&mses_m2, &distances),
            sets: self
                .named
                .iter()
                .zip(of_named)
                .map(|((name, gains), report)| NamedSet {
                    name: (*name).to_owned(),
                    set: ranked(*gains, distance(report), mse(report)),
                })
                .collect(),
            flatness: [0.01, 0.02, 0.05, 0.1, 0.2]
                .map(|share| Flatness {
                    within: share,
                    sets_by_distance: within(&distances, share),
                    sets_by_mse: within(&mses_m2, share),
                })
                .to_vec(),
            main_effects: (0..4)
                .map(|axis| {
                    let effect = main_effect(&self.config, axis, &distances, &mses_m2);
                    (Gains::NAMES[axis].to_owned(), effect)
                })
                .collect(),
            distances,
            mses_m2,
        }
    }
}

fn main_effect(config: &RunConfig, axis: usize, distances: &[f64], mses_m2: &[f64]) -> MainEffect {
    let grid = config.grid;
    let values = grid.axes()[axis];
    let of_value = |all: &[f64], place: usize| -> f64 {
        let sets = (0..grid.len()).filter(|set| grid.position(*set).0[axis] as usize == place);
        mean(&sets.map(|set| all[set]).collect::<Vec<_>>())
    };
    let means = |all: &[f64]| (0..values.len()).map(|place| of_value(all, place)).collect();
    let share = |all: &[f64], means: &[f64]| {
        let whole = mean(all);
        let spread = |values: &[f64]| {
            mean(&values.iter().map(|it| (it - whole) * (it - whole)).collect::<Vec<_>>())
        };
        let total = spread(all);
        // Each value of a gain stands in equally many sets.
        if total > 0.0 { spread(means) / total } else { 0.0 }
    };
    let (mean_distances, mean_mses): (Vec<f64>, Vec<f64>) = (means(distances), means(mses_m2));
    MainEffect {
        share_distance: share(distances, &mean_distances),
        share_mse: share(mses_m2, &mean_mses),
        values: mean_distances
            .iter()
            .zip(&mean_mses)
            .enumerate()
            .map(|(place, (mean_distance, mean_mse_m2))| ValueMean {
                value: values.value(place),
                mean_distance: *mean_distance,
                mean_mse_m2: *mean_mse_m2,
            })
            .collect(),
    }
}
