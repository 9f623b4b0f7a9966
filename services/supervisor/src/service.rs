//! The supervisor's process: it stands in the command path, and tells the zone.

use anyhow::Result;
use config::{MAX_FLEET, RunConfig};
use ipc_types::{
    BatchHeader, Command, DriveRequest, Odometry, RawCommand, TickHeader, WakeRole, Zone, has,
};
use runtime::clock::now_ns;
use runtime::{Bus, Counters, Inlet, Outlet, Received, Service, join, serve};
use tracking::{Pose, ZoneTracker};

use crate::{Gate, Passed, SpeedGovernor};

/// Runs the process until it is asked to stop.
///
/// # Errors
/// If it cannot join the run, or the transport fails.
pub fn run() -> Result<()> {
    let (attachment, bus, config) = join()?;
    attachment.pin();
    let mut supervisor = Supervisor::new(&bus, &config, attachment.names.run)?;
    serve(&attachment, &bus, WakeRole::Supervisor, &mut supervisor)
}

struct Supervisor {
    requests: Inlet<DriveRequest>,
    odometry: Inlet<Odometry>,
    raw_commands: Inlet<RawCommand>,
    commands: Outlet<Command>,
    zones: Outlet<Zone>,
    run: u64,
    gate: Gate,
    /// A tracker at the start of the path and a governor at rest, to be copied into new slots.
    fresh: (ZoneTracker, SpeedGovernor),
    slots: Vec<Slot>,
    /// Zones that begin with the next tick.
    entered: Vec<Zone>,
    batch: BatchHeader,
    /// A raw command of a batch whose request has not come yet: the two travel on different topics.
    early: Option<Received<RawCommand>>,
    counters: Counters,
}

struct Slot {
    tracker: ZoneTracker,
    governor: SpeedGovernor,
    measured: Pose,
    speed_mps: f64,
    zone: usize,
}

impl Supervisor {
    fn new(bus: &Bus, config: &RunConfig, run: u64) -> Result<Self> {
        Ok(Self {
            requests: bus.inlet()?,
            odometry: bus.inlet()?,
            raw_commands: bus.inlet()?,
            commands: bus.outlet()?,
            zones: bus.outlet()?,
            run,
            gate: Gate::new(config),
            fresh: (ZoneTracker::new(config), SpeedGovernor::new(config)),
            slots: Vec::new(),
            entered: Vec::new(),
            batch: BatchHeader::default(),
            early: None,
            counters: Counters::default(),
        })
    }

    fn start_batch(&mut self, header: BatchHeader, requests: &[DriveRequest]) {
        self.slots.clear();
        if header.run != self.run || requests.is_empty() || requests.len() > MAX_FLEET {
            self.counters.dropped += 1;
            return;
        }
        self.slots.extend(requests.iter().map(|request| Slot {
            tracker: self.fresh.0.clone(),
            governor: self.fresh.1,
            speed_mps: 0.0,
            measured: Pose {
                x_m: request.start.x_m,
                y_m: request.start.y_m,
                yaw_rad: request.start.yaw_rad,
            },
            zone: 0,
        }));
        self.batch = header;
    }

    fn is_of_batch(&self, header: TickHeader, len: usize) -> bool {
        (header.run, header.batch, header.attempt)
            == (self.run, self.batch.batch, self.batch.attempt)
            && len == self.slots.len()
            && len > 0
    }

    fn note_poses(&mut self, header: TickHeader, odometry: &[Odometry]) {
        if !self.is_of_batch(header, odometry.len()) {
            return;
        }
        for (slot, odometry) in self.slots.iter_mut().zip(odometry) {
            let measured = Pose {
                x_m: odometry.measured.x_m,
                y_m: odometry.measured.y_m,
                yaw_rad: odometry.measured.yaw_rad,
            };
            if measured.is_finite() {
                slot.measured = measured;
            } else {
                self.counters.rejected += 1;
            }
            // The governor takes what is not finite for the last speed that was.
            slot.speed_mps = odometry.speed_mps;
        }
    }

