//! Driving by the clock: what fails on the way, and how soon the vehicle is told something safe.

mod support;

use std::path::Path;
use std::time::{Duration, Instant};

use ipc_types::{Safety, has};
use runtime::clock::now_ns;
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use support::onlooker::{Onlooker, ROUNDABOUT};
use support::{Sandbox, Training};

/// A car with the limits of a road, in a roundabout without an end.
fn guarded() -> Vec<&'static str> {
    [ROUNDABOUT, &["--realtime", "--vehicle", "tesla_model_3_guarded"]].concat()
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
    let wall_s = clocked["run"]["wall_s"].as_f64().unwrap();
    assert!(wall_s >= 5.0, "{wall_s} s for 5 s by the clock");
    sandbox.assert_clean();
}

#[test]
fn every_kill_ends_in_a_safe_command_and_none_is_missed() {
    let (kill, stop) = (Signal::KILL, Signal::STOP);
    inject(&[
        ("controller", kill),
        ("supervisor", kill),
        ("simulator", kill),
        ("controller", stop),
    ]);
}

#[test]
fn every_freeze_ends_in_a_safe_command_and_none_is_missed() {
    let (kill, stop) = (Signal::KILL, Signal::STOP);
    inject(&[
        ("supervisor", stop),
        ("simulator", stop),
        ("controller", stop),
        ("controller", kill),
    ]);
}

/// Half of the faults that are asked for, one behind the other.
fn inject(faults: &[(&'static str, Signal)]) {
    let injections: usize =
        std::env::var("PATHTUNE_INJECTIONS").map_or(20, |text| text.parse().unwrap()) / 2;
    let sandbox = Sandbox::new();
    let mut drive = start(&sandbox, &guarded());
    drive.wait_for("the run", || sandbox.has_living_run());
    let mut onlooker = Onlooker::new(&sandbox.living_run());
    onlooker.until_it_drives();
    let mut spread = Spread(1);
    let mut times_ms: Vec<(f64, &str, Signal)> = Vec::new();
    let mut again_ms = Vec::new();
    let (mut stops, mut replaced) = (0, 0);
    for index in 0..injections {
        let (service, signal) = faults[index % faults.len()];
        onlooker.look_for(Duration::from_secs_f64(0.2 + 0.1 * spread.next()));
        onlooker.until_it_drives();
        let pid = pid_of(&sandbox, service);
        let fault_ns = now_ns();
        let (time_ms, healed) = onlooker.strike(service, pid, signal);
        times_ms.push((time_ms, service, signal));
        replaced += usize::from(healed);
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
         {replaced} replaced before the car had to slow down; {stops} stops; killed controller to driving again: p50 {:.0} ms, max {:.0} ms; off the path at most {:.2} m, {:.2} m/s",
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
    let args = [&guarded()[..], &["--set", "vehicle.safety.degraded_limit_s=0.2"]].concat();
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
    assert!(said.contains("is being stopped: no answer from the controller"), "{said}");
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

#[test]
fn a_car_that_nobody_here_wrote_drives_over_shared_memory() {
    let Some(python) = support::python_with_a_multi_body_car() else { return };
    let sandbox = Sandbox::new();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/peers/shm_car.py");
    let car = format!("vehicle={python} -B {}", script.display());
    for (maneuver, seconds) in [("lane_change", 8), ("roundabout", 15)] {
        let time = format!("drive.loop_time_s={seconds}");
        let args = ["drive", maneuver, "--set", &time, "--set", "vehicle.gear_engaged=true"];
        let simulated = [&args[..], &["--vehicle", "tesla_model_3_guarded"]].concat();
        let simulated = sandbox.json(&format!("simulated_{maneuver}"), &simulated);
        let driven =
            [&args[..], &["--realtime", "--vehicle", "ackermann", "--replace", &car]].concat();
        let driven = sandbox.json(&format!("driven_{maneuver}"), &driven);
        let off = |result: &Value| result["max_cross_track_m"].as_f64().unwrap();
        println!(
            "{maneuver}: at most {:.3} m off the path by the multi-body car over shared memory, {:.3} m by our simulator",
            off(&driven),
            off(&simulated),
        );
        assert_ne!(driven["reason"], "collision");
        assert!(off(&driven) < 1.75, "{driven}");
    }
    sandbox.assert_clean();
}
