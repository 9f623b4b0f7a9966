//! What is kept of a job that is done, and of one that failed: a small file each, named after the job's identity.
//!
//! A record has two parts. [`Figures`] is what configuration and seed decide: the same bytes wherever and however often
//! the job was tried. [`Trial`] says how it went. A checksum over the first tells a damaged record from a whole one.

use outcome::{Course, Measures, Outcome, RunResult, TrainResult, ValidatedRow};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::study::manifest::checksum;

/// The largest record that is written and read: one block of most file systems.
pub(crate) const MOST_BYTES: usize = 4096;

/// The version of records.
const VERSION: u32 = 1;

/// A job that is done.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Record {
    version: u32,
    /// The job's identity.
    pub(crate) job: String,
    /// CRC-32 of identity and figures.
    check: String,
    /// What configuration and seed decide.
    pub(crate) figures: Figures,
    /// How it went.
    pub(crate) trial: Trial,
}

/// What configuration and seed decide of a job.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Figures {
    pub(crate) maneuver: String,
    pub(crate) vehicle: String,
    pub(crate) law: String,
    pub(crate) objective: String,
    pub(crate) tuner: String,
    pub(crate) seed: u64,
    /// The digest of the training.
    pub(crate) digest: String,
    /// SHA-256 of `outcome.json`.
    pub(crate) outcome: String,
    /// The tuned parameters, with their names in the law, as JSON.
    pub(crate) gains: String,
    pub(crate) on_bound: Vec<String>,
    pub(crate) value: f64,
    pub(crate) distance: f64,
    pub(crate) mse_m2: f64,
    pub(crate) path_mean_m: f64,
    pub(crate) path_p95_m: f64,
    pub(crate) path_max_m: f64,
    pub(crate) arrived: bool,
    pub(crate) grid_size: Option<usize>,
    pub(crate) rank_value: Option<usize>,
    pub(crate) rank_mean: Option<usize>,
    pub(crate) best_value: Option<f64>,
    pub(crate) paper_value: Option<f64>,
    pub(crate) plain_q_value: Option<f64>,
    pub(crate) random_walk_value: Option<f64>,
    pub(crate) asked: u64,
    pub(crate) distinct: u64,
    /// Of a validation.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) noisy: Option<NoisyFigures>,
    /// How the training went, by true values, if the study compares it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) course: Option<Course>,
}

/// The drives with noise of a validated set.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) struct NoisyFigures {
    pub(crate) mse_m2_mean: f64,
    pub(crate) mse_m2_worst: f64,
    pub(crate) path_mean_m: f64,
    pub(crate) path_max_m: f64,
    pub(crate) collisions: u32,
}

impl Figures {
    /// Those of a drive; what else belongs to a job is left empty.
    fn of_drive(it: &Measures) -> Self {
        Self {
            value: it.value,
            distance: it.distance,
            mse_m2: it.mse_m2,
            path_mean_m: it.path_mean_m,
            path_p95_m: it.path_p95_m,
            path_max_m: it.path_max_m,
            arrived: it.arrived,
            ..Self::default()
        }
    }

    fn of_training(it: &TrainResult) -> Self {
        let beside = |set: &Option<outcome::Beside>| set.as_ref().map(|it| it.set.measures.value);
        Self {
            tuner: it.tuner.clone(),
            digest: it.digest.clone(),
            gains: serde_json::to_string(&it.gains).expect("plain data"),
            on_bound: it.on_bound.clone(),
            grid_size: it.grid.map(|grid| grid.size),
            rank_value: it.grid.map(|grid| grid.rank_value),
            rank_mean: it.grid.and_then(|grid| grid.rank_mean),
            best_value: it.grid.map(|grid| grid.best_value),
            paper_value: it.paper.as_ref().map(|set| set.measures.value),
            plain_q_value: beside(&it.plain_q),
            random_walk_value: beside(&it.random_walk),
            asked: it.asked,
            distinct: it.distinct,
            ..Self::of_drive(&it.measures)
        }
    }

    fn of_validation(row: &ValidatedRow, digest: &str, asked: u64) -> Self {
        let noisy = &row.noisy;
        Self {
            digest: digest.to_owned(),
            gains: serde_json::to_string(&row.gains).expect("plain data"),
            asked,
            distinct: asked,
            noisy: Some(NoisyFigures {
                mse_m2_mean: noisy.mse_m2_mean,
                mse_m2_worst: noisy.mse_m2_worst,
                path_mean_m: noisy.path_mean_m,
                path_max_m: noisy.path_max_m,
                collisions: noisy.collisions,
            }),
            ..Self::of_drive(&row.noise_free.measures)
        }
    }
}

/// How the trial went that came to the end.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Trial {
    pub(crate) host: String,
    pub(crate) started_at: String,
    pub(crate) ended_at: String,
    /// Seconds that the pipeline ran, without those before an interruption.
    pub(crate) wall_s: f64,
    /// Processes that were started again.
    pub(crate) restarts: u32,
}

