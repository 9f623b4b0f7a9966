//! Whether and when a dead process is started again.
//!
//! Pure: time is an argument. After a first death the process is restarted at once; after further ones it waits longer
//! each time, until it works again. Too many deaths in a short time end the run: a process that dies at every start will
//! not get better by waiting. Deaths before the run has got on are no reason to give up: it will get on again.

use std::collections::VecDeque;
use std::time::Duration;

/// How many deaths are tolerated in which time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Budget {
    /// Deaths that are answered with a restart.
    pub restarts: u32,
    /// Time in which they may happen.
    pub within: Duration,
}

impl Default for Budget {
    /// Five in ten seconds, as in systemd.
    fn default() -> Self {
        Self { restarts: 5, within: Duration::from_secs(10) }
    }
}

/// What to do about a death.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Decision {
    /// Start it again after this time.
    Restart(Duration),
    /// End the run.
    GiveUp,
}

/// Longest wait before a restart.
const LONGEST_WAIT: Duration = Duration::from_secs(2);
/// Wait before the second restart in a row.
const FIRST_WAIT: Duration = Duration::from_millis(50);

/// Decides for one process.
#[derive(Debug, Clone)]
pub struct RestartPolicy {
    budget: Budget,
    deaths_ns: VecDeque<u64>,
    in_a_row: u32,
}

impl RestartPolicy {
    /// A policy that has seen no death yet.
    pub fn new(budget: Budget) -> Self {
        Self { budget, deaths_ns: VecDeque::new(), in_a_row: 0 }
    }

    /// The process has died. `jitter` in [0, 1) spreads the restarts of processes that die together.
    pub fn died(&mut self, now_ns: u64, jitter: f64) -> Decision {
        let oldest_ns = now_ns.saturating_sub(self.budget.within.as_nanos() as u64);
        self.deaths_ns.retain(|death_ns| *death_ns >= oldest_ns);
        self.deaths_ns.push_back(now_ns);
        self.in_a_row += 1;
        // Deaths that come slowly, for example after a deadline, are just as bad if nothing works in between.
        if self.deaths_ns.len().max(self.in_a_row as usize) > self.budget.restarts as usize {
            return Decision::GiveUp;
        }
        if self.in_a_row == 1 {
            return Decision::Restart(Duration::ZERO);
        }
        let wait = FIRST_WAIT * 2u32.saturating_pow(self.in_a_row - 2);
        Decision::Restart(wait.min(LONGEST_WAIT).mul_f64(1.0 + 0.5 * jitter))
    }

    /// Notes that the process works.
    pub fn works(&mut self) {
        self.in_a_row = 0;
    }

    /// Notes that a batch has finished: the run gets on, however often the process dies.
    pub fn gets_on(&mut self) {
        self.works();
        self.deaths_ns.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: u64 = 1_000_000_000;

    #[test]
    fn the_first_restart_is_at_once_and_the_next_ones_wait_longer() {
        let mut policy = RestartPolicy::new(Budget::default());
        let waits: Vec<_> = (0..5)
            .map(|death| match policy.died(death * SECOND, 0.0) {
                Decision::Restart(wait) => wait.as_millis(),
                Decision::GiveUp => panic!("within the budget"),
            })
            .collect();
        assert_eq!(waits, [0, 50, 100, 200, 400]);
        policy.works();
        assert_eq!(policy.died(100 * SECOND, 0.9), Decision::Restart(Duration::ZERO));
    }

    #[test]
    fn the_budget_is_five_in_ten_seconds() {
        let mut policy = RestartPolicy::new(Budget::default());
        for death in 0..5 {
            policy.works();
            assert_ne!(policy.died(death, 0.5), Decision::GiveUp);
        }
        assert_eq!(policy.died(SECOND, 0.5), Decision::GiveUp);
        let mut slow = RestartPolicy::new(Budget::default());
        for death in 0..100 {
            slow.works();
            assert_ne!(slow.died(death * SECOND * 5 / 2, 0.5), Decision::GiveUp);
        }
    }

    #[test]
    fn a_run_that_gets_on_is_not_given_up() {
        let mut policy = RestartPolicy::new(Budget::default());
        for death in 0..100 {
            assert_ne!(policy.died(death, 0.5), Decision::GiveUp);
            if death % 4 == 3 {
                policy.gets_on();
            }
        }
        for death in 100..105 {
            assert_ne!(policy.died(death, 0.5), Decision::GiveUp);
        }
        assert_eq!(policy.died(105, 0.5), Decision::GiveUp);
    }

    #[test]
    fn slow_deaths_count_too_if_nothing_works_between_them() {
        let mut policy = RestartPolicy::new(Budget::default());
        for death in 0..5 {
            assert_ne!(policy.died(death * 60 * SECOND, 0.5), Decision::GiveUp);
        }
        assert_eq!(policy.died(300 * SECOND, 0.5), Decision::GiveUp);
    }

    #[test]
    fn jitter_only_adds() {
        let mut policy = RestartPolicy::new(Budget::default());
        policy.died(0, 0.0);
        assert_eq!(policy.died(1, 0.5), Decision::Restart(Duration::from_micros(62_500)));
    }
}
