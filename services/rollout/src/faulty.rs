//! A simulated vehicle that does not do as it is told from some moment on: for tests of what the gate makes of it.

use config::RunConfig;
use simulator::{Observation, SimulatedVehicle};
use tracking::Pose;

use crate::Plant;

/// What is wrong with the vehicle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Fault {
    /// Nothing.
    None,
    /// It steers to the other side.
    WrongSign,
    /// Its accelerator is stuck: it drives at this speed, whatever it is told.
    StuckThrottle {
        /// The speed.
        speed_mps: f64,
    },
    /// It goes on with the command that it had, whatever it is told.
    IgnoresCommands,
    /// Its wheels stay straight.
    NoSteering,
    /// Its linkage is bent: it steers by a share of the commanded angle, and to one side.
    BentLinkage {
        /// The share.
        gain: f64,
        /// The angle at a command to go straight on.
        offset_rad: f64,
    },
    /// Its odometry gives the pose of a point that lies this much farther ahead than the configuration says.
    PointAhead {
        /// How much.
        by_m: f64,
    },
    /// Its localisation hangs: odometry repeats the last pose, while it drives on.
    PoseStands,
    /// Something holds it: it does not drive until the fault ends.
    Held,
}

impl Fault {
    /// The fault of this name and its numbers, as in `bent_linkage 0.15 0.12`.
    pub fn parse(text: &str) -> Option<Self> {
        let words: Vec<&str> = text.split_whitespace().collect();
        let number = |index: usize| words.get(index)?.parse().ok();
        Some(match *words.first()? {
            "none" => Self::None,
            "wrong_sign" => Self::WrongSign,
            "stuck_throttle" => Self::StuckThrottle { speed_mps: number(1)? },
            "ignores_commands" => Self::IgnoresCommands,
            "no_steering" => Self::NoSteering,
            "bent_linkage" => Self::BentLinkage { gain: number(1)?, offset_rad: number(2)? },
            "point_ahead" => Self::PointAhead { by_m: number(1)? },
            "pose_stands" => Self::PoseStands,
            "held" => Self::Held,
            _ => return None,
        })
    }
}

/// A simulated vehicle with a fault.
#[derive(Debug, Clone)]
pub struct FaultyCar {
    car: SimulatedVehicle,
    fault: Fault,
    /// The ticks from the first to the one before the last in which it has the fault.
    from_tick: u64,
    to_tick: u64,
    /// For how many ticks it is there and then away in turn; 0 if it stays.
    in_turn: u64,
    tick: u64,
    /// The last command that it obeyed.
    had: (f64, f64),
    /// Where it was measured last.
    was: Pose,
}

impl FaultyCar {
    /// The configured vehicle, with a fault from one tick to before another.
    pub fn new(config: &RunConfig, fault: Fault, from_tick: u64, to_tick: u64) -> Self {
        let car = SimulatedVehicle::new(config);
        Self {
            car,
            fault,
            from_tick,
            to_tick,
            in_turn: 0,
            tick: 0,
            had: (0.0, 0.0),
            was: Pose::default(),
        }
    }

    /// As [`FaultyCar::new`], but the fault comes and goes: it is there for so many ticks, and away for as many.
    pub fn in_turn(config: &RunConfig, fault: Fault, from_tick: u64, ticks: u64) -> Self {
        Self { in_turn: ticks, ..Self::new(config, fault, from_tick, u64::MAX) }
    }

    fn has_fault(&self) -> bool {
        let is_away = || (self.tick - self.from_tick) / self.in_turn % 2 == 1;
        (self.from_tick..self.to_tick).contains(&self.tick) && !(self.in_turn > 0 && is_away())
    }
}

impl Plant for FaultyCar {
    fn reset(&mut self, start: Pose, noise_seed: Option<u64>) {
        self.car.reset(start, noise_seed);
        (self.tick, self.had) = (0, (0.0, 0.0));
    }

    fn observe(&mut self) -> Observation {
        let mut seen = self.car.observe();
        if let Fault::PointAhead { by_m } = self.fault
            && self.has_fault()
        {
            let at = seen.measured.ahead(by_m);
            (seen.measured.x_m, seen.measured.y_m) = (at.x, at.y);
        }
        if self.fault == Fault::PoseStands && self.has_fault() {
            seen.measured = self.was;
        }
        self.was = seen.measured;
        seen
    }

    fn step(&mut self, speed_mps: f64, steering_rad: f64) {
        let mut does = (speed_mps, steering_rad);
        if self.has_fault() {
            match self.fault {
                Fault::None | Fault::PointAhead { .. } | Fault::PoseStands => {}
                Fault::WrongSign => does.1 = -steering_rad,
                Fault::StuckThrottle { speed_mps } => does.0 = speed_mps,
                Fault::IgnoresCommands => does = self.had,
                Fault::NoSteering => does.1 = 0.0,
                Fault::BentLinkage { gain, offset_rad } => {
                    does.1 = gain * steering_rad + offset_rad;
                }
                // Its own brake.
                Fault::Held => does.0 = if speed_mps > 0.0 { -1.0 } else { speed_mps },
            }
        }
        self.had = does;
        self.tick += 1;
        self.car.step(does.0, does.1);
    }
}
