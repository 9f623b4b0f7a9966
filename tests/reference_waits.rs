//! The reference waits for a vehicle that does not follow, a rearmed vehicle goes on where its heading says, and the
//! last command of a drive is within its limits like every other one.

mod support;

use std::fs;
use std::time::Duration;

use anyhow::Result;
use config::{Layers, Parameters, RunConfig};
use ipc_types::{
    BatchHeader, Command as WireCommand, DriveRequest, Odometry, RawCommand, Safety, Status,
    TickHeader, WakeRole, WirePose, has,
};
use rollout::{Rollout, TickRecord};
use runtime::clock::now_ns;
use runtime::observer::Observer;
use runtime::{Bus, Counters, Inlet, Outlet, Service, join, serve};
use simulator::SimulatedVehicle;
use support::Sandbox;
use tracking::Pose;

const GAINS: [&str; 2] = ["--gains", "3,21,21,0.7"];

/// A process of this file in the vehicle's role.
fn car(process: &str) -> String {
    let this = std::env::current_exe().unwrap();
    format!("vehicle={} --exact {process} --ignored --nocapture", this.display())
}

/// A path's file: straight on, a slight bend to the left, and straight on.
fn bend() -> String {
    let straight = (0..8).map(|index| (0.5 * f64::from(index), 0.0));
    let turn_rad = 0.3f64;
    let arc = (0..=6).map(|index| {
        let angle_rad = turn_rad / 6.0 * f64::from(index);
        (4.0 + 10.0 * angle_rad.sin(), 10.0 * (1.0 - angle_rad.cos()))
    });
    let (x_m, y_m) = (4.0 + 10.0 * turn_rad.sin(), 10.0 * (1.0 - turn_rad.cos()));
    let on = (1..=10).map(|index| {
        let on_m = 0.5 * f64::from(index);
        (x_m + on_m * turn_rad.cos(), y_m + on_m * turn_rad.sin())
    });
    csv(straight.chain(arc).chain(on))
}

/// Two legs of 12 m, 1.6 m apart, for a car at the scale of 1:10.
fn hairpin() -> String {
    let there = (0..120).map(|index| (0.1 * f64::from(index), 0.0));
    let turn = (0..=25).map(|index| {
        let angle_rad = std::f64::consts::PI * f64::from(index) / 25.0;
        (12.0 + 0.8 * angle_rad.sin(), 0.8 * (1.0 - angle_rad.cos()))
    });
    let back = (1..=120).map(|index| (12.0 - 0.1 * f64::from(index), 1.6));
    csv(there.chain(turn).chain(back))
}

fn csv(points: impl Iterator<Item = (f64, f64)>) -> String {
    let rows: Vec<String> = points.map(|(x_m, y_m)| format!("{x_m:.6},{y_m:.6}\n")).collect();
    format!("x_m,y_m\n{}", rows.concat())
}

/// The numbers of a column of a recorded drive.
fn column(sandbox: &Sandbox, out: &str, name: &str) -> Vec<f64> {
    let path = sandbox.path(out).join("drives/drive.csv");
    let mut reader = csv::Reader::from_path(path).unwrap();
    let at = reader.headers().unwrap().iter().position(|it| it == name).unwrap();
    reader.records().map(|row| row.unwrap()[at].parse().unwrap()).collect()
}

