//! What a pipeline is made of, and what is known of it at its end.

use std::path::PathBuf;

use config::launch::Launch;
use config::{RunConfig, SweepPlan};
use outcome::ProcessFacts;
use runtime::Wait;

use crate::pipeline::interrupts::Interrupts;
use crate::pipeline::recovery::Recovery;
use crate::pipeline::restart::Budget;
use crate::pipeline::sequencer::DriveCounts;
use crate::pipeline::services::Services;

/// What a pipeline is made of: checked, so that only the machine can still keep it from running.
pub(crate) struct Plan {
    pub(crate) config: RunConfig,
    pub(crate) launch: Launch,
    /// Our own services, for the roles that no command fills.
    pub(crate) services: Services,
    /// What is driven instead of a training.
    pub(crate) sweep: Option<SweepPlan>,
    pub(crate) folder: PathBuf,
    pub(crate) budget: Budget,
    /// Faults on purpose: the script with its seed.
    pub(crate) chaos: Option<(String, u64)>,
    pub(crate) quiet: bool,
    /// How the ring waits, if somebody has said.
    pub(crate) wait: Option<Wait>,
    /// Priority of first-in-first-out scheduling of the ring, if it was asked for.
    pub(crate) fifo: Option<u8>,
    pub(crate) interrupted: Interrupts,
}

/// What only the orchestrator knows of a pipeline that has come to its end.
#[derive(Debug)]
pub(crate) struct PipelineFacts {
    pub(crate) counts: DriveCounts,
    /// In the order in which they started.
    pub(crate) processes: Vec<ProcessFacts>,
    pub(crate) recovery: Recovery,
    pub(crate) wall_s: f64,
    /// Mean time of a tick, from the request of a batch to its report.
    pub(crate) tick_ns: f64,
    /// How the processes waited for each other.
    pub(crate) waiting: &'static str,
}
