//! The vehicle swapped: a process that is no service of ours fills the role.

mod support;

use std::fs;
use std::time::{Duration, Instant};

use anyhow::Result;
use config::{MAX_FLEET, RunConfig};
use ipc_types::{Command, DriveRequest, Odometry, TickHeader, WakeRole, WirePose};
use runtime::clock::now_ns;
use runtime::{Bus, Counters, Inlet, Outlet, Service, join, serve};
use serde_json::Value;
use simulator::SimulatedVehicle;
use support::Sandbox;
use tracking::Pose;

/// Shortest time between two ticks of the slow vehicle, as of a real one.
const SLOW_TICK: Duration = Duration::from_millis(10);

fn vehicle(process: &str) -> String {
    format!(
        "vehicle={} --exact {process} --ignored --nocapture",
        std::env::current_exe().unwrap().display()
    )
}

#[test]
fn a_foreign_vehicle_of_the_same_plant_trains_to_the_same_bytes() {
    let sandbox = Sandbox::new();
    let ours = sandbox.train("ours", &["lane_change", "--episodes", "2"]);
    let replaced = vehicle("fast_vehicle");
    let args = ["lane_change", "--episodes", "2", "--replace", &replaced];
    let theirs = sandbox.train("theirs", &args);
    assert_eq!(theirs["digest"], ours["digest"]);
    // It never said that it repeats itself: no drive is answered from memory.
    assert_eq!(theirs["drives"]["asked"], theirs["drives"]["driven"]);
    assert!(sandbox.path("theirs/logs/vehicle.log").exists());
    sandbox.assert_clean();
}

/// What a result says, but for the drives from which its figures come.
fn decided(sandbox: &Sandbox, out: &str) -> serde_json::Value {
    let text = fs::read(sandbox.path(out).join("outcome.json")).unwrap();
    let mut outcome: serde_json::Value = serde_json::from_slice(&text).unwrap();
    outcome["vehicle_drives"].take();
    // Plants are driven by our simulator alone.
    outcome["plants"].take();
    outcome
}

#[test]
fn figures_of_a_declared_vehicle_of_the_same_plant_are_ours_whatever_dies() {
    let sandbox = Sandbox::new();
    let ours = sandbox.train("ours", &["lane_change", "--episodes", "2"]);
    assert!(ours["vehicle_drives"].is_null());
    assert_eq!(ours["drives"]["for_table"], 0);
    let replaced = vehicle("fast_vehicle");
    let args = ["lane_change", "--episodes", "2", "--replace", &replaced, "--deterministic"];
    let theirs = sandbox.train("theirs", &args);
    // To the last bit: its own drives, ranks, the paper's row, and what plain Q and a random walk find on its grid.
    assert_eq!(decided(&sandbox, "theirs"), decided(&sandbox, "ours"));
    let driven = |key: &str| theirs["drives"][key].as_u64().unwrap();
    let asked = ours["drives"]["asked"].as_u64().unwrap();
    assert!(driven("driven") < asked, "it is remembered: {}", theirs["drives"]);
    // Each set of the grid, the paper's and the tuned one once; those of the training are known.
    assert!(
        (750..=752).contains(&(driven("for_table") + driven("driven"))),
        "{}",
        theirs["drives"]
    );
    let drives = &theirs["vehicle_drives"];
    assert_eq!((&drives["repeats"], &drives["by_clock"]), (&true.into(), &false.into()));
    assert_eq!(
        (&drives["of_grid_set"], &drives["for_table"]),
        (&1.into(), &driven("for_table").into())
    );

    // Killed trainers, in the drives for the table too, and a training that is resumed only for the table.
    let chaos = [
        "--chaos",
        "kill trainer@drive=20; kill trainer@drive=120; random:4",
        "--restart-budget",
        "100",
    ];
    sandbox.train("killed", &[&args[..], &chaos].concat());
    assert_eq!(decided(&sandbox, "killed"), decided(&sandbox, "ours"));
    for name in ["result.json", "outcome.json"] {
        fs::remove_file(sandbox.path("theirs").join(name)).unwrap();
    }
    let again = sandbox.resume_training("theirs", &["--quiet"]).succeed();
    assert_eq!(decided(&sandbox, "theirs"), decided(&sandbox, "ours"));
    assert_eq!(
        (&again["drives"], &again["vehicle_drives"]),
        (&theirs["drives"], &theirs["vehicle_drives"])
    );
    sandbox.assert_clean();
}

