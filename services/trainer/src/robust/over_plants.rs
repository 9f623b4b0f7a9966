//! The choice among finalists over plants with noise, by plain calls.
//!
//! The noise of the training is the same for all sets, so its best set may owe its place to that noise. The finalists are
//! therefore driven on the same plants with other noise, which chooses; and what is told of them comes from plants that
//! were drawn anew, each with a noise of its own.

use config::{Over, OverBy, RunConfig};
use tracking::Objective;

use super::Finalists;
use crate::over::{PlantRollouts, Purpose, on_plant};
use crate::plants::fresh_plants;
use crate::result::Choice;

impl Finalists {
    /// The set that is chosen, and how it does on plants that chose nothing. Passes its progress, as a share, to
    /// `progress`.
    pub(crate) fn choose_over_plants(
        &self,
        config: &RunConfig,
        objective: &Objective,
        progress: impl Fn(f64),
    ) -> Choice {
        let repeats = self.repeats as usize;
        let mut choosing = PlantRollouts::with(config, Purpose::Choosing, repeats);
        let mut costs = Vec::with_capacity(self.sets.len());
        for (place, set) in self.sets.iter().enumerate() {
            costs.push(objective.of(&choosing.drive(set.parameters, None)));
            progress(place as f64 / self.sets.len() as f64);
        }
        // Plants of the car, not the faster drive beside them: a value at another speed is another value.
        let mut of_car = config.clone();
        of_car.over = Over { by: OverBy::Nominal, ..config.over.clone() };
        let mut told = vec![Vec::new(); self.sets.len()];
        let changes = of_car.plant_changes();
        let plants = fresh_plants(config, &changes).take(self.fresh as usize);
        for (number, plant) in plants.enumerate() {
            let mut rollout = on_plant(config, &plant);
            let seed = Purpose::Telling.seed(config, number);
            for (set, values) in self.sets.iter().zip(&mut told) {
                values.push(objective.of(&rollout.drive(set.parameters, Some(seed))));
            }
        }
        let values: Vec<&[f64]> = told.iter().map(Vec::as_slice).collect();
        self.chosen(config, &costs, &values, self.repeats * config.plants() as u64)
    }
}
