//! Which drives are made when: batches, slots and attempts.
//!
//! Pure. The trainer proposes drives by (learner, step). A batch takes as many as the fleet holds; it ends
//! with the controller's report, and an attempt that a crash ended is repeated with the same seeds, so with
//! the same result. The answer to a learner is kept until its next proposal, so that it can be sent again to a trainer
//! that missed it: each drive counts exactly once.

use std::collections::BTreeMap;

use ipc_types::{
    Attempt, BatchHeader, DriveOutcome, DriveReport, DriveRequest, Proposal, WirePose,
};

/// Which drives are made when.
#[derive(Debug)]
pub struct Sequencer {
    start: WirePose,
    fleet: usize,
    /// Drives of the learners below this number are counted as theirs; those of others are extra.
    learners: u32,
    /// Bits that every request carries.
    flags: u32,
    /// The attempt that is or was last under way.
    attempt: Attempt,
    proposals: Vec<Proposal>,
    driving: Vec<DriveRequest>,
    /// The last outcome of each learner.
    outcomes: BTreeMap<u32, DriveOutcome>,
    counts: DriveCounts,
}

/// What was driven.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct DriveCounts {
    /// Drives of learners, or of a list, that were reported.
    pub reported: u64,
    /// Drives in addition to those of a training: of finalists, and of the tuned set for the figures.
    pub beside: u64,
    /// Drives that were requested again after a crash.
    pub reissued: u64,
    /// Ticks of all reported drives.
    pub ticks: u64,
    /// Reports that belonged to no drive of the batch.
    pub dropped: u64,
}

impl Sequencer {
    /// A sequencer before the first batch, for `fleet` vehicles and `learners` learners.
    pub fn new(run: u64, start: WirePose, fleet: usize, learners: u32) -> Self {
        Self {
            start,
            fleet,
            learners,
            flags: 0,
            attempt: Attempt::between_batches(run),
            proposals: Vec::new(),
            driving: Vec::new(),
            outcomes: BTreeMap::new(),
            counts: DriveCounts::default(),
        }
    }

    /// Makes every vehicle in lockstep wait for the recorder of the run.
    pub fn log_all(&mut self) {
        self.flags |= DriveRequest::LOGGED;
    }

    /// Tells everybody that the vehicle paces by the clock.
    pub fn pace_by_clock(&mut self) {
        self.flags |= DriveRequest::REAL_TIME;
    }

    /// Limits the fleet to what the vehicle can drive at once.
    pub fn limit_fleet(&mut self, capacity: usize) {
        self.fleet = self.fleet.min(capacity.max(1));
    }

    /// Takes all drives that the learners want. Returns the outcomes that the trainer has missed.
    pub fn propose(&mut self, proposals: &[Proposal]) -> Vec<DriveOutcome> {
        let mut missed = Vec::new();
        self.proposals.clear();
        for proposal in proposals {
            match self.outcomes.get(&proposal.learner) {
                Some(outcome) if outcome.report.step == proposal.step => missed.push(*outcome),
                _ if self.is_driving_for(proposal) => {}
                _ => self.proposals.push(*proposal),
            }
        }
        // Learners that have made the fewest steps go first, so that a small fleet serves all of them alike.
        self.proposals.sort_by_key(|proposal| (proposal.step, proposal.learner));
        missed
    }

    fn is_driving_for(&self, proposal: &Proposal) -> bool {
        self.driving
            .iter()
            .any(|drive| (drive.learner, drive.step) == (proposal.learner, proposal.step))
    }

    /// The next batch, if there is none under way and drives are wanted.
    pub fn next_batch(&mut self) -> Option<(BatchHeader, &[DriveRequest])> {
        if !self.driving.is_empty() || self.proposals.is_empty() {
            return None;
        }
        self.attempt.batch += 1;
        self.attempt.attempt = 1;
        self.driving = self
            .proposals
            .drain(..self.fleet.min(self.proposals.len()))
            .map(|proposal| DriveRequest {
                start: self.start,
                parameters: proposal.parameters,
                seed: proposal.seed,
                ticks: proposal.ticks,
                learner: proposal.learner,
                step: proposal.step,
                flags: proposal.flags | self.flags,
                plant: proposal.plant,
            })
            .collect();
        // The trainer asks again for the rest once it has learnt from this batch.
        self.proposals.clear();
        Some((self.header(), &self.driving))
    }

    /// The batch under way again, as a new attempt; `None` between batches.
    pub fn reissue(&mut self) -> Option<(BatchHeader, &[DriveRequest])> {
        if self.driving.is_empty() {
            return None;
        }
        self.attempt.attempt += 1;
        self.counts.reissued += self.driving.len() as u64;
        Some((self.header(), &self.driving))
    }

    /// Takes a report. Returns the outcomes if it reports the batch under way.
    pub fn report(
        &mut self,
        header: BatchHeader,
        reports: &[DriveReport],
    ) -> Option<Vec<DriveOutcome>> {
        let fits = header.attempt == self.attempt
            && reports.len() == self.driving.len()
            && !self.driving.is_empty()
            && self.driving.iter().zip(reports).all(|(drive, report)| {
                (drive.learner, drive.step, drive.seed)
                    == (report.learner, report.step, report.seed)
            });
        if !fits {
            self.counts.dropped += 1;
            return None;
        }
        self.driving.clear();
        let outcomes: Vec<DriveOutcome> = reports
            .iter()
            .map(|report| DriveOutcome { report: *report, attempt: self.attempt })
            .collect();
        for outcome in &outcomes {
            if outcome.report.learner < self.learners {
                self.counts.reported += 1;
            } else {
                self.counts.beside += 1;
            }
            self.counts.ticks += outcome.report.ticks;
            self.outcomes.insert(outcome.report.learner, *outcome);
        }
        Some(outcomes)
    }

