//! What `result.json` holds, as far as the page shows it. Keys that the page does not know are passed over, and whatever
//! older or shorter runs lack is optional: a report of an old run is better than none.

use std::collections::BTreeMap;
use std::fs;
use std::io::ErrorKind;
use std::path::Path;

use config::Gains;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

use crate::ReportError;

/// The result of a run, of one of four kinds.
#[derive(Debug)]
pub(crate) enum RunResult {
    Train(Box<Train>),
    Validate(Validate),
    Grid(Grid),
    Drive(Drive),
}

/// A single drive.
#[derive(Debug, Deserialize)]
pub(crate) struct Drive {
    pub(crate) gains: Vec<Gains>,
    pub(crate) reason: String,
    pub(crate) driven_s: f64,
    pub(crate) mse_m2: f64,
    pub(crate) along_m2: f64,
    pub(crate) cross_m2: f64,
    pub(crate) max_cross_track_m: f64,
    #[serde(default)]
    pub(crate) true_poses: bool,
    #[serde(default)]
    pub(crate) joined: bool,
}

/// The key that tells the kinds apart, and what heads every page.
#[derive(Debug, Clone, Default, Deserialize)]
pub(crate) struct Head {
    pub(crate) kind: Option<String>,
    pub(crate) maneuver: Option<String>,
    pub(crate) seed: Option<u64>,
    pub(crate) digest: Option<String>,
}

/// A training.
#[derive(Debug, Deserialize)]
pub(crate) struct Train {
    pub(crate) gains: Gains,
    #[serde(default)]
    pub(crate) on_bound: Vec<String>,
    pub(crate) distance: f64,
    pub(crate) mse_m2: f64,
    pub(crate) grid: Option<GridStanding>,
    pub(crate) paper: Option<SetStanding>,
    pub(crate) plain_q: Option<PlainQ>,
    pub(crate) drives: Option<DriveCounts>,
    #[serde(default)]
    pub(crate) learners: Vec<Learner>,
    pub(crate) recovery: Option<Recovery>,
    pub(crate) noise: Option<NoiseOutcome>,
    pub(crate) vehicle_s: Option<f64>,
    pub(crate) wall_s: Option<f64>,
    pub(crate) real_time_factor: Option<f64>,
}

/// Where the tuned set stands in the grid.
#[derive(Debug, Deserialize)]
pub(crate) struct GridStanding {
    pub(crate) size: u64,
    pub(crate) rank_distance: Option<u64>,
    pub(crate) rank_mse: Option<u64>,
    pub(crate) rank_mean_distance: Option<u64>,
    pub(crate) best_distance: Option<f64>,
    pub(crate) best_mse_m2: Option<f64>,
}

/// One set, noise-free, and its ranks.
#[derive(Debug, Clone, Deserialize)]
pub(crate) struct SetStanding {
    pub(crate) gains: Gains,
    pub(crate) distance: f64,
    pub(crate) mse_m2: f64,
    pub(crate) rank_distance: Option<u64>,
    pub(crate) rank_mse: Option<u64>,
}

/// The training beside, by plain Q-learning.
#[derive(Debug, Deserialize)]
pub(crate) struct PlainQ {
    #[serde(flatten)]
    pub(crate) set: SetStanding,
    pub(crate) asked: Option<u64>,
}

#[derive(Debug, Deserialize)]
pub(crate) struct DriveCounts {
    pub(crate) asked: u64,
    pub(crate) driven: u64,
    pub(crate) reissued: u64,
}

#[derive(Debug, Deserialize)]
pub(crate) struct Recovery {
    #[serde(default)]
    pub(crate) injected: u64,
    #[serde(default)]
    pub(crate) recoveries: u64,
}

/// One learner, and how it learnt.
#[derive(Debug, Deserialize)]
pub(crate) struct Learner {
    pub(crate) alpha: f64,
    pub(crate) gains: Gains,
    #[serde(default)]
    pub(crate) locked: BTreeMap<String, f64>,
    #[serde(default)]
    pub(crate) episodes: Vec<Episode>,
    /// How often each value of each gain was driven.
    pub(crate) usage: Option<BTreeMap<String, Vec<Use>>>,
}

#[derive(Debug, Deserialize)]
pub(crate) struct Episode {
    #[serde(rename = "return")]
    pub(crate) return_: f64,
    #[serde(default)]
    pub(crate) steps: u64,
    #[serde(default)]
    pub(crate) terminated: bool,
    #[serde(default)]
    pub(crate) distances: Vec<f64>,
}

#[derive(Debug, Deserialize)]
pub(crate) struct Use {
    pub(crate) value: f64,
    pub(crate) count: f64,
}

/// What a training under noise adds: its finalists, driven again and again.
#[derive(Debug, Deserialize)]
pub(crate) struct NoiseOutcome {
    #[serde(default)]
    pub(crate) finalists: Vec<Finalist>,
    pub(crate) against_paper: Option<Difference>,
    pub(crate) repeats: Option<u64>,
    pub(crate) holdout: Option<u64>,
}

#[derive(Debug, Deserialize)]
pub(crate) struct Finalist {
    pub(crate) gains: Gains,
    pub(crate) mean_distance: f64,
    pub(crate) low: f64,
    pub(crate) high: f64,
    pub(crate) visits: Option<u64>,
}

#[derive(Debug, Deserialize)]
pub(crate) struct Difference {
    pub(crate) difference: f64,
    pub(crate) low: f64,
    pub(crate) high: f64,
    pub(crate) verdict: String,
}

/// A validation: the rows of the paper's table, driven.
#[derive(Debug, Deserialize)]
pub(crate) struct Validate {
    pub(crate) rows: Vec<ValidateRow>,
    pub(crate) rms_factor: Option<f64>,
    pub(crate) repeats: Option<u64>,
}