impl Record {
    /// The record of a job's result; `outcome` holds the bytes of `outcome.json`, `course` what a comparison says of it.
    ///
    /// # Errors
    /// If it is no result of a job.
    pub(crate) fn of(
        job: &str,
        result: &RunResult,
        outcome: &[u8],
        course: Option<Course>,
        host: &str,
    ) -> Result<Self, String> {
        let decided = &result.decided;
        let hash = Sha256::digest(outcome);
        let of_outcome = match &decided.outcome {
            Outcome::Train(it) => Figures::of_training(it),
            Outcome::Validate(it) => match &it.rows[..] {
                [row] => Figures::of_validation(row, &it.digest, result.drives.asked),
                _ => return Err("is the validation of several sets".to_owned()),
            },
            other => return Err(format!("is the result of a {}", other.kind())),
        };
        let figures = Figures {
            maneuver: decided.maneuver.clone(),
            vehicle: decided.vehicle.clone(),
            law: decided.law.clone(),
            objective: decided.objective.clone(),
            seed: decided.seed,
            outcome: hash.iter().map(|byte| format!("{byte:02x}")).collect(),
            course,
            ..of_outcome
        };
        let run = &result.run;
        let trial = Trial {
            host: host.to_owned(),
            started_at: run.started_at.clone(),
            ended_at: run.ended_at.clone(),
            wall_s: run.wall_s,
            restarts: run.processes.iter().map(|process| process.restarts).sum(),
        };
        let check = check(job, &figures);
        Ok(Self { version: VERSION, job: job.to_owned(), check, figures, trial })
    }

    /// Its bytes.
    ///
    /// # Errors
    /// If they are more than [`MOST_BYTES`].
    pub(crate) fn to_bytes(&self) -> Result<Vec<u8>, String> {
        let mut bytes = serde_json::to_vec(self).expect("plain data");
        bytes.push(b'\n');
        match bytes.len() {
            0..=MOST_BYTES => Ok(bytes),
            count => Err(format!("its record has {count} bytes, more than {MOST_BYTES}")),
        }
    }

    /// Reads the record of a job.
    ///
    /// # Errors
    /// If it is damaged, or of another job or version; the error says which.
    pub(crate) fn parse(job: &str, bytes: &[u8]) -> Result<Self, String> {
        let record: Self = serde_json::from_slice(bytes).map_err(|error| error.to_string())?;
        if record.version != VERSION {
            return Err(format!("of version {}, not {VERSION}", record.version));
        }
        if record.job != job {
            return Err(format!("of another job, {}", record.job));
        }
        if record.check != check(job, &record.figures) {
            return Err("its checksum does not fit".to_owned());
        }
        Ok(record)
    }
}

fn check(job: &str, figures: &Figures) -> String {
    checksum(&format!("{job}{}", serde_json::to_string(figures).expect("plain data")))
}

/// A job that failed.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Failed {
    /// The exit code: 64 or 75.
    pub(crate) code: u8,
    /// How often it was tried.
    pub(crate) tries: u32,
    /// What the last trial said at its end.
    pub(crate) line: String,
    pub(crate) host: String,
    pub(crate) at: String,
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// A record for tests.
    pub(crate) fn record(job: &str, seed: u64, value: f64) -> Record {
        let figures = Figures {
            maneuver: "lane_change".to_owned(),
            vehicle: "tesla, long".to_owned(),
            law: "paper".to_owned(),
            objective: "distance".to_owned(),
            tuner: "educated-q".to_owned(),
            seed,
            digest: "ab".repeat(32),
            outcome: "cd".repeat(32),
            gains: "{\"kv\":1.26,\"kl\":11.0}".to_owned(),
            on_bound: vec!["kl".to_owned()],
            value,
            distance: 0.1 + 0.2,
            mse_m2: 1.5,
            path_mean_m: 1e-9,
            path_p95_m: 0.1,
            path_max_m: 0.2,
            arrived: false,
            grid_size: Some(750),
            rank_value: Some(1),
            rank_mean: None,
            best_value: Some(value),
            paper_value: None,
            plain_q_value: Some(value),
            random_walk_value: Some(value),
            asked: 15_117,
            distinct: 695,
            noisy: None,
            course: None,
        };
        let trial = Trial {
            host: "here".to_owned(),
            started_at: String::new(),
            ended_at: String::new(),
            wall_s: 1.0,
            restarts: 0,
        };
        let check = check(job, &figures);
        Record { version: VERSION, job: job.to_owned(), check, figures, trial }
    }

    #[test]
    fn a_record_is_read_as_it_was_written_and_each_damage_is_seen() {
        let job = "0".repeat(32);
        let whole = record(&job, 7, 0.795_5);
        let bytes = whole.to_bytes().unwrap();
        assert_eq!(Record::parse(&job, &bytes).unwrap(), whole);
        assert!(Record::parse(&"1".repeat(32), &bytes).unwrap_err().contains("another job"));
        let text = String::from_utf8(bytes.clone()).unwrap();
        let figures = text.find("\"trial\"").unwrap();
        // One bit of any byte before the part that differs from trial to trial.
        for place in 0..figures {
            let mut damaged = bytes.clone();
            damaged[place] ^= 1;
            let read = Record::parse(&job, &damaged);
            assert!(read.as_ref().is_err() || read.unwrap() == whole, "byte {place}");
        }
        for end in 0..bytes.len() - 2 {
            assert!(Record::parse(&job, &bytes[..end]).is_err(), "{end} bytes");
        }
    }

    #[test]
    fn a_record_too_large_is_not_written() {
        let mut large = record(&"0".repeat(32), 7, 1.0);
        large.figures.gains = "x".repeat(MOST_BYTES);
        assert!(large.to_bytes().unwrap_err().contains("more than 4096"));
    }
}