    /// Whether a batch is under way.
    pub fn is_driving(&self) -> bool {
        !self.driving.is_empty()
    }

    /// Ticks of the longest drive of the batch under way.
    pub fn ticks(&self) -> u64 {
        self.driving.iter().map(|drive| drive.ticks).max().unwrap_or_default()
    }

    /// Number of the batch that is or was last under way.
    pub fn batch(&self) -> u64 {
        self.attempt.batch
    }

    /// The attempt at it.
    pub fn attempt(&self) -> u32 {
        self.attempt.attempt
    }

    /// What was driven.
    pub fn counts(&self) -> DriveCounts {
        self.counts
    }

    fn header(&self) -> BatchHeader {
        BatchHeader { attempt: self.attempt, ..BatchHeader::default() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn sequencer(fleet: usize) -> Sequencer {
        Sequencer::new(9, WirePose::default(), fleet, u32::MAX)
    }

    fn proposal(learner: u32, step: u32) -> Proposal {
        let seed = u64::from(learner * 1000 + step);
        Proposal { learner, step, seed, ticks: 5, ..Proposal::default() }
    }

    fn reports(drives: &[DriveRequest]) -> Vec<DriveReport> {
        drives
            .iter()
            .map(|drive| DriveReport {
                learner: drive.learner,
                step: drive.step,
                seed: drive.seed,
                ticks: drive.ticks,
                ..DriveReport::default()
            })
            .collect()
    }

    #[test]
    fn a_batch_takes_what_the_fleet_holds_and_who_is_behind_goes_first() {
        let mut sequencer = sequencer(2);
        sequencer.propose(&[proposal(0, 7), proposal(1, 3), proposal(2, 5)]);
        let (header, drives) = sequencer.next_batch().unwrap();
        let first = Attempt { run: 9, batch: 1, attempt: 1, reserved: 0 };
        assert_eq!(header.attempt, first);
        assert_eq!(drives.iter().map(|drive| drive.learner).collect::<Vec<_>>(), [1, 2]);
        assert!(sequencer.next_batch().is_none());
    }

    #[test]
    fn only_the_current_attempt_is_believed() {
        let mut sequencer = sequencer(1);
        sequencer.propose(&[proposal(0, 0)]);
        let (first, drives) = sequencer.next_batch().unwrap();
        let reports = reports(drives);
        let (second, again) = sequencer.reissue().unwrap();
        assert_eq!((second.attempt.batch, second.attempt.attempt), (1, 2));
        assert_eq!(again[0].seed, reports[0].seed);
        assert!(sequencer.report(first, &reports).is_none());
        assert!(sequencer.report(second, &[]).is_none());
        assert_eq!(sequencer.report(second, &reports).unwrap()[0].attempt, second.attempt);
        assert!(sequencer.report(second, &reports).is_none());
        let counts = sequencer.counts();
        assert_eq!((counts.reported, counts.reissued, counts.dropped), (1, 1, 3));
        assert!(sequencer.reissue().is_none());
    }

    #[test]
    fn a_trainer_that_missed_an_outcome_is_told_again() {
        let mut sequencer = sequencer(1);
        sequencer.propose(&[proposal(0, 0)]);
        let (header, drives) = sequencer.next_batch().unwrap();
        let reports = reports(drives);
        // The trainer was restarted meanwhile, and asks for the drive that is under way.
        assert!(sequencer.propose(&[proposal(0, 0)]).is_empty());
        sequencer.report(header, &reports).unwrap();
        assert!(sequencer.next_batch().is_none());
        // And again after the report.
        assert_eq!(sequencer.propose(&[proposal(0, 0)]).len(), 1);
        assert!(sequencer.next_batch().is_none());
        assert!(sequencer.propose(&[proposal(0, 1)]).is_empty());
        assert_eq!(sequencer.next_batch().unwrap().1[0].step, 1);
    }

    proptest! {
        /// Learners that want ten drives each get each of them once, whatever dies when.
        #[test]
        fn every_drive_counts_exactly_once(
            fleet in 1usize..6, learners in 1usize..6,
            crashes in prop::collection::vec(0u8..3, 0..200),
        ) {
            let mut sequencer = sequencer(fleet);
            let mut steps = vec![0u32; learners];
            let mut crashes = crashes.into_iter();
            let mut rounds = 0;
            while steps.iter().any(|step| *step < 10) {
                rounds += 1;
                prop_assert!(rounds < 1000);
                let wanted: Vec<Proposal> = steps.iter().enumerate()
                    .filter(|(_, step)| **step < 10)
                    .map(|(learner, step)| proposal(learner as u32, *step)).collect();
                let mut outcomes = sequencer.propose(&wanted);
                let crash = crashes.next();
                if let Some((mut header, drives)) = sequencer.next_batch() {
                    let reports = reports(drives);
                    if crash == Some(1) {
                        // A process of the ring died: the report of the old attempt comes late.
                        let old = header;
                        header = sequencer.reissue().unwrap().0;
                        prop_assert!(sequencer.report(old, &reports).is_none());
                    }
                    let told = sequencer.report(header, &reports).unwrap();
                    if crash != Some(2) {
                        // Otherwise the trainer died before it received the outcomes.
                        outcomes.extend(told);
                    }
                }
                for outcome in outcomes {
                    let step = &mut steps[outcome.report.learner as usize];
                    prop_assert_eq!(outcome.report.step, *step);
                    *step += 1;
                }
            }
            prop_assert_eq!(sequencer.counts().reported, 10 * learners as u64);
        }
    }
}
