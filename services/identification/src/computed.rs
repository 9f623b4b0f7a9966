//! Odometry that is computed from the command instead of being measured.
//!
//! Some drivers (F1TENTH's `vesc_to_odom` by default) take the commanded steering angle for the real one: their yaw rate is
//! v·tan(δ)/L with the L of their own file. A fit to that returns this L, and no dead time, all with tiny intervals. Such a
//! yaw rate follows the command without any lag and without noise; a car has both.

use nalgebra::{Matrix6, Vector6};

use crate::drive::Stretch;
use crate::levenberg::median;
use crate::steering::rate_of_heading;

/// No steering is as fast as this.
const LAG_S: f64 = 0.02;
/// What a formula leaves: some roundings, or this share of the yaw rate.
const ROUNDINGS: f64 = 3.0;
const SHARE: f64 = 0.002;
/// Slower, a speed tells little.
const MOVING_MPS: f64 = 0.5;

/// What is wrong with a yaw rate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Computed {
    /// It is v·tan(command)/L.
    FromCommand { wheelbase_m: f64 },
    /// It is another function of the command alone, as with a servo's gain and trim.
    OfCommand,
    /// It is 0 while the car steers.
    Zero,
}

/// Looks whether the yaw rate of a drive was computed; one that has none is taken from its heading.
pub(crate) fn computed(stretches: &[Stretch]) -> Option<Computed> {
    let longest = stretches.iter().max_by_key(|it| it.len())?;
    let tick_s = longest.tick_s;
    let rates: Vec<f64> = match longest.yaw_rate_radps.iter().all(|rate| rate.is_finite()) {
        true => longest.yaw_rate_radps.clone(),
        false => {
            let slopes = longest.yaw_rad.windows(2).map(|two| (two[1] - two[0]) / tick_s);
            std::iter::once(0.0).chain(slopes).collect()
        }
    };
    let moving: Vec<usize> =
        (0..longest.len()).filter(|&at| longest.speed_mps[at] > MOVING_MPS).collect();
    let commands: Vec<f64> =
        longest.time_s.iter().map(|time| longest.command_at(*time).steering_rad).collect();
    let steering: Vec<usize> =
        moving.iter().copied().filter(|&at| commands[at].abs() > 0.05).collect();
    let rms = |at: &[usize]| {
        (at.iter().map(|&at| rates[at] * rates[at]).sum::<f64>() / at.len().max(1) as f64).sqrt()
    };
    if steering.len() as f64 * tick_s < 2.0 {
        return None;
    }
    if rms(&steering) < 1e-6 {
        return Some(Computed::Zero);
    }
    // What remains of the yaw rate after a dead time of whole ticks and a lag, and the wheelbase: medians, both.
    let score = |ticks: usize, lag_s: f64| {
        let mut angle = 0.0;
        let mut expected = vec![0.0; rates.len()];
        for at in 0..rates.len() {
            let held = if at >= ticks { commands[at - ticks] } else { 0.0 };
            let share = if lag_s == 0.0 { 1.0 } else { -libm::expm1(-tick_s / lag_s) };
            angle += share * (held - angle);
            expected[at] = longest.speed_mps[at] * libm::tan(angle);
        }
        let turning = moving.iter().filter(|&&at| rates[at].abs() > 0.05);
        let mut ratios: Vec<f64> = turning.map(|&at| expected[at] / rates[at]).collect();
        if ratios.is_empty() {
            return (f64::INFINITY, f64::INFINITY);
        }
        let wheelbase_m = median(&mut ratios);
        let left = moving.iter().map(|&at| (rates[at] - expected[at] / wheelbase_m).abs());
        (median(&mut left.collect::<Vec<f64>>()), wheelbase_m)
    };
    let mut best = (f64::INFINITY, 0.0, 0.0);
    for ticks in 0..5 {
        for lag_s in [0.0, 0.02, 0.04, 0.06, 0.09, 0.12, 0.16, 0.2, 0.3] {
            let (left, wheelbase_m) = score(ticks, lag_s);
            if left < best.0 {
                best = (left, lag_s, wheelbase_m);
            }
        }
    }
    let steps = rates.windows(2).map(|two| (two[1] - two[0]).abs()).filter(|step| *step > 0.0);
    let grain = steps.fold(f64::INFINITY, f64::min);
    let grain = if grain.is_finite() { grain } else { 0.0 };
    let (left, lag_s, wheelbase_m) = best;
    let most = (ROUNDINGS * grain).max(SHARE * rms(&moving));
    if lag_s < LAG_S && left < most {
        return Some(Computed::FromCommand { wheelbase_m });
    }
    let is_function = (0..5).any(|ticks| {
        let commands: Vec<f64> =
            (0..commands.len()).map(|at| commands[at.saturating_sub(ticks)]).collect();
        function_left(&commands, &rates, &longest.speed_mps, &moving).is_some_and(|it| it < most)
    });
    is_function.then_some(Computed::OfCommand)
}

