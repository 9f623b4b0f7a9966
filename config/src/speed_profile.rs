//! The speeds at which a car can drive a path.

use crate::Vehicle;
use crate::points::curvatures;

/// What a car can do, all m/s².
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct SpeedLimits {
    pub(crate) lateral_mps2: f64,
    pub(crate) acceleration_mps2: f64,
    pub(crate) deceleration_mps2: f64,
}

/// Lateral acceleration that no tyre of a car exceeds on a dry road, m/s²: the limit where the vehicle's file has none.
const GRIP_MPS2: f64 = 9.0;

impl SpeedLimits {
    /// The limits of a vehicle: its safety's, and what its pedals can do.
    pub(crate) fn of(vehicle: &Vehicle) -> Self {
        let safety = &vehicle.safety;
        Self {
            lateral_mps2: safety.lateral_acceleration_limit_mps2.min(GRIP_MPS2),
            acceleration_mps2: safety.acceleration_limit_mps2.min(vehicle.throttle_accel_mps2),
            deceleration_mps2: safety.deceleration_limit_mps2.min(vehicle.brake_decel_mps2),
        }
    }

    /// The same, each times a share.
    pub(crate) fn times(self, share: f64) -> Self {
        Self {
            lateral_mps2: share * self.lateral_mps2,
            acceleration_mps2: share * self.acceleration_mps2,
            deceleration_mps2: share * self.deceleration_mps2,
        }
    }
}

/// The highest speeds at evenly spaced points that are nowhere above `most_mps`, and obey the limits: v²·|κ| in each turn,
/// then forwards v² ≤ v₋₁² + 2·a·ds, and backwards for braking. A closed path is one whose last point is its first.
///
/// The first speed is not bound by the start from rest: the reference has a ramp of its own.
pub(crate) fn profile(points: &[[f64; 2]], most_mps: &[f64], limits: SpeedLimits) -> Vec<f64> {
    let count = points.len();
    let mut speeds_mps = most_mps.to_vec();
    let is_closed = points[0] == points[count - 1] && count > 2;
    for (index, curvature) in curvatures(points) {
        // The turn begins and ends between the points.
        for near in [index.saturating_sub(1), index, (index + 1).min(count - 1)] {
            let highest_mps = (limits.lateral_mps2 / curvature.max(1e-9)).sqrt();
            speeds_mps[near] = speeds_mps[near].min(highest_mps);
        }
    }
    if is_closed {
        speeds_mps[count - 1] = speeds_mps[count - 1].min(speeds_mps[0]);
    }
    let step_m = |index: usize| {
        libm::hypot(
            points[index + 1][0] - points[index][0],
            points[index + 1][1] - points[index][1],
        )
    };
    let reach =
        |from_mps: f64, mps2: f64, step_m: f64| (from_mps * from_mps + 2.0 * mps2 * step_m).sqrt();
    // What is behind the seam of a lap binds what is before it: twice around is enough.
    let is_round = is_closed && most_mps[count - 1] > 0.0;
    for _ in 0..if is_round { 2 } else { 1 } {
        for index in 0..count - 1 {
            let most = reach(speeds_mps[index], limits.acceleration_mps2, step_m(index));
            speeds_mps[index + 1] = speeds_mps[index + 1].min(most);
        }
        if is_round {
            speeds_mps[0] = speeds_mps[0].min(speeds_mps[count - 1]);
        }
        for index in (0..count - 1).rev() {
            let most = reach(speeds_mps[index + 1], limits.deceleration_mps2, step_m(index));
            speeds_mps[index] = speeds_mps[index].min(most);
        }
        if is_round {
            speeds_mps[count - 1] = speeds_mps[count - 1].min(speeds_mps[0]);
        }
    }
    speeds_mps
}

/// The first stretch on which the speeds change faster than `limits` allow: the point where it begins, and the
/// acceleration that it would take, m/s². Judged over 1 m of points that are `step_m` apart.
pub(crate) fn too_abrupt(
    speeds_mps: &[f64],
    step_m: f64,
    limits: SpeedLimits,
) -> Option<(usize, f64)> {
    let over = ((1.0 / step_m).round() as usize).clamp(1, speeds_mps.len() - 1);
    speeds_mps.windows(over + 1).enumerate().find_map(|(index, speeds)| {
        let (from, to) = (speeds[0], speeds[over]);
        let mps2 = (to * to - from * from) / (2.0 * over as f64 * step_m);
        let is_over = mps2 > limits.acceleration_mps2 || -mps2 > limits.deceleration_mps2;
        is_over.then_some((index, mps2))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: SpeedLimits =
        SpeedLimits { lateral_mps2: 3.0, acceleration_mps2: 2.0, deceleration_mps2: 4.0 };

    /// A straight of 40 m, a quarter turn of 6 m, and a straight again.
    fn bend() -> Vec<[f64; 2]> {
        let arc = 6.0 * std::f64::consts::FRAC_PI_2;
        (0..358)
            .map(|index| 0.25 * f64::from(index))
            .map(|s| {
                if s < 40.0 {
                    [s, 0.0]
                } else if s < 40.0 + arc {
                    let angle = (s - 40.0) / 6.0;
                    [40.0 + 6.0 * libm::sin(angle), 6.0 * (1.0 - libm::cos(angle))]
                } else {
                    [46.0, 6.0 + s - 40.0 - arc]
                }
            })
            .collect()
    }

    #[test]
    fn a_bend_is_slow_and_reached_and_left_within_the_limits() {
        let points = bend();
        let most = vec![8.5; points.len()];
        let speeds = profile(&points, &most, LIMITS);
        // Mid-bend: sqrt(3·6) = 4.24 m/s.
        let mid = 180;
        assert!((speeds[mid] - 18.0_f64.sqrt()).abs() < 0.05, "{}", speeds[mid]);
        assert_eq!((speeds[0], speeds[60]), (8.5, 8.5));
        assert_eq!(too_abrupt(&speeds, 0.25, LIMITS.times(1.001)), None);
        assert!(too_abrupt(&most, 0.25, LIMITS).is_none());
        // What the file allows bounds it, and so does a stop at the end.
        let mut slow = vec![3.0; points.len()];
        slow[357] = 0.0;
        let speeds = profile(&points, &slow, LIMITS);
        assert!(
            speeds.iter().all(|speed| *speed <= 3.0) && speeds[357] == 0.0 && speeds[mid] == 3.0
        );
        assert!((speeds[356] - (2.0 * 4.0 * 0.25_f64).sqrt()).abs() < 1e-9);
    }

    #[test]
    fn an_abrupt_speed_is_found_where_it_begins() {
        let mut speeds = vec![2.0; 100];
        speeds[50..].fill(6.0);
        let (index, mps2) = too_abrupt(&speeds, 0.25, LIMITS).unwrap();
        assert!((46..50).contains(&index) && mps2 > 10.0);
    }
}
