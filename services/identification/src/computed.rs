//! Odometry that is computed from the command instead of being measured.
//!
//! Some drivers (F1TENTH's `vesc_to_odom` by default) take the commanded steering angle for the real one: their yaw rate is
//! v·tan(δ)/L with the L of their own file. A fit to that returns this L, and no dead time, all with tiny intervals. Such a
//! yaw rate follows the command without any lag and without noise; a car has both.

use nalgebra::{Matrix6, Vector6};

use crate::drive::{STANDING_MPS, Stretch};
use crate::levenberg::median;
use crate::steering::rate_of_heading;

/// No steering is as fast as this.
const LAG_S: f64 = 0.02;
/// A driver that computes is no later than this, or one sample. Dead times of cars are longer.
const LATE_S: f64 = 0.05;
/// What a formula leaves of a yaw rate at the median, as a share of it; more where it is rounded coarsely, but never more than
/// the other share, as a lag leaves that much in gentle bends.
const SHARE: f64 = 0.002;
const MOST_SHARE: f64 = 0.01;
/// The grain of a yaw rate is coarse where so many of them are more than that share. A formula then leaves no more than one
/// grain in as many samples of all.
const ROUNDINGS: f64 = 3.0;
const WITHIN_A_GRAIN: f64 = 0.9;
/// Differences that are smaller are those of binary numbers.
const NO_GRAIN: f64 = 1e-9;
/// A car has to steer for so long, and to change its steering for so long, to tell whether its yaw rate is a formula's.
const STEERING_S: f64 = 2.0;
const CHANGING_S: f64 = 1.0;
/// It steers beyond this angle.
const STEERING_RAD: f64 = 0.05;
/// What wheels do with a change shows for so long, if it is more than this share of the largest angle. At rest, wheels with a
/// lag are where a formula would have them.
const SHOWS_S: f64 = 0.3;
const CHANGE_SHARE: f64 = 0.02;

/// What is wrong with a yaw rate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Computed {
    /// It is v·tan(command)/L.
    FromCommand { wheelbase_m: f64 },
    /// It is another function of the command alone, as with a servo's gain and trim.
    OfCommand,
    /// It is 0 while the car steers.
    Zero,
    /// In no stretch the car steers enough to tell.
    Unknown,
}

/// Looks whether the yaw rate of a drive was computed, in each of its stretches; one that has none is taken from its heading.
pub(crate) fn computed(stretches: &[Stretch]) -> Option<Computed> {
    let verdicts: Vec<Option<Computed>> = stretches.iter().map(of_stretch).collect();
    let is_known = |it: &&Computed| **it != Computed::Unknown;
    match verdicts.iter().flatten().find(is_known) {
        None if verdicts.iter().all(Option::is_some) => Some(Computed::Unknown),
        wrong => wrong.copied(),
    }
}

fn of_stretch(stretch: &Stretch) -> Option<Computed> {
    let Some(seen) = Seen::of(stretch) else { return Some(Computed::Unknown) };
    let yaw_rates = &stretch.yaw_rate_radps;
    if yaw_rates.iter().all(|rate| rate.is_finite()) {
        return seen.verdict(yaw_rates, grain(yaw_rates));
    }
    // Drivers integrate by the time that passed, or by a tick of their own. Arrivals differ from both.
    let turned: Vec<f64> = stretch.yaw_rad.windows(2).map(|two| two[1] - two[0]).collect();
    let rounded = grain(&turned) / stretch.tick_s;
    let rates = |held_s: &dyn Fn(usize) -> f64| -> Vec<f64> {
        let slopes = turned.iter().enumerate().map(|(at, turned)| turned / held_s(at));
        std::iter::once(0.0).chain(slopes).collect()
    };
    let passed = rates(&|at| stretch.time_s[at + 1] - stretch.time_s[at]);
    seen.verdict(&passed, rounded).or_else(|| seen.verdict(&rates(&|_| stretch.tick_s), rounded))
}

/// The least difference between neighbours, as of numbers that were rounded; 0 if there is none.
fn grain(values: &[f64]) -> f64 {
    let steps = values.windows(2).map(|two| (two[1] - two[0]).abs()).filter(|it| *it > NO_GRAIN);
    let grain = steps.fold(f64::INFINITY, f64::min);
    if grain.is_finite() { grain } else { 0.0 }
}

