//! What the tuners share that propose points and are told their values: budget, repeats, parallel drives, and saving.
//!
//! A [`Method`] proposes a generation of points and learns their values when all of them are known. The drives of a
//! generation are dealt to the learners in turn. So a training comes to the same whatever the fleet, and without noise
//! whatever the number of learners. Without noise no set is driven twice: a point whose set was driven is answered from
//! what is known, and costs nothing.

mod cholesky;
mod cube;
mod process;
mod saved;
mod sobol;
mod space;

use std::cmp::Ordering;

use config::{OverBy, Parameters, RunConfig};
use outcome::{LearnerSummary, OfDrives};
use sha2::{Digest, Sha256};
use tracking::DriveRecord;

use crate::digest::add_parameters;
use crate::packing::{from_bytes, to_bytes};
use crate::plants::lacking_margin;
use crate::tuners::{Ask, LearnerState, Told, Tuner};

pub(crate) use cholesky::Cholesky;
pub(crate) use cube::{Cube, Point};
pub(crate) use process::{Process, Reading, Shape, expected_improvement, matern};
pub(crate) use sobol::Sobol;
pub(crate) use space::{Known, Space};

/// Generations in a row without a new set, after which a set is drawn at random.
const BARREN: u32 = 30;
/// A search is settled while it neither finds nor expects a set that is better than the best one by more than this share.
pub(crate) const SETTLED: f64 = 0.01;
/// What a set without any margin counts as worse, as a share of its value.
const FRAGILE_PRICE: f64 = 4.0;
/// A value that is no number, or beyond this, counts as this.
const WORST: f64 = 1e12;
/// The normal distribution's 97.5th percentile.
const Z: f64 = 1.959_963_984_540_054;

/// How points are proposed. All that it keeps is a function of what it was told and of the space's random stream.
pub(crate) trait Method: std::fmt::Debug + Clone + Send + Sync + 'static {
    /// The points whose values it wants to know next, as they can be driven; at most `room` of them can be new. None of
    /// them if it has no more to ask.
    fn propose(&mut self, space: &mut Space, room: usize) -> Vec<Point>;

    /// Takes the values of the points proposed last, in their order: means if they were driven several times. Shorter
    /// than the proposal only if the budget ended with it.
    fn learn(&mut self, _values: &[f64]) {}

    /// The value that the choice goes by, for each set that was driven.
    fn judged(&self, space: &Space) -> Vec<f64> {
        space.known.iter().map(Known::mean).collect()
    }

    /// Mean and standard deviation of the logarithm of a point's value, by the method's model; `None` if it has none, or
    /// without noise.
    fn predicted(&self, _space: &Space, _point: &[f64]) -> Option<(f64, f64)> {
        None
    }

    /// Whether, when it proposed last, it had no hope for a set that is better than the best one by more than [`SETTLED`].
    fn is_settled(&self) -> bool {
        false
    }

    /// All that tells it from a new one.
    fn state(&self) -> Vec<f64> {
        Vec::new()
    }

    /// Takes what [`Method::state`] gave. Returns whether it can have been that.
    fn restore(&mut self, state: &[f64]) -> bool {
        state.is_empty()
    }
}

/// A drive of the generation.
#[derive(Debug, Clone, PartialEq)]
struct Slot {
    point: Point,
    value: Option<f64>,
}

/// What one learner has received.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Received {
    drives: u32,
    best: Option<(f64, Parameters)>,
}

/// A method with its budget.
#[derive(Debug, Clone)]
pub(crate) struct Search<M> {
    config: RunConfig,
    method: M,
    space: Space,
    /// Drives that may be made in all.
    budget: usize,
    /// Drives of each set that is proposed.
    repeats: usize,
    /// What the method proposed last.
    generation: Vec<Point>,
    /// The drives of it, in the order in which they are dealt to the learners.
    slots: Vec<Slot>,
    learners: Vec<Received>,
    /// After so many drives the search was settled, and has been since.
    settled_after: Option<u32>,
}

impl<M: Method> Search<M> {
    /// A search at its first drive. The tuner has the settings `drives`, `repeats`, `learners` and `draw`.
    pub(crate) fn new(config: &RunConfig, method: impl FnOnce(&mut Space) -> M) -> Self {
        let mut space = Space::new(config);
        let repeats = if config.steps_differ() {
            config.tuner.settings.number("repeats") as usize
        } else {
            1
        };
        let budget = (config.tuner.settings.number("drives") as usize).max(1);
        let mut search = Self {
            config: config.clone(),
            method: method(&mut space),
            space,
            budget,
            repeats: repeats.clamp(1, budget),
            generation: Vec::new(),
            slots: Vec::new(),
            learners: vec![Received::default(); config.learners()],
            settled_after: None,
        };
        search.propose();
        search
    }

    fn spent(&self) -> usize {
        self.learners.iter().map(|it| it.drives as usize).sum()
    }

    /// By how much a set counts as worse than its drives. Over plants a set that is fragile is not chosen if there is another one,
    /// so the search is to look where sets are not; what the price rises with, it can follow.
    fn price(&self, set: &Parameters) -> f64 {
        match self.config.over.by {
            OverBy::Nominal => 1.0,
            _ => 1.0 + FRAGILE_PRICE * lacking_margin(&self.config, set),
        }
    }

