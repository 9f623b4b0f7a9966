//! `pathtune conformance`: our vehicle passes, and each broken one fails its own check and no unrelated one.

mod support;

use std::process::Command as Program;
use std::time::Duration;

use anyhow::Result;
use ipc_types::{
    Attempt, BatchHeader, Command, Credit, DriveRequest, Odometry, TickHeader, WakeRole, WirePose,
    has,
};
use runtime::clock::now_ns;
use runtime::{Bus, Counters, Inlet, Outlet, Service, join, serve};
use serde_json::Value;
use simulator::SimulatedVehicle;
use support::Sandbox;
use support::conformance::{FAULT, breaks, failed};
use tracking::Pose;

#[test]
fn our_simulator_passes_and_leaves_nothing() {
    let sandbox = Sandbox::new();
    let (code, ids, found) = failed(&sandbox, "", &["--", "pathtune", "service", "simulator"]);
    assert!(ids.is_empty() && code == Some(0), "{found:#}");
    // All but what belongs to the other way of pacing.
    assert!(found["passed"].as_u64().unwrap() >= 50, "{found:#}");
    sandbox.assert_clean();
}

#[test]
fn a_recording_passes_as_far_as_one_can_that_nobody_steers() {
    let sandbox = Sandbox::new();
    sandbox.json("out", &["drive", "lane_change", "--record"]);
    let recording = sandbox.path("out/recording.mcap").display().to_string();
    let args = ["conformance", "--json", "--", "pathtune", "service", "replayer", &recording];
    let output = sandbox.run(&args);
    let found: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((output.status.code(), &found["failed"]), (Some(0), &0.into()), "{found:#}");
    assert!(found["passed"].as_u64().unwrap() >= 40, "{found:#}");
    sandbox.assert_clean();
}

#[test]
fn nothing_moves_unless_it_is_allowed() {
    let sandbox = Sandbox::new();
    let args = ["conformance", "--json", "--", "pathtune", "service", "simulator"];
    let output = sandbox.run(&args);
    let found: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(found["failed"], 0, "{found:#}");
    let checks = found["checks"].as_array().unwrap();
    let moves = checks.iter().find(|check| check["id"] == "moves").unwrap();
    assert_eq!(moves["verdict"], "skipped");
    assert!(moves["seen"].as_str().unwrap().contains("--allow-motion"));
}

#[test]
fn a_user_s_mistake_is_told_in_a_line() {
    let sandbox = Sandbox::new();
    let cases: [(&[&str], &str); 4] = [
        (&["conformance"], "CMD"),
        (&["conformance", "--", "no-such-program-of-mine"], "no-such-program-of-mine"),
        (&["conformance", "--maneuver", "loop", "--", "true"], "loop"),
        (&["conformance", "--set", "drive.tick_s=-1", "--", "true"], "drive.tick_s"),
    ];
    for (args, part) in cases {
        let output = sandbox.run(args);
        let told = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(64), "{args:?}: {told}");
        assert!(told.contains(part) && told.lines().count() == 1, "{args:?}: {told}");
    }
    // One that never speaks is no mistake of the command line, but fails.
    let (code, ids, _) = failed(&sandbox, "", &["--", "true"]);
    assert_eq!((code, ids.contains("ready")), (Some(1), true));
    sandbox.assert_clean();
}

#[test]
fn broken_life_is_found() {
    breaks(&[
        ("", "", &[]),
        ("late", "ready", &[]),
        ("pauses", "signs_of_life", &[]),
        ("mute", "signs_of_life", &["ready", "exit", "no_leftovers"]),
        ("incarnation", "incarnation", &[]),
        ("capacity", "capacity", &[]),
        ("pacing", "pacing", &[]),
        ("exit code", "exit", &[]),
        ("child", "no_processes", &[]),
    ]);
}

#[test]
fn broken_headers_are_found() {
    breaks(&[
        ("attempt", "names_attempt", &[]),
        ("batch", "names_batch", &[]),
        ("skips", "ticks", &[]),
        ("applied", "applied", &["first_stamps"]),
        ("stamp", "stamps", &["first_stamps", "applied"]),
        ("one short", "elements", &[]),
        ("twice", "one_each", &[]),
        ("not finite", "finite", &[]),
    ]);
}

