//! The control law: equation 2 of the paper.

use config::{Gains, RunConfig};
use tracking::TrackingError;

/// What the law wants: forward speed, yaw rate, steering angle.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct RawCommand {
    /// v, m/s.
    pub speed_mps: f64,
    /// ω_s, rad/s: wanted, before the low-pass filter.
    pub yaw_rate_radps: f64,
    /// φ, rad: positive to the left.
    pub steering_rad: f64,
}

/// The law with the state of its low-pass filter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ControlLaw {
    tick_s: f64,
    steering_limit_rad: f64,
    steering_rad: f64,
}

impl ControlLaw {
    /// The law at rest, with the filter at 0.
    pub fn new(config: &RunConfig) -> Self {
        Self {
            tick_s: config.drive.tick_s,
            steering_limit_rad: config.controller.steering_limit_rad,
            steering_rad: 0.0,
        }
    }

    /// Puts the filter back to 0.
    pub fn reset(&mut self) {
        self.resume(0.0);
    }

    /// Puts the filter where the last command left the steering angle.
    pub fn resume(&mut self, steering_rad: f64) {
        self.steering_rad = steering_rad.clamp(-self.steering_limit_rad, self.steering_limit_rad);
    }

    /// One tick of the law, on the error in the vehicle frame:
    ///
    /// v = Kv·e_x,  ω = Ks·e_θ + Kl·e_y,  φ = Ki·φ₋₁ + Ki·h·ω,  φ within its limit.
    ///
    /// The limit clamps the state of the filter, so that it does not wind up.
    pub fn command(&mut self, gains: Gains, error: TrackingError) -> RawCommand {
        let Gains { kv, kl, ks, ki } = gains;
        let (h, phi_max) = (self.tick_s, self.steering_limit_rad);
        let v = kv * error.along_track_m;
        let omega = ks * error.heading_rad + kl * error.cross_track_m;
        let phi = (ki * self.steering_rad + ki * h * omega).clamp(-phi_max, phi_max);
        self.steering_rad = phi;
        RawCommand { speed_mps: v, yaw_rate_radps: omega, steering_rad: phi }
    }

    /// Whether the last command was at the limit of the steering angle.
    pub fn is_steering_limited(&self) -> bool {
        self.steering_rad.abs() >= self.steering_limit_rad
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::Layers;

    fn law() -> ControlLaw {
        ControlLaw::new(&Layers::maneuver("lane_change").unwrap().resolve().unwrap())
    }

    #[test]
    fn one_tick_by_hand() {
        let gains = Gains { kv: 3.0, kl: 21.0, ks: 6.0, ki: 0.7 };
        let error = TrackingError { along_track_m: 0.5, cross_track_m: 0.1, heading_rad: -0.2 };
        let mut law = law();
        let first = law.command(gains, error);
        assert_eq!(first.speed_mps, 1.5);
        assert!((first.yaw_rate_radps - 0.9).abs() < 1e-12);
        assert!((first.steering_rad - 0.7 * 0.01 * 0.9).abs() < 1e-15);
        let second = law.command(gains, error);
        assert!((second.steering_rad - 0.7 * (first.steering_rad + 0.009)).abs() < 1e-15);
    }

    #[test]
    fn the_filter_does_not_wind_up_behind_its_limit() {
        let gains = Gains { kv: 1.0, kl: 21.0, ks: 1.0, ki: 0.98 };
        let left = TrackingError { cross_track_m: 100.0, ..TrackingError::default() };
        let right = TrackingError { cross_track_m: -1.0, ..TrackingError::default() };
        let mut law = law();
        for _ in 0..1000 {
            law.command(gains, left);
        }
        assert!(law.is_steering_limited());
        let after = law.command(gains, right);
        assert!(after.steering_rad < law.steering_limit_rad && !law.is_steering_limited());
    }
}
