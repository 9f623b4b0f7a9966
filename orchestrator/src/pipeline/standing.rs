//! A drive by the clock waits for people: for somebody who rearms the vehicle after a stop, and for its first odometry, as it
//! may still be on its way to the start. What is told meanwhile, and for how long it waits.

use config::RunConfig;
use ipc_types::Safety;

/// Time between two notices, and before the first one of a vehicle that has not begun.
const TELL_EVERY_S: f64 = 30.0;
const TELL_FIRST_S: f64 = 5.0;
/// A stop for how the vehicle drove ends the drive, at the latest ten seconds of odometry after it. Where no odometry comes, it
/// ends after this long.
const ENDS_WITHIN_S: f64 = 20.0;

/// For what the vehicles of a drive wait.
#[derive(Debug)]
pub(crate) struct Standing {
    limit_s: f64,
    stopped: Option<Stopped>,
    /// How many times it was told that there is no odometry yet.
    told: u32,
}

#[derive(Debug)]
struct Stopped {
    slot: usize,
    reasons: u32,
    since_ns: u64,
    told: u32,
}

/// What is due.
#[derive(Debug, PartialEq)]
pub(crate) enum Due {
    /// To say that the vehicle still waits.
    Notice(String),
    /// To end the drive; bits of [`Safety::reasons`] for which the vehicle was stopped, 0 if it has not begun.
    End(u32),
}

impl Standing {
    pub(crate) fn new(config: &RunConfig) -> Self {
        Self { limit_s: config.drive.patience_s, stopped: None, told: 0 }
    }

    /// Takes what the gate of a vehicle reports.
    pub(crate) fn see(&mut self, slot: usize, state: u32, reasons: u32, now_ns: u64) {
        let is_stopped = state == Safety::STOPPING || state == Safety::STOPPED;
        match &mut self.stopped {
            Some(it) if it.slot == slot && is_stopped => it.reasons = reasons,
            Some(it) if it.slot == slot => self.stopped = None,
            None if is_stopped => {
                self.stopped = Some(Stopped { slot, reasons, since_ns: now_ns, told: 0 });
            }
            _ => {}
        }
    }

    /// What is due by now of a drive that was asked for at `asked_ns` and whose first odometry has not come.
    pub(crate) fn due_at_start(&mut self, now_ns: u64, asked_ns: u64) -> Option<Due> {
        let waits_s = now_ns.saturating_sub(asked_ns) as f64 / 1e9;
        if waits_s >= self.limit_s {
            return Some(Due::End(0));
        }
        if waits_s < TELL_FIRST_S + TELL_EVERY_S * f64::from(self.told) {
            return None;
        }
        self.told = ((waits_s - TELL_FIRST_S) / TELL_EVERY_S) as u32 + 1;
        let end = self.end_in(waits_s);
        Some(Due::Notice(format!(
            "the vehicle was asked to drive {waits_s:.0} s ago, and has sent no odometry yet{end}"
        )))
    }

    /// When the drive ends, in words.
    fn end_in(&self, waits_s: f64) -> String {
        match self.limit_s - waits_s {
            left_s if left_s.is_finite() => {
                format!("; else the drive ends in {left_s:.0} s (drive.patience_s)")
            }
            _ => String::new(),
        }
    }

