//! A vehicle for pathtune: what the contract (`ipc_types/CONTRACT.md`, "What a vehicle does") asks of one, around the
//! plant in `car.rs`. It drives in lockstep, or by the clock with `run.realtime = true` or `--realtime`.

mod car;

use anyhow::Result;
use car::Car;
use config::{MAX_FLEET, RunConfig};
use ipc_types::{
    BatchHeader, Command, Credit, DriveRequest, Odometry, Status, TickHeader, WakeRole, has,
};
use runtime::clock::now_ns;
use runtime::{Bus, Counters, Inlet, Outlet, Service, join, serve};

fn main() -> Result<()> {
    let (attachment, bus, config) = join()?;
    let is_restarted = attachment.incarnation > 1;
    let mut vehicle = MyVehicle::new(&bus, config, attachment.names.run, is_restarted)?;
    serve(&attachment, &bus, WakeRole::Vehicle, &mut vehicle)
}

struct MyVehicle {
    requests: Inlet<DriveRequest>,
    commands: Inlet<Command>,
    credits: Inlet<Credit>,
    odometry: Outlet<Odometry>,
    run: u64,
    config: RunConfig,
    realtime: bool,
    tick_ns: u64,
    age_limit_ns: u64,
    started_ns: u64,
    is_restarted: bool,
    /// The cars of the batch; none before the first.
    slots: Vec<Slot>,
    /// Header of the odometry that was published last.
    header: TickHeader,
    /// Lockstep: that odometry waits for its command.
    waits_for_command: bool,
    /// Lockstep: that odometry waits for a recorder, and is not published yet.
    held_back: bool,
    /// Ticks that each recorder of the batch allows to be published.
    allowed: Vec<(u32, u64)>,
    /// Real time: when tick 0 was, and tick and stamp of the command that is held.
    zero_ns: u64,
    held: Option<(u64, u64)>,
    counters: Counters,
}

struct Slot {
    car: Car,
    speed_mps: f64,
    steering_rad: f64,
    status: u32,
}

impl Slot {
    fn has_ended(&self) -> bool {
        has(self.status, Odometry::ENDED)
    }
}

impl MyVehicle {
    fn new(bus: &Bus, config: RunConfig, run: u64, is_restarted: bool) -> Result<Self> {
        let realtime = config.run.realtime || std::env::args().any(|it| it == "--realtime");
        let ns = |time_s: f64| (time_s * 1e9).round() as u64;
        Ok(Self {
            requests: bus.inlet()?,
            commands: bus.inlet()?,
            credits: bus.inlet()?,
            odometry: bus.outlet()?,
            run,
            realtime,
            tick_ns: ns(config.drive.tick_s),
            age_limit_ns: ns(config.vehicle.safety.command_age_limit_s),
            started_ns: now_ns(),
            is_restarted,
            config,
            slots: Vec::new(),
            header: TickHeader::default(),
            waits_for_command: false,
            held_back: false,
            allowed: Vec::new(),
            zero_ns: 0,
            held: None,
            counters: Counters {
                capacity: MAX_FLEET as u32,
                pacing: if realtime { Status::REAL_TIME } else { 0 },
                ..Counters::default()
            },
        })
    }

    fn start_batch(&mut self, header: BatchHeader, requests: &[DriveRequest]) -> Result<()> {
        (self.waits_for_command, self.held_back, self.held) = (false, false, None);
        self.slots.clear();
        if !header.attempt.is_of(self.run) || requests.is_empty() || requests.len() > MAX_FLEET {
            self.counters.dropped += 1;
            return Ok(());
        }
        let (vehicle, tick_s) = (&self.config.vehicle, self.config.drive.tick_s);
        self.slots.extend(requests.iter().map(|request| Slot {
            car: Car::new(vehicle, tick_s, request.start),
            speed_mps: 0.0,
            steering_rad: 0.0,
            status: 0,
        }));
        // Who records one drive asks for the next when it has the last; who records the whole run says when it is ready.
        let flags = requests.iter().fold(0, |flags, request| flags | request.flags);
        self.allowed = [(DriveRequest::RECORDED, Credit::AHEAD), (DriveRequest::LOGGED, 0)]
            .into_iter()
            .filter(|(source, _)| !self.realtime && has(flags, *source))
            .collect();
        let BatchHeader { attempt, sent_ns, .. } = header;
        self.header = TickHeader { attempt, ..TickHeader::default() };
        self.zero_ns = now_ns();
        if self.realtime && self.is_restarted && sent_ns < self.started_ns {
            // Restarted during a drive: it goes on with that, from where this car now stands, which is the start.
            self.zero_ns = sent_ns;
            self.header.tick = (now_ns() - sent_ns) / self.tick_ns;
        }
        self.publish()
    }

