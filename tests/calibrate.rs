//! `calibrate`: an envelope from simulated and from recorded drives, its promise in words, and drives that are judged by it.

mod support;

use std::fs;
use std::process::Output;

use config::{Envelope, Parameters, RunConfig};
use ipc_types::Safety;
use rollout::Rollout;
use serde_json::Value;
use support::Sandbox;
use tracking::{DriveRecord, EndReason};

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

    // An envelope that is far too narrow: the gate stops the drive, and the result says when, by what, and how.
    let line = text.lines().find(|line| line.starts_with("threshold = ")).unwrap();
    with_threshold(&sandbox, "many.toml", "narrow.toml", 0.05);
    let out = drive("out", "narrow.toml", &[]);
    assert_eq!(out.status.code(), Some(2), "{}", stderr(&out));
    let result = sandbox.result("out");
    let seen = &result["envelope"];
    assert!(stdout(&out).contains("out of its envelope after"), "{}", stdout(&out));
    assert_eq!(result["reason"], "stopped");
    let by = seen["out_by"].as_str().unwrap();
    let reason = format!("envelope_{}", by.trim_start_matches("heading_"));
    assert_eq!(result["stopped_for"], serde_json::json!([reason]), "{result}");
    let harmless = ["along", "lateral", "noise", "heading_noise"];
    let action = if harmless.contains(&by) { "rest" } else { "brake" };
    assert_eq!((&seen["action"], &result["stopped_how"]), (&action.into(), &action.into()));
    let (tick, at_s) = (seen["out_at_tick"].as_u64().unwrap(), seen["out_at_s"].as_f64().unwrap());
    assert!((100..300).contains(&tick) && (at_s - tick as f64 / 100.0).abs() < 1e-9, "{seen}");
    // The command of the next tick is the first of the gate's own.
    let rows = sandbox.text("out/drives/drive.csv");
    let flags = |tick: u64| -> u32 {
        let row = rows.lines().find(|row| row.starts_with(&format!("{tick},"))).unwrap();
        row.split(',').nth_back(1).unwrap().parse().unwrap()
    };
    let stopping = ipc_types::Command::STOPPING;
    assert_eq!((flags(tick) & stopping, flags(tick + 1) & stopping), (0, stopping));

    // Only judged, it drives on, and the same is said of it.
    let judged = drive("judged", "narrow.toml", &["--only-judge"]);
    assert!(judged.status.success(), "{}", stderr(&judged));
    let result = sandbox.result("judged");
    assert_eq!(result["envelope"]["out_at_tick"], tick);
    assert_eq!(result["envelope"]["action"], Value::Null);
    assert!(stdout(&judged).contains("it was not stopped for that"));

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

/// An envelope of this threshold, made of that file.
fn with_threshold(sandbox: &Sandbox, from: &str, to: &str, threshold: f64) {
    let text = sandbox.text(from);
    let line = text.lines().find(|line| line.starts_with("threshold = ")).unwrap();
    let text = text.replace(line, &format!("threshold = {threshold:?}"));
    fs::write(sandbox.path(to), text).unwrap();
}

#[test]
fn stops_are_the_same_over_fleets_and_kills_and_those_of_plain_calls() {
    let sandbox = Sandbox::new();
    calibrated(&sandbox, &["--drives", "40", "--out", "wide.toml"]);
    let scores = Envelope::parse(&sandbox.text("wide.toml")).unwrap().scores;
    // About every other drive is out of it.
    with_threshold(&sandbox, "wide.toml", "half.toml", scores[scores.len() / 2]);
    let validate = |out: &str, args: &[&str]| {
        let named = ["validate", "roundabout", "--gains", "3.4,21,1,0.84", "--repeats", "12"];
        let held = ["--envelope", "half.toml"];
        let output = sandbox.run(&[&named, &held[..], &SHORT, &["--out", out], args].concat());
        assert!(output.status.success(), "{}", sandbox.story(out, &output));
        sandbox.result(out)
    };
    let alone = validate("alone", &["--fleet", "1"]);
    let fleet = validate("fleet", &["--fleet", "5"]);
    let script = "kill supervisor@drive=2,tick=300; kill controller@drive=6,tick=400; kill simulator@drive=9";
    let killed = validate("killed", &["--fleet", "1", "--chaos", script]);
    assert_eq!(killed["run"]["recovery"]["injected"], 3, "{}", killed["run"]["recovery"]);
    assert_eq!((&alone["digest"], &alone["digest"]), (&fleet["digest"], &killed["digest"]));

    let config = RunConfig::from_resolved(&sandbox.text("alone/config.toml")).unwrap();
    assert!(config.envelope.is_some());
    let mut rollout = Rollout::new(&config);
    let set = Parameters::of(&[3.4, 21.0, 1.0, 0.84]);
    let records: Vec<_> = (1..=12).map(|seed| rollout.drive(set, Some(seed))).collect();
    let stopped = records.iter().filter(|it| it.reason == EndReason::Stopped).count();
    assert!((2..11).contains(&stopped), "{stopped}");
    let of_envelope = |it: &&DriveRecord| it.stopped_for & !Safety::OUT_OF_ENVELOPE == 0;
    assert_eq!(records.iter().filter(of_envelope).count(), 12);
    let mean = records.iter().map(DriveRecord::mse_m2).sum::<f64>() / 12.0;
    let told = alone["rows"][0]["noisy"]["mse_m2_mean"].as_f64().unwrap();
    assert!((mean - told).abs() < 1e-12 * mean, "{mean} {told}");

    let two = ["validate", "roundabout", "--envelope", "half.toml"];
    refused(&sandbox, &two, &["--envelope half.toml", "one set", "--gains"]);
    sandbox.assert_clean();
}

#[test]
fn by_the_clock_a_restarted_supervisor_watches_on() {
    let sandbox = Sandbox::new();
    calibrated(&sandbox, &["--drives", "40", "--out", "wide.toml"]);
    with_threshold(&sandbox, "wide.toml", "narrow.toml", 0.05);
    let named = ["drive", "roundabout", "--noise", "--realtime", "--envelope", "narrow.toml"];
    let chaos = ["--chaos", "kill supervisor@drive=1,tick=80", "--out", "out"];
    let output = sandbox.run(&[&named, &SHORT[..], &chaos].concat());
    assert_eq!(output.status.code(), Some(2), "{}", sandbox.story("out", &output));
    let result = sandbox.result("out");
    assert_eq!(result["run"]["recovery"]["injected"], 1);
    let stopped_for = result["stopped_for"].as_array().unwrap();
    let by_envelope = |it: &&Value| it.as_str().unwrap().starts_with("envelope_");
    assert_eq!(stopped_for.iter().filter(by_envelope).count(), 1, "{result}");
    assert!(["rest", "brake"].contains(&result["stopped_how"].as_str().unwrap()), "{result}");
    sandbox.assert_clean();
}
