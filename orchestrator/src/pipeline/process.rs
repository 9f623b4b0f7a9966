//! Starts and ends processes. Decides nothing.

use std::fs::{File, OpenOptions};
use std::io::{self, Read, Seek, SeekFrom};
use std::os::fd::OwnedFd;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use runtime::{Attachment, cleanup};
use rustix::process::{Pid, PidfdFlags, Signal, kill_process_group, pidfd_open};

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
        command.arg0("pathtune");
        match program {
            Program::Service(name) => {
                command.args(["service", name]);
            }
            Program::Command(words) => {
                // Ties itself to our life and moves to its core, then becomes the user's program.
                command.args(["service", "exec", "--"]);
                command.args(shell_words::split(words).map_err(io::Error::other)?);
            }
        }
        let output: File = OpenOptions::new().create(true).append(true).open(log)?;
        attachment.give_to(&mut command);
        let child = command
            .process_group(0)
            .stdin(Stdio::null())
            .stdout(output.try_clone()?)
            .stderr(output)
            .spawn()?;
        let pidfd = pidfd_open(pid_of(&child), PidfdFlags::empty())?;
        Ok(Self { child, pidfd })
    }

    /// Its process id.
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// How it died, if it has.
    pub fn try_wait(&mut self) -> Option<ExitStatus> {
        self.child.try_wait().ok().flatten()
    }

    /// Asks it to stop.
    pub(crate) fn interrupt(&self) {
        let _ = kill_process_group(pid_of(&self.child), Signal::INT);
    }

    /// Kills it and all its children, and waits for its end.
    pub fn kill(&mut self) -> Option<ExitStatus> {
        let _ = kill_process_group(pid_of(&self.child), Signal::KILL);
        self.child.wait().ok()
    }

    /// Asks it to stop, waits for at most `patience`, and kills what is left of it. Returns whether it stopped by
    /// itself.
    pub fn stop(&mut self, patience: Duration) -> bool {
        self.interrupt();
        let until = Instant::now() + patience;
        let stopped = loop {
            if self.try_wait().is_some() {
                break true;
            }
            if Instant::now() >= until {
                break false;
            }
            std::thread::sleep(Duration::from_millis(1));
        };
        self.kill();
        stopped
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

/// Becomes a user's program: the second half of [`Process::start`] with a command, and the service `exec`.
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
    let Some((program, arguments)) = words.split_first() else {
        return anyhow::anyhow!("no program to execute");
    };
    let error = Command::new(program).args(arguments).exec();
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
    let read = File::open(log).and_then(|mut file| {
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

/// How many bytes at the end of a log are read.
const LOG_END: u64 = 64 << 10;
/// How many characters of each line of a log are shown.
const LINE_LENGTH: usize = 400;
