//! One pipeline, one core, or a core for each of its ring: which ones are free.

use std::os::linux::net::SocketAddrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};

use runtime::Wait;
use runtime::waiting::RING;
use rustix::thread::{CpuSet, sched_getaffinity};

/// Where the processes of a pipeline's ring run, and how they wait for each other.
#[derive(Debug)]
pub(crate) struct Placement {
    pub(crate) wait: Wait,
    /// One for each process of the ring, one for all of them, or none.
    cores: Vec<CoreClaim>,
}

impl Placement {
    /// For a pipeline that waits as it was told to, or else as suits the machine.
    pub(crate) fn new(wanted: Option<Wait>, fleet: usize, realtime: bool) -> Self {
        // Cores are asked for only where they may be used: in between, others would find them taken.
        let may_spin = wanted.map_or_else(
            || Wait::choose(allowed_cores().len(), fleet, realtime) == Wait::Spin,
            |wait| wait == Wait::Spin,
        );
        let mut cores = Vec::new();
        if may_spin {
            cores.extend((0..2 * RING).map_while(|_| CoreClaim::unshared()));
        }
        let wait = wanted.unwrap_or_else(|| Wait::choose(cores.len(), fleet, realtime));
        if wait == Wait::Spin && cores.len() >= RING {
            cores.truncate(RING);
            cores.iter_mut().for_each(CoreClaim::keep_others_off);
        } else {
            cores.clear();
            // By the clock nobody has to be quick behind somebody else: whichever core is free will do.
            if wait != Wait::Spin && !realtime {
                cores.extend(CoreClaim::unshared().or_else(CoreClaim::shared));
            }
        }
        Self { wait, cores }
    }

    /// The core of the ring's process with this place in it, if it has one.
    pub(crate) fn core_of(&self, place: usize) -> Option<usize> {
        let claim = self.cores.get(place).or_else(|| self.cores.first());
        claim.map(|claim| claim.core)
    }

    /// The ring's cores.
    pub(crate) fn cores(&self) -> impl Iterator<Item = usize> {
        self.cores.iter().map(|claim| claim.core)
    }
}

/// A core on which a ring, or a process of it, runs. Others see that for as long as this lives.
#[derive(Debug)]
pub(crate) struct CoreClaim {
    /// Number of the core.
    pub(crate) core: usize,
    /// Names in the abstract namespace: free again when their owner dies, and no file to leave behind.
    claims: Vec<UnixDatagram>,
}

impl CoreClaim {
    /// Claims a core that no other pipeline of this machine has.
    pub(crate) fn unshared() -> Option<Self> {
        allowed_cores().into_iter().find_map(|core| {
            let claim = bind("core", core)?;
            Some(Self { core, claims: vec![claim] })
        })
    }

    /// A core that somebody has claimed already, and who hands it on.
    pub(crate) fn shared() -> Option<Self> {
        let cores: Vec<usize> =
            allowed_cores().into_iter().filter(|core| bind("spin", *core).is_some()).collect();
        let core = *cores.get(std::process::id() as usize % cores.len().max(1))?;
        Some(Self { core, claims: Vec::new() })
    }

    /// Nobody is to share this core: its process never hands it on.
    fn keep_others_off(&mut self) {
        self.claims.extend(bind("spin", self.core));
    }
}

fn bind(what: &str, core: usize) -> Option<UnixDatagram> {
    let name = SocketAddr::from_abstract_name(format!("pathtune-{what}-{core}")).ok()?;
    UnixDatagram::bind_addr(&name).ok()
}

/// The cores that this process may use; the last ones first, because the first one often serves the interrupts.
fn allowed_cores() -> Vec<usize> {
    let Ok(allowed) = sched_getaffinity(None) else { return Vec::new() };
    (0..CpuSet::MAX_CPU).rev().filter(|core| allowed.is_set(*core)).collect()
}
