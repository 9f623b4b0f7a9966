//! What is said of a gate's state: in the log one line a change, and where it changes all the time, some of them counted; to the
//! user, how a vehicle is stopped.

use config::RunConfig;
use ipc_types::Safety;

/// A line of a vehicle's gate comes at most this often.
const LINE_EVERY_NS: u64 = 1_000_000_000;

/// The gate of one vehicle, as reported last.
#[derive(Debug, Default)]
pub(crate) struct GateLog {
    state: u32,
    told: u32,
    told_ns: Option<u64>,
    untold: u64,
}

impl GateLog {
    /// Takes a report; returns whether the state has changed.
    pub(crate) fn changes_to(&mut self, state: u32) -> bool {
        std::mem::replace(&mut self.state, state) != state
    }

    /// Takes the reasons that are only told; returns those that are new.
    pub(crate) fn begins(&mut self, told: u32) -> u32 {
        told & !std::mem::replace(&mut self.told, told)
    }

    /// Whether a change is due to be logged now; if so, how many changes before it were not.
    pub(crate) fn line_due(&mut self, now_ns: u64) -> Option<u64> {
        if self.told_ns.is_some_and(|told_ns| now_ns.saturating_sub(told_ns) < LINE_EVERY_NS) {
            self.untold += 1;
            return None;
        }
        self.told_ns = Some(now_ns);
        Some(std::mem::take(&mut self.untold))
    }
}

/// How a vehicle is stopped, in words.
pub(crate) struct StopWords {
    /// A negative speed may be commanded, which brakes the vehicle.
    brakes: bool,
    /// Within which time somebody may let it drive again; `None` where nobody can.
    rearm_within_s: Option<f64>,
}

impl StopWords {
    /// For the vehicles of a run; `realtime` if somebody may rearm them.
    pub(crate) fn new(config: &RunConfig, realtime: bool) -> Self {
        Self {
            brakes: config.vehicle.safety.reverse_limit_mps > 0.0,
            rearm_within_s: realtime.then_some(config.drive.patience_s),
        }
    }

    /// How it is stopped for these reasons, and what lets it drive again.
    pub(crate) fn words(&self, reasons: u32) -> String {
        let mut words = Safety::words_of_action(Safety::action_name(reasons)).to_owned();
        if !self.brakes {
            words += ", at a command of 0 m/s, as its file allows none below (vehicle.safety.reverse_limit_mps)";
        }
        // A stop for how it drove is the drive's result.
        if let Some(within_s) = self.rearm_within_s.filter(|_| reasons & Safety::OF_THE_DRIVE == 0)
        {
            words += "; `pathtune rearm` lets it drive again";
            if within_s.is_finite() {
                words += &format!(" within {within_s} s (drive.patience_s)");
            }
        }
        words
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gate_that_flickers_writes_a_line_a_second_with_a_count() {
        let mut log = GateLog::default();
        assert!(log.changes_to(1) && !log.changes_to(1));
        assert_eq!(log.line_due(5), Some(0));
        for at_ns in 6..1000 {
            assert_eq!(log.line_due(at_ns), None);
        }
        assert_eq!(log.line_due(5 + LINE_EVERY_NS), Some(994));
        assert_eq!(log.line_due(6 + 2 * LINE_EVERY_NS), Some(0));
    }
}
