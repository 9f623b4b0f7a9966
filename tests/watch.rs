//! What the gate's watch makes of vehicles that do not drive as they are told, from outside: message, result, exit code.
//!
//! Processes of this test take the vehicle's role: our simulated vehicle, with a fault.

mod support;

use anyhow::Result;
use config::{Parameters, RunConfig};
use ipc_types::{Command, DriveRequest, Odometry, TickHeader, WakeRole, WirePose};
use rollout::{Fault, FaultyCar, Plant, Rollout};
use runtime::{Bus, Counters, Inlet, Outlet, Service, join, serve};
use support::Sandbox;
use tracking::Pose;

/// Twice as fast as the path.
const STUCK: Fault = Fault::StuckThrottle { speed_mps: 4.0 };
const BENT: Fault = Fault::BentLinkage { gain: 0.15, offset_rad: 0.12 };

/// A straight of 20 m, a bend of 14 m to the left, and a straight of 20 m, at 2 m/s.
fn bend() -> String {
    let mut file = "x_m,y_m,v_mps\n".to_owned();
    (0..=40).for_each(|index| file += &format!("{},0,2\n", 0.5 * f64::from(index)));
    for degree in 1..90 {
        let angle = f64::from(degree).to_radians();
        file += &format!("{},{},2\n", 20.0 + 14.0 * angle.sin(), 14.0 * (1.0 - angle.cos()));
    }
    (0..=40).for_each(|index| file += &format!("34,{},2\n", 14.0 + 0.5 * f64::from(index)));
    file
}

/// Drives the bend with a vehicle that has a fault; returns exit code, what was said, and the result.
fn drive(sandbox: &Sandbox, process: &str) -> (Option<i32>, String, serde_json::Value) {
    std::fs::write(sandbox.path("bend.csv"), bend()).unwrap();
    let vehicle = format!(
        "vehicle={} --exact {process} --ignored --nocapture",
        std::env::current_exe().unwrap().display()
    );
    let args = ["drive", "--path", "bend.csv", "--vehicle", "ackermann", "--gains", "3,21,21,0.7"];
    let output = sandbox.run(&[&args[..], &["--out", process, "--replace", &vehicle]].concat());
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    (output.status.code(), said, sandbox.result(process))
}

#[test]
fn far_off_the_path_drives_on() {
    let sandbox = Sandbox::new();
    let (code, said, result) = drive(&sandbox, "bent_vehicle");
    assert_eq!(code, Some(2), "{said}");
    assert!(said.contains("does not turn as its steering angle is commanded"), "{said}");
    assert_eq!((&result["reason"], &result["arrived"]), (&"stopped".into(), &false.into()));
    assert_eq!(result["stopped_for"], serde_json::json!(["steering_ignored"]));
    assert!(result["path_max_m"].as_f64().unwrap() < 3.5, "{result}");

    assert_as_plain_calls(&sandbox, "bent_vehicle", BENT, &result);
    sandbox.assert_clean();
}

/// Its reference goes along with it, at a rate that the supervisor sets tick by tick.
#[test]
fn a_car_that_runs_away_is_told_and_kept_near_its_path() {
    let sandbox = Sandbox::new();
    let (code, said, result) = drive(&sandbox, "stuck_vehicle");
    assert_eq!(code, Some(2), "{said}");
    assert_eq!(result["stopped_for"], serde_json::json!(["speed_ignored"]), "{said}");
    assert!(result["path_max_m"].as_f64().unwrap() < 1.0, "{result}");
    assert_as_plain_calls(&sandbox, "stuck_vehicle", STUCK, &result);
    sandbox.assert_clean();
}

/// Bit for bit what plain calls make of it.
fn assert_as_plain_calls(sandbox: &Sandbox, out: &str, fault: Fault, result: &serde_json::Value) {
    let config = sandbox.text(&format!("{out}/config.toml"));
    let config = RunConfig::from_resolved(&config).unwrap();
    let car = FaultyCar::new(&config, fault, 0, u64::MAX);
    let record = Rollout::around(car, &config).drive(Parameters::of(&[3.0, 21.0, 21.0, 0.7]), None);
    let ticks = (result["driven_s"].as_f64().unwrap() / config.drive.tick_s).round() as u64;
    assert_eq!((ticks, result["path_max_m"].as_f64()), (record.ticks, Some(record.path_max_m)));
}

