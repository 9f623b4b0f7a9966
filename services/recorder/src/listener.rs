//! Listens to all topics, counts what was missed, and hands everything to the tape.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use anyhow::Result;
use ipc_types::layout::Bytes;
use ipc_types::topics::OBSERVER_BUFFER;
use ipc_types::{Attempt, BatchHeader, DriveReport};
use runtime::Bus;

use crate::Place;
use crate::progress::{Heard, Reported, TickProgress};
use crate::tape::Tape;
use crate::topics::{Sample, Tap, index_of, tap_all, topics};

/// The largest number of messages of a topic that one look takes.
const AT_ONCE: usize = 64;
/// A block is handed over at this size, so that what waits for the disk stays small.
const BLOCK_BYTES: usize = 1 << 20;
/// Time between two attempts to hand a block to a thread that cannot keep up.
const BEHIND_NAP: Duration = Duration::from_micros(200);

/// The result of one look.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Look {
    /// Nothing.
    Nothing,
    /// Messages, and there may be more.
    Some,
    /// Messages, and all that there were.
    All,
    /// The disk cannot keep up: nothing was taken.
    Behind,
}

/// The inlets of all topics, and the tape.
pub(crate) struct Listener {
    taps: Vec<Box<dyn Tap>>,
    tape: Tape,
    block: Vec<Sample>,
    /// Progress by topic, for those that are sent once a tick.
    ticks: BTreeMap<usize, TickProgress>,
    others: BTreeMap<usize, Heard>,
    reported: Reported,
    /// The request that was received last.
    pub(crate) requested: Option<Place>,
    behind: Duration,
    requests: usize,
    reports: usize,
    /// The topics that a drive cannot do without.
    ring: [usize; 3],
}

impl Listener {
    pub(crate) fn new(bus: &Bus, tape: Tape) -> Result<Self> {
        let mut ticks = BTreeMap::new();
        let mut others = BTreeMap::new();
        for (index, topic) in topics().iter().enumerate() {
            if topic.is_per_tick {
                ticks.insert(index, TickProgress::default());
            } else {
                others.insert(index, Heard::default());
            }
        }
        Ok(Self {
            taps: tap_all(bus)?,
            tape,
            block: Vec::new(),
            ticks,
            others,
            reported: Reported::default(),
            requested: None,
            behind: Duration::ZERO,
            requests: index_of("drive_request"),
            reports: index_of("drive_report"),
            ring: ["odometry", "raw_command", "command"].map(index_of),
        })
    }

    /// Takes what has come.
    pub(crate) fn listen(&mut self) -> Result<Look> {
        if !self.hand_over()? {
            return Ok(Look::Behind);
        }
        let (mut bytes, mut is_all) = (0, true);
        for tap in &self.taps {
            for taken in 0.. {
                if taken == AT_ONCE || bytes > BLOCK_BYTES {
                    is_all = false;
                    break;
                }
                let Some(sample) = tap.take()? else { break };
                bytes += sample.bytes.len();
                if let Some(ticks) = self.ticks.get_mut(&sample.topic) {
                    ticks.note(sample.place);
                } else if let Some(heard) = self.others.get_mut(&sample.topic) {
                    heard.messages += 1;
                }
                if sample.topic == self.requests {
                    self.requested = Some(sample.place);
                } else if sample.topic == self.reports {
                    self.reported.note(sample.place.attempt, longest(&sample.bytes));
                }
                self.block.push(sample);
            }
        }
        if is_all {
            // A report is sent before anything of the next batch: it has been received by now.
            for ticks in self.ticks.values_mut() {
                ticks.settle(self.reported.all());
            }
        }
        if self.block.is_empty() {
            return Ok(Look::Nothing);
        }
        self.hand_over()?;
        Ok(if is_all { Look::All } else { Look::Some })
    }

    /// Hands over what was taken; returns whether the tape accepted it.
    fn hand_over(&mut self) -> Result<bool> {
        if self.block.is_empty() {
            return Ok(true);
        }
        let since = Instant::now();
        let Some(block) = self.tape.offer(std::mem::take(&mut self.block))? else {
            return Ok(true);
        };
        self.block = block;
        std::thread::sleep(BEHIND_NAP);
        self.behind += since.elapsed();
        Ok(false)
    }

    /// How many ticks of an attempt were received on every topic of the ring.
    pub(crate) fn ticks_of(&self, attempt: Attempt) -> u64 {
        let of = |topic: &usize| self.ticks.get(topic).map_or(0, |it| it.ticks_of(attempt));
        self.ring.iter().map(of).min().unwrap_or_default()
    }

    /// Receives what is left, ends the file, and reports what was missed.
    pub(crate) fn finish(mut self, digest: Option<String>) -> Result<Summary> {
        // What has come by now fits into a buffer; if the run goes on, more would come for ever.
        let mut looks = 0;
        while looks <= OBSERVER_BUFFER / AT_ONCE {
            match self.listen()? {
                Look::Nothing => break,
                Look::Behind => {}
                Look::Some | Look::All => looks += 1,
            }
        }
        let topics = topics();
        let mut summary = Summary { behind: self.behind, ..Summary::default() };
        for (topic, ticks) in &mut self.ticks {
            ticks.end(self.reported.all());
            summary.heard.insert(topics[*topic].name.to_owned(), ticks.heard().clone());
        }
        for (topic, heard) in self.others {
            summary.heard.insert(topics[topic].name.to_owned(), heard);
        }
        summary.file = self.tape.finish(self.block, summary.metadata(digest))?;
        Ok(summary)
    }
}

/// Ticks of the longest drive of a report.
fn longest(mut bytes: &[u8]) -> u64 {
    let _ = BatchHeader::take(&mut bytes);
    let reports = std::iter::from_fn(|| DriveReport::take(&mut bytes));
    reports.map(|report| report.ticks).max().unwrap_or_default()
}

/// The summary of a recording.
#[derive(Debug, Clone, Default)]
pub struct Summary {
    /// The file that was written last.
    pub file: std::path::PathBuf,
    /// What was received and missed, by topic.
    pub heard: BTreeMap<String, Heard>,
    /// How long nothing could be taken because the disk could not keep up.
    pub behind: Duration,
}

impl Summary {
    /// Number of missed messages, over all topics.
    pub fn missed(&self) -> u64 {
        self.heard.values().map(|heard| heard.missed).sum()
    }

    /// Number of written messages, over all topics.
    pub fn messages(&self) -> u64 {
        self.heard.values().map(|heard| heard.messages).sum()
    }

    /// What was missed, in words; `None` if nothing was.
    pub fn gaps(&self) -> Option<String> {
        let missed: Vec<String> = self
            .heard
            .iter()
            .filter(|(_, heard)| heard.missed > 0)
            .map(|(topic, Heard { messages, missed })| {
                format!("{missed} of {} messages of {topic}", messages + missed)
            })
            .collect();
        (!missed.is_empty()).then(|| missed.join(", "))
    }

    fn metadata(&self, digest: Option<String>) -> BTreeMap<String, String> {
        let mut metadata = BTreeMap::from([
            ("gaps".to_owned(), self.missed().to_string()),
            ("behind_ms".to_owned(), self.behind.as_millis().to_string()),
        ]);
        for (topic, heard) in &self.heard {
            metadata.insert(format!("messages.{topic}"), heard.messages.to_string());
            metadata.insert(format!("missed.{topic}"), heard.missed.to_string());
        }
        if let Some(digest) = digest {
            metadata.insert("digest".to_owned(), digest);
        }
        metadata
    }
}
