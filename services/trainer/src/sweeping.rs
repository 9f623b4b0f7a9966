//! A sweep joined to the pipeline: asks for its drives, records those that must be recorded, and takes their reports.

use std::collections::BTreeMap;
use std::path::PathBuf;

use anyhow::{Result, ensure};
use config::RunConfig;
use ipc_types::{Attempt, BatchHeader, DriveOutcome, DriveReport, LearnerProgress, Proposal};
use outcome::Lap;
use runtime::Bus;
use runtime::clock::now_ns;
use tracking::{LapRecorder, Reference};

use crate::along::{SingleSums, Sums};
use crate::recording::{Recorder, Taken};
use crate::sweep::{PlannedDrive, Sweep};
use crate::wire::{Driven, record_of};

/// Where a sweep belongs.
pub(crate) struct Place {
    pub(crate) run: u64,
    pub(crate) folder: PathBuf,
    pub(crate) max_len: usize,
    pub(crate) tick_s: f64,
    /// Full length of a drive.
    pub(crate) ticks: u64,
    /// Counts the laps of recorded drives; `None` if the path is driven once.
    pub(crate) laps: Option<LapRecorder>,
    /// What is told of a recorded drive that is the only one; `None` for several.
    pub(crate) single: Option<Box<SingleSums>>,
    /// Which start of the process it is.
    pub(crate) incarnation: u64,
}

/// What counts the laps of a recorded drive; `None` if the path is driven once.
pub(crate) fn laps_of(config: &RunConfig) -> Option<LapRecorder> {
    (config.path.laps > 1).then(|| LapRecorder::new(Reference::new(config), config.drive.tick_s))
}

/// The result of one look at a sweep.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Progress {
    /// Nothing.
    None,
    /// Some ticks of a recording.
    Recording,
    /// The last recording that was waited for is written.
    Recorded,
}

/// A sweep that is being driven.
pub(crate) struct Sweeping {
    place: Place,
    sweep: Sweep,
    recorder: Option<Recorder>,
    /// Reports whose recordings are not complete yet, with the time at which they came.
    unrecorded: Vec<(DriveReport, u64)>,
    /// Names of the drives that were recorded.
    recorded: Vec<String>,
    /// Ticks that recordings lack, by their names.
    lacking: BTreeMap<String, u64>,
    /// The laps of recordings, by their names.
    laps: BTreeMap<String, Vec<Lap>>,
    /// What the recording of a single drive comes to.
    single: Option<Box<SingleSums>>,
}

impl Sweeping {
    pub(crate) fn new(
        bus: &Bus,
        place: Place,
        first_learner: u32,
        drives: Vec<PlannedDrive>,
    ) -> Result<Self> {
        let records = drives.iter().any(|drive| drive.record.is_some());
        // Observers cost a little of every tick, so they are attached only if there is something to record.
        let recorder = match records {
            true => {
                let names = (first_learner..).zip(&drives);
                let names = names.filter_map(|(it, drive)| Some((it, drive.record.clone()?)));
                let files = (place.folder.as_path(), names.collect());
                let sums = Sums { laps: place.laps.clone(), single: place.single.clone() };
                Some(Recorder::new(bus, place.run, place.tick_s, files, sums)?)
            }
            false => None,
        };
        // Drives of which only the predecessor saw something (recordings and switches) must be made again. For all
        // others the reports are enough, and the orchestrator still has them.
        let is_watched = records || drives.iter().any(|drive| drive.by_zone.len() > 1);
        let step = if is_watched { place.incarnation as u32 } else { 0 };
        let sweep = Sweep::new(first_learner, step, place.ticks, drives);
        Ok(Self {
            place,
            sweep,
            recorder,
            unrecorded: Vec::new(),
            recorded: Vec::new(),
            lacking: BTreeMap::new(),
            laps: BTreeMap::new(),
            single: None,
        })
    }

    /// The drives that are still wanted, at most as many as one message carries.
    pub(crate) fn wanted(&self) -> Vec<Proposal> {
        self.sweep.wanted(self.place.max_len)
    }

    pub(crate) fn sweep(&self) -> &Sweep {
        &self.sweep
    }

    /// Names of the drives that were recorded, in their order.
    pub(crate) fn recorded(&self) -> Vec<String> {
        let mut names = self.recorded.clone();
        names.sort();
        names
    }

    /// Ticks that recordings lack, by their names.
    pub(crate) fn lacking(&self) -> BTreeMap<String, u64> {
        self.lacking.clone()
    }

    /// The laps of recorded drives, by their names; empty if the path is driven once.
    pub(crate) fn laps(&self) -> BTreeMap<String, Vec<Lap>> {
        self.laps.clone()
    }

    /// What the recording of a single drive comes to; `None` if there is none.
    pub(crate) fn single(&self) -> Option<&SingleSums> {
        self.single.as_deref()
    }

