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
