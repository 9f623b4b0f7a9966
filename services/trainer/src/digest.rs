//! The digest of a training: what each learner received and became, and nothing else.

use ipc_types::DriveReport;
use sha2::{Digest, Sha256};

use crate::Training;

/// SHA-256 over the learners in order, as hexadecimal digits. Knows no batch, slot, attempt, process or time.
pub fn digest(training: &Training) -> String {
    let mut digest = Sha256::new();
    for learner in training.learners() {
        learner.digest_into(&mut digest);
    }
    to_hex(&digest.finalize())
}

/// SHA-256 over the reports of a list of drives, as hexadecimal digits.
pub(crate) fn digest_of_reports(reports: &[DriveReport]) -> String {
    let mut digest = Sha256::new();
    for report in reports {
        let errors =
            [report.mean_abs_along_m, report.mean_abs_cross_m, report.mean_abs_heading_rad];
        let more = [report.along_mse_m2, report.cross_mse_m2, report.max_abs_cross_m];
        let gains = config::Gains::from_parameters(&report.parameters).to_array();
        for number in gains.into_iter().chain(errors).chain(more) {
            digest.update(number.to_bits().to_le_bytes());
        }
        let counts = [report.seed, report.ticks, report.steering_limited_ticks, report.trace];
        for count in counts.into_iter().chain([report.reason.into()]) {
            digest.update(count.to_le_bytes());
        }
    }
    to_hex(&digest.finalize())
}

pub(crate) fn to_hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
