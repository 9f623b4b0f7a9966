//! The trainer's process: proposes drives, learns from their outcomes, writes the journal, and at the end
//! ranks what it chose among all sets of the grid: by plain calls, or if the vehicle is not our simulator by its own
//! drives.

use std::fs;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::thread::JoinHandle;

use anyhow::{Context, Result, anyhow, ensure};
use config::{Parameters, RunConfig};
use ipc_types::{
    Attempt, BatchHeader, DriveOutcome, DriveRequest, LearnerProgress, Proposal, WakeRole, has,
};
use outcome::{Decided, OUTCOME_FILE, Outcome, TrainResult, VehicleDrives, to_json};
use runtime::clock::now_ns;
use runtime::{Attachment, Bus, Counters, Inlet, Outlet, Service, join, serve};
use sha2::{Digest, Sha256};

use crate::checkpoint::{self, Keeper};
use crate::digest::to_hex;
use crate::journal::{Journal, REMEMBERED_AT_ONCE};
use crate::own_drives::{Driver, recommended};
use crate::ranking::grid_is_driven;
use crate::result::{Choice, decided, train_result};
use crate::story::Story;
use crate::sweeping::{Place, Progress, Sweeping};
use crate::training::{Taken, Training};
use crate::wire::record_of;
use crate::{Finalists, OwnDrives, PlannedDrive, Ranking, objective_of, rank_mean};

/// Name of the journal in the run's folder.
pub const JOURNAL_FILE: &str = "journal";

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
            Self::Replaying
            | Self::Remembering
            | Self::Training
            | Self::Ranking(_)
            | Self::Over => None,
        }
    }
}

/// The figures of a table under way.
struct Table {
    choice: Choice,
    own: OwnDrives,
    drives: VehicleDrives,
    /// All drives are over, but no request has told how the vehicle paces: the two travel on different topics.
    waits_for_pace: bool,
}

/// The set that a training has found, and its result.
struct Chosen {
    parameters: Parameters,
    result: TrainResult,
}

