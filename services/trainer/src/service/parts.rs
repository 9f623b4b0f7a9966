//! The drives of a step over several plants: asked for one by one, and one drive for the learner once all have come.
//!
//! To the rest of the pipeline each (learner, plant, drive on it) is a learner of its own. The journal holds only what the drives came to
//! together. After a restart all of them are asked for again; the orchestrator sends those that were made once more.

use std::collections::HashMap;

use config::{OverBy, RunConfig};
use ipc_types::DriveReport;
use tracking::{DriveRecord, Objective};

use crate::over::{Judge, Purpose};
use crate::tuners::Ask;

pub(super) struct Parts {
    /// With noise, there are several drives on each plant.
    of_plant: u32,
    /// The seeds of a step's drives, plant by plant: the same for all sets.
    seeds: Vec<u64>,
    /// The configured vehicle alone; a single plant is another one.
    is_nominal: bool,
    judge: Judge,
    /// By learner and step: the drives of that step, plant by plant.
    come: HashMap<(u32, u32), Vec<Option<DriveRecord>>>,
}

impl Parts {
    pub(super) fn new(config: &RunConfig, objective: Objective) -> Self {
        let seeds = 0..config.drives_of_step();
        Self {
            of_plant: config.drives_of_plant() as u32,
            seeds: seeds.map(|drive| Purpose::Training.seed(config, drive)).collect(),
            is_nominal: config.over.by == OverBy::Nominal,
            judge: Judge::new(config, objective),
            come: HashMap::new(),
        }
    }

    /// The drives that these asks still need: each with the number of its learner in the pipeline, and its plant, which is 0
    /// for the configured vehicle.
    pub(super) fn of(&self, wanted: &[Ask]) -> Vec<(Ask, u32, u32)> {
        if self.is_nominal {
            return wanted.iter().map(|ask| (*ask, ask.learner, 0)).collect();
        }
        let has_come = |ask: &Ask, drive: usize| {
            let come = self.come.get(&(ask.learner, ask.step));
            come.is_some_and(|come| come[drive].is_some())
        };
        let of_step = self.seeds.len() as u32;
        let part = |ask: &Ask, drive: u32| {
            let learner = ask.learner * of_step + drive;
            (Ask { seed: self.seeds[drive as usize], ..*ask }, learner, drive / self.of_plant + 1)
        };
        wanted
            .iter()
            .flat_map(|ask| (0..of_step).map(move |drive| (ask, drive)))
            .filter(|(ask, drive)| !has_come(ask, *drive as usize))
            .map(|(ask, drive)| part(ask, drive))
            .collect()
    }

    /// Takes a report. Returns the learner and its drive, once those of all plants have come. What no learner waits for is
    /// handed on with plant 0, for the training to refuse.
    pub(super) fn take(
        &mut self,
        wanted: &[Ask],
        report: &DriveReport,
        drive: DriveRecord,
    ) -> Option<(u32, DriveRecord)> {
        if self.is_nominal {
            return Some((report.learner, drive));
        }
        let of_step = self.seeds.len();
        let (learner, part) = (report.learner / of_step as u32, report.learner as usize % of_step);
        if !wanted.iter().any(|ask| (ask.learner, ask.step) == (learner, report.step)) {
            return Some((learner, drive));
        }
        // What was asked for before the last step is over.
        self.come.retain(|of, _| wanted.iter().any(|ask| (ask.learner, ask.step) == *of));
        let key = (learner, report.step);
        let come = self.come.entry(key).or_insert_with(|| vec![None; of_step]);
        come[part] = Some(drive);
        let all: Option<Vec<DriveRecord>> = come.iter().copied().collect();
        let together = self.judge.together(&all?);
        self.come.remove(&key);
        Some((learner, together))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::{Layers, Parameters};

    #[test]
    fn a_step_is_over_when_the_drives_of_all_plants_have_come_whatever_their_order() {
        let mut layers = Layers::maneuver("roundabout").unwrap();
        layers.set("over.by=mean").unwrap();
        let config = layers.resolve().unwrap();
        let ask = |learner, step| Ask { learner, step, parameters: Parameters::default(), seed: 0 };
        let wanted = [ask(0, 3), ask(1, 2)];
        let mut parts = Parts::new(&config, Objective::new(&config));
        let asked = parts.of(&wanted);
        assert_eq!(asked.len(), 18);
        assert!(asked.iter().all(|(ask, learner, plant)| *learner == ask.learner * 9 + plant - 1));
        let report = |learner, step| DriveReport { learner, step, ..DriveReport::default() };
        let drive = |path_mean_m| DriveRecord { path_mean_m, ..DriveRecord::default() };
        for plant in [7, 0, 3, 3, 1, 2, 6, 5, 8] {
            let part = drive(f64::from(plant));
            assert_eq!(parts.take(&wanted, &report(9 + plant, 2), part), None);
            assert_eq!(parts.take(&wanted, &report(plant, 2), part).unwrap().0, 0, "an old step");
        }
        assert_eq!(parts.of(&wanted).len(), 10);
        let (learner, together) = parts.take(&wanted, &report(13, 2), drive(4.0)).unwrap();
        assert_eq!((learner, together.path_mean_m), (1, 4.0));
        assert_eq!(parts.of(&wanted).len(), 18);
    }
}
