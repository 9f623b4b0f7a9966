//! Cars that only the test knows, files that know them roughly, and drives in them.
#![allow(dead_code, reason = "each test uses a part")]

pub(crate) mod foreign;

use config::{Layers, RunConfig, Vehicle};
use identification::{Command, Drive, Odometry};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use simulator::SimulatedVehicle;
use tracking::{EXCITATION_S, excitation};

/// Random numbers that are the same everywhere.
pub(crate) struct Dice(ChaCha8Rng);

impl Dice {
    pub(crate) fn new(seed: u64) -> Self {
        Self(ChaCha8Rng::seed_from_u64(seed))
    }

    pub(crate) fn uniform(&mut self, low: f64, high: f64) -> f64 {
        let unit = (self.0.next_u64() >> 11) as f64 / (1u64 << 53) as f64;
        low + (high - low) * unit
    }

    pub(crate) fn log_uniform(&mut self, low: f64, high: f64) -> f64 {
        libm::exp(self.uniform(libm::log(low), libm::log(high)))
    }

    pub(crate) fn normal(&mut self) -> f64 {
        let radius = (-2.0 * libm::log(1.0 - self.uniform(0.0, 1.0))).sqrt();
        radius * libm::cos(self.uniform(0.0, std::f64::consts::TAU))
    }
}

/// Noise of what the car tells.
#[derive(Clone, Copy)]
pub(crate) struct Sensors {
    pub(crate) position_sd_m: f64,
    pub(crate) heading_sd_rad: f64,
    pub(crate) speed_sd_mps: f64,
    pub(crate) yaw_rate_sd_radps: f64,
}

pub(crate) const SENSORS: Sensors = Sensors {
    position_sd_m: 0.02,
    heading_sd_rad: 0.005,
    speed_sd_mps: 0.02,
    yaw_rate_sd_radps: 0.005,
};

pub(crate) fn base() -> RunConfig {
    let mut config = Layers::maneuver("smooth_lane").unwrap().resolve().unwrap();
    config.collision.enabled = false;
    config
}

/// A car, and a file that knows it only roughly.
pub(crate) fn hidden_car(dice: &mut Dice) -> (Vehicle, Vehicle) {
    let mut car = base().vehicle;
    car.wheelbase_m = dice.uniform(2.3, 3.3);
    car.tracked_point_m = dice.uniform(0.0, 1.5);
    car.steering_delay_s = dice.uniform(0.03, 0.3);
    car.steering_lag_s = dice.log_uniform(0.05, 0.3);
    car.steering_rate_radps = dice.log_uniform(0.25, 1.2);
    car.steering_offset_rad = 0.01 * dice.normal();
    car.speed_delay_s = dice.uniform(0.0, 0.3);
    car.speed_kp *= dice.log_uniform(0.6, 1.6);
    car.speed_ki *= dice.log_uniform(0.5, 2.0);
    car.throttle_accel_mps2 *= dice.log_uniform(0.6, 1.6);
    car.brake_decel_mps2 *= dice.log_uniform(0.6, 1.6);
    car.pedal_lag_s *= dice.log_uniform(0.5, 3.0);
    car.drag_per_s *= dice.log_uniform(0.5, 2.0);
    car.rolling_decel_mps2 *= dice.log_uniform(0.5, 2.0);
    let mut file = car.clone();
    for value in [
        &mut file.wheelbase_m,
        &mut file.steering_delay_s,
        &mut file.steering_lag_s,
        &mut file.steering_rate_radps,
        &mut file.speed_delay_s,
        &mut file.speed_kp,
        &mut file.speed_ki,
        &mut file.throttle_accel_mps2,
        &mut file.brake_decel_mps2,
        &mut file.pedal_lag_s,
        &mut file.drag_per_s,
        &mut file.rolling_decel_mps2,
    ] {
        *value *= dice.log_uniform(0.5, 2.0);
    }
    file.steering_offset_rad = 0.0;
    file.tracked_point_m = 0.7;
    (car, file)
}

/// Drives a car with commands of the time.
pub(crate) fn drive(
    car: &Vehicle,
    length_s: f64,
    sensors: &Sensors,
    dice: &mut Dice,
    commands: impl Fn(f64) -> (f64, f64),
) -> Drive {
    let mut config = base();
    config.vehicle = car.clone();
    let tick_s = config.drive.tick_s;
    let mut vehicle = SimulatedVehicle::new(&config);
    let mut drive = Drive::default();
    for tick in 0..(length_s / tick_s) as usize {
        let time_s = tick as f64 * tick_s;
        let seen = vehicle.observe();
        drive.odometry.push(Odometry {
            time_s,
            x_m: seen.truth.x_m + sensors.position_sd_m * dice.normal(),
            y_m: seen.truth.y_m + sensors.position_sd_m * dice.normal(),
            yaw_rad: seen.truth.yaw_rad + sensors.heading_sd_rad * dice.normal(),
            speed_mps: seen.speed_mps + sensors.speed_sd_mps * dice.normal(),
            yaw_rate_radps: seen.yaw_rate_radps + sensors.yaw_rate_sd_radps * dice.normal(),
        });
        let (steering_rad, speed_mps) = commands(time_s);
        drive.commands.push(Command { time_s, steering_rad, speed_mps });
        vehicle.step(speed_mps, steering_rad);
    }
    drive
}

/// The excitation, driven by a car.
pub(crate) fn excite(car: &Vehicle, sensors: &Sensors, dice: &mut Dice) -> Drive {
    drive(car, EXCITATION_S, sensors, dice, |time_s| excitation(time_s, 0.25, 2.0, 0.0))
}
