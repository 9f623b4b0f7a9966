//! Processes that lost their parent: those that a user's program has started fall to its guardian, and those of a
//! guardian that was killed fall to the orchestrator. Nobody else ends them.

use std::fs;
use std::process::Child;
use std::sync::Mutex;
use std::time::{Duration, Instant};

use rustix::process::{
    Pid, Signal, WaitOptions, getpid, kill_process, set_child_subreaper, waitpid,
};

/// The children that this process has started itself; some of them may be gone.
static STARTED: Mutex<Vec<Pid>> = Mutex::new(Vec::new());

/// From now on, descendants of this process that lose their parent become its children.
pub(crate) fn adopt() {
    // Refused by no kernel that this program runs on.
    let _ = set_child_subreaper(Some(getpid()));
}

/// Notes that this process has started a child.
pub(crate) fn started(child: &Child) {
    STARTED.lock().expect("nobody panics while it is held").push(Pid::from_child(child));
}

/// Kills the children that this process has not started itself, and all that they have started.
pub(crate) fn kill_all() {
    let until = Instant::now() + PATIENCE;
    while Instant::now() < until {
        let mut orphans = children();
        {
            let mut started = STARTED.lock().expect("nobody panics while it is held");
            started.retain(|pid| orphans.contains(pid));
            orphans.retain(|pid| !started.contains(pid));
        }
        if orphans.is_empty() {
            return;
        }
        for orphan in orphans {
            let _ = kill_process(orphan, Signal::KILL);
            let _ = waitpid(Some(orphan), WaitOptions::NOHANG);
        }
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// How long to try: a process that the kernel holds does not die.
const PATIENCE: Duration = Duration::from_secs(2);

/// The children of this process.
pub(crate) fn children() -> Vec<Pid> {
    let own = getpid().as_raw_nonzero().get();
    let is_ours = |pid: &i32| {
        let stat = fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
        // The name in front is in parentheses, and may hold any character; state and parent follow it.
        let parent = stat.rsplit_once(')').and_then(|(_, rest)| rest.split_whitespace().nth(1));
        parent.and_then(|parent| parent.parse::<i32>().ok()) == Some(own)
    };
    let Ok(entries) = fs::read_dir("/proc") else { return Vec::new() };
    entries
        .flatten()
        .filter_map(|entry| entry.file_name().to_str()?.parse().ok())
        .filter(is_ours)
        .filter_map(Pid::from_raw)
        .collect()
}
