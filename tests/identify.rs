//! A car's values, found from recorded drives and written into its file; and drives that tell nothing.

mod support;

use std::fmt::Write as _;
use std::fs;
use std::process::Output;

use config::{Layers, Vehicle};
use serde_json::Value;
use simulator::SimulatedVehicle;
use support::Sandbox;
use tracking::{EXCITATION_S, excitation};

/// What the user believes of the car.
const FILE: &str = "# My car.\nbased_on = \"tesla_model_3_guarded\"\nname = \"mine\"\nwheelbase_m = 2.2 # by eye\nsteering_delay_s = 0.02\nsteering_lag_s = 0.2\nsteering_rate_radps = 0.9\ngear_engaged = true\n\n[safety]\n# Softly.\nstop_deceleration_mps2 = 1.5\n";

/// What it is.
const CAR: &str = "based_on = \"tesla_model_3_guarded\"\nname = \"mine\"\nwheelbase_m = 2.6\nsteering_delay_s = 0.14\nsteering_lag_s = 0.1\nsteering_rate_radps = 0.5\nsteering_offset_rad = 0.01\nspeed_delay_s = 0.1\ngear_engaged = true\n";

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn vehicle(sandbox: &Sandbox, name: &str) -> Vehicle {
    Layers::vehicle_of_file(sandbox.path(name).to_str().unwrap()).unwrap()
}

/// A sandbox with both files.
fn sandbox() -> Sandbox {
    let sandbox = Sandbox::new();
    fs::write(sandbox.path("car.toml"), FILE).unwrap();
    fs::write(sandbox.path("true.toml"), CAR).unwrap();
    sandbox
}

/// The excitation in the true car, as CSV. The noise repeats after some samples; `rate` is the yaw rate that is told, made
/// from the measured one, the speed and the command of the tick before.
fn write_drive(sandbox: &Sandbox, name: &str, rate: impl Fn(f64, f64, f64) -> f64) {
    let mut layers = Layers::maneuver("lane_change").unwrap();
    layers.set_vehicle("test", sandbox.path("true.toml").to_str().unwrap()).unwrap();
    let config = layers.resolve().unwrap();
    let mut car = SimulatedVehicle::new(&config);
    let noise = |tick: usize, size: f64| size * ((tick * 7919 % 1013) as f64 / 506.0 - 1.0);
    let mut text = String::from(
        "t_s,x_m,y_m,yaw_rad,speed_mps,yaw_rate_radps,command_steering_rad,command_speed_mps\n",
    );
    let mut last_rad = 0.0;
    for tick in 0..(EXCITATION_S / 0.01) as usize {
        let time_s = tick as f64 * 0.01;
        let seen = car.observe();
        let (steering_rad, speed_mps) = excitation(time_s, 0.25, 2.0, 0.0);
        writeln!(
            text,
            "{time_s:.2},{:.4},{:.4},{:.5},{:.4},{:.5},{steering_rad:.6},{speed_mps}",
            seen.truth.x_m + noise(tick, 0.03),
            seen.truth.y_m + noise(tick + 400, 0.03),
            seen.truth.yaw_rad + noise(tick + 800, 0.005),
            seen.speed_mps + noise(tick + 1200, 0.02),
            rate(seen.yaw_rate_radps + noise(tick + 1600, 0.006), seen.speed_mps, last_rad),
        )
        .unwrap();
        car.step(speed_mps, steering_rad);
        last_rad = steering_rad;
    }
    fs::write(sandbox.path(name), text).unwrap();
}

/// Runs `pathtune identify` with a mistake: one line with all parts, and nothing has changed.
fn refused(sandbox: &Sandbox, args: &[&str], parts: &[&str]) {
    let before = fs::read(sandbox.path("car.toml")).unwrap();
    let output = sandbox.run(&[&["identify", "--vehicle", "car.toml"], args].concat());
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(64), "{args:?}: {said}");
    for part in parts {
        assert!(said.contains(part), "{args:?}: {part:?} is missing in {said:?}");
    }
    assert_eq!(said.trim_end().lines().count(), 1, "{args:?}: {said}");
    assert_eq!(fs::read(sandbox.path("car.toml")).unwrap(), before, "{args:?} has changed it");
    assert!(!sandbox.path("car.toml.before-1").exists());
}

fn near(found: f64, truth: f64, share: f64) {
    assert!((found / truth - 1.0).abs() < share, "{found} is not near {truth}");
}

