//! How the processes of a run wait for each other: the one place where that is decided.
//!
//! Three ways to spend the time between two looks for a message, one choice between them from cores, fleet and mode,
//! and what a process asks of the machine before it starts: a core, a real-time priority, its memory locked.

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

/// Processes of the ring: vehicle, controller, supervisor.
pub const RING: usize = 3;

/// A reader that has looked in vain for this long may go to sleep; one that has not, does not. Readers and writers
/// share the value: see [`crate::Outlet::send`].
const SLEEPS_AFTER_NS: u64 = 100_000;
/// Looks in vain before a process may sleep: on a busy core each one can take a time slice, on an idle one they
/// are over within `SLEEPS_AFTER_NS`.
const LOOKS: u32 = 64;
/// Longest sleep: bounds what a lost wake-up could cost.
const NAP: Duration = Duration::from_millis(20);

/// What a process does between two looks for a message.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Wait {
    /// Hands the core on to the next process of the ring, which shares it; sleeps after 100 µs in vain.
    #[default]
    Yield,
    /// Looks again at once, on a core of its own; sleeps after 100 µs in vain. The quickest for a fleet of one, and
    /// ruinous where processes outnumber cores.
    Spin,
    /// Sleeps at once. Burns the least, and leaves the cores to others; each message costs a wake-up.
    Block,
}

impl Wait {
    /// Each of them.
    pub const ALL: [Wait; 3] = [Wait::Yield, Wait::Spin, Wait::Block];

    /// The way for a pipeline with this many cores that no other pipeline has claimed.
    ///
    /// One core is enough where processes only ever take turns, and leaves the others to other pipelines. A
    /// core for each pays only where the hand-over is the most of a tick, with a fleet of one, and only where as many
    /// are left to everybody else. By the clock every wait is long, and ends in a sleep anyway.
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

    /// How long a reader has looked in vain when it may be asleep.
    pub(crate) fn sleeps_after_ns(self) -> u64 {
        if self == Wait::Block { 0 } else { SLEEPS_AFTER_NS }
    }

    fn looks_before_sleep(self) -> u32 {
        if self == Wait::Block { 1 } else { LOOKS }
    }

    /// Between two looks of a process that does not sleep.
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

/// A reader's waiting: counts its looks in vain, and knows when it may sleep.
///
/// Who sleeps earlier misses messages, because writers count on it: see [`crate::Outlet::send`].
#[derive(Debug, Clone, Copy, Default)]
pub struct Waiting {
    wait: Wait,
    looks_in_vain: u32,
    since_ns: u64,
    /// It has looked long enough: another look in vain, and it may sleep. So until the next message.
    is_time: bool,
}

impl Waiting {
    /// Of a process that waits this way.
    pub fn new(wait: Wait) -> Self {
        Self { wait, ..Self::default() }
    }

    /// There was a message: lets the next process have it.
    pub fn progress(&mut self) {
        self.looks_in_vain = 0;
        self.is_time = false;
        self.wait.pause();
    }

    /// Whether the last look was in vain.
    pub fn has_waited(&self) -> bool {
        self.looks_in_vain > 0
    }

    /// Notes a look in vain; whether the reader may sleep after it, else it has paused and looks again.
    pub fn may_sleep(&mut self) -> bool {
        // A look that began before it was time proves nothing: a message may have come behind it.
        if self.is_time {
            return true;
        }
        self.looks_in_vain += 1;
        if self.looks_in_vain == 1 {
            self.since_ns = now_ns();
        }
        self.is_time = self.looks_in_vain >= self.wait.looks_before_sleep()
            && now_ns() - self.since_ns >= self.wait.sleeps_after_ns();
        self.wait.pause();
        false
    }

    /// Sleeps until somebody notifies, or `due_ns` by [`now_ns`], or for 20 ms.
    pub(crate) fn sleep(bus: &Bus, alarm: &Alarm, due_ns: u64) {
        bus.look_for_readers();
        alarm.wait(NAP.min(Duration::from_nanos(due_ns.saturating_sub(now_ns()))));
    }
}

/// Puts this thread, and what it starts, under first-in-first-out scheduling.
///
/// # Errors
/// If the machine does not allow it, in words.
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

/// Keeps what this process holds now in memory: no page of it is fetched from a disk in the middle of a tick. What
/// is mapped later is left alone, because a limit reached there would end the process.
///
/// # Errors
/// If the machine does not allow it, in words.
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
    fn who_blocks_may_sleep_behind_a_second_look_and_others_only_behind_many() {
        let mut blocks = Waiting::new(Wait::Block);
        assert!(!blocks.may_sleep() && blocks.may_sleep() && blocks.may_sleep());
        for wait in [Wait::Yield, Wait::Spin] {
            let mut waiting = Waiting::new(wait);
            let began_ns = now_ns();
            // However long they took: the look behind them is still to come.
            assert!((0..LOOKS).all(|_| !waiting.may_sleep()));
            while !waiting.may_sleep() {
                assert!(now_ns() - began_ns < 1_000_000_000);
            }
            waiting.progress();
            assert!(!waiting.may_sleep());
        }
    }
}
