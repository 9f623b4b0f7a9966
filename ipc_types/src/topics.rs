//! All topics in one table: their names, who sends, who is woken, and how much is kept.

use crate::layout::{Layout, ZeroCopySend};
use crate::{
    BatchHeader, Command, Credit, DriveOutcome, DriveReport, DriveRequest, GainSwitch,
    KeptLawState, LawState, LearnerProgress, Odometry, Proposal, RawCommand, Rearm, Safety, Status,
    TickHeader, TrackingError, Zone,
};

/// Who can be woken by a message. The same roles send them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[allow(missing_docs, reason = "the roles of a pipeline")]
pub enum WakeRole {
    Vehicle,
    Controller,
    Supervisor,
    Trainer,
    Orchestrator,
    Recorder,
}

impl WakeRole {
    /// Every role.
    pub const ALL: [WakeRole; 6] = [
        WakeRole::Vehicle,
        WakeRole::Controller,
        WakeRole::Supervisor,
        WakeRole::Trainer,
        WakeRole::Orchestrator,
        WakeRole::Recorder,
    ];

    /// Whether the role belongs to a ring: a run may have several rings, and one of each other role.
    pub fn is_of_ring(self) -> bool {
        matches!(self, WakeRole::Vehicle | WakeRole::Controller | WakeRole::Supervisor)
    }

    /// Name of the event that wakes the role.
    pub fn event_name(self) -> &'static str {
        match self {
            WakeRole::Vehicle => "wake/vehicle",
            WakeRole::Controller => "wake/controller",
            WakeRole::Supervisor => "wake/supervisor",
            WakeRole::Trainer => "wake/trainer",
            WakeRole::Orchestrator => "wake/orchestrator",
            WakeRole::Recorder => "wake/recorder",
        }
    }
}

/// Who sends the messages of a topic.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Senders {
    /// The process in one of these roles.
    Roles(&'static [WakeRole]),
    /// `pathtune rearm`, on behalf of a user.
    Rearm,
    /// Every process of the run.
    Everybody,
}

/// Settings of a topic.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Topic {
    /// Name.
    pub name: &'static str,
    /// Who sends its messages.
    pub senders: Senders,
    /// Who is woken by a message, in this order, in which the scheduler then runs them.
    pub wakes: &'static [WakeRole],
    /// How many messages a late subscriber receives.
    pub history: usize,
    /// How many messages a participant's buffer holds.
    pub buffer: usize,
    /// The largest number of publishers at a time.
    pub publishers: usize,
}

/// A message with its topic.
pub trait Message: ZeroCopySend + Layout + Copy + Default + std::fmt::Debug + 'static {
    /// What each message carries in addition to its elements.
    type Header: ZeroCopySend + Layout + Copy + Default + std::fmt::Debug + 'static;
    /// The topic.
    const TOPIC: Topic;
}

/// Buffer of an observer: how many messages it may lag behind without a loss.
pub const OBSERVER_BUFFER: usize = 1024;
/// The largest number of subscribers of a topic, including observers.
pub const MAX_SUBSCRIBERS: usize = 32;
/// The largest number of nodes of a run, including dead ones that have not been cleaned up yet.
pub const MAX_NODES: usize = 64;

macro_rules! topics {
    ($($message:ident, $header:ident, $name:literal, from $senders:expr, wakes $wakes:expr,
        history $history:literal, buffer $buffer:literal, publishers $publishers:literal;)+) => {
        $(impl Message for $message {
            type Header = $header;
            const TOPIC: Topic = Topic {
                name: $name,
                senders: $senders,
                wakes: $wakes,
                history: $history,
                buffer: $buffer,
                publishers: $publishers,
            };
        })+

        /// Calls `$call!(Message)` for every message that has a topic.
        #[macro_export]
        macro_rules! for_each_topic {
            ($call:ident) => { $($call!($crate::$message);)+ };
        }
    };
}

use Senders::{Everybody, Rearm as RearmCommand, Roles};
use WakeRole::{Controller, Orchestrator, Recorder, Supervisor, Trainer, Vehicle};

