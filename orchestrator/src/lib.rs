//! Looks after the processes of a run: starts them, sequences the drives, restarts what crashed, ends in order.
//!
//! Links no service: it starts processes, by re-executing the binary it is part of or by a user's command.
//! That is what makes a swap of any of them possible by construction.
//!
//! The rooms, from what the user types down to what runs:
//! - [`cli`]: the command line as types.
//! - [`commands`]: what each command does, from its options to its exit code.
//! - [`conformance`] and `bench`: the two commands that are more than a page.
//! - [`runs`]: what a run needs around its pipeline: checks, folder, result, and how other terminals find it.
//! - [`pipeline`]: the processes of one run and the loop that joins them. [`pipeline::sequencer`] and
//!   [`pipeline::restart`] decide, and are pure; [`pipeline::process`] and `pipeline::main_loop` act.
//! - [`words`]: what is said to the user.
//!
//! A room uses those below it, and `pipeline` and `words` know no command.

pub mod bench;
pub mod cli;
pub mod commands;
pub mod conformance;
pub mod pipeline;
pub mod runs;
pub mod words;
