//! What was received on each topic, and which ticks were not there: every gap is counted.

use std::collections::BTreeMap;

use ipc_types::Attempt;
use ipc_types::topics::OBSERVER_BUFFER;
use outcome::TopicCounts;

use crate::Place;

/// How many attempts' lengths are remembered: an observer that is late may receive as many reports before their ticks.
const REMEMBERED: usize = 4096;

/// Whether messages of one topic can have been lost, because they came faster than they were taken.
///
/// The buffer drops its oldest message when another one comes while it is full. All that it held at that time is taken
/// afterwards. So if fewer messages than it holds are taken from one time that it is empty to the next, none was lost in
/// between.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Overflow {
    since_empty: usize,
    has_happened: bool,
}

impl Overflow {
    /// A message was taken.
    pub(crate) fn took(&mut self) {
        self.since_empty += 1;
        self.has_happened |= self.since_empty >= OBSERVER_BUFFER;
    }

    /// The buffer was empty.
    pub(crate) fn was_empty(&mut self) {
        self.since_empty = 0;
    }

    /// What was received, if `absent` ticks of the topic were not there: without an overflow, nobody sent them.
    pub(crate) fn counts(self, messages: u64, absent: u64) -> TopicCounts {
        if self.has_happened {
            TopicCounts { messages, missed: absent, unsent: 0 }
        } else {
            TopicCounts { messages, missed: 0, unsent: absent }
        }
    }
}

/// How far the recorder has followed one topic that is sent once a tick.
#[derive(Debug, Default)]
pub(crate) struct TickProgress {
    attempt: Attempt,
    next_tick: u64,
    /// Attempts that this topic has finished, with the number of ticks that it had seen and the attempt that followed:
    /// they are compared with the reports of the attempts in between.
    left: Vec<(Attempt, u64, Attempt)>,
    /// Messages that were received.
    pub(crate) messages: u64,
    /// Ticks that are known to have been driven, but whose messages were not there.
    pub(crate) absent: u64,
}

/// No recorder misses so many ticks in a row: hours.
const LONGEST_GAP: u64 = 10_000_000;

impl TickProgress {
    /// How many ticks of an attempt were received.
    pub(crate) fn ticks_of(&self, attempt: Attempt) -> u64 {
        if self.attempt == attempt { self.next_tick } else { 0 }
    }

    /// Notes a message.
    pub(crate) fn note(&mut self, place: Place) {
        let tick = place.tick.unwrap_or_default();
        self.messages += 1;
        if self.messages == 1 {
            // A recorder that joins late has not missed what came before.
            (self.attempt, self.next_tick) = (place.attempt, tick);
        } else if place.attempt != self.attempt {
            self.left.push((self.attempt, self.next_tick, place.attempt));
            (self.attempt, self.next_tick) = (place.attempt, 0);
        }
        if tick.saturating_sub(self.next_tick) > LONGEST_GAP {
            // The tick itself is wrong.
            return;
        }
        self.absent += tick.saturating_sub(self.next_tick);
        self.next_tick = self.next_tick.max(tick.saturating_add(1));
    }

    /// Compares finished attempts with what was reported.
    pub(crate) fn settle(&mut self, reported: &BTreeMap<Attempt, u64>) {
        for (attempt, ticks, next) in self.left.drain(..) {
            // An attempt without a report was broken off: its length does not matter.
            for (reported, all) in reported.range(attempt..next.max(attempt)) {
                let seen = if *reported == attempt { ticks } else { 0 };
                self.absent += all.saturating_sub(seen);
            }
        }
    }

    /// Finishes the last attempt, too.
    pub(crate) fn end(&mut self, reported: &BTreeMap<Attempt, u64>) {
        if self.messages > 0 {
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
        assert_eq!((progress.messages, progress.absent), (3, 2));
        reported.note(at(1, 1), 12);
        // Without its beginning.
        note(&mut progress, at(2, 1), 3..4);
        assert_eq!(progress.absent, 5);
        progress.settle(reported.all());
        assert_eq!(progress.absent, 7);
        // A broken attempt has no end to miss; the last one has.
        note(&mut progress, at(2, 2), 0..4);
        reported.note(at(2, 2), 4);
        assert_eq!((progress.ticks_of(at(2, 2)), progress.ticks_of(at(2, 1))), (4, 0));
        // A whole batch was missed.
        reported.note(at(3, 1), 10);
        note(&mut progress, at(4, 1), 0..1);
        progress.settle(reported.all());
        assert_eq!((progress.messages, progress.absent), (9, 17));
        reported.note(at(4, 1), 3);
        progress.end(reported.all());
        assert_eq!(progress.absent, 19);
    }
    #[test]
    fn ticks_that_are_not_there_are_lost_only_if_the_buffer_can_have_been_full() {
        let mut overflow = Overflow::default();
        for _ in 0..3 {
            (1..OBSERVER_BUFFER).for_each(|_| overflow.took());
            overflow.was_empty();
        }
        assert_eq!(overflow.counts(9, 2), TopicCounts { messages: 9, missed: 0, unsent: 2 });
        (0..OBSERVER_BUFFER).for_each(|_| overflow.took());
        overflow.was_empty();
        assert_eq!(overflow.counts(9, 2), TopicCounts { messages: 9, missed: 2, unsent: 0 });
    }
}
