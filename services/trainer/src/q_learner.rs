//! One learner: educated Q-learning (section 2.4 of the paper) as a state machine that waits for drives.
//!
//! A learner always wants exactly one drive, or has finished. [`QLearner::learn`] takes that drive and decides
//! what comes next; nothing else changes its state.

mod saved;

use config::{
    ClosestBy, ClosestOver, EpisodeGains, FirstGains, GreedyTies, Grid, GridPosition, Learning,
    MAX_PARAMETERS, OutOfRange, Parameters, Pick, RunConfig, StepLimitEffect,
};
use outcome::{LearnerSummary, Usage};
use sha2::{Digest, Sha256};
use tracking::{DriveRecord, state_distance};

use crate::digest::add_parameters;
use crate::q_learning::Method;
use crate::rng::Stream;
use crate::tuners::{EpisodeRecord, Told};

pub(crate) use saved::SavedLearner;

/// One learner.
#[derive(Debug, Clone)]
pub(crate) struct QLearner {
    learning: Learning,
    method: Method,
    grid: Grid,
    /// Each parameter goes down, stays, or goes up.
    actions: usize,
    penalty: f64,
    alpha: f64,
    rng: Stream,
    q: Vec<f64>,
    visits: Vec<u32>,
    set_visits: Vec<u32>,
    locked: [Option<u16>; MAX_PARAMETERS],
    /// The set that is driven now, or was driven last.
    position: GridPosition,
    /// The action that led to it.
    action: usize,
    /// State and value of the objective before that action; `None` if the coming drive only shows in which state the
    /// learner is.
    before: Option<(usize, f64)>,
    closest: f64,
    best: f64,
    /// The last terminal sets, as many as the lock's window holds.
    terminal_sets: Vec<GridPosition>,
    /// Episodes that are over, and how many of them reached a terminal state.
    episodes: u32,
    terminated: u32,
    current: EpisodeRecord,
    step: u32,
}

impl QLearner {
    /// Learner number `number` of a run, with its learning rate and its own random stream.
    pub(crate) fn new(config: &RunConfig, method: Method, number: u32, alpha: f64) -> Self {
        let learning = config.learning.clone();
        let grid = config.grid();
        let bins = learning.bins as usize;
        let actions = 3usize.pow(grid.axes().len() as u32);
        let mut rng = Stream::new(config.run.seed, u64::from(number));
        let position = match learning.first_gains {
            FirstGains::Random => random_position(&grid, &mut rng),
            FirstGains::Centre => {
                let centre = grid.axes().iter().map(|axis| (axis.len() / 2) as u16);
                GridPosition::of(&centre.collect::<Vec<_>>())
            }
        };
        Self {
            learning,
            method,
            grid,
            actions,
            penalty: if config.collision.enabled { config.collision.penalty } else { 0.0 },
            alpha,
            rng,
            q: vec![0.0; bins * bins * actions],
            visits: vec![0; bins * bins * actions],
            set_visits: vec![0; grid.len()],
            locked: [None; MAX_PARAMETERS],
            position,
            action: 0,
            before: None,
            closest: f64::INFINITY,
            best: f64::INFINITY,
            terminal_sets: Vec::new(),
            episodes: 0,
            terminated: 0,
            current: EpisodeRecord::default(),
            step: 0,
        }
    }

    /// The step that waits for a drive, and its set; `None` once the training is over.
    pub(crate) fn wanted(&self) -> Option<(u32, Parameters)> {
        (!self.is_finished()).then(|| (self.step, self.grid.set(self.position)))
    }

    /// Whether all episodes are over.
    pub(crate) fn is_finished(&self) -> bool {
        self.episodes >= self.learning.episodes
    }

    /// Takes the drive that [`QLearner::wanted`] asked for, with its value by the objective, and moves on.
    ///
    /// # Panics
    /// If the learner has finished.
    pub(crate) fn learn(&mut self, drive: &DriveRecord, value: f64) -> Told {
        assert!(!self.is_finished(), "a finished learner wants no drive");
        let state = self.state(drive);
        self.set_visits[self.grid.index(self.position)] += 1;
        self.best = self.best.min(value);
        let told = match self.before {
            None => {
                self.next_action(state, value);
                Told::default()
            }
            Some((old_state, old_value)) => {
                self.transition(old_state, old_value, state, value, drive.collided())
            }
        };
        self.step += 1;
        told
    }

