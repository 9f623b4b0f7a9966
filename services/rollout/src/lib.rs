//! The whole loop as one pure function: vehicle, controller, gate, zones and schedule, called in turn.
//!
//! It is the oracle (the pipeline must equal it bit for bit), the lower bound of the benchmarks, and the
//! engine of the exhaustive grid. It calls the same cores as the processes do, in the order of one tick.

// Tests may read and write files, start threads, and know the time.
#![cfg_attr(test, allow(clippy::disallowed_methods, clippy::disallowed_types))]

mod faulty;

use config::{Parameters, RunConfig};
use controller::clock::ReferenceClock;
use controller::{Decision, DriveController, GateWord, Seen};
use simulator::{Observation, SimulatedVehicle};
use supervisor::{Movement, Pace, Passed, Progress, RawCommand, State, Watch, Zones};
use tracking::{DriveRecord, Pose};

pub use faulty::{Fault, FaultyCar};

/// Everything that happened in one tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TickRecord {
    /// What the vehicle reported.
    pub observation: Observation,
    /// What the controller computed from it.
    pub decision: Decision,
    /// What the gate passed.
    pub passed: Passed,
    /// What the gate reports.
    pub gate: GateWord,
    /// The zone that applies from the next tick on.
    pub zone: usize,
}

/// What is driven: our simulated vehicle, or another plant that is computed tick by tick.
pub trait Plant {
    /// Puts the tracked point at `start`, at rest, and restarts the noise from its seed, if there is any.
    fn reset(&mut self, start: Pose, noise_seed: Option<u64>);
    /// What the sensors report now; called once a tick.
    fn observe(&mut self) -> Observation;
    /// Drives one tick with a command: forward speed, and steering angle of the road wheels.
    fn step(&mut self, speed_mps: f64, steering_rad: f64);
    /// What is wrong, apart from what the watch itself sees, as bits of a gate's reasons: for an alarm that knows.
    fn faults(&self) -> u32 {
        0
    }
}

impl Plant for SimulatedVehicle {
    fn reset(&mut self, start: Pose, noise_seed: Option<u64>) {
        SimulatedVehicle::reset(self, start, noise_seed);
    }

    #[inline]
    fn observe(&mut self) -> Observation {
        SimulatedVehicle::observe(self)
    }

    #[inline]
    fn step(&mut self, speed_mps: f64, steering_rad: f64) {
        SimulatedVehicle::step(self, speed_mps, steering_rad);
    }
}

/// Vehicle, controller, gate and zones of one configuration, to be driven again and again.
#[derive(Debug, Clone)]
pub struct Rollout<P = SimulatedVehicle> {
    vehicle: P,
    controller: DriveController,
    /// A watch over a vehicle at rest and a pace at the start of the path, to be copied for each drive.
    fresh_watch: Watch,
    fresh_pace: Pace,
    tick_s: f64,
    /// Zones at the start of the path, likewise.
    fresh_zones: Zones,
    start: Pose,
    ticks: u64,
}

impl Rollout {
    /// The loop of a configuration, around our simulated vehicle.
    pub fn new(config: &RunConfig) -> Self {
        Self::around(SimulatedVehicle::new(config), config)
    }

    /// The loop of a configuration around the vehicle of another one, of which what drives it knows nothing.
    pub fn on_plant(config: &RunConfig, plant: &RunConfig) -> Self {
        Self::around(SimulatedVehicle::new(plant), config)
    }
}

impl<P: Plant> Rollout<P> {
    /// The loop of a configuration, around another plant.
    pub fn around(vehicle: P, config: &RunConfig) -> Self {
        Self {
            vehicle,
            controller: DriveController::new(config),
            fresh_watch: {
                let mut watch = Watch::new(config);
                watch.tells_truth();
                watch
            },
            fresh_pace: Pace::new(config),
            tick_s: config.drive.tick_s,
            fresh_zones: Zones::new(config),
            start: config.path.start.into(),
            ticks: config.ticks(),
        }
    }

