//! How the processes of a run wait for each other: this is the only place where that is decided.
//!
//! It has the three ways to spend the time between two looks for a message, the choice between them by cores, fleet and
//! mode, and what a process requests of the machine before it starts: a core, a real-time priority, and locked memory.

use std::str::FromStr;
use std::thread::yield_now;
use std::time::Duration;

use rustix::mm::{MlockAllFlags, mlockall};
use thread_priority::unix::{
    RealtimeThreadSchedulePolicy, ThreadSchedulePolicy, set_thread_priority_and_policy,
    thread_native_id,
};
use thread_priority::{ThreadPriority, ThreadPriorityValue};

use crate::Bus;
use crate::bus::Alarm;
use crate::clock::now_ns;

/// Number of processes in the ring: vehicle, controller, supervisor.
pub const RING: usize = 3;

/// A reader may go to sleep only if it has found no message for this long. Readers and writers
/// share the value: see [`crate::Outlet::send`].
const SLEEPS_AFTER_NS: u64 = 100_000;
/// Number of looks without a message before a process may sleep: on a busy core each look can take a time slice, on an
/// idle core all of them are over within `SLEEPS_AFTER_NS`.
const LOOKS: u32 = 64;
/// Others keep the core busy if the looks take this long: then sleeping costs less than yielding, because who yields gives
/// each of them a time slice, while who is woken comes first.
const CROWDED_AFTER_NS: u64 = 1_000_000;
/// Longest sleep: bounds what a lost wake-up could cost.
const NAP: Duration = Duration::from_millis(20);

/// What a process does between two looks for a message.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Wait {
    /// Yields the core to the next process of the ring, which shares it; sleeps after 100 µs without a message.
    #[default]
    Yield,
    /// Looks again at once, on a core of its own; sleeps after 100 µs without a message. The fastest way for a fleet of
    /// one, and ruinous if processes outnumber cores.
    Spin,
    /// Sleeps at once. Uses the least processor time, and leaves the cores to others; each message costs a wake-up.
    Block,
}

impl Wait {
    /// All ways of waiting.
    pub const ALL: [Wait; 3] = [Wait::Yield, Wait::Spin, Wait::Block];

    /// The way to wait for a pipeline for which this many cores are unclaimed.
    ///
    /// One core is enough, because the processes only take turns; it leaves the others to other pipelines. A
    /// core for each process pays only with a fleet of one, where the hand-over is the largest part of a tick, and only
    /// if as many cores are left for everything else. By the clock every wait is long, and ends in a sleep anyway.
    pub fn choose(cores: usize, fleet: usize, realtime: bool) -> Self {
        let has_cores = cores >= 2 * RING;
        if has_cores && fleet == 1 && !realtime { Wait::Spin } else { Wait::Yield }
    }

    /// Its name in options and files.
    pub fn name(self) -> &'static str {
        match self {
            Wait::Yield => "yield",
            Wait::Spin => "spin",
            Wait::Block => "block",
        }
    }

    /// After how long without a message a reader may be asleep.
    pub(crate) fn sleeps_after_ns(self) -> u64 {
        if self == Wait::Block { 0 } else { SLEEPS_AFTER_NS }
    }

    fn looks_before_sleep(self) -> u32 {
        if self == Wait::Block { 1 } else { LOOKS }
    }

    /// What a process that does not sleep does between two looks.
    pub(crate) fn pause(self) {
        match self {
            Wait::Yield => yield_now(),
            Wait::Spin => std::hint::spin_loop(),
            Wait::Block => {}
        }
    }
}

impl FromStr for Wait {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = Wait::ALL.into_iter().find(|wait| wait.name() == text);
        found.ok_or_else(|| format!("{text:?} is none of yield, spin and block"))
    }
}

/// The waiting of a reader: counts its looks without a message, and decides when it may sleep.
///
/// A reader that sleeps earlier misses messages, because writers rely on this: see [`crate::Outlet::send`].
#[derive(Debug, Clone, Copy, Default)]
pub struct Waiting {
    wait: Wait,
    looks_in_vain: u32,
    since_ns: u64,
    /// The reader has looked long enough: after one more look without a message it may sleep. Stays set until the next
    /// message.
    is_time: bool,
}

