//! Latencies from stamps: which messages belong to the same tick, how much time lies between their stamps, and how
//! often each span was seen. Knows no clock, no bus and no terminal.
//!
//! Every message carries the stamps of the hops that it has passed, so most spans are within one header. What a vehicle
//! does with command k is reported only by odometry k+1: the two are joined by batch, attempt and tick.

use hdrhistogram::Histogram;
use ipc_types::TickHeader;
use ipc_types::topics::OBSERVER_BUFFER;

/// A part of a tick's way, from one stamp to the next; the last one is the whole way.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Hop {
    /// From the vehicle's odometry until the controller has taken it.
    VehicleToController,
    /// In the controller.
    Controller,
    /// From the raw command until the supervisor has taken it.
    ControllerToSupervisor,
    /// In the supervisor.
    Supervisor,
    /// From the command until the vehicle applies it.
    SupervisorToVehicle,
    /// From the odometry until the vehicle applies its command.
    EndToEnd,
}

impl Hop {
    /// Every hop, in the order of a tick.
    pub const ALL: [Hop; 6] = [
        Hop::VehicleToController,
        Hop::Controller,
        Hop::ControllerToSupervisor,
        Hop::Supervisor,
        Hop::SupervisorToVehicle,
        Hop::EndToEnd,
    ];

    /// Its name in every output.
    pub fn name(self) -> &'static str {
        match self {
            Hop::VehicleToController => "vehicle_to_controller",
            Hop::Controller => "controller",
            Hop::ControllerToSupervisor => "controller_to_supervisor",
            Hop::Supervisor => "supervisor",
            Hop::SupervisorToVehicle => "supervisor_to_vehicle",
            Hop::EndToEnd => "end_to_end",
        }
    }
}

/// The longest span that is distinguished from longer ones.
const LONGEST_NS: u64 = 60_000_000_000;
/// A longer span is not a latency: one of its stamps is of something else.
const IMPLAUSIBLE_NS: u64 = 3_600_000_000_000;
/// No batch has this many ticks: a larger number is not a tick.
const IMPLAUSIBLE_TICK: u64 = 1 << 32;
/// How many headers wait for their counterpart. The topics are drained one after the other, so one can be ahead of
/// another by as much as a buffer holds.
const WAITING: usize = 2 * OBSERVER_BUFFER;

/// Counts of what was seen.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct TickCounts {
    /// Ticks whose odometry was seen.
    pub ticks: u64,
    /// Ticks that were driven but not seen, according to the gaps between tick numbers.
    pub missed: u64,
    /// Batches of which nothing was seen. How many ticks they had is not known here.
    pub missed_batches: u64,
    /// Ticks whose command was applied later than the budget allows, or not in time for the next tick at all.
    pub deadline_misses: u64,
    /// Those of them that missed the next tick: the vehicle had gone on before the command was sent.
    pub late: u64,
    /// Spans left out because a stamp was missing, went backwards or made no sense.
    pub implausible: u64,
    /// Messages that belong to no regular tick: of another run, of a batch that is over, or of a tick that was seen
    /// before.
    pub strays: u64,
}

impl TickCounts {
    fn add(&mut self, other: TickCounts) {
        self.ticks += other.ticks;
        self.missed += other.missed;
        self.missed_batches += other.missed_batches;
        self.deadline_misses += other.deadline_misses;
        self.late += other.late;
        self.implausible += other.implausible;
        self.strays += other.strays;
    }
}

/// What was seen over a certain time.
#[derive(Debug, Clone)]
pub struct Figures {
    hops: Vec<Histogram<u64>>,
    /// Spans between the odometry of consecutive ticks.
    pub period: Histogram<u64>,
    /// Counts of what was seen.
    pub counts: TickCounts,
}

impl Figures {
    /// Nothing seen yet.
    ///
    /// # Panics
    /// Never: the bounds of the histograms are in order.
    pub fn new() -> Self {
        let histogram = || Histogram::new_with_bounds(1, LONGEST_NS, 3).expect("bounds in order");
        let hops = Hop::ALL.iter().map(|_| histogram()).collect();
        Self { hops, period: histogram(), counts: TickCounts::default() }
    }