/// A stretch in which the car steers enough to tell.
struct Seen<'a> {
    stretch: &'a Stretch,
    /// The angle that was commanded last, at each sample.
    commands: Vec<f64>,
    /// Samples at which the car moves, of these the ones at which it steers, and at which its command has just changed.
    moving: Vec<usize>,
    steering: Vec<usize>,
    changing: Vec<usize>,
    /// By how many samples a formula may be late.
    most_late: usize,
}

impl<'a> Seen<'a> {
    fn of(stretch: &'a Stretch) -> Option<Self> {
        let tick_s = stretch.tick_s;
        let commands: Vec<f64> =
            stretch.time_s.iter().map(|&time| stretch.command_at(time).steering_rad).collect();
        let moving: Vec<usize> =
            (0..stretch.len()).filter(|&at| stretch.speed_mps[at] > STANDING_MPS).collect();
        let of_moving = |is: &dyn Fn(usize) -> bool| -> Vec<usize> {
            moving.iter().copied().filter(|&at| is(at)).collect()
        };
        let steering = of_moving(&|at| commands[at].abs() > STEERING_RAD);
        let most_rad = steering.iter().fold(0.0_f64, |most, &at| most.max(commands[at].abs()));
        let shows = (SHOWS_S / tick_s).ceil() as usize;
        let changing = of_moving(&|at| {
            let change = commands[at] - commands[at.saturating_sub(shows)];
            change.abs() > CHANGE_SHARE * most_rad
        });
        let seconds = |of: &[usize]| of.len() as f64 * tick_s;
        let tells = seconds(&steering) >= STEERING_S && seconds(&changing) >= CHANGING_S;
        let most_late = ((LATE_S / tick_s + 1e-6) as usize).max(1);
        tells.then_some(Self { stretch, commands, moving, steering, changing, most_late })
    }

    fn verdict(&self, rates: &[f64], grain: f64) -> Option<Computed> {
        let rms = |at: &[usize]| {
            (at.iter().map(|&at| rates[at] * rates[at]).sum::<f64>() / at.len() as f64).sqrt()
        };
        if rms(&self.steering) < 1e-6 {
            return Some(Computed::Zero);
        }
        let rms = rms(&self.moving);
        let is_coarse = ROUNDINGS * grain > SHARE * rms;
        let most = (ROUNDINGS * grain).max(SHARE * rms).min(MOST_SHARE * rms);
        let is_formula = |left: &mut [f64]| {
            let within = left.iter().filter(|it| **it <= grain).count() as f64;
            median(left) < most && (!is_coarse || within >= WITHIN_A_GRAIN * left.len() as f64)
        };
        let mut best = (f64::INFINITY, 0.0, 0.0, Vec::new());
        // The speed in the formula is the one that is told, or one that has not its noise.
        let speeds = [&self.stretch.speed_mps, &self.stretch.smooth_mps];
        let tries = || (0..=self.most_late).flat_map(|late| speeds.map(|speed| (late, speed)));
        for (late, speed_mps) in tries() {
            for lag_s in [0.0, 0.02, 0.04, 0.06, 0.09, 0.12, 0.16, 0.2, 0.3] {
                let (mut left, wheelbase_m) = self.formula_left(rates, speed_mps, late, lag_s);
                let middle = median(&mut left);
                if middle < best.0 {
                    best = (middle, lag_s, wheelbase_m, left);
                }
            }
        }
        let (_, lag_s, wheelbase_m, mut left) = best;
        if !left.is_empty() && lag_s < LAG_S && is_formula(&mut left) {
            return Some(Computed::FromCommand { wheelbase_m });
        }
        let is_function = |(late, speed_mps): (usize, &Vec<f64>)| {
            let left = self.function_left(rates, speed_mps, late);
            left.is_some_and(|mut left| is_formula(&mut left))
        };
        tries().any(is_function).then_some(Computed::OfCommand)
    }

    /// The command of so many samples before.
    fn before(&self, at: usize, late: usize) -> f64 {
        if at >= late { self.commands[at - late] } else { 0.0 }
    }

