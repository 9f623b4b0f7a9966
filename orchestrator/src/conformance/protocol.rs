//! What a vehicle answers: requests, commands that are meant for it, and commands that are not. The vehicle does not
//! move.

use std::time::Duration;

use ipc_types::{Attempt, Command, Odometry, TickHeader, WirePose, has};

use super::checks::Findings;
use super::stand::{ANSWER, MAX_SLOTS, SILENCE, Seen, Stand};
use crate::words::Failure;

/// How near its start a vehicle must stand: a real one is put there by hand.
const NEAR_M: f64 = 0.5;
const NEAR_RAD: f64 = 0.1;
/// A vehicle slower than this stands still.
pub(super) const STANDS_MPS: f64 = 0.05;

/// The first request. Returns whether the other checks can be made.
pub(super) fn begins(stand: &mut Stand, to: &mut Findings) -> Result<bool, Failure> {
    stand.request(1, 0)?;
    let Some(first) = stand.next(Duration::from_secs(2))? else {
        to.note(
            "answers_request",
            false,
            stand.died.clone().unwrap_or("no answer in 2 s".to_owned()),
        );
        return Ok(false);
    };
    let waited_ms = first.heard_ns.saturating_sub(stand.header.sent_ns) / 1_000_000;
    to.note("answers_request", true, format!("after {waited_ms} ms"));
    let (header, wanted) = (first.header, stand.header);
    let (named, asked) = (header.attempt, wanted.attempt);
    let names_batch = to.note(
        "names_batch",
        (named.run, named.batch) == (asked.run, asked.batch),
        format!("run {:016x}, batch {}", named.run, named.batch),
    );
    let seen = format!("{} of {}", named.attempt, asked.attempt);
    let names_attempt = to.note("names_attempt", named.attempt == asked.attempt, seen);
    let stamped = header.odometry_sent_ns >= wanted.sent_ns && header.applied_ns == 0;
    let seen = format!("sent {}, applied {}", header.odometry_sent_ns, header.applied_ns);
    to.note("first_stamps", stamped, seen);
    begins_well(stand, to, &first);
    Ok(names_batch && names_attempt)
}

/// What must hold for the first odometry of each drive.
pub(super) fn begins_well(stand: &Stand, to: &mut Findings, first: &Seen) {
    let tick = first.header.tick;
    to.note("tick_zero", tick == 0, format!("tick {tick}"));
    for (index, item) in first.items.iter().enumerate() {
        let (at, start) = (item.measured, stand.start_of(index));
        let apart_m = apart_m(at, start);
        let turned_rad = (at.yaw_rad - start.yaw_rad).abs();
        let is_near = apart_m <= NEAR_M && turned_rad <= NEAR_RAD;
        let seen = format!("slot {index}: {apart_m:.3} m and {turned_rad:.3} rad off");
        to.note("start_pose", is_near, seen);
        let rests = item.speed_mps.abs() <= STANDS_MPS && item.yaw_rate_radps.abs() <= STANDS_MPS;
        let seen = format!("slot {index}: {:.3} m/s", item.speed_mps);
        to.note("at_rest", rests, seen);
    }
}

pub(super) fn apart_m(a: WirePose, b: WirePose) -> f64 {
    (a.x_m - b.x_m).hypot(a.y_m - b.y_m)
}

/// The checks of lockstep.
pub(super) fn check(stand: &mut Stand, to: &mut Findings) -> Result<(), Failure> {
    let Some(first) = stand.begin(1, 0)? else { return Ok(()) };
    let waits = stand.is_silent()?;
    if !to.note("waits", waits, if waits { "silent" } else { "odometry without a command" }) {
        return Ok(());
    }
    stand.answer(&first, Command::default())?;
    let next = stand.next(ANSWER)?;
    stand.pass(SILENCE)?;
    let more = stand.heard.len();
    let answers = usize::from(next.is_some()) + more;
    let (Some(next), true) =
        (next, to.note("one_each", answers == 1, format!("{answers} for one command")))
    else {
        return Ok(());
    };
    counts(stand, to, next)?;
    let dropped_before = stand.told().dropped;
    let mut dropped = 0;
    for (id, spoil) in SPOILT {
        let Some(first) = stand.begin(1, 0)? else { return Ok(()) };
        let Some(last) = stand.drive(first, 3, |_| Command::default())?.pop() else {
            return Ok(());
        };
        let (header, commands) = spoil(stand.answer_to(last.header));
        stand.send_commands(header, &vec![Command::default(); commands])?;
        let silent = stand.is_silent()?;
        let seen = if silent { "silent" } else { "obeyed" };
        dropped += u64::from(to.note(id, silent, seen));
        if silent {
            // A valid command is still obeyed.
            stand.answer(&last, Command::default())?;
            if stand.next(ANSWER)?.is_none() {
                to.note(id, false, "silent after a valid command, too");
            }
        }
    }
    let (_, rose) =
        stand.wait_for_count(dropped_before + dropped.max(1) - 1, |told| told.dropped)?;
    let rose = if dropped > 1 { rose + dropped - 1 } else { rose };
    to.note("counts_dropped", rose >= dropped, format!("{rose} of {dropped}"));
    not_finite(stand, to)?;
    ended(stand, to)?;
    begins_anew(stand, to)?;
    fleet(stand, to)
}

