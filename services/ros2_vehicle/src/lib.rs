//! The vehicle role filled by a car that speaks ROS 2: its odometry becomes ours, our commands become its
//! Ackermann or twist messages.
//!
//! The part that needs no ROS 2 is pure: [`messages`] (as they are on the wire), [`frames`] (which point, in which
//! frame), [`arrivals`] (how much of it comes, and why it is not used), [`stop`] (commands to the car, and how it comes
//! to a stop), [`car`] (a drive in real time), [`hearing`] (whether the commands arrive), [`waits`] (why a drive does not
//! begin) and [`missing`] (what to say if something is missing). The process around them needs the feature `dds`, which brings DDS itself: no ROS needs to be
//! installed.

pub mod arrivals;
#[cfg(feature = "dds")]
mod begun;
pub mod car;
#[cfg(feature = "dds")]
mod commands;
pub mod frames;
pub mod hearing;
pub mod messages;
pub mod missing;
#[cfg(feature = "dds")]
mod ros;
#[cfg(feature = "dds")]
mod service;
pub mod stop;
#[cfg(feature = "dds")]
mod threads;
#[cfg(feature = "dds")]
mod topics;
pub mod waits;

/// A user's mistake: one line that says what to do.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct Refused(pub String);

/// Runs the process until it is asked to stop.
///
/// # Errors
/// [`Refused`] if another program drives the car already, or the network cannot be used; other errors if it cannot join
/// the run, or the transport fails.
#[cfg(feature = "dds")]
pub fn run() -> anyhow::Result<()> {
    service::run()
}

/// Says that the process is not in this build.
///
/// # Errors
/// Always: [`Refused`].
#[cfg(not(feature = "dds"))]
pub fn run() -> anyhow::Result<()> {
    let why =
        "this build has no ros2-vehicle; build it with `cargo build --release --features ros2`";
    Err(Refused(why.to_owned()).into())
}
