//! The controller's process: odometry in, raw commands out, and a report at the end of a batch.

use anyhow::Result;
use config::{Gains, MAX_FLEET, RunConfig};
use ipc_types::{
    Attempt, BatchHeader, Command, DriveReport, DriveRequest, GainSwitch, KeptLawState, LawState,
    Odometry, RawCommand, Safety, TickHeader, TrackingError, WakeRole, WirePose, Zone, has,
};
use runtime::clock::now_ns;
use runtime::{Bus, Counters, Inlet, Outlet, Received, Service, join, serve};
use tracking::{EndReason, Pose};

use crate::{Decision, DriveController, Ended, Seen};

/// Runs the process until it is asked to stop.
///
/// # Errors
/// If it cannot join the run, or the transport fails.
pub fn run() -> Result<()> {
    let started_ns = now_ns();
    let (attachment, bus, config) = join()?;
    attachment.take_place();
    let mut controller = Controller::new(&bus, config, attachment.names.run, started_ns)?;
    serve(&attachment, &bus, WakeRole::Controller, &mut controller)
}

struct Controller {
    requests: Inlet<DriveRequest>,
    odometry: Inlet<Odometry>,
    zones: Inlet<Zone>,
    gains: Inlet<GainSwitch>,
    /// Made before the ear on `safety`: who has heard that has heard this.
    kept_law_states: Inlet<KeptLawState>,
    safety: Inlet<Safety>,
    law_states: Outlet<LawState>,
    raw_commands: Outlet<RawCommand>,
    errors: Outlet<TrackingError>,
    reports: Outlet<DriveReport>,
    run: u64,
    /// A drive at its first tick, to be copied into new slots.
    fresh: DriveController,
    /// What was asked for, one a slot; apart, because no tick reads it.
    requested: Vec<DriveRequest>,
    slots: Vec<Slot>,
    /// Odometry that something else must come before: the request of its batch, or a zone's gains. They
    /// travel on different topics.
    held: Option<Received<Odometry>>,
    /// Whether gains change with the zone in the batch under way.
    scheduled: bool,
    /// Whether the vehicle paces by the clock: then nobody is waited for, and ticks may be missing.
    real_time: bool,
    started_ns: u64,
    /// The laws' states, as the supervisor has kept them for a controller that joins a drive; empty if it has told none.
    kept: Vec<KeptLawState>,
    /// The batch that is driven, with the tick that comes next; none between batches.
    driving: Option<(BatchHeader, u64)>,
    /// The last attempt that was asked for.
    last: Attempt,
    counters: Counters,
}

/// Ticks for which a restarted controller waits for somebody who knows how the drive stands: the supervisor tells it
/// at least once a tick, unless it was restarted, too.
const JOINS_WITHIN: u32 = 20;

/// More than any drive lasts.
const LONGEST_TICKS: f64 = 1e9;

struct Slot {
    drive: DriveController,
    /// The last odometry that could be believed.
    seen: Seen,
    has_truth: bool,
    answer: Answer,
    ended: Option<Box<Ended>>,
    /// This process joined the drive on its way.
    joined: bool,
    /// The zone whose gains the next tick must have.
    awaited: Option<u32>,
    clock: Clock,
}

/// What was made of the last tick.
#[derive(Debug, Clone, Copy, Default)]
struct Answer {
    command: crate::RawCommand,
    error: tracking::TrackingError,
    reference_along_m: f64,
}

/// The clock of a slot's reference. In lockstep it is the tick.
#[derive(Debug, Clone, Copy)]
struct Clock {
    /// Ticks that it has run since it last started from rest.
    phase_ticks: f64,
    /// The tick at which it had run so long; none before the first.
    at_tick: Option<u64>,
    /// Its rate, as the supervisor tells it.
    rate: f64,
    /// The vehicle is being stopped, or stands: behind that, the clock starts from rest.
    frozen: bool,
    /// The drive had begun before this process did: ticks that are still waited for somebody who knows how it stands.
    joins_within: Option<u32>,
}

