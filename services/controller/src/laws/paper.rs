//! The paper's control law: its equation 2.

use config::{Parameters, RunConfig};

use super::{HeldSteering, Law, LawState, RawCommand};
use crate::Sight;

/// The law with the state of its low-pass filter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Paper {
    tick_s: f64,
    steering: HeldSteering,
}

impl Law for Paper {
    fn new(config: &RunConfig) -> Self {
        Self { tick_s: config.drive.tick_s, steering: HeldSteering::new(config) }
    }

    fn restart(&mut self, steering_rad: f64) {
        self.steering.hold(steering_rad);
    }

    fn state(&self) -> LawState {
        self.steering.state()
    }

    fn resume(&mut self, state: &LawState) {
        self.steering.resume(state);
    }

    /// On the error in the vehicle frame, with the parameters Kv (1/s), Kl (rad/(m·s)), Ks (1/s), Ki:
    ///
    /// v = Kv·e_x,  ω = Ks·e_θ + Kl·e_y,  φ = Ki·φ₋₁ + Ki·h·ω,  φ within its limit.
    #[inline]
    fn command(&mut self, parameters: &Parameters, sight: &Sight) -> RawCommand {
        let [kv, kl, ks, ki, ..] = parameters.0;
        let error = sight.error;
        let h = self.tick_s;
        let v = kv * error.along_track_m;
        let omega = ks * error.heading_rad + kl * error.cross_track_m;
        let phi = self.steering.hold(ki * self.steering.angle_rad() + ki * h * omega);
        RawCommand { speed_mps: v, yaw_rate_radps: omega, steering_rad: phi }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::Layers;
    use tracking::{Pose, Reference, TrackingError};

    fn config() -> RunConfig {
        Layers::maneuver("lane_change").unwrap().resolve().unwrap()
    }

    fn command(law: &mut Paper, gains: &[f64], error: TrackingError) -> RawCommand {
        let config = config();
        let reference = Reference::new(&config);
        let pose = Pose::default();
        let mut sight = Sight::new(&config, &reference, 0.0, pose, pose, 0.0, 0.0);
        sight.error = error;
        law.command(&Parameters::of(gains), &sight)
    }

    #[test]
    fn one_tick_by_hand() {
        let gains = [3.0, 21.0, 6.0, 0.7];
        let error = TrackingError { along_track_m: 0.5, cross_track_m: 0.1, heading_rad: -0.2 };
        let mut law = Paper::new(&config());
        let first = command(&mut law, &gains, error);
        assert_eq!(first.speed_mps, 1.5);
        assert!((first.yaw_rate_radps - 0.9).abs() < 1e-12);
        assert!((first.steering_rad - 0.7 * 0.01 * 0.9).abs() < 1e-15);
        let second = command(&mut law, &gains, error);
        assert!((second.steering_rad - 0.7 * (first.steering_rad + 0.009)).abs() < 1e-15);
    }

    #[test]
    fn the_filter_does_not_wind_up_at_its_limit() {
        let gains = [1.0, 21.0, 1.0, 0.98];
        let left = TrackingError { cross_track_m: 100.0, ..TrackingError::default() };
        let right = TrackingError { cross_track_m: -1.0, ..TrackingError::default() };
        let mut law = Paper::new(&config());
        for _ in 0..1000 {
            command(&mut law, &gains, left);
        }
        let limit_rad = config().controller.steering_limit_rad;
        assert_eq!(law.steering.angle_rad(), limit_rad);
        assert!(command(&mut law, &gains, right).steering_rad < limit_rad);
    }
}
