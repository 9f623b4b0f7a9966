//! The steering, the wheelbase and the odometry's point: yaw rate and pose, as they follow from the commands.
//!
//! The steering chain runs through the whole stretch on the commands alone. With the measured speed v (its noise taken
//! out, and multiplied by a scale s) it gives
//!
//! - the yaw rate r + b, where r comes to s·v·tan(δ)/(L + K·v²), the later the faster the car is ([`tracking::Turning`]), and
//!   b is the bias of the gyro;
//! - the pose in windows of 3 s: v and r integrated, with a rear axle that slips as [`crate::slip`] has found, seen at the
//!   odometry's point p ahead of it. Each window is laid over the measured one, headings and positions, by the rigid motion
//!   that fits best (in closed form), so that neither the start of the window nor drift counts. The poses may be older than
//!   the yaw rate: where one is measured, it tells the dead time.

use config::{Vehicle, VehicleModel};
use tracking::{SteeringActuator, SteeringStep, Turning};

use crate::drive::{ByLength, STANDING_MPS, Stretch, walk};
use crate::levenberg::{Axis, Model, Place};

pub(crate) const WHEELBASE: usize = 0;
pub(crate) const DELAY: usize = 1;
pub(crate) const LAG: usize = 2;
pub(crate) const RATE: usize = 3;
pub(crate) const OFFSET: usize = 4;
pub(crate) const GAIN: usize = 5;
pub(crate) const POINT: usize = 6;
pub(crate) const SCALE: usize = 7;
pub(crate) const BIAS: usize = 8;
/// Between the heading of the odometry and the direction of its axes, as of a sensor that is not mounted straight.
pub(crate) const MOUNTED: usize = 9;
/// Lag of the yaw rate for each m/s. At one speed it is the same as a longer lag of the steering.
pub(crate) const YAW_LAG: usize = 10;
/// Gradient of understeer. At one speed it is the same as a longer wheelbase.
pub(crate) const UNDERSTEER: usize = 11;
/// How much older the poses are than the yaw rate, in s: a filter of one of them is slower, or a simulator's pose is a part
/// of a tick ahead of its rates.
pub(crate) const POSE_AGE: usize = 12;
/// Where the wheels stop, as a logarithm: the file's limit, unless a drive shows that they stop before it.
pub(crate) const STOP: usize = 13;
const COUNT: usize = 14;
/// No car has more of either.
const MOST_S2PM: f64 = 0.05;

/// Channels of residuals.
const YAW_RATE: usize = 0;
pub(crate) const HEADING: usize = 1;
pub(crate) const POSITION: usize = 2;

/// Length of a window of poses, and of a block.
pub(crate) const WINDOW_S: f64 = 3.0;
/// How far a car has to go in a window, in wheelbases: half a metre of a family car.
const LEAST_TRAVEL: f64 = 0.17;
/// The heading's slope over ± this time stands in for a yaw rate that is not measured.
const HEADING_S: f64 = 0.05;
/// A lag that a file has not is looked for from here.
const NO_LAG_S: f64 = 0.05;
/// The chain begins with wheels whose angle is not known, unless the car stood.
const UNKNOWN_S: f64 = 1.5;

/// The logarithm of the slowest steering rate that is looked for, .02 rad/s; and the quickest one, rad/s.
const LEAST_LOG_RATE: f64 = -3.912;
const MOST_RATE_RADPS: f64 = 50.0;
/// No car steers less, or more, rad.
const LEAST_STOP_RAD: f64 = 0.02;
const MOST_STOP_RAD: f64 = 1.5;
/// Up to this lateral acceleration, tyres let a car turn as its wheels say.
pub(crate) const GRIP_MPS2: f64 = 3.0;
/// So many steps of the command, at least, tell how quick the wheels are.
const TELLING_STEPS: usize = 5;

/// Wheels turn by no more than so many times as much as they are told, where that is looked for.
const MOST_GAIN: f64 = 2.0;

/// A steering rate from which on the wheels keep up with these commands from one sample to the next: a quicker one cannot
/// show. What is held at the samples counts: commands may come several times between two of them. Single steps, as where a
/// recording begins, do not count. `gain`: by how many times as much as they are told the wheels turn.
fn quickest_radps(stretches: &[Stretch], gain: f64) -> f64 {
    let of_stretch = |it: &Stretch| {
        let held: Vec<f64> =
            it.time_s.iter().map(|&time| it.command_at(time).steering_rad).collect();
        let tick_s = it.tick_s;
        held.windows(2).map(|two| (two[1] - two[0]).abs() / tick_s).collect::<Vec<f64>>()
    };
    let mut rates: Vec<f64> = stretches.iter().flat_map(of_stretch).collect();
    rates.sort_unstable_by(|a, b| b.total_cmp(a));
    let rate = gain * rates.get(TELLING_STEPS - 1).copied().unwrap_or(0.0);
    rate.clamp(2.0 * libm::exp(LEAST_LOG_RATE), MOST_RATE_RADPS)
}

