//! What to replay: the batches of a recording that were driven to their end.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use config::NamedParameters;
use ipc_types::layout::Bytes;
use ipc_types::{BatchHeader, DriveRequest, GainSwitch, TickHeader};
use recorder::layout_digest;
use recorder::reading::Recording;
use serde::{Deserialize, Serialize};

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
    let mut parts = parts(file, |_| false)?.into_iter();
    let recording = parts.next().context("a first part")?;
    let beginning = |key: &str| recording.beginning.get(key).map(String::as_str);
    let why = |why: &str| format!("{} {why}", file.display());
    ensure!(
        beginning("from_first_tick") == Some("true"),
        why("does not begin with the first tick of its run; record it with --record")
    );
    let last = parts.next_back();
    let last = last.as_ref().unwrap_or(&recording);
    let end = last.end.as_ref().filter(|_| last.cut_off.is_none());
    let Some(end) = end else { bail!(why("was cut off: its end is missing")) };
    ensure!(
        end.get("gaps").is_some_and(|gaps| gaps == "0"),
        why("has gaps: missing messages cannot be compared")
    );
    let config = recording.attachments.get("config.toml");
    let Some(config) = config else { bail!(why("holds no configuration")) };
    Ok(String::from_utf8(config.clone())?)
}

/// Reads a recording with the messages of some channels, and the files that continue it.
fn parts(first: &Path, wanted: impl Fn(&str) -> bool) -> Result<Vec<Recording>> {
    let mut parts = vec![Recording::read_only(first, &wanted)?];
    let beginning = &parts[0].beginning;
    ensure!(!beginning.is_empty(), "{} is not a recording by pathtune", first.display());
    ensure!(
        beginning.get("layout") == Some(&layout_digest()),
        "{} was made by an earlier version of pathtune; its messages have another layout, so this one cannot replay it",
        first.display()
    );
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
        let part = Recording::read_only(&path, &wanted)
            .with_context(|| format!("{} is continued in {next}", first.display()))?;
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

/// A batch as it was recorded.
#[derive(Debug, Default)]
pub(crate) struct Batch {
    /// Its number in the recording.
    pub(crate) number: u64,
    pub(crate) requests: Vec<DriveRequest>,
    pub(crate) switches: Vec<GainSwitch>,
    /// Elements of the topics that are replayed or compared, tick by tick, as bytes.
    pub(crate) ticks: BTreeMap<&'static str, Vec<Vec<u8>>>,
}

/// Reads the batches of a recording that were driven to their end, each in its last attempt, with these topics.
pub(crate) fn batches(file: &Path, topics: &[&'static str]) -> Result<Vec<Batch>> {
    let others = ["drive_request", "drive_report", "gains"];
    let parts = parts(file, |channel| {
        let name = channel.strip_prefix("/pathtune/").unwrap_or_default();
        others.contains(&name) || topics.contains(&name)
    })?;
    let mut reported = BTreeMap::new();
    for message in parts.iter().flat_map(|part| part.of("drive_report")) {
        let header = BatchHeader::take(&mut &message.data[..]).context("a report")?;
        reported.insert(header.attempt.batch, header.attempt);
    }
    let mut all: BTreeMap<u64, Batch> = BTreeMap::new();
    for message in parts.iter().flat_map(|part| &part.messages) {
        let name = message.topic.strip_prefix("/pathtune/").unwrap_or_default();
        let mut bytes = &message.data[..];
        let per_tick = topics.iter().find(|topic| **topic == name);
        let attempt = match per_tick {
            Some(_) => TickHeader::take(&mut bytes).map(|it| it.attempt),
            None => BatchHeader::take(&mut bytes).map(|it| it.attempt),
        }
        .context("a header")?;
        if reported.get(&attempt.batch) != Some(&attempt) {
            continue;
        }
        let of = all.entry(attempt.batch).or_default();
        of.number = attempt.batch;
        match (per_tick, name) {
            (Some(topic), _) => of.ticks.entry(topic).or_default().push(bytes.to_vec()),
            (None, "drive_request") => of.requests = parse::<DriveRequest>(bytes),
            (None, "gains") => of.switches.extend(parse::<GainSwitch>(bytes)),
            _ => {}
        }
    }
    Ok(all.into_values().filter(|batch| !batch.requests.is_empty()).collect())
}

pub(crate) fn parse<M: Bytes>(mut bytes: &[u8]) -> Vec<M> {
    std::iter::from_fn(|| M::take(&mut bytes)).collect()
}