impl Waiting {
    /// For a process that waits in this way.
    pub fn new(wait: Wait) -> Self {
        Self { wait, ..Self::default() }
    }

    /// There was a message: lets the next process run.
    pub fn progress(&mut self) {
        self.looks_in_vain = 0;
        self.is_time = false;
        self.wait.pause();
    }

    /// Whether the last look found nothing.
    pub fn has_waited(&self) -> bool {
        self.looks_in_vain > 0
    }

    /// Notes a look that found nothing. Returns whether the reader may sleep now; if not, this has paused, and it must
    /// look again.
    pub fn may_sleep(&mut self) -> bool {
        // A look that began before it was time proves nothing: a message may have come after it.
        if self.is_time {
            return true;
        }
        self.looks_in_vain += 1;
        if self.looks_in_vain == 1 {
            self.since_ns = now_ns();
        }
        let waited_ns = now_ns() - self.since_ns;
        let has_looked = self.looks_in_vain >= self.wait.looks_before_sleep();
        self.is_time = waited_ns >= self.wait.sleeps_after_ns()
            && (has_looked || waited_ns >= CROWDED_AFTER_NS);
        self.wait.pause();
        false
    }

    /// Sleeps until another process notifies, until `due_ns` by [`now_ns`], or for 20 ms.
    pub(crate) fn sleep(bus: &Bus, alarm: &Alarm, due_ns: u64) {
        bus.look_for_readers();
        alarm.wait(NAP.min(Duration::from_nanos(due_ns.saturating_sub(now_ns()))));
    }
}

/// Puts this thread, and the threads that it starts, under first-in-first-out scheduling.
///
/// # Errors
/// If the machine does not allow it; the error says why.
pub fn use_fifo(priority: u8) -> Result<(), String> {
    let refused = |error: thread_priority::Error| match error {
        thread_priority::Error::OS(code) => std::io::Error::from_raw_os_error(code).to_string(),
        other => format!("{other:?}"),
    };
    let value = ThreadPriorityValue::try_from(priority).map_err(|why| why.to_string())?;
    let policy = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
    set_thread_priority_and_policy(thread_native_id(), ThreadPriority::Crossplatform(value), policy)
        .map_err(refused)
}

/// Locks in memory what this process has mapped now, so that no page is fetched from a disk in the middle of a tick.
/// What is mapped later is not locked, because reaching a limit then would end the process.
///
/// # Errors
/// If the machine does not allow it; the error says why.
pub fn lock_memory() -> Result<(), String> {
    mlockall(MlockAllFlags::CURRENT).map_err(|error| error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spins_only_with_a_core_for_each_and_as_many_to_spare() {
        for cores in 0..16 {
            for (fleet, realtime) in [(1, false), (16, false), (1, true)] {
                let spins = Wait::choose(cores, fleet, realtime) == Wait::Spin;
                assert_eq!(spins, cores >= 6 && fleet == 1 && !realtime);
            }
        }
    }

    #[test]
    fn names_are_read_back() {
        for wait in Wait::ALL {
            assert_eq!(wait.name().parse(), Ok(wait));
        }
        assert!("sleep".parse::<Wait>().is_err());
    }

    #[test]
    fn who_blocks_may_sleep_after_a_second_look_and_others_after_many_or_slow_ones() {
        let mut blocks = Waiting::new(Wait::Block);
        assert!(!blocks.may_sleep() && blocks.may_sleep() && blocks.may_sleep());
        for wait in [Wait::Yield, Wait::Spin] {
            let mut waiting = Waiting::new(wait);
            let began_ns = now_ns();
            let mut looks = 1;
            while !waiting.may_sleep() {
                looks += 1;
                assert!(now_ns() - began_ns < 1_000_000_000);
            }
            let waited_ns = now_ns() - began_ns;
            // However long the looks took, one more was made after it was time.
            assert!(looks >= 2 && waited_ns >= SLEEPS_AFTER_NS);
            assert!(
                looks > LOOKS || waited_ns >= CROWDED_AFTER_NS,
                "{looks} looks in {waited_ns} ns"
            );
            waiting.progress();
            assert!(!waiting.may_sleep());
        }
    }
}