/// The header with its attempt changed.
fn of(mut header: TickHeader, change: impl FnOnce(&mut Attempt)) -> TickHeader {
    change(&mut header.attempt);
    header
}

/// Turns a good header into a bad one, and gives the number of elements to send with it.
pub(super) type Spoil = fn(TickHeader) -> (TickHeader, usize);

/// Commands, for a drive of one slot, that must not be obeyed.
pub(super) const SPOILT: [(&str, Spoil); 7] = [
    ("drops_run", |header| (of(header, |attempt| attempt.run ^= 2), 1)),
    ("drops_batch", |header| (of(header, |attempt| attempt.batch -= 1), 1)),
    ("drops_attempt", |header| (of(header, |attempt| attempt.attempt += 1), 1)),
    ("drops_old_tick", |header| (TickHeader { tick: header.tick - 1, ..header }, 1)),
    ("drops_old_tick", |header| (TickHeader { tick: 0, ..header }, 1)),
    ("drops_early_tick", |header| (TickHeader { tick: header.tick + 1, ..header }, 1)),
    ("drops_length", |header| (header, 2)),
];

/// Ticks and stamps over a number of commands.
fn counts(stand: &mut Stand, to: &mut Findings, from: Seen) -> Result<(), Failure> {
    let seen = stand.drive(from, 100, |_| Command::default())?;
    let mut wrong = None;
    for pair in seen.windows(2) {
        let (before, now) = (&pair[0], &pair[1]);
        if now.header.tick != before.header.tick + 1 {
            wrong.get_or_insert(format!("{} after {}", now.header.tick, before.header.tick));
        }
        let applied_ns = now.header.applied_ns;
        let is_between = applied_ns >= before.heard_ns && applied_ns <= now.header.odometry_sent_ns;
        let seen = format!(
            "tick {}: {applied_ns}, which must lie between {} and {}",
            now.header.tick, before.heard_ns, now.header.odometry_sent_ns
        );
        to.note("applied", is_between, seen);
    }
    let seen_ticks = seen.len() - 1;
    if wrong.is_none() && seen_ticks < 100 {
        wrong = Some(format!("silent after {seen_ticks} commands"));
    }
    to.note("ticks", wrong.is_none(), wrong.unwrap_or("100 in a row".to_owned()));
    Ok(())
}

/// A command that is not finite; in both modes.
pub(super) fn not_finite(stand: &mut Stand, to: &mut Findings) -> Result<(), Failure> {
    let Some(first) = stand.begin(1, 0)? else { return Ok(()) };
    let before = stand.told().rejected;
    stand.answer(&first, Command { speed_mps: f64::NAN, ..Command::default() })?;
    match stand.next(ANSWER)? {
        Some(next) => {
            let speed_mps = next.first().speed_mps;
            to.note(
                "not_finite",
                speed_mps.abs() <= STANDS_MPS,
                format!("{speed_mps:.3} m/s after it"),
            );
        }
        None => {
            to.note(
                "not_finite",
                false,
                stand.died.clone().unwrap_or("silent after it".to_owned()),
            );
        }
    }
    let (rose, count) = stand.wait_for_count(before, |told| told.rejected)?;
    to.note("counts_rejected", rose, count.to_string());
    Ok(())
}

