//! What a recording holds, and what it lacks.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The recording of a run.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct RecordingFacts {
    /// Name of the file in the run's folder that was written last.
    pub file: String,
    /// Whether it begins with the first tick of the run: if the recorder was restarted, what it had not written is lost.
    pub from_first_tick: bool,
    /// Messages that were written.
    pub messages: u64,
    /// Messages that were sent and are missing, at most; of topics that are not sent once a tick, at least.
    pub missed: u64,
    /// Messages of ticks that nobody sent: by the clock, a process that is held up leaves ticks out.
    pub unsent: u64,
    /// The same by topic.
    pub topics: BTreeMap<String, TopicCounts>,
}

/// The messages of a topic in a recording.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct TopicCounts {
    /// Messages that were written.
    pub messages: u64,
    /// Messages that were sent and are missing, as in the sum over all topics.
    pub missed: u64,
    /// Messages of ticks that nobody sent.
    pub unsent: u64,
}

impl RecordingFacts {
    /// Name of the file with which the recorder passes it on.
    pub const FILE: &str = "recording.json";

    /// What the recording lacks, in words: one line for each kind of loss.
    pub fn told(&self) -> Vec<String> {
        let list = |of: fn(&TopicCounts) -> u64| {
            let lacking = self.topics.iter().filter(|(_, counts)| of(counts) > 0);
            let told = lacking.map(|(topic, counts)| {
                let TopicCounts { messages, missed, unsent } = *counts;
                format!("{} of {} of {topic}", of(counts), messages + missed + unsent)
            });
            told.collect::<Vec<_>>().join(", ")
        };
        let mut lines = Vec::new();
        if !self.from_first_tick {
            lines.push(format!(
                "the recording goes on in {}; what had not been written is lost",
                self.file
            ));
        }
        if self.missed > 0 {
            lines.push(format!(
                "the recording has gaps; messages that are missing: {}",
                list(|it| it.missed)
            ));
        }
        if self.unsent > 0 {
            lines.push(format!(
                "the machine was too busy for the clock; messages that no process sent: {}",
                list(|it| it.unsent)
            ));
        }
        lines
    }
}