    /// The spans of a hop.
    pub fn hop(&self, hop: Hop) -> &Histogram<u64> {
        &self.hops[hop as usize]
    }

    /// Adds what was seen over some other time.
    ///
    /// # Panics
    /// Never: all histograms have the same bounds.
    pub fn add(&mut self, other: &Figures) {
        let ours = self.hops.iter_mut().chain([&mut self.period]);
        for (ours, theirs) in ours.zip(other.hops.iter().chain([&other.period])) {
            ours.add(theirs).expect("the same bounds");
        }
        self.counts.add(other.counts);
    }

    /// Forgets everything.
    pub fn reset(&mut self) {
        self.hops.iter_mut().for_each(Histogram::reset);
        self.period.reset();
        self.counts = TickCounts::default();
    }
}

impl Default for Figures {
    fn default() -> Self {
        Self::new()
    }
}

/// Headers that wait for their counterpart, each in a place that depends on its tick. A header whose counterpart never
/// comes is overwritten in time.
struct Waiting {
    places: Vec<Option<TickHeader>>,
}

impl Waiting {
    fn new() -> Self {
        Self { places: vec![None; WAITING] }
    }

    fn put(&mut self, header: TickHeader) {
        self.places[header.tick as usize % WAITING] = Some(header);
    }

    /// The header of a tick of the batch and attempt that `like` names.
    fn take(&mut self, like: TickHeader, tick: u64) -> Option<TickHeader> {
        let place = &mut self.places[tick as usize % WAITING];
        place.take_if(|it| (it.attempt, it.tick) == (like.attempt, tick))
    }
}

/// Takes the messages of a run as they come, and keeps the figures since they were last asked for.
pub struct Latency {
    run: u64,
    budget_ns: u64,
    figures: Figures,
    /// The odometry that was seen last.
    last: Option<TickHeader>,
    odometry: Waiting,
    commands: Waiting,
    age_ns: Option<u64>,
}

impl Latency {
    /// Creates it for a run; an end-to-end span above the budget is a deadline miss.
    pub fn new(run: u64, budget_ns: u64) -> Self {
        Self {
            run,
            budget_ns,
            figures: Figures::new(),
            last: None,
            odometry: Waiting::new(),
            commands: Waiting::new(),
            age_ns: None,
        }
    }

    /// The header of the newest odometry.
    pub fn newest(&self) -> Option<TickHeader> {
        self.last
    }

    /// How old the command was that the vehicle applied last: from its sending until it was applied.
    pub fn age_ns(&self) -> Option<u64> {
        self.age_ns
    }

    /// Whether anything was seen since the figures were last taken.
    pub fn has_seen_ticks(&self) -> bool {
        self.figures.counts.ticks > 0
    }

    /// The figures since the last call, added to `total` as well.
    pub fn take(&mut self, total: &mut Figures) -> Figures {
        let taken = self.figures.clone();
        self.figures.reset();
        total.add(&taken);
        taken
    }

    /// Takes an odometry message: counts its tick, and learns what became of the command before.
    pub fn odometry(&mut self, header: TickHeader) {
        if !header.attempt.is_of(self.run) || header.tick >= IMPLAUSIBLE_TICK {
            self.figures.counts.strays += 1;
            return;
        }
        let counts = &mut self.figures.counts;
        match self.last {
            // An observer that joins in the middle has not missed anything.
            None => {}
            Some(last) if last.attempt == header.attempt => {
                if header.tick <= last.tick {
                    counts.strays += 1;
                    return;
                }
                counts.missed += header.tick - last.tick - 1;
                if header.tick == last.tick + 1 {
                    let period = span(last.odometry_sent_ns, header.odometry_sent_ns);
                    note(&mut self.figures.period, counts, period);
                }
            }
            Some(last) if header.attempt.is_ahead_of(&last.attempt) => {
                // How many more ticks the previous batch had is not known, but the beginning of this one is.
                counts.missed += header.tick;
                counts.missed_batches +=
                    (header.attempt.batch - last.attempt.batch).saturating_sub(1);
            }
            Some(_) => {
                counts.strays += 1;
                return;
            }
        }
        counts.ticks += 1;
        self.last = Some(header);
        if header.tick == 0 {
            return;
        }
        match self.commands.take(header, header.tick - 1) {
            Some(command) => self.join(command, header),
            None => self.odometry.put(header),
        }
    }

