//! How far a vehicle in lockstep may run ahead of its recorders.

use crate::{Credit, DriveRequest, has};

/// The ticks of a batch that its recorders allow to be published: unlimited, unless the batch is recorded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Allowance([(u32, u64); 2]);

impl Allowance {
    /// The allowance at the start of a batch with these requests.
    ///
    /// A recorder of single drives asks for the next drive only when it has the last one. A recorder of the whole run
    /// may still be busy with the previous batch, so tick 0 waits for its first credit.
    pub fn new(requests: &[DriveRequest]) -> Self {
        let flags = requests.iter().fold(0, |flags, request| flags | request.flags);
        let of = |source, ahead| (source, if has(flags, source) { ahead } else { u64::MAX });
        Self([of(DriveRequest::RECORDED, Credit::AHEAD), of(DriveRequest::LOGGED, 0)])
    }

    /// Whether a tick may be published.
    pub fn allows(&self, tick: u64) -> bool {
        self.0.iter().all(|(_, allowed)| tick < *allowed)
    }

    /// Takes a credit of this batch and attempt.
    pub fn grant(&mut self, credit: Credit) {
        for (source, allowed) in &mut self.0 {
            if *source == credit.source {
                *allowed = (*allowed).max(credit.ticks.saturating_add(Credit::AHEAD));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_recorder_allows_for_itself() {
        let of = |flags| Allowance::new(&[DriveRequest { flags, ..DriveRequest::default() }]);
        assert!(of(0).allows(u64::MAX - 1));
        let recorded = of(DriveRequest::RECORDED);
        assert!(recorded.allows(Credit::AHEAD - 1) && !recorded.allows(Credit::AHEAD));
        let mut both = of(DriveRequest::RECORDED | DriveRequest::LOGGED);
        assert!(!both.allows(0));
        let credit = |source, ticks| Credit { ticks, source, ..Credit::default() };
        both.grant(credit(DriveRequest::LOGGED, 0));
        assert!(both.allows(Credit::AHEAD - 1) && !both.allows(Credit::AHEAD));
        both.grant(credit(DriveRequest::LOGGED, 100));
        assert!(!both.allows(Credit::AHEAD));
        both.grant(credit(DriveRequest::RECORDED, 50));
        assert!(both.allows(Credit::AHEAD + 49) && !both.allows(Credit::AHEAD + 50));
        // What was allowed once is not revoked.
        both.grant(credit(DriveRequest::RECORDED, 1));
        assert!(both.allows(Credit::AHEAD + 49));
    }
}
