//! The latency monitor: observes a running pipeline from another terminal, without slowing it.
//!
//! It is one more reader of odometry, raw commands and commands, and computes everything from the stamps that
//! these carry anyway: no process of the pipeline does anything for it. [`latency`] is the pure part; [`report`] has
//! its figures in the form in which they are output; the rest reads the bus, writes and draws.

pub mod latency;
mod lines;
mod observed;
#[cfg(feature = "prometheus")]
mod prometheus;
pub mod report;
mod view;

use std::io::{self, IsTerminal};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::Context;
use config::RunConfig;
use runtime::clock::now_ns;
use runtime::run::RunNames;

use crate::observed::ObservedRun;

/// What a user wants to see.
#[derive(Debug, Clone)]
pub struct Options {
    /// The run.
    pub names: RunNames,
    /// Its output folder.
    pub folder: PathBuf,
    /// Slot of the vehicle whose flags are shown.
    pub vehicle: usize,
    /// One JSON object a second on standard output.
    pub json: bool,
    /// One row a second in a file.
    pub csv: Option<PathBuf>,
    /// How long to watch; without end if it is not given.
    pub duration: Option<Duration>,
    /// A single report over a second.
    pub once: bool,
    /// The longest end-to-end span that is no deadline miss; the run's tick if it is not given.
    pub budget: Option<Duration>,
    /// Where Prometheus can fetch the figures.
    pub prometheus: Option<SocketAddr>,
}

/// Why a run cannot be watched.
#[derive(Debug, thiserror::Error)]
pub enum MonitorError {
    /// A user's mistake.
    #[error("{0}")]
    User(String),
    /// Anything else.
    #[error(transparent)]
    Other(#[from] anyhow::Error),
}

impl From<runtime::BusError> for MonitorError {
    fn from(error: runtime::BusError) -> Self {
        Self::Other(error.into())
    }
}

impl From<io::Error> for MonitorError {
    fn from(error: io::Error) -> Self {
        Self::Other(error.into())
    }
}

/// Time between looks at the bus. At 125,000 ticks a second a quarter of an observer's buffer fills meanwhile, so
/// that a look that comes late loses nothing yet; and with nothing to read, 500 looks a second cost well under
/// one percent of a core.
const POLL: Duration = Duration::from_millis(2);
/// Time between checks whether the run is still alive.
const LOOK_NS: u64 = 200_000_000;
const SECOND_NS: u64 = 1_000_000_000;
/// The niceness of an observer, which gives way to the pipeline on a core that it must share with it.
const NICENESS: i32 = 10;

/// Watches a run until the user ends it or the run ends.
///
/// # Errors
/// If the run cannot be joined, a file or address cannot be used, or there is no such vehicle.
pub fn run(options: &Options) -> Result<(), MonitorError> {
    if options.prometheus.is_some() && !cfg!(feature = "prometheus") {
        return Err(MonitorError::User(
            "this build has no --prometheus; build it with `cargo build --release --features prometheus`"
                .to_owned(),
        ));
    }
    let stop = Stop::new()?;
    // Refused only if the niceness is higher already.
    let _ = rustix::process::nice(NICENESS);
    let budget_ns = budget_ns(options)?;
    let mut run = ObservedRun::attach(&options.names, options.vehicle, budget_ns)?;
    let mut publish = Publish::new(options)?;
    let rings = run.rings();
    if rings > 1 {
        let _ = io::Write::write_fmt(
            &mut io::stderr(),
            format_args!(
                "pathtune: {rings} rings share the drives of this run; shown is the first one\n"
            ),
        );
    }
    let asked_for_lines = options.json || options.csv.is_some() || options.once;
    let ended = if asked_for_lines || !io::stdout().is_terminal() {
        lines::run(options, &mut run, &stop, &mut publish)?
    } else {
        view::run(options, &mut run, &stop, &mut publish)?
    };
    drop(run);
    if ended == StopReason::RunOver {
        // A user who has closed standard error does not want to know.
        let _ = io::Write::write_fmt(
            &mut io::stderr(),
            format_args!("pathtune: run {:016x} has ended\n", options.names.run),
        );
    }
    Ok(())
}

/// The budget that was given, or the tick of the run's configuration.
fn budget_ns(options: &Options) -> Result<u64, MonitorError> {
    if let Some(budget) = options.budget {
        return Ok(u64::try_from(budget.as_nanos()).unwrap_or(u64::MAX));
    }
    let path = options.folder.join("config.toml");
    let text = config::read_small(&path).with_context(|| {
        format!("failed to read {}; name the deadline with --budget", path.display())
    })?;
    let config = RunConfig::from_resolved(&text)
        .with_context(|| format!("failed to read {}", path.display()))?;
    Ok((config.drive.tick_s * 1e9).round() as u64)
}

/// Why watching has ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum StopReason {
    /// The user has ended it.
    Enough,
    /// The run's orchestrator is gone.
    RunOver,
}

/// Whether a signal asks the process to end.
struct Stop(Arc<AtomicBool>);

impl Stop {
    fn new() -> io::Result<Self> {
        let flag = Arc::new(AtomicBool::new(false));
        use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
        for signal in [SIGINT, SIGTERM, SIGHUP] {
            signal_hook::flag::register(signal, flag.clone())?;
        }
        Ok(Self(flag))
    }

    fn is_asked_for(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

/// What every kind of output does between two looks at the bus.
struct LookTimer {
    began_ns: u64,
    look_ns: u64,
    duration_ns: Option<u64>,
}

impl LookTimer {
    fn new(options: &Options) -> Self {
        let now_ns = now_ns();
        let ns = |duration: Duration| u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX);
        Self { began_ns: now_ns, look_ns: now_ns, duration_ns: options.duration.map(ns) }
    }

    /// Whether it is time to look at more than the bus.
    fn is_time_to_look(&mut self) -> bool {
        let now_ns = now_ns();
        let is_time = now_ns >= self.look_ns;
        if is_time {
            self.look_ns = now_ns + LOOK_NS;
        }
        is_time
    }

    fn is_over(&self) -> bool {
        self.duration_ns.is_some_and(|duration_ns| now_ns() - self.began_ns >= duration_ns)
    }
}

/// Takes what has come. When a run ends, its bus is gone before its lock: that is not an error.
fn drain(run: &mut ObservedRun) -> Result<Option<StopReason>, MonitorError> {
    match run.drain() {
        Err(MonitorError::Other(_)) if !run.is_alive() => Ok(Some(StopReason::RunOver)),
        other => other.map(|()| None),
    }
}

/// The figures for Prometheus, if they are asked for.
struct Publish {
    #[cfg(feature = "prometheus")]
    page: Option<prometheus::Page>,
}

impl Publish {
    #[cfg(feature = "prometheus")]
    fn new(options: &Options) -> Result<Self, MonitorError> {
        let open = |address| {
            prometheus::Page::open(address).map_err(|error| {
                MonitorError::User(format!("failed to listen on {address}: {error}"))
            })
        };
        Ok(Self { page: options.prometheus.map(open).transpose()? })
    }

    #[cfg(not(feature = "prometheus"))]
    fn new(_: &Options) -> Result<Self, MonitorError> {
        Ok(Self {})
    }

    #[cfg(feature = "prometheus")]
    fn put(&mut self, report: &report::Report) {
        if let Some(page) = &self.page {
            page.put(report);
        }
    }

    #[cfg(not(feature = "prometheus"))]
    fn put(&mut self, _: &report::Report) {}
}
