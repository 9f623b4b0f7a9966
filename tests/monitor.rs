//! The latency monitor, attached to running trainings from outside.

mod support;

use std::fs;
use std::io::Write;
use std::process::{Child, Command, Output};
use std::time::{Duration, Instant};

use anyhow::Result;
use config::MAX_FLEET;
use ipc_types::{
    Command as DriveCommand, DriveRequest, Odometry, RawCommand, TickHeader, WakeRole, WirePose,
};
use runtime::clock::now_ns;
use runtime::{Bus, Counters, Inlet, Outlet, Service, join, serve};
use rustix::process::Signal;
use serde_json::Value;
use simulator::SimulatedVehicle;
use support::{Sandbox, Training, signal};
use tracking::Pose;

/// What the processes of these tests wait on purpose.
const DELAY: Duration = Duration::from_millis(2);

const HOPS: [&str; 6] = [
    "vehicle_to_controller",
    "controller",
    "controller_to_supervisor",
    "supervisor",
    "supervisor_to_vehicle",
    "end_to_end",
];

/// A process of this executable, for `--replace`.
fn role(role: &str, process: &str) -> String {
    format!(
        "{role}={} --exact {process} --ignored --nocapture",
        std::env::current_exe().unwrap().display()
    )
}

fn a_long_training<'a>(sandbox: &'a Sandbox, more: &[&str]) -> Training<'a> {
    let mut args = vec!["lane_change", "--no-memo", "--episodes", "100000"];
    args.extend(more);
    let mut training = sandbox.start_training("out", &args);
    training.wait_for("a living run", || {
        let status = sandbox.run(&["status", "--json"]);
        let status: Value = serde_json::from_slice(&status.stdout).unwrap();
        status["runs"][0]["tick"].as_u64().is_some_and(|tick| tick > 0)
    });
    training
}

fn end(training: Training) {
    signal(training.id(), Signal::INT);
    training.finish();
}