    /// What is due by now of a vehicle that was stopped, described by `describe`.
    pub(crate) fn due(&mut self, now_ns: u64, describe: impl Fn(u32) -> String) -> Option<Due> {
        let it = self.stopped.as_mut()?;
        let is_final = it.reasons & Safety::OF_THE_DRIVE != 0;
        let limit_s = if is_final { ENDS_WITHIN_S } else { self.limit_s };
        let waits_s = now_ns.saturating_sub(it.since_ns) as f64 / 1e9;
        if waits_s >= limit_s {
            return Some(Due::End(it.reasons));
        }
        if is_final || waits_s < TELL_EVERY_S * f64::from(it.told + 1) {
            return None;
        }
        it.told = (waits_s / TELL_EVERY_S) as u32;
        let (slot, why) = (it.slot, describe(it.reasons));
        let end = self.end_in(waits_s);
        Some(Due::Notice(format!(
            "vehicle {slot} was stopped {waits_s:.0} s ago: {why}; `pathtune rearm` lets it drive again{end}"
        )))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND_NS: u64 = 1_000_000_000;

    fn due(standing: &mut Standing, at_s: u64) -> Option<Due> {
        standing.due(at_s * SECOND_NS, |_| "why".to_owned())
    }

    #[test]
    fn it_tells_that_a_vehicle_waits_and_ends_a_drive_that_nobody_rearms() {
        let mut standing = Standing { limit_s: 70.0, stopped: None, told: 0 };
        assert_eq!(due(&mut standing, 1000), None);
        standing.see(0, Safety::STOPPING, Safety::ODOMETRY_JUMP, 10 * SECOND_NS);
        assert_eq!(due(&mut standing, 39), None);
        standing.see(0, Safety::STOPPED, Safety::ODOMETRY_JUMP, 39 * SECOND_NS);
        let told = "vehicle 0 was stopped 30 s ago: why; `pathtune rearm` lets it drive again; else the drive ends in \
                    40 s (drive.patience_s)";
        assert_eq!(due(&mut standing, 40), Some(Due::Notice(told.to_owned())));
        assert_eq!(due(&mut standing, 69), None);
        assert!(matches!(due(&mut standing, 70), Some(Due::Notice(_))));
        assert_eq!(due(&mut standing, 79), None);
        assert_eq!(due(&mut standing, 80), Some(Due::End(Safety::ODOMETRY_JUMP)));
    }

    #[test]
    fn a_vehicle_that_does_not_begin_is_told_and_ends_its_drive() {
        let mut standing = Standing { limit_s: 60.0, stopped: None, told: 0 };
        let mut due = |at_s: u64| standing.due_at_start((100 + at_s) * SECOND_NS, 100 * SECOND_NS);
        assert_eq!(due(4), None);
        let told = "the vehicle was asked to drive 5 s ago, and has sent no odometry yet; else the drive ends in 55 s \
                    (drive.patience_s)";
        assert_eq!(due(5), Some(Due::Notice(told.to_owned())));
        assert_eq!(due(34), None);
        assert!(matches!(due(35), Some(Due::Notice(_))));
        assert_eq!(due(59), None);
        assert_eq!(due(60), Some(Due::End(0)));
    }

    #[test]
    fn a_vehicle_that_is_rearmed_has_all_its_time_again() {
        let mut standing = Standing { limit_s: 70.0, stopped: None, told: 0 };
        standing.see(0, Safety::STOPPED, 1, 0);
        standing.see(0, Safety::NORMAL, 0, 60 * SECOND_NS);
        assert_eq!(due(&mut standing, 1000), None);
        standing.see(0, Safety::STOPPED, 1, 1000 * SECOND_NS);
        assert_eq!(due(&mut standing, 1029), None);
        assert_eq!(due(&mut standing, 1070), Some(Due::End(1)));
    }

    #[test]
    fn without_a_limit_it_waits_for_ever_and_a_stop_for_how_it_drove_does_not() {
        let mut standing = Standing { limit_s: f64::INFINITY, stopped: None, told: 0 };
        standing.see(0, Safety::STOPPED, Safety::ODOMETRY_STALE, 0);
        let told = "vehicle 0 was stopped 100000 s ago: why; `pathtune rearm` lets it drive again";
        assert_eq!(due(&mut standing, 100_000), Some(Due::Notice(told.to_owned())));
        standing.see(0, Safety::STOPPED, Safety::STEERING_REVERSED, SECOND_NS);
        assert_eq!(due(&mut standing, 20), Some(Due::End(Safety::STEERING_REVERSED)));
    }
}
