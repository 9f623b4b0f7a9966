//! The controller's process: odometry in, raw commands out, and a report at the end of a batch.

use anyhow::Result;
use config::{Gains, MAX_FLEET, RunConfig};
use ipc_types::{
    BatchHeader, Command, DriveReport, DriveRequest, GainSwitch, Odometry, RawCommand, Safety,
    TickHeader, TrackingError, WakeRole, WirePose, Zone, has,
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
    safety: Inlet<Safety>,
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
    /// The batch that is driven, with the tick that comes next; none between batches.
    driving: Option<(BatchHeader, u64)>,
    /// The last batch and attempt that was asked for.
    last: (u64, u32),
    counters: Counters,
}

/// Ticks for which a restarted controller waits for somebody who knows how the drive stands: the supervisor tells it
/// at least once a tick, unless it was restarted, too.
const JOINS_WITHIN: u32 = 20;

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
    phase: u64,
    /// The tick at which it had run so long; none before the first.
    at_tick: Option<u64>,
    /// The vehicle is being stopped, or stands: the clock does, too, and starts from rest behind it.
    frozen: bool,
    /// The gate slows the vehicle down for a moment: the clock waits for it.
    held: bool,
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
            safety: bus.inlet()?,
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
            driving: None,
            last: (0, 0),
            counters: Counters::default(),
        })
    }

    fn start_batch(&mut self, header: BatchHeader, requests: &[DriveRequest]) {
        self.driving = None;
        if header.run != self.run || requests.is_empty() || requests.len() > MAX_FLEET {
            self.counters.dropped += 1;
            return;
        }
        self.requested = requests.to_vec();
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
        self.last = (header.batch, header.attempt);
    }

    fn answer(&mut self, header: TickHeader, odometry: &[Odometry]) -> Result<()> {
        let received_ns = now_ns();
        let expected = self.driving.is_some_and(|(batch, tick)| {
            let is_next = if self.real_time { header.tick >= tick } else { header.tick == tick };
            (header.run, header.batch, header.attempt) == (self.run, batch.batch, batch.attempt)
                && is_next
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
        let Self { slots, counters, real_time, .. } = self;
        let mut sent_ns = 0;
        // In one go for each vehicle: a fleet does not fit into the nearest cache.
        let answer = |index: usize| {
            let slot = &mut slots[index];
            if !*real_time {
                slot.clock.phase = header.tick;
            }
            let believed = slot.tick(&odometry[index]);
            counters.rejected += u64::from(!believed);
            slot.raw_command()
        };
        self.raw_commands.write(odometry.len(), answer)?.send(|now_ns| {
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
            self.counters.batch = batch.batch;
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
        let is_of_batch = |header: BatchHeader| {
            (header.run, header.batch, header.attempt) == (batch.run, batch.batch, batch.attempt)
        };
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
                let ipc_types::Gains { kv, kl, ks, ki } = switch.gains;
                let gains = Gains { kv, kl, ks, ki };
                if config::check_gains(gains).is_err() {
                    self.counters.rejected += 1;
                    continue;
                }
                slot.awaited = None;
                slot.drive.switch_gains(gains);
                let (slot, zone) = (switch.slot, switch.zone);
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
        let (run, batch, attempt) = (self.run, self.last.0, self.last.1);
        let mut newest = None;
        while let Some(message) = self.safety.receive()? {
            let header = message.header();
            if (header.run, header.batch, header.attempt) == (run, batch, attempt)
                && message.items().len() == self.slots.len()
            {
                newest = Some(message);
            }
        }
        let mut ready = true;
        for (index, (slot, odometry)) in self.slots.iter_mut().zip(odometry).enumerate() {
            let safety = newest.as_ref().map(|message| message.items()[index]);
            ready &= slot.follow(tick, safety, pose(odometry.measured));
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
        let ipc_types::Gains { kv, kl, ks, ki } = request.gains;
        drive.reset(Gains { kv, kl, ks, ki }, request.ticks);
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
                phase: 0,
                at_tick: None,
                frozen: false,
                held: false,
                joins_within: None,
            },
        }
    }

    /// Lets the reference's clock run to `tick`, or stand still, as the gate says. Whether the tick can be answered: a
    /// drive that was joined has to wait until somebody has told how it stands.
    fn follow(&mut self, tick: u64, safety: Option<Safety>, measured: Pose) -> bool {
        let clock = &mut self.clock;
        if let Some(left) = clock.joins_within {
            match safety {
                Some(it) if it.has_reference != 0 && it.origin_m.is_finite() => {
                    self.drive.join(it.origin_m, finite_or_zero(it.steering_rad));
                    clock.frozen = is_latched(it.state);
                    (clock.phase, clock.at_tick) = (it.phase.into(), Some(it.tick));
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
            tracing::info!(tick, phase = clock.phase, frozen = clock.frozen, "joined the drive");
        } else if let Some(it) = safety {
            let frozen = is_latched(it.state);
            if clock.frozen && !frozen {
                let steering_rad = finite_or_zero(it.steering_rad);
                self.drive.restart(clock.phase, measured, steering_rad);
                (clock.phase, clock.at_tick) = (0, Some(tick));
                tracing::info!(tick, from_m = self.drive.origin_m(), "rearmed");
            }
            clock.frozen = frozen;
        }
        clock.held = safety.map_or(clock.held, |it| it.state == Safety::DEGRADED);
        let since = clock.at_tick.map_or(tick, |at| tick.saturating_sub(at));
        if !(clock.frozen || clock.held) {
            clock.phase += since;
        }
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
            self.drive.tick(self.clock.phase, seen);
        self.answer = Answer { command, error, reference_along_m };
        self.ended = ended.map(Box::new);
        believed
    }

    fn report(&self, request: &DriveRequest) -> DriveReport {
        let Some(ended) = &self.ended else { return DriveReport::default() };
        let Ended { metrics, trace } = **ended;
        DriveReport {
            gains: request.gains,
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
            // A drive has at most a million ticks.
            phase: self.clock.phase as u32,
            flags,
        }
    }

    fn tracking_error(&self) -> TrackingError {
        let error = self.answer.error;
        TrackingError {
            along_track_m: error.along_track_m,
            cross_track_m: error.cross_track_m,
            heading_rad: error.heading_rad,
            reference_along_m: self.answer.reference_along_m,
        }
    }
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
        let is_early = header.run == self.run && (header.batch, header.attempt) > self.last;
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

        let tick = TickHeader { run: names.run, batch: 1, attempt: 1, ..TickHeader::default() };
        odometry.send(tick, 1, |_| Odometry::default()).unwrap();
        // News, although there is nothing to be done: the request may have come meanwhile, and its wake-up is over.
        assert!(controller.poll().unwrap());
        assert!(!controller.poll().unwrap());
        let request =
            BatchHeader { run: names.run, batch: 1, attempt: 1, ..BatchHeader::default() };
        requests.send(request, 1, |_| DriveRequest { ticks, ..DriveRequest::default() }).unwrap();
        assert!(controller.poll().unwrap() && answers.receive().unwrap().is_none());
        assert!(controller.poll().unwrap());
        assert_eq!(answers.receive().unwrap().unwrap().header().batch, 1);
        assert!(!controller.poll().unwrap());
        drop((controller, odometry, requests, answers, bus));
        names.remove();
    }
}
