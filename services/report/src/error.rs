//! Why a report could not be written: always one line that names the file and what to do.

use std::io;
use std::path::{Path, PathBuf};

/// Why a report could not be written.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// The folder does not hold a file that every ended run holds.
    #[error("{} holds no {file}: {advice}", folder.display())]
    Missing {
        /// The run's folder.
        folder: PathBuf,
        /// The file that is not there.
        file: &'static str,
        /// Why it may be missing, and what to do.
        advice: &'static str,
    },
    /// The result cannot be read, or was made by another version.
    #[error("{0}")]
    Result(String),
    /// A file exists, but does not hold what it should.
    #[error("{}: {problem}; the file was changed or cut off since the run; repeat the run", at(path, *line))]
    Malformed {
        /// The file.
        path: PathBuf,
        /// The line, counted from 1, if it is known.
        line: Option<u64>,
        /// What is wrong with it.
        problem: String,
    },
    /// A file could not be read.
    #[error("failed to read {}: {problem}; check that it exists and that you may read it", path.display())]
    Read {
        /// The file or folder.
        path: PathBuf,
        /// What the system says.
        problem: io::Error,
    },
    /// A file could not be written.
    #[error("failed to write {}: {problem}; check that you may write to the folder and that the disk is not full", path.display())]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// What the system says.
        problem: io::Error,
    },
    /// A picture could not be drawn: this is a bug of this crate, not a mistake in the files.
    #[error("failed to draw {picture}: {problem}; please report this with the run's folder")]
    Draw {
        /// Name of the picture.
        picture: String,
        /// What the drawing library says.
        problem: String,
    },
}

impl ReportError {
    /// A file that does not hold what it should; a parser's message of several lines becomes one.
    pub(crate) fn malformed(path: &Path, line: Option<u64>, problem: impl ToString) -> Self {
        Self::Malformed { path: path.to_owned(), line, problem: one_line(problem) }
    }

    /// A result that was refused, with the reason.
    pub(crate) fn result(problem: impl ToString) -> Self {
        Self::Result(one_line(problem))
    }
}

fn one_line(problem: impl ToString) -> String {
    problem.to_string().split_whitespace().collect::<Vec<_>>().join(" ")
}

fn at(path: &Path, line: Option<u64>) -> String {
    match line {
        Some(line) => format!("{}:{line}", path.display()),
        None => path.display().to_string(),
    }
}
