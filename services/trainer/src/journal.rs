//! The journal: every step of a training, one line each, written before the next one is proposed.
//!
//! A line is a CRC-32 in eight hexadecimal digits, a space, and a JSON object; the first names the
//! configuration. A last line that was torn by a crash is cut off; a damaged line before it is an error.

use std::fs::{File, OpenOptions};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};
use tracking::DriveRecord;

use crate::training::{Taken, Training};

/// A journal that cannot be used.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say it")]
pub enum JournalError {
    #[error("failed to use the journal {path}: {source}")]
    Io { path: PathBuf, source: io::Error },
    #[error(
        "the journal {path} is damaged at byte {offset}: {problem}; restore it from a backup, or start the training again"
    )]
    Damaged { path: PathBuf, offset: usize, problem: String },
    #[error(
        "the journal {path} belongs to another configuration; resume with the one it was made with"
    )]
    Foreign { path: PathBuf },
    #[error(
        "the journal {path} was made by an earlier version of pathtune; resume with that version, or start the training again"
    )]
    Earlier { path: PathBuf },
    #[error("the journal {path} is in use by another training")]
    InUse { path: PathBuf },
}

#[derive(Debug, Serialize, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
struct Opening {
    journal: u32,
    configuration: String,
}

const VERSION: u32 = 2;
/// How long to wait for a journal that another process still holds.
const LOCK_PATIENCE: Duration = Duration::from_secs(2);

/// A step. A step that was answered from memory holds no drive, because an earlier record holds it.
#[derive(Debug, Serialize, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
struct Record {
    learner: u32,
    step: u32,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    driven: Option<DrivenStep>,
}

#[derive(Debug, Serialize, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
struct DrivenStep {
    /// The law's parameters, in its order.
    parameters: Vec<f64>,
    drive: DriveRecord,
}

/// A journal, open for more.
#[derive(Debug)]
pub struct Journal {
    path: PathBuf,
    file: File,
    /// Number of the law's parameters.
    parameters: usize,
    unwritten: Vec<u8>,
    syncing: Option<JoinHandle<io::Result<()>>>,
}

impl Journal {
    /// Opens or starts the journal of a training, and replays what it holds into `training`; passes each step to
    /// `each`. `configuration` is a hash of everything that determines the training.
    ///
    /// # Errors
    /// If the file cannot be used, is damaged before its last line, or belongs to another configuration.
    pub fn open(
        path: &Path,
        configuration: &str,
        training: &mut Training,
        each: impl FnMut(&Taken),
    ) -> Result<Self, JournalError> {
        let io = |source| JournalError::Io { path: path.to_owned(), source };
        let mut file = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(path)
            .map_err(io)?;
        // A predecessor that was killed a moment ago may not be gone yet.
        let until = Instant::now() + LOCK_PATIENCE;
        while file.try_lock().is_err() {
            if Instant::now() > until {
                return Err(JournalError::InUse { path: path.to_owned() });
            }
            std::thread::sleep(Duration::from_millis(2));
        }
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes).map_err(io)?;
        let whole = replay(path, &bytes, configuration, training, each)?;
        if whole < bytes.len() {
            tracing::warn!(bytes = bytes.len() - whole, "cut a torn record off the journal");
            file.set_len(whole as u64).map_err(io)?;
        }
        file.seek(SeekFrom::Start(whole as u64)).map_err(io)?;
        let mut journal = Self {
            path: path.to_owned(),
            file,
            parameters: training.law().count(),
            unwritten: Vec::new(),
            syncing: None,
        };
        if whole == 0 {
            journal.add(&Opening { journal: VERSION, configuration: configuration.to_owned() });
        }
        Ok(journal)
    }

    /// Notes a step; [`Journal::write`] writes it to the file.
    pub fn note(&mut self, taken: &Taken) {
        let Taken { ask, drive, remembered, .. } = taken;
        let driven = (!remembered).then(|| DrivenStep {
            parameters: ask.parameters.0[..self.parameters].to_vec(),
            drive: *drive,
        });
        self.add(&Record { learner: ask.learner, step: ask.step, driven });
    }

    fn add(&mut self, record: &impl Serialize) {
        let json = serde_json::to_vec(record).expect("records are plain, and their numbers finite");
        let line = format!("{:08x} ", crc32fast::hash(&json));
        self.unwritten.extend_from_slice(line.as_bytes());
        self.unwritten.extend_from_slice(&json);
        self.unwritten.push(b'\n');
    }

    /// Writes what was noted: after this, a crash of the process loses none of it.
    ///
    /// # Errors
    /// If it cannot be written to the disk.
    pub fn write(&mut self) -> Result<(), JournalError> {
        let result = self.file.write_all(&self.unwritten);
        self.unwritten.clear();
        result.map_err(|source| JournalError::Io { path: self.path.clone(), source })
    }

    /// Syncs what was written to the disk, in a separate thread, because a disk may be slow: after that, a power cut
    /// loses none of it. There is one sync at a time; the next call reports a failure of the last one.
    ///
    /// # Errors
    /// If it could not be written to the disk.
    pub fn sync(&mut self) -> Result<(), JournalError> {
        if self.syncing.as_ref().is_some_and(|thread| !thread.is_finished()) {
            return Ok(());
        }
        let io = |source| JournalError::Io { path: self.path.clone(), source };
        if let Some(Ok(Err(source))) = self.syncing.take().map(JoinHandle::join) {
            return Err(io(source));
        }
        let file = self.file.try_clone().map_err(io)?;
        self.syncing = Some(std::thread::spawn(move || file.sync_data()));
        Ok(())
    }

    /// The journal's file, for a caller that can wait for a sync.
    ///
    /// # Errors
    /// If the system has no descriptor left.
    pub fn file(&self) -> io::Result<File> {
        self.file.try_clone()
    }
}

