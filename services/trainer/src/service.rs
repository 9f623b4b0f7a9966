//! The trainer's process: proposes drives, learns from their outcomes, writes the journal, and at the end
//! ranks what it chose among all sets of the grid: by plain calls, or if the vehicle is not our simulator by its own
//! drives.

mod after;
mod parts;

use std::fs;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::AtomicU32;
use std::thread::JoinHandle;

use anyhow::{Context, Result, ensure};
use config::RunConfig;
use ipc_types::{
    Attempt, BatchHeader, DriveOutcome, DriveRequest, LearnerProgress, Proposal, WakeRole,
};
use outcome::{Decided, OUTCOME_FILE, TrainResult, to_json};
use runtime::clock::now_ns;
use runtime::{Attachment, Bus, Counters, Inlet, Outlet, Service, join, serve};
use sha2::{Digest, Sha256};

use crate::checkpoint::{self, Keeper};
use crate::digest::to_hex;
use crate::journal::{Journal, REMEMBERED_AT_ONCE};
use crate::own_drives::Driver;
use crate::service::after::{Chosen, Table};
use crate::service::parts::Parts;
use crate::story::Story;
use crate::sweeping::{Place, Progress, Sweeping};
use crate::training::{Taken, Training};
use crate::wire::record_of;
use crate::{Finalists, objective_of};

/// Name of the journal in the run's folder.
pub const JOURNAL_FILE: &str = "journal";

/// What was asked for leaves a training nothing to drive: what the user can do about it.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct CannotBegin(String);

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
    /// Tell whether the vehicle paces by the clock.
    requests: Inlet<DriveRequest>,
    proposals: Outlet<Proposal>,
    progress: Outlet<LearnerProgress>,
    bus: Rc<Bus>,
    run: u64,
    incarnation: u64,
    max_len: usize,
    folder: PathBuf,
    config: RunConfig,
    driver: Driver,
    /// Shared with the ranking thread, but only once it has finished.
    training: Arc<Training>,
    /// Drives over plants that have come, until those of all plants of their step have.
    parts: Parts,
    journal: Journal,
    story: Story,
    checkpoints: Keeper,
    /// Thousandths of the ranking that are done, and when that was reported.
    ranked: Arc<AtomicU32>,
    told_ns: u64,
    stage: TrainingStage,
    counters: Counters,
}

enum TrainingStage {
    /// The tuner computes what it needs before its first drive.
    Preparing,
    /// Steps of the journal are still to be taken again.
    Replaying,
    /// Some steps can be answered from memory.
    Remembering,
    /// Waits for outcomes.
    Training,
    /// All learners have finished; the best sets are driven again, because single drives differ.
    Finalists(Sweeping, Box<Finalists>),
    /// A vehicle that is not our simulator makes the drives from which the table's figures come.
    Table(Sweeping, Box<Table>),
    /// A thread compares the choice with the grid; with our simulator it drives the grid.
    Ranking(JoinHandle<Result<Chosen>>),
    /// The tuned set is driven for the recordings.
    Demonstrating(Sweeping, Box<TrainResult>),
    /// The outcome has been written and announced.
    Over,
}

impl TrainingStage {
    /// The sweep that is under way.
    fn sweeping(&mut self) -> Option<&mut Sweeping> {
        match self {
            Self::Finalists(sweeping, _)
            | Self::Table(sweeping, _)
            | Self::Demonstrating(sweeping, _) => Some(sweeping),
            Self::Preparing
            | Self::Replaying
            | Self::Remembering
            | Self::Training
            | Self::Ranking(_)
            | Self::Over => None,
        }
    }
}

