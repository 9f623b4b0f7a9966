//! Driving by the clock: what fails on the way, and how soon the vehicle is told something safe.

mod support;

use std::time::{Duration, Instant};

use ipc_types::{BatchHeader, Command as WireCommand, Odometry, Rearm, Safety, TickHeader, has};
use runtime::clock::now_ns;
use runtime::observer::Observer;
use runtime::run::RunNames;
use runtime::{Inlet, Outlet};
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use support::{Sandbox, Training};

/// A car in a roundabout, a quarter of an hour long: the limits of a road, and no end in sight.
const ROUNDABOUT: &[&str] = &[
    "roundabout",
    "--realtime",
    "--vehicle",
    "tesla_model_3_guarded",
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
struct Onlooker {
    commands: Inlet<WireCommand>,
    odometry: Inlet<Odometry>,
    safety: Inlet<Safety>,
    rearms: Outlet<Rearm>,
    run: u64,
    /// The newest of each.
    command: Option<(TickHeader, WireCommand)>,
    seen: Option<(TickHeader, Odometry)>,
    state: u32,
    reasons: u32,
    /// Time of the first safe command, or of the vehicle's own stop, since this was last cleared.
    safe_ns: Option<u64>,
    /// The worst of all: distance from the path, speed.
    off_path_m: f64,
    speed_mps: f64,
    _observer: Observer,
}

impl Onlooker {
    fn new(names: &RunNames) -> Self {
        let observer = Observer::attach(names).unwrap();
        let bus = observer.bus();
        Self {
            commands: bus.observe().unwrap(),
            odometry: bus.observe().unwrap(),
            safety: bus.observe().unwrap(),
            rearms: bus.outlet().unwrap(),
            run: names.run,
            command: None,
            seen: None,
            state: Safety::NORMAL,
            reasons: 0,
            safe_ns: None,
            off_path_m: 0.0,
            speed_mps: 0.0,
            _observer: observer,
        }
    }

    fn look(&mut self) {
        while let Some(message) = self.commands.receive().unwrap() {
            let (header, command) = (message.header(), message.items()[0]);
            let own = WireCommand::DEGRADED | WireCommand::STOPPING | WireCommand::STOPPED;
            if has(command.flags, own) {
                self.note_safe(header.supervisor_sent_ns);
            }
            self.command = Some((header, command));
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
        self.safe_ns = Some(self.safe_ns.map_or(at_ns, |before| before.min(at_ns)));
    }

    /// Looks until something holds.
    fn look_until(&mut self, what: &str, mut holds: impl FnMut(&mut Self) -> bool) {
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

    fn look_for(&mut self, time: Duration) {
        let until = Instant::now() + time;
        while Instant::now() < until {
            self.look();
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    /// Whether commands pass, and the car goes on.
    fn drives(&self) -> bool {
        let (Some((_, command)), Some((_, seen))) = (self.command, self.seen) else { return false };
        self.state == Safety::NORMAL
            && !has(command.flags, WireCommand::DEGRADED | WireCommand::STOPPING)
            && !has(seen.status, Odometry::OWN_STOP)
            && seen.speed_mps > 0.3
    }

    fn rearm(&self) {
        let header = BatchHeader { run: self.run, sent_ns: now_ns(), ..BatchHeader::default() };
        self.rearms.send(header, 1, |_| Rearm::default()).unwrap();
    }

    /// Looks until the car drives again, rearmed where it was stopped; whether it was.
    fn until_it_drives(&mut self) -> bool {
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

fn start<'a>(sandbox: &'a Sandbox, args: &[&str]) -> Training<'a> {
    sandbox.start("drive", "out", args)
}

/// The pid of a service that has been replaced since.
fn pid_of(sandbox: &Sandbox, name: &str) -> i32 {
    let until = Instant::now() + Duration::from_secs(10);
    loop {
        if let Some(pid) = sandbox.service(name) {
            return pid;
        }
        assert!(Instant::now() < until, "no {name}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Numbers from 0 to 1 that are the same in every run.
struct Spread(u64);

impl Spread {
    fn next(&mut self) -> f64 {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }
}

#[test]
fn a_drive_by_the_clock_is_the_drive_in_lockstep() {
    let sandbox = Sandbox::new();
    let args = ["drive", "lane_change"];
    let lockstep = sandbox.json("lockstep", &args);
    let clocked = sandbox.json("clocked", &[&args[..], &["--realtime"]].concat());
    for result in [&lockstep, &clocked] {
        assert_eq!((&result["kind"], &result["reason"]), (&"drive".into(), &"time".into()));
    }
    // A tick that came late on a busy machine may differ; the drive as a whole does not.
    let mse = |result: &Value| result["mse_m2"].as_f64().unwrap();
    let apart = mse(&clocked) / mse(&lockstep);
    assert!((0.8..1.25).contains(&apart), "{apart}");
    let wall_s = clocked["wall_s"].as_f64().unwrap();
    assert!(wall_s >= 5.0, "{wall_s} s for 5 s by the clock");
    sandbox.assert_clean();
}

#[test]
fn every_fault_ends_in_a_safe_command_and_none_is_missed() {
    let injections: usize =
        std::env::var("PATHTUNE_INJECTIONS").map_or(20, |text| text.parse().unwrap());
    let sandbox = Sandbox::new();
    let mut drive = start(&sandbox, ROUNDABOUT);
    drive.wait_for("the run", || sandbox.has_living_run());
    let mut onlooker = Onlooker::new(&sandbox.living_run());
    onlooker.until_it_drives();
    let faults = [
        ("controller", Signal::KILL),
        ("supervisor", Signal::KILL),
        ("simulator", Signal::KILL),
        ("controller", Signal::STOP),
        ("supervisor", Signal::STOP),
        ("simulator", Signal::STOP),
    ];
    let mut spread = Spread(1);
    let mut times_ms: Vec<(f64, &str, Signal)> = Vec::new();
    let mut again_ms = Vec::new();
    let mut stops = 0;
    for index in 0..injections {
        let (service, signal) = faults[index % faults.len()];
        onlooker.look_for(Duration::from_secs_f64(0.2 + 0.1 * spread.next()));
        onlooker.until_it_drives();
        let pid = Pid::from_raw(pid_of(&sandbox, service)).unwrap();
        onlooker.look();
        onlooker.safe_ns = None;
        let fault_ns = now_ns();
        kill_process(pid, signal).unwrap();
        onlooker.look_until("a safe command", |it| it.safe_ns.is_some_and(|at| at >= fault_ns));
        let safe_ns = onlooker.safe_ns.unwrap();
        times_ms.push(((safe_ns - fault_ns) as f64 / 1e6, service, signal));
        let stopped = onlooker.until_it_drives();
        stops += usize::from(stopped);
        if signal == Signal::KILL && service == "controller" {
            again_ms.push((now_ns() - fault_ns) as f64 / 1e6);
        }
    }
    times_ms.sort_by(|a, b| a.0.total_cmp(&b.0));
    again_ms.sort_by(f64::total_cmp);
    let at = |share: f64| times_ms[((times_ms.len() - 1) as f64 * share) as usize].0;
    println!(
        "{injections} faults, none missed; fault to safe command: p50 {:.1} ms, p90 {:.1} ms, p99 {:.1} ms, max {:.1} ms ({} {:?}); \
         {stops} stops; killed controller to driving again: p50 {:.0} ms, max {:.0} ms; off the path at most {:.2} m, {:.2} m/s",
        at(0.5),
        at(0.9),
        at(0.99),
        at(1.0),
        times_ms.last().unwrap().1,
        times_ms.last().unwrap().2,
        again_ms[again_ms.len() / 2],
        again_ms.last().unwrap(),
        onlooker.off_path_m,
        onlooker.speed_mps,
    );
    assert!(onlooker.off_path_m < 1.75, "{}", onlooker.off_path_m);
    assert!(onlooker.speed_mps < 9.0);
    drop(onlooker);
    drive.interrupt();
    drive.finish();
    sandbox.assert_clean();
}

#[test]
fn a_stopped_vehicle_stands_until_it_is_rearmed_and_then_starts_where_it_is() {
    let sandbox = Sandbox::new();
    // Short of the time that it takes to replace a frozen process.
    let args = [ROUNDABOUT, &["--set", "vehicle.safety.degraded_limit_s=0.2"]].concat();
    let mut drive = start(&sandbox, &args);
    drive.wait_for("the run", || sandbox.has_living_run());
    let nothing = sandbox.run(&["rearm"]);
    assert_eq!(nothing.status.code(), Some(64));
    let mut onlooker = Onlooker::new(&sandbox.living_run());
    onlooker.until_it_drives();
    onlooker.look_for(Duration::from_secs(2));
    let nothing = sandbox.run(&["rearm"]);
    assert_eq!(nothing.status.code(), Some(64));
    let said = String::from_utf8_lossy(&nothing.stderr).into_owned();
    assert!(said.contains("no vehicle is stopped"), "{said}");

    // Frozen for longer than a moment: the car is stopped for good.
    let pid = Pid::from_raw(pid_of(&sandbox, "controller")).unwrap();
    kill_process(pid, Signal::STOP).unwrap();
    onlooker.look_until("it stands", |it| it.state == Safety::STOPPED);
    assert!(has(onlooker.reasons, Safety::COMMAND_STALE), "{}", onlooker.reasons);
    onlooker.look_for(Duration::from_secs(2));
    let (_, stands) = onlooker.seen.unwrap();
    assert_eq!(onlooker.state, Safety::STOPPED, "it went on by itself");
    assert!(stands.speed_mps < 0.05, "{}", stands.speed_mps);
    // The wheels are straight, and the reference did not run away.
    assert!(onlooker.command.unwrap().1.steering_rad.abs() < 0.01);

    onlooker.speed_mps = 0.0;
    let rearmed = sandbox.run(&["rearm"]);
    assert!(rearmed.status.success(), "{}", String::from_utf8_lossy(&rearmed.stderr));
    onlooker.look_until("it drives again", |it| it.drives());
    onlooker.look_for(Duration::from_secs(3));
    // No lunge: the reference's 1.2 m/s, and what the law makes of a few decimetres.
    assert!(onlooker.speed_mps < 2.0, "{} m/s behind the rearm", onlooker.speed_mps);
    assert!(onlooker.off_path_m < 1.0, "{}", onlooker.off_path_m);
    drop(onlooker);
    drive.interrupt();
    let output = drive.finish();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(said.contains("is being stopped: no answer of the controller"), "{said}");
    sandbox.assert_clean();
}

#[test]
fn gains_of_a_training_are_driven() {
    let sandbox = Sandbox::new();
    let trained = sandbox.train("training", &["lane_change", "--episodes", "2"]);
    let driven = sandbox.json("driven", &["drive", "lane_change", "--from", "training"]);
    assert_eq!(driven["gains"][0], trained["gains"]);
    let mistake = sandbox.run(&["drive", "lane_change", "--from", "driven"]);
    assert_eq!(mistake.status.code(), Some(64));
    let said = String::from_utf8_lossy(&mistake.stderr).into_owned();
    assert!(said.contains("is not the result of a training"), "{said}");
    sandbox.assert_clean();
}
