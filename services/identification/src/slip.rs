//! How the rear axle slips, from poses and speed alone.
//!
//! A point p ahead of the rear axle moves at v forwards and at p·r − c·v²·r to the left, with the yaw rate r and the slip c
//! of the rear axle, its slip angle per lateral acceleration. So its way, with the measured heading θ, is
//!
//! P(t) = P₀ + ∫ s·v·(cos θ, sin θ) + m·v·(−sin θ, cos θ) dt + p·(cos θ, sin θ) + c·∫ v²·(sin θ, −cos θ) dθ,
//!
//! linear in the scale s of the speed, the small angle m between the heading and the direction of the car, p and c. Windows
//! have a start of their own. The commands do not appear: what a steering model misses, such as a yaw rate that lags behind
//! the wheels the more the faster the car is, would pass for slip.
//!
//! At one speed c·v² is the same as a point that lies so much farther back; bends at different speeds tell the two apart.

use nalgebra::{Matrix4, Vector4};

use crate::drive::Stretch;
use crate::fit::Z95;
use crate::levenberg::{HUBER, robust_sd, white_noise_sd};
use crate::steering::{block_of, blocks_of, windows};

/// The heading is a parabola over ± this time, without most of its noise.
const HEADING_S: f64 = 0.25;
/// Rounds of weighing anew.
const ROUNDS: usize = 3;

/// The slip of the rear axle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Slip {
    /// Slip angle per lateral acceleration, rad/(m/s²).
    pub(crate) at_s2pm: f64,
    /// Half the width of its 95 % interval.
    pub(crate) half_s2pm: f64,
    /// How far the point that suits the drive moves ahead for each rad/(m/s²) more of slip, in m.
    pub(crate) point_m_per_s2pm: f64,
}

/// One sample of a window: what its two coordinates are made of, less the window's means, and what was measured.
struct Sample {
    of: [Vector4<f64>; 2],
    measured: [f64; 2],
    /// How far a heading that is wrong by 1 rad here moves all that follows, of each coordinate.
    swings_m: [f64; 2],
}

impl Sample {
    fn residuals(&self, found: &Vector4<f64>) -> [f64; 2] {
        [0, 1].map(|axis| self.measured[axis] - self.of[axis].dot(found))
    }
}

/// Fits the slip to the windows of 3 s that count; `None` if the drive does not determine it at all.
///
/// The interval is the wider of two: that of white noise of headings and positions, where a wrong heading moves all that
/// follows in its window, and that of a regression whose errors go together within windows (Liang and Zeger, Biometrika 73,
/// 1986).
pub(crate) fn fit_slip(
    stretches: &[Stretch],
    wheelbase_m: f64,
    counts: &dyn Fn(usize) -> bool,
) -> Option<Slip> {
    let windows = all_windows(stretches, wheelbase_m, counts);
    let mut weights: Vec<Vec<f64>> = windows.iter().map(|it| vec![1.0; it.len()]).collect();
    let (mut found, mut inverse) = (Vector4::zeros(), Matrix4::zeros());
    for round in 0..ROUNDS {
        let (mut normal, mut side) = (Matrix4::zeros(), Vector4::zeros());
        for (weight, sample) in weights.iter().flatten().zip(windows.iter().flatten()) {
            for (of, measured) in sample.of.iter().zip(sample.measured) {
                normal += *weight * of * of.transpose();
                side += *weight * measured * of;
            }
        }
        inverse = normal.cholesky()?.inverse();
        found = inverse * side;
        if round + 1 < ROUNDS {
            let sizes = |sample: &Sample| sample.residuals(&found).into_iter();
            let sd = robust_sd(windows.iter().flatten().flat_map(sizes)).max(1e-6);
            for (weights, window) in weights.iter_mut().zip(&windows) {
                for (weight, sample) in weights.iter_mut().zip(window) {
                    let [x, y] = sample.residuals(&found);
                    *weight = (HUBER * sd / libm::hypot(x, y).max(1e-300)).min(1.0);
                }
            }
        }
    }
    let largest = |of: fn(&Stretch) -> f64| stretches.iter().map(of).fold(0.0, f64::max);
    let yaw_sd = largest(|it| white_noise_sd(it.yaw_rad.windows(4)));
    let position_sd =
        largest(|it| white_noise_sd(it.x_m.windows(4)).max(white_noise_sd(it.y_m.windows(4))));
    let (mut together, mut white) = (Matrix4::zeros(), Matrix4::zeros());
    for (window, weights) in windows.iter().zip(&weights) {
        let mut sum = Vector4::zeros();
        // Of all samples behind the present one.
        let mut behind = [Vector4::zeros(); 2];
        for (sample, weight) in window.iter().zip(weights).rev() {
            let swung = behind[0] * sample.swings_m[0] + behind[1] * sample.swings_m[1];
            white += yaw_sd * yaw_sd * swung * swung.transpose();
            for (axis, residual) in sample.residuals(&found).into_iter().enumerate() {
                let of = *weight * sample.of[axis];
                sum += residual * of;
                white += position_sd * position_sd * of * of.transpose();
                behind[axis] += of;
            }
        }
        together += sum * sum.transpose();
    }
    let variance = |scatter: Matrix4<f64>| (inverse * scatter * inverse)[(3, 3)];
    let half_s2pm = Z95 * variance(together).max(variance(white)).max(0.0).sqrt();
    // Of the other three, the best ones at another slip.
    let point_m_per_s2pm = inverse[(2, 3)] / inverse[(3, 3)];
    let slip = Slip { at_s2pm: found[3], half_s2pm, point_m_per_s2pm };
    (slip.at_s2pm.is_finite() && half_s2pm.is_finite()).then_some(slip)
}

