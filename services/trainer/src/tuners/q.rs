//! Plain Q-learning: the paper's method without the locks.

use config::RunConfig;

use crate::q_learning::{Method, QLearning};

/// Learners that never lock a parameter, one for each learning rate.
pub(super) fn new(config: &RunConfig) -> QLearning {
    QLearning::new(config, Method { locks: false, epsilon: None })
}