/// Replays the whole lines; returns where the last one ends.
fn replay(
    path: &Path,
    bytes: &[u8],
    configuration: &str,
    training: &mut Training,
    mut each: impl FnMut(&Taken),
) -> Result<usize, JournalError> {
    let mut offset = 0;
    while offset < bytes.len() {
        let damaged = |problem: &str| {
            let problem = problem.to_owned();
            JournalError::Damaged { path: path.to_owned(), offset, problem }
        };
        let rest = &bytes[offset..];
        // Lines are written whole, so only the last one can be torn: it lacks its end.
        let Some(length) = rest.iter().position(|byte| *byte == b'\n') else { return Ok(offset) };
        let line = &rest[..length];
        let json = checked(line).ok_or_else(|| damaged("its checksum does not match"))?;
        if offset == 0 {
            let opening: Opening = serde_json::from_slice(json)
                .map_err(|_| damaged("it does not begin like a journal"))?;
            if opening.journal < VERSION {
                return Err(JournalError::Earlier { path: path.to_owned() });
            }
            if opening != (Opening { journal: VERSION, configuration: configuration.to_owned() }) {
                return Err(JournalError::Foreign { path: path.to_owned() });
            }
        } else {
            let record: Record = serde_json::from_slice(json)
                .map_err(|error| damaged(&format!("not a record: {error}")))?;
            let taken = take(training, &record).map_err(damaged)?;
            each(&taken);
        }
        offset += length + 1;
    }
    Ok(offset)
}

/// Replays a step.
fn take(training: &mut Training, record: &Record) -> Result<Taken, &'static str> {
    let Record { learner, step, driven } = record;
    let taken = match driven {
        None => training.take_remembered(*learner, *step),
        Some(DrivenStep { drive, .. }) if !drive.is_plausible() => {
            return Err("a drive with impossible numbers");
        }
        Some(DrivenStep { parameters, drive }) => training
            .take(*learner, *step, *drive)
            .filter(|taken| taken.ask.parameters.0[..training.law().count()] == parameters[..]),
    };
    taken.ok_or("a step that the training does not make")
}

