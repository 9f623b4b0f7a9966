//! A training: a tuner, the memory of drives that its learners share, and what they have seen.

use std::cmp::Ordering;
use std::collections::HashMap;

use config::{LawConfig, MAX_PARAMETERS, Parameters, RunConfig};
use serde::{Deserialize, Serialize};
use tracking::{DriveRecord, Objective};

use crate::digest::Received;
use crate::over::PlantRollouts;
use crate::tuners::{Ask, Told, Tuner, tuner};

/// A drive that a learner took.
#[derive(Debug, Clone, PartialEq)]
pub struct Taken {
    /// The drive for which it had waited.
    pub ask: Ask,
    /// The drive that it received.
    pub drive: DriveRecord,
    /// The drive's value by the objective; the smaller the better.
    pub value: f64,
    /// Whether the drive was remembered rather than driven.
    pub remembered: bool,
    /// What the tuner learnt from it.
    pub told: Told,
}

/// A parameter set that learners have driven.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VisitedSet {
    /// The set.
    pub parameters: Parameters,
    /// How often it was driven.
    pub visits: u32,
    /// Mean of the objective over its drives.
    pub mean_value: f64,
}

/// A training under way.
#[derive(Debug)]
pub struct Training {
    law: LawConfig,
    tuner: Box<dyn Tuner>,
    objective: Objective,
    /// Whether no two drives are the same.
    noise: bool,
    /// The drives that were made, by their set; `None` if none is remembered. If no two drives are the same, none is.
    memory: Option<HashMap<[u64; MAX_PARAMETERS], DriveRecord>>,
    /// The drives of a budget that no memory holds, in their order; `None` without a budget.
    driven: Option<Vec<(Parameters, DriveRecord)>>,
    /// What each learner has received.
    received: Vec<Received>,
    /// Number of drives and the sum of their values, by set and learner. Kept learner by learner, because the order in
    /// which learners are served must not change the order in which numbers are added.
    visited: HashMap<[u64; MAX_PARAMETERS], Visits>,
}

/// Number of drives with a set and the sum of their values, by learner.
type Visits = Vec<(u32, f64)>;

/// What a training has become, as plain data; see [`Training::save`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct SavedTraining {
    tuner: Vec<u8>,
    received: Vec<Vec<u8>>,
    memory: Option<Vec<(Vec<f64>, DriveRecord)>>,
    driven: Option<Vec<(Vec<f64>, DriveRecord)>>,
    visited: Vec<(Vec<f64>, Visits)>,
}

impl Training {
    /// A training at its first step, whose drives are judged by `objective`.
    pub fn new(config: &RunConfig, objective: Objective) -> Self {
        let tuner = tuner(&config.learning.tuner, config);
        let remembers = config.run.memo && !config.drives_differ();
        Self {
            law: config.law.clone(),
            received: vec![Received::default(); tuner.learners() as usize],
            tuner,
            objective,
            noise: config.drives_differ(),
            memory: remembers.then(HashMap::new),
            driven: (!remembers && config.tuner.has_budget()).then(Vec::new),
            visited: HashMap::new(),
        }
    }

    /// What it has become: all that [`Training::restored`] needs to go on from here.
    pub(crate) fn save(&self) -> SavedTraining {
        let values = |bits: &[u64; MAX_PARAMETERS]| {
            bits[..self.law.count()].iter().map(|bits| f64::from_bits(*bits)).collect()
        };
        SavedTraining {
            tuner: self.tuner.save(),
            received: self.received.iter().map(Received::save).collect(),
            memory: self
                .memory
                .as_ref()
                .map(|memory| memory.iter().map(|(bits, drive)| (values(bits), *drive)).collect()),
            driven: self.driven.as_ref().map(|driven| {
                driven.iter().map(|(set, drive)| (values(&set.to_bits()), *drive)).collect()
            }),
            visited: self
                .visited
                .iter()
                .map(|(bits, learners)| (values(bits), learners.clone()))
                .collect(),
        }
    }

