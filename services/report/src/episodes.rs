//! The episodes of a training, as `episodes.csv` holds them: a row each, those of several learners in any order.

use std::path::Path;

use serde::Deserialize;

use crate::ReportError;
use crate::files::{check_numbers, read_table};

/// Name of the file in a run's folder.
pub(crate) const EPISODES_FILE: &str = "episodes.csv";

/// One episode of a learner, as far as the figures show it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Episode {
    number: u32,
    /// Sum of the rewards of its steps.
    pub(crate) return_: f64,
    /// Value of the objective in its last step.
    pub(crate) last_value: f64,
}

/// The columns that are read.
#[derive(Debug, Deserialize)]
struct Row {
    learner: usize,
    episode: u32,
    #[serde(rename = "return")]
    return_: f64,
    last_value: f64,
}

/// Reads the episodes of each of `learners` learners, in the order of their numbers; `None` if the run's folder has no
/// such file.
pub(crate) fn read(run: &Path, learners: usize) -> Result<Option<Vec<Vec<Episode>>>, ReportError> {
    let mut all = vec![Vec::new(); learners];
    let is_there = read_table(&run.join(EPISODES_FILE), |row: Row| {
        let Row { learner, episode, return_, last_value } = row;
        check_numbers([("return", return_), ("last_value", last_value)])?;
        let of = all.get_mut(learner).ok_or_else(|| {
            format!(
                "learner: is {learner}, but result.json lists {learners} learners, counted from 0"
            )
        })?;
        of.push(Episode { number: episode, return_, last_value });
        Ok(())
    })?;
    for of in &mut all {
        of.sort_by_key(|episode| episode.number);
    }
    Ok(is_there.then_some(all))
}
