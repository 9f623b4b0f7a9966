//! `pathtune sweep run --all`: the engine for one machine. One job is one process tree on one core.

use std::collections::{BTreeMap, VecDeque};
use std::io::{BufRead, BufReader};
use std::os::fd::OwnedFd;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::sync::Mutex;
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::thread;
use std::time::Duration;

use rustix::process::{Pid, PidfdFlags, Signal, pidfd_open, pidfd_send_signal};

use crate::cli::RunJobsArgs;
use crate::pipeline::cores::free_first;
use crate::pipeline::interrupts::Interrupts;
use crate::runs::preflight::check_resources_of_pipelines;
use crate::study::identity::resolve;
use crate::study::manifest::Manifest;
use crate::study::progress::Progress;
use crate::study::status::{Damages, jobs_have};
use crate::study::store::Store;
use crate::words::Failure;
use crate::words::terminal::{say, tell};

/// The exit code of a job whose input is wrong.
const WRONG_INPUT: i32 = 64;

/// Runs all jobs that are not done.
///
/// # Errors
/// If a line is damaged, the machine is too small, or a job has failed in the end.
pub(crate) fn run_all(args: &RunJobsArgs) -> Result<(), Failure> {
    let interrupts = Interrupts::new()?;
    let store = Store::of(&args.at).make()?;
    let mut damages = Damages::default();
    let (mut waiting, mut done) = (VecDeque::new(), 0);
    let mut largest = Largest::default();
    for line in Manifest::open(&args.at.manifest)?.lines()? {
        match line {
            Err(line) => damages.tell(&line.message),
            Ok(job) if store.is_done(&job.job) => done += 1,
            Ok(job) => {
                waiting.push_back(Trial { index: job.index, number: 1 });
                largest.look_at(&job.command);
            }
        }
    }
    let all = done + waiting.len();
    if !waiting.is_empty() {
        let cores = cores(args, waiting.len())?;
        check_resources_of_pipelines(cores.len(), largest.max_len)?;
        let engine = Engine::new(args, waiting)?;
        let mut progress = Progress::new(args.quiet, done, all);
        let failed = engine.run(&cores, &interrupts, &mut progress);
        progress.finish();
        done = progress.done;
        if let Some(signal) = interrupts.signal() {
            let way_on = "the same command goes on with the rest";
            return Err(Failure::Interrupted(
                signal,
                format!("{done} of {all} jobs are done; {way_on}"),
            ));
        }
        say!("{done} of {all} jobs are done");
        damages.end()?;
        let count = failed.len();
        let jobs = jobs_have(count);
        let way_on = "see `pathtune sweep status`";
        return match failed.contains(&WRONG_INPUT) {
            true => Err(Failure::User(format!("{jobs} failed; {way_on}"))),
            false if count > 0 => Err(Failure::TryAgain(format!("{jobs} failed; {way_on}"))),
            false => Ok(()),
        };
    }
    say!("{done} of {all} jobs are done");
    damages.end()
}

/// How large the pipelines of the jobs are that are to run.
#[derive(Debug, Default)]
struct Largest {
    /// Elements of the longest messages of any.
    max_len: usize,
    /// The last command without its seed: of jobs that differ in nothing else, one tells for all.
    family: Vec<String>,
    families: usize,
}

impl Largest {
    /// Families that are looked at: resolving a configuration takes a millisecond.
    const MOST_FAMILIES: usize = 1000;

    fn look_at(&mut self, command: &[String]) {
        let at = command.iter().position(|word| word == "--seed").unwrap_or(command.len());
        let family = &command[..at];
        if family == self.family || self.families == Self::MOST_FAMILIES {
            return;
        }
        self.family = family.to_vec();
        self.families += 1;
        // A mistake in a job's input is that job's own failure; here it only hides how large its pipeline is.
        self.max_len = self.max_len.max(resolve(command).map_or(1, |it| it.max_len()));
    }
}

/// One core for each pipeline, those first that no other run has claimed.
fn cores(args: &RunJobsArgs, jobs: usize) -> Result<Vec<usize>, Failure> {
    let mut cores = free_first();
    let wanted = args.jobs.map_or(cores.len(), |jobs| jobs as usize);
    if wanted > cores.len() {
        let count = cores.len();
        return Err(Failure::User(format!(
            "-j {wanted}: each job takes a core, and this machine gives {count}; take -j {count} or less"
        )));
    }
    cores.truncate(wanted.min(jobs));
    let taken = cores.iter().filter(|(_, is_free)| !is_free).count();
    if taken > 0 && !args.quiet {
        tell!(
            "pathtune: other runs have claimed {taken} of these cores; jobs share them, and take longer"
        );
    }
    Ok(cores.into_iter().map(|(core, _)| core).collect())
}

/// One try of a job.
#[derive(Debug, Clone, Copy)]
struct Trial {
    index: u64,
    /// Which one it is, counted from 1.
    number: u32,
}

/// What a slot reports to the main thread.
pub(crate) enum Event {
    Done,
    /// A trial failed; the job is tried again unless this was its last one.
    Failed {
        line: String,
        is_last: bool,
    },
}

