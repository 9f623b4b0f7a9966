//! Tuners: what proposes parameters and learns from the drives made with them.
//!
//! A tuner is a file of this folder with its row in the table below, and a file of `config/tuners` that says what it is
//! and holds its settings. Memory, journal, finalists and ranking are outside the tuners, and serve all of them.

mod cem;
mod cmaes;
mod coordinate;
mod educated_q;
mod gp;
mod q;
mod random;
mod random_walk;
mod simulate_first;
mod sobol;

use std::cmp::Ordering;
use std::fmt::Debug;

use config::{Parameters, RunConfig};
use outcome::{LearnerSummary, OfDrives, SimulatedFirst};
use sha2::Sha256;
use tracking::{DriveRecord, Objective};

use crate::rng::drive_seed;

/// A drive that a tuner waits for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ask {
    /// The learner that asks: an independent learner, or a member of a population.
    pub learner: u32,
    /// Its step, counted from 0; for a population, the generation.
    pub step: u32,
    /// The parameters of the law.
    pub parameters: Parameters,
    /// Seed of the noise.
    pub seed: u64,
}

impl Ask {
    /// A drive with a seed of its own, derived from the run's.
    pub fn new(config: &RunConfig, learner: u32, step: u32, parameters: Parameters) -> Self {
        let seed = drive_seed(config.run.seed, learner, step);
        Self { learner, step, parameters, seed }
    }
}

/// What a tuner learnt from a drive, for the run's files.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Told {
    /// The reward of the step; `None` if the tuner has no rewards.
    pub reward: Option<f64>,
    /// The episode that ended with it, if one did.
    pub episode: Option<EpisodeRecord>,
}

/// An episode that is over: a row of `episodes.csv`.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct EpisodeRecord {
    /// Its number, counted from 0.
    pub number: u32,
    /// Its steps.
    pub steps: u32,
    /// Sum of the rewards of its steps.
    pub reward_sum: f64,
    /// Value of the objective in its last step.
    pub last_value: f64,
    /// The set with which it reached a terminal state; `None` if the step limit truncated it.
    pub terminal: Option<Parameters>,
}

/// The progress of one learner, for the progress line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LearnerState {
    /// Share of its proposals that are made at random.
    pub epsilon: f64,
    /// Least value of the objective so far; infinite before the first drive.
    pub best_value: f64,
    /// Number of drives that it received.
    pub drives: u32,
    /// Number of episodes that are over; 0 if the tuner has none.
    pub episodes: u32,
    /// Number of all episodes; 0 if the tuner has none, and progress is told by drives.
    pub of_episodes: u32,
}

/// What proposes parameters and learns from drives, as a state machine: the same configuration, seed and drives give the
/// same proposals, in whatever order the learners are served. Reads no clock, and draws every random number from a
/// stream of the run's seed.
pub trait Tuner: Debug + Send + Sync {
    /// Does a part of what it computes before its first drive, and returns which share of that is done. Until that is 1, no
    /// drive is wanted. Most tuners compute nothing.
    ///
    /// # Errors
    /// If it turns out that no set may be driven.
    fn prepare(&mut self) -> Result<f64, String> {
        Ok(1.0)
    }

    /// Number of learners, numbered from 0: as many drives may be under way at once.
    fn learners(&self) -> u32;

    /// The drive that a learner waits for; `None` while it waits for other learners, and once it has finished. Stays
    /// the same until [`Tuner::tell`].
    fn wanted(&self, learner: u32) -> Option<Ask>;

    /// Takes the drive of [`Tuner::wanted`], with its value by the objective (the smaller the better), and moves on.
    fn tell(&mut self, ask: &Ask, drive: &DriveRecord, value: f64) -> Told;

    /// Whether all learners have finished.
    fn is_finished(&self) -> bool {
        (0..self.learners()).all(|learner| self.wanted(learner).is_none())
    }

    /// The set that it recommends once it has finished. Ties go to the set that `order` puts first.
    fn recommend(&self, order: &dyn Fn(&Parameters, &Parameters) -> Ordering) -> Parameters;

