//! Lockstep: a recorder that is slower than the drive.

use std::time::Duration;

use ipc_types::{Command, Credit, DriveRequest};

use super::checks::Findings;
use super::stand::{ANSWER, Seen, Stand};
use crate::words::Failure;

/// Whether the vehicle waits for the credits of the recorder.
pub(super) fn check(stand: &mut Stand, to: &mut Findings) -> Result<(), Failure> {
    // A vehicle that counts otherwise has failed those checks already.
    if ["waits", "one_each", "ticks"].iter().any(|id| to.has_failed(id)) {
        return Ok(());
    }
    recorded(stand, to)?;
    logged(stand, to)
}

fn recorded(stand: &mut Stand, to: &mut Findings) -> Result<(), Failure> {
    let Some(first) = stand.begin(1, DriveRequest::RECORDED)? else {
        to.note(
            "credit_recorded",
            false,
            "no tick 0 before a credit, although the first 512 ticks need none",
        );
        return Ok(());
    };
    let Some(last) = stand.drive(first, Credit::AHEAD - 1, |_| Command::default())?.pop() else {
        return Ok(());
    };
    if last.header.tick != Credit::AHEAD - 1 {
        let seen = format!("fell silent after tick {}", last.header.tick);
        to.note("credit_recorded", false, seen);
        return Ok(());
    }
    // After the last tick that needs no credit.
    stand.answer(&last, Command::default())?;
    if !stand.is_silent()? {
        to.note("credit_recorded", false, format!("tick {} without a credit", Credit::AHEAD));
        return Ok(());
    }
    let header = stand.header;
    let mut of_another = header;
    of_another.attempt.attempt += 1;
    stand.send_credit(of_another, DriveRequest::RECORDED, 100)?;
    let attempt_is_quiet = stand.is_silent()?;
    stand.send_credit(header, DriveRequest::LOGGED, 100)?;
    let source_is_quiet = stand.is_silent()?;
    let seen = format!(
        "another attempt: silent {attempt_is_quiet}; another source: silent {source_is_quiet}"
    );
    if !to.note("credit_of_another", attempt_is_quiet && source_is_quiet, seen) {
        to.skip(&["credit_recorded"], "it accepts credits that are not meant for it");
        return Ok(());
    }
    stand.send_credit(header, DriveRequest::RECORDED, 3)?;
    let Some(next) = stand.next(ANSWER)? else {
        to.note("credit_recorded", false, "silent after a credit");
        return Ok(());
    };
    let seen = drive_to_its_end(stand, next)?;
    to.note("credit_recorded", seen == Credit::AHEAD + 2, format!("3 credits: up to tick {seen}"));
    Ok(())
}

/// Drives until the vehicle falls silent; returns its last tick.
fn drive_to_its_end(stand: &mut Stand, from: Seen) -> Result<u64, Failure> {
    let mut last = from;
    for _ in 0..10 {
        stand.answer(&last, Command::default())?;
        match stand.next(Duration::from_millis(150))? {
            Some(next) => last = next,
            None => break,
        }
    }
    Ok(last.header.tick)
}

fn logged(stand: &mut Stand, to: &mut Findings) -> Result<(), Failure> {
    stand.request(1, DriveRequest::LOGGED)?;
    if !stand.is_silent()? {
        to.note("credit_logged", false, "tick 0 before the first credit");
        return Ok(());
    }
    let header = stand.header;
    stand.send_credit(header, DriveRequest::LOGGED, 0)?;
    let first = stand.first(ANSWER)?;
    let seen =
        if first.is_some() { "tick 0 after the first credit" } else { "silent after a credit" };
    to.note("credit_logged", first.is_some(), seen);
    Ok(())
}