topics! {
    // Once a tick. One tick is in flight at a time, so a buffer of 2 loses nothing.
    Odometry, TickHeader, "odometry", from Roles(&[Vehicle]),
        wakes &[Controller, Supervisor], history 0, buffer 2, publishers 1;
    RawCommand, TickHeader, "raw_command", from Roles(&[Controller]),
        wakes &[Supervisor], history 0, buffer 2, publishers 1;
    Command, TickHeader, "command", from Roles(&[Supervisor]),
        wakes &[Vehicle], history 0, buffer 2, publishers 1;
    TrackingError, TickHeader, "tracking_error", from Roles(&[Controller]),
        wakes &[], history 0, buffer 2, publishers 1;
    // Between ticks. The last one is kept for late joiners.
    DriveRequest, BatchHeader, "drive_request", from Roles(&[Orchestrator]),
        wakes &[Vehicle, Controller, Supervisor, Recorder], history 1, buffer 2, publishers 1;
    Zone, BatchHeader, "zone", from Roles(&[Supervisor]),
        wakes &[Trainer], history 1, buffer 16, publishers 1;
    GainSwitch, BatchHeader, "gains", from Roles(&[Trainer]),
        wakes &[Controller], history 1, buffer 16, publishers 1;
    Credit, BatchHeader, "credit", from Roles(&[Trainer, Recorder]),
        wakes &[Vehicle], history 1, buffer 2, publishers 2;
    DriveReport, BatchHeader, "drive_report", from Roles(&[Controller]),
        wakes &[Orchestrator], history 1, buffer 2, publishers 1;
    DriveOutcome, BatchHeader, "drive_outcome", from Roles(&[Orchestrator]),
        wakes &[Trainer], history 1, buffer 2, publishers 1;
    Proposal, BatchHeader, "proposal", from Roles(&[Trainer]),
        wakes &[Orchestrator], history 1, buffer 2, publishers 1;
    LearnerProgress, BatchHeader, "learner_progress", from Roles(&[Trainer]),
        wakes &[], history 1, buffer 2, publishers 1;
    // The gate's state, and the way back to normal.
    Safety, BatchHeader, "safety", from Roles(&[Supervisor]),
        wakes &[Controller], history 1, buffer 16, publishers 1;
    // Only when driving by the clock: the state that a law must not lose when its process is replaced.
    LawState, BatchHeader, "law_state", from Roles(&[Controller]),
        wakes &[], history 0, buffer 2, publishers 1;
    KeptLawState, BatchHeader, "kept_law_state", from Roles(&[Supervisor]),
        wakes &[], history 1, buffer 2, publishers 1;
    Rearm, BatchHeader, "rearm", from RearmCommand,
        wakes &[Supervisor], history 0, buffer 2, publishers 16;
    // From every process; the place of a dead publisher is free again only after the clean-up.
    Status, BatchHeader, "status", from Everybody,
        wakes &[Orchestrator], history 1, buffer 64, publishers 16;
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The senders as the contract names them.
    fn told(senders: Senders) -> String {
        match senders {
            Roles(roles) => {
                let names = roles.iter().map(|role| format!("{role:?}").to_lowercase());
                names.collect::<Vec<_>>().join(", ")
            }
            RearmCommand => "`pathtune rearm`".to_owned(),
            Everybody => "everybody".to_owned(),
        }
    }

    #[test]
    fn the_contract_tells_the_topics_as_they_are() {
        let contract = include_str!("../CONTRACT.md");
        let rows: Vec<Vec<&str>> = contract
            .lines()
            .skip_while(|line| !line.starts_with("| topic |"))
            .skip(2)
            .take_while(|line| line.starts_with('|'))
            .map(|line| line.trim_matches('|').split('|').map(str::trim).collect())
            .collect();
        let mut topics = 0;
        macro_rules! check {
            ($message:ty) => {
                let topic = <$message as Message>::TOPIC;
                let name = format!("`{}`", topic.name);
                let row = rows.iter().find(|row| row[0] == name);
                let row = row.unwrap_or_else(|| panic!("{name} is not in the contract"));
                let short = |name: &str| {
                    let name = name.trim_start_matches("pathtune.");
                    format!("`{}`", name.split('#').next().unwrap_or_default())
                };
                assert_eq!(row[1], short(<$message as Layout>::TYPE_NAME), "{name}");
                let header = short(<<$message as Message>::Header as Layout>::TYPE_NAME);
                assert_eq!(row[2], header, "{name}");
                let from = row[3].split('→').next().unwrap_or_default().trim();
                assert_eq!(from, told(topic.senders), "{name}");
                topics += 1;
            };
        }
        for_each_topic!(check);
        assert_eq!(rows.len(), topics, "the contract lists topics that do not exist");
    }
}