#[test]
fn values_are_found_written_and_brought_back() {
    let sandbox = sandbox();
    write_drive(&sandbox, "drive.csv", |measured, _, _| measured);
    let args = ["identify", "drive.csv", "--vehicle", "car.toml"];
    let output = sandbox.run(&args);
    assert!(output.status.success(), "{}", stderr(&output));
    let told = String::from_utf8(output.stdout).unwrap();
    for part in
        ["wheelbase_m", "steering_delay_s + steering_lag_s", "predicted over 3 s", "--write puts"]
    {
        assert!(told.contains(part), "{told}");
    }
    assert_eq!(sandbox.text("car.toml"), FILE);

    let output = sandbox.run(&[&args[..], &["--write"]].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    let text = sandbox.text("car.toml");
    for part in ["# My car.\n", "# by eye", "# Softly.\nstop_deceleration_mps2 = 1.5"] {
        assert!(text.contains(part), "{text}");
    }
    let (found, truth) = (vehicle(&sandbox, "car.toml"), vehicle(&sandbox, "true.toml"));
    near(found.wheelbase_m, truth.wheelbase_m, 0.005);
    near(found.steering_delay_s, truth.steering_delay_s, 0.03);
    near(found.steering_rate_radps, truth.steering_rate_radps, 0.03);
    near(found.speed_delay_s, truth.speed_delay_s, 0.1);
    near(found.steering_offset_rad, truth.steering_offset_rad, 0.1);
    assert_eq!(found.safety, vehicle(&sandbox, "car.toml").safety);
    assert_eq!(sandbox.text("car.toml.before-1"), FILE);

    // The same drive has nothing more to tell.
    let again = sandbox.run(&[&args[..], &["--write"]].concat());
    assert_eq!(again.status.code(), Some(64), "{}", stderr(&again));
    assert!(stderr(&again).contains("nothing was written"), "{}", stderr(&again));
    assert_eq!(sandbox.text("car.toml"), text);

    let back = sandbox.run(&["identify", "--rollback", "--vehicle", "car.toml"]);
    assert!(back.status.success(), "{}", stderr(&back));
    assert_eq!(sandbox.text("car.toml"), FILE);
    refused(&sandbox, &["--rollback"], &["car.toml", "no values were written"]);
    sandbox.assert_clean();
}

#[test]
fn odometry_that_repeats_the_command_and_files_that_are_no_drive_are_refused() {
    let sandbox = sandbox();
    write_drive(&sandbox, "computed.csv", |_, speed, command| speed * command.tan() / 0.25);
    let parts = ["computed.csv", "v·tan(commanded steering)/0.250 m", "IMU"];
    refused(&sandbox, &["computed.csv", "--write"], &parts);
    write_drive(&sandbox, "blind.csv", |_, _, _| 0.0);
    refused(&sandbox, &["blind.csv", "--write"], &["yaw rate is 0 while the car steers"]);
    fs::write(sandbox.path("half.csv"), "t_s,x_m\n0,1\n").unwrap();
    refused(&sandbox, &["half.csv"], &["half.csv", "no column y_m"]);
    refused(&sandbox, &["nothing.csv"], &["nothing.csv", "No such file"]);
    fs::write(sandbox.path("broken.mcap"), b"\x89MCAP0\r\n").unwrap();
    refused(&sandbox, &["broken.mcap"], &["broken.mcap"]);
    refused(&sandbox, &[], &["DRIVE"]);
}

#[test]
fn the_excitation_is_driven_and_names_the_command_that_identifies() {
    let sandbox = sandbox();
    let args = ["excite", "--vehicle", "true.toml", "--out", "out", "--compact"];
    let output = sandbox.run(&args);
    assert!(output.status.success(), "{}", stderr(&output));
    let told = String::from_utf8(output.stdout).unwrap();
    assert!(told.contains("pathtune identify "), "{told}");
    assert!(told.contains("out/recording.mcap --vehicle true.toml"), "{told}");
    let args = ["identify", "out/recording.mcap", "--vehicle", "car.toml", "--write"];
    let output = sandbox.run(&args);
    assert!(output.status.success(), "{}", stderr(&output));
    let (found, truth) = (vehicle(&sandbox, "car.toml"), vehicle(&sandbox, "true.toml"));
    near(found.wheelbase_m, truth.wheelbase_m, 0.002);
    near(found.steering_delay_s, truth.steering_delay_s, 0.02);
    near(found.steering_lag_s, truth.steering_lag_s, 0.05);
    near(found.steering_rate_radps, truth.steering_rate_radps, 0.02);
    near(found.speed_delay_s, truth.speed_delay_s, 0.1);
    // A wheel turns no further than it can.
    let output = sandbox.run(&["excite", "--vehicle", "true.toml", "--steering", "0.6"]);
    assert_eq!(output.status.code(), Some(64));
    assert!(stderr(&output).contains("give less with --steering"), "{}", stderr(&output));
    sandbox.assert_clean();
}

#[test]
fn a_recording_of_ours_is_read_as_such_and_as_the_bag_that_it_also_is() {
    let sandbox = sandbox();
    let args = ["roundabout", "--vehicle", "true.toml", "--record"];
    let output = sandbox.run(&[&["drive"], &args[..], &["--out", "out"]].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    let truth = vehicle(&sandbox, "true.toml");
    let identify = |more: &[&str]| {
        let args = ["identify", "out/recording.mcap", "--vehicle", "car.toml", "--json"];
        let output = sandbox.run(&[&args[..], more].concat());
        assert!(output.status.success(), "{}", stderr(&output));
        let json: Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(json["schema"], 1);
        json["identification"]["rows"].as_array().unwrap().clone()
    };
    let value = |rows: &[Value], key: &str| {
        let row = rows.iter().find(|row| row["key"] == key).unwrap();
        assert_eq!(row["identified"], true, "{row}");
        row["after"].as_f64().unwrap()
    };
    let rows = identify(&[]);
    near(value(&rows, "wheelbase_m"), truth.wheelbase_m, 0.005);
    near(value(&rows, "steering_delay_s"), truth.steering_delay_s, 0.05);
    near(value(&rows, "tracked_point_m"), truth.tracked_point_m, 0.05);
    let rows = identify(&["--odometry", "/odom", "--command", "/cmd", "--simulated"]);
    near(value(&rows, "wheelbase_m"), truth.wheelbase_m, 0.005);
    // What a car publishes is its odometry's own point.
    near(value(&rows, "ros2.odometry_point_m"), truth.tracked_point_m, 0.05);
    let wrong = ["identify", "out/recording.mcap", "--vehicle", "car.toml", "--odometry", "/odo"];
    let said = stderr(&sandbox.run(&wrong));
    assert!(said.contains("has no odometry on /odo") && said.contains("/odom"), "{said}");
    sandbox.assert_clean();
}