/// What is simulated first is simulated with our cores; then a vehicle that is not ours makes its few drives and no other.
#[test]
fn a_training_that_simulates_first_drives_its_budget_and_not_once_more_whatever_dies() {
    let sandbox = Sandbox::new();
    let replaced = vehicle("fast_vehicle");
    let mut args = vec!["smooth_lane", "--law", "pure_pursuit", "--simulate-first", "4"];
    args.extend(["--drives", "6", "--within", "2"]);
    for set in [
        "tuner.settings.draw=grid",
        "grid.kv={min=1,max=1,step=1}",
        "grid.filter={min=0,max=0,step=1}",
        "vehicle.steering_delay_s=0.1",
    ] {
        args.extend(["--set", set]);
    }
    // Where drives repeat exactly, none is made twice.
    let ours = sandbox.train("ours", &[&args[..], &["--set", "run.repeats=false"]].concat());
    // Nobody can drive so near; another start of the trainer would not help.
    let within = ["train", "--out", "near", "--set", "tuner.settings.within_m=0.01"];
    let others = args.iter().filter(|it| !["--within", "2"].contains(it));
    let output = sandbox.run(&within.iter().chain(others).copied().collect::<Vec<_>>());
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(64), "{said}");
    assert!(said.contains("no set stays so near to the path on all 4 simulated plants"), "{said}");
    args.extend(["--replace", &replaced]);
    let theirs = sandbox.train("theirs", &args);
    let drives = &theirs["drives"];
    assert_eq!((&drives["driven"], &drives["for_table"]), (&6.into(), &0.into()), "{drives}");
    // Two of them with the textbook's set, and the last one with the set that is chosen.
    let simulated = &theirs["simulated_first"];
    assert_eq!((&simulated["drives"], &simulated["plants"]), (&6.into(), &4.into()));
    assert_eq!(
        (&simulated["beyond"], &simulated["textbook"]["driven"]["drives"]),
        (&0.into(), &2.into())
    );
    assert_eq!(simulated["not_arrived"], 0);
    assert!(simulated["chosen"]["drives"].as_u64().unwrap() >= 2, "{simulated}");
    // The same plant drives both.
    for key in ["digest", "gains", "simulated_first"] {
        assert_eq!(theirs[key], ours[key], "{key}");
    }
    let chaos = ["--chaos", "kill trainer@drive=3; kill controller@drive=5"];
    let killed = sandbox.train("killed", &[&args[..], &chaos].concat());
    for key in ["digest", "gains", "simulated_first", "path_mean_m"] {
        assert_eq!(killed[key], theirs[key], "{key}");
    }
    sandbox.assert_clean();
}

#[test]
fn with_a_budget_a_vehicle_makes_these_drives_and_no_others() {
    let sandbox = Sandbox::new();
    let unsteady = vehicle("unsteady_vehicle");
    let args = ["lane_change", "--tuner", "gp", "--drives", "12"];
    let replaced = sandbox.train("out", &[&args[..], &["--replace", &unsteady]].concat());
    let drives = &replaced["drives"];
    assert_eq!((&drives["driven"], &drives["for_table"]), (&12.into(), &0.into()), "{drives}");
    assert_eq!((&replaced["grid"], &replaced["noise"]), (&Value::Null, &Value::Null));
    assert_eq!(replaced["drives_recorded"], serde_json::json!([]));
    // What its model says of the set, and the set's own figures.
    let predicted = &replaced["predicted"];
    assert!(predicted["low"].as_f64() < predicted["high"].as_f64(), "{predicted}");
    assert!(replaced["path_mean_m"].as_f64().unwrap() > 0.0);
    // One that repeats itself is known by a single drive.
    let steady = vehicle("fast_vehicle");
    let more = ["--replace", &steady, "--deterministic"];
    let replaced = sandbox.train("steady", &[&args[..], &more].concat());
    assert_eq!(replaced["drives"]["driven"], 12);
    assert_eq!((&replaced["predicted"], &replaced["grid"]), (&Value::Null, &Value::Null));
    let ours = sandbox.train("ours", &args);
    assert_eq!(replaced["digest"], ours["digest"]);
    sandbox.assert_clean();
}

