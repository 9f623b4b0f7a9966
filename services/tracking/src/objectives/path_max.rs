//! How far from the path a drive was at most.

use config::RunConfig;

use super::Measure;
use crate::DriveRecord;

/// Largest distance of the pose from the nearest point of the path, in m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PathMax;

impl Measure for PathMax {
    fn new(_: &RunConfig) -> Self {
        Self
    }

    fn of(&self, drive: &DriveRecord) -> f64 {
        drive.path_max_m
    }

    fn of_bound(&self, apart_m: f64) -> f64 {
        apart_m
    }
}