    /// Takes a raw command: gives the spans to the controller, and in it.
    pub fn raw_command(&mut self, header: TickHeader) {
        if !header.attempt.is_of(self.run) {
            self.figures.counts.strays += 1;
            return;
        }
        self.note(Hop::VehicleToController, header.odometry_sent_ns, header.controller_received_ns);
        self.note(Hop::Controller, header.controller_received_ns, header.controller_sent_ns);
    }

    /// Takes a command: gives the spans to the supervisor, and in it.
    pub fn command(&mut self, header: TickHeader) {
        if !header.attempt.is_of(self.run) || header.tick >= IMPLAUSIBLE_TICK {
            self.figures.counts.strays += 1;
            return;
        }
        if header.controller_sent_ns == 0 {
            // One of the supervisor's own, in real time: it answers nothing.
            return;
        }
        let (sent_ns, received_ns) = (header.controller_sent_ns, header.supervisor_received_ns);
        self.note(Hop::ControllerToSupervisor, sent_ns, received_ns);
        self.note(Hop::Supervisor, received_ns, header.supervisor_sent_ns);
        match self.odometry.take(header, header.tick + 1) {
            Some(next) => self.join(header, next),
            None => self.commands.put(header),
        }
    }

    /// Learns from the odometry after a command what became of it.
    fn join(&mut self, command: TickHeader, next: TickHeader) {
        let counts = &mut self.figures.counts;
        if next.odometry_sent_ns != 0 && command.supervisor_sent_ns > next.odometry_sent_ns {
            counts.late += 1;
            counts.deadline_misses += 1;
            return;
        }
        self.age_ns = span(command.supervisor_sent_ns, next.applied_ns);
        let whole = span(command.odometry_sent_ns, next.applied_ns);
        counts.deadline_misses += u64::from(whole.is_some_and(|ns| ns > self.budget_ns));
        self.note(Hop::SupervisorToVehicle, command.supervisor_sent_ns, next.applied_ns);
        self.note(Hop::EndToEnd, command.odometry_sent_ns, next.applied_ns);
    }

    fn note(&mut self, hop: Hop, from_ns: u64, to_ns: u64) {
        let Figures { hops, counts, .. } = &mut self.figures;
        note(&mut hops[hop as usize], counts, span(from_ns, to_ns));
    }
}

/// The time between two stamps, if they are plausible.
fn span(from_ns: u64, to_ns: u64) -> Option<u64> {
    if from_ns == 0 || to_ns == 0 {
        return None;
    }
    to_ns.checked_sub(from_ns).filter(|ns| *ns <= IMPLAUSIBLE_NS)
}

fn note(histogram: &mut Histogram<u64>, counts: &mut TickCounts, span: Option<u64>) {
    match span {
        // The histogram begins at 1.
        Some(ns) => histogram.saturating_record(ns.max(1)),
        None => counts.implausible += 1,
    }
}

#[cfg(test)]
mod tests {
    use ipc_types::Attempt;
    use proptest::prelude::*;

    use super::*;

    const RUN: u64 = 7;
    /// Spans of the hops, all of them different.
    const SPANS: [u64; 5] = [1_000, 20_000, 3_000, 40_000, 500_000];
    const PERIOD: u64 = 10_000_000;

