//! The clock of a vehicle's reference: how many ticks the reference has run.
//!
//! It runs at the rate that the gate sets: it waits for a vehicle that does not follow, and while the gate slows down or
//! stops the vehicle, and goes along with one that cannot be stopped. Where the vehicle paces by the clock, it also
//! - starts again from rest, when a stopped vehicle is allowed to drive on;
//! - goes on where its predecessor was, when a controller joins a drive that has begun.
//!
//! Pure: the gate's report is an argument, and what the drive must do about it is returned.

use tracking::FASTEST_CLOCK;

/// The part of a gate's report on which the clock depends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GateReport {
    /// Tick of the odometry on which the report is based.
    pub tick: u64,
    /// Where along the path the clock last started from rest, and the ticks that it has run since, as in the
    /// controller's last answer; `None` if the gate has received no answer.
    pub reference: Option<(f64, f64)>,
    /// How many ticks the clock must run in a tick of the vehicle, 0 to [`FASTEST_CLOCK`].
    pub clock_rate: f64,
    /// The vehicle is being stopped, or stands.
    pub is_stopped: bool,
}

/// What a tick means for the drive, apart from moving the clock to it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Moved {
    /// Nothing.
    On,
    /// The tick cannot be answered: the drive had begun before this process, which does not know its state yet.
    Held,
    /// The drive is joined; the clock last started from rest at this place along the path.
    Joined {
        /// That place.
        origin_m: f64,
    },
    /// The drive is joined, and its state is lost: the reference starts from rest, where the vehicle is.
    JoinedAnew,
    /// A stopped vehicle drives on: the reference starts from rest, where the vehicle is.
    Restarted {
        /// Ticks that the clock had run before.
        after_ticks: f64,
    },
}

/// How far a reference's clock has run.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Phase {
    /// Ticks since it last started from rest.
    pub ticks: f64,
    /// Ticks of the vehicle, since the start of the drive or since it was joined, for which it has waited for a vehicle
    /// that was not stopped.
    pub waited_ticks: f64,
}

impl From<u64> for Phase {
    /// The phase of a clock that has run with the vehicle's ticks.
    fn from(ticks: u64) -> Self {
        Self { ticks: ticks as f64, waited_ticks: 0.0 }
    }
}

/// The clock of a vehicle's reference.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReferenceClock {
    phase: Phase,
    /// The tick at which it had run that long; `None` before the first.
    at_tick: Option<u64>,
    /// How many ticks it runs in a tick of the vehicle.
    rate: f64,
    /// The vehicle is being stopped, or stands: afterwards the clock starts from rest.
    is_frozen: bool,
    /// The drive had begun before this process: how many more ticks to wait for a report of its state.
    held_ticks: Option<u32>,
}

impl Default for ReferenceClock {
    fn default() -> Self {
        let phase = Phase::default();
        Self { phase, at_tick: None, rate: 1.0, is_frozen: false, held_ticks: None }
    }
}

impl ReferenceClock {
    /// How many ticks a clock that joins waits for a report of the drive's state: the supervisor sends it
    /// at least once a tick, unless it was restarted, too.
    pub const HELD_TICKS: u32 = 20;

    /// Longer than any drive: a phase that another process reports is limited to this.
    const LONGEST_TICKS: f64 = 1e9;

    /// The clock of a drive that had begun before.
    pub fn joining() -> Self {
        Self { held_ticks: Some(Self::HELD_TICKS), ..Self::default() }
    }

    /// How far it has run.
    pub fn phase(&self) -> Phase {
        self.phase
    }

    /// Whether the vehicle is being stopped, or stands, according to the gate's last report.
    pub fn is_frozen(&self) -> bool {
        self.is_frozen
    }

    /// Whether it still waits for the state of a drive that had begun before.
    pub fn is_joining(&self) -> bool {
        self.held_ticks.is_some()
    }

    /// In lockstep: runs on to `tick`, at the rate that the gate has set since the tick before, if it has set one. No
    /// vehicle is rearmed there, and no drive is joined.
    pub fn follow(&mut self, tick: u64, rate: Option<f64>) {
        self.run_to(tick, rate);
    }

    /// By the vehicle's clock: runs on to `tick`, with the gate's report since the tick before, if there is
    /// one.
    pub fn advance(&mut self, tick: u64, report: Option<GateReport>) -> Moved {
        let moved = match self.held_ticks {
            Some(left) => self.join(tick, report, left),
            None => self.hear(tick, report),
        };
        if moved != Moved::Held {
            self.run_to(tick, report.map(|it| it.clock_rate));
        }
        moved
    }

