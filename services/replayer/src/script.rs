//! What to replay: the batches of a recording that were driven to their end.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use config::NamedParameters;
use ipc_types::layout::Bytes;
use ipc_types::{
    Attempt, BatchHeader, Command, DriveReport, DriveRequest, GainSwitch, Message, Odometry,
    RawCommand, TickHeader,
};
use recorder::reading::{Kept, Recording};
use serde::{Deserialize, Serialize};

/// The topics that are compared.
pub(crate) const COMPARED: [&str; 2] = [RawCommand::TOPIC.name, Command::TOPIC.name];
/// The topics between ticks that say what was driven.
const BETWEEN: [&str; 3] =
    [DriveRequest::TOPIC.name, DriveReport::TOPIC.name, GainSwitch::TOPIC.name];

/// The order for the processes of a replay: a file in the run's folder.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Order {
    /// The recording.
    pub file: PathBuf,
    /// The first tick of each drive that is compared.
    pub from_tick: u64,
    /// The tick before which the comparison ends.
    pub to_tick: u64,
    /// How many times as fast as real time; `None` for as fast as possible.
    pub speed: Option<f64>,
    /// The law's parameters by zone that replace the recorded ones; empty to keep the recorded ones.
    pub by_zone: Vec<NamedParameters>,
}

impl Order {
    /// Name of the file in the run's folder.
    pub const FILE: &'static str = "replay.toml";

    /// Reads the order of a run.
    ///
    /// # Errors
    /// If there is none, or it cannot be parsed.
    pub fn read(folder: &Path) -> Result<Self> {
        let path = folder.join(Self::FILE);
        let text =
            std::fs::read_to_string(&path).with_context(|| format!("failed to read {path:?}"))?;
        Ok(toml::from_str(&text)?)
    }
}

/// Checks that a recording can be replayed; returns its configuration.
///
/// # Errors
/// If it cannot; the error says why in one line.
pub fn check(file: &Path) -> Result<String> {
    let mut kept = Kept::default();
    let mut parts = read_parts(file, |name, bytes| {
        let is_kept = COMPARED.contains(&name) || name == Odometry::TOPIC.name;
        if is_kept { kept.note(bytes.len()) } else { Ok(()) }
    })?
    .into_iter();
    let recording = parts.next().context("a first part")?;
    let why = |why: &str| format!("{} {why}", file.display());
    ensure!(
        recording.beginning.get("from_first_tick").is_some_and(|it| it == "true"),
        why("does not begin with the first tick of its run; record it with --record")
    );
    let last = parts.next_back();
    let last = last.as_ref().unwrap_or(&recording);
    let Some(end) = &last.end else { bail!(why("was cut off: its end is missing")) };
    let none = |what: &str| {
        let mut topics = COMPARED.iter().chain(&BETWEEN).chain([&Odometry::TOPIC.name]);
        topics.all(|topic| end.get(&format!("{what}.{topic}")).is_some_and(|count| count == "0"))
    };
    ensure!(none("missed"), why("has gaps: missing messages cannot be compared"));
    ensure!(
        none("unsent"),
        why(
            "was driven by the clock, and some ticks had no messages: it cannot be compared tick by tick"
        )
    );
    let config = recording.attachments.get("config.toml");
    let Some(config) = config else { bail!(why("holds no configuration")) };
    String::from_utf8(config.clone()).with_context(|| why("holds a configuration that is no text"))
}

