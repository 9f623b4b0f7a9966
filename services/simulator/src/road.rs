//! The road: where the body may be. Its edges run along both sides of the path.

use config::{RunConfig, Vehicle};
use nalgebra::Vector2;
use tracking::{Path, Pose};

/// The road of a path, and where along it the vehicle was last.
#[derive(Debug, Clone)]
pub(crate) struct Road {
    path: Path,
    half_width_m: f64,
    along_m: f64,
}

impl Road {
    const WINDOW_M: f64 = 3.0;

    /// The road of a configuration, if its edges are watched.
    pub(crate) fn new(config: &RunConfig) -> Option<Self> {
        let collision = config.collision;
        collision.enabled.then(|| Self {
            path: Path::new(&config.path),
            half_width_m: collision.lane_half_width_m + collision.margin_m,
            along_m: 0.0,
        })
    }

    /// Returns to the start of the path.
    pub(crate) fn reset(&mut self) {
        self.along_m = 0.0;
    }

    /// Whether a corner of the body is off the road.
    pub(crate) fn is_left(&mut self, vehicle: &Vehicle, rear_axle: Pose) -> bool {
        let near = self.path.project(rear_axle.x_m, rear_axle.y_m, self.along_m, Self::WINDOW_M);
        self.along_m = near.along_m;
        let reach_m = vehicle.body_front_m + vehicle.body_rear_m + Self::WINDOW_M;
        let half_width_m = vehicle.body_half_width_m;
        [
            (vehicle.body_front_m, half_width_m),
            (vehicle.body_front_m, -half_width_m),
            (-vehicle.body_rear_m, half_width_m),
            (-vehicle.body_rear_m, -half_width_m),
        ]
        .into_iter()
        .any(|(ahead_m, left_m)| {
            let corner =
                rear_axle.position() + rear_axle.rotation() * Vector2::new(ahead_m, left_m);
            !self.holds(corner, reach_m)
        })
    }

    fn holds(&self, corner: Vector2<f64>, reach_m: f64) -> bool {
        let point = self.path.project(corner.x, corner.y, self.along_m, reach_m);
        // Beyond the path's ends there is no edge: only the sideways distance counts.
        let at_end = point.along_m <= 0.0 || point.along_m >= self.path.length_m();
        let apart_m = if at_end {
            point.offset_m.abs()
        } else {
            libm::hypot(corner.x - point.pose.x_m, corner.y - point.pose.y_m)
        };
        apart_m <= self.half_width_m
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::Layers;

    #[test]
    fn the_edges_are_beside_the_body() {
        let check = |sets: &[&str], y_m: f64, left: bool| {
            let mut layers = Layers::maneuver("lane_change").unwrap();
            layers.set("path.pieces=[{kind='straight',length_m=50.0}]").unwrap();
            for set in sets {
                layers.set(set).unwrap();
            }
            let config = layers.resolve().unwrap();
            let mut road = Road::new(&config).unwrap();
            let pose = Pose { y_m, ..Pose::default() };
            assert_eq!(road.is_left(&config.vehicle, pose), left, "{sets:?} at {y_m}");
        };
        let lane_alone = ["collision.enabled=true", "collision.margin_m=0"];
        check(&lane_alone, 0.0, false);
        check(&lane_alone, 0.82, false);
        check(&lane_alone, -0.84, true);
        check(&lane_alone[..1], 4.32, false);
        check(&lane_alone[..1], 4.34, true);
    }
}
