//! A Gaussian process: what a few driven sets say about all others.
//!
//! C. E. Rasmussen and C. K. I. Williams, "Gaussian Processes for Machine Learning" (2006), chapters 2 and 5. The kernel
//! is Matérn's with ν = 5/2 and a length for each coordinate of the unit cube. Lengths and noise are those with the
//! greatest posterior density; the variance is integrated out as far as a mode goes.

use super::{Cholesky, Point};

/// What is known of a point: its value, the number of drives of which that is the mean, and the sum of the squared differences
/// of these from it.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Reading {
    pub(crate) point: Point,
    pub(crate) value: f64,
    pub(crate) drives: u32,
    pub(crate) scatter: f64,
}

/// Lengths of the kernel and noise of a drive, as logarithms.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Shape {
    /// In the unit cube, one for each coordinate.
    log_lengths: Vec<f64>,
    /// Variance of a drive's noise, as a share of the process's.
    log_noise: f64,
}

/// What is thought of a shape before any drive: mean and standard deviation of each logarithm, and its bounds.
#[derive(Debug, Clone, Copy)]
struct Belief {
    mean: f64,
    sd: f64,
    bounds: [f64; 2],
}

/// Lengths around half of an axis.
const LENGTH: Belief = Belief { mean: -0.7, sd: 1.2, bounds: [-3.0, 2.3] };
/// Without noise: what the kernel cannot follow, such as the steps of a manoeuvre that ends earlier or later.
const ROUGHNESS: Belief = Belief { mean: -9.0, sd: 2.0, bounds: [-13.8, -2.3] };
const NOISE: Belief = Belief { mean: -3.5, sd: 2.0, bounds: [-9.2, 2.3] };
/// Steps of the search for a shape, as logarithms.
const STEPS: [f64; 6] = [1.2, 0.6, 0.6, 0.3, 0.3, 0.15];
/// Readings by which a shape is chosen, at most.
const SHAPED_BY: usize = 64;

/// A process with its readings.
#[derive(Debug, Clone)]
pub(crate) struct Process {
    shape: Shape,
    points: Vec<Point>,
    factor: Cholesky,
    /// A⁻¹ y, with A the readings' covariance as a share of the process's variance.
    weights: Vec<f64>,
    variance: f64,
    mean: f64,
    scale: f64,
}

impl Shape {
    /// The likeliest shape. It depends on the readings alone, so that nothing needs to be saved.
    pub(crate) fn of(readings: &[Reading], noise: bool) -> Self {
        let belief = if noise { NOISE } else { ROUGHNESS };
        let dimensions = readings.first().map_or(0, |it| it.point.len());
        let fit = Fit::new(&thinned(readings), dimensions);
        let mut beliefs = vec![LENGTH; dimensions];
        beliefs.push(belief);
        let mut at: Vec<f64> = beliefs.iter().map(|it| it.mean).collect();
        let mut best = fit.log_density(&at, &beliefs);
        for step in STEPS {
            for axis in 0..at.len() {
                for step in [step, -step] {
                    let before = at[axis];
                    at[axis] =
                        (before + step).clamp(beliefs[axis].bounds[0], beliefs[axis].bounds[1]);
                    let density = fit.log_density(&at, &beliefs);
                    if density > best {
                        best = density;
                        break;
                    }
                    at[axis] = before;
                }
            }
        }
        let log_noise = at.pop().expect("the noise comes last");
        Self { log_lengths: at, log_noise }
    }
}

/// The best half of the readings that shape a process, and of the others every so many.
fn thinned(readings: &[Reading]) -> Vec<Reading> {
    if readings.len() <= SHAPED_BY {
        return readings.to_vec();
    }
    let mut sorted: Vec<&Reading> = readings.iter().collect();
    sorted.sort_by(|a, b| a.value.total_cmp(&b.value));
    let (best, others) = sorted.split_at(SHAPED_BY / 2);
    let every = others.len().div_ceil(SHAPED_BY / 2);
    best.iter().copied().chain(others.iter().copied().step_by(every)).cloned().collect()
}

/// What a shape is judged by.
struct Fit {
    size: usize,
    /// For each coordinate, the squared differences of all pairs, row by row right of the diagonal.
    squares: Vec<Vec<f64>>,
    values: Vec<f64>,
    drives: Vec<f64>,
    repeats: Repeats,
}

