//! The stamps of a recording.
//!
//! In lockstep a drive of 70 s takes a fraction of a second, and the clock says nothing about it. The time of such a
//! recording is therefore that of the vehicles, laid end to end: tick k of an attempt is k ticks after the attempt's
//! start, and an attempt starts where the previous one has ended. Messages between ticks have the time at which they
//! came.
//!
//! A drive by the clock has the time of the wall clock, so that its recording lines up with the car's own.
//!
//! All channels share this time (`log_time`). When a message was really sent is in its own bytes, by the clock of the
//! run's processes, and is also the `publish_time` of our own channels, by the wall clock.

use std::collections::BTreeMap;
use std::time::{SystemTime, UNIX_EPOCH};

use ipc_types::Attempt;
use runtime::clock::now_ns;

use crate::Place;

/// How many attempts' starts are remembered: messages of different topics overtake each other by no more than this.
const REMEMBERED: usize = 4;

/// The wall clock beside the clock of the run's processes.
#[derive(Debug, Clone, Copy)]
pub struct WallClock {
    /// Time of the wall clock, since 1970, at 0 of the processes' clock.
    pub origin_ns: u64,
}

impl WallClock {
    /// As both clocks read now; that of the wall may be set anew later.
    pub fn now() -> Self {
        let wall_ns = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_nanos();
        Self { origin_ns: (wall_ns as u64).saturating_sub(now_ns()) }
    }

    /// Nanoseconds since 1970 at a time of the processes' clock.
    pub fn unix_ns(self, at_ns: u64) -> u64 {
        // The tools of ROS 2 take stamps for signed numbers.
        self.origin_ns.saturating_add(at_ns).min(i64::MAX as u64)
    }
}

/// The stamps of a run's messages.
#[derive(Debug, Clone)]
pub struct Timeline {
    tick_ns: u64,
    wall: WallClock,
    /// The vehicle paces by the clock.
    by_the_clock: bool,
    starts: BTreeMap<Attempt, u64>,
    end_ns: u64,
}

impl Timeline {
    /// The timeline of a run whose ticks last `tick_s`, before its first tick. `by_the_clock`: it is to be driven in real
    /// time.
    pub fn new(tick_s: f64, wall: WallClock, by_the_clock: bool) -> Self {
        let tick_ns = (tick_s * 1e9).round() as u64;
        Self { tick_ns, wall, by_the_clock, starts: BTreeMap::new(), end_ns: 0 }
    }

    /// The vehicle paces by the clock, or does not, from the next message on.
    pub fn pace(&mut self, by_the_clock: bool) {
        self.by_the_clock = by_the_clock;
    }

    /// The time of a message.
    pub fn stamp(&mut self, place: Place) -> u64 {
        if self.by_the_clock {
            return self.wall.unix_ns(place.sent_ns);
        }
        let Some(tick) = place.tick else { return self.end_ns };
        let end_ns = self.end_ns;
        let start_ns = *self.starts.entry(place.attempt).or_insert(end_ns);
        if self.starts.len() > REMEMBERED {
            self.starts.pop_first();
        }
        let stamp_ns =
            start_ns.saturating_add(tick.saturating_mul(self.tick_ns)).min(i64::MAX as u64);
        self.end_ns = self.end_ns.max(stamp_ns + self.tick_ns);
        stamp_ns
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn attempts_lie_end_to_end() {
        let mut timeline = Timeline::new(0.01, WallClock { origin_ns: 1 }, false);
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

    #[test]
    fn by_the_clock_a_message_has_the_wall_clock_s_time() {
        let wall = WallClock::now();
        let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).unwrap();
        let apart_ns = since_1970.as_nanos().abs_diff(u128::from(wall.unix_ns(now_ns())));
        assert!(apart_ns < 1_000_000_000, "{apart_ns}");
        let mut timeline = Timeline::new(0.01, WallClock { origin_ns: 1_000 }, true);
        let mut stamp = |tick, sent_ns| timeline.stamp(Place { tick, sent_ns, ..Place::default() });
        assert_eq!((stamp(Some(3), 70), stamp(None, 71)), (1_070, 1_071));
        assert_eq!(stamp(None, u64::MAX), i64::MAX as u64);
    }
}