    /// A training of the same configuration at the step at which it was saved; `None` if it was none of that
    /// configuration.
    pub(crate) fn restored(
        config: &RunConfig,
        objective: Objective,
        saved: SavedTraining,
    ) -> Option<Self> {
        let SavedTraining { tuner, received, memory, driven, visited } = saved;
        let mut training = Self::new(config, objective);
        let learners = training.received.len();
        let count = training.law.count();
        let bits =
            |values: &[f64]| (values.len() == count).then(|| Parameters::of(values).to_bits());
        training.received =
            received.iter().map(|it| Received::restored(it)).collect::<Option<_>>()?;
        let memory = match memory {
            Some(memory) => Some(
                memory
                    .iter()
                    .map(|(values, drive)| Some((bits(values)?, *drive)))
                    .collect::<Option<HashMap<_, _>>>()?,
            ),
            None => None,
        };
        if training.received.len() != learners || memory.is_some() != training.memory.is_some() {
            return None;
        }
        training.memory = memory;
        let set = |values: &[f64]| (values.len() == count).then(|| Parameters::of(values));
        training.driven = match driven {
            Some(driven) => Some(
                driven.iter().map(|(it, drive)| Some((set(it)?, *drive))).collect::<Option<_>>()?,
            ),
            None => None,
        };
        training.visited = visited
            .into_iter()
            .map(|(values, of_learners)| {
                (of_learners.len() == learners).then_some((bits(&values)?, of_learners))
            })
            .collect::<Option<_>>()?;
        training.tuner.restore(&tuner).then_some(training)
    }

    /// The law whose parameters are tuned.
    pub fn law(&self) -> &LawConfig {
        &self.law
    }

    /// The objective by which drives are judged.
    pub fn objective(&self) -> &Objective {
        &self.objective
    }

    /// The tuner.
    pub fn tuner(&self) -> &dyn Tuner {
        &*self.tuner
    }

    /// Does a part of what the tuner computes before its first drive; see [`Tuner::prepare`].
    ///
    /// # Errors
    /// If no set may be driven.
    pub fn prepare(&mut self) -> Result<f64, String> {
        self.tuner.prepare()
    }

    /// Whether every learner has finished.
    pub fn is_finished(&self) -> bool {
        self.tuner.is_finished()
    }

    /// Answers from memory what can be answered, at most `at_most` steps; passes each step to `each`. Returns whether
    /// every learner now waits for a drive or for other learners, or has finished.
    pub fn remember(&mut self, at_most: usize, mut each: impl FnMut(&Taken)) -> bool {
        let mut steps = 0;
        // The drive of one learner may give another one its next step: a round without any step is the last.
        loop {
            let before = steps;
            for learner in 0..self.tuner.learners() {
                while let Some(ask) = self.tuner.wanted(learner) {
                    let memory = self.memory.as_ref();
                    let drive = memory.and_then(|it| it.get(&ask.parameters.to_bits())).copied();
                    let Some(drive) = drive else { break };
                    if steps == at_most {
                        return false;
                    }
                    steps += 1;
                    each(&self.tell(ask, drive, true));
                }
            }
            if steps == before {
                return true;
            }
        }
    }

    /// The drives for which learners wait; with memory, the same drive only once.
    pub fn wanted(&self) -> Vec<Ask> {
        let learners = 0..self.tuner.learners();
        let mut wanted: Vec<Ask> = learners.filter_map(|it| self.tuner.wanted(it)).collect();
        if self.memory.is_some() {
            let mut seen = Vec::with_capacity(wanted.len());
            wanted.retain(|ask| {
                let set = ask.parameters.to_bits();
                let is_new = !seen.contains(&set);
                seen.push(set);
                is_new
            });
        }
        wanted
    }

    /// Hands a drive to the learner that waits for it. Returns the step, or `None` if no learner waits for that
    /// drive (any more).
    pub fn take(&mut self, learner: u32, step: u32, drive: DriveRecord) -> Option<Taken> {
        if learner >= self.tuner.learners() {
            return None;
        }
        let ask = self.tuner.wanted(learner).filter(|ask| ask.step == step)?;
        if let Some(memory) = &mut self.memory {
            memory.insert(ask.parameters.to_bits(), drive);
        }
        if let Some(driven) = &mut self.driven {
            driven.push((ask.parameters, drive));
        }
        Some(self.tell(ask, drive, false))
    }

