//! One learner: educated Q-learning (section 2.4 of the paper) as a state machine that waits for drives.
//!
//! A learner always wants exactly one drive, or has finished. [`Learner::learn`] takes that drive and decides
//! what comes next; nothing else moves it.

use config::{
    ClosestBy, ClosestOver, EpisodeGains, FirstGains, GreedyTies, Grid, GridPosition, Learning,
    OutOfRange, Pick, RunConfig, StepLimitEffect, Tuner,
};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use tracking::state_distance;

use crate::rng::Stream;

/// Number of actions: each of the four gains goes down, stays, or goes up.
const ACTIONS: usize = 81;

/// What a learner remembers of a drive; the part of a report that decides anything.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DriveRecord {
    /// Mean absolute along-track error.
    pub mean_abs_along_m: f64,
    /// Mean absolute cross-track error: the paper's E_y.
    pub mean_abs_cross_m: f64,
    /// Mean absolute heading error: the paper's E_θ.
    pub mean_abs_heading_rad: f64,
    /// Along-track share of the mse.
    pub along_mse_m2: f64,
    /// Cross-track share of the mse.
    pub cross_mse_m2: f64,
    /// Ticks driven.
    pub ticks: u64,
    /// Whether the drive ended in a collision.
    pub collision: bool,
    /// Hash over every pose seen and every command given.
    pub trace: u64,
}

impl DriveRecord {
    /// The paper's figure of merit.
    pub fn mse_m2(&self) -> f64 {
        self.along_mse_m2 + self.cross_mse_m2
    }

    /// Whether every number is one that a drive can have.
    pub fn is_plausible(&self) -> bool {
        [
            self.mean_abs_along_m,
            self.mean_abs_cross_m,
            self.mean_abs_heading_rad,
            self.along_mse_m2,
            self.cross_mse_m2,
        ]
        .into_iter()
        .all(|number| number.is_finite() && number >= 0.0)
    }
}

impl From<rollout::Ended> for DriveRecord {
    fn from(ended: rollout::Ended) -> Self {
        let metrics = ended.metrics;
        Self {
            mean_abs_along_m: metrics.mean_abs_along_m,
            mean_abs_cross_m: metrics.mean_abs_cross_m,
            mean_abs_heading_rad: metrics.mean_abs_heading_rad,
            along_mse_m2: metrics.along_mse_m2,
            cross_mse_m2: metrics.cross_mse_m2,
            ticks: metrics.ticks,
            collision: metrics.reason == tracking::EndReason::Collision,
            trace: ended.trace,
        }
    }
}

/// What is kept of an episode.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct EpisodeRecord {
    /// Reward of each step.
    pub rewards: Vec<f64>,
    /// Distance of each step's state to the goal.
    pub distances: Vec<f64>,
    /// The gain set with which it reached its terminal state; none where the step limit ended it.
    pub terminal: Option<GridPosition>,
}

/// One learner.
#[derive(Debug, Clone)]
pub struct Learner {
    learning: Learning,
    grid: Grid,
    penalty: f64,
    alpha: f64,
    rng: Stream,
    q: Vec<f64>,
    visits: Vec<u32>,
    set_visits: Vec<u32>,
    /// Sum of the distances of each set's drives.
    set_distances: Vec<f64>,
    locked: [Option<u16>; 4],
    /// The gain set that is driven now, or was driven last.
    position: GridPosition,
    /// The action that led to it.
    action: usize,
    /// State and distance before that action; none while the coming drive only tells where the learner is.
    before: Option<(usize, f64)>,
    closest: f64,
    best: f64,
    terminal_sets: Vec<GridPosition>,
    episodes: Vec<EpisodeRecord>,
    current: EpisodeRecord,
    step: u32,
    drives: Sha256,
}

