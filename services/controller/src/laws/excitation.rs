//! No law that follows: it drives what a car is identified by, whatever the path is.
//!
//! See [`tracking::excitation`] for the commands. The path only says where the drive begins.

use config::{Parameters, RunConfig};
use tracking::excitation;

use super::{Law, LawState, RawCommand};
use crate::Sight;

/// The time of the drive.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Excitation {
    ticks: u64,
    tick_s: f64,
    limit_rad: f64,
}

impl Law for Excitation {
    fn new(config: &RunConfig) -> Self {
        Self {
            ticks: 0,
            tick_s: config.drive.tick_s,
            limit_rad: config.controller.steering_limit_rad,
        }
    }

    fn restart(&mut self, _: f64) {
        self.ticks = 0;
    }

    fn state(&self) -> LawState {
        LawState::of(&[self.ticks as f64])
    }

    fn resume(&mut self, state: &LawState) {
        self.ticks = state.numbers().first().map_or(0, |ticks| ticks.clamp(0.0, 1e9) as u64);
    }

    /// With the parameters `steering` (rad), `speed` (m/s) and `turn` (rad).
    fn command(&mut self, parameters: &Parameters, sight: &Sight) -> RawCommand {
        let [steering_rad, speed_mps, turn_rad, ..] = parameters.0;
        let time_s = self.ticks as f64 * self.tick_s;
        self.ticks += 1;
        let (steering_rad, speed_mps) = excitation(time_s, steering_rad, speed_mps, turn_rad);
        let steering_rad = steering_rad.clamp(-self.limit_rad, self.limit_rad);
        RawCommand {
            speed_mps,
            yaw_rate_radps: sight.speed_mps * libm::tan(steering_rad) / sight.wheelbase_m(),
            steering_rad,
        }
    }
}
