//! What the adapter says where something is missing, or in the way.

use std::time::{Duration, Instant};

use ipc_types::Status;

use super::ring::Ring;
use crate::support::Sandbox;
use crate::support::dds::{Peer, own_domain, python};

#[test]
fn what_is_missing_is_said_within_five_seconds_of_a_process_that_lives() {
    let Some(python) = python() else { return };
    for (with_car, part) in [
        (false, "no odometry on /odom; publishers seen: 0"),
        (true, "no odometry on /odom; publishers seen: 1, best effort; ours asks for reliable"),
    ] {
        let (sandbox, domain) = (Sandbox::new(), own_domain());
        let car = with_car.then(|| Peer::start(&sandbox, &python, domain, &[]));
        if let Some(car) = &car {
            car.wait_until_it_lives();
        }
        let started = Instant::now();
        let settings = ["vehicle.ros2.odometry_reliability='reliable'"];
        let mut ring = Ring::start(&sandbox, domain, "ackermann", &settings);
        ring.wait_for("readiness", Duration::from_secs(5), |ring| {
            ring.newest_status.state == Status::READY
        });
        let ready = started.elapsed();
        // A sign of life every 100 ms, and a request that has to wait.
        ring.request();
        let mut beats = 0;
        let until = started + Duration::from_millis(5000).max(ready + Duration::from_secs(3));
        while Instant::now() < until {
            while ring.status.receive().unwrap().is_some() {
                beats += 1;
            }
            std::thread::sleep(Duration::from_millis(5));
            ring.bus.look_for_readers();
        }
        let told = ring.told();
        assert!(told.contains(part), "{told}");
        assert!(told.contains("waits for odometry"), "{told}");
        assert_eq!(told.contains("nobody receives /drive"), !with_car, "{told}");
        assert!(beats >= 15, "{beats} beats, ready after {ready:?}");
        assert!(ring.heard.is_empty() && !ring.is_at_start());
        ring.stop();
        sandbox.assert_clean();
    }
}

#[test]
fn a_car_that_somebody_drives_already_is_left_to_them() {
    let Some(python) = python() else { return };
    let (sandbox, domain) = (Sandbox::new(), own_domain());
    let driver = Peer::start(&sandbox, &python, domain, &["--driver"]);
    driver.wait_until_it_lives();
    let mut ring = Ring::start(&sandbox, domain, "ackermann", &[]);
    let status = ring.adapter.wait().unwrap();
    let told = ring.told();
    assert_eq!(status.code(), Some(64), "{told}");
    assert_eq!(told.lines().count(), 1, "{told}");
    assert!(told.contains("publishes on /drive already"), "{told}");
    drop(ring);
    sandbox.assert_clean();
}

#[test]
fn the_user_is_told_what_is_missing_and_what_is_in_the_way() {
    let Some(python) = python() else { return };
    let (sandbox, domain) = (Sandbox::new(), own_domain());
    let domain_is = format!("vehicle.ros2.domain_id={domain}");
    let more = ["--set", &domain_is, "--set", "vehicle.ros2.network='127.0.0.1'"];
    let args = ["lane_change", "--adapter", "ros2-vehicle", "--vehicle", "ackermann"];
    let args = [&args[..], &more].concat();
    // Nobody there: it waits, and says for what.
    let drive = sandbox.start("drive", "waits", &args);
    let told_all = || {
        let log = |name: &str| {
            std::fs::read_to_string(sandbox.path("waits/logs").join(name)).unwrap_or_default()
        };
        // Repeated, so that a second line of it could have reached the user. What the user is told stands in the
        // orchestrator's log, too.
        log("orchestrator.log").contains("publishers seen: 0")
            && log("ros2-vehicle.log").matches("the drive waits for odometry").count() > 1
    };
    let until = Instant::now() + Duration::from_secs(20);
    while !told_all() {
        assert!(Instant::now() < until, "the drive does not say what it waits for");
        std::thread::sleep(Duration::from_millis(50));
    }
    drive.interrupt();
    let told = String::from_utf8_lossy(&drive.finish().stderr).into_owned();
    assert!(told.contains("ros2-vehicle: no odometry on /odom; publishers seen: 0"), "{told}");
    assert_eq!(told.matches("the drive waits for odometry").count(), 1, "{told}");
    // Somebody drives the car: one line, and no second try.
    let driver = Peer::start(&sandbox, &python, domain, &["--driver"]);
    driver.wait_until_it_lives();
    let output = sandbox.run(&[&["drive"], &args[..], &["--out", "refused"]].concat());
    let told = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(64), "{told}");
    assert!(
        told.contains("ros2-vehicle: ") && told.contains("publishes on /drive already"),
        "{told}"
    );
    assert!(!told.contains("restarted"), "{told}");
    drop(driver);
    sandbox.assert_clean();
}

