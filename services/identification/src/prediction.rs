//! How well a vehicle's values predict where a car will be, over 1 s and 3 s of driving that no fit has seen.

use config::Vehicle;
use serde::Serialize;
use tracking::Turning;

use crate::drive::{STANDING_MPS, Stretch, walk};
use crate::speed;
use crate::steering::{block_of, blocks_of, wheels, yaw_rates};

/// A drive is fitted this many times without a part of it, so that each part is predicted once by a fit that has not seen
/// it.
pub(crate) const FOLDS: usize = 3;

/// Whether a block is held out in a fold.
pub(crate) fn is_held_out(block: usize, fold: usize) -> bool {
    block % FOLDS == fold
}

/// The longest step of integration.
const STEP_S: f64 = 0.01;

/// How far off a prediction is in the end.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Prediction {
    /// How far ahead.
    pub over_s: f64,
    /// Mean distance from where the car really was, with the values of the file.
    pub before_m: f64,
    /// That with the new values.
    pub after_m: f64,
    /// 95 % interval of the factor by which the distance shrinks (after/before, geometric mean over blocks).
    pub ratio: [f64; 2],
    /// Stretches of driving that were predicted.
    pub windows: usize,
}

impl Prediction {
    /// Whether the new values predict better, and not by chance.
    pub fn is_better(&self) -> bool {
        self.windows > 0 && self.after_m < self.before_m && self.ratio[1] < 1.0
    }
}

/// A vehicle whose odometry tells a point so far ahead of the rear axle.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Car<'a> {
    pub(crate) vehicle: &'a Vehicle,
    pub(crate) point_m: f64,
}

/// A block of a fold: the mean error of what was predicted in it with the file's values, with the new ones, and of how
/// many windows.
pub(crate) type Pair = (f64, f64, usize);

/// Predicts what a fold holds out with the file's values and with new ones.
pub(crate) fn pairs(
    stretches: &[Stretch],
    before: Car<'_>,
    after: Car<'_>,
    over_s: f64,
    fold: usize,
) -> Vec<Pair> {
    let old = errors(stretches, before, over_s, fold);
    let new = errors(stretches, after, over_s, fold);
    let mut blocks: Vec<(usize, Pair)> = Vec::new();
    for ((block, old), (_, new)) in old.into_iter().zip(new) {
        match blocks.last_mut() {
            Some((last, sums)) if *last == block => {
                *sums = (sums.0 + old, sums.1 + new, sums.2 + 1);
            }
            _ => blocks.push((block, (old, new, 1))),
        }
    }
    let mean =
        |(_, (old, new, count)): (usize, Pair)| (old / count as f64, new / count as f64, count);
    blocks.into_iter().map(mean).collect()
}

/// Sums up what was predicted over one horizon in all folds.
pub(crate) fn sum_up(pairs: &[Pair], over_s: f64) -> Prediction {
    // Below a millimetre, nothing is better than anything.
    let log = |error: f64| libm::log(error.max(1e-3));
    let count = pairs.len() as f64;
    // Windows of one block are not independent: what counts is the mean of a block.
    let ratios: Vec<f64> = pairs.iter().map(|(old, new, _)| log(*new) - log(*old)).collect();
    let middle = ratios.iter().sum::<f64>() / count.max(1.0);
    let scatter: f64 = ratios.iter().map(|ratio| (ratio - middle).powi(2)).sum();
    let half = match pairs.len() {
        0 | 1 => f64::INFINITY,
        blocks => student(blocks - 1) * (scatter / (count - 1.0) / count).sqrt(),
    };
    let windows: usize = pairs.iter().map(|it| it.2).sum();
    let mean = |of: fn(&Pair) -> f64| {
        pairs.iter().map(|pair| of(pair) * pair.2 as f64).sum::<f64>() / windows.max(1) as f64
    };
    Prediction {
        over_s,
        before_m: mean(|it| it.0),
        after_m: mean(|it| it.1),
        ratio: [libm::exp(middle - half), libm::exp(middle + half)],
        windows,
    }
}

/// Student's t, the quantile 97.5 %, within 1 % (Cornish–Fisher beyond 2 degrees of freedom).
fn student(freedom: usize) -> f64 {
    match freedom {
        0 => f64::INFINITY,
        1 => 12.706,
        2 => 4.303,
        freedom => {
            let (z, n) = (1.959_964_f64, freedom as f64);
            z + (z.powi(3) + z) / (4.0 * n)
                + (5.0 * z.powi(5) + 16.0 * z.powi(3) + 3.0 * z) / (96.0 * n * n)
                + (3.0 * z.powi(7) + 19.0 * z.powi(5) + 17.0 * z.powi(3) - 15.0 * z)
                    / (384.0 * n.powi(3))
        }
    }
}

