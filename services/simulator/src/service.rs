//! The simulator's process: the vehicle role in lockstep.
//!
//! It publishes odometry k, waits for command k, integrates, and publishes k+1: as fast as the rest of the
//! ring answers. With `run.realtime` it paces by the clock instead: see `clocked`.

use anyhow::Result;
use config::{MAX_FLEET, RunConfig};
use ipc_types::{
    Allowance, BatchHeader, Command, Credit, DriveRequest, Odometry, Status, TickHeader, WakeRole,
    WirePose, has,
};
use runtime::clock::now_ns;
use runtime::{Bus, Counters, Inlet, Outlet, Service, Written, join, serve};
use tracking::Pose;

use crate::clocked::Clocked;
use crate::{Observation, SimulatedVehicle};

/// Runs the process until it is asked to stop.
///
/// # Errors
/// If it cannot join the run, or the transport fails.
pub fn run() -> Result<()> {
    let started_ns = now_ns();
    let (attachment, bus, config) = join()?;
    attachment.take_place();
    let mut simulator = Simulator::new(&bus, config, attachment.names.run)?;
    if simulator.config.run.realtime {
        simulator.clocked = Some(Clocked::new(&simulator.config, started_ns));
        simulator.counters.pacing = Status::REAL_TIME | Status::AT_START;
    }
    serve(&attachment, &bus, WakeRole::Vehicle, &mut simulator)
}

struct Simulator {
    requests: Inlet<DriveRequest>,
    commands: Inlet<Command>,
    credits: Inlet<Credit>,
    odometry: Outlet<Odometry>,
    run: u64,
    config: RunConfig,
    slots: Vec<Slot>,
    pace: Pace,
    /// What real time adds.
    clocked: Option<Clocked>,
    counters: Counters,
}

/// What the next tick waits for, in lockstep.
struct Pace {
    /// Header of the odometry that waits for its command; none between batches.
    waiting: Option<TickHeader>,
    /// What the batch's recorders allow.
    allowance: Allowance,
    /// Header of the odometry that waits for a recorder.
    held_back: Option<TickHeader>,
}

impl Pace {
    /// A batch without recorders, before its first odometry.
    fn new() -> Self {
        Self { waiting: None, allowance: Allowance::new(&[]), held_back: None }
    }

    /// Sends odometry, unless a recorder has not got so far; then it is to be written again.
    fn publish(&mut self, written: Written<Odometry>, header: TickHeader) -> Result<()> {
        if !self.allowance.allows(header.tick) {
            self.held_back = Some(header);
            return Ok(());
        }
        self.held_back = None;
        self.waiting = Some(header);
        written.send(|now_ns| TickHeader { odometry_sent_ns: now_ns, ..header })?;
        Ok(())
    }
}

pub(crate) struct Slot {
    pub(crate) vehicle: SimulatedVehicle,
    pub(crate) last: Odometry,
    pub(crate) ended: bool,
    /// In real time: the vehicle stops, because no command is young enough.
    pub(crate) own_stop: bool,
}

impl Simulator {
    fn new(bus: &Bus, config: RunConfig, run: u64) -> Result<Self> {
        Ok(Self {
            requests: bus.inlet()?,
            commands: bus.inlet()?,
            credits: bus.inlet()?,
            odometry: bus.outlet()?,
            run,
            config,
            slots: Vec::new(),
            pace: Pace::new(),
            clocked: None,
            counters: Counters { capacity: MAX_FLEET as u32, ..Counters::default() },
        })
    }

    fn start_batch(&mut self, header: BatchHeader, requests: &[DriveRequest]) -> Result<()> {
        self.pace = Pace::new();
        if !header.attempt.is_of(self.run) || requests.is_empty() || requests.len() > MAX_FLEET {
            self.counters.dropped += 1;
            return Ok(());
        }
        let vehicle = SimulatedVehicle::new(&self.config);
        self.slots.truncate(requests.len());
        while self.slots.len() < requests.len() {
            self.slots.push(Slot {
                vehicle: vehicle.clone(),
                last: Odometry::default(),
                ended: false,
                own_stop: false,
            });
        }
        for (slot, request) in self.slots.iter_mut().zip(requests) {
            let WirePose { x_m, y_m, yaw_rad } = request.start;
            let noise = has(request.flags, DriveRequest::NOISE).then_some(request.seed);
            slot.vehicle.reset(Pose { x_m, y_m, yaw_rad }, noise);
            slot.ended = false;
            slot.own_stop = false;
        }
        if let Some(clocked) = &mut self.clocked {
            clocked.start(header, now_ns());
            self.counters.batch = header.attempt.batch;
            return Ok(());
        }
        self.pace.allowance = Allowance::new(requests);
        self.counters.batch = header.attempt.batch;
        self.counters.tick = 0;
        let slots = &mut self.slots;
        let first = self.odometry.write(slots.len(), |index| slots[index].observe())?;
        let header = TickHeader { attempt: header.attempt, ..TickHeader::default() };
        self.pace.publish(first, header)
    }

