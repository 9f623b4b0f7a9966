//! Frames, signs, units and limits, by small movements; in lockstep and in real time.

use ipc_types::{Command, DriveRequest, Odometry};

use super::checks::Findings;
use super::protocol::{STANDS_MPS, apart_m, begins_well};
use super::realtime;
use super::stand::{Seen, Stand};
use crate::words::Failure;

/// Slow enough for a yard.
const SPEED_MPS: f64 = 1.5;
const LEFT_RAD: f64 = 0.2;
/// A vehicle slower than this has stopped, as far as one whose speed controller has an integral part ever does.
const CREEPS_MPS: f64 = 0.1;
/// A gear takes seconds to engage.
const PATIENCE_S: f64 = 10.0;

pub(super) fn to_drive(speed_mps: f64, steering_rad: f64) -> Command {
    Command { speed_mps, steering_rad, ..Command::default() }
}

/// All checks that move the vehicle, except the repeated drive.
pub(super) fn check(stand: &mut Stand, to: &mut Findings) -> Result<(), Failure> {
    if to.has_failed("waits") || to.has_failed("one_each") {
        return Ok(());
    }
    let Some(first) = stand.begin(1, 0)? else { return Ok(()) };
    let Some(moving) = until_it_moves(stand, to, first)? else { return Ok(()) };
    let straight = drive(stand, moving, 1.0, to_drive(SPEED_MPS, 0.0))?;
    judge_straight(stand, to, &straight);
    let left = drive(stand, last_of(straight), 1.5, to_drive(SPEED_MPS, LEFT_RAD))?;
    let turns_left = judge_left(stand, to, &left);
    let straight = drive(stand, last_of(left), 1.5, to_drive(SPEED_MPS, 0.0))?;
    // A heading that differs from the path's first, which may be 0. The wheels need half a second to straighten.
    let rolled = &straight[straight.len() / 2..];
    if turns_left {
        judge_straight(stand, to, rolled);
    }
    let limit_rad = stand.config.vehicle.steering_limit_rad;
    let sharp = drive(stand, last_of(straight), 1.5, to_drive(SPEED_MPS, 3.0 * limit_rad))?;
    let widest_rad = sharp.iter().map(|seen| seen.first().steering_rad.abs()).fold(0.0, f64::max);
    let seen = format!("{widest_rad:.3} rad, where {limit_rad:.3} is the limit");
    to.note("steering_limit", widest_rad <= limit_rad + 0.01, seen);
    let standing =
        until(stand, last_of(sharp), to_drive(0.0, 0.0), |it| it.speed_mps.abs() <= CREEPS_MPS)?;
    let speed_mps = standing.first().speed_mps;
    if to.note("stops", speed_mps.abs() <= CREEPS_MPS, format!("{speed_mps:.3} m/s")) {
        let backwards = drive(stand, standing, 1.0, to_drive(-1.0, 0.0))?;
        let least_mps =
            backwards.iter().map(|seen| seen.first().speed_mps).fold(f64::MAX, f64::min);
        let (along_m, _) = moved(&backwards);
        let seen = format!("{least_mps:.3} m/s, {along_m:.3} m");
        to.note("brakes_only", least_mps >= -STANDS_MPS && along_m >= -0.05, seen);
    }
    if stand.realtime { realtime::stops_on_its_own(stand, to) } else { ended_stands(stand, to) }
}

fn last_of(mut seen: Vec<Seen>) -> Seen {
    seen.pop().expect("what a drive began with")
}

fn drive(
    stand: &mut Stand,
    from: Seen,
    time_s: f64,
    command: Command,
) -> Result<Vec<Seen>, Failure> {
    stand.drive(from, stand.ticks_of(time_s), |_| command)
}

/// Drives on until a condition holds, for at most `PATIENCE_S`; returns the last odometry seen.
fn until(
    stand: &mut Stand,
    from: Seen,
    command: Command,
    holds: impl Fn(&Odometry) -> bool,
) -> Result<Seen, Failure> {
    let end = from.header.tick + stand.ticks_of(PATIENCE_S);
    let mut last = from;
    while !holds(&last.first()) && last.header.tick < end {
        let before = last.header.tick;
        last = last_of(stand.drive(last, 5, |_| command)?);
        if last.header.tick == before {
            break;
        }
    }
    Ok(last)
}

/// Drives until the vehicle moves; returns `None` if it does not.
pub(super) fn until_it_moves(
    stand: &mut Stand,
    to: &mut Findings,
    first: Seen,
) -> Result<Option<Seen>, Failure> {
    let from = first.header.tick;
    let moving = until(stand, first, to_drive(SPEED_MPS, 0.0), |it| it.speed_mps.abs() >= 0.5)?;
    let took_s = (moving.header.tick - from) as f64 * stand.config.drive.tick_s;
    let speed_mps = moving.first().speed_mps;
    let moves =
        to.note("moves", speed_mps.abs() >= 0.5, format!("{speed_mps:.2} m/s after {took_s:.1} s"));
    Ok(moves.then_some(moving))
}

/// How far the vehicle moved: along its first heading, and to the left of it.
fn moved(seen: &[Seen]) -> (f64, f64) {
    let (from, to) = (seen[0].first().measured, seen[seen.len() - 1].first().measured);
    let (x_m, y_m) = (to.x_m - from.x_m, to.y_m - from.y_m);
    let (sin, cos) = from.yaw_rad.sin_cos();
    (x_m * cos + y_m * sin, y_m * cos - x_m * sin)
}