/// To the orchestrator each drive of a sweep is a learner of its own. Their numbers are above those of the learners and
/// of all finalists.
const FIRST_OF_TABLE: u32 = u32::MAX / 4;
const FIRST_OF_GRID: u32 = u32::MAX / 8 * 3;
const FIRST_DEMONSTRATED: u32 = u32::MAX / 2;

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
            training: Arc::new(training),
            journal,
            story,
            ranked: Arc::default(),
            told_ns: 0,
            stage: TrainingStage::Replaying,
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
        // In the order of the learners: outcomes that were missed are sent again in another one.
        let mut outcomes: Vec<&DriveOutcome> = outcomes.iter().collect();
        outcomes.sort_by_key(|outcome| outcome.report.learner);
        let mut taken = Vec::with_capacity(outcomes.len());
        for DriveOutcome { report, attempt } in outcomes {
            self.counters.batch = attempt.batch;
            let drive = record_of(report);
            // Asking again would bring the same report again.
            ensure!(drive.is_plausible(), "impossible numbers in a drive report: {report:?}");
            match self.training_mut().take(report.learner, report.step, drive) {
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
            incarnation: self.incarnation,
        }
    }

    /// Starts what follows when all learners have finished: where single drives differ the finalists, then the figures.
    fn after_training(&mut self) -> Result<()> {
        self.story.flush()?;
        self.checkpoints.finish()?;
        if self.config.noise.enabled || self.driver == (Driver::Vehicle { repeats: false }) {
            let finalists = Finalists::new(&self.config, &self.training);
            let first = self.training.tuner().learners();
            let sweeping = Sweeping::new(&self.bus, self.place(), first, finalists.drives())?;
            self.stage = TrainingStage::Finalists(sweeping, Box::new(finalists));
            return self.ask();
        }
        match self.driver {
            Driver::Simulator => self.rank(None),
            Driver::Vehicle { .. } => {
                let choice = Choice::recommended(recommended(&self.training));
                self.drive_table(choice, OwnDrives::default())
            }
        }
    }

    /// Asks for the drives of a sweep that are still wanted.
    fn ask(&mut self) -> Result<()> {
        let header = self.header(LearnerProgress::DRIVES);
        let Some(sweeping) = self.stage.sweeping() else { return Ok(()) };
        let (progress, wanted) = (sweeping.progress(), sweeping.wanted());
        self.progress.send(header, 1, |_| progress)?;
        if !wanted.is_empty() {
            self.proposals.send(self.header(0), wanted.len(), |index| wanted[index])?;
        }
        Ok(())
    }

    /// Asks for more of a sweep, or goes on once all of its drives are over.
    fn after_drives(&mut self) -> Result<()> {
        let Some(driven) = self.stage.sweeping().and_then(|sweeping| sweeping.driven()) else {
            return self.ask();
        };
        match std::mem::replace(&mut self.stage, TrainingStage::Over) {
            TrainingStage::Finalists(_, finalists) => {
                let records: Vec<_> = driven.iter().map(|it| it.record).collect();
                let choice = finalists.choose(&self.config, self.training.objective(), &records);
                match self.driver {
                    Driver::Simulator => self.rank(Some(choice)),
                    Driver::Vehicle { .. } => {
                        let mut own = OwnDrives::default();
                        if !self.config.noise.enabled {
                            own.take(&driven);
                        }
                        self.drive_table(choice, own)
                    }
                }
            }
            TrainingStage::Table(sweeping, mut table) => {
                // The drives of the grid are in there once they are over, too.
                let is_grid = table.drives.of_grid_set > 0;
                if !is_grid && !self.knows_pace(&mut table)? {
                    self.stage = TrainingStage::Table(sweeping, table);
                    return Ok(());
                }
                table.own.take(&driven);
                table.drives.for_table += driven.len() as u64;
                if !is_grid && !table.drives.by_clock && grid_is_driven(&self.config) {
                    return self.drive_grid(table);
                }
                self.rank_own(*table)
            }
            TrainingStage::Demonstrating(sweeping, mut result) => {
                result.drives_recorded = sweeping.recorded();
                result.drives_lacking = sweeping.lacking();
                write_outcome(&self.folder, &decided(&self.config, Outcome::Train(result)))?;
                self.proposals.send(self.header(Proposal::FINISHED), 1, |_| Proposal::default())?;
                Ok(())
            }
            other => {
                self.stage = other;
                Ok(())
            }
        }
    }

    /// Drives the rows of the table; `own` are the drives that it has already.
    fn drive_table(&mut self, choice: Choice, own: OwnDrives) -> Result<()> {
        let repeats = self.driver == (Driver::Vehicle { repeats: true });
        let of_each = if repeats { 1 } else { self.config.robust.repeats };
        let rows = std::iter::once(choice.parameters).chain(self.config.paper_set());
        let drives = own.missing(rows, of_each);
        let sweeping = Sweeping::new(&self.bus, self.place(), FIRST_OF_TABLE, drives)?;
        let drives = VehicleDrives { repeats, by_clock: false, for_table: 0, of_grid_set: 0 };
        let table = Table { choice, own, drives, waits_for_pace: false };
        self.stage = TrainingStage::Table(sweeping, Box::new(table));
        self.after_drives()
    }

    /// Drives the sets of the grid that the vehicle has not driven.
    fn drive_grid(&mut self, mut table: Box<Table>) -> Result<()> {
        let (grid, own) = (self.config.grid(), &mut table.own);
        let sets: Vec<Parameters> = grid.positions().map(|position| grid.set(position)).collect();
        if table.drives.repeats {
            // Those of the training count.
            let unknown = sets.iter().filter(|set| own.of(set).is_empty());
            let known: Vec<_> = unknown
                .filter_map(|set| Some((*set, *self.training.remembered(set)?)))
                .collect();
            known.iter().for_each(|(set, drive)| own.add(set, *drive));
        }
        table.drives.of_grid_set = if table.drives.repeats { 1 } else { self.grid_repeats() };
        let drives = own.missing(sets, table.drives.of_grid_set);
        let sweeping = Sweeping::new(&self.bus, self.place(), FIRST_OF_GRID, drives)?;
        self.stage = TrainingStage::Table(sweeping, table);
        self.after_drives()
    }

    /// Drives of each set of the grid with a vehicle that does not repeat itself.
    fn grid_repeats(&self) -> u32 {
        let ticks = self.config.ticks() * self.config.grid().len() as u64;
        let allowed = (self.config.ranking.max_ticks / ticks).max(1);
        u64::from(self.config.ranking.repeats).min(allowed) as u32
    }

    /// Learns from the last request whether the vehicle paces by the clock. Returns whether one has come.
    fn knows_pace(&mut self, table: &mut Table) -> Result<bool> {
        let request = self.requests.receive_newest()?;
        table.waits_for_pace = request.is_none();
        let by_clock = |it: &DriveRequest| has(it.flags, DriveRequest::REAL_TIME);
        table.drives.by_clock = request.is_some_and(|it| it.items().iter().any(by_clock));
        Ok(!table.waits_for_pace)
    }

    /// Ranks what was chosen, or else what the tuner recommends, among all sets by plain calls. In a separate thread: it
    /// may take a while, and the process must give signs of life meanwhile.
    fn rank(&mut self, choice: Option<Choice>) -> Result<()> {
        let (config, training) = (self.config.clone(), self.training.clone());
        let share = self.ranked.clone();
        self.in_thread(move || {
            let progress = |done: f64| share.store((1000.0 * done) as u32, Ordering::Relaxed);
            let mut choice = choice;
            if let Some(choice) = choice.as_mut().filter(|_| grid_is_driven(&config)) {
                let (objective, set) = (training.objective(), &choice.parameters);
                choice.rank_mean = Some(rank_mean(&config, objective, set, progress));
            }
            let ranking = Ranking::by_rollout(&config);
            let recommend = || training.tuner().recommend(&|a, b| ranking.compare(a, b));
            let choice = choice.unwrap_or_else(|| Choice::recommended(recommend()));
            train_result(&config, &training, &ranking, choice, None)
        })
    }

    /// The same by the drives of a vehicle that is not our simulator.
    fn rank_own(&mut self, table: Table) -> Result<()> {
        let (config, training) = (self.config.clone(), self.training.clone());
        self.in_thread(move || {
            let Table { choice, own, drives, .. } = table;
            let ranking = Ranking::of_vehicle(&config, own);
            train_result(&config, &training, &ranking, choice, Some(drives))
        })
    }

    fn in_thread(&mut self, rank: impl FnOnce() -> TrainResult + Send + 'static) -> Result<()> {
        let (journal, law) = (self.journal.file()?, self.config.law.clone());
        self.stage = TrainingStage::Ranking(std::thread::spawn(move || {
            journal.sync_data().context("failed to sync the journal")?;
            let result = rank();
            let parameters = law
                .parameters_of(&result.gains)
                .map_err(|(key, problem)| anyhow!("the tuned set: {key} {problem}"))?;
            Ok(Chosen { parameters, result })
        }));
        Ok(())
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
        let sweeping = Sweeping::new(&self.bus, self.place(), FIRST_DEMONSTRATED, drives)?;
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
