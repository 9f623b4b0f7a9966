//! The ladder over whole drives: vehicles with faults in the circuit, and what each action makes of them.
//!
//! The alarm here is one that knows: it comes half a second (`PATHTUNE_ALARM_S`) after the fault, so that the actions alone
//! are compared. `PATHTUNE_DRIVES` is the number of drives with each fault, `PATHTUNE_VEHICLE` a preset of the vehicle, and
//! `PATHTUNE_SETS` settings, each behind a space.

// A test reads what it is to drive.
#![allow(clippy::disallowed_methods)]

use config::{Layers, Parameters, RunConfig};
use ipc_types::Safety;
use rollout::{Plant, Rollout};
use simulator::{Observation, SimulatedVehicle};
use tracking::Pose;

/// After the fault.
fn alarm_s() -> f64 {
    std::env::var("PATHTUNE_ALARM_S").map_or(0.5, |text| text.parse().unwrap())
}

const BEYOND_M: f64 = 1.0;

/// What is wrong with the vehicle.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Fault {
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

const STEERING: [Fault; 6] =
    [Understeer, SteeringGain, SteeringRate, WrongSign, StuckStraight, StuckAsItIs];
const OTHERS: [Fault; 7] =
    [Drift, SteeringOffset, ThrottleAsItIs, ThrottleFull, PoseOff, SpeedSensor, Noise];

impl Fault {
    /// What an alarm that knows gives as its reason.
    fn reason(self) -> u32 {
        match self {
            Understeer | SteeringGain | SteeringRate | StuckStraight | StuckAsItIs
            | SteeringOffset => Safety::OUT_BY_YAW,
            WrongSign => Safety::STEERING_REVERSED,
            ThrottleAsItIs | ThrottleFull => Safety::OUT_BY_QUALITY,
            SpeedSensor => Safety::OUT_BY_ALONG,
            Drift | PoseOff => Safety::OUT_BY_LATERAL,
            Noise => Safety::OUT_BY_NOISE,
        }
    }
}

/// The paper's car, which has a fault once it has come this far.
#[derive(Clone)]
struct Troubled {
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
    fn new(config: &RunConfig, fault: Fault, from_m: f64, alarm: u32) -> Self {
        let mut car = SimulatedVehicle::new(config);
        let seen = car.observe();
        Self {
            car,
            fault,
            from_m,
            alarm,
            alarm_s: alarm_s(),
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
fn circuit(speed_mps: f64) -> (RunConfig, Vec<Parameters>) {
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

/// Largest distances from the path, from the fault on, of some drives.
fn distances(
    (config, sets): &(RunConfig, Vec<Parameters>),
    fault: Fault,
    alarm: u32,
    drives: u32,
) -> Vec<f64> {
    let drive = |index: u32| {
        let from_m = 2.0 + 168.0 * (f64::from(index) + 0.5) / f64::from(drives);
        let car = Troubled::new(config, fault, from_m, alarm);
        let (mut driven_m, mut farthest_m) = (0.0, 0.0f64);
        Rollout::around(car, config).drive_scheduled(sets, Some(u64::from(index)), |_, tick| {
            driven_m += tick.observation.speed_mps * config.drive.tick_s;
            if driven_m >= from_m {
                farthest_m = farthest_m.max(tick.decision.path_distance_m);
            }
        });
        farthest_m
    };
    (0..drives).map(drive).collect()
}

fn beyond(distances: &[f64]) -> usize {
    distances.iter().filter(|it| **it > BEYOND_M).count()
}

fn drives(default: u32) -> u32 {
    std::env::var("PATHTUNE_DRIVES").map_or(default, |text| text.parse().unwrap())
}

#[test]
fn the_rule_keeps_faulty_vehicles_near_their_path() {
    let count = drives(2);
    for speed_mps in [1.45, 3.0, 4.0] {
        let circuit = circuit(speed_mps);
        let mut all = 0;
        let mut of_straight = 0;
        for (what, faults) in [("steering", &STEERING[..]), ("others", &OTHERS[..])] {
            let mut by_action = [0; 5];
            for fault in faults {
                let mut line = format!("{speed_mps} m/s, {fault:?}:");
                let actions = [
                    ("nothing", 0),
                    ("rest", Safety::OUT_BY_ALONG),
                    ("brake", Safety::OUT_BY_YAW),
                    ("straight", Safety::STEERING_REVERSED),
                    ("rule", fault.reason()),
                ];
                for ((name, alarm), sum) in actions.into_iter().zip(&mut by_action) {
                    let mut all = distances(&circuit, *fault, alarm, count);
                    all.sort_by(f64::total_cmp);
                    *sum += beyond(&all);
                    let (middle, most) = (all[all.len() / 2], all[all.len() * 95 / 100]);
                    line += &format!(" {name} {} ({middle:.2}/{most:.2})", beyond(&all));
                }
                println!("{line}");
            }
            println!(
                "{speed_mps} m/s, {what}, {} drives each: beyond 1 m {by_action:?} with nothing, rest, brake, straight, \
                 the rule",
                count as usize * faults.len()
            );
            all += by_action[4];
            of_straight += by_action[3];
        }
        let most = count as usize * 13 * 30 / 520;
        assert!(all <= most, "{all} beyond 1 m at {speed_mps} m/s, and at most {most} may be");
        println!(
            "{speed_mps} m/s: {all} by the rule, {of_straight} by stops with the wheels straight"
        );
    }
}