    fn pass(&mut self, header: TickHeader, raw: &[RawCommand]) -> Result<()> {
        let received_ns = now_ns();
        if !self.is_of_batch(header, raw.len()) {
            self.counters.dropped += 1;
            return Ok(());
        }
        self.tell_zones(header, raw)?;
        self.counters.batch = header.batch;
        self.counters.tick = header.tick + 1;
        let Self { gate, slots, counters, .. } = self;
        let header = TickHeader {
            supervisor_received_ns: received_ns,
            supervisor_sent_ns: now_ns(),
            ..header
        };
        self.commands.send(header, raw.len(), |index| {
            let raw = &raw[index];
            let slot = &mut slots[index];
            let allowed_mps = slot.governor.allowed_mps(slot.speed_mps);
            let passed =
                gate.pass(allowed_mps, raw.speed_mps, raw.yaw_rate_radps, raw.steering_rad);
            counters.rejected += u64::from(passed.change.rejected);
            to_command(passed, has(raw.flags, Command::ENDED), slot.zone)
        })?;
        Ok(())
    }

    /// Announces zones that begin with the next tick, before this tick's command.
    fn tell_zones(&mut self, header: TickHeader, raw: &[RawCommand]) -> Result<()> {
        self.entered.clear();
        for (index, (slot, raw)) in self.slots.iter_mut().zip(raw).enumerate() {
            if has(raw.flags, Command::ENDED) {
                continue;
            }
            let zone = slot.tracker.update(slot.measured, raw.reference_along_m);
            if zone != slot.zone {
                slot.zone = zone;
                let (from_tick, zone) = (header.tick + 1, zone as u32);
                self.entered.push(Zone { from_tick, slot: index as u32, zone });
            }
        }
        if !self.entered.is_empty() {
            let header = BatchHeader { flags: 0, sent_ns: now_ns(), ..self.batch };
            let entered = &self.entered;
            self.zones.send(header, entered.len(), |index| entered[index])?;
        }
        Ok(())
    }
}

fn to_command(passed: Passed, ended: bool, zone: usize) -> Command {
    let flag = |on: bool, bit: u32| if on { bit } else { 0 };
    Command {
        // A drive that has ended is no reason to go on.
        speed_mps: if ended { 0.0 } else { passed.speed_mps },
        yaw_rate_radps: passed.yaw_rate_radps,
        steering_rad: passed.steering_rad,
        flags: flag(ended, Command::ENDED)
            | flag(passed.change.speed_limited, Command::SPEED_LIMITED)
            | flag(passed.change.steering_limited, Command::STEERING_LIMITED)
            | flag(passed.change.rejected, Command::REJECTED),
        zone: zone as u32,
    }
}

impl Service for Supervisor {
    fn poll(&mut self) -> Result<bool> {
        if let Some(request) = self.requests.receive_newest()? {
            // The last raw command of a batch is sent before its report, and so before the next request: whoever
            // records is owed its command.
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
        // The raw command is looked for first: the pose that it answers was there before it.
        let raw = match (self.raw_commands.receive()?, self.early.take()) {
            (Some(new), held) => {
                // What was held belongs to nothing that anybody asked for.
                self.counters.dropped += u64::from(held.is_some());
                new
            }
            (None, Some(held)) => held,
            (None, None) => return Ok(false),
        };
        let (header, batch) = (raw.header(), self.batch);
        if header.run == self.run && (header.batch, header.attempt) > (batch.batch, batch.attempt) {
            self.early = Some(raw);
            return Ok(false);
        }
        if let Some(odometry) = self.odometry.receive_newest()? {
            self.note_poses(odometry.header(), odometry.items());
        }
        self.pass(raw.header(), raw.items())?;
        Ok(true)
    }

    fn status(&self) -> Counters {
        self.counters
    }
}
