//! Means of what the odometry says, over short times.

use config::RunConfig;

/// Over how long.
const MEAN_S: f64 = 0.1;

/// The means of N numbers over 0.1 s, or over a tick where that is longer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Means<const N: usize> {
    sums: [f64; N],
    count: u32,
    of: u32,
}

impl<const N: usize> Means<N> {
    pub(crate) fn new(config: &RunConfig) -> Self {
        let of = (MEAN_S / config.drive.tick_s).round().max(1.0) as u32;
        Self { sums: [0.0; N], count: 0, of }
    }

    /// Whether the next numbers are the first of a mean.
    #[inline]
    pub(crate) fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Forgets the numbers of the mean that is under way.
    pub(crate) fn restart(&mut self) {
        (self.sums, self.count) = ([0.0; N], 0);
    }

    /// Takes the numbers of a tick; returns the means with the last of them.
    #[inline]
    pub(crate) fn add(&mut self, numbers: [f64; N]) -> Option<[f64; N]> {
        for (sum, number) in self.sums.iter_mut().zip(numbers) {
            *sum += number;
        }
        self.count += 1;
        if self.count < self.of {
            return None;
        }
        let means = self.sums.map(|sum| sum / f64::from(self.count));
        self.restart();
        Some(means)
    }
}