/// What drives of the same points tell of the noise, by how they differ: more than any model of the points does.
#[derive(Debug, Clone, Copy)]
struct Repeats {
    /// How many drives there are beyond the first ones of their points.
    count: f64,
    /// Sum of the squared differences from the means, in units of the values' standard deviation.
    scatter: f64,
}

/// Square of the share of a value by which its drives may differ from it for noise.
const MOST_SCATTER: f64 = 0.5;

impl Repeats {
    /// Drives of one point that differ by more than noise, as where some arrive and others do not, tell nothing of the noise
    /// of all others.
    fn of(readings: &[Reading], scale: f64) -> Self {
        let mut all = Self { count: 0.0, scatter: 0.0 };
        for it in readings {
            let count = f64::from(it.drives) - 1.0;
            if it.scatter <= MOST_SCATTER * count {
                all.count += count;
                all.scatter += it.scatter / (scale * scale);
            }
        }
        all
    }
}

impl Fit {
    fn new(readings: &[Reading], dimensions: usize) -> Self {
        let size = readings.len();
        let of_axis = |axis: usize| {
            let coordinate = |it: usize| readings[it].point[axis];
            let pairs = (0..size).flat_map(|a| (a + 1..size).map(move |b| (a, b)));
            pairs.map(|(a, b)| square(coordinate(a) - coordinate(b))).collect()
        };
        let (values, _, scale) = standardised(readings);
        Self {
            size,
            squares: (0..dimensions).map(of_axis).collect(),
            values,
            drives: readings.iter().map(|it| f64::from(it.drives)).collect(),
            repeats: Repeats::of(readings, scale),
        }
    }

    /// Logarithm of the posterior density of a shape, up to a constant.
    fn log_density(&self, at: &[f64], beliefs: &[Belief]) -> f64 {
        let (log_noise, log_lengths) = at.split_last().expect("the noise comes last");
        let mut sums = vec![0.0; self.size * self.size.saturating_sub(1) / 2];
        for (squares, log_length) in self.squares.iter().zip(log_lengths) {
            let share = libm::exp(-2.0 * log_length);
            sums.iter_mut().zip(squares).for_each(|(sum, square)| *sum += share * square);
        }
        let noise = libm::exp(*log_noise);
        let mut matrix = vec![0.0; self.size * self.size];
        let mut sums = sums.into_iter();
        for (row, drives) in self.drives.iter().enumerate() {
            matrix[row * self.size + row] = 1.0 + noise / drives;
            let right = &mut matrix[row * self.size + row + 1..(row + 1) * self.size];
            right.iter_mut().zip(&mut sums).for_each(|(it, sum)| *it = matern(sum));
        }
        let Some(factor) = Cholesky::of(matrix, self.size) else { return f64::NEG_INFINITY };
        let mut solved = self.values.clone();
        factor.solve_lower(&mut solved, 1);
        let count = self.size as f64 + self.repeats.count;
        let fit = -0.5 * (factor.log_determinant() + self.repeats.count * log_noise)
            - 0.5 * (count + 2.0) * libm::log(variance(&solved, self.repeats, noise));
        let belief = |(at, it): (&f64, &Belief)| -0.5 * square((at - it.mean) / it.sd);
        fit + at.iter().zip(beliefs).map(belief).sum::<f64>()
    }
}

/// The process's variance, given L⁻¹ y and a drive's noise as a share of it: its mode, if one as large as the values' counts as
/// much as two readings do.
fn variance(solved: &[f64], repeats: Repeats, noise: f64) -> f64 {
    let squares = solved.iter().map(|it| it * it).sum::<f64>() + repeats.scatter / noise;
    (squares + 2.0) / (solved.len() as f64 + repeats.count + 2.0)
}

impl Process {
    /// The process of a shape through some readings.
    pub(crate) fn new(shape: Shape, readings: &[Reading]) -> Self {
        let size = readings.len();
        let (mut weights, mean, scale) = standardised(readings);
        let points: Vec<Point> = readings.iter().map(|it| it.point.clone()).collect();
        let mut matrix = covariances(&shape, &points, &points);
        for (row, reading) in readings.iter().enumerate() {
            matrix[row * size + row] += libm::exp(shape.log_noise) / f64::from(reading.drives);
        }
        // With a noise of at least e⁻¹³·⁸ on the diagonal it has a factor unless numbers fail; then nothing is learnt.
        let factor = Cholesky::of(matrix, size).unwrap_or_else(|| {
            let unit = (0..size * size).map(|it| if it % (size + 1) == 0 { 1.0 } else { 0.0 });
            Cholesky::of(unit.collect(), size).expect("a unit matrix has a factor")
        });
        factor.solve_lower(&mut weights, 1);
        let noise = libm::exp(shape.log_noise);
        let variance = variance(&weights, Repeats::of(readings, scale), noise);
        factor.solve_upper(&mut weights);
        Self { shape, points, factor, weights, variance, mean, scale }
    }

