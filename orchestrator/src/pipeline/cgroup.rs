//! A control group (version 2) for a user's program and all that it starts: whatever they do, they stay in it, and the
//! kernel kills all of them at once. Where none can be made, for example because it was not delegated to this user, the
//! guardian does without.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// A group of its own for the processes of one program.
#[derive(Debug)]
pub(crate) struct Cgroup(PathBuf);

impl Cgroup {
    /// Makes the group of a guardian, below the one in which this process is.
    pub(crate) fn make(run: u64, guardian: u32) -> Option<Self> {
        let folder = folder_of(run, guardian)?;
        fs::create_dir(&folder).ok()?;
        // Kernels before 5.14 cannot kill a group.
        if folder.join(KILL).exists() {
            Some(Self(folder))
        } else {
            let _ = fs::remove_dir(folder);
            None
        }
    }

    /// The group that a guardian has left.
    pub(crate) fn left_by(run: u64, guardian: u32) -> Option<Self> {
        folder_of(run, guardian).filter(|folder| folder.is_dir()).map(Self)
    }

    /// The group in this folder, if there is one whose name begins like this.
    pub(crate) fn found(folder: &Path, name: &str) -> Option<Self> {
        let has_name = folder.file_name()?.to_str()?.starts_with(name);
        (has_name && folder.join(KILL).exists()).then(|| Self(folder.to_owned()))
    }

    /// Where processes enter it: see [`enter`].
    pub(crate) fn path(&self) -> &Path {
        &self.0
    }

    /// Kills all of it, and removes it.
    pub(crate) fn kill(self) {
        let _ = fs::write(self.0.join(KILL), "1");
        let until = Instant::now() + PATIENCE;
        // It can be removed once its last process is gone.
        while fs::remove_dir(&self.0).is_err() && self.0.exists() && Instant::now() < until {
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}

/// Moves this process into a group.
pub(crate) fn enter(folder: &Path) -> io::Result<()> {
    fs::write(folder.join("cgroup.procs"), "0")
}

const KILL: &str = "cgroup.kill";
/// How long the processes of a group may take to be gone.
const PATIENCE: Duration = Duration::from_secs(1);

fn folder_of(run: u64, guardian: u32) -> Option<PathBuf> {
    let mounts = fs::read_to_string("/proc/self/mountinfo").ok()?;
    let groups = fs::read_to_string("/proc/self/cgroup").ok()?;
    Some(own_folder(&mounts, &groups)?.join(format!("pathtune-{run:016x}-{guardian}")))
}

/// The folder of the group in which this process is, from its `mountinfo` and `cgroup`; see proc(5).
fn own_folder(mounts: &str, groups: &str) -> Option<PathBuf> {
    let mount = mounts.lines().find_map(|line| {
        let (front, back) = line.split_once(" - ")?;
        back.starts_with("cgroup2 ").then(|| front.split(' ').nth(4))?
    })?;
    let group = groups.lines().find_map(|line| line.strip_prefix("0::/"))?;
    Some(Path::new(mount).join(group))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_own_group_is_found_beside_those_of_version_1() {
        let mounts = "30 24 0:26 / /sys/fs/cgroup ro shared:9 - tmpfs tmpfs ro,mode=755\n\
                      31 30 0:27 / /sys/fs/cgroup/unified rw shared:10 - cgroup2 cgroup2 rw\n\
                      32 30 0:28 / /sys/fs/cgroup/cpu rw shared:11 - cgroup cgroup rw,cpu\n";
        let found = own_folder(mounts, "4:memory:/other\n0::/user.slice/mine.scope\n");
        let expected = Path::new("/sys/fs/cgroup/unified/user.slice/mine.scope");
        assert_eq!(found.as_deref(), Some(expected));
        assert_eq!(own_folder(mounts, "4:memory:/other\n"), None);
        assert_eq!(own_folder("", "0::/\n"), None);
    }
}