    /// The drive with a set that memory holds; never one with noise.
    pub(crate) fn remembered(&self, parameters: &Parameters) -> Option<&DriveRecord> {
        self.memory.as_ref()?.get(&parameters.to_bits())
    }

    /// The drives that were made one by one, of all sets; without memory those of a budget alone.
    pub(crate) fn driven(&self) -> Vec<(Parameters, DriveRecord)> {
        self.driven.clone().unwrap_or_else(|| {
            let known = |it: &VisitedSet| Some((it.parameters, *self.remembered(&it.parameters)?));
            self.visited().iter().filter_map(known).collect()
        })
    }

    fn tell(&mut self, ask: Ask, drive: DriveRecord, remembered: bool) -> Taken {
        let learner = ask.learner as usize;
        let value = self.objective.of(&drive);
        self.received[learner].add(self.law.values(&ask.parameters), &drive);
        let learners = self.received.len();
        let of_set = self.visited.entry(ask.parameters.to_bits());
        let (visits, sum) = &mut of_set.or_insert_with(|| vec![(0, 0.0); learners])[learner];
        *visits += 1;
        *sum += value;
        let told = self.tuner.tell(&ask, &drive, value);
        Taken { ask, drive, value, remembered, told }
    }

    /// Hash of what a learner has received.
    pub(crate) fn received(&self, learner: u32) -> [u8; 32] {
        self.received[learner as usize].hash()
    }

    /// Number of drives that learners received.
    pub fn asked_drives(&self) -> u64 {
        let learners = 0..self.tuner.learners();
        learners.map(|learner| u64::from(self.tuner.state(learner).drives)).sum()
    }

    /// The sets that learners have driven, in the order of [`by_values`].
    pub fn visited(&self) -> Vec<VisitedSet> {
        let of_set = |(bits, of_learners): (&[u64; MAX_PARAMETERS], &Vec<(u32, f64)>)| {
            let (visits, sum) = of_learners
                .iter()
                .fold((0, 0.0), |(visits, sum), (more, values)| (visits + more, sum + values));
            let parameters = Parameters(bits.map(f64::from_bits));
            VisitedSet { parameters, visits, mean_value: sum / f64::from(visits) }
        };
        let mut sets: Vec<VisitedSet> = self.visited.iter().map(of_set).collect();
        sets.sort_by(|a, b| by_values(&a.parameters, &b.parameters));
        sets
    }

    /// The number of different drives among them: those that memory would not answer.
    pub fn distinct_drives(&self) -> u64 {
        if self.noise { self.asked_drives() } else { self.visited.len() as u64 }
    }
}

/// The order of sets by their first value, then by their second, and so on: the order of their numbers in a grid.
pub fn by_values(a: &Parameters, b: &Parameters) -> Ordering {
    let compared = a.0.iter().zip(&b.0).map(|(a, b)| a.total_cmp(b));
    compared.fold(Ordering::Equal, Ordering::then)
}

/// A whole training without a pipeline, each drive answered by `drive`.
pub fn train_offline(
    config: &RunConfig,
    objective: Objective,
    mut drive: impl FnMut(&Ask) -> DriveRecord,
) -> Training {
    let mut training = Training::new(config, objective);
    while training.prepare().expect("some set may be driven") < 1.0 {}
    loop {
        training.remember(usize::MAX, |_| {});
        let wanted = training.wanted();
        if wanted.is_empty() {
            return training;
        }
        for ask in wanted {
            let drive = drive(&ask);
            training.take(ask.learner, ask.step, drive);
        }
    }
}

