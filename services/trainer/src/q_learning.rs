//! Q-learning over the grid as a tuner: independent learners, one for each learning rate, which vote with their
//! picks.

use std::cmp::Ordering;

use config::{Parameters, RunConfig};
use outcome::LearnerSummary;
use sha2::Sha256;
use tracking::DriveRecord;

use crate::packing::{from_bytes, to_bytes};
use crate::q_learner::{QLearner, SavedLearner};
use crate::tuners::{Ask, LearnerState, Told, Tuner};

/// How the tuners of this family differ.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Method {
    /// Whether parameters on which the terminal sets agree are locked.
    pub(crate) locks: bool,
    /// Share of the actions that are chosen at random; `None` for one that falls from episode to episode, as
    /// `learning.epsilon_start` and `epsilon_decay_share` say.
    pub(crate) epsilon: Option<f64>,
}

/// The learners of a run.
#[derive(Debug, Clone)]
pub(crate) struct QLearning {
    config: RunConfig,
    learners: Vec<QLearner>,
}

impl QLearning {
    pub(crate) fn new(config: &RunConfig, method: Method) -> Self {
        let learners = (0..)
            .zip(&config.run.alphas)
            .map(|(number, alpha)| QLearner::new(config, method, number, *alpha))
            .collect();
        Self { config: config.clone(), learners }
    }
}

impl Tuner for QLearning {
    fn learners(&self) -> u32 {
        self.learners.len() as u32
    }

    fn wanted(&self, learner: u32) -> Option<Ask> {
        let (step, parameters) = self.learners.get(learner as usize)?.wanted()?;
        Some(Ask::new(&self.config, learner, step, parameters))
    }

    fn tell(&mut self, ask: &Ask, drive: &DriveRecord, value: f64) -> Told {
        self.learners[ask.learner as usize].learn(drive, value)
    }

    /// The set that most learners picked.
    fn recommend(&self, order: &dyn Fn(&Parameters, &Parameters) -> Ordering) -> Parameters {
        let picks: Vec<Parameters> = self.learners.iter().map(QLearner::pick).collect();
        let votes = |set: &Parameters| picks.iter().filter(|pick| *pick == set).count();
        picks
            .iter()
            .copied()
            .min_by(|a, b| votes(b).cmp(&votes(a)).then_with(|| order(a, b)))
            .expect("there is at least one learner")
    }

    fn state(&self, learner: u32) -> LearnerState {
        let it = &self.learners[learner as usize];
        LearnerState {
            epsilon: it.epsilon(),
            best_value: it.best_value(),
            drives: it.drives_taken(),
            episodes: it.episodes(),
            of_episodes: self.config.learning.episodes,
        }
    }

    fn story(&self) -> Vec<LearnerSummary> {
        self.learners.iter().map(|learner| learner.summary(&self.config)).collect()
    }

    fn digest_into(&self, learner: u32, digest: &mut Sha256) {
        self.learners[learner as usize].digest_into(digest);
    }

    fn save(&self) -> Vec<u8> {
        to_bytes(&self.learners.iter().map(QLearner::save).collect::<Vec<_>>())
    }

    fn restore(&mut self, saved: &[u8]) -> bool {
        let saved: Option<Vec<SavedLearner>> = from_bytes(saved);
        saved.is_some_and(|saved| {
            saved.len() == self.learners.len()
                && self.learners.iter_mut().zip(&saved).all(|(it, saved)| it.restore(saved))
        })
    }
}