impl Trainer {
    fn new(bus: Rc<Bus>, config: RunConfig, attachment: &Attachment) -> Result<Self> {
        let folder = attachment.folder.clone();
        let driver = Driver::of_run(&folder, &config)?;
        let configuration = fingerprint(&config);
        let mut journal = Journal::open(&folder.join(JOURNAL_FILE), &configuration)?;
        let new = Training::new(&config, objective_of(&config));
        let (training, lengths) =
            checkpoint::take_up(&folder, &configuration, &config, &mut journal, new)?;
        let story = Story::open(&folder, &config.law, config.learning.heading_weight, lengths)?;
        let parts = Parts::new(&config, *training.objective());
        Ok(Self {
            outcomes: bus.inlet()?,
            requests: bus.inlet()?,
            proposals: bus.outlet()?,
            progress: bus.outlet()?,
            bus,
            run: attachment.names.run,
            incarnation: attachment.incarnation,
            max_len: attachment.max_len,
            checkpoints: Keeper::new(&folder, configuration),
            folder,
            config,
            driver,
            parts,
            training: Arc::new(training),
            journal,
            story,
            ranked: Arc::default(),
            told_ns: 0,
            stage: TrainingStage::Preparing,
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

    /// Lets the tuner compute what it needs before its first drive, a part at a time: signs of life go between the parts.
    fn prepare(&mut self) -> Result<()> {
        let done = self.training_mut().prepare().map_err(CannotBegin)?;
        if done >= 1.0 {
            self.stage = TrainingStage::Replaying;
            return Ok(());
        }
        self.tell_share(done, LearnerProgress::SIMULATING)
    }

    /// Takes steps of the journal again, as many as leave time for signs of life.
    fn replay(&mut self) -> Result<()> {
        let Self { journal, training, story, .. } = self;
        let training = Arc::get_mut(training).expect("no ranking while the journal is replayed");
        let mut told = Ok(());
        let is_over = journal.replay(training, |taken| {
            if told.is_ok() {
                told = story.add(taken);
            }
        })?;
        told?;
        if is_over {
            self.stage = TrainingStage::Remembering;
        }
        self.tell_progress()
    }

    /// Answers what memory can, writes the journal, and asks for the rest.
    fn propose(&mut self) -> Result<()> {
        let mut taken = Vec::new();
        let each = |step: &Taken| taken.push(step.clone());
        let answered = self.training_mut().remember(REMEMBERED_AT_ONCE, each);
        self.journal.note_remembered(taken.len());
        for taken in &taken {
            self.story.add(taken)?;
        }
        self.journal.write()?;
        if self.checkpoints.is_due(now_ns()) {
            let story = self.story.written()?;
            self.checkpoints.keep(&self.journal, story, &self.training)?;
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
        let wanted = self.parts.of(&self.training.wanted());
        let ticks = self.config.ticks();
        let flags = if self.config.noise.enabled { DriveRequest::NOISE } else { 0 };
        self.proposals.send(self.header(0), wanted.len(), |index| {
            let (ask, learner, plant) = wanted[index];
            Proposal {
                parameters: ask.parameters.0,
                seed: ask.seed,
                ticks,
                learner,
                step: ask.step,
                flags,
                plant,
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
        // In the order of the learners: outcomes that were missed are sent again in another one.
        let mut outcomes: Vec<&DriveOutcome> = outcomes.iter().collect();
        outcomes.sort_by_key(|outcome| outcome.report.learner);
        let mut taken = Vec::with_capacity(outcomes.len());
        for DriveOutcome { report, .. } in outcomes {
            let drive = record_of(report);
            // Asking again would bring the same report again.
            ensure!(drive.is_plausible(), "impossible numbers in a drive report: {report:?}");
            let wanted = self.training.wanted();
            let Some((learner, drive)) = self.parts.take(&wanted, report, drive) else { continue };
            match self.training_mut().take(learner, report.step, drive) {
                Some(step) => taken.push(step),
                // It was answered before: the report was sent again.
                None => self.counters.dropped += 1,
            }
        }
        self.journal.note_driven(&taken, self.config.law.count());
        taken.iter().try_for_each(|taken| self.story.add(taken))
    }

    fn place(&self) -> Place {
        Place {
            run: self.run,
            folder: self.folder.clone(),
            max_len: self.max_len,
            tick_s: self.config.drive.tick_s,
            ticks: self.config.ticks(),
            laps: crate::sweeping::laps_of(&self.config),
            single: None,
            incarnation: self.incarnation,
        }
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
            TrainingStage::Preparing => {
                self.prepare()?;
                return Ok(true);
            }
            TrainingStage::Replaying => {
                self.replay()?;
                return Ok(true);
            }
            TrainingStage::Remembering => {
                self.propose()?;
                return Ok(true);
            }
            TrainingStage::Ranking(_) => return self.after_ranking(),
            TrainingStage::Table(_, table) if table.waits_for_pace => {
                self.after_drives()?;
            }
            stage => {
                if let Some(sweeping) = stage.sweeping() {
                    match sweeping.poll()? {
                        Progress::None => {}
                        Progress::Recording => return Ok(true),
                        Progress::Recorded => {
                            self.after_drives()?;
                            return Ok(true);
                        }
                    }
                }
            }
        }
        let Some(outcomes) = self.outcomes.receive()? else { return Ok(false) };
        if !outcomes.header().attempt.is_of(self.run) {
            self.counters.dropped += 1;
            return Ok(true);
        }
        if let Some(outcome) = outcomes.items().last() {
            self.counters.batch = outcome.attempt.batch;
        }
        match self.stage.sweeping() {
            Some(sweeping) => {
                self.counters.dropped += sweeping.learn(outcomes.items())?;
                self.after_drives()?;
            }
            None => self.learn(outcomes.items())?,
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
