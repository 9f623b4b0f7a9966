//! The gain schedule's process: the trainer's role outside training.
//!
//! It asks for the drives of a plan instead of learning, answers each zone with that zone's gains, and writes
//! the result of the drives.

use std::collections::BTreeMap;
use std::rc::Rc;
use std::thread::JoinHandle;

use anyhow::{Context, Result, anyhow};
use config::{RunConfig, SweepKind, SweepPlan};
use ipc_types::{
    Attempt, BatchHeader, DriveOutcome, DriveRequest, GainSwitch, LearnerProgress, Proposal,
    WakeRole, Zone,
};
use outcome::{GridResult, Outcome, PlantCheck, Switch};
use runtime::clock::now_ns;
use runtime::{Attachment, Bus, Counters, Inlet, Outlet, Service, join, serve};

use crate::along::SingleSums;
use crate::grid::GridSweep;
use crate::own_drives::Driver;
use crate::result::decided;
use crate::service::write_outcome;
use crate::single::SingleDrive;
use crate::sweeping::{Place, Progress, Sweeping};
use crate::validation::Validation;
use crate::wire::Driven;

/// Runs the process until it is asked to stop.
///
/// # Errors
/// If it cannot join the run, the plan cannot be read, or the transport fails.
pub fn run() -> Result<()> {
    let (attachment, bus, config) = join()?;
    let path = attachment.folder.join(SweepPlan::FILE);
    let text =
        std::fs::read_to_string(&path).with_context(|| format!("failed to read {path:?}"))?;
    let plan = SweepPlan::parse(&text)?;
    let bus = Rc::new(bus);
    let mut schedule = Schedule::new(&bus, config, &plan, &attachment)?;
    serve(&attachment, &bus, WakeRole::Trainer, &mut schedule)?;
    schedule.stop()
}

struct Schedule {
    requests: Inlet<DriveRequest>,
    zones: Inlet<Zone>,
    outcomes: Inlet<DriveOutcome>,
    proposals: Outlet<Proposal>,
    progress: Outlet<LearnerProgress>,
    gains: Outlet<GainSwitch>,
    run: u64,
    folder: std::path::PathBuf,
    config: RunConfig,
    subject: Subject,
    sweeping: Sweeping,
    /// Learner of each slot of the batch that was requested last. A predecessor of this process may have asked
    /// for the batch; its zones are answered all the same.
    batch: (BatchHeader, Vec<u32>),
    /// Zones of a batch whose request has not come yet: the two travel on different topics.
    early: Vec<(BatchHeader, Zone)>,
    /// The switches of each drive, in its last attempt.
    switches: BTreeMap<usize, Vec<Switch>>,
    /// Drives the sets of a validation on plants, until they are taken.
    checks: Option<JoinHandle<Vec<Option<PlantCheck>>>>,
    /// Makes a result of the drives of a grid, until it is taken: it drives plants, too, and this process must give signs of
    /// life meanwhile.
    ranking: Option<JoinHandle<Result<GridResult>>>,
    stage: ScheduleStage,
    counters: Counters,
}

enum Subject {
    Validation(Validation),
    Grid(GridSweep),
    Drive(SingleDrive),
}

#[derive(Clone, Copy, PartialEq)]
enum ScheduleStage {
    /// No drive was asked for yet.
    Fresh,
    Driving,
    /// All drives are over, but the thread with the plants or with the result is not.
    Checking,
    /// The outcome has been written and announced.
    Over,
}

impl Schedule {
    fn new(
        bus: &Rc<Bus>,
        config: RunConfig,
        plan: &SweepPlan,
        attachment: &Attachment,
    ) -> Result<Self> {
        let simulated = Driver::of_run(&attachment.folder, &config)? == Driver::Simulator;
        let subject = match plan.kind {
            SweepKind::Validate => Subject::Validation(Validation::new(&config, plan)?),
            SweepKind::Grid => Subject::Grid(GridSweep::new(&config, plan, simulated)?),
            SweepKind::Drive => Subject::Drive(SingleDrive::new(&config, plan)?),
        };
        let drives = match &subject {
            Subject::Validation(validation) => validation.drives(),
            Subject::Grid(grid) => grid.drives(),
            Subject::Drive(drive) => drive.drives(),
        };
        let place = Place {
            run: attachment.names.run,
            folder: attachment.folder.clone(),
            max_len: attachment.max_len,
            tick_s: config.drive.tick_s,
            ticks: config.ticks(),
            laps: crate::sweeping::laps_of(&config),
            single: match &subject {
                Subject::Drive(_) => Some(Box::new(SingleSums::new(&config))),
                _ => None,
            },
            // A drive in real time goes on without this process, and is not made again.
            incarnation: if plan.realtime { 0 } else { attachment.incarnation },
        };
        let checks = match &subject {
            Subject::Validation(validation) if simulated => {
                let validation = validation.clone();
                Some(std::thread::spawn(move || validation.plant_checks()))
            }
            _ => None,
        };
        Ok(Self {
            requests: bus.inlet()?,
            zones: bus.inlet()?,
            outcomes: bus.inlet()?,
            proposals: bus.outlet()?,
            progress: bus.outlet()?,
            gains: bus.outlet()?,
            run: attachment.names.run,
            folder: attachment.folder.clone(),
            sweeping: Sweeping::new(bus, place, 0, drives)?,
            config,
            subject,
            batch: (
                BatchHeader {
                    attempt: Attempt::between_batches(attachment.names.run),
                    ..BatchHeader::default()
                },
                Vec::new(),
            ),
            early: Vec::new(),
            switches: BTreeMap::new(),
            checks,
            ranking: None,
            stage: ScheduleStage::Fresh,
            counters: Counters::default(),
        })
    }

