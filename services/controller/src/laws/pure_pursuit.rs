//! Pure pursuit: the rear axle drives along the circle that leads to a point of the path ahead of it.
//!
//! Coulter, "Implementation of the Pure Pursuit Path Tracking Algorithm", CMU-RI-TR-92-01 (1992), with a look-ahead that
//! grows with the speed (Snider, "Automatic Steering Methods for Autonomous Automobile Path Tracking",
//! CMU-RI-TR-09-08 (2009), section 2.2) and a low-pass filter of the angle.

use config::{Parameters, RunConfig};
use tracking::Pose;

use super::{HeldSteering, Law, LawState, RawCommand};
use crate::Sight;

/// The law with the state of its low-pass filter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PurePursuit {
    /// Whether the look-ahead begins at the point of the path nearest to the rear axle, instead of at the reference.
    nearest: bool,
    steering: HeldSteering,
}

impl PurePursuit {
    /// The goal is taken to be at least this share of the look-ahead away: a goal beside the car would ask for a circle
    /// that no car can drive.
    const NEAREST_GOAL: f64 = 0.5;
}

impl Law for PurePursuit {
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

    /// With the parameters Kv (1/s), ld_min (m), ld_s (s) and the filter's share f, the wheelbase L, and the goal (x, y)
    /// in the frame of the rear axle, which lies ld_min + ld_s·|v| along the path ahead of it, at the distance d:
    ///
    /// δ = atan(2·L·y / d²),  φ = f·φ₋₁ + (1 − f)·δ,  v = v_ref + Kv·e_s,  φ within its limit.
    fn command(&mut self, parameters: &Parameters, sight: &Sight) -> RawCommand {
        let [kv, ld_min_m, ld_s, filter, ..] = parameters.0;
        let rear = sight.rear_axle();
        let ahead_m = ld_min_m + ld_s * sight.speed_mps.abs();
        let from_m =
            if self.nearest { sight.project(rear).along_m } else { sight.reference_along_m() };
        let (x_m, y_m) = seen_from(rear, sight.path_ahead_or_beyond(from_m, ahead_m));
        let nearest_m = Self::NEAREST_GOAL * ahead_m;
        let apart_m2 = (x_m * x_m + y_m * y_m).max(nearest_m * nearest_m);
        let wheelbase_m = sight.wheelbase_m();
        let delta = libm::atan2(2.0 * wheelbase_m * y_m, apart_m2);
        let phi = self.steering.filter(filter, delta);
        RawCommand::following(sight, kv, phi)
    }
}

/// A position in the frame of a pose: ahead of it, and to its left.
fn seen_from(pose: Pose, at: Pose) -> (f64, f64) {
    let (dx, dy) = (at.x_m - pose.x_m, at.y_m - pose.y_m);
    let (sin, cos) = (libm::sin(pose.yaw_rad), libm::cos(pose.yaw_rad));
    (dx * cos + dy * sin, dy * cos - dx * sin)
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::Layers;
    use tracking::Reference;

    fn config(sets: &[&str]) -> RunConfig {
        let mut layers = Layers::maneuver("lane_change").unwrap();
        layers.set_law("test", "pure_pursuit").unwrap();
        for set in sets {
            layers.set(set).unwrap();
        }
        layers.resolve().unwrap()
    }

    /// The command beside a path of one piece, 7 s after the start.
    fn command(sets: &[&str], rear: Pose, speed_mps: f64, parameters: &[f64]) -> RawCommand {
        let config = config(sets);
        let mut reference = Reference::new(&config);
        let tracked = rear.ahead(config.vehicle.tracked_point_m);
        let pose = Pose { x_m: tracked.x, y_m: tracked.y, yaw_rad: rear.yaw_rad };
        let reference_pose = reference.advance(700.0, pose);
        let sight = Sight::new(&config, &reference, 700.0, reference_pose, pose, speed_mps, 0.0);
        let mut law = PurePursuit::new(&config);
        law.restart(0.2);
        law.command(&Parameters::of(parameters), &sight)
    }

    const STRAIGHT: &str = "path.pieces=[{kind='straight',length_m=50.0}]";

    #[test]
    fn one_tick_by_hand() {
        // Half a metre to the left of a straight path, heading 0.1 away from it; the goal is 2 + 0.8 · 2 = 3.6 m ahead.
        let rear = Pose { x_m: 10.0, y_m: 0.5, yaw_rad: 0.1 };
        let command = command(&[STRAIGHT], rear, 2.0, &[0.0, 2.0, 0.8, 0.25]);
        // In the frame of the rear axle: α is the angle to the goal, and δ = atan(2·L·sin α / d).
        let apart_m = libm::hypot(3.6, 0.5);
        let alpha_rad = libm::atan2(-0.5, 3.6) - 0.1;
        let delta = libm::atan(2.0 * 2.875 * libm::sin(alpha_rad) / apart_m);
        assert!((command.steering_rad - (0.25 * 0.2 + 0.75 * delta)).abs() < 1e-9, "{command:?}");
        assert_eq!(command.speed_mps, 1.5);
    }

    #[test]
    fn on_a_circle_the_wheels_are_those_of_the_circle() {
        let arc = "path.pieces=[{kind='arc',radius_m=20.0,angle_deg=90.0}]";
        let yaw_rad = 0.3_f64;
        let (sin, cos) = (libm::sin(yaw_rad), libm::cos(yaw_rad));
        let rear = Pose { x_m: 20.0 * sin, y_m: 20.0 * (1.0 - cos), yaw_rad };
        for ahead_m in [0.5, 2.0, 8.0] {
            let command = command(&[arc], rear, 1.0, &[1.0, ahead_m, 0.0, 0.0]);
            let wanted_rad = libm::atan(2.875 / 20.0);
            assert!((command.steering_rad - wanted_rad).abs() < 1e-9, "{ahead_m}: {command:?}");
        }
    }

    #[test]
    fn beyond_the_path_it_goes_straight_on() {
        let rear = Pose { x_m: 49.5, y_m: 0.0, yaw_rad: 0.0 };
        let end = command(&[STRAIGHT], rear, 1.0, &[0.0, 4.0, 0.0, 0.0]);
        assert_eq!(end.steering_rad, 0.0);
    }

    #[test]
    fn the_look_ahead_may_begin_at_the_reference() {
        let setting = "law.settings.errors_at=reference";
        // The reference is 9.75 m along: the car, 3 m behind it and 0.5 m aside, looks 5 m ahead.
        let rear = Pose { x_m: 6.75, y_m: 0.5, yaw_rad: 0.0 };
        let command = command(&[STRAIGHT, setting], rear, 1.0, &[0.0, 2.0, 0.0, 0.0]);
        let wanted_rad = libm::atan(2.0 * 2.875 * -0.5 / (5.0 * 5.0 + 0.25));
        assert!((command.steering_rad - wanted_rad).abs() < 1e-9, "{command:?}");
    }
}
