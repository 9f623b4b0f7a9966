//! Looks after the processes of a run: starts them, sequences the drives, restarts what crashed, ends in order.
//!
//! Links no service: it starts processes, by re-executing the binary it is part of or by a user's command.
//! That is what makes a swap of any of them possible by construction. Whatever does link one is handed in as a
//! [`House`] by the binary's `main`.
//!
//! The rooms, from what the user types down to what runs:
//! - `doorway`: [`run`], from the command line to an exit code.
//! - [`cli`]: the command line as types.
//! - [`commands`]: what each command does, from its options to what it prints.
//! - `conformance` and [`bench`]: the two commands that are more than a page.
//! - [`runs`]: what a run needs around its pipeline: checks, folder, result, and how other terminals find it.
//! - [`pipeline`]: the processes of one run and the loop that joins them. [`pipeline::sequencer`] and
//!   [`pipeline::restart`] decide, and are pure; [`pipeline::process`] and `pipeline::main_loop` act.
//! - [`words`]: what is said to the user.
//!
//! A room uses those below it, and nothing in `pipeline` or `words` imports from `commands`. `runs::state`, which the
//! pipeline writes, uses no room but `words`; `words::tables` knows one type of the pipeline, its recoveries.

pub mod bench;
pub mod cli;
pub mod commands;
mod conformance;
mod doorway;
pub mod pipeline;
pub mod runs;
pub mod words;

pub use doorway::{House, Tools, run};
pub use pipeline::services::{Service, Services};
