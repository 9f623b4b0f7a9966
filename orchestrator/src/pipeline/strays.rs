//! Processes of users' programs whose orchestrator and guardian were killed together: nobody is left who would end them, so
//! the next command that sweeps up the dead run does.
//!
//! A guardian leaves a note in the run's private folder before it starts its program. By it the program's processes are
//! known: by their control group, by the pipe to which they print, by their environment, and by whose children they are.
//! One that has left all of these lives on where no control group can be made.

use std::collections::BTreeSet;
use std::fs;
use std::io::{self, Write};
use std::os::fd::AsFd;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use runtime::run::RunNames;
use rustix::process::{Pid, Signal, getpid, kill_process};

use crate::pipeline::cgroup::Cgroup;
use crate::pipeline::guardian;

/// First part of the name of a guardian's note.
const NOTE: &str = "guardian-";
/// How long a guardian that still lives may take to do its own work, and the processes to be gone.
const PATIENCE: Duration = Duration::from_secs(3);
const LOOK_EVERY: Duration = Duration::from_millis(2);

/// Notes by what the processes of a guardian's program are known: the pipe to which they print, and their control group.
pub(crate) fn note(root: &Path, output: impl AsFd, cgroup: Option<&Cgroup>) -> io::Result<()> {
    let pipe = rustix::fs::fstat(output)?.st_ino;
    let cgroup = cgroup.map(|it| it.path().display().to_string()).unwrap_or_default();
    let path = root.join(format!("{NOTE}{}", std::process::id()));
    // Of a process that had the same number.
    let _ = fs::remove_file(&path);
    let mut file = fs::File::create_new(&path)?;
    writeln!(file, "{}\n{pipe}\n{cgroup}", boot_id()?)
}

/// Removes what dead runs of this user have left, the processes of users' programs among it; returns those runs.
pub(crate) fn sweep_dead_runs() -> Vec<RunNames> {
    runtime::run::sweep_dead_runs(end_all)
}

/// Ends all processes of users' programs in a run whose orchestrator is dead.
fn end_all(names: &RunNames) {
    let Ok(boot) = boot_id() else { return };
    let notes: Vec<Note> = fs::read_dir(&names.root)
        .into_iter()
        .flatten()
        .flatten()
        .filter(|entry| entry.file_name().to_string_lossy().starts_with(NOTE))
        .filter_map(|entry| Note::parse(&fs::read_to_string(entry.path()).ok()?, &boot))
        .collect();
    if notes.is_empty() {
        return;
    }
    let until = Instant::now() + PATIENCE;
    let own_group = format!("pathtune-{:016x}-", names.run);
    let mark = Mark { run: names.run, pipes: notes.iter().map(|it| it.pipe).collect() };
    // A guardian that lives is at work: it knows its children better.
    while Instant::now() < until && processes().iter().any(|it| mark.is_of_guardian(it.pid)) {
        std::thread::sleep(LOOK_EVERY);
    }
    for cgroup in notes.into_iter().filter_map(|it| it.cgroup) {
        if let Some(cgroup) = Cgroup::found(&cgroup, &own_group) {
            cgroup.kill();
        }
    }
    let until = Instant::now() + PATIENCE;
    while Instant::now() < until {
        let strays = mark.strays(&processes());
        if strays.is_empty() {
            return;
        }
        for stray in strays {
            tracing::warn!(pid = stray, run = names.run, "ended a process of a dead run's program");
            if let Some(pid) = Pid::from_raw(stray) {
                let _ = kill_process(pid, Signal::KILL);
            }
        }
        std::thread::sleep(LOOK_EVERY);
    }
}

/// What a guardian has noted.
struct Note {
    pipe: u64,
    cgroup: Option<PathBuf>,
}

impl Note {
    /// `None` if it is damaged, or from before the machine was started: the numbers may be others' by now.
    fn parse(text: &str, boot: &str) -> Option<Self> {
        let mut lines = text.lines();
        if lines.next()? != boot {
            return None;
        }
        let pipe = lines.next()?.parse().ok()?;
        Some(Self { pipe, cgroup: lines.next().filter(|it| !it.is_empty()).map(PathBuf::from) })
    }
}

/// By what the processes of a dead run's programs are known.
struct Mark {
    run: u64,
    pipes: BTreeSet<u64>,
}

