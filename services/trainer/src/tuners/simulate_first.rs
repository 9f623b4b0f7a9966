//! Simulate first, then few drives: many plants say beforehand which sets are good, and the drives of the vehicle verify
//! more than they search.
//!
//! The sets are driven in the order of what is thought of them, which each drive corrects, in turn with the textbook's set;
//! the last drive is once more that of the best of them. A set that left the strip around the path on any simulated plant
//! is not driven. There is one learner: the drives are those of one vehicle, one after the other.

use std::cmp::Ordering;

use config::{Parameters, RunConfig};
use outcome::{LearnerSummary, SimulatedFirst};
use sha2::{Digest, Sha256};
use tracking::{DriveRecord, Objective};

use crate::digest::add_parameters;
use crate::packing::{from_bytes, to_bytes};
use crate::search::expected_improvement;
use crate::simulate_first::{Belief, Driven, Ensemble, Reading, log_value, simulated_first};
use crate::tuners::{Ask, LearnerState, Told, Tuner};

/// How often the textbook's set is driven, at most.
const TEXTBOOK: usize = 3;
/// With fewer drives none of them repeats a set, or is the textbook's.
const FEW: usize = 3;
/// The training could stop when no set is expected to improve on the best by more than this, in the logarithm of the value.
const IMPROVEMENT: f64 = 0.01;

/// The tuner.
pub(super) fn new(config: &RunConfig) -> SimulateFirst {
    SimulateFirst {
        config: config.clone(),
        ensemble: Ensemble::new(config),
        budget: (config.tuner.settings.number("drives") as usize).max(1),
        within_m: config.tuner.settings.number("within_m"),
        repeats: config.run.memo && !config.drives_differ(),
        driven: Vec::new(),
        next: None,
    }
}

/// The sets, what is thought of them, and what was driven.
#[derive(Debug, Clone)]
pub(super) struct SimulateFirst {
    config: RunConfig,
    ensemble: Ensemble,
    budget: usize,
    within_m: f64,
    /// Whether a second drive of a set is the first one again, which tells nothing.
    repeats: bool,
    driven: Vec<Driven>,
    /// The set to be driven next.
    next: Option<usize>,
}

impl SimulateFirst {
    fn belief(&self, drives: usize) -> Belief {
        let readings: Vec<Reading> = self.driven[..drives].iter().map(Driven::reading).collect();
        Belief::new(self.ensemble.candidates(), &readings, self.ensemble.noise())
    }

    fn is_within(&self, candidate: usize) -> bool {
        self.ensemble.candidates()[candidate].stays_within(self.within_m)
    }

    fn times(&self, candidate: usize) -> usize {
        self.driven.iter().filter(|it| it.candidate as usize == candidate).count()
    }

    /// The set that is best after these drives: one that was driven, and never left the strip if there is one.
    fn best_driven(&self, belief: &Belief, drives: usize) -> Option<usize> {
        let driven = &self.driven[..drives];
        let left = |number: usize| {
            let of_set = driven.iter().filter(|it| it.candidate as usize == number);
            let max_m = |it: &Driven| it.record.path_max_m;
            of_set.clone().any(|it| max_m(it).is_nan() || max_m(it) > self.within_m)
        };
        let all = || driven.iter().map(|it| it.candidate as usize);
        belief.best(all().filter(|it| !left(*it))).or_else(|| belief.best(all()))
    }

    /// The set to be driven next.
    fn choose(&self) -> Option<usize> {
        let drives = self.driven.len();
        if drives >= self.budget || !self.ensemble.is_done() {
            return None;
        }
        let belief = self.belief(drives);
        if self.budget >= FEW {
            if drives + 1 == self.budget && !self.repeats {
                return self.best_driven(&belief, drives);
            }
            let textbook = self.ensemble.textbook();
            let is_its_turn =
                drives % 2 == 1 && self.times(textbook) < if self.repeats { 1 } else { TEXTBOOK };
            if is_its_turn && self.is_within(textbook) {
                return Some(textbook);
            }
        }
        let all = 0..self.ensemble.candidates().len();
        let new = all.filter(|it| self.is_within(*it) && self.times(*it) == 0);
        let again = || self.best_driven(&belief, drives).filter(|_| !self.repeats);
        belief.best(new).or_else(again)
    }