    fn propose(&mut self) -> Result<()> {
        self.stage = ScheduleStage::Driving;
        let progress = self.sweeping.progress();
        let header = self.sweeping.header(LearnerProgress::DRIVES);
        self.progress.send(header, 1, |_| progress)?;
        let wanted = self.sweeping.wanted();
        if !wanted.is_empty() {
            self.proposals.send(self.sweeping.header(0), wanted.len(), |index| wanted[index])?;
        }
        Ok(())
    }

    /// Learns which drives are under way; returns whether there was anything new.
    fn hear_request(&mut self) -> Result<bool> {
        let Some(request) = self.requests.receive_newest()? else { return Ok(false) };
        if !request.header().attempt.is_of(self.run) {
            self.counters.dropped += 1;
            return Ok(true);
        }
        let slots = request.items().iter().map(|slot| slot.learner).collect();
        self.batch = (request.header(), slots);
        (self.counters.batch, self.counters.tick) = (self.batch.0.attempt.batch, 0);
        for learner in &self.batch.1 {
            if let Some(index) = self.sweeping.sweep().index_of(*learner) {
                self.switches.remove(&index);
            }
        }
        let early = std::mem::take(&mut self.early);
        self.answer(early)?;
        Ok(true)
    }

    /// Learns which zones were entered; returns whether there was anything new.
    fn hear_zones(&mut self) -> Result<bool> {
        let Some(zones) = self.zones.receive()? else { return Ok(false) };
        let header = zones.header();
        self.counters.tick = zones.items().first().map_or(0, |zone| zone.from_tick);
        let zones = zones.items().iter().map(|zone| (header, *zone)).collect();
        self.answer(zones)?;
        Ok(true)
    }

    /// Answers zones with their parameters, in one message.
    fn answer(&mut self, zones: Vec<(BatchHeader, Zone)>) -> Result<()> {
        let Self { batch: (batch, slots), sweeping, config, switches, early, counters, .. } = self;
        let mut answers = Vec::with_capacity(zones.len());
        for (header, zone) in zones {
            if header.attempt.is_ahead_of(&batch.attempt) {
                early.push((header, zone));
                continue;
            }
            let is_of_batch = header.attempt == batch.attempt;
            let index = slots
                .get(zone.slot as usize)
                .filter(|_| is_of_batch)
                .and_then(|learner| sweeping.sweep().index_of(*learner));
            let Some(index) = index else {
                counters.dropped += 1;
                continue;
            };
            let by_zone = &sweeping.sweep().drive(index).by_zone;
            let entered = config.path.zones.get(zone.zone as usize);
            let (Some(&parameters), Some(entered)) = (by_zone.get(zone.zone as usize), entered)
            else {
                // A single set is used in all zones.
                continue;
            };
            let named = config.law.named(&parameters);
            tracing::info!(
                tick = zone.from_tick,
                drive = index,
                zone = entered.name,
                parameters = %named,
                "switch"
            );
            switches.entry(index).or_default().push(Switch {
                tick: zone.from_tick,
                zone: zone.zone,
                name: entered.name.clone(),
                gains: named,
            });
            let parameters = parameters.0;
            let Zone { from_tick, slot, zone } = zone;
            answers.push(GainSwitch { parameters, from_tick, slot, zone });
        }
        if !answers.is_empty() {
            let header = BatchHeader { flags: 0, sent_ns: now_ns(), ..*batch };
            self.gains.send(header, answers.len(), |index| answers[index])?;
        }
        Ok(())
    }

