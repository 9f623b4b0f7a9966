//! The sets that may be driven, driven by plain calls on the plants that the car may be.

use std::collections::VecDeque;

use config::{Parameters, PlantChange, RunConfig, Scale};
use rollout::Rollout;
use tracking::Objective;

use super::log_value;
use crate::objective_of;
use crate::over::on_plant;
use crate::plants::drawn;
use crate::rng::{Stream, drive_seed};
use crate::search::{Cube, Point, Sobol};

/// Sets of a law whose parameters may have any values between the ends of the grid.
const CONTINUOUS: u32 = 1024;
/// A grid with more sets is not simulated as a whole: as many Sobol points of it are.
const WHOLE_GRID: usize = 2048;
/// Which plants are driven first, and which share of the sets, one of how many, goes on to the others: what is bad on some
/// plants like the car is not worth driving on all.
const ROUNDS: [(usize, usize); 2] = [(2, 4), (8, 2)];
/// So many sets go on in any case.
const LEAST_KEPT: usize = 128;
/// The random stream of plants, and that of the Sobol points.
const PLANTS: u64 = 0x656e_7365_6d62_6c65;
const POINTS: u64 = 0x7365_7473;
/// What stands for the learner in the seeds of the noise on these drives.
const SEEDS: u32 = u32::MAX - 1;
/// Drives of a set by which its noise is read.
const NOISY: u32 = 24;

/// A set that may be driven.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Candidate {
    /// The set.
    pub(crate) set: Parameters,
    /// Where it lies in the unit cube.
    pub(crate) point: Point,
    /// Logarithm of the objective on each plant, or on the first ones if it is out.
    pub(crate) logs: Vec<f64>,
    /// The largest distance from the path in any of these drives.
    pub(crate) worst_m: f64,
    /// Whether it was not driven on all plants, because others were better on the first ones.
    pub(crate) is_out: bool,
}

impl Candidate {
    fn new(set: Parameters, point: Point) -> Self {
        Self { set, point, logs: Vec::new(), worst_m: 0.0, is_out: false }
    }

    /// Whether it was driven on all plants and stayed this near to the path.
    pub(crate) fn stays_within(&self, within_m: f64) -> bool {
        !self.is_out && self.worst_m <= within_m
    }

    fn sum(&self) -> f64 {
        self.logs.iter().sum()
    }
}

/// All of them, with the plants on which they are driven.
#[derive(Debug, Clone)]
pub(crate) struct Ensemble {
    config: RunConfig,
    objective: Option<Objective>,
    changes: Vec<PlantChange>,
    candidates: Vec<Candidate>,
    /// The textbook's set of the law, which is the last one unless it is among the others. It is never out.
    textbook: usize,
    /// Plants that all sets which are not out were driven on.
    driven_on: usize,
    /// How many drives are made at the same time. What comes out does not depend on it.
    threads: usize,
    lanes: Vec<Lane>,
    /// Sets that are still to be driven on the plants of the lanes.
    waiting: VecDeque<usize>,
    /// Drives made, and drives in all.
    done: usize,
    drives: usize,
    /// Variance of the logarithm of a drive's value with noise.
    noise: f64,
}

/// A drive that is made at the same time as others: on which plant, and of which of the sets that are driven at once.
#[derive(Debug, Clone)]
struct Lane {
    plant: usize,
    slot: usize,
    rollout: Rollout,
}

