//! Injected faults, and how long it takes until ticks flow again.

use std::collections::BTreeMap;

use outcome::{DeathToTick, Recovery};
use runtime::chaos::Spread;

/// Random kills at a given mean rate, with exponentially distributed intervals.
#[derive(Debug)]
pub(crate) struct RandomKills {
    per_s: f64,
    spread: Spread,
    due_ns: u64,
}

impl RandomKills {
    pub(crate) fn new(per_s: f64, seed: u64) -> Self {
        Self { per_s, spread: Spread::new(seed), due_ns: 0 }
    }

    /// Which of `count` processes to kill now, if any.
    pub(crate) fn due(&mut self, now_ns: u64, count: usize) -> Option<usize> {
        if self.per_s <= 0.0 {
            return None;
        }
        let due = self.due_ns != 0 && now_ns >= self.due_ns;
        if due || self.due_ns == 0 {
            let wait_s = -(1.0 - self.spread.uniform()).ln() / self.per_s;
            self.due_ns = now_ns + (wait_s * 1e9) as u64;
        }
        due.then(|| (self.spread.uniform() * count as f64) as usize)
    }

    /// When the next kill is due; `None` if no kills are asked for.
    pub(crate) fn next_ns(&self) -> Option<u64> {
        (self.per_s > 0.0).then_some(self.due_ns)
    }
}

/// Deaths and stalls of a run, and how long each stopped the flow of ticks.
#[derive(Debug, Default)]
pub(crate) struct Recoveries {
    /// Faults that the orchestrator caused itself.
    pub(crate) killed_at_random: usize,
    /// Batches that were driven again although no process had died.
    pub(crate) stalls: usize,
    /// Since when each ring has been broken, by its number.
    since_ns: BTreeMap<usize, u64>,
    times_ns: Vec<u64>,
}

impl Recoveries {
    /// Notes that something in a ring broke now, unless it was broken already.
    pub(crate) fn broken(&mut self, ring: usize, now_ns: u64) {
        self.since_ns.entry(ring).or_insert(now_ns);
    }

    /// Notes that ticks flow again in a ring.
    pub(crate) fn mended(&mut self, ring: usize, now_ns: u64) {
        if let Some(since_ns) = self.since_ns.remove(&ring) {
            self.times_ns.push(now_ns - since_ns);
        }
    }

    /// Their summary.
    pub(crate) fn sum_up(&self, scripted: usize) -> Recovery {
        let mut times_ns = self.times_ns.clone();
        times_ns.sort_unstable();
        let at = |share: f64| {
            let index = ((times_ns.len() as f64 * share).ceil() as usize).clamp(1, times_ns.len());
            times_ns[index - 1] as f64 / 1e6
        };
        let at = |share: f64| (!times_ns.is_empty()).then(|| at(share));
        Recovery {
            injected: (self.killed_at_random + scripted) as u64,
            stalls: self.stalls as u64,
            recoveries: times_ns.len() as u64,
            death_to_tick_ms: DeathToTick { p50: at(0.5), p99: at(0.99), max: at(1.0) },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn random_kills_come_at_their_rate() {
        let mut kills = RandomKills::new(10.0, 1);
        let count = (0..100_000u64).filter(|ms| kills.due(ms * 1_000_000, 4).is_some()).count();
        assert!((800..1200).contains(&count), "{count}");
        assert_eq!(RandomKills::new(0.0, 1).due(1, 4), None);
    }

    #[test]
    fn a_recovery_lasts_from_the_first_break_to_the_next_tick() {
        let mut recoveries = Recoveries::default();
        recoveries.mended(0, 5);
        recoveries.broken(0, 10_000_000);
        recoveries.broken(0, 20_000_000);
        // Another ring gets on.
        recoveries.mended(1, 25_000_000);
        recoveries.mended(0, 30_000_000);
        let recovery = recoveries.sum_up(1);
        assert_eq!((recovery.injected, recovery.recoveries), (1, 1));
        assert_eq!(recovery.death_to_tick_ms.max, Some(20.0));
        assert_eq!(Recoveries::default().sum_up(0).death_to_tick_ms.p50, None);
    }
}
