//! `pathtune conformance --realtime`: each vehicle with a broken clock fails its own check and no unrelated one.

mod support;

use anyhow::Result;
use config::RunConfig;
use ipc_types::{
    Attempt, BatchHeader, Command, DriveRequest, Odometry, Status, TickHeader, WakeRole, WirePose,
    has,
};
use runtime::clock::now_ns;
use runtime::{Bus, Counters, Inlet, Outlet, Service, join, serve};
use support::conformance::{FAULT, breaks};

#[test]
fn a_broken_clock_is_found() {
    breaks(&[
        ("clock", "", &[]),
        ("clock, half the rate", "rate", &[]),
        ("clock, counts messages", "tick_by_time", &["ticks", "joins"]),
        ("clock, begins anew", "joins", &[]),
        ("clock, silent at the end", "goes_on", &["ended_flag"]),
    ]);
}

#[test]
fn a_broken_own_stop_is_found() {
    breaks(&[
        ("clock, no own stop", "own_stop", &[]),
        ("clock, stops hard", "own_stop_slows", &[]),
        ("clock, takes late ones", "counts_late", &[]),
        // On a loaded machine a command may come too late before that is meant, and it stands from then on.
        ("clock, never resumes", "resumes", &["forward", "steer_left"]),
        ("clock, any run", "drops_run", &[]),
    ]);
}

/// Not a test: the process in the vehicle's role.
#[test]
#[ignore = "a process of the tests above"]
fn broken_vehicle() {
    let (attachment, bus, config) = join().unwrap();
    let is_restarted = attachment.incarnation > 1;
    let mut vehicle = Broken::new(&bus, config, attachment.names.run, is_restarted);
    serve(&attachment, &bus, WakeRole::Vehicle, &mut vehicle).unwrap();
}

/// One car on a straight: the clock is what is looked at.
struct Broken {
    fault: String,
    requests: Inlet<DriveRequest>,
    commands: Inlet<Command>,
    odometry: Outlet<Odometry>,
    run: u64,
    is_restarted: bool,
    config: RunConfig,
    tick_ns: u64,
    header: TickHeader,
    /// Ticks that were driven, however they are counted.
    driven: u64,
    zero_ns: u64,
    due_ns: u64,
    cars: Vec<Odometry>,
    command: Command,
    heard: (u64, u64),
    sticks: bool,
    counters: Counters,
}

impl Broken {
    fn new(bus: &Bus, config: RunConfig, run: u64, is_restarted: bool) -> Self {
        Self {
            fault: std::env::var(FAULT).unwrap().replace("clock, ", ""),
            requests: bus.inlet().unwrap(),
            commands: bus.inlet().unwrap(),
            odometry: bus.outlet().unwrap(),
            run,
            is_restarted,
            tick_ns: (config.drive.tick_s * 1e9) as u64,
            config,
            header: TickHeader::default(),
            driven: 0,
            zero_ns: 0,
            due_ns: u64::MAX,
            cars: Vec::new(),
            command: Command::default(),
            heard: (0, 0),
            sticks: false,
            counters: Counters { capacity: 4, pacing: Status::REAL_TIME, ..Counters::default() },
        }
    }

    fn is(&self, fault: &str) -> bool {
        self.fault == fault
    }

    fn start(&mut self, of: BatchHeader, requests: &[DriveRequest]) -> Result<()> {
        let car =
            |request: &DriveRequest| Odometry { measured: request.start, ..Odometry::default() };
        self.cars = requests.iter().map(car).collect();
        (self.command, self.heard, self.sticks) = (Command::default(), (0, 0), false);
        let BatchHeader { attempt, sent_ns, .. } = of;
        self.header = TickHeader { attempt, ..TickHeader::default() };
        self.zero_ns = now_ns();
        if std::mem::take(&mut self.is_restarted) && !self.is("begins anew") {
            self.zero_ns = sent_ns;
            self.header.tick = (now_ns() - sent_ns) / self.tick_ns;
        }
        self.driven = self.header.tick;
        self.publish()
    }

    fn publish(&mut self) -> Result<()> {
        self.header.odometry_sent_ns = now_ns();
        let cars = &self.cars;
        self.odometry.send(self.header, cars.len(), |index| cars[index])?;
        let slower = 1 + u64::from(self.is("half the rate"));
        let ticks = (now_ns() - self.zero_ns) / self.tick_ns + slower;
        self.due_ns = self.zero_ns + ticks * self.tick_ns;
        Ok(())
    }

