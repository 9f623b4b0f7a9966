//! The choice among finalists over plants, by plain calls.
//!
//! The plants of a training are few, and the same for all sets: its best set may owe its place to them, and not even arrive
//! on others like them. With noise, the same is true of that noise. The finalists are therefore told apart on plants of
//! their own, which were drawn anew, and what is told of them comes from yet other ones. A set that the pages call fragile
//! ranks behind all that are not: whoever trains over plants asks for a set that holds.

use std::sync::atomic::{AtomicUsize, Ordering};

use config::{OverBy, Parameters, PlantChange, RunConfig};
use tracking::{DriveRecord, Objective};

use super::{Finalists, Rank, Visited};
use crate::Training;
use crate::over::{Judge, Purpose, on_plant};
use crate::plants::{Plausible, choosing_plants, fresh_plants};
use crate::result::Choice;

/// How many of the finalists are to be sets that are not fragile, if so many are found
const STEADY: usize = 6;
/// among so many of the best sets.
const LOOKED_AT: usize = 200;
/// How many sets are asked at most until one of them holds on all plants that choose,
const ASKED: usize = 100;
/// so many at a time.
const TOGETHER: usize = 20;

impl Finalists {
    /// The finalists of a training over plants: if few of them hold, the best ones that do are added.
    pub(crate) fn over_plants(config: &RunConfig, training: &Training) -> Self {
        let mut finalists = Self::new(config, training);
        finalists.fresh = config.robust.fresh.into();
        let mut plausible = Plausible::new(config);
        for set in &mut finalists.sets {
            set.fragile = plausible.is_fragile(&set.parameters);
        }
        let mut steady = finalists.sets.iter().filter(|it| it.visits > 0 && !it.fragile).count();
        for set in best_first(training).take(LOOKED_AT) {
            if steady >= STEADY {
                break;
            }
            let is_known = finalists.sets.iter().any(|it| it.parameters == set.parameters);
            if !is_known && !plausible.is_fragile(&set.parameters) {
                finalists.sets.push(set);
                steady += 1;
            }
        }
        finalists
    }

    /// The set that is chosen, and how it does on plants that chose nothing. Passes its progress, as a share, to
    /// `progress`.
    ///
    /// The best sets of a training are much alike: where one of them does not arrive on a plant, none may. Then more sets
    /// are asked, the best first, and those that do better become finalists.
    pub(crate) fn choose_over_plants(
        &mut self,
        config: &RunConfig,
        training: &Training,
        progress: impl Fn(f64) + Sync,
    ) -> Choice {
        let objective = training.objective();
        let plants = choosing_plants(config);
        let mut ranks = self.ranks(config, objective, &plants, &self.sets, |it| progress(0.3 * it));
        let others: Vec<Visited> = best_first(training)
            .filter(|it| self.sets.iter().all(|known| known.parameters != it.parameters))
            .take(ASKED.saturating_sub(self.sets.len()))
            .collect();
        let mut plausible = Plausible::new(config);
        for (asked, few) in others.chunks(TOGETHER).enumerate() {
            let first = |(set, rank): (&Visited, &Rank)| {
                (set.visits > 0).then_some((rank.not_arrived, rank.fragile))
            };
            let best = self.sets.iter().zip(&ranks).filter_map(first).min();
            if !config.is_to_arrive() || best == Some((0, false)) {
                break;
            }
            let share = |it: f64| (asked as f64 + it) * TOGETHER as f64 / ASKED as f64;
            let found =
                self.ranks(config, objective, &plants, few, |it| progress(0.3 + 0.4 * share(it)));
            for (set, rank) in few.iter().zip(found) {
                // Whether it is fragile takes longer to say, and matters only then.
                if best.is_some_and(|(not_arrived, _)| rank.not_arrived > not_arrived) {
                    continue;
                }
                let fragile = plausible.is_fragile(&set.parameters);
                if best.is_none_or(|best| (rank.not_arrived, fragile) < best) {
                    self.sets.push(Visited { fragile, ..*set });
                    ranks.push(Rank { fragile, ..rank });
                }
            }
        }
        // Plants of the car, not the faster drive beside them: a value at another speed is another value.
        let mut of_car = config.clone();
        of_car.over.by = OverBy::Nominal;
        let changes = of_car.plant_changes();
        let fresh: Vec<PlantChange> =
            fresh_plants(config, &changes).take(self.fresh as usize).collect();
        let sets = parameters(&self.sets);
        let share = |it: f64| progress(0.7 + 0.3 * it);
        let told: Vec<Vec<f64>> = drives_on(config, &fresh, Purpose::Telling, &sets, share)
            .iter()
            .map(|drives| drives.iter().map(|it| objective.of(it)).collect())
            .collect();
        let values: Vec<&[f64]> = told.iter().map(Vec::as_slice).collect();
        self.chosen(config, &ranks, &values, plants.len() as u64)
    }

