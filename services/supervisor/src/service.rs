//! The supervisor's process: it stands in the command path, and announces the zone.
//!
//! In `lockstep` it answers each raw command, and knows vehicle time only. Otherwise it also acts `by_the_clock`: if
//! no answer is recent enough, it sends commands of its own.

mod by_the_clock;
mod lockstep;

use anyhow::Result;
use config::{MAX_FLEET, PerPlant, RunConfig};
use ipc_types::{
    Attempt, BatchHeader, Command, DriveRequest, KeptLawState, LawState, Odometry, RawCommand,
    Rearm, Safety, TickHeader, WakeRole, WirePose, Zone, has,
};
use runtime::clock::now_ns;
use runtime::{Bus, Counters, Inlet, Outlet, Received, Service, join, serve};
use tracking::{Pose, Reference};

use crate::{Movement, Pace, Progress, State, Watch, Zones};
use by_the_clock::Clocked;

/// Runs the process until it is asked to stop.
///
/// # Errors
/// If it cannot join the run, or the transport fails.
pub fn run() -> Result<()> {
    let started_ns = now_ns();
    let (attachment, bus, config) = join()?;
    attachment.take_place();
    let mut supervisor = Supervisor::new(&bus, &config, attachment.names.run, started_ns)?;
    serve(&attachment, &bus, WakeRole::Supervisor, &mut supervisor)
}

struct Supervisor {
    requests: Inlet<DriveRequest>,
    odometry: Inlet<Odometry>,
    law_states: Inlet<LawState>,
    raw_commands: Inlet<RawCommand>,
    rearms: Inlet<Rearm>,
    commands: Outlet<Command>,
    zones: Outlet<Zone>,
    /// Made before the outlet of `safety`: publishers notice a new reader in this order, so that it receives both
    /// histories, or only this one.
    kept_law_states: Outlet<KeptLawState>,
    safety: Outlet<Safety>,
    run: u64,
    tick_s: f64,
    /// Tells on which leg of the path a vehicle stands.
    reference: Reference,
    answer_age_limit_ns: u64,
    started_ns: u64,
    /// Zones and a pace at the start of the path, and a watch over a vehicle at rest, to be copied into new slots.
    fresh: PerPlant<Fresh>,
    config: RunConfig,
    slots: Vec<Slot>,
    /// Zones that begin with the next tick.
    entered: Vec<Zone>,
    batch: BatchHeader,
    /// A raw command of a batch whose request has not come yet: the two travel on different topics. Odometry
    /// that came before the preceding raw command was answered is held in the same way.
    early: Option<Received<RawCommand>>,
    early_odometry: Option<Received<Odometry>>,
    /// The additional state of a batch in real time.
    clocked: Option<Clocked>,
    counters: Counters,
}

/// What a slot begins with.
#[derive(Clone)]
struct Fresh {
    zones: Zones,
    pace: Pace,
    watch: Watch,
}

impl Fresh {
    fn new(config: &RunConfig) -> Self {
        Self { zones: Zones::new(config), pace: Pace::new(config), watch: Watch::new(config) }
    }
}

struct Slot {
    zones: Zones,
    pace: Pace,
    watch: Watch,
    /// The last pose and speed that were finite.
    measured: Pose,
    speed_mps: f64,
    zone: usize,
    /// The newest answer, and the tick to which it belongs.
    raw: RawCommand,
    raw_tick: u64,
    /// In lockstep: the rate of the reference's clock that was reported last.
    told_rate: f64,
    ended: bool,
}

impl Supervisor {
    fn new(bus: &Bus, config: &RunConfig, run: u64, started_ns: u64) -> Result<Self> {
        Ok(Self {
            requests: bus.inlet()?,
            odometry: bus.inlet()?,
            law_states: bus.inlet()?,
            raw_commands: bus.inlet()?,
            rearms: bus.inlet()?,
            commands: bus.outlet()?,
            zones: bus.outlet()?,
            kept_law_states: bus.outlet()?,
            safety: bus.outlet()?,
            run,
            tick_s: config.drive.tick_s,
            reference: Reference::new(config),
            answer_age_limit_ns: (config.vehicle.safety.answer_age_limit_s * 1e9) as u64,
            started_ns,
            fresh: PerPlant::new(Fresh::new(config)),
            config: config.clone(),
            slots: Vec::new(),
            entered: Vec::new(),
            batch: BatchHeader { attempt: Attempt::between_batches(run), ..BatchHeader::default() },
            early: None,
            early_odometry: None,
            clocked: None,
            counters: Counters::default(),
        })
    }

