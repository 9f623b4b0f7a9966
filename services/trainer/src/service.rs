//! The trainer's process: proposes drives, learns from their outcomes, writes the journal, and at the end
//! ranks what it chose among all sets of the grid.

use std::fs;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::thread::JoinHandle;

use anyhow::{Context, Result, anyhow, ensure};
use config::{Parameters, RunConfig};
use ipc_types::{
    Attempt, BatchHeader, DriveOutcome, DriveRequest, LearnerProgress, Proposal, WakeRole,
};
use outcome::{Decided, NoiseChoice, OUTCOME_FILE, Outcome, TrainResult, to_json};
use runtime::clock::now_ns;
use runtime::{Attachment, Bus, Counters, Inlet, Outlet, Service, join, serve};
use sha2::{Digest, Sha256};

use crate::digest::to_hex;
use crate::journal::Journal;
use crate::ranking::grid_is_driven;
use crate::result::{decided, train_result};
use crate::story::Story;
use crate::sweeping::{Place, Progress, Sweeping};
use crate::training::{Taken, Training};
use crate::wire::record_of;
use crate::{Finalists, PlannedDrive, Ranking, objective_of, rank_mean};

/// Name of the journal in the run's folder.
pub const JOURNAL_FILE: &str = "journal";

/// Time between two syncs of the journal: what a power cut may cost.
const SYNC_NS: u64 = 1_000_000_000;
/// Number of remembered steps between two signs of life: a few milliseconds of work.
const REMEMBERED_AT_ONCE: usize = 1000;
/// Time between two reports on the progress of the ranking.
const TELL_NS: u64 = 100_000_000;

/// Runs the process until it is asked to stop.
///
/// # Errors
/// If it cannot join the run, the transport fails, or the journal cannot be used.
pub fn run() -> Result<()> {
    let (attachment, bus, config) = join()?;
    let bus = Rc::new(bus);
    let mut trainer = Trainer::new(bus.clone(), config, &attachment)?;
    serve(&attachment, &bus, WakeRole::Trainer, &mut trainer)
}

struct Trainer {
    outcomes: Inlet<DriveOutcome>,
    proposals: Outlet<Proposal>,
    progress: Outlet<LearnerProgress>,
    bus: Rc<Bus>,
    run: u64,
    incarnation: u64,
    max_len: usize,
    folder: PathBuf,
    config: RunConfig,
    /// Shared with the ranking thread, but only once it has finished.
    training: Arc<Training>,
    journal: Journal,
    story: Story,
    synced_ns: u64,
    /// Thousandths of the ranking that are done, and when that was reported.
    ranked: Arc<AtomicU32>,
    told_ns: u64,
    stage: TrainingStage,
    counters: Counters,
}

enum TrainingStage {
    /// Some steps can be answered from memory.
    Remembering,
    /// Waits for outcomes.
    Training,
    /// All learners have finished; under noise the best sets are driven again.
    Finalists(Sweeping, Box<Finalists>),
    /// A thread drives the grid.
    Ranking(JoinHandle<Result<Chosen>>),
    /// The tuned set is driven for the recordings.
    Demonstrating(Sweeping, Box<TrainResult>),
    /// The outcome has been written and announced.
    Over,
}

/// The set that a training has found, and its result.
struct Chosen {
    parameters: Parameters,
    result: TrainResult,
}

impl Trainer {
    fn new(bus: Rc<Bus>, config: RunConfig, attachment: &Attachment) -> Result<Self> {
        let folder = attachment.folder.clone();
        let mut training = Training::new(&config, objective_of(&config));
        let mut story = Story::new(&folder, &config.law, config.learning.heading_weight)?;
        let mut told = Ok(());
        let each = |taken: &Taken| {
            if told.is_ok() {
                told = story.add(taken);
            }
        };
        let path = folder.join(JOURNAL_FILE);
        let journal = Journal::open(&path, &fingerprint(&config), &mut training, each)?;
        told?;
        Ok(Self {
            outcomes: bus.inlet()?,
            proposals: bus.outlet()?,
            progress: bus.outlet()?,
            bus,
            run: attachment.names.run,
            incarnation: attachment.incarnation,
            max_len: attachment.max_len,
            folder,
            config,
            training: Arc::new(training),
            journal,
            story,
            synced_ns: 0,
            ranked: Arc::default(),
            told_ns: 0,
            stage: TrainingStage::Remembering,
            counters: Counters::default(),
        })
    }

    fn header(&self, flags: u32) -> BatchHeader {
        let attempt = Attempt::between_batches(self.run);
        BatchHeader { attempt, flags, sent_ns: now_ns(), ..BatchHeader::default() }
    }

    fn training_mut(&mut self) -> &mut Training {
        Arc::get_mut(&mut self.training).expect("no ranking while drives are taken")
    }

    /// Notes a step in the journal and in the files for users.
    fn note(&mut self, taken: &Taken) -> Result<()> {
        self.journal.note(taken);
        self.story.add(taken)
    }

