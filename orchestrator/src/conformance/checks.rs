//! All checks in one table, and what was found.

use std::collections::BTreeMap;

use serde::Serialize;

/// One check of a vehicle.
pub(super) struct Check {
    pub(super) id: &'static str,
    pub(super) name: &'static str,
    /// What to do if it fails.
    pub(super) mend: &'static str,
}

macro_rules! checks {
    ($($id:literal, $name:literal, $mend:literal;)+) => {
        /// Every check, in the order in which it is reported.
        pub(super) const CHECKS: &[Check] = &[$(Check { id: $id, name: $name, mend: $mend }),+];
    };
}

checks! {
    "ready", "ready within 5 s of its start",
        "publish the first Status as soon as all ports exist; do slow work after it";
    "role", "Status names the vehicle's role, READY and this run",
        "fill role = 1, state = 1, and the header's run from PATHTUNE_RUN";
    "incarnation", "Status echoes PATHTUNE_INCARNATION", "copy PATHTUNE_INCARNATION into Status.incarnation";
    "capacity", "capacity is between 1 and 256", "set Status.capacity to the number of vehicles that one message may carry";
    "pacing", "pacing has only known bits, and REAL_TIME if and only if the run is to be paced by the clock",
        "set REAL_TIME (1) in Status.pacing if the clock paces the vehicle, and not otherwise";
    "quiet_at_first", "silent before the first request", "publish odometry only after a DriveRequest";
    "signs_of_life", "gives a sign of life at least every 100 ms, with a margin of 300 ms",
        "send Status every 100 ms, also during a drive and while no messages arrive";
    "answers_request", "answers a request with odometry within 2 s", "publish tick 0 after each DriveRequest";
    "tick_zero", "a drive begins with tick 0", "count ticks from 0 after each DriveRequest";
    "names_batch", "odometry names the run and batch of the request", "copy attempt.run and attempt.batch of the request into the TickHeader";
    "names_attempt", "odometry names the attempt of the request", "copy the whole attempt of the request's header into the TickHeader";
    "elements", "one element for each slot, in every odometry message", "publish as many elements as the request holds";
    "start_pose", "the tracked point stands at the request's start",
        "reset on each request; poses are those of the tracked point, in metres and radians of the map frame";
    "at_rest", "a drive begins at rest", "set speed and yaw rate to 0 on each request";
    "finite", "all numbers are finite, and reserved fields are 0", "write every field of each element; loaned memory holds old data";
    "first_stamps", "tick 0 carries odometry_sent_ns, and its applied_ns is 0",
        "stamp with CLOCK_MONOTONIC just before sending; applied_ns is 0 until a command has been applied";
    "waits", "lockstep: no odometry without a command", "publish the next tick only in answer to a command";
    "one_each", "lockstep: one odometry message for each command", "publish exactly once for each command";
    "ticks", "ticks rise one by one in lockstep, and never fall in real time", "count one tick for each odometry message";
    "stamps", "odometry_sent_ns rises, and lies in the past", "stamp with CLOCK_MONOTONIC just before sending";
    "applied", "applied_ns lies between the command and the odometry that follows it",
        "take the time when the command is applied, and send it with the next odometry";
    "drops_run", "a command of another run is dropped", "compare the header's run";
    "drops_batch", "a command of another batch is dropped", "compare the header's batch";
    "drops_attempt", "a command of another attempt is dropped", "compare the header's attempt";
    "drops_old_tick", "lockstep: a stale or repeated command is dropped", "obey only a command for the tick published last";
    "drops_early_tick", "lockstep: a command of a later tick is dropped", "obey only a command for the tick published last";
    "drops_length", "a command with another number of elements is dropped", "compare the number of elements with that of the request";
    "counts_dropped", "dropped messages are counted", "count every dropped message in Status.dropped";
    "not_finite", "a command that is not finite means stop", "treat a command that is not finite as speed 0, and go on";
    "counts_rejected", "commands that are not finite are counted", "count commands that are not finite in Status.rejected";
    "ended_flag", "a slot whose command has ENDED reports it, and the other slots do not",
        "set ENDED (4) in the slot's odometry after a command with ENDED (1)";
    "ended_stands", "lockstep: an ended slot stands still, whatever its commands", "ignore commands for a slot that has ended";
    "over_is_silent", "lockstep: silent when all slots have ended", "publish nothing after the command that ends the last slot";
    "interrupts", "a request ends the drive under way", "look for requests during a drive, too";
    "reissue", "another attempt starts from the beginning", "reset and count from 0 even if only the attempt differs";
    "repeats", "the same request gives the same drive, bit for bit, if the vehicle claims so",
        "let nothing but the request and the commands determine the drive, or do not claim it";
    "fleet", "a fleet up to its capacity, each slot at its own start", "drive up to as many slots as the capacity, in the request's order";
    "credit_recorded", "lockstep: waits for the credits of a RECORDED batch",
        "publish tick k only if the credit's ticks + 512 > k";
    "credit_of_another", "credits of another batch or source change nothing", "compare the batch, attempt and source of a Credit";
    "credit_logged", "lockstep: a LOGGED batch waits for its first credit", "hold tick 0 back until that source's first Credit";
    "new_publishers", "goes on after a restart of the supervisor and the orchestrator",
        "keep the ports; do not tie the drive to one publisher";
    "moves", "moves within 10 s of a speed command", "obey the command's speed_mps, in metres per second";
    "forward", "drives along its heading", "x grows along the heading: REP-103, yaw in radians counter-clockwise from x";
    "units_speed", "displacement equals speed times time", "report speed_mps in metres per second, and poses in metres";
    "steer_left", "a positive steering angle turns left: yaw rises, y grows", "steering and yaw are positive to the left";
    "units_yaw_rate", "the yaw rate is the rate at which yaw changes", "report yaw_rate_radps in radians per second, positive to the left";
    "units_steering", "the yaw rate is v·tan(steering)/wheelbase, to within half of it",
        "steering_rad is the angle of the road wheels in radians; check vehicle.wheelbase_m";
    "steering_limit", "the steering angle stays within its limit", "limit it to vehicle.steering_limit_rad";
    "stops", "stops at speed 0", "brake to a standstill at speed 0";
    "brakes_only", "a negative speed only brakes", "never drive backwards";
    "rate", "real time: odometry at the rate of drive.tick_s", "publish every drive.tick_s, paced by your own clock";
    "jitter", "real time: nine of ten gaps below 2.5 ticks", "wait until the next tick is due, not for a fixed time";
    "tick_by_time", "real time: the tick is the time since tick 0", "compute it from the clock, and skip missed ticks";
    "own_stop", "real time: OWN_STOP without a fresh command", "set OWN_STOP (8) once the command is older than command_age_limit_s";
    "own_stop_slows", "real time: the vehicle's own stop is straight, within its deceleration limit, and to a standstill",
        "steer straight, and slow down by at most stop_deceleration_mps2";
    "resumes", "real time: a fresh command ends the vehicle's own stop", "obey the next fresh command, and clear OWN_STOP";
    "counts_late", "real time: a command that comes too late changes nothing, and is counted",
        "compare supervisor_sent_ns with the clock; count late commands in Status.late";
    "goes_on", "real time: goes on publishing after ENDED", "publish until the next request";
    "restart", "becomes ready again after kill -9, with the next incarnation", "leave no lock and no file that prevents a second start";
    "joins", "drives again after its restart: in lockstep the reissued batch, in real time the batch under way",
        "take the DriveRequest that the topic has kept; in real time, count ticks from its sent_ns";
    "stays_alive", "stays alive until it is asked to stop", "see its log";
    "exit", "ends within 5 s of SIGINT, with exit code 0", "handle SIGINT: close the node, exit with 0";
    "no_processes", "leaves no process behind", "end every process that you started";
    "no_leftovers", "leaves no node and no segment behind", "drop the ports and the node before exiting";
}