#[test]
fn broken_obedience_is_found() {
    breaks(&[
        ("any run", "drops_run", &[]),
        ("any batch", "drops_batch", &[]),
        ("any attempt", "drops_attempt", &[]),
        ("stale", "drops_old_tick", &["drops_early_tick"]),
        ("any length", "drops_length", &[]),
        ("no count", "counts_dropped", &[]),
        ("no rejects", "counts_rejected", &[]),
        ("no end", "ended_flag", &["over_is_silent", "ended_stands"]),
        ("no credit", "credit_recorded", &["credit_logged"]),
        ("any credit", "credit_of_another", &["credit_logged"]),
        ("same batch", "reissue", &["joins", "new_publishers"]),
    ]);
}

#[test]
fn broken_numbers_are_found() {
    breaks(&[
        ("yaw sign", "steer_left", &[]),
        ("millimetres", "units_speed", &["start_pose", "fleet"]),
        ("speed in km/h", "units_speed", &["stops"]),
        ("degrees a second", "units_yaw_rate", &[]),
        ("wheel in degrees", "steering_limit", &["units_steering"]),
        ("no reset", "start_pose", &["at_rest", "fleet"]),
        ("order of slots", "start_pose", &["fleet"]),
        ("never moves", "moves", &[]),
        ("never stops", "stops", &[]),
        ("unsteady", "repeats", &[]),
    ]);
}

#[test]
fn counts_that_no_process_can_have_are_not_passed_on() {
    let sandbox = Sandbox::new();
    let exe = std::env::current_exe().unwrap();
    let vehicle = format!("vehicle={} --exact broken_vehicle --ignored --nocapture", exe.display());
    let args = ["train", "lane_change", "--episodes", "1", "--out", "out", "--replace", &vehicle];
    let output = sandbox.command(&args).env(FAULT, "counts").output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{}", sandbox.story("out", &output));
    assert_eq!(said.matches("counts in its Status that no process can have").count(), 1, "{said}");
    let result = sandbox.result("out");
    let vehicle = result["processes"].as_array().unwrap().iter().find(|it| it["name"] == "vehicle");
    assert_eq!(vehicle.unwrap()["dropped"], 0);
    sandbox.assert_clean();
}

#[test]
fn its_folder_is_private_and_removed() {
    let sandbox = Sandbox::new();
    // Where others could have waited for it.
    let theirs = sandbox.path("tmp");
    std::fs::create_dir(&theirs).unwrap();
    let args = ["conformance", "--json", "--", "pathtune", "service", "simulator"];
    let run = sandbox.command(&args).env("TMPDIR", &theirs).spawn().unwrap();
    let root = sandbox.path("r/pathtune");
    let until = std::time::Instant::now() + Duration::from_secs(20);
    let log = loop {
        let roots = std::fs::read_dir(&root).into_iter().flatten().flatten();
        let logs = roots.map(|entry| entry.path().join("conformance/logs/vehicle.log"));
        if let Some(log) = logs.into_iter().find(|log| log.exists()) {
            break log;
        }
        assert!(std::time::Instant::now() < until, "no log below {root:?}");
        std::thread::sleep(Duration::from_millis(5));
    };
    let output = run.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(0));
    assert!(!log.exists() && std::fs::read_dir(&theirs).unwrap().count() == 0);
    sandbox.assert_clean();
}

/// Not a test: the process in the vehicle's role.
#[test]
#[ignore = "a process of the tests above"]
#[allow(clippy::zombie_processes, reason = "it is broken on purpose")]
fn broken_vehicle() {
    let fault = std::env::var(FAULT).unwrap();
    let (mut attachment, bus, config) = join().unwrap();
    let run = attachment.names.run;
    if fault == "late" {
        std::thread::sleep(Duration::from_millis(5500));
    }
    if fault == "mute" {
        std::thread::sleep(Duration::from_secs(60));
    }
    if fault == "child" {
        Program::new("sh").args(["-c", "trap '' INT; exec sleep 60"]).spawn().unwrap();
    }
    if fault == "incarnation" {
        attachment.incarnation += 1;
    }
    let mut vehicle = Broken::new(&bus, SimulatedVehicle::new(&config), run, fault.clone());
    serve(&attachment, &bus, WakeRole::Vehicle, &mut vehicle).unwrap();
    drop((vehicle, bus));
    if fault == "exit code" {
        std::process::exit(3);
    }
}