    /// After how many drives no set was expected to be better by much.
    fn could_stop_after(&self) -> Option<u32> {
        (1..=self.driven.len())
            .find(|drives| {
                let belief = self.belief(*drives);
                let Some(best) = self.best_driven(&belief, *drives) else { return false };
                let least = belief.sets[best].0;
                let all = belief.sets.iter().enumerate().filter(|(it, _)| self.is_within(*it));
                all.map(|(_, of)| expected_improvement(least, *of)).all(|it| it < IMPROVEMENT)
            })
            .map(|drives| drives as u32)
    }

    fn recommended(&self) -> Option<usize> {
        let drives = self.driven.len();
        self.best_driven(&self.belief(drives), drives)
    }

    fn set(&self, candidate: usize) -> Parameters {
        self.ensemble.candidates()[candidate].set
    }

    fn least(&self) -> f64 {
        self.driven.iter().map(|it| it.value).fold(f64::INFINITY, f64::min)
    }
}

impl Tuner for SimulateFirst {
    fn prepare(&mut self) -> Result<f64, String> {
        if self.ensemble.is_done() {
            return Ok(1.0);
        }
        let share = self.ensemble.go_on();
        if share >= 1.0 {
            let candidates = self.ensemble.candidates();
            if !(0..candidates.len()).any(|it| self.is_within(it)) {
                // Sets that are out were driven on some of the plants alone.
                let on_all = candidates.iter().filter(|it| !it.is_out);
                let least = on_all.map(|it| it.worst_m).fold(f64::INFINITY, f64::min);
                return Err(format!(
                    "--within {} (tuner.settings.within_m): no set stays so near to the path on all {} simulated plants; the best one is up to {least:.4} m \
                     from it. Give more, or identify the vehicle better, so that its plants differ less",
                    self.within_m,
                    self.ensemble.plants(),
                ));
            }
            self.next = self.choose();
        }
        Ok(share)
    }

    fn learners(&self) -> u32 {
        1
    }

    fn wanted(&self, learner: u32) -> Option<Ask> {
        let set = self.set(self.next.filter(|_| learner == 0)?);
        Some(Ask::new(&self.config, 0, self.driven.len() as u32, set))
    }

    fn tell(&mut self, _ask: &Ask, drive: &DriveRecord, value: f64) -> Told {
        let candidate = self.next.expect("only a drive that is wanted is told") as u32;
        self.driven.push(Driven { candidate, value, record: *drive });
        self.next = self.choose();
        Told::default()
    }

    fn recommend(&self, _order: &dyn Fn(&Parameters, &Parameters) -> Ordering) -> Parameters {
        // Of equals the one that was driven first: no two sets are thought the same of unless they are the same.
        self.recommended().map_or_else(|| self.config.law.defaults(), |it| self.set(it))
    }

    fn state(&self, _learner: u32) -> LearnerState {
        LearnerState {
            epsilon: 0.0,
            best_value: self.least(),
            drives: self.driven.len() as u32,
            episodes: 0,
            of_episodes: 0,
        }
    }

    fn story(&self) -> Vec<LearnerSummary> {
        vec![LearnerSummary {
            alpha: None,
            gains: self.config.law.named(&self.recommend(&crate::by_values)),
            locked: Default::default(),
            usage: Default::default(),
            drives: self.driven.len() as u32,
            episodes: 0,
            terminated: 0,
            best: Some(self.least()).filter(|it| it.is_finite()),
        }]
    }

    fn digest_into(&self, _learner: u32, digest: &mut Sha256) {
        digest.update((self.driven.len() as u32).to_le_bytes());
        add_parameters(digest, &self.recommend(&crate::by_values));
    }

    fn save(&self) -> Vec<u8> {
        to_bytes(&self.driven)
    }

    fn restore(&mut self, saved: &[u8]) -> bool {
        let Some(driven) = from_bytes::<Vec<Driven>>(saved) else { return false };
        let count = self.ensemble.candidates().len();
        let is_whole = driven.len() <= self.budget
            && driven
                .iter()
                .all(|it| (it.candidate as usize) < count && !log_value(it.value).is_nan());
        if is_whole {
            self.driven = driven;
            self.next = self.choose();
        }
        is_whole
    }

    fn chooses(&self) -> bool {
        true
    }

    fn simulated_first(&self, objective: &Objective) -> Option<SimulatedFirst> {
        let stop = self.could_stop_after();
        let (config, ensemble) = (&self.config, &self.ensemble);
        Some(simulated_first(config, objective, ensemble, &self.driven, self.recommended()?, stop))
    }
}

#[cfg(test)]
#[path = "simulate_first_tests.rs"]
mod tests;