impl Learner {
    /// Learner number `number` of a run, with its learning rate and its own random stream.
    pub fn new(config: &RunConfig, number: u32, alpha: f64) -> Self {
        let learning = config.learning;
        let grid = config.grid;
        let bins = learning.bins as usize;
        let mut rng = Stream::new(config.run.seed, u64::from(number));
        let position = match learning.first_gains {
            FirstGains::Random => random_position(&grid, &mut rng),
            FirstGains::Centre => GridPosition(grid.axes().map(|axis| (axis.len() / 2) as u16)),
        };
        Self {
            learning,
            grid,
            penalty: if config.collision.enabled { config.collision.penalty } else { 0.0 },
            alpha,
            rng,
            q: vec![0.0; bins * bins * ACTIONS],
            visits: vec![0; bins * bins * ACTIONS],
            set_visits: vec![0; grid.len()],
            set_distances: vec![0.0; grid.len()],
            locked: [None; 4],
            position,
            action: 0,
            before: None,
            closest: f64::INFINITY,
            best: f64::INFINITY,
            terminal_sets: Vec::new(),
            episodes: Vec::new(),
            current: EpisodeRecord::default(),
            step: 0,
            drives: Sha256::new(),
        }
    }

    /// The step that waits for a drive, and its gain set; none once the training is over.
    pub fn wanted(&self) -> Option<(u32, GridPosition)> {
        (!self.is_finished()).then_some((self.step, self.position))
    }

    /// Whether all episodes are over.
    pub fn is_finished(&self) -> bool {
        self.episodes.len() >= self.learning.episodes as usize
    }

    /// Takes the drive that [`Learner::wanted`] asked for, and moves on.
    ///
    /// # Panics
    /// If the learner has finished.
    pub fn learn(&mut self, drive: &DriveRecord) {
        assert!(!self.is_finished(), "a finished learner wants no drive");
        self.hash_drive(drive);
        let state = self.state(drive);
        let distance = self.distance(drive);
        let set = self.grid.index(self.position);
        self.set_visits[set] += 1;
        self.set_distances[set] += distance;
        self.best = self.best.min(distance);
        match self.before {
            None => self.next_action(state, distance),
            Some((old_state, old_distance)) => {
                self.transition(old_state, old_distance, state, distance, drive.collision);
            }
        }
        self.step += 1;
    }

    /// One transition of the paper's algorithm: reward, terminal condition, update, and what comes next.
    fn transition(
        &mut self,
        old_state: usize,
        old_distance: f64,
        state: usize,
        distance: f64,
        collision: bool,
    ) {
        // Equation 5, less the penalty.
        let penalty = if collision { self.penalty } else { 0.0 };
        let reward = 1.0 / (1.0 + distance) - 1.0 / (1.0 + old_distance) - penalty;
        self.current.rewards.push(reward);
        self.current.distances.push(distance);

        let compared = match self.learning.closest_by {
            ClosestBy::Continuous => distance,
            ClosestBy::Binned => self.binned_distance(state),
        };
        let terminated = compared < self.closest;
        let at_limit = self.current.rewards.len() >= self.learning.step_limit as usize;
        let truncated = !terminated && at_limit;

        let ends_in_nothing = terminated
            || (truncated && self.learning.step_limit_effect == StepLimitEffect::Terminates);
        let future = if ends_in_nothing { 0.0 } else { self.learning.gamma * self.max_q(state) };
        let entry = old_state * ACTIONS + self.action;
        self.q[entry] += self.alpha * (reward + future - self.q[entry]);
        self.visits[entry] += 1;

        if terminated {
            self.closest = compared;
            self.current.terminal = Some(self.position);
            self.terminal_sets.push(self.position);
            if self.learning.tuner == Tuner::EducatedQ {
                self.lock_agreed_gains();
            }
        }
        if terminated || truncated {
            self.episodes.push(std::mem::take(&mut self.current));
            if self.learning.closest_over == ClosestOver::Episode {
                self.closest = f64::INFINITY;
            }
            if self.learning.episode_gains == EpisodeGains::Random {
                let random = random_position(&self.grid, &mut self.rng);
                self.position = self.within_locks(random);
                self.before = None;
                return;
            }
        }
        self.next_action(state, distance);
    }

