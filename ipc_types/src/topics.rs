//! All topics in one table: name, who is woken, how much is kept.

use iceoryx2::prelude::ZeroCopySend;

use crate::layout::Layout;
use crate::{
    BatchHeader, Command, Credit, DriveOutcome, DriveReport, DriveRequest, GainSwitch,
    LearnerProgress, Odometry, Proposal, RawCommand, Rearm, Safety, Status, TickHeader,
    TrackingError, Zone,
};

/// Who can be woken by a message.
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

/// Settings of a topic.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Topic {
    /// Name.
    pub name: &'static str,
    /// Who is woken by a message, in this order: the scheduler runs them in it.
    pub wakes: &'static [WakeRole],
    /// Messages that a late subscriber is given.
    pub history: usize,
    /// Messages that a participant's buffer holds.
    pub buffer: usize,
    /// Publishers at a time.
    pub publishers: usize,
}

/// A message with its topic.
pub trait Message: ZeroCopySend + Layout + Copy + Default + std::fmt::Debug + 'static {
    /// What each message carries beside its elements.
    type Header: ZeroCopySend + Layout + Copy + Default + std::fmt::Debug + 'static;
    /// The topic.
    const TOPIC: Topic;
}

/// Buffer of an observer: what it may lag behind without a loss.
pub const OBSERVER_BUFFER: usize = 1024;
/// Subscribers of a topic, observers included.
pub const MAX_SUBSCRIBERS: usize = 32;
/// Nodes of a run, dead ones that wait for their clean-up included.
pub const MAX_NODES: usize = 64;

macro_rules! topics {
    ($($message:ident, $header:ident, $name:literal, wakes $wakes:expr,
        history $history:literal, buffer $buffer:literal, publishers $publishers:literal;)+) => {
        $(impl Message for $message {
            type Header = $header;
            const TOPIC: Topic = Topic {
                name: $name,
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

use WakeRole::{Controller, Orchestrator, Recorder, Supervisor, Trainer, Vehicle};

topics! {
    // Once a tick. One tick is in flight at a time, so a buffer of 2 loses nothing.
    Odometry, TickHeader, "odometry", wakes &[Controller, Supervisor],
        history 0, buffer 2, publishers 1;
    RawCommand, TickHeader, "raw_command", wakes &[Supervisor],
        history 0, buffer 2, publishers 1;
    Command, TickHeader, "command", wakes &[Vehicle],
        history 0, buffer 2, publishers 1;
    TrackingError, TickHeader, "tracking_error", wakes &[],
        history 0, buffer 2, publishers 1;
    // Between ticks. The last one is kept for late joiners.
    DriveRequest, BatchHeader, "drive_request", wakes &[Vehicle, Controller, Supervisor, Recorder],
        history 1, buffer 2, publishers 1;
    Zone, BatchHeader, "zone", wakes &[Trainer],
        history 1, buffer 16, publishers 1;
    GainSwitch, BatchHeader, "gains", wakes &[Controller],
        history 1, buffer 16, publishers 1;
    Credit, BatchHeader, "credit", wakes &[Vehicle],
        history 1, buffer 2, publishers 2;
    DriveReport, BatchHeader, "drive_report", wakes &[Orchestrator],
        history 1, buffer 2, publishers 1;
    DriveOutcome, BatchHeader, "drive_outcome", wakes &[Trainer],
        history 1, buffer 2, publishers 1;
    Proposal, BatchHeader, "proposal", wakes &[Orchestrator],
        history 1, buffer 2, publishers 1;
    LearnerProgress, BatchHeader, "learner_progress", wakes &[],
        history 1, buffer 2, publishers 1;
    // The gate's state and its way back.
    Safety, BatchHeader, "safety", wakes &[Controller],
        history 1, buffer 16, publishers 1;
    Rearm, BatchHeader, "rearm", wakes &[Supervisor],
        history 0, buffer 2, publishers 16;
    // From everybody; a dead publisher's place is free again only when it was cleaned up.
    Status, BatchHeader, "status", wakes &[Orchestrator],
        history 1, buffer 64, publishers 16;
}