struct Broken {
    fault: String,
    requests: Inlet<DriveRequest>,
    commands: Inlet<Command>,
    credits: Inlet<Credit>,
    odometry: Outlet<Odometry>,
    run: u64,
    fresh: SimulatedVehicle,
    slots: Vec<(SimulatedVehicle, Odometry)>,
    header: TickHeader,
    waits: bool,
    held_back: bool,
    allowed: Vec<(u32, u64)>,
    batches: u64,
    counters: Counters,
}

impl Broken {
    fn new(bus: &Bus, fresh: SimulatedVehicle, run: u64, fault: String) -> Self {
        let capacity = if fault == "capacity" { 300 } else { 64 };
        let pacing = if fault == "pacing" { 8 } else { 0 };
        let dropped = if fault == "counts" { u64::MAX / 2 } else { 0 };
        Self {
            requests: bus.inlet().unwrap(),
            commands: bus.inlet().unwrap(),
            credits: bus.inlet().unwrap(),
            odometry: bus.outlet().unwrap(),
            run,
            fresh,
            slots: Vec::new(),
            header: TickHeader::default(),
            waits: false,
            held_back: false,
            allowed: Vec::new(),
            batches: 0,
            counters: Counters { capacity, pacing, dropped, ..Counters::default() },
            fault,
        }
    }

    fn is(&self, fault: &str) -> bool {
        self.fault == fault
    }

    fn start(&mut self, of: BatchHeader, requests: &[DriveRequest]) -> Result<()> {
        if self.is("same batch") && of.attempt.batch == self.header.attempt.batch {
            return Ok(());
        }
        self.batches += 1;
        if self.is("pauses") && self.batches == 3 {
            std::thread::sleep(Duration::from_millis(700));
        }
        if !self.is("no reset") {
            self.slots.clear();
        }
        for (_, odometry) in &mut self.slots {
            odometry.status = 0;
        }
        let fresh = self.slots.len();
        self.slots.resize_with(requests.len(), || (self.fresh.clone(), Odometry::default()));
        for index in fresh..requests.len() {
            let from = if self.is("order of slots") { requests.len() - 1 - index } else { index };
            let WirePose { x_m, y_m, yaw_rad } = requests[from].start;
            self.slots[index].0.reset(Pose { x_m, y_m, yaw_rad }, None);
        }
        let flags = requests.iter().fold(0, |flags, request| flags | request.flags);
        self.allowed = [(DriveRequest::RECORDED, Credit::AHEAD), (DriveRequest::LOGGED, 0)]
            .into_iter()
            .filter(|(source, _)| has(flags, *source) && !self.is("no credit"))
            .collect();
        let attempt = Attempt { run: self.run, ..of.attempt };
        self.header = TickHeader { attempt, ..TickHeader::default() };
        self.publish()
    }

    fn publish(&mut self) -> Result<()> {
        self.held_back = self.allowed.iter().any(|(_, ticks)| self.header.tick >= *ticks);
        if self.held_back {
            return Ok(());
        }
        for index in 0..self.slots.len() {
            let odometry = self.observe(index);
            self.slots[index].1 = odometry;
        }
        self.header.odometry_sent_ns = if self.is("stamp") { 1 } else { now_ns() };
        let mut header = self.header;
        header.attempt.attempt += u32::from(self.is("attempt"));
        header.attempt.batch += u64::from(self.is("batch"));
        let slots = &self.slots;
        let short = usize::from(self.fault == "one short" && slots.len() > 1);
        self.odometry.send(header, slots.len() - short, |index| slots[index].1)?;
        self.waits = true;
        Ok(())
    }

