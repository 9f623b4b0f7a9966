//! Removes what a dead process of a run left behind.
//!
//! A process killed while it runs leaves a dead node, which any other process can clean. One killed while it
//! starts may leave half-made files that no process may open: it would hang. Such files are recognised by
//! their mode and removed by name, before any process looks at them.

use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::Path;

use crate::run::{RunNames, segments_of};

/// Removes the half-made files of the dead process `pid`: the first of two steps. No other process of the run may be
/// starting meanwhile.
pub fn remove_half_made(names: &RunNames, pid: u32) {
    for name in segments_of(names.run) {
        let path = Path::new("/dev/shm").join(&name);
        let Ok(meta) = fs::metadata(&path) else { continue };
        if meta.mode() & 0o777 == 0o200 && carries_pid(&name, pid) {
            tracing::debug!(%name, "removed a half-made segment");
            let _ = fs::remove_file(&path);
        }
    }
    let Ok(entries) = fs::read_dir(names.root.join("services")) else { return };
    for entry in entries.flatten() {
        // Finished ones are 0400.
        if entry.metadata().is_ok_and(|meta| meta.mode() & 0o777 == 0o600) {
            tracing::debug!(name = ?entry.file_name(), "removed a half-made service");
            let _ = fs::remove_file(entry.path());
        }
    }
}

/// Removes what is left of the dead process `pid` after its node has been removed: the second of two steps.
pub fn remove_leftovers(names: &RunNames, pid: u32) {
    for name in segments_of(names.run) {
        if carries_pid(&name, pid) && !name.ends_with(".dynamic") {
            tracing::debug!(%name, "removed a leftover segment");
            let _ = fs::remove_file(Path::new("/dev/shm").join(name));
        }
    }
    let Ok(entries) = fs::read_dir(names.root.join("nodes")) else { return };
    for entry in entries.flatten() {
        if entry.file_name().to_str().is_some_and(|name| carries_pid(name, pid)) {
            let path = entry.path();
            tracing::debug!(?path, "removed a leftover of a node");
            let _ = if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) };
        }
    }
}

/// The helper process: removes dead nodes from the bus, and ends. The process that starts it kills it if it hangs.
///
/// # Errors
/// If it was not started by an orchestrator, or the run is gone.
pub fn run_helper() -> anyhow::Result<()> {
    let attachment = crate::Attachment::from_env()?;
    attachment.tie_to_parent()?;
    crate::Bus::attach(&attachment.names, attachment.max_len)?.clean_dead_nodes();
    Ok(())
}

/// Whether a name that the transport made (in `/dev/shm`, or among its nodes) contains an id made by `pid`: ids are
/// decimal numbers of 128 bits, counter, pid, nanoseconds and seconds from the top, 32 bits each.
pub fn carries_pid(name: &str, pid: u32) -> bool {
    name.split(|c: char| !c.is_ascii_digit())
        .filter(|digits| digits.len() > 20)
        .filter_map(|digits| digits.parse::<u128>().ok())
        .any(|id| (id >> 64) as u32 == pid)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_id_carries_its_pid() {
        let id = (7u128 << 96) | (4711u128 << 64) | (123_456u128 << 32) | 1_700_000_000;
        assert!(carries_pid(&format!("pathtune_00ab_{id}.data"), 4711));
        assert!(!carries_pid(&format!("pathtune_00ab_{id}.data"), 4712));
        assert!(!carries_pid("pathtune_00ab_.global_mgmt", 0));
    }
}
