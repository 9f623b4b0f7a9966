//! The choice under noise: by means instead of single drives.
//!
//! One noisy drive says little of a gain set. So the sets whose drives of the training have the best mean are
//! driven again, each with the same noise seeds; the best mean of those is chosen, and compared with others
//! by the differences of drives with the same seed.

use config::{Gains, RunConfig};
use ipc_types::DriveReport;
use rollout::Rollout;
use serde::{Deserialize, Serialize};

use crate::statistics::{Estimate, Verdict, mean};
use crate::sweep::PlannedDrive;
use crate::{Learner, Training, vote_by};

/// The sets that are driven again, and how each did in the training.
#[derive(Debug, Clone, PartialEq)]
pub struct Finalists {
    sets: Vec<Finalist>,
    repeats: u64,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Finalist {
    gains: Gains,
    visits: u32,
}

/// What the drives of the finalists have come to.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "the keys of result.json, described in the README")]
pub struct NoiseOutcome {
    pub repeats: u64,
    pub holdout: u32,
    /// Best mean first; the first one is chosen.
    pub finalists: Vec<FinalistOutcome>,
    /// The chosen set against the set that the learners voted for, and against the paper's.
    pub against_voted: Comparison,
    pub against_paper: Option<Comparison>,
}

/// One finalist.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "the keys of result.json, described in the README")]
pub struct FinalistOutcome {
    pub gains: Gains,
    pub mean_distance: f64,
    pub low: f64,
    pub high: f64,
    /// Drives of the training with this set.
    pub visits: u32,
}

/// The chosen set against another one, by the distances of drives with the same noise.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "the keys of result.json, described in the README")]
pub struct Comparison {
    pub gains: Gains,
    pub difference: f64,
    pub low: f64,
    pub high: f64,
    pub verdict: Verdict,
}

impl Finalists {
    /// The sets of a finished training with the best mean distance, and behind them the set that the learners
    /// voted for and the paper's, where they are not among them.
    pub fn new(config: &RunConfig, training: &Training) -> Self {
        let learners = training.learners();
        let drives_of = |set: usize| {
            learners
                .iter()
                .map(|learner| learner.drives_of(set))
                .fold((0, 0.0), |(visits, sum), (more, distances)| (visits + more, sum + distances))
        };
        let mut driven: Vec<(f64, usize, u32)> = (0..config.grid.len())
            .map(|set| (set, drives_of(set)))
            .filter(|(_, (visits, _))| *visits > 0)
            .map(|(set, (visits, sum))| (sum / f64::from(visits), set, visits))
            .collect();
        driven.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let mut sets: Vec<Finalist> = driven
            .iter()
            .take(config.robust.finalists as usize)
            .map(|(_, set, visits)| Finalist {
                gains: config.grid.gains(config.grid.position(*set)),
                visits: *visits,
            })
            .collect();
        let voted = voted(config, learners);
        for gains in [Some(voted), config.paper_gains()].into_iter().flatten() {
            if sets.iter().all(|set| set.gains != gains) {
                let position = config.grid.find(gains);
                let visits = position.map_or(0, |it| drives_of(config.grid.index(it)).0);
                sets.push(Finalist { gains, visits });
            }
        }
        Self { sets, repeats: config.robust.repeats.into() }
    }

    /// The drives that tell: set by set, each with the noise seeds 1, 2, ….
    pub fn drives(&self) -> Vec<PlannedDrive> {
        let of_set = |set: &Finalist| {
            let by_zone = vec![set.gains];
            (1..=self.repeats).map(move |seed| PlannedDrive {
                by_zone: by_zone.clone(),
                seed: Some(seed),
                record: None,
            })
        };
        self.sets.iter().flat_map(of_set).collect()
    }