impl Ensemble {
    /// The sets of a configuration whose tuner has the settings `plants` and `draw`; none is driven yet.
    pub(crate) fn new(config: &RunConfig) -> Self {
        let count = config.tuner.settings.number("plants") as usize;
        let cube = Cube::new(config);
        let mut seeds = Stream::new(config.run.seed, POINTS);
        let mut seed = || (seeds.uniform() * (1u64 << 32) as f64) as u32;
        let sobol = Sobol::new((0..cube.dimensions()).map(|_| seed()).collect());
        let points: Vec<Point> = match cube.len() {
            Some(all) if all <= WHOLE_GRID => (0..all).map(|it| cube.numbered(it)).collect(),
            _ => (0..CONTINUOUS).map(|it| cube.evenly(&sobol.point(it))).collect(),
        };
        let mut candidates: Vec<Candidate> = Vec::with_capacity(points.len() + 1);
        let mut seen = std::collections::HashSet::new();
        for point in points {
            let set = cube.set(&point);
            if seen.insert(set.to_bits()) {
                candidates.push(Candidate::new(set, point));
            }
        }
        let set = textbook_set(config);
        let textbook = candidates.iter().position(|it| it.set == set).unwrap_or_else(|| {
            let point = point_of(config, &set);
            candidates.push(Candidate::new(set, point));
            candidates.len() - 1
        });
        let mut new = Self {
            config: config.clone(),
            objective: None,
            changes: plants(config, count, PLANTS),
            candidates,
            textbook,
            driven_on: 0,
            threads: std::thread::available_parallelism().map_or(1, |cores| cores.get()),
            lanes: Vec::new(),
            waiting: VecDeque::new(),
            done: 0,
            drives: 0,
            noise: 0.0,
        };
        new.drives = new.drives_ahead();
        new
    }

    /// How many drives are to be made before a round; the textbook's set may make a few more.
    fn drives_ahead(&self) -> usize {
        let mut sets = self.candidates.iter().filter(|it| !it.is_out).count();
        let (mut driven_on, mut drives) = (self.driven_on, 0);
        while let Some((plants, of)) = self.round(driven_on) {
            drives += sets * (plants - driven_on);
            (sets, driven_on) = (kept(sets, of), plants);
        }
        drives
    }

    /// The next round after so many plants: up to which plant it goes, and one of how many sets goes on after it.
    fn round(&self, driven_on: usize) -> Option<(usize, usize)> {
        let all = self.changes.len();
        let next = ROUNDS.into_iter().find(|(plants, _)| (driven_on + 1..all).contains(plants));
        next.or_else(|| (driven_on < all).then_some((all, 1)))
    }

    /// The sets, in an order that depends on the configuration alone.
    pub(crate) fn candidates(&self) -> &[Candidate] {
        &self.candidates
    }

    /// Number of the textbook's set among them.
    pub(crate) fn textbook(&self) -> usize {
        self.textbook
    }

    /// Number of plants.
    pub(crate) fn plants(&self) -> usize {
        self.changes.len()
    }

    /// Variance of the logarithm of a drive's value that noise makes; 0 without noise.
    pub(crate) fn noise(&self) -> f64 {
        self.noise
    }

    /// Drives one more set on the plants of this round, or as many as there are cores for. Returns which share of all
    /// drives is done.
    pub(crate) fn go_on(&mut self) -> f64 {
        if self.is_done() {
            return 1.0;
        }
        if self.waiting.is_empty() {
            self.begin_round();
        }
        let objective = *self.objective.get_or_insert_with(|| objective_of(&self.config));
        let together = self.lanes.last().map_or(0, |lane| lane.slot + 1).min(self.waiting.len());
        let numbers: Vec<usize> = self.waiting.drain(..together).collect();
        let sets: Vec<Parameters> = numbers.iter().map(|it| self.candidates[*it].set).collect();
        let noisy = self.config.noise.enabled;
        let seed = self.config.run.seed;
        let drive = |lane: &mut Lane| {
            let set = *sets.get(lane.slot)?;
            // The same noise for all sets, so that it does not tell them apart.
            let noise = noisy.then(|| drive_seed(seed, SEEDS, lane.plant as u32));
            let record = lane.rollout.drive(set, noise);
            Some((lane.slot, log_value(objective.of(&record)), record.path_max_m))
        };
        let of_each = self.lanes.len().div_ceil(self.threads);
        let parts: Vec<Vec<_>> = std::thread::scope(|scope| {
            let workers: Vec<_> = self
                .lanes
                .chunks_mut(of_each)
                .map(|lanes| scope.spawn(|| lanes.iter_mut().filter_map(drive).collect()))
                .collect();
            workers.into_iter().map(|it| it.join().expect("a rollout does not panic")).collect()
        });
        for (slot, log, max_m) in parts.into_iter().flatten() {
            let candidate = &mut self.candidates[numbers[slot]];
            candidate.logs.push(log);
            candidate.worst_m =
                candidate.worst_m.max(if max_m.is_nan() { f64::INFINITY } else { max_m });
            self.done += 1;
        }
        if self.waiting.is_empty() {
            self.end_round();
            if self.is_done() {
                self.read_noise(&objective);
                return 1.0;
            }
        }
        self.done as f64 / self.drives as f64
    }

