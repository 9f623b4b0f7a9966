//! Means and their intervals.

use outcome::Verdict;

/// A mean with its 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// The mean.
    pub mean: f64,
    /// Lower end of the interval.
    pub low: f64,
    /// Upper end of the interval.
    pub high: f64,
}

impl Estimate {
    /// The mean of some values, with the interval of Student's t. A single value has an interval without bounds, because it
    /// says nothing of what others would be.
    ///
    /// # Panics
    /// If there is no value.
    pub fn of(values: &[f64]) -> Self {
        let count = values.len() as f64;
        let mean = mean(values);
        if values.len() < 2 {
            return Self { mean, low: f64::NEG_INFINITY, high: f64::INFINITY };
        }
        let squares: f64 = values.iter().map(|value| (value - mean) * (value - mean)).sum();
        let half = t_975(count - 1.0) * (squares / (count - 1.0) / count).sqrt();
        Self { mean, low: mean - half, high: mean + half }
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

/// The 97.5th percentile of Student's t with so many degrees of freedom, 1 or more, to about 1e-10.
fn t_975(freedom: f64) -> f64 {
    // P(|T| > t) = I_x(ν/2, 1/2) at x = ν/(ν + t²), which falls with t.
    let beyond = |t: f64| incomplete_beta(0.5 * freedom, 0.5, freedom / (freedom + t * t));
    let (mut low, mut high) = (1.9, 13.0);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if beyond(middle) > 0.05 { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

/// The 95 % interval of a share of which `count` of `of` were seen, by Clopper and Pearson (1934): it holds the share in at
/// least so many cases, whatever it is. All of [0, 1] if nothing was seen.
pub(crate) fn clopper_pearson(count: u64, of: u64) -> (f64, f64) {
    let (k, n) = (count as f64, of as f64);
    // P(B ≥ k) at the share p is I_p(k, n − k + 1), which rises with p.
    let solve = |a: f64, b: f64, wanted: f64| {
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if incomplete_beta(a, b, middle) < wanted { low = middle } else { high = middle }
        }
        0.5 * (low + high)
    };
    let low = if count == 0 { 0.0 } else { solve(k, n - k + 1.0, 0.025) };
    let high = if count == of { 1.0 } else { solve(k + 1.0, n - k, 0.975) };
    (low, high)
}

/// The regularised incomplete beta function, by its continued fraction (Abramowitz and Stegun, 26.5.8), for x where it
/// converges fast or whose mirror image does.
fn incomplete_beta(a: f64, b: f64, x: f64) -> f64 {
    if x > (a + 1.0) / (a + b + 2.0) {
        return 1.0 - incomplete_beta(b, a, 1.0 - x);
    }
    let log_beta = libm::lgamma(a) + libm::lgamma(b) - libm::lgamma(a + b);
    let front = libm::exp(a * libm::log(x) + b * libm::log(1.0 - x) - log_beta) / a;
    // From the inside out.
    let mut fraction = 1.0;
    for m in (1..=200).rev() {
        let m = f64::from(m);
        let odd = -(a + m) * (a + b + m) * x / ((a + 2.0 * m) * (a + 2.0 * m + 1.0));
        let even = m * (b - m) * x / ((a + 2.0 * m - 1.0) * (a + 2.0 * m));
        fraction = 1.0 + even / (1.0 + odd / fraction);
    }
    let first = -(a + b) * x / (a + 1.0);
    front / (1.0 + first / fraction)
}

/// The mean of some values.
pub(crate) fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Stream;

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
    fn the_percentiles_of_student_s_t_are_those_of_the_tables() {
        for (freedom, wanted) in [
            (1.0, 12.706_205),
            (2.0, 4.302_653),
            (9.0, 2.262_157),
            (29.0, 2.045_230),
            (999.0, 1.962_341),
        ] {
            assert!((t_975(freedom) - wanted).abs() < 1e-6, "{freedom}: {}", t_975(freedom));
        }
    }

    #[test]
    fn clopper_and_pearson_s_intervals_are_those_of_the_tables() {
        for ((count, of), (low, high)) in [
            ((0, 10), (0.0, 0.308_497)),
            ((1, 20), (0.001_265, 0.248_733)),
            ((5, 10), (0.187_086, 0.812_914)),
            ((10, 10), (0.691_503, 1.0)),
            ((0, 0), (0.0, 1.0)),
        ] {
            let (of_low, of_high) = clopper_pearson(count, of);
            assert!(
                (of_low - low).abs() < 1e-5 && (of_high - high).abs() < 1e-5,
                "{count} of {of}"
            );
        }
    }

    /// How often, of so many samples, the interval of the mean holds the truth, and how often two sets that are equal are
    /// told apart with the first one better. Sums of squares are skewed as values of an objective are.
    #[test]
    fn intervals_cover_and_equals_are_rarely_called_better() {
        let (mut covered, mut better) = (0u32, 0u32);
        let mut stream = Stream::new(3, 5);
        let repetitions = 3000u32;
        let mut value = || (0..4).map(|_| stream.uniform() * stream.uniform()).sum::<f64>();
        for _ in 0..repetitions {
            let [a, b]: [Vec<f64>; 2] = std::array::from_fn(|_| (0..30).map(|_| value()).collect());
            let estimate = Estimate::of(&a);
            covered += u32::from(estimate.low <= 1.0 && 1.0 <= estimate.high);
            better += u32::from(Estimate::of_difference(&a, &b).verdict() == Verdict::Better);
        }
        // 99 % of a binomial distribution around 95 % and around 2.5 %.
        let half = |share: f64| 2.576 * (share * (1.0 - share) / f64::from(repetitions)).sqrt();
        let share = |count: u32| f64::from(count) / f64::from(repetitions);
        println!("covered {}, better {}", share(covered), share(better));
        assert!((share(covered) - 0.95).abs() < half(0.95), "{}", share(covered));
        assert!(share(better) - 0.025 < half(0.025), "{}", share(better));
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
