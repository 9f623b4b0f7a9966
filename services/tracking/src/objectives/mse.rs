//! The paper's figure of merit.

use config::RunConfig;

use super::Measure;
use crate::DriveRecord;

/// The mean of (e_x² + e_y²)/2 in m², the paper's equation 6.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Mse;

impl Measure for Mse {
    fn new(_: &RunConfig) -> Self {
        Self
    }

    fn of(&self, drive: &DriveRecord) -> f64 {
        drive.mse_m2()
    }

    fn of_bound(&self, apart_m: f64) -> f64 {
        0.5 * apart_m * apart_m
    }
}