    fn start_batch(&mut self, header: BatchHeader, requests: &[DriveRequest]) {
        self.slots.clear();
        self.clocked = None;
        if !header.attempt.is_of(self.run) || requests.is_empty() || requests.len() > MAX_FLEET {
            self.counters.dropped += 1;
            return;
        }
        let Self { fresh, slots, config, .. } = self;
        slots.extend(requests.iter().map(|request| {
            let Fresh { zones, pace, watch } = fresh.of(config, request.plant, Fresh::new).clone();
            Slot {
                zones,
                pace,
                watch,
                measured: Pose {
                    x_m: request.start.x_m,
                    y_m: request.start.y_m,
                    yaw_rad: request.start.yaw_rad,
                },
                speed_mps: 0.0,
                zone: 0,
                raw: RawCommand::default(),
                raw_tick: 0,
                told_rate: 1.0,
                ended: false,
            }
        }));
        self.batch = header;
        if requests.iter().any(|request| has(request.flags, DriveRequest::REAL_TIME)) {
            self.clocked = Some(Clocked::new(header.sent_ns < self.started_ns));
        }
    }

    fn is_of_batch(&self, header: TickHeader, len: usize) -> bool {
        header.attempt == self.batch.attempt && len == self.slots.len() && len > 0
    }

    /// Answers a raw command.
    fn pass(&mut self, header: TickHeader, raw: &[RawCommand]) -> Result<()> {
        let received_ns = now_ns();
        if !self.is_of_batch(header, raw.len()) {
            self.counters.dropped += 1;
            return Ok(());
        }
        if self.clocked.is_none() {
            return self.pass_in_lockstep(header, raw, received_ns);
        }
        self.pass_by_the_clock(header, raw, received_ns)
    }
}

/// Reports the gates' states, and the rates of the references' clocks from the next tick on.
fn tell_safety(
    safety: &Outlet<Safety>,
    batch: BatchHeader,
    slots: &[Slot],
    has_reference: bool,
) -> Result<()> {
    let header = BatchHeader { flags: 0, sent_ns: now_ns(), ..batch };
    safety.send(header, slots.len(), |index| {
        let slot = &slots[index];
        Safety {
            tick: slot.raw_tick,
            origin_m: slot.raw.origin_m,
            phase_ticks: slot.raw.phase_ticks,
            clock_rate: slot.clock_rate(),
            has_reference: u32::from(has_reference),
            ..slot.watch.safety()
        }
    })?;
    Ok(())
}

/// Announces zones that begin with the next tick.
fn announce(zones: &Outlet<Zone>, batch: BatchHeader, entered: &[Zone]) -> Result<()> {
    if !entered.is_empty() {
        let header = BatchHeader { flags: 0, sent_ns: now_ns(), ..batch };
        zones.send(header, entered.len(), |index| entered[index])?;
    }
    Ok(())
}

impl Slot {
    /// Takes odometry; returns whether it could be believed. After the end of the drive it is not judged.
    fn see(&mut self, tick: u64, odometry: &Odometry, joins: bool) -> bool {
        let WirePose { x_m, y_m, yaw_rad } = odometry.measured;
        let pose = Pose { x_m, y_m, yaw_rad };
        let Odometry { speed_mps, yaw_rate_radps, steering_rad, .. } = *odometry;
        let movement = Movement { pose, speed_mps, yaw_rate_radps };
        if speed_mps.is_finite() {
            self.speed_mps = speed_mps;
        }
        if self.ended {
            return true;
        }
        if joins {
            self.watch.resume(movement, steering_rad);
        }
        if has(odometry.status, Odometry::HAS_TRUTH) {
            self.watch.tells_truth();
        }
        let obeys = !has(odometry.status, Odometry::OWN_STOP);
        let faults = self.watch.see(tick, movement, obeys);
        if pose.is_finite() {
            self.measured = pose;
        }
        faults == 0
    }

    /// Takes odometry that cannot be believed, but for its speed.
    fn refuse(&mut self, faults: u32, speed_mps: f64) {
        if speed_mps.is_finite() {
            self.speed_mps = speed_mps;
        }
        self.watch.disbelieve(faults, speed_mps);
    }

    /// Takes over what the controller reports; returns the zone that the vehicle has entered, if any.
    fn hear(&mut self, tick: u64, raw: &RawCommand) -> Option<u32> {
        self.raw = *raw;
        self.raw_tick = tick;
        self.ended |= has(raw.flags, Command::ENDED);
        if self.ended {
            return None;
        }
        if !has(raw.flags, RawCommand::FROZEN) {
            self.watch.look_near(raw.reference_along_m);
        }
        self.watch.follow(raw.reference_along_m);
        let RawCommand { speed_mps: asked_mps, reference_along_m: along_m, origin_m, .. } = *raw;
        self.pace.update(tick, self.measured, Progress { asked_mps, along_m, origin_m });
        let zone = self.zones.update(self.measured, along_m, raw.steering_rad);
        let is_new = zone != self.zone;
        self.zone = zone;
        is_new.then_some(zone as u32)
    }

