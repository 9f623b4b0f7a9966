//! The journal: what a training cannot compute again, written before the next drive is proposed.
//!
//! It is a sequence of records. The first one names the configuration. Each of the others holds the drives that came
//! back together, or the number of steps that memory answered one after another: which steps these were, and by which
//! drives they were answered, follows from the records before. A record is packed, with a checksum. It holds no line
//! feed (COBS sees to that), and ends with one. A last record that was torn by a crash is cut off; a damaged record
//! before it is an error.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Read, Seek, SeekFrom, Write};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use rustix::io::Errno;
use serde::{Deserialize, Serialize};
use tracking::DriveRecord;

use crate::own_file;
use crate::packing::{pack, unpack};
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
    Damaged { path: PathBuf, offset: u64, problem: String },
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

impl JournalError {
    /// Whether it is the same however often one tries.
    pub fn is_final(&self) -> bool {
        match self {
            Self::Damaged { .. } | Self::Foreign { .. } | Self::Earlier { .. } => true,
            // Another kind of file, or a link; not a disk that is full or fails.
            Self::Io { source, .. } => {
                source.kind() == io::ErrorKind::InvalidInput
                    || [Errno::LOOP, Errno::ISDIR, Errno::NXIO]
                        .iter()
                        .any(|kind| source.raw_os_error() == Some(kind.raw_os_error()))
            }
            Self::InUse { .. } => false,
        }
    }
}

const VERSION: u32 = 3;
/// How long to wait for a journal that another process still holds.
const LOCK_PATIENCE: Duration = Duration::from_secs(2);
/// What ends a record.
const END: u8 = b'\n';
/// The longest record that is read. The drives of the largest fleet take a tenth of it; whatever is longer is no
/// journal, and is not read into memory.
const LONGEST_RECORD: u64 = 1 << 20;
/// The most steps that one record may say were remembered: a replayed record takes no longer than it took to write.
pub const REMEMBERED_AT_ONCE: usize = 1000;
/// Number of bytes before a [`Mark`] that are compared.
const MARKED_BYTES: u64 = 4096;

#[derive(Debug, Clone, Serialize, Deserialize, PartialEq)]
enum Record {
    Opening {
        version: u32,
        /// Changes with the fields of a drive: packed data does not name them.
        layout: u32,
        configuration: String,
    },
    /// Drives that came back together.
    Driven(Vec<DrivenStep>),
    /// So many steps were answered from memory.
    Remembered(u32),
}

#[derive(Debug, Clone, Serialize, Deserialize, PartialEq)]
struct DrivenStep {
    learner: u32,
    step: u32,
    /// The law's parameters, in its order.
    parameters: Vec<f64>,
    drive: DriveRecord,
}

/// A place in a journal, and a checksum of the bytes before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Mark {
    position: u64,
    sum: u32,
}

/// A journal. It is replayed first, then written.
#[derive(Debug)]
pub struct Journal {
    path: PathBuf,
    file: File,
    /// What is still to be replayed; `None` once everything is.
    unread: Option<BufReader<File>>,
    /// Where the records end that were replayed or written.
    position: u64,
    unwritten: Vec<u8>,
    /// The first record of a journal that this training begins.
    opening: Vec<u8>,
}

