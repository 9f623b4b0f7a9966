//! The whole loop as one pure function: vehicle, controller, gate, zones and schedule, called in turn.
//!
//! It is the oracle (the pipeline must equal it bit for bit), the lower bound of the benchmarks, and the
//! engine of the exhaustive grid. It calls the same cores as the processes do, in the order of one tick.

// Tests may read and write files, start threads, and know the time.
#![cfg_attr(test, allow(clippy::disallowed_methods, clippy::disallowed_types))]

use config::{Parameters, RunConfig};
use controller::{Decision, DriveController, Seen};
use simulator::{Observation, SimulatedVehicle};
use supervisor::{Movement, Passed, RawCommand, Watch};
use tracking::{DriveRecord, ZoneTracker};

/// Everything that happened in one tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TickRecord {
    /// What the vehicle reported.
    pub observation: Observation,
    /// What the controller computed from it.
    pub decision: Decision,
    /// What the gate passed.
    pub passed: Passed,
    /// The zone that applies from the next tick on.
    pub zone: usize,
}

/// Vehicle, controller, gate and zones of one configuration, to be driven again and again.
#[derive(Debug, Clone)]
pub struct Rollout {
    vehicle: SimulatedVehicle,
    controller: DriveController,
    /// A watch over a vehicle at rest, to be copied for each drive.
    fresh_watch: Watch,
    tick_s: f64,
    zones: ZoneTracker,
    start: tracking::Pose,
    ticks: u64,
}

impl Rollout {
    /// The loop of a configuration.
    pub fn new(config: &RunConfig) -> Self {
        Self {
            vehicle: SimulatedVehicle::new(config),
            controller: DriveController::new(config),
            fresh_watch: Watch::new(config),
            tick_s: config.drive.tick_s,
            zones: ZoneTracker::new(config),
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
        self.zones.reset();
        let mut watch = self.fresh_watch;
        self.controller.reset(by_zone[0], self.ticks);
        let mut zone = 0;
        let mut tick = 0;
        loop {
            let observation = self.vehicle.observe();
            let decision = self.controller.tick(
                tick,
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
            watch.see(tick, Movement { pose, speed_mps, yaw_rate_radps });
            let raw = RawCommand {
                speed_mps: raw.speed_mps,
                yaw_rate_radps: raw.yaw_rate_radps,
                steering_rad: raw.steering_rad,
            };
            let passed = watch.command(self.tick_s, 0, Some(raw));
            let entered = self.zones.update(observation.measured, decision.reference_along_m);
            if entered != zone && by_zone.len() > 1 {
                self.controller.switch_parameters(by_zone[entered]);
            }
            zone = entered;
            each(tick, &TickRecord { observation, decision, passed, zone });
            if let Some(ended) = decision.ended {
                return ended;
            }
            self.vehicle.step(passed.speed_mps, passed.steering_rad);
            tick += 1;
        }
    }
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