    fn observe(&mut self, index: usize) -> Odometry {
        let (vehicle, last) = &mut self.slots[index];
        if has(last.status, Odometry::ENDED) {
            return *last;
        }
        let seen = vehicle.observe();
        let Pose { x_m, y_m, yaw_rad } = seen.measured;
        let mut odometry = Odometry {
            measured: WirePose { x_m, y_m, yaw_rad },
            speed_mps: seen.speed_mps,
            yaw_rate_radps: seen.yaw_rate_radps,
            steering_rad: seen.steering_rad,
            ..Odometry::default()
        };
        match self.fault.as_str() {
            "yaw sign" => odometry.measured.yaw_rad *= -1.0,
            "millimetres" => {
                odometry.measured.x_m *= 1000.0;
                odometry.measured.y_m *= 1000.0;
            }
            "speed in km/h" => odometry.speed_mps *= 3.6,
            "degrees a second" => odometry.yaw_rate_radps = seen.yaw_rate_radps.to_degrees(),
            "wheel in degrees" => odometry.steering_rad = seen.steering_rad.to_degrees(),
            "not finite" if self.header.tick == 60 => odometry.yaw_rate_radps = f64::NAN,
            // Something that no request knows of.
            "unsteady" => odometry.measured.x_m += 1e-6 * self.batches as f64,
            _ => {}
        }
        odometry
    }

    fn hear(&mut self, header: TickHeader, commands: &[Command]) -> Result<()> {
        let ours = self.header;
        let (named, of) = (header.attempt, ours.attempt);
        let fits = (self.is("any run") || named.run == of.run)
            && (self.is("any batch") || named.batch == of.batch)
            && (self.is("any attempt") || named.attempt == of.attempt)
            && (self.is("stale") || header.tick == ours.tick)
            && (self.is("any length") || commands.len() == self.slots.len());
        if !(fits && self.waits) {
            self.counters.dropped += u64::from(!self.is("no count"));
            return Ok(());
        }
        self.waits = false;
        let mut is_over = true;
        for (index, command) in commands.iter().enumerate().take(self.slots.len()) {
            let Command { mut speed_mps, mut steering_rad, flags, .. } = *command;
            if has(flags, Command::ENDED) && !self.is("no end") {
                self.slots[index].1.status |= Odometry::ENDED;
            }
            if has(self.slots[index].1.status, Odometry::ENDED) {
                continue;
            }
            is_over = false;
            if !(speed_mps.is_finite() && steering_rad.is_finite()) {
                self.counters.rejected += u64::from(!self.is("no rejects"));
                (speed_mps, steering_rad) = (0.0, 0.0);
            }
            if self.is("never moves") {
                speed_mps = 0.0;
            }
            // Once it rolls, it rolls on.
            if self.is("never stops") && self.slots[index].1.speed_mps > 0.3 {
                speed_mps = speed_mps.max(1.0);
            }
            self.slots[index].0.step(speed_mps, steering_rad);
        }
        if is_over {
            return Ok(());
        }
        let more = u64::from(self.is("skips") && self.header.tick % 50 == 49);
        self.header.tick += 1 + more;
        self.header.applied_ns = if self.is("applied") { 1 } else { now_ns() };
        self.publish()?;
        if self.is("twice") {
            self.publish()?;
        }
        Ok(())
    }

    fn catch_up(&mut self) -> Result<bool> {
        let mut heard = false;
        while let Some(credit) = self.credits.receive()? {
            heard = true;
            let ours = credit.header().attempt == self.header.attempt;
            for (source, ticks) in &mut self.allowed {
                let credit = credit.items()[0];
                if self.fault == "any credit" || (ours && *source == credit.source) {
                    *ticks = (*ticks).max(credit.ticks + Credit::AHEAD);
                }
            }
        }
        if heard {
            self.publish()?;
        }
        Ok(heard)
    }
}

impl Service for Broken {
    fn poll(&mut self) -> Result<bool> {
        if let Some(request) = self.requests.receive_newest()? {
            self.start(request.header(), request.items())?;
        } else if self.held_back {
            return self.catch_up();
        } else if let Some(command) = self.commands.receive()? {
            self.hear(command.header(), command.items())?;
        } else {
            return Ok(false);
        }
        Ok(true)
    }

    fn status(&self) -> Counters {
        self.counters
    }
}
