//! The trainer's process: proposes drives, learns from their outcomes, writes the journal, and at the end
//! ranks what it chose among all sets of the grid.

use std::fs;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::thread::JoinHandle;

use anyhow::{Context, Result, anyhow, ensure};
use config::RunConfig;
use ipc_types::{
    Attempt, BatchHeader, DriveOutcome, DriveReport, DriveRequest, LearnerProgress, Proposal,
    WakeRole,
};
use runtime::clock::now_ns;
use runtime::{Attachment, Bus, Counters, Inlet, Outlet, Service, join, serve};
use serde::Serialize;
use sha2::{Digest, Sha256};

use crate::digest::to_hex;
use crate::journal::Journal;
use crate::sweeping::{Place, Progress, Sweeping};
use crate::{
    DriveRecord, Finalists, NoiseOutcome, Outcome, PlannedDrive, Ranking, Training,
    rank_mean_distance,
};

/// Name of the journal in the run's folder.
pub const JOURNAL_FILE: &str = "journal";
/// Name of the outcome in the run's folder, while the orchestrator has not made `result.json` of it.
pub const OUTCOME_FILE: &str = "outcome.json";

/// Between two syncs of the journal: what a power cut may cost.
const SYNC_NS: u64 = 1_000_000_000;
/// Remembered steps between two signs of life: some milliseconds of work.
const REMEMBERED_AT_ONCE: usize = 1000;
/// Between two words on how far the ranking is.
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
    training: Training,
    journal: Journal,
    synced_ns: u64,
    /// Thousandths of the ranking that are done, and when that was told.
    ranked: Arc<AtomicU32>,
    told_ns: u64,
    stage: Stage,
    counters: Counters,
}

enum Stage {
    /// Some steps can be answered from memory.
    Remembering,
    /// Waits for outcomes.
    Training,
    /// All learners have finished; under noise the best sets are driven again.
    Finalists(Sweeping, Finalists),
    /// A thread drives the grid.
    Ranking(JoinHandle<Result<Outcome>>),
    /// The tuned gains are shown.
    Demonstrating(Sweeping, Box<Outcome>),
    /// The outcome is written, and was announced.
    Over,
}

