//! Measures whole pipelines: one alone, several at once, observed, and waiting.

use std::collections::BTreeMap;
use std::io::Read;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use outcome::RunResult;
use runtime::periods::FILE_VARIABLE;
use rustix::process::{Pid, Signal, kill_process};
use tempfile::TempDir;

use super::rings::Killed;
use super::{LAW, MANEUVER, Timing, spread};
use crate::runs::state::RunState;

/// A pipeline that does nothing but drive: the sets of a grid, one drive each.
struct Sweep {
    orchestrator: Child,
    folder: TempDir,
}

/// Name of the file with the times of a pipeline's ticks.
const TICK_TIMES: &str = "tick_times";

/// As many drives as take about a second and leave no place in the fleet empty. Another law may take longer for each.
fn drives_of(law: &str, fleet: usize) -> usize {
    match fleet {
        0..=3 if law != LAW => 16,
        0..=3 => 32,
        4..=15 => 128,
        16..=63 => 512,
        _ => 1024,
    }
}

impl Sweep {
    fn start(law: &str, fleet: usize, more: &[&str]) -> Result<Self> {
        let folder = tempfile::tempdir()?;
        let orchestrator = Command::new("/proc/self/exe")
            .arg0("pathtune")
            .args(["grid", MANEUVER])
            .args(spread(law, drives_of(law, fleet))?.iter().flat_map(|it| ["--set", it]))
            // Wait as the rings do, whatever else the machine would allow.
            .args(["--wait", "yield", "--rings", "1"])
            .args(["--fleet", &fleet.to_string(), "--json", "--out"])
            .arg(folder.path().join("run"))
            .args(more)
            .env(FILE_VARIABLE, folder.path().join(TICK_TIMES))
            .process_group(0)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()?;
        Ok(Self { orchestrator, folder })
    }

    fn id(&self) -> u32 {
        self.orchestrator.id()
    }

