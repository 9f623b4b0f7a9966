//! The room between a path and the road's edges, where the path's file tells them.

use config::RunConfig;
use tracking::Path;

/// The least share of the way to an edge that stays when half of the body is taken off.
const LEAST_SHARE: f64 = 0.5;

/// How far the vehicle may be beside its path until its body reaches an edge of the road.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Road {
    /// Where the points of one lap are, along the path, and the room on the left and on the right of each.
    joints_m: Vec<f64>,
    room_m: Vec<[f64; 2]>,
}

impl Road {
    /// `None` if the edges are not known.
    pub(crate) fn new(config: &RunConfig, path: &Path) -> Option<Self> {
        let widths_m = &config.path.widths_m;
        if widths_m.is_empty() {
            return None;
        }
        // A line that passes an edge more closely than the body allows is meant so by whoever drew it.
        let half_m = config.vehicle.body_half_width_m;
        let room = |width_m: f64| (width_m - half_m).max(LEAST_SHARE * width_m);
        Some(Self {
            joints_m: path.joints_m().take(widths_m.len()).collect(),
            room_m: widths_m.iter().map(|sides| sides.map(room)).collect(),
        })
    }

    /// The room on one side of a place along the path, m.
    pub(crate) fn room_m(&self, along_m: f64, is_left: bool) -> f64 {
        let side = usize::from(!is_left);
        let lap_m = self.joints_m[self.joints_m.len() - 1];
        let in_lap_m = if along_m > lap_m { along_m % lap_m } else { along_m };
        let after = self.joints_m.partition_point(|joint| *joint <= in_lap_m);
        let (from, to) = (after.saturating_sub(1), after.min(self.joints_m.len() - 1));
        let span_m = self.joints_m[to] - self.joints_m[from];
        let share = if span_m > 0.0 { (in_lap_m - self.joints_m[from]) / span_m } else { 0.0 };
        let (first, last) = (self.room_m[from][side], self.room_m[to][side]);
        first + share.clamp(0.0, 1.0) * (last - first)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn road(laps: u32) -> Road {
        let mut config = config::Layers::maneuver("lane_change").unwrap().resolve().unwrap();
        config.vehicle.body_half_width_m = 0.5;
        config.path.pieces = Vec::new();
        config.path.points = vec![[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 0.0]];
        config.path.widths_m = vec![[2.0, 1.5], [4.0, 1.5], [4.0, 0.6], [2.0, 1.5]];
        config.path.laps = laps;
        Road::new(&config, &Path::new(&config.path)).unwrap()
    }

    #[test]
    fn the_body_keeps_off_both_edges_in_each_lap() {
        let road = road(3);
        let lap_m = road.joints_m[3];
        for lap in 0..3 {
            let along_m = f64::from(lap) * lap_m + 0.5 * road.joints_m[1];
            assert!((road.room_m(along_m, true) - 2.5).abs() < 1e-9, "{lap}");
            assert!((road.room_m(along_m, false) - 1.0).abs() < 1e-9, "{lap}");
        }
        // No more than half of the way is taken off, and the ends of the path have their own widths.
        assert!((road.room_m(road.joints_m[2], false) - 0.3).abs() < 1e-9);
        assert_eq!((road.room_m(-1.0, true), road.room_m(3.0 * lap_m, true)), (1.5, 1.5));
    }
}
