//! The rank of the threshold among the scores of n drives, so that the rate of false alarms is bounded with a stated
//! probability: order statistics after S. S. Wilks (1941), today called PAC.
//!
//! With the (r+1)-th largest score as threshold, P(rate > α) = P(Bin(n, α) ≤ r), whatever the scores' distribution. The
//! plain conformal rank ⌈(n+1)(1−α)⌉ bounds the rate only on average over calibrations: about half of them exceed it.

/// The largest r with P(Bin(n, α) ≤ r) ≤ δ; `None` if even r = 0 is too large: n drives are too few.
pub fn rank(drives: u64, alpha: f64, delta: f64) -> Option<u64> {
    // Sums of probabilities by their logarithms: the first ones may be too small for a number.
    let (log_hit, log_miss) = (libm::log(alpha), libm::log1p(-alpha));
    let log_delta = libm::log(delta);
    let mut log_term = drives as f64 * log_miss;
    let mut log_sum = log_term;
    let mut found = None;
    let mut hits = 0;
    while log_sum <= log_delta && hits < drives {
        found = Some(hits);
        log_term += libm::log((drives - hits) as f64 / (hits + 1) as f64) + log_hit - log_miss;
        hits += 1;
        let (high, low) = (log_sum.max(log_term), log_sum.min(log_term));
        log_sum = high + libm::log1p(libm::exp(low - high));
    }
    found
}

/// The share of false alarms that n drives support with the largest score as threshold: 1 − δ^(1/n).
pub fn supported_share(drives: u64, delta: f64) -> f64 {
    -libm::expm1(libm::log(delta) / drives as f64)
}

/// What some drives can promise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Guarantee {
    /// The share of false alarms is at most this …
    pub alpha: f64,
    /// … but for this probability.
    pub delta: f64,
    /// How many of the drives have a score above the threshold.
    pub above: u64,
}

impl Guarantee {
    /// What to promise without being asked.
    const USUAL: f64 = 0.01;
    /// The probability with which few drives promise what they can.
    const FEW: f64 = 0.05;

    /// What so many drives can promise: a share of 1 % with a probability of 99 %, if they are enough; otherwise the share
    /// that they support with 95 %. `None` without a drive.
    pub fn of(drives: u64) -> Option<Self> {
        if let Some(above) = rank(drives, Self::USUAL, Self::USUAL) {
            return Some(Self { alpha: Self::USUAL, delta: Self::USUAL, above });
        }
        let alpha = supported_share(drives, Self::FEW);
        (drives > 0).then_some(Self { alpha, delta: Self::FEW, above: 0 })
    }

    /// The threshold among these scores, ascending: the (r+1)-th largest.
    pub fn threshold(&self, scores: &[f64]) -> f64 {
        scores[scores.len() - 1 - self.above as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rank_is_that_of_the_table() {
        let table = [(458, None), (459, Some(0)), (1000, Some(2)), (2000, Some(9))];
        for (drives, expected) in table {
            assert_eq!(rank(drives, 0.01, 0.01), expected, "{drives}");
        }
    }

    #[test]
    fn a_rank_agrees_with_the_sum_of_exact_fractions() {
        // P(Bin(10, 1/2) ≤ r) = 1, 11, 56, 176, 386, … of 1024.
        for (delta, expected) in
            [(0.5, None), (1.5, Some(0)), (11.5, Some(1)), (55.9, Some(1)), (56.1, Some(2))]
        {
            assert_eq!(rank(10, 0.5, delta / 1024.0), expected, "{delta}");
        }
        // Where the probabilities are too small for a number of this size, too.
        assert!(rank(1_000_000, 0.01, 0.01).is_some_and(|it| (9_760..9_780).contains(&it)));
    }

    /// A permutation of the first `count` numbers, by the multiplicative generator of D. H. Lehmer.
    fn shuffled(count: usize, seed: u64) -> Vec<f64> {
        let mut numbers: Vec<f64> = (0..count).map(|it| it as f64).collect();
        let mut state = 2 * seed + 1;
        for last in (1..count).rev() {
            state = state.wrapping_mul(0xda94_2042_e4dd_58b5);
            numbers.swap(last, (state >> 33) as usize % (last + 1));
        }
        numbers
    }

    #[test]
    fn of_random_splits_nearly_all_keep_the_rate_and_with_the_conformal_rank_many_do_not() {
        let (splits, drives, others) = (200, 1000, 4000);
        let keep = |guarantee: Guarantee| {
            let kept = (0..splits).filter(|split| {
                let scores = shuffled(drives + others, 7919 * split + 3);
                let mut calibrated = scores[..drives].to_vec();
                calibrated.sort_by(f64::total_cmp);
                let threshold = guarantee.threshold(&calibrated);
                scores[drives..].iter().filter(|it| **it > threshold).count() * 100 <= others
            });
            kept.count()
        };
        let pac = Guarantee::of(drives as u64).unwrap();
        // Rank 991 of 1001 from below.
        let above = drives as u64 - (1001.0f64 * 0.99).ceil() as u64;
        let conformal = Guarantee { above, ..pac };
        let (by_pac, by_conformal) = (keep(pac), keep(conformal));
        println!("of {splits} splits {by_pac} keep the rate, {by_conformal} by the conformal rank");
        assert!(by_pac >= 190, "{by_pac}");
        assert!(by_conformal < 150, "{by_conformal}");
    }

    #[test]
    fn few_drives_support_little() {
        let table = [(10, 0.2589), (30, 0.0950), (59, 0.0495), (100, 0.0295), (299, 0.00997)];
        for (drives, alpha) in table {
            assert!((supported_share(drives, 0.05) - alpha).abs() < 5e-5, "{drives}");
        }
        let few = Guarantee::of(10).unwrap();
        assert_eq!((few.above, few.delta, Guarantee::of(0)), (0, 0.05, None));
        for (drives, above) in [(459, 0), (1000, 2), (2000, 9)] {
            let promised = Guarantee { alpha: 0.01, delta: 0.01, above };
            assert_eq!(Guarantee::of(drives), Some(promised), "{drives}");
        }
    }
}