impl Trainer {
    fn new(bus: Rc<Bus>, config: RunConfig, attachment: &Attachment) -> Result<Self> {
        let folder = attachment.folder.clone();
        let mut training = Training::new(&config);
        let journal =
            Journal::open(&folder.join(JOURNAL_FILE), &fingerprint(&config), &mut training)?;
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
            training,
            journal,
            synced_ns: 0,
            ranked: Arc::default(),
            told_ns: 0,
            stage: Stage::Remembering,
            counters: Counters::default(),
        })
    }

    fn header(&self, flags: u32) -> BatchHeader {
        let attempt = Attempt::between_batches(self.run);
        BatchHeader { attempt, flags, sent_ns: now_ns(), ..BatchHeader::default() }
    }

    /// Answers what memory can, writes the journal, and asks for the rest.
    fn propose(&mut self) -> Result<()> {
        let Self { training, journal, .. } = self;
        let answered = training.remember(REMEMBERED_AT_ONCE, |step| journal.note(step));
        self.journal.write()?;
        let now_ns = now_ns();
        if now_ns - self.synced_ns >= SYNC_NS {
            self.journal.sync()?;
            self.synced_ns = now_ns;
        }
        self.tell_progress()?;
        if !answered {
            self.stage = Stage::Remembering;
            return Ok(());
        }
        if self.training.is_finished() {
            return self.after_training();
        }
        self.stage = Stage::Training;
        let wanted = self.training.wanted();
        let ticks = self.config.ticks();
        let grid = self.config.grid;
        let flags = if self.config.noise.enabled { DriveRequest::NOISE } else { 0 };
        self.proposals.send(self.header(0), wanted.len(), |index| {
            let wanted = wanted[index];
            Proposal {
                parameters: grid.gains(wanted.position).to_parameters(),
                seed: wanted.seed,
                ticks,
                learner: wanted.learner,
                step: wanted.step,
                flags,
                plant: 0,
            }
        })?;
        Ok(())
    }

    fn tell_progress(&mut self) -> Result<()> {
        let learners = self.training.learners();
        let episodes = self.config.learning.episodes;
        self.progress.send(self.header(0), learners.len(), |index| {
            let learner = &learners[index];
            LearnerProgress {
                epsilon: learner.epsilon(),
                best_distance: learner.best_distance(),
                asked: learner.drives_taken().into(),
                episode: learner.episodes().len() as u32,
                episodes,
            }
        })?;
        Ok(())
    }

    fn learn(&mut self, outcomes: &[DriveOutcome]) -> Result<()> {
        for DriveOutcome { report, attempt } in outcomes {
            self.counters.batch = attempt.batch;
            let drive = to_record(report);
            // Asking again would bring the same report again.
            ensure!(drive.is_plausible(), "impossible numbers in a drive report: {report:?}");
            match self.training.take(report.learner, report.step, drive) {
                Some(step) => self.journal.note(&step),
                // It was answered before: a report that was sent again.
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

    /// What comes when all learners have finished: under noise the finalists, then the ranking.
    fn after_training(&mut self) -> Result<()> {
        if !self.config.noise.enabled {
            self.stage = Stage::Ranking(self.rank(None)?);
            return Ok(());
        }
        let finalists = Finalists::new(&self.config, &self.training);
        // To the orchestrator each drive of a sweep is a learner of its own.
        let first = self.training.learners().len() as u32;
        let sweeping = Sweeping::new(&self.bus, self.place(), first, finalists.drives())?;
        self.stage = Stage::Finalists(sweeping, finalists);
        self.ask()
    }

    /// Asks for the drives of a sweep that are still wanted.
    fn ask(&mut self) -> Result<()> {
        let (Stage::Finalists(sweeping, _) | Stage::Demonstrating(sweeping, _)) = &self.stage
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

    /// Goes on behind a sweep whose drives are all over. Whether it was.
    fn after_sweep(&mut self) -> Result<bool> {
        match std::mem::replace(&mut self.stage, Stage::Over) {
            Stage::Finalists(sweeping, finalists) => match sweeping.reports() {
                Some(reports) => {
                    let noise = finalists.outcome(&self.config, &self.training, &reports);
                    self.stage = Stage::Ranking(self.rank(Some(noise))?);
                }
                None => {
                    self.stage = Stage::Finalists(sweeping, finalists);
                    return Ok(false);
                }
            },
            Stage::Demonstrating(sweeping, mut outcome) => {
                if sweeping.reports().is_none() {
                    self.stage = Stage::Demonstrating(sweeping, outcome);
                    return Ok(false);
                }
                outcome.drives_recorded = sweeping.recorded();
                write_outcome(&self.folder, &outcome)?;
                self.proposals.send(self.header(Proposal::FINISHED), 1, |_| Proposal::default())?;
            }
            other => {
                self.stage = other;
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// Ranks what was chosen among all sets, in a thread: it may take a while, and the process shows meanwhile
    /// that it lives.
    fn rank(&self, noise: Option<NoiseOutcome>) -> Result<JoinHandle<Result<Outcome>>> {
        let (config, training) = (self.config.clone(), self.training.clone());
        let journal = self.journal.file()?;
        let share = self.ranked.clone();
        Ok(std::thread::spawn(move || {
            journal.sync_data().context("failed to sync the journal")?;
            let noise = noise.map(|noise| {
                let progress = |done: f64| share.store((1000.0 * done) as u32, Ordering::Relaxed);
                let rank = rank_mean_distance(&config, noise.finalists[0].gains, progress);
                (noise, rank)
            });
            Ok(Outcome::new(&config, &training, &mut Ranking::by_rollout(&config), noise))
        }))
    }

    /// Waits for the ranking; then shows what the tuned gains do, in recorded drives.
    fn after_ranking(&mut self) -> Result<bool> {
        let Stage::Ranking(thread) = std::mem::replace(&mut self.stage, Stage::Over) else {
            return Ok(false);
        };
        if !thread.is_finished() {
            self.stage = Stage::Ranking(thread);
            self.tell_ranking()?;
            return Ok(false);
        }
        let outcome = thread.join().map_err(|_| anyhow!("the ranking panicked"))??;
        let drives = [("tuned_noise_free", None), ("tuned_noisy", Some(1))]
            .map(|(name, seed)| PlannedDrive {
                by_zone: vec![outcome.gains],
                seed,
                record: Some(name.to_owned()),
            })
            .to_vec();
        // Beyond the learners and all finalists.
        let first = u32::MAX / 2;
        let sweeping = Sweeping::new(&self.bus, self.place(), first, drives)?;
        self.stage = Stage::Demonstrating(sweeping, Box::new(outcome));
        self.ask()?;
        Ok(true)
    }

    /// Tells how far the ranking is, where it takes long enough to be told.
    fn tell_ranking(&mut self) -> Result<()> {
        let now_ns = now_ns();
        if now_ns - self.told_ns < TELL_NS {
            return Ok(());
        }
        self.told_ns = now_ns;
        let ranked = self.ranked.load(Ordering::Relaxed);
        let (epsilon, best_distance) = (0.0, f64::INFINITY);
        let progress =
            LearnerProgress { epsilon, best_distance, asked: 0, episode: ranked, episodes: 1000 };
        self.progress.send(self.header(LearnerProgress::RANKING), 1, |_| progress)?;
        Ok(())
    }
}

/// Writes the outcome, by rename: whoever sees the file sees all of it.
pub(crate) fn write_outcome(folder: &Path, outcome: &impl Serialize) -> Result<()> {
    let path = folder.join(OUTCOME_FILE);
    let whole = path.with_extension("part");
    fs::write(&whole, serde_json::to_vec(outcome)?)
        .and_then(|()| fs::rename(&whole, &path))
        .with_context(|| format!("failed to write {path:?}"))
}

fn to_record(report: &DriveReport) -> DriveRecord {
    DriveRecord {
        mean_abs_along_m: report.mean_abs_along_m,
        mean_abs_cross_m: report.mean_abs_cross_m,
        mean_abs_heading_rad: report.mean_abs_heading_rad,
        along_mse_m2: report.along_mse_m2,
        cross_mse_m2: report.cross_mse_m2,
        ticks: report.ticks,
        collision: report.reason == DriveReport::COLLISION,
        trace: report.trace,
    }
}

/// Hash of everything that decides a training; fleet size, memory and gains that were promoted before do not.
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
            Stage::Remembering => {
                self.propose()?;
                return Ok(true);
            }
            Stage::Ranking(_) => return self.after_ranking(),
            Stage::Finalists(sweeping, _) | Stage::Demonstrating(sweeping, _) => {
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
            Stage::Training | Stage::Over => {}
        }
        let Some(outcomes) = self.outcomes.receive()? else { return Ok(false) };
        if !outcomes.header().attempt.is_of(self.run) {
            self.counters.dropped += 1;
            return Ok(true);
        }
        match &mut self.stage {
            Stage::Finalists(sweeping, _) | Stage::Demonstrating(sweeping, _) => {
                self.counters.dropped += sweeping.learn(outcomes.items())?;
                if !self.after_sweep()? {
                    self.ask()?;
                }
            }
            _ => self.learn(outcomes.items())?,
        }
        if matches!(self.stage, Stage::Training) {
            self.propose()?;
        }
        Ok(true)
    }

    fn status(&self) -> Counters {
        self.counters
    }
}
