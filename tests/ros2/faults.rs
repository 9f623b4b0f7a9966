//! Faults of the link: this process is stopped for a moment, or somebody else begins to drive the car.

use std::time::{Duration, Instant};

use ipc_types::{Odometry, Safety, Status, has};
use rustix::process::Signal;
use serde_json::Value;

use super::ring::{Ring, follow};
use crate::support::dds::{Peer, own_domain, python};
use crate::support::onlooker::{Onlooker, ROUNDABOUT};
use crate::support::{Sandbox, signal};

const PAUSES: [Duration; 2] = [Duration::from_millis(20), Duration::from_secs(3)];

fn repeats() -> usize {
    std::env::var("PATHTUNE_PAUSES").map_or(2, |text| text.parse().unwrap())
}

#[test]
fn an_adapter_that_was_paused_commands_again() {
    let Some(python) = python() else { return };
    let (sandbox, domain) = (Sandbox::new(), own_domain());
    let car = Peer::start(&sandbox, &python, domain, &[]);
    let mut ring = Ring::start(&sandbox, domain, "ackermann", &[]);
    ring.wait_for("a car at the start", Duration::from_secs(8), Ring::is_at_start);
    ring.request();
    ring.drive(Duration::from_secs(2), follow(0.0, 1.0));
    for pause in PAUSES {
        let mut times_ms = Vec::new();
        for _ in 0..repeats() {
            let pid = ring.adapter.id() as i32;
            signal(pid, Signal::STOP);
            ring.drive(pause, follow(0.0, 1.0));
            let heard = car.last("heard");
            signal(pid, Signal::CONT);
            let continued = Instant::now();
            while car.last("heard") <= heard {
                ring.drive(Duration::from_millis(5), follow(0.0, 1.0));
                let told = ring.told();
                assert!(continued.elapsed() < Duration::from_secs(5), "no command leaves: {told}");
            }
            times_ms.push(continued.elapsed().as_secs_f64() * 1e3);
            let driven = ring.drive(Duration::from_millis(700), follow(0.0, 1.0));
            let last = driven.last().expect("odometry again").1;
            assert_eq!(last.status, 0, "{}", ring.told());
        }
        times_ms.sort_by(f64::total_cmp);
        println!(
            "paused for {pause:?}, {} times: commands again after {:.0} ms (median), {:.0} ms (largest)",
            times_ms.len(),
            times_ms[times_ms.len() / 2],
            times_ms[times_ms.len() - 1],
        );
    }
    assert!(car.last("speed_mps") > 0.7);
    // Paused, and then asked to end: the car is told to stop all the same.
    signal(ring.adapter.id() as i32, Signal::STOP);
    std::thread::sleep(PAUSES[0]);
    signal(ring.adapter.id() as i32, Signal::CONT);
    let told = ring.stop();
    assert!(told.contains("this process was stopped for a moment"), "{told}");
    // The car has its own time to read what was acknowledged.
    let stopped = Instant::now();
    while car.last("told_mps") != 0.0 {
        assert!(stopped.elapsed() < Duration::from_secs(5), "{told}");
        std::thread::sleep(Duration::from_millis(10));
    }
    sandbox.assert_clean();
}

/// The longest time between two commands that a car heard, in milliseconds.
fn longest_silence_ms(log: &[Value]) -> f64 {
    let heard = |line: &Value| line["heard"].as_u64().unwrap();
    let times_ns: Vec<u64> = std::iter::once(log[0]["t_ns"].as_u64().unwrap())
        .chain(
            log.windows(2)
                .filter(|pair| heard(&pair[1]) > heard(&pair[0]))
                .map(|pair| pair[1]["t_ns"].as_u64().unwrap()),
        )
        .collect();
    times_ns.windows(2).map(|pair| (pair[1] - pair[0]) as f64 / 1e6).fold(0.0, f64::max)
}

#[test]
fn a_drive_goes_on_when_its_adapter_was_paused() {
    let Some(python) = python() else { return };
    let (sandbox, domain) = (Sandbox::new(), own_domain());
    let car = Peer::start(&sandbox, &python, domain, &[]);
    let set = format!("vehicle.ros2.domain_id={domain}");
    let adapter = ["--adapter", "ros2-vehicle", "--vehicle", "ackermann"];
    let network = ["--set", &set, "--set", "vehicle.ros2.network=\"127.0.0.1\""];
    let args = [ROUNDABOUT, &adapter[..], &network[..]].concat();
    let mut drive = sandbox.start("drive", "out", &args);
    drive.wait_for("the run", || sandbox.has_living_run());
    let mut onlooker = Onlooker::new(&sandbox.living_run());
    onlooker.until_it_drives();
    for pause in PAUSES {
        let (mut gaps_ms, mut stops) = (Vec::new(), 0);
        for _ in 0..repeats() {
            onlooker.look_for(Duration::from_millis(300));
            let pid = sandbox.service("ros2-vehicle").unwrap();
            signal(pid, Signal::STOP);
            let before = car.log().len();
            onlooker.look_for(pause);
            // Frozen for so long, it may have been replaced.
            let _ = rustix::process::kill_process(
                rustix::process::Pid::from_raw(pid).unwrap(),
                Signal::CONT,
            );
            onlooker.look_for(Duration::from_millis(700));
            stops += usize::from(onlooker.until_it_drives());
            gaps_ms.push(longest_silence_ms(&car.log()[before..]));
        }
        gaps_ms.sort_by(f64::total_cmp);
        println!(
            "paused for {pause:?}, {} times: without commands for {:.0} ms (median), {:.0} ms (largest); {stops} stops",
            gaps_ms.len(),
            gaps_ms[gaps_ms.len() / 2],
            gaps_ms[gaps_ms.len() - 1],
        );
    }
    assert_eq!(onlooker.state, Safety::NORMAL);
    drop(onlooker);
    drive.interrupt();
    drive.finish();
    std::thread::sleep(Duration::from_millis(300));
    assert_eq!(car.last("told_mps"), 0.0);
    sandbox.assert_clean();
}

