//! Observers: processes that are not part of the run, and may come, go, freeze and die at any time.
//!
//! An observer creates no topic, cleans nothing up, is woken by nobody and wakes nobody. It registers
//! by a file in the run's private folder, which is named after its process and locked while it lives. By these files
//! the orchestrator finds dead observers, and limits their number.

use std::fs::{self, File, OpenOptions};
use std::io;
use std::path::{Path, PathBuf};

use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};

use crate::run::{LOCK_FILE, RunNames};
use crate::{Bus, BusError};

/// The largest number of observers of a run at a time: each one costs a little of every tick, and a place on the
/// topics.
pub const MAX_OBSERVERS: usize = 16;

/// Why a run cannot be observed.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say it")]
pub enum ObserverError {
    #[error(
        "the run has {MAX_OBSERVERS} observers already, which is the limit; end one of them first"
    )]
    Full,
    #[error("failed to use {path}: {source}")]
    Io { path: PathBuf, source: io::Error },
    #[error(transparent)]
    Bus(#[from] BusError),
}

/// A place among the observers of a run, given back when this is dropped.
pub struct Observer {
    // Dropped before the file is removed: an observer without a file has no ports.
    bus: Option<Bus>,
    path: PathBuf,
    names: RunNames,
    _lock: File,
}

impl Observer {
    /// Joins the run as one more observer.
    ///
    /// # Errors
    /// If there are too many already, or the run is gone.
    pub fn attach(names: &RunNames) -> Result<Self, ObserverError> {
        let folder = folder(names);
        let io = |path: &Path| {
            let path = path.to_owned();
            move |source| ObserverError::Io { path, source }
        };
        // The run's own folder must exist: it must not be created again for a run that is gone.
        match fs::create_dir(&folder) {
            Err(error) if error.kind() != io::ErrorKind::AlreadyExists => {
                return Err(io(&folder)(error));
            }
            _ => {}
        }
        let pid = std::process::id();
        let (born, path) = (folder.join(format!(".{pid}")), folder.join(pid.to_string()));
        let open = OpenOptions::new().write(true).create(true).truncate(false).open(&born);
        let lock = open.map_err(io(&born))?;
        lock.lock().map_err(io(&born))?;
        // From the moment at which it has its final name it is locked.
        fs::rename(&born, &path).map_err(io(&path))?;
        let mut observer = Self { bus: None, path, names: names.clone(), _lock: lock };
        if places(names).len() > MAX_OBSERVERS {
            return Err(ObserverError::Full);
        }
        observer.bus = Some(Bus::attach(names, 1)?);
        step_aside(names);
        Ok(observer)
    }

    /// The run's bus: for [`Bus::observe`].
    ///
    /// # Panics
    /// Never: an attached observer has one.
    pub fn bus(&self) -> &Bus {
        self.bus.as_ref().expect("attached")
    }
}

/// Name of the file in the run's private folder that lists the cores on which its ring runs, separated by spaces.
pub const CORE_FILE: &str = "core";

/// Leaves the ring's cores to the ring, if there are others; a refusal costs the ring some speed and nothing else.
fn step_aside(names: &RunNames) {
    let Ok(text) = fs::read_to_string(names.root.join(CORE_FILE)) else { return };
    let Ok(mut cores) = sched_getaffinity(None) else { return };
    for core in text.split_whitespace().filter_map(|core| core.parse().ok()) {
        if core < CpuSet::MAX_CPU {
            cores.unset(core);
        }
    }
    if cores.count() > 0 {
        let _ = sched_setaffinity(None, &cores);
    }
}

impl Drop for Observer {
    fn drop(&mut self) {
        self.bus = None;
        let _ = fs::remove_file(&self.path);
        // A run that ends while an observer joins has removed its files already, including its lock. What exists
        // now was made by observers that came too late, and no other process knows of it. A run whose orchestrator died
        // with its lock in place is left to the sweep.
        if self.names.root.join(LOCK_FILE).try_exists().is_ok_and(|exists| !exists) {
            self.names.remove();
        }
    }
}

/// Process ids of observers that died without giving up their place.
pub fn dead_observers(names: &RunNames) -> Vec<u32> {
    let is_dead = |pid: &u32| match File::open(folder(names).join(pid.to_string())) {
        Ok(file) => file.try_lock().is_ok(),
        Err(_) => false,
    };
    places(names).into_iter().filter(is_dead).collect()
}

/// Frees the place of a dead observer, once what it left on the bus is removed.
pub fn forget_observer(names: &RunNames, pid: u32) {
    let _ = fs::remove_file(folder(names).join(pid.to_string()));
}

fn folder(names: &RunNames) -> PathBuf {
    names.root.join("observers")
}

/// Process ids of all observers, dead or alive.
fn places(names: &RunNames) -> Vec<u32> {
    let Ok(entries) = fs::read_dir(folder(names)) else { return Vec::new() };
    entries.flatten().filter_map(|entry| entry.file_name().to_str()?.parse().ok()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_is_dead_once_nobody_locks_it() {
        let root = tempfile::tempdir().unwrap();
        let names = RunNames { run: 1, root: root.path().to_owned() };
        assert!(dead_observers(&names).is_empty());
        fs::create_dir(folder(&names)).unwrap();
        let held = File::create(folder(&names).join("4711")).unwrap();
        held.lock().unwrap();
        File::create(folder(&names).join("4712")).unwrap();
        // A file that is only just being made does not belong to an observer yet.
        File::create(folder(&names).join(".4713")).unwrap();
        assert_eq!(dead_observers(&names), [4712]);
        assert_eq!(places(&names).len(), 2);
        forget_observer(&names, 4712);
        drop(held);
        assert_eq!(dead_observers(&names), [4711]);
    }
}
