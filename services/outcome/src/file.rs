//! The files of a result, read and written.

use std::io;
use std::path::{Path, PathBuf};

use config::read_small;
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::{Decided, RunResult, SCHEMA};

/// Name of the result in a run's folder.
pub const RESULT_FILE: &str = "result.json";
/// Name of its decided part.
pub const OUTCOME_FILE: &str = "outcome.json";

/// A result that cannot be read.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say it")]
pub enum OutcomeError {
    #[error("{path}: {source}")]
    Io { path: PathBuf, source: io::Error },
    #[error(
        "{path}: made by an earlier version of pathtune; read it with that version, or run again"
    )]
    Earlier { path: PathBuf },
    #[error("{path}: {problem}")]
    Malformed { path: PathBuf, problem: String },
}

/// Reads the result of a run.
///
/// # Errors
/// If the file cannot be read, is of an earlier version, or is not a result.
pub fn read_result(folder: &Path) -> Result<RunResult, OutcomeError> {
    read(&folder.join(RESULT_FILE))
}

/// Reads the decided part of a result, while the run has not ended.
///
/// # Errors
/// As [`read_result`].
pub fn read_decided(folder: &Path) -> Result<Decided, OutcomeError> {
    read(&folder.join(OUTCOME_FILE))
}

/// The bytes of a file of results: the same for the same value.
pub fn to_json(result: &impl Serialize) -> Vec<u8> {
    let mut bytes = serde_json::to_vec_pretty(result).expect("results are plain data");
    bytes.push(b'\n');
    bytes
}

fn read<T: DeserializeOwned>(path: &Path) -> Result<T, OutcomeError> {
    let text =
        read_small(path).map_err(|source| OutcomeError::Io { path: path.to_owned(), source })?;
    let malformed = |problem: String| OutcomeError::Malformed {
        path: path.to_owned(),
        problem: brief(problem),
    };
    let value: serde_json::Value =
        serde_json::from_str(&text).map_err(|error| malformed(error.to_string()))?;
    match value.get("schema").and_then(serde_json::Value::as_u64) {
        Some(version) if version == u64::from(SCHEMA) => {}
        Some(version) if version < u64::from(SCHEMA) => {
            return Err(OutcomeError::Earlier { path: path.to_owned() });
        }
        Some(version) => {
            return Err(malformed(format!(
                "schema: is {version}, but this version of pathtune reads {SCHEMA}"
            )));
        }
        None => {
            return Err(malformed("schema: is missing: this is not a result of pathtune".into()));
        }
    }
    // Parsed from the text again, not from the value, which sorts the parameters by their names.
    let mut reader = serde_json::Deserializer::from_str(&text);
    serde_path_to_error::deserialize(&mut reader).map_err(|error| {
        let key = error.path().to_string();
        malformed(match key.as_str() {
            "." => error.inner().to_string(),
            key => format!("{key}: {}", error.inner()),
        })
    })
}

/// A message holds the value that is wrong, however long that is: its beginning and its end say enough.
fn brief(problem: String) -> String {
    let count = problem.chars().count();
    if count <= LONGEST_MESSAGE {
        return problem;
    }
    let half = LONGEST_MESSAGE / 2;
    let (first, last) = (problem.chars().take(half), problem.chars().skip(count - half));
    first.chain(['…']).chain(last).collect()
}

/// In characters.
const LONGEST_MESSAGE: usize = 400;
