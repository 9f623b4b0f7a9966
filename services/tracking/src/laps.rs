//! The laps of a drive on a closed path: how long each took, and how far from the path it was driven.

use crate::{PathFollower, Reference};

/// One lap of a drive.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lap {
    /// From the tick at which it began to the one at which the next lap began or the path's end was reached; `None` if it
    /// was not driven to its end.
    pub time_s: Option<f64>,
    /// Mean distance of the pose from the nearest point of the path. The stretch on which a vehicle that starts from rest comes
    /// up to the path's speed is left out of every lap.
    pub path_mean_m: f64,
    /// Its largest value.
    pub path_max_m: f64,
    /// Whether the vehicle stood at some tick, as in a start from rest.
    pub stood: bool,
}

/// Adds up the laps of a drive, tick by tick. A lap begins at the first tick at which the nearest point of the path lies
/// in it.
///
/// A slow vehicle is nearer to its path. So that laps can be compared, their means are taken over the same stretch: from the
/// place at which the vehicle first came up to the path's speed.
#[derive(Debug, Clone)]
pub struct LapRecorder {
    reference: Reference,
    tick_s: f64,
    follower: PathFollower,
    laps: Vec<Lap>,
    /// Where the compared stretch of a lap begins; `None` until the vehicle has come up to speed.
    compared_from_m: Option<f64>,
    /// Of the lap under way: its first tick, the sum of the distances from the path, and how many.
    from_tick: u64,
    distance_m: f64,
    count: u64,
    last_tick: u64,
}

impl LapRecorder {
    /// A vehicle that is slower than this stands.
    const STANDS_BELOW_MPS: f64 = 0.05;
    /// One that drives at this share of the path's speed has come up to it.
    const UP_TO_SPEED: f64 = 0.9;
    /// One that has not come up to it by this share of the first lap does not start, but is slow: nothing is left out.
    const LONGEST_START: f64 = 0.5;

    /// Before the first tick of a drive, of which only path and speeds count.
    pub fn new(reference: Reference, tick_s: f64) -> Self {
        Self {
            reference,
            tick_s,
            follower: PathFollower::default(),
            laps: Vec::new(),
            compared_from_m: None,
            from_tick: 0,
            distance_m: 0.0,
            count: 0,
            last_tick: 0,
        }
    }

    /// Adds a tick: where the vehicle is in the map frame, true if that is known, and its speed. Ticks may be missing.
    pub fn add(&mut self, tick: u64, x_m: f64, y_m: f64, speed_mps: f64) {
        let path = self.reference.path();
        let distance_m = self.follower.distance_m(path, x_m, y_m);
        let along_m = self.follower.along_m(path, x_m, y_m);
        let (laps, reached) = (path.laps(), self.follower.lap(path));
        let (lap_m, place_m) = (path.length_m() / laps as f64, along_m - path.lap_from_m(reached));
        // One that is back behind the line, by noise, is still in the lap that had begun.
        while self.laps.len() <= reached {
            self.close(tick);
            self.laps.push(Lap { time_s: None, path_mean_m: 0.0, path_max_m: 0.0, stood: false });
        }
        if self.compared_from_m.is_none() {
            if reached > 0 || place_m > Self::LONGEST_START * lap_m {
                self.compared_from_m = Some(0.0);
            } else if speed_mps >= Self::UP_TO_SPEED * self.reference.path_speed_mps(along_m) {
                self.compared_from_m = Some(place_m);
                (self.distance_m, self.count) = (0.0, 0);
            }
        }
        if self.compared_from_m.is_none_or(|from_m| place_m >= from_m) {
            (self.distance_m, self.count) = (self.distance_m + distance_m, self.count + 1);
        }
        if let Some(lap) = self.laps.last_mut() {
            lap.path_mean_m = self.distance_m / self.count.max(1) as f64;
            lap.path_max_m = lap.path_max_m.max(distance_m);
            lap.stood |= speed_mps.abs() < Self::STANDS_BELOW_MPS;
        }
        self.last_tick = tick;
    }

    /// The laps of the drive; `arrived`: it ended at the path's end.
    pub fn finish(mut self, arrived: bool) -> Vec<Lap> {
        if arrived && self.laps.len() == self.reference.path().laps() {
            self.close(self.last_tick);
        }
        self.laps
    }

    /// Ends the lap under way at a tick.
    fn close(&mut self, tick: u64) {
        if let Some(lap) = self.laps.last_mut() {
            lap.time_s = Some((tick - self.from_tick) as f64 * self.tick_s);
            self.from_tick = tick;
        }
        (self.distance_m, self.count) = (0.0, 0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::Layers;
    use std::f64::consts::TAU;

    #[test]
    fn laps_are_compared_from_where_the_vehicle_came_up_to_speed() {
        let mut layers = Layers::maneuver("lane_change").unwrap();
        layers.set("reference.speed_mps=2.0").unwrap();
        let mut config = layers.resolve().unwrap();
        let ring = |index: usize| {
            let (sin, cos) = (TAU * (index % 60) as f64 / 60.0).sin_cos();
            [20.0 * cos, 20.0 * sin]
        };
        (config.path.pieces, config.path.points) = (Vec::new(), (0..=60).map(ring).collect());
        config.path.laps = 2;
        // A tenth of a metre outside, but for the first 20 m of each lap; slow only there, in the first lap.
        let means_m = |slow_mps: f64| -> Vec<f64> {
            let mut laps = LapRecorder::new(Reference::new(&config), 0.1);
            for tick in 0..600_u32 {
                let along_m = 2.0 * TAU * 20.0 * f64::from(tick) / 600.0;
                let starts = along_m % (TAU * 20.0) < 20.0;
                let radius_m = if starts { 20.0 } else { 20.1 };
                let (sin, cos) = (along_m / 20.0).sin_cos();
                let speed_mps = if along_m < 20.0 { slow_mps } else { 2.0 };
                laps.add(tick.into(), radius_m * cos, radius_m * sin, speed_mps);
            }
            laps.finish(true).iter().map(|lap| lap.path_mean_m).collect()
        };
        let near = |found: &[f64], wanted: f64| {
            assert!(
                found.len() == 2 && found.iter().all(|it| (it - wanted).abs() < 2e-3),
                "{found:?}"
            );
        };
        near(&means_m(0.5), 0.1);
        near(&means_m(2.0), 0.1 * (1.0 - 1.0 / TAU));
    }
}
