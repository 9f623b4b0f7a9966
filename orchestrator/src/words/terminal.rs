//! Output for the user, over streams that may be closed or full.

use std::collections::BTreeSet;
use std::io::{self, Write};
use std::sync::Mutex;

use crate::words::Failure;

/// Writes a line to standard output, from a function that returns a [`Failure`].
macro_rules! say {
    ($($words:tt)*) => { $crate::words::terminal::write_out(&format!($($words)*))? };
}

/// Writes a line to standard error if possible: a failure is no reason to stop anything.
macro_rules! tell {
    ($($words:tt)*) => { $crate::words::terminal::write_err(&format!($($words)*)) };
}

pub(crate) use {say, tell};

/// Writes a line to standard output. It is not an error if the reader has gone away.
pub(crate) fn write_out(line: &str) -> Result<(), Failure> {
    match writeln!(io::stdout(), "{line}") {
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => {
            Err(anyhow::Error::new(error).context("failed to write to standard output").into())
        }
        _ => Ok(()),
    }
}

/// Prints the result of a command.
///
/// # Errors
/// If it cannot be written to standard output.
pub fn print_line(line: &str) -> Result<(), Failure> {
    write_out(line)
}

/// Writes a line to standard error.
pub(crate) fn write_err(line: &str) {
    let _ = writeln!(io::stderr(), "{line}");
}

/// Writes a note to standard error, unless this process has told it already: what is read twice is told once.
pub(crate) fn tell_once(note: &str) {
    static TOLD: Mutex<BTreeSet<String>> = Mutex::new(BTreeSet::new());
    if TOLD.lock().is_ok_and(|mut told| told.insert(note.to_owned())) {
        write_err(&format!("pathtune: {note}"));
    }
}

/// Prints how a command failed: one line, whatever a file name or a foreign program put into it.
pub fn print_failure(failure: &Failure) {
    write_err(&format!("pathtune: {}", one_line(&failure.message())));
}

/// Prints a mistake on the command line: one line.
pub fn print_usage_error(error: &clap::Error) {
    let text = error.to_string();
    // The advice after the first paragraph is in --help.
    let first = text.split("\n\n").next().unwrap_or(&text);
    let first = first.strip_prefix("error: ").unwrap_or(first);
    write_err(&format!("pathtune: {}; see --help", one_line(first)));
}

fn one_line(text: &str) -> String {
    let mut line: String =
        text.chars().map(|c| if c.is_control() { ' ' } else { c }).take(LONGEST).collect();
    if line.len() < text.len() {
        line.push('…');
    }
    line.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// How many characters of a message are shown.
const LONGEST: usize = 3000;
