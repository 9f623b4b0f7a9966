//! The speed loop: the speed as it follows from the commands.
//!
//! The model is that of the plant, in the plant's own steps (which end where commands of speed or steering arrive), so that
//! the values that are found are those with which the plant drives as the car did: a command arrives after its dead time at a PI controller, whose output is throttle or
//! brake, each behind a first-order lag. It runs through the whole stretch on the commands alone.
//!
//! As long as no pedal is at its end, kp and the acceleration at full throttle act as a product alone. The coordinates are
//! therefore the products kp·a and ki·a, a itself (which only a pedal at its end, or the integral at its bound, tells), and
//! the ratio of brake to throttle.

use config::Vehicle;

use crate::drive::{ByLength, STANDING_MPS, Stretch, walk};
use crate::levenberg::{Axis, Model, Place};
use crate::steering::{block_of, blocks_of};

pub(crate) const DELAY: usize = 0;
pub(crate) const KP: usize = 1;
pub(crate) const KI: usize = 2;
pub(crate) const THROTTLE: usize = 3;
pub(crate) const BRAKE: usize = 4;
pub(crate) const PEDAL_LAG: usize = 5;
pub(crate) const DRAG: usize = 6;
pub(crate) const ROLLING: usize = 7;
const COUNT: usize = 8;

/// The longest step of integration.
const STEP_S: f64 = 0.01;
/// The plant's steps make the speed a function of the dead time that has a kink at each whole tick and is nearly flat just
/// below: the slope is taken over half a tick.
const DELAY_STEP_S: f64 = 0.0025;
/// The largest acceleration, 30 m/s², and the largest ratio of brake to throttle, as logarithms.
const MOST_PEDAL: f64 = 3.4;
/// So long the speed loop's inner state tells on the speed, where the recording begins within a drive.
const UNKNOWN_S: f64 = 4.0;

/// The values of a vehicle's file in the coordinates of the fit. What is 0 there is looked for from a small value.
pub(crate) fn of_vehicle(vehicle: &Vehicle) -> [f64; COUNT] {
    let log = |value: f64, small: f64| libm::log(value.max(small));
    let throttle = vehicle.throttle_accel_mps2;
    [
        vehicle.speed_delay_s,
        log(vehicle.speed_kp * throttle, 0.05),
        log(vehicle.speed_ki * throttle, 0.005),
        libm::log(throttle),
        libm::log(vehicle.brake_decel_mps2 / throttle),
        log(vehicle.pedal_lag_s, 0.005),
        log(vehicle.drag_per_s, 0.01),
        log(vehicle.rolling_decel_mps2, 0.01),
    ]
}

/// The vehicle with the values of a fit.
pub(crate) fn to_vehicle(at: &[f64], vehicle: &Vehicle) -> Vehicle {
    let throttle = libm::exp(at[THROTTLE]);
    let mut new = vehicle.clone();
    new.speed_delay_s = at[DELAY];
    new.speed_kp = libm::exp(at[KP]) / throttle;
    new.speed_ki = libm::exp(at[KI]) / throttle;
    new.throttle_accel_mps2 = throttle;
    new.brake_decel_mps2 = libm::exp(at[BRAKE]) * throttle;
    new.pedal_lag_s = libm::exp(at[PEDAL_LAG]);
    new.drag_per_s = libm::exp(at[DRAG]);
    new.rolling_decel_mps2 = libm::exp(at[ROLLING]);
    new
}

/// The loop's state.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct SpeedLoop {
    pub(crate) speed_mps: f64,
    integral: f64,
    throttle: f64,
    brake: f64,
}

impl SpeedLoop {
    /// Midway in a drive: with the pedals that make this acceleration, as the loop presses them under this command.
    fn midway(vehicle: &Vehicle, speed_mps: f64, accel_mps2: f64, command_mps: f64) -> Self {
        let needed_mps2 = accel_mps2 + vehicle.drag_per_s * speed_mps + vehicle.rolling_decel_mps2;
        let most_mps2 = match needed_mps2 >= 0.0 {
            true => vehicle.throttle_accel_mps2,
            false => vehicle.brake_decel_mps2,
        };
        let pedal = (needed_mps2 / most_mps2).clamp(-1.0, 1.0);
        let integral = (pedal - vehicle.speed_kp * (command_mps - speed_mps))
            .clamp(vehicle.speed_integral_min, vehicle.speed_integral_max);
        Self { speed_mps, integral, throttle: pedal.max(0.0), brake: (-pedal).max(0.0) }
    }

    /// One step under a command, as the plant takes it. `share`: of its way that a pedal makes in it.
    pub(crate) fn step(
        &mut self,
        vehicle: &Vehicle,
        command_mps: f64,
        engaged: bool,
        (held_s, share): (f64, f64),
    ) {
        let command_mps = command_mps.min(vehicle.speed_limit_mps);
        let error = command_mps - self.speed_mps;
        self.integral = (self.integral + vehicle.speed_ki * error * held_s)
            .clamp(vehicle.speed_integral_min, vehicle.speed_integral_max);
        let mut pedals = (vehicle.speed_kp * error + self.integral).clamp(-1.0, 1.0);
        if command_mps < 0.0 {
            pedals = pedals.min(0.0);
        }
        self.throttle += share * (pedals.max(0.0) - self.throttle);
        self.brake += share * ((-pedals).max(0.0) - self.brake);
        let mut accel_mps2 = -vehicle.drag_per_s * self.speed_mps
            - vehicle.brake_decel_mps2 * self.brake
            - vehicle.rolling_decel_mps2;
        if engaged {
            accel_mps2 += vehicle.throttle_accel_mps2 * self.throttle;
        }
        self.speed_mps = (self.speed_mps + accel_mps2 * held_s).max(0.0);
    }
}

