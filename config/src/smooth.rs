//! Smooths a path that was measured with noise.
//!
//! The line is a cubic smoothing spline (Reinsch, "Smoothing by Spline Functions", Numerische Mathematik 10, 1967), each
//! coordinate over the length along the line: it makes Σ w·(r − z)² + λ·∫z″² least. The length along noisy points is far
//! longer than that of the line, so that it is taken from a first smoothing over the points' numbers (Whittaker's, of second
//! differences). Points that lie behind each other within a step count together, so that a car that stood still leaves one
//! point. How smooth is decided by generalised cross-validation (Craven and Wahba, 1979), and by the turns that the car can
//! drive. Pure arithmetic and libm: the same bytes on every host.

#![allow(clippy::needless_range_loop, reason = "rows and columns of matrices")]

use crate::points::tightest;
use crate::resample::resample;

/// A length of λ below which the car's tightest turns keep their shape: the share of that turn's radius. On such a turn it
/// moves the line by less than a thousandth of the radius.
const SHORTEST_SHARE: f64 = 0.18;
/// Lengths that are tried, each this many times the one before.
const STEP: f64 = 1.25;
const TRIED: i32 = 24;
/// Points of the path that are compared on both sides of a point's place.
const AROUND: usize = 12;

/// A smoothed path.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Smoothed {
    pub(crate) points: Vec<[f64; 2]>,
    /// For each of them, the given points that it stands for, as a range.
    pub(crate) given: Vec<(usize, usize)>,
    /// Distance of the given points from the smoothed line: the mean, and the greatest.
    pub(crate) mean_m: f64,
    pub(crate) greatest_m: f64,
    /// Whether the car can drive its tightest turn.
    pub(crate) is_drivable: bool,
}

/// The smoothed path through `points`, of which there are at least 5; `sharpest` is the curvature of the car's tightest
/// turn, 1/m. The line lies at most `bound_m` from the points at the mean, or is the one that is nearest to them.
pub(crate) fn smooth(points: &[[f64; 2]], sharpest: f64, bound_m: f64) -> Smoothed {
    let count = points.len();
    let is_closed = points[0] == points[count - 1];
    // A lap goes on before its beginning and behind its end.
    let overlap = if is_closed { (count - 1).min(200) } else { 0 };
    let around = count - usize::from(is_closed);
    let extended: Vec<[f64; 2]> = if is_closed {
        (0..count + 2 * overlap).map(|index| points[(index + around - overlap) % around]).collect()
    } else {
        points.to_vec()
    };
    let bins = Bins::new(&extended, &by_number(&extended));
    let shortest_m = (SHORTEST_SHARE / sharpest).max(0.3 * bins.step_m);
    let candidates: Vec<(f64, Vec<[f64; 2]>)> = (0..TRIED)
        .map(|power| {
            let length_m = shortest_m * STEP.powi(power);
            (length_m, bins.spline(length_m.powi(4) / bins.step_m))
        })
        .collect();
    let score = |(length_m, line): &(f64, Vec<[f64; 2]>)| bins.cross_validation(line, *length_m);
    let best = candidates
        .iter()
        .map(score)
        .enumerate()
        .min_by(|a, b| a.1.total_cmp(&b.1))
        .map_or(0, |it| it.0);
    let finished = |line: &[[f64; 2]]| bins.finish(line, &extended, points, overlap, sharpest);
    let mut chosen = finished(&candidates[best].1);
    if chosen.mean_m > bound_m {
        // Less smooth, and nearer to the points.
        for (_, line) in candidates[..best].iter().rev() {
            chosen = finished(line);
            if chosen.mean_m <= bound_m {
                break;
            }
        }
        return chosen;
    }
    // Noise that is no white one looks like curves; then it is smoothed until the car can drive it.
    for (_, line) in candidates.iter().skip(best + 1) {
        if chosen.is_drivable {
            break;
        }
        let smoother = finished(line);
        if smoother.mean_m > bound_m {
            break;
        }
        chosen = smoother;
    }
    chosen
}

fn apart_m(a: [f64; 2], b: [f64; 2]) -> f64 {
    libm::hypot(b[0] - a[0], b[1] - a[1])
}

