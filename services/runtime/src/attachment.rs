//! How a process learns which run it belongs to: its environment.

use std::num::NonZero;
use std::path::PathBuf;
use std::str::FromStr;

use anyhow::{Context, Result, bail};

use crate::chaos;
use crate::run::RunNames;
use crate::waiting::{Wait, use_fifo};

/// Where a process belongs: the variables that the orchestrator sets for each of its children.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Attachment {
    /// The run.
    pub names: RunNames,
    /// The run's output folder: configuration, journal, logs, result.
    pub folder: PathBuf,
    /// The largest number of elements in a message of this run.
    pub max_len: usize,
    /// Which ring of the run it belongs to, counted from 0; the first one is also that of trainer and recorder.
    pub ring: usize,
    /// Which start of this role it is, counted from 1.
    pub incarnation: u64,
    /// The core on which this process must run, if a certain one is chosen.
    pub core: Option<usize>,
    /// How the processes of the run wait for each other.
    pub wait: Wait,
    /// Priority of first-in-first-out scheduling, if the processes of the ring must request it; see [`use_fifo`].
    pub fifo: Option<u8>,
    /// Process id of the process that starts this one: the orchestrator, or the guardian of a user's program.
    pub parent: i32,
    /// Faults to inject, with their seed; see [`crate::chaos`].
    pub chaos: Option<(String, u64)>,
}

const RUN: &str = "PATHTUNE_RUN";
const ROOT: &str = "PATHTUNE_ROOT";
const PREFIX: &str = "PATHTUNE_PREFIX";
const FOLDER: &str = "PATHTUNE_FOLDER";
const MAX_LEN: &str = "PATHTUNE_MAX_LEN";
const RING: &str = "PATHTUNE_RING";
const INCARNATION: &str = "PATHTUNE_INCARNATION";
const CORE: &str = "PATHTUNE_CORE";
const WAIT: &str = "PATHTUNE_WAIT";
const FIFO: &str = "PATHTUNE_FIFO";
const PARENT: &str = Attachment::PARENT;

impl Attachment {
    /// The variable with the process id of the parent, with which the process ends.
    pub const PARENT: &str = "PATHTUNE_PARENT";

    /// Reads the environment.
    ///
    /// # Errors
    /// If a variable is missing or malformed: the process was not started by an orchestrator.
    pub fn from_env() -> Result<Self> {
        let text = |name: &str| {
            std::env::var(name).with_context(|| {
                format!("{name} is not set: services are started by `pathtune train`, not by hand")
            })
        };
        let run =
            u64::from_str_radix(&text(RUN)?, 16).with_context(|| format!("malformed {RUN}"))?;
        let names = RunNames { run, root: PathBuf::from(text(ROOT)?) };
        if text(PREFIX)? != names.prefix() {
            bail!("{PREFIX} does not belong to {RUN}");
        }
        fn parsed<T: FromStr>(name: &str) -> Result<Option<T>> {
            let Ok(text) = std::env::var(name) else { return Ok(None) };
            let parsed = text.parse().ok().with_context(|| format!("malformed {name}"))?;
            Ok(Some(parsed))
        }
        Ok(Self {
            names,
            folder: PathBuf::from(text(FOLDER)?),
            max_len: text(MAX_LEN)?.parse().with_context(|| format!("malformed {MAX_LEN}"))?,
            ring: parsed(RING)?.unwrap_or_default(),
            incarnation: text(INCARNATION)?
                .parse()
                .with_context(|| format!("malformed {INCARNATION}"))?,
            core: parsed(CORE)?,
            wait: parsed(WAIT)?.unwrap_or_default(),
            fifo: parsed(FIFO)?,
            chaos: None,
            parent: text(PARENT)?.parse().with_context(|| format!("malformed {PARENT}"))?,
        })
    }

    /// Gives a child its variables, and none of ours that the user's own environment happens to have: such as a script of
    /// faults, or a priority.
    pub fn give_to(&self, child: &mut std::process::Command) {
        for (name, _) in std::env::vars_os() {
            let ours = name.to_str().is_some_and(|name| name.starts_with("PATHTUNE_"));
            let kept = [
                crate::logging::LOG_VAR,
                crate::log_file::LIMIT_VARIABLE,
                crate::periods::FILE_VARIABLE,
            ];
            if ours && kept.iter().all(|kept| name != *kept) {
                child.env_remove(name);
            }
        }
        child.envs(self.to_env());
    }

    /// The variables, for a child.
    pub fn to_env(&self) -> Vec<(&'static str, String)> {
        let mut env = vec![
            (RUN, format!("{:016x}", self.names.run)),
            (ROOT, self.names.root.display().to_string()),
            (PREFIX, self.names.prefix()),
            (FOLDER, self.folder.display().to_string()),
            (MAX_LEN, self.max_len.to_string()),
            (INCARNATION, self.incarnation.to_string()),
            (PARENT, self.parent.to_string()),
            (WAIT, self.wait.name().to_owned()),
            (GLIBC_TUNABLES, without_rseq(std::env::var(GLIBC_TUNABLES).ok())),
        ];
        if let Some((script, seed)) = &self.chaos {
            env.push((chaos::SCRIPT, script.clone()));
            env.push((chaos::SEED, seed.to_string()));
        }
        if self.ring > 0 {
            env.push((RING, self.ring.to_string()));
        }
        if let Some(core) = self.core {
            env.push((CORE, core.to_string()));
        }
        if let Some(fifo) = self.fifo {
            env.push((FIFO, fifo.to_string()));
        }
        env
    }

    /// Ties this process to its orchestrator: when the orchestrator dies, this process is killed. Call it before
    /// anything else.
    ///
    /// # Errors
    /// If the orchestrator is gone already.
    pub fn tie_to_parent(&self) -> Result<()> {
        rustix::process::set_parent_process_death_signal(Some(rustix::process::Signal::KILL))?;
        // The orchestrator may have died before the signal was requested.
        let parent = rustix::process::getppid().map(|pid| pid.as_raw_nonzero().get());
        if parent != Some(self.parent) {
            bail!("the orchestrator that started this process is gone");
        }
        Ok(())
    }

    /// Takes the place on the machine that this process was given: its core and its priority. A refusal costs speed and
    /// nothing else.
    pub fn take_place(&self) {
        // The kernel may wake a sleeper 50 µs late to save a little power: here that is half of a tick's duration.
        let _ = rustix::thread::set_current_timer_slack(NonZero::new(1));
        if let Some(core) = self.core {
            let mut cores = rustix::thread::CpuSet::new();
            cores.set(core);
            if let Err(error) = rustix::thread::sched_setaffinity(None, &cores) {
                tracing::warn!(core, %error, "not pinned");
            }
        }
        if let Some(priority) = self.fifo
            && let Err(why) = use_fifo(priority)
        {
            tracing::warn!(priority, %why, "not scheduled first in, first out");
        }
    }
}
/// The variable with settings for the C library, read when a process starts.
const GLIBC_TUNABLES: &str = "GLIBC_TUNABLES";

/// Settings with which the C library does not register restartable sequences: nothing here uses them, and the
/// kernel would have to check them at every switch of the core to another process.
fn without_rseq(settings: Option<String>) -> String {
    let ours = "glibc.pthread.rseq=0";
    settings.map_or(ours.to_owned(), |theirs| format!("{theirs}:{ours}"))
}
