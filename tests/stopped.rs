//! Runs that the user stops: what was driven is kept, and how to go on is said.

mod support;

use std::fs;
use std::process::Output;
use std::time::{Duration, Instant};

use serde_json::Value;
use support::Sandbox;

/// Starts a run, stops it once `enough` says so, and returns its end.
fn stop_when(sandbox: &Sandbox, args: &[&str], mut enough: impl FnMut(&Value) -> bool) -> Output {
    let mut run = sandbox.start(args[0], "out", &args[1..]);
    let until = Instant::now() + Duration::from_secs(60);
    loop {
        let status = sandbox.run(&["status", "--json"]);
        let status: Value = serde_json::from_slice(&status.stdout).unwrap_or_default();
        if enough(&status["runs"][0]) {
            break;
        }
        assert!(!run.is_over() && Instant::now() < until, "it ended too early, or hangs");
        std::thread::sleep(Duration::from_millis(20));
    }
    run.interrupt();
    run.finish()
}

/// What must be there of a run that was stopped; returns what the result says was driven by then.
fn check_kept(sandbox: &Sandbox, output: &Output) -> String {
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(130), "{}", sandbox.story("out", output));
    let result = sandbox.result("out");
    let after = result["run"]["stopped_after"].as_str().unwrap().to_owned();
    assert!(said.contains(&format!("stopped after {after}")), "{said}");
    let report = sandbox.text("out/report/index.html");
    assert!(report.contains(&format!("after {after}, before its end")), "no word in the report");
    sandbox.assert_clean();
    after
}

#[test]
fn a_stopped_drive_keeps_its_ticks() {
    let sandbox = Sandbox::new();
    let output = stop_when(&sandbox, &["drive", "roundabout", "--realtime"], |run| {
        run["tick"].as_u64().unwrap_or_default() > 150
    });
    let after = check_kept(&sandbox, &output);
    let driven_s: f64 = after.trim_end_matches(" s").parse().unwrap();
    // On a busy machine, ticks are left out.
    assert!((1.0..30.0).contains(&driven_s), "{after}");
    let result = sandbox.result("out");
    assert_eq!((&result["kind"], &result["reason"]), (&"drive".into(), &"interrupted".into()));
    assert!(result["progress"].as_f64().unwrap() < 0.9);
    assert!(result["mse_m2"].as_f64().unwrap() > 0.0);
    let rows = sandbox.text("out/drives/drive.csv").lines().count() - 1;
    assert!(rows > 100 && rows as f64 <= driven_s * 100.0 + 11.0, "{rows} rows, {after}");
}

#[test]
fn a_stopped_grid_keeps_its_sets() {
    let sandbox = Sandbox::new();
    let output = stop_when(&sandbox, &["grid", "lane_change", "--fleet", "2"], |run| {
        run["batch"].as_u64().unwrap_or_default() > 20
    });
    let after = check_kept(&sandbox, &output);
    let result = sandbox.result("out");
    let size = result["size"].as_u64().unwrap();
    assert!(size >= 40 && after.starts_with(&format!("{size} of ")), "{size}: {after}");
    assert_eq!(sandbox.text("out/grid.csv").lines().count() as u64, size + 1);
    assert_eq!(result["best"].as_array().unwrap().len(), 10);
    assert_eq!(result["best"][0]["rank_value"], 1);
    assert_eq!(result["main_effects"], serde_json::json!({}));
}

#[test]
fn a_stopped_validation_keeps_its_whole_rows() {
    let sandbox = Sandbox::new();
    let sets: Vec<String> = (1..=20).map(|kl| format!("3,{kl},21,0.7")).collect();
    let mut args = vec!["validate", "lane_change", "--fleet", "1", "--repeats", "100"];
    for set in &sets {
        args.extend(["--gains", set]);
    }
    let whole = sandbox.json("whole", &[&args[..6], &["--gains", &sets[0]]].concat());
    let output = stop_when(&sandbox, &args, |run| run["batch"].as_u64().unwrap_or_default() > 130);
    let after = check_kept(&sandbox, &output);
    let result = sandbox.result("out");
    let rows = result["rows"].as_array().unwrap();
    assert!(
        (1..20).contains(&rows.len()) && after == format!("{} of 20 sets", rows.len()),
        "{after}"
    );
    // What a set does on other plants is asked at the end of a validation, beside the drives.
    let driven = |row: &serde_json::Value| {
        let mut row = row.clone();
        row.as_object_mut().unwrap().remove("plants");
        row
    };
    assert_eq!(driven(&rows[0]), driven(&whole["rows"][0]));
}

#[test]
fn who_stops_before_anything_was_driven_is_told_so() {
    let sandbox = Sandbox::new();
    let mut run = sandbox.start("validate", "out", &["lane_change", "--quiet"]);
    run.wait_for("the start", || fs::exists(sandbox.path("out/launch.toml")).unwrap_or_default());
    run.interrupt();
    let output = run.finish();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(130), "{said}");
    assert!(said.contains("interrupted; "), "{said}");
    sandbox.assert_clean();
}
