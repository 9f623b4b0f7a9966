//! Drives of a set over several plants: how they are judged together, and the noise that they have.
//!
//! Noise over plants is the same for all sets (common random numbers): each plant has streams of its own, which depend on
//! the run's seed and on what the drives are for, and on no set. So a set is the same each time it is driven, differences
//! between sets are those of the sets, and tuners may treat the objective as one without noise. The price is that a set may
//! fit the very noise that chose it. Therefore what chooses among the finalists, what is told of the chosen one, and what
//! ranks it each have noise of their own.

use config::{OverBy, Parameters, PlantChange, RunConfig};
use rollout::Rollout;
use tracking::{DriveRecord, Objective};

use crate::rng::drive_seed;

/// What drives over plants are for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Purpose {
    /// A training learns from them.
    Training,
    /// They choose among the finalists.
    Choosing,
    /// They say what a choice is worth.
    Telling,
    /// They compare it with the grid, and with the sets of textbooks.
    Ranking,
}

impl Purpose {
    /// The seed of the noise of drive number `drive`.
    pub(crate) fn seed(self, config: &RunConfig, drive: usize) -> u64 {
        // No learner has such a number, and the finalists of a single plant have others.
        let learner = match self {
            Self::Training => u32::MAX - 2,
            Self::Choosing => u32::MAX - 3,
            Self::Telling => u32::MAX - 4,
            Self::Ranking => u32::MAX - 5,
        };
        drive_seed(config.run.seed, learner, drive as u32)
    }
}

/// Drives of a set by plain calls: of the configured vehicle, or over the plants of the configuration.
#[derive(Debug)]
pub(crate) struct PlantRollouts {
    rollouts: Vec<Rollout>,
    judge: Judge,
    /// With noise over plants the seeds of its drives, as many for each plant; otherwise none.
    seeds: Vec<u64>,
}

impl PlantRollouts {
    /// The drives of a step of a training. `objective` judges those of several plants together.
    pub(crate) fn new(config: &RunConfig, objective: Objective) -> Self {
        Self::with(config, objective, Purpose::Training, config.drives_of_plant())
    }

    /// Those by which sets are compared that a training has found: one on each plant.
    pub(crate) fn of_ranking(config: &RunConfig, objective: Objective) -> Self {
        Self::with(config, objective, Purpose::Ranking, 1)
    }

    /// Those for a purpose, so many on each plant.
    pub(crate) fn with(
        config: &RunConfig,
        objective: Objective,
        purpose: Purpose,
        repeats: usize,
    ) -> Self {
        let rollouts: Vec<Rollout> = match config.over.by {
            OverBy::Nominal => vec![Rollout::new(config)],
            _ => config.plant_changes().iter().map(|it| on_plant(config, it)).collect(),
        };
        let count = if config.is_noisy_over_plants() { repeats * rollouts.len() } else { 0 };
        let seeds = (0..count).map(|drive| purpose.seed(config, drive)).collect();
        Self { rollouts, judge: Judge::new(config, objective), seeds }
    }

    /// The drive with a set; over plants, what the drives come to together. `noise_seed` is for the configured vehicle
    /// alone: the plants have their noise already.
    pub(crate) fn drive(&mut self, set: Parameters, noise_seed: Option<u64>) -> DriveRecord {
        if self.judge.by == OverBy::Nominal {
            return self.rollouts[0].drive(set, noise_seed);
        }
        let of_each = self.seeds.len() / self.rollouts.len();
        let mut drives = Vec::with_capacity(self.seeds.len().max(self.rollouts.len()));
        for (plant, rollout) in self.rollouts.iter_mut().enumerate() {
            let seeds = &self.seeds[plant * of_each..][..of_each];
            drives.extend(seeds.iter().map(|seed| rollout.drive(set, Some(*seed))));
            if seeds.is_empty() {
                drives.push(rollout.drive(set, None));
            }
        }
        self.judge.together(&drives)
    }
}

/// The loop around a plant: what drives it believes in the vehicle's file.
pub(crate) fn on_plant(config: &RunConfig, change: &PlantChange) -> Rollout {
    Rollout::on_plant(&config.driving_plant(change), &config.with_plant(change))
}

/// How the drives of a set on several plants become one.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Judge {
    by: OverBy,
    objective: Objective,
}

impl Judge {
    /// Judges by an objective that knows all that it needs.
    pub(crate) fn new(config: &RunConfig, objective: Objective) -> Self {
        debug_assert!(config.over.by == OverBy::Nominal || !objective.needs_grid());
        Self { by: config.over.by, objective }
    }

    /// One record of drives with the same set, plant by plant in their order.
    ///
    /// # Panics
    /// If there is no drive.
    pub(crate) fn together(&self, drives: &[DriveRecord]) -> DriveRecord {
        let share = match self.by {
            OverBy::Nominal => return drives[0],
            OverBy::Mean => return self.objective.mean_of(drives),
            OverBy::P90 => 0.9,
            OverBy::Worst => 1.0,
        };
        let mut order: Vec<(f64, usize)> =
            drives.iter().enumerate().map(|(at, it)| (self.objective.of(it), at)).collect();
        order.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let rank = libm::ceil(share * drives.len() as f64) as usize;
        drives[order[rank.max(1) - 1].1]
    }
}

#[cfg(test)]
mod tests {
    use config::{Axis, Layers};

    use super::*;
    use crate::objective_of;

    #[test]
    fn the_worst_plant_is_found_by_an_objective_whose_scales_are_the_grid_s() {
        let mut layers = Layers::maneuver("lane_change").unwrap();
        layers.set("objective=weighted").unwrap();
        layers.set("over.by=worst").unwrap();
        let mut config = layers.resolve().unwrap();
        for axis in config.grid.values_mut() {
            *axis = Axis { max: axis.min + axis.step, ..*axis };
        }
        let objective = objective_of(&config);
        assert!(!objective.needs_grid());
        let set = config.paper_set().unwrap();
        let changes = config.plant_changes();
        let values: Vec<f64> = changes
            .iter()
            .map(|it| objective.of(&on_plant(&config, it).drive(set, None)))
            .collect();
        let worst = values.iter().copied().fold(0.0, f64::max);
        assert!(worst.is_finite() && values.iter().any(|it| *it < 0.9 * worst), "{values:?}");
        let together = PlantRollouts::of_ranking(&config, objective).drive(set, None);
        assert_eq!(objective.of(&together), worst);
        let ranking = crate::Ranking::by_rollout(&config);
        assert_eq!(*ranking.objective(), objective);
    }
}