    /// Takes the sets that are not out to the next plants.
    fn begin_round(&mut self) {
        let Some((plants, _)) = self.round(self.driven_on) else { return };
        let plants = self.driven_on..plants;
        self.waiting =
            (0..self.candidates.len()).filter(|it| !self.candidates[*it].is_out).collect();
        let fresh: Vec<Rollout> =
            plants.clone().map(|it| on_plant(&self.config, &self.changes[it])).collect();
        // Few plants do not keep all cores busy with one set. Those of one set stand in the order of the plants.
        let together = self.threads.div_ceil(fresh.len()).min(self.waiting.len());
        self.lanes = (0..together)
            .flat_map(|slot| plants.clone().zip(&fresh).map(move |it| (slot, it)))
            .map(|(slot, (plant, rollout))| Lane { plant, slot, rollout: rollout.clone() })
            .collect();
    }

    /// Leaves out the sets that were worst so far. A set that leaves the strip is not driven in the end, and the farther
    /// it does, the sooner it is out.
    fn end_round(&mut self) {
        self.lanes.clear();
        let Some((plants, of)) = self.round(self.driven_on) else { return };
        self.driven_on = plants;
        let within_m = self.config.tuner.settings.number("within_m");
        let mut order: Vec<usize> =
            (0..self.candidates.len()).filter(|it| !self.candidates[*it].is_out).collect();
        let kept = kept(order.len(), of);
        order.sort_by(|a, b| {
            let [a, b] = [a, b].map(|it| &self.candidates[*it]);
            let key = |it: &Candidate| {
                let leaves = it.worst_m > within_m;
                (leaves, if leaves { it.worst_m } else { it.sum() })
            };
            let ((a_leaves, a), (b_leaves, b)) = (key(a), key(b));
            a_leaves.cmp(&b_leaves).then(a.total_cmp(&b))
        });
        for number in order.into_iter().skip(kept).filter(|it| *it != self.textbook) {
            self.candidates[number].is_out = true;
        }
        self.drives = self.done + self.drives_ahead();
    }

    /// Whether all sets were driven that go on to all plants.
    pub(crate) fn is_done(&self) -> bool {
        self.driven_on == self.changes.len()
    }

    /// Reads what noise does to the value of the set that is best in simulation, with the vehicle as its file has it.
    fn read_noise(&mut self, objective: &Objective) {
        if !self.config.noise.enabled {
            return;
        }
        let all = self.candidates.iter().filter(|it| !it.is_out);
        let best = all.min_by(|a, b| a.sum().total_cmp(&b.sum()));
        let Some(set) = best.map(|it| it.set) else { return };
        let mut rollout = Rollout::new(&self.config);
        let logs: Vec<f64> = (0..NOISY)
            .map(|it| {
                let seed = drive_seed(self.config.run.seed, SEEDS, u32::MAX - it);
                log_value(objective.of(&rollout.drive(set, Some(seed))))
            })
            .collect();
        let mean = crate::statistics::mean(&logs);
        let squares: f64 = logs.iter().map(|it| (it - mean) * (it - mean)).sum();
        self.noise = squares / (logs.len() - 1) as f64;
    }
}

