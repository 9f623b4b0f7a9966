//! The processes of one run, and the loop that joins them.
//!
//! Read `main_loop` first. [`sequencer`] and [`restart`] decide, and are pure; [`process`] acts.

pub(crate) mod cgroup;
pub(crate) mod cores;
pub(crate) mod gate_log;
pub mod guardian;
pub(crate) mod interrupts;
pub(crate) mod main_loop;
pub(crate) mod member;
pub(crate) mod observers;
pub(crate) mod orphans;
pub(crate) mod plan;
pub mod process;
pub(crate) mod progress;
pub(crate) mod recovery;
pub mod restart;
mod ring;
pub mod sequencer;
pub(crate) mod services;
mod standing;
pub(crate) mod strays;
pub(crate) mod vitals;
