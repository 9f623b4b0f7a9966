//! The controller's process: odometry in, raw commands out, and a report at the end of a batch.

use anyhow::Result;
use config::{LawConfig, MAX_FLEET, Parameters, PerPlant, RunConfig};
use ipc_types::{
    Attempt, BatchHeader, Command, DriveReport, DriveRequest, GainSwitch, KeptLawState, LawState,
    Odometry, RawCommand, Safety, TickHeader, TrackingError, WakeRole, WirePose, Zone, has,
};
use runtime::clock::{is_ahead, now_ns};
use runtime::{Bus, Counters, Inlet, Outlet, Received, Service, join, serve};
use tracking::{DriveRecord, EndReason, Pose};

use crate::clock::{GateReport, Moved, ReferenceClock, finite_or_zero};
use crate::{Decision, DriveController, GateWord, Seen};

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
    /// Made before the inlet of `safety`: a process that has received `safety` has received this.
    kept_law_states: Inlet<KeptLawState>,
    safety: Inlet<Safety>,
    law_states: Outlet<LawState>,
    raw_commands: Outlet<RawCommand>,
    errors: Outlet<TrackingError>,
    reports: Outlet<DriveReport>,
    run: u64,
    /// The law's bounds for its parameters: those that come from other processes are checked against them.
    law: LawConfig,
    config: RunConfig,
    /// A drive at its first tick, to be copied into new slots.
    fresh: PerPlant<DriveController>,
    /// The requests, one for each slot; kept apart, because no tick reads them.
    requested: Vec<DriveRequest>,
    slots: Vec<Slot>,
    /// Odometry that must wait for something else: the request of its batch, or a zone's parameters. They
    /// travel on different topics.
    held: Option<Received<Odometry>>,
    /// Whether parameters change with the zone in the batch under way.
    scheduled: bool,
    /// Whether the vehicle paces by the clock: then it waits for no process, and ticks may be missing.
    real_time: bool,
    started_ns: u64,
    /// The laws' states, as the supervisor has kept them for a controller that joins a drive; empty if it has sent
    /// none.
    kept: Vec<KeptLawState>,
    /// The batch that is driven, with the tick that comes next; `None` between batches.
    driving: Option<(BatchHeader, u64)>,
    roll_out: RollOut,
    /// The last attempt that was requested.
    last: Attempt,
    counters: Counters,
}

/// By the clock, the time between the end of a batch and its report, in which the supervisor brings the vehicles to a
/// stop: the run may be over with the report.
struct RollOut {
    speed_limit_mps: f64,
    stop_deceleration_mps2: f64,
    standstill_mps: f64,
    /// The earliest and the latest time of the report, once all drives have ended.
    within_ns: Option<(u64, u64)>,
}

impl RollOut {
    /// By how much longer than the commands a vehicle may take to come to a stop, before it is no longer waited for.
    const PATIENCE_S: f64 = 2.0;

    fn new(config: &RunConfig) -> Self {
        let safety = config.vehicle.safety;
        Self {
            speed_limit_mps: config.supervisor.speed_limit_mps,
            stop_deceleration_mps2: safety.stop_deceleration_mps2,
            standstill_mps: safety.standstill_mps,
            within_ns: None,
        }
    }

    /// Whether it is over. The slots are those of a batch whose drives have all ended.
    fn is_over(&mut self, now_ns: u64, slots: &[Slot]) -> bool {
        let (earliest_ns, latest_ns) = *self.within_ns.get_or_insert_with(|| {
            let fastest_mps = slots.iter().fold(0.0, |fastest: f64, slot| {
                let commanded_mps = slot.answer.command.speed_mps.abs();
                fastest.max(commanded_mps.min(self.speed_limit_mps))
            });
            let stop_s = fastest_mps / self.stop_deceleration_mps2;
            let after_ns = |time_s: f64| now_ns + (time_s * 1e9) as u64;
            (after_ns(stop_s), after_ns(2.0 * stop_s + Self::PATIENCE_S))
        });
        let stand = slots.iter().all(|slot| slot.seen.speed_mps.abs() < self.standstill_mps);
        now_ns >= latest_ns || now_ns >= earliest_ns && stand
    }
}

