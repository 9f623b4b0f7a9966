//! Reads back our part of a recording.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result, bail, ensure};

use crate::container::{End, Record, scan};
pub use crate::tape::{BEGINNING, END};
use crate::{layout_digest, raw};

/// The most that is kept of a recording in memory.
pub const KEPT_LIMIT: usize = 1 << 30;

/// Our part of a recording.
#[derive(Debug, Default)]
pub struct Recording {
    /// The metadata at its beginning.
    pub beginning: BTreeMap<String, String>,
    /// The metadata at its end; `None` if the file was cut off.
    pub end: Option<BTreeMap<String, String>>,
    /// The attached files, by name.
    pub attachments: BTreeMap<String, Vec<u8>>,
    /// The messages of all channels, in the order of the file; none if they were given away.
    pub messages: Vec<Message>,
    /// Why reading ended before the end, if it did, as the end of a sentence about the file.
    pub cut_off: Option<String>,
}

/// A message of a recording.
#[derive(Debug, Clone)]
pub struct Message {
    /// Its channel, as in `/pathtune/odometry`.
    pub topic: String,
    /// Its time on the recording's timeline.
    pub log_time_ns: u64,
    /// Its bytes: of our own topics those that were in shared memory, of the others CDR.
    pub data: Vec<u8>,
}

/// Whether a file is a recording of ours: an MCAP file that begins with our metadata. Another one may be a bag of ROS 2.
///
/// # Errors
/// If it cannot be read.
pub fn is_ours(path: &Path) -> Result<bool> {
    let mut ours = None;
    // Ours begins with its metadata; no message comes before it.
    let _ = scan(path, |record| match record {
        Record::Metadata { name: BEGINNING, .. } => {
            ours = Some(true);
            bail!("known")
        }
        Record::Message { .. } => {
            ours = Some(false);
            bail!("known")
        }
        _ => Ok(()),
    });
    Ok(ours.unwrap_or(false))
}

/// A message of any MCAP file.
#[derive(Debug, Clone, Copy)]
pub struct AnyMessage<'a> {
    /// Its topic.
    pub topic: &'a str,
    /// The name of its type, as in `nav_msgs/msg/Odometry`; empty if the file does not say.
    pub kind: &'a str,
    /// When it arrived.
    pub log_time_ns: u64,
    /// Its bytes.
    pub data: &'a [u8],
}

