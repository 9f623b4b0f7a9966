//! Stanley's law: the front wheels follow the path's heading and turn towards the path.
//!
//! Thrun and others, "Stanley: The robot that won the DARPA Grand Challenge", Journal of Field Robotics 23 (2006),
//! section 9.2, with a softening of the speed and a low-pass filter of the angle.

use config::{Parameters, RunConfig};
use tracking::tracking_error;

use super::{HeldSteering, Law, LawState, RawCommand};
use crate::Sight;

/// The law with the state of its low-pass filter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Stanley {
    /// Whether errors are measured at the nearest point of the path instead of against the moving reference.
    nearest: bool,
    steering: HeldSteering,
}

impl Law for Stanley {
    fn new(config: &RunConfig) -> Self {
        Self {
            nearest: config.law.settings.text("errors_at") != "reference",
            steering: HeldSteering::new(config),
        }
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

    /// With the parameters Kv (1/s), k (1/s), k_soft (m/s) and the filter's share f:
    ///
    /// δ = e_θ + atan2(k·e_y, k_soft + |v|),  φ = f·φ₋₁ + (1 − f)·δ,  v = v_ref + Kv·e_s,  φ within its limit.
    fn command(&mut self, parameters: &Parameters, sight: &Sight) -> RawCommand {
        let [kv, k, k_soft, filter, ..] = parameters.0;
        let front = sight.front_axle();
        let target = if self.nearest { sight.project(front).pose } else { sight.reference_pose };
        let error = tracking_error(target, front);
        let softened_mps = k_soft + sight.speed_mps.abs();
        let delta = error.heading_rad + libm::atan2(k * error.cross_track_m, softened_mps);
        let phi = self.steering.filter(filter, delta);
        RawCommand::following(sight, kv, phi)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::Layers;
    use tracking::{Pose, Reference};

    fn config(sets: &[&str]) -> RunConfig {
        let mut layers = Layers::maneuver("lane_change").unwrap();
        layers.set_law("test", "stanley").unwrap();
        for set in sets {
            layers.set(set).unwrap();
        }
        layers.resolve().unwrap()
    }

    #[test]
    fn one_tick_by_hand() {
        let config = config(&["path.pieces=[{kind='straight',length_m=50.0}]"]);
        let mut reference = Reference::new(&config);
        let mut law = Stanley::new(&config);
        // Half a metre to the left of a straight path, heading 0.1 away from it.
        let yaw_rad = 0.1;
        let axles_m = config.vehicle.wheelbase_m - config.vehicle.tracked_point_m;
        let pose = Pose { x_m: 10.0, y_m: 0.5 - axles_m * libm::sin(yaw_rad), yaw_rad };
        let reference_pose = reference.advance(700.0, pose);
        let sight = Sight::new(&config, &reference, 700.0, reference_pose, pose, 2.0, 0.0);
        let command = law.command(&Parameters::of(&[0.0, 2.0, 0.5, 0.25]), &sight);
        // The front axle is 0.5 m to the left: e_y = −0.5·cos 0.1, in its frame.
        let delta = -0.1 - libm::atan2(2.0 * 0.5 * libm::cos(0.1), 2.5);
        assert!((command.steering_rad - 0.75 * delta).abs() < 1e-12, "{command:?}");
        assert_eq!(command.speed_mps, sight.reference_speed_mps());
        // The second tick keeps a quarter of the first.
        let second = law.command(&Parameters::of(&[1.0, 2.0, 0.5, 0.25]), &sight);
        let wanted = 0.25 * command.steering_rad + 0.75 * delta;
        assert!((second.steering_rad - wanted).abs() < 1e-12, "{second:?}");
        let behind_m = sight.reference_along_m() - sight.projection().along_m;
        assert!((second.speed_mps - command.speed_mps - behind_m).abs() < 1e-12);
    }

    #[test]
    fn errors_may_be_those_against_the_reference() {
        let settings = "law.settings.errors_at=reference";
        let config = config(&[settings]);
        let mut reference = Reference::new(&config);
        let pose = Pose::default();
        let reference_pose = reference.advance(100.0, pose);
        let sight = Sight::new(&config, &reference, 100.0, reference_pose, pose, 1.0, 0.0);
        let command = Stanley::new(&config).command(&config.law.defaults(), &sight);
        let error = tracking_error(reference_pose, sight.front_axle());
        let delta = error.heading_rad + libm::atan2(error.cross_track_m, 2.0);
        assert!((command.steering_rad - delta).abs() < 1e-12);
    }
}