    /// Goes on where the predecessor was, according to the gate.
    fn join(&mut self, tick: u64, report: Option<GateReport>, held_ticks: u32) -> Moved {
        let known = report.and_then(|it| Some((it, it.reference?)));
        match known {
            Some((report, (origin_m, phase_ticks))) if origin_m.is_finite() => {
                self.held_ticks = None;
                self.is_frozen = report.is_stopped;
                self.phase.ticks = finite_or_zero(phase_ticks).clamp(0.0, Self::LONGEST_TICKS);
                self.at_tick = Some(report.tick);
                Moved::Joined { origin_m }
            }
            // The supervisor knows no more than this process: it has been restarted, too.
            _ if held_ticks == 0 => {
                self.held_ticks = None;
                self.at_tick = Some(tick);
                Moved::JoinedAnew
            }
            _ => {
                self.held_ticks = Some(held_ticks - 1);
                Moved::Held
            }
        }
    }

    /// Takes over whether the vehicle is stopped, and starts from rest after a stop.
    fn hear(&mut self, tick: u64, report: Option<GateReport>) -> Moved {
        let Some(report) = report else { return Moved::On };
        let was_frozen = std::mem::replace(&mut self.is_frozen, report.is_stopped);
        if !was_frozen || report.is_stopped {
            return Moved::On;
        }
        let after_ticks = self.phase.ticks;
        (self.phase.ticks, self.at_tick) = (0.0, Some(tick));
        Moved::Restarted { after_ticks }
    }

    fn run_to(&mut self, tick: u64, rate: Option<f64>) {
        // It has a bound, whatever another process reports.
        self.rate = rate.map_or(self.rate, |it| finite_or_zero(it).clamp(0.0, FASTEST_CLOCK));
        let since = self.at_tick.map_or(tick, |at| tick.saturating_sub(at)) as f64;
        self.phase.ticks += self.rate * since;
        if !self.is_frozen {
            self.phase.waited_ticks += (1.0 - self.rate).max(0.0) * since;
        }
        self.at_tick = Some(tick);
    }
}