#[test]
fn a_vehicle_that_does_not_repeat_itself_gets_means_with_intervals() {
    let sandbox = Sandbox::new();
    let replaced = vehicle("unsteady_vehicle");
    let output = sandbox.run(&[
        "train",
        "lane_change",
        "--episodes",
        "1",
        "--set",
        "robust.finalists=3",
        "--set",
        "robust.repeats=4",
        "--set",
        "ranking.repeats=2",
        "--set",
        "grid.kv={ min = 1.0, max = 3.0, step = 1.0 }",
        "--replace",
        &replaced,
        "--quiet",
        "--out",
        "out",
    ]);
    assert!(output.status.success(), "{}", sandbox.story("out", &output));
    let result = sandbox.result("out");
    let drives = &result["vehicle_drives"];
    assert_eq!((&drives["repeats"], &drives["of_grid_set"]), (&false.into(), &2.into()));
    for row in [&result, &result["paper"]] {
        let spread = &row["spread"];
        assert_eq!(spread["drives"], 4, "{row}");
        for key in ["value", "distance", "mse_m2", "path_mean_m"] {
            let number = |value: &serde_json::Value| value.as_f64().unwrap();
            let (low, high) = (number(&spread[key]["low"]), number(&spread[key]["high"]));
            let mean = number(&row[key]);
            assert!(low < mean && mean < high, "{key}: {mean} in [{low}, {high}]");
        }
    }
    assert!(result["grid"]["rank_distance"].as_u64().unwrap() >= 1);
    // Chosen among the finalists, which are driven as often as is needed for a mean.
    assert_eq!(result["noise"]["repeats"], 4);
    assert_eq!(result["noise"]["finalists"][0]["gains"], result["gains"]);
    let [of_finalist, of_table] =
        [&result["noise"]["finalists"][0]["mean_value"], &result["value"]]
            .map(|it| it.as_f64().unwrap());
    assert!((of_finalist - of_table).abs() < 1e-12, "{of_finalist} {of_table}");
    let said = String::from_utf8(output.stdout).unwrap();
    for part in [
        "does not repeat itself",
        "none is computed with our simulator",
        "over 4 drives",
        "found by plain Q",
    ] {
        assert!(said.contains(part), "{part:?} is missing in {said}");
    }
    sandbox.assert_clean();
}

#[test]
fn scales_from_the_simulator_s_grid_are_refused_for_another_vehicle() {
    let sandbox = Sandbox::new();
    let replaced = vehicle("fast_vehicle");
    for command in ["train", "validate", "drive"] {
        let args = [
            command,
            "lane_change",
            "--objective",
            "weighted",
            "--replace",
            &replaced,
            "--out",
            "out",
        ];
        let output = sandbox.run(&args);
        let said = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(64), "{command}: {said}");
        assert!(
            said.contains("another vehicle drives here") && said.contains("mse_scale"),
            "{said}"
        );
        assert_eq!(said.lines().count(), 1, "{said}");
        assert!(!sandbox.path("out").exists());
    }
    let alone = sandbox.run(&["train", "lane_change", "--deterministic"]);
    assert_eq!(alone.status.code(), Some(64));
    assert!(String::from_utf8(alone.stderr).unwrap().contains("--replace"));
    sandbox.assert_clean();
}

