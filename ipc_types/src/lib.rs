//! The wire vocabulary: the messages that the processes of a pipeline exchange.
//!
//! Messages are plain C structs in shared memory, read and written in place. `CONTRACT.md` in this crate's
//! folder says who sends which, when, and what it means; [`topics`] holds all topics in one table.
//!
//! A message travels as a slice, with one element for each vehicle (or learner, or slot), under one header. Lengths
//! are in metres, angles in radians, times in nanoseconds of `CLOCK_MONOTONIC`; axes follow REP-103.
//!
//! The transport compares types only by name, size and alignment. Each name therefore ends in a hash of
//! the layout, and the build fails if hash and layout differ: see [`layout`]. [`schema`] exports all of it to
//! Python and C.

mod allowance;
pub mod layout;
mod messages;
mod words;
#[macro_use]
pub mod topics;
// Must come after the topics, whose macro it uses.
pub mod schema;

pub use allowance::Allowance;
pub use messages::*;
pub use topics::{Message, Topic, WakeRole};

/// The largest number of parameters of a law.
pub const MAX_PARAMETERS: usize = 16;
/// The largest number of values in a law's state.
pub const MAX_STATE: usize = 64;