    /// What the raw command wants, within limits, if it is an answer; otherwise a command of our own. After the end of
    /// the drive the vehicle is brought to a stop. Also returns whether the raw command was not finite.
    fn command(&mut self, dt_s: f64, faults: u32, is_answer: bool) -> (Command, bool) {
        let raw = is_answer.then_some(crate::RawCommand {
            speed_mps: self.raw.speed_mps,
            yaw_rate_radps: self.raw.yaw_rate_radps,
            steering_rad: self.raw.steering_rad,
        });
        let passed = match self.ended {
            true => self.watch.end(dt_s, self.speed_mps),
            false => self.watch.command(dt_s, faults, raw),
        };
        self.zones.tell(passed.steering_rad);
        let flag = |on: bool, bit: u32| if on { bit } else { 0 };
        let change = passed.change;
        let command = Command {
            speed_mps: passed.speed_mps,
            yaw_rate_radps: passed.yaw_rate_radps,
            steering_rad: passed.steering_rad,
            flags: flag(self.ended, Command::ENDED)
                | flag(change.speed_limited, Command::SPEED_LIMITED)
                | flag(change.steering_limited, Command::STEERING_LIMITED)
                | flag(change.rejected, Command::REJECTED)
                | flag(change.acceleration_limited, Command::ACCELERATION_LIMITED)
                | flag(change.steering_rate_limited, Command::STEERING_RATE_LIMITED)
                | flag(change.lateral_limited, Command::LATERAL_LIMITED)
                | flag(self.zones.is_refusing(), Command::SWITCH_REFUSED)
                | match self.watch.state() {
                    State::Normal => 0,
                    State::Degraded => Command::DEGRADED,
                    State::Stopping => Command::STOPPING,
                    State::Stopped => Command::STOPPED,
                }
                | if self.ended { 0 } else { self.watch.action_flags() },
            zone: self.zone as u32,
        };
        (command, change.rejected)
    }

    /// The rate of the reference's clock from the next tick on.
    fn clock_rate(&self) -> f64 {
        self.watch.clock_rate(self.pace.rate())
    }

    /// Whether there is nothing left to do for the vehicle: its drive has ended, and it stands.
    fn is_at_rest(&self) -> bool {
        self.ended && self.watch.stands(self.speed_mps)
    }
}

impl Service for Supervisor {
    fn poll(&mut self) -> Result<bool> {
        // In lockstep a request comes when nothing else does, and a raw command that overtakes it is held.
        let mut raw = if self.clocked.is_some() { None } else { self.raw_commands.receive()? };
        if raw.is_none()
            && let Some(request) = self.requests.receive_newest()?
        {
            // The last raw command of a batch is sent before its report, and so before the next request: the
            // recorder must still get the command for it.
            while let Some(raw) = self.raw_commands.receive()? {
                if self.is_of_batch(raw.header(), raw.items().len()) {
                    self.pass(raw.header(), raw.items())?;
                } else {
                    self.early = Some(raw);
                }
            }
            self.start_batch(request.header(), request.items());
            return Ok(true);
        }
        if self.clocked.is_some() {
            // In lockstep no vehicle is stopped for good.
            if self.hear_rearms()? {
                return Ok(true);
            }
            raw = self.raw_commands.receive()?;
        }
        let is_new = raw.is_some();
        let raw = match (raw, self.early.take()) {
            (Some(new), held) => {
                // What was held belongs to no batch that was requested.
                self.counters.dropped += u64::from(held.is_some());
                Some(new)
            }
            (None, held) => held,
        };
        // The raw command is looked for first: the pose that it answers was there before it. In real time odometry counts
        // even if it is never answered.
        if self.clocked.is_some()
            && let Some(odometry) = self.odometry.receive_newest()?
        {
            self.see(odometry.header(), odometry.items());
        }
        let Some(raw) = raw else { return self.look_at_clock() };
        if raw.header().attempt.is_ahead_of(&self.batch.attempt) {
            self.early = Some(raw);
            // The request that it waits for may be here already, and there will be no second wake-up for it.
            return Ok(is_new);
        }
        self.pass(raw.header(), raw.items())?;
        Ok(true)
    }

    fn status(&self) -> Counters {
        self.counters
    }

