//! The exhaustive grid: every gain set, driven by plain calls, as the yardstick of a training.

use std::cmp::Ordering;

use config::{GridPosition, RunConfig};
use rollout::Rollout;

use crate::DriveRecord;

/// Distance and mse of every gain set, noise-free.
#[derive(Debug, Clone)]
pub struct Ranking {
    config: RunConfig,
    rollout: Rollout,
    drives: Vec<DriveRecord>,
}

impl Ranking {
    /// An empty ranking; [`Ranking::rank_more`] fills it.
    pub fn new(config: &RunConfig) -> Self {
        Self { config: config.clone(), rollout: Rollout::new(config), drives: Vec::new() }
    }

    /// The whole ranking at once.
    pub fn by_rollout(config: &RunConfig) -> Self {
        let mut ranking = Self::new(config);
        while ranking.rank_more(1000) {}
        ranking
    }

    /// Drives up to `count` more sets; whether there are any left.
    pub fn rank_more(&mut self, count: usize) -> bool {
        let grid = self.config.grid;
        let until = (self.drives.len() + count).min(grid.len());
        while self.drives.len() < until {
            let gains = grid.gains(grid.position(self.drives.len()));
            self.drives.push(self.rollout.drive(gains, None).into());
        }
        until < grid.len()
    }

    /// Number of sets.
    pub fn len(&self) -> usize {
        self.drives.len()
    }

    /// Whether nothing was ranked yet.
    pub fn is_empty(&self) -> bool {
        self.drives.is_empty()
    }

    /// The drive of a set of the grid.
    pub fn drive(&self, position: GridPosition) -> &DriveRecord {
        &self.drives[self.config.grid.index(position)]
    }

    /// Distance of a drive to the goal.
    pub fn distance_of(&self, drive: &DriveRecord) -> f64 {
        let weight = self.config.learning.heading_weight;
        tracking::state_distance(drive.mean_abs_cross_m, drive.mean_abs_heading_rad, weight)
    }

    /// Distance of a set of the grid.
    pub fn distance(&self, position: GridPosition) -> f64 {
        self.distance_of(self.drive(position))
    }

    /// Rank of a distance: 1 + the number of sets that are strictly better.
    pub fn rank_of_distance(&self, distance: f64) -> usize {
        1 + self.drives.iter().filter(|drive| self.distance_of(drive) < distance).count()
    }

    /// Rank of an mse: 1 + the number of sets that are strictly better.
    pub fn rank_of_mse(&self, mse_m2: f64) -> usize {
        1 + self.drives.iter().filter(|drive| drive.mse_m2() < mse_m2).count()
    }

    /// Rank of a set by its distance.
    pub fn rank_distance(&self, position: GridPosition) -> usize {
        self.rank_of_distance(self.distance(position))
    }

    /// Least distance of any set.
    pub fn best_distance(&self) -> f64 {
        self.drives.iter().map(|drive| self.distance_of(drive)).fold(f64::INFINITY, f64::min)
    }

    /// Least mse of any set.
    pub fn best_mse_m2(&self) -> f64 {
        self.drives.iter().map(DriveRecord::mse_m2).fold(f64::INFINITY, f64::min)
    }

    /// Lower distance first, then lower mse, then lower number in the grid.
    pub fn compare(&self, a: GridPosition, b: GridPosition) -> Ordering {
        let grid = self.config.grid;
        self.distance(a)
            .total_cmp(&self.distance(b))
            .then_with(|| self.drive(a).mse_m2().total_cmp(&self.drive(b).mse_m2()))
            .then_with(|| grid.index(a).cmp(&grid.index(b)))
    }

    /// Any set, also one outside the grid, driven once.
    pub fn drive_off_grid(&mut self, gains: config::Gains) -> DriveRecord {
        self.rollout.drive(gains, None).into()
    }
}
