//! The folder of a study's results: where the record of each job is, and what is beside it.
//!
//! ```text
//! ab/ab….json           record of a job that is done
//! ab/ab….outcome.json   its outcome.json
//! ab/ab….failed         why its last trial failed
//! work/ab…/             the run's folder of a trial under way, unless a scratch folder was named
//! ab/.ab….part          a file that is being written, or that somebody was killed over
//! ```
//!
//! Records are spread over 256 folders by the first two digits of the identity: a million files in one folder are slow to
//! find on many file systems. Everything is written beside and renamed, so that nobody reads half a file.

use std::fs;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use config::{open_regular, read_small};

use crate::cli::StudyArg;
use crate::study::record::{Failed, MOST_BYTES, Record};
use crate::words::Failure;

/// The folder of a study's results.
#[derive(Debug, Clone)]
pub(crate) struct Store {
    pub(crate) folder: PathBuf,
}

/// How a job stands.
#[derive(Debug)]
pub(crate) enum Standing {
    /// Its record.
    Done(Box<Record>),
    /// Neither done nor failed.
    Missing,
    /// Why the last trial failed.
    Failed(Failed),
    /// The record cannot be read: with the file and why.
    Damaged(String),
}

impl Store {
    /// The folder that belongs to a manifest, or the one that the user names.
    pub(crate) fn of(at: &StudyArg) -> Self {
        let beside = || at.manifest.with_extension("results");
        Self { folder: at.results.clone().unwrap_or_else(beside) }
    }

    /// Makes the folder, and names it by its whole path: a job works in another folder.
    pub(crate) fn make(self) -> Result<Self, Failure> {
        let fail = |error: io::Error| {
            let why = format!("{}: cannot be made: {error}", self.folder.display());
            match error.kind() {
                // A file in its place stays there.
                io::ErrorKind::AlreadyExists | io::ErrorKind::NotADirectory => Failure::User(why),
                _ => Failure::TryAgain(why),
            }
        };
        fs::create_dir_all(&self.folder).map_err(fail)?;
        Ok(Self { folder: fs::canonicalize(&self.folder).map_err(fail)? })
    }

    fn path(&self, job: &str, ending: &str) -> PathBuf {
        self.folder.join(&job[..2]).join(format!("{job}.{ending}"))
    }

    /// How a job stands, by what lies in the folder.
    pub(crate) fn standing(&self, job: &str) -> Standing {
        let path = self.path(job, "json");
        match open_regular(&path).and_then(|file| {
            let mut bytes = Vec::new();
            file.take(MOST_BYTES as u64 + 1).read_to_end(&mut bytes).map(|_| bytes)
        }) {
            Ok(bytes) if bytes.len() > MOST_BYTES => {
                Standing::Damaged(format!("{}: damaged (too large)", path.display()))
            }
            Ok(bytes) => match Record::parse(job, &bytes) {
                Ok(record) => Standing::Done(Box::new(record)),
                Err(why) => Standing::Damaged(format!("{}: damaged ({why})", path.display())),
            },
            Err(error) if error.kind() == io::ErrorKind::NotFound => match self.failed(job) {
                Some(failed) => Standing::Failed(failed),
                None => Standing::Missing,
            },
            Err(error) => Standing::Damaged(format!("{}: {error}", path.display())),
        }
    }

    /// Whether a job is done.
    pub(crate) fn is_done(&self, job: &str) -> bool {
        matches!(self.standing(job), Standing::Done(_))
    }

    fn failed(&self, job: &str) -> Option<Failed> {
        serde_json::from_str(&read_small(&self.path(job, "failed")).ok()?).ok()
    }

    /// Keeps what a job has come to. The record is written last: once it is there, the job is done.
    pub(crate) fn keep(&self, record: &Record, outcome: &[u8]) -> Result<(), String> {
        let bytes = record.to_bytes()?;
        self.write(&self.path(&record.job, "outcome.json"), outcome)?;
        self.write(&self.path(&record.job, "json"), &bytes)?;
        let _ = fs::remove_file(self.path(&record.job, "failed"));
        Ok(())
    }

    /// Notes that a trial of a job failed.
    pub(crate) fn note_failure(&self, job: &str, code: u8, line: &str) -> Result<(), String> {
        let tries = 1 + self.failed(job).map_or(0, |before| before.tries);
        let line = line.chars().take(1000).collect();
        let at = jiff::Timestamp::now().strftime("%Y-%m-%dT%H:%M:%SZ").to_string();
        let failed = Failed { code, tries, line, host: host(), at };
        let text = serde_json::to_string(&failed).expect("plain data");
        self.write(&self.path(job, "failed"), text.as_bytes())
    }

    /// Writes a file as a whole. Others may write the same one on other machines: each has a part of its own.
    fn write(&self, path: &Path, bytes: &[u8]) -> Result<(), String> {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let part = path.with_file_name(format!(".{name}.{}.{}.part", host(), std::process::id()));
        let written = fs::write(&part, bytes)
            .or_else(|error| match (error.kind(), part.parent()) {
                // The first file of its folder.
                (io::ErrorKind::NotFound, Some(folder)) => {
                    fs::create_dir_all(folder).and_then(|()| fs::write(&part, bytes))
                }
                _ => Err(error),
            })
            .and_then(|()| fs::rename(&part, path));
        written.map_err(|error| {
            let _ = fs::remove_file(&part);
            format!("{}: cannot be written: {error}", path.display())
        })
    }
}

/// The name of this machine, as far as it can be part of a file's name.
pub(crate) fn host() -> String {
    let name = read_small(Path::new("/proc/sys/kernel/hostname")).unwrap_or_default();
    name.chars().filter(|c| c.is_ascii_alphanumeric() || "-_".contains(*c)).take(64).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::study::record::tests::record;

    #[test]
    fn a_job_is_missing_then_failed_then_done_and_damage_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store { folder: folder.path().join("results") }.make().unwrap();
        let job = "ab".repeat(16);
        assert!(matches!(store.standing(&job), Standing::Missing));
        store.note_failure(&job, 75, "no room").unwrap();
        store.note_failure(&job, 75, "no room").unwrap();
        let Standing::Failed(failed) = store.standing(&job) else { panic!() };
        assert_eq!((failed.code, failed.tries, &*failed.line), (75, 2, "no room"));
        store.keep(&record(&job, 7, 1.0), b"{}").unwrap();
        assert!(store.is_done(&job));
        assert!(store.failed(&job).is_none());
        let files = fs::read_dir(store.folder.join("ab")).unwrap().count();
        assert_eq!(files, 2, "only the record and the outcome are left");
        for bytes in [&b""[..], b"{", &[b'x'; 5000]] {
            fs::write(store.path(&job, "json"), bytes).unwrap();
            let Standing::Damaged(why) = store.standing(&job) else { panic!() };
            assert!(why.contains(&format!("ab/{job}.json: damaged")), "{why}");
        }
    }
}
