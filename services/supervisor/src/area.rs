//! The area in which the vehicle may drive: it is stopped before its body leaves it.

use config::{RunConfig, Vehicle};
use ipc_types::Safety;
use tracking::Pose;

use crate::Movement;

/// A command takes effect this much later than it is decided on, at least.
const REACTION_S: f64 = 0.1;

/// What a vehicle needs of the ground: its body, and the way to a stop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Footprint {
    /// From the tracked point to the ends of the body, and to its sides.
    front_m: f64,
    rear_m: f64,
    half_width_m: f64,
    deceleration_mps2: f64,
    delay_s: f64,
}

impl Footprint {
    /// That of a vehicle's file.
    pub fn new(vehicle: &Vehicle) -> Self {
        Self {
            front_m: vehicle.body_front_m - vehicle.tracked_point_m,
            rear_m: vehicle.body_rear_m + vehicle.tracked_point_m,
            half_width_m: vehicle.body_half_width_m,
            deceleration_mps2: vehicle.safety.stop_deceleration_mps2,
            delay_s: REACTION_S + vehicle.speed_delay_s,
        }
    }

    /// The corners (x, y) of the ground that the body covers until the vehicle stands, if it brakes now and drives straight
    /// on: m, in the frame of the pose.
    #[inline]
    pub fn corners_m(&self, pose: Pose, speed_mps: f64) -> [[f64; 2]; 4] {
        let (sin, cos) = (libm::sin(pose.yaw_rad), libm::cos(pose.yaw_rad));
        let speed_mps = speed_mps.max(0.0);
        let stop_m = speed_mps * (self.delay_s + 0.5 * speed_mps / self.deceleration_mps2);
        let (front_m, side_m) = (self.front_m + stop_m, self.half_width_m);
        let corners = [
            (front_m, side_m),
            (front_m, -side_m),
            (-self.rear_m, side_m),
            (-self.rear_m, -side_m),
        ];
        corners.map(|(ahead_m, left_m)| {
            [pose.x_m + ahead_m * cos - left_m * sin, pose.y_m + ahead_m * sin + left_m * cos]
        })
    }
}

/// The area of one vehicle, as `drive.area_m` has it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Area {
    /// Least and largest x, least and largest y.
    bounds_m: [f64; 4],
    footprint: Footprint,
    faults: u32,
}

impl Area {
    /// `None` if it is not bounded.
    pub(crate) fn new(config: &RunConfig) -> Option<Self> {
        let bounds_m = config.drive.area_m;
        let footprint = Footprint::new(&config.vehicle);
        let is_bounded = bounds_m.iter().any(|bound| bound.is_finite());
        is_bounded.then_some(Self { bounds_m, footprint, faults: 0 })
    }

    /// Takes odometry that is believed.
    #[inline]
    pub(crate) fn see(&mut self, movement: Movement) {
        let [least_x, most_x, least_y, most_y] = self.bounds_m;
        let is_inside =
            |[x, y]: [f64; 2]| (least_x..=most_x).contains(&x) && (least_y..=most_y).contains(&y);
        let corners = self.footprint.corners_m(movement.pose, movement.speed_mps);
        self.faults = if corners.into_iter().all(is_inside) { 0 } else { Safety::AREA };
    }

    /// [`Safety::AREA`], if the vehicle would leave the area even if it braked now.
    pub(crate) fn faults(&self) -> u32 {
        self.faults
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_body_and_the_way_to_a_stop_stay_inside() {
        let mut config = config::Layers::maneuver("lane_change").unwrap().resolve().unwrap();
        assert_eq!(Area::new(&config), None);
        config.drive.area_m = [-10.0, 10.0, -5.0, f64::INFINITY];
        let vehicle = &mut config.vehicle;
        (vehicle.body_front_m, vehicle.body_rear_m, vehicle.body_half_width_m) = (4.0, 1.0, 1.0);
        (vehicle.tracked_point_m, vehicle.speed_delay_s) = (1.0, 0.0);
        vehicle.safety.stop_deceleration_mps2 = 2.0;
        let mut area = Area::new(&config).unwrap();
        let mut fault_at = |x_m: f64, y_m: f64, yaw_rad: f64, speed_mps: f64| {
            let pose = Pose { x_m, y_m, yaw_rad };
            area.see(Movement { pose, speed_mps, yaw_rate_radps: 0.0 });
            area.faults() != 0
        };
        // The front is 3 m ahead of the point, and a stop from 2 m/s takes 1.2 m.
        assert_eq!((fault_at(5.7, 0.0, 0.0, 2.0), fault_at(5.9, 0.0, 0.0, 2.0)), (false, true));
        assert_eq!((fault_at(6.9, 0.0, 0.0, 0.0), fault_at(7.1, 0.0, 0.0, 0.0)), (false, true));
        // Its rear is 2 m behind, its sides 1 m beside; and the other way round.
        assert_eq!((fault_at(-7.9, 0.0, 0.0, 0.0), fault_at(-8.1, 0.0, 0.0, 0.0)), (false, true));
        assert_eq!((fault_at(0.0, -3.9, 0.0, 0.0), fault_at(0.0, -4.1, 0.0, 0.0)), (false, true));
        let back = std::f64::consts::PI;
        assert_eq!((fault_at(7.9, 0.0, back, 2.0), fault_at(8.1, 0.0, back, 2.0)), (false, true));
        assert!(!fault_at(0.0, 1e9, 0.0, 0.0));
        assert!(fault_at(f64::NAN, 0.0, 0.0, 0.0));
    }
}