    /// One drive from the start with these parameters of the law; with noise if there is a seed for it.
    pub fn drive(&mut self, parameters: Parameters, noise_seed: Option<u64>) -> DriveRecord {
        self.drive_with(parameters, noise_seed, |_, _| {})
    }

    /// As [`Rollout::drive`], passing each tick to `each`.
    pub fn drive_with(
        &mut self,
        parameters: Parameters,
        noise_seed: Option<u64>,
        each: impl FnMut(u64, &TickRecord),
    ) -> DriveRecord {
        self.drive_scheduled(&[parameters], noise_seed, each)
    }

    /// As [`Rollout::drive_with`], with parameters for each zone of the path; a single set is used in all of them.
    ///
    /// # Panics
    /// If there is neither one set nor one for each zone.
    pub fn drive_scheduled(
        &mut self,
        by_zone: &[Parameters],
        noise_seed: Option<u64>,
        mut each: impl FnMut(u64, &TickRecord),
    ) -> DriveRecord {
        self.vehicle.reset(self.start, noise_seed);
        let mut zones = self.fresh_zones.clone();
        let mut watch = self.fresh_watch.clone();
        let mut pace = self.fresh_pace.clone();
        let mut clock = ReferenceClock::default();
        let mut rate = None;
        self.controller.reset(by_zone[0], self.ticks);
        let mut zone = 0;
        let mut tick = 0;
        loop {
            let observation = self.vehicle.observe();
            clock.follow(tick, rate);
            let decision = self.controller.tick(
                clock.phase(),
                Seen {
                    measured: observation.measured,
                    speed_mps: observation.speed_mps,
                    yaw_rate_radps: observation.yaw_rate_radps,
                    truth: Some(observation.truth),
                    collision: observation.collision,
                },
            );
            let raw = decision.command;
            let Observation { measured: pose, speed_mps, yaw_rate_radps, .. } = observation;
            watch.see(tick, Movement { pose, speed_mps, yaw_rate_radps }, true);
            watch.follow(decision.reference_along_m);
            let raw = RawCommand {
                speed_mps: raw.speed_mps,
                yaw_rate_radps: raw.yaw_rate_radps,
                steering_rad: raw.steering_rad,
            };
            let passed = match decision.ended {
                None => watch.command(self.tick_s, self.vehicle.faults(), Some(raw)),
                Some(_) => watch.end(self.tick_s, speed_mps),
            };
            let along_m = decision.reference_along_m;
            let progress = Progress { asked_mps: raw.speed_mps, along_m, origin_m: 0.0 };
            pace.update(tick, pose, progress);
            let gate = gate_word(&watch);
            self.controller.hear_gate(gate);
            rate = Some(watch.clock_rate(pace.rate()));
            let entered = zones.update(pose, along_m, raw.steering_rad);
            zones.tell(passed.steering_rad);
            if entered != zone && by_zone.len() > 1 {
                self.controller.switch_parameters(by_zone[entered]);
            }
            zone = entered;
            each(tick, &TickRecord { observation, decision, passed, gate, zone });
            if let Some(ended) = decision.ended {
                return ended;
            }
            self.vehicle.step(passed.speed_mps, passed.steering_rad);
            tick += 1;
        }
    }
}

/// What the controller hears of the gate. In lockstep nobody rearms a vehicle: every stop ends the drive.
fn gate_word(watch: &Watch) -> GateWord {
    let (state, reasons) = (watch.state(), watch.reasons());
    let is_stopped = state.is_latched();
    GateWord { reasons, is_stopped, stands: state == State::Stopped, is_final: is_stopped }
}

/// One drive with these parameters of the law; with noise if there is a seed for it.
///
/// # Examples
/// ```
/// let config = config::Layers::maneuver("lane_change")?.resolve()?;
/// let chosen = config.paper_set().expect("the paper chose one");
/// let record = rollout::rollout(&config, chosen, None);
/// assert!(record.mse_m2() < 2.0);
/// # Ok::<(), config::ConfigError>(())
/// ```
pub fn rollout(config: &RunConfig, parameters: Parameters, noise_seed: Option<u64>) -> DriveRecord {
    Rollout::new(config).drive(parameters, noise_seed)
}