    /// One transition of the paper's algorithm: reward, terminal condition, update, and what comes next.
    fn transition(
        &mut self,
        old_state: usize,
        old_value: f64,
        state: usize,
        value: f64,
        collision: bool,
    ) -> Told {
        // Equation 5, less the penalty; the paper's objective is the distance.
        let penalty = if collision { self.penalty } else { 0.0 };
        let reward = 1.0 / (1.0 + value) - 1.0 / (1.0 + old_value) - penalty;
        self.current.steps += 1;
        self.current.reward_sum += reward;
        self.current.last_value = value;

        let compared = match self.learning.closest_by {
            ClosestBy::Continuous => value,
            ClosestBy::Binned => self.binned_distance(state),
        };
        let terminated = compared < self.closest;
        let at_limit = self.current.steps >= self.learning.step_limit;
        let truncated = !terminated && at_limit;

        let ends_in_nothing = terminated
            || (truncated && self.learning.step_limit_effect == StepLimitEffect::Terminates);
        let future = if ends_in_nothing { 0.0 } else { self.learning.gamma * self.max_q(state) };
        let entry = old_state * self.actions + self.action;
        self.q[entry] += self.alpha * (reward + future - self.q[entry]);
        self.visits[entry] += 1;

        if terminated {
            self.closest = compared;
            self.current.terminal = Some(self.grid.set(self.position));
            self.terminated += 1;
            if self.terminal_sets.len() == self.learning.lock_window as usize {
                self.terminal_sets.remove(0);
            }
            self.terminal_sets.push(self.position);
            if self.method.locks {
                self.lock_agreed_gains();
            }
        }
        let mut told = Told { reward: Some(reward), episode: None };
        if terminated || truncated {
            let number = self.episodes;
            told.episode = Some(EpisodeRecord { number, ..std::mem::take(&mut self.current) });
            self.episodes += 1;
            if self.learning.closest_over == ClosestOver::Episode {
                self.closest = f64::INFINITY;
            }
            if self.learning.episode_gains == EpisodeGains::Random {
                let random = random_position(&self.grid, &mut self.rng);
                self.position = self.within_locks(random);
                self.before = None;
                return told;
            }
        }
        self.next_action(state, value);
        told
    }

