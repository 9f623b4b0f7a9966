//! Reads back our part of a recording.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result};
use mcap::read::{ChunkFlattener, Options};
use mcap::records::Record;

pub use crate::tape::{BEGINNING, END};

/// Our part of a recording.
#[derive(Debug, Default)]
pub struct Recording {
    /// The metadata at its beginning.
    pub beginning: BTreeMap<String, String>,
    /// The metadata at its end; `None` if the file was cut off.
    pub end: Option<BTreeMap<String, String>>,
    /// The attached files, by name.
    pub attachments: BTreeMap<String, Vec<u8>>,
    /// The messages of all channels, in the order of the file.
    pub messages: Vec<Message>,
    /// Why reading ended before the end, if it did.
    pub cut_off: Option<String>,
}

/// A message of a recording.
#[derive(Debug, Clone)]
pub struct Message {
    /// Its channel, as in `/pathtune/odometry`.
    pub topic: String,
    /// Its time on the recording's timeline.
    pub log_time_ns: u64,
    /// Its bytes.
    pub data: Vec<u8>,
}

impl Recording {
    /// Reads a file, as far as it goes.
    ///
    /// # Errors
    /// If it cannot be read at all, or is not an MCAP file.
    pub fn read(path: &Path) -> Result<Self> {
        Self::read_only(path, |_| true)
    }

    /// As [`Recording::read`], with only the messages of some channels.
    ///
    /// # Errors
    /// As [`Recording::read`].
    pub fn read_only(path: &Path, wanted: impl Fn(&str) -> bool) -> Result<Self> {
        let bytes =
            std::fs::read(path).with_context(|| format!("failed to read {}", path.display()))?;
        Self::parse(&bytes, wanted)
            .with_context(|| format!("{} is not a recording", path.display()))
    }

    fn parse(bytes: &[u8], wanted: impl Fn(&str) -> bool) -> Result<Self> {
        let mut recording = Self::default();
        let mut channels = BTreeMap::new();
        let mut ended = false;
        for record in ChunkFlattener::new_with_options(bytes, Options::IgnoreEndMagic.into())? {
            let record = match record {
                Ok(record) => record,
                Err(error) => {
                    recording.cut_off = Some(error.to_string());
                    break;
                }
            };
            match record {
                Record::Channel(channel) => {
                    channels.insert(channel.id, channel.topic);
                }
                Record::Message { header, data } => {
                    let topic: String =
                        channels.get(&header.channel_id).cloned().unwrap_or_default();
                    if !wanted(&topic) {
                        continue;
                    }
                    let log_time_ns = header.log_time;
                    recording.messages.push(Message {
                        topic,
                        log_time_ns,
                        data: data.into_owned(),
                    });
                }
                Record::Metadata(metadata) if metadata.name == BEGINNING => {
                    recording.beginning = metadata.metadata;
                }
                Record::Metadata(metadata) if metadata.name == END => {
                    recording.end = Some(metadata.metadata);
                }
                Record::Attachment { header, data, .. } => {
                    recording.attachments.insert(header.name, data.into_owned());
                }
                Record::Footer(_) => ended = true,
                _ => {}
            }
        }
        if !ended && recording.cut_off.is_none() {
            recording.cut_off = Some("the end of the file is missing".to_owned());
        }
        Ok(recording)
    }

    /// The messages of one of our topics.
    pub fn of<'a>(&'a self, topic: &'a str) -> impl Iterator<Item = &'a Message> {
        self.messages.iter().filter(move |it| it.topic.strip_prefix("/pathtune/") == Some(topic))
    }
}
