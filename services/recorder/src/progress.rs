//! What was received on each topic, and what was missed: every gap is counted.

use std::collections::BTreeMap;

use ipc_types::Attempt;
use serde::{Deserialize, Serialize};

use crate::Place;

/// How many attempts' lengths are remembered: an observer that is late may receive as many reports before their ticks.
const REMEMBERED: usize = 4096;

/// What was received and missed on one topic.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Heard {
    /// Messages that were written.
    pub messages: u64,
    /// Messages of ticks that are known to exist, but were not received.
    pub missed: u64,
}

/// How far the recorder has followed one topic that is sent once a tick.
#[derive(Debug, Default)]
pub(crate) struct TickProgress {
    attempt: Attempt,
    next_tick: u64,
    /// Attempts that this topic has finished, with the number of ticks that it had seen and the attempt that followed:
    /// they are compared with the reports of the attempts in between.
    left: Vec<(Attempt, u64, Attempt)>,
    heard: Heard,
}

impl TickProgress {
    /// How many ticks of an attempt were received.
    pub(crate) fn ticks_of(&self, attempt: Attempt) -> u64 {
        if self.attempt == attempt { self.next_tick } else { 0 }
    }

    /// Notes a message.
    pub(crate) fn note(&mut self, place: Place) {
        let tick = place.tick.unwrap_or_default();
        self.heard.messages += 1;
        if self.heard.messages == 1 {
            // A recorder that joins late has not missed what came before.
            (self.attempt, self.next_tick) = (place.attempt, tick);
        } else if place.attempt != self.attempt {
            self.left.push((self.attempt, self.next_tick, place.attempt));
            (self.attempt, self.next_tick) = (place.attempt, 0);
        }
        self.heard.missed += tick.saturating_sub(self.next_tick);
        self.next_tick = self.next_tick.max(tick + 1);
    }

    /// Compares finished attempts with what was reported.
    pub(crate) fn settle(&mut self, reported: &BTreeMap<Attempt, u64>) {
        for (attempt, ticks, next) in self.left.drain(..) {
            // An attempt without a report was broken off: its length does not matter.
            for (reported, all) in reported.range(attempt..next.max(attempt)) {
                let seen = if *reported == attempt { ticks } else { 0 };
                self.heard.missed += all.saturating_sub(seen);
            }
        }
    }

    /// What was received in all.
    pub(crate) fn heard(&self) -> &Heard {
        &self.heard
    }

    /// Finishes the last attempt, too.
    pub(crate) fn end(&mut self, reported: &BTreeMap<Attempt, u64>) {
        if self.heard.messages > 0 {
            let last = Attempt { batch: u64::MAX, ..self.attempt };
            self.left.push((self.attempt, self.next_tick, last));
        }
        self.settle(reported);
    }
}

/// The lengths of the attempts that were reported.
#[derive(Debug, Default)]
pub(crate) struct Reported(BTreeMap<Attempt, u64>);

impl Reported {
    pub(crate) fn note(&mut self, attempt: Attempt, ticks: u64) {
        self.0.insert(attempt, ticks);
        if self.0.len() > REMEMBERED {
            self.0.pop_first();
        }
    }

    pub(crate) fn all(&self) -> &BTreeMap<Attempt, u64> {
        &self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(batch: u64, attempt: u32) -> Attempt {
        Attempt { batch, attempt, ..Attempt::default() }
    }

    fn note(progress: &mut TickProgress, attempt: Attempt, ticks: std::ops::Range<u64>) {
        for tick in ticks {
            progress.note(Place { attempt, tick: Some(tick), sent_ns: 0 });
        }
    }

    #[test]
    fn gaps_are_counted_wherever_they_are() {
        let mut progress = TickProgress::default();
        let mut reported = Reported::default();
        // Late, with a hole, and without its end.
        note(&mut progress, at(1, 1), 5..7);
        note(&mut progress, at(1, 1), 9..10);
        assert_eq!(progress.heard(), &Heard { messages: 3, missed: 2 });
        reported.note(at(1, 1), 12);
        // Without its beginning.
        note(&mut progress, at(2, 1), 3..4);
        assert_eq!(progress.heard().missed, 5);
        progress.settle(reported.all());
        assert_eq!(progress.heard().missed, 7);
        // A broken attempt has no end to miss; the last one has.
        note(&mut progress, at(2, 2), 0..4);
        reported.note(at(2, 2), 4);
        assert_eq!((progress.ticks_of(at(2, 2)), progress.ticks_of(at(2, 1))), (4, 0));
        // A whole batch was missed.
        reported.note(at(3, 1), 10);
        note(&mut progress, at(4, 1), 0..1);
        progress.settle(reported.all());
        assert_eq!(progress.heard(), &Heard { messages: 9, missed: 17 });
        reported.note(at(4, 1), 3);
        progress.end(reported.all());
        assert_eq!(progress.heard().missed, 19);
    }
}