/// The values of a vehicle's file in the coordinates of the fit.
pub(crate) fn of_vehicle(vehicle: &Vehicle, point_m: f64) -> [f64; COUNT] {
    let mut at = [0.0; COUNT];
    at[WHEELBASE] = libm::log(vehicle.wheelbase_m);
    at[DELAY] = vehicle.steering_delay_s;
    at[LAG] =
        libm::log(if vehicle.steering_lag_s > 0.0 { vehicle.steering_lag_s } else { NO_LAG_S });
    at[RATE] = libm::log(vehicle.steering_rate_radps);
    at[OFFSET] = vehicle.steering_offset_rad;
    at[GAIN] = libm::log(vehicle.steering_gain);
    at[POINT] = point_m;
    at[YAW_LAG] = vehicle.yaw_lag_s2pm;
    at[UNDERSTEER] = vehicle.understeer_s2pm;
    at[STOP] = libm::log(vehicle.steering_limit_rad);
    at
}

/// The vehicle with the values of a fit; the odometry's point is not among its keys here.
pub(crate) fn to_vehicle(at: &[f64], vehicle: &Vehicle) -> Vehicle {
    let mut new = vehicle.clone();
    new.wheelbase_m = libm::exp(at[WHEELBASE]);
    new.steering_delay_s = at[DELAY];
    new.steering_lag_s = libm::exp(at[LAG]);
    new.steering_rate_radps = libm::exp(at[RATE]);
    new.steering_offset_rad = at[OFFSET];
    new.steering_gain = libm::exp(at[GAIN]);
    new.yaw_lag_s2pm = at[YAW_LAG];
    new.understeer_s2pm = at[UNDERSTEER];
    new.steering_limit_rad = libm::exp(at[STOP]);
    new
}

/// The angle of the road wheels at each sample.
pub(crate) fn wheels(stretch: &Stretch, vehicle: &Vehicle) -> Vec<f64> {
    let actuator = SteeringActuator::new(vehicle);
    let mut angle_rad =
        actuator.target_rad(stretch.first_acting(vehicle.steering_delay_s).steering_rad);
    let mut angles = vec![angle_rad; stretch.len()];
    let mut steps = ByLength::new();
    walk(stretch, vehicle.steering_delay_s, None, f64::INFINITY, |index, command, length_s| {
        let step = steps.get(length_s, || SteeringStep::new(actuator, length_s));
        angle_rad = step.turn(angle_rad, command.steering_rad);
        angles[index] = angle_rad;
    });
    angles
}

/// The yaw rate at each sample that a vehicle has behind its wheels, with the measured speed times `scale`.
pub(crate) fn yaw_rates(stretch: &Stretch, vehicle: &Vehicle, scale: f64) -> Vec<f64> {
    let mut turning = Turning::new(vehicle);
    let ask = |(angle, speed): (&f64, &f64)| turning.asked_radps(*angle, scale * speed);
    let angles = wheels(stretch, vehicle);
    let mut rates: Vec<f64> = angles.iter().zip(&stretch.smooth_mps).map(ask).collect();
    if vehicle.yaw_lag_s2pm == 0.0 {
        return rates;
    }
    turning.set(rates[0], rates[0]);
    for (index, rate) in rates.iter_mut().enumerate().skip(1) {
        let held_s = stretch.time_s[index] - stretch.time_s[index - 1];
        let speed_mps = 0.5 * (stretch.smooth_mps[index - 1] + stretch.smooth_mps[index]);
        turning.turn_to(*rate, scale * speed_mps, held_s);
        *rate = turning.yaw_rate_radps();
    }
    rates
}

/// What is fitted.
#[derive(Debug)]
pub(crate) struct Steering<'a> {
    stretches: &'a [Stretch],
    vehicle: Vehicle,
    pub(crate) axes: Vec<Axis>,
    places: Vec<Place>,
    floors: [f64; 3],
    has_yaw_rate: bool,
    with_poses: bool,
}