/// The integral of a number over time.
fn summed(stand: &Stand, seen: &[Seen], number: impl Fn(&Odometry) -> f64) -> f64 {
    seen.windows(2)
        .map(|pair| {
            let ticks = (pair[1].header.tick - pair[0].header.tick) as f64;
            number(&pair[1].first()) * ticks * stand.config.drive.tick_s
        })
        .sum()
}

/// Whether two numbers agree to within a relative tolerance, or are both small.
fn agree(a: f64, b: f64, share: f64, small: f64) -> bool {
    (a - b).abs() <= share * a.abs().max(b.abs()) + small
}

fn judge_straight(stand: &Stand, to: &mut Findings, seen: &[Seen]) {
    let (along_m, left_m) = moved(seen);
    let seen_text = format!("{along_m:.3} m along its heading, {left_m:.3} m sideways");
    to.note("forward", along_m > 0.0 && left_m.abs() <= 0.2 * along_m + 0.02, seen_text);
    let rolled_m = summed(stand, seen, |it| it.speed_mps);
    let poses =
        seen.windows(2).map(|pair| apart_m(pair[0].first().measured, pair[1].first().measured));
    let moved_m: f64 = poses.sum();
    let seen_text =
        format!("{moved_m:.3} m according to the poses, {rolled_m:.3} m according to the speed");
    to.note("units_speed", agree(moved_m, rolled_m, 0.2, 0.05), seen_text);
}

/// Whether it turned left.
fn judge_left(stand: &Stand, to: &mut Findings, seen: &[Seen]) -> bool {
    let turned_rad =
        seen[seen.len() - 1].first().measured.yaw_rad - seen[0].first().measured.yaw_rad;
    let (along_m, left_m) = moved(seen);
    let seen_text = format!("{turned_rad:.3} rad, {left_m:.3} m to the left over {along_m:.3} m");
    if !to.note("steer_left", turned_rad > 0.01 && left_m > 0.0, seen_text) {
        return false;
    }
    let rates_rad = summed(stand, seen, |it| it.yaw_rate_radps);
    let seen_text = format!(
        "{turned_rad:.3} rad according to the yaw, {rates_rad:.3} rad according to the yaw rate"
    );
    to.note("units_yaw_rate", agree(turned_rad, rates_rad, 0.2, 0.02), seen_text);
    let wheelbase_m = stand.config.vehicle.wheelbase_m;
    // By displacement, not by the reported speed, which has a check of its own.
    let poses = seen.windows(2).map(|pair| {
        apart_m(pair[0].first().measured, pair[1].first().measured)
            * pair[1].first().steering_rad.tan()
            / wheelbase_m
    });
    let steered_rad: f64 = poses.sum();
    let seen_text = format!(
        "{turned_rad:.3} rad according to the yaw, {steered_rad:.3} rad according to the steering angle"
    );
    if !to.has_failed("units_speed") {
        to.note("units_steering", agree(turned_rad, steered_rad, 0.5, 0.05), seen_text);
    }
    true
}

/// A slot that has ended stands still while the other drives on.
fn ended_stands(stand: &mut Stand, to: &mut Findings) -> Result<(), Failure> {
    if stand.told().capacity < 2 {
        to.skip(&["ended_stands"], "drives only one vehicle, and is silent once that has ended");
        return Ok(());
    }
    let Some(first) = stand.begin(2, 0)? else { return Ok(()) };
    begins_well(stand, to, &first);
    let moving = until(stand, first, to_drive(SPEED_MPS, 0.0), |it| it.speed_mps >= 0.5)?;
    let end = Command { flags: Command::ENDED, ..Command::default() };
    stand.send_commands(stand.answer_to(moving.header), &[end, to_drive(SPEED_MPS, 0.0)])?;
    let Some(ended) = stand.next(super::stand::ANSWER)? else { return Ok(()) };
    let last = last_of(drive(stand, ended.clone(), 0.5, to_drive(3.0, 0.1))?);
    let crept_m = apart_m(ended.first().measured, last.first().measured);
    to.note("ended_stands", crept_m < 1e-6, format!("{crept_m:.3} m in half a second"));
    Ok(())
}

/// Sends the same request twice, if the vehicle claims to repeat its drives.
pub(super) fn repeats(stand: &mut Stand, to: &mut Findings, claimed: bool) -> Result<(), Failure> {
    if !claimed {
        to.skip(&["repeats"], "not claimed: --deterministic");
        return Ok(());
    }
    if to.has_failed("waits") || to.has_failed("one_each") {
        return Ok(());
    }
    let mut drives = Vec::new();
    for attempt in 0..2 {
        let first = if attempt == 0 {
            stand.begin(1, DriveRequest::NOISE)?
        } else {
            stand.reissue(DriveRequest::NOISE)?;
            stand.first(super::stand::ANSWER)?
        };
        let Some(first) = first else { return Ok(()) };
        let seen = stand.drive(first, 300, |_| to_drive(SPEED_MPS, 0.1))?;
        drives.push(seen.into_iter().map(|seen| seen.items).collect::<Vec<_>>());
    }
    let differs = drives[0].iter().zip(&drives[1]).position(|(one, other)| one != other);
    let same = differs.is_none() && drives[0].len() == drives[1].len();
    let seen = differs
        .map_or(format!("{} ticks", drives[0].len()), |tick| format!("differs at tick {tick}"));
    to.note("repeats", same, seen);
    Ok(())
}