    /// The command of a tick, and the odometry that follows it.
    fn tick(batch: u64, attempt: u32, tick: u64) -> (TickHeader, TickHeader) {
        let sent = 1_000_000_000 * batch + PERIOD * tick;
        let attempt = Attempt { run: RUN, batch, attempt, reserved: 0 };
        let odometry = TickHeader { attempt, tick, odometry_sent_ns: sent, ..<_>::default() };
        let stamp = |hops: usize| sent + SPANS[..hops].iter().sum::<u64>();
        let command = TickHeader {
            controller_received_ns: stamp(1),
            controller_sent_ns: stamp(2),
            supervisor_received_ns: stamp(3),
            supervisor_sent_ns: stamp(4),
            ..odometry
        };
        let next = TickHeader {
            tick: tick + 1,
            applied_ns: stamp(5),
            odometry_sent_ns: sent + PERIOD,
            ..odometry
        };
        (command, next)
    }

    fn first(batch: u64, attempt: u32) -> TickHeader {
        TickHeader { applied_ns: 0, ..tick(batch, attempt, 0).0 }
    }

    fn taken(latency: &mut Latency) -> Figures {
        latency.take(&mut Figures::new())
    }

    #[test]
    fn every_span_is_found_in_its_hop_and_in_no_other() {
        let mut latency = Latency::new(RUN, 600_000);
        latency.odometry(first(1, 1));
        for k in 0..100 {
            let (command, next) = tick(1, 1, k);
            latency.raw_command(command);
            latency.command(command);
            latency.odometry(next);
        }
        assert_eq!(latency.age_ns(), Some(SPANS[4]));
        let figures = taken(&mut latency);
        for (hop, ns) in Hop::ALL.into_iter().zip(SPANS.into_iter().chain([SPANS.iter().sum()])) {
            let histogram = figures.hop(hop);
            assert_eq!(histogram.len(), 100, "{hop:?}");
            for q in [0.0, 0.5, 0.999, 1.0] {
                let read = histogram.value_at_quantile(q) as f64;
                assert!((read / ns as f64 - 1.0).abs() < 1e-3, "{hop:?}: {read} for {ns}");
            }
        }
        assert!((figures.period.value_at_quantile(0.5) as f64 / PERIOD as f64 - 1.0).abs() < 1e-3);
        assert_eq!(figures.counts, TickCounts { ticks: 101, ..TickCounts::default() });
    }

    #[test]
    fn gaps_are_counted_within_a_drive_and_at_its_beginning() {
        let mut latency = Latency::new(RUN, u64::MAX);
        // An observer that joins at tick 5 has not missed anything; then 3 ticks are missing.
        latency.odometry(tick(1, 1, 4).1);
        latency.odometry(tick(1, 1, 8).1);
        assert_eq!(taken(&mut latency).counts.missed, 3);
        // A new attempt, and a new batch, begin with tick 0.
        latency.odometry(first(1, 2));
        latency.odometry(first(2, 1));
        assert_eq!(taken(&mut latency).counts, TickCounts { ticks: 2, ..TickCounts::default() });
        // Batches 3 to 5 were not seen at all, nor were two ticks of batch 6.
        latency.odometry(tick(6, 1, 1).1);
        let counts = taken(&mut latency).counts;
        assert_eq!((counts.missed, counts.missed_batches), (2, 3));
    }

    #[test]
    fn nothing_is_joined_over_batches_attempts_or_gaps() {
        let mut latency = Latency::new(RUN, u64::MAX);
        let (command, _) = tick(1, 1, 3);
        latency.command(command);
        for other in [tick(1, 1, 2).1, tick(1, 2, 3).1, tick(2, 1, 3).1, tick(2, 1, 4).1] {
            latency.odometry(other);
        }
        assert_eq!(taken(&mut latency).hop(Hop::EndToEnd).len(), 0);
    }

