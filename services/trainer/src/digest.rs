//! The digest of a training: what each learner received and became, and nothing else.
//!
//! The list of fields is frozen, so that the same training has the same digest in every version. For each learner, in
//! order:
//!
//! 1. for each drive that it received, in the order of its steps: the law's parameters; `mean_abs_along_m`,
//!    `mean_abs_cross_m`, `mean_abs_heading_rad`, `along_mse_m2`, `cross_mse_m2`; `ticks`; 1 for a collision, else 0;
//!    and `trace`, which covers every pose and every command. They go through a SHA-256 of their own, whose
//!    32 bytes are hashed;
//! 2. what it became, as its tuner tells by [`Tuner::digest_into`](crate::Tuner::digest_into). The Q-learning tuners add
//!    the learning rate, the steps, the Q-table, the visits of its entries, the visits of the sets, the locked places,
//!    and the set that the learner picks.
//!
//! Numbers enter as their bits, lowest byte first. The digest contains no batch, slot, attempt, process or time, and no
//! measure that was added later: those of [`DriveRecord`] that are not named above stay outside.

use config::Parameters;
use sha2::digest::common::hazmat::SerializableState;
use sha2::{Digest, Sha256};
use tracking::DriveRecord;

use crate::Training;
use crate::wire::Driven;

/// SHA-256 over the learners in order, as hexadecimal digits.
pub fn digest(training: &Training) -> String {
    let mut digest = Sha256::new();
    for learner in 0..training.tuner().learners() {
        digest.update(training.received(learner));
        training.tuner().digest_into(learner, &mut digest);
    }
    to_hex(&digest.finalize())
}

/// Hashes what a learner receives, as it receives it.
#[derive(Debug, Clone, Default)]
pub(crate) struct Received(Sha256);

impl Received {
    pub(crate) fn add(&mut self, parameters: &[f64], drive: &DriveRecord) {
        let DriveRecord { mean_abs_along_m, mean_abs_cross_m, mean_abs_heading_rad, .. } = *drive;
        let errors = [mean_abs_along_m, mean_abs_cross_m, mean_abs_heading_rad];
        add_numbers(&mut self.0, parameters);
        add_numbers(&mut self.0, &errors);
        add_numbers(&mut self.0, &[drive.along_mse_m2, drive.cross_mse_m2]);
        self.0.update(drive.ticks.to_le_bytes());
        self.0.update([u8::from(drive.collided())]);
        self.0.update(drive.trace.to_le_bytes());
    }

    pub(crate) fn hash(&self) -> [u8; 32] {
        self.0.clone().finalize().into()
    }

    /// The hash under way, as bytes.
    pub(crate) fn save(&self) -> Vec<u8> {
        self.0.serialize().to_vec()
    }

    /// Goes on with a hash that was saved.
    pub(crate) fn restored(saved: &[u8]) -> Option<Self> {
        let saved = saved.try_into().ok()?;
        Sha256::deserialize(&saved).ok().map(Self)
    }
}

/// SHA-256 over the reports of a list of drives, as hexadecimal digits; `count` is the number of the law's parameters.
pub(crate) fn digest_of_drives(drives: &[Driven], count: usize) -> String {
    let mut digest = Sha256::new();
    for Driven { report, .. } in drives {
        add_numbers(&mut digest, &report.parameters[..count]);
        let errors =
            [report.mean_abs_along_m, report.mean_abs_cross_m, report.mean_abs_heading_rad];
        add_numbers(&mut digest, &errors);
        let more = [report.along_mse_m2, report.cross_mse_m2, report.max_abs_cross_m];
        add_numbers(&mut digest, &more);
        let counts = [report.seed, report.ticks, report.steering_limited_ticks, report.trace];
        for count in counts.into_iter().chain([report.reason.into()]) {
            digest.update(count.to_le_bytes());
        }
    }
    to_hex(&digest.finalize())
}

/// Adds parameters; those beyond the law's own are 0, and count.
pub(crate) fn add_parameters(digest: &mut Sha256, parameters: &Parameters) {
    add_numbers(digest, &parameters.0);
}

fn add_numbers(digest: &mut Sha256, numbers: &[f64]) {
    for number in numbers {
        digest.update(number.to_bits().to_le_bytes());
    }
}

pub(crate) fn to_hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
