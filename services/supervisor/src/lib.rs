//! The paper's high-level supervisor: the safety gate in the command path, and the zones.
//!
//! [`Gate`], [`SpeedGovernor`], [`Plausibility`], [`Guard`] and [`Ladder`] are pure, and [`Watch`] joins them for one vehicle;
//! [`service`] joins that to the pipeline.

// Tests may read and write files, start threads, and know the time.
#![cfg_attr(test, allow(clippy::disallowed_methods, clippy::disallowed_types))]

mod area;
mod channel;
mod deviation;
pub mod envelope;
mod gate;
mod governor;
mod guard;
mod ladder;
mod mean;
mod pace;
mod plausibility;
mod response;
mod road;
mod runaway;
#[cfg(feature = "process")]
#[allow(clippy::disallowed_methods, clippy::disallowed_types, reason = "no pure core")]
pub mod service;
mod unseen;
mod watch;
mod zones;

pub use area::Footprint;
pub use channel::Channel;
pub use deviation::Deviation;
pub use gate::{Change, Gate, Passed, RawCommand};
pub use governor::SpeedGovernor;
pub use guard::{Guard, State};
pub use ladder::{Action, Ladder, Step};
pub use pace::{Pace, Progress};
pub use plausibility::{Movement, Plausibility};
pub use response::Response;
pub use watch::Watch;
pub use zones::Zones;
