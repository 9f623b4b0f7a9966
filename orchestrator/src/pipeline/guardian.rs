//! Stands between the orchestrator and a user's program, and lets nothing of that program outlive it.
//!
//! A guardian starts the program, in a control group of its own where one can be made, and adopts whatever descendants
//! lose their parent. It writes what they print to a log of bounded size. When the program ends, when the orchestrator
//! asks for it, and when the orchestrator dies, it kills all that is left of them, and then ends as the program did.

use std::fs::File;
use std::io::{Read, Write};
use std::os::unix::net::UnixStream;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use runtime::Attachment;
use runtime::log_file::LogFile;
use rustix::event::{PollFd, PollFlags, poll};
use rustix::fs::{OFlags, fcntl_setfl};
use rustix::io::Errno;
use rustix::pipe::{PipeFlags, pipe_with};
use rustix::process::{
    Pid, Resource, Rlimit, Signal, WaitOptions, WaitStatus, getppid, kill_process,
    kill_process_group, set_parent_process_death_signal, setrlimit, wait,
};
use signal_hook::consts::{SIGCHLD, SIGHUP, SIGINT, SIGTERM};

use crate::pipeline::cgroup::Cgroup;
use crate::pipeline::{orphans, strays};

/// Name of the service.
pub(crate) const SERVICE: &str = "guardian";
/// The variable that names the control group which the program is to enter.
pub(crate) const CGROUP: &str = "PATHTUNE_CGROUP";

/// Starts a user's program and guards it to its end: the service `guardian LOG COMMAND`. Prints the program's process
/// id.
///
/// # Errors
/// If the program cannot be started. Otherwise this process ends as the program does.
pub fn guard(words: &[String]) -> anyhow::Result<()> {
    let [log, command] = words else { bail!("a guardian takes a log and a command") };
    let attachment = Attachment::from_env()?;
    let signals = Signals::catch()?;
    // Not a killing one: the program's processes must be killed first.
    set_parent_process_death_signal(Some(Signal::TERM))?;
    if getppid().map(|pid| pid.as_raw_nonzero().get()) != Some(attachment.parent) {
        bail!("the orchestrator that started this process is gone");
    }
    orphans::adopt();
    let mut log = LogFile::open(Path::new(log))?;
    let cgroup = Cgroup::make(attachment.names.run, std::process::id());
    let (program, mut output) = start(command, cgroup.as_ref(), &attachment)?;
    name(program);

    let (mut status, mut is_asked, mut has_output) = (None, false, true);
    while status.is_none() && !is_asked {
        let mut fds = vec![PollFd::new(&signals.bell, PollFlags::IN)];
        if has_output {
            fds.push(PollFd::new(&output, PollFlags::IN));
        }
        let _ = poll(&mut fds, None);
        has_output = has_output && write_down(&mut output, &mut log) != Printed::AllThereIs;
        signals.be_quiet();
        is_asked = signals.end.load(Ordering::Relaxed);
        if signals.interrupt.swap(false, Ordering::Relaxed) {
            let _ = kill_process_group(program, Signal::INT);
        }
        status = reap(program).0;
    }
    if !is_asked {
        survivors(program).into_iter().for_each(name);
    }
    if let Some(cgroup) = cgroup {
        cgroup.kill();
    }
    // Whoever loses its parent becomes a child of this process: without a child, it is the last one.
    loop {
        let (ended, is_alone) = reap(program);
        status = status.or(ended);
        if is_alone {
            break;
        }
        for child in orphans::children() {
            let _ = kill_process(child, Signal::KILL);
        }
        std::thread::sleep(LOOK_EVERY);
    }
    while write_down(&mut output, &mut log) == Printed::Something {}
    end_like(status)
}

/// Names a process to the orchestrator, if that still listens.
fn name(process: Pid) {
    let _ = writeln!(std::io::stdout(), "{}", process.as_raw_nonzero());
}

/// How long what a program has started may outlive it.
const GRACE: Duration = Duration::from_millis(100);
const LOOK_EVERY: Duration = Duration::from_millis(1);

/// The signals that a guardian heeds.
struct Signals {
    /// Readable after each of them.
    bell: UnixStream,
    end: Arc<AtomicBool>,
    interrupt: Arc<AtomicBool>,
}