    fn publish(&mut self) -> Result<()> {
        self.held_back = self.allowed.iter().any(|(_, ticks)| self.header.tick >= *ticks);
        if self.held_back {
            return Ok(());
        }
        self.header.odometry_sent_ns = now_ns();
        (self.counters.batch, self.counters.tick) = (self.header.attempt.batch, self.header.tick);
        let slots = &self.slots;
        let observe = |index: usize| slots[index].car.observe(slots[index].status);
        self.odometry.send(self.header, slots.len(), observe)?;
        self.waits_for_command = !self.realtime;
        Ok(())
    }

    /// Publishes what was held back, once every recorder has got far enough.
    fn catch_up(&mut self) -> Result<bool> {
        let mut heard = false;
        // All of them: the newest one may be another recorder's.
        while let Some(message) = self.credits.receive()? {
            heard = true;
            let fits = message.header().attempt == self.header.attempt;
            let Some(credit) = message.items().first().filter(|_| fits) else {
                self.counters.dropped += 1;
                continue;
            };
            for (source, ticks) in &mut self.allowed {
                if *source == credit.source {
                    *ticks = (*ticks).max(credit.ticks.saturating_add(Credit::AHEAD));
                }
            }
        }
        if heard {
            self.publish()?;
        }
        Ok(heard)
    }

    fn hear(&mut self, header: TickHeader, commands: &[Command]) -> Result<()> {
        let fits_tick = if self.realtime {
            self.held.is_none_or(|(tick, _)| header.tick >= tick) && header.tick <= self.header.tick
        } else {
            self.waits_for_command && header.tick == self.header.tick
        };
        let is_ours = header.attempt == self.header.attempt;
        if !(fits_tick && is_ours) || commands.len() != self.slots.len() {
            self.counters.dropped += 1;
            return Ok(());
        }
        let now = now_ns();
        if self.realtime && now.saturating_sub(header.supervisor_sent_ns) > self.age_limit_ns {
            self.counters.late += 1;
            return Ok(());
        }
        for (slot, command) in self.slots.iter_mut().zip(commands) {
            if has(command.flags, Command::ENDED) {
                slot.status |= Odometry::ENDED;
            }
            (slot.speed_mps, slot.steering_rad) = (command.speed_mps, command.steering_rad);
            if !slot.has_ended() && !(slot.speed_mps.is_finite() && slot.steering_rad.is_finite()) {
                self.counters.rejected += 1;
                (slot.speed_mps, slot.steering_rad) = (0.0, 0.0);
            }
        }
        self.header.applied_ns = now;
        self.held = Some((header.tick, header.supervisor_sent_ns));
        if self.realtime { Ok(()) } else { self.drive_in_lockstep() }
    }

    fn drive_in_lockstep(&mut self) -> Result<()> {
        self.waits_for_command = false;
        let mut is_over = true;
        for slot in self.slots.iter_mut().filter(|slot| !slot.has_ended()) {
            slot.car.step(slot.speed_mps, slot.steering_rad);
            is_over = false;
        }
        if is_over {
            return Ok(());
        }
        self.header.tick += 1;
        self.publish()
    }

    fn next_tick_ns(&self) -> Option<u64> {
        let paces = self.realtime && !self.slots.is_empty();
        paces.then(|| self.zero_ns + (self.header.tick + 1) * self.tick_ns)
    }

    /// Drives the ticks that have passed with the commands that are held, and publishes the last of them.
    fn drive_by_clock(&mut self) -> Result<bool> {
        let now = now_ns();
        if self.next_tick_ns().is_none_or(|due_ns| now < due_ns) {
            return Ok(false);
        }
        let tick = (now - self.zero_ns) / self.tick_ns;
        let fresh_since_ns = now - self.age_limit_ns;
        let is_stale = self.held.is_none_or(|(_, sent_ns)| sent_ns < fresh_since_ns);
        for slot in &mut self.slots {
            for _ in self.header.tick..tick {
                if is_stale || slot.has_ended() {
                    slot.car.stop();
                } else {
                    slot.car.step(slot.speed_mps, slot.steering_rad);
                }
            }
            slot.status &= !Odometry::OWN_STOP;
            slot.status |= if is_stale { Odometry::OWN_STOP } else { 0 };
        }
        self.header.tick = tick;
        self.publish()?;
        Ok(true)
    }
}

impl Service for MyVehicle {
    fn poll(&mut self) -> Result<bool> {
        if let Some(request) = self.requests.receive_newest()? {
            self.start_batch(request.header(), request.items())?;
            return Ok(true);
        }
        if self.held_back {
            return self.catch_up();
        }
        if let Some(command) = self.commands.receive()? {
            self.hear(command.header(), command.items())?;
            return Ok(true);
        }
        self.drive_by_clock()
    }

    fn status(&self) -> Counters {
        self.counters
    }

    fn due_ns(&self) -> u64 {
        self.next_tick_ns().unwrap_or(u64::MAX)
    }
}
