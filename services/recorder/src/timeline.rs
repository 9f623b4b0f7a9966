//! Vehicle time laid end to end: the stamps of a recording.
//!
//! In lockstep a drive of 70 s takes a fraction of a second, and the clock says nothing about it. The time of a
//! recording is therefore that of the vehicles: tick k of an attempt is k ticks after the attempt's start, and an
//! attempt starts where the previous one has ended. Messages between ticks have the time at which they came. All
//! channels share this time (`log_time`). When a message was really sent is in its own bytes, and is also the
//! `publish_time` of our own channels.

use std::collections::BTreeMap;

use ipc_types::Attempt;

use crate::Place;

/// How many attempts' starts are remembered: messages of different topics overtake each other by no more than this.
const REMEMBERED: usize = 4;

/// Vehicle time laid end to end over the attempts of a run.
#[derive(Debug, Clone)]
pub struct Timeline {
    tick_ns: u64,
    starts: BTreeMap<Attempt, u64>,
    end_ns: u64,
}

impl Timeline {
    /// The timeline of a run whose ticks last `tick_s`, before its first tick.
    pub fn new(tick_s: f64) -> Self {
        Self { tick_ns: (tick_s * 1e9).round() as u64, starts: BTreeMap::new(), end_ns: 0 }
    }

    /// The time of a message.
    pub fn stamp(&mut self, place: Place) -> u64 {
        let Some(tick) = place.tick else { return self.end_ns };
        let end_ns = self.end_ns;
        let start_ns = *self.starts.entry(place.attempt).or_insert(end_ns);
        if self.starts.len() > REMEMBERED {
            self.starts.pop_first();
        }
        let stamp_ns = start_ns + tick * self.tick_ns;
        self.end_ns = self.end_ns.max(stamp_ns + self.tick_ns);
        stamp_ns
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn attempts_lie_end_to_end() {
        let mut timeline = Timeline::new(0.01);
        let mut stamp = |(batch, attempt), tick| {
            let attempt = Attempt { batch, attempt, ..Attempt::default() };
            timeline.stamp(Place { attempt, tick, sent_ns: 9 })
        };
        assert_eq!(stamp((0, 0), None), 0);
        assert_eq!(stamp((1, 1), Some(0)), 0);
        assert_eq!(stamp((1, 1), Some(1)), 10_000_000);
        assert_eq!(stamp((1, 2), Some(0)), 20_000_000);
        // Messages that answer the previous attempt come a little later.
        assert_eq!(stamp((1, 1), Some(1)), 10_000_000);
        assert_eq!(stamp((2, 1), Some(0)), 30_000_000);
        assert_eq!(stamp((0, 0), None), 40_000_000);
    }
}