/// What the adapter says of odometry that it gets and cannot use, or of a car that takes no commands.
fn check_told(args: &[&str], settings: &[&str], parts: &[&str]) {
    let Some(python) = python() else { return };
    let (sandbox, domain) = (Sandbox::new(), own_domain());
    let car = Peer::start(&sandbox, &python, domain, args);
    car.wait_until_it_lives();
    let mut ring = Ring::start(&sandbox, domain, "ackermann", settings);
    let told = |ring: &Ring| parts.iter().all(|part| ring.told().contains(part));
    ring.wait_for("readiness", Duration::from_secs(8), |ring| {
        ring.newest_status.state == Status::READY
    });
    ring.request();
    // Five seconds, and as many again for a machine that is busy with the other tests.
    ring.wait_for(&format!("{parts:?}"), Duration::from_secs(10), told);
    assert!(ring.heard.is_empty() && !ring.is_at_start(), "{}", ring.told());
    assert_eq!(car.last("told_mps"), 0.0);
    ring.stop();
    sandbox.assert_clean();
}

#[test]
fn frozen_stamps_over_ros2() {
    let parts =
        ["odometry on /odom comes at ", " Hz, but its stamp stands at 1234567890.000000000"];
    check_told(&["--habit", "stamp-stands"], &[], &parts);
}

#[test]
fn stamps_of_five_seconds_ago_do_not_pass_as_fresh() {
    let parts = [" Hz, but it was measured 5.0 s before it was sent, by its stamp"];
    check_told(&["--habit", "stamp-late"], &[], &parts);
}

#[test]
fn odometry_that_cannot_be_used_is_told_as_what_it_is() {
    for (habit, setting, part) in [
        ("no-quaternion", "vehicle.ros2.align='start'", "the quaternion's length is 0"),
        ("not-a-number", "vehicle.ros2.align='start'", "its linear speed is not finite"),
        ("", "vehicle.ros2.odometry_frame='map'", "its frame_id is \"odom\"; vehicle.ros2"),
    ] {
        let parts = ["odometry on /odom comes at ", part];
        check_told(&["--habit", habit], &[setting], &parts);
    }
}

#[test]
fn a_publisher_that_is_silent_is_told_with_the_reliability_that_it_offers() {
    let parts = ["no odometry on /odom; publishers seen: 1, reliable"];
    check_told(&["--habit", "mute"], &[], &parts);
}

#[test]
fn a_drive_does_not_start_where_nobody_receives_its_commands() {
    let parts = ["nobody receives /drive; subscribers seen: 0", "waits for somebody who receives"];
    check_told(&["--deaf"], &[], &parts);
}

#[test]
fn the_age_of_simulated_stamps_counts_from_their_arrival() {
    let Some(python) = python() else { return };
    for (habit, part) in [("simulated-time", "its arrival"), ("", "its stamp")] {
        let (sandbox, domain) = (Sandbox::new(), own_domain());
        let _car = Peer::start(&sandbox, &python, domain, &["--habit", habit]);
        let mut ring = Ring::start(&sandbox, domain, "ackermann", &[]);
        ring.wait_for("a car at the start", Duration::from_secs(8), Ring::is_at_start);
        let told = ring.stop();
        assert!(told.contains(&format!("its age counts from {part}")), "{told}");
        sandbox.assert_clean();
    }
}

#[test]
fn an_address_of_no_interface_is_refused() {
    let sandbox = Sandbox::new();
    let args = ["drive", "lane_change", "--adapter", "ros2-vehicle", "--vehicle", "ackermann"];
    let more = ["--set", "vehicle.ros2.network='192.0.2.77'", "--out", "out"];
    let output = sandbox.run(&[&args[..], &more].concat());
    let told = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(64), "{told}");
    assert!(told.contains("vehicle.ros2.network is 192.0.2.77, but no interface"), "{told}");
    sandbox.assert_clean();
}
