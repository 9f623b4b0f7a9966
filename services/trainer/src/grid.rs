//! Every set of the grid: the best of them, how flat the optimum is, and which parameter matters.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use anyhow::{Context, Result};
use config::{ConfigError, OverBy, Parameters, RunConfig, SweepPlan};
use outcome::{
    Flatness, GridResult, MainEffect, Measures, NamedSet, PlantCheck, RankedSet, ValueMean,
};
use tracking::DriveRecord;

use crate::Ranking;
use crate::digest::digest_of_drives;
use crate::over::{Judge, Purpose};
use crate::plants::{ALTERNATIVES, check};
use crate::ranking::of_plants;
use crate::result::on_bound;
use crate::statistics::mean;
use crate::sweep::PlannedDrive;
use crate::wire::Driven;

/// Name of the file with a row for each set.
pub const GRID_FILE: &str = "grid.csv";

/// What a sweep of the grid drives, and how its reports become a result.
#[derive(Debug, Clone)]
pub struct GridSweep {
    config: RunConfig,
    /// Sets to rank among those of the grid, each with its name.
    named: Vec<(&'static str, Parameters)>,
    /// Whether our simulator drives them: then the best of them is driven on plausible plants.
    simulated: bool,
}

/// Length of each list of the best sets.
const BEST: usize = 10;

/// One measure of a drive.
type Measure = fn(&Measures) -> f64;
const VALUE: Measure = |it| it.value;
const DISTANCE: Measure = |it| it.distance;
const MSE: Measure = |it| it.mse_m2;
const PATH: Measure = |it| it.path_mean_m;

impl GridSweep {
    /// The grid of a configuration, the paper's set, and the sets of a plan.
    ///
    /// # Errors
    /// If the plan's sets are not of the configuration's law.
    pub fn new(config: &RunConfig, plan: &SweepPlan, simulated: bool) -> Result<Self, ConfigError> {
        let paper = config.paper_set().map(|set| ("paper", set));
        let sets = plan.parameters(&config.law)?;
        let yours = sets.iter().map(|sets| ("yours", sets[0]));
        Ok(Self {
            config: config.clone(),
            named: paper.into_iter().chain(yours).collect(),
            simulated,
        })
    }

    /// The drives: every set of the grid in its order, then the named ones; over plants, plant by plant for each of them.
    pub fn drives(&self) -> Vec<PlannedDrive> {
        let grid = self.config.grid();
        let of_grid = grid.positions().map(|position| grid.set(position));
        let named = self.named.iter().map(|(_, set)| *set);
        of_grid.chain(named).flat_map(|set| self.drives_of(set)).collect()
    }

    /// The drives of one set.
    fn drives_of(&self, set: Parameters) -> impl Iterator<Item = PlannedDrive> {
        let config = &self.config;
        let (of_plant, is_nominal) = (config.drives_of_plant(), config.over.by == OverBy::Nominal);
        (0..config.drives_of_step()).map(move |drive| PlannedDrive {
            by_zone: vec![set],
            seed: config.is_noisy_over_plants().then(|| Purpose::Training.seed(config, drive)),
            plant: if is_nominal { 0 } else { (drive / of_plant) as u32 + 1 },
            record: None,
        })
    }

    /// The result of [`GridSweep::drives`], as far as they were made; writes `grid.csv` into the run's folder.
    ///
    /// # Errors
    /// If that file cannot be written.
    pub fn finish(&self, folder: &Path, driven: &[Option<Driven>]) -> Result<GridResult> {
        let judge = Judge::new(&self.config, of_plants(&self.config));
        // A set counts once all of its drives were made.
        let together = |drives: &[Option<Driven>]| {
            let all: Option<Vec<DriveRecord>> =
                drives.iter().map(|it| it.as_ref().map(|it| it.record)).collect();
            all.map(|all| judge.together(&all))
        };
        let of_sets: Vec<Option<DriveRecord>> =
            driven.chunks(self.config.drives_of_step()).map(together).collect();
        let (records, of_named) = of_sets.split_at(self.config.grid().len());
        let ranking = Ranking::of_some(&self.config, records);
        let size = records.iter().flatten().count();
        let path = folder.join(GRID_FILE);
        self.write(&path, &ranking).with_context(|| format!("failed to write {path:?}"))?;
        let measures = ranking.measures();
        let law = &self.config.law;
        Ok(GridResult {
            digest: digest_of_drives(
                &driven.iter().flatten().copied().collect::<Vec<_>>(),
                law.count(),
            ),
            size,
            best: self.best(&ranking, [VALUE, MSE]),
            best_by_distance: self.best(&ranking, [DISTANCE, MSE]),
            best_by_mse: self.best(&ranking, [MSE, DISTANCE]),
            best_by_path: self.best(&ranking, [PATH, MSE]),
            sets: self
                .named
                .iter()
                .zip(of_named)
                .filter_map(|((name, set), drive)| {
                    let set = self.ranked(&ranking, set, drive.as_ref()?);
                    Some(NamedSet { name: (*name).to_owned(), set })
                })
                .collect(),
            flatness: [0.01, 0.02, 0.05, 0.1, 0.2]
                .map(|share| Flatness {
                    within: share,
                    sets_by_value: within(measures, VALUE, share),
                    sets_by_distance: within(measures, DISTANCE, share),
                    sets_by_mse: within(measures, MSE, share),
                    sets_by_path: within(measures, PATH, share),
                })
                .to_vec(),
            // Only in a whole grid does each value of a parameter occur with all values of the others.
            plants: self.plants(&ranking),
            main_effects: if size == ranking.len() {
                main_effects(&self.config, measures)
            } else {
                BTreeMap::new()
            },
        })
    }

