//! A pipeline has one core, or one for each process of its ring; this file finds cores that are free.

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
    /// For a pipeline that waits as `wanted`, or else as suits the machine.
    pub(crate) fn new(wanted: Option<Wait>, fleet: usize, realtime: bool) -> Self {
        // Cores are claimed only if they may be used: until they are released, others would find them taken.
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
            // By the clock, no process has to follow another one quickly: any free core will do.
            if wait != Wait::Spin && !realtime {
                cores.extend(CoreClaim::unshared().or_else(CoreClaim::shared));
            }
        }
        Self { wait, cores }
    }

    /// The core of the process at this place in the ring, if it has one.
    pub(crate) fn core_of(&self, place: usize) -> Option<usize> {
        let claim = self.cores.get(place).or_else(|| self.cores.first());
        claim.map(|claim| claim.core)
    }

    /// The ring's cores.
    pub(crate) fn cores(&self) -> impl Iterator<Item = usize> {
        self.cores.iter().map(|claim| claim.core)
    }
}

/// A claim on a core for a ring or one of its processes. Other pipelines see it for as long as this exists.
#[derive(Debug)]
pub(crate) struct CoreClaim {
    /// Number of the core.
    pub(crate) core: usize,
    /// Names in the abstract namespace: they are free again when their owner dies, and leave no file behind.
    claims: Vec<UnixDatagram>,
}

impl CoreClaim {
    /// Claims a core that no other pipeline on this machine has claimed.
    pub(crate) fn unshared() -> Option<Self> {
        allowed_cores().into_iter().find_map(|core| {
            let claim = bind("core", core)?;
            Some(Self { core, claims: vec![claim] })
        })
    }

    /// A core that another pipeline has claimed, but yields.
    pub(crate) fn shared() -> Option<Self> {
        let cores: Vec<usize> =
            allowed_cores().into_iter().filter(|core| bind("spin", *core).is_some()).collect();
        let core = *cores.get(std::process::id() as usize % cores.len().max(1))?;
        Some(Self { core, claims: Vec::new() })
    }

    /// Keeps other pipelines off this core: its process spins, and never yields it.
    fn keep_others_off(&mut self) {
        self.claims.extend(bind("spin", self.core));
    }
}

fn bind(what: &str, core: usize) -> Option<UnixDatagram> {
    let name = SocketAddr::from_abstract_name(format!("pathtune-{what}-{core}")).ok()?;
    UnixDatagram::bind_addr(&name).ok()
}

/// The cores that this process may use, the last ones first, because the first core often serves the interrupts.
fn allowed_cores() -> Vec<usize> {
    let Ok(allowed) = sched_getaffinity(None) else { return Vec::new() };
    (0..CpuSet::MAX_CPU).rev().filter(|core| allowed.is_set(*core)).collect()
}