    /// Fills the slots with the drives of the next generation; leaves them empty if the search is over.
    fn propose(&mut self) {
        let room = self.budget.saturating_sub(self.spent()) / self.repeats;
        // Under noise, sets that are known may be driven again.
        if room == 0 || (!self.space.noise && self.space.is_finished()) {
            return;
        }
        let mut barren = 0;
        let mut fresh: Vec<Point> = Vec::new();
        while fresh.is_empty() {
            barren += 1;
            if barren > BARREN {
                self.generation.clear();
                fresh.extend(self.space.draw_new(&[]));
                break;
            }
            self.generation = self.method.propose(&mut self.space, room);
            let spent = self.spent() as u32;
            self.settled_after =
                self.method.is_settled().then(|| self.settled_after.unwrap_or(spent));
            for point in &self.generation {
                let is_known = !self.space.noise && self.space.find(point).is_some();
                if !is_known && fresh.len() < room && !self.space.holds(&fresh, point) {
                    fresh.push(point.clone());
                }
            }
            if fresh.is_empty() {
                self.learn();
            }
        }
        let slots =
            fresh.into_iter().flat_map(|point| vec![Slot { point, value: None }; self.repeats]);
        self.slots = slots.collect();
    }

    /// Hands the values of the generation to the method.
    fn learn(&mut self) {
        let values = self.generation.iter().map_while(|point| self.space.find(point));
        let values: Vec<f64> = values.map(Known::mean).collect();
        self.method.learn(&values);
    }

    /// What is known, and of a generation under way the drives that are over as well.
    fn with_slots(&self) -> Space {
        let mut space = self.space.clone();
        for Slot { point, value } in &self.slots {
            value.iter().for_each(|value| space.add(point, *value));
        }
        space
    }

    /// The next drive of a learner, as a place in the slots.
    fn slot_of(&self, learner: u32) -> Option<usize> {
        let mut dealt = (learner as usize..self.slots.len()).step_by(self.learners.len());
        dealt.find(|slot| self.slots[*slot].value.is_none())
    }
}

impl<M: Method> Tuner for Search<M> {
    fn learners(&self) -> u32 {
        self.learners.len() as u32
    }

    fn wanted(&self, learner: u32) -> Option<Ask> {
        let step = self.learners.get(learner as usize)?.drives;
        let slot = &self.slots[self.slot_of(learner)?];
        Some(Ask::new(&self.config, learner, step, self.space.cube.set(&slot.point)))
    }

    fn tell(&mut self, ask: &Ask, _drive: &DriveRecord, value: f64) -> Told {
        let slot = self.slot_of(ask.learner).expect("only a drive that is wanted is told");
        let value = if value.is_finite() { value.min(WORST) } else { WORST };
        let price = self.price(&ask.parameters);
        self.slots[slot].value = Some((value * price).min(WORST));
        let received = &mut self.learners[ask.learner as usize];
        received.drives += 1;
        if received.best.is_none_or(|(best, _)| value < best) {
            received.best = Some((value, ask.parameters));
        }
        if self.slots.iter().all(|slot| slot.value.is_some()) {
            // In the order of the slots, whoever was served first.
            let before = self.space.least();
            for Slot { point, value } in std::mem::take(&mut self.slots) {
                self.space.add(&point, value.unwrap_or(WORST));
            }
            if self.space.least() < before * (1.0 - SETTLED) {
                self.settled_after = None;
            }
            self.learn();
            self.propose();
        }
        Told::default()
    }

    fn recommend(&self, order: &dyn Fn(&Parameters, &Parameters) -> Ordering) -> Parameters {
        let space = self.with_slots();
        let judged = self.method.judged(&space);
        let best = judged.iter().copied().fold(f64::INFINITY, f64::min);
        let sets = space.known.iter().zip(&judged).filter(|(_, value)| **value == best);
        let sets = sets.map(|(known, _)| space.cube.set(&known.point));
        sets.min_by(|a, b| order(a, b)).unwrap_or_else(|| self.config.law.defaults())
    }

    fn predicted(&self, set: &Parameters) -> Option<OfDrives> {
        let space = self.with_slots();
        let known = space.known.iter().find(|it| space.cube.set(&it.point) == *set)?;
        let (mean, sd) = self.method.predicted(&space, &known.point)?;
        let [predicted, low, high] = [mean, mean - Z * sd, mean + Z * sd].map(libm::exp);
        Some(OfDrives { drives: known.drives.into(), predicted, low, high })
    }

    fn could_stop_after(&self) -> Option<u32> {
        self.settled_after
    }

    fn state(&self, learner: u32) -> LearnerState {
        let received = &self.learners[learner as usize];
        LearnerState {
            epsilon: 0.0,
            best_value: received.best.map_or(f64::INFINITY, |(value, _)| value),
            drives: received.drives,
            episodes: 0,
            of_episodes: 0,
        }
    }

    fn story(&self) -> Vec<LearnerSummary> {
        let summary = |it: &Received| LearnerSummary {
            alpha: None,
            gains: self.config.law.named(&self.best_of(it)),
            locked: Default::default(),
            usage: Default::default(),
            drives: it.drives,
            episodes: 0,
            terminated: 0,
            best: it.best.map(|(value, _)| value),
        };
        self.learners.iter().map(summary).collect()
    }

    fn digest_into(&self, learner: u32, digest: &mut Sha256) {
        let received = &self.learners[learner as usize];
        digest.update(received.drives.to_le_bytes());
        add_parameters(digest, &self.best_of(received));
    }

    fn save(&self) -> Vec<u8> {
        to_bytes(&self.saved())
    }

    fn restore(&mut self, saved: &[u8]) -> bool {
        from_bytes(saved).is_some_and(|saved| self.take_saved(saved))
    }
}

impl<M: Method> Search<M> {
    /// The best set that a learner saw; the law's own if it saw none.
    fn best_of(&self, received: &Received) -> Parameters {
        received.best.map_or_else(|| self.config.law.defaults(), |(_, set)| set)
    }
}
