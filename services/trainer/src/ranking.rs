//! The exhaustive grid as a yardstick for a training: every set, driven by plain calls, or by the vehicle itself.

use std::cmp::Ordering;

use config::{Grid, OverBy, Parameters, RunConfig};
use outcome::{Measures, Spread};
use rollout::Rollout;
use tracking::{DriveRecord, Objective};

use crate::over::PlantRollouts;
use crate::own_drives::{OwnDrives, mean_of, spread_of};
use crate::training::by_values;

/// Whether the whole grid of a configuration is driven: it must take at most `ranking.max_ticks` ticks. The limit is a
/// number of ticks, not a time, because a time would depend on the machine.
pub fn grid_is_driven(config: &RunConfig) -> bool {
    let ticks = u128::from(config.ticks()) * (config.grid().len() * config.plants()) as u128;
    ticks <= u128::from(config.ranking.max_ticks)
}

/// The objective of a configuration, with the grid's drives given to it if it needs them: those of the vehicle as its file
/// has it, over plants as well, because what they come to together is judged by it.
pub fn objective_of(config: &RunConfig) -> Objective {
    let mut objective = Objective::new(config);
    if objective.needs_grid() {
        let mut rollout = Rollout::new(config);
        let grid = config.grid();
        let drives = grid.positions().map(|position| rollout.drive(grid.set(position), None));
        objective.take_grid(&drives.collect::<Vec<_>>());
    }
    objective
}

/// The objective by which drives on several plants become one; that of a single vehicle, which needs none, has not been
/// given the drives of the grid.
pub(crate) fn of_plants(config: &RunConfig) -> Objective {
    match config.over.by {
        OverBy::Nominal => Objective::new(config),
        _ => objective_of(config),
    }
}

/// The drives of every set of the grid, if the grid is driven; and the objective. They are noise-free, but over plants with
/// noise where a training has both: there the noise is the same for all sets, and none that the training has seen.
#[derive(Debug, Clone)]
pub struct Ranking {
    config: RunConfig,
    grid: Grid,
    objective: Objective,
    /// A drive of each set.
    drives: Vec<DriveRecord>,
    /// The measures of each set: of its drive, or the means of its drives.
    measures: Vec<Measures>,
    /// The drives of a vehicle that is not our simulator; `None` where a drive that is not known can be computed.
    own: Option<OwnDrives>,
}

/// The figures of a set.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Figures {
    /// Its measures, or their means over several drives.
    pub(crate) measures: Measures,
    /// How certain these means are; `None` for a single drive.
    pub(crate) spread: Option<Spread>,
}

impl Ranking {
    /// Drives the grid, if it takes few enough ticks.
    pub fn by_rollout(config: &RunConfig) -> Self {
        let grid = config.grid();
        let drives = if grid_is_driven(config) {
            let mut rollout = PlantRollouts::of_ranking(config, of_plants(config));
            grid.positions().map(|position| rollout.drive(grid.set(position), None)).collect()
        } else {
            Vec::new()
        };
        Self::of_drives(config, drives)
    }

    /// A ranking by given drives: one for each set of the grid, in its order, or none at all.
    pub(crate) fn of_drives(config: &RunConfig, drives: Vec<DriveRecord>) -> Self {
        let mut objective = of_plants(config);
        if objective.needs_grid() {
            objective.take_grid(&drives);
        }
        let weight = config.learning.heading_weight;
        let measures = drives.iter().map(|drive| measures_of(&objective, weight, drive)).collect();
        Self { config: config.clone(), grid: config.grid(), objective, drives, measures, own: None }
    }

    /// A ranking by the drives of some sets of the grid, in its order: all others are worse.
    pub(crate) fn of_some(config: &RunConfig, drives: &[Option<DriveRecord>]) -> Self {
        let mut ranking = Self::of_drives(config, drives.iter().flatten().copied().collect());
        let mut measures = ranking.measures.into_iter();
        let each = drives.iter().map(|drive| drive.and_then(|_| measures.next()));
        ranking.measures = each.map(|it| it.unwrap_or(NOT_DRIVEN)).collect();
        ranking.drives = drives.iter().map(|drive| drive.unwrap_or_default()).collect();
        ranking
    }