fn all_windows(
    stretches: &[Stretch],
    wheelbase_m: f64,
    counts: &dyn Fn(usize) -> bool,
) -> Vec<Vec<Sample>> {
    let mut all = Vec::new();
    let mut first_block = 0;
    for stretch in stretches {
        let half = (HEADING_S / stretch.tick_s).round() as usize;
        let headings: Vec<f64> =
            (0..stretch.len()).map(|at| heading(&stretch.yaw_rad, at, half)).collect();
        for it in windows(stretch, wheelbase_m) {
            if it.moves && counts(first_block + block_of(stretch, it.range.start)) {
                all.push(samples(stretch, &headings, it.range));
            }
        }
        first_block += blocks_of(stretch);
    }
    all
}

/// The samples of a window.
fn samples(stretch: &Stretch, headings: &[f64], range: std::ops::Range<usize>) -> Vec<Sample> {
    let mut sums = [Vector4::zeros(); 2];
    let mut samples = Vec::new();
    for at in range.clone() {
        let (mut x_m, mut y_m) = (0.0, 0.0);
        if at > range.start {
            let held_s = stretch.time_s[at] - stretch.time_s[at - 1];
            let speed_mps = 0.5 * (stretch.smooth_mps[at - 1] + stretch.smooth_mps[at]);
            let turned = headings[at] - headings[at - 1];
            let (sin, cos) = libm::sincos(0.5 * (headings[at - 1] + headings[at]));
            (x_m, y_m) = (speed_mps * held_s * cos, speed_mps * held_s * sin);
            let squared = speed_mps * speed_mps * turned;
            sums[0] += Vector4::new(x_m, -y_m, 0.0, squared * sin);
            sums[1] += Vector4::new(y_m, x_m, 0.0, -squared * cos);
        }
        let (sin, cos) = libm::sincos(headings[at]);
        let mut of = sums;
        (of[0][2], of[1][2]) = (cos, sin);
        let measured = [stretch.x_m[at], stretch.y_m[at]];
        samples.push(Sample { of, measured, swings_m: [-y_m, x_m] });
    }
    let count = samples.len() as f64;
    for axis in 0..2 {
        let of = samples.iter().map(|it| it.of[axis]).sum::<Vector4<f64>>() / count;
        let measured = samples.iter().map(|it| it.measured[axis]).sum::<f64>() / count;
        for sample in &mut samples {
            sample.of[axis] -= of;
            sample.measured[axis] -= measured;
        }
    }
    samples
}

/// A heading without most of its noise: the value in the middle of the parabola that fits its neighbours best.
fn heading(yaw_rad: &[f64], at: usize, half: usize) -> f64 {
    let half = half.min(at).min(yaw_rad.len() - 1 - at);
    let reach = half as f64;
    // Savitzky and Golay's weights of second order.
    let (mut sum, mut weights) = (0.0, 0.0);
    for (step, yaw_rad) in yaw_rad[at - half..=at + half].iter().enumerate() {
        let off = step as f64 - reach;
        let weight = 3.0 * reach * (reach + 1.0) - 1.0 - 5.0 * off * off;
        sum += weight * yaw_rad;
        weights += weight;
    }
    if half < 2 { yaw_rad[at] } else { sum / weights }
}
