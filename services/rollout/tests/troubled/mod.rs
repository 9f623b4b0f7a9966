//! The circuit, and the paper's car with a fault from some place on: what both tests of the ladder drive.

use config::{Layers, Parameters, RunConfig};
use rollout::Plant;
use simulator::{Observation, SimulatedVehicle};
use tracking::Pose;

/// What is wrong with the vehicle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Fault {
    #[allow(dead_code, reason = "one of the tests has no use for it")]
    Healthy,
    Understeer,
    SteeringGain,
    SteeringRate,
    WrongSign,
    StuckStraight,
    StuckAsItIs,
    Drift,
    SteeringOffset,
    ThrottleAsItIs,
    ThrottleFull,
    PoseOff,
    SpeedSensor,
    Noise,
}

use Fault::*;

pub(crate) const STEERING: [Fault; 6] =
    [Understeer, SteeringGain, SteeringRate, WrongSign, StuckStraight, StuckAsItIs];
pub(crate) const OTHERS: [Fault; 7] =
    [Drift, SteeringOffset, ThrottleAsItIs, ThrottleFull, PoseOff, SpeedSensor, Noise];

/// The paper's car, which has a fault once it has come this far.
#[derive(Clone)]
pub(crate) struct Troubled {
    car: SimulatedVehicle,
    fault: Fault,
    from_m: f64,
    /// What the alarm tells.
    alarm: u32,
    alarm_s: f64,
    tick_s: f64,
    driven_m: f64,
    /// For how long it has had the fault.
    faulty_s: Option<f64>,
    seen: Observation,
    steering_rad: f64,
    speed_mps: f64,
    carried: (f64, f64),
}

impl Troubled {
    /// A car with a fault from this place on, and an alarm of these reasons so long after it.
    pub(crate) fn new(
        config: &RunConfig,
        fault: Fault,
        from_m: f64,
        (alarm, alarm_s): (u32, f64),
    ) -> Self {
        let mut car = SimulatedVehicle::new(config);
        let seen = car.observe();
        Self {
            car,
            fault,
            from_m,
            alarm,
            alarm_s,
            tick_s: config.drive.tick_s,
            driven_m: 0.0,
            faulty_s: None,
            seen,
            steering_rad: 0.0,
            speed_mps: 0.0,
            carried: (0.0, 0.0),
        }
    }
}

/// Places a point that much to the left of a pose.
fn left_of(pose: Pose, by_m: f64) -> Pose {
    let (sin, cos) = (libm::sin(pose.yaw_rad), libm::cos(pose.yaw_rad));
    Pose { x_m: pose.x_m - by_m * sin, y_m: pose.y_m + by_m * cos, ..pose }
}

impl Plant for Troubled {
    fn reset(&mut self, start: Pose, noise_seed: Option<u64>) {
        self.car.reset(start, noise_seed);
        (self.driven_m, self.faulty_s, self.carried) = (0.0, None, (0.0, 0.0));
    }

    fn observe(&mut self) -> Observation {
        let mut seen = self.car.observe();
        self.driven_m += seen.speed_mps * self.tick_s;
        if self.driven_m >= self.from_m && self.faulty_s.is_none() {
            self.faulty_s = Some(0.0);
            (self.steering_rad, self.speed_mps) = (seen.steering_rad, seen.speed_mps);
        }
        if self.faulty_s.is_some() {
            match self.fault {
                Drift => {
                    let step =
                        left_of(Pose { x_m: 0.0, y_m: 0.0, ..seen.truth }, 0.1 * self.tick_s);
                    self.carried = (self.carried.0 + step.x_m, self.carried.1 + step.y_m);
                }
                PoseOff => seen.measured = left_of(seen.measured, 0.3),
                SpeedSensor => seen.speed_mps *= 0.8,
                Noise => {
                    let (truth, measured) = (seen.truth, seen.measured);
                    let thrice = |truth: f64, measured: f64| truth + 3.0 * (measured - truth);
                    seen.measured = Pose {
                        x_m: thrice(truth.x_m, measured.x_m),
                        y_m: thrice(truth.y_m, measured.y_m),
                        yaw_rad: thrice(truth.yaw_rad, measured.yaw_rad),
                    };
                }
                _ => {}
            }
        }
        for pose in [&mut seen.truth, &mut seen.measured] {
            (pose.x_m, pose.y_m) = (pose.x_m + self.carried.0, pose.y_m + self.carried.1);
        }
        self.seen = seen;
        seen
    }

    fn faults(&self) -> u32 {
        if self.faulty_s.is_some_and(|since_s| since_s >= self.alarm_s) { self.alarm } else { 0 }
    }

    fn step(&mut self, speed_mps: f64, steering_rad: f64) {
        let (mut speed, mut angle) = (speed_mps, steering_rad);
        if let Some(since_s) = &mut self.faulty_s {
            *since_s += self.tick_s;
            match self.fault {
                Understeer => angle = libm::atan(libm::tan(steering_rad) / 1.6),
                SteeringGain => angle = 0.6 * steering_rad,
                SteeringRate => {
                    let reach_rad = 0.2 * self.tick_s;
                    self.steering_rad +=
                        (steering_rad - self.steering_rad).clamp(-reach_rad, reach_rad);
                    angle = self.steering_rad;
                }
                WrongSign => angle = -steering_rad,
                StuckStraight => angle = 0.0,
                StuckAsItIs => angle = self.steering_rad,
                SteeringOffset => angle = steering_rad + 2.0f64.to_radians(),
                // The brake is stronger than the engine.
                ThrottleAsItIs if speed_mps >= 0.0 => speed = speed_mps.max(self.speed_mps),
                ThrottleFull if speed_mps >= 0.0 => speed = 9.0,
                SpeedSensor => speed = speed_mps / 0.8,
                _ => {}
            }
        }
        self.car.step(speed, angle);
    }
}

/// The circuit at a speed, with noise, and the paper's sets.
pub(crate) fn circuit(speed_mps: f64) -> (RunConfig, Vec<Parameters>) {
    let vehicle = std::env::var("PATHTUNE_VEHICLE").unwrap_or_else(|_| "tesla_model_3".to_owned());
    let sets = std::env::var("PATHTUNE_SETS").unwrap_or_default();
    let mut layers = Layers::maneuver("circuit").unwrap();
    layers.set_vehicle("test", &vehicle).unwrap();
    for set in [
        "noise.enabled=true",
        "collision.enabled=false",
        // Else the reference runs ahead of a car that does not roll yet, and the race after it is what is measured.
        "vehicle.gear_engaged=true",
        "supervisor.speed_limit_mps=5.0",
        &format!("reference.speed_mps={speed_mps:?}"),
        &format!("drive.loop_time_s={:?}", (200.0 / speed_mps).round()),
    ] {
        layers.set(set).unwrap();
    }
    sets.split_whitespace().for_each(|set| layers.set(set).unwrap());
    let config = layers.resolve().unwrap();
    let row = config.paper_rows().into_iter().find(|row| row.chosen).unwrap();
    let sets = config.sets_by_zone(&row.sets);
    (config, sets)
}
