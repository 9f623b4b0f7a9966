//! A random walk over the grid: the learners of Q-learning with every action chosen at random.

use config::RunConfig;

use crate::q_learning::{Method, QLearning};

/// Learners that explore throughout and never lock a parameter. There is one for each learning rate; the rates
/// themselves have no effect here.
pub(super) fn new(config: &RunConfig) -> QLearning {
    QLearning::new(config, Method { locks: false, epsilon: Some(1.0) })
}