    /// The best sets by the first measure; ties go to the second, then to the lower number.
    fn best(&self, ranking: &Ranking, by: [Measure; 2]) -> Vec<RankedSet> {
        let best = self.order(ranking, by).into_iter().take(BEST);
        best.map(|set| self.ranked(ranking, &set, &ranking.drive(&set))).collect()
    }

    /// The sets that were driven, the best by the first measure first.
    fn order(&self, ranking: &Ranking, by: [Measure; 2]) -> Vec<Parameters> {
        let (grid, measures) = (ranking.grid(), ranking.measures());
        let mut order: Vec<usize> =
            (0..measures.len()).filter(|set| was_driven(&measures[*set])).collect();
        order.sort_by(|&a, &b| {
            let compared = by.map(|by| by(&measures[a]).total_cmp(&by(&measures[b])));
            compared[0].then(compared[1]).then(a.cmp(&b))
        });
        order.into_iter().map(|index| grid.set(grid.position(index))).collect()
    }

    /// What the best set does on plausible plants, beside those that are nominally about as good.
    fn plants(&self, ranking: &Ranking) -> Option<Box<PlantCheck>> {
        let mut near = self.order(ranking, [VALUE, MSE]);
        near.truncate(ALTERNATIVES);
        let best = *near.first().filter(|_| self.simulated)?;
        Some(Box::new(check(&self.config, ranking.objective(), &best, near)))
    }

    fn ranked(&self, ranking: &Ranking, set: &Parameters, drive: &DriveRecord) -> RankedSet {
        let measures = ranking.measures_of(drive);
        RankedSet {
            gains: self.config.law.named(set),
            measures,
            off_grid: ranking.is_off_grid(set),
            rank_value: ranking.rank_by(VALUE, &measures),
            rank_distance: ranking.rank_by(DISTANCE, &measures),
            rank_mse: ranking.rank_by(MSE, &measures),
            rank_path: ranking.rank_by(PATH, &measures),
            on_bound: on_bound(&self.config, set),
        }
    }

    /// A row for each set: its parameters, its measures by every objective, whether its drive arrived.
    fn write(&self, path: &Path, ranking: &Ranking) -> Result<()> {
        let part = path.with_extension("part");
        let mut writer = csv::Writer::from_path(&part)?;
        let measures = ["value", "distance", "mse_m2", "path_mean_m", "path_p95_m", "path_max_m"];
        writer.write_record(self.config.law.keys().chain(measures).chain(["arrived"]))?;
        let grid = ranking.grid();
        let driven = grid.positions().zip(ranking.measures()).filter(|(_, it)| was_driven(it));
        for (position, it) in driven {
            let set = grid.set(position);
            let measures =
                [it.value, it.distance, it.mse_m2, it.path_mean_m, it.path_p95_m, it.path_max_m];
            let numbers = self.config.law.values(&set).iter().chain(&measures);
            let row = numbers.map(f64::to_string).chain([it.arrived.to_string()]);
            writer.write_record(row)?;
        }
        writer.flush()?;
        drop(writer);
        Ok(fs::rename(part, path)?)
    }
}

/// Whether the set with these measures was driven.
fn was_driven(measures: &Measures) -> bool {
    measures.path_mean_m.is_finite()
}

/// Number of sets that exceed the best value by at most this share of it.
fn within(measures: &[Measures], by: Measure, share: f64) -> usize {
    let least = measures.iter().map(by).fold(f64::INFINITY, f64::min);
    measures.iter().filter(|it| by(it) <= (1.0 + share) * least).count()
}

fn main_effects(config: &RunConfig, measures: &[Measures]) -> BTreeMap<String, MainEffect> {
    config
        .law
        .keys()
        .enumerate()
        .map(|(axis, key)| (key.to_owned(), main_effect(config, axis, measures)))
        .collect()
}

fn main_effect(config: &RunConfig, axis: usize, measures: &[Measures]) -> MainEffect {
    let grid = config.grid();
    let values = grid.axes()[axis];
    let of_value = |by: Measure, place: usize| -> f64 {
        let sets = (0..grid.len()).filter(|set| grid.position(*set).0[axis] as usize == place);
        mean(&sets.map(|set| by(&measures[set])).collect::<Vec<_>>())
    };
    let means =
        |by: Measure| -> Vec<f64> { (0..values.len()).map(|place| of_value(by, place)).collect() };
    let share = |by: Measure, means: &[f64]| {
        let all: Vec<f64> = measures.iter().map(by).collect();
        let whole = mean(&all);
        let spread = |values: &[f64]| {
            mean(&values.iter().map(|it| (it - whole) * (it - whole)).collect::<Vec<_>>())
        };
        let total = spread(&all);
        // Each value of a parameter occurs in the same number of sets.
        if total > 0.0 { spread(means) / total } else { 0.0 }
    };
    let (of_value, of_distance, of_mse, of_path) =
        (means(VALUE), means(DISTANCE), means(MSE), means(PATH));
    MainEffect {
        share_value: share(VALUE, &of_value),
        share_distance: share(DISTANCE, &of_distance),
        share_mse: share(MSE, &of_mse),
        share_path: share(PATH, &of_path),
        values: (0..values.len())
            .map(|place| ValueMean {
                value: values.value(place),
                mean_value: of_value[place],
                mean_distance: of_distance[place],
                mean_mse_m2: of_mse[place],
                mean_path_m: of_path[place],
            })
            .collect(),
    }
}