#[test]
fn commands_that_nobody_acknowledges_are_told_and_the_drive_does_not_go_on() {
    let Some(python) = python() else { return };
    let (sandbox, domain) = (Sandbox::new(), own_domain());
    // Its odometry comes, whether or not its ear hears commands.
    let _car = Peer::start(&sandbox, &python, domain, &["--deaf"]);
    let ear = Peer::start(&sandbox, &python, domain, &["--ear"]);
    let mut ring = Ring::start(&sandbox, domain, "ackermann", &[]);
    ring.wait_for("a car at the start", Duration::from_secs(30), Ring::is_at_start);
    // Discovered, and deaf from the start.
    ear.freeze();
    ring.request();
    let is_told = |ring: &Ring, what: &str| ring.told().contains(what);
    ring.wait_for("what it waits for", Duration::from_secs(30), |ring| {
        is_told(ring, "the drive waits for somebody to acknowledge a command")
    });
    assert!(ring.heard.is_empty(), "{}", ring.told());
    // Discovery over loopback, where nobody hears an announcement twice at once, may take a while.
    ear.signal(Signal::CONT);
    ring.wait_for("the drive", Duration::from_secs(60), |ring| !ring.heard.is_empty());
    ring.drive(Duration::from_secs(1), follow(0.0, 1.0));
    assert_eq!(ear.last("told_mps"), 1.0, "{}", ring.told());
    // Deaf on the way.
    let before = ring.told().len();
    ear.freeze();
    let (deaf, until) = (Instant::now(), Instant::now() + Duration::from_secs(20));
    let mut times_ms = Vec::new();
    for what in ["acknowledged for 0.3 s; joining the network anew", "this drive does not go on"] {
        while !ring.told()[before..].contains(what) {
            assert!(Instant::now() < until, "{what} is not told: {}", ring.told());
            ring.drive(Duration::from_millis(5), follow(0.0, 1.0));
        }
        times_ms.push(deaf.elapsed().as_millis());
    }
    println!("not acknowledged: told after {} ms, given up after {} ms", times_ms[0], times_ms[1]);
    // It hears again: it is stopped, whatever the rest of the ring says.
    ear.signal(Signal::CONT);
    let until = Instant::now() + Duration::from_secs(60);
    while ear.last("told_mps") > 0.0 {
        assert!(Instant::now() < until, "the car drives on: {}", ring.told());
        ring.drive(Duration::from_millis(50), follow(0.0, 1.0));
    }
    ring.drive(Duration::from_millis(500), follow(0.0, 1.0));
    assert_eq!(ear.last("told_mps"), 0.0, "{}", ring.told());
    let told = ring.stop();
    assert!(!told.contains("publishes on"), "{told}");
    sandbox.assert_clean();
}

#[test]
fn beside_a_second_publisher_the_car_stops() {
    let Some(python) = python() else { return };
    let (sandbox, domain) = (Sandbox::new(), own_domain());
    let car = Peer::start(&sandbox, &python, domain, &[]);
    let mut ring = Ring::start(&sandbox, domain, "ackermann", &[]);
    ring.wait_for("a car at the start", Duration::from_secs(8), Ring::is_at_start);
    ring.request();
    ring.drive(Duration::from_secs(3), follow(0.0, 1.5));
    assert!(car.last("speed_mps") > 1.0);
    // It says nothing yet: the car stops all the same.
    let driver = Peer::start(&sandbox, &python, domain, &["--driver"]);
    let until = Instant::now() + Duration::from_secs(10);
    while car.last("told_mps") > 0.0 {
        assert!(Instant::now() < until, "the car drives on: {}", ring.told());
        ring.drive(Duration::from_millis(50), follow(0.0, 1.5));
    }
    // Nor does it drive on when the other one has gone.
    drop(driver);
    let stopped = ring.drive(Duration::from_secs(2), follow(0.0, 1.5));
    assert!(stopped.iter().all(|(_, seen)| has(seen.status, Odometry::OWN_STOP)));
    assert!(car.last("speed_mps").abs() < 0.1 && car.last("told_mps") == 0.0);
    assert!(
        ring.told().contains("somebody else publishes on /drive, too: the car is being stopped")
    );
    // The next drive may.
    ring.wait_for("a car at the start", Duration::from_secs(8), Ring::is_at_start);
    assert!(has(ring.newest_status.pacing, Status::AT_START));
    ring.request();
    ring.drive(Duration::from_secs(2), follow(0.0, 1.0));
    assert!(car.last("speed_mps") > 0.5, "{}", ring.told());
    ring.stop();
    sandbox.assert_clean();
}