impl<'a> Steering<'a> {
    /// Of the yaw rate alone, or with the poses. Without a measured yaw rate, that of the heading stands in for it while the
    /// poses are left out.
    pub(crate) fn new(
        stretches: &'a [Stretch],
        vehicle: &Vehicle,
        point_m: f64,
        wheelbase_is_measured: bool,
        with_poses: bool,
    ) -> Self {
        let prior = of_vehicle(vehicle, point_m);
        let length_m = vehicle.wheelbase_m;
        let axis = |index: usize, low: f64, high: f64, prior_sd: f64, step: f64, free: bool| Axis {
            low,
            high,
            prior: prior[index],
            prior_sd,
            file: if index == LAG && vehicle.steering_lag_s == 0.0 { low } else { prior[index] },
            step,
            is_two_sided: false,
            free,
        };
        let log = libm::log;
        // The dynamic model's tyres slip by themselves.
        let slips = vehicle.model == VehicleModel::Kinematic;
        let has_yaw_rate =
            stretches.iter().all(|it| it.yaw_rate_radps.iter().all(|rate| rate.is_finite()));
        let gain = if wheelbase_is_measured { MOST_GAIN } else { vehicle.steering_gain };
        let axes = vec![
            axis(WHEELBASE, prior[0] - 2.0, prior[0] + 2.0, 0.7, 1e-5, !wheelbase_is_measured),
            axis(DELAY, 0.0, 0.95, 0.3, 1e-4, true),
            axis(LAG, log(0.002), log(3.0), 1.2, 1e-4, true),
            axis(RATE, LEAST_LOG_RATE, log(quickest_radps(stretches, gain)), 1.2, 1e-4, true),
            axis(OFFSET, -0.4, 0.4, 0.1, 1e-6, true),
            axis(GAIN, log(0.1), log(10.0), 0.7, 1e-5, wheelbase_is_measured),
            axis(POINT, -7.0 * length_m, 7.0 * length_m, 0.7 * length_m, 1e-4, with_poses),
            axis(SCALE, -0.3, 0.3, 0.1, 1e-6, with_poses),
            axis(BIAS, -0.2, 0.2, 0.02, 1e-6, with_poses),
            axis(MOUNTED, -0.5, 0.5, 0.1, 1e-6, with_poses),
            axis(YAW_LAG, 0.0, MOST_S2PM, 0.02, 1e-6, with_poses && slips),
            axis(UNDERSTEER, 0.0, MOST_S2PM, 0.02, 1e-6, with_poses && slips),
            axis(POSE_AGE, -0.3, 0.3, 0.02, 1e-4, with_poses && has_yaw_rate),
            axis(STOP, log(LEAST_STOP_RAD), log(MOST_STOP_RAD), 1.2, 1e-5, false),
        ];
        let mut new = Self {
            stretches,
            vehicle: vehicle.clone(),
            axes,
            places: Vec::new(),
            floors: [1e-5, 1e-5, 1e-4 * length_m],
            has_yaw_rate,
            with_poses,
        };
        new.places = new.lay_out();
        new
    }

    /// The largest angle that commands ask the wheels for, by a fit, whatever they can do: while the car moves, as others show
    /// nothing, and but for one sample in a hundred, as a single slip must not hide where the wheels stop.
    pub(crate) fn most_asked_rad(&self, at: &[f64]) -> f64 {
        let (gain, offset_rad) = (libm::exp(at[GAIN]), at[OFFSET]);
        let of_stretch = |it: &Stretch| {
            let moving = it.time_s.iter().zip(&it.smooth_mps).filter(|(_, v)| **v > STANDING_MPS);
            let asked = |time: f64| (gain * it.command_at(time).steering_rad + offset_rad).abs();
            moving.map(|(time, _)| asked(*time)).collect::<Vec<f64>>()
        };
        let mut asked: Vec<f64> = self.stretches.iter().flat_map(of_stretch).collect();
        asked.sort_by(f64::total_cmp);
        asked.get(99 * asked.len() / 100).map_or(LEAST_STOP_RAD, |it| it.max(LEAST_STOP_RAD))
    }

    /// For each residual of a fit to the yaw rate alone, whether the tyres are far from their limit at its sample.
    pub(crate) fn have_grip(&self) -> Vec<bool> {
        let of_stretch = |it: &Stretch| {
            let rate = |at: usize| match self.has_yaw_rate {
                true => it.yaw_rate_radps[at],
                false => rate_of_heading(it, at, HEADING_S),
            };
            let has = |at: usize| (it.smooth_mps[at] * rate(at)).abs() <= GRIP_MPS2;
            (0..it.len()).map(has).collect::<Vec<bool>>()
        };
        self.stretches.iter().flat_map(of_stretch).collect()
    }