impl Controller {
    fn new(bus: &Bus, config: RunConfig, run: u64, started_ns: u64) -> Result<Self> {
        Ok(Self {
            requests: bus.inlet()?,
            odometry: bus.inlet()?,
            zones: bus.inlet()?,
            gains: bus.inlet()?,
            kept_law_states: bus.inlet()?,
            safety: bus.inlet()?,
            law_states: bus.outlet()?,
            raw_commands: bus.outlet()?,
            errors: bus.outlet()?,
            reports: bus.outlet()?,
            run,
            fresh: DriveController::new(&config),
            requested: Vec::new(),
            slots: Vec::new(),
            held: None,
            scheduled: false,
            real_time: false,
            started_ns,
            kept: Vec::new(),
            driving: None,
            last: Attempt::between_batches(run),
            counters: Counters::default(),
        })
    }

    fn start_batch(&mut self, header: BatchHeader, requests: &[DriveRequest]) {
        self.driving = None;
        if !header.attempt.is_of(self.run) || requests.is_empty() || requests.len() > MAX_FLEET {
            self.counters.dropped += 1;
            return;
        }
        self.requested = requests.to_vec();
        self.kept.clear();
        self.slots.clear();
        self.slots.extend(requests.iter().map(|request| Slot::new(&self.fresh, request)));
        self.real_time = requests.iter().any(|it| has(it.flags, DriveRequest::REAL_TIME));
        if self.real_time && header.sent_ns < self.started_ns {
            for slot in &mut self.slots {
                slot.clock.joins_within = Some(JOINS_WITHIN);
            }
        }
        self.scheduled = requests.iter().any(|it| has(it.flags, DriveRequest::SCHEDULED));
        self.driving = Some((header, 0));
        self.last = header.attempt;
    }

    fn answer(&mut self, header: TickHeader, odometry: &[Odometry]) -> Result<()> {
        let received_ns = now_ns();
        let expected = self.driving.is_some_and(|(batch, tick)| {
            let is_next = if self.real_time { header.tick >= tick } else { header.tick == tick };
            header.attempt == batch.attempt && is_next
        });
        if self.real_time && self.driving.is_none() {
            // A vehicle goes on behind the end of its drive.
            return Ok(());
        }
        if !expected || odometry.len() != self.slots.len() {
            self.counters.dropped += 1;
            return Ok(());
        }
        if self.real_time && !self.hear_safety(header.tick, odometry)? {
            return Ok(());
        }
        let real_time = self.real_time;
        let Self { slots, counters, .. } = self;
        let mut sent_ns = 0;
        // In one go for each vehicle: a fleet does not fit into the nearest cache.
        let answer = |index: usize| {
            let slot = &mut slots[index];
            if !real_time {
                slot.clock.phase_ticks = header.tick as f64;
            }
            let believed = slot.tick(&odometry[index]);
            counters.rejected += u64::from(!believed);
            slot.raw_command()
        };
        let written = self.raw_commands.write(odometry.len(), answer)?;
        if real_time {
            // Before the raw command: who has that has this.
            let (tick, sent_ns) = (header.tick, now_ns());
            let header = BatchHeader { attempt: header.attempt, sent_ns, ..BatchHeader::default() };
            let slots = &self.slots;
            self.law_states.send_quietly(header, slots.len(), |index| {
                slots[index].law_state(tick, index as u32)
            })?;
        }
        written.send(|now_ns| {
            sent_ns = now_ns;
            TickHeader { controller_received_ns: received_ns, controller_sent_ns: now_ns, ..header }
        })?;
        let slots = &self.slots;
        let header = TickHeader {
            controller_received_ns: received_ns,
            controller_sent_ns: sent_ns,
            ..header
        };
        if self.errors.has_readers() {
            self.errors.send_quietly(header, slots.len(), |index| slots[index].tracking_error())?;
        }
        if let Some((batch, tick)) = &mut self.driving {
            *tick = header.tick + 1;
            self.counters.batch = batch.attempt.batch;
            self.counters.tick = *tick;
        }
        if slots.iter().all(|slot| slot.ended.is_some()) {
            self.report()?;
        }
        Ok(())
    }

