//! The sets that may be driven, driven by plain calls on the plants that the car may be.

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
    /// Logarithm of the objective on each plant.
    pub(crate) logs: Vec<f64>,
    /// The largest distance from the path in any of these drives.
    pub(crate) worst_m: f64,
}

/// All of them, with the plants on which they are driven.
#[derive(Debug, Clone)]
pub(crate) struct Ensemble {
    config: RunConfig,
    objective: Option<Objective>,
    changes: Vec<PlantChange>,
    rollouts: Vec<Rollout>,
    candidates: Vec<Candidate>,
    /// The textbook's set of the law, which is the last one unless it is among the others.
    textbook: usize,
    /// How many of them were driven on all plants.
    done: usize,
    /// Variance of the logarithm of a drive's value with noise.
    noise: f64,
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
                candidates.push(Candidate { set, point, logs: Vec::new(), worst_m: 0.0 });
            }
        }
        let set = textbook_set(config);
        let textbook = candidates.iter().position(|it| it.set == set).unwrap_or_else(|| {
            let point = point_of(config, &set);
            candidates.push(Candidate { set, point, logs: Vec::new(), worst_m: 0.0 });
            candidates.len() - 1
        });
        Self {
            config: config.clone(),
            objective: None,
            changes: plants(config, count, PLANTS),
            rollouts: Vec::new(),
            candidates,
            textbook,
            done: 0,
            noise: 0.0,
        }
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

    /// Drives one more of the sets on all plants, on all cores. Returns which share of them is done.
    pub(crate) fn go_on(&mut self) -> f64 {
        if self.done == self.candidates.len() {
            return 1.0;
        }
        if self.rollouts.is_empty() {
            self.rollouts = self.changes.iter().map(|it| on_plant(&self.config, it)).collect();
        }
        let objective = *self.objective.get_or_insert_with(|| objective_of(&self.config));
        let set = self.candidates[self.done].set;
        let noisy = self.config.noise.enabled;
        let seed = self.config.run.seed;
        let drive = |plant: usize, rollout: &mut Rollout| {
            // The same noise for all sets, so that it does not tell them apart.
            let record = rollout.drive(set, noisy.then(|| drive_seed(seed, SEEDS, plant as u32)));
            (log_value(objective.of(&record)), record.path_max_m)
        };
        let threads = std::thread::available_parallelism().map_or(1, |cores| cores.get());
        let of_each = self.rollouts.len().div_ceil(threads);
        let parts: Vec<Vec<(f64, f64)>> = std::thread::scope(|scope| {
            let drive = &drive;
            let chunks = self.rollouts.chunks_mut(of_each).enumerate();
            let workers: Vec<_> = chunks
                .map(|(chunk, rollouts)| {
                    scope.spawn(move || {
                        let each = rollouts.iter_mut().enumerate();
                        each.map(|(place, it)| drive(chunk * of_each + place, it)).collect()
                    })
                })
                .collect();
            workers.into_iter().map(|it| it.join().expect("a rollout does not panic")).collect()
        });
        let candidate = &mut self.candidates[self.done];
        for (log, max_m) in parts.into_iter().flatten() {
            candidate.logs.push(log);
            candidate.worst_m =
                candidate.worst_m.max(if max_m.is_nan() { f64::INFINITY } else { max_m });
        }
        self.done += 1;
        if self.done == self.candidates.len() {
            self.rollouts.clear();
            self.read_noise(&objective);
        }
        self.done as f64 / self.candidates.len() as f64
    }

    /// Whether all sets were driven.
    pub(crate) fn is_done(&self) -> bool {
        self.done == self.candidates.len()
    }

    /// Reads what noise does to the value of the set that is best in simulation, with the vehicle as its file has it.
    fn read_noise(&mut self, objective: &Objective) {
        if !self.config.noise.enabled {
            return;
        }
        let sum = |it: &Candidate| it.logs.iter().sum::<f64>();
        let best = self.candidates.iter().min_by(|a, b| sum(a).total_cmp(&sum(b)));
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