/// How many of some sets go on when one of so many does.
fn kept(sets: usize, of: usize) -> usize {
    (sets / of).max(LEAST_KEPT).min(sets)
}

/// Plants that the car may be: those that the configuration names, or eight around the vehicle's file; and as many drawn
/// between them as are lacking.
pub(super) fn plants(config: &RunConfig, count: usize, stream: u64) -> Vec<PlantChange> {
    let named = config.plant_changes();
    let mut random = Stream::new(config.run.seed, stream);
    let drawn = (named.len()..count).map(|_| drawn(&named, &mut random)).collect::<Vec<_>>();
    named.into_iter().take(count).chain(drawn).collect()
}

/// What a user would type in for this law.
fn textbook_set(config: &RunConfig) -> Parameters {
    let sets = config.textbook_sets();
    sets.iter()
        .find(|it| it.config.law.name == config.law.name)
        .map_or_else(|| config.law.defaults(), |it| it.parameters)
}

/// Where a set lies in the unit cube; beyond it, if the grid does not reach as far.
fn point_of(config: &RunConfig, set: &Parameters) -> Point {
    let grid = config.grid();
    let each = grid.axes().iter().zip(&config.law.parameters).zip(set.0);
    each.map(|((axis, parameter), value)| {
        let (low, high) = (axis.min(), axis.max());
        if low >= high {
            return 0.5;
        }
        match parameter.scale {
            Scale::Linear => (value - low) / (high - low),
            Scale::Log => libm::log(value / low) / libm::log(high / low),
        }
    })
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::{Axis, Layers};

    fn driven(threads: usize) -> Ensemble {
        let mut layers = Layers::maneuver("smooth_lane").unwrap();
        for set in [
            "law_preset=pure_pursuit",
            "learning.tuner=simulate-first",
            "tuner.settings.draw=grid",
            "tuner.settings.plants=3",
            "tuner.settings.within_m=0.12",
            "drive.loop_time_s=8.0",
            "grid.filter={min=0.84,max=0.84,step=1}",
        ] {
            layers.set(set).unwrap();
        }
        let mut config = layers.resolve().unwrap();
        for (key, min, max, step) in
            [("kv", 1.0, 1.0, 1.0), ("ld_min", 0.5, 7.0, 1.2), ("ld_s", 0.1, 1.4, 0.1)]
        {
            config.grid.insert(key.to_owned(), Axis { min, max, step });
        }
        let mut ensemble = Ensemble { threads, ..Ensemble::new(&config) };
        let mut share = 0.0;
        while !ensemble.is_done() {
            assert!(share < 1.0, "done before the last round");
            let next = ensemble.go_on();
            assert!(next >= share);
            share = next;
        }
        assert_eq!(share, 1.0);
        ensemble
    }

    #[test]
    fn the_worst_sets_on_the_first_plants_are_out_and_the_number_of_cores_does_not_matter() {
        let (one, many) = (driven(1), driven(5));
        assert_eq!(one.candidates(), many.candidates());
        let all = one.candidates().len();
        let out = one.candidates().iter().filter(|it| it.is_out).count();
        assert!(
            all > 150 && (all - out == LEAST_KEPT || all - out == LEAST_KEPT + 1),
            "{all} {out}"
        );
        let within = |it: &Candidate| it.stays_within(0.12);
        for it in one.candidates() {
            assert_eq!(it.logs.len(), if it.is_out { 2 } else { 3 });
            assert!(!it.is_out || !within(it));
        }
        assert!(!one.candidates()[one.textbook()].is_out);
        // None that stays in the strip is out for one that does not.
        let left = |it: &&Candidate| it.worst_m > 0.12;
        let kept_outside = one.candidates().iter().filter(|it| !it.is_out).filter(left).count();
        let out_inside = one.candidates().iter().filter(|it| it.is_out && !left(it)).count();
        assert!(kept_outside <= 1 || out_inside == 0, "{kept_outside} {out_inside}");
        assert!(one.candidates().iter().filter(|it| within(it)).count() > 20);
    }
}