impl Journal {
    /// Opens or starts the journal of a training. `configuration` is a hash of everything that determines the training.
    /// [`Journal::replay`] comes next.
    ///
    /// # Errors
    /// If the file cannot be used, is no journal, or belongs to another configuration.
    pub fn open(path: &Path, configuration: &str) -> Result<Self, JournalError> {
        let io = |source| JournalError::Io { path: path.to_owned(), source };
        let file = own_file::open(path).map_err(io)?;
        // A predecessor that was killed a moment ago may not be gone yet.
        let until = Instant::now() + LOCK_PATIENCE;
        while file.try_lock().is_err() {
            if Instant::now() > until {
                return Err(JournalError::InUse { path: path.to_owned() });
            }
            std::thread::sleep(Duration::from_millis(2));
        }
        let unread = Some(BufReader::new(file.try_clone().map_err(io)?));
        let opening = Record::Opening {
            version: VERSION,
            layout: layout(),
            configuration: configuration.to_owned(),
        };
        let (path, none) = (path.to_owned(), Vec::new());
        let mut journal =
            Self { path, file, unread, position: 0, unwritten: none.clone(), opening: none };
        journal.add(&opening);
        journal.opening = std::mem::take(&mut journal.unwritten);
        let mut line = journal.next_line()?;
        if line.is_empty() {
            journal.unwritten = std::mem::take(&mut journal.opening);
            return Ok(journal);
        }
        let path = &journal.path;
        if line.get(8..).is_some_and(|rest| rest.starts_with(b" {\"journal\":")) {
            return Err(JournalError::Earlier { path: path.to_owned() });
        }
        match decode(&mut line) {
            Some(found) if found == opening => Ok(journal),
            Some(Record::Opening { version, layout: fields, .. })
                if version < VERSION || fields != layout() =>
            {
                Err(JournalError::Earlier { path: path.to_owned() })
            }
            Some(Record::Opening { .. }) => Err(JournalError::Foreign { path: path.to_owned() }),
            _ => Err(journal.damaged(0, "it does not begin like a journal")),
        }
    }

    /// Replays records into `training` until some thousand steps are taken or none is left, and passes each step to
    /// `each`. Returns whether everything is replayed; then the journal can be written.
    ///
    /// # Errors
    /// If the file cannot be read or is damaged before its last record.
    pub fn replay(
        &mut self,
        training: &mut Training,
        mut each: impl FnMut(&Taken),
    ) -> Result<bool, JournalError> {
        let mut steps = 0;
        while steps < REMEMBERED_AT_ONCE {
            let offset = self.position;
            let mut line = self.next_line()?;
            if line.is_empty() {
                return Ok(true);
            }
            let record = decode(&mut line)
                .ok_or_else(|| self.damaged(offset, "its checksum does not match"))?;
            steps += take(training, record, &mut each)
                .map_err(|problem| self.damaged(offset, problem))?;
        }
        Ok(false)
    }

    /// The next record, without its end; empty if there is none. Then a torn one has been cut off.
    fn next_line(&mut self) -> Result<Vec<u8>, JournalError> {
        let io = |source| JournalError::Io { path: self.path.clone(), source };
        let mut line = Vec::new();
        let Some(unread) = &mut self.unread else { return Ok(line) };
        unread.take(LONGEST_RECORD).read_until(END, &mut line).map_err(io)?;
        if line.pop_if(|last| *last == END).is_some() {
            self.position += line.len() as u64 + 1;
            if line.is_empty() {
                return Err(self.damaged(self.position - 1, "an empty record"));
            }
            return Ok(line);
        }
        if line.len() as u64 == LONGEST_RECORD {
            return Err(self.damaged(self.position, "a record without an end"));
        }
        if self.position == 0 && !self.opening.starts_with(&line) {
            return Err(self.damaged(0, "it does not begin like a journal"));
        }
        // Records are written whole, so only the last one can be torn: it lacks its end.
        if !line.is_empty() {
            tracing::warn!(bytes = line.len(), "cut a torn record off the journal");
            self.file.set_len(self.position).map_err(io)?;
        }
        self.file.seek(SeekFrom::Start(self.position)).map_err(io)?;
        self.unread = None;
        Ok(Vec::new())
    }

    fn damaged(&self, offset: u64, problem: &str) -> JournalError {
        JournalError::Damaged { path: self.path.clone(), offset, problem: problem.to_owned() }
    }

    /// Notes drives that came back together; [`Journal::write`] writes them to the file. `count` is the number of the
    /// law's parameters.
    pub fn note_driven(&mut self, taken: &[Taken], count: usize) {
        let step = |Taken { ask, drive, .. }: &Taken| DrivenStep {
            learner: ask.learner,
            step: ask.step,
            parameters: ask.parameters.0[..count].to_vec(),
            drive: *drive,
        };
        if !taken.is_empty() {
            self.add(&Record::Driven(taken.iter().map(step).collect()));
        }
    }