#[test]
fn nobody_burns_a_core_while_a_slow_vehicle_drives() {
    let sandbox = Sandbox::new();
    let replaced = vehicle("slow_vehicle");
    let mut training = sandbox.start_training("out", &["lane_change", "--replace", &replaced]);
    training.wait_for("the services", || {
        ["supervisor", "controller", "trainer"].iter().all(|name| sandbox.service(name).is_some())
    });
    std::thread::sleep(Duration::from_millis(500));
    let watched = [
        ("supervisor", sandbox.service("supervisor").unwrap()),
        ("controller", sandbox.service("controller").unwrap()),
        ("trainer", sandbox.service("trainer").unwrap()),
        ("orchestrator", training.id()),
    ];
    let before: Vec<f64> = watched.iter().map(|(_, pid)| cpu_s(*pid)).collect();
    let started = Instant::now();
    std::thread::sleep(Duration::from_secs(3));
    let elapsed_s = started.elapsed().as_secs_f64();
    for ((name, pid), before) in watched.iter().zip(before) {
        let share = (cpu_s(*pid) - before) / elapsed_s;
        println!("{name}: {:.1} % of a core behind a 10 ms vehicle", 100.0 * share);
        // A spinning process would read 100 %, however slow the machine is.
        assert!(share < 0.2, "{name} burns {share}");
    }
    let status = sandbox.run(&["status", "--json"]);
    let status: serde_json::Value = serde_json::from_slice(&status.stdout).unwrap();
    for process in status["runs"][0]["processes"].as_array().unwrap() {
        assert_eq!(process["restarts"], 0, "taken for frozen: {process}");
    }
    rustix::process::kill_process(
        rustix::process::Pid::from_raw(training.id()).unwrap(),
        rustix::process::Signal::INT,
    )
    .unwrap();
    training.finish();
    sandbox.assert_clean();
}

#[test]
fn messages_that_do_not_belong_are_dropped_and_counted() {
    let sandbox = Sandbox::new();
    let ours = sandbox.train("ours", &["lane_change", "--episodes", "2"]);
    let replaced = vehicle("hostile_vehicle");
    let args = ["lane_change", "--episodes", "2", "--replace", &replaced];
    let theirs = sandbox.train("theirs", &args);
    assert_eq!(theirs["digest"], ours["digest"]);
    let processes = theirs["processes"].as_array().unwrap();
    let controller = processes.iter().find(|process| process["name"] == "controller").unwrap();
    assert!(controller["dropped"].as_u64().unwrap() > 100, "{controller}");
    let refused = fs::read_to_string(sandbox.path("theirs/refused")).unwrap();
    assert!(refused.contains("ExceedsMaxSupportedPublishers"), "{refused}");
    sandbox.assert_clean();
}

/// CPU time of a process so far.
fn cpu_s(pid: i32) -> f64 {
    let text = fs::read_to_string(format!("/proc/{pid}/stat")).unwrap();
    let fields: Vec<&str> = text.rsplit(')').next().unwrap().split_whitespace().collect();
    let ticks: f64 = fields[11].parse::<f64>().unwrap() + fields[12].parse::<f64>().unwrap();
    ticks / rustix::param::clock_ticks_per_second() as f64
}

/// Not a test: the process in the vehicle's role.
#[test]
#[ignore = "a process of the tests above"]
fn fast_vehicle() {
    run_vehicle(Duration::ZERO);
}

/// Not a test: the process in the vehicle's role.
#[test]
#[ignore = "a process of the tests above"]
fn slow_vehicle() {
    run_vehicle(SLOW_TICK);
}

/// Not a test: the process in the vehicle's role. Before each true message it sends one that does not belong.
#[test]
#[ignore = "a process of the tests above"]
fn hostile_vehicle() {
    let (attachment, bus, config) = join().unwrap();
    let mut vehicle = Vehicle::new(&bus, &config, Duration::ZERO);
    vehicle.hostile = true;
    // A second publisher has no place on a topic.
    let refused = bus.outlet::<Odometry>().map(|_| ()).unwrap_err().to_string();
    fs::write(attachment.folder.join("refused"), refused).unwrap();
    serve(&attachment, &bus, WakeRole::Vehicle, &mut vehicle).unwrap();
}

/// Not a test: the process in the vehicle's role. Its steering is never the same in two drives.
#[test]
#[ignore = "a process of the tests above"]
fn unsteady_vehicle() {
    let (attachment, bus, config) = join().unwrap();
    let mut vehicle = Vehicle::new(&bus, &config, Duration::ZERO);
    vehicle.unsteady = true;
    serve(&attachment, &bus, WakeRole::Vehicle, &mut vehicle).unwrap();
}

