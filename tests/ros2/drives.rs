//! Drives with a car that nobody here wrote.

use std::time::{Duration, Instant};

use ipc_types::{Command, Odometry, TickHeader, WirePose, has};
use rustix::process::Signal;
use serde_json::Value;

use super::ring::{Ring, follow};
use crate::support::Sandbox;
use crate::support::dds::{Peer, own_domain, python};
use crate::support::onlooker::{Onlooker, ROUNDABOUT};

fn silent_for_the_rest(rest: &[(TickHeader, Odometry)], own: &[(TickHeader, Odometry)]) -> bool {
    rest.iter().all(|(header, _)| header.tick < own[0].0.tick)
}

fn ticks(heard: &[(TickHeader, Odometry)]) -> Vec<u64> {
    heard.iter().map(|(header, _)| header.tick).collect()
}

#[test]
fn a_car_that_nobody_here_wrote_is_driven_stopped_and_left_standing() {
    let Some(python) = python() else { return };
    let (sandbox, domain) = (Sandbox::new(), own_domain());
    // It stands anywhere: where it stands the path begins. Its odometry is that of a point 1 m ahead.
    let args = ["--start", "12,-3,2.5", "--point", "1.0"];
    let car = Peer::start(&sandbox, &python, domain, &args);
    let settings = ["vehicle.ros2.odometry_point_m=1.0", "vehicle.ros2.odometry_frame='odom'"];
    let mut ring = Ring::start(&sandbox, domain, "ackermann", &settings);
    ring.wait_for("a car at the start", Duration::from_secs(8), Ring::is_at_start);
    assert_eq!(ring.newest_status.capacity, 1);
    assert!(ring.heard.is_empty());

    ring.request();
    let driven = ring.drive(Duration::from_secs(5), follow(-1.0, 1.5));
    let (first, last) = (driven.first().unwrap(), driven.last().unwrap());
    assert_eq!((first.0.tick, first.1.status, first.0.applied_ns), (0, 0, 0));
    let WirePose { x_m, y_m, yaw_rad } = first.1.measured;
    assert!(x_m.abs() < 1e-9 && y_m.abs() < 1e-9 && yaw_rad.abs() < 1e-9, "{first:?}");
    assert!(ticks(&driven).is_sorted_by(|a, b| a < b));
    let rate_hz = driven.len() as f64 / 5.0;
    println!("odometry at {rate_hz} Hz");
    // Of 100, on whatever machine.
    assert!(rate_hz > 50.0, "{rate_hz} Hz");
    let at = last.1.measured;
    assert!(at.x_m > 3.0 && (at.y_m + 1.0).abs() < 0.2, "{at:?}");
    assert!((last.1.speed_mps - 1.5).abs() < 0.2 && last.1.status == 0, "{last:?}");
    assert!(last.0.applied_ns > last.0.odometry_sent_ns - 100_000_000);
    // As the car itself has it, in its own frame: the tracked point lies 0.7 m ahead of its rear axle.
    let map = |line: &Value| {
        let of = |key: &str| line[key].as_f64().unwrap();
        let yaw_rad = of("yaw_rad");
        let x_m = of("x_m") + 0.7 * yaw_rad.cos() - 12.0 - 0.7 * 2.5f64.cos();
        let y_m = of("y_m") + 0.7 * yaw_rad.sin() + 3.0 - 0.7 * 2.5f64.sin();
        let (sin, cos) = 2.5f64.sin_cos();
        (cos * x_m + sin * y_m, cos * y_m - sin * x_m)
    };
    let line = car
        .log()
        .into_iter()
        .rev()
        .find(|line| line["t_ns"].as_u64().unwrap() <= last.0.odometry_sent_ns);
    let (x_m, y_m) = map(&line.unwrap());
    assert!((x_m - at.x_m).hypot(y_m - at.y_m) < 0.1, "({x_m}, {y_m}), measured {at:?}");

    // Nobody answers any more: it stops by itself, wheels straight, and says so.
    let before = car.last("speed_mps");
    let silent = ring.drive(Duration::from_secs(2), |_| None);
    let (own, rest): (Vec<_>, Vec<_>) =
        silent.into_iter().partition(|(_, seen)| has(seen.status, Odometry::OWN_STOP));
    // A command is held for 0.1 s: at most 10 ticks, and some that were on their way.
    assert!(before > 1.2 && rest.len() < 30, "{before} m/s, {}", rest.len());
    assert!(silent_for_the_rest(&rest, &own), "own stop ends by itself");
    assert!(own.len() > 50, "{}", own.len());
    assert!(car.last("speed_mps") < 0.3 && car.last("told_mps") == 0.0);
    assert_eq!(car.last("told_rad"), 0.0);
    // Somebody does again.
    let again = ring.drive(Duration::from_secs(2), follow(-1.0, 1.0));
    assert_eq!(again.last().unwrap().1.status, 0);
    assert!(car.last("speed_mps") > 0.7);
    // The end of the drive; the next one begins where the car has come to rest.
    let ended = ring.drive(Duration::from_secs(3), |_| {
        Some(Command { flags: Command::ENDED, ..Command::default() })
    });
    assert_eq!(ended.last().unwrap().1.status, Odometry::ENDED);
    assert!(car.last("speed_mps").abs() < 0.05);
    ring.wait_for("the car at rest", Duration::from_secs(5), Ring::is_at_start);
    ring.request();
    let next = ring.drive(Duration::from_secs(2), follow(0.0, 1.0));
    // What was on its way when the request went out is of the drive before.
    let (header, first) = next.iter().find(|(header, _)| header.attempt.batch == 2).unwrap();
    assert_eq!((header.tick, first.measured.x_m), (0, 0.0));

    // It ends on the way: the car is told to stop.
    assert!(car.last("told_mps") == 1.0);
    let heard = car.last("heard");
    let told = ring.stop();
    assert!(told.contains("told the car to stop"), "{told}");
    std::thread::sleep(Duration::from_millis(200));
    assert_eq!((car.last("told_mps"), car.last("told_rad")), (0.0, 0.0));
    assert!(car.last("heard") - heard >= 3.0);
    sandbox.assert_clean();
}