/// The points smoothed over their numbers: only to tell the length along the line.
fn by_number(points: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let count = points.len();
    let whittaker = |lambda: f64| -> Vec<[f64; 2]> {
        // (I + λ·DᵀD)·z = r with second differences D.
        let (mut main, mut first, mut second) =
            (vec![1.0; count], vec![0.0; count], vec![0.0; count]);
        for at in 0..count - 2 {
            let weights = [1.0, -2.0, 1.0];
            for (a, wa) in weights.iter().enumerate() {
                main[at + a] += lambda * wa * wa;
            }
            first[at] += lambda * weights[0] * weights[1];
            first[at + 1] += lambda * weights[1] * weights[2];
            second[at] += lambda * weights[0] * weights[2];
        }
        solve(&main, &first, &second, points)
    };
    let score = |power: i32| {
        let lambda = 4.0_f64.powi(power);
        let line = whittaker(lambda);
        let rest: f64 =
            line.iter().zip(points).map(|(z, r)| apart_m(*z, *r) * apart_m(*z, *r)).sum();
        (gcv(rest, freedom(lambda, count), count), line)
    };
    let all = (-2..9).map(score);
    all.min_by(|a, b| a.0.total_cmp(&b.0)).map_or_else(|| points.to_vec(), |it| it.1)
}

/// Degrees of freedom of a smoothing of second differences over `count` even steps: the trace of its matrix, from the
/// eigenvalues of the differences.
fn freedom(lambda: f64, count: usize) -> f64 {
    (0..count)
        .map(|index| {
            let half = 0.5 * std::f64::consts::PI * index as f64 / count as f64;
            let sin = libm::sin(half);
            1.0 / (1.0 + lambda * 16.0 * sin * sin * sin * sin)
        })
        .sum()
}

fn gcv(rest: f64, freedom: f64, count: usize) -> f64 {
    let free = (count as f64 - freedom).max(1e-9);
    rest / (free * free)
}

/// Solves a symmetric system of five diagonals, positive definite, for two right-hand sides at once.
fn solve(main: &[f64], first: &[f64], second: &[f64], right: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let count = main.len();
    let (mut d, mut l1, mut l2) = (vec![0.0; count], vec![0.0; count], vec![0.0; count]);
    let mut z = right.to_vec();
    // L·D·Lᵀ, and the forward substitution with it.
    for at in 0..count {
        let mut pivot = main[at];
        let mut below = first[at];
        if at >= 1 {
            pivot -= l1[at - 1] * l1[at - 1] * d[at - 1];
            below -= l1[at - 1] * l2[at - 1] * d[at - 1];
        }
        if at >= 2 {
            pivot -= l2[at - 2] * l2[at - 2] * d[at - 2];
        }
        (d[at], l1[at], l2[at]) = (pivot, below / pivot, second[at] / pivot);
        for axis in 0..2 {
            if at >= 1 {
                z[at][axis] -= l1[at - 1] * z[at - 1][axis];
            }
            if at >= 2 {
                z[at][axis] -= l2[at - 2] * z[at - 2][axis];
            }
        }
    }
    for at in (0..count).rev() {
        for axis in 0..2 {
            z[at][axis] /= d[at];
            if at + 1 < count {
                z[at][axis] -= l1[at] * z[at + 1][axis];
            }
            if at + 2 < count {
                z[at][axis] -= l2[at] * z[at + 2][axis];
            }
        }
    }
    z
}

/// Points that lie within a step of the line, taken together.
#[derive(Debug)]
struct Bins {
    /// Mean place, length along the line and number of the points of each.
    means: Vec<[f64; 2]>,
    along_m: Vec<f64>,
    weights: Vec<f64>,
    given: Vec<(usize, usize)>,
    step_m: f64,
}

impl Bins {
    fn new(points: &[[f64; 2]], line: &[[f64; 2]]) -> Self {
        let mut along_m = vec![0.0];
        let mut steps: Vec<f64> = line.windows(2).map(|pair| apart_m(pair[0], pair[1])).collect();
        for step_m in &steps {
            along_m.push(along_m[along_m.len() - 1] + step_m);
        }
        steps.sort_by(f64::total_cmp);
        let length_m = along_m[along_m.len() - 1];
        let step_m = steps[3 * (steps.len() - 1) / 4].max(1e-5 * length_m);
        let mut bins = Self {
            means: Vec::new(),
            along_m: Vec::new(),
            weights: Vec::new(),
            given: Vec::new(),
            step_m,
        };
        let mut from = 0;
        while from < points.len() {
            let mut to = from + 1;
            while to < points.len() && along_m[to] - along_m[from] < 0.5 * step_m {
                to += 1;
            }
            let weight = (to - from) as f64;
            let mean =
                |axis: usize| points[from..to].iter().map(|it| it[axis]).sum::<f64>() / weight;
            let along: f64 = along_m[from..to].iter().sum::<f64>() / weight;
            bins.means.push([mean(0), mean(1)]);
            bins.along_m.push(along);
            bins.weights.push(weight);
            bins.given.push((from, to));
            from = to;
        }
        bins
    }