    /// A ranking by the drives of a vehicle that is not our simulator: of all sets of the grid, or without ranks.
    pub(crate) fn of_vehicle(config: &RunConfig, own: OwnDrives) -> Self {
        let grid = config.grid();
        let first = |set: Parameters| own.of(&set).first().copied();
        let drives: Option<Vec<DriveRecord>> =
            grid.positions().map(|position| first(grid.set(position))).collect();
        let mut ranking = Self::of_drives(config, drives.unwrap_or_default());
        ranking.own = Some(own);
        let figures = |index| ranking.figures(&grid.set(grid.position(index)));
        let of_grid = (0..ranking.len()).map(|index| figures(index).expect("just driven").measures);
        ranking.measures = of_grid.collect();
        ranking
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

    /// Number of a set in the grid, unless it lies between the sets of the grid.
    fn index_of(&self, parameters: &Parameters) -> Option<usize> {
        let position = self.grid.find(parameters)?;
        (self.grid.set(position) == *parameters).then(|| self.grid.index(position))
    }

    /// Whether a set lies between the sets of the grid.
    pub(crate) fn is_off_grid(&self, parameters: &Parameters) -> bool {
        self.index_of(parameters).is_none()
    }

    /// The drive of a set; it is computed now if it was not driven before.
    ///
    /// # Panics
    /// If the drives are those of a vehicle that is not our simulator, and it has not driven this set.
    pub fn drive(&self, parameters: &Parameters) -> DriveRecord {
        let of_grid = self.index_of(parameters).and_then(|index| self.drives.get(index));
        of_grid.copied().unwrap_or_else(|| match &self.own {
            Some(own) => own.of(parameters)[0],
            None => {
                PlantRollouts::of_ranking(&self.config, self.objective).drive(*parameters, None)
            }
        })
    }

    /// The figures of a set; `None` if a vehicle that is not our simulator has not driven it.
    pub(crate) fn figures(&self, parameters: &Parameters) -> Option<Figures> {
        let Some(own) = &self.own else {
            return Some(Figures {
                measures: self.measures_of(&self.drive(parameters)),
                spread: None,
            });
        };
        let all: Vec<Measures> = own.of(parameters).iter().map(|it| self.measures_of(it)).collect();
        (!all.is_empty()).then(|| Figures { measures: mean_of(&all), spread: spread_of(&all) })
    }

    /// The measures of a drive.
    pub fn measures_of(&self, drive: &DriveRecord) -> Measures {
        measures_of(&self.objective, self.config.learning.heading_weight, drive)
    }

    /// The measures of every set of the grid, in its order.
    pub fn measures(&self) -> &[Measures] {
        &self.measures
    }

    /// Rank by one measure: 1 + the number of sets of the grid that are strictly better.
    pub fn rank_by(&self, measure: impl Fn(&Measures) -> f64, of: &Measures) -> usize {
        let own = measure(of);
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

/// The measures of a set that was not driven.
const NOT_DRIVEN: Measures = Measures {
    value: f64::INFINITY,
    distance: f64::INFINITY,
    mse_m2: f64::INFINITY,
    path_mean_m: f64::INFINITY,
    path_p95_m: f64::INFINITY,
    path_max_m: f64::INFINITY,
    steering_travel_radps: f64::INFINITY,
    steering_rate_p95_radps: f64::INFINITY,
    lateral_acceleration_p95_mps2: f64::INFINITY,
    lateral_acceleration_max_mps2: f64::INFINITY,
    lateral_jerk_p95_mps3: f64::INFINITY,
    lateral_jerk_max_mps3: f64::INFINITY,
    progress_in_time: 0.0,
    arrived: false,
};

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
        steering_travel_radps: drive.steering_travel_radps,
        steering_rate_p95_radps: drive.steering_rate_p95_radps,
        lateral_acceleration_p95_mps2: drive.lateral_acceleration_p95_mps2,
        lateral_acceleration_max_mps2: drive.lateral_acceleration_max_mps2,
        lateral_jerk_p95_mps3: drive.lateral_jerk_p95_mps3,
        lateral_jerk_max_mps3: drive.lateral_jerk_max_mps3,
        progress_in_time: drive.progress_in_time,
        arrived: drive.arrived(),
    }
}
