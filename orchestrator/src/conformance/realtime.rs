//! A vehicle that paces by the clock.

use std::time::Duration;

use ipc_types::{Command, Odometry, TickHeader};

use super::checks::Findings;
use super::motion::{to_drive, until_it_moves};
use super::protocol::{self, SPOILT, STANDS_MPS};
use super::stand::{ANSWER, Seen, Stand};
use crate::words::Failure;

/// The checks that do not move the vehicle.
pub(super) fn check(stand: &mut Stand, to: &mut Findings) -> Result<(), Failure> {
    paces(stand, to)?;
    let Some(stale) = goes_stale(stand, to)? else { return Ok(()) };
    drops(stand, to, stale)?;
    protocol::not_finite(stand, to)?;
    ends(stand, to)?;
    protocol::begins_anew(stand, to)?;
    protocol::fleet(stand, to)
}

/// On a busy machine a correct vehicle may be late; a faulty one is late every time.
const TRIES: u32 = 5;

/// Rate, regularity, and ticks that follow the clock.
fn paces(stand: &mut Stand, to: &mut Findings) -> Result<(), Failure> {
    for left in (0..TRIES).rev() {
        let Some(first) = stand.begin(1, 0)? else { return Ok(()) };
        let seen = stand.drive(first, stand.ticks_of(2.0), |_| Command::default())?;
        let pace = SeenPacing::new(stand, &seen);
        if pace.is_good() || left == 0 {
            pace.note(to);
            break;
        }
    }
    Ok(())
}

/// How a vehicle paced, in ticks.
struct SeenPacing {
    heard: usize,
    due: f64,
    gaps: Vec<f64>,
    falls: Option<String>,
    most_off: f64,
}

impl SeenPacing {
    fn new(stand: &Stand, seen: &[Seen]) -> Self {
        let tick_ns = stand.config.drive.tick_s * 1e9;
        let from = &seen[0].header;
        let since = |seen: &Seen| {
            seen.header.odometry_sent_ns.saturating_sub(from.odometry_sent_ns) as f64 / tick_ns
        };
        let mut gaps: Vec<f64> =
            seen.windows(2).map(|pair| since(&pair[1]) - since(&pair[0])).collect();
        gaps.sort_by(f64::total_cmp);
        let falls = seen.windows(2).find(|pair| pair[1].header.tick <= pair[0].header.tick);
        let off = |seen: &Seen| (seen.header.tick as f64 - from.tick as f64 - since(seen)).abs();
        Self {
            heard: seen.len() - 1,
            due: since(&seen[seen.len() - 1]),
            falls: falls
                .map(|pair| format!("{} after {}", pair[1].header.tick, pair[0].header.tick)),
            most_off: seen.iter().map(off).fold(0.0, f64::max),
            gaps,
        }
    }

    fn keeps_rate(&self) -> bool {
        self.heard > 5 && (0.8..1.2).contains(&(self.heard as f64 / self.due.max(1.0)))
    }

    /// Nine of ten gaps are below this.
    fn wide_gap(&self) -> f64 {
        self.gaps.get(self.gaps.len() * 9 / 10).copied().unwrap_or(f64::INFINITY)
    }

    fn is_good(&self) -> bool {
        self.keeps_rate() && self.wide_gap() < 2.5 && self.falls.is_none() && self.most_off <= 3.0
    }

    fn note(&self, to: &mut Findings) {
        let seen = format!("{} in {:.1} ticks", self.heard, self.due);
        if !to.note("rate", self.keeps_rate(), seen) {
            return;
        }
        let wide = self.wide_gap();
        to.note("jitter", wide < 2.5, format!("nine of ten gaps below {wide:.2} ticks"));
        let seen = self.falls.clone().unwrap_or("rising".to_owned());
        to.note("ticks", self.falls.is_none(), seen);
        let seen = format!("at most {:.1} ticks off", self.most_off);
        to.note("tick_by_time", self.most_off <= 3.0, seen);
    }
}

/// Without commands, the vehicle must report its own stop. Returns the newest odometry then.
fn goes_stale(stand: &mut Stand, to: &mut Findings) -> Result<Option<Seen>, Failure> {
    let Some(first) = stand.begin(1, 0)? else { return Ok(None) };
    let fresh = stand.drive(first, 50, |_| Command::default())?;
    let told = fresh.iter().skip(10).filter(|seen| seen.has(Odometry::OWN_STOP)).count();
    if told * 2 > fresh.len() {
        to.note(
            "own_stop",
            false,
            format!("{told} of {} report it although commands are fresh", fresh.len()),
        );
        return Ok(None);
    }
    let stale = after_silence(stand)?;
    let is_told = stale.as_ref().is_some_and(|seen| seen.has(Odometry::OWN_STOP));
    let text = if stale.is_some() {
        "reported after command_age_limit_s"
    } else {
        "no odometry without commands"
    };
    let text =
        if is_told || stale.is_none() { text } else { "not reported after command_age_limit_s" };
    Ok(if to.note("own_stop", is_told, text) { stale } else { None })
}

/// The newest odometry when no command has come for long enough.
fn after_silence(stand: &mut Stand) -> Result<Option<Seen>, Failure> {
    let limit_s = stand.config.vehicle.safety.command_age_limit_s;
    stand.pass(Duration::from_secs_f64(limit_s) + 10 * stand.tick())?;
    stand.heard.clear();
    stand.next(ANSWER)
}

