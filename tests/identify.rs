//! A car's values, found from recorded drives and written into its file; and drives that tell nothing.

mod support;

use std::fmt::Write as _;
use std::fs;
use std::path::Path;
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
    // Where it comes from, how well it is known, and how the odometry is off.
    for part in [
        "# Found by `pathtune identify`, version ",
        "drive.csv (SHA-256 ",
        "# Left by the fit: speed ",
    ] {
        assert!(text.contains(part), "{part:?} is missing in {text}");
    }
    let table: toml::Table = text.parse().unwrap();
    assert_eq!(table["uncertainty"]["identified"].as_bool(), Some(true));
    let interval = table["uncertainty"]["wheelbase_m"].as_array().unwrap();
    let [low, high] = [0, 1].map(|end: usize| interval[end].as_float().unwrap());
    assert!(low <= found.wheelbase_m && found.wheelbase_m <= high && high - low < 0.05);
    // Noise that is even over ± 0.03 m has this standard deviation; by the half of it that lies within 0.015 m it would be
    // taken for one of 0.0222 m.
    near(table["noise"]["position_sd_m"].as_float().unwrap(), 0.03 / 3.0_f64.sqrt(), 0.05);
    assert!(table["noise"]["yaw_rate_sd_radps"].as_float().unwrap() > 0.0);
    let stated = Layers::vehicle_of_file(sandbox.path("car.toml").to_str().unwrap()).unwrap();
    assert!(stated.uncertainty.identified && stated.noise.position_sd_m.is_some());
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
fn what_was_measured_is_drawn_beside_what_is_predicted() {
    let sandbox = sandbox();
    write_drive(&sandbox, "drive.csv", |rate, _, _| rate);
    let args = ["identify", "drive.csv", "--vehicle", "car.toml", "--report", "pages/mine"];
    let output = sandbox.run(&args);
    assert!(output.status.success(), "{}", stderr(&output));
    let page = sandbox.text("pages/mine/index.html");
    for part in ["wheelbase_m", "drive.csv", "predicted over 3 s", "Figure 5."] {
        assert!(page.contains(part), "{part}");
    }
    for name in
        ["way", "speed-predicted", "speed-residuals", "yaw-rate-predicted", "yaw-rate-residuals"]
    {
        assert!(
            sandbox.text(&format!("pages/mine/{name}.svg")).contains("with the new ones"),
            "{name}"
        );
    }
    // Drawn again; but never into a folder of something else.
    assert!(sandbox.run(&args).status.success());
    fs::write(sandbox.path("pages/mine/thesis.tex"), "").unwrap();
    refused(
        &sandbox,
        &["drive.csv", "--report", "pages/mine"],
        &["--report pages/mine", "thesis.tex"],
    );
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
    let of_bags = ["blind.csv", "--odometry", "/odom"];
    refused(&sandbox, &of_bags, &["blind.csv: is no bag", "--odometry"]);
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
    // It follows no path.
    assert!(told.contains("rad/s on average") && !told.contains("off the path"), "{told}");
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
    // The ground that the drive takes is told, and what is too small is refused.
    let told = |args: &[&str]| {
        let output = sandbox.run(&[&["excite", "--vehicle", "true.toml"], args].concat());
        (output.status.code(), stderr(&output))
    };
    let (code, why) = told(&["--compact", "--box", "20x90"]);
    assert_eq!((code, why.contains("the drive takes ")), (Some(64), true), "{why}");
    let (code, why) = told(&["--box", "20"]);
    assert_eq!((code, why.contains("as in 30x30")), (Some(64), true), "{why}");
    let (code, why) = told(&["--box", "200x60", "--out", "boxed"]);
    assert_eq!((code, why.contains("heading along its 200 m")), (Some(0), true), "{why}");
    assert!(!sandbox.text("boxed/config.toml").contains("area_m = [-inf"));
    // Wheels that turn less get smaller steps.
    fs::write(sandbox.path("small.toml"), "base = \"f1tenth\"\nname = \"small\"\n").unwrap();
    let args = ["excite", "--vehicle", "small.toml", "--compact", "--out", "small"];
    let output = sandbox.run(&args);
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(stderr(&output).contains("the wheels turn by 0.419 rad at most: steps of 0.18"));
    // The supervisor lets commands change no faster than the wheels turn: so no drive shows that they turn faster.
    let args = ["identify", "small/recording.mcap", "--vehicle", "small.toml", "--json"];
    let found = sandbox.run(&args);
    let found: serde_json::Value = serde_json::from_slice(&found.stdout).unwrap();
    let mut rows = found["identification"]["rows"].as_array().unwrap().iter();
    let rate = rows.find(|row| row["key"] == "steering_rate_radps").unwrap();
    assert_eq!((&rate["identified"], &rate["after"]), (&false.into(), &3.2.into()), "{rate}");
    // What follows no path has none to be driven, but the way that it took.
    let args = ["train", "--path", "small/recording.mcap", "--vehicle", "small.toml"];
    let output = sandbox.run(&args);
    assert_eq!(output.status.code(), Some(64));
    assert!(stderr(&output).contains("/odom") && !stderr(&output).contains("/path,"));
    // A wheel turns no further than it can.
    let output = sandbox.run(&["excite", "--vehicle", "true.toml", "--steering", "0.6"]);
    assert_eq!(output.status.code(), Some(64));
    assert!(stderr(&output).contains("give less with --steering"), "{}", stderr(&output));
    sandbox.assert_clean();
}