/// Block and error of each prediction: within a block, one begins every second that leaves room for it.
fn errors(stretches: &[Stretch], car: Car<'_>, over_s: f64, fold: usize) -> Vec<(usize, f64)> {
    let mut errors = Vec::new();
    let mut first_block = 0;
    for stretch in stretches {
        let angles = wheels(stretch, car.vehicle);
        let rates = yaw_rates(stretch, car.vehicle, 1.0);
        let loops = speed::run(stretch, car.vehicle);
        let mut last_start_s = f64::NEG_INFINITY;
        for (index, state) in loops.iter().enumerate() {
            let (now_s, block) = (stretch.time_s[index], block_of(stretch, index));
            let is_due = now_s - last_start_s >= 1.0 - 1e-6;
            let end = stretch.time_s.partition_point(|time| *time < now_s + over_s - 1e-6);
            // A prediction over a whole block ends with the first sample of the next one.
            let within =
                end < stretch.len() && block_of(stretch, end.saturating_sub(2).max(index)) == block;
            let moves = stretch.smooth_mps[index] > STANDING_MPS;
            if !is_held_out(first_block + block, fold) || !is_due || !within || !moves {
                continue;
            }
            last_start_s = now_s;
            let from = From { state: *state, yaw_rate_radps: rates[index] };
            let (x_m, y_m) = way(stretch, car, &angles, from, index..end, |_, _| {});
            let [at_x, at_y] = place(stretch, end);
            errors.push((first_block + block, libm::hypot(x_m - at_x, y_m - at_y)));
        }
        first_block += blocks_of(stretch);
    }
    errors
}

/// Samples around one, as many on either side, within `reach_s`.
fn around(stretch: &Stretch, index: usize, reach_s: f64) -> std::ops::RangeInclusive<usize> {
    let reach = (reach_s / stretch.tick_s).round() as usize;
    let reach = reach.min(index).min(stretch.len() - 1 - index);
    index - reach..=index + reach
}

/// A measured position without most of its noise.
fn place(stretch: &Stretch, index: usize) -> [f64; 2] {
    let around = around(stretch, index, 0.1);
    let mut xs = stretch.x_m[around.clone()].to_vec();
    let mut ys = stretch.y_m[around].to_vec();
    let count = xs.len();
    // The mean without the ends: an outlier must not decide.
    let mean = |values: &mut Vec<f64>| {
        values.sort_by(f64::total_cmp);
        let cut = count / 5;
        values[cut..count - cut].iter().sum::<f64>() / (count - 2 * cut) as f64
    };
    [mean(&mut xs), mean(&mut ys)]
}

/// What a prediction begins with, beside the measured pose.
#[derive(Debug, Clone, Copy)]
pub(crate) struct From {
    pub(crate) state: speed::SpeedLoop,
    pub(crate) yaw_rate_radps: f64,
}

/// Where the odometry's point will be at the end of a range, from the commands alone; each place on the way there is passed
/// to `each`.
pub(crate) fn way(
    stretch: &Stretch,
    car: Car<'_>,
    angles: &[f64],
    From { mut state, yaw_rate_radps }: From,
    range: std::ops::Range<usize>,
    mut each: impl FnMut(f64, f64),
) -> (f64, f64) {
    let start = range.start;
    let [x_m, y_m] = place(stretch, start);
    let near = around(stretch, start, 0.25);
    let mut yaws = stretch.yaw_rad[near].to_vec();
    let mut yaw_rad = crate::levenberg::median(&mut yaws);
    let (sin, cos) = libm::sincos(yaw_rad);
    let (mut rear_x, mut rear_y) = (x_m - car.point_m * cos, y_m - car.point_m * sin);
    state.speed_mps = stretch.smooth_mps[start];
    let mut turning = Turning::new(car.vehicle);
    turning.set(yaw_rate_radps, turning.asked_radps(angles[start], state.speed_mps));
    let cut = Stretch {
        time_s: stretch.time_s[start..=range.end].to_vec(),
        commands: stretch.commands.clone(),
        x_m: Vec::new(),
        y_m: Vec::new(),
        yaw_rad: Vec::new(),
        speed_mps: Vec::new(),
        smooth_mps: Vec::new(),
        yaw_rate_radps: Vec::new(),
        ..*stretch
    };
    walk(&cut, car.vehicle.speed_delay_s, None, STEP_S, |index, command, held_s| {
        let before_mps = state.speed_mps;
        let share = speed::pedal_share(car.vehicle, held_s);
        state.step(car.vehicle, command.speed_mps, true, (held_s, share));
        let wheels = [angles[start + index - 1], angles[start + index]];
        let speed_mps = 0.5 * (before_mps + state.speed_mps);
        let turned = turning.turn_evenly(wheels, speed_mps, held_s);
        let (sin, cos) = libm::sincos(yaw_rad + 0.5 * turned);
        rear_x += speed_mps * held_s * cos;
        rear_y += speed_mps * held_s * sin;
        let out_m = car.vehicle.rear_slip_s2pm * speed_mps * speed_mps * turned;
        rear_x += out_m * sin;
        rear_y -= out_m * cos;
        yaw_rad += turned;
        let (sin, cos) = libm::sincos(yaw_rad);
        each(rear_x + car.point_m * cos, rear_y + car.point_m * sin);
    });
    let (sin, cos) = libm::sincos(yaw_rad);
    (rear_x + car.point_m * cos, rear_y + car.point_m * sin)
}