    /// Hears zones and their gains; whether a tick must still wait for gains.
    ///
    /// A zone is sent before the command that the vehicle answers with its tick's odometry: by now it is here.
    fn awaits_gains(&mut self) -> Result<bool> {
        let Some((batch, tick)) = self.driving.filter(|_| self.scheduled) else {
            return Ok(false);
        };
        let is_of_batch = |header: BatchHeader| header.attempt == batch.attempt;
        while let Some(zones) = self.zones.receive()? {
            for zone in zones.items().iter().filter(|_| is_of_batch(zones.header())) {
                let index = zone.slot as usize;
                if let Some(slot) = self.slots.get_mut(index)
                    && has(self.requested[index].flags, DriveRequest::SCHEDULED)
                {
                    slot.awaited = Some(zone.zone);
                }
            }
        }
        while let Some(switches) = self.gains.receive()? {
            for switch in switches.items().iter().filter(|_| is_of_batch(switches.header())) {
                let slot = self.slots.get_mut(switch.slot as usize);
                let Some(slot) = slot.filter(|slot| slot.awaited == Some(switch.zone)) else {
                    self.counters.dropped += 1;
                    continue;
                };
                let gains = Gains::from_parameters(&switch.parameters);
                if config::check_gains(gains).is_err() {
                    self.counters.rejected += 1;
                    continue;
                }
                slot.awaited = None;
                slot.drive.switch_gains(gains);
                let (slot, zone) = (switch.slot, switch.zone);
                let Gains { kv, kl, ks, ki } = gains;
                tracing::info!(tick, slot, zone, kv, kl, ks, ki, "gains switched");
            }
        }
        let awaits = self.slots.iter().any(|slot| slot.awaited.is_some());
        // In real time the old gains go on.
        self.counters.late += u64::from(awaits && self.real_time);
        Ok(awaits && !self.real_time)
    }

    /// Hears what the gate does: whether a reference stands still, and how a drive stands that is joined. Whether this
    /// tick can be answered.
    fn hear_safety(&mut self, tick: u64, odometry: &[Odometry]) -> Result<bool> {
        let (attempt, len) = (self.last, self.slots.len());
        let is_ours = |of: BatchHeader, items: usize| of.attempt == attempt && items == len;
        let mut newest = None;
        while let Some(message) = self.safety.receive()? {
            if is_ours(message.header(), message.items().len()) {
                newest = Some(message);
            }
        }
        // Only a drive that is joined is in want of it.
        let joins = self.slots.iter().any(|slot| slot.clock.joins_within.is_some());
        let kept = if joins { self.kept_law_states.receive_newest()? } else { None };
        if let Some(kept) = kept.filter(|it| is_ours(it.header(), it.items().len())) {
            self.kept = kept.items().to_vec();
        }
        let mut ready = true;
        for (index, (slot, odometry)) in self.slots.iter_mut().zip(odometry).enumerate() {
            let safety = newest.as_ref().map(|message| message.items()[index]);
            let filter_rad = self.kept.get(index).and_then(filter_rad);
            ready &= slot.follow(tick, safety, filter_rad, pose(odometry.measured));
        }
        Ok(ready)
    }

    fn report(&mut self) -> Result<()> {
        let Some((header, _)) = self.driving.take() else { return Ok(()) };
        let header = BatchHeader { flags: 0, sent_ns: now_ns(), ..header };
        let Self { requested, slots, .. } = self;
        self.reports.send(header, slots.len(), |index| slots[index].report(&requested[index]))?;
        Ok(())
    }
}

impl Slot {
    fn new(fresh: &DriveController, request: &DriveRequest) -> Self {
        let mut drive = fresh.clone();
        drive.reset(Gains::from_parameters(&request.parameters), request.ticks);
        let start = pose(request.start);
        Self {
            drive,
            seen: Seen { measured: start, truth: None, collision: false },
            has_truth: false,
            answer: Answer::default(),
            ended: None,
            joined: false,
            awaited: None,
            clock: Clock {
                phase_ticks: 0.0,
                at_tick: None,
                rate: 1.0,
                frozen: false,
                joins_within: None,
            },
        }
    }

