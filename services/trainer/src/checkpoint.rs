//! Checkpoints: what a training has become, written once a second, so that a restarted trainer replays no more of the
//! journal than what came after.
//!
//! A checkpoint belongs to a place in the journal, and to the lengths that `episodes.csv` and `drives.csv` had there.
//! The last two are kept. One that is damaged, torn, of another version, or does not fit to these files is passed over:
//! then the one before it counts, and without any the journal is replayed from its start. So no checkpoint is needed,
//! and none can do harm.

use std::fs::{self, File};
use std::io::{ErrorKind, Read, Write};
use std::path::{Path, PathBuf};
use std::thread::JoinHandle;

use anyhow::{Context, Result, anyhow};
use config::RunConfig;
use runtime::clock::now_ns;
use serde::{Deserialize, Serialize};

use crate::journal::{Journal, Mark};
use crate::own_file;
use crate::packing::{pack, unpack};
use crate::story::Lengths;
use crate::training::{SavedTraining, Training};

/// The newest checkpoint, the one before it, and one that is being written.
const FILES: [&str; 2] = ["checkpoint", "checkpoint.previous"];
const PART: &str = "checkpoint.part";
/// The largest file that is taken for a checkpoint.
const MOST_BYTES: u64 = 128 << 20;
/// Raised whenever a tuner saves something else than before.
const VERSION: u32 = 3;
/// Time between two checkpoints, and so between two syncs of the journal: what a power cut may cost.
const INTERVAL_NS: u64 = 1_000_000_000;
/// Making a checkpoint holds up the training: one that takes long is made less often, after this many times as long.
const PAUSE: u64 = 5;

#[derive(Debug, Serialize, Deserialize)]
struct Checkpoint {
    version: u32,
    /// Release of pathtune: packed data does not name its fields.
    release: String,
    /// As in the journal.
    configuration: String,
    journal: Mark,
    story: Lengths,
    training: SavedTraining,
}

/// A training as a restarted trainer finds it: at its newest usable checkpoint, or at its first step. The journal is to
/// be replayed from there, and the story begins at these lengths.
pub(crate) fn take_up(
    folder: &Path,
    configuration: &str,
    config: &RunConfig,
    journal: &mut Journal,
    new: Training,
) -> Result<(Training, Option<Lengths>)> {
    for name in FILES {
        let Some(checkpoint) = read(&folder.join(name), configuration) else { continue };
        let Checkpoint { journal: mark, story, training, .. } = checkpoint;
        if !story.are_within(folder) {
            continue;
        }
        let Some(training) = Training::restored(config, *new.objective(), training) else {
            continue;
        };
        if journal.go_to(&mark).context("failed to read the journal")? {
            tracing::info!(file = name, "goes on from a checkpoint");
            return Ok((training, Some(story)));
        }
    }
    Ok((new, None))
}

/// A checkpoint of this version, release and configuration, if the file holds one that is whole.
fn read(path: &Path, configuration: &str) -> Option<Checkpoint> {
    if !fs::symlink_metadata(path).ok()?.is_file() {
        return None;
    }
    let mut bytes = Vec::new();
    own_file::open(path).and_then(|file| file.take(MOST_BYTES + 1).read_to_end(&mut bytes)).ok()?;
    let checkpoint: Option<Checkpoint> =
        if bytes.len() as u64 > MOST_BYTES { None } else { unpack(&bytes) };
    let usable = checkpoint.filter(|it| {
        it.version == VERSION
            && it.release == env!("CARGO_PKG_VERSION")
            && it.configuration == configuration
    });
    if usable.is_none() {
        tracing::warn!(?path, "passed over a checkpoint that is damaged or of another version");
    }
    usable
}

/// Makes the checkpoints of a training.
#[derive(Debug)]
pub(crate) struct Keeper {
    folder: PathBuf,
    configuration: String,
    due_ns: u64,
    /// Writes a checkpoint, because a disk may be slow.
    writing: Option<JoinHandle<Result<()>>>,
}

impl Keeper {
    pub(crate) fn new(folder: &Path, configuration: String) -> Self {
        Self { folder: folder.to_owned(), configuration, due_ns: 0, writing: None }
    }

    /// Whether it is time for a checkpoint, and the last one has been written.
    pub(crate) fn is_due(&self, now_ns: u64) -> bool {
        now_ns >= self.due_ns && self.writing.as_ref().is_none_or(JoinHandle::is_finished)
    }

    /// Makes a checkpoint of a training whose steps are all in the journal and in the story's files, which are that
    /// long. A separate thread syncs the journal and writes it; the next call reports a failure of the last one.
    ///
    /// The story's files are not synced: they may grow by tens of megabytes a second. If a power cut takes their end,
    /// the checkpoint does not fit them.
    pub(crate) fn keep(
        &mut self,
        journal: &Journal,
        story: Lengths,
        training: &Training,
    ) -> Result<()> {
        self.finish()?;
        let begun_ns = now_ns();
        let checkpoint = Checkpoint {
            version: VERSION,
            release: env!("CARGO_PKG_VERSION").to_owned(),
            configuration: self.configuration.clone(),
            journal: journal.mark().context("failed to read the journal")?,
            story,
            training: training.save(),
        };
        let bytes = pack(&checkpoint);
        let now_ns = now_ns();
        self.due_ns = now_ns + INTERVAL_NS.max(PAUSE * (now_ns - begun_ns));
        let journal = journal.file().context("failed to sync the journal")?;
        let folder = self.folder.clone();
        self.writing = Some(std::thread::spawn(move || {
            // Before the checkpoint, which is of no use without it.
            journal.sync_data().context("failed to sync the journal")?;
            write(&folder, &bytes).with_context(|| format!("failed to write {folder:?}/{PART}"))
        }));
        Ok(())
    }

    /// Waits until the last checkpoint has been written.
    pub(crate) fn finish(&mut self) -> Result<()> {
        let Some(writing) = self.writing.take() else { return Ok(()) };
        writing.join().map_err(|_| anyhow!("the thread that writes checkpoints panicked"))?
    }
}

/// Writes a checkpoint beside the others and renames it. Whenever this is cut short, one of the last two is there.
fn write(folder: &Path, bytes: &[u8]) -> std::io::Result<()> {
    let [newest, previous] = FILES.map(|name| folder.join(name));
    let part = folder.join(PART);
    remove_if_there(&part)?;
    let mut file = File::create_new(&part)?;
    file.write_all(bytes)?;
    file.sync_data()?;
    match fs::rename(&newest, previous) {
        Err(error) if error.kind() != ErrorKind::NotFound => return Err(error),
        _ => {}
    }
    fs::rename(part, newest)
}

fn remove_if_there(path: &Path) -> std::io::Result<()> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}

#[cfg(test)]
#[path = "checkpoint_tests.rs"]
mod tests;
