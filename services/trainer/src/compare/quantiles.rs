//! Quantiles and shares over the seeds of a comparison, with their 95 % intervals.

use outcome::{Quantile, Share};

/// What an interval leaves out on each side.
const OUTSIDE: f64 = 0.025;
/// The normal distribution's quantile at 1 − [`OUTSIDE`].
const Z: f64 = 1.959_963_984_540_054;

/// The quantile of some values, by nearest rank, with the interval of order statistics. Infinite values are those beyond
/// all others, and are told as none.
pub(super) fn quantile(values: &[f64], share: f64) -> Quantile {
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    let count = sorted.len();
    // With ranks from 1: the rank l leaves the quantile below it with the chance P(B < l), where B counts the values that
    // are not above the quantile.
    let (mut below, mut low, mut high) = (0.0, None, None);
    for rank in 1..=count {
        below += binomial(count, share, rank - 1);
        if below <= OUTSIDE {
            low = Some(rank);
        }
        if below >= 1.0 - OUTSIDE && high.is_none() {
            high = Some(rank);
        }
    }
    let at = |rank: usize| sorted.get(rank.wrapping_sub(1)).copied().filter(|it| it.is_finite());
    let rank = ((share * count as f64).ceil() as usize).max(1);
    Quantile { value: at(rank), low: low.and_then(at), high: high.and_then(at) }
}

/// P(B = k) for B binomially distributed.
fn binomial(count: usize, share: f64, k: usize) -> f64 {
    let log_factorial = |it: usize| libm::lgamma(it as f64 + 1.0);
    let ways = log_factorial(count) - log_factorial(k) - log_factorial(count - k);
    libm::exp(ways + k as f64 * libm::log(share) + (count - k) as f64 * libm::log(1.0 - share))
}

/// A share of `of`, with Wilson's interval.
pub(super) fn share(count: u64, of: u64) -> Share {
    let (n, p) = (of as f64, count as f64 / of as f64);
    let middle = (p + Z * Z / (2.0 * n)) / (1.0 + Z * Z / n);
    let half = Z / (1.0 + Z * Z / n) * (p * (1.0 - p) / n + Z * Z / (4.0 * n * n)).sqrt();
    let (low, high) = ((middle - half).max(0.0), (middle + half).min(1.0));
    Share { count, share: p, low, high }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_are_those_of_the_tables() {
        // Of 20 values the median lies between the 6th and the 15th with 95.9 % (tables of order statistics).
        let values: Vec<f64> = (1..=20).map(f64::from).collect();
        let median = quantile(&values, 0.5);
        assert_eq!(median, Quantile { value: Some(10.0), low: Some(6.0), high: Some(15.0) });
        // Of so few values no upper bound of the 95th percentile is known.
        assert_eq!(quantile(&values, 0.95).high, None);
        // Wilson's interval of 8 of 10: 0.490 to 0.943.
        let it = share(8, 10);
        assert!((it.low - 0.4902).abs() < 1e-4 && (it.high - 0.9433).abs() < 1e-4, "{it:?}");
        assert!((share(10, 10).low - 0.7225).abs() < 1e-4 && share(10, 10).high > 0.9999);
    }

    #[test]
    fn what_lies_beyond_the_budget_is_told_as_none() {
        let mut values = vec![f64::INFINITY; 30];
        values.extend((0..70).map(f64::from));
        assert_eq!(quantile(&values, 0.5).value, Some(49.0));
        assert_eq!(quantile(&values, 0.95).value, None);
    }
}