impl Mark {
    /// Those that are known, and what they have started; never this process, nor one above it.
    fn strays(&self, all: &[Process]) -> Vec<i32> {
        let parent = |pid: i32| all.iter().find(|it| it.pid == pid).map(|it| it.parent);
        let above =
            |pid: i32| std::iter::successors(Some(pid), |it| parent(*it).filter(|it| *it > 1));
        let own: BTreeSet<i32> = above(getpid().as_raw_nonzero().get()).take(all.len()).collect();
        let marked: BTreeSet<i32> = all
            .iter()
            .map(|it| it.pid)
            .filter(|pid| !own.contains(pid) && self.is_on(*pid))
            .collect();
        let is_stray = |pid: i32| above(pid).take(all.len()).any(|it| marked.contains(&it));
        all.iter().map(|it| it.pid).filter(|pid| !own.contains(pid) && is_stray(*pid)).collect()
    }

    fn is_on(&self, pid: i32) -> bool {
        self.is_in_environment(pid) || self.has_pipe(pid)
    }

    fn is_in_environment(&self, pid: i32) -> bool {
        let environment = fs::read(format!("/proc/{pid}/environ")).unwrap_or_default();
        let variable = format!("PATHTUNE_RUN={:016x}", self.run);
        environment.split(|byte| *byte == 0).any(|it| it == variable.as_bytes())
    }

    fn has_pipe(&self, pid: i32) -> bool {
        let Ok(files) = fs::read_dir(format!("/proc/{pid}/fd")) else { return false };
        files.flatten().any(|file| {
            let link = fs::read_link(file.path()).unwrap_or_default();
            let number = link.to_str().and_then(|it| it.strip_prefix("pipe:[")?.strip_suffix(']'));
            number.and_then(|it| it.parse().ok()).is_some_and(|it| self.pipes.contains(&it))
        })
    }

    fn is_of_guardian(&self, pid: i32) -> bool {
        let line = fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
        let mut words = line.split(|byte| *byte == 0).skip(1);
        let is_guardian = words.next() == Some(b"service".as_slice())
            && words.next() == Some(guardian::SERVICE.as_bytes());
        is_guardian && self.is_in_environment(pid)
    }
}

/// A process of this user that has not ended.
struct Process {
    pid: i32,
    parent: i32,
}

fn processes() -> Vec<Process> {
    let own = rustix::process::geteuid().as_raw();
    let Ok(entries) = fs::read_dir("/proc") else { return Vec::new() };
    let read = |entry: fs::DirEntry| {
        let pid = entry.file_name().to_str()?.parse().ok()?;
        if entry.metadata().ok()?.uid() != own {
            return None;
        }
        let stat = fs::read_to_string(entry.path().join("stat")).ok()?;
        // The name in front is in parentheses, and may hold any character; state and parent follow it.
        let mut rest = stat.rsplit_once(')')?.1.split_whitespace();
        let (state, parent) = (rest.next()?, rest.next()?.parse().ok()?);
        (state != "Z").then_some(Process { pid, parent })
    };
    entries.flatten().filter_map(read).collect()
}

/// What tells this start of the machine from others.
fn boot_id() -> io::Result<String> {
    Ok(fs::read_to_string("/proc/sys/kernel/random/boot_id")?.trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_note_from_before_the_machine_was_started_names_nobody() {
        let note = Note::parse("boot\n4711\n/sys/fs/cgroup/mine\n", "boot").unwrap();
        assert_eq!((note.pipe, note.cgroup), (4711, Some("/sys/fs/cgroup/mine".into())));
        assert_eq!(Note::parse("boot\n4711\n\n", "boot").unwrap().cgroup, None);
        for damaged in ["other\n4711\n\n", "boot\n", "boot\nmany\n", ""] {
            assert!(Note::parse(damaged, "boot").is_none(), "{damaged:?}");
        }
    }

    #[test]
    fn neither_this_process_nor_one_above_it_is_a_stray() {
        let own = getpid().as_raw_nonzero().get();
        let (output, _printed) = rustix::pipe::pipe().unwrap();
        let pipe = rustix::fs::fstat(&output).unwrap().st_ino;
        let mark = Mark { run: 1, pipes: [pipe].into() };
        assert!(mark.has_pipe(own));
        assert!(!mark.strays(&processes()).contains(&own));
        let other = Mark { run: 1, pipes: BTreeSet::new() };
        assert!(other.strays(&processes()).is_empty());
    }
}
