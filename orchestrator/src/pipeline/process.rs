//! Starts and ends processes. Decides nothing.

use std::fs::{File, OpenOptions};
use std::io::{self, BufRead, BufReader, Read, Seek, SeekFrom};
use std::os::fd::OwnedFd;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::Path;
use std::process::{Child, ChildStdout, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use config::open_regular;
use runtime::{Attachment, cleanup};
use rustix::event::{PollFd, PollFlags, poll};
use rustix::process::{Pid, PidfdFlags, Signal, kill_process, kill_process_group, pidfd_open};
use rustix::time::Timespec;

use crate::pipeline::cgroup::{self, Cgroup};
use crate::pipeline::{guardian, orphans};

/// What a process of the pipeline runs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Program {
    /// Our own service with this name.
    Service(&'static str),
    /// A command of the user's, split into words as a shell would.
    Command(String),
}

/// A living process of the pipeline, in a process group of its own.
#[derive(Debug)]
pub struct Process {
    child: Child,
    /// Readable once the process has died.
    pub pidfd: OwnedFd,
    guarded: Option<Guarded>,
}

/// What is known of a user's program, of which `child` is the guardian.
#[derive(Debug)]
struct Guarded {
    run: u64,
    /// Process id of the program, if it could be started.
    program: Option<u32>,
    /// Where the guardian names process ids, one a line.
    told: BufReader<ChildStdout>,
}

impl Process {
    /// Starts a process. Its output is added to the file `log`.
    ///
    /// Call it from the main thread: the parent-death signal follows the thread that spawned.
    ///
    /// # Errors
    /// If the program or the log file cannot be opened.
    pub fn start(program: &Program, attachment: &Attachment, log: &Path) -> io::Result<Self> {
        // The binary that is running now, even if its file has been replaced since.
        let mut command = Command::new("/proc/self/exe");
        let output: File = OpenOptions::new().create(true).append(true).open(log)?;
        command.arg0("pathtune").arg("service").stderr(output.try_clone()?);
        match program {
            Program::Service(name) => {
                command.arg(name).stdout(output);
            }
            Program::Command(words) => {
                orphans::adopt();
                command.arg(guardian::SERVICE).arg(log).arg(words).stdout(Stdio::piped());
            }
        }
        attachment.give_to(&mut command);
        let mut child = command.process_group(0).stdin(Stdio::null()).spawn()?;
        orphans::started(&child);
        let pidfd = pidfd_open(pid_of(&child), PidfdFlags::empty())?;
        let told = child.stdout.take().map(BufReader::new);
        let guarded = told.map(|told| Guarded { run: attachment.names.run, program: None, told });
        let mut process = Self { child, pidfd, guarded };
        if let Some(guarded) = &mut process.guarded {
            guarded.learn_program()?;
        }
        Ok(process)
    }

    /// Its process id; that of the user's program, if it is one.
    pub fn id(&self) -> u32 {
        let program = self.guarded.as_ref().and_then(|guarded| guarded.program);
        program.unwrap_or(self.child.id())
    }

    /// How it died, if it has.
    pub fn try_wait(&mut self) -> Option<ExitStatus> {
        self.child.try_wait().ok().flatten()
    }

    /// Asks it to stop.
    pub(crate) fn interrupt(&self) {
        let _ = match self.guarded {
            // The guardian passes it on.
            Some(_) => kill_process(pid_of(&self.child), Signal::INT),
            None => kill_process_group(pid_of(&self.child), Signal::INT),
        };
    }

    /// Kills it and all that it has started, and waits for its end.
    pub fn kill(&mut self) -> Option<ExitStatus> {
        let Some(Guarded { run, .. }) = self.guarded else {
            let _ = kill_process_group(pid_of(&self.child), Signal::KILL);
            return self.child.wait().ok();
        };
        let guardian = pid_of(&self.child);
        if self.try_wait().is_none() {
            let _ = kill_process(guardian, Signal::TERM);
            let _ = kill_process(guardian, Signal::CONT);
            if !self.ends_within(GUARDIAN_ENDS_WITHIN) {
                let _ = kill_process(guardian, Signal::KILL);
            }
        }
        let status = self.child.wait().ok()?;
        // It may have been killed before it could do its work; then that falls to this process.
        if status.signal().is_some() {
            if let Some(cgroup) = Cgroup::left_by(run, self.child.id()) {
                cgroup.kill();
            }
            orphans::kill_all();
        }
        Some(status)
    }

    /// Asks it to stop, waits for at most `patience`, and kills what is left of it. Returns whether it stopped by
    /// itself.
    pub fn stop(&mut self, patience: Duration) -> bool {
        self.interrupt();
        let stopped = self.ends_within(patience);
        self.kill();
        stopped
    }

    fn ends_within(&mut self, patience: Duration) -> bool {
        let until = Instant::now() + patience;
        while self.try_wait().is_none() {
            if Instant::now() >= until {
                return false;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        true
    }

    /// The processes that a user's program has left behind, once it has ended by itself.
    pub(crate) fn survivors(&mut self) -> Vec<u32> {
        let Some(guarded) = &mut self.guarded else { return Vec::new() };
        std::iter::from_fn(|| guarded.next_id()).collect()
    }
}

/// A guardian has only to kill: if that takes longer, it is stuck.
const GUARDIAN_ENDS_WITHIN: Duration = Duration::from_secs(3);
/// How long a guardian may take to start its program.
const GUARDIAN_STARTS_WITHIN: Timespec = Timespec { tv_sec: 10, tv_nsec: 0 };

impl Guarded {
    /// Waits until the guardian has started the program, or has failed to.
    fn learn_program(&mut self) -> io::Result<()> {
        let mut fds = [PollFd::new(self.told.get_ref(), PollFlags::IN)];
        if poll(&mut fds, Some(&GUARDIAN_STARTS_WITHIN)) == Ok(0) {
            return Err(io::Error::other("its guardian hangs"));
        }
        self.program = self.next_id();
        Ok(())
    }

    /// The next process id that the guardian names, or none once it has ended.
    fn next_id(&mut self) -> Option<u32> {
        let mut line = String::new();
        self.told.read_line(&mut line).ok()?;
        line.trim().parse().ok()
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        if self.try_wait().is_none() {
            self.kill();
        }
    }
}

fn pid_of(child: &Child) -> Pid {
    Pid::from_child(child)
}

/// Becomes a user's program: the service `exec`, which a guardian starts.
///
/// # Errors
/// Always, if it returns at all: the orchestrator is gone, or the program cannot be executed.
pub fn exec(words: &[String]) -> anyhow::Error {
    let attachment = match Attachment::from_env() {
        Ok(attachment) => attachment,
        Err(error) => return error,
    };
    if let Err(error) = attachment.tie_to_parent() {
        return error;
    }
    attachment.take_place();
    if let Some(folder) = std::env::var_os(guardian::CGROUP) {
        // Without a group, the guardian kills its processes one by one.
        let _ = cgroup::enter(Path::new(&folder));
    }
    let Some((program, arguments)) = words.split_first() else {
        return anyhow::anyhow!("no program to execute");
    };
    let error = Command::new(program).args(arguments).env_remove(guardian::CGROUP).exec();
    anyhow::Error::new(error).context(format!("failed to execute {program}"))
}

/// Removes what the dead process `pid` left on the bus.
///
/// # Errors
/// If the helper that removes dead nodes fails time after time.
pub fn clean_up_behind(attachment: &Attachment, pid: u32) -> anyhow::Result<()> {
    let names = &attachment.names;
    cleanup::remove_half_made(names, pid);
    let mut helpers = Vec::new();
    // The helper may be killed like any process. Until one has succeeded, the dead node's own files must
    // stay: they say whose places on the topics are free again.
    while !clean_dead_nodes(attachment, &mut helpers) {
        if helpers.len() >= HELPERS {
            anyhow::bail!("the clean-up helper failed {HELPERS} times; start again with --resume");
        }
        if let Some(helper) = helpers.last() {
            cleanup::remove_half_made(names, *helper);
        }
    }
    for dead in helpers.into_iter().chain([pid]) {
        cleanup::remove_leftovers(names, dead);
    }
    Ok(())
}

/// How many helpers may fail after one death.
const HELPERS: usize = 10;

/// Starts the helper that removes dead nodes from the bus.
pub(crate) fn spawn_cleaner(attachment: &Attachment) -> io::Result<Child> {
    let mut command = Command::new("/proc/self/exe");
    attachment.give_to(&mut command);
    command
        .arg0("pathtune")
        .args(["service", "cleaner"])
        .process_group(0)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .inspect(orphans::started)
}

/// Runs the helper that removes dead nodes from the bus; kills it if it hangs, as it may on half-made files.
/// Returns whether it succeeded.
fn clean_dead_nodes(attachment: &Attachment, helpers: &mut Vec<u32>) -> bool {
    let Ok(mut helper) = spawn_cleaner(attachment) else { return false };
    helpers.push(helper.id());
    let until = Instant::now() + Duration::from_secs(3);
    while Instant::now() < until {
        if let Ok(Some(status)) = helper.try_wait() {
            return status.success();
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    tracing::warn!("the clean-up helper hung, and was killed");
    let _ = helper.kill();
    let _ = helper.wait();
    false
}

/// How a process died, in words.
pub fn describe(status: ExitStatus) -> String {
    match (status.code(), status.signal()) {
        (Some(code), _) => format!("ended with exit code {code}"),
        (None, Some(7)) => "was ended by a bus error; is /dev/shm full?".to_owned(),
        (None, Some(signal)) => format!("was ended by signal {signal}"),
        (None, None) => "ended".to_owned(),
    }
}

/// The last lines of a log, made safe for a terminal: a foreign program may have written anything.
pub fn last_lines(log: &Path, count: usize) -> Vec<String> {
    let mut bytes = Vec::new();
    let read = open_regular(log).and_then(|mut file| {
        let length = file.metadata()?.len();
        file.seek(SeekFrom::Start(length.saturating_sub(LOG_END)))?;
        file.take(LOG_END).read_to_end(&mut bytes)
    });
    if read.is_err() {
        return Vec::new();
    }
    let text = String::from_utf8_lossy(&bytes);
    let lines: Vec<&str> = text.lines().collect();
    lines[lines.len().saturating_sub(count)..]
        .iter()
        .map(|line| line.chars().filter(|c| !c.is_control()).take(LINE_LENGTH).collect())
        .collect()
}

/// The last lines that say something: those before the backtrace of a program that ended by an error, which stands behind
/// what happened.
pub fn before_backtrace(mut lines: Vec<String>, count: usize) -> Vec<String> {
    let is_heading = |line: &String| line.trim().eq_ignore_ascii_case("stack backtrace:");
    if let Some(at) = lines.iter().rposition(is_heading) {
        lines.truncate(at);
        lines.truncate(lines.iter().rposition(|it| !it.trim().is_empty()).map_or(0, |it| it + 1));
    }
    lines.split_off(lines.len().saturating_sub(count))
}

/// How many bytes at the end of a log are read.
const LOG_END: u64 = 64 << 10;
/// How many characters of each line of a log are shown.
const LINE_LENGTH: usize = 400;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn last_words_are_what_happened_and_not_a_backtrace() {
        let lines = |text: &str| text.lines().map(str::to_owned).collect::<Vec<_>>();
        let said = "first\nError: unknown field\n\nStack backtrace:\n   0: main\n   1: _start";
        assert_eq!(before_backtrace(lines(said), 1), ["Error: unknown field"]);
        assert_eq!(before_backtrace(lines("one\ntwo\nthree"), 2), ["two", "three"]);
    }
}