/// A command that is not meant for the vehicle does not end its own stop; a fresh one that is does.
fn drops(stand: &mut Stand, to: &mut Findings, mut newest: Seen) -> Result<(), Failure> {
    let dropped_before = stand.told().dropped;
    let mut dropped = 0;
    // A stale tick cannot be recognised here: the newest command counts, whichever tick it answers.
    let spoilt = SPOILT.iter().filter(|(id, _)| !id.ends_with("_tick"));
    for (id, spoil) in spoilt {
        let mut holds = true;
        for _ in 0..5 {
            let (header, elements) = spoil(stand.answer_to(newest.header));
            stand.send_commands(header, &vec![Command::default(); elements])?;
            let Some(next) = stand.next(ANSWER)? else { return Ok(()) };
            holds &= next.has(Odometry::OWN_STOP);
            newest = next;
        }
        let text = if holds { "the own stop goes on" } else { "accepted as a fresh command" };
        dropped += 5 * u64::from(to.note(id, holds, text));
        if let Some(next) = after_silence(stand)? {
            newest = next;
        }
    }
    let wanted = dropped_before + dropped.max(1) - 1;
    let (rose, _) = stand.wait_for_count(wanted, |told| told.dropped)?;
    to.note(
        "counts_dropped",
        rose,
        format!("{} of {dropped}", stand.told().dropped - dropped_before),
    );

    let late_before = stand.told().late;
    let age_ns = (10e9 * stand.config.vehicle.safety.command_age_limit_s) as u64;
    let Some(newest) = after_silence(stand)? else { return Ok(()) };
    let header = stand.answer_to(newest.header);
    let old = TickHeader { supervisor_sent_ns: header.supervisor_sent_ns - age_ns, ..header };
    stand.send_commands(old, &[Command::default()])?;
    stand.pass(3 * stand.tick())?;
    stand.heard.clear();
    let stays = stand.next(ANSWER)?.is_some_and(|seen| seen.has(Odometry::OWN_STOP));
    let (rose, count) = stand.wait_for_count(late_before, |told| told.late)?;
    to.note(
        "counts_late",
        rose && stays,
        format!("counted {count}, the own stop goes on: {stays}"),
    );

    let Some(newest) = after_silence(stand)? else { return Ok(()) };
    let fresh = stand.drive(newest, 20, |_| Command::default())?;
    let resumed = fresh.iter().any(|seen| !seen.has(Odometry::OWN_STOP));
    to.note("resumes", resumed, if resumed { "OWN_STOP is cleared" } else { "OWN_STOP stays set" });
    Ok(())
}

/// After ENDED the vehicle reports it, and goes on publishing.
fn ends(stand: &mut Stand, to: &mut Findings) -> Result<(), Failure> {
    let Some(first) = stand.begin(1, 0)? else { return Ok(()) };
    let end = Command { flags: Command::ENDED, ..Command::default() };
    let seen = stand.drive(first, 20, |_| end)?;
    let is_told = seen[seen.len() - 1].has(Odometry::ENDED);
    to.note(
        "ended_flag",
        is_told,
        if is_told { "ENDED is reported" } else { "ENDED is not reported" },
    );
    stand.heard.clear();
    let goes_on = stand.next(ANSWER)?.is_some();
    to.note("goes_on", goes_on, if goes_on { "goes on publishing" } else { "silent after ENDED" });
    Ok(())
}

/// At speed, and then without commands.
pub(super) fn stops_on_its_own(stand: &mut Stand, to: &mut Findings) -> Result<(), Failure> {
    if to.has_failed("own_stop") {
        return Ok(());
    }
    let Some(first) = stand.begin(1, 0)? else { return Ok(()) };
    let Some(moving) = until_it_moves(stand, to, first)? else { return Ok(()) };
    let turning = stand.drive(moving, stand.ticks_of(1.0), |_| to_drive(1.5, 0.2))?;
    let from_mps = turning[turning.len() - 1].first().speed_mps;
    let limits = stand.config.vehicle.safety;
    let time_s = limits.command_age_limit_s + from_mps / limits.stop_deceleration_mps2;
    stand.pass(Duration::from_secs_f64(1.5 * time_s + 1.0))?;
    let seen: Vec<Seen> =
        stand.heard.drain(..).filter(|seen| seen.has(Odometry::OWN_STOP)).collect();
    let Some(last) = seen.last() else { return Ok(()) };
    // Each measured over several ticks: one tick may carry the share of another.
    let hardest = seen.iter().zip(seen.iter().skip(20)).map(|(before, after)| {
        let time_s = (after.header.tick - before.header.tick) as f64 * stand.config.drive.tick_s;
        (before.first().speed_mps - after.first().speed_mps) / time_s
    });
    let hardest_mps2 = hardest.fold(0.0, f64::max);
    let (speed_mps, steering_rad) = (last.first().speed_mps, last.first().steering_rad);
    let stands = speed_mps.abs() <= STANDS_MPS && steering_rad.abs() <= 0.02;
    let text = format!(
        "from {from_mps:.2} to {speed_mps:.2} m/s by at most {hardest_mps2:.2} m/s², wheels at {steering_rad:.2} rad"
    );
    to.note("own_stop_slows", stands && hardest_mps2 <= 1.2 * limits.stop_deceleration_mps2, text);
    Ok(())
}
