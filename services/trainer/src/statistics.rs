//! Means and their intervals.

use outcome::Verdict;

use crate::rng::Stream;

/// A mean with its 95 % bootstrap interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// The mean.
    pub mean: f64,
    /// Lower end of the interval.
    pub low: f64,
    /// Upper end of the interval.
    pub high: f64,
}

/// Number of resamples of a bootstrap: with these, the interval's ends are accurate to about a tenth of its width.
const RESAMPLES: usize = 10_000;

impl Estimate {
    /// The mean of some values, with the percentile bootstrap's interval. The same values give the same
    /// interval: the resampling draws from a stream of its own.
    ///
    /// # Panics
    /// If there is no value.
    pub fn of(values: &[f64]) -> Self {
        let count = values.len();
        let mean = mean(values);
        let mut stream = Stream::new(count as u64, u64::MAX);
        let mut means: Vec<f64> = (0..RESAMPLES)
            .map(|_| (0..count).map(|_| values[stream.below(count)]).sum::<f64>() / count as f64)
            .collect();
        means.sort_unstable_by(f64::total_cmp);
        let at = |share: f64| means[(share * (RESAMPLES - 1) as f64).round() as usize];
        Self { mean, low: at(0.025), high: at(0.975) }
    }

    /// The mean of paired differences `a − b`, with its interval.
    ///
    /// # Panics
    /// If there are no pairs.
    pub fn of_difference(a: &[f64], b: &[f64]) -> Self {
        let differences: Vec<f64> = a.iter().zip(b).map(|(a, b)| a - b).collect();
        Self::of(&differences)
    }

    /// What a difference of costs says about the first one: better or worse only if the interval excludes 0.
    pub fn verdict(&self) -> Verdict {
        if self.high < 0.0 {
            Verdict::Better
        } else if self.low > 0.0 {
            Verdict::Worse
        } else {
            Verdict::Undecided
        }
    }
}

/// The mean of some values.
pub(crate) fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_interval_has_the_width_that_theory_gives() {
        // Of n values with standard deviation s, the interval of the mean is about ± 1.96 s/√n.
        let mut stream = Stream::new(7, 7);
        let values: Vec<f64> =
            (0..400).map(|_| (0..12).map(|_| stream.uniform()).sum::<f64>() - 6.0).collect();
        let estimate = Estimate::of(&values);
        let half = (estimate.high - estimate.low) / 2.0;
        assert!((half - 1.96 / 20.0).abs() < 0.015, "{half}");
        assert!(estimate.low < estimate.mean && estimate.mean < estimate.high);
        assert_eq!(estimate, Estimate::of(&values));
    }

    #[test]
    fn only_a_clear_difference_is_called_one() {
        let noisy = [1.0, 3.0, 2.0, 0.5, 2.5, 1.5, 2.2, 0.8];
        let better: Vec<f64> = noisy.iter().map(|value| value - 0.1).collect();
        assert_eq!(Estimate::of_difference(&better, &noisy).verdict(), Verdict::Better);
        assert_eq!(Estimate::of_difference(&noisy, &better).verdict(), Verdict::Worse);
        let other = [3.0, 1.0, 0.6, 2.0, 1.4, 2.6, 0.9, 2.1];
        assert_eq!(Estimate::of_difference(&other, &noisy).verdict(), Verdict::Undecided);
        assert_eq!(Estimate::of_difference(&noisy, &noisy).verdict(), Verdict::Undecided);
    }
}
