//! The result of a training.

use std::collections::BTreeMap;

use config::{Parameters, RunConfig};
use outcome::{
    Beside, Decided, GridStanding, NoiseChoice, Outcome, PlantCheck, SCHEMA, SetStanding,
    TrainResult, VehicleDrives,
};
use tracking::Objective;

use crate::baselines::{baselines, trade_off};
use crate::digest::digest;
use crate::plants::{ALTERNATIVES, check};
use crate::ranking::Figures;
use crate::training::{by_values, train_offline};
use crate::{Ranking, Training};

/// A result with the keys that begin every result.
pub(crate) fn decided(config: &RunConfig, outcome: Outcome) -> Decided {
    Decided {
        schema: SCHEMA,
        maneuver: config.maneuver.clone(),
        vehicle: config.vehicle.name.clone(),
        law: config.law.name.clone(),
        objective: config.objective.name.clone(),
        seed: config.run.seed,
        outcome,
    }
}

/// The set that a training comes to.
#[derive(Debug, Clone, PartialEq)]
pub struct Choice {
    /// The set.
    pub parameters: Parameters,
    /// How it was chosen by means; `None` if it is what the tuner recommends.
    pub by_means: Option<NoiseChoice>,
    /// Its rank by the mean over further noise seeds, if it has one.
    pub rank_mean: Option<usize>,
}

impl Choice {
    /// The set that the tuner recommends.
    pub fn recommended(parameters: Parameters) -> Self {
        Self { parameters, by_means: None, rank_mean: None }
    }
}

/// The result of a finished training, compared with the grid if that was driven. `drives` describes the drives of a
/// ranking by those of a vehicle that is not our simulator.
///
/// # Panics
/// If such a vehicle has not driven the set that was chosen.
pub fn train_result(
    config: &RunConfig,
    training: &Training,
    ranking: &Ranking,
    choice: Choice,
    drives: Option<VehicleDrives>,
) -> TrainResult {
    let Choice { parameters, by_means, rank_mean } = choice;
    let Figures { measures, spread } = ranking.figures(&parameters).expect("the choice is driven");
    TrainResult {
        tuner: config.learning.tuner.clone(),
        digest: digest(training),
        gains: config.law.named(&parameters),
        on_bound: on_bound(config, &parameters),
        measures,
        spread,
        off_grid: ranking.is_off_grid(&parameters),
        vehicle_drives: drives,
        grid: (!ranking.is_empty()).then(|| GridStanding {
            size: ranking.len(),
            rank_value: ranking.rank_by(|it| it.value, &measures),
            rank_distance: ranking.rank_by(|it| it.distance, &measures),
            rank_mse: ranking.rank_by(|it| it.mse_m2, &measures),
            rank_path: ranking.rank_by(|it| it.path_mean_m, &measures),
            rank_mean,
            best_value: ranking.best_by(|it| it.value),
            best_distance: ranking.best_by(|it| it.distance),
            best_mse_m2: ranking.best_by(|it| it.mse_m2),
            best_path_mean_m: ranking.best_by(|it| it.path_mean_m),
        }),
        paper: config.paper_set().and_then(|set| standing(config, &set, ranking)),
        plain_q: beside("q", config, ranking),
        random_walk: beside("random-walk", config, ranking),
        baselines: match drives {
            None => baselines(config, ranking.objective(), &measures),
            // It would have to be driven with other laws; our simulator's figures are no yardstick for its own.
            Some(_) => None,
        },
        // With a vehicle that is not ours, what our simulator makes of its file: the only thing that tells a fragile set.
        plants: Some(plant_check(config, training, ranking, &parameters)),
        trade_off: trade_off(config, ranking),
        predicted: match by_means {
            None => training.tuner().predicted(&parameters),
            Some(_) => None,
        },
        noise: by_means,
        could_stop_after: training.tuner().could_stop_after(),
        simulated_first: training.tuner().simulated_first(training.objective()),
        asked: training.asked_drives(),
        distinct: training.distinct_drives(),
        learners: training.tuner().story(),
        drives_recorded: Vec::new(),
        drives_lacking: BTreeMap::new(),
        laps: BTreeMap::new(),
    }
}

/// What a set does on plausible plants, beside the nominally best sets of the grid, or else of those that were visited.
fn plant_check(
    config: &RunConfig,
    training: &Training,
    ranking: &Ranking,
    set: &Parameters,
) -> PlantCheck {
    let mut near: Vec<(f64, Parameters)> = if ranking.is_empty() {
        training.visited().iter().map(|it| (it.mean_value, it.parameters)).collect()
    } else {
        let grid = ranking.grid();
        let of = |index: usize| grid.set(grid.position(index));
        ranking.measures().iter().enumerate().map(|(index, it)| (it.value, of(index))).collect()
    };
    near.sort_by(|a, b| a.0.total_cmp(&b.0).then_with(|| by_values(&a.1, &b.1)));
    near.truncate(ALTERNATIVES);
    let near: Vec<Parameters> = near.into_iter().map(|(_, set)| set).collect();
    check(config, ranking.objective(), set, near)
}

/// Names of the parameters that lie on a bound of the grid.
pub(crate) fn on_bound(config: &RunConfig, parameters: &Parameters) -> Vec<String> {
    let places = config.grid().on_bound(parameters);
    places.into_iter().map(|place| config.law.parameters[place].key.clone()).collect()
}

/// The standing of a set, without noise, among those of the grid; `None` if it was not driven.
fn standing(config: &RunConfig, parameters: &Parameters, ranking: &Ranking) -> Option<SetStanding> {
    let Figures { measures, spread } = ranking.figures(parameters)?;
    let is_driven = !ranking.is_empty();
    Some(SetStanding {
        gains: config.law.named(parameters),
        measures,
        spread,
        off_grid: ranking.is_off_grid(parameters),
        rank_value: is_driven.then(|| ranking.rank_by(|it| it.value, &measures)),
        rank_distance: is_driven.then(|| ranking.rank_by(|it| it.distance, &measures)),
        rank_mse: is_driven.then(|| ranking.rank_by(|it| it.mse_m2, &measures)),
        rank_path: is_driven.then(|| ranking.rank_by(|it| it.path_mean_m, &measures)),
    })
}

/// The same training by another tuner, without noise, on the drives of the grid.
fn beside(tuner: &str, config: &RunConfig, ranking: &Ranking) -> Option<Beside> {
    if ranking.is_empty() {
        return None;
    }
    let mut other = config.clone();
    other.learning.tuner = tuner.to_owned();
    other.noise.enabled = false;
    other.run.memo = true;
    let objective: Objective = *ranking.objective();
    let training = train_offline(&other, objective, |ask| ranking.drive(&ask.parameters));
    let set = training.tuner().recommend(&|a, b| ranking.compare(a, b));
    Some(Beside {
        set: standing(config, &set, ranking)?,
        asked: training.asked_drives(),
        distinct: training.distinct_drives(),
    })
}
