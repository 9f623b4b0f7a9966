//! A random walk over the grid: the learners of Q-learning with every action chosen at random.

use config::RunConfig;

use crate::q_learning::{Method, QLearning};

/// Learners that explore throughout and never lock a parameter; one for each learning rate, which decides nothing here
/// but their number.
pub(super) fn new(config: &RunConfig) -> QLearning {
    QLearning::new(config, Method { locks: false, epsilon: Some(1.0) })
}