/// Case `car_held_at_the_start`: the car's own safety held it for 3 s, and then it raced after its reference.
#[test]
fn car_held_at_the_start() {
    let sandbox = Sandbox::new();
    fs::write(sandbox.path("bend.csv"), bend()).unwrap();
    let held = car("held_car");
    let args = ["--path", "bend.csv", "--vehicle", "ackermann", "--realtime", "--replace", &held];
    let mut drive = sandbox.start("drive", "out", &[&args[..], &GAINS, &["--json"]].concat());
    drive.wait_for("the run", || sandbox.has_living_run());
    let observer = Observer::attach(&sandbox.living_run()).unwrap();
    let odometry = observer.bus().observe::<Odometry>().unwrap();
    let (mut highest_mps, mut moved_at) = (0.0f64, None);
    while !drive.is_over() {
        while let Some(message) = odometry.receive().unwrap() {
            let speed_mps = message.items()[0].speed_mps;
            highest_mps = highest_mps.max(speed_mps);
            if speed_mps > 0.1 {
                moved_at.get_or_insert(message.header().tick);
            }
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    drop((odometry, observer));
    let result = drive.succeed();
    assert_eq!(result["reason"], "goal", "{result}");
    assert!(moved_at.is_some_and(|tick| tick >= 300), "it was not held: {moved_at:?}");
    // The path says 1.5 m/s; it was 5.06 m/s when the reference did not wait.
    assert!((1.0..2.4).contains(&highest_mps), "{highest_mps} m/s");
    println!("held for 3 s: at most {highest_mps:.2} m/s on a path for 1.5 m/s");
    sandbox.assert_clean();
}

#[test]
fn in_lockstep_a_reference_that_waits_is_that_of_plain_calls_bit_for_bit() {
    let sandbox = Sandbox::new();
    let path = sandbox.path("bend.csv");
    fs::write(&path, bend()).unwrap();
    let sets = ["vehicle.gear_engaged=false", "vehicle.gear_drive_s=4.0"];
    let args = [
        "drive",
        "--path",
        "bend.csv",
        "--vehicle",
        "ackermann",
        "--set",
        sets[0],
        "--set",
        sets[1],
    ];
    let result = sandbox.json("out", &[&args[..], &GAINS].concat());

    let mut layers = Layers::own_path();
    layers.set_vehicle("test", "ackermann").unwrap();
    for set in sets {
        layers.set(set).unwrap();
    }
    layers.add_path(&path).unwrap();
    let config = layers.resolve().unwrap();
    let mut records: Vec<TickRecord> = Vec::new();
    let parameters = Parameters::of(&[3.0, 21.0, 21.0, 0.7]);
    let ended = Rollout::new(&config).drive_with(parameters, None, |_, it| records.push(*it));
    // Longer than the drive's time: the reference has waited.
    assert_eq!((&result["reason"], ended.arrived()), (&"goal".into(), true));
    let standing = records.windows(2).filter(|pair| {
        pair[0].decision.reference_along_m == pair[1].decision.reference_along_m
            && pair[0].decision.reference_along_m > 0.0
    });
    assert!(standing.count() > 100, "it never waited");
    for (name, number) in [
        ("x_m", (|it| it.observation.truth.x_m) as fn(&TickRecord) -> f64),
        ("speed_mps", |it| it.observation.speed_mps),
        ("command_speed_mps", |it| it.passed.speed_mps),
        ("command_yaw_rate_radps", |it| it.passed.yaw_rate_radps),
        ("command_steering_rad", |it| it.passed.steering_rad),
    ] {
        let told = column(&sandbox, "out", name);
        assert_eq!(told.len(), records.len());
        for (tick, (told, record)) in told.iter().zip(&records).enumerate() {
            assert_eq!(told.to_bits(), number(record).to_bits(), "{name} at tick {tick}");
        }
    }
    sandbox.assert_clean();
}

/// Case `rearm_beside_the_opposite_leg`: the localisation jumps by a metre, to where the opposite leg of a hairpin is
/// nearer; the rearmed car took that leg.
#[test]
fn rearm_beside_the_opposite_leg() {
    let sandbox = Sandbox::new();
    fs::write(sandbox.path("hairpin.csv"), hairpin()).unwrap();
    let jumping = car("jumping_car");
    let args = [
        "--path",
        "hairpin.csv",
        "--vehicle",
        "f1tenth",
        "--realtime",
        "--replace",
        &jumping,
        // So that it may drive on a metre off the path.
        "--set",
        "vehicle.safety.path_distance_limit_m=5",
        "--set",
        "vehicle.safety.path_heading_limit_rad=inf",
    ];
    let mut drive = sandbox.start("drive", "out", &[&args[..], &GAINS].concat());
    drive.wait_for("the run", || sandbox.has_living_run());
    let observer = Observer::attach(&sandbox.living_run()).unwrap();
    let safety = observer.bus().observe::<Safety>().unwrap();
    let raw = observer.bus().observe::<RawCommand>().unwrap();
    let state = || safety.receive_newest().unwrap().map(|it| it.items()[0].state);
    drive.wait_for("the stop", || state() == Some(Safety::STOPPED));
    let rearmed = sandbox.run(&["rearm"]);
    assert!(rearmed.status.success(), "{}", String::from_utf8_lossy(&rearmed.stderr));
    let mut seen = RawCommand::default();
    drive.wait_for("the reference to drive on", || {
        if let Some(message) = raw.receive_newest().unwrap() {
            seen = message.items()[0];
        }
        seen.origin_m > 0.0 && seen.phase_ticks > 100.0
    });
    // It stood some metres along the first leg, of 12; on the leg back that place is at 20 m or more.
    assert!((2.0..8.0).contains(&seen.origin_m), "{seen:?}");
    assert!(seen.speed_mps > 0.0, "{seen:?}");
    drop((safety, raw, observer));
    drive.interrupt();
    drive.finish();
    sandbox.assert_clean();
}

#[test]
fn a_car_that_no_leg_of_the_path_fits_is_not_rearmed() {
    let sandbox = Sandbox::new();
    fs::write(sandbox.path("bend.csv"), bend()).unwrap();
    let turned = car("turned_car");
    let args = ["--path", "bend.csv", "--vehicle", "ackermann", "--realtime", "--replace", &turned];
    let mut drive = sandbox.start("drive", "out", &[&args[..], &GAINS].concat());
    drive.wait_for("the run", || sandbox.has_living_run());
    let observer = Observer::attach(&sandbox.living_run()).unwrap();
    let safety = observer.bus().observe::<Safety>().unwrap();
    let mut seen = Safety::default();
    let mut newest = || {
        if let Some(message) = safety.receive_newest().unwrap() {
            seen = message.items()[0];
        }
        seen
    };
    drive.wait_for("the stop", || newest().state == Safety::STOPPED);
    let refused = sandbox.run(&["rearm"]);
    let said = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert_eq!(refused.status.code(), Some(64), "{said}");
    assert!(said.contains("no leg of the path within its reach fits its heading"), "{said}");
    let seen = newest();
    assert_eq!(seen.state, Safety::STOPPED);
    assert!(has(seen.reasons, Safety::NO_LEG), "{}", seen.reasons);
    drop((safety, observer));
    drive.interrupt();
    drive.finish();
    sandbox.assert_clean();
}

/// All commands of drives by the clock, one that ends at speed and one that arrives.
#[test]
fn every_command_by_the_clock_is_within_every_limit() {
    for (name, vehicle, speed_mps, seconds) in [
        ("lane_change", "tesla_model_3_guarded", "4.8", "4"),
        ("roundabout", "ackermann", "3", "4"),
    ] {
        let sandbox = Sandbox::new();
        let speed = format!("reference.speed_mps={speed_mps}");
        let time = format!("drive.loop_time_s={seconds}");
        let sets = ["vehicle.gear_engaged=true", &speed, &time];
        let mut args = vec![name, "--realtime", "--vehicle", vehicle];
        args.extend(sets.iter().flat_map(|set| ["--set", set]));
        let mut drive = sandbox.start("drive", "out", &[&args[..], &GAINS].concat());
        drive.wait_for("the run", || sandbox.has_living_run());
        let observer = Observer::attach(&sandbox.living_run()).unwrap();
        let commands = observer.bus().observe::<WireCommand>().unwrap();
        let mut all: Vec<(u64, WireCommand)> = Vec::new();
        while !drive.is_over() {
            while let Some(message) = commands.receive().unwrap() {
                all.push((message.header().supervisor_sent_ns, message.items()[0]));
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        drop((commands, observer));
        drive.finish();
        let config = RunConfig::from_resolved(&sandbox.text("out/config.toml")).unwrap();
        check_limits(&config, &all);
        // It ended at speed, and was then brought to a stop.
        let ending: Vec<_> = all.iter().filter(|it| has(it.1.flags, WireCommand::ENDED)).collect();
        let (first, last) = (ending[0].1, ending[ending.len() - 1].1);
        println!(
            "{name}: {} commands within all limits; the last {} from {:.2} to {} m/s",
            all.len(),
            ending.len(),
            first.speed_mps,
            last.speed_mps
        );
        assert!(first.speed_mps > 0.5 && last.speed_mps.abs() < 0.05, "{first:?} {last:?}");
        assert!(last.steering_rad.abs() < 1e-9);
        sandbox.assert_clean();
    }
}

fn check_limits(config: &RunConfig, commands: &[(u64, WireCommand)]) {
    let (safety, tick_s) = (config.vehicle.safety, config.drive.tick_s);
    let mut last_mps2 = None;
    for pair in commands.windows(2) {
        let [(was_ns, was), (now_ns, now)] = pair else { continue };
        // A command that comes late makes no larger step than one that is on time.
        let dt_s = ((now_ns - was_ns) as f64 / 1e9).min(tick_s);
        let acceleration_mps2 = (now.speed_mps - was.speed_mps) / dt_s;
        let told = format!("{dt_s} s: {was:?} {now:?}");
        let grain = 1e-12 / dt_s;
        assert!(now.speed_mps <= config.supervisor.speed_limit_mps, "{told}");
        assert!(now.speed_mps >= -safety.reverse_limit_mps, "{told}");
        assert!(acceleration_mps2 <= safety.acceleration_limit_mps2 + grain, "{told}");
        assert!(acceleration_mps2 >= -safety.deceleration_limit_mps2 - grain, "{told}");
        if let Some(last_mps2) = last_mps2 {
            let change_mps2: f64 = acceleration_mps2 - last_mps2;
            assert!(change_mps2.abs() <= safety.jerk_limit_mps3 * dt_s + 4.0 * grain, "{told}");
        }
        last_mps2 = Some(acceleration_mps2);
        let turned_rad = (now.steering_rad - was.steering_rad).abs();
        assert!(turned_rad <= safety.steering_rate_limit_radps * dt_s + 1e-12, "{told}");
        assert!(now.steering_rad.abs() <= config.controller.steering_limit_rad, "{told}");
        let curvature = now.steering_rad.tan() / config.vehicle.wheelbase_m;
        let lateral_mps2 = now.speed_mps * now.speed_mps * curvature.abs();
        assert!(lateral_mps2 <= safety.lateral_acceleration_limit_mps2 + 1e-9, "{told}");
        assert!((now.yaw_rate_radps - now.speed_mps * curvature).abs() < 1e-12, "{told}");
    }
}

/// A stop for what does not lie in the drive is driven again three times, and then the training ends with the cause.
fn check_given_up(process: &str, cause: &str) {
    let sandbox = Sandbox::new();
    fs::write(sandbox.path("bend.csv"), bend()).unwrap();
    let car = car(process);
    let args = ["train", "--path", "bend.csv", "--vehicle", "ackermann", "--episodes", "1"];
    let output = sandbox.run(&[&args[..], &["--replace", &car, "--out", "out"]].concat());
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(70), "{told}");
    let gave_up = "gave up: the vehicle was stopped 3 times on the same drive, and again";
    assert!(told.contains(&format!("{gave_up}: {cause}")), "{told}");
    assert!(told.contains("go on with: pathtune train --resume"), "{told}");
    let log = sandbox.text("out/logs/orchestrator.log");
    assert_eq!(log.matches(" reissued ").count(), 3, "{log}");
    assert_eq!(told.matches("vehicle 0 stands").count(), 4, "{told}");
    sandbox.assert_clean();
}

#[test]
fn a_training_whose_car_jumps_in_every_drive_is_given_up_with_the_cause() {
    check_given_up("ever_jumping_car", "the measured pose jumped");
}

#[test]
fn a_training_whose_car_never_knows_where_it_is_is_given_up_with_the_cause() {
    check_given_up("ever_lost_car", "the odometry is not finite");
}

/// Whoever drives by a script gets an end, and the cause: nobody is there to rearm the car. One whose odometry ends does not
/// come to stand for its gate, and no tick comes any more.
fn check_nobody_rearms(process: &str, cause: &str, name: &str) {
    let sandbox = Sandbox::new();
    fs::write(sandbox.path("hairpin.csv"), hairpin()).unwrap();
    let car = car(process);
    let args = ["drive", "--path", "hairpin.csv", "--vehicle", "f1tenth", "--realtime"];
    let limit = ["--set", "drive.patience_s=1.5", "--replace", &car, "--out", "out"];
    let output = sandbox.run(&[&args[..], &GAINS, &limit].concat());
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{told}");
    let within = "`pathtune rearm` lets it drive again within 1.5 s (drive.patience_s)";
    assert!(told.contains(within), "{told}");
    let end = told.lines().find(|it| it.contains("did not arrive")).unwrap();
    assert!(end.contains("the gate stopped the vehicle at ") && end.contains(cause), "{told}");
    let waited = "; nobody rearmed it within 1.5 s (drive.patience_s)";
    assert!(end.ends_with(waited), "{told}");
    assert!(sandbox.path("out/report/index.html").exists(), "{told}");
    let result = sandbox.result("out");
    assert_eq!(result["reason"], "stopped", "{told}");
    let stopped_for = result["stopped_for"].as_array().unwrap();
    assert!(stopped_for.iter().any(|it| it == name), "{result}");
    // What came before the stop was recorded.
    assert!(column(&sandbox, "out", "time_s").len() > 150, "{told}");
    let lacking = result["drives_lacking"]["drive"].as_u64().unwrap_or_default();
    assert!(lacking < 1_000_000, "{told}");
    sandbox.assert_clean();
}

#[test]
fn a_car_that_jumped_and_nobody_rearms_ends_its_drive_with_the_cause() {
    check_nobody_rearms("jumping_car", "the measured pose jumped", "odometry_jump");
}

#[test]
fn a_car_that_falls_silent_ends_its_drive_with_the_cause() {
    check_nobody_rearms("silent_car", "no odometry", "odometry_stale");
}

#[test]
fn a_car_that_does_not_know_where_it_is_ends_its_drive_with_the_cause() {
    check_nobody_rearms("lost_car", "the odometry is not finite", "odometry_invalid");
}

#[test]
fn a_car_that_stamps_by_another_clock_ends_its_drive_with_the_cause() {
    let cause = "the odometry's tick or stamp is ahead of the clock";
    check_nobody_rearms("car_by_another_clock", cause, "time_ahead");
}

/// A single tick that leaps is dropped; a vehicle whose ticks stay ahead of the clock is stopped.
#[test]
fn a_car_whose_ticks_leap_ends_its_drive_with_the_cause() {
    check_nobody_rearms(
        "leaping_car",
        "the odometry's tick or stamp is ahead of the clock",
        "time_ahead",
    );
}

#[test]
fn a_car_that_does_not_begin_ends_its_drive_with_the_cause() {
    let sandbox = Sandbox::new();
    let car = car("absent_car");
    let args = ["drive", "roundabout", "--realtime", "--replace", &car, "--out", "out"];
    let output = sandbox.run(&[&args[..], &["--set", "drive.patience_s=0.5"]].concat());
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{told}");
    let end = "the drive did not arrive: it has not begun; the vehicle sent no odometry within 0.5 s (drive.patience_s)";
    assert!(told.contains(end), "{told}");
    sandbox.assert_clean();
}

/// Not a test: a car by the clock that is not there yet.
#[test]
#[ignore = "a process of the tests above"]
fn absent_car() {
    let (attachment, bus, config) = join().unwrap();
    attachment.take_place();
    let mut car = Car { is_silent: true, ..Car::new(&bus, &config, |_, _| {}) };
    serve(&attachment, &bus, WakeRole::Vehicle, &mut car).unwrap();
}

/// Not a test: a car by the clock whose odometry ends.
#[test]
#[ignore = "a process of the tests above"]
fn silent_car() {
    run_car(|tick, car| car.is_silent = tick > 200);
}

/// Not a test: a car by the clock that does not know where it is any more.
#[test]
#[ignore = "a process of the tests above"]
fn lost_car() {
    run_car(|tick, car| car.apart.x_m = if tick < 200 { 0.0 } else { f64::NAN });
}

/// Not a test: a car by the clock one of whose ticks leaps, and later all of them.
#[test]
#[ignore = "a process of the tests above"]
fn leaping_car() {
    run_car(|tick, car| car.leaps = if tick == 100 || tick > 200 { 1_000_000_000_000 } else { 0 });
}

/// Not a test: a car by the clock that soon does not know where it is, in every drive.
#[test]
#[ignore = "a process of the tests above"]
fn ever_lost_car() {
    run_car(|tick, car| car.apart.x_m = if tick < 60 { 0.0 } else { f64::NAN });
}

/// Not a test: a car whose stamps are soon those of another clock, an hour ahead.
#[test]
#[ignore = "a process of the tests above"]
fn car_by_another_clock() {
    run_car(|tick, car| car.stamps_ahead_ns = if tick < 200 { 0 } else { 3_600_000_000_000 });
}

/// Not a test: a car by the clock whose localisation never comes to rest.
#[test]
#[ignore = "a process of the tests above"]
fn ever_jumping_car() {
    run_car(|tick, car| car.apart.y_m = if tick > 60 { 5.0 * tick as f64 } else { 0.0 });
}

/// Not a test: a car by the clock whose own safety holds it for 3 s.
#[test]
#[ignore = "a process of the tests above"]
fn held_car() {
    run_car(|tick, car| car.is_held = tick < 300);
}

/// Not a test: a car by the clock whose localisation jumps a metre to the left.
#[test]
#[ignore = "a process of the tests above"]
fn jumping_car() {
    run_car(|tick, car| car.apart.y_m = if tick < 300 { 0.0 } else { 1.0 });
}

/// Not a test: a car by the clock whose localisation turns around.
#[test]
#[ignore = "a process of the tests above"]
fn turned_car() {
    run_car(|tick, car| car.apart.yaw_rad = if tick < 150 { 0.0 } else { std::f64::consts::PI });
}

fn run_car(fate: fn(u64, &mut Car)) {
    let (attachment, bus, config) = join().unwrap();
    attachment.take_place();
    let mut car = Car::new(&bus, &config, fate);
    serve(&attachment, &bus, WakeRole::Vehicle, &mut car).unwrap();
}

/// Our simulated car by the clock, with a fate.
struct Car {
    requests: Inlet<DriveRequest>,
    commands: Inlet<WireCommand>,
    odometry: Outlet<Odometry>,
    vehicle: SimulatedVehicle,
    fate: fn(u64, &mut Self),
    /// It does not drive, whatever it is told.
    is_held: bool,
    /// It tells nothing any more.
    is_silent: bool,
    /// What it adds to the numbers of its ticks.
    leaps: u64,
    /// What it adds to its stamps.
    stamps_ahead_ns: u64,
    /// What its localisation adds to its pose.
    apart: Pose,
    tick_ns: u64,
    age_limit_ns: u64,
    zero_ns: u64,
    header: Option<TickHeader>,
    /// The command that it holds, and when that was sent.
    command: (u64, WireCommand),
    counters: Counters,
}

impl Car {
    fn new(bus: &Bus, config: &RunConfig, fate: fn(u64, &mut Self)) -> Self {
        let pacing = Status::REAL_TIME | Status::AT_START;
        Self {
            requests: bus.inlet().unwrap(),
            commands: bus.inlet().unwrap(),
            odometry: bus.outlet().unwrap(),
            vehicle: SimulatedVehicle::new(config),
            fate,
            is_held: false,
            is_silent: false,
            leaps: 0,
            stamps_ahead_ns: 0,
            apart: Pose::default(),
            tick_ns: (config.drive.tick_s * 1e9) as u64,
            age_limit_ns: (config.vehicle.safety.command_age_limit_s * 1e9) as u64,
            zero_ns: 0,
            header: None,
            command: (0, WireCommand::default()),
            counters: Counters { capacity: 1, pacing, ..Counters::default() },
        }
    }

    fn start(&mut self, of: BatchHeader, request: &DriveRequest) -> Result<()> {
        let WirePose { x_m, y_m, yaw_rad } = request.start;
        self.vehicle.reset(Pose { x_m, y_m, yaw_rad }, None);
        self.apart = Pose::default();
        self.command = (0, WireCommand::default());
        self.zero_ns = now_ns();
        self.publish(TickHeader { attempt: of.attempt, ..TickHeader::default() })
    }

    fn publish(&mut self, header: TickHeader) -> Result<()> {
        if self.is_silent {
            self.header = Some(header);
            return Ok(());
        }
        let header = TickHeader { odometry_sent_ns: now_ns(), ..header };
        self.header = Some(header);
        let seen = self.vehicle.observe();
        let Pose { x_m, y_m, yaw_rad } = self.apart;
        let at = seen.measured;
        let measured =
            WirePose { x_m: at.x_m + x_m, y_m: at.y_m + y_m, yaw_rad: at.yaw_rad + yaw_rad };
        let odometry_sent_ns = header.odometry_sent_ns + self.stamps_ahead_ns;
        let sent = TickHeader { tick: header.tick + self.leaps, odometry_sent_ns, ..header };
        self.odometry.send(sent, 1, |_| Odometry {
            measured,
            speed_mps: seen.speed_mps,
            yaw_rate_radps: seen.yaw_rate_radps,
            steering_rad: seen.steering_rad,
            ..Odometry::default()
        })?;
        Ok(())
    }

    fn drive(&mut self, header: TickHeader) -> Result<()> {
        let tick = (now_ns() - self.zero_ns) / self.tick_ns;
        for _ in header.tick..tick {
            (self.fate)(tick, self);
            let (sent_ns, command) = self.command;
            let is_stale = now_ns().saturating_sub(sent_ns) > self.age_limit_ns;
            if is_stale || self.is_held {
                self.vehicle.step(0.0, 0.0);
            } else {
                self.vehicle.step(command.speed_mps, command.steering_rad);
            }
        }
        self.publish(TickHeader { tick, ..header })
    }
}

impl Service for Car {
    fn poll(&mut self) -> Result<bool> {
        if let Some(request) = self.requests.receive_newest()? {
            self.start(request.header(), &request.items()[0])?;
        } else if let Some(message) = self.commands.receive()? {
            if self.header.is_some_and(|it| it.attempt == message.header().attempt) {
                self.command = (message.header().supervisor_sent_ns, message.items()[0]);
            }
        } else if let Some(header) = self.header.filter(|_| now_ns() >= self.due_ns()) {
            self.drive(header)?;
        } else {
            return Ok(false);
        }
        Ok(true)
    }

    fn status(&self) -> Counters {
        self.counters
    }

    fn due_ns(&self) -> u64 {
        self.header.map_or(u64::MAX, |it| self.zero_ns + (it.tick + 1) * self.tick_ns)
    }
}
