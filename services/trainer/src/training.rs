//! All learners of a run, and the memory of drives that they share.

use std::collections::HashMap;

use config::{GridPosition, RunConfig};
use rollout::Rollout;

use crate::Ranking;
use crate::learner::{DriveRecord, Learner};
use crate::rng::drive_seed;

/// A drive that a learner waits for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Wanted {
    /// The learner.
    pub learner: u32,
    /// Its step.
    pub step: u32,
    /// The gain set.
    pub position: GridPosition,
    /// Seed of the noise.
    pub seed: u64,
}

/// A drive that a learner took.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Step {
    /// What it had waited for.
    pub wanted: Wanted,
    /// What it got.
    pub drive: DriveRecord,
    /// Whether the drive was remembered rather than driven.
    pub remembered: bool,
}

/// All learners of a run.
#[derive(Debug, Clone)]
pub struct Training {
    learners: Vec<Learner>,
    run_seed: u64,
    noise: bool,
    memory: Option<HashMap<Key, DriveRecord>>,
}

/// What makes two drives of one configuration the same: the gains, and where there is noise, its seed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
struct Key(GridPosition, Option<u64>);

impl Training {
    /// A training at its first step: one learner for each learning rate.
    pub fn new(config: &RunConfig) -> Self {
        let learners = (0..)
            .zip(&config.run.alphas)
            .map(|(number, alpha)| Learner::new(config, number, *alpha))
            .collect();
        Self {
            learners,
            run_seed: config.run.seed,
            noise: config.noise.enabled,
            memory: config.run.memo.then(HashMap::new),
        }
    }

    /// The learners, in order.
    pub fn learners(&self) -> &[Learner] {
        &self.learners
    }

    /// Whether every learner has finished.
    pub fn is_finished(&self) -> bool {
        self.learners.iter().all(Learner::is_finished)
    }

    /// Answers from memory what can be, at most so many steps of it; shows each step to `each`. Whether every
    /// learner now waits for a drive or has finished.
    pub fn remember(&mut self, at_most: usize, mut each: impl FnMut(&Step)) -> bool {
        let mut steps = 0;
        for learner in 0..self.learners.len() {
            while let Some(wanted) = self.wanted_by(learner) {
                let key = self.key(wanted);
                let Some(drive) = self.memory.as_ref().and_then(|memory| memory.get(&key)).copied()
                else {
                    break;
                };
                if steps == at_most {
                    return false;
                }
                steps += 1;
                each(&Step { wanted, drive, remembered: true });
                self.learners[learner].learn(&drive);
            }
        }
        true
    }

    /// The drives that are waited for: with memory, the same drive only once.
    pub fn wanted(&self) -> Vec<Wanted> {
        let mut wanted: Vec<Wanted> =
            (0..self.learners.len()).filter_map(|learner| self.wanted_by(learner)).collect();
        if self.memory.is_some() {
            let mut seen = Vec::with_capacity(wanted.len());
            wanted.retain(|wanted| {
                let key = self.key(*wanted);
                let new = !seen.contains(&key);
                seen.push(key);
                new
            });
        }
        wanted
    }

    /// Hands a drive to the learner that waits for it. Returns the step, or none if nobody waits for that
    /// drive (any more).
    pub fn take(&mut self, learner: u32, step: u32, drive: DriveRecord) -> Option<Step> {
        let wanted = self.wanted_by(learner as usize).filter(|wanted| wanted.step == step)?;
        let key = self.key(wanted);
        if let Some(memory) = &mut self.memory {
            memory.insert(key, drive);
        }
        self.learners[learner as usize].learn(&drive);
        Some(Step { wanted, drive, remembered: false })
    }

    fn wanted_by(&self, learner: usize) -> Option<Wanted> {
        let (step, position) = self.learners.get(learner)?.wanted()?;
        let learner = learner as u32;
        Some(Wanted { learner, step, position, seed: drive_seed(self.run_seed, learner, step) })
    }

    fn key(&self, wanted: Wanted) -> Key {
        Key(wanted.position, self.noise.then_some(wanted.seed))
    }
}

/// The gain set that most learners picked; ties go to the lower distance, then the lower mse, then the lower
/// number in the grid.
pub fn vote(learners: &[Learner], ranking: &Ranking) -> GridPosition {
    vote_by(learners, |a, b| ranking.compare(a, b))
}