    /// The progress of a learner.
    fn state(&self, learner: u32) -> LearnerState;

    /// A summary of how each learner learnt, of bounded size.
    fn story(&self) -> Vec<LearnerSummary>;

    /// Whether what it recommends needs no further drives that choose among its best sets, under noise either.
    fn chooses(&self) -> bool {
        false
    }

    /// What its model says of a set that was driven; `None` if it has none, or where a single drive says it all.
    fn predicted(&self, _set: &Parameters) -> Option<OfDrives> {
        None
    }

    /// After how many of its drives it neither found nor expected a set that is better by more than 1 %; `None` if it did
    /// until its end, or cannot tell.
    fn could_stop_after(&self) -> Option<u32> {
        None
    }

    /// What many simulated plants and few drives say of the set that it recommends.
    fn simulated_first(&self, _objective: &Objective) -> Option<SimulatedFirst> {
        None
    }

    /// Adds what learner number `learner` has become to the run's digest; what it received is in it already.
    fn digest_into(&self, learner: u32, digest: &mut Sha256);

    /// All that tells it from a new tuner, the positions of its random streams included, as bytes of bounded number:
    /// they are saved once a second.
    fn save(&self) -> Vec<u8>;

    /// Makes a new tuner what the one of the same configuration was that saved these bytes. Returns whether they are
    /// such bytes; if not, this tuner must not be used any more.
    fn restore(&mut self, saved: &[u8]) -> bool;
}

/// The table of tuners: the name of the file in `config/tuners`, and what makes one for a configuration.
macro_rules! tuners {
    ($($name:literal => $module:ident),+ $(,)?) => {
        /// The tuner with this name, a row of the table.
        ///
        /// # Panics
        /// If no tuner has that name; a resolved configuration names one.
        pub fn tuner(name: &str, config: &RunConfig) -> Box<dyn Tuner> {
            match name {
                $($name => Box::new($module::new(config)),)+
                other => panic!("the tuner {other} has a file in config/tuners but no row here"),
            }
        }

        #[cfg(test)]
        const NAMES: &[&str] = &[$($name),+];
    };
}