    /// Chooses an action in `state`, epsilon-greedily, and the gain set that it leads to.
    fn next_action(&mut self, state: usize, distance: f64) {
        self.action = if self.rng.uniform() < self.epsilon() {
            self.rng.below(ACTIONS)
        } else {
            self.greedy_action(state)
        };
        let mut digits = self.action;
        let mut moved = self.position;
        let mut left_grid = false;
        for (axis, place) in self.grid.axes().iter().zip(&mut moved.0) {
            let wanted = i32::from(*place) + (digits % 3) as i32 - 1;
            digits /= 3;
            let bound = wanted.clamp(0, axis.len() as i32 - 1);
            left_grid |= bound != wanted;
            *place = bound as u16;
        }
        if left_grid && self.learning.out_of_range == OutOfRange::Stay {
            moved = self.position;
        }
        self.position = self.within_locks(moved);
        self.before = Some((state, distance));
    }

    /// A locked gain's range is that one value.
    fn within_locks(&self, mut position: GridPosition) -> GridPosition {
        for (place, locked) in position.0.iter_mut().zip(self.locked) {
            *place = locked.unwrap_or(*place);
        }
        position
    }

    fn greedy_action(&mut self, state: usize) -> usize {
        let values = &self.q[state * ACTIONS..(state + 1) * ACTIONS];
        let best = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let ties = || (0..ACTIONS).filter(|action| values[*action] == best);
        let chosen = match self.learning.greedy_ties {
            GreedyTies::First => 0,
            GreedyTies::Random => self.rng.below(ties().count()),
        };
        ties().nth(chosen).expect("the largest value is one of the values")
    }

    fn lock_agreed_gains(&mut self) {
        let window = self.learning.lock_window as usize;
        let Some(from) = self.terminal_sets.len().checked_sub(window) else { return };
        let last = &self.terminal_sets[from..];
        for axis in 0..4 {
            let place = last[0].0[axis];
            if self.locked[axis].is_none() && last.iter().all(|set| set.0[axis] == place) {
                self.locked[axis] = Some(place);
            }
        }
    }

    /// Exploration rate of the current episode.
    pub fn epsilon(&self) -> f64 {
        let over = self.learning.epsilon_decay_share * f64::from(self.learning.episodes);
        let share = self.episodes.len() as f64 / over;
        (self.learning.epsilon_start * (1.0 - share)).max(0.0)
    }

    fn max_q(&self, state: usize) -> f64 {
        let values = &self.q[state * ACTIONS..(state + 1) * ACTIONS];
        values.iter().copied().fold(f64::NEG_INFINITY, f64::max)
    }

    /// The drive's state: both mean errors in bins, what lies above the limit in the last one.
    fn state(&self, drive: &DriveRecord) -> usize {
        let bins = self.learning.bins as usize;
        let bin = |error: f64, high: f64| ((error / high * bins as f64) as usize).min(bins - 1);
        bin(drive.mean_abs_cross_m, self.learning.error_high_cross_m) * bins
            + bin(drive.mean_abs_heading_rad, self.learning.error_high_heading_rad)
    }

    fn distance(&self, drive: &DriveRecord) -> f64 {
        let weight = self.learning.heading_weight;
        state_distance(drive.mean_abs_cross_m, drive.mean_abs_heading_rad, weight)
    }

    /// Distance of the middle of a state's bins.
    fn binned_distance(&self, state: usize) -> f64 {
        let bins = self.learning.bins as usize;
        let middle = |bin: usize, high: f64| (bin as f64 + 0.5) * high / bins as f64;
        state_distance(
            middle(state / bins, self.learning.error_high_cross_m),
            middle(state % bins, self.learning.error_high_heading_rad),
            self.learning.heading_weight,
        )
    }

    fn hash_drive(&mut self, drive: &DriveRecord) {
        self.drives.update(self.grid.index(self.position).to_le_bytes());
        for number in [
            drive.mean_abs_along_m,
            drive.mean_abs_cross_m,
            drive.mean_abs_heading_rad,
            drive.along_mse_m2,
            drive.cross_mse_m2,
        ] {
            self.drives.update(number.to_bits().to_le_bytes());
        }
        self.drives.update(drive.ticks.to_le_bytes());
        self.drives.update([u8::from(drive.collision)]);
        self.drives.update(drive.trace.to_le_bytes());
    }