    fn due_ns(&self) -> u64 {
        self.own_due_ns().unwrap_or(u64::MAX)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::Layers;
    use runtime::run::RunNames;

    #[test]
    fn what_overtakes_its_request_is_held_counts_as_news_and_is_answered_with_its_odometry() {
        let names = RunNames::create().unwrap();
        let bus = Bus::create(&names, 1).unwrap();
        let config = Layers::maneuver("lane_change").unwrap().resolve().unwrap();
        let mut supervisor = Supervisor::new(&bus, &config, names.run, now_ns()).unwrap();
        let (odometry, raw_commands) = (bus.outlet().unwrap(), bus.outlet().unwrap());
        let requests = bus.outlet().unwrap();
        let commands = bus.observe::<Command>().unwrap();
        let first_at = |batch| Attempt { run: names.run, batch, attempt: 1, reserved: 0 };
        let ask = |batch| {
            let header = BatchHeader { attempt: first_at(batch), ..BatchHeader::default() };
            requests.send(header, 1, |_| DriveRequest::default()).unwrap();
        };
        let at =
            |batch, tick| TickHeader { attempt: first_at(batch), tick, ..TickHeader::default() };
        let see = |header, x_m| {
            let measured = WirePose { x_m, ..WirePose::default() };
            odometry.send(header, 1, |_| Odometry { measured, ..Odometry::default() }).unwrap();
        };
        let want = |header, flags| {
            raw_commands
                .send(header, 1, |_| RawCommand { flags, ..RawCommand::default() })
                .unwrap();
        };

        see(at(1, 0), 0.25);
        want(at(1, 0), 0);
        // Counts as progress although there is nothing to do: the request may have come meanwhile, and its wake-up is
        // over.
        assert!(supervisor.poll().unwrap());
        assert!(!supervisor.poll().unwrap());
        ask(1);
        assert!(supervisor.poll().unwrap() && commands.receive().unwrap().is_none());
        assert!(supervisor.poll().unwrap());
        assert_eq!(commands.receive().unwrap().unwrap().header().attempt.batch, 1);
        assert_eq!(supervisor.slots[0].measured.x_m, 0.25);

        // The next batch begins before the last raw command of this one is answered: each has its own odometry.
        see(at(1, 1), 0.5);
        want(at(1, 1), Command::ENDED);
        see(at(2, 0), 0.75);
        assert!(supervisor.poll().unwrap());
        assert_eq!(supervisor.slots[0].measured.x_m, 0.5);
        want(at(2, 0), 0);
        ask(2);
        while supervisor.poll().unwrap() {}
        assert_eq!((supervisor.batch.attempt.batch, supervisor.slots[0].measured.x_m), (2, 0.75));
        let answered: Vec<u64> = std::iter::from_fn(|| commands.receive().unwrap())
            .map(|command| command.header().attempt.batch)
            .collect();
        assert_eq!(answered, [1, 2]);
        drop((supervisor, odometry, raw_commands, requests, commands, bus));
        names.remove();
    }

    #[test]
    fn by_the_clock_the_state_of_a_law_is_handed_on_with_every_command() {
        let names = RunNames::create().unwrap();
        let bus = Bus::create(&names, 1).unwrap();
        let config = Layers::maneuver("lane_change").unwrap().resolve().unwrap();
        let mut supervisor = Supervisor::new(&bus, &config, names.run, now_ns()).unwrap();
        let (odometry, raw_commands) = (bus.outlet().unwrap(), bus.outlet().unwrap());
        let (requests, law_states) = (bus.outlet().unwrap(), bus.outlet().unwrap());
        let kept = bus.observe::<KeptLawState>().unwrap();
        let attempt = Attempt { run: names.run, batch: 1, attempt: 1, reserved: 0 };
        let header = BatchHeader { attempt, sent_ns: now_ns(), ..BatchHeader::default() };
        let flags = DriveRequest::REAL_TIME;
        requests.send(header, 1, |_| DriveRequest { flags, ..DriveRequest::default() }).unwrap();
        while supervisor.poll().unwrap() {}
        let mut answer = |tick, state: Option<LawState>| {
            let at =
                TickHeader { attempt, tick, odometry_sent_ns: now_ns(), ..TickHeader::default() };
            odometry.send(at, 1, |_| Odometry::default()).unwrap();
            if let Some(state) = state {
                law_states.send(header, 1, |_| state).unwrap();
            }
            raw_commands.send(at, 1, |_| RawCommand::default()).unwrap();
            while supervisor.poll().unwrap() {}
            kept.receive_newest().unwrap().map(|it| (it.header().attempt, it.items()[0]))
        };
        // Nothing is known, so nothing is reported.
        assert_eq!(answer(0, None), None);
        let mut state = LawState { tick: 1, count: 2, ..LawState::default() };
        state.numbers[..2].copy_from_slice(&[0.25, -3.0]);
        let LawState { tick, slot, count, numbers } = state;
        let expected = Some((attempt, KeptLawState { tick, slot, count, numbers }));
        assert_eq!(answer(1, Some(state)), expected);
        assert_eq!(answer(2, None), expected);
        drop((supervisor, odometry, raw_commands, requests, law_states, kept, bus));
        names.remove();
    }
}
