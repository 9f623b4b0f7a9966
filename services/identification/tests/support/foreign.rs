//! Cars that the plant does not know: a servo of second order, a dead band, understeer, and another speed loop.

use std::collections::VecDeque;

use config::Vehicle;
use identification::{Command, Drive, Odometry};
use tracking::{EXCITATION_S, Pose, excitation};

use super::{Dice, SENSORS, hidden_car};

const TICK_S: f64 = 0.01;
/// Steps of integration within a tick.
const STEPS: usize = 10;
const STEP_S: f64 = TICK_S / STEPS as f64;

/// A foreign car.
#[derive(Debug, Clone)]
pub(crate) struct Foreign {
    pub(crate) wheelbase_m: f64,
    pub(crate) point_m: f64,
    delay_s: f64,
    /// Natural frequency and damping of the servo.
    servo_radps: f64,
    damping: f64,
    rate_radps: f64,
    dead_band_rad: f64,
    offset_rad: f64,
    understeer_s2pm: f64,
    speed_delay_s: f64,
    speed_lag_s: f64,
    accel_mps2: f64,
}

impl Foreign {
    fn new(dice: &mut Dice) -> Self {
        Self {
            wheelbase_m: dice.uniform(2.3, 3.3),
            point_m: dice.uniform(0.0, 1.5),
            delay_s: dice.uniform(0.05, 0.2),
            servo_radps: dice.uniform(8.0, 20.0),
            damping: dice.uniform(0.6, 1.0),
            rate_radps: dice.log_uniform(0.3, 1.2),
            dead_band_rad: dice.uniform(0.0, 0.01),
            offset_rad: 0.01 * dice.normal(),
            understeer_s2pm: dice.uniform(0.0, 0.01),
            speed_delay_s: dice.uniform(0.0, 0.2),
            speed_lag_s: dice.uniform(0.3, 1.0),
            accel_mps2: dice.uniform(1.0, 3.0),
        }
    }
}

/// One of them, somewhere.
#[derive(Debug, Clone)]
pub(crate) struct Driven {
    car: Foreign,
    steering: VecDeque<f64>,
    speeds: VecDeque<f64>,
    turning_radps: f64,
    rear: Pose,
    pub(crate) wheel_rad: f64,
    pub(crate) speed_mps: f64,
    pub(crate) yaw_rate_radps: f64,
}

impl Driven {
    /// At rest, with its odometry's point there.
    pub(crate) fn at(car: &Foreign, point: Pose) -> Self {
        let line = |delay_s: f64| VecDeque::from(vec![0.0; (delay_s / STEP_S).round() as usize]);
        let (sin, cos) = libm::sincos(point.yaw_rad);
        let rear = Pose {
            x_m: point.x_m - car.point_m * cos,
            y_m: point.y_m - car.point_m * sin,
            yaw_rad: point.yaw_rad,
        };
        Self {
            steering: line(car.delay_s),
            speeds: line(car.speed_delay_s),
            car: car.clone(),
            turning_radps: 0.0,
            rear,
            wheel_rad: 0.0,
            speed_mps: 0.0,
            yaw_rate_radps: 0.0,
        }
    }

    /// Its odometry's point.
    pub(crate) fn point(&self) -> Pose {
        let (sin, cos) = libm::sincos(self.rear.yaw_rad);
        let (x_m, y_m) = (self.rear.x_m, self.rear.y_m);
        let ahead_m = self.car.point_m;
        Pose { x_m: x_m + ahead_m * cos, y_m: y_m + ahead_m * sin, ..self.rear }
    }

    /// Drives a tick.
    pub(crate) fn step(&mut self, speed_mps: f64, steering_rad: f64) {
        let car = &self.car;
        for _ in 0..STEPS {
            self.steering.push_back(steering_rad);
            self.speeds.push_back(speed_mps);
            let target = self.steering.pop_front().unwrap() + car.offset_rad;
            let error = target - self.wheel_rad;
            let error = error - error.clamp(-car.dead_band_rad, car.dead_band_rad);
            let pull = car.servo_radps * car.servo_radps * error
                - 2.0 * car.damping * car.servo_radps * self.turning_radps;
            let turning = self.turning_radps + pull * STEP_S;
            self.turning_radps = turning.clamp(-car.rate_radps, car.rate_radps);
            self.wheel_rad += self.turning_radps * STEP_S;
            let wanted = (self.speeds.pop_front().unwrap() - self.speed_mps) / car.speed_lag_s;
            let wanted = wanted.clamp(-2.0 * car.accel_mps2, car.accel_mps2);
            self.speed_mps = (self.speed_mps + wanted * STEP_S).max(0.0);
            let speed = self.speed_mps;
            let length_m = car.wheelbase_m + car.understeer_s2pm * speed * speed;
            self.yaw_rate_radps = speed * libm::tan(self.wheel_rad) / length_m;
            let (sin, cos) = libm::sincos(self.rear.yaw_rad + 0.5 * self.yaw_rate_radps * STEP_S);
            self.rear.x_m += speed * STEP_S * cos;
            self.rear.y_m += speed * STEP_S * sin;
            self.rear.yaw_rad += self.yaw_rate_radps * STEP_S;
        }
    }
}

/// The excitation, driven by a foreign car.
fn excite(car: &Foreign, dice: &mut Dice) -> Drive {
    let mut driven = Driven::at(car, Pose { x_m: car.point_m, y_m: 0.0, yaw_rad: 0.0 });
    let mut drive = Drive::default();
    for tick in 0..(EXCITATION_S / TICK_S) as usize {
        let time_s = tick as f64 * TICK_S;
        let point = driven.point();
        drive.odometry.push(Odometry {
            time_s,
            x_m: point.x_m + SENSORS.position_sd_m * dice.normal(),
            y_m: point.y_m + SENSORS.position_sd_m * dice.normal(),
            yaw_rad: point.yaw_rad + SENSORS.heading_sd_rad * dice.normal(),
            speed_mps: driven.speed_mps + SENSORS.speed_sd_mps * dice.normal(),
            yaw_rate_radps: driven.yaw_rate_radps + SENSORS.yaw_rate_sd_radps * dice.normal(),
        });
        let (steering_rad, speed_mps) = excitation(time_s, 0.25, 2.0, 0.0);
        drive.commands.push(Command { time_s, steering_rad, speed_mps });
        driven.step(speed_mps, steering_rad);
    }
    drive
}

/// A file that knows a car only roughly, the car, and the excitation in it.
pub(crate) fn case(seed: u64) -> (Vehicle, Foreign, Drive) {
    let mut dice = Dice::new(1000 + seed);
    let (_, file) = hidden_car(&mut dice);
    let car = Foreign::new(&mut dice);
    let driven = excite(&car, &mut dice);
    (file, car, driven)
}