    /// The smoothing spline at the bins, by Reinsch's algorithm.
    fn spline(&self, lambda: f64) -> Vec<[f64; 2]> {
        let count = self.means.len();
        if count < 4 {
            return self.means.clone();
        }
        let h: Vec<f64> =
            self.along_m.windows(2).map(|pair| (pair[1] - pair[0]).max(1e-9)).collect();
        let inner = count - 2;
        // Column j of Q has 1/h[j], −1/h[j] − 1/h[j+1], 1/h[j+1] in the rows j, j+1, j+2.
        let q = |j: usize| [1.0 / h[j], -1.0 / h[j] - 1.0 / h[j + 1], 1.0 / h[j + 1]];
        let inverse = |at: usize| 1.0 / self.weights[at];
        let (mut main, mut first, mut second) =
            (vec![0.0; inner], vec![0.0; inner], vec![0.0; inner]);
        let mut right = vec![[0.0; 2]; inner];
        for j in 0..inner {
            let qj = q(j);
            main[j] = (h[j] + h[j + 1]) / 3.0
                + lambda * (0..3).map(|k| qj[k] * qj[k] * inverse(j + k)).sum::<f64>();
            if j + 1 < inner {
                let next = q(j + 1);
                first[j] = h[j + 1] / 6.0
                    + lambda
                        * (qj[1] * next[0] * inverse(j + 1) + qj[2] * next[1] * inverse(j + 2));
            }
            if j + 2 < inner {
                second[j] = lambda * qj[2] * q(j + 2)[0] * inverse(j + 2);
            }
            for axis in 0..2 {
                right[j][axis] = (0..3).map(|k| qj[k] * self.means[j + k][axis]).sum();
            }
        }
        let gamma = solve(&main, &first, &second, &right);
        let mut line = self.means.clone();
        for (j, bend) in gamma.iter().enumerate() {
            let qj = q(j);
            for k in 0..3 {
                for axis in 0..2 {
                    line[j + k][axis] -= lambda * inverse(j + k) * qj[k] * bend[axis];
                }
            }
        }
        line
    }

    fn cross_validation(&self, line: &[[f64; 2]], length_m: f64) -> f64 {
        let count = line.len();
        let rest: f64 = (0..count)
            .map(|at| {
                self.weights[at]
                    * apart_m(line[at], self.means[at])
                    * apart_m(line[at], self.means[at])
            })
            .sum();
        gcv(rest, freedom((length_m / self.step_m).powi(4), count), count)
    }

    /// The line without its overlap, with how far the points lie from it.
    fn finish(
        &self,
        line: &[[f64; 2]],
        extended: &[[f64; 2]],
        points: &[[f64; 2]],
        overlap: usize,
        sharpest: f64,
    ) -> Smoothed {
        let count = points.len();
        let is_closed = overlap > 0;
        let is_kept = |(from, _): (usize, usize)| {
            !is_closed || (from >= overlap && from < overlap + count - 1)
        };
        let (mut kept, mut given) = (Vec::new(), Vec::new());
        for (at, range) in self.given.iter().enumerate().filter(|(_, range)| is_kept(**range)) {
            kept.push(line[at]);
            given.push((range.0 - overlap, (range.1 - overlap).min(count)));
        }
        if is_closed {
            kept.push(kept[0]);
            given.push((count - 1, count));
        }
        let (mut sum_m, mut greatest_m) = (0.0, 0.0_f64);
        for (at, (from, to)) in self.given.iter().enumerate() {
            let around = &line[at.saturating_sub(AROUND)..(at + AROUND + 1).min(line.len())];
            for point in &extended[*from..*to] {
                let off_m = around
                    .windows(2)
                    .map(|pair| from_segment_m(*point, pair[0], pair[1]))
                    .fold(f64::INFINITY, f64::min);
                sum_m += off_m;
                greatest_m = greatest_m.max(off_m);
            }
        }
        let even = resample(&kept, &[], crate::points::MAX_POINTS);
        let is_drivable = tightest(&even.points).1 <= sharpest;
        Smoothed {
            points: kept,
            given,
            mean_m: sum_m / extended.len() as f64,
            greatest_m,
            is_drivable,
        }
    }
}

