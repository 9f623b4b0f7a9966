//! The paper's distance of the mean errors to 0.

use config::RunConfig;

use super::Measure;
use crate::{DriveRecord, state_distance};

/// d = √(E_y² + w·E_θ²), the paper's equation 4; see [`state_distance`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Distance {
    heading_weight: f64,
}

impl Measure for Distance {
    fn new(config: &RunConfig) -> Self {
        Self { heading_weight: config.learning.heading_weight }
    }

    fn of(&self, drive: &DriveRecord) -> f64 {
        state_distance(drive.mean_abs_cross_m, drive.mean_abs_heading_rad, self.heading_weight)
    }

    fn of_bound(&self, apart_m: f64) -> f64 {
        apart_m
    }
}
