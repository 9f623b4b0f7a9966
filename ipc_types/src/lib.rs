//! The wire vocabulary: what the processes of a pipeline say to each other.
//!
//! Messages are plain C structs in shared memory, read and written in place. `CONTRACT.md` beside this
//! crate says who sends which, when, and what it means; [`topics`] holds all topics in one table.
//!
//! A message travels as a slice, one element a vehicle (or a learner, or a slot), under one header. Lengths
//! are in metres, angles in radians, times in nanoseconds of `CLOCK_MONOTONIC`; axes follow REP-103.
//!
//! The transport compares types by name, size and alignment alone. Each name therefore ends in a hash of
//! the layout, and the build fails where hash and layout differ: see [`layout`]. [`schema`] tells it all to
//! Python and C.

mod allowance;
pub mod layout;
mod messages;
#[macro_use]
pub mod topics;
// Behind the topics, whose macro it uses.
pub mod schema;

pub use allowance::Allowance;
pub use messages::*;
pub use topics::{Message, Topic, WakeRole};

/// The most parameters that a law has.
pub const MAX_PARAMETERS: usize = 16;
/// The most numbers of a law's state.
pub const MAX_STATE: usize = 64;