/// Distance of a point from a straight piece.
fn from_segment_m(point: [f64; 2], from: [f64; 2], to: [f64; 2]) -> f64 {
    let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
    let (px, py) = (point[0] - from[0], point[1] - from[1]);
    let length2 = dx * dx + dy * dy;
    let share = if length2 > 0.0 { ((px * dx + py * dy) / length2).clamp(0.0, 1.0) } else { 0.0 };
    libm::hypot(px - share * dx, py - share * dy)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A reproducible number in (−1, 1) with the spread of a sum of twelve, near a Gaussian of 1.
    fn gauss(seed: &mut u64) -> f64 {
        let mut sum = -6.0;
        for _ in 0..12 {
            *seed = seed
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            sum += (*seed >> 11) as f64 / (1u64 << 53) as f64;
        }
        sum
    }

    /// A quarter turn of 8 m between two straights, every 10 cm.
    fn bend() -> Vec<[f64; 2]> {
        let (straight, radius) = (20.0, 8.0);
        let arc = radius * std::f64::consts::FRAC_PI_2;
        (0..)
            .map(|index| 0.1 * f64::from(index))
            .take_while(|s| *s <= 2.0 * straight + arc)
            .map(|s| {
                if s < straight {
                    [s, 0.0]
                } else if s < straight + arc {
                    let angle = (s - straight) / radius;
                    [straight + radius * libm::sin(angle), radius * (1.0 - libm::cos(angle))]
                } else {
                    [straight + radius, radius + s - straight - arc]
                }
            })
            .collect()
    }

    #[test]
    fn noise_is_taken_off_and_the_bend_stays() {
        for (sd_m, near_m) in [(0.0, 0.02), (0.008, 0.02), (0.02, 0.03), (0.05, 0.06), (0.2, 0.2)] {
            let mut seed = 3;
            let clean = bend();
            let noisy: Vec<[f64; 2]> = clean
                .iter()
                .map(|[x, y]| [x + sd_m * gauss(&mut seed), y + sd_m * gauss(&mut seed)])
                .collect();
            let line = smooth(&noisy, 1.0 / 5.0, 0.2);
            assert!(line.is_drivable, "{sd_m}");
            assert!(
                line.mean_m <= 0.2 && (line.mean_m - 0.8 * sd_m).abs() < 0.2 * sd_m + 0.005,
                "{sd_m}: {}",
                line.mean_m
            );
            let off_m = clean
                .iter()
                .map(|it| {
                    line.points
                        .windows(2)
                        .map(|pair| from_segment_m(*it, pair[0], pair[1]))
                        .fold(9.0, f64::min)
                })
                .fold(0.0, f64::max);
            assert!(off_m < near_m, "{sd_m}: {off_m}");
        }
    }

    #[test]
    fn a_lap_stays_closed_and_a_car_that_stood_leaves_one_point() {
        let mut seed = 7;
        let count = 600;
        let mut points: Vec<[f64; 2]> = (0..count)
            .map(|index| {
                let angle = std::f64::consts::TAU * f64::from(index) / f64::from(count);
                [
                    10.0 * libm::cos(angle) + 0.02 * gauss(&mut seed),
                    10.0 * libm::sin(angle) + 0.02 * gauss(&mut seed),
                ]
            })
            .collect();
        points.push(points[0]);
        let line = smooth(&points, 1.0 / 5.0, 0.2);
        assert!(line.is_drivable);
        assert_eq!(line.points[0], line.points[line.points.len() - 1]);
        let off_m = line
            .points
            .iter()
            .map(|it| (libm::hypot(it[0], it[1]) - 10.0).abs())
            .fold(0.0, f64::max);
        assert!(off_m < 0.02, "{off_m}");
        let mut stood: Vec<[f64; 2]> =
            (0..60).map(|_| [0.02 * gauss(&mut seed), 0.02 * gauss(&mut seed)]).collect();
        stood.extend(
            bend().iter().map(|[x, y]| [x + 0.02 * gauss(&mut seed), y + 0.02 * gauss(&mut seed)]),
        );
        let line = smooth(&stood, 1.0 / 5.0, 0.2);
        assert!(line.is_drivable && line.greatest_m < 0.12, "{line:?}");
    }
}
