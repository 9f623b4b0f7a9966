//! The recorder's process: it records the run from its first tick on, and loses nothing.
//!
//! A vehicle in lockstep waits for its credit. The first credit of a batch is granted only when everything before the
//! batch has been received, so that what is under way always fits into an observer's buffer. A recorder that was
//! restarted goes on in another file, whose metadata says so.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use anyhow::{Context, Result};
use config::RunConfig;
use config::launch::{Launch, Role};
use ipc_types::{Attempt, BatchHeader, Credit, DriveRequest, WakeRole};
use outcome::RecordingFacts;
use runtime::clock::now_ns;
use runtime::{Attachment, Counters, Outlet, Service, join, serve};
use serde_json::Value;

use crate::layout_digest;
use crate::listener::{Listener, Look};
use crate::tape::{Files, Settings, Tape, name_of};
use crate::timeline::WallClock;

/// Ticks between two credits: a quarter of what the vehicle may run ahead.
const CREDIT_EVERY: u64 = Credit::AHEAD / 4;
/// Name of a run's recording, without number and extension.
pub(crate) const STEM: &str = "recording";
/// Files of a run's folder that are attached to its recording.
const ATTACHED: [&str; 3] = ["config.toml", "launch.toml", "sweep.toml"];

/// Runs the process until it is asked to stop.
///
/// # Errors
/// If it cannot join the run, the file cannot be written, or the transport fails.
pub fn run() -> Result<()> {
    let (attachment, bus, config) = join()?;
    let files = Files::first_free(attachment.folder.join(STEM), split_bytes(&attachment.folder)?);
    let before = files.before().map(|path| name_of(&path));
    if let Some(before) = &before {
        tracing::warn!(
            before,
            "continues in another file; unclosed chunks of the previous file are lost"
        );
    }
    let tape = Tape::start(settings(
        files,
        &attachment.folder,
        &config,
        attachment.names.run,
        before.is_none(),
    ))?;
    let mut recorder = Recorder {
        listener: Listener::new(&bus, tape)?,
        credits: bus.outlet()?,
        attempt: Attempt::between_batches(attachment.names.run),
        granted: None,
    };
    serve(&attachment, &bus, WakeRole::Recorder, &mut recorder)?;
    let summary = recorder.listener.finish(digest(&attachment))?;
    let facts = summary.facts(before.is_none());
    for line in facts.told() {
        tracing::warn!("{line}");
    }
    if !summary.behind.is_zero() {
        tracing::warn!(behind = ?summary.behind, "could not keep up; a vehicle in lockstep waited for this long");
    }
    tracing::info!(file = %summary.file.display(), messages = facts.messages, "recorded");
    // For the orchestrator, which joins it with the result.
    let path = attachment.names.root.join(RecordingFacts::FILE);
    fs::write(&path, serde_json::to_vec(&facts)?)
        .with_context(|| format!("failed to write {path:?}"))
}

/// What the files of a recording have in common.
pub(crate) fn settings(
    files: Files,
    folder: &Path,
    config: &RunConfig,
    run: u64,
    from_first_tick: bool,
) -> Settings {
    let wall = WallClock::now();
    let beginning = BTreeMap::from(
        [
            ("version", env!("CARGO_PKG_VERSION").to_owned()),
            ("layout", layout_digest()),
            ("run", format!("{run:016x}")),
            ("maneuver", config.maneuver.clone()),
            ("seed", config.run.seed.to_string()),
            ("tick_s", config.drive.tick_s.to_string()),
            ("wall_clock_origin_ns", wall.origin_ns.to_string()),
            ("from_first_tick", from_first_tick.to_string()),
        ]
        .map(|(key, value)| (key.to_owned(), value)),
    );
    let attachments = ATTACHED
        .iter()
        .filter_map(|name| Some(((*name).to_owned(), fs::read(folder.join(name)).ok()?)))
        .collect();
    Settings {
        files,
        tick_s: config.drive.tick_s,
        path: config.law.follows_path.then(|| tracking::Path::new(&config.path)),
        wall,
        by_the_clock: config.run.realtime,
        beginning,
        attachments,
    }
}

/// The size of files according to the launch file.
fn split_bytes(folder: &Path) -> Result<Option<u64>> {
    let path = folder.join("launch.toml");
    let text = fs::read_to_string(&path).with_context(|| format!("failed to read {path:?}"))?;
    let launch = Launch::parse("launch.toml", &text)?;
    Ok(launch.process.iter().find(|it| it.role == Role::Recorder).and_then(|it| it.split_bytes))
}

/// The digest of a run that has ended: the recorder stops last, when the outcome is written.
fn digest(attachment: &Attachment) -> Option<String> {
    let bytes = fs::read(attachment.folder.join("outcome.json")).ok()?;
    let outcome: Value = serde_json::from_slice(&bytes).ok()?;
    Some(outcome["digest"].as_str()?.to_owned())
}

struct Recorder {
    listener: Listener,
    credits: Outlet<Credit>,
    /// The attempt that was requested last.
    attempt: Attempt,
    /// How many ticks were granted for it; `None` before the first grant.
    granted: Option<u64>,
}

impl Recorder {
    fn grant(&mut self, look: Look) -> Result<()> {
        let Some(requested) = self.listener.requested else { return Ok(()) };
        if requested.attempt != self.attempt {
            (self.attempt, self.granted) = (requested.attempt, None);
        }
        let ticks = self.listener.ticks_of(self.attempt);
        let is_due = match self.granted {
            None => matches!(look, Look::All | Look::Nothing),
            Some(granted) => ticks >= granted + CREDIT_EVERY,
        };
        if is_due {
            self.granted = Some(ticks);
            let (attempt, sent_ns) = (self.attempt, now_ns());
            let header = BatchHeader { attempt, sent_ns, ..BatchHeader::default() };
            let credit = Credit { ticks, source: DriveRequest::LOGGED, reserved: 0 };
            self.credits.send(header, 1, |_| credit)?;
        }
        Ok(())
    }
}

impl Service for Recorder {
    fn poll(&mut self) -> Result<bool> {
        let look = self.listener.listen()?;
        self.grant(look)?;
        Ok(look != Look::Nothing)
    }

    fn status(&self) -> Counters {
        let tick = self.listener.ticks_of(self.attempt);
        Counters { batch: self.attempt.batch, tick, ..Counters::default() }
    }
}
