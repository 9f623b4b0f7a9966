//! What a pipeline is made of, and what is known about it at its end.

use std::path::PathBuf;

use config::launch::Launch;
use config::{RunConfig, SweepPlan};
use outcome::{ProcessFacts, RecordingFacts, Recovery};
use runtime::Wait;

use crate::pipeline::interrupts::Interrupts;
use crate::pipeline::restart::Budget;
use crate::pipeline::sequencer::DriveCounts;
use crate::pipeline::services::Services;

/// What a pipeline is made of. It has been checked, so that only the machine can still prevent it from running.
pub(crate) struct Plan {
    pub(crate) config: RunConfig,
    pub(crate) launch: Launch,
    /// Our own services, for the roles that no command of the user's fills.
    pub(crate) services: Services,
    /// What is driven instead of a training.
    pub(crate) sweep: Option<SweepPlan>,
    pub(crate) folder: PathBuf,
    pub(crate) budget: Budget,
    /// Faults to inject: the script with its seed.
    pub(crate) chaos: Option<(String, u64)>,
    pub(crate) quiet: bool,
    /// How the ring waits, if the user has chosen.
    pub(crate) wait: Option<Wait>,
    /// How many rings share the drives, if that is decided.
    pub(crate) rings: Option<usize>,
    /// Priority of first-in-first-out scheduling for the ring, if requested.
    pub(crate) fifo: Option<u8>,
    pub(crate) interrupted: Interrupts,
}

/// What only the orchestrator knows about a pipeline that has ended.
#[derive(Debug)]
pub(crate) struct PipelineFacts {
    /// The signal that has ended it before its time, if one has.
    pub(crate) stopped_by: Option<i32>,
    /// The drive, by the clock, has waited for people in vain: bits of [`ipc_types::Safety::reasons`] for which its vehicle was
    /// stopped, 0 if it has not begun.
    pub(crate) out_of_patience: Option<u32>,
    pub(crate) counts: DriveCounts,
    /// In the order in which they started.
    pub(crate) processes: Vec<ProcessFacts>,
    pub(crate) recovery: Recovery,
    pub(crate) wall_s: f64,
    /// Mean time of a tick, from the request of a batch to its report.
    pub(crate) tick_ns: f64,
    /// What the recorder wrote; none if there is none, or if it did not live to tell.
    pub(crate) recording: Option<RecordingFacts>,
    /// How the processes waited for each other.
    pub(crate) waiting: &'static str,
    /// How many rings shared the drives.
    pub(crate) rings: usize,
}