/// A bag with a recording's odometry, in which the car was told twists by a wheelbase. `is_named`: with the type of the twists.
/// `has_rate`: with the recording's yaw rate; NaN otherwise.
fn as_twists(recording: &Path, bag: &Path, wheelbase_m: f64, is_named: bool, has_rate: bool) {
    use byteorder::LittleEndian;
    use ros2_vehicle::messages::{AckermannDriveStamped, Odometry, Twist};
    let file = std::io::BufWriter::new(fs::File::create(bag).unwrap());
    let mut writer = mcap::Writer::new(file).unwrap();
    let twist = match is_named {
        true => writer.add_schema("geometry_msgs/msg/Twist", "ros2msg", b"").unwrap(),
        false => 0,
    };
    let channels = [("/odom", 0), ("/cmd_vel", twist)]
        .map(|(topic, kind)| writer.add_channel(kind, topic, "cdr", &Default::default()).unwrap());
    let mut write = |at: usize, time_ns: u64, data: &[u8]| {
        let header = mcap::records::MessageHeader {
            channel_id: channels[at],
            sequence: 0,
            log_time: time_ns,
            publish_time: time_ns,
        };
        writer.write_to_known_channel(&header, data).unwrap();
    };
    recorder::reading::read_any(recording, |it| {
        let (topic, time_ns, data) = (it.topic, it.log_time_ns, it.data);
        if topic == "/odom" && has_rate {
            write(0, time_ns, data);
        } else if topic == "/odom" {
            let (mut told, _) = cdr_encoding::from_bytes::<Odometry, LittleEndian>(&data[4..])?;
            told.twist.twist.angular.z = f64::NAN;
            let body = cdr_encoding::to_vec::<_, LittleEndian>(&told)?;
            write(0, time_ns, &[&[0, 1, 0, 0], &body[..]].concat());
        } else if topic == "/cmd" {
            let (told, _) =
                cdr_encoding::from_bytes::<AckermannDriveStamped, LittleEndian>(&data[4..])?;
            let (speed, angle) =
                (f64::from(told.drive.speed), f64::from(told.drive.steering_angle));
            let mut twist = Twist::default();
            twist.linear.x = speed;
            twist.angular.z = speed * angle.tan() / wheelbase_m;
            let body = cdr_encoding::to_vec::<_, LittleEndian>(&twist)?;
            write(1, time_ns, &[&[0, 1, 0, 0], &body[..]].concat());
        }
        Ok(())
    })
    .unwrap();
    writer.finish().unwrap();
}

