//! Driving at 100 Hz: how long it takes from odometry to the applied command, and what is lost, on a quiet machine and
//! with a load on all cores.

use std::io::Read;
use std::os::unix::process::CommandExt;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use rustix::process::{Pid, Signal, kill_process};
use serde_json::{Value, json};
use tempfile::TempDir;

use super::rings::Killed;
use crate::runs::state::RunState;
use crate::words::Failure;
use crate::words::tables::table_of;
use crate::words::terminal::{say, tell};

/// Time before a drive is measured: the processes have just started.
const SETTLING: Duration = Duration::from_secs(1);

/// How it is driven.
#[derive(Debug, Clone, Copy)]
struct Condition {
    name: &'static str,
    loaded: bool,
    fifo: bool,
}

const CONDITIONS: [Condition; 4] = [
    Condition { name: "realtime", loaded: false, fifo: false },
    Condition { name: "realtime/loaded", loaded: true, fifo: false },
    Condition { name: "realtime/fifo", loaded: false, fifo: true },
    Condition { name: "realtime/fifo/loaded", loaded: true, fifo: true },
];

/// Measures under each condition, and prints a table.
pub(super) fn bench(time: Duration, as_json: bool) -> Result<(), Failure> {
    let mut rows = Vec::new();
    for condition in CONDITIONS {
        if !as_json {
            tell!("{}: {} s", condition.name, time.as_secs_f64());
        }
        rows.push((condition.name, measure(condition, time)?));
    }
    let hop = |report: &Value, key: &str| report["hops"]["end_to_end"][key].as_u64().unwrap_or(0);
    let ticks = |report: &Value| {
        let count = |key: &str| report[key].as_u64().unwrap_or(0);
        // The odometry of the first tick does not report a command.
        let driven = count("ticks") + count("missed");
        (driven, driven.saturating_sub(1).saturating_sub(hop(report, "n")))
    };
    if as_json {
        let rows: Vec<Value> = rows
            .iter()
            .map(|(name, report)| {
                let (ticks, lost) = ticks(report);
                let of = |key: &str| hop(report, key);
                json!({
                    "name": name, "ticks": ticks, "lost": lost, "p50_ns": of("p50_ns"),
                    "p99_ns": of("p99_ns"), "p999_ns": of("p999_ns"), "max_ns": of("max_ns"),
                    "hops": report["hops"], "period": report["period"],
                })
            })
            .collect();
        say!("{}", json!({ "rows": rows }));
        return Ok(());
    }
    let mut table = table_of(&["100 Hz", "ticks", "lost", "p50 µs", "p99", "p99.9", "max"]);
    for (name, report) in &rows {
        let (ticks, lost) = ticks(report);
        let us = |key: &str| format!("{:.0}", hop(report, key) as f64 / 1e3);
        table.add_row([
            (*name).to_owned(),
            ticks.to_string(),
            lost.to_string(),
            us("p50_ns"),
            us("p99_ns"),
            us("p999_ns"),
            us("max_ns"),
        ]);
    }
    say!("{table}");
    say!(
        "end to end: odometry published to command applied; lost: ticks that passed without a command of their own; \
         loaded: a busy thread on each core; fifo: --fifo, where it is allowed"
    );
    Ok(())
}

/// The monitor's report on a drive by the clock.
fn measure(condition: Condition, time: Duration) -> Result<Value> {
    let folder = tempfile::tempdir()?;
    let load = condition.loaded.then(Load::new);
    let drive = Drive::start(condition, &folder, time)?;
    let run = drive.run()?;
    thread::sleep(SETTLING);
    let mut monitor = Killed(
        Command::new("/proc/self/exe")
            .arg0("pathtune")
            .args(["monitor", &run, "--once", "--json", "--for"])
            .arg(format!("{}ms", time.as_millis()))
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()?,
    );
    let mut text = String::new();
    monitor.0.stdout.take().context("no output")?.read_to_string(&mut text)?;
    drop((drive, load));
    serde_json::from_str(&text).context("the monitor saw nothing")
}

/// A drive by the clock that outlasts its measurement.
struct Drive(Child);

impl Drive {
    fn start(condition: Condition, folder: &TempDir, time: Duration) -> Result<Self> {
        let loop_s = time.as_secs() + 60;
        let child = Command::new("/proc/self/exe")
            .arg0("pathtune")
            .args(["drive", "roundabout", "--realtime", "--quiet", "--out"])
            .arg(folder.path().join("run"))
            .args(["--set", &format!("drive.loop_time_s={loop_s}")])
            // A circle without an end.
            .args(["--set", "path.pieces=[{kind='arc',radius_m=100.0,angle_deg=3600.0}]"])
            .args(condition.fifo.then_some("--fifo"))
            .process_group(0)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()?;
        Ok(Self(child))
    }

    /// Waits until it drives; returns the run's number.
    fn run(&self) -> Result<String> {
        let until = Instant::now() + Duration::from_secs(20);
        loop {
            let state = RunState::of_orchestrator(self.0.id());
            if let Some(state) = state.filter(|state| state.batch > 0) {
                return Ok(state.run);
            }
            ensure!(Instant::now() < until, "a drive by the clock did not begin");
            thread::sleep(Duration::from_millis(5));
        }
    }
}

impl Drop for Drive {
    fn drop(&mut self) {
        let _ = kill_process(Pid::from_child(&self.0), Signal::INT);
        let _ = self.0.wait();
    }
}

/// A load of one busy thread for each core.
struct Load {
    stop: Arc<AtomicBool>,
    threads: Vec<thread::JoinHandle<()>>,
}

impl Load {
    fn new() -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let cores = thread::available_parallelism().map_or(1, usize::from);
        let busy = |_| {
            let stop = stop.clone();
            thread::spawn(move || while !stop.load(Ordering::Relaxed) {})
        };
        let threads = (0..cores).map(busy).collect();
        Self { stop, threads }
    }
}

impl Drop for Load {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}
