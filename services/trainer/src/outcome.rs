//! What a training has come to, as it is written for the orchestrator and for people.

use config::{Gains, RunConfig, Tuner};
use serde::{Deserialize, Serialize};

use crate::digest::digest;
use crate::robust::NoiseOutcome;
use crate::training::{train_offline, vote};
use crate::{Learner, Ranking, Training};

/// What a training has come to. The orchestrator adds what only it knows, and writes `result.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "the keys of result.json, described in the README")]
pub struct Outcome {
    pub digest: String,
    pub gains: Gains,
    pub on_bound: Vec<String>,
    pub distance: f64,
    pub mse_m2: f64,
    pub grid: GridOutcome,
    pub paper: Option<SetOutcome>,
    /// The same training by plain Q-learning, from the same grid.
    pub plain_q: PlainOutcome,
    /// The choice under noise; none without.
    pub noise: Option<NoiseOutcome>,
    pub asked: u64,
    pub learners: Vec<LearnerOutcome>,
    /// Drives with the tuned gains whose recordings lie in the run's folder.
    pub drives_recorded: Vec<String>,
}

/// Where the gains stand among all sets of the grid.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "the keys of result.json, described in the README")]
pub struct GridOutcome {
    pub size: usize,
    pub rank_distance: usize,
    pub rank_mse: usize,
    /// By the mean distance over noise seeds that nobody has used; none without noise.
    pub rank_mean_distance: Option<usize>,
    pub best_distance: f64,
    pub best_mse_m2: f64,
}

/// One gain set, noise-free.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "the keys of result.json, described in the README")]
pub struct SetOutcome {
    pub gains: Gains,
    pub distance: f64,
    pub mse_m2: f64,
    pub rank_distance: usize,
    pub rank_mse: usize,
}

/// The training beside: by plain Q-learning, noise-free, on the drives of the ranking.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "the keys of result.json, described in the README")]
pub struct PlainOutcome {
    #[serde(flatten)]
    pub set: SetOutcome,
    pub asked: u64,
}

/// One learner.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "the keys of result.json, described in the README")]
pub struct LearnerOutcome {
    pub alpha: f64,
    pub seed: u64,
    pub gains: Gains,
    pub locked: std::collections::BTreeMap<String, f64>,
    /// How often each value of each gain was driven.
    pub usage: std::collections::BTreeMap<String, Vec<Usage>>,
    pub episodes: Vec<EpisodeOutcome>,
}

/// How often a gain had a value.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "the keys of result.json, described in the README")]
pub struct Usage {
    pub value: f64,
    pub count: u64,
}

/// One episode.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "the keys of result.json, described in the README")]
pub struct EpisodeOutcome {
    #[serde(rename = "return")]
    pub return_: f64,
    pub steps: usize,
    pub terminated: bool,
    pub terminal_gains: Option<Gains>,
    pub rewards: Vec<f64>,
    pub distances: Vec<f64>,
}

impl Outcome {
    /// What a finished training has come to, against a whole ranking. Under noise the best of the finalists is
    /// chosen, else the set that the learners voted for.
    pub fn new(
        config: &RunConfig,
        training: &Training,
        ranking: &mut Ranking,
        noise: Option<(NoiseOutcome, usize)>,
    ) -> Self {
        let (noise, rank_mean_distance) = noise.unzip();
        let gains = match &noise {
            Some(noise) => noise.finalists[0].gains,
            None => config.grid.gains(vote(training.learners(), ranking)),
        };
        let set = SetOutcome::new(gains, ranking);
        let plain = {
            let mut plain = config.clone();
            plain.learning.tuner = Tuner::Q;
            plain.noise.enabled = false;
            plain.run.memo = true;
            train_offline(&plain, |wanted| *ranking.drive(wanted.position))
        };
        let plain_gains = config.grid.gains(vote(plain.learners(), ranking));
        Self {
            digest: digest(training),
            gains,
            on_bound: on_bound(config, gains),
            distance: set.distance,
            mse_m2: set.mse_m2,
            grid: GridOutcome {
                size: ranking.len(),
                rank_distance: set.rank_distance,
                rank_mse: set.rank_mse,
                rank_mean_distance,
                best_distance: ranking.best_distance(),
                best_mse_m2: ranking.best_mse_m2(),
            },
            paper: config.paper_gains().map(|gains| SetOutcome::new(gains, ranking)),
            plain_q: PlainOutcome {
                set: SetOutcome::new(plain_gains, ranking),
                asked: drives_taken(&plain),
            },
            noise,
            asked: drives_taken(training),
            learners: training
                .learners()
                .iter()
                .map(|learner| LearnerOutcome::new(config, learner))
                .collect(),
            drives_recorded: Vec::new(),
        }
    }
}

/// Names of the gains that lie on a bound of the grid.
pub(crate) fn on_bound(config: &RunConfig, gains: Gains) -> Vec<String> {
    let position = config.grid.find(gains);
    let names = position.map_or(Vec::new(), |position| config.grid.on_bound(position));
    names.into_iter().map(str::to_owned).collect()
}

fn drives_taken(training: &Training) -> u64 {
    training.learners().iter().map(|learner| u64::from(learner.drives_taken())).sum()
}

impl SetOutcome {
    fn new(gains: Gains, ranking: &mut Ranking) -> Self {
        let drive = ranking.drive_off_grid(gains);
        let (distance, mse_m2) = (ranking.distance_of(&drive), drive.mse_m2());
        Self {
            gains,
            distance,
            mse_m2,
            rank_distance: ranking.rank_of_distance(distance),
            rank_mse: ranking.rank_of_mse(mse_m2),
        }
    }
}

impl LearnerOutcome {
    fn new(config: &RunConfig, learner: &Learner) -> Self {
        let axes = config.grid.axes();
        let locked = learner
            .locked()
            .iter()
            .enumerate()
            .filter_map(|(axis, place)| {
                let value = axes[axis].value((*place)? as usize);
                Some((Gains::NAMES[axis].to_owned(), value))
            })
            .collect();
        let episodes = learner
            .episodes()
            .iter()
            .map(|episode| EpisodeOutcome {
                return_: episode.rewards.iter().sum(),
                steps: episode.rewards.len(),
                terminated: episode.terminal.is_some(),
                terminal_gains: episode.terminal.map(|set| config.grid.gains(set)),
                rewards: episode.rewards.clone(),
                distances: episode.distances.clone(),
            })
            .collect();
        Self {
            alpha: learner.alpha(),
            seed: config.run.seed,
            gains: config.grid.gains(learner.pick()),
            locked,
            usage: usage(config, learner),
            episodes,
        }
    }
}

fn usage(config: &RunConfig, learner: &Learner) -> std::collections::BTreeMap<String, Vec<Usage>> {
    let grid = config.grid;
    let axes = grid.axes();
    let of_axis = |axis: usize| {
        let mut usage: Vec<Usage> = (0..axes[axis].len())
            .map(|place| Usage { value: axes[axis].value(place), count: 0 })
            .collect();
        for set in 0..grid.len() {
            let place = grid.position(set).0[axis] as usize;
            usage[place].count += u64::from(learner.drives_of(set).0);
        }
        (Gains::NAMES[axis].to_owned(), usage)
    };
    (0..4).map(of_axis).collect()
}