/// What the best polynomial of the command leaves of the yaw rate while the command changes: a median. `None` if it hardly
/// ever does: at rest, wheels with a lag are where a function of the command would have them.
fn function_left(
    commands: &[f64],
    rates: &[f64],
    speed_mps: &[f64],
    moving: &[usize],
) -> Option<f64> {
    const CHANGED_RAD: f64 = 0.01;
    const WITHIN: usize = 3;
    const LEAST: usize = 50;
    // Powers of about 1 at most.
    let powers = |at: usize| {
        let x = commands[at] / 0.5;
        Vector6::new(1.0, x, x.powi(2), x.powi(3), x.powi(4), x.powi(5))
    };
    let (mut normal, mut right) = (Matrix6::zeros(), Vector6::zeros());
    for &at in moving {
        let powers = powers(at);
        normal += powers * powers.transpose();
        right += powers * (rates[at] / speed_mps[at]);
    }
    let weights = (normal + Matrix6::identity() * 1e-9).cholesky()?.solve(&right);
    let changes = |at: &&usize| {
        let before = commands[at.saturating_sub(WITHIN)];
        (commands[**at] - before).abs() > CHANGED_RAD
    };
    let mut left: Vec<f64> = moving
        .iter()
        .filter(changes)
        .map(|&at| (rates[at] - speed_mps[at] * powers(at).dot(&weights)).abs())
        .collect();
    (left.len() >= LEAST).then(|| median(&mut left))
}

/// Whether the measured speed is the commanded one: no car follows a changing command without delay.
pub(crate) fn speed_is_commanded(stretches: &[Stretch]) -> bool {
    const CHANGED_MPS: f64 = 0.05;
    const SHARE_OF_CHANGE: f64 = 0.02;
    const SHARE_OF_SAMPLES: f64 = 0.9;
    const WITHIN: usize = 5;
    const LEAST: usize = 20;
    let (mut all, mut alike) = (0, 0);
    for stretch in stretches {
        let commanded: Vec<f64> =
            stretch.time_s.iter().map(|time| stretch.command_at(*time).speed_mps).collect();
        for at in WITHIN..stretch.len() {
            let change = (commanded[at] - commanded[at - WITHIN]).abs();
            if change > CHANGED_MPS {
                let is_alike = |before: usize| {
                    (stretch.speed_mps[at] - commanded[at - before]).abs()
                        <= SHARE_OF_CHANGE * change
                };
                all += 1;
                alike += usize::from((0..3).any(is_alike));
            }
        }
    }
    all >= LEAST && f64::from(alike as u32) >= SHARE_OF_SAMPLES * f64::from(all as u32)
}

/// How well the yaw rate follows the commands: the correlation of largest size over some delays. Rates beyond those of nine
/// of ten samples are cut, as outliers must not decide.
pub(crate) fn follows(stretches: &[Stretch]) -> f64 {
    const HEADING_S: f64 = 0.2;
    let rate = |stretch: &Stretch, at: usize| match stretch.yaw_rate_radps[at] {
        rate if rate.is_finite() => rate,
        _ => rate_of_heading(stretch, at, HEADING_S),
    };
    let rates: Vec<Vec<f64>> =
        stretches.iter().map(|it| (0..it.len()).map(|at| rate(it, at)).collect()).collect();
    let mut sizes: Vec<f64> = rates.iter().flatten().map(|rate| rate.abs()).collect();
    let ninth = sizes.len() * 9 / 10;
    let limit =
        if sizes.is_empty() { 0.0 } else { *sizes.select_nth_unstable_by(ninth, f64::total_cmp).1 };
    let mut best = 0.0_f64;
    for delay_s in [0.0, 0.1, 0.2, 0.3, 0.4, 0.6, 0.8] {
        let (mut xx, mut yy, mut xy) = (0.0, 0.0, 0.0);
        for (stretch, rates) in stretches.iter().zip(&rates) {
            for (at, rate) in rates.iter().enumerate() {
                let rate = rate.clamp(-limit, limit);
                let command = stretch.command_at(stretch.time_s[at] - delay_s).steering_rad;
                let expected = stretch.smooth_mps[at] * libm::tan(command.clamp(-1.4, 1.4));
                (xx, yy, xy) = (xx + expected * expected, yy + rate * rate, xy + expected * rate);
            }
        }
        let correlation = if xx > 0.0 && yy > 0.0 { xy / (xx * yy).sqrt() } else { 0.0 };
        if correlation.abs() > best.abs() {
            best = correlation;
        }
    }
    best
}
