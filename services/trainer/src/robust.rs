//! The choice by means instead of single drives: under noise, and with a vehicle that does not repeat itself.
//!
//! One such drive says little about a set. So the sets whose drives in the training have the best mean are driven again,
//! each with the same noise seeds if there is noise, and the set with the best mean of these drives is chosen. A mean that
//! was chosen for being the best is too good. Under noise, therefore, what is told of the sets comes from further drives,
//! which chose nothing: means, intervals, and the differences between drives with the same seed.
//!
//! Over plants the finalists are driven again on other plants, see `over_plants`.

mod over_plants;

use config::{Parameters, RunConfig};
use outcome::{Comparison, Finalist, NoiseChoice};
use rollout::Rollout;
use tracking::{DriveRecord, Objective};

use crate::Training;
use crate::result::Choice;
use crate::rng::drive_seed;
use crate::statistics::{Estimate, mean};
use crate::sweep::PlannedDrive;
use crate::training::by_values;

/// The sets that are driven again, and how each did in the training.
#[derive(Debug, Clone, PartialEq)]
pub struct Finalists {
    sets: Vec<Visited>,
    /// The set that the tuner recommends on the basis of single drives.
    recommended: Parameters,
    paper: Option<Parameters>,
    /// Drives of a set that choose.
    repeats: u64,
    /// Drives behind them that only tell; 0 without noise, where the vehicle's time is dear and all drives tell.
    fresh: u64,
    noise: bool,
    seed: u64,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Visited {
    parameters: Parameters,
    visits: u32,
    /// Whether the set is known to be fragile; looked at over plants alone.
    fragile: bool,
}

/// By what a finalist is ranked, what counts most first.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Rank {
    /// Drives that did not arrive, on plants and where drives are to arrive.
    not_arrived: usize,
    /// Whether it is fragile: another set with which every drive arrives is preferred then.
    fragile: bool,
    /// The objective of the drives together.
    cost: f64,
}

impl Finalists {
    /// The sets of a finished training with the best mean of the objective, and after them the set that the tuner
    /// recommends and the paper's, if they are not among them.
    pub fn new(config: &RunConfig, training: &Training) -> Self {
        let best: Vec<Visited> = over_plants::best_first(training).collect();
        let mut sets: Vec<Visited> =
            best.iter().take(config.robust.finalists as usize).copied().collect();
        let recommended = training.tuner().recommend(&by_values);
        let paper = config.paper_set();
        for parameters in [Some(recommended), paper].into_iter().flatten() {
            if sets.iter().all(|set| set.parameters != parameters) {
                let known = best.iter().find(|it| it.parameters == parameters).copied();
                sets.push(known.unwrap_or(Visited { parameters, visits: 0, fragile: false }));
            }
        }
        let (repeats, noise) = (config.robust.repeats.into(), config.noise.enabled);
        let fresh = if noise { config.robust.fresh.into() } else { 0 };
        Self { sets, recommended, paper, repeats, fresh, noise, seed: config.run.seed }
    }

    /// The drives: set by set, first those that choose, then those that only tell. If there is noise, it is the same for
    /// all sets, and another one for each seed of a run.
    pub fn drives(&self) -> Vec<PlannedDrive> {
        let of_set = |set: &Visited| {
            let by_zone = vec![set.parameters];
            (0..self.repeats + self.fresh).map(move |drive| PlannedDrive {
                by_zone: by_zone.clone(),
                seed: self.noise.then(|| drive_seed(self.seed, FINALISTS, drive as u32)),
                plant: 0,
                record: None,
            })
        };
        self.sets.iter().flat_map(of_set).collect()
    }

    /// The set that is chosen by the records of [`Finalists::drives`], and how it was chosen.
    pub fn choose(
        &self,
        config: &RunConfig,
        objective: &Objective,
        records: &[DriveRecord],
    ) -> Choice {
        let all: Vec<Vec<f64>> = records
            .chunks((self.repeats + self.fresh) as usize)
            .map(|drives| drives.iter().map(|drive| objective.of(drive)).collect())
            .collect();
        let cost = |it: &Vec<f64>| mean(&it[..self.repeats as usize]);
        let ranks: Vec<Rank> =
            all.iter().map(|it| Rank { cost: cost(it), ..Rank::default() }).collect();
        // Those that tell: all of them, if no others follow.
        let told = if self.fresh > 0 { self.repeats as usize } else { 0 };
        let values: Vec<&[f64]> = all.iter().map(|it| &it[told..]).collect();
        self.chosen(config, &ranks, &values, self.repeats)
    }

