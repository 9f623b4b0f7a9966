//! A list of drives, each made once: the drives that are not made for learning.

use config::Parameters;
use ipc_types::{DriveReport, DriveRequest, Proposal};

use crate::wire::Driven;

/// One drive of a sweep.
#[derive(Debug, Clone, PartialEq)]
pub struct PlannedDrive {
    /// The parameters of each zone; a single set is used in all of them.
    pub by_zone: Vec<Parameters>,
    /// Seed of the noise; `None` for a drive without noise.
    pub seed: Option<u64>,
    /// Which plant is driven: 0 for the configured vehicle, n for the n-th of the configuration.
    pub plant: u32,
    /// The name, without extension, of the file for its recording; `None` for a drive that is not recorded.
    pub record: Option<String>,
}

/// A list of drives, each made once, in any order.
///
/// To the orchestrator each of them is a learner of its own, with a single step.
#[derive(Debug, Clone)]
pub struct Sweep {
    first_learner: u32,
    step: u32,
    ticks: u64,
    drives: Vec<PlannedDrive>,
    reports: Vec<Option<DriveReport>>,
}

impl Sweep {
    /// A sweep whose drives are identified by the learners `first_learner`, `first_learner + 1`, … and by `step`. A
    /// process that uses another step than its predecessor never gets answers to the predecessor's requests.
    pub fn new(first_learner: u32, step: u32, ticks: u64, drives: Vec<PlannedDrive>) -> Self {
        let reports = vec![None; drives.len()];
        Self { first_learner, step, ticks, drives, reports }
    }

    /// The drives that are still wanted, at most `at_most`.
    pub fn wanted(&self, at_most: usize) -> Vec<Proposal> {
        (self.first_learner..)
            .zip(self.drives.iter().zip(&self.reports))
            .filter(|(_, (_, report))| report.is_none())
            .take(at_most)
            .map(|(learner, (drive, _))| self.proposal(learner, drive))
            .collect()
    }

    fn proposal(&self, learner: u32, drive: &PlannedDrive) -> Proposal {
        let flag = |on: bool, bit: u32| if on { bit } else { 0 };
        Proposal {
            parameters: drive.by_zone[0].0,
            seed: drive.seed.unwrap_or_default(),
            ticks: self.ticks,
            learner,
            step: self.step,
            flags: flag(drive.seed.is_some(), DriveRequest::NOISE)
                | flag(drive.by_zone.len() > 1, DriveRequest::SCHEDULED)
                | flag(drive.record.is_some(), DriveRequest::RECORDED),
            plant: drive.plant,
        }
    }

    /// The number of the drive of `learner`, whichever process asked for it.
    pub fn index_of(&self, learner: u32) -> Option<usize> {
        let index = learner.checked_sub(self.first_learner)? as usize;
        (index < self.drives.len()).then_some(index)
    }

    /// The number of the drive of `learner` and `step`, if this process asked for it.
    pub fn index_of_own(&self, learner: u32, step: u32) -> Option<usize> {
        self.index_of(learner).filter(|_| step == self.step)
    }

    /// Learner and step by which a drive of the list is known.
    pub fn key_of(&self, index: usize) -> (u32, u32) {
        (self.first_learner + index as u32, self.step)
    }

    /// A drive of the list.
    pub fn drive(&self, index: usize) -> &PlannedDrive {
        &self.drives[index]
    }

    /// Takes the report of a drive; returns whether it was wanted.
    pub fn take(&mut self, report: &DriveReport) -> bool {
        let Some(index) = self.index_of_own(report.learner, report.step) else { return false };
        self.reports[index].replace(*report).is_none()
    }

    /// Whether a drive is over.
    pub fn is_over(&self, index: usize) -> bool {
        self.reports[index].is_some()
    }

    /// Number of drives.
    pub fn len(&self) -> usize {
        self.drives.len()
    }

    /// Whether there is nothing to drive.
    pub fn is_empty(&self) -> bool {
        self.drives.is_empty()
    }

    /// Number of drives that are over.
    pub fn done(&self) -> usize {
        self.reports.iter().filter(|report| report.is_some()).count()
    }

    /// The drives that were made, in their order, once all are over.
    pub fn driven(&self) -> Option<Vec<Driven>> {
        self.driven_so_far().into_iter().collect()
    }

    /// The drives in their order, as far as they were made.
    pub fn driven_so_far(&self) -> Vec<Option<Driven>> {
        self.reports.iter().map(|report| report.map(Driven::from)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_drive_is_asked_for_until_it_is_reported() {
        let set = Parameters::of(&[1.0, 2.0, 3.0, 0.5]);
        let plain = PlannedDrive { by_zone: vec![set], seed: None, plant: 0, record: None };
        let rich = PlannedDrive {
            by_zone: vec![set; 3],
            seed: Some(4),
            plant: 3,
            record: Some("rich".to_owned()),
        };
        let mut sweep = Sweep::new(5, 2, 100, vec![plain, rich]);
        let wanted = sweep.wanted(9);
        assert_eq!(wanted.iter().map(|it| it.learner).collect::<Vec<_>>(), [5, 6]);
        assert_eq!((wanted[0].flags, wanted[0].seed), (0, 0));
        let all = DriveRequest::NOISE | DriveRequest::SCHEDULED | DriveRequest::RECORDED;
        assert_eq!((wanted[1].flags, wanted[1].seed, wanted[1].plant), (all, 4, 3));
        assert_eq!(sweep.wanted(1).len(), 1);

        let report = |learner, step| DriveReport { learner, step, ..DriveReport::default() };
        assert!(!sweep.take(&report(4, 2)) && !sweep.take(&report(7, 2)));
        assert!(!sweep.take(&report(5, 1)), "what a predecessor asked for");
        assert!(sweep.take(&report(6, 2)) && !sweep.take(&report(6, 2)));
        assert!(sweep.driven().is_none());
        assert!(matches!(sweep.driven_so_far()[..], [None, Some(_)]));
        assert!(sweep.take(&report(5, 2)));
        assert_eq!(sweep.driven().unwrap()[1].report.learner, 6);
        assert!(sweep.wanted(9).is_empty());
    }
}
