//! The result of a training.

use config::{Parameters, RunConfig};
use outcome::{
    Beside, Decided, GridStanding, NoiseChoice, Outcome, SCHEMA, SetStanding, TrainResult,
};
use tracking::Objective;

use crate::digest::digest;
use crate::training::train_offline;
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

/// The result of a finished training, compared with the grid if that was driven. Under noise the best of the finalists
/// is chosen, ranked by its mean if the grid was driven; otherwise the set that the tuner recommends.
pub fn train_result(
    config: &RunConfig,
    training: &Training,
    ranking: &Ranking,
    noise: Option<(NoiseChoice, Parameters, Option<usize>)>,
) -> TrainResult {
    let recommended = || training.tuner().recommend(&|a, b| ranking.compare(a, b));
    let (choice, parameters, rank_mean) = match noise {
        Some((choice, parameters, rank_mean)) => (Some(choice), parameters, rank_mean),
        None => (None, recommended(), None),
    };
    let drive = ranking.drive(&parameters);
    TrainResult {
        tuner: config.learning.tuner.clone(),
        digest: digest(training),
        gains: config.law.named(&parameters),
        on_bound: on_bound(config, &parameters),
        measures: ranking.measures_of(&drive),
        grid: (!ranking.is_empty()).then(|| GridStanding {
            size: ranking.len(),
            rank_value: ranking.rank_by(|it| it.value, &drive),
            rank_distance: ranking.rank_by(|it| it.distance, &drive),
            rank_mse: ranking.rank_by(|it| it.mse_m2, &drive),
            rank_path: ranking.rank_by(|it| it.path_mean_m, &drive),
            rank_mean,
            best_value: ranking.best_by(|it| it.value),
            best_distance: ranking.best_by(|it| it.distance),
            best_mse_m2: ranking.best_by(|it| it.mse_m2),
            best_path_mean_m: ranking.best_by(|it| it.path_mean_m),
        }),
        paper: config.paper_set().map(|set| standing(config, &set, ranking)),
        plain_q: beside("q", config, ranking),
        random_walk: beside("random-walk", config, ranking),
        noise: choice,
        asked: training.asked_drives(),
        distinct: training.distinct_drives(),
        learners: training.tuner().story(),
        drives_recorded: Vec::new(),
    }
}

/// Names of the parameters that lie on a bound of the grid.
pub(crate) fn on_bound(config: &RunConfig, parameters: &Parameters) -> Vec<String> {
    let places = config.grid().on_bound(parameters);
    places.into_iter().map(|place| config.law.parameters[place].key.clone()).collect()
}

/// The standing of a set, without noise, among those of the grid.
fn standing(config: &RunConfig, parameters: &Parameters, ranking: &Ranking) -> SetStanding {
    let drive = ranking.drive(parameters);
    let is_driven = !ranking.is_empty();
    SetStanding {
        gains: config.law.named(parameters),
        measures: ranking.measures_of(&drive),
        rank_value: is_driven.then(|| ranking.rank_by(|it| it.value, &drive)),
        rank_distance: is_driven.then(|| ranking.rank_by(|it| it.distance, &drive)),
        rank_mse: is_driven.then(|| ranking.rank_by(|it| it.mse_m2, &drive)),
        rank_path: is_driven.then(|| ranking.rank_by(|it| it.path_mean_m, &drive)),
    }
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
        set: standing(config, &set, ranking),
        asked: training.asked_drives(),
        distinct: training.distinct_drives(),
    })
}