    /// Answers what memory can, writes the journal, and asks for the rest.
    fn propose(&mut self) -> Result<()> {
        let mut taken = Vec::new();
        let each = |step: &Taken| taken.push(step.clone());
        let answered = self.training_mut().remember(REMEMBERED_AT_ONCE, each);
        for taken in &taken {
            self.note(taken)?;
        }
        self.journal.write()?;
        let now_ns = now_ns();
        if now_ns - self.synced_ns >= SYNC_NS {
            self.journal.sync()?;
            self.story.flush()?;
            self.synced_ns = now_ns;
        }
        self.tell_progress()?;
        if !answered {
            self.stage = TrainingStage::Remembering;
            return Ok(());
        }
        if self.training.is_finished() {
            return self.after_training();
        }
        self.stage = TrainingStage::Training;
        let wanted = self.training.wanted();
        let ticks = self.config.ticks();
        let flags = if self.config.noise.enabled { DriveRequest::NOISE } else { 0 };
        self.proposals.send(self.header(0), wanted.len(), |index| {
            let ask = wanted[index];
            Proposal {
                parameters: ask.parameters.0,
                seed: ask.seed,
                ticks,
                learner: ask.learner,
                step: ask.step,
                flags,
                plant: 0,
            }
        })?;
        Ok(())
    }

    fn tell_progress(&mut self) -> Result<()> {
        let tuner = self.training.tuner();
        self.progress.send(self.header(0), tuner.learners() as usize, |index| {
            let state = tuner.state(index as u32);
            LearnerProgress {
                epsilon: state.epsilon,
                best_value: state.best_value,
                asked: state.drives.into(),
                episode: state.episodes,
                episodes: state.of_episodes,
            }
        })?;
        Ok(())
    }

    fn learn(&mut self, outcomes: &[DriveOutcome]) -> Result<()> {
        for DriveOutcome { report, attempt } in outcomes {
            self.counters.batch = attempt.batch;
            let drive = record_of(report);
            // Asking again would bring the same report again.
            ensure!(drive.is_plausible(), "impossible numbers in a drive report: {report:?}");
            match self.training_mut().take(report.learner, report.step, drive) {
                Some(taken) => self.note(&taken)?,
                // It was answered before: the report was sent again.
                None => self.counters.dropped += 1,
            }
        }
        Ok(())
    }

    fn place(&self) -> Place {
        Place {
            run: self.run,
            folder: self.folder.clone(),
            max_len: self.max_len,
            tick_s: self.config.drive.tick_s,
            ticks: self.config.ticks(),
            incarnation: self.incarnation,
        }
    }

    /// Starts what follows when all learners have finished: under noise the finalists, then the ranking.
    fn after_training(&mut self) -> Result<()> {
        self.story.flush()?;
        if !self.config.noise.enabled {
            self.stage = TrainingStage::Ranking(self.rank(None)?);
            return Ok(());
        }
        let finalists = Finalists::new(&self.config, &self.training);
        // To the orchestrator each drive of a sweep is a learner of its own.
        let first = self.training.tuner().learners();
        let sweeping = Sweeping::new(&self.bus, self.place(), first, finalists.drives())?;
        self.stage = TrainingStage::Finalists(sweeping, Box::new(finalists));
        self.ask()
    }

    /// Asks for the drives of a sweep that are still wanted.
    fn ask(&mut self) -> Result<()> {
        let (TrainingStage::Finalists(sweeping, _) | TrainingStage::Demonstrating(sweeping, _)) =
            &self.stage
        else {
            return Ok(());
        };
        let (header, progress) = (self.header(LearnerProgress::DRIVES), sweeping.progress());
        self.progress.send(header, 1, |_| progress)?;
        let wanted = sweeping.wanted();
        if !wanted.is_empty() {
            self.proposals.send(sweeping.header(0), wanted.len(), |index| wanted[index])?;
        }
        Ok(())
    }