    /// Writes and announces the outcome once all drives are over; until then asks for the rest.
    fn go_on(&mut self) -> Result<()> {
        if self.sweeping.is_recording() {
            return Ok(());
        }
        if self.sweeping.driven().is_none() {
            return self.propose();
        }
        let driven = self.sweeping.driven_so_far();
        if let (Subject::Grid(grid), None) = (&self.subject, &self.ranking) {
            let (grid, folder, driven) = (grid.clone(), self.folder.clone(), driven.clone());
            self.ranking = Some(std::thread::spawn(move || grid.finish(&folder, &driven)));
        }
        if self.checks.as_ref().is_some_and(|thread| !thread.is_finished())
            || self.ranking.as_ref().is_some_and(|thread| !thread.is_finished())
        {
            self.stage = ScheduleStage::Checking;
            return Ok(());
        }
        if let Some(outcome) = self.outcome(&driven)? {
            write_outcome(&self.folder, &decided(&self.config, outcome))?;
        }
        self.stage = ScheduleStage::Over;
        let header = self.sweeping.header(Proposal::FINISHED);
        self.proposals.send(header, 1, |_| Proposal::default())?;
        Ok(())
    }

    /// Keeps what was driven until this process was asked to stop.
    fn stop(&mut self) -> Result<()> {
        if self.stage == ScheduleStage::Over {
            return Ok(());
        }
        let mut driven = self.sweeping.driven_so_far();
        if let Subject::Drive(drive) = &self.subject
            && driven[0].is_none()
        {
            let sums = self.sweeping.cut_recording(0)?;
            driven[0] = sums.and_then(|sums| drive.interrupted(sums));
        }
        let Some(mut outcome) = self.outcome(&driven)? else { return Ok(()) };
        if let Outcome::Drive(drive) = &mut outcome {
            drive.reason = "interrupted".to_owned();
        }
        write_outcome(&self.folder, &decided(&self.config, outcome))
    }

    /// The outcome of the drives that were made: of a validation, only the rows that are whole. `None` if that is nothing.
    fn outcome(&mut self, driven: &[Option<Driven>]) -> Result<Option<Outcome>> {
        let (recorded, lacking) = (self.sweeping.recorded(), self.sweeping.lacking());
        let laps = self.sweeping.laps();
        Ok(match &self.subject {
            Subject::Validation(validation) => {
                let mut switches = vec![Vec::new(); validation.len()];
                for (drive, of_drive) in &self.switches {
                    if let Some(row) = validation.noise_free_row(*drive) {
                        switches[row] = of_drive.clone();
                    }
                }
                let (validation, driven, rows) = validation.cut(driven);
                let switches: Vec<_> = rows.iter().map(|row| switches[*row].clone()).collect();
                (!rows.is_empty()).then(|| {
                    let mut result = validation.result(&driven, &switches);
                    result.drives_recorded = recorded;
                    result.drives_lacking = lacking;
                    result.laps = laps;
                    // A validation that is stopped does not wait for them.
                    let ready = self.checks.take_if(|thread| thread.is_finished());
                    if let Some(Ok(mut checks)) = ready.map(JoinHandle::join) {
                        for (row, number) in result.rows.iter_mut().zip(&rows) {
                            row.plants = checks[*number].take();
                        }
                    }
                    Outcome::Validate(result)
                })
            }
            Subject::Grid(_) if driven.iter().all(Option::is_none) => None,
            Subject::Grid(grid) => Some(Outcome::Grid(match self.ranking.take() {
                Some(ranking) => ranking.join().map_err(|_| anyhow!("the ranking panicked"))??,
                None => grid.finish(&self.folder, driven)?,
            })),
            Subject::Drive(drive) => driven[0].map(|driven| {
                let switches = self.switches.remove(&0).unwrap_or_default();
                let mut result = drive.result(&driven, switches);
                let sums = self.sweeping.single();
                result.fastest = sums.and_then(SingleSums::fastest);
                result.envelope =
                    sums.and_then(|it| it.in_envelope(&self.config, driven.record.stopped_for));
                result.refused = sums.map(SingleSums::refused).unwrap_or_default();
                result.drives_recorded = recorded;
                result.drives_lacking = lacking;
                result.laps = laps;
                Outcome::Drive(Box::new(result))
            }),
        })
    }
}

impl Service for Schedule {
    fn poll(&mut self) -> Result<bool> {
        if self.stage == ScheduleStage::Fresh {
            self.go_on()?;
            return Ok(true);
        }
        if self.stage == ScheduleStage::Checking {
            self.go_on()?;
        }
        // A zone waits only for this answer.
        let mut any = self.hear_request()? | self.hear_zones()?;
        match self.sweeping.poll()? {
            Progress::None => {}
            Progress::Recording => any = true,
            Progress::Recorded => {
                any = true;
                self.go_on()?;
            }
        }
        let Some(outcomes) = self.outcomes.receive()? else { return Ok(any) };
        if !outcomes.header().attempt.is_of(self.run) || self.stage == ScheduleStage::Over {
            self.counters.dropped += 1;
            return Ok(true);
        }
        self.counters.dropped += self.sweeping.learn(outcomes.items())?;
        self.go_on()?;
        Ok(true)
    }

    fn status(&self) -> Counters {
        self.counters
    }
}
