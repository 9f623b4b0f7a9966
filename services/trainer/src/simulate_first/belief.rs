//! A Gaussian process over a fixed list of sets, whose mean and covariance are those of simulated drives.
//!
//! Of the logarithm of the objective: the mean over the plants; the covariance over the plants, and beside it a Matérn
//! kernel for what no plant knows, and a constant for what makes all sets worse or better alike. C. E. Rasmussen and
//! C. K. I. Williams, "Gaussian Processes for Machine Learning" (2006), chapter 2.

use super::Candidate;
use crate::search::{Cholesky, matern};

/// What no plant knows of a set: standard deviation, and length in the unit cube.
const UNKNOWN: f64 = 0.05;
const LENGTH: f64 = 0.7;
/// Variance of what all sets have in common.
const COMMON: f64 = 0.01;
/// A drive tells the logarithm of a value with at least this standard deviation.
const LEAST_NOISE: f64 = 0.01;

/// A drive of the vehicle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Reading {
    /// Number of the set.
    pub(crate) candidate: usize,
    /// Logarithm of the drive's value.
    pub(crate) log: f64,
}

/// What is thought of each set.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Belief {
    /// Mean and standard deviation of the logarithm of each set's value, without a drive's noise.
    pub(crate) sets: Vec<(f64, f64)>,
}

impl Belief {
    /// What simulated and real drives say of the sets together. `noise` is the variance of a real drive's logarithm.
    pub(crate) fn new(candidates: &[Candidate], readings: &[Reading], noise: f64) -> Self {
        let noise = noise.max(LEAST_NOISE * LEAST_NOISE);
        let means: Vec<f64> =
            candidates.iter().map(|it| crate::statistics::mean(&it.logs)).collect();
        let covariance = |a: usize, b: usize| {
            let (of_a, of_b) = (&candidates[a], &candidates[b]);
            let features = of_a.logs.iter().zip(&of_b.logs);
            let product: f64 = features.map(|(x, y)| (x - means[a]) * (y - means[b])).sum();
            let each = of_a.point.iter().zip(&of_b.point);
            let squared: f64 = each.map(|(x, y)| (x - y) * (x - y) / (LENGTH * LENGTH)).sum();
            product / of_a.logs.len() as f64 + UNKNOWN * UNKNOWN * matern(squared) + COMMON
        };
        let size = readings.len();
        let mut matrix = vec![0.0; size * size];
        for (row, a) in readings.iter().enumerate() {
            for (column, b) in readings.iter().enumerate().skip(row) {
                matrix[row * size + column] = covariance(a.candidate, b.candidate);
            }
            matrix[row * size + row] += noise;
        }
        let factor = Cholesky::of(matrix, size);
        let Some(factor) = factor.filter(|_| size > 0) else {
            let sd = |it: usize| covariance(it, it).sqrt();
            return Self { sets: means.iter().enumerate().map(|(it, m)| (*m, sd(it))).collect() };
        };
        let mut weights: Vec<f64> =
            readings.iter().map(|it| it.log - means[it.candidate]).collect();
        factor.solve_lower(&mut weights, 1);
        let of_set = |(it, mean): (usize, &f64)| {
            let mut column: Vec<f64> =
                readings.iter().map(|reading| covariance(reading.candidate, it)).collect();
            factor.solve_lower(&mut column, 1);
            let shift: f64 = column.iter().zip(&weights).map(|(a, b)| a * b).sum();
            let known: f64 = column.iter().map(|it| it * it).sum();
            (mean + shift, (covariance(it, it) - known).max(0.0).sqrt())
        };
        Self { sets: means.iter().enumerate().map(of_set).collect() }
    }

    /// The set with the least mean among some; the first of several.
    pub(crate) fn best(&self, among: impl Iterator<Item = usize>) -> Option<usize> {
        among.fold(None, |best, it| match best {
            Some(best) if self.sets[best].0 <= self.sets[it].0 => Some(best),
            _ => Some(it),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two plants that disagree on which of the first two sets is better; the third is bad on both.
    fn candidates() -> Vec<Candidate> {
        [([0.0, 0.4], 0.0), ([0.5, 0.1], 0.5), ([2.0, 2.0], 1.0)]
            .into_iter()
            .map(|(logs, at)| Candidate {
                set: config::Parameters::of(&[at]),
                point: vec![at],
                logs: logs.to_vec(),
                worst_m: 0.0,
                is_out: false,
            })
            .collect()
    }

    #[test]
    fn without_drives_it_is_what_was_simulated() {
        let belief = Belief::new(&candidates(), &[], 0.0);
        let means: Vec<f64> = belief.sets.iter().map(|it| it.0).collect();
        assert!((means[0] - 0.2).abs() < 1e-12 && (means[1] - 0.3).abs() < 1e-12);
        // The plants' variance, that of what no plant knows, and that of what all have in common.
        assert!((belief.sets[0].1.powi(2) - (0.04 + 0.0025 + 0.01)).abs() < 1e-12);
        assert_eq!(belief.best(0..3), Some(0));
    }

    #[test]
    fn a_drive_tells_which_plant_the_car_is_like() {
        // As on the second plant: then the other set must be the better one.
        let belief = Belief::new(&candidates(), &[Reading { candidate: 0, log: 0.4 }], 0.0);
        assert_eq!(belief.best(0..3), Some(1));
        let (mean, sd) = belief.sets[0];
        assert!((mean - 0.4).abs() < 0.005 && sd < 0.011, "{mean} ± {sd}");
        assert!(belief.sets[1].1 < 0.2);
        // Of noisy drives it takes several to be as sure.
        let noisy = Belief::new(&candidates(), &[Reading { candidate: 0, log: 0.4 }], 0.1);
        assert!(noisy.sets[0].1 > 0.15 && noisy.sets[0].0 < 0.3);
    }
}