    /// The gain set that this learner picks, once it has any.
    pub fn pick(&self) -> GridPosition {
        match self.learning.pick {
            Pick::LastTerminal => self.terminal_sets.last().copied().unwrap_or(self.position),
            Pick::MostVisited => {
                // The first of the most visited: the lowest number.
                let most = self.set_visits.iter().max().copied().unwrap_or_default();
                let index = self.set_visits.iter().position(|visits| *visits == most);
                self.grid.position(index.unwrap_or_default())
            }
        }
    }

    /// Adds what the learner received and became to a digest.
    pub(crate) fn digest_into(&self, digest: &mut Sha256) {
        digest.update(self.alpha.to_bits().to_le_bytes());
        digest.update(self.step.to_le_bytes());
        digest.update(self.drives.clone().finalize());
        for value in &self.q {
            digest.update(value.to_bits().to_le_bytes());
        }
        for visits in self.visits.iter().chain(&self.set_visits) {
            digest.update(visits.to_le_bytes());
        }
        for locked in self.locked {
            digest.update(locked.map_or(u16::MAX, |place| place).to_le_bytes());
        }
        digest.update(self.grid.index(self.pick()).to_le_bytes());
    }

    /// Learning rate.
    pub fn alpha(&self) -> f64 {
        self.alpha
    }

    /// Drives that were asked for and answered.
    pub fn drives_taken(&self) -> u32 {
        self.step
    }

    /// Drives of the set with this number in the grid, and the sum of their distances to the goal.
    pub fn drives_of(&self, set: usize) -> (u32, f64) {
        (self.set_visits[set], self.set_distances[set])
    }

    /// Least distance to the goal of any drive; infinite before the first.
    pub fn best_distance(&self) -> f64 {
        self.best
    }

    /// The episodes that are over.
    pub fn episodes(&self) -> &[EpisodeRecord] {
        &self.episodes
    }

    /// Locked gains, by position along their axis.
    pub fn locked(&self) -> [Option<u16>; 4] {
        self.locked
    }
}