/// What becomes of angles on their way through twists depends on the file's wheelbase: another one in it would change the
/// car's answer by as much, and the next identification the wheelbase.
#[test]
fn twists_tell_how_much_the_car_turns_and_not_its_wheelbase() {
    let sandbox = sandbox();
    let args = ["drive", "roundabout", "--vehicle", "true.toml", "--record", "--out", "out"];
    let output = sandbox.run(&args);
    assert!(output.status.success(), "{}", stderr(&output));
    let (file, truth) = (vehicle(&sandbox, "car.toml"), vehicle(&sandbox, "true.toml"));
    let by_m = file.wheelbase_m / 0.9;
    let recording = sandbox.path("out/recording.mcap");
    as_twists(&recording, &sandbox.path("twists.mcap"), by_m, false, true);
    as_twists(&recording, &sandbox.path("named.mcap"), by_m, true, true);
    as_twists(&recording, &sandbox.path("blind.mcap"), by_m, true, false);
    let identify = |bag: &str, more: &[&str]| {
        let args = ["identify", bag, "--vehicle", "car.toml", "--json", "--simulated"];
        let topics = ["--odometry", "/odom", "--command", "/cmd_vel"];
        let output = sandbox.run(&[&args[..], &topics, more].concat());
        assert!(output.status.success(), "{}", stderr(&output));
        output
    };
    let output = identify("twists.mcap", &["--command-type", "twist"]);
    let json: Value = serde_json::from_slice(&output.stdout).unwrap();
    let rows = json["identification"]["rows"].as_array().unwrap();
    // The bag itself may tell the type.
    let named: Value = serde_json::from_slice(&identify("named.mcap", &[]).stdout).unwrap();
    assert!(named["identification"]["rows"].as_array() == Some(rows));
    let said = stderr(&output);
    assert!(
        said.contains("asks for a yaw rate") && said.contains("wheelbase_m stays 2.2 m"),
        "{said}"
    );
    let row = |key: &str| rows.iter().find(|row| row["key"] == key);
    assert_eq!(row("wheelbase_m"), None);
    // The file's angles are 0.9 times those of the car, and its wheelbase is another.
    let gain = row("steering_gain").unwrap()["after"].as_f64().unwrap();
    near(gain, file.wheelbase_m / truth.wheelbase_m / 0.9, 0.01);
    // Without a yaw rate, the heading tells it.
    let blind: Value = serde_json::from_slice(&identify("blind.mcap", &[]).stdout).unwrap();
    assert!(blind["identification"]["noise"]["yaw_rate_sd_radps"].is_null(), "{blind}");
    let mut rows = blind["identification"]["rows"].as_array().unwrap().iter();
    let row = rows.find(|row| row["key"] == "steering_gain").unwrap();
    near(row["after"].as_f64().unwrap(), gain, 0.02);
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
    let other = ["out/recording.mcap", "--odometry", "/odom", "--command", "/cmd"];
    let other = [&other[..], &["--command-type", "twist"]].concat();
    refused(&sandbox, &other, &["--command-type", "by the bag's own word"]);
    // Whatever is missing in what is left of a recording, the line names the reason.
    let whole = fs::read(sandbox.path("out/recording.mcap")).unwrap();
    fs::write(sandbox.path("cut.mcap"), &whole[..whole.len() / 8]).unwrap();
    refused(&sandbox, &["cut.mcap"], &["record a longer drive", "cut.mcap was cut off"]);
    let odo = ["cut.mcap", "--odometry", "/odo"];
    refused(&sandbox, &odo, &["has no odometry on /odo", "it was cut off"]);
    sandbox.assert_clean();
}

