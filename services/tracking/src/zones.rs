//! Which zone of the path the vehicle is in.

use config::{RunConfig, ZoneBy};

use crate::{Path, Pose};

/// Follows a vehicle through the zones of its path.
#[derive(Debug, Clone, PartialEq)]
pub struct ZoneTracker {
    path: Path,
    /// Where each zone of each lap begins, along the path; the first at 0.
    from_m: Vec<f64>,
    /// Zones of a lap.
    zones: usize,
    by: ZoneBy,
    hysteresis_m: f64,
    along_m: f64,
    /// Counted over all laps.
    zone: usize,
}

impl ZoneTracker {
    /// How far from the last projection the next one is looked for: many ticks of any speed, and less
    /// than paths usually take to come back to themselves.
    const WINDOW_M: f64 = 3.0;

    /// A tracker at the start of the path.
    pub fn new(config: &RunConfig) -> Self {
        let path = Path::new(&config.path);
        let zones = &config.path.zones;
        let of_lap = |lap: usize| zones.iter().map(move |zone| (lap, zone.from_m));
        let all = (0..path.laps()).flat_map(of_lap);
        Self {
            from_m: all.map(|(lap, from_m)| path.lap_from_m(lap) + from_m).collect(),
            zones: zones.len(),
            path,
            by: config.supervisor.zone_by,
            hysteresis_m: config.supervisor.zone_hysteresis_m,
            along_m: 0.0,
            zone: 0,
        }
    }

    /// Returns to the start of the path.
    pub fn reset(&mut self) {
        self.along_m = 0.0;
        self.zone = 0;
    }

    /// Goes on from a place along the path: the next update gives the zone there.
    pub fn resume(&mut self, along_m: f64) {
        self.along_m = along_m;
        self.zone = 0;
    }

    /// The zone, given the pose that is measured now and the reference's progress.
    pub fn update(&mut self, measured: Pose, reference_along_m: f64) -> usize {
        if self.zones == 1 {
            return 0;
        }
        self.along_m = match self.by {
            ZoneBy::Measured => {
                self.path.project(measured.x_m, measured.y_m, self.along_m, Self::WINDOW_M).along_m
            }
            ZoneBy::Reference => reference_along_m,
        };
        // The next zone begins at the border itself; the vehicle is back in the previous one only when it is behind the
        // border by the hysteresis.
        while self.from_m.get(self.zone + 1).is_some_and(|from_m| self.along_m >= *from_m) {
            self.zone += 1;
        }
        while self.along_m < self.from_m[self.zone] - self.hysteresis_m {
            self.zone -= 1;
        }
        self.zone % self.zones
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::Layers;

    #[test]
    fn a_zone_begins_at_its_border_and_is_left_behind_the_hysteresis() {
        let mut layers = Layers::maneuver("lane_change").unwrap();
        layers
            .set("path.zones=[{name='a',from_m=0.0},{name='b',from_m=1.0},{name='c',from_m=1.5}]")
            .unwrap();
        layers.set("path.pieces=[{kind='straight',length_m=9.0}]").unwrap();
        let mut zones = ZoneTracker::new(&layers.resolve().unwrap());
        let mut at = |x_m: f64| zones.update(Pose { x_m, ..Pose::default() }, 0.0);
        assert_eq!([at(0.0), at(0.99), at(1.0), at(0.51), at(0.49)], [0, 0, 1, 1, 0]);
        assert_eq!([at(2.0), at(1.1), at(0.9), at(0.1)], [2, 2, 1, 0]);
    }
}
