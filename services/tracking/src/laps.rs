//! The laps of a drive on a closed path: how long each took, and how far from the path it was driven.

use crate::{Path, PathFollower};

/// One lap of a drive.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lap {
    /// From the tick at which it began to the one at which the next lap began or the path's end was reached; `None` if it
    /// was not driven to its end.
    pub time_s: Option<f64>,
    /// Mean distance of the pose from the nearest point of the path.
    pub path_mean_m: f64,
    /// Its largest value.
    pub path_max_m: f64,
    /// Whether the vehicle stood at some tick, as in a start from rest.
    pub stood: bool,
}

/// Adds up the laps of a drive, tick by tick. A lap begins at the first tick at which the nearest point of the path lies
/// in it.
#[derive(Debug, Clone)]
pub struct LapRecorder {
    path: Path,
    tick_s: f64,
    follower: PathFollower,
    laps: Vec<Lap>,
    /// Of the lap under way: its first tick, the sum of the distances from the path, and how many.
    from_tick: u64,
    distance_m: f64,
    count: u64,
    last_tick: u64,
}

impl LapRecorder {
    /// A vehicle that is slower than this stands.
    const STANDS_BELOW_MPS: f64 = 0.05;

    /// Before the first tick of a drive.
    pub fn new(path: Path, tick_s: f64) -> Self {
        Self {
            path,
            tick_s,
            follower: PathFollower::default(),
            laps: Vec::new(),
            from_tick: 0,
            distance_m: 0.0,
            count: 0,
            last_tick: 0,
        }
    }

    /// Adds a tick: where the vehicle is in the map frame, true if that is known, and its speed. Ticks may be missing.
    pub fn add(&mut self, tick: u64, x_m: f64, y_m: f64, speed_mps: f64) {
        let distance_m = self.follower.distance_m(&self.path, x_m, y_m);
        // One that is back behind the line, by noise, is still in the lap that had begun.
        while self.laps.len() <= self.follower.lap(&self.path) {
            self.close(tick);
            self.laps.push(Lap { time_s: None, path_mean_m: 0.0, path_max_m: 0.0, stood: false });
        }
        (self.distance_m, self.count) = (self.distance_m + distance_m, self.count + 1);
        if let Some(lap) = self.laps.last_mut() {
            lap.path_mean_m = self.distance_m / self.count as f64;
            lap.path_max_m = lap.path_max_m.max(distance_m);
            lap.stood |= speed_mps.abs() < Self::STANDS_BELOW_MPS;
        }
        self.last_tick = tick;
    }

    /// The laps of the drive; `arrived`: it ended at the path's end.
    pub fn finish(mut self, arrived: bool) -> Vec<Lap> {
        if arrived && self.laps.len() == self.path.laps() {
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