    fn hear(&mut self, header: TickHeader, commands: &[Command]) {
        let ours = self.header;
        let of = if self.is("any run") { header.attempt.run } else { self.run };
        let fits = header.attempt == Attempt { run: of, ..ours.attempt }
            && header.tick >= self.heard.0
            && commands.len() == self.cars.len();
        if !fits {
            self.counters.dropped += 1;
            return;
        }
        if self.is_too_old(header.supervisor_sent_ns) && !self.is("takes late ones") {
            self.counters.late += 1;
            return;
        }
        self.heard = (header.tick, header.supervisor_sent_ns);
        if self.is("takes late ones") {
            self.heard.1 = now_ns();
        }
        self.command = commands[0];
        if !self.command.speed_mps.is_finite() {
            self.counters.rejected += 1;
            self.command.speed_mps = 0.0;
        }
        for (car, command) in self.cars.iter_mut().zip(commands) {
            car.status |= if has(command.flags, Command::ENDED) { Odometry::ENDED } else { 0 };
        }
        self.header.applied_ns = now_ns();
    }

    fn is_too_old(&self, sent_ns: u64) -> bool {
        let limit_ns = (self.config.vehicle.safety.command_age_limit_s * 1e9) as u64;
        now_ns().saturating_sub(sent_ns) > limit_ns
    }

    fn drive(&mut self) -> Result<()> {
        let tick = (now_ns() - self.zero_ns) / self.tick_ns;
        self.sticks |=
            self.is("never resumes") && self.heard.0 > 20 && self.is_too_old(self.heard.1);
        let stops = self.is_too_old(self.heard.1) || self.sticks;
        let vehicle = self.config.vehicle.clone();
        let hard = if self.is("stops hard") { 4.0 } else { 1.0 };
        let down_mps = hard * vehicle.safety.stop_deceleration_mps2 * self.config.drive.tick_s;
        for _ in std::mem::replace(&mut self.driven, tick)..tick {
            for car in &mut self.cars {
                let ends = stops || has(car.status, Odometry::ENDED);
                let wanted_mps = if ends { 0.0 } else { self.command.speed_mps.max(0.0) };
                let change_mps = (wanted_mps - car.speed_mps).clamp(-down_mps, 0.02);
                car.speed_mps += change_mps;
                let limit_rad = vehicle.steering_limit_rad;
                let wanted_rad = if ends { 0.0 } else { self.command.steering_rad };
                let turn_rad = wanted_rad.clamp(-limit_rad, limit_rad) - car.steering_rad;
                car.steering_rad += turn_rad.clamp(-0.006, 0.006);
                car.yaw_rate_radps = car.speed_mps * car.steering_rad.tan() / vehicle.wheelbase_m;
                let WirePose { x_m, y_m, yaw_rad } = &mut car.measured;
                *yaw_rad += car.yaw_rate_radps * self.config.drive.tick_s;
                *x_m += car.speed_mps * yaw_rad.cos() * self.config.drive.tick_s;
                *y_m += car.speed_mps * yaw_rad.sin() * self.config.drive.tick_s;
            }
        }
        let flag = if stops && !self.is("no own stop") { Odometry::OWN_STOP } else { 0 };
        for car in &mut self.cars {
            car.status = car.status & !Odometry::OWN_STOP | flag;
        }
        // Of ten ticks it counts nine.
        self.header.tick = if self.is("counts messages") { tick * 9 / 10 } else { tick };
        self.publish()
    }
}

impl Service for Broken {
    fn poll(&mut self) -> Result<bool> {
        if let Some(request) = self.requests.receive_newest()? {
            self.start(request.header(), request.items())?;
        } else if let Some(command) = self.commands.receive()? {
            self.hear(command.header(), command.items());
        } else if now_ns() >= self.due_ns {
            let is_over = self.cars.iter().all(|car| has(car.status, Odometry::ENDED));
            if is_over && self.is("silent at the end") {
                self.due_ns = u64::MAX;
                return Ok(true);
            }
            self.drive()?;
        } else {
            return Ok(false);
        }
        Ok(true)
    }

    fn due_ns(&self) -> u64 {
        self.due_ns
    }

    fn status(&self) -> Counters {
        self.counters
    }
}
