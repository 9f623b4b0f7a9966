//! How the reference pose advances along the path.

use config::{Advance, RunConfig};

use crate::{Path, Pose};

/// The pose that the vehicle should have, tick by tick.
#[derive(Debug, Clone, PartialEq)]
pub struct Reference {
    path: Path,
    advance: Advance,
    lookahead_m: f64,
    speed_mps: f64,
    ramp_s: f64,
    tick_s: f64,
    along_m: f64,
}

impl Reference {
    /// How far from the last projection the next one is looked for, with [`Advance::Projection`].
    const WINDOW_M: f64 = 3.0;

    /// The reference of a configuration, at the start of its path.
    pub fn new(config: &RunConfig) -> Self {
        Self {
            path: Path::new(&config.path),
            advance: config.reference.advance,
            lookahead_m: config.reference.lookahead_m,
            speed_mps: config.reference.speed_mps,
            ramp_s: config.reference.ramp_s,
            tick_s: config.drive.tick_s,
            along_m: 0.0,
        }
    }

    /// Moves to `tick`, with the pose that was measured there, and returns the reference pose.
    pub fn advance(&mut self, tick: u64, measured: Pose) -> Pose {
        match self.advance {
            Advance::Time => {
                self.along_m = self.distance_after(tick as f64 * self.tick_s);
                self.path.at(self.along_m)
            }
            Advance::Projection => {
                let (x_m, y_m) = (measured.x_m, measured.y_m);
                self.along_m = self.path.project(x_m, y_m, self.along_m, Self::WINDOW_M).along_m;
                self.path.at(self.along_m + self.lookahead_m)
            }
        }
    }

    /// Back to the start of the path.
    pub fn reset(&mut self) {
        self.along_m = 0.0;
    }

    /// Progress along the path.
    pub fn along_m(&self) -> f64 {
        self.along_m.min(self.path.length_m())
    }

    /// The path.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Whether the reference has reached the end of the path.
    pub fn at_end(&self) -> bool {
        let ahead_m = if self.advance == Advance::Projection { self.lookahead_m } else { 0.0 };
        self.along_m + ahead_m >= self.path.length_m()
    }

    /// Distance run after a time: a linear ramp from rest, then the set speed.
    fn distance_after(&self, time_s: f64) -> f64 {
        if time_s < self.ramp_s {
            0.5 * self.speed_mps * time_s * time_s / self.ramp_s
        } else {
            self.speed_mps * (time_s - 0.5 * self.ramp_s)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::Layers;

    fn lane_change(sets: &[&str]) -> Reference {
        let mut layers = Layers::maneuver("lane_change").unwrap();
        for set in sets {
            layers.set(set).unwrap();
        }
        Reference::new(&layers.resolve().unwrap())
    }

    #[test]
    fn the_ramp_ends_at_the_set_speed() {
        let mut reference = lane_change(&[]);
        let measured = Pose::default();
        reference.advance(0, measured);
        assert_eq!(reference.along_m(), 0.0);
        reference.advance(100, measured);
        assert!((reference.along_m() - 0.75).abs() < 1e-12);
        reference.advance(300, measured);
        assert!((reference.along_m() - 3.75).abs() < 1e-12);
        assert!(!reference.at_end());
    }

    #[test]
    fn a_projected_reference_keeps_its_distance() {
        let mut reference =
            lane_change(&["reference.advance=projection", "reference.lookahead_m=0.5"]);
        let pose = reference.advance(7, Pose { x_m: 0.2, y_m: 0.4, yaw_rad: 0.0 });
        assert!((pose.x_m - 0.7).abs() < 1e-12 && pose.y_m == 0.0);
    }
}
