//! What a training has come to, as it is written for the orchestrator and for people.

use config::{Gains, RunConfig, Tuner};
use serde::{Deserialize, Serialize};

use crate::digest::digest;
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
    pub paper: SetOutcome,
    /// The same training by plain Q-learning, from the same grid.
    pub plain_q: PlainOutcome,
    pub asked: u64,
    pub learners: Vec<LearnerOutcome>,
}

/// Where the gains stand among all sets of the grid.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "the keys of result.json, described in the README")]
pub struct GridOutcome {
    pub size: usize,
    pub rank_distance: usize,
    pub rank_mse: usize,
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
    pub episodes: Vec<EpisodeOutcome>,
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
    /// What a finished training has come to, against a whole ranking.
    pub fn new(config: &RunConfig, training: &Training, ranking: &mut Ranking) -> Self {
        let chosen = vote(training.learners(), ranking);
        let gains = config.grid.gains(chosen);
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
            on_bound: config.grid.on_bound(chosen).into_iter().map(str::to_owned).collect(),
            distance: set.distance,
            mse_m2: set.mse_m2,
            grid: GridOutcome {
                size: ranking.len(),
                rank_distance: set.rank_distance,
                rank_mse: set.rank_mse,
                best_distance: ranking.best_distance(),
                best_mse_m2: ranking.best_mse_m2(),
            },
            paper: SetOutcome::new(config.paper_gains, ranking),
            plain_q: PlainOutcome {
                set: SetOutcome::new(plain_gains, ranking),
                asked: drives_taken(&plain),
            },
            asked: drives_taken(training),
            learners: training
                .learners()
                .iter()
                .map(|learner| LearnerOutcome::new(config, learner))
                .collect(),
        }
    }
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
            episodes,
        }
    }
}