    fn lay_out(&self) -> Vec<Place> {
        let mut places = Vec::new();
        let mut first_block = 0;
        for stretch in self.stretches {
            let block = |index: usize| first_block + block_of(stretch, index);
            let mut put = |channel: usize, telling: &dyn Fn(usize) -> bool| {
                let place = |index| Place { channel, block: block(index), telling: telling(index) };
                places.extend((0..stretch.len()).map(place));
            };
            if self.uses_yaw_rate() {
                put(YAW_RATE, &|index| is_moving(stretch, index));
            }
            if self.with_poses {
                let windows = windows(stretch, self.vehicle.wheelbase_m);
                let moves =
                    |index: usize| windows.iter().any(|it| it.range.contains(&index) && it.moves);
                for channel in [HEADING, POSITION, POSITION] {
                    put(channel, &moves);
                }
            }
            first_block += blocks_of(stretch);
        }
        places
    }

    fn uses_yaw_rate(&self) -> bool {
        self.has_yaw_rate || !self.with_poses
    }
}

/// The number of a sample's block within its stretch.
pub(crate) fn block_of(stretch: &Stretch, index: usize) -> usize {
    ((stretch.time_s[index] - stretch.time_s[0]) / WINDOW_S) as usize
}

/// How many blocks a stretch has.
pub(crate) fn blocks_of(stretch: &Stretch) -> usize {
    block_of(stretch, stretch.len() - 1) + 1
}

/// Whether a sample tells something about the steering.
fn is_moving(stretch: &Stretch, index: usize) -> bool {
    let since_s = stretch.time_s[index] - stretch.time_s[0];
    stretch.smooth_mps[index] > STANDING_MPS && (stretch.from_rest || since_s > UNKNOWN_S)
}

/// A window of poses.
#[derive(Debug, Clone)]
pub(crate) struct Window {
    pub(crate) range: std::ops::Range<usize>,
    /// Whether the car moves in it far enough to tell a direction.
    pub(crate) moves: bool,
}

/// The windows of a stretch: its blocks. A small car need not go as far as a large one.
pub(crate) fn windows(stretch: &Stretch, wheelbase_m: f64) -> Vec<Window> {
    let least_m = LEAST_TRAVEL * wheelbase_m;
    let mut windows = Vec::new();
    let mut first = 0;
    while first < stretch.len() {
        let block = block_of(stretch, first);
        let mut end = first;
        while end < stretch.len() && block_of(stretch, end) == block {
            end += 1;
        }
        let travel_m: f64 = stretch.smooth_mps[first..end].iter().sum::<f64>() * stretch.tick_s;
        let known = stretch.from_rest || block > 0;
        windows.push(Window {
            range: first..end,
            moves: known && travel_m > least_m && end - first > 9,
        });
        first = end;
    }
    windows
}

/// The yaw rate that a heading tells: its slope over ± `reach_s`.
pub(crate) fn rate_of_heading(stretch: &Stretch, index: usize, reach_s: f64) -> f64 {
    let half = ((reach_s / stretch.tick_s).round() as usize).max(1);
    let (from, to) = (index.saturating_sub(half), (index + half).min(stretch.len() - 1));
    (stretch.yaw_rad[to] - stretch.yaw_rad[from]) / (stretch.time_s[to] - stretch.time_s[from])
}

impl Model for Steering<'_> {
    fn axes(&self) -> &[Axis] {
        &self.axes
    }

    fn places(&self) -> &[Place] {
        &self.places
    }

    fn floors(&self) -> &[f64] {
        &self.floors
    }

    fn residuals(&self, at: &[f64], weights: &[f64], out: &mut [f64]) {
        let vehicle = to_vehicle(at, &self.vehicle);
        let scale = libm::exp(at[SCALE]);
        let mut first = 0;
        for stretch in self.stretches {
            let len = stretch.len();
            let rates = yaw_rates(stretch, &vehicle, scale);
            if self.uses_yaw_rate() {
                for index in 0..len {
                    out[first + index] = if !is_moving(stretch, index) {
                        0.0
                    } else if self.has_yaw_rate {
                        stretch.yaw_rate_radps[index] - rates[index] - at[BIAS]
                    } else {
                        rate_of_heading(stretch, index, HEADING_S) - rates[index]
                    };
                }
                first += len;
            }
            if self.with_poses {
                let (heading, rest) = out[first..first + 3 * len].split_at_mut(len);
                let (x, y) = rest.split_at_mut(len);
                let weights = &weights[first..first + 3 * len];
                let (point_m, mounted_rad) = (at[POINT], at[MOUNTED]);
                let slip_s2pm = vehicle.rear_slip_s2pm;
                let age_s = at[POSE_AGE];
                let track =
                    Track { stretch, rates: &rates, scale, point_m, slip_s2pm, mounted_rad, age_s };
                for window in windows(stretch, self.vehicle.wheelbase_m) {
                    let range = window.range.clone();
                    if window.moves {
                        track.compare(&window, weights, [&mut *heading, &mut *x, &mut *y]);
                    } else {
                        for channel in [&mut *heading, &mut *x, &mut *y] {
                            channel[range.clone()].fill(0.0);
                        }
                    }
                }
                first += 3 * len;
            }
        }
    }
}

