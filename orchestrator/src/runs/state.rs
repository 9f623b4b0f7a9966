//! What a living run reports about itself in a file in its private folder, by which other terminals find it.
//!
//! The pipeline writes it, so this module uses nothing of the pipeline.

use std::path::{Path, PathBuf};
use std::{fs, io};

use config::read_small;
use outcome::ProcessFacts;
use runtime::run::{RunNames, living_runs};
use serde::{Deserialize, Serialize};

use crate::runs::preflight::check_resources_of_observer;
use crate::words::Failure;

/// Name of the file in a drive's folder that says what was known of the car when it began.
pub(crate) const CAR_FILE: &str = "car.txt";

/// What a living run reports about itself.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct RunState {
    pub(crate) run: String,
    pub(crate) pid: u32,
    pub(crate) maneuver: String,
    pub(crate) folder: PathBuf,
    /// Whether it is a training, which can be gone on with.
    #[serde(default)]
    pub(crate) resumable: bool,
    pub(crate) batch: u64,
    pub(crate) attempt: u32,
    pub(crate) tick: u64,
    /// How many rings share its drives; batch, attempt and tick are the first one's.
    #[serde(default)]
    pub(crate) rings: usize,
    pub(crate) processes: Vec<ProcessState>,
}

/// One process of it.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct ProcessState {
    /// `down`, `starting` or `ready`.
    pub(crate) state: String,
    #[serde(flatten)]
    pub(crate) facts: ProcessFacts,
}

impl RunState {
    /// Name of the file.
    pub(crate) const FILE: &str = "run.json";

    /// Name of the file by which a run is asked to stop. A number of a process would be no good name of a run: in another
    /// container it is another process.
    pub(crate) const STOP_FILE: &str = "stop";

    /// Asks the run to stop.
    pub(crate) fn request_stop(&self) -> io::Result<()> {
        let names =
            living_runs().into_iter().find(|names| format!("{:016x}", names.run) == self.run);
        match names {
            // Made anew, so that no link is followed; somebody else may have asked already.
            Some(names) => match fs::File::create_new(names.root.join(Self::STOP_FILE)) {
                Err(error) if error.kind() != io::ErrorKind::AlreadyExists => Err(error),
                _ => Ok(()),
            },
            None => Ok(()),
        }
    }

    /// Writes the file, by rename, so that nobody reads half of it.
    pub(crate) fn write(&self, path: &Path) -> io::Result<()> {
        let part = path.with_extension("part");
        fs::write(&part, serde_json::to_vec(self)?)?;
        fs::rename(part, path)
    }

    /// The living run of the orchestrator with this process id.
    pub(crate) fn of_orchestrator(pid: u32) -> Option<Self> {
        Self::living().into_iter().find(|state| state.pid == pid)
    }

    /// The living runs of this user.
    pub(crate) fn living() -> Vec<Self> {
        living_runs().iter().filter_map(Self::read).collect()
    }

    /// The living run that a user names by the beginning of its number or by its folder, or the only one there is.
    pub(crate) fn find(run: Option<&str>) -> Result<Self, Failure> {
        let mut runs = Self::living();
        if let Some(word) = run {
            let folder = fs::canonicalize(word).ok();
            runs.retain(|state| {
                state.run.starts_with(word) || Some(&state.folder) == folder.as_ref()
            });
        }
        match (runs.len(), run) {
            (1, _) => Ok(runs.remove(0)),
            (0, None) => Err(Failure::User("no run is alive".to_owned())),
            (0, Some(word)) => Err(Failure::User(format!(
                "no living run has a number or folder {word:?}; `pathtune status` lists them"
            ))),
            (_, _) => Err(Failure::User(format!(
                "several runs match: {}; name one",
                runs.iter().map(|state| state.run.as_str()).collect::<Vec<_>>().join(", ")
            ))),
        }
    }

    fn read(names: &RunNames) -> Option<Self> {
        serde_json::from_str(&read_small(&names.root.join(Self::FILE)).ok()?).ok()
    }
}

/// What `pathtune status --json` says of a living run.
#[derive(Debug, Serialize)]
pub(crate) struct ShownRun {
    #[serde(flatten)]
    pub(crate) state: RunState,
    /// Root path and prefix of its iceoryx2.
    root: PathBuf,
    prefix: String,
}

impl ShownRun {
    /// Those living runs of this user that are named, or all of them.
    pub(crate) fn named(run: Option<&str>) -> Result<Vec<Self>, Failure> {
        let only = run.map(|_| RunState::find(run)).transpose()?;
        let is_meant = |state: &RunState| only.as_ref().is_none_or(|only| only.run == state.run);
        let living = living_runs().into_iter().filter_map(|names| {
            let state = RunState::read(&names).filter(is_meant)?;
            Some(Self { state, prefix: names.prefix(), root: names.root })
        });
        Ok(living.collect())
    }
}

/// What observers need to know about a living run.
#[derive(Debug, Clone)]
pub struct LivingRun {
    /// What names it on this machine.
    pub names: RunNames,
    /// Its output folder.
    pub folder: PathBuf,
}

/// What was known of the car since its envelope was calibrated when the drive in this folder began, in words.
pub fn known_of_car(folder: &Path) -> Option<String> {
    let text = read_small(&folder.join(CAR_FILE)).ok()?;
    Some(text.lines().next()?.to_owned())
}

/// The living run that a user names by the beginning of its number or by its folder, or the only one there is.
///
/// # Errors
/// If no run matches, or several do.
pub fn living_run(run: Option<&str>) -> Result<LivingRun, Failure> {
    let state = RunState::find(run)?;
    check_resources_of_observer()?;
    let names = living_runs()
        .into_iter()
        .find(|names| format!("{:016x}", names.run) == state.run)
        .ok_or_else(|| Failure::User(format!("run {} has just ended", state.run)))?;
    Ok(LivingRun { names, folder: state.folder })
}