    /// Lets the reference's clock run to `tick`, or stand still, as the gate says. Whether the tick can be answered: a
    /// drive that was joined has to wait until somebody has told how it stands. `filter_rad` is where the law's filter
    /// goes on then, if that was kept.
    fn follow(
        &mut self,
        tick: u64,
        safety: Option<Safety>,
        filter_rad: Option<f64>,
        measured: Pose,
    ) -> bool {
        let clock = &mut self.clock;
        if let Some(left) = clock.joins_within {
            match safety {
                Some(it) if it.has_reference != 0 && it.origin_m.is_finite() => {
                    let steering_rad = finite_or_zero(it.steering_rad);
                    self.drive.join(it.origin_m, filter_rad.unwrap_or(steering_rad));
                    clock.frozen = is_latched(it.state);
                    clock.phase_ticks = finite_or_zero(it.phase_ticks).clamp(0.0, LONGEST_TICKS);
                    clock.at_tick = Some(it.tick);
                }
                // The supervisor knows no more than we do: it has been restarted, too.
                _ if left == 0 => {
                    self.drive.restart(0, measured, 0.0);
                    clock.at_tick = Some(tick);
                }
                _ => {
                    clock.joins_within = Some(left - 1);
                    return false;
                }
            }
            clock.joins_within = None;
            self.joined = true;
            tracing::info!(
                tick,
                phase_ticks = clock.phase_ticks,
                frozen = clock.frozen,
                "joined the drive"
            );
        } else if let Some(it) = safety {
            let frozen = is_latched(it.state);
            if clock.frozen && !frozen {
                let steering_rad = finite_or_zero(it.steering_rad);
                self.drive.restart(clock.whole_ticks(), measured, steering_rad);
                (clock.phase_ticks, clock.at_tick) = (0.0, Some(tick));
                tracing::info!(tick, from_m = self.drive.origin_m(), "rearmed");
            }
            clock.frozen = frozen;
        }
        clock.rate = safety.map_or(clock.rate, |it| finite_or_zero(it.clock_rate).max(0.0));
        let since = clock.at_tick.map_or(tick, |at| tick.saturating_sub(at));
        clock.phase_ticks += clock.rate * since as f64;
        clock.at_tick = Some(tick);
        true
    }

    /// One tick; whether the odometry could be believed. If not, the last one stands in for it.
    fn tick(&mut self, odometry: &Odometry) -> bool {
        if self.ended.is_some() {
            return true;
        }
        let has_truth = has(odometry.status, Odometry::HAS_TRUTH);
        let mut seen = Seen {
            measured: pose(odometry.measured),
            truth: has_truth.then(|| pose(odometry.truth)),
            collision: has(odometry.status, Odometry::COLLISION),
        };
        let believed =
            seen.measured.is_finite() && seen.truth.is_none_or(|truth| truth.is_finite());
        if believed {
            self.seen = seen;
            self.has_truth = has_truth;
        } else {
            seen = self.seen;
        }
        let Decision { command, error, reference_along_m, ended } =
            self.drive.tick(self.clock.whole_ticks(), seen);
        self.answer = Answer { command, error, reference_along_m };
        self.ended = ended.map(Box::new);
        believed
    }

    fn report(&self, request: &DriveRequest) -> DriveReport {
        let Some(ended) = &self.ended else { return DriveReport::default() };
        let Ended { metrics, trace } = **ended;
        DriveReport {
            parameters: request.parameters,
            seed: request.seed,
            ticks: metrics.ticks,
            steering_limited_ticks: metrics.steering_limited_ticks,
            trace,
            mean_abs_along_m: metrics.mean_abs_along_m,
            mean_abs_cross_m: metrics.mean_abs_cross_m,
            mean_abs_heading_rad: metrics.mean_abs_heading_rad,
            along_mse_m2: metrics.along_mse_m2,
            cross_mse_m2: metrics.cross_mse_m2,
            max_abs_cross_m: metrics.max_abs_cross_m,
            path_mean_m: 0.0,
            path_p95_m: 0.0,
            path_max_m: 0.0,
            progress: 0.0,
            steering_travel_radps: 0.0,
            lateral_acceleration_max_mps2: 0.0,
            learner: request.learner,
            step: request.step,
            reason: match metrics.reason {
                EndReason::Time => DriveReport::TIME,
                EndReason::Goal => DriveReport::GOAL,
                EndReason::Collision => DriveReport::COLLISION,
            },
            flags: if self.has_truth { Odometry::HAS_TRUTH } else { 0 }
                | if self.joined { DriveReport::JOINED } else { 0 },
        }
    }

