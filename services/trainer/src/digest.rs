//! The digest of a training: what each learner received and became, and nothing else.

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

pub(crate) fn to_hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