fn lines(output: &Output) -> Vec<Value> {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8_lossy(&output.stdout);
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

fn one_line(output: &Output) -> String {
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(text.lines().count(), 1, "{text}");
    text
}

/// Asserts that one hop, and the whole way with it, reads about as long as the delay, and no other does.
fn check_delay(sandbox: &Sandbox, delayed: &str) -> u64 {
    let report = lines(&sandbox.run(&["monitor", "--json", "--once", "--budget", "1ms"])).remove(0);
    let delayed_ns = report["hops"][delayed]["p50_ns"].as_u64().unwrap();
    for hop in HOPS {
        let p50_ns = report["hops"][hop]["p50_ns"].as_u64().unwrap();
        let n = report["hops"][hop]["n"].as_u64().unwrap();
        assert!(n > 10, "{hop}: {report}");
        if hop == delayed || hop == "end_to_end" {
            // A sleep ends late, never early; on a busy machine much too late.
            assert!(p50_ns >= 2_000_000, "{hop}: {report}");
        } else {
            assert!(p50_ns < delayed_ns / 2, "{hop}: {report}");
        }
    }
    let misses = report["deadline_misses"].as_u64().unwrap();
    let ticks = report["ticks"].as_u64().unwrap();
    assert!(misses >= report["hops"]["end_to_end"]["n"].as_u64().unwrap(), "{report}");
    assert!(misses <= ticks + 1, "{report}");
    assert_eq!(report["missed"], 0, "{report}");
    assert_eq!(report["implausible"], 0, "{report}");
    delayed_ns
}

#[test]
fn a_delay_shows_in_its_hop_and_in_no_other() {
    for (who, process, hop) in [
        ("vehicle", "vehicle_that_waits", "supervisor_to_vehicle"),
        ("supervisor", "supervisor_that_waits", "supervisor"),
    ] {
        let sandbox = Sandbox::new();
        let replaced = role(who, process);
        let training = a_long_training(&sandbox, &["--replace", &replaced]);
        let p50_ns = check_delay(&sandbox, hop);
        end(training);
        // What the process itself has read of its clock around its sleep.
        let text = fs::read_to_string(sandbox.path("out/delays")).unwrap();
        let mut delays: Vec<u64> = text.lines().filter_map(|line| line.parse().ok()).collect();
        delays.sort_unstable();
        let median_ns = delays[delays.len() / 2];
        let ratio = p50_ns as f64 / median_ns as f64;
        // The machine's load changes between the second that was watched and the rest.
        assert!(
            (0.9..2.0).contains(&ratio),
            "{hop}: {p50_ns} ns, by its own stamps {median_ns} ns"
        );
        sandbox.assert_clean();
    }
}

#[test]
fn every_output_holds_the_same_figures() {
    let sandbox = Sandbox::new();
    let training = a_long_training(&sandbox, &["--alphas", "0.1,0.5"]);

    let output =
        sandbox.run(&["monitor", "--json", "--csv", "rows.csv", "--for", "3s", "--vehicle", "1"]);
    let reports = lines(&output);
    assert_eq!(reports.len(), 3, "{reports:?}");
    for (index, report) in reports.iter().enumerate() {
        assert!((report["t_s"].as_f64().unwrap() - (index + 1) as f64).abs() < 0.5, "{report}");
        assert!(report["rate_hz"].as_f64().unwrap() > 0.0, "{report}");
        assert_eq!(report["attempt"], 1);
        assert_eq!(report["budget_ns"], 10_000_000);
        assert_eq!(report["vehicle"]["slot"], 1);
        assert_eq!(report["vehicle"]["fleet"], 2);
        for hop in HOPS {
            let spans = &report["hops"][hop];
            let of = |name: &str| spans[name].as_u64().unwrap();
            let sorted = [of("p50_ns"), of("p90_ns"), of("p99_ns"), of("p999_ns"), of("max_ns")];
            assert!(sorted.is_sorted() && sorted[0] > 0, "{hop}: {spans}");
        }
        let seen = report["ticks"].as_u64().unwrap();
        assert!(seen > 0 && report["missed"].is_u64() && report["deadline_misses"].is_u64());
        // Nothing that our own processes stamp makes no sense.
        assert_eq!(report["implausible"], 0, "{report}");
        assert_eq!(report["strays"], 0, "{report}");
    }
    let mut rows = csv::Reader::from_path(sandbox.path("rows.csv")).unwrap();
    let names = rows.headers().unwrap().clone();
    let column = |name: &str| names.iter().position(|it| it == name).unwrap();
    let rows: Vec<csv::StringRecord> = rows.records().map(Result::unwrap).collect();
    assert_eq!(rows.len(), 3);
    for (row, report) in rows.iter().zip(&reports) {
        assert_eq!(row[column("ticks")], report["ticks"].to_string());
        let p99 = &report["hops"]["end_to_end"]["p99_ns"];
        assert_eq!(row[column("end_to_end_p99_ns")], p99.to_string());
    }

    let once = sandbox.run(&["monitor", "--once"]);
    assert!(once.status.success());
    let table = String::from_utf8_lossy(&once.stdout).into_owned();
    assert!(table.contains("end to end") && table.contains("ticks/s"), "{table}");

    let started = Instant::now();
    let text = sandbox.run(&["monitor", "--for", "500ms"]);
    assert!(text.status.success() && started.elapsed() >= Duration::from_millis(500));
    assert_eq!(String::from_utf8_lossy(&text.stdout).lines().count(), 1);

    end(training);
    sandbox.assert_clean();
}

#[test]
fn mistakes_are_told_in_one_line() {
    let sandbox = Sandbox::new();
    let check = |args: &[&str], words: &str| {
        let output = sandbox.run(&[&["monitor"], args].concat());
        assert_eq!(output.status.code(), Some(64), "{args:?}");
        let text = one_line(&output);
        assert!(text.contains(words), "{args:?}: {text}");
    };
    check(&[], "no run is alive");
    check(&["zz"], "no living run has a number or folder");
    for time in ["0s", "-1s", "soon", "", "0"] {
        check(&["--for", time], "expected a time above zero");
    }
    let training = a_long_training(&sandbox, &[]);
    check(&["--vehicle", "7"], "there is no vehicle 7: the fleet has");
    check(&["--csv", "no/such/folder.csv"], "failed to write no/such/folder.csv");
    if cfg!(not(feature = "prometheus")) {
        check(&["--prometheus", "127.0.0.1:0"], "--features prometheus");
    }
    end(training);
    sandbox.assert_clean();
}

#[test]
fn the_seventeenth_observer_is_refused_until_a_place_is_free() {
    let sandbox = Sandbox::new();
    let mut training = a_long_training(&sandbox, &[]);
    let places = sandbox.living_run().root.join("observers");
    // One that is only just being made has a name that begins with a dot.
    let is_made = |entry: std::io::Result<fs::DirEntry>| {
        entry.is_ok_and(|entry| !entry.file_name().to_string_lossy().starts_with('.'))
    };
    let count = || {
        fs::read_dir(&places)
            .map_or(0, |entries| entries.filter_map(|it| is_made(it).then_some(())).count())
    };
    let monitor = || sandbox.command(&["monitor", "--json"]).spawn().unwrap();
    let mut monitors: Vec<Child> = (0..16).map(|_| monitor()).collect();
    training.wait_for("sixteen observers", || count() == 16);
    let refused = sandbox.run(&["monitor", "--once"]);
    assert_eq!(refused.status.code(), Some(64));
    assert!(one_line(&refused).contains("16 observers already"), "{}", one_line(&refused));
    // One goes in order, one is killed: the orchestrator finds that out.
    let stopped = monitors.pop().unwrap();
    signal(stopped.id() as i32, Signal::INT);
    assert!(stopped.wait_with_output().unwrap().status.success());
    let mut killed = monitors.pop().unwrap();
    killed.kill().unwrap();
    killed.wait().unwrap();
    training.wait_for("two free places", || count() == 14);
    monitors.push(monitor());
    training.wait_for("the next observer", || count() == 15);
    assert!(sandbox.run(&["monitor", "--once"]).status.success());
    end(training);
    for monitor in monitors {
        let output = monitor.wait_with_output().unwrap();
        assert!(output.status.success());
        assert!(one_line(&output).contains("has ended"));
    }
    sandbox.assert_clean();
}

#[test]
fn monitors_change_no_digest_and_leave_nothing() {
    let sandbox = Sandbox::new();
    let args = ["lane_change", "--no-memo", "--episodes", "10"];
    let alone = sandbox.train("alone", &args);
    let mut training = sandbox.start_training("watched", &args);
    training.wait_until_it_drives();
    let mut monitors: Vec<Child> = Vec::new();
    let mut waves = 0;
    while !training.is_over() {
        // They go by themselves, or are killed or frozen and killed a moment later; one stays to the end.
        let args: &[&str] = if waves == 0 { &[] } else { &["--for", "300ms"] };
        let mut all = vec!["monitor", "--json"];
        all.extend(args);
        monitors.push(sandbox.command(&all).spawn().unwrap());
        std::thread::sleep(Duration::from_millis(60));
        if let [_, .., old, _] = monitors.as_mut_slice() {
            match waves % 3 {
                0 => old.kill().unwrap(),
                1 => signal(old.id() as i32, Signal::STOP),
                _ => {}
            }
        }
        waves += 1;
        if waves % 8 == 0 {
            for mut monitor in monitors.drain(1..) {
                let _ = monitor.kill();
                let _ = monitor.wait();
            }
        }
    }
    let watched = training.succeed();
    assert!(waves > 3, "the training is too short to be watched");
    assert_eq!(watched["digest"], alone["digest"]);
    for process in watched["processes"].as_array().unwrap() {
        assert_eq!(process["restarts"], 0, "{process}");
    }
    let stayed = monitors.remove(0).wait_with_output().unwrap();
    assert!(stayed.status.success(), "{stayed:?}");
    assert!(String::from_utf8_lossy(&stayed.stderr).contains("has ended"));
    for mut monitor in monitors {
        let _ = monitor.kill();
        let _ = monitor.wait();
    }
    sandbox.assert_clean();
}

#[test]
fn the_view_gives_the_terminal_back() {
    if Command::new("script").arg("--version").output().is_err() {
        assert!(std::env::var_os("PATHTUNE_NO_SKIPS").is_none(), "`script` is not installed");
        println!("skipped: `script` is not installed");
        return;
    }
    let sandbox = Sandbox::new();
    let training = a_long_training(&sandbox, &[]);
    // A pseudo-terminal; the signal must find the monitor, not the shell.
    let pid_file = sandbox.path("pid");
    for ending in ["q", "TERM", "for"] {
        let more = if ending == "for" { "--for 1s" } else { "" };
        let line = format!(
            "stty rows 30 cols 100; echo $$ > {}; exec {} monitor {more}",
            pid_file.display(),
            env!("CARGO_BIN_EXE_pathtune")
        );
        let mut view = Command::new("script")
            .args(["-qec", &line, "/dev/null"])
            .env("XDG_RUNTIME_DIR", sandbox.path("r"))
            .env("TERM", "xterm")
            .stdin(std::process::Stdio::piped())
            .stdout(std::process::Stdio::piped())
            .spawn()
            .unwrap();
        std::thread::sleep(Duration::from_millis(1500));
        match ending {
            "q" => view.stdin.as_mut().unwrap().write_all(b"q").unwrap(),
            "TERM" => {
                let pid = fs::read_to_string(&pid_file).unwrap();
                signal(pid.trim().parse().unwrap(), Signal::TERM);
            }
            _ => {}
        }
        let output = view.wait_with_output().unwrap();
        assert!(output.status.success(), "{ending}: {output:?}");
        let text = String::from_utf8_lossy(&output.stdout);
        assert!(text.contains("p99.9"), "{ending}: {text}");
        // The alternate screen is entered, and left as the last thing.
        let (entered, left) = (text.rfind("\x1b[?1049h"), text.rfind("\x1b[?1049l"));
        assert!(entered.is_some() && entered < left, "{ending}: {text}");
    }
    end(training);
    sandbox.assert_clean();
}

/// Not a test: a vehicle that waits before it applies a command.
#[test]
#[ignore = "a process of the tests above"]
fn vehicle_that_waits() {
    let (attachment, bus, config) = join().unwrap();
    let delays = fs::File::create(attachment.folder.join("delays")).unwrap();
    let mut vehicle = Vehicle {
        requests: bus.inlet().unwrap(),
        commands: bus.inlet().unwrap(),
        odometry: bus.outlet().unwrap(),
        fresh: SimulatedVehicle::new(&config),
        fleet: Vec::new(),
        header: TickHeader::default(),
        delays,
    };
    serve(&attachment, &bus, WakeRole::Vehicle, &mut vehicle).unwrap();
}

/// Not a test: a supervisor that passes everything, and waits before it does.
#[test]
#[ignore = "a process of the tests above"]
fn supervisor_that_waits() {
    let (attachment, bus, _) = join().unwrap();
    let delays = fs::File::create(attachment.folder.join("delays")).unwrap();
    let mut supervisor = Supervisor::new(&bus, delays);
    serve(&attachment, &bus, WakeRole::Supervisor, &mut supervisor).unwrap();
}

/// Waits, and writes how long that took by this process's own clock.
fn wait(delays: &mut fs::File) {
    let before = Instant::now();
    std::thread::sleep(DELAY);
    writeln!(delays, "{}", before.elapsed().as_nanos()).unwrap();
}

struct Vehicle {
    requests: Inlet<DriveRequest>,
    commands: Inlet<DriveCommand>,
    odometry: Outlet<Odometry>,
    fresh: SimulatedVehicle,
    fleet: Vec<SimulatedVehicle>,
    header: TickHeader,
    delays: fs::File,
}

impl Vehicle {
    fn publish(&mut self) -> Result<()> {
        self.header.odometry_sent_ns = now_ns();
        let fleet = &mut self.fleet;
        self.odometry.send(self.header, fleet.len(), |slot| {
            let seen = fleet[slot].observe();
            let wire =
                |pose: Pose| WirePose { x_m: pose.x_m, y_m: pose.y_m, yaw_rad: pose.yaw_rad };
            Odometry {
                measured: wire(seen.measured),
                truth: wire(seen.truth),
                speed_mps: seen.speed_mps,
                yaw_rate_radps: seen.yaw_rate_radps,
                steering_rad: seen.steering_rad,
                status: Odometry::HAS_TRUTH,
                reserved: 0,
            }
        })?;
        Ok(())
    }
}

impl Service for Vehicle {
    fn poll(&mut self) -> Result<bool> {
        if let Some(request) = self.requests.receive_newest()? {
            let header = request.header();
            let reset = |request: &DriveRequest| {
                let WirePose { x_m, y_m, yaw_rad } = request.start;
                let mut vehicle = self.fresh.clone();
                vehicle.reset(Pose { x_m, y_m, yaw_rad }, None);
                vehicle
            };
            self.fleet = request.items().iter().map(reset).collect();
            self.header = TickHeader { attempt: header.attempt, ..TickHeader::default() };
            self.publish()?;
            return Ok(true);
        }
        let Some(commands) = self.commands.receive()? else { return Ok(false) };
        let of = |header: TickHeader| (header.attempt, header.tick);
        let has_ended = |command: &DriveCommand| command.flags & DriveCommand::ENDED != 0;
        if of(commands.header()) != of(self.header) || commands.items().iter().all(has_ended) {
            return Ok(true);
        }
        wait(&mut self.delays);
        self.header.applied_ns = now_ns();
        for (vehicle, command) in self.fleet.iter_mut().zip(commands.items()) {
            vehicle.step(command.speed_mps, command.steering_rad);
        }
        self.header.tick += 1;
        self.publish()?;
        Ok(true)
    }

    fn status(&self) -> Counters {
        Counters { capacity: MAX_FLEET as u32, ..Counters::default() }
    }
}

struct Supervisor {
    requests: Inlet<DriveRequest>,
    raw_commands: Inlet<RawCommand>,
    commands: Outlet<DriveCommand>,
    delays: fs::File,
}

impl Supervisor {
    fn new(bus: &Bus, delays: fs::File) -> Self {
        Self {
            requests: bus.inlet().unwrap(),
            raw_commands: bus.inlet().unwrap(),
            commands: bus.outlet().unwrap(),
            delays,
        }
    }
}

impl Service for Supervisor {
    fn poll(&mut self) -> Result<bool> {
        let _ = self.requests.receive_newest()?;
        let Some(raw) = self.raw_commands.receive()? else { return Ok(false) };
        let supervisor_received_ns = now_ns();
        wait(&mut self.delays);
        let header =
            TickHeader { supervisor_received_ns, supervisor_sent_ns: now_ns(), ..raw.header() };
        self.commands.send(header, raw.items().len(), |slot| {
            let raw = raw.items()[slot];
            DriveCommand {
                speed_mps: raw.speed_mps,
                yaw_rate_radps: raw.yaw_rate_radps,
                steering_rad: raw.steering_rad,
                flags: raw.flags & DriveCommand::ENDED,
                zone: 0,
            }
        })?;
        Ok(true)
    }

    fn status(&self) -> Counters {
        Counters::default()
    }
}