struct Slot {
    drive: DriveController,
    /// The last odometry that could be believed.
    seen: Seen,
    answer: Answer,
    /// The record of the drive, once it has ended.
    record: Option<Box<DriveRecord>>,
    /// This process joined the drive while it was under way.
    joined: bool,
    /// The zone whose parameters the next tick must have.
    awaited: Option<u32>,
    clock: ReferenceClock,
    /// The gate stops the vehicle with its wheels straight.
    is_straightened: bool,
}

/// What was computed in the last tick.
#[derive(Debug, Clone, Copy, Default)]
struct Answer {
    command: crate::RawCommand,
    error: tracking::TrackingError,
    reference_along_m: f64,
    path_distance_m: f64,
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
            fresh: PerPlant::new(DriveController::new(&config)),
            roll_out: RollOut::new(&config),
            law: config.law.clone(),
            config,
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
        if requests.iter().any(|it| self.law.check(&Parameters(it.parameters)).is_err()) {
            self.counters.rejected += 1;
            return;
        }
        self.requested = requests.to_vec();
        self.kept.clear();
        self.slots.clear();
        let Self { fresh, slots, config, .. } = self;
        slots.extend(requests.iter().map(|request| {
            let of = fresh.of(config, request.plant, DriveController::new);
            Slot::new(of, request)
        }));
        self.real_time = requests.iter().any(|it| has(it.flags, DriveRequest::REAL_TIME));
        if self.real_time && header.sent_ns < self.started_ns {
            for slot in &mut self.slots {
                slot.clock = ReferenceClock::joining();
            }
        }
        self.scheduled = requests.iter().any(|it| has(it.flags, DriveRequest::SCHEDULED));
        self.driving = Some((header, 0));
        self.roll_out.within_ns = None;
        self.last = header.attempt;
    }

    fn answer(&mut self, header: TickHeader, odometry: &[Odometry]) -> Result<()> {
        let received_ns = now_ns();
        if self.real_time && self.driving.is_none() {
            // A vehicle goes on after the end of its drive.
            return Ok(());
        }
        if !self.expects(header, received_ns) || odometry.len() != self.slots.len() {
            self.counters.dropped += 1;
            return Ok(());
        }
        if self.real_time && !self.hear_safety(header.tick, odometry)? {
            return Ok(());
        }
        let real_time = self.real_time;
        let safety = if real_time { None } else { self.newest_safety()? };
        let told = |index: usize| safety.as_ref().map(|it| it.items()[index]);
        let Self { slots, counters, .. } = self;
        let mut sent_ns = 0;
        // All steps for one vehicle after the other: a fleet does not fit into the nearest cache.
        let answer = |index: usize| {
            let slot = &mut slots[index];
            if !real_time {
                let safety = told(index);
                slot.clock.follow(header.tick, safety.map(|it| it.clock_rate));
                // Nobody rearms a vehicle in lockstep.
                slot.hear_gate(safety, true);
            }
            let believed = slot.tick(&odometry[index]);
            counters.rejected += u64::from(!believed);
            slot.raw_command()
        };
        let written = self.raw_commands.write(odometry.len(), answer)?;
        if real_time {
            // Before the raw command: a process that has the raw command has this, too.
            tell_law_states(&self.law_states, header, &self.slots)?;
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
        let has_ended = slots.iter().all(|slot| slot.record.is_some());
        if has_ended && (!real_time || self.roll_out.is_over(now_ns(), &self.slots)) {
            self.report()?;
        }
        Ok(())
    }

    /// Reports a batch whose vehicles have had time enough to come to a stop, also if they say no more.
    fn look_at_clock(&mut self) -> Result<bool> {
        let is_due = self.driving.is_some() && now_ns() >= self.due_ns();
        if is_due {
            self.report()?;
        }
        Ok(is_due)
    }

    /// Whether odometry with this header is what the batch goes on with.
    fn expects(&self, header: TickHeader, now_ns: u64) -> bool {
        let tick_s = self.config.drive.tick_s;
        self.driving.is_some_and(|(batch, tick)| {
            let is_next = if self.real_time {
                header.tick >= tick && !is_ahead(header.tick, tick_s, batch.sent_ns, now_ns)
            } else {
                header.tick == tick
            };
            header.attempt == batch.attempt && is_next
        })
    }

    /// Receives zones and their parameters; returns whether a tick must still wait for parameters.
    ///
    /// A zone is sent before the command that the vehicle answers with the odometry of the zone's tick: by now it is
    /// here.
    fn awaits_parameters(&mut self) -> Result<bool> {
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
                let parameters = Parameters(switch.parameters);
                if self.law.check(&parameters).is_err() {
                    self.counters.rejected += 1;
                    continue;
                }
                slot.awaited = None;
                slot.drive.switch_parameters(parameters);
                let (slot, zone) = (switch.slot, switch.zone);
                let parameters = self.law.values(&parameters);
                tracing::info!(tick, slot, zone, ?parameters, "parameters switched");
            }
        }
        let awaits = self.slots.iter().any(|slot| slot.awaited.is_some());
        // In real time the old parameters stay in use.
        self.counters.late += u64::from(awaits && self.real_time);
        Ok(awaits && !self.real_time)
    }

    /// The gate's newest report for this batch, if one has come since the last tick. It was sent before the command that
    /// the vehicle answers with the odometry of the tick from which it holds: by now it is here.
    fn newest_safety(&self) -> Result<Option<Received<Safety>>> {
        let mut newest = None;
        while let Some(message) = self.safety.receive()? {
            if message.header().attempt == self.last && message.items().len() == self.slots.len() {
                newest = Some(message);
            }
        }
        Ok(newest)
    }

    /// Receives the gate's reports: whether a reference stands still, and the state of a drive that is joined. Returns
    /// whether this tick can be answered.
    fn hear_safety(&mut self, tick: u64, odometry: &[Odometry]) -> Result<bool> {
        let newest = self.newest_safety()?;
        let (attempt, len) = (self.last, self.slots.len());
        let is_ours = |of: BatchHeader, items: usize| of.attempt == attempt && items == len;
        // Only a drive that is being joined needs it.
        let joins = self.slots.iter().any(|slot| slot.clock.is_joining());
        let kept = if joins { self.kept_law_states.receive_newest()? } else { None };
        if let Some(kept) = kept.filter(|it| is_ours(it.header(), it.items().len())) {
            self.kept = kept.items().to_vec();
        }
        let mut ready = true;
        for (index, (slot, odometry)) in self.slots.iter_mut().zip(odometry).enumerate() {
            let safety = newest.as_ref().map(|message| message.items()[index]);
            let state = self.kept.get(index).and_then(kept_state);
            ready &= slot.follow(tick, safety, state.as_ref(), seen(odometry));
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

/// Sends the state that the laws must not lose if this process is replaced.
fn tell_law_states(law_states: &Outlet<LawState>, tick: TickHeader, slots: &[Slot]) -> Result<()> {
    let TickHeader { attempt, tick, .. } = tick;
    let header = BatchHeader { attempt, sent_ns: now_ns(), ..BatchHeader::default() };
    let state = |index: usize| slots[index].law_state(tick, index as u32);
    law_states.send_quietly(header, slots.len(), state)?;
    Ok(())
}

impl Slot {
    fn new(fresh: &DriveController, request: &DriveRequest) -> Self {
        let mut drive = fresh.clone();
        drive.reset(Parameters(request.parameters), request.ticks);
        let measured = pose(request.start);
        Self {
            drive,
            seen: Seen {
                measured,
                speed_mps: 0.0,
                yaw_rate_radps: 0.0,
                truth: None,
                collision: false,
            },
            answer: Answer::default(),
            record: None,
            joined: false,
            awaited: None,
            clock: ReferenceClock::default(),
            is_straightened: false,
        }
    }

    /// Lets the reference's clock run to `tick`, or stand still, as the gate says. Returns whether the tick can be
    /// answered: a drive that is being joined has to wait until its state is reported. Then the law goes on from
    /// `state`, if that was kept.
    fn follow(
        &mut self,
        tick: u64,
        safety: Option<Safety>,
        state: Option<&crate::LawState>,
        seen: Option<Seen>,
    ) -> bool {
        // To join, it must know where the vehicle is.
        let safety = safety.filter(|_| seen.is_some() || !self.clock.is_joining());
        self.hear_gate(safety, false);
        let measured = seen.unwrap_or(self.seen).measured;
        let steering_rad = safety.map_or(0.0, |it| finite_or_zero(it.steering_rad));
        match self.clock.advance(tick, safety.map(gate_report)) {
            Moved::On => return true,
            Moved::Held => return false,
            Moved::Restarted { after_ticks } => {
                self.drive.restart(after_ticks, measured, steering_rad);
                tracing::info!(tick, from_m = self.drive.origin_m(), "rearmed");
                return true;
            }
            Moved::Joined { origin_m } => {
                self.drive.join(origin_m, self.clock.phase(), measured, steering_rad, state);
            }
            Moved::JoinedAnew => self.drive.restart(0.0, measured, 0.0),
        }
        self.joined = true;
        let (phase_ticks, frozen) = (self.clock.phase().ticks, self.clock.is_frozen());
        tracing::info!(tick, phase_ticks, frozen, "joined the drive");
        true
    }

    /// Tells the drive what the gate has reported. `is_final`: a stop ends the drive, whatever it is for.
    fn hear_gate(&mut self, safety: Option<Safety>, is_final: bool) {
        let Some(Safety { state, reasons, .. }) = safety else { return };
        let is_stopped = state == Safety::STOPPING || state == Safety::STOPPED;
        let is_straight = self.is_straightened || reasons & Safety::STRAIGHTENS != 0;
        self.is_straightened = is_stopped && is_straight;
        self.drive.hear_gate(GateWord {
            reasons,
            is_stopped,
            stands: state == Safety::STOPPED,
            is_final: is_stopped && (is_final || reasons & Safety::OF_THE_DRIVE != 0),
        });
    }

    /// Computes one tick; returns whether the odometry could be believed. If not, the last one stands in for it.
    fn tick(&mut self, odometry: &Odometry) -> bool {
        let believed = seen(odometry);
        let seen = believed.unwrap_or(self.seen);
        self.seen = seen;
        if self.record.is_some() {
            return true;
        }
        let Decision { command, error, reference_along_m, path_distance_m, ended } =
            self.drive.tick(self.clock.phase(), seen);
        self.answer = Answer { command, error, reference_along_m, path_distance_m };
        self.record = ended.map(Box::new);
        believed.is_some()
    }

    fn report(&self, request: &DriveRequest) -> DriveReport {
        let Some(record) = &self.record else { return DriveReport::default() };
        DriveReport {
            parameters: request.parameters,
            seed: request.seed,
            ticks: record.ticks,
            steering_limited_ticks: record.steering_limited_ticks,
            trace: record.trace,
            mean_abs_along_m: record.mean_abs_along_m,
            mean_abs_cross_m: record.mean_abs_cross_m,
            mean_abs_heading_rad: record.mean_abs_heading_rad,
            along_mse_m2: record.along_mse_m2,
            cross_mse_m2: record.cross_mse_m2,
            max_abs_cross_m: record.max_abs_cross_m,
            path_mean_m: record.path_mean_m,
            path_p95_m: record.path_p95_m,
            path_max_m: record.path_max_m,
            progress: record.progress,
            progress_in_time: record.progress_in_time,
            steering_rate_p95_radps: record.steering_rate_p95_radps,
            lateral_acceleration_p95_mps2: record.lateral_acceleration_p95_mps2,
            lateral_jerk_p95_mps3: record.lateral_jerk_p95_mps3,
            lateral_jerk_max_mps3: record.lateral_jerk_max_mps3,
            steering_travel_radps: record.steering_travel_radps,
            lateral_acceleration_max_mps2: record.lateral_acceleration_max_mps2,
            learner: request.learner,
            step: request.step,
            reason: match record.reason {
                EndReason::Time => DriveReport::TIME,
                EndReason::Goal => DriveReport::GOAL,
                EndReason::Collision => DriveReport::COLLISION,
                EndReason::Held => DriveReport::HELD,
                EndReason::Stopped => DriveReport::STOPPED,
            },
            stopped_for: record.stopped_for,
            slowed_for: record.slowed_for,
            flags: if self.seen.truth.is_some() { Odometry::HAS_TRUTH } else { 0 }
                | if self.joined { DriveReport::JOINED } else { 0 },
        }
    }

    fn raw_command(&self) -> RawCommand {
        let command = self.answer.command;
        let flags = if self.record.is_some() { Command::ENDED } else { 0 }
            | if self.clock.is_frozen() { RawCommand::FROZEN } else { 0 }
            | if self.is_straightened { RawCommand::STRAIGHTENED } else { 0 };
        RawCommand {
            speed_mps: command.speed_mps,
            yaw_rate_radps: command.yaw_rate_radps,
            steering_rad: command.steering_rad,
            reference_along_m: self.answer.reference_along_m,
            origin_m: self.drive.origin_m(),
            phase_ticks: self.clock.phase().ticks,
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
            path_distance_m: self.answer.path_distance_m,
        }
    }

    /// The state that the law must not lose if this process is replaced.
    fn law_state(&self, tick: u64, slot: u32) -> LawState {
        let state = self.drive.law_state();
        let numbers = state.numbers();
        let mut wire = LawState { tick, slot, count: numbers.len() as u32, ..LawState::default() };
        wire.numbers[..numbers.len()].copy_from_slice(numbers);
        wire
    }
}

/// The state from which a law can go on, if one was kept.
fn kept_state(kept: &KeptLawState) -> Option<crate::LawState> {
    let numbers = kept.numbers.get(..kept.count as usize)?;
    let is_usable = !numbers.is_empty() && numbers.iter().all(|number| number.is_finite());
    is_usable.then(|| crate::LawState::of(numbers))
}

/// The part of the gate's report on which the reference's clock depends.
fn gate_report(safety: Safety) -> GateReport {
    let Safety { tick, origin_m, phase_ticks, clock_rate, state, .. } = safety;
    GateReport {
        tick,
        reference: (safety.has_reference != 0).then_some((origin_m, phase_ticks)),
        clock_rate,
        is_stopped: state == Safety::STOPPING || state == Safety::STOPPED,
    }
}

/// The odometry, if all of its numbers can be believed.
fn seen(odometry: &Odometry) -> Option<Seen> {
    let Odometry { speed_mps, yaw_rate_radps, status, .. } = *odometry;
    let measured = pose(odometry.measured);
    let truth = has(status, Odometry::HAS_TRUTH).then(|| pose(odometry.truth));
    let is_finite = measured.is_finite()
        && truth.is_none_or(|truth| truth.is_finite())
        && speed_mps.is_finite()
        && yaw_rate_radps.is_finite();
    let collision = has(status, Odometry::COLLISION);
    is_finite.then_some(Seen { measured, speed_mps, yaw_rate_radps, truth, collision })
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
            // Odometry before the newest is too old to be answered.
            while let Some(newer) = self.odometry.receive()? {
                self.counters.late += 1;
                newest = Some(newer);
            }
        }
        let is_new = newest.is_some();
        let odometry = match (newest, self.held.take()) {
            (Some(new), held) => {
                // What was held belongs to no batch that was requested.
                self.counters.dropped += u64::from(held.is_some());
                new
            }
            (None, Some(held)) => held,
            (None, None) => return self.look_at_clock(),
        };
        let header = odometry.header();
        let is_early = header.attempt.is_ahead_of(&self.last);
        if is_early || self.awaits_parameters()? {
            self.held = Some(odometry);
            // What it waits for may be here already, and there will be no second wake-up for it.
            return Ok(is_new);
        }
        self.answer(odometry.header(), odometry.items())?;
        Ok(true)
    }

    fn status(&self) -> Counters {
        self.counters
    }

    fn due_ns(&self) -> u64 {
        let within_ns = self.roll_out.within_ns.filter(|_| self.driving.is_some());
        within_ns.map_or(u64::MAX, |(_, latest_ns)| latest_ns)
    }
}

#[cfg(test)]
mod tests;