    /// Notes that one call of [`Training::remember`] answered so many steps, at most [`REMEMBERED_AT_ONCE`].
    pub fn note_remembered(&mut self, steps: usize) {
        if steps > 0 {
            self.add(&Record::Remembered(steps as u32));
        }
    }

    fn add(&mut self, record: &Record) {
        let packed = pack(record);
        let from = self.unwritten.len();
        self.unwritten.resize(from + cobs::max_encoding_length(packed.len()), 0);
        let length = cobs::encode_with_sentinel(&packed, &mut self.unwritten[from..], END);
        self.unwritten.truncate(from + length);
        self.unwritten.push(END);
    }

    /// Writes what was noted: after this, a crash of the process loses none of it.
    ///
    /// # Errors
    /// If it cannot be written to the disk.
    pub fn write(&mut self) -> Result<(), JournalError> {
        let result = self.file.write_all(&self.unwritten);
        self.position += self.unwritten.len() as u64;
        self.unwritten.clear();
        result.map_err(|source| JournalError::Io { path: self.path.clone(), source })
    }

    /// The journal's file, for whoever can wait for a sync.
    ///
    /// # Errors
    /// If the system has no descriptor left.
    pub fn file(&self) -> io::Result<File> {
        self.file.try_clone()
    }

    /// The place where the written records end.
    ///
    /// # Errors
    /// If the file cannot be read.
    pub(crate) fn mark(&self) -> io::Result<Mark> {
        Ok(Mark { position: self.position, sum: self.sum_before(self.position)? })
    }

    /// Passes over the records before a mark, if this is the journal in which it was made and holds them.
    ///
    /// # Errors
    /// If the file cannot be read.
    pub(crate) fn go_to(&mut self, mark: &Mark) -> io::Result<bool> {
        let is_there = mark.position >= self.position
            && mark.position <= self.file.metadata()?.len()
            && self.sum_before(mark.position)? == mark.sum;
        let Some(unread) = self.unread.as_mut().filter(|_| is_there) else { return Ok(false) };
        unread.seek(SeekFrom::Start(mark.position))?;
        self.position = mark.position;
        Ok(true)
    }

    /// Checksum of the last bytes before a place.
    fn sum_before(&self, position: u64) -> io::Result<u32> {
        let count = position.min(MARKED_BYTES);
        let mut bytes = vec![0; count as usize];
        self.file.read_exact_at(&mut bytes, position - count)?;
        Ok(crc32fast::hash(&bytes))
    }
}

/// Replays a record; returns how many steps it held.
fn take(
    training: &mut Training,
    record: Record,
    each: &mut impl FnMut(&Taken),
) -> Result<usize, &'static str> {
    const UNKNOWN: &str = "a step that the training does not make";
    match record {
        Record::Opening { .. } => Err("a second opening"),
        Record::Remembered(steps) => {
            let wanted = steps as usize;
            if wanted > REMEMBERED_AT_ONCE {
                return Err(UNKNOWN);
            }
            let mut steps = 0;
            training.remember(wanted, |taken| {
                steps += 1;
                each(taken);
            });
            if steps == wanted { Ok(steps) } else { Err(UNKNOWN) }
        }
        Record::Driven(drives) => {
            let count = training.law().count();
            for DrivenStep { learner, step, parameters, drive } in &drives {
                if !drive.is_plausible() {
                    return Err("a drive with impossible numbers");
                }
                let taken = training
                    .take(*learner, *step, *drive)
                    .filter(|taken| taken.ask.parameters.0[..count] == parameters[..])
                    .ok_or(UNKNOWN)?;
                each(&taken);
            }
            Ok(drives.len())
        }
    }
}

fn decode(line: &mut [u8]) -> Option<Record> {
    let length = cobs::decode_in_place_with_sentinel(line, END).ok()?;
    unpack(&line[..length])
}

/// A checksum over the names of a drive's fields.
fn layout() -> u32 {
    let json = serde_json::to_vec(&DriveRecord::default()).expect("a drive is plain data");
    crc32fast::hash(&json)
}

#[cfg(test)]
#[path = "journal_tests.rs"]
mod tests;
