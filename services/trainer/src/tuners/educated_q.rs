//! Educated Q-learning, the paper's method (its section 2.4): gains on which the terminal sets agree are locked.

use config::RunConfig;

use crate::q_learning::{Method, QLearning};

/// The paper's learners, one for each learning rate.
pub(super) fn new(config: &RunConfig) -> QLearning {
    QLearning::new(config, Method { locks: true, epsilon: None })
}