#[test]
fn a_killed_adapter_joins_the_drive_again() {
    let Some(python) = python() else { return };
    let (sandbox, domain) = (Sandbox::new(), own_domain());
    let car = Peer::start(&sandbox, &python, domain, &["--start", "0,0,-1.0"]);
    let mut ring = Ring::start(&sandbox, domain, "ackermann", &[]);
    ring.wait_for("a car at the start", Duration::from_secs(8), Ring::is_at_start);
    ring.request();
    let driven = ring.drive(Duration::from_secs(2), follow(0.0, 1.0));
    assert!(!driven.is_empty());
    let killed = Instant::now();
    ring.kill_and_restart(&sandbox);
    let heard = ring.heard.len();
    let before = ring.heard[heard - 1];
    ring.wait_for("odometry", Duration::from_secs(5), |ring| ring.heard.len() > heard);
    println!("odometry again {:?} behind the kill", killed.elapsed());
    let first = ring.heard[heard];
    assert_eq!((first.0.attempt.batch, first.0.attempt.attempt), (1, 1));
    assert!(first.0.tick > before.0.tick, "{first:?}, before {before:?}");
    let ticks_away = (first.0.odometry_sent_ns - before.0.odometry_sent_ns) / 10_000_000;
    assert!((first.0.tick - before.0.tick).abs_diff(ticks_away) < 10, "{ticks_away}");
    // It goes on where the car is, not at the start again.
    let away_m = 0.01 * ticks_away as f64;
    let ahead_m = first.1.measured.x_m - before.1.measured.x_m;
    assert!(ahead_m > 0.0 && ahead_m < 1.5 * away_m + 0.2, "{ahead_m} m in {away_m} s");
    assert!(first.1.measured.y_m.abs() < 0.2, "{first:?}");
    // Nobody has answered yet: it stops the car as soon as the car hears it.
    ring.wait_for("its own stop", Duration::from_secs(5), |ring| {
        ring.heard[heard..].iter().any(|(_, odometry)| has(odometry.status, Odometry::OWN_STOP))
    });
    let again = ring.drive(Duration::from_secs(2), follow(0.0, 1.0));
    assert_eq!(again.last().unwrap().1.status, 0);
    assert!(car.last("speed_mps") > 0.8);
    let told = ring.stop();
    assert!(told.contains("joined=true"), "{told}");
    sandbox.assert_clean();
}

#[test]
fn carla_s_topics_messages_frames_and_collisions_are_understood() {
    let Some(python) = python() else { return };
    let (sandbox, domain) = (Sandbox::new(), own_domain());
    let args = [
        ["--odometry", "/carla/ego_vehicle/odometry"],
        ["--drive", "/carla/ego_vehicle/ackermann_cmd"],
        ["--collision", "/carla/ego_vehicle/collision"],
        ["--collides-after", "0.5"],
        ["--frame", "map"],
        ["--point", "1.44"],
        ["--start=-0.5,-0.1,0.05", "--bare"],
        // Not CARLA's: its own node turns the sign. Here the key must.
        ["--sign=-1", "--bare"],
    ];
    let args = args.concat();
    let car = Peer::start(&sandbox, &python, domain, &args);
    let settings = ["vehicle.ros2.steering_sign=-1", "vehicle.ros2.align='map'"];
    let mut ring = Ring::start(&sandbox, domain, "carla", &settings);
    ring.wait_for("a car at the start", Duration::from_secs(8), Ring::is_at_start);
    ring.request();
    let driven = ring.drive(Duration::from_secs(4), follow(0.5, 1.0));
    // In the map's frame the pose is the car's own: 0.7 m ahead of its rear axle.
    let first = driven[0].1.measured;
    assert!((first.x_m - 0.2).abs() < 0.01 && (first.y_m + 0.065).abs() < 0.01, "{first:?}");
    assert!((driven.last().unwrap().1.measured.y_m - 0.5).abs() < 0.25);
    assert!(car.log().iter().any(|line| line["told_rad"].as_f64().unwrap() < -0.1));
    let collided: Vec<bool> =
        driven.iter().map(|(_, seen)| has(seen.status, Odometry::COLLISION)).collect();
    assert!(!collided[0] && *collided.last().unwrap() && collided.is_sorted());
    let told = ring.stop();
    assert!(told.contains("collision"), "{told}");
    sandbox.assert_clean();
}

