//! One who looks on while a vehicle drives by the clock, and rearms it where it was stopped.

use std::time::{Duration, Instant};

use ipc_types::{
    Attempt, BatchHeader, Command as WireCommand, Odometry, RawCommand, Rearm, Safety, TickHeader,
    has,
};
use runtime::clock::now_ns;
use runtime::observer::Observer;
use runtime::run::RunNames;
use runtime::{Inlet, Outlet};
use rustix::process::{Pid, Signal, kill_process};

/// A roundabout without an end: a quarter of an hour, and the drive gear in.
pub const ROUNDABOUT: &[&str] = &[
    "roundabout",
    "--set",
    "drive.loop_time_s=3600",
    "--set",
    "path.pieces=[{kind='straight',length_m=4.0},{kind='arc',radius_m=18.0,angle_deg=3600.0}]",
    "--set",
    "vehicle.gear_engaged=true",
    "--restart-budget",
    "100000",
];

/// One who looks on, and keeps what was said of the first vehicle.
pub struct Onlooker {
    commands: Inlet<WireCommand>,
    raw_commands: Inlet<RawCommand>,
    odometry: Inlet<Odometry>,
    safety: Inlet<Safety>,
    rearms: Outlet<Rearm>,
    run: u64,
    /// The newest of each.
    pub command: Option<(TickHeader, WireCommand)>,
    pub seen: Option<(TickHeader, Odometry)>,
    pub state: u32,
    pub reasons: u32,
    /// What the law asked for last, and the first that the successor of a killed controller asked for.
    pub raw: Option<RawCommand>,
    pub raw_again: Option<RawCommand>,
    /// Time of the first safe command, or of the vehicle's own stop, behind the last fault.
    pub safe_ns: Option<u64>,
    /// Time of the first command behind it that the successor of whoever was hit has had a part in.
    pub healed_ns: Option<u64>,
    fault_ns: u64,
    /// Who was hit, and since when it cannot have sent anything.
    hit: Option<(&'static str, u64)>,
    /// The worst of all: distance from the path, speed.
    pub off_path_m: f64,
    pub speed_mps: f64,
    /// The largest step of the steering from one tick's command to the next one's.
    pub step_rad: f64,
    _observer: Observer,
}

impl Onlooker {
    pub fn new(names: &RunNames) -> Self {
        let observer = Observer::attach(names).unwrap();
        let bus = observer.bus();
        Self {
            commands: bus.observe().unwrap(),
            raw_commands: bus.observe().unwrap(),
            odometry: bus.observe().unwrap(),
            safety: bus.observe().unwrap(),
            rearms: bus.outlet().unwrap(),
            run: names.run,
            command: None,
            seen: None,
            raw: None,
            raw_again: None,
            state: Safety::NORMAL,
            reasons: 0,
            safe_ns: None,
            healed_ns: None,
            fault_ns: 0,
            hit: None,
            off_path_m: 0.0,
            speed_mps: 0.0,
            step_rad: 0.0,
            _observer: observer,
        }
    }

    pub fn look(&mut self) {
        while let Some(message) = self.commands.receive().unwrap() {
            let (header, command) = (message.header(), message.items()[0]);
            let own = WireCommand::DEGRADED | WireCommand::STOPPING | WireCommand::STOPPED;
            if has(command.flags, own) {
                self.note_safe(header.supervisor_sent_ns);
            }
            self.note_healed(header);
            if let Some((last, before)) = self.command {
                let ticks = header.tick.saturating_sub(last.tick).max(1) as f64;
                let step_rad = (command.steering_rad - before.steering_rad).abs() / ticks;
                self.step_rad = self.step_rad.max(step_rad);
            }
            self.command = Some((header, command));
        }
        while let Some(message) = self.raw_commands.receive().unwrap() {
            let (header, raw) = (message.header(), message.items()[0]);
            match self.hit {
                Some(("controller", since_ns)) if header.controller_sent_ns > since_ns => {
                    self.raw_again.get_or_insert(raw);
                }
                _ => self.raw = Some(raw),
            }
        }
        while let Some(message) = self.odometry.receive().unwrap() {
            let (header, odometry) = (message.header(), message.items()[0]);
            if has(odometry.status, Odometry::OWN_STOP) {
                self.note_safe(header.odometry_sent_ns);
            }
            self.off_path_m = self.off_path_m.max(off_path_m(&odometry));
            self.speed_mps = self.speed_mps.max(odometry.speed_mps.abs());
            self.seen = Some((header, odometry));
        }
        while let Some(message) = self.safety.receive().unwrap() {
            (self.state, self.reasons) = (message.items()[0].state, message.items()[0].reasons);
        }
    }