#[test]
fn a_recording_counts_once_by_whatever_names_it_is_given() {
    let sandbox = sandbox();
    let args = ["drive", "roundabout", "--vehicle", "true.toml", "--record", "--out", "out"];
    let output = sandbox.run(&[&args[..], &["--record-split", "64k"]].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    let part = |number: usize| format!("out/recording-{number:04}.mcap");
    assert!(sandbox.path(&part(2)).exists());
    let moving_s = |drives: &[&str]| {
        let args = ["--vehicle", "car.toml", "--json", "--simulated"];
        let output = sandbox.run(&[&["identify"], drives, &args[..]].concat());
        assert!(output.status.success(), "{}", stderr(&output));
        let json: Value = serde_json::from_slice(&output.stdout).unwrap();
        (json["identification"]["moving_s"].as_f64().unwrap(), stderr(&output))
    };
    // The first part names the one that continues it.
    let (once, said) = moving_s(&[&part(1)]);
    assert!(!said.contains("counts once"), "{said}");
    let (all, said) = moving_s(&[&part(1), &part(2), "./out/../out/recording-0001.mcap"]);
    assert_eq!(all, once);
    assert!(said.contains(&format!("{}, ./out/..", part(2))), "{said}");
    assert!(said.contains("counts once"), "{said}");
    sandbox.assert_clean();
}

#[test]
fn what_the_configuration_would_refuse_never_stands_in_the_file_and_rollbacks_keep_all() {
    use std::os::unix::fs::MetadataExt as _;
    let sandbox = sandbox();
    write_drive(&sandbox, "drive.csv", |measured, _, _| measured);
    // The noise that is found would be a jump.
    fs::write(sandbox.path("car.toml"), format!("{FILE}jump_limit_m = 0.04\n")).unwrap();
    let inode = || fs::metadata(sandbox.path("car.toml")).unwrap().ino();
    let before = inode();
    let parts = ["car.toml", "nothing was written", "jump_limit_m"];
    let args = ["identify", "drive.csv", "--vehicle", "car.toml", "--write"];
    let output = sandbox.run(&args);
    assert_eq!(output.status.code(), Some(64), "{}", stderr(&output));
    for part in parts {
        assert!(stderr(&output).contains(part), "{}", stderr(&output));
    }
    assert_eq!(inode(), before, "another file was in its place");
    assert!(!sandbox.path("car.toml.before-1").exists());
    // Two rounds of writing and rolling back keep what both wrote.
    fs::write(sandbox.path("car.toml"), FILE).unwrap();
    for after in ["car.toml.after-1", "car.toml.after-2"] {
        assert!(!sandbox.path(after).exists());
        let output = sandbox.run(&args);
        assert!(output.status.success(), "{}", stderr(&output));
        let written = sandbox.text("car.toml");
        let back = sandbox.run(&["identify", "--rollback", "--vehicle", "car.toml"]);
        assert!(back.status.success(), "{}", stderr(&back));
        assert!(String::from_utf8_lossy(&back.stdout).contains(after));
        assert_eq!((sandbox.text(after), sandbox.text("car.toml")), (written, FILE.to_owned()));
    }
    sandbox.assert_clean();
}

/// What odometry of a small car tells of its yaw rate.
#[derive(Clone, Copy, PartialEq)]
enum YawRate {
    /// v·tan(δ)/L of the servo's command, as `vesc_to_odom` makes it by default.
    Command,
    /// The same, and a third of the commands arrive a tick late.
    LateCommand,
    /// That of a gyro.
    Gyro,
    /// None: the heading stays 0.
    Zero,
}

/// 60 s at 50 Hz of a car at the scale of 1:10, whose odometry is the integral of speed and that yaw rate, as CSV. The car
/// has another wheelbase than its driver believes, a linkage that gives 93 %, an offset, a servo with dead time, lag and
/// rate, and understeer.
fn write_small_drive(sandbox: &Sandbox, name: &str, kind: YawRate) {
    const TICK_S: f64 = 0.02;
    const SUB: usize = 20;
    let sub_s = TICK_S / SUB as f64;
    let commands = |time_s: f64| {
        let speed = match time_s {
            ..1.0 => 0.0,
            ..30.0 => 2.0,
            _ => 2.0 + 0.8 * (0.5 * (time_s - 30.0)).sin(),
        };
        let since_s = time_s - 15.0;
        let steering = match time_s {
            ..3.0 => 0.0,
            ..15.0 => [0.22, -0.22, 0.11, -0.11][((time_s - 3.0) / 1.5) as usize % 4],
            ..30.0 => 0.15 * (std::f64::consts::TAU * (0.1 + 0.04 * since_s) * since_s).sin(),
            _ => 0.2 * (0.7 * (time_s - 30.0)).sin() + 0.05 * (2.3 * time_s).sin(),
        };
        (speed, steering)
    };
    // Even over ± 1, and the same everywhere.
    let mut state = 5_u64;
    let mut dice = move || {
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    };
    let mut on_the_way = std::collections::VecDeque::from(vec![0.0; 30]);
    let (mut speed, mut wheel, mut rate) = (0.0_f64, 0.0_f64, 0.0_f64);
    let (mut x, mut y, mut yaw) = (0.0_f64, 0.0_f64, 0.0_f64);
    let (mut told, mut before) = (0.0_f64, 0.0_f64);
    let mut text =
        String::from("t_s,cmd_speed_mps,cmd_steering_rad,x_m,y_m,yaw_rad,v_mps,yaw_rate_radps\n");
    for tick in 0..3000 {
        let time_s = tick as f64 * TICK_S;
        let (wanted, steering) = commands(time_s);
        // The driver counts turns of the motor.
        let measured = ((speed * 4614.0 + 20.0 * dice()).round() / 4614.0).max(0.0);
        let measured = if measured < 0.05 { 0.0 } else { measured };
        let shown = match kind {
            YawRate::Command | YawRate::LateCommand => measured * told.tan() / 0.25,
            YawRate::Gyro => rate + 0.035 * dice() + 0.004,
            YawRate::Zero => 0.0,
        };
        x += measured * yaw.cos() * TICK_S;
        y += measured * yaw.sin() * TICK_S;
        yaw += shown * TICK_S;
        writeln!(
            text,
            "{time_s:.2},{wanted:.3},{steering:.4},{x:.4},{y:.4},{yaw:.5},{measured:.4},{shown:.5}"
        )
        .unwrap();
        let is_late = kind == YawRate::LateCommand && dice() > 0.33;
        told = if is_late { before } else { steering };
        before = steering;
        for _ in 0..SUB {
            on_the_way.push_back(steering);
            let turned = (on_the_way.pop_front().unwrap() - wheel) * sub_s / 0.09;
            wheel += turned.clamp(-4.0 * sub_s, 4.0 * sub_s);
            speed += (wanted - speed) * sub_s / 0.25;
            rate = speed * (0.93 * wheel + 0.025).tan() / (0.324 + 0.006 * speed * speed);
        }
    }
    fs::write(sandbox.path(name), text).unwrap();
}

#[test]
fn odometry_from_the_command() {
    let sandbox = Sandbox::new();
    fs::write(sandbox.path("car.toml"), "based_on = \"f1tenth\"\nname = \"mine\"\n").unwrap();
    let formula = [
        "drive.csv",
        "v·tan(commanded steering)/0.250 m",
        "computed and not measured",
        "use_servo_cmd_to_calc_angular_velocity",
        "give an IMU's yaw rate or a localised pose",
    ];
    write_small_drive(&sandbox, "drive.csv", YawRate::Command);
    refused(&sandbox, &["drive.csv", "--write"], &formula);
    write_small_drive(&sandbox, "drive.csv", YawRate::LateCommand);
    refused(&sandbox, &["drive.csv", "--write"], &formula);
    write_small_drive(&sandbox, "drive.csv", YawRate::Zero);
    let zero = ["yaw rate is 0 while the car steers", "give an IMU's yaw rate or a localised pose"];
    refused(&sandbox, &["drive.csv", "--write"], &zero);
    // With a gyro it is identified: the linkage counts as wheelbase, 0.324 m/0.93.
    write_small_drive(&sandbox, "drive.csv", YawRate::Gyro);
    let output = sandbox.run(&["identify", "drive.csv", "--vehicle", "car.toml", "--write"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let found = vehicle(&sandbox, "car.toml");
    near(found.wheelbase_m, 0.324 / 0.93, 0.02);
    assert!(found.understeer_s2pm > 0.002, "{}", found.understeer_s2pm);
    near(found.steering_delay_s + found.steering_lag_s, 0.12, 0.2);
    sandbox.assert_clean();
}

/// Noise of a good receiver: 2 cm, and ± 0.7° evenly.
const NOISE: [&str; 5] = [
    "--noise",
    "--set",
    "noise.position_sd_m=0.02",
    "--set",
    "noise.heading_half_width_rad=0.0122",
];

/// CommonRoad's multi-body car (29 states) behind a dead time and a lag: excited, identified, trained for and driven in
/// lockstep, all with noise, beside sets of textbooks for the file as it was. `PATHTUNE_MULTI_BODY=N` trains with as many
/// drives as an owner would, drives N times each with noise of its own, and prints the figures.
#[test]
fn a_car_that_nobody_here_wrote_is_identified_tuned_and_driven_nearer_than_textbooks_do() {
    let Some(python) = support::python_with_a_multi_body_car() else { return };
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/peers/shm_car.py");
    let car = format!(
        "vehicle={python} -B {} --steering-delay-s 0.15 --steering-lag-s 0.12",
        script.display()
    );
    let sandbox = Sandbox::new();
    for name in ["car.toml", "file.toml"] {
        fs::write(sandbox.path(name), "based_on = \"ackermann\"\nname = \"mine\"\n").unwrap();
    }
    let args = ["excite", "--vehicle", "car.toml", "--out", "excited", "--replace", &car];
    let output = sandbox.run(&[&args[..], &NOISE].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    let args = ["identify", "excited/recording.mcap", "--vehicle", "car.toml", "--json", "--write"];
    let output = sandbox.run(&args);
    assert!(output.status.success(), "{}", stderr(&output));
    let json: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(json["predicts_better"], true, "{json}");
    let predictions = json["identification"]["predictions"].as_array().unwrap();
    let after = |index: usize| predictions[index]["after_m"].as_f64().unwrap();
    println!("predicted over 1 s to {:.4} m, over 3 s to {:.4} m", after(0), after(1));
    assert!(after(0) < 0.03 && after(1) < 0.05, "{predictions:?}");
    let times = std::env::var("PATHTUNE_MULTI_BODY").ok();
    let times = times.map(|text| text.parse().expect("PATHTUNE_MULTI_BODY is a number of drives"));
    train_and_drive(&sandbox, &car, times);
    sandbox.assert_clean();
}

/// `smooth_lane` at 3.5 m/s: pure pursuit, compensated and trained over the default plants with the noise of the file that
/// was identified, beside textbook sets that are neither. Without `times` as little as shows it.
fn train_and_drive(sandbox: &Sandbox, car: &str, times: Option<u64>) {
    let mut args = vec!["train", "smooth_lane", "--vehicle", "car.toml", "--law", "pure_pursuit"];
    args.extend(["--over", "default", "--noise"]);
    args.extend(["--set", "tuner.settings.draw=continuous", "--set", "ranking.max_ticks=0"]);
    args.extend(match times {
        Some(_) => ["--tuner", "cmaes", "--drives", "64"],
        None => ["--tuner", "coordinate", "--drives", "24"],
    });
    if times.is_none() {
        let few = ["over.repeats=1", "over.choosing=6", "robust.finalists=1", "robust.fresh=2"];
        few.iter().for_each(|set| args.extend(["--set", set]));
    }
    let trained = sandbox.json("trained", &args);
    let gains: Vec<String> = ["kv", "ld_min", "ld_s", "filter"]
        .map(|key| trained["gains"][key].as_f64().unwrap().to_string())
        .to_vec();
    let tuned = gains.join(",");
    // Means of mean distance and steering travel, and the largest distance.
    let drive = |out: &str, vehicle: &str, law: &str, gains: &str, more: &[&str]| {
        let (mut mean_m, mut max_m, mut travel_radps) = (0.0, 0.0_f64, 0.0);
        let times = times.unwrap_or(1);
        for seed in 1..=times {
            let seed_is = format!("run.seed={seed}");
            let mut args = vec!["drive", "smooth_lane", "--vehicle", vehicle, "--law", law];
            args.extend(["--gains", gains, "--set", &seed_is]);
            args.extend(NOISE.iter().chain(more));
            let driven = sandbox.json(&format!("{out}_{seed}"), &args);
            let figure = |key: &str| driven[key].as_f64().unwrap();
            mean_m += figure("path_mean_m") / times as f64;
            travel_radps += figure("steering_travel_radps") / times as f64;
            max_m = max_m.max(figure("path_max_m"));
        }
        println!("{out}: {law} {gains}: {mean_m:.4} m, {max_m:.3} m, {travel_radps:.3} rad/s");
        (mean_m, max_m, travel_radps)
    };
    let (simulated_m, ..) = drive("simulated", "car.toml", "pure_pursuit", &tuned, &[]);
    let (mean_m, max_m, travel_radps) =
        drive("driven", "car.toml", "pure_pursuit", &tuned, &["--replace", car]);
    let untuned = [
        ("pure_pursuit", "1,2,0.8,0"),
        ("stanley", "1,1,1,0"),
        ("pure_pursuit", "1,2,1,0"),
        ("stanley", "1,2.5,1,0"),
    ];
    // The first two are the best of them.
    let of_these = if times.is_some() { untuned.len() } else { 2 };
    let plain = ["--set", "controller.compensate_dead_time=false", "--replace", car];
    let best = untuned[..of_these].iter().enumerate().map(|(index, (law, gains))| {
        drive(&format!("untuned_{index}"), "file.toml", law, gains, &plain).0
    });
    let best_m = best.fold(f64::INFINITY, f64::min);
    println!("tuned {mean_m:.4} m (simulated {simulated_m:.4} m), best untuned {best_m:.4} m");
    assert!(mean_m < 0.65 * best_m && max_m < 0.25 && travel_radps < 0.65);
    // Predicted to two millimetres.
    assert!((simulated_m - mean_m).abs() < 0.002);
}
