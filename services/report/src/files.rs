//! The files of a run, read: its result, its texts, its tables of comma-separated values.

use std::io::ErrorKind;
use std::path::Path;

use config::{BoundedLines, open_regular, read_small};
use outcome::{OutcomeError, RESULT_FILE, RunResult};
use serde::de::DeserializeOwned;

use crate::ReportError;

/// The largest table that is read: a run of many hours.
const MOST_BYTES: u64 = 256 << 20;

/// Reads the result of a run that has ended.
pub(crate) fn read_result(run: &Path) -> Result<RunResult, ReportError> {
    outcome::read_result(run).map_err(|error| match error {
        OutcomeError::Io { source, .. } if source.kind() == ErrorKind::NotFound && !run.exists() => {
            ReportError::Read { path: run.to_owned(), problem: source }
        }
        OutcomeError::Io { source, .. } if source.kind() == ErrorKind::NotFound => {
            ReportError::Missing {
                folder: run.to_owned(),
                file: RESULT_FILE,
                advice: "the run has not ended; wait for it, resume it with `pathtune train --resume` if it is a \
                         training, or repeat it",
            }
        }
        other => ReportError::result(other),
    })
}

/// The text of a file that every ended run holds.
pub(crate) fn read_required(
    run: &Path,
    file: &'static str,
    advice: &'static str,
) -> Result<String, ReportError> {
    let path = run.join(file);
    match read_small(&path) {
        Ok(text) => Ok(text),
        Err(error) if error.kind() == ErrorKind::NotFound => {
            Err(ReportError::Missing { folder: run.to_owned(), file, advice })
        }
        Err(problem) => Err(ReportError::Read { path, problem }),
    }
}

/// Reads a table of comma-separated values, whose header names the columns, and passes each row to `take`, which
/// returns what is wrong with it, if anything. Columns that the row's type does not have are skipped. Returns whether
/// there is such a file.
pub(crate) fn read_table<T: DeserializeOwned>(
    path: &Path,
    mut take: impl FnMut(T) -> Result<(), String>,
) -> Result<bool, ReportError> {
    let file = match open_regular(path) {
        Ok(file) => file,
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(false),
        Err(problem) => return Err(ReportError::Read { path: path.to_owned(), problem }),
    };
    if file.metadata().is_ok_and(|meta| meta.len() > MOST_BYTES) {
        let problem = format!("it holds more than {} MiB", MOST_BYTES >> 20);
        return Err(ReportError::malformed(path, None, problem));
    }
    let mut reader =
        csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(BoundedLines::new(file));
    let headers = reader.headers().map_err(|error| at(path, &error))?.clone();
    let mut record = csv::StringRecord::new();
    while reader.read_record(&mut record).map_err(|error| at(path, &error))? {
        let line = record.position().map(csv::Position::line);
        let row = record.deserialize(Some(&headers)).map_err(|error| {
            let problem = match error.kind() {
                csv::ErrorKind::Deserialize { err, .. } => {
                    let column = err
                        .field()
                        .and_then(|field| headers.get(field as usize))
                        .map(|name| format!("{name}: "));
                    format!("{}{}", column.unwrap_or_default(), err.kind())
                }
                _ => error.to_string(),
            };
            ReportError::malformed(path, line, problem)
        })?;
        take(row).map_err(|problem| ReportError::malformed(path, line, problem))?;
    }
    Ok(true)
}

/// Refuses the first number that cannot be drawn.
pub(crate) fn check_numbers<'a>(
    numbers: impl IntoIterator<Item = (&'a str, f64)>,
) -> Result<(), String> {
    match numbers.into_iter().find(|(_, number)| !number.is_finite()) {
        Some((column, number)) => Err(format!("{column}: {number} cannot be drawn")),
        None => Ok(()),
    }
}

fn at(path: &Path, error: &csv::Error) -> ReportError {
    let line = error.position().map(csv::Position::line);
    let problem = match error.kind() {
        csv::ErrorKind::UnequalLengths { expected_len, len, .. } => {
            format!("{len} values, but the header names {expected_len} columns")
        }
        csv::ErrorKind::Utf8 { .. } => "the text is not UTF-8".to_owned(),
        _ => error.to_string(),
    };
    ReportError::malformed(path, line, problem)
}
