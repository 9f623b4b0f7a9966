//! A ring of a pipeline as the orchestrator sees it: its topics and cores, and how the batch under way there gets on.
//!
//! Most pipelines have one. Who drives many vehicles in lockstep may have several, as the processes of a ring take turns and
//! so keep no more than one core busy.

use ipc_types::{DriveReport, DriveRequest, Safety, Status};
use runtime::run::RunNames;
use runtime::{Bus, BusError, Inlet, Outlet};

use crate::pipeline::cores::Placement;
use crate::pipeline::gate_log::GateLog;
use crate::pipeline::main_loop::STOPS_IN_A_ROW;
use crate::words::Failure;

/// A ring: vehicle, controller and supervisor are members of the pipeline that bear its number.
pub(crate) struct Ring {
    pub(crate) bus: Bus,
    pub(crate) status: Inlet<Status>,
    pub(crate) reports: Inlet<DriveReport>,
    pub(crate) safety: Inlet<Safety>,
    pub(crate) requests: Outlet<DriveRequest>,
    pub(crate) placement: Placement,
    /// The largest number of elements in a message of its processes.
    pub(crate) max_len: usize,
    /// The gate of each slot.
    pub(crate) gates: Vec<GateLog>,
    /// A process of the ring died, or a message was lost: the batch under way will not end.
    pub(crate) batch_is_broken: bool,
    /// The latest batch and tick that any of its processes reported; `seen_ns` is when that of any of them last changed.
    pub(crate) seen: (u64, u64),
    pub(crate) seen_ns: u64,
    /// What the processes had waited for a processor by then.
    pub(crate) seen_waited_ns: u64,
    /// Attempts at the batch under way that stalled.
    pub(crate) stalls_in_a_row: u32,
    /// Attempts at the batch under way in which a vehicle was stopped for what does not lie in the drive.
    pub(crate) stops_in_a_row: u32,
    /// When the batch under way was issued.
    pub(crate) issued_ns: u64,
    /// Since when a vehicle has been on its way to a stop that does not lie in its drive, and by which reasons.
    pub(crate) stopping: Option<(u64, u32)>,
}

impl Ring {
    /// Its vehicle was stopped for what does not lie in the drive, which is made again from the start.
    ///
    /// # Errors
    /// If that has happened too many times in a row.
    pub(crate) fn drive_again(&mut self, why: &str) -> Result<(), Failure> {
        self.stops_in_a_row += 1;
        if self.stops_in_a_row > STOPS_IN_A_ROW {
            return Err(Failure::GaveUp(format!(
                "gave up: the vehicle was stopped {STOPS_IN_A_ROW} times on the same drive, and again: {why}"
            )));
        }
        self.batch_is_broken = true;
        Ok(())
    }

    /// Creates the topics of the ring with this number, of so many that share the drives; those of the first one are the
    /// run's, whose messages between trainer and orchestrator have up to `max_len` elements.
    pub(crate) fn create(
        names: &RunNames,
        max_len: usize,
        (number, rings): (usize, usize),
        placement: Placement,
    ) -> Result<Self, BusError> {
        let share = max_len.div_ceil(rings);
        let bus = match number {
            0 => Bus::create(names, max_len),
            number => Bus::create_ring(names, share, number),
        }?
        .waiting(placement.wait);
        Ok(Self {
            max_len: share,
            status: bus.inlet()?,
            reports: bus.inlet()?,
            safety: bus.inlet()?,
            requests: bus.outlet()?,
            bus,
            placement,
            gates: Vec::new(),
            batch_is_broken: false,
            seen: (0, 0),
            seen_ns: 0,
            seen_waited_ns: 0,
            stalls_in_a_row: 0,
            stops_in_a_row: 0,
            issued_ns: 0,
            stopping: None,
        })
    }
}