fn ended(stand: &mut Stand, to: &mut Findings) -> Result<(), Failure> {
    let slots = stand.told().capacity.min(2) as usize;
    let Some(first) = stand.begin(slots, 0)? else { return Ok(()) };
    let end = Command { flags: Command::ENDED, ..Command::default() };
    let mut last = first;
    if slots == 2 {
        stand.send_commands(stand.answer_to(last.header), &[end, Command::default()])?;
        let Some(next) = stand.next(ANSWER)? else {
            to.note("ended_flag", false, "silent, although one slot drives on");
            return Ok(());
        };
        if next.items.len() == 2 {
            let flags: Vec<bool> =
                next.items.iter().map(|item| has(item.status, Odometry::ENDED)).collect();
            to.note("ended_flag", flags == [true, false], format!("{flags:?} of [true, false]"));
        }
        last = next;
    } else {
        to.skip(&["ended_flag"], "drives only one vehicle, and is silent once that has ended");
    }
    stand.answer(&last, end)?;
    let silent = stand.is_silent()?;
    to.note("over_is_silent", silent, if silent { "silent" } else { "odometry after the end" });
    Ok(())
}

/// A request during a drive, and another attempt; in both modes.
pub(super) fn begins_anew(stand: &mut Stand, to: &mut Findings) -> Result<(), Failure> {
    let Some(first) = stand.begin(1, 0)? else { return Ok(()) };
    stand.drive(first, 5, |_| Command::default())?;
    let first = stand.begin(1, 0)?;
    let seen = first.as_ref().map_or("nothing of the new batch".to_owned(), |first| {
        format!("tick {} of the new batch", first.header.tick)
    });
    let Some(first) =
        first.filter(|_| to.note("interrupts", !seen.starts_with("nothing"), seen.clone()))
    else {
        return Ok(());
    };
    begins_well(stand, to, &first);
    stand.drive(first, 5, |_| Command::default())?;
    stand.reissue(0)?;
    let first = stand.first(Duration::from_secs(2))?;
    let begins = first.as_ref().is_some_and(|first| first.header.tick == 0);
    let seen = first.map_or("nothing of attempt 2".to_owned(), |first| {
        format!("tick {} of attempt {}", first.header.tick, first.header.attempt.attempt)
    });
    to.note("reissue", begins, seen);
    Ok(())
}

/// As many slots as fit; in both modes.
pub(super) fn fleet(stand: &mut Stand, to: &mut Findings) -> Result<(), Failure> {
    let slots = (stand.told().capacity as usize).min(MAX_SLOTS);
    let Some(first) = stand.begin(slots, 0)? else {
        to.note("fleet", false, format!("no answer to a request for {slots} slots"));
        return Ok(());
    };
    let is_there =
        |(index, item): (usize, &Odometry)| apart_m(item.measured, stand.start_of(index)) <= NEAR_M;
    // The check `elements` covers how many there are, and `start_pose` where the first one stands.
    let there = first.items.iter().enumerate().filter(|it| is_there(*it)).count();
    let fits = there + 1 >= first.items.len()
        && (there == first.items.len() || to.has_failed("start_pose"));
    to.note("fleet", fits, format!("{there} of {slots} at their starts"));
    Ok(())
}

/// Publishers that disappear and come back in the middle of a drive.
pub(super) fn goes_on_behind_a_restart(
    stand: &mut Stand,
    to: &mut Findings,
) -> Result<(), Failure> {
    if stand.process.is_none() {
        return Ok(());
    }
    let Some(first) = stand.begin(1, 0)? else { return Ok(()) };
    begins_well(stand, to, &first);
    let Some(last) = stand.drive(first, 5, |_| Command::default())?.pop() else { return Ok(()) };
    stand.replace_publishers()?;
    stand.pass(SILENCE)?;
    let newest = stand.heard.pop_back().unwrap_or(last);
    stand.heard.clear();
    stand.answer(&newest, Command::default())?;
    let command_is_heard = stand.next(ANSWER)?.is_some();
    stand.reissue(0)?;
    let request_is_heard = stand.first(Duration::from_secs(2))?.is_some();
    let seen = format!("command heard: {command_is_heard}, request heard: {request_is_heard}");
    to.note("new_publishers", command_is_heard && request_is_heard, seen);
    Ok(())
}

/// Reports what was noted of all odometry.
pub(super) fn sum_up(stand: &Stand, to: &mut Findings) {
    let odd = &stand.oddities;
    if odd.heard == 0 {
        return;
    }
    let found = |it: &Option<String>| it.clone().unwrap_or(format!("{} messages", odd.heard));
    to.note("finite", odd.not_finite.is_none(), found(&odd.not_finite));
    to.note("elements", odd.elements.is_none(), found(&odd.elements));
    to.note("stamps", odd.stamps.is_none(), found(&odd.stamps));
}