    fn obey(&mut self, header: TickHeader, commands: &[Command]) -> Result<()> {
        let Some(waiting) = self.pace.waiting else {
            self.counters.dropped += 1;
            return Ok(());
        };
        if !header_matches(header, waiting) || commands.len() != self.slots.len() {
            self.counters.dropped += 1;
            return Ok(());
        }
        let applied_ns = now_ns();
        let Self { slots, counters, .. } = self;
        let mut any_goes_on = false;
        let next = self.odometry.write(commands.len(), |index| {
            let (slot, command) = (&mut slots[index], &commands[index]);
            slot.ended |= has(command.flags, Command::ENDED);
            if slot.ended {
                slot.last.status |= Odometry::ENDED;
                return slot.last;
            }
            any_goes_on = true;
            let (mut speed_mps, mut steering_rad) = (command.speed_mps, command.steering_rad);
            if !(speed_mps.is_finite() && steering_rad.is_finite()) {
                counters.rejected += 1;
                (speed_mps, steering_rad) = (0.0, 0.0);
            }
            slot.vehicle.step(speed_mps, steering_rad);
            slot.observe()
        })?;
        if !any_goes_on {
            self.pace.waiting = None;
            return Ok(());
        }
        self.counters.tick = waiting.tick + 1;
        let header = TickHeader {
            attempt: waiting.attempt,
            tick: waiting.tick + 1,
            applied_ns,
            ..TickHeader::default()
        };
        self.pace.publish(next, header)
    }
}

impl Slot {
    /// Takes what the sensors tell now: what is published next.
    pub(crate) fn observe(&mut self) -> Odometry {
        let Observation { measured, truth, speed_mps, yaw_rate_radps, steering_rad, collision } =
            self.vehicle.observe();
        let wire = |pose: Pose| WirePose { x_m: pose.x_m, y_m: pose.y_m, yaw_rad: pose.yaw_rad };
        self.last = Odometry {
            measured: wire(measured),
            truth: wire(truth),
            speed_mps,
            yaw_rate_radps,
            steering_rad,
            status: Odometry::HAS_TRUTH | if collision { Odometry::COLLISION } else { 0 },
            reserved: 0,
        };
        self.last
    }
}

impl Simulator {
    /// Publishes what was held back, once every recorder has got far enough.
    fn catch_up(&mut self, held_back: TickHeader) -> Result<bool> {
        let mut any = false;
        // All of them: the newest one may be another recorder's.
        while let Some(credit) = self.credits.receive()? {
            any = true;
            let header = credit.header();
            let is_of_batch = header.attempt == held_back.attempt;
            let Some(credit) = credit.items().first().filter(|_| is_of_batch) else {
                self.counters.dropped += 1;
                continue;
            };
            self.pace.allowance.grant(*credit);
        }
        if any {
            let slots = &self.slots;
            let again = self.odometry.write(slots.len(), |index| slots[index].last)?;
            self.pace.publish(again, held_back)?;
        }
        Ok(any)
    }
}

fn header_matches(a: TickHeader, b: TickHeader) -> bool {
    (a.attempt, a.tick) == (b.attempt, b.tick)
}

impl Service for Simulator {
    fn poll(&mut self) -> Result<bool> {
        // In lockstep a request comes when no command does.
        if self.pace.waiting.is_some()
            && self.pace.held_back.is_none()
            && let Some(command) = self.commands.receive()?
        {
            self.obey(command.header(), command.items())?;
            return Ok(true);
        }
        if let Some(request) = self.requests.receive_newest()? {
            self.start_batch(request.header(), request.items())?;
            return Ok(true);
        }
        if let Some(held_back) = self.pace.held_back {
            return self.catch_up(held_back);
        }
        let Self { clocked, slots, commands, odometry, counters, .. } = self;
        if let Some(clocked) = clocked {
            return clocked.poll(slots, commands, odometry, counters);
        }
        let Some(command) = self.commands.receive()? else { return Ok(false) };
        self.obey(command.header(), command.items())?;
        Ok(true)
    }

    fn status(&self) -> Counters {
        self.counters
    }

    fn due_ns(&self) -> u64 {
        self.clocked.as_ref().map_or(u64::MAX, Clocked::due_ns)
    }
}
