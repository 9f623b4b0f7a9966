//! The simulator's process: the vehicle role, in `lockstep` or, with `run.realtime`, `by_the_clock`.

mod by_the_clock;
mod lockstep;

use anyhow::Result;
use config::{MAX_FLEET, RunConfig};
use ipc_types::{
    BatchHeader, Command, Credit, DriveRequest, Odometry, Status, WakeRole, WirePose, has,
};
use runtime::clock::now_ns;
use runtime::{Bus, Counters, Inlet, Outlet, Service, join, serve};
use tracking::Pose;

use crate::{Observation, SimulatedVehicle};
use by_the_clock::Clocked;
use lockstep::Lockstep;

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
    /// The configured vehicle; once they are asked for, behind it the plants of the configuration.
    plants: Vec<SimulatedVehicle>,
    config: RunConfig,
    slots: Vec<Slot>,
    lockstep: Lockstep,
    /// The additional state in real time.
    clocked: Option<Clocked>,
    counters: Counters,
}

struct Slot {
    vehicle: SimulatedVehicle,
    /// Which of the plants it is.
    plant: u32,
    last: Odometry,
    ended: bool,
    /// In real time: the vehicle stops, because no command is recent enough.
    own_stop: bool,
    /// In real time: the speed that the vehicle's stop commanded last, while it stops.
    stop_mps: Option<f64>,
}

impl Simulator {
    fn new(bus: &Bus, config: RunConfig, run: u64) -> Result<Self> {
        Ok(Self {
            requests: bus.inlet()?,
            commands: bus.inlet()?,
            credits: bus.inlet()?,
            odometry: bus.outlet()?,
            run,
            plants: vec![SimulatedVehicle::new(&config)],
            config,
            slots: Vec::new(),
            lockstep: Lockstep::new(&[]),
            clocked: None,
            counters: Counters { capacity: MAX_FLEET as u32, ..Counters::default() },
        })
    }

    fn start_batch(&mut self, header: BatchHeader, requests: &[DriveRequest]) -> Result<()> {
        self.lockstep = Lockstep::new(&[]);
        if !header.attempt.is_of(self.run) || requests.is_empty() || requests.len() > MAX_FLEET {
            self.counters.dropped += 1;
            return Ok(());
        }
        if requests.iter().any(|request| request.plant > 0) && self.plants.len() == 1 {
            let changes = self.config.plant_changes();
            let plants =
                changes.iter().map(|it| SimulatedVehicle::new(&self.config.with_plant(it)));
            self.plants.extend(plants);
        }
        if requests.iter().any(|request| request.plant as usize >= self.plants.len()) {
            self.counters.dropped += 1;
            return Ok(());
        }
        self.slots.truncate(requests.len());
        while self.slots.len() < requests.len() {
            self.slots.push(Slot {
                vehicle: self.plants[0].clone(),
                plant: 0,
                last: Odometry::default(),
                ended: false,
                own_stop: false,
                stop_mps: None,
            });
        }
        for (slot, request) in self.slots.iter_mut().zip(requests) {
            let WirePose { x_m, y_m, yaw_rad } = request.start;
            let noise = has(request.flags, DriveRequest::NOISE).then_some(request.seed);
            if slot.plant != request.plant {
                slot.vehicle = self.plants[request.plant as usize].clone();
                slot.plant = request.plant;
            }
            slot.vehicle.reset(Pose { x_m, y_m, yaw_rad }, noise);
            slot.ended = false;
            slot.own_stop = false;
            slot.stop_mps = None;
        }
        if let Some(clocked) = &mut self.clocked {
            clocked.start(header, now_ns());
            self.counters.batch = header.attempt.batch;
            return Ok(());
        }
        self.lockstep = Lockstep::new(requests);
        self.counters.batch = header.attempt.batch;
        self.counters.tick = 0;
        self.lockstep.start(header, &mut self.slots, &self.odometry)
    }
}

impl Slot {
    /// Reads the sensors: returns what is published next.
    fn observe(&mut self) -> Odometry {
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

impl Service for Simulator {
    fn poll(&mut self) -> Result<bool> {
        let Self { lockstep, slots, commands, odometry, counters, .. } = self;
        // In lockstep a request comes when no command does.
        if lockstep.awaits_command()
            && let Some(command) = commands.receive()?
        {
            lockstep.obey(command.header(), command.items(), slots, odometry, counters)?;
            return Ok(true);
        }
        if let Some(request) = self.requests.receive_newest()? {
            self.start_batch(request.header(), request.items())?;
            return Ok(true);
        }
        if let Some(held_back) = lockstep.held_back() {
            return lockstep.catch_up(held_back, &self.credits, slots, odometry, counters);
        }
        if let Some(clocked) = &mut self.clocked {
            return clocked.poll(slots, commands, odometry, counters);
        }
        let Some(command) = commands.receive()? else { return Ok(false) };
        lockstep.obey(command.header(), command.items(), slots, odometry, counters)?;
        Ok(true)
    }

    fn status(&self) -> Counters {
        self.counters
    }

    fn due_ns(&self) -> u64 {
        self.clocked.as_ref().map_or(u64::MAX, Clocked::due_ns)
    }
}
