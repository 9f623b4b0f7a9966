//! A ring of a pipeline has one core, or one for each of its processes; this file finds cores that are free, and decides how many
//! rings there are.

use std::os::linux::net::SocketAddrExt;
use std::os::unix::net::{SocketAddr, UnixListener, UnixStream};

use runtime::Wait;
use runtime::waiting::RING;
use rustix::net::sockopt::socket_peercred;
use rustix::process::geteuid;
use rustix::thread::{CpuSet, sched_getaffinity};

use crate::pipeline::plan::Plan;

/// Where the processes of a pipeline's ring run, and how they wait for each other.
#[derive(Debug)]
pub(crate) struct Placement {
    pub(crate) wait: Wait,
    /// One for each process of the ring, one for all of them, or none.
    cores: Vec<CoreClaim>,
}

impl Placement {
    /// More rings than this have little use for what one trainer asks for.
    pub(crate) const MOST_RINGS: usize = 8;

    /// Where each ring of a pipeline runs. There are as many rings as the plan says, or else as free cores can be kept busy: a
    /// drive comes out the same in any of them.
    pub(crate) fn of_rings(plan: &Plan, realtime: bool) -> Vec<Self> {
        let fleet = plan.config.fleet();
        let useful = (fleet / VEHICLES_OF_RING).clamp(1, Self::MOST_RINGS);
        let wanted = plan.rings.unwrap_or(useful);
        let first = Self::new(plan.wait, fleet.div_ceil(wanted), realtime);
        let wait = first.wait;
        let mut rings = vec![first];
        while rings.len() < wanted {
            let core = CoreClaim::unshared();
            if core.is_none() && plan.rings.is_none() {
                break;
            }
            rings.push(match (wait, core) {
                (Wait::Spin, _) => Self::new(Some(wait), fleet, realtime),
                (_, core) => {
                    Self { wait, cores: core.or_else(CoreClaim::shared).into_iter().collect() }
                }
            });
        }
        rings
    }

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

/// A ring is worth its processes if it drives so many vehicles at once: with fewer, most of a tick is the hand-over.
const VEHICLES_OF_RING: usize = 32;

/// A claim on a core for a ring or one of its processes. Other pipelines see it for as long as this exists.
#[derive(Debug)]
pub(crate) struct CoreClaim {
    /// Number of the core.
    pub(crate) core: usize,
    /// Names in the abstract namespace: they are free again when their owner dies, and leave no file behind.
    claims: Vec<UnixListener>,
}

impl CoreClaim {
    /// Claims a core that no other pipeline on this machine has claimed.
    pub(crate) fn unshared() -> Option<Self> {
        allowed_cores().into_iter().find_map(|core| {
            let claim = claim("core", core)?;
            Some(Self { core, claims: vec![claim] })
        })
    }

    /// A core that another pipeline has claimed, but yields.
    pub(crate) fn shared() -> Option<Self> {
        let cores: Vec<usize> =
            allowed_cores().into_iter().filter(|core| claim("spin", *core).is_some()).collect();
        let core = *cores.get(std::process::id() as usize % cores.len().max(1))?;
        Some(Self { core, claims: Vec::new() })
    }

    /// Keeps other pipelines off this core: its process spins, and never yields it.
    fn keep_others_off(&mut self) {
        self.claims.extend(claim("spin", self.core));
    }
}

/// The cores that this process may use, those first that no pipeline on this machine has claimed; with each, whether it is
/// one of these.
pub(crate) fn free_first() -> Vec<(usize, bool)> {
    // Claims end with this call: whoever is to run there makes its own.
    let mut cores: Vec<(usize, bool)> =
        allowed_cores().into_iter().map(|core| (core, claim("core", core).is_some())).collect();
    cores.sort_by_key(|(_, is_free)| !is_free);
    cores
}

/// Claims a core for this user's runs, if none of them has claimed it.
///
/// Any user can take any name. So a name that somebody else has taken says nothing, and the next one counts.
fn claim(what: &str, core: usize) -> Option<UnixListener> {
    let user = geteuid().as_raw();
    (0..NAMES).find_map(|number| {
        let name = format!("pathtune-{user}-{what}-{core}-{number}");
        let name = SocketAddr::from_abstract_name(name).ok()?;
        match UnixListener::bind_addr(&name) {
            Ok(claim) => Some(Some(claim)),
            Err(_) if is_taken_by(user, &name) => Some(None),
            Err(_) => None,
        }
    })?
}

/// How many names strangers may take before a core can no longer be claimed.
const NAMES: u32 = 32;

/// Whether a process of this user listens at a name.
fn is_taken_by(user: u32, name: &SocketAddr) -> bool {
    UnixStream::connect_addr(name)
        .ok()
        .and_then(|stream| socket_peercred(&stream).ok())
        .is_some_and(|owner| owner.uid.as_raw() == user)
}

/// The cores that this process may use, the last ones first, because the first core often serves the interrupts.
fn allowed_cores() -> Vec<usize> {
    let Ok(allowed) = sched_getaffinity(None) else { return Vec::new() };
    (0..CpuSet::MAX_CPU).rev().filter(|core| allowed.is_set(*core)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::net::UnixDatagram;

    #[test]
    fn a_core_is_claimed_once_and_a_stranger_s_name_is_no_claim() {
        let (what, core) = ("test", std::process::id() as usize);
        // Whoever does not listen there with credentials of this user is a stranger.
        let name = format!("pathtune-{}-{what}-{core}-0", geteuid().as_raw());
        let name = SocketAddr::from_abstract_name(name).unwrap();
        let _stranger = UnixDatagram::bind_addr(&name).unwrap();
        let ours = claim(what, core).unwrap();
        assert!(claim(what, core).is_none());
        drop(ours);
        assert!(claim(what, core).is_some());
    }
}
