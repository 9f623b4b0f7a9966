//! Listens to all topics, counts what was missed, and hands everything to the tape.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::Result;
use ipc_types::layout::Bytes;
use ipc_types::topics::OBSERVER_BUFFER;
use ipc_types::{Attempt, BatchHeader, DriveReport};
use outcome::{RecordingFacts, TopicCounts};
use runtime::Bus;

use crate::Place;
use crate::progress::{Overflow, Reported, TickProgress};
use crate::tape::{Tape, name_of};
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
    /// Number of messages by topic, for the others.
    others: BTreeMap<usize, u64>,
    /// By topic.
    overflows: Vec<Overflow>,
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
                others.insert(index, 0);
            }
        }
        let overflows = vec![Overflow::default(); topics().len()];
        Ok(Self {
            taps: tap_all(bus)?,
            tape,
            block: Vec::new(),
            ticks,
            others,
            overflows,
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
                let overflow = &mut self.overflows[tap.topic()];
                let Some(sample) = tap.take()? else {
                    overflow.was_empty();
                    break;
                };
                overflow.took();
                bytes += sample.bytes.len();
                if let Some(ticks) = self.ticks.get_mut(&sample.topic) {
                    ticks.note(sample.place);
                } else if let Some(messages) = self.others.get_mut(&sample.topic) {
                    *messages += 1;
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
        let mut heard = BTreeMap::new();
        for (topic, ticks) in &mut self.ticks {
            ticks.end(self.reported.all());
            let counts = self.overflows[*topic].counts(ticks.messages, ticks.absent);
            heard.insert(topics[*topic].name.to_owned(), counts);
        }
        for (topic, messages) in self.others {
            // Of these nobody knows how many there were: a loss counts as one.
            let TopicCounts { missed, .. } = self.overflows[topic].counts(messages, 1);
            let counts = TopicCounts { messages, missed, unsent: 0 };
            heard.insert(topics[topic].name.to_owned(), counts);
        }
        let mut summary = Summary { file: PathBuf::new(), heard, behind: self.behind };
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
    pub file: PathBuf,
    /// What was received, by topic.
    pub heard: BTreeMap<String, TopicCounts>,
    /// How long nothing could be taken because the disk could not keep up.
    pub behind: Duration,
}

impl Summary {
    /// The summary for `result.json`.
    pub fn facts(&self, from_first_tick: bool) -> RecordingFacts {
        RecordingFacts {
            file: name_of(&self.file),
            from_first_tick,
            messages: self.sum(|counts| counts.messages),
            missed: self.sum(|counts| counts.missed),
            unsent: self.sum(|counts| counts.unsent),
            topics: self.heard.clone(),
        }
    }

    fn sum(&self, of: impl Fn(&TopicCounts) -> u64) -> u64 {
        self.heard.values().map(of).sum()
    }

    fn metadata(&self, digest: Option<String>) -> BTreeMap<String, String> {
        let mut metadata = BTreeMap::from([
            ("gaps".to_owned(), self.sum(|counts| counts.missed).to_string()),
            ("unsent".to_owned(), self.sum(|counts| counts.unsent).to_string()),
            ("behind_ms".to_owned(), self.behind.as_millis().to_string()),
        ]);
        for (topic, TopicCounts { messages, missed, unsent }) in &self.heard {
            metadata.insert(format!("messages.{topic}"), messages.to_string());
            metadata.insert(format!("missed.{topic}"), missed.to_string());
            metadata.insert(format!("unsent.{topic}"), unsent.to_string());
        }
        if let Some(digest) = digest {
            metadata.insert("digest".to_owned(), digest);
        }
        metadata
    }
}
