//! The recorder: writes all messages of a run to an MCAP file.
//!
//! Every topic has a channel `/pathtune/<topic>` with the bytes of its messages, header and elements, as they were
//! in shared memory, wrapped as [`raw`] says. In addition there are ROS 2 messages made from them, which tools such as
//! Foxglove and PlotJuggler show without set-up. See [`ros`] for their topics, [`timeline`] for their stamps. All
//! channels are CDR and have a schema, so that the tools of ROS 2 take the whole file.
//!
//! As a process of the pipeline ([`service`]) it loses nothing: a vehicle in lockstep waits for its credit. From
//! another terminal ([`attached`]) it is an observer, and reports what it has missed.
//!
//! The file consists of chunks of about 1 MiB, closed at least once a second: a file that was cut off can be read
//! up to its last closed chunk.

pub mod attached;
mod container;
mod listener;
mod progress;
pub mod raw;
pub mod reading;
pub mod ros;
mod rosbag;
pub mod service;
mod tape;
pub mod timeline;
mod topics;

pub use topics::{Place, TopicInfo, layout_digest, topics};
