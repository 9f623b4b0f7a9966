//! Randomness that is the same in every version and on every host.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// One stream of random numbers.
#[derive(Debug, Clone)]
pub(crate) struct Stream(ChaCha8Rng);

impl Stream {
    /// Stream number `stream` of a seed. The key is spelt out, because a library may change how it makes
    /// one from a number.
    pub(crate) fn new(seed: u64, stream: u64) -> Self {
        let mut key = [0; 32];
        key[..8].copy_from_slice(&seed.to_le_bytes());
        key[8..16].copy_from_slice(&stream.to_le_bytes());
        Self(ChaCha8Rng::from_seed(key))
    }

    /// How far the stream has been drawn.
    pub(crate) fn position(&self) -> u128 {
        self.0.get_word_pos()
    }

    /// Goes to where a stream of the same seed and number had been drawn.
    pub(crate) fn go_to(&mut self, position: u128) {
        self.0.set_word_pos(position);
    }

    /// Uniform in [0, 1), 53 bits.
    pub(crate) fn uniform(&mut self) -> f64 {
        (self.0.next_u64() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Normally distributed, by G. E. P. Box and M. E. Muller; one of the two that their method gives is left.
    pub(crate) fn normal(&mut self) -> f64 {
        let far = (-2.0 * libm::log(1.0 - self.uniform())).sqrt();
        far * libm::cos(2.0 * std::f64::consts::PI * self.uniform())
    }

    /// Uniform among the first `count` numbers; `count` is small, so the bias is far below 2⁻⁵⁰.
    pub(crate) fn below(&mut self, count: usize) -> usize {
        ((u128::from(self.0.next_u64()) * count as u128) >> 64) as usize
    }
}

/// Seed of a drive: from run, learner and step, so that a repeated attempt sees the same noise.
pub(crate) fn drive_seed(run_seed: u64, learner: u32, step: u32) -> u64 {
    // splitmix64's finaliser over the three numbers.
    let mut mixed = run_seed ^ 0x9e37_79b9_7f4a_7c15;
    for number in [u64::from(learner), u64::from(step)] {
        mixed = mixed.wrapping_add(number.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15));
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        mixed ^= mixed >> 31;
    }
    mixed
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_stream_does_not_change_with_a_library() {
        let mut stream = Stream::new(1, 0);
        let drawn: Vec<u64> = (0..3).map(|_| stream.uniform().to_bits()).collect();
        assert_eq!(drawn, FIRST_DRAWN);
        assert_ne!(Stream::new(1, 1).uniform(), Stream::new(1, 0).uniform());
    }

    const FIRST_DRAWN: [u64; 3] = [4600543922235128406, 4598984558295872832, 4605365254607385758];

    #[test]
    fn normal_numbers_have_the_moments_of_their_distribution() {
        let mut stream = Stream::new(3, 0);
        let drawn: Vec<f64> = (0..20_000).map(|_| stream.normal()).collect();
        let moment = |power: i32| drawn.iter().map(|it| it.powi(power)).sum::<f64>() / 20_000.0;
        let off = [moment(1), moment(2) - 1.0, moment(3), moment(4) - 3.0];
        // Four standard errors of each.
        let bounds = [0.0283, 0.04, 0.11, 0.28];
        assert!(off.iter().zip(bounds).all(|(off, bound)| off.abs() < bound), "{off:?}");
    }

    #[test]
    fn drives_have_seeds_of_their_own() {
        let mut seeds: Vec<u64> = (0..50)
            .flat_map(|learner| (0..200).map(move |step| drive_seed(1, learner, step)))
            .collect();
        seeds.sort_unstable();
        seeds.dedup();
        assert_eq!(seeds.len(), 10_000);
    }
}