fn random_position(grid: &Grid, rng: &mut Stream) -> GridPosition {
    GridPosition(grid.axes().map(|axis| rng.below(axis.len()) as u16))
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::Layers;

    fn config(sets: &[&str]) -> RunConfig {
        let mut layers = Layers::maneuver("lane_change").unwrap();
        for set in sets {
            layers.set(set).unwrap();
        }
        layers.resolve().unwrap()
    }

    fn drive(cross_m: f64) -> DriveRecord {
        DriveRecord {
            mean_abs_along_m: 0.0,
            mean_abs_cross_m: cross_m,
            mean_abs_heading_rad: 0.0,
            along_mse_m2: 0.0,
            cross_mse_m2: 0.0,
            ticks: 1,
            collision: false,
            trace: 0,
        }
    }

    #[test]
    fn the_first_drive_only_tells_where_the_learner_is() {
        let mut learner = Learner::new(&config(&[]), 0, 0.5);
        learner.learn(&drive(1.0));
        assert_eq!(learner.closest, f64::INFINITY);
        assert!(learner.current.rewards.is_empty() && learner.episodes.is_empty());
        // The second is a step, and any state is closer than none: the first episode ends with it.
        learner.learn(&drive(2.0));
        assert_eq!(learner.episodes.len(), 1);
        assert_eq!(learner.episodes[0].rewards, [1.0 / 3.0 - 1.0 / 2.0]);
        assert_eq!(learner.closest, 2.0);
    }

    #[test]
    fn the_update_is_the_paper_s_and_a_terminal_state_is_worth_nothing() {
        let mut learner = Learner::new(&config(&[]), 0, 0.5);
        learner.learn(&drive(1.0));
        let (state, _) = learner.before.unwrap();
        let entry = state * ACTIONS + learner.action;
        // Would count if the state were not terminal.
        let there = learner.state(&drive(0.5));
        learner.q[there * ACTIONS..(there + 1) * ACTIONS].fill(7.0);
        learner.learn(&drive(0.5));
        let reward = 1.0 / 1.5 - 1.0 / 2.0;
        assert_eq!(learner.q[entry], 0.5 * reward);
        assert_eq!(learner.visits[entry], 1);
    }

    #[test]
    fn the_step_limit_bootstraps_through_the_end_unless_told_otherwise() {
        let updated = |sets: &[&str]| {
            let mut all = vec!["learning.step_limit=1"];
            all.extend(sets);
            let mut learner = Learner::new(&config(&all), 0, 1.0);
            learner.closest = 0.0;
            learner.learn(&drive(1.0));
            let entry = learner.before.unwrap().0 * ACTIONS + learner.action;
            let there = learner.state(&drive(2.0));
            learner.q[there * ACTIONS..(there + 1) * ACTIONS].fill(10.0);
            learner.learn(&drive(2.0));
            assert_eq!(learner.episodes.len(), 1);
            assert_eq!(learner.episodes[0].terminal, None);
            learner.q[entry]
        };
        let reward = 1.0 / 3.0 - 1.0 / 2.0;
        assert_eq!(updated(&[]), reward + 0.9 * 10.0);
        assert_eq!(updated(&["learning.step_limit_effect=terminates"]), reward);
    }

    #[test]
    fn five_terminal_sets_that_agree_lock_a_gain_for_good() {
        let mut learner = Learner::new(&config(&[]), 0, 0.5);
        for place in [0, 1, 2, 3] {
            learner.terminal_sets.push(GridPosition([place, 4, place, place]));
        }
        learner.lock_agreed_gains();
        assert_eq!(learner.locked, [None; 4]);
        learner.terminal_sets.push(GridPosition([4, 4, 0, 0]));
        learner.lock_agreed_gains();
        assert_eq!(learner.locked, [None, Some(4), None, None]);
        assert_eq!(learner.within_locks(GridPosition([1, 1, 1, 1])), GridPosition([1, 4, 1, 1]));
        for _ in 0..9 {
            learner.terminal_sets.push(GridPosition([2, 0, 0, 0]));
        }
        learner.lock_agreed_gains();
        assert_eq!(learner.locked, [Some(2), Some(4), Some(0), Some(0)]);
    }

    #[test]
    fn epsilon_falls_to_nothing_by_half_time() {
        let mut learner = Learner::new(&config(&[]), 0, 0.5);
        assert_eq!(learner.epsilon(), 1.0);
        learner.episodes = vec![EpisodeRecord::default(); 3];
        assert!((learner.epsilon() - 0.8).abs() < 1e-12);
        learner.episodes = vec![EpisodeRecord::default(); 20];
        assert_eq!(learner.epsilon(), 0.0);
    }

    #[test]
    fn errors_above_the_limit_fall_into_the_last_bin() {
        let learner = Learner::new(&config(&[]), 0, 0.5);
        assert_eq!(learner.state(&drive(0.0)), 0);
        assert_eq!(learner.state(&drive(2.999)), 39 * 40);
        assert_eq!(learner.state(&drive(1e9)), 39 * 40);
    }

    #[test]
    fn a_collision_costs_its_penalty() {
        let mut learner = Learner::new(&config(&["collision.enabled=true"]), 0, 0.5);
        learner.learn(&drive(1.0));
        learner.learn(&DriveRecord { collision: true, ..drive(1.0) });
        assert_eq!(learner.episodes[0].rewards, [-1.0]);
    }

    #[test]
    fn every_reading_runs_to_its_end() {
        for set in [
            "learning.tuner=q",
            "learning.episode_gains=random",
            "learning.out_of_range=stay",
            "learning.closest_over=episode",
            "learning.closest_by=binned",
            "learning.step_limit_effect=terminates",
            "learning.pick=most_visited",
            "learning.first_gains=centre",
            "learning.greedy_ties=first",
        ] {
            let mut learner = Learner::new(&config(&[set]), 0, 0.5);
            while let Some((step, position)) = learner.wanted() {
                assert!(step <= 30 * 131, "{set} goes on for ever");
                learner.learn(&drive(f64::from(position.0[0]) + 0.5));
            }
            assert_eq!(learner.episodes().len(), 30);
        }
    }
}