#[derive(Debug, Deserialize)]
pub(crate) struct ValidateRow {
    /// One set for each manoeuvre of the path.
    pub(crate) gains: Vec<Gains>,
    #[serde(default)]
    pub(crate) chosen_by_paper: bool,
    pub(crate) noise_free: NoiseFree,
    pub(crate) noisy: Option<Noisy>,
    #[serde(default)]
    pub(crate) switches: Vec<Switch>,
}

#[derive(Debug, Deserialize)]
pub(crate) struct NoiseFree {
    pub(crate) mse_m2: f64,
    pub(crate) along_m2: Option<f64>,
    pub(crate) cross_m2: Option<f64>,
    pub(crate) distance: Option<f64>,
    pub(crate) max_cross_track_m: Option<f64>,
    /// Share of the ticks.
    pub(crate) steering_limited: Option<f64>,
    pub(crate) collisions: Option<u64>,
    pub(crate) paper_mse_m2: Option<f64>,
    pub(crate) factor: Option<f64>,
}

#[derive(Debug, Deserialize)]
pub(crate) struct Noisy {
    pub(crate) mse_m2_mean: f64,
    pub(crate) mse_m2_low: Option<f64>,
    pub(crate) mse_m2_high: Option<f64>,
    pub(crate) mse_m2_worst: Option<f64>,
    pub(crate) collisions: Option<u64>,
    pub(crate) paper_mse_m2: Option<f64>,
    pub(crate) factor: Option<f64>,
}

/// Other gains from a tick on, where the vehicle entered a zone.
#[derive(Debug, Deserialize)]
pub(crate) struct Switch {
    pub(crate) tick: u64,
    pub(crate) zone: u64,
    pub(crate) name: String,
    pub(crate) gains: Gains,
}

/// The exhaustive grid.
#[derive(Debug, Deserialize)]
pub(crate) struct Grid {
    pub(crate) size: u64,
    #[serde(default)]
    pub(crate) best_by_distance: Vec<SetStanding>,
    #[serde(default)]
    pub(crate) best_by_mse: Vec<SetStanding>,
    #[serde(default)]
    pub(crate) sets: Vec<NamedSet>,
    #[serde(default)]
    pub(crate) flatness: Vec<Flatness>,
    #[serde(default)]
    pub(crate) main_effects: BTreeMap<String, MainEffect>,
    /// Of every set, in the order of the grid.
    #[serde(default)]
    pub(crate) distances: Vec<f64>,
}

#[derive(Debug, Deserialize)]
pub(crate) struct NamedSet {
    pub(crate) name: String,
    #[serde(flatten)]
    pub(crate) set: SetStanding,
}

/// How many sets are nearly as good as the best.
#[derive(Debug, Deserialize)]
pub(crate) struct Flatness {
    pub(crate) within: f64,
    pub(crate) sets_by_distance: Option<u64>,
    pub(crate) sets_by_mse: Option<u64>,
}

/// What one gain does on average over all values of the others.
#[derive(Debug, Deserialize)]
pub(crate) struct MainEffect {
    pub(crate) share_distance: Option<f64>,
    pub(crate) share_mse: Option<f64>,
    #[serde(default)]
    pub(crate) values: Vec<EffectValue>,
}

#[derive(Debug, Deserialize)]
pub(crate) struct EffectValue {
    pub(crate) value: f64,
    pub(crate) mean_distance: f64,
    pub(crate) mean_mse_m2: f64,
}

/// Reads a run's `result.json`.
pub(crate) fn read(run: &Path) -> Result<(Head, RunResult), ReportError> {
    let text = read_required(
        run,
        "result.json",
        "the run has not ended; wait for it, go on with it by `pathtune train --resume` if it is a training, or drive it anew",
    )?;
    let path = run.join("result.json");
    // serde_json names line and column of a slip in the syntax, but not of a key that is missing: the path of the key
    // says more there.
    let value: Value = serde_json::from_str(&text)
        .map_err(|error| ReportError::malformed(&path, Some(error.line() as u64), &error))?;
    let head: Head = typed(&path, &value)?;
    let result = match head.kind.as_deref() {
        None | Some("train") => RunResult::Train(typed(&path, &value)?),
        Some("validate") => RunResult::Validate(typed(&path, &value)?),
        Some("grid") => RunResult::Grid(typed(&path, &value)?),
        Some("drive") => RunResult::Drive(typed(&path, &value)?),
        Some(other) => {
            let problem =
                format!("kind: {other:?} is none of \"train\", \"validate\", \"grid\", \"drive\"");
            return Err(ReportError::malformed(&path, None, problem));
        }
    };
    Ok((head, result))
}

fn typed<T: DeserializeOwned>(path: &Path, value: &Value) -> Result<T, ReportError> {
    serde_path_to_error::deserialize(value).map_err(|error| {
        let key = error.path().to_string();
        let problem = match key.as_str() {
            "." => error.inner().to_string(),
            key => format!("{key}: {}", error.inner()),
        };
        ReportError::malformed(path, None, problem)
    })
}

/// The text of a file that every ended run holds.
pub(crate) fn read_required(
    run: &Path,
    file: &'static str,
    advice: &'static str,
) -> Result<String, ReportError> {
    let path = run.join(file);
    match fs::read(&path) {
        Ok(bytes) => String::from_utf8(bytes)
            .map_err(|_| ReportError::malformed(&path, None, "the text is not UTF-8")),
        Err(error) if error.kind() == ErrorKind::NotFound => {
            Err(ReportError::Missing { folder: run.to_owned(), file, advice })
        }
        Err(problem) => Err(ReportError::Read { path, problem }),
    }
}