struct Engine<'a> {
    args: &'a RunJobsArgs,
    program: PathBuf,
    waiting: Mutex<VecDeque<Trial>>,
    /// The jobs under way, so that they can be asked to stop; none is started any more once this is `None`.
    running: Mutex<Option<BTreeMap<u64, OwnedFd>>>,
}

impl<'a> Engine<'a> {
    fn new(args: &'a RunJobsArgs, waiting: VecDeque<Trial>) -> Result<Self, Failure> {
        // The binary may be replaced while a study runs: this name leads to the one that runs now.
        let program = PathBuf::from("/proc/self/exe");
        let program = std::fs::read_link(&program).ok().filter(|it| it.exists()).unwrap_or(program);
        let (waiting, running) = (Mutex::new(waiting), Mutex::new(Some(BTreeMap::new())));
        Ok(Self { args, program, waiting, running })
    }

    /// Runs the jobs, one at a time on each core; returns the exit codes of those that have failed in the end.
    fn run(&self, cores: &[usize], interrupts: &Interrupts, progress: &mut Progress) -> Vec<i32> {
        let failed = Mutex::new(Vec::new());
        thread::scope(|scope| {
            let (events, told) = channel();
            for core in cores {
                let (events, failed) = (events.clone(), &failed);
                scope.spawn(move || self.work_on(*core, &events, failed));
            }
            drop(events);
            loop {
                match told.recv_timeout(Duration::from_millis(100)) {
                    Ok(event) => progress.take(event),
                    Err(RecvTimeoutError::Timeout) => progress.show(),
                    Err(RecvTimeoutError::Disconnected) => break,
                }
                if interrupts.signal().is_some() {
                    self.stop();
                }
            }
        });
        failed.into_inner().expect("no slot panics")
    }

    /// Takes one job after the other.
    fn work_on(&self, core: usize, events: &Sender<Event>, failed: &Mutex<Vec<i32>>) {
        loop {
            let next = self.waiting.lock().expect("no slot panics").pop_front();
            let Some(trial) = next else { return };
            let Some((code, line)) = self.try_job(trial, core) else { return };
            let event = match code {
                0 => Event::Done,
                code => {
                    let is_last = code == WRONG_INPUT || trial.number >= self.args.tries;
                    if is_last {
                        failed.lock().expect("no slot panics").push(code);
                    } else {
                        let again = Trial { number: trial.number + 1, ..trial };
                        self.waiting.lock().expect("no slot panics").push_back(again);
                    }
                    let index = trial.index;
                    let line = if line.is_empty() {
                        format!("job {index}: exit code {code}")
                    } else {
                        line
                    };
                    Event::Failed { line, is_last }
                }
            };
            if events.send(event).is_err() {
                return;
            }
        }
    }

    /// Runs one trial; returns its exit code and its last words, or nothing if this engine is to stop.
    fn try_job(&self, trial: Trial, core: usize) -> Option<(i32, String)> {
        let mut command = Command::new(&self.program);
        command.args(["sweep", "run"]).arg(&self.args.at.manifest);
        let path = |command: &mut Command, option: &str, value: &Option<PathBuf>| {
            if let Some(value) = value {
                command.arg(option).arg(value);
            }
        };
        path(&mut command, "--results", &self.args.at.results);
        path(&mut command, "--scratch", &self.args.scratch);
        if self.args.keep {
            command.arg("--keep");
        }
        command.args(["--quiet", "--index", &trial.index.to_string(), "--core", &core.to_string()]);
        command.args(["--under", &std::process::id().to_string()]);
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
        let started = {
            // Held while it starts: a job is either not started, or asked to stop like the others.
            let mut running = self.running.lock().expect("no slot panics");
            let running = running.as_mut()?;
            let child = command.spawn();
            if let Ok(child) = &child
                && let Some(pid) = Pid::from_raw(child.id() as i32)
                && let Ok(handle) = pidfd_open(pid, PidfdFlags::empty())
            {
                running.insert(trial.index, handle);
            }
            child
        };
        let mut child = match started {
            Ok(child) => child,
            Err(error) => return Some((75, format!("job {}: {error}", trial.index))),
        };
        let mut last = String::new();
        if let Some(stderr) = child.stderr.take() {
            // Whatever it says: the last line tells how it ended.
            for line in BufReader::new(stderr).split(b'\n').map_while(Result::ok) {
                last = String::from_utf8_lossy(&line).trim().to_owned();
            }
        }
        let code = child.wait().ok().and_then(|status| status.code()).unwrap_or(75);
        let mut running = self.running.lock().expect("no slot panics");
        let is_stopped = running.is_none();
        running.as_mut().and_then(|running| running.remove(&trial.index));
        (code == 0 || !is_stopped).then_some((code, last))
    }

    /// Asks the jobs under way to stop, once; no other is started.
    fn stop(&self) {
        let running = self.running.lock().expect("no slot panics").take();
        for handle in running.into_iter().flat_map(BTreeMap::into_values) {
            let _ = pidfd_send_signal(handle, Signal::TERM);
        }
    }
}