    /// The set that ranks first, and what the values of drives that may have chosen nothing tell of all of them.
    fn chosen(
        &self,
        config: &RunConfig,
        ranks: &[Rank],
        values: &[&[f64]],
        choosing: u64,
    ) -> Choice {
        // Only sets that the training has visited may be chosen; the others are there for comparison.
        let mut order: Vec<usize> = (0..self.sets.len()).collect();
        let first = |index: usize| {
            let Rank { not_arrived, fragile, .. } = ranks[index];
            (self.sets[index].visits == 0, not_arrived, fragile)
        };
        order.sort_by(|&a, &b| {
            first(a).cmp(&first(b)).then(ranks[a].cost.total_cmp(&ranks[b].cost))
        });
        let chosen = order[0];
        let compare = |parameters: Parameters| {
            let other = self.sets.iter().position(|set| set.parameters == parameters)?;
            let difference = Estimate::of_difference(values[chosen], values[other]);
            Some(Comparison {
                gains: config.law.named(&parameters),
                difference: difference.mean,
                low: difference.low,
                high: difference.high,
                verdict: difference.verdict(),
            })
        };
        let by_means = NoiseChoice {
            repeats: values[chosen].len() as u64,
            choosing,
            holdout: config.robust.holdout,
            finalists: order
                .iter()
                .map(|&index| {
                    let Estimate { mean: mean_value, low, high } = Estimate::of(values[index]);
                    let Visited { parameters, visits, fragile } = self.sets[index];
                    let gains = config.law.named(&parameters);
                    let not_arrived = ranks[index].not_arrived as u64;
                    Finalist { gains, mean_value, low, high, visits, not_arrived, fragile }
                })
                .collect(),
            against_recommended: compare(self.recommended).expect("it was driven"),
            against_paper: self.paper.and_then(compare),
        };
        let parameters = self.sets[chosen].parameters;
        Choice { parameters, by_means: Some(by_means), rank_mean: None }
    }
}

/// What stands for the learner in the seeds of the finalists' noise; no learner has this number.
const FINALISTS: u32 = u32::MAX;

/// The first of the noise seeds that were not used before: far from those of the finalists (1, 2, …), and not among
/// those of a training, which are scattered over 64 bits.
const FIRST_HOLDOUT_SEED: u64 = 1_000_001;

/// Rank of a set by the mean of the objective over noise seeds that were not used before: 1 + the number of sets of the
/// grid that are strictly better. Passes its progress, as a share, to `progress`.
///
/// Drives millions of ticks, on all cores.
pub fn rank_mean(
    config: &RunConfig,
    objective: &Objective,
    parameters: &Parameters,
    progress: impl Fn(f64) + Sync,
) -> usize {
    let seeds: Vec<u64> = (FIRST_HOLDOUT_SEED..).take(config.robust.holdout as usize).collect();
    // Values are not negative: once the sum is beyond the limit, it stays there.
    let sum = |rollout: &mut Rollout, parameters: &Parameters, limit: f64| {
        let mut sum = 0.0;
        for seed in &seeds {
            sum += objective.of(&rollout.drive(*parameters, Some(*seed)));
            if sum >= limit {
                break;
            }
        }
        sum
    };
    let limit = sum(&mut Rollout::new(config), parameters, f64::INFINITY);
    let next = std::sync::atomic::AtomicUsize::new(0);
    let grid = config.grid();
    let count = grid.len();
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
                        let other = grid.set(grid.position(set));
                        better += usize::from(sum(&mut rollout, &other, limit) < limit);
                        progress(set as f64 / count as f64);
                    }
                })
            })
            .collect();
        workers.into_iter().map(|worker| worker.join().expect("a rollout does not panic")).sum()
    });
    1 + better
}