/// Reads a recording and the files that continue it, and gives the messages of our own topics to `take`: the topic's
/// name, and the message's bytes.
fn read_parts(
    first: &Path,
    mut take: impl FnMut(&str, &[u8]) -> Result<()>,
) -> Result<Vec<Recording>> {
    let mut read = |path: &Path| {
        let recording = Recording::read_with(path, |channel, _, data| {
            channel.strip_prefix("/pathtune/").map_or(Ok(()), |name| take(name, data))
        })?;
        match &recording.cut_off {
            Some(why) => bail!("{} {why}", path.display()),
            None => Ok(recording),
        }
    };
    let mut parts = vec![read(first)?];
    let beginning = &parts[0].beginning;
    if let (Some(number), Some(before)) = (beginning.get("file"), beginning.get("continues")) {
        let file = first.display();
        bail!("{file} is part {number} of a recording, after {before}; name the first one");
    }
    while let Some(next) =
        parts.last().and_then(|it| it.end.as_ref()).and_then(|end| end.get("continued_in"))
    {
        // A name without a folder: the parts are in the same folder.
        let name = Path::new(next)
            .file_name()
            .context("a recording does not name the file that continues it")?;
        let path = first.with_file_name(name);
        let part =
            read(&path).with_context(|| format!("{} is continued in {next}", first.display()))?;
        let number = (parts.len() + 1).to_string();
        ensure!(
            part.beginning.get("run") == parts[0].beginning.get("run")
                && part.beginning.get("file") == Some(&number),
            "{} is not part {number} of {}",
            path.display(),
            first.display()
        );
        parts.push(part);
    }
    Ok(parts)
}

/// A batch as it was recorded, in its last attempt.
#[derive(Debug, Default)]
pub(crate) struct Batch {
    attempt: Attempt,
    is_reported: bool,
    pub(crate) requests: Vec<DriveRequest>,
    pub(crate) switches: Vec<GainSwitch>,
    /// Elements of the topics that are replayed or compared, tick by tick, as bytes.
    pub(crate) ticks: BTreeMap<&'static str, Vec<Vec<u8>>>,
}

impl Batch {
    /// Its number in the recording.
    pub(crate) fn number(&self) -> u64 {
        self.attempt.batch
    }
}

/// Reads the batches of a recording that were driven to their end, each in its last attempt, with these topics, which
/// are sent once a tick. `max_len` is the largest number of elements that a message may have.
pub(crate) fn batches(file: &Path, topics: &[&'static str], max_len: usize) -> Result<Vec<Batch>> {
    let mut all: BTreeMap<u64, Batch> = BTreeMap::new();
    let mut kept = Kept::default();
    read_parts(file, |name, mut bytes| {
        let per_tick = topics.iter().find(|topic| **topic == name);
        let (attempt, tick) = match (per_tick, name) {
            (Some(_), _) => TickHeader::take(&mut bytes).map(|it| (it.attempt, it.tick)),
            (None, name) if BETWEEN.contains(&name) => {
                BatchHeader::take(&mut bytes).map(|it| (it.attempt, 0))
            }
            _ => return Ok(()),
        }
        .context("is damaged: a message has no header")?;
        let of = all.entry(attempt.batch).or_default();
        if of.attempt > attempt {
            return Ok(());
        }
        if of.attempt < attempt {
            *of = Batch { attempt, ..Batch::default() };
        }
        kept.note(size_of::<Vec<u8>>() + bytes.len())?;
        match (per_tick, name) {
            (Some(topic), _) => {
                let ticks = of.ticks.entry(topic).or_default();
                ensure!(
                    tick == ticks.len() as u64,
                    "is damaged: tick {} of batch {} is missing on {topic}",
                    ticks.len(),
                    attempt.batch
                );
                ticks.push(bytes.to_vec());
            }
            (None, "drive_request") => of.requests = parse::<DriveRequest>(bytes),
            (None, "gains") => of.switches.extend(parse::<GainSwitch>(bytes)),
            _ => of.is_reported = true,
        }
        Ok(())
    })?;
    let whole: Vec<Batch> =
        all.into_values().filter(|it| it.is_reported && !it.requests.is_empty()).collect();
    let kinds = recorder::topics();
    for batch in &whole {
        let len = batch.requests.len();
        let is_whole = |topic: &&'static str| {
            let kind = kinds.iter().find(|it| it.name == *topic);
            let bytes = kind.map_or(0, |it| it.element_bytes) * len;
            batch.ticks.get(*topic).is_some_and(|ticks| ticks.iter().all(|it| it.len() == bytes))
        };
        ensure!(
            len <= max_len && topics.iter().all(is_whole),
            "{} is damaged: the messages of batch {} do not fit together",
            file.display(),
            batch.number()
        );
    }
    Ok(whole)
}

pub(crate) fn parse<M: Bytes>(mut bytes: &[u8]) -> Vec<M> {
    std::iter::from_fn(|| M::take(&mut bytes)).collect()
}