/// Reads any MCAP file, and gives its messages to `take` one after the other. Returns why reading ended before the end, if it
/// did, as the end of a sentence about the file.
///
/// # Errors
/// If it cannot be read at all; or that of `take`.
pub fn read_any(
    path: &Path,
    mut take: impl FnMut(AnyMessage<'_>) -> Result<()>,
) -> Result<Option<String>> {
    let (mut channels, mut kinds, mut kept) = (BTreeMap::new(), BTreeMap::new(), Kept::default());
    let end = scan(path, |record| match record {
        Record::Schema { id, name } => {
            kept.note(name.len())?;
            kinds.insert(id, name.to_owned());
            Ok(())
        }
        Record::Channel { id, schema, topic } => {
            kept.note(topic.len())?;
            channels.insert(id, (topic.to_owned(), schema));
            Ok(())
        }
        Record::Message { channel, log_time_ns, data } => {
            let (topic, schema) = channels.get(&channel).map_or(("", 0), |it| (&it.0, it.1));
            let kind = kinds.get(&schema).map_or("", String::as_str);
            take(AnyMessage { topic, kind, log_time_ns, data })
        }
        _ => Ok(()),
    })?;
    Ok(match end {
        End::Whole => None,
        End::CutOff(what) => Some(format!("was cut off: {what}")),
        End::Damaged(where_and_why) => Some(format!("is damaged {where_and_why}")),
    })
}

/// Keeps count of what is kept in memory.
#[derive(Debug, Default)]
pub struct Kept(usize);

impl Kept {
    /// Notes what is to be kept next.
    ///
    /// # Errors
    /// If it would be more than [`KEPT_LIMIT`] in all.
    pub fn note(&mut self, bytes: usize) -> Result<()> {
        self.0 = self.0.saturating_add(bytes);
        ensure!(
            self.0 <= KEPT_LIMIT,
            "holds more than {} MiB of what would have to be kept in memory; record fewer drives in one run",
            KEPT_LIMIT >> 20
        );
        Ok(())
    }
}

impl Recording {
    /// Reads a file, as far as it goes.
    ///
    /// # Errors
    /// If it cannot be read at all, is not a recording of this version, or is too large to be kept in memory.
    pub fn read(path: &Path) -> Result<Self> {
        let (mut messages, mut kept) = (Vec::new(), Kept::default());
        let recording = Self::read_with(path, |topic, log_time_ns, data| {
            kept.note(size_of::<Message>() + topic.len() + data.len())?;
            let (topic, data) = (topic.to_owned(), data.to_owned());
            messages.push(Message { topic, log_time_ns, data });
            Ok(())
        })?;
        Ok(Self { messages, ..recording })
    }

    /// As [`Recording::read`], with the messages given to `take` one after the other: channel, time on the recording's
    /// timeline, and bytes.
    ///
    /// # Errors
    /// As [`Recording::read`], and that of `take`, as the end of a sentence about the file.
    pub fn read_with(
        path: &Path,
        mut take: impl FnMut(&str, u64, &[u8]) -> Result<()>,
    ) -> Result<Self> {
        let mut recording = Self::default();
        let (mut channels, mut kept) = (BTreeMap::new(), Kept::default());
        let mut refused = None;
        let end = scan(path, |record| {
            recording
                .note(record, &mut channels, &mut kept, &mut take)
                .inspect_err(|why| refused = Some(format!("{} {why:#}", path.display())))
        });
        if let Some(why) = refused {
            bail!(why);
        }
        recording.cut_off =
            match end.with_context(|| format!("failed to read {}", path.display()))? {
                End::Whole => None,
                End::CutOff(what) => Some(format!("was cut off: {what}")),
                End::Damaged(where_and_why) => Some(format!("is damaged {where_and_why}")),
            };
        if recording.beginning.is_empty() {
            let why = recording.cut_off.as_deref().unwrap_or("is not a recording by pathtune");
            bail!("{} {why}", path.display());
        }
        Ok(recording)
    }

    fn note(
        &mut self,
        record: Record<'_>,
        channels: &mut BTreeMap<u16, String>,
        kept: &mut Kept,
        take: &mut impl FnMut(&str, u64, &[u8]) -> Result<()>,
    ) -> Result<()> {
        match record {
            Record::Schema { .. } => {}
            Record::Channel { id, topic, .. } => {
                kept.note(topic.len())?;
                channels.insert(id, topic.to_owned());
            }
            Record::Message { channel, log_time_ns, data } => {
                ensure!(!self.beginning.is_empty(), "is not a recording by pathtune");
                let topic = channels.get(&channel).map_or("", String::as_str);
                let is_ours = topic.starts_with("/pathtune/");
                let data = if is_ours { raw::unwrap(data) } else { Some(data) };
                let data = data.context("is damaged: a message is not as long as it says")?;
                take(topic, log_time_ns, data)?;
            }
            Record::Metadata { name: BEGINNING, entries } => {
                ensure!(
                    entries.get("layout") == Some(&layout_digest()),
                    "was made by an earlier version of pathtune; its messages have another layout, so this one cannot \
                     replay it"
                );
                self.beginning = entries;
            }
            Record::Metadata { name: END, entries } => self.end = Some(entries),
            Record::Metadata { .. } => {}
            Record::Attachment { name, data } => {
                kept.note(name.len() + data.len())?;
                self.attachments.insert(name.to_owned(), data.to_owned());
            }
        }
        Ok(())
    }

    /// The messages of one of our topics.
    pub fn of<'a>(&'a self, topic: &'a str) -> impl Iterator<Item = &'a Message> {
        self.messages.iter().filter(move |it| it.topic.strip_prefix("/pathtune/") == Some(topic))
    }
}
