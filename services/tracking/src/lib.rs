//! Where the vehicle is, where it should be, and how far apart the two are.
//!
//! Pure: no clock, no I/O, no log, no thread. Terms (REP-103 axes: x forward, y left, yaw counter-clockwise):
//!
//! - a *pose* is a position and a yaw in the map frame;
//! - a *path* is a chain of straight and circular segments, addressed by the distance along it;
//! - the *reference* is the pose that the vehicle should have at a tick;
//! - the *tracking error* is the reference's pose in the vehicle frame (the paper's equation 1, rotated);
//! - the *steering chain* is what a steering command goes through until it is an angle of the road wheels;
//! - *turning* is what becomes of that angle: the yaw rate of a car whose tyres slip a little.

// Tests may read and write files, start threads, and know the time.
#![cfg_attr(test, allow(clippy::disallowed_methods, clippy::disallowed_types))]

mod excitation;
mod laps;
mod objectives;
mod path;
mod record;
mod reference;
mod steering;
mod turning;
mod zones;

pub use excitation::{EXCITATION_S, excitation};
pub use laps::{Lap, LapRecorder};
pub use objectives::Objective;
pub use path::{Path, PathFollower, PathPoint};
pub use record::{Covered, DriveRecord, DriveRecorder, EndReason, TickMeasures, state_distance};
pub use reference::{FASTEST_CLOCK, Reference};
pub use steering::{DelayLine, Part, SteeringActuator, SteeringChain, SteeringStep, parts_of_tick};
pub use turning::{Turning, TurningStep};
pub use zones::ZoneTracker;

use nalgebra::{Rotation2, Vector2};

/// A pose in the map frame.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Pose {
    /// x in the map frame.
    pub x_m: f64,
    /// y in the map frame.
    pub y_m: f64,
    /// Yaw, counter-clockwise from the map's x axis; not wrapped.
    pub yaw_rad: f64,
}

impl From<config::PoseConfig> for Pose {
    fn from(pose: config::PoseConfig) -> Self {
        Self { x_m: pose.x_m, y_m: pose.y_m, yaw_rad: pose.yaw_rad }
    }
}

impl Pose {
    /// The position.
    pub fn position(&self) -> Vector2<f64> {
        Vector2::new(self.x_m, self.y_m)
    }

    /// The rotation from this pose's frame into the map frame.
    pub fn rotation(&self) -> Rotation2<f64> {
        // nalgebra is built with libm-force: the same sin and cos on every host.
        Rotation2::new(self.yaw_rad)
    }

    /// The point `ahead_m` in front of this pose, in the map frame.
    pub fn ahead(&self, ahead_m: f64) -> Vector2<f64> {
        self.position() + self.rotation() * Vector2::new(ahead_m, 0.0)
    }

    /// Whether every number of the pose is finite.
    pub fn is_finite(&self) -> bool {
        self.x_m.is_finite() && self.y_m.is_finite() && self.yaw_rad.is_finite()
    }
}

/// The reference's pose in the vehicle frame.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct TrackingError {
    /// Forward: positive where the vehicle is behind. The paper's ᵇe_x.
    pub along_track_m: f64,
    /// To the left: positive where the vehicle is to the right of the reference. The paper's ᵇe_y.
    pub cross_track_m: f64,
    /// Counter-clockwise, wrapped to [-π, π]. The paper's ᵇe_θ.
    pub heading_rad: f64,
}

/// The error of `pose` against `reference`: equation 1 of the paper, rotated into the vehicle frame.
///
/// # Examples
/// ```
/// use tracking::{Pose, tracking_error};
/// let reference = Pose { x_m: 0.0, y_m: 2.0, yaw_rad: 0.0 };
/// let error = tracking_error(reference, Pose::default());
/// assert_eq!(error.cross_track_m, 2.0); // the reference lies 2 m to the left
/// ```
pub fn tracking_error(reference: Pose, pose: Pose) -> TrackingError {
    let error = pose.rotation().inverse() * (reference.position() - pose.position());
    TrackingError {
        along_track_m: error.x,
        cross_track_m: error.y,
        heading_rad: wrap_angle(reference.yaw_rad - pose.yaw_rad),
    }
}

/// The same angle within [-π, π].
pub fn wrap_angle(angle_rad: f64) -> f64 {
    use std::f64::consts::TAU;
    // Most angles need no division; the sum makes the same 0.0 of -0.0.
    if angle_rad.abs() < 3.0 {
        return angle_rad + 0.0;
    }
    angle_rad - TAU * (angle_rad / TAU).round()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::f64::consts::PI;

    proptest! {
        #[test]
        fn wrapped_angles_are_small_and_the_same(angle in -1e3..1e3f64) {
            let wrapped = wrap_angle(angle);
            prop_assert!(wrapped.abs() <= PI + 1e-12);
            prop_assert!((libm::sin(wrapped) - libm::sin(angle)).abs() < 1e-9);
            prop_assert!((libm::cos(wrapped) - libm::cos(angle)).abs() < 1e-9);
        }

        #[test]
        fn the_error_is_the_same_wherever_the_map_begins(
            x in -100.0..100.0f64, y in -100.0..100.0f64, yaw in -3.0..3.0f64, turn in -3.0..3.0f64,
        ) {
            // Moves both poses by one rigid motion: the vehicle frame does not see it.
            let reference = Pose { x_m: 1.0, y_m: -2.0, yaw_rad: 0.3 };
            let pose = Pose { x_m: 0.5, y_m: 0.25, yaw_rad: yaw };
            let motion = Pose { x_m: x, y_m: y, yaw_rad: turn };
            let moved = |pose: Pose| {
                let at = motion.position() + motion.rotation() * pose.position();
                Pose { x_m: at.x, y_m: at.y, yaw_rad: pose.yaw_rad + turn }
            };
            let (still, there) =
                (tracking_error(reference, pose), tracking_error(moved(reference), moved(pose)));
            prop_assert!((still.along_track_m - there.along_track_m).abs() < 1e-9);
            prop_assert!((still.cross_track_m - there.cross_track_m).abs() < 1e-9);
            prop_assert!((still.heading_rad - there.heading_rad).abs() < 1e-9);
        }
    }

    #[test]
    fn signs_follow_rep_103() {
        let pose = Pose { x_m: 0.0, y_m: 0.0, yaw_rad: PI / 2.0 };
        let reference = Pose { x_m: -1.0, y_m: 2.0, yaw_rad: PI };
        let error = tracking_error(reference, pose);
        assert!((error.along_track_m - 2.0).abs() < 1e-12);
        assert!((error.cross_track_m - 1.0).abs() < 1e-12);
        assert!((error.heading_rad - PI / 2.0).abs() < 1e-12);
    }
}