    fn raw_command(&self) -> RawCommand {
        let command = self.answer.command;
        let flags = if self.ended.is_some() { Command::ENDED } else { 0 }
            | if self.clock.frozen { RawCommand::FROZEN } else { 0 };
        RawCommand {
            speed_mps: command.speed_mps,
            yaw_rate_radps: command.yaw_rate_radps,
            steering_rad: command.steering_rad,
            reference_along_m: self.answer.reference_along_m,
            origin_m: self.drive.origin_m(),
            phase_ticks: self.clock.phase_ticks,
            flags,
            reserved: 0,
        }
    }

    fn tracking_error(&self) -> TrackingError {
        let error = self.answer.error;
        TrackingError {
            along_track_m: error.along_track_m,
            cross_track_m: error.cross_track_m,
            heading_rad: error.heading_rad,
            reference_along_m: self.answer.reference_along_m,
            path_distance_m: 0.0,
        }
    }

    /// What the law must not lose if this process is replaced: the state of its filter, which is the angle that it
    /// wanted last.
    fn law_state(&self, tick: u64, slot: u32) -> LawState {
        let mut state = LawState { tick, slot, count: 1, ..LawState::default() };
        state.numbers[0] = self.answer.command.steering_rad;
        state
    }
}

impl Clock {
    /// The drive counts whole ticks.
    fn whole_ticks(&self) -> u64 {
        self.phase_ticks as u64
    }
}

/// The state of the law's filter, if one was kept.
fn filter_rad(kept: &KeptLawState) -> Option<f64> {
    Some(kept.numbers[0]).filter(|rad| kept.count == 1 && rad.is_finite())
}

fn is_latched(state: u32) -> bool {
    state == Safety::STOPPING || state == Safety::STOPPED
}

fn finite_or_zero(number: f64) -> f64 {
    if number.is_finite() { number } else { 0.0 }
}

fn pose(wire: WirePose) -> Pose {
    Pose { x_m: wire.x_m, y_m: wire.y_m, yaw_rad: wire.yaw_rad }
}

impl Service for Controller {
    fn poll(&mut self) -> Result<bool> {
        // In lockstep a request comes when nothing else does, and odometry that overtakes it is held.
        let mut newest = if self.real_time { None } else { self.odometry.receive()? };
        if newest.is_none()
            && let Some(request) = self.requests.receive_newest()?
        {
            self.start_batch(request.header(), request.items());
            return Ok(true);
        }
        if self.real_time {
            newest = self.odometry.receive()?;
            // What came before the newest is too old to be answered.
            while let Some(newer) = self.odometry.receive()? {
                self.counters.late += 1;
                newest = Some(newer);
            }
        }
        let is_new = newest.is_some();
        let odometry = match (newest, self.held.take()) {
            (Some(new), held) => {
                // What was held belongs to nothing that anybody asked for.
                self.counters.dropped += u64::from(held.is_some());
                new
            }
            (None, Some(held)) => held,
            (None, None) => return Ok(false),
        };
        let header = odometry.header();
        let is_early = header.attempt.is_ahead_of(&self.last);
        if is_early || self.awaits_gains()? {
            self.held = Some(odometry);
            // What it waits for may be here already, and nobody wakes us for it again.
            return Ok(is_new);
        }
        self.answer(odometry.header(), odometry.items())?;
        Ok(true)
    }

