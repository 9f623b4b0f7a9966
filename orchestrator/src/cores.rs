//! One pipeline, one core: which one is free.

use std::os::linux::net::SocketAddrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};

use rustix::thread::{CpuSet, sched_getaffinity};

/// The core on which a pipeline's ring runs.
#[derive(Debug)]
pub(crate) struct CoreClaim {
    /// Number of the core.
    pub(crate) core: usize,
    /// Others see the claim for as long as this lives; none if all cores are claimed already.
    _claim: Option<UnixDatagram>,
}

impl CoreClaim {
    /// Claims a core that no other pipeline of this machine has; shares one if all are taken.
    pub(crate) fn new() -> Option<Self> {
        let allowed = sched_getaffinity(None).ok()?;
        // The last cores first: the first one often serves the interrupts.
        let cores: Vec<usize> =
            (0..CpuSet::MAX_CPU).rev().filter(|core| allowed.is_set(*core)).collect();
        for core in &cores {
            // A name in the abstract namespace is free again when its owner dies, and leaves no file.
            let Ok(name) = SocketAddr::from_abstract_name(format!("pathtune-core-{core}")) else {
                continue;
            };
            if let Ok(claim) = UnixDatagram::bind_addr(&name) {
                return Some(Self { core: *core, _claim: Some(claim) });
            }
        }
        let core = *cores.get(std::process::id() as usize % cores.len().max(1))?;
        Some(Self { core, _claim: None })
    }
}