    /// Goes on after a sweep once all of its drives are over. Returns whether they were.
    fn after_sweep(&mut self) -> Result<bool> {
        match std::mem::replace(&mut self.stage, TrainingStage::Over) {
            TrainingStage::Finalists(sweeping, finalists) => match sweeping.driven() {
                Some(driven) => {
                    let records: Vec<_> = driven.iter().map(|it| it.record).collect();
                    let choice =
                        finalists.choose(&self.config, self.training.objective(), &records);
                    self.stage = TrainingStage::Ranking(self.rank(Some(choice))?);
                }
                None => {
                    self.stage = TrainingStage::Finalists(sweeping, finalists);
                    return Ok(false);
                }
            },
            TrainingStage::Demonstrating(sweeping, mut result) => {
                if sweeping.driven().is_none() {
                    self.stage = TrainingStage::Demonstrating(sweeping, result);
                    return Ok(false);
                }
                result.drives_recorded = sweeping.recorded();
                write_outcome(&self.folder, &decided(&self.config, Outcome::Train(result)))?;
                self.proposals.send(self.header(Proposal::FINISHED), 1, |_| Proposal::default())?;
            }
            other => {
                self.stage = other;
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// Ranks what was chosen among all sets, in a separate thread: it may take a while, and the process must give signs
    /// of life meanwhile.
    fn rank(
        &self,
        choice: Option<(Parameters, NoiseChoice)>,
    ) -> Result<JoinHandle<Result<Chosen>>> {
        let (config, training) = (self.config.clone(), self.training.clone());
        let journal = self.journal.file()?;
        let share = self.ranked.clone();
        Ok(std::thread::spawn(move || {
            journal.sync_data().context("failed to sync the journal")?;
            let progress = |done: f64| share.store((1000.0 * done) as u32, Ordering::Relaxed);
            let noise = choice.map(|(parameters, choice)| {
                let rank = grid_is_driven(&config)
                    .then(|| rank_mean(&config, training.objective(), &parameters, progress));
                (choice, parameters, rank)
            });
            let result = train_result(&config, &training, &Ranking::by_rollout(&config), noise);
            let parameters = config
                .law
                .parameters_of(&result.gains)
                .map_err(|(key, problem)| anyhow!("the tuned set: {key} {problem}"))?;
            Ok(Chosen { parameters, result })
        }))
    }

    /// Waits for the ranking; then makes recorded drives with the tuned set.
    fn after_ranking(&mut self) -> Result<bool> {
        let TrainingStage::Ranking(thread) =
            std::mem::replace(&mut self.stage, TrainingStage::Over)
        else {
            return Ok(false);
        };
        if !thread.is_finished() {
            self.stage = TrainingStage::Ranking(thread);
            self.tell_ranking()?;
            return Ok(false);
        }
        let Chosen { parameters, result } =
            thread.join().map_err(|_| anyhow!("the ranking panicked"))??;
        let drives = [("tuned_noise_free", None), ("tuned_noisy", Some(1))]
            .map(|(name, seed)| PlannedDrive {
                by_zone: vec![parameters],
                seed,
                record: Some(name.to_owned()),
            })
            .to_vec();
        // Numbers above those of the learners and all finalists.
        let first = u32::MAX / 2;
        let sweeping = Sweeping::new(&self.bus, self.place(), first, drives)?;
        self.stage = TrainingStage::Demonstrating(sweeping, Box::new(result));
        self.ask()?;
        Ok(true)
    }

    /// Reports the progress of the ranking, if it takes long enough.
    fn tell_ranking(&mut self) -> Result<()> {
        let now_ns = now_ns();
        if now_ns - self.told_ns < TELL_NS {
            return Ok(());
        }
        self.told_ns = now_ns;
        let ranked = self.ranked.load(Ordering::Relaxed);
        let (epsilon, best_value) = (0.0, f64::INFINITY);
        let progress =
            LearnerProgress { epsilon, best_value, asked: 0, episode: ranked, episodes: 1000 };
        self.progress.send(self.header(LearnerProgress::RANKING), 1, |_| progress)?;
        Ok(())
    }
}

/// Writes the decided part of the result, by rename, so that nobody reads half of it.
pub(crate) fn write_outcome(folder: &Path, decided: &Decided) -> Result<()> {
    let path = folder.join(OUTCOME_FILE);
    let whole = path.with_extension("part");
    fs::write(&whole, to_json(decided))
        .and_then(|()| fs::rename(&whole, &path))
        .with_context(|| format!("failed to write {path:?}"))
}

/// Hash of everything that determines a training; fleet size, memory and gains that were promoted before do not.
fn fingerprint(config: &RunConfig) -> String {
    let mut config = config.clone();
    config.run.fleet = 0;
    config.run.memo = true;
    config.vehicle.gains.clear();
    let json = serde_json::to_vec(&config).expect("a configuration is plain data");
    to_hex(&Sha256::digest(&json))
}

impl Service for Trainer {
    fn poll(&mut self) -> Result<bool> {
        match &mut self.stage {
            TrainingStage::Remembering => {
                self.propose()?;
                return Ok(true);
            }
            TrainingStage::Ranking(_) => return self.after_ranking(),
            TrainingStage::Finalists(sweeping, _) | TrainingStage::Demonstrating(sweeping, _) => {
                match sweeping.poll()? {
                    Progress::None => {}
                    Progress::Recording => return Ok(true),
                    Progress::Recorded => {
                        if !self.after_sweep()? {
                            self.ask()?;
                        }
                        return Ok(true);
                    }
                }
            }
            TrainingStage::Training | TrainingStage::Over => {}
        }
        let Some(outcomes) = self.outcomes.receive()? else { return Ok(false) };
        if !outcomes.header().attempt.is_of(self.run) {
            self.counters.dropped += 1;
            return Ok(true);
        }
        match &mut self.stage {
            TrainingStage::Finalists(sweeping, _) | TrainingStage::Demonstrating(sweeping, _) => {
                self.counters.dropped += sweeping.learn(outcomes.items())?;
                if !self.after_sweep()? {
                    self.ask()?;
                }
            }
            _ => self.learn(outcomes.items())?,
        }
        if matches!(self.stage, TrainingStage::Training) {
            self.propose()?;
        }
        Ok(true)
    }

    fn status(&self) -> Counters {
        self.counters
    }
}