    /// Mean and standard deviation of the process at some points, without a drive's noise.
    pub(crate) fn predict(&self, points: &[Point]) -> Vec<(f64, f64)> {
        let count = points.len();
        if count == 0 {
            return Vec::new();
        }
        let mut columns = covariances(&self.shape, &self.points, points);
        let mut means = vec![0.0; count];
        for (row, weight) in columns.chunks_exact(count).zip(&self.weights) {
            means.iter_mut().zip(row).for_each(|(mean, it)| *mean += weight * it);
        }
        self.factor.solve_lower(&mut columns, count);
        let mut left = vec![1.0; count];
        for row in columns.chunks_exact(count) {
            left.iter_mut().zip(row).for_each(|(left, it)| *left -= it * it);
        }
        let each = means.into_iter().zip(left);
        each.map(|(mean, left)| {
            let sd = (self.variance * left.max(0.0)).sqrt();
            (self.mean + self.scale * mean, self.scale * sd)
        })
        .collect()
    }

    /// Standard deviation of a drive's noise.
    pub(crate) fn noise(&self) -> f64 {
        self.scale * (self.variance * libm::exp(self.shape.log_noise)).sqrt()
    }

    /// The shape.
    pub(crate) fn shape(&self) -> &Shape {
        &self.shape
    }
}

/// The kernel between each of `rows` and each of `columns`, row by row.
fn covariances(shape: &Shape, rows: &[Point], columns: &[Point]) -> Vec<f64> {
    let shares: Vec<f64> = shape.log_lengths.iter().map(|it| libm::exp(-2.0 * it)).collect();
    let mut all = Vec::with_capacity(rows.len() * columns.len());
    for row in rows {
        all.extend(columns.iter().map(|column| {
            let each = row.iter().zip(column).zip(&shares);
            matern(each.map(|((a, b), share)| share * square(a - b)).sum())
        }));
    }
    all
}

/// Matérn's kernel with ν = 5/2, of a squared distance in lengths.
pub(crate) fn matern(squared: f64) -> f64 {
    let far = (5.0 * squared).sqrt();
    (1.0 + far + far * far / 3.0) * libm::exp(-far)
}

fn square(it: f64) -> f64 {
    it * it
}

/// The values less their mean, in units of their standard deviation; and these two. A single value, from which nothing
/// deviates, is in units of its own: values are logarithms, so it is believed up to some factors of e.
fn standardised(readings: &[Reading]) -> (Vec<f64>, f64, f64) {
    let count = readings.len().max(1) as f64;
    let mean = readings.iter().map(|it| it.value).sum::<f64>() / count;
    let spread = readings.iter().map(|it| square(it.value - mean)).sum::<f64>() / count;
    let scale = if readings.len() > 1 { spread.sqrt().max(1e-9) } else { 1.0 };
    (readings.iter().map(|it| (it.value - mean) / scale).collect(), mean, scale)
}

