//! The trainer's process: proposes drives, learns from their outcomes, writes the journal, and at the end
//! ranks what it chose among all sets of the grid.

use std::fs;
use std::path::PathBuf;
use std::thread::JoinHandle;

use anyhow::{Context, Result, anyhow, ensure};
use config::RunConfig;
use ipc_types::{BatchHeader, DriveOutcome, DriveReport, LearnerProgress, Proposal, WakeRole};
use runtime::clock::now_ns;
use runtime::{Bus, Counters, Inlet, Outlet, Service, join, serve};
use sha2::{Digest, Sha256};

use crate::digest::to_hex;
use crate::journal::Journal;
use crate::{DriveRecord, Outcome, Ranking, Training};

/// Name of the journal in the run's folder.
pub const JOURNAL_FILE: &str = "journal";
/// Name of the outcome in the run's folder, while the orchestrator has not made `result.json` of it.
pub const OUTCOME_FILE: &str = "outcome.json";

/// Between two syncs of the journal: what a power cut may cost.
const SYNC_NS: u64 = 1_000_000_000;
/// Remembered steps between two signs of life: some milliseconds of work.
const REMEMBERED_AT_ONCE: usize = 1000;

/// Runs the process until it is asked to stop.
///
/// # Errors
/// If it cannot join the run, the transport fails, or the journal cannot be used.
pub fn run() -> Result<()> {
    let (attachment, bus, config) = join()?;
    let mut trainer = Trainer::new(&bus, config, attachment.names.run, attachment.folder.clone())?;
    serve(&attachment, &bus, WakeRole::Trainer, &mut trainer)
}

struct Trainer {
    outcomes: Inlet<DriveOutcome>,
    proposals: Outlet<Proposal>,
    progress: Outlet<LearnerProgress>,
    run: u64,
    folder: PathBuf,
    config: RunConfig,
    training: Training,
    journal: Journal,
    synced_ns: u64,
    stage: Stage,
    counters: Counters,
}

enum Stage {
    /// Some steps can be answered from memory.
    Remembering,
    /// Waits for outcomes.
    Training,
    /// All learners have finished; a thread drives the grid and writes the outcome.
    Ranking(JoinHandle<Result<()>>),
    /// The outcome is written, and was announced.
    Over,
}

impl Trainer {
    fn new(bus: &Bus, config: RunConfig, run: u64, folder: PathBuf) -> Result<Self> {
        let mut training = Training::new(&config);
        let journal =
            Journal::open(&folder.join(JOURNAL_FILE), &fingerprint(&config), &mut training)?;
        Ok(Self {
            outcomes: bus.inlet()?,
            proposals: bus.outlet()?,
            progress: bus.outlet()?,
            run,
            folder,
            config,
            training,
            journal,
            synced_ns: 0,
            stage: Stage::Remembering,
            counters: Counters::default(),
        })
    }

    fn header(&self, flags: u32) -> BatchHeader {
        BatchHeader { run: self.run, flags, sent_ns: now_ns(), ..BatchHeader::default() }
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
            self.stage = Stage::Ranking(self.rank()?);
            return Ok(());
        }
        self.stage = Stage::Training;
        let wanted = self.training.wanted();
        let ticks = self.config.ticks();
        let grid = self.config.grid;
        self.proposals.send(self.header(0), wanted.len(), |index| {
            let wanted = wanted[index];
            let config::Gains { kv, kl, ks, ki } = grid.gains(wanted.position);
            Proposal {
                gains: ipc_types::Gains { kv, kl, ks, ki },
                seed: wanted.seed,
                ticks,
                learner: wanted.learner,
                step: wanted.step,
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
        for DriveOutcome { report, batch, .. } in outcomes {
            self.counters.batch = *batch;
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

    /// Ranks what was chosen among all sets and writes the outcome, in a thread: it may take a while, and the
    /// process shows meanwhile that it lives.
    fn rank(&self) -> Result<JoinHandle<Result<()>>> {
        let (config, training) = (self.config.clone(), self.training.clone());
        let path = self.folder.join(OUTCOME_FILE);
        let journal = self.journal.file()?;
        Ok(std::thread::spawn(move || {
            journal.sync_data().context("failed to sync the journal")?;
            let outcome = Outcome::new(&config, &training, &mut Ranking::by_rollout(&config));
            let whole = path.with_extension("part");
            // By rename: whoever sees the file sees all of it.
            fs::write(&whole, serde_json::to_vec(&outcome)?)
                .and_then(|()| fs::rename(&whole, &path))
                .with_context(|| format!("failed to write {path:?}"))
        }))
    }

    /// Waits for the ranking; announces it once it is written.
    fn announce(&mut self) -> Result<bool> {
        let Stage::Ranking(thread) = std::mem::replace(&mut self.stage, Stage::Over) else {
            return Ok(false);
        };
        if !thread.is_finished() {
            self.stage = Stage::Ranking(thread);
            return Ok(false);
        }
        thread.join().map_err(|_| anyhow!("the ranking panicked"))??;
        self.proposals.send(self.header(Proposal::FINISHED), 1, |_| Proposal::default())?;
        Ok(true)
    }
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

/// Hash of everything that decides a training; fleet size and memory do not.
fn fingerprint(config: &RunConfig) -> String {
    let mut config = config.clone();
    config.run.fleet = 0;
    config.run.memo = true;
    let json = serde_json::to_vec(&config).expect("a configuration is plain data");
    to_hex(&Sha256::digest(&json))
}

impl Service for Trainer {
    fn poll(&mut self) -> Result<bool> {
        match self.stage {
            Stage::Remembering => {
                self.propose()?;
                return Ok(true);
            }
            Stage::Ranking(_) => return self.announce(),
            Stage::Training | Stage::Over => {}
        }
        let Some(outcomes) = self.outcomes.receive()? else { return Ok(false) };
        if outcomes.header().run != self.run {
            self.counters.dropped += 1;
            return Ok(true);
        }
        self.learn(outcomes.items())?;
        if matches!(self.stage, Stage::Training) {
            self.propose()?;
        }
        Ok(true)
    }

    fn status(&self) -> Counters {
        self.counters
    }
}