pub(crate) fn finite_or_zero(number: f64) -> f64 {
    if number.is_finite() { number } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// What a gate reports if all is well.
    fn well(tick: u64, clock: &ReferenceClock) -> GateReport {
        GateReport {
            tick,
            reference: Some((0.0, clock.phase.ticks)),
            clock_rate: 1.0,
            is_stopped: false,
        }
    }

    /// What a gate reports while it stops the vehicle.
    fn stopped(tick: u64, clock: &ReferenceClock) -> GateReport {
        GateReport { clock_rate: 0.0, is_stopped: true, ..well(tick, clock) }
    }

    /// Any number that may come over the wire.
    fn any_number() -> impl Strategy<Value = f64> {
        prop_oneof![
            4 => -1.0..3.0f64,
            1 => Just(f64::NAN),
            1 => Just(f64::INFINITY),
            1 => -1e300..1e300f64,
        ]
    }

    /// Anything that another process may report.
    fn any_report() -> impl Strategy<Value = Option<GateReport>> {
        let reference = prop::option::of((any_number(), any_number()));
        let report = (any::<u64>(), reference, any_number(), any::<bool>());
        prop::option::of(report).prop_map(|report| {
            report.map(|(tick, reference, clock_rate, is_stopped)| GateReport {
                tick,
                reference,
                clock_rate,
                is_stopped,
            })
        })
    }

    /// Numbers of ticks between two that are answered, each with what the gate reports: normal, slower, stopping, or
    /// nothing.
    fn any_drive() -> impl Strategy<Value = Vec<(u64, u8)>> {
        prop::collection::vec((1..5u64, 0..4u8), 1..60)
    }

    fn told(kind: u8, tick: u64, clock: &ReferenceClock) -> Option<GateReport> {
        match kind {
            0 => Some(well(tick, clock)),
            1 => Some(GateReport { clock_rate: 0.0, ..well(tick, clock) }),
            2 => Some(stopped(tick, clock)),
            _ => None,
        }
    }

    proptest! {
        #[test]
        fn it_never_runs_backward_nor_faster_than_its_bound_whatever_is_told(
            ticks in prop::collection::vec((1..50u64, any_report()), 1..60),
        ) {
            let mut clock = ReferenceClock::default();
            clock.advance(0, None);
            let mut now = 0;
            for (since, report) in ticks {
                let before = clock.phase.ticks;
                now += since;
                match clock.advance(now, report) {
                    Moved::Restarted { after_ticks } => {
                        prop_assert_eq!((after_ticks, clock.phase.ticks), (before, 0.0));
                    }
                    moved => {
                        prop_assert_eq!(moved, Moved::On);
                        let run = clock.phase.ticks - before;
                        // Up to rounding.
                        let most = FASTEST_CLOCK * since as f64 + 1e-9;
                        prop_assert!((0.0..=most).contains(&run), "{run} in {since}");
                    }
                }
            }
        }

        #[test]
        fn it_waits_while_the_vehicle_is_stopped_and_then_starts_from_rest(
            before in 1..1000u64, stop in 1..1000u64, after in 1..1000u64,
        ) {
            let mut clock = ReferenceClock::default();
            let report = well(0, &clock);
            clock.advance(before, Some(report));
            for tick in before..before + stop {
                // The supervisor reports it once a tick; some reports get lost.
                let report = (tick == before || tick % 3 == 0).then(|| stopped(tick, &clock));
                prop_assert_eq!(clock.advance(tick + 1, report), Moved::On);
                prop_assert!(clock.is_frozen());
                prop_assert_eq!(clock.phase(), Phase::from(before));
            }
            let now = before + stop + 1;
            let report = well(now - 1, &clock);
            let moved = clock.advance(now, Some(report));
            prop_assert_eq!(moved, Moved::Restarted { after_ticks: before as f64 });
            prop_assert!(!clock.is_frozen());
            prop_assert_eq!(clock.advance(now + after, None), Moved::On);
            prop_assert_eq!(clock.phase(), Phase::from(after));
        }

        #[test]
        fn who_joins_goes_on_where_the_predecessor_was(
            driven in any_drive(), silent in 1..10u64, further in any_drive(), kind in 0..3u8,
        ) {
            let mut predecessor = ReferenceClock::default();
            let mut tick = 0;
            predecessor.advance(0, None);
            for (since, kind) in driven {
                let report = told(kind, tick, &predecessor);
                tick += since;
                predecessor.advance(tick, report);
            }
            // Its last answer, as the gate reports it: if it had not been lost, the clock would have heard the same.
            let last = told(kind, tick, &predecessor);
            tick += silent;
            let mut successor = ReferenceClock::joining();
            prop_assert!(successor.is_joining());
            prop_assert_eq!(successor.advance(tick, last), Moved::Joined { origin_m: 0.0 });
            let restarted = matches!(predecessor.advance(tick, last), Moved::Restarted { .. });
            // After a rearm that nobody took over, the reference goes on from where it stood.
            prop_assume!(!restarted);
            // For how long the predecessor has waited is not handed on.
            successor.phase.waited_ticks = predecessor.phase.waited_ticks;
            prop_assert_eq!(successor, predecessor);
            for (since, kind) in further {
                let report = told(kind, tick, &predecessor);
                tick += since;
                let moved = predecessor.advance(tick, report);
                prop_assert_eq!(successor.advance(tick, report), moved);
                prop_assert_eq!(successor, predecessor);
            }
        }

        #[test]
        fn who_joins_believes_no_strange_number(report in any_report(), tick in 0..1_000_000u64) {
            let mut clock = ReferenceClock::joining();
            if clock.advance(tick, report) == Moved::Held {
                prop_assert_eq!(clock.phase(), Phase::default());
                return Ok(());
            }
            let most = ReferenceClock::LONGEST_TICKS + FASTEST_CLOCK * tick as f64;
            prop_assert!((0.0..=most).contains(&clock.phase.ticks));
        }
    }

    #[test]
    fn who_joins_holds_some_ticks_for_somebody_who_knows_and_then_starts_anew() {
        let mut clock = ReferenceClock::joining();
        let knows_nothing = GateReport { reference: None, ..well(90, &clock) };
        for tick in 100..100 + u64::from(ReferenceClock::HELD_TICKS) {
            let report = (tick % 2 == 0).then_some(knows_nothing);
            assert_eq!(clock.advance(tick, report), Moved::Held);
        }
        assert_eq!(clock.advance(120, Some(knows_nothing)), Moved::JoinedAnew);
        assert_eq!(clock.phase(), Phase::default());
        assert_eq!(clock.advance(123, None), Moved::On);
        assert_eq!(clock.phase(), Phase::from(3));
    }

    #[test]
    fn in_lockstep_it_runs_with_the_ticks_at_the_rate_that_was_set_last() {
        let mut clock = ReferenceClock::default();
        let rates = [None, None, Some(0.25), None, Some(0.0), Some(1.0), None];
        for (tick, rate) in (0..).zip(rates) {
            clock.follow(tick, rate);
        }
        assert_eq!(clock.phase(), Phase { ticks: 3.5, waited_ticks: 2.5 });
    }
}