/// The share of its way that a pedal makes in a time.
pub(crate) fn pedal_share(vehicle: &Vehicle, held_s: f64) -> f64 {
    -libm::expm1(-held_s / vehicle.pedal_lag_s)
}

/// The acceleration over the first part of a stretch.
fn first_accel_mps2(stretch: &Stretch) -> f64 {
    const OVER_S: f64 = 0.3;
    let (time_s, speed_mps) = (&stretch.time_s, &stretch.smooth_mps);
    let to = time_s.partition_point(|it| *it < time_s[0] + OVER_S).min(time_s.len() - 1).max(1);
    (speed_mps[to] - speed_mps[0]) / (time_s[to] - time_s[0])
}

/// The state of the loop at each sample.
pub(crate) fn run(stretch: &Stretch, vehicle: &Vehicle) -> Vec<SpeedLoop> {
    let mut state = match stretch.from_rest {
        true => SpeedLoop::default(),
        false => {
            let acting = stretch.first_acting(vehicle.speed_delay_s);
            let command_mps = acting.speed_mps.min(vehicle.speed_limit_mps);
            SpeedLoop::midway(
                vehicle,
                stretch.smooth_mps[0],
                first_accel_mps2(stretch),
                command_mps,
            )
        }
    };
    // A gear that has to engage first engages when the car begins to move.
    let moves = |speed: &f64| *speed > STANDING_MPS;
    let begin = stretch.smooth_mps.iter().position(moves).unwrap_or(stretch.len());
    let engages = if vehicle.gear_engaged || !stretch.from_rest { 0 } else { begin };
    let mut states = vec![state; stretch.len()];
    let steering_s = Some(vehicle.steering_delay_s);
    let mut shares = ByLength::new();
    walk(stretch, vehicle.speed_delay_s, steering_s, STEP_S, |index, command, held_s| {
        let share = shares.get(held_s, || pedal_share(vehicle, held_s));
        state.step(vehicle, command.speed_mps, index >= engages, (held_s, share));
        states[index] = state;
    });
    states
}

/// What is fitted.
#[derive(Debug)]
pub(crate) struct Speed<'a> {
    stretches: &'a [Stretch],
    vehicle: Vehicle,
    pub(crate) axes: Vec<Axis>,
    places: Vec<Place>,
    floors: [f64; 1],
}

impl<'a> Speed<'a> {
    pub(crate) fn new(stretches: &'a [Stretch], vehicle: &Vehicle) -> Self {
        let prior = of_vehicle(vehicle);
        let mut is_zero = [false; COUNT];
        is_zero[KP] = vehicle.speed_kp == 0.0;
        is_zero[KI] = vehicle.speed_ki == 0.0;
        is_zero[DRAG] = vehicle.drag_per_s == 0.0;
        is_zero[ROLLING] = vehicle.rolling_decel_mps2 == 0.0;
        let axis = |index: usize| {
            let (low, high, prior_sd, step) = match index {
                DELAY => (0.0, 0.95, 0.3, DELAY_STEP_S),
                // No car brakes, or speeds up, as hard as that.
                THROTTLE | BRAKE => {
                    let low = prior[index].min(MOST_PEDAL) - 4.0;
                    (low, (prior[index] + 4.0).min(MOST_PEDAL), 1.2, 1e-5)
                }
                _ => (prior[index] - 4.0, prior[index] + 4.0, 1.2, 1e-5),
            };
            let is_two_sided = index == DELAY;
            let prior = prior[index];
            let file = if is_zero[index] { low } else { prior };
            Axis { low, high, prior, prior_sd, file, step, is_two_sided, free: true }
        };
        let mut places = Vec::new();
        let mut first_block = 0;
        for stretch in stretches {
            places.extend((0..stretch.len()).map(|index| Place {
                channel: 0,
                block: first_block + block_of(stretch, index),
                telling: is_known(stretch, index) && stretch.smooth_mps[index] > STANDING_MPS,
            }));
            first_block += blocks_of(stretch);
        }
        Self {
            stretches,
            vehicle: vehicle.clone(),
            axes: (0..COUNT).map(axis).collect(),
            places,
            floors: [1e-4],
        }
    }
}

fn is_known(stretch: &Stretch, index: usize) -> bool {
    stretch.from_rest || stretch.time_s[index] - stretch.time_s[0] > UNKNOWN_S
}

impl Model for Speed<'_> {
    fn axes(&self) -> &[Axis] {
        &self.axes
    }

    fn places(&self) -> &[Place] {
        &self.places
    }

    fn floors(&self) -> &[f64] {
        &self.floors
    }

    fn residuals(&self, at: &[f64], _: &[f64], out: &mut [f64]) {
        let vehicle = to_vehicle(at, &self.vehicle);
        let mut first = 0;
        for stretch in self.stretches {
            for (index, state) in run(stretch, &vehicle).iter().enumerate() {
                out[first + index] = match is_known(stretch, index) {
                    true => stretch.speed_mps[index] - state.speed_mps,
                    false => 0.0,
                };
            }
            first += stretch.len();
        }
    }
}