    #[test]
    fn stamps_that_make_no_sense_are_counted_and_left_out() {
        let check = |command: TickHeader, next: TickHeader, implausible: u64| {
            let mut latency = Latency::new(RUN, 0);
            latency.command(command);
            latency.odometry(next);
            let figures = taken(&mut latency);
            assert_eq!(figures.counts.implausible, implausible);
            assert_eq!(figures.hop(Hop::EndToEnd).len(), 0);
            assert_eq!(figures.counts.deadline_misses, 0);
        };
        let (command, next) = tick(1, 1, 3);
        check(command, TickHeader { applied_ns: 0, ..next }, 2);
        check(command, TickHeader { applied_ns: 1, ..next }, 2);
        check(command, TickHeader { applied_ns: u64::MAX, ..next }, 2);
        check(TickHeader { odometry_sent_ns: 0, ..command }, next, 1);
        let attempt = Attempt { run: 8, ..command.attempt };
        check(TickHeader { attempt, ..command }, next, 0);
    }

    #[test]
    fn a_command_above_the_budget_or_behind_the_next_tick_is_a_deadline_miss() {
        let all: u64 = SPANS.iter().sum();
        for (budget, misses) in [(all, 0), (all - 1, 1)] {
            let mut latency = Latency::new(RUN, budget);
            let (command, next) = tick(1, 1, 0);
            latency.command(command);
            latency.odometry(next);
            assert_eq!(taken(&mut latency).counts.deadline_misses, misses);
        }
        let mut latency = Latency::new(RUN, u64::MAX);
        let (command, next) = tick(1, 1, 0);
        latency.odometry(next);
        latency.command(TickHeader { supervisor_sent_ns: next.odometry_sent_ns + 1, ..command });
        let figures = taken(&mut latency);
        assert_eq!((figures.counts.late, figures.counts.deadline_misses), (1, 1));
        assert_eq!(figures.hop(Hop::SupervisorToVehicle).len(), 0);
    }

    #[test]
    fn longer_than_can_be_told_apart_is_the_longest() {
        let mut latency = Latency::new(RUN, u64::MAX);
        let command = tick(1, 1, 0).0;
        latency.raw_command(TickHeader {
            controller_sent_ns: command.controller_received_ns + 2 * LONGEST_NS,
            ..command
        });
        assert!(taken(&mut latency).hop(Hop::Controller).max() >= LONGEST_NS);
    }

    proptest! {
        /// However the topics are drained, and whatever is lost on the way, each tick that was seen whole is
        /// joined once, and every lost one is counted.
        #[test]
        fn the_order_of_draining_changes_nothing(
            chunks in prop::collection::vec(1usize..200, 1..40),
            commands_first: bool,
            lost in prop::collection::vec(any::<bool>(), 1..50),
        ) {
            let is_lost = |tick: u64| tick > 0 && lost[tick as usize % lost.len()];
            let mut latency = Latency::new(RUN, u64::MAX);
            let mut next_tick = 0;
            latency.odometry(first(1, 1));
            for chunk in chunks {
                let ticks: Vec<u64> = (next_tick..next_tick + chunk as u64).collect();
                next_tick += chunk as u64;
                let commands = |latency: &mut Latency| {
                    ticks.iter().for_each(|k| latency.command(tick(1, 1, *k).0));
                };
                let odometry = |latency: &mut Latency| {
                    let seen = ticks.iter().filter(|k| !is_lost(**k));
                    seen.for_each(|k| latency.odometry(tick(1, 1, *k).1));
                };
                if commands_first {
                    commands(&mut latency);
                    odometry(&mut latency);
                } else {
                    odometry(&mut latency);
                    commands(&mut latency);
                }
            }
            let seen = (0..next_tick).filter(|k| !is_lost(*k)).count() as u64;
            let last_seen = (0..next_tick).rfind(|k| !is_lost(*k)).unwrap_or(0);
            let figures = taken(&mut latency);
            prop_assert_eq!(figures.hop(Hop::EndToEnd).len(), seen);
            prop_assert_eq!(figures.counts.ticks, seen + 1);
            prop_assert_eq!(figures.counts.missed, last_seen + 1 - seen);
        }
    }
}
