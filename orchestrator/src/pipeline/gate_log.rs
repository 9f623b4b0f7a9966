//! What the log says of a gate's state: one line a change, and where it changes all the time, some of them counted.

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
