//! What comes on the odometry's topic: how often, how old it is, and why it is not used.

use std::collections::VecDeque;

use crate::frames::Unusable;
use crate::messages::Time;

/// A stamp so far ahead of the time of sending is of another clock: two clocks of one computer read alike.
const AHEAD_NS: i128 = 20_000_000;
/// So is one that far behind: no measurement is on its way for so long.
const BEHIND_NS: i128 = 60_000_000_000;
/// The rate is that of the last so many messages, unless the last one is older than this.
const KEPT: usize = 32;
const GONE_NS: u64 = 1_000_000_000;

/// How long before it was sent an odometry message was measured. Both times are the sender's, so that the clocks of two
/// computers need not agree. `None` if its stamp is not of the clock by which it was sent: never filled in, or of a
/// simulation. Then its age counts from its arrival.
pub fn age_ns(stamp: Time, sent: Time) -> Option<u64> {
    let age_ns = ns(sent) - ns(stamp);
    let is_sane = stamp != Time::default() && (-AHEAD_NS..=BEHIND_NS).contains(&age_ns);
    is_sane.then(|| age_ns.max(0) as u64)
}

fn ns(time: Time) -> i128 {
    i128::from(time.sec) * 1_000_000_000 + i128::from(time.nanosec)
}

/// Why odometry that comes is not used. Each reads on after "odometry on /odom comes at 50 Hz, but".
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NotUsed {
    /// It cannot be read as a message of its type.
    #[error("it cannot be read: {0}")]
    Unreadable(String),
    /// Its contents.
    #[error(transparent)]
    Unusable(#[from] Unusable),
    /// The same stamp again and again: nothing was measured since.
    #[error("its stamp stands at {}.{:09}: whoever sends it repeats itself, or its clock stands", .0.sec, .0.nanosec)]
    StampStands(Time),
    /// Measured too long before it was sent.
    #[error(
        "it was measured {age_s:.1} s before it was sent, by its stamp; vehicle.ros2.odometry_age_limit_s allows {limit_s} s"
    )]
    Old {
        /// How long before.
        age_s: f64,
        /// What is allowed.
        limit_s: f64,
    },
}

/// What has come lately.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Arrivals {
    times_ns: VecDeque<u64>,
    last: Option<NotUsed>,
}

impl Arrivals {
    /// Notes a message, and why it is not used, if so.
    pub fn note(&mut self, not_used: Option<NotUsed>, now_ns: u64) {
        if self.times_ns.len() == KEPT {
            self.times_ns.pop_front();
        }
        self.times_ns.push_back(now_ns);
        self.last = not_used;
    }

    /// How many come a second, and why the last one is not used; `None` if none comes, or it is used.
    pub fn not_used(&self, now_ns: u64) -> Option<(f64, &NotUsed)> {
        let (first, last) = (self.times_ns.front()?, self.times_ns.back()?);
        let is_coming = self.times_ns.len() > 1 && now_ns.saturating_sub(*last) < GONE_NS;
        let why = self.last.as_ref().filter(|_| is_coming)?;
        let between = (self.times_ns.len() - 1) as f64;
        Some((between / (last.saturating_sub(*first).max(1) as f64 * 1e-9), why))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    fn time(sec: i32, ms: u32) -> Time {
        Time { sec, nanosec: ms * 1_000_000 }
    }

    #[test]
    fn a_stamp_counts_where_it_is_of_the_sender_s_clock() {
        let sent = time(1_700_000_000, 500);
        for (stamp, age) in [
            (time(1_700_000_000, 480), Some(20)),
            (time(1_699_999_995, 500), Some(5000)),
            // Rounded up, or stamped by another process of the same computer.
            (time(1_700_000_000, 510), Some(0)),
            // Time of a satellite, of a simulation, none at all, an hour of another zone.
            (time(1_700_000_018, 500), None),
            (time(12, 0), None),
            (time(0, 0), None),
            (time(1_699_996_400, 500), None),
        ] {
            assert_eq!(age_ns(stamp, sent), age.map(|ms| ms * MS), "{stamp:?}");
        }
        assert_eq!(age_ns(time(i32::MIN, 0), time(i32::MAX, 999)), None);
    }

    #[test]
    fn what_comes_and_is_not_used_is_told_with_its_rate() {
        let mut arrivals = Arrivals::default();
        assert_eq!(arrivals.not_used(0), None);
        for k in 0..100 {
            arrivals.note(Some(NotUsed::StampStands(time(3, 5))), k * 20 * MS);
        }
        let now_ns = 99 * 20 * MS;
        let (rate_hz, why) = arrivals.not_used(now_ns).unwrap();
        assert!((rate_hz - 50.0).abs() < 1e-9, "{rate_hz}");
        assert!(why.to_string().starts_with("its stamp stands at 3.005000000"), "{why}");
        assert_eq!(arrivals.not_used(now_ns + 1000 * MS), None);
        arrivals.note(None, now_ns);
        assert_eq!(arrivals.not_used(now_ns), None);
    }
}