    /// Waits until the run drives; returns its number.
    fn run(&mut self) -> Result<String> {
        let until = Instant::now() + Duration::from_secs(10);
        loop {
            let state = RunState::of_orchestrator(self.id());
            if let Some(state) = state.filter(|state| state.batch > 0) {
                return Ok(state.run);
            }
            ensure!(Instant::now() < until, "a pipeline did not begin to drive");
            ensure!(self.orchestrator.try_wait()?.is_none(), "a pipeline ended too early");
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    /// Nanoseconds per tick, once the pipeline has ended.
    fn tick_ns(&mut self) -> Result<f64> {
        let mut text = String::new();
        let mut output = self.orchestrator.stdout.take().context("no output")?;
        output.read_to_string(&mut text)?;
        let folder = self.folder.path().display();
        ensure!(self.orchestrator.wait()?.success(), "a pipeline failed in {folder}");
        let result: RunResult = serde_json::from_str(&text)?;
        Ok(result.run.tick_ns)
    }
}

impl Drop for Sweep {
    fn drop(&mut self) {
        // Stopped in order: if killed, it would leave its shared memory for the next run to remove.
        let _ = kill_process(Pid::from_child(&self.orchestrator), Signal::INT);
        let _ = self.orchestrator.wait();
    }
}

/// A tick of one pipeline with this law, and with the given number of monitors attached.
pub(super) fn pipeline(law: &str, fleet: usize, monitors: usize) -> Result<Timing> {
    let mut sweep = Sweep::start(law, fleet, &[])?;
    let mut watching = Vec::new();
    if monitors > 0 {
        let run = sweep.run()?;
        for _ in 0..monitors {
            watching.push(Killed(monitor(&run)?));
        }
    }
    let tick_ns = sweep.tick_ns()?;
    let text = std::fs::read_to_string(sweep.folder.path().join(TICK_TIMES))?;
    Ok(Timing { tick_ns, ..Timing::parse(&text)? })
}

fn monitor(run: &str) -> std::io::Result<Child> {
    Command::new("/proc/self/exe")
        .arg0("pathtune")
        .args(["monitor", run, "--json"])
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
}

/// Vehicle ticks a second of `count` pipelines at once, together.
pub(super) fn pipelines(count: usize, fleet: usize) -> Result<f64> {
    let mut sweeps: Vec<Sweep> =
        (0..count).map(|_| Sweep::start(LAW, fleet, &[])).collect::<Result<_>>()?;
    let mut rate = 0.0;
    for sweep in &mut sweeps {
        rate += fleet as f64 * 1e9 / sweep.tick_ns()?;
    }
    Ok(rate)
}

/// One process of a pipeline whose vehicle takes 10 ms a tick.
pub(super) struct Waiting {
    pub(super) name: String,
    /// Share of a core.
    pub(super) cpu: f64,
    pub(super) rss_bytes: u64,
    /// The part of it that is shared memory.
    pub(super) shared_bytes: u64,
}

/// How much processor time and memory the processes of a pipeline use while they wait for a slow vehicle, and the time
/// from the start of a pipeline to its first drive.
pub(super) fn waiting() -> Result<(Vec<Waiting>, Duration)> {
    let started = Instant::now();
    let mut sweep = Sweep::start(LAW, 1, &["--chaos", "delay odometry 10ms"])?;
    sweep.run()?;
    let start_up = started.elapsed();
    std::thread::sleep(Duration::from_millis(500));
    let before = (Instant::now(), cpu_times(sweep.id()));
    std::thread::sleep(Duration::from_secs(3));
    let wall_s = before.0.elapsed().as_secs_f64();
    let after = cpu_times(sweep.id());
    let waiting = after
        .into_iter()
        .filter_map(|(pid, (name, ticks))| {
            let (_, ticks_before) = before.1.get(&pid)?;
            let cpu_s =
                (ticks - ticks_before) as f64 / rustix::param::clock_ticks_per_second() as f64;
            let (rss_bytes, shared_bytes) = memory(pid);
            Some(Waiting { name, cpu: cpu_s / wall_s, rss_bytes, shared_bytes })
        })
        .collect();
    Ok((waiting, start_up))
}

/// Clock ticks that an orchestrator and its processes have run, by process id, with the name of each.
fn cpu_times(orchestrator: u32) -> BTreeMap<u32, (String, u64)> {
    let Ok(entries) = std::fs::read_dir("/proc") else { return BTreeMap::new() };
    entries
        .flatten()
        .filter_map(|entry| {
            let pid: u32 = entry.file_name().to_str()?.parse().ok()?;
            let stat = std::fs::read_to_string(entry.path().join("stat")).ok()?;
            // After the name, which may contain anything: state, parent, …, user and system time.
            let fields: Vec<&str> = stat.rsplit_once(')')?.1.split_whitespace().collect();
            let parent: u32 = fields.get(1)?.parse().ok()?;
            let ticks =
                fields.get(11)?.parse::<u64>().ok()? + fields.get(12)?.parse::<u64>().ok()?;
            let name = match pid == orchestrator {
                true => "orchestrator".to_owned(),
                false if parent == orchestrator => name_of(&entry.path())?,
                false => return None,
            };
            Some((pid, (name, ticks)))
        })
        .collect()
}

/// `pathtune service NAME`.
fn name_of(process: &Path) -> Option<String> {
    let words = std::fs::read_to_string(process.join("cmdline")).ok()?;
    words.split('\0').nth(2).map(str::to_owned)
}

/// Resident memory of a process, and the part of it that is shared.
fn memory(pid: u32) -> (u64, u64) {
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).unwrap_or_default();
    let bytes = |key: &str| {
        let line = status.lines().find_map(|line| line.strip_prefix(key));
        let kib = line.and_then(|rest| rest.split_whitespace().next()?.parse::<u64>().ok());
        kib.unwrap_or_default() * 1024
    };
    (bytes("VmRSS:"), bytes("RssShmem:"))
}
