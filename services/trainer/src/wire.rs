//! Turns reports as they come over the wire into what the rest of the trainer works with; this happens only here.

use ipc_types::DriveReport;
use tracking::{DriveRecord, EndReason};

/// A drive of a list that was made: its report, and its record.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Driven {
    /// The report.
    pub report: DriveReport,
    /// The same as a record.
    pub record: DriveRecord,
}

impl From<DriveReport> for Driven {
    fn from(report: DriveReport) -> Self {
        Self { record: record_of(&report), report }
    }
}

/// The record of the drive that a report describes.
pub(crate) fn record_of(report: &DriveReport) -> DriveRecord {
    DriveRecord {
        ticks: report.ticks,
        reason: match report.reason {
            DriveReport::GOAL => EndReason::Goal,
            DriveReport::COLLISION => EndReason::Collision,
            DriveReport::HELD => EndReason::Held,
            DriveReport::STOPPED => EndReason::Stopped,
            _ => EndReason::Time,
        },
        mean_abs_along_m: report.mean_abs_along_m,
        mean_abs_cross_m: report.mean_abs_cross_m,
        mean_abs_heading_rad: report.mean_abs_heading_rad,
        along_mse_m2: report.along_mse_m2,
        cross_mse_m2: report.cross_mse_m2,
        max_abs_cross_m: report.max_abs_cross_m,
        steering_limited_ticks: report.steering_limited_ticks,
        trace: report.trace,
        path_mean_m: report.path_mean_m,
        path_p95_m: report.path_p95_m,
        path_max_m: report.path_max_m,
        progress: report.progress,
        progress_in_time: report.progress_in_time,
        steering_rate_p95_radps: report.steering_rate_p95_radps,
        lateral_acceleration_p95_mps2: report.lateral_acceleration_p95_mps2,
        lateral_jerk_p95_mps3: report.lateral_jerk_p95_mps3,
        lateral_jerk_max_mps3: report.lateral_jerk_max_mps3,
        steering_travel_radps: report.steering_travel_radps,
        lateral_acceleration_max_mps2: report.lateral_acceleration_max_mps2,
        stopped_for: report.stopped_for,
        slowed_for: report.slowed_for,
        missed: 0.0,
    }
}
