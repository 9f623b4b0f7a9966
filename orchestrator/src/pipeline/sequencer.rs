//! Which drives are made when: batches, slots and attempts.
//!
//! Pure. The trainer proposes drives by (learner, step). Each ring has at most one batch under way, and the rings that are free
//! share what is proposed. A batch takes as many drives as the ring's fleet holds; it ends
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
    /// Vehicles of a ring.
    fleet: usize,
    /// Drives of the learners below this number are counted as theirs; those of others are extra.
    learners: u32,
    /// Bits that every request carries.
    flags: u32,
    run: u64,
    /// Number of the batch that was begun last, by any ring.
    last_batch: u64,
    proposals: Vec<Proposal>,
    rings: Vec<Underway>,
    /// The last outcome of each learner.
    outcomes: BTreeMap<u32, DriveOutcome>,
    counts: DriveCounts,
}

/// What a ring drives.
#[derive(Debug, Clone)]
struct Underway {
    /// The attempt that is or was last under way.
    attempt: Attempt,
    /// Its drives; empty between batches.
    driving: Vec<DriveRequest>,
}

impl Underway {
    fn header(&self) -> BatchHeader {
        BatchHeader { attempt: self.attempt, ..BatchHeader::default() }
    }
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
    /// A sequencer before the first batch, for `fleet` vehicles in all of `rings` rings and `learners` learners.
    pub fn new(run: u64, start: WirePose, fleet: usize, rings: usize, learners: u32) -> Self {
        let idle = Underway { attempt: Attempt::between_batches(run), driving: Vec::new() };
        Self {
            start,
            fleet: fleet.div_ceil(rings),
            learners,
            flags: 0,
            run,
            last_batch: 0,
            proposals: Vec::new(),
            rings: vec![idle; rings],
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
        self.rings
            .iter()
            .flat_map(|ring| &ring.driving)
            .any(|drive| (drive.learner, drive.step) == (proposal.learner, proposal.step))
    }

    /// The next batch of a ring, if it has none under way and drives are wanted. `free` is the number of rings that could
    /// begin one now, this one included: they get equal shares.
    pub fn next_batch(
        &mut self,
        ring: usize,
        free: usize,
    ) -> Option<(BatchHeader, &[DriveRequest])> {
        let followed = self.proposals.iter().any(|it| it.flags & FOLLOWED != 0);
        if self.is_driving(ring) || self.proposals.is_empty() || (followed && ring != TRAINERS_RING)
        {
            return None;
        }
        let free = if followed { 1 } else { free.max(1) };
        self.last_batch += 1;
        let share = self.proposals.len().div_ceil(free).min(self.fleet);
        let driving = self
            .proposals
            .drain(..share)
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
        if free == 1 {
            // The trainer asks again for the rest once it has learnt from this batch.
            self.proposals.clear();
        }
        let attempt =
            Attempt { batch: self.last_batch, attempt: 1, ..Attempt::between_batches(self.run) };
        let ring = &mut self.rings[ring];
        *ring = Underway { attempt, driving };
        Some((ring.header(), &ring.driving))
    }

    /// The batch of a ring again, as a new attempt; `None` between batches.
    pub fn reissue(&mut self, ring: usize) -> Option<(BatchHeader, &[DriveRequest])> {
        let ring = &mut self.rings[ring];
        if ring.driving.is_empty() {
            return None;
        }
        ring.attempt.attempt += 1;
        self.counts.reissued += ring.driving.len() as u64;
        Some((ring.header(), &ring.driving))
    }

    /// Takes a report of a ring. Returns the outcomes if it reports the batch under way there.
    pub fn report(
        &mut self,
        ring: usize,
        header: BatchHeader,
        reports: &[DriveReport],
    ) -> Option<Vec<DriveOutcome>> {
        let Underway { attempt, driving } = &mut self.rings[ring];
        let fits = header.attempt == *attempt
            && reports.len() == driving.len()
            && !driving.is_empty()
            && driving.iter().zip(reports).all(|(drive, report)| {
                (drive.learner, drive.step, drive.seed)
                    == (report.learner, report.step, report.seed)
            });
        if !fits {
            self.counts.dropped += 1;
            return None;
        }
        driving.clear();
        let outcomes: Vec<DriveOutcome> = reports
            .iter()
            .map(|report| DriveOutcome { report: *report, attempt: *attempt })
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

    /// Whether a ring has a batch under way.
    pub fn is_driving(&self, ring: usize) -> bool {
        !self.rings[ring].driving.is_empty()
    }

    /// Ticks of the longest drive of the batch that a ring has under way.
    pub fn ticks(&self, ring: usize) -> u64 {
        self.rings[ring].driving.iter().map(|drive| drive.ticks).max().unwrap_or_default()
    }

    /// Number of the batch that a ring has, or had last, under way.
    pub fn batch(&self, ring: usize) -> u64 {
        self.rings[ring].attempt.batch
    }

    /// The attempt at it.
    pub fn attempt(&self, ring: usize) -> u32 {
        self.rings[ring].attempt.attempt
    }

    /// What was driven.
    pub fn counts(&self) -> DriveCounts {
        self.counts
    }
}

/// The ring whose topics the trainer reads.
const TRAINERS_RING: usize = 0;
/// Flags of drives that the trainer follows tick by tick, or to whose zones it answers: they must be where it listens.
const FOLLOWED: u32 = DriveRequest::RECORDED | DriveRequest::SCHEDULED;

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn sequencer(fleet: usize) -> Sequencer {
        sequencer_of_rings(fleet, 1)
    }

    fn sequencer_of_rings(fleet: usize, rings: usize) -> Sequencer {
        Sequencer::new(9, WirePose::default(), fleet, rings, u32::MAX)
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
        let (header, drives) = sequencer.next_batch(0, 1).unwrap();
        let first = Attempt { run: 9, batch: 1, attempt: 1, reserved: 0 };
        assert_eq!(header.attempt, first);
        assert_eq!(drives.iter().map(|drive| drive.learner).collect::<Vec<_>>(), [1, 2]);
        assert!(sequencer.next_batch(0, 1).is_none());
    }

    #[test]
    fn only_the_current_attempt_is_believed() {
        let mut sequencer = sequencer(1);
        sequencer.propose(&[proposal(0, 0)]);
        let (first, drives) = sequencer.next_batch(0, 1).unwrap();
        let reports = reports(drives);
        let (second, again) = sequencer.reissue(0).unwrap();
        assert_eq!((second.attempt.batch, second.attempt.attempt), (1, 2));
        assert_eq!(again[0].seed, reports[0].seed);
        assert!(sequencer.report(0, first, &reports).is_none());
        assert!(sequencer.report(0, second, &[]).is_none());
        assert_eq!(sequencer.report(0, second, &reports).unwrap()[0].attempt, second.attempt);
        assert!(sequencer.report(0, second, &reports).is_none());
        let counts = sequencer.counts();
        assert_eq!((counts.reported, counts.reissued, counts.dropped), (1, 1, 3));
        assert!(sequencer.reissue(0).is_none());
    }

    #[test]
    fn a_trainer_that_missed_an_outcome_is_told_again() {
        let mut sequencer = sequencer(1);
        sequencer.propose(&[proposal(0, 0)]);
        let (header, drives) = sequencer.next_batch(0, 1).unwrap();
        let reports = reports(drives);
        // The trainer was restarted meanwhile, and asks for the drive that is under way.
        assert!(sequencer.propose(&[proposal(0, 0)]).is_empty());
        sequencer.report(0, header, &reports).unwrap();
        assert!(sequencer.next_batch(0, 1).is_none());
        // And again after the report.
        assert_eq!(sequencer.propose(&[proposal(0, 0)]).len(), 1);
        assert!(sequencer.next_batch(0, 1).is_none());
        assert!(sequencer.propose(&[proposal(0, 1)]).is_empty());
        assert_eq!(sequencer.next_batch(0, 1).unwrap().1[0].step, 1);
    }

    #[test]
    fn rings_that_are_free_share_what_is_wanted() {
        let mut sequencer = sequencer_of_rings(8, 2);
        let wanted: Vec<Proposal> = (0..5).map(|learner| proposal(learner, 0)).collect();
        sequencer.propose(&wanted);
        let learners =
            |drives: &[DriveRequest]| drives.iter().map(|it| it.learner).collect::<Vec<_>>();
        let (first, drives) = sequencer.next_batch(0, 2).unwrap();
        let of_first = reports(drives);
        assert_eq!(learners(drives), [0, 1, 2]);
        let (second, drives) = sequencer.next_batch(1, 1).unwrap();
        let of_second = reports(drives);
        assert_eq!((learners(drives), second.attempt.batch), (vec![3, 4], 2));
        // Each ring has its own batch and attempts, and a fleet half as large.
        assert_eq!(sequencer.reissue(1).unwrap().0.attempt.attempt, 2);
        assert!(sequencer.report(1, first, &of_first).is_none());
        assert!(sequencer.report(1, second, &of_second).is_none());
        assert!(sequencer.report(0, first, &of_first).is_some());
        let wanted: Vec<Proposal> = (0..9).map(|learner| proposal(learner, 1)).collect();
        sequencer.propose(&wanted);
        assert_eq!(learners(sequencer.next_batch(0, 1).unwrap().1), [0, 1, 2, 3]);
    }

    #[test]
    fn drives_that_the_trainer_follows_are_in_its_ring() {
        for flags in [DriveRequest::RECORDED, DriveRequest::SCHEDULED] {
            let mut sequencer = sequencer_of_rings(8, 2);
            let wanted = [Proposal { flags, ..proposal(0, 0) }, proposal(1, 0)];
            sequencer.propose(&wanted);
            assert!(sequencer.next_batch(1, 2).is_none());
            assert_eq!(sequencer.next_batch(0, 2).unwrap().1.len(), 2);
        }
    }

    proptest! {
        /// Learners that want ten drives each get each of them once, whatever dies when, and whichever ring is the first.
        #[test]
        fn every_drive_counts_exactly_once(
            fleet in 1usize..6, rings in 1usize..4, learners in 1usize..6,
            events in prop::collection::vec((0u8..3, 0usize..3), 0..200),
        ) {
            let mut sequencer = sequencer_of_rings(fleet, rings);
            let mut steps = vec![0u32; learners];
            let mut events = events.into_iter();
            let mut rounds = 0;
            let mut underway = vec![None; rings];
            while steps.iter().any(|step| *step < 10) {
                rounds += 1;
                prop_assert!(rounds < 1000);
                let wanted: Vec<Proposal> = steps.iter().enumerate()
                    .filter(|(_, step)| **step < 10)
                    .map(|(learner, step)| proposal(learner as u32, *step)).collect();
                let mut outcomes = sequencer.propose(&wanted);
                let mut free = underway.iter().filter(|it| it.is_none()).count();
                for (ring, underway) in underway.iter_mut().enumerate().filter(|it| it.1.is_none()) {
                    if let Some((header, drives)) = sequencer.next_batch(ring, free) {
                        *underway = Some((header, reports(drives)));
                    }
                    free -= 1;
                }
                let (crash, ring) = events.next().unwrap_or_default();
                // The ring that ends its batch now: the first one with a batch from there on.
                let ends = (0..rings).map(|it| (it + ring) % rings).find(|it| underway[*it].is_some());
                if let Some(ring) = ends {
                    let (mut header, reports) = underway[ring].take().unwrap();
                    if crash == 1 {
                        // A process of the ring died: the report of the old attempt comes late.
                        let old = header;
                        header = sequencer.reissue(ring).unwrap().0;
                        prop_assert!(sequencer.report(ring, old, &reports).is_none());
                    }
                    let told = sequencer.report(ring, header, &reports).unwrap();
                    if crash != 2 {
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