/// The whole pipeline behind the adapter, and in front of it a car that nobody here wrote.
fn drive_whole(maneuver: &str, seconds: u32) {
    let Some(python) = python() else { return };
    let (sandbox, domain) = (Sandbox::new(), own_domain());
    let time = format!("drive.loop_time_s={seconds}");
    let simulated =
        ["drive", maneuver, "--vehicle", "tesla_model_3_guarded", "--set", &time, "--set"];
    let simulated =
        sandbox.json("simulated", &[&simulated[..], &["vehicle.gear_engaged=true"]].concat());
    let car = Peer::start(&sandbox, &python, domain, &["--start", "0,0,0.3"]);
    let set = format!("vehicle.ros2.domain_id={domain}");
    let args = ["drive", maneuver, "--adapter", "ros2-vehicle", "--vehicle", "ackermann"];
    let more = ["--set", &set, "--set", "vehicle.ros2.network=\"127.0.0.1\"", "--set", &time];
    // Discovery over loopback may take longer than a car in a laboratory would.
    let driven = sandbox.json("driven", &[&args[..], &more].concat());
    let off = |result: &Value| result["max_cross_track_m"].as_f64().unwrap();
    println!(
        "{maneuver}: at most {:.3} m off the path by the multi-body car over DDS, {:.3} m by our simulator; mse {} and {}; it drove {:.1} m",
        off(&driven),
        off(&simulated),
        driven["mse_m2"],
        simulated["mse_m2"],
        car.last("x_m").hypot(car.last("y_m")),
    );
    assert_ne!(driven["reason"], "collision");
    assert_eq!(driven["true_poses"], false);
    // It went along the path, within the lane and the one beside it.
    assert!(off(&driven) < 1.75, "{driven}");
    assert!(car.last("x_m").hypot(car.last("y_m")) > 2.0, "it did not go");
    sandbox.assert_clean();
}

#[test]
fn the_pipeline_drives_it_through_a_lane_change() {
    drive_whole("lane_change", 8);
}

#[test]
fn the_pipeline_drives_it_through_a_roundabout() {
    drive_whole("roundabout", 20);
}

#[test]
fn adapters_killed_again_and_again_are_always_ready_again() {
    let Some(python) = python() else { return };
    let kills: usize =
        std::env::var("PATHTUNE_ADAPTER_KILLS").map_or(10, |text| text.parse().unwrap());
    let (sandbox, domain) = (Sandbox::new(), own_domain());
    let car = Peer::start(&sandbox, &python, domain, &[]);
    let set = format!("vehicle.ros2.domain_id={domain}");
    let adapter = ["--adapter", "ros2-vehicle", "--vehicle", "ackermann"];
    let network = ["--set", &set, "--set", "vehicle.ros2.network=\"127.0.0.1\""];
    let mut drive =
        sandbox.start("drive", "out", &[ROUNDABOUT, &adapter[..], &network[..]].concat());
    drive.wait_for("the run", || sandbox.has_living_run());
    let mut onlooker = Onlooker::new(&sandbox.living_run());
    onlooker.until_it_drives();
    let (mut times_ms, mut stops) = (Vec::new(), 0);
    for kill in 0..kills {
        onlooker.look_for(Duration::from_millis(300));
        onlooker.until_it_drives();
        let pid = sandbox.service("ros2-vehicle").unwrap();
        // Every third one freezes, which is found out by its silence.
        let fault = if kill % 3 == 2 { Signal::STOP } else { Signal::KILL };
        times_ms.push(onlooker.strike("ros2-vehicle", pid, fault).0);
        // Another one drives.
        onlooker.look_until("another adapter", |_| {
            sandbox.service("ros2-vehicle").is_some_and(|now| now != pid)
        });
        stops += usize::from(onlooker.until_it_drives());
    }
    times_ms.sort_by(f64::total_cmp);
    println!(
        "{kills} adapters killed or frozen: safe command p50 {:.1} ms, max {:.1} ms; {stops} stops; {:.1} m driven",
        times_ms[kills / 2],
        times_ms[kills - 1],
        car.last("x_m").hypot(car.last("y_m")),
    );
    // One publisher, as DDS and as the topic see it: a second one would have been told.
    let told = sandbox.text("out/logs/ros2-vehicle.log");
    assert!(!told.contains("publishes on"), "{told}");
    drop(onlooker);
    drive.interrupt();
    drive.finish();
    sandbox.assert_clean();
}