impl Signals {
    fn catch() -> anyhow::Result<Self> {
        let (bell, ringer) = UnixStream::pair()?;
        bell.set_nonblocking(true)?;
        let (end, interrupt) = (Arc::default(), Arc::default());
        // Before the bell, so that it is not heard before the flag is there.
        for signal in [SIGTERM, SIGHUP] {
            signal_hook::flag::register(signal, Arc::clone(&end))?;
        }
        signal_hook::flag::register(SIGINT, Arc::clone(&interrupt))?;
        for signal in [SIGTERM, SIGHUP, SIGINT, SIGCHLD] {
            signal_hook::low_level::pipe::register(signal, ringer.try_clone()?)?;
        }
        Ok(Self { bell, end, interrupt })
    }

    fn be_quiet(&self) {
        while (&self.bell).read(&mut [0; 64]).is_ok_and(|count| count > 0) {}
    }
}

/// Starts the program; returns its process id, and what it and its descendants print.
fn start(
    command: &str,
    cgroup: Option<&Cgroup>,
    attachment: &Attachment,
) -> anyhow::Result<(Pid, File)> {
    let (output, printed) = pipe_with(PipeFlags::CLOEXEC)?;
    // By it the program's processes are found if this one is killed together with the orchestrator.
    strays::note(&attachment.names.root, &output, cgroup)
        .context("failed to note what the program is known by")?;
    fcntl_setfl(&output, OFlags::NONBLOCK)?;
    let mut child = Command::new("/proc/self/exe");
    child
        .arg0("pathtune")
        // Ties itself to our life and moves to its core, then becomes the user's program.
        .args(["service", "exec", "--"])
        .args(shell_words::split(command)?)
        .env(Attachment::PARENT, std::process::id().to_string());
    if let Some(cgroup) = cgroup {
        child.env(CGROUP, cgroup.path());
    }
    let child = child
        .process_group(0)
        .stdin(Stdio::null())
        .stdout(printed.try_clone()?)
        .stderr(printed)
        .spawn()
        .context("failed to start the program")?;
    Ok((Pid::from_child(&child), output.into()))
}

/// What there was to copy.
#[derive(PartialEq)]
enum Printed {
    Something,
    /// Nothing for now.
    Nothing,
    /// Nobody is left who could print.
    AllThereIs,
}

/// Copies what was printed to the log.
fn write_down(output: &mut File, log: &mut LogFile) -> Printed {
    let mut bytes = [0; 64 << 10];
    match output.read(&mut bytes) {
        Ok(0) => Printed::AllThereIs,
        Ok(count) => {
            // A full disk must not hold up the program.
            let _ = log.write_all(&bytes[..count]);
            Printed::Something
        }
        Err(_) => Printed::Nothing,
    }
}

/// Takes note of the children that have ended. Returns how the program has ended, if it is among them, and whether no
/// child is left.
fn reap(program: Pid) -> (Option<WaitStatus>, bool) {
    let mut ended = None;
    loop {
        match wait(WaitOptions::NOHANG) {
            Ok(Some((pid, status))) if pid == program => ended = Some(status),
            Ok(Some(_)) | Err(Errno::INTR) => {}
            Ok(None) => return (ended, false),
            Err(_) => return (ended, true),
        }
    }
}

/// The processes that a program leaves behind when it ends by itself.
fn survivors(program: Pid) -> Vec<Pid> {
    let until = Instant::now() + GRACE;
    while !reap(program).1 {
        if Instant::now() > until {
            return orphans::children();
        }
        std::thread::sleep(LOOK_EVERY);
    }
    Vec::new()
}

/// Ends this process as the program has ended.
fn end_like(status: Option<WaitStatus>) -> anyhow::Result<()> {
    if let Some(signal) = status.and_then(|status| status.terminating_signal()) {
        // The program has left a core file, if anything.
        let none = Rlimit { current: Some(0), maximum: Some(0) };
        let _ = setrlimit(Resource::Core, none);
        let _ = signal_hook::low_level::emulate_default_handler(signal);
    }
    std::process::exit(status.and_then(|status| status.exit_status()).unwrap_or(1))
}