    /// Takes outcomes; returns how many of them were not wanted.
    pub(crate) fn learn(&mut self, outcomes: &[DriveOutcome]) -> Result<u64> {
        let mut dropped = 0;
        for DriveOutcome { report, .. } in outcomes {
            // Asking again would bring the same report again.
            ensure!(
                record_of(report).is_plausible(),
                "impossible numbers in a drive report: {report:?}"
            );
            let Some(index) = self.sweep.index_of_own(report.learner, report.step) else {
                dropped += 1;
                continue;
            };
            // Who asks again gets the same report again, and its recording is taken only once.
            let is_waited_for = self
                .unrecorded
                .iter()
                .any(|(it, _)| (it.learner, it.step) == (report.learner, report.step));
            if is_waited_for || self.sweep.is_over(index) {
                dropped += 1;
            } else if self.sweep.drive(index).record.is_some() {
                self.unrecorded.push((*report, now_ns()));
            } else {
                dropped += u64::from(!self.sweep.take(report));
            }
        }
        Ok(dropped)
    }

    /// Records. A reported drive is over once its recording is written.
    pub(crate) fn poll(&mut self) -> Result<Progress> {
        let Some(recorder) = &mut self.recorder else { return Ok(Progress::None) };
        let any = recorder.poll()?;
        let waited = !self.unrecorded.is_empty();
        let mut waiting = Vec::new();
        for (report, since_ns) in self.unrecorded.drain(..) {
            let must_be_whole = !recorder.has_waited_enough(since_ns);
            let DriveReport { learner, step, ticks, .. } = report;
            let Some(taken) = recorder.take(learner, step, ticks, must_be_whole)? else {
                waiting.push((report, since_ns));
                continue;
            };
            // By the clock the report counts the ticks that were answered alone.
            let all = taken.next_tick.max(ticks);
            let lacking = all - taken.rows;
            if lacking > 0 {
                let name = &taken.name;
                tracing::warn!(name, lacking, of = all, "the recording lacks ticks");
                self.lacking.insert(name.clone(), lacking);
            }
            let arrived = record_of(&report).arrived();
            keep(taken, arrived, &mut self.recorded, &mut self.laps, &mut self.single);
            self.sweep.take(&report);
        }
        self.unrecorded = waiting;
        Ok(match any {
            _ if waited && self.unrecorded.is_empty() => Progress::Recorded,
            true => Progress::Recording,
            false => Progress::None,
        })
    }

    /// Whether reports wait for their recordings: then nothing more is asked for.
    pub(crate) fn is_recording(&self) -> bool {
        !self.unrecorded.is_empty()
    }

    /// The drives that were made, once all are over.
    pub(crate) fn driven(&self) -> Option<Vec<Driven>> {
        if self.is_recording() { None } else { self.sweep.driven() }
    }

    /// The drives in their order, as far as they were made.
    pub(crate) fn driven_so_far(&self) -> Vec<Option<Driven>> {
        self.sweep.driven_so_far()
    }

    /// Ends the recording of a drive under way, and writes it; returns what it comes to, if it is a single drive and
    /// anything of it was recorded.
    pub(crate) fn cut_recording(&mut self, index: usize) -> Result<Option<&SingleSums>> {
        self.poll()?;
        let Some(recorder) = &mut self.recorder else { return Ok(None) };
        let (learner, step) = self.sweep.key_of(index);
        if recorder.has_rows(learner, step)
            && let Some(taken) = recorder.take(learner, step, u64::MAX, false)?
        {
            keep(taken, false, &mut self.recorded, &mut self.laps, &mut self.single);
        }
        Ok(self.single())
    }

    /// Progress of the sweep, to be sent with [`LearnerProgress::DRIVES`].
    pub(crate) fn progress(&self) -> LearnerProgress {
        LearnerProgress {
            epsilon: 0.0,
            best_value: f64::INFINITY,
            asked: self.sweep.done() as u64,
            episode: self.sweep.done() as u32,
            episodes: self.sweep.len() as u32,
        }
    }

    pub(crate) fn header(&self, flags: u32) -> BatchHeader {
        let attempt = Attempt::between_batches(self.place.run);
        BatchHeader { attempt, flags, sent_ns: now_ns(), ..BatchHeader::default() }
    }
}

/// Notes what a recording comes to.
fn keep(
    Taken { name, mut sums, .. }: Taken,
    arrived: bool,
    recorded: &mut Vec<String>,
    laps: &mut BTreeMap<String, Vec<Lap>>,
    single: &mut Option<Box<SingleSums>>,
) {
    if let Some(of_drive) = sums.finish_laps(arrived) {
        laps.insert(name.clone(), of_drive);
    }
    recorded.push(name);
    *single = sums.single;
}