    /// Chooses an action in `state`, epsilon-greedily, and the gain set that it leads to.
    fn next_action(&mut self, state: usize, value: f64) {
        self.action = if self.rng.uniform() < self.epsilon() {
            self.rng.below(self.actions)
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
        self.before = Some((state, value));
    }

    /// Restricts the range of a locked gain to its one value.
    fn within_locks(&self, mut position: GridPosition) -> GridPosition {
        for (place, locked) in position.0.iter_mut().zip(self.locked) {
            *place = locked.unwrap_or(*place);
        }
        position
    }

    fn greedy_action(&mut self, state: usize) -> usize {
        let values = &self.q[state * self.actions..(state + 1) * self.actions];
        let best = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let actions = self.actions;
        let ties = || (0..actions).filter(|action| values[*action] == best);
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
        for axis in 0..self.grid.axes().len() {
            let place = last[0].0[axis];
            if self.locked[axis].is_none() && last.iter().all(|set| set.0[axis] == place) {
                self.locked[axis] = Some(place);
            }
        }
    }

    /// Exploration rate of the current episode.
    pub(crate) fn epsilon(&self) -> f64 {
        if let Some(epsilon) = self.method.epsilon {
            return epsilon;
        }
        let over = self.learning.epsilon_decay_share * f64::from(self.learning.episodes);
        let share = f64::from(self.episodes) / over;
        (self.learning.epsilon_start * (1.0 - share)).max(0.0)
    }

    fn max_q(&self, state: usize) -> f64 {
        let values = &self.q[state * self.actions..(state + 1) * self.actions];
        values.iter().copied().fold(f64::NEG_INFINITY, f64::max)
    }

    /// The drive's state: both mean errors in bins; the last bin includes everything above the limit.
    fn state(&self, drive: &DriveRecord) -> usize {
        let bins = self.learning.bins as usize;
        let bin = |error: f64, high: f64| ((error / high * bins as f64) as usize).min(bins - 1);
        bin(drive.mean_abs_cross_m, self.learning.error_high_cross_m) * bins
            + bin(drive.mean_abs_heading_rad, self.learning.error_high_heading_rad)
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

    /// The set that this learner picks, once it has any.
    pub(crate) fn pick(&self) -> Parameters {
        self.grid.set(match self.learning.pick {
            Pick::LastTerminal => self.terminal_sets.last().copied().unwrap_or(self.position),
            Pick::MostVisited => {
                // Of equally visited sets the first one, which has the lowest number.
                let most = self.set_visits.iter().max().copied().unwrap_or_default();
                let index = self.set_visits.iter().position(|visits| *visits == most);
                self.grid.position(index.unwrap_or_default())
            }
        })
    }

    /// Adds what the learner became to a digest.
    pub(crate) fn digest_into(&self, digest: &mut Sha256) {
        digest.update(self.alpha.to_bits().to_le_bytes());
        digest.update(self.step.to_le_bytes());
        for value in &self.q {
            digest.update(value.to_bits().to_le_bytes());
        }
        for visits in self.visits.iter().chain(&self.set_visits) {
            digest.update(visits.to_le_bytes());
        }
        for locked in &self.locked[..self.grid.axes().len()] {
            digest.update(locked.unwrap_or(u16::MAX).to_le_bytes());
        }
        add_parameters(digest, &self.pick());
    }

    /// Number of drives that were asked for and answered.
    pub(crate) fn drives_taken(&self) -> u32 {
        self.step
    }

    /// Least value of the objective of any drive; infinite before the first.
    pub(crate) fn best_value(&self) -> f64 {
        self.best
    }

    /// Episodes that are over.
    pub(crate) fn episodes(&self) -> u32 {
        self.episodes
    }

    /// A summary of how it learnt, of bounded size.
    pub(crate) fn summary(&self, config: &RunConfig) -> LearnerSummary {
        let axes = self.grid.axes();
        let names = || config.law.keys().map(str::to_owned).enumerate();
        let locked = names().filter_map(|(axis, name)| {
            let place = self.locked[axis]?;
            Some((name, axes[axis].value(place as usize)))
        });
        LearnerSummary {
            alpha: Some(self.alpha),
            gains: config.law.named(&self.pick()),
            locked: locked.collect(),
            usage: names().map(|(axis, name)| (name, self.usage(axis))).collect(),
            drives: self.step,
            episodes: self.episodes,
            terminated: self.terminated,
            best: self.best.is_finite().then_some(self.best),
        }
    }

    /// How often each value of a parameter was driven.
    fn usage(&self, axis: usize) -> Vec<Usage> {
        let values = self.grid.axes()[axis];
        let mut usage: Vec<Usage> =
            (0..values.len()).map(|place| Usage { value: values.value(place), count: 0 }).collect();
        for (set, visits) in self.set_visits.iter().enumerate() {
            let place = self.grid.position(set).0[axis] as usize;
            usage[place].count += u64::from(*visits);
        }
        usage
    }
}

fn random_position(grid: &Grid, rng: &mut Stream) -> GridPosition {
    let places = grid.axes().iter().map(|axis| rng.below(axis.len()) as u16);
    GridPosition::of(&places.collect::<Vec<_>>())
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::Layers;
    use tracking::EndReason;

    fn config(sets: &[&str]) -> RunConfig {
        let mut layers = Layers::maneuver("lane_change").unwrap();
        for set in sets {
            layers.set(set).unwrap();
        }
        layers.resolve().unwrap()
    }

    /// Actions of the paper's four gains.
    const ACTIONS: usize = 81;

    fn learner(sets: &[&str], alpha: f64) -> QLearner {
        let method = Method { locks: true, epsilon: None };
        QLearner::new(&config(sets), method, 0, alpha)
    }

    fn drive(cross_m: f64) -> DriveRecord {
        DriveRecord { mean_abs_cross_m: cross_m, ..DriveRecord::default() }
    }

    /// Learns from a drive whose value is its cross-track error.
    fn learn(learner: &mut QLearner, drive: &DriveRecord) -> Told {
        learner.learn(drive, drive.mean_abs_cross_m)
    }

    #[test]
    fn the_first_drive_only_tells_where_the_learner_is() {
        let mut learner = learner(&[], 0.5);
        learn(&mut learner, &drive(1.0));
        assert_eq!(learner.closest, f64::INFINITY);
        assert_eq!((learner.current.steps, learner.episodes), (0, 0));
        // The second drive is a step, and any state is closer than none: the first episode ends with it.
        let episode = learn(&mut learner, &drive(2.0)).episode.unwrap();
        assert_eq!((learner.episodes, episode.number, episode.steps), (1, 0, 1));
        assert_eq!(episode.reward_sum, 1.0 / 3.0 - 1.0 / 2.0);
        assert_eq!(learner.closest, 2.0);
    }

    #[test]
    fn the_update_is_the_paper_s_and_a_terminal_state_is_worth_nothing() {
        let mut learner = learner(&[], 0.5);
        learn(&mut learner, &drive(1.0));
        let (state, _) = learner.before.unwrap();
        let entry = state * ACTIONS + learner.action;
        // This value would count if the state were not terminal.
        let there = learner.state(&drive(0.5));
        learner.q[there * ACTIONS..(there + 1) * ACTIONS].fill(7.0);
        learn(&mut learner, &drive(0.5));
        let reward = 1.0 / 1.5 - 1.0 / 2.0;
        assert_eq!(learner.q[entry], 0.5 * reward);
        assert_eq!(learner.visits[entry], 1);
    }

    #[test]
    fn the_step_limit_bootstraps_through_the_end_unless_told_otherwise() {
        let updated = |sets: &[&str]| {
            let mut all = vec!["learning.step_limit=1"];
            all.extend(sets);
            let mut learner = learner(&all, 1.0);
            learner.closest = 0.0;
            learn(&mut learner, &drive(1.0));
            let entry = learner.before.unwrap().0 * ACTIONS + learner.action;
            let there = learner.state(&drive(2.0));
            learner.q[there * ACTIONS..(there + 1) * ACTIONS].fill(10.0);
            let episode = learn(&mut learner, &drive(2.0)).episode.unwrap();
            assert_eq!((learner.episodes, episode.terminal), (1, None));
            learner.q[entry]
        };
        let reward = 1.0 / 3.0 - 1.0 / 2.0;
        assert_eq!(updated(&[]), reward + 0.9 * 10.0);
        assert_eq!(updated(&["learning.step_limit_effect=terminates"]), reward);
    }

    #[test]
    fn five_terminal_sets_that_agree_lock_a_gain_for_good() {
        let mut learner = learner(&[], 0.5);
        for place in [0, 1, 2, 3] {
            learner.terminal_sets.push(GridPosition::of(&[place, 4, place, place]));
        }
        learner.lock_agreed_gains();
        assert_eq!(learner.locked[..4], [None; 4]);
        learner.terminal_sets.push(GridPosition::of(&[4, 4, 0, 0]));
        learner.lock_agreed_gains();
        assert_eq!(learner.locked[..4], [None, Some(4), None, None]);
        assert_eq!(
            learner.within_locks(GridPosition::of(&[1, 1, 1, 1])),
            GridPosition::of(&[1, 4, 1, 1])
        );
        for _ in 0..9 {
            learner.terminal_sets.push(GridPosition::of(&[2, 0, 0, 0]));
        }
        learner.lock_agreed_gains();
        assert_eq!(learner.locked[..4], [Some(2), Some(4), Some(0), Some(0)]);
    }

    #[test]
    fn epsilon_falls_to_nothing_by_half_time() {
        let mut learner = learner(&[], 0.5);
        assert_eq!(learner.epsilon(), 1.0);
        learner.episodes = 3;
        assert!((learner.epsilon() - 0.8).abs() < 1e-12);
        learner.episodes = 20;
        assert_eq!(learner.epsilon(), 0.0);
    }

    #[test]
    fn errors_above_the_limit_fall_into_the_last_bin() {
        let learner = learner(&[], 0.5);
        assert_eq!(learner.state(&drive(0.0)), 0);
        assert_eq!(learner.state(&drive(2.999)), 39 * 40);
        assert_eq!(learner.state(&drive(1e9)), 39 * 40);
    }

    #[test]
    fn a_collision_costs_its_penalty() {
        let mut learner = learner(&["collision.enabled=true"], 0.5);
        learn(&mut learner, &drive(1.0));
        let crash = DriveRecord { reason: EndReason::Collision, ..drive(1.0) };
        assert_eq!(learn(&mut learner, &crash).reward, Some(-1.0));
    }

    #[test]
    fn every_reading_runs_to_its_end() {
        for set in [
            "learning.episode_gains=random",
            "learning.out_of_range=stay",
            "learning.closest_over=episode",
            "learning.closest_by=binned",
            "learning.step_limit_effect=terminates",
            "learning.pick=most_visited",
            "learning.first_gains=centre",
            "learning.greedy_ties=first",
        ] {
            let mut learner = learner(&[set], 0.5);
            while let Some((step, set)) = learner.wanted() {
                assert!(step <= 30 * 131, "{set:?} goes on for ever");
                learn(&mut learner, &drive(set.0[0] + 0.5));
            }
            assert_eq!(learner.episodes(), 30);
        }
    }
}