    fn status(&self) -> Counters {
        self.counters
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::Layers;
    use runtime::run::RunNames;

    #[test]
    fn odometry_that_overtakes_its_request_is_held_counts_as_news_and_is_answered() {
        let names = RunNames::create().unwrap();
        let bus = Bus::create(&names, 1).unwrap();
        let config = Layers::maneuver("lane_change").unwrap().resolve().unwrap();
        let ticks = config.ticks();
        let mut controller = Controller::new(&bus, config, names.run, now_ns()).unwrap();
        let (odometry, requests) = (bus.outlet::<Odometry>().unwrap(), bus.outlet().unwrap());
        let answers = bus.observe::<RawCommand>().unwrap();

        let attempt = Attempt { run: names.run, batch: 1, attempt: 1, reserved: 0 };
        let tick = TickHeader { attempt, ..TickHeader::default() };
        odometry.send(tick, 1, |_| Odometry::default()).unwrap();
        // News, although there is nothing to be done: the request may have come meanwhile, and its wake-up is over.
        assert!(controller.poll().unwrap());
        assert!(!controller.poll().unwrap());
        let request = BatchHeader { attempt, ..BatchHeader::default() };
        requests.send(request, 1, |_| DriveRequest { ticks, ..DriveRequest::default() }).unwrap();
        assert!(controller.poll().unwrap() && answers.receive().unwrap().is_none());
        assert!(controller.poll().unwrap());
        assert_eq!(answers.receive().unwrap().unwrap().header().attempt.batch, 1);
        assert!(!controller.poll().unwrap());
        drop((controller, odometry, requests, answers, bus));
        names.remove();
    }

    #[test]
    fn a_controller_that_joins_a_drive_resumes_the_filter_that_was_kept() {
        for kept_rad in [None, Some(0.25)] {
            let names = RunNames::create().unwrap();
            let bus = Bus::create(&names, 1).unwrap();
            let config = Layers::maneuver("lane_change").unwrap().resolve().unwrap();
            let ticks = config.ticks();
            let mut controller = Controller::new(&bus, config, names.run, now_ns()).unwrap();
            let (odometry, requests) = (bus.outlet().unwrap(), bus.outlet().unwrap());
            let (kept_law_states, safety) = (bus.outlet().unwrap(), bus.outlet().unwrap());
            let answers = bus.observe::<RawCommand>().unwrap();
            let states = bus.observe::<LawState>().unwrap();

            let attempt = Attempt { run: names.run, batch: 1, attempt: 1, reserved: 0 };
            // It was asked for before this controller began.
            let header = BatchHeader { attempt, sent_ns: 1, ..BatchHeader::default() };
            // The filter alone: each tick halves its angle.
            let gains = Gains { ki: 0.5, ..Gains::default() };
            let request = DriveRequest {
                parameters: gains.to_parameters(),
                ticks,
                flags: DriveRequest::REAL_TIME,
                ..DriveRequest::default()
            };
            requests.send(header, 1, |_| request).unwrap();
            assert!(controller.poll().unwrap());
            if let Some(rad) = kept_rad {
                let mut kept = KeptLawState { tick: 6, count: 1, ..KeptLawState::default() };
                kept.numbers[0] = rad;
                kept_law_states.send(header, 1, |_| kept).unwrap();
            }
            let stands = Safety {
                tick: 6,
                steering_rad: 0.125,
                phase_ticks: 6.0,
                clock_rate: 1.0,
                has_reference: 1,
                ..Safety::default()
            };
            safety.send(header, 1, |_| stands).unwrap();
            let tick = TickHeader { attempt, tick: 8, ..TickHeader::default() };
            odometry.send(tick, 1, |_| Odometry::default()).unwrap();
            assert!(controller.poll().unwrap());
            let answer = answers.receive().unwrap().unwrap().items()[0];
            let steering_rad = 0.5 * kept_rad.unwrap_or(stands.steering_rad);
            assert_eq!((answer.steering_rad, answer.phase_ticks), (steering_rad, 8.0));
            let state = states.receive().unwrap().unwrap().items()[0];
            assert_eq!((state.tick, state.slot, state.count), (8, 0, 1));
            assert_eq!(state.numbers[0], steering_rad);
            drop((controller, odometry, requests, kept_law_states, safety, answers, states, bus));
            names.remove();
        }
    }
}
