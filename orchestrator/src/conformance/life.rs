//! Start, signs of life, restart and end.

use std::fs;
use std::time::Duration;

use ipc_types::Status;
use runtime::clock::now_ns;
use runtime::run::segments_of;

use super::checks::Findings;
use super::stand::{SILENCE, Stand};
use crate::pipeline::process::describe;
use crate::words::Failure;

const READY_WITHIN_NS: u64 = 5_000_000_000;
/// How long to wait for a late vehicle, so that the other checks can still be made.
const READY_AT_LAST: Duration = Duration::from_secs(12);
/// Signs of life are due every 100 ms, with a margin.
const GAP_NS: u64 = 400_000_000;
const ENDS_WITHIN: Duration = Duration::from_secs(5);

/// The first start. Returns whether the vehicle can be checked further.
pub(super) fn becomes_ready(stand: &mut Stand, to: &mut Findings) -> Result<bool, Failure> {
    stand.start()?;
    if !stand.wait(READY_AT_LAST, |stand| stand.beat.is_some())? {
        to.note("ready", false, stand.died.clone().unwrap_or("no Status in 12 s".to_owned()));
        return Ok(false);
    }
    let Some((header, status, _)) = stand.beat else { return Ok(false) };
    let took_ns = now_ns() - stand.started_ns;
    to.note("ready", took_ns <= READY_WITHIN_NS, format!("after {:.2} s", took_ns as f64 / 1e9));
    let is_vehicle = status.role == Status::VEHICLE && status.state == Status::READY;
    let is_of_run = header.attempt.is_of(stand.attachment.names.run);
    let run = header.attempt.run;
    let seen = format!("role {}, state {}, run {run:016x}", status.role, status.state);
    to.note("role", is_vehicle && is_of_run, seen);
    to.note(
        "incarnation",
        status.incarnation == 1,
        format!("{} at the first start", status.incarnation),
    );
    let capacity = status.capacity;
    to.note("capacity", (1..=256).contains(&capacity), capacity.to_string());
    stand.pass(Duration::from_millis(1200))?;
    let heard = stand.heard.len();
    to.note("quiet_at_first", heard == 0, format!("{heard} odometry messages"));
    stand.heard.clear();
    Ok(true)
}

/// Kills the vehicle in the middle of a drive, and starts it again.
pub(super) fn restarts(stand: &mut Stand, to: &mut Findings) -> Result<(), Failure> {
    if stand.process.is_none() || stand.begin(1, 0)?.is_none() {
        return Ok(());
    }
    if stand.realtime {
        // Far enough into the drive that a new beginning can be told from a continuation.
        stand.pass(Duration::from_millis(300))?;
    }
    stand.note_open_gap();
    stand.kill()?;
    stand.start()?;
    let ready = stand.wait(READY_AT_LAST, |stand| stand.beat.is_some())?;
    let took_ns = now_ns() - stand.started_ns;
    let incarnation = stand.told().incarnation;
    let seen = match &stand.died {
        Some(died) => died.clone(),
        None => format!("after {:.2} s, incarnation {incarnation}", took_ns as f64 / 1e9),
    };
    let in_time = took_ns <= READY_WITHIN_NS && (incarnation == 2 || to.has_failed("incarnation"));
    // A late vehicle is late at every start, and has failed the check `ready` for it.
    if !to.note("restart", ready && (in_time || to.has_failed("ready")), seen) {
        return Ok(());
    }
    if !stand.realtime {
        stand.reissue(0)?;
    }
    let first = stand.first(Duration::from_secs(2))?;
    let Some(first) = first else {
        to.note("joins", false, "no odometry");
        return Ok(());
    };
    let (tick, expected) = (
        first.header.tick,
        if stand.realtime { by_time(stand, first.header.odometry_sent_ns) } else { 0 },
    );
    let near = if stand.realtime { 5 } else { 0 };
    let seen =
        format!("attempt {}, tick {tick}, where {expected} is due", first.header.attempt.attempt);
    to.note("joins", tick.abs_diff(expected) <= near, seen);
    Ok(())
}

/// The tick that is due at a given time, in a drive that a restarted vehicle joins.
fn by_time(stand: &Stand, now_ns: u64) -> u64 {
    let tick_ns = stand.config.drive.tick_s * 1e9;
    (now_ns.saturating_sub(stand.header.sent_ns) as f64 / tick_ns) as u64
}

/// Sends SIGINT, and looks for what the vehicle leaves behind.
pub(super) fn ends(stand: &mut Stand, to: &mut Findings) -> Result<(), Failure> {
    stand.pump()?;
    stand.note_open_gap();
    match stand.longest_gap_ns {
        Some(gap_ns) => {
            let seen = format!("longest gap {} ms", gap_ns / 1_000_000);
            to.note("signs_of_life", gap_ns <= GAP_NS, seen);
        }
        None if stand.process.is_some() => {
            to.note("signs_of_life", false, "none at all");
        }
        None => {}
    }
    let died = stand.died.clone();
    to.note("stays_alive", died.is_none(), died.unwrap_or("to the end".to_owned()));
    let Some(mut process) = stand.process.take() else { return Ok(()) };
    let pid = process.id();
    let asked_ns = now_ns();
    process.interrupt();
    let mut ended = None;
    while ended.is_none() && now_ns() - asked_ns < ENDS_WITHIN.as_nanos() as u64 {
        ended = process.try_wait();
        std::thread::sleep(Duration::from_millis(2));
    }
    let took_s = (now_ns() - asked_ns) as f64 / 1e9;
    match ended {
        Some(status) => {
            to.note("exit", status.success(), format!("{} after {took_s:.2} s", describe(status)));
        }
        None => {
            to.note("exit", false, "still alive after 5 s");
        }
    }
    std::thread::sleep(SILENCE);
    if ended.is_some() {
        let left = process.survivors();
        to.note("no_processes", left.is_empty(), format!("{} left {left:?}", left.len()));
        if left.is_empty() {
            let left = leftovers(stand, pid);
            to.note("no_leftovers", left.is_empty(), format!("{} left {left:?}", left.len()));
        }
    }
    process.kill();
    Ok(())
}

/// Names of segments and node files that a process left behind.
fn leftovers(stand: &Stand, pid: u32) -> Vec<String> {
    let names = &stand.attachment.names;
    let nodes = fs::read_dir(names.root.join("nodes")).into_iter().flatten().flatten();
    let nodes = nodes.filter_map(|entry| entry.file_name().into_string().ok());
    segments_of(names.run)
        .into_iter()
        .chain(nodes)
        .filter(|name| runtime::cleanup::carries_pid(name, pid))
        // Shared with the processes at the other end, which are still alive.
        .filter(|name| !name.ends_with(".dynamic") && !name.ends_with(".connection"))
        .collect()
}
