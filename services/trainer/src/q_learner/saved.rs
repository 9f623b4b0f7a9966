//! What a learner has become, as plain data.

use config::{GridPosition, MAX_PARAMETERS};
use serde::{Deserialize, Serialize};

use super::QLearner;
use crate::tuners::EpisodeRecord;

/// What tells a learner from a new one of the same configuration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct SavedLearner {
    /// Position of its random stream.
    drawn: u128,
    /// The entries of the Q-table that were ever updated: index, value, visits.
    entries: Vec<(u32, f64, u32)>,
    /// The sets that were driven: index, visits.
    sets: Vec<(u32, u32)>,
    locked: [Option<u16>; MAX_PARAMETERS],
    position: [u16; MAX_PARAMETERS],
    action: u32,
    before: Option<(u32, f64)>,
    closest: f64,
    best: f64,
    terminal_sets: Vec<[u16; MAX_PARAMETERS]>,
    episodes: u32,
    terminated: u32,
    /// Of the episode under way: steps, sum of rewards, last value.
    current: (u32, f64, f64),
    step: u32,
}

impl QLearner {
    /// What it has become.
    pub(crate) fn save(&self) -> SavedLearner {
        let visited = |visits: &[u32]| -> Vec<(u32, u32)> {
            (0..).zip(visits.iter().copied()).filter(|(_, visits)| *visits > 0).collect()
        };
        let EpisodeRecord { steps, reward_sum, last_value, .. } = self.current;
        SavedLearner {
            drawn: self.rng.position(),
            entries: visited(&self.visits)
                .into_iter()
                .map(|(entry, visits)| (entry, self.q[entry as usize], visits))
                .collect(),
            sets: visited(&self.set_visits),
            locked: self.locked,
            position: self.position.0,
            action: self.action as u32,
            before: self.before.map(|(state, value)| (state as u32, value)),
            closest: self.closest,
            best: self.best,
            terminal_sets: self.terminal_sets.iter().map(|set| set.0).collect(),
            episodes: self.episodes,
            terminated: self.terminated,
            current: (steps, reward_sum, last_value),
            step: self.step,
        }
    }

    /// Makes a new learner what the saved one was. Returns whether it can have been one of this configuration; if not,
    /// this learner must not be used any more.
    pub(crate) fn restore(&mut self, saved: &SavedLearner) -> bool {
        let axes = self.grid.axes();
        let is_place = |axis: usize, place: u16| {
            axes.get(axis).map_or(place == 0, |axis| usize::from(place) < axis.len())
        };
        let is_set = |set: &[u16; MAX_PARAMETERS]| {
            set.iter().enumerate().all(|(axis, place)| is_place(axis, *place))
        };
        let are_locks = (0..).zip(&saved.locked).all(|(axis, locked)| {
            locked.is_none_or(|place| axis < axes.len() && is_place(axis, place))
        });
        let states = self.q.len() / self.actions;
        let is_whole = saved.entries.iter().all(|(entry, ..)| (*entry as usize) < self.q.len())
            && saved.sets.iter().all(|(set, _)| (*set as usize) < self.set_visits.len())
            && are_locks
            && is_set(&saved.position)
            && saved.terminal_sets.iter().all(is_set)
            && saved.terminal_sets.len() <= self.learning.lock_window as usize
            && (saved.action as usize) < self.actions
            && saved.before.is_none_or(|(state, _)| (state as usize) < states)
            && saved.episodes <= self.learning.episodes;
        if !is_whole {
            return false;
        }
        self.rng.go_to(saved.drawn);
        for (entry, value, visits) in &saved.entries {
            self.q[*entry as usize] = *value;
            self.visits[*entry as usize] = *visits;
        }
        for (set, visits) in &saved.sets {
            self.set_visits[*set as usize] = *visits;
        }
        self.locked = saved.locked;
        self.position = GridPosition(saved.position);
        self.action = saved.action as usize;
        self.before = saved.before.map(|(state, value)| (state as usize, value));
        (self.closest, self.best) = (saved.closest, saved.best);
        self.terminal_sets = saved.terminal_sets.iter().map(|set| GridPosition(*set)).collect();
        (self.episodes, self.terminated) = (saved.episodes, saved.terminated);
        let (steps, reward_sum, last_value) = saved.current;
        self.current = EpisodeRecord { steps, reward_sum, last_value, ..EpisodeRecord::default() };
        self.step = saved.step;
        true
    }
}