/// How much less than `best` a normally distributed value is expected to come to, counting nothing where it is more.
pub(crate) fn expected_improvement(best: f64, (mean, sd): (f64, f64)) -> f64 {
    if sd <= 0.0 {
        return (best - mean).max(0.0);
    }
    let z = (best - mean) / sd;
    let density = libm::exp(-0.5 * z * z) / (2.0 * std::f64::consts::PI).sqrt();
    let below = 0.5 * libm::erfc(-z / std::f64::consts::SQRT_2);
    sd * (z * below + density)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Stream;
    use crate::search::Sobol;

    fn wave(point: &[f64]) -> f64 {
        libm::sin(3.0 * point[0]) + point[1] * point[1]
    }

    fn readings(count: u32) -> Vec<Reading> {
        let sobol = Sobol::new(vec![3, 4]);
        let reading = |it: u32| {
            let point = sobol.point(it);
            Reading { value: wave(&point), point, drives: 1, scatter: 0.0 }
        };
        (0..count).map(reading).collect()
    }

    #[test]
    fn a_smooth_function_is_predicted_from_thirty_points_and_its_readings_are_believed() {
        let readings = readings(30);
        let process = Process::new(Shape::of(&readings, false), &readings);
        let points: Vec<Point> = readings.iter().map(|it| it.point.clone()).collect();
        for ((mean, sd), reading) in process.predict(&points).into_iter().zip(&readings) {
            assert!((mean - reading.value).abs() < 0.02 && sd < 0.05, "{mean} ± {sd}");
        }
        let others: Vec<Point> = (100..200).map(|it| Sobol::new(vec![3, 4]).point(it)).collect();
        let within =
            process.predict(&others).into_iter().zip(&others).filter(|((mean, sd), point)| {
                let off = (mean - wave(point)).abs();
                assert!(off < 0.1, "{off} at {point:?}");
                off < 3.0 * sd + 1e-3
            });
        assert!(within.count() >= 95);
    }

    #[test]
    fn far_from_its_readings_a_process_knows_little() {
        let readings = readings(6)
            .into_iter()
            .map(|it| Reading { point: it.point.iter().map(|it| it / 10.0).collect(), ..it });
        let readings: Vec<Reading> = readings.collect();
        let process = Process::new(Shape::of(&readings, false), &readings);
        let near = process.predict(&[vec![0.05, 0.05]])[0].1;
        let far = process.predict(&[vec![1.0, 1.0]])[0].1;
        assert!(far > 5.0 * near, "{near} {far}");
    }

    #[test]
    fn noise_is_told_from_shape() {
        // Readings that are off by 0.5 up or down, by chance, are not believed exactly.
        let (smooth, mut stream) = (readings(40), Stream::new(9, 0));
        let off = |it: &Reading, by: f64| Reading { value: it.value + by, ..it.clone() };
        let noisy =
            smooth.iter().map(|it| off(it, if stream.uniform() < 0.5 { 0.5 } else { -0.5 }));
        let noisy: Vec<Reading> = noisy.collect();
        let process = Process::new(Shape::of(&noisy, true), &noisy);
        let points: Vec<Point> = smooth.iter().map(|it| it.point.clone()).collect();
        let off = process.predict(&points).into_iter().zip(&smooth);
        let off = off.map(|((mean, _), it)| square(mean - it.value)).sum::<f64>() / 40.0;
        assert!(off.sqrt() < 0.35, "{off}");
    }

    #[test]
    fn drives_of_the_same_points_tell_the_noise() {
        for sd in [0.3, 0.03] {
            // Four drives at each point, as far apart as that.
            let again = |it: Reading| Reading { drives: 4, scatter: 3.0 * sd * sd, ..it };
            let readings: Vec<Reading> = readings(10).into_iter().map(again).collect();
            let told = Process::new(Shape::of(&readings, true), &readings).noise();
            assert!((told / sd - 1.0).abs() < 0.2, "{told} for {sd}");
        }
    }

    #[test]
    fn a_set_with_which_only_some_drives_arrive_tells_nothing_of_the_noise_of_all() {
        let again = |it: Reading| Reading { drives: 4, scatter: 3.0 * 0.03 * 0.03, ..it };
        let mut readings: Vec<Reading> = readings(10).into_iter().map(again).collect();
        readings[3].scatter = 6.0;
        let told = Process::new(Shape::of(&readings, true), &readings).noise();
        assert!((told / 0.03 - 1.0).abs() < 0.2, "{told}");
    }

    #[test]
    fn a_single_reading_is_not_believed_exactly() {
        let one = &readings(1)[..];
        let (mean, sd) =
            Process::new(Shape::of(one, true), one).predict(&[one[0].point.clone()])[0];
        assert!((mean - one[0].value).abs() < 1.0 && sd > 0.1, "{mean} {sd}");
    }

    #[test]
    fn the_expected_improvement_is_that_of_the_normal_distribution() {
        // φ(0) = 0.39894; at z = 1: Φ(1) + φ(1) = 0.84134 + 0.24197.
        assert!((expected_improvement(1.0, (1.0, 2.0)) - 0.797_884_56).abs() < 1e-8);
        assert!((expected_improvement(2.0, (1.0, 1.0)) - 1.083_315_47).abs() < 1e-8);
        assert_eq!(expected_improvement(2.0, (1.5, 0.0)), 0.5);
        assert_eq!(expected_improvement(2.0, (2.5, 0.0)), 0.0);
    }
}