/// A track by dead reckoning.
struct Track<'a> {
    stretch: &'a Stretch,
    rates: &'a [f64],
    scale: f64,
    point_m: f64,
    slip_s2pm: f64,
    mounted_rad: f64,
    age_s: f64,
}

impl Track<'_> {
    /// Measured minus expected heading, x and y in a window. `weights`: those of heading, x and y of the whole stretch.
    fn compare(&self, window: &Window, weights: &[f64], [heading, x, y]: [&mut [f64]; 3]) {
        let (stretch, len) = (self.stretch, self.stretch.len());
        let (mut yaw_rad, mut rear_x, mut rear_y) = (0.0_f64, 0.0, 0.0);
        let range = window.range.clone();
        for index in range.clone() {
            if index > range.start {
                let held_s = stretch.time_s[index] - stretch.time_s[index - 1];
                let turned = 0.5 * (self.rates[index - 1] + self.rates[index]) * held_s;
                let speed = 0.5 * (stretch.smooth_mps[index - 1] + stretch.smooth_mps[index]);
                let (sin, cos) = libm::sincos(yaw_rad + 0.5 * turned);
                rear_x += self.scale * speed * held_s * cos;
                rear_y += self.scale * speed * held_s * sin;
                let out_m = self.slip_s2pm * (self.scale * speed).powi(2) * turned;
                rear_x += out_m * sin;
                rear_y -= out_m * cos;
                yaw_rad += turned;
            }
            // Where it was when the pose was taken.
            let yaw_then_rad = yaw_rad - self.age_s * self.rates[index];
            let (sin, cos) = libm::sincos(yaw_then_rad);
            let ahead_m = self.point_m - self.age_s * self.scale * stretch.smooth_mps[index];
            heading[index] = yaw_then_rad;
            (x[index], y[index]) = (rear_x + ahead_m * cos, rear_y + ahead_m * sin);
        }
        // Outliers must not move the window either. The tiny number keeps a window without weights defined.
        let weight = |index: usize| weights[len + index] * weights[2 * len + index] + 1e-12;
        let yaw_weight = |index: usize| weights[index] * weights[index] + 1e-12;
        let mut sums = [0.0; 7];
        for index in range.clone() {
            let (w, h) = (weight(index), yaw_weight(index));
            let (measured_x, measured_y) = (stretch.x_m[index], stretch.y_m[index]);
            let of = [w, w * x[index], w * y[index], w * measured_x, w * measured_y];
            let yaw = [h, h * (stretch.yaw_rad[index] - heading[index])];
            for (sum, of) in sums.iter_mut().zip(of.into_iter().chain(yaw)) {
                *sum += of;
            }
        }
        let [w, model_x, model_y, at_x, at_y, h, yaw] = sums;
        let (model_x, model_y, at_x, at_y) = (model_x / w, model_y / w, at_x / w, at_y / w);
        let (mut dot, mut cross) = (0.0, 0.0);
        for index in range.clone() {
            let (mx, my) = (x[index] - model_x, y[index] - model_y);
            let (dx, dy) = (stretch.x_m[index] - at_x, stretch.y_m[index] - at_y);
            dot += weight(index) * (mx * dx + my * dy);
            cross += weight(index) * (mx * dy - my * dx);
        }
        // The rotation that suits the positions, moved towards the one that suits the headings by how much each of them
        // would mind.
        let by_positions = libm::atan2(cross, dot);
        let by_headings = yaw / h - self.mounted_rad;
        let share = h / (h + libm::hypot(cross, dot));
        let turned = by_positions + share * tracking::wrap_angle(by_headings - by_positions);
        let (sin, cos) = libm::sincos(turned);
        let off = tracking::wrap_angle(by_headings - turned) - by_headings;
        for index in range {
            let (mx, my) = (x[index] - model_x, y[index] - model_y);
            x[index] = stretch.x_m[index] - at_x - (cos * mx - sin * my);
            y[index] = stretch.y_m[index] - at_y - (sin * mx + cos * my);
            heading[index] = stretch.yaw_rad[index] - heading[index] - self.mounted_rad + off;
        }
    }
}