/// Checks that are made in lockstep only.
pub(super) const LOCKSTEP_ALONE: &[&str] = &[
    "waits",
    "one_each",
    "applied",
    "drops_old_tick",
    "drops_early_tick",
    "ended_stands",
    "over_is_silent",
    "repeats",
    "credit_recorded",
    "credit_of_another",
    "credit_logged",
];

/// Checks that are made in real time only.
pub(super) const REAL_TIME_ALONE: &[&str] = &[
    "rate",
    "jitter",
    "tick_by_time",
    "own_stop",
    "own_stop_slows",
    "resumes",
    "counts_late",
    "goes_on",
];

/// Checks that move the vehicle.
pub(super) const MOVING: &[&str] = &[
    "moves",
    "forward",
    "units_speed",
    "steer_left",
    "units_yaw_rate",
    "units_steering",
    "steering_limit",
    "stops",
    "brakes_only",
    "ended_stands",
    "repeats",
    "own_stop_slows",
];

/// The result of a check.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Verdict {
    Pass,
    Fail,
    Skipped,
}

/// What has been found so far.
#[derive(Debug, Default)]
pub(super) struct Findings(BTreeMap<&'static str, (Verdict, String)>);

impl Findings {
    /// Notes the result of a check. A failure stays a failure, and the first observation of a result is kept.
    pub(super) fn note(&mut self, id: &'static str, passes: bool, seen: impl Into<String>) -> bool {
        let verdict = if passes { Verdict::Pass } else { Verdict::Fail };
        self.put(id, verdict, seen.into());
        passes
    }

    /// Notes that a check was not made, and why.
    pub(super) fn skip(&mut self, ids: &[&'static str], why: &str) {
        for id in ids {
            self.put(id, Verdict::Skipped, why.to_owned());
        }
    }

    fn put(&mut self, id: &'static str, verdict: Verdict, seen: String) {
        debug_assert!(CHECKS.iter().any(|check| check.id == id), "{id} is in the table");
        match self.0.get(id) {
            Some((Verdict::Fail, _)) => {}
            Some((Verdict::Pass, _)) if verdict != Verdict::Fail => {}
            _ => {
                self.0.insert(id, (verdict, seen));
            }
        }
    }

    /// Whether a check was made and failed.
    pub(super) fn has_failed(&self, id: &str) -> bool {
        self.0.get(id).is_some_and(|(verdict, _)| *verdict == Verdict::Fail)
    }

    /// Every check with its result.
    pub(super) fn rows(&self) -> impl Iterator<Item = (&'static Check, Verdict, &str)> {
        CHECKS.iter().map(|check| match self.0.get(check.id) {
            Some((verdict, seen)) => (check, *verdict, seen.as_str()),
            None => {
                (check, Verdict::Skipped, "not reached: an earlier check that it depends on failed")
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failure_stays_and_every_check_is_told() {
        let mut findings = Findings::default();
        findings.note("ready", false, "late");
        findings.note("ready", true, "in time");
        findings.skip(&["role"], "why");
        findings.note("role", true, "as it should be");
        let rows: Vec<_> = findings.rows().collect();
        assert_eq!(rows.len(), CHECKS.len());
        assert_eq!((rows[0].1, rows[0].2), (Verdict::Fail, "late"));
        assert_eq!(rows[1].1, Verdict::Pass);
        let mut ids: Vec<_> = CHECKS.iter().map(|check| check.id).collect();
        ids.sort_unstable();
        ids.dedup();
        assert_eq!(ids.len(), CHECKS.len(), "an id twice");
    }
}