tuners! {
    "educated-q" => educated_q,
    "q" => q,
    "random-walk" => random_walk,
    "random" => random,
    "sobol" => sobol,
    "coordinate" => coordinate,
    "gp" => gp,
    "cem" => cem,
    "cmaes" => cmaes,
    "simulate-first" => simulate_first,
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::Layers;

    #[test]
    fn table_and_files_name_the_same_tuners() {
        let mut known: Vec<&str> = config::names_in("tuners").collect();
        let mut rows = NAMES.to_vec();
        known.sort_unstable();
        rows.sort_unstable();
        assert_eq!(known, rows);
    }

    fn config(tuner: &str) -> RunConfig {
        let mut layers = Layers::maneuver("lane_change").unwrap();
        for set in ["learning.episodes=4", "learning.step_limit=9", "learning.bins=8", "run.seed=7"]
        {
            layers.set(set).unwrap();
        }
        layers.set(&format!("learning.tuner={tuner}")).unwrap();
        let config = layers.clone().resolve().unwrap();
        if config.tuner.has_budget() {
            layers.set("tuner.settings.drives=21").unwrap();
        }
        if tuner == "simulate-first" {
            // Few sets and plants, which are driven indeed.
            for set in [
                "tuner.settings.plants=2",
                "tuner.settings.within_m=100",
                "tuner.settings.draw=grid",
                "grid.kv={min=1,max=1,step=1}",
                "grid.ks={min=1,max=1,step=1}",
                "drive.loop_time_s=1",
            ] {
                layers.set(set).unwrap();
            }
        }
        layers.resolve().unwrap()
    }

    /// The tuner, ready for its first drive.
    fn ready(mut tuner: Box<dyn Tuner>) -> Box<dyn Tuner> {
        while tuner.prepare().unwrap() < 1.0 {}
        tuner
    }

    /// A made-up drive: good where the parameters are large.
    fn drive(ask: &Ask) -> (DriveRecord, f64) {
        let value = 1.0 / (1.0 + ask.parameters.0.iter().sum::<f64>());
        (DriveRecord { mean_abs_cross_m: value, ..DriveRecord::default() }, value)
    }

    /// What a finished tuner comes to.
    fn end(tuner: &dyn Tuner) -> (Parameters, String, Vec<u8>) {
        let order = |a: &Parameters, b: &Parameters| a.0.partial_cmp(&b.0).unwrap();
        let mut digest = <Sha256 as sha2::Digest>::new();
        (0..tuner.learners()).for_each(|it| tuner.digest_into(it, &mut digest));
        let digest = sha2::Digest::finalize(digest);
        let story = format!("{:?} {:?}", tuner.story(), tuner.could_stop_after());
        (tuner.recommend(&order), story, digest.to_vec())
    }

    /// Serves one learner after the other, once each.
    fn serve_all(tuner: &mut dyn Tuner) {
        for learner in 0..tuner.learners() {
            let Some(ask) = tuner.wanted(learner) else { continue };
            let (record, value) = drive(&ask);
            tuner.tell(&ask, &record, value);
        }
    }

    #[test]
    fn every_tuner_goes_on_from_what_it_saved_at_any_step() {
        for name in NAMES {
            let config = config(name);
            let mut calm = ready(tuner(name, &config));
            while !calm.is_finished() {
                serve_all(&mut *calm);
            }
            let mut resumed = ready(tuner(name, &config));
            loop {
                let saved = resumed.save();
                resumed = tuner(name, &config);
                assert!(resumed.restore(&saved), "{name}");
                resumed = ready(resumed);
                assert_eq!(resumed.save(), saved, "{name}");
                if resumed.is_finished() {
                    break;
                }
                serve_all(&mut *resumed);
            }
            assert_eq!(end(&*resumed), end(&*calm), "{name}");
        }
    }

    proptest::proptest! {
        /// A checksum keeps damage off a tuner, but not what another version saved.
        #[test]
        fn no_saved_bytes_make_a_tuner_panic(
            row in 0..NAMES.len(), steps in 0usize..40, at in 0.0..1.0, bytes: [u8; 4], cut: bool,
        ) {
            let config = config(NAMES[row]);
            let mut saving = ready(tuner(NAMES[row], &config));
            (0..steps).for_each(|_| serve_all(&mut *saving));
            let mut saved = saving.save();
            let at = (at * saved.len() as f64) as usize;
            if cut { saved.truncate(at) } else { saved.splice(at..(at + 4).min(saved.len()), bytes); }
            let mut tuner = tuner(NAMES[row], &config);
            if tuner.restore(&saved) {
                tuner = ready(tuner);
                (0..steps).for_each(|_| serve_all(&mut *tuner));
            }
        }
    }

    #[test]
    fn every_tuner_runs_to_its_end_whoever_is_served_first() {
        for name in NAMES {
            let config = config(name);
            let served = [true, false].map(|forwards| {
                let mut tuner = ready(tuner(name, &config));
                // The messages have room for so many.
                assert_eq!(tuner.learners() as usize, config.learners(), "{name}");
                let mut steps = 0;
                while !tuner.is_finished() {
                    let mut learners: Vec<u32> = (0..tuner.learners()).collect();
                    if !forwards {
                        learners.reverse();
                    }
                    for learner in learners {
                        let Some(ask) = tuner.wanted(learner) else { continue };
                        assert_eq!(ask.learner, learner);
                        config.law.check(&ask.parameters).unwrap();
                        let (record, value) = drive(&ask);
                        tuner.tell(&ask, &record, value);
                        steps += 1;
                        assert!(steps < 100_000, "{name} goes on for ever");
                    }
                }
                end(&*tuner)
            });
            assert_eq!(served[0], served[1], "{name}");
            assert!(config.law.check(&served[0].0).is_ok());
        }
    }
}
