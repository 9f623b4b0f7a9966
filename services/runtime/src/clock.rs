//! The one clock: `CLOCK_MONOTONIC`, the same in every process of the machine.

use rustix::time::{ClockId, clock_gettime};

/// As [`now_ns`], but up to a few milliseconds late, and at a fraction of the cost.
pub fn coarse_ns() -> u64 {
    let now = clock_gettime(ClockId::MonotonicCoarse);
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}

/// Nanoseconds of `CLOCK_MONOTONIC`.
pub fn now_ns() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}

/// How far the ticks of a vehicle by the clock may lie ahead of the time since its drive was requested: by so many seconds,
/// and by this share of that time, as its clock may be another one.
const AHEAD_S: f64 = 1.0;
const AHEAD_SHARE: f64 = 0.1;

/// Whether a tick of a drive by the clock lies ahead of the time that has passed since the drive was requested: tick k is
/// k ticks after the drive's first, so the number is wrong.
pub fn is_ahead(tick: u64, tick_s: f64, requested_ns: u64, now_ns: u64) -> bool {
    let passed_s = now_ns.saturating_sub(requested_ns) as f64 / 1e9;
    tick as f64 * tick_s > AHEAD_S + (1.0 + AHEAD_SHARE) * passed_s
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tick_is_ahead_if_the_time_does_not_account_for_it() {
        const S: u64 = 1_000_000_000;
        for (tick, passed_s, wanted) in
            [(0, 0, false), (99, 0, false), (101, 0, true), (6_690, 60, false), (6_710, 60, true)]
        {
            assert_eq!(is_ahead(tick, 0.01, 5 * S, (5 + passed_s) * S), wanted, "{tick}");
        }
        assert!(is_ahead(u64::MAX, 0.01, 0, S) && !is_ahead(10, 0.01, S, 0));
    }
}