    /// How sets rank on plants that choose.
    fn ranks(
        &self,
        config: &RunConfig,
        objective: &Objective,
        plants: &[PlantChange],
        sets: &[Visited],
        progress: impl Fn(f64) + Sync,
    ) -> Vec<Rank> {
        let judge = Judge::new(config, *objective);
        let is_to_arrive = config.is_to_arrive();
        drives_on(config, plants, Purpose::Choosing, &parameters(sets), progress)
            .iter()
            .zip(sets)
            .map(|(drives, set)| Rank {
                not_arrived: drives.iter().filter(|it| is_to_arrive && !it.arrived()).count(),
                fragile: set.fragile,
                cost: objective.of(&judge.together(drives)),
            })
            .collect()
    }
}

fn parameters(sets: &[Visited]) -> Vec<Parameters> {
    sets.iter().map(|it| it.parameters).collect()
}

/// The sets that a training has driven, the best first.
pub(super) fn best_first(training: &Training) -> impl Iterator<Item = Visited> {
    let mut visited = training.visited();
    // Stable: ties go to the lower number in the grid.
    visited.sort_by(|a, b| a.mean_value.total_cmp(&b.mean_value));
    visited.into_iter().map(|it| Visited {
        parameters: it.parameters,
        visits: it.visits,
        fragile: false,
    })
}

/// The drives of sets on plants, set by set and plant by plant; with noise, that of the purpose. On all cores.
fn drives_on(
    config: &RunConfig,
    plants: &[PlantChange],
    purpose: Purpose,
    sets: &[Parameters],
    progress: impl Fn(f64) + Sync,
) -> Vec<Vec<DriveRecord>> {
    let next = AtomicUsize::new(0);
    let on_next = || {
        let mut driven = Vec::new();
        loop {
            let plant = next.fetch_add(1, Ordering::Relaxed);
            let Some(change) = plants.get(plant) else { return driven };
            let mut rollout = on_plant(config, change);
            let seed = config.noise.enabled.then(|| purpose.seed(config, plant));
            let of_plant: Vec<_> = sets.iter().map(|set| rollout.drive(*set, seed)).collect();
            driven.push((plant, of_plant));
            progress(plant as f64 / plants.len() as f64);
        }
    };
    let threads = std::thread::available_parallelism().map_or(1, |cores| cores.get());
    let mut driven: Vec<(usize, Vec<DriveRecord>)> = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..threads).map(|_| scope.spawn(on_next)).collect();
        workers.into_iter().flat_map(|it| it.join().expect("a rollout does not panic")).collect()
    });
    driven.sort_by_key(|(plant, _)| *plant);
    let of_set = |set: usize| driven.iter().map(|(_, drives)| drives[set]).collect();
    (0..sets.len()).map(of_set).collect()
}

#[cfg(test)]
#[path = "over_plants_tests.rs"]
mod tests;
