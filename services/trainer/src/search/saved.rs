//! What a search has become, as plain data.

use config::Parameters;
use serde::{Deserialize, Serialize};

use super::space::Known;
use super::{Method, Received, Search, Slot};

/// A value, and the set with which it was read.
type SavedBest = (f64, Vec<f64>);

/// What tells a search from a new one of the same configuration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Saved {
    drawn: u128,
    /// Points that were driven: coordinates, sum of the values, of their squares, number of drives.
    known: Vec<(Vec<f64>, f64, f64, u32)>,
    generation: Vec<Vec<f64>>,
    slots: Vec<(Vec<f64>, Option<f64>)>,
    /// Of each learner: its drives, and the best value with its set.
    learners: Vec<(u32, Option<SavedBest>)>,
    method: Vec<f64>,
    settled_after: Option<u32>,
}

impl<M: Method> Search<M> {
    pub(super) fn saved(&self) -> Saved {
        let values = |set: Parameters| self.config.law.values(&set).to_vec();
        let learner = |it: &Received| (it.drives, it.best.map(|(value, set)| (value, values(set))));
        Saved {
            drawn: self.space.rng.position(),
            known: self
                .space
                .known
                .iter()
                .map(|it| (it.point.clone(), it.sum, it.squares, it.drives))
                .collect(),
            generation: self.generation.clone(),
            slots: self.slots.iter().map(|it| (it.point.clone(), it.value)).collect(),
            learners: self.learners.iter().map(learner).collect(),
            method: self.method.state(),
            settled_after: self.settled_after,
        }
    }

    /// Becomes what was saved. Returns whether that can have been a search of this configuration.
    pub(super) fn take_saved(&mut self, saved: Saved) -> bool {
        let (count, dimensions) = (self.config.law.count(), self.space.cube.dimensions());
        let is_point = |point: &[f64]| {
            point.len() == dimensions && point.iter().all(|it| (0.0..=1.0).contains(it))
        };
        let is_whole = saved.known.len() <= self.budget
            && saved.slots.len() <= self.budget
            && saved.known.iter().all(|(point, sum, squares, drives)| {
                is_point(point)
                    && sum.is_finite()
                    && squares.is_finite()
                    && (1..=self.budget as u32).contains(drives)
            })
            && saved.generation.iter().all(|it| is_point(it))
            && saved
                .slots
                .iter()
                .all(|(it, value)| is_point(it) && value.is_none_or(f64::is_finite))
            && (saved.slots.is_empty() || saved.slots.iter().any(|(_, value)| value.is_none()))
            && saved.settled_after.is_none_or(|it| it as usize <= self.budget)
            && saved.learners.len() == self.learners.len()
            && saved.learners.iter().all(|(drives, best)| {
                *drives as usize <= self.budget
                    && best.as_ref().is_none_or(|(_, set)| set.len() == count)
            });
        if !is_whole || !self.method.restore(&saved.method) {
            return false;
        }
        self.space.rng.go_to(saved.drawn);
        for (point, sum, squares, drives) in saved.known {
            self.space.put(Known { point, sum, squares, drives });
        }
        self.generation = saved.generation;
        self.settled_after = saved.settled_after;
        let slots = saved.slots.into_iter();
        self.slots = slots.map(|(point, value)| Slot { point, value }).collect();
        let learners = saved.learners.into_iter();
        let best = |(value, set): (f64, Vec<f64>)| (value, Parameters::of(&set));
        self.learners =
            learners.map(|(drives, it)| Received { drives, best: it.map(best) }).collect();
        true
    }
}
