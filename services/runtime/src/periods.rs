//! How long the ticks of a ring take, as its first process sees them: for benchmarks.

use std::path::PathBuf;

use hdrhistogram::Histogram;

/// Names a file into which the vehicle's process writes the times of its ticks when it ends.
pub const FILE_VARIABLE: &str = "PATHTUNE_TICK_TIMES";

/// Spans between consecutive ticks.
#[derive(Debug)]
pub struct Periods {
    histogram: Histogram<u64>,
    first_ns: Option<u64>,
    last_ns: u64,
}

impl Default for Periods {
    fn default() -> Self {
        // Three digits: no two runs agree to a thousandth.
        let histogram = Histogram::new_with_bounds(1, 1_000_000_000, 3).expect("bounds in order");
        Self { histogram, first_ns: None, last_ns: 0 }
    }
}

impl Periods {
    /// Notes a tick at this time.
    pub fn note(&mut self, now_ns: u64) {
        match self.first_ns {
            None => self.first_ns = Some(now_ns),
            Some(_) => self.histogram.saturating_record(now_ns - self.last_ns),
        }
        self.last_ns = now_ns;
    }

    /// Nanoseconds per tick: mean, median and 99th percentile, separated by spaces.
    pub fn summary(&self) -> String {
        let spans = self.histogram.len().max(1);
        let mean_ns = (self.last_ns - self.first_ns.unwrap_or(self.last_ns)) as f64 / spans as f64;
        let at = |quantile| self.histogram.value_at_quantile(quantile);
        format!("{mean_ns} {} {}", at(0.5), at(0.99))
    }
}

/// The periods of a service that is being measured.
#[derive(Debug)]
pub(crate) struct Measured {
    file: PathBuf,
    /// Batch and tick that were seen last.
    seen: (u64, u64),
    periods: Periods,
}

impl Measured {
    /// `None` unless the environment asks for it.
    pub(crate) fn from_env() -> Option<Self> {
        let file = std::env::var_os(FILE_VARIABLE)?.into();
        Some(Self { file, seen: (0, 0), periods: Periods::default() })
    }

    pub(crate) fn note(&mut self, seen: (u64, u64), now_ns: u64) {
        if std::mem::replace(&mut self.seen, seen) != seen {
            self.periods.note(now_ns);
        }
    }
}

impl Drop for Measured {
    fn drop(&mut self) {
        let _ = std::fs::write(&self.file, self.periods.summary());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_span_is_from_one_tick_to_the_next() {
        let mut periods = Periods::default();
        assert_eq!(periods.summary(), "0 0 0");
        for now_ns in [1000, 1010, 1020, 1050] {
            periods.note(now_ns);
        }
        let numbers: Vec<f64> =
            periods.summary().split(' ').map(|number| number.parse().unwrap()).collect();
        assert_eq!(numbers, [50.0 / 3.0, 10.0, 30.0]);
    }
}
