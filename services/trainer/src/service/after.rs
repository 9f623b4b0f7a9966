//! What follows when all learners have finished: finalists, the figures of the table, the ranking, and the recordings.

use std::sync::atomic::Ordering;

use anyhow::{Context, Result, anyhow};
use config::Parameters;
use ipc_types::{DriveRequest, LearnerProgress, Proposal, has};
use outcome::{Outcome, TrainResult, VehicleDrives};
use runtime::clock::now_ns;

use super::{Trainer, TrainingStage, write_outcome};
use crate::own_drives::{Driver, recommended};
use crate::ranking::grid_is_driven;
use crate::result::{Choice, decided, train_result};
use crate::sweeping::Sweeping;
use crate::{Finalists, OwnDrives, PlannedDrive, Ranking, rank_mean};

/// Time between two reports on the progress of the ranking.
const TELL_NS: u64 = 100_000_000;

/// With a budget below this, what a tuner's model says takes the place of finalists.
const FEW_DRIVES: f64 = 30.0;

/// The figures of a table under way.
pub(super) struct Table {
    choice: Choice,
    own: OwnDrives,
    drives: VehicleDrives,
    /// All drives are over, but no request has told how the vehicle paces: the two travel on different topics.
    pub(super) waits_for_pace: bool,
}

/// The set that a training has found, and its result.
pub(super) struct Chosen {
    parameters: Parameters,
    result: TrainResult,
}

/// To the orchestrator each drive of a sweep is a learner of its own. Their numbers are above those of the learners and
/// of all finalists.
const FIRST_OF_TABLE: u32 = u32::MAX / 4;
const FIRST_OF_GRID: u32 = u32::MAX / 8 * 3;
const FIRST_DEMONSTRATED: u32 = u32::MAX / 2;

impl Trainer {
    /// Starts what follows when all learners have finished: where single drives differ the finalists, then the figures.
    pub(super) fn after_training(&mut self) -> Result<()> {
        self.story.flush()?;
        self.checkpoints.finish()?;
        if self.is_dear() || self.training.tuner().chooses() {
            return self.rank_few();
        }
        if self.config.is_over_plants() && self.driver == Driver::Simulator {
            return self.rank(None);
        }
        if self.config.noise.enabled && self.is_few() && self.driver == Driver::Simulator {
            let set = recommended(&self.training);
            if self.training.tuner().predicted(&set).is_some() {
                return self.rank(Some(Choice::recommended(set)));
            }
        }
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

    /// Whether the budget of drives is so small that no drives beside it may choose among finalists.
    fn is_few(&self) -> bool {
        let tuner = &self.config.tuner;
        tuner.has_budget() && tuner.settings.number("drives") < FEW_DRIVES
    }

    /// Whether a vehicle that is not our simulator makes the drives of a budget: then it makes no others, for whatever.
    fn is_dear(&self) -> bool {
        self.driver != Driver::Simulator && self.config.tuner.has_budget()
    }

    /// Goes on without any further drive of a vehicle that is not our simulator: those of its budget are all that it makes.
    fn rank_few(&mut self) -> Result<()> {
        let choice = Choice::recommended(recommended(&self.training));
        let Driver::Vehicle { repeats } = self.driver else { return self.rank(Some(choice)) };
        let mut own = OwnDrives::default();
        let driven = self.training.driven();
        driven.iter().for_each(|(set, drive)| own.add(set, *drive));
        let drives = VehicleDrives { repeats, by_clock: false, for_table: 0, of_grid_set: 0 };
        self.rank_own(Table { choice, own, drives, waits_for_pace: false })
    }

    /// Asks for the drives of a sweep that are still wanted.
    pub(super) fn ask(&mut self) -> Result<()> {
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
    pub(super) fn after_drives(&mut self) -> Result<()> {
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
                result.laps = sweeping.laps();
                self.end(result)
            }
            other => {
                self.stage = other;
                Ok(())
            }
        }
    }

    /// Writes the result and announces it.
    fn end(&mut self, result: Box<TrainResult>) -> Result<()> {
        self.stage = TrainingStage::Over;
        write_outcome(&self.folder, &decided(&self.config, Outcome::Train(result)))?;
        self.proposals.send(self.header(Proposal::FINISHED), 1, |_| Proposal::default())?;
        Ok(())
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
            let known: Vec<_> =
                unknown.filter_map(|set| Some((*set, *self.training.remembered(set)?))).collect();
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
            let by_means = |it: &&mut Choice| it.by_means.is_some() && grid_is_driven(&config);
            if let Some(choice) = choice.as_mut().filter(by_means) {
                let (objective, set) = (training.objective(), &choice.parameters);
                choice.rank_mean = Some(rank_mean(&config, objective, set, progress));
            }
            if choice.is_none() && config.is_over_plants() {
                let mut finalists = Finalists::over_plants(&config, &training);
                choice = Some(finalists.choose_over_plants(&config, &training, progress));
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
    pub(super) fn after_ranking(&mut self) -> Result<bool> {
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
        if self.is_dear() {
            return self.end(Box::new(result)).map(|()| true);
        }
        let drives = [("tuned_noise_free", None), ("tuned_noisy", Some(1))]
            .map(|(name, seed)| PlannedDrive {
                by_zone: vec![parameters],
                seed,
                plant: 0,
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
        let share = f64::from(self.ranked.load(Ordering::Relaxed)) / 1000.0;
        self.tell_share(share, LearnerProgress::RANKING)
    }

    /// Reports which share is done of something that takes long, not too often.
    pub(super) fn tell_share(&mut self, share: f64, of: u32) -> Result<()> {
        let now_ns = now_ns();
        if now_ns - self.told_ns < TELL_NS {
            return Ok(());
        }
        self.told_ns = now_ns;
        let (epsilon, best_value, episode) = (0.0, f64::INFINITY, (1000.0 * share) as u32);
        let progress = LearnerProgress { epsilon, best_value, asked: 0, episode, episodes: 1000 };
        self.progress.send(self.header(of), 1, |_| progress)?;
        Ok(())
    }
}