fn checked(line: &[u8]) -> Option<&[u8]> {
    let (digits, rest) = line.split_at_checked(8)?;
    let json = rest.strip_prefix(b" ")?;
    let sum = u32::from_str_radix(std::str::from_utf8(digits).ok()?, 16).ok()?;
    (crc32fast::hash(json) == sum).then_some(json)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Ranking, digest};
    use config::{Layers, RunConfig};
    use proptest::prelude::*;
    use std::fs;
    use std::sync::LazyLock;

    fn config() -> RunConfig {
        let mut layers = Layers::maneuver("lane_change").unwrap();
        for set in ["learning.episodes=3", "learning.step_limit=8", "run.alphas=[0.1,0.5]"] {
            layers.set(set).unwrap();
        }
        layers.resolve().unwrap()
    }

    /// Continues the training from where the journal ends; returns the digest.
    fn train(path: &Path, config: &RunConfig, most_drives: usize) -> Result<String, JournalError> {
        // Driven once for all tests: then a training takes only microseconds.
        static RANKING: LazyLock<Ranking> = LazyLock::new(|| Ranking::by_rollout(&self::config()));
        let mut training = Training::new(config, *RANKING.objective());
        let mut journal = Journal::open(path, "c", &mut training, |_| {})?;
        for _ in 0..most_drives {
            training.remember(usize::MAX, |taken| journal.note(taken));
            let Some(ask) = training.wanted().first().copied() else { break };
            let drive = RANKING.drive(&ask.parameters);
            let taken = training.take(ask.learner, ask.step, drive).unwrap();
            journal.note(&taken);
            journal.write()?;
        }
        Ok(digest(&training))
    }

    #[test]
    fn every_cut_of_the_last_4_kib_goes_on_to_the_same_digest() {
        let folder = tempfile::tempdir().unwrap();
        let (whole, cut) = (folder.path().join("whole"), folder.path().join("cut"));
        let config = config();
        let wanted = train(&whole, &config, usize::MAX).unwrap();
        let bytes = fs::read(&whole).unwrap();
        assert!(bytes.len() > 4096);
        for length in bytes.len() - 4096..=bytes.len() {
            fs::write(&cut, &bytes[..length]).unwrap();
            assert_eq!(train(&cut, &config, usize::MAX).unwrap(), wanted, "cut at {length}");
        }
    }

    proptest! {
        #[test]
        fn no_bytes_make_the_journal_panic(
            bytes in prop::collection::vec(any::<u8>(), 0..300), at in 0usize..3000, keep in any::<bool>(),
        ) {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("journal");
            let mut text = Vec::new();
            if keep {
                train(&path, &config(), 9).unwrap();
                text = fs::read(&path).unwrap();
            }
            let at = at.min(text.len());
            text.splice(at..at, bytes);
            fs::write(&path, &text).unwrap();
            let _ = train(&path, &config(), 1);
        }
    }

    #[test]
    fn damage_in_the_middle_is_named_by_its_offset() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("journal");
        train(&path, &config(), 20).unwrap();
        let bytes = fs::read(&path).unwrap();
        for at in (0..bytes.len() - 200).step_by(11) {
            let mut damaged = bytes.clone();
            damaged[at] ^= 1;
            fs::write(&path, &damaged).unwrap();
            let error = train(&path, &config(), 0).unwrap_err().to_string();
            let names = ["byte", "another configuration", "an earlier version"];
            assert!(names.iter().any(|name| error.contains(name)), "{error}");
        }
    }

    #[test]
    fn a_journal_of_another_configuration_or_version_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("journal");
        train(&path, &config(), 3).unwrap();
        let open = |path: &Path| {
            let config = config();
            let mut training = Training::new(&config, crate::objective_of(&config));
            Journal::open(path, "d", &mut training, |_| {}).unwrap_err()
        };
        assert!(matches!(open(&path), JournalError::Foreign { .. }));
        // The first line of a journal as earlier versions wrote it.
        let earlier = r#"{"journal":1,"configuration":"d"}"#;
        fs::write(&path, format!("{:08x} {earlier}\n", crc32fast::hash(earlier.as_bytes())))
            .unwrap();
        assert!(matches!(open(&path), JournalError::Earlier { .. }));
    }
}
