//! The exhaustive grid: every set, driven by plain calls, as a yardstick for a training.

use std::cmp::Ordering;

use config::{Grid, Parameters, RunConfig};
use outcome::Measures;
use rollout::Rollout;
use tracking::{DriveRecord, Objective};

use crate::training::by_values;

/// Whether the whole grid of a configuration is driven: it must take at most `ranking.max_ticks` ticks. The limit is a
/// number of ticks, not a time, because a time would depend on the machine.
pub fn grid_is_driven(config: &RunConfig) -> bool {
    let ticks = u128::from(config.ticks()) * config.grid().len() as u128;
    ticks <= u128::from(config.ranking.max_ticks)
}

/// The objective of a configuration, with the grid's drives given to it if it needs them.
pub fn objective_of(config: &RunConfig) -> Objective {
    let objective = Objective::new(config);
    if objective.needs_grid() { *Ranking::by_rollout(config).objective() } else { objective }
}

/// The noise-free drive of every set of the grid, if the grid is driven; and the objective.
#[derive(Debug, Clone)]
pub struct Ranking {
    config: RunConfig,
    grid: Grid,
    objective: Objective,
    drives: Vec<DriveRecord>,
    measures: Vec<Measures>,
}

impl Ranking {
    /// Drives the grid, if it takes few enough ticks.
    pub fn by_rollout(config: &RunConfig) -> Self {
        let grid = config.grid();
        let drives = if grid_is_driven(config) {
            let mut rollout = Rollout::new(config);
            grid.positions().map(|position| rollout.drive(grid.set(position), None)).collect()
        } else {
            Vec::new()
        };
        Self::of_drives(config, drives)
    }

    /// A ranking by given drives: one for each set of the grid, in its order, or none at all.
    pub(crate) fn of_drives(config: &RunConfig, drives: Vec<DriveRecord>) -> Self {
        let mut objective = Objective::new(config);
        if objective.needs_grid() {
            objective.take_grid(&drives);
        }
        let weight = config.learning.heading_weight;
        let measures = drives.iter().map(|drive| measures_of(&objective, weight, drive)).collect();
        Self { config: config.clone(), grid: config.grid(), objective, drives, measures }
    }

    /// The objective by which a drive is judged.
    pub fn objective(&self) -> &Objective {
        &self.objective
    }

    /// The grid, whether it was driven or not.
    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    /// Number of sets that were driven: those of the grid, or none.
    pub fn len(&self) -> usize {
        self.drives.len()
    }

    /// Whether the grid was not driven.
    pub fn is_empty(&self) -> bool {
        self.drives.is_empty()
    }

    /// The noise-free drive of a set; it is driven now if it was not driven before.
    pub fn drive(&self, parameters: &Parameters) -> DriveRecord {
        let of_grid = self
            .grid
            .find(parameters)
            .filter(|position| self.grid.set(*position) == *parameters)
            .and_then(|position| self.drives.get(self.grid.index(position)));
        let drive = || Rollout::new(&self.config).drive(*parameters, None);
        of_grid.copied().unwrap_or_else(drive)
    }

    /// The measures of a drive.
    pub fn measures_of(&self, drive: &DriveRecord) -> Measures {
        measures_of(&self.objective, self.config.learning.heading_weight, drive)
    }

    /// The measures of every set of the grid, in its order.
    pub fn measures(&self) -> &[Measures] {
        &self.measures
    }

    /// Rank of a drive by one measure: 1 + the number of sets of the grid that are strictly better.
    pub fn rank_by(&self, measure: impl Fn(&Measures) -> f64, drive: &DriveRecord) -> usize {
        let own = measure(&self.measures_of(drive));
        1 + self.measures.iter().filter(|it| measure(it) < own).count()
    }

    /// Least value of one measure in the grid; infinite if the grid was not driven.
    pub fn best_by(&self, measure: impl Fn(&Measures) -> f64) -> f64 {
        self.measures.iter().map(measure).fold(f64::INFINITY, f64::min)
    }

    /// Better by the objective first, then by the mse, then by the order of the grid.
    pub fn compare(&self, a: &Parameters, b: &Parameters) -> Ordering {
        let [of_a, of_b] = [a, b].map(|set| self.measures_of(&self.drive(set)));
        of_a.value
            .total_cmp(&of_b.value)
            .then(of_a.mse_m2.total_cmp(&of_b.mse_m2))
            .then_with(|| by_values(a, b))
    }
}

/// The measures of a drive.
pub(crate) fn measures_of(
    objective: &Objective,
    heading_weight: f64,
    drive: &DriveRecord,
) -> Measures {
    Measures {
        value: objective.of(drive),
        distance: drive.distance(heading_weight),
        mse_m2: drive.mse_m2(),
        path_mean_m: drive.path_mean_m,
        path_p95_m: drive.path_p95_m,
        path_max_m: drive.path_max_m,
        arrived: drive.arrived(),
    }
}