/// A whole training by plain calls: no process, no shared memory. The oracle of the pipeline.
pub fn train_by_rollout(config: &RunConfig) -> Training {
    let objective = crate::objective_of(config);
    let mut rollout = PlantRollouts::new(config, objective);
    train_offline(config, objective, |ask| {
        let noise = config.steps_differ().then_some(ask.seed);
        rollout.drive(ask.parameters, noise)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Ranking, digest};
    use config::Layers;

    fn config(maneuver: &str, sets: &[&str]) -> RunConfig {
        let mut layers = Layers::maneuver(maneuver).unwrap();
        for set in sets {
            layers.set(set).unwrap();
        }
        layers.resolve().unwrap()
    }

    #[test]
    fn memory_changes_nothing_that_is_learnt() {
        let short = ["learning.episodes=4", "learning.step_limit=10"];
        let with = train_by_rollout(&config("lane_change", &short));
        let without =
            train_by_rollout(&config("lane_change", &[short[0], short[1], "run.memo=false"]));
        assert_eq!(digest(&with), digest(&without));
        assert!(with.distinct_drives() < with.asked_drives());
        assert_eq!(with.distinct_drives(), without.distinct_drives());
        let noisy = [short[0], short[1], "noise.enabled=true"];
        assert_ne!(digest(&with), digest(&train_by_rollout(&config("lane_change", &noisy))));
    }

    #[test]
    fn seeds_and_alphas_change_the_digest() {
        let of = |sets: &[&str]| {
            let mut all = vec!["learning.episodes=2", "learning.step_limit=5"];
            all.extend(sets);
            digest(&train_by_rollout(&config("lane_change", &all)))
        };
        assert_eq!(of(&[]), of(&["run.fleet=2"]));
        assert_ne!(of(&[]), of(&["run.seed=2"]));
        assert_ne!(of(&["run.alphas=[0.1]"]), of(&["run.alphas=[0.2]"]));
    }

    #[test]
    fn the_digest_s_list_of_fields_is_frozen() {
        // Made-up drives, so that the digest does not depend on the vehicle or a law.
        let config = config("lane_change", &["learning.episodes=3", "run.alphas=[0.1,0.5]"]);
        let training = train_offline(&config, Objective::new(&config), |ask| {
            let cross_m = ask.parameters.0[0] / 10.0;
            DriveRecord {
                ticks: 500,
                mean_abs_cross_m: cross_m,
                mean_abs_heading_rad: 0.25,
                cross_mse_m2: cross_m * cross_m,
                trace: 7,
                // Measures that were added later.
                path_mean_m: f64::from(ask.step),
                progress: f64::from(ask.step),
                ..DriveRecord::default()
            }
        });
        assert_eq!(digest(&training), FROZEN);
    }

    const FROZEN: &str = "963a2cce06d48003906c6d26ec441e681af012e347680aa1c7ec880d3cff095c";

    /// How many of the seeds 1–20 recommend a set in the best 1 % of the grid by distance.
    fn seeds_in_best_percent(maneuver: &str, tuner: &str) -> usize {
        let mut config = config(maneuver, &[]);
        config.learning.tuner = tuner.to_owned();
        let ranking = Ranking::by_rollout(&config);
        let best = ranking.len() / 100;
        (1..=20)
            .filter(|seed| {
                config.run.seed = *seed;
                let training = train_offline(&config, *ranking.objective(), |ask| {
                    ranking.drive(&ask.parameters)
                });
                let set = training.tuner().recommend(&|a, b| ranking.compare(a, b));
                let measures = ranking.measures_of(&ranking.drive(&set));
                let rank = ranking.rank_by(|it| it.distance, &measures);
                println!("{maneuver} {tuner} seed {seed}: rank {rank} of {}", ranking.len());
                rank <= best
            })
            .count()
    }

    #[test]
    fn the_recommended_set_lies_in_the_best_percent_of_the_grid() {
        for maneuver in ["lane_change", "roundabout"] {
            let educated = seeds_in_best_percent(maneuver, "educated-q");
            let plain = seeds_in_best_percent(maneuver, "q");
            println!("{maneuver}: educated {educated}/20, plain Q-learning {plain}/20");
            assert!(educated >= 18, "{maneuver}: {educated} of 20 seeds");
        }
    }
}