/// The gain set that most learners picked; ties go to what `compare` puts first.
pub(crate) fn vote_by(
    learners: &[Learner],
    compare: impl Fn(GridPosition, GridPosition) -> std::cmp::Ordering,
) -> GridPosition {
    let picks: Vec<GridPosition> = learners.iter().map(Learner::pick).collect();
    let votes = |set: GridPosition| picks.iter().filter(|pick| **pick == set).count();
    picks
        .iter()
        .copied()
        .min_by(|a, b| votes(*b).cmp(&votes(*a)).then_with(|| compare(*a, *b)))
        .expect("a training has at least one learner")
}

/// A whole training without a pipeline, each drive answered by `drive`.
pub fn train_offline(
    config: &RunConfig,
    mut drive: impl FnMut(&Wanted) -> DriveRecord,
) -> Training {
    let mut training = Training::new(config);
    loop {
        training.remember(usize::MAX, |_| {});
        let wanted = training.wanted();
        if wanted.is_empty() {
            return training;
        }
        for wanted in wanted {
            let drive = drive(&wanted);
            training.take(wanted.learner, wanted.step, drive);
        }
    }
}

/// A whole training by plain calls: no process, no shared memory. The oracle of the pipeline.
pub fn train_by_rollout(config: &RunConfig) -> Training {
    let mut rollout = Rollout::new(config);
    train_offline(config, |wanted| {
        let noise = config.noise.enabled.then_some(wanted.seed);
        rollout.drive(config.grid.gains(wanted.position), noise).into()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::digest::digest;
    use config::{Layers, Tuner};

    fn config(maneuver: &str, sets: &[&str]) -> RunConfig {
        let mut layers = Layers::maneuver(maneuver).unwrap();
        for set in sets {
            layers.set(set).unwrap();
        }
        layers.resolve().unwrap()
    }

    #[test]
    fn memory_changes_nothing_that_is_learnt() {
        let short = ["learning.episodes=4", "learning.step_limit=10"];
        let with = train_by_rollout(&config("lane_change", &short));
        let without =
            train_by_rollout(&config("lane_change", &[short[0], short[1], "run.memo=false"]));
        assert_eq!(digest(&with), digest(&without));
        let noisy = [short[0], short[1], "noise.enabled=true"];
        assert_ne!(digest(&with), digest(&train_by_rollout(&config("lane_change", &noisy))));
    }

    #[test]
    fn seeds_and_alphas_change_the_digest() {
        let of = |sets: &[&str]| {
            let mut all = vec!["learning.episodes=2", "learning.step_limit=5"];
            all.extend(sets);
            digest(&train_by_rollout(&config("lane_change", &all)))
        };
        assert_eq!(of(&[]), of(&["run.fleet=2"]));
        assert_ne!(of(&[]), of(&["run.seed=2"]));
        assert_ne!(of(&["run.alphas=[0.1]"]), of(&["run.alphas=[0.2]"]));
    }

    /// Share of seeds 1–20 whose voted gains lie in the best 1 % of the grid by distance.
    fn seeds_in_best_percent(maneuver: &str, tuner: Tuner) -> usize {
        let mut config = config(maneuver, &[]);
        config.learning.tuner = tuner;
        let ranking = Ranking::by_rollout(&config);
        let best = ranking.len() / 100;
        (1..=20)
            .filter(|seed| {
                config.run.seed = *seed;
                let training = train_offline(&config, |wanted| *ranking.drive(wanted.position));
                let rank = ranking.rank_distance(vote(training.learners(), &ranking));
                println!("{maneuver} {tuner:?} seed {seed}: rank {rank} of {}", ranking.len());
                rank <= best
            })
            .count()
    }

    #[test]
    fn the_vote_lands_in_the_best_percent_of_the_grid() {
        for maneuver in ["lane_change", "roundabout"] {
            let educated = seeds_in_best_percent(maneuver, Tuner::EducatedQ);
            let plain = seeds_in_best_percent(maneuver, Tuner::Q);
            println!("{maneuver}: educated {educated}/20, plain Q-learning {plain}/20");
            assert!(educated >= 18, "{maneuver}: {educated} of 20 seeds");
        }
    }
}