    fn note_safe(&mut self, at_ns: u64) {
        if at_ns >= self.fault_ns {
            self.safe_ns = Some(self.safe_ns.map_or(at_ns, |before| before.min(at_ns)));
        }
    }

    fn note_healed(&mut self, header: TickHeader) {
        let Some((service, since_ns)) = self.hit else { return };
        let its_part_ns = match service {
            "controller" => header.controller_sent_ns,
            "supervisor" => header.supervisor_sent_ns,
            _ => header.odometry_sent_ns,
        };
        if its_part_ns > since_ns {
            self.healed_ns.get_or_insert(header.supervisor_sent_ns);
        }
    }

    /// Kills or freezes a process of the run; waits for the first safe command behind it, for the vehicle's own stop, or
    /// for a successor that is there before the vehicle had to stop. Milliseconds until then, and whether it was that.
    pub fn strike(&mut self, service: &'static str, pid: i32, signal: Signal) -> (f64, bool) {
        self.hit = None;
        self.look();
        (self.safe_ns, self.healed_ns, self.hit, self.raw_again) = (None, None, None, None);
        self.fault_ns = now_ns();
        kill_process(Pid::from_raw(pid).unwrap(), signal).unwrap();
        while is_running(pid) {}
        self.hit = Some((service, now_ns()));
        self.look_until("a safe command", |it| it.safe_ns.or(it.healed_ns).is_some());
        let until_ns = self.safe_ns.into_iter().chain(self.healed_ns).min().unwrap();
        ((until_ns - self.fault_ns) as f64 / 1e6, self.safe_ns.is_none())
    }

    /// Looks until something holds.
    pub fn look_until(&mut self, what: &str, mut holds: impl FnMut(&mut Self) -> bool) {
        let until = Instant::now() + Duration::from_secs(20);
        loop {
            self.look();
            if holds(self) {
                return;
            }
            assert!(
                Instant::now() < until,
                "{what}: state {}, reasons {}, {:?}, {:?}",
                self.state,
                self.reasons,
                self.command,
                self.seen
            );
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    pub fn look_for(&mut self, time: Duration) {
        let until = Instant::now() + time;
        while Instant::now() < until {
            self.look();
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    /// Whether commands pass, and the car goes on.
    pub fn drives(&self) -> bool {
        let (Some((_, command)), Some((_, seen))) = (self.command, self.seen) else { return false };
        self.state == Safety::NORMAL
            && !has(command.flags, WireCommand::DEGRADED | WireCommand::STOPPING)
            && !has(seen.status, Odometry::OWN_STOP)
            && seen.speed_mps > 0.3
    }

    pub fn rearm(&self) {
        let attempt = Attempt::between_batches(self.run);
        let header = BatchHeader { attempt, sent_ns: now_ns(), ..BatchHeader::default() };
        self.rearms.send(header, 1, |_| Rearm::default()).unwrap();
    }

    /// Looks until the car drives again, rearmed where it was stopped; whether it was.
    pub fn until_it_drives(&mut self) -> bool {
        let mut stopped = false;
        self.look_until("it drives again", |it| {
            if it.state == Safety::STOPPED {
                stopped = true;
                it.rearm();
            }
            it.drives()
        });
        stopped
    }
}

/// Distance of the true pose from the path of [`ROUNDABOUT`].
fn off_path_m(odometry: &Odometry) -> f64 {
    let (x_m, y_m) = (odometry.truth.x_m, odometry.truth.y_m);
    let from_circle_m = ((x_m - 4.0).hypot(y_m - 18.0) - 18.0).abs();
    if x_m < 4.0 && y_m < 9.0 { from_circle_m.min(y_m.abs()) } else { from_circle_m }
}

/// Whether a process still does anything: a signal takes effect a moment after it was sent.
fn is_running(pid: i32) -> bool {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
    let state = stat.rsplit_once(") ").and_then(|(_, rest)| rest.chars().next());
    state.is_some_and(|state| !"TZX".contains(state))
}