fn run_vehicle(tick: Duration) {
    let (attachment, bus, config) = join().unwrap();
    let mut vehicle = Vehicle::new(&bus, &config, tick);
    serve(&attachment, &bus, WakeRole::Vehicle, &mut vehicle).unwrap();
}

struct Vehicle {
    requests: Inlet<DriveRequest>,
    commands: Inlet<Command>,
    odometry: Outlet<Odometry>,
    fresh: SimulatedVehicle,
    fleet: Vec<SimulatedVehicle>,
    header: TickHeader,
    tick: Duration,
    hostile: bool,
    unsteady: bool,
    /// The offset of each vehicle's steering.
    offsets_rad: Vec<f64>,
    driven: u64,
    sent: u64,
}

impl Vehicle {
    fn new(bus: &Bus, config: &RunConfig, tick: Duration) -> Self {
        Self {
            requests: bus.inlet().unwrap(),
            commands: bus.inlet().unwrap(),
            odometry: bus.outlet().unwrap(),
            fresh: SimulatedVehicle::new(config),
            fleet: Vec::new(),
            header: TickHeader::default(),
            tick,
            hostile: false,
            unsteady: false,
            offsets_rad: Vec::new(),
            driven: 0,
            sent: 0,
        }
    }

    /// A message of another run, batch, attempt, tick or fleet, full of numbers that are none.
    fn send_what_does_not_belong(&mut self) -> Result<()> {
        let mut header = self.header;
        let mut len = self.fleet.len();
        match self.sent % 7 {
            0 => header.attempt.run ^= 1,
            1 => header.attempt.batch = header.attempt.batch.wrapping_sub(1),
            2 => header.attempt.attempt = 0,
            3 => header.tick = u64::MAX,
            4 => header.tick = header.tick.wrapping_sub(1),
            5 => header.attempt.batch += 1,
            _ => len = 1 + usize::from(len == 1),
        }
        let pose = WirePose { x_m: f64::NAN, y_m: f64::INFINITY, yaw_rad: -f64::NAN };
        let odometry = Odometry { measured: pose, status: u32::MAX, ..Odometry::default() };
        self.odometry.send_quietly(header, len, |_| odometry)?;
        Ok(())
    }

    fn publish(&mut self) -> Result<()> {
        std::thread::sleep(self.tick);
        self.sent += 1;
        if self.hostile {
            self.send_what_does_not_belong()?;
        }
        let fleet = &mut self.fleet;
        let header = TickHeader { odometry_sent_ns: now_ns(), ..self.header };
        self.odometry.send(header, fleet.len(), |slot| {
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
            self.fleet = request
                .items()
                .iter()
                .map(|request| {
                    let WirePose { x_m, y_m, yaw_rad } = request.start;
                    let mut vehicle = self.fresh.clone();
                    vehicle.reset(Pose { x_m, y_m, yaw_rad }, None);
                    vehicle
                })
                .collect();
            let unsteady = if self.unsteady { 0.01 } else { 0.0 };
            let numbers = self.driven..self.driven + self.fleet.len() as u64;
            self.driven = numbers.end;
            self.offsets_rad = numbers.map(|it| unsteady * (it as f64 * 2.4).sin()).collect();
            self.header = TickHeader { attempt: header.attempt, ..TickHeader::default() };
            self.publish()?;
            return Ok(true);
        }
        let Some(commands) = self.commands.receive()? else { return Ok(false) };
        let of = |header: TickHeader| (header.attempt, header.tick);
        if of(commands.header()) != of(self.header) {
            return Ok(true);
        }
        if commands.items().iter().all(|command| command.flags & Command::ENDED != 0) {
            return Ok(true);
        }
        let fleet = self.fleet.iter_mut().zip(&self.offsets_rad);
        for ((vehicle, offset_rad), command) in fleet.zip(commands.items()) {
            vehicle.step(command.speed_mps, command.steering_rad + offset_rad);
        }
        self.header.tick += 1;
        self.publish()?;
        Ok(true)
    }

    fn status(&self) -> Counters {
        Counters { capacity: MAX_FLEET as u32, ..Counters::default() }
    }
}
