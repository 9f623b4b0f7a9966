//! Looks after the processes of a run: starts them, sequences the drives, restarts what crashed, and ends in order.
//!
//! Links no service: it starts processes, by re-executing the binary it is part of or by a user's command.
//! By construction, therefore, any of them can be replaced. The parts that do link services are handed in as a
//! [`House`] by the binary's `main`.
//!
//! The rooms, from what the user types down to what runs:
//! - `doorway`: [`run`], from the command line to an exit code.
//! - [`cli`]: the command line as types.
//! - [`commands`]: what each command does, from its options to what it prints.
//! - `conformance` and [`bench`](mod@bench): the two commands that are longer than a page.
//! - `study`: many trainings, on one machine or many: `pathtune sweep`.
//! - [`runs`]: what a run needs in addition to its pipeline: checks, folder, result, and how other terminals find it.
//! - [`pipeline`]: the processes of one run and the loop that joins them. [`pipeline::sequencer`] and
//!   [`pipeline::restart`] decide, and are pure; [`pipeline::process`] and `pipeline::main_loop` act.
//! - [`words`]: what is said to the user.
//!
//! A room uses only those below it, and nothing in `pipeline` or `words` imports from `commands`. Two exceptions:
//! `runs::state`, which the pipeline writes, uses only `words`; `words::tables` knows one type of the pipeline, its
//! recoveries.

pub mod bench;
pub mod cli;
pub mod commands;
mod conformance;
mod doorway;
pub mod pipeline;
pub mod runs;
mod study;
pub mod words;

pub use doorway::{ExciteTools, House, Tools, run};
pub use pipeline::services::{Service, Services};
pub use study::StudyTools;
