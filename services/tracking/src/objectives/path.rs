//! How far from the path a drive was on average.

use config::RunConfig;

use super::Measure;
use crate::DriveRecord;

/// Mean distance of the pose from the nearest point of the path, in m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Path;

impl Measure for Path {
    fn new(_: &RunConfig) -> Self {
        Self
    }

    fn of(&self, drive: &DriveRecord) -> f64 {
        drive.path_mean_m
    }

    fn of_bound(&self, apart_m: f64) -> f64 {
        apart_m
    }
}