#[test]
fn a_wrong_steering_sign_is_told_and_a_healthy_vehicle_arrives() {
    let sandbox = Sandbox::new();
    let (code, said, result) = drive(&sandbox, "vehicle_of_the_wrong_sign");
    assert_eq!(code, Some(2), "{said}");
    assert!(said.contains("turns right when told to turn left"), "{said}");
    assert!(said.contains("steering_sign?"), "{said}");
    assert!(result["path_max_m"].as_f64().unwrap() < 3.5, "{result}");
    let (code, said, result) = drive(&sandbox, "healthy_vehicle");
    assert_eq!((code, &result["reason"]), (Some(0), &"goal".into()), "{said}");
    assert_eq!(result["stopped_for"], serde_json::json!([]));
    sandbox.assert_clean();
}

/// Not a test: a process in the vehicle's role.
#[test]
#[ignore = "a process of the tests above"]
fn bent_vehicle() {
    run_vehicle(BENT);
}

/// Not a test: a process in the vehicle's role.
#[test]
#[ignore = "a process of the tests above"]
fn stuck_vehicle() {
    run_vehicle(STUCK);
}

/// Not a test: a process in the vehicle's role.
#[test]
#[ignore = "a process of the tests above"]
fn vehicle_of_the_wrong_sign() {
    run_vehicle(Fault::WrongSign);
}

/// Not a test: a process in the vehicle's role.
#[test]
#[ignore = "a process of the tests above"]
fn healthy_vehicle() {
    run_vehicle(Fault::None);
}

fn run_vehicle(fault: Fault) {
    let (attachment, bus, config) = join().unwrap();
    let car = FaultyCar::new(&config, fault, 0, u64::MAX);
    let mut vehicle = Vehicle::new(&bus, car);
    serve(&attachment, &bus, WakeRole::Vehicle, &mut vehicle).unwrap();
}

/// A fleet of one, in lockstep.
struct Vehicle {
    requests: Inlet<DriveRequest>,
    commands: Inlet<Command>,
    odometry: Outlet<Odometry>,
    car: FaultyCar,
    header: TickHeader,
}

impl Vehicle {
    fn new(bus: &Bus, car: FaultyCar) -> Self {
        Self {
            requests: bus.inlet().unwrap(),
            commands: bus.inlet().unwrap(),
            odometry: bus.outlet().unwrap(),
            car,
            header: TickHeader::default(),
        }
    }

    fn publish(&mut self) -> Result<()> {
        let seen = self.car.observe();
        let wire = |pose: Pose| WirePose { x_m: pose.x_m, y_m: pose.y_m, yaw_rad: pose.yaw_rad };
        let odometry = Odometry {
            measured: wire(seen.measured),
            truth: wire(seen.truth),
            speed_mps: seen.speed_mps,
            yaw_rate_radps: seen.yaw_rate_radps,
            steering_rad: seen.steering_rad,
            status: Odometry::HAS_TRUTH,
            reserved: 0,
        };
        self.odometry.send(self.header, 1, |_| odometry)?;
        Ok(())
    }
}

impl Service for Vehicle {
    fn poll(&mut self) -> Result<bool> {
        if let Some(request) = self.requests.receive_newest()? {
            let WirePose { x_m, y_m, yaw_rad } = request.items()[0].start;
            self.car.reset(Pose { x_m, y_m, yaw_rad }, None);
            let attempt = request.header().attempt;
            self.header = TickHeader { attempt, ..TickHeader::default() };
            self.publish()?;
            return Ok(true);
        }
        let Some(commands) = self.commands.receive()? else { return Ok(false) };
        let command = commands.items()[0];
        let of = |header: TickHeader| (header.attempt, header.tick);
        if of(commands.header()) == of(self.header) && command.flags & Command::ENDED == 0 {
            self.car.step(command.speed_mps, command.steering_rad);
            self.header.tick += 1;
            self.publish()?;
        }
        Ok(true)
    }

    fn status(&self) -> Counters {
        Counters { capacity: 1, ..Counters::default() }
    }
}