    /// What the reports of [`Finalists::drives`] come to.
    pub fn outcome(
        &self,
        config: &RunConfig,
        training: &Training,
        reports: &[DriveReport],
    ) -> NoiseOutcome {
        let weight = config.learning.heading_weight;
        let distances: Vec<Vec<f64>> = reports
            .chunks(self.repeats as usize)
            .map(|drives| {
                let distance = |report: &DriveReport| {
                    let (cross_m, heading_rad) =
                        (report.mean_abs_cross_m, report.mean_abs_heading_rad);
                    tracking::state_distance(cross_m, heading_rad, weight)
                };
                drives.iter().map(distance).collect()
            })
            .collect();
        // Only what the training has visited may be chosen; the rest is there for comparison.
        let mut order: Vec<usize> = (0..self.sets.len()).collect();
        let cost = |index: usize| (self.sets[index].visits == 0, mean(&distances[index]));
        order.sort_by(|a, b| {
            let (a, b) = (cost(*a), cost(*b));
            a.0.cmp(&b.0).then(a.1.total_cmp(&b.1))
        });
        let chosen = order[0];
        let compare = |gains: Gains| {
            let other = self.sets.iter().position(|set| set.gains == gains)?;
            let difference = Estimate::of_difference(&distances[chosen], &distances[other]);
            Some(Comparison {
                gains,
                difference: difference.mean,
                low: difference.low,
                high: difference.high,
                verdict: difference.verdict(),
            })
        };
        NoiseOutcome {
            repeats: self.repeats,
            holdout: config.robust.holdout,
            finalists: order
                .iter()
                .map(|&index| {
                    let Estimate { mean, low, high } = Estimate::of(&distances[index]);
                    let Finalist { gains, visits } = self.sets[index];
                    FinalistOutcome { gains, mean_distance: mean, low, high, visits }
                })
                .collect(),
            against_voted: compare(voted(config, training.learners())).expect("it was driven"),
            against_paper: config.paper_gains().and_then(compare),
        }
    }
}

/// The set that most learners picked; ties go to the lower number in the grid.
fn voted(config: &RunConfig, learners: &[Learner]) -> Gains {
    let grid = config.grid;
    grid.gains(vote_by(learners, |a, b| grid.index(a).cmp(&grid.index(b))))
}

/// The first of the noise seeds that nobody has used: far from those of the finalists (1, 2, …), and not among
/// those of a training, which are scattered over 64 bits.
const FIRST_HOLDOUT_SEED: u64 = 1_000_001;

/// Rank of a set of the grid by its mean distance over noise seeds that nobody has used: 1 + the number of sets
/// that are strictly better. Tells its progress, a share, to `progress`.
///
/// Drives millions of ticks, on all cores.
pub fn rank_mean_distance(
    config: &RunConfig,
    gains: Gains,
    progress: impl Fn(f64) + Sync,
) -> usize {
    let seeds: Vec<u64> = (FIRST_HOLDOUT_SEED..).take(config.robust.holdout as usize).collect();
    let weight = config.learning.heading_weight;
    // Distances are not negative: once the sum is beyond the limit, it stays there.
    let sum = |rollout: &mut Rollout, gains: Gains, limit: f64| {
        let mut sum = 0.0;
        for seed in &seeds {
            sum += rollout.drive(gains, Some(*seed)).metrics.distance(weight);
            if sum >= limit {
                break;
            }
        }
        sum
    };
    let limit = sum(&mut Rollout::new(config), gains, f64::INFINITY);
    let next = std::sync::atomic::AtomicUsize::new(0);
    let count = config.grid.len();
    let threads = std::thread::available_parallelism().map_or(1, |cores| cores.get());
    let better: usize = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..threads)
            .map(|_| {
                scope.spawn(|| {
                    let mut rollout = Rollout::new(config);
                    let mut better = 0;
                    loop {
                        let set = next.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
                        if set >= count {
                            return better;
                        }
                        let other = config.grid.gains(config.grid.position(set));
                        better += usize::from(sum(&mut rollout, other, limit) < limit);
                        progress(set as f64 / count as f64);
                    }
                })
            })
            .collect();
        workers.into_iter().map(|worker| worker.join().expect("a rollout does not panic")).sum()
    });
    1 + better
}