    /// What v·tan(angle)/L leaves of the yaw rate while the command changes, for an angle that is so many samples late and has
    /// a lag, and this L.
    fn formula_left(
        &self,
        rates: &[f64],
        speed_mps: &[f64],
        late: usize,
        lag_s: f64,
    ) -> (Vec<f64>, f64) {
        /// Of the yaw rate's largest value, from which on it tells L.
        const TELLING: f64 = 0.2;
        let stretch = self.stretch;
        let mut angle = 0.0;
        let mut expected = vec![0.0; rates.len()];
        for (at, expected) in expected.iter_mut().enumerate() {
            let held_s = if at > 0 { stretch.time_s[at] - stretch.time_s[at - 1] } else { 0.0 };
            let share = if lag_s == 0.0 { 1.0 } else { -libm::expm1(-held_s / lag_s) };
            angle += share * (self.before(at, late) - angle);
            *expected = speed_mps[at] * libm::tan(angle);
        }
        let most = self.moving.iter().fold(0.0_f64, |most, &at| most.max(expected[at].abs()));
        let turning = self.moving.iter().filter(|&&at| expected[at].abs() > TELLING * most);
        // Upside down, as a yaw rate may be 0.
        let mut ratios: Vec<f64> = turning.map(|&at| rates[at] / expected[at]).collect();
        let per_m = median(&mut ratios);
        let left = self.changing.iter().map(|&at| (rates[at] - expected[at] * per_m).abs());
        (left.collect(), 1.0 / per_m)
    }

    /// What the best polynomial of the command leaves of the yaw rate while the command changes.
    fn function_left(&self, rates: &[f64], speed_mps: &[f64], late: usize) -> Option<Vec<f64>> {
        // Powers of about 1 at most.
        let expected = |at: usize| {
            let x = self.before(at, late) / 0.5;
            speed_mps[at] * Vector6::new(1.0, x, x.powi(2), x.powi(3), x.powi(4), x.powi(5))
        };
        let (mut normal, mut right) = (Matrix6::zeros(), Vector6::zeros());
        for &at in &self.moving {
            let expected = expected(at);
            normal += expected * expected.transpose();
            right += expected * rates[at];
        }
        let weights = (normal + Matrix6::identity() * 1e-9).cholesky()?.solve(&right);
        let left = self.changing.iter().map(|&at| (rates[at] - expected(at).dot(&weights)).abs());
        Some(left.collect())
    }
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
/// of ten samples are cut, and commands beyond those of 99 of 100, as outliers and slips must not decide.
pub(crate) fn follows(stretches: &[Stretch]) -> f64 {
    const HEADING_S: f64 = 0.2;
    let rate = |stretch: &Stretch, at: usize| match stretch.yaw_rate_radps[at] {
        rate if rate.is_finite() => rate,
        _ => rate_of_heading(stretch, at, HEADING_S),
    };
    let asked = |stretch: &Stretch, at: usize, delay_s: f64| {
        let command = stretch.command_at(stretch.time_s[at] - delay_s).steering_rad;
        stretch.smooth_mps[at] * libm::tan(command.clamp(-1.4, 1.4))
    };
    let each = |of: &dyn Fn(&Stretch, usize) -> f64| -> Vec<Vec<f64>> {
        stretches.iter().map(|it| (0..it.len()).map(|at| of(it, at)).collect()).collect()
    };
    let rates = each(&rate);
    let limit = quantile_of_sizes(&rates, 0.9);
    let asked_limit = quantile_of_sizes(&each(&|it, at| asked(it, at, 0.0)), 0.99);
    let mut best = 0.0_f64;
    for delay_s in [0.0, 0.1, 0.2, 0.3, 0.4, 0.6, 0.8] {
        let (mut xx, mut yy, mut xy) = (0.0, 0.0, 0.0);
        for (stretch, rates) in stretches.iter().zip(&rates) {
            for (at, rate) in rates.iter().enumerate() {
                let rate = rate.clamp(-limit, limit);
                let expected = asked(stretch, at, delay_s).clamp(-asked_limit, asked_limit);
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

/// The size that so many of all values do not exceed; 0 of nothing.
fn quantile_of_sizes(values: &[Vec<f64>], share: f64) -> f64 {
    let mut sizes: Vec<f64> = values.iter().flatten().map(|it| it.abs()).collect();
    let place = (share * sizes.len() as f64) as usize;
    if sizes.is_empty() { 0.0 } else { *sizes.select_nth_unstable_by(place, f64::total_cmp).1 }
}
