//! `calibrate`: an envelope from simulated and from recorded drives, its promise in words, and drives that are held to it.

mod support;

use std::fs;
use std::process::Output;

use serde_json::Value;
use support::Sandbox;

const SHORT: [&str; 4] = ["--set", "drive.loop_time_s=7.0", "--set", "vehicle.gear_engaged=true"];

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn stdout(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned()
}

fn calibrated(sandbox: &Sandbox, args: &[&str]) -> String {
    let output = sandbox.run(&[&["calibrate", "roundabout"], args, &SHORT[..]].concat());
    assert!(output.status.success(), "{args:?}: {}", stderr(&output));
    stdout(&output)
}

/// A mistake: one line with these parts.
fn refused(sandbox: &Sandbox, args: &[&str], parts: &[&str]) {
    let output = sandbox.run(args);
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(64), "{args:?}: {said}");
    assert_eq!(said.trim_end().lines().count(), 1, "{args:?}: {said}");
    for part in parts {
        assert!(said.contains(part), "{args:?}: {part:?} is missing in {said:?}");
    }
}

#[test]
fn drives_are_held_to_an_envelope_that_promises_what_its_drives_support() {
    let sandbox = Sandbox::new();
    let said = calibrated(&sandbox, &["--drives", "20"]);
    // Ten drives for the threshold support 25.9 %.
    for part in [
        "10 drives for the scales, 10 others",
        "25.887 %",
        "459 support 1 %",
        "roundabout.envelope.toml",
    ] {
        assert!(said.contains(part), "{part:?} is missing in {said}");
    }
    let said: Value = serde_json::from_str(&calibrated(
        &sandbox,
        &["--drives", "1000", "--json", "--out", "many.toml"],
    ))
    .unwrap();
    assert_eq!(said["promise"]["alpha"], 0.01);
    assert_eq!(said["promise"]["delta"], 0.01);
    let text = sandbox.text("many.toml");
    calibrated(&sandbox, &["--drives", "1000", "--out", "again.toml"]);
    assert_eq!(text, sandbox.text("again.toml"));
    let exists: Vec<&str> =
        [&["calibrate", "roundabout", "--out", "many.toml"], &SHORT[..]].concat();
    refused(&sandbox, &exists, &["many.toml", "exists already", "--out"]);

    let drive = |out: &str, envelope: &str, args: &[&str]| {
        let named = ["drive", "roundabout", "--noise", "--out", out, "--envelope", envelope];
        sandbox.run(&[&named, &SHORT[..], args].concat())
    };
    let good = drive("good", "many.toml", &[]);
    assert!(good.status.success(), "{}", stderr(&good));
    let result = &sandbox.result("good")["envelope"];
    let (score, threshold) =
        (result["score"].as_f64().unwrap(), result["threshold"].as_f64().unwrap());
    assert!(score > 0.1 && score <= threshold, "{result}");
    assert_eq!(result["out_at_s"], Value::Null);
    let said = stdout(&good);
    assert!(said.contains("within its envelope") && said.contains("1 drive, evidence"), "{said}");
    assert_eq!(sandbox.text("many.toml.drives").lines().count(), 1);

    // An envelope that is far too narrow: the gate stops the vehicle, and says by what.
    let line = text.lines().find(|line| line.starts_with("threshold = ")).unwrap();
    fs::write(sandbox.path("narrow.toml"), text.replace(line, "threshold = 0.05")).unwrap();
    let stopped = drive("stopped", "narrow.toml", &[]);
    let result = &sandbox.result("stopped");
    assert_eq!(result["reason"], "stopped", "{}", stderr(&stopped));
    let by = result["envelope"]["out_by"].as_str().unwrap();
    let reason = format!("envelope_{}", by.trim_start_matches("heading_"));
    assert!(result["stopped_for"].as_array().unwrap().contains(&Value::from(reason)), "{result}");
    assert!(result["envelope"]["out_at_s"].as_f64().unwrap() < 3.0);

    let other = ["drive", "roundabout", "--envelope", "many.toml", "--gains", "2.2,21,1,0.98"];
    refused(&sandbox, &[&other, &SHORT[..]].concat(), &["--envelope many.toml", "gains", "kv=3.4"]);
    fs::write(sandbox.path("broken.toml"), text.replace(line, "threshold = -1.0")).unwrap();
    let broken = ["drive", "roundabout", "--envelope", "broken.toml"];
    refused(&sandbox, &broken, &["--envelope broken.toml", "threshold", "above 0"]);
    sandbox.assert_clean();
}

#[test]
fn recordings_of_ones_own_car_make_an_envelope() {
    let sandbox = Sandbox::new();
    let mut args = Vec::new();
    for number in 1..=4 {
        let (out, seed) = (format!("r{number}"), format!("run.seed={number}"));
        let drive = [
            "drive",
            "roundabout",
            "--noise",
            "--record",
            "--quiet",
            "--set",
            &seed,
            "--out",
            &out,
        ];
        let driven = sandbox.run(&[&drive, &SHORT[..]].concat());
        assert!(driven.status.success(), "{}", stderr(&driven));
        args.extend(["--from".to_owned(), format!("r{number}/recording.mcap")]);
    }
    let args: Vec<&str> = args.iter().map(String::as_str).collect();
    let said = calibrated(&sandbox, &args);
    for part in ["recorded, in 4 files", "2 drives for the scales, 2 others", "77.639 %"] {
        assert!(said.contains(part), "{part:?} is missing in {said}");
    }
    let few = [&["calibrate", "roundabout", "--out", "few.toml"], &args[..2], &SHORT[..]].concat();
    refused(&sandbox, &few, &["at least 4"]);
    let other = [&["calibrate", "lane_change"], &args[..]].concat();
    refused(&sandbox, &other, &["--from r1/recording.mcap", "another kind", "maneuver"]);
    sandbox.assert_clean();
}
