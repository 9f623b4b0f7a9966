//! Runs `pathtune conformance` on a vehicle that is broken on purpose.

use std::collections::BTreeSet;

use serde_json::Value;

use super::Sandbox;

/// Says to the broken vehicle what is broken.
pub const FAULT: &str = "VEHICLE_TEST_FAULT";

/// What a run of the checks has found: the exit code, and the ids of those that failed.
pub fn failed(
    sandbox: &Sandbox,
    fault: &str,
    args: &[&str],
) -> (Option<i32>, BTreeSet<String>, Value) {
    let all = [&["conformance", "--json", "--allow-motion"], args].concat();
    let output = sandbox.command(&all).env(FAULT, fault).output().unwrap();
    let found: Value = serde_json::from_slice(&output.stdout).unwrap_or_else(|error| {
        panic!("{fault}: {error}: {}", String::from_utf8_lossy(&output.stderr))
    });
    let checks = found["checks"].as_array().unwrap();
    assert!(checks.len() >= 30);
    let failed = checks.iter().filter(|check| check["verdict"] == "fail");
    let ids = failed.map(|check| check["id"].as_str().unwrap().to_owned()).collect();
    (output.status.code(), ids, found)
}

/// Runs the broken vehicle: it must fail `must`, and may fail `may` in its train.
pub fn breaks(cases: &[(&str, &str, &[&str])]) {
    // Most of the time is spent waiting for what must not come.
    for at_once in cases.chunks(4) {
        std::thread::scope(|scope| {
            for case in at_once {
                scope.spawn(move || break_one(case));
            }
        });
    }
}

fn break_one((fault, must, may): &(&str, &str, &[&str])) {
    let sandbox = Sandbox::new();
    let exe = std::env::current_exe().unwrap();
    let vehicle =
        ["--", exe.to_str().unwrap(), "--exact", "broken_vehicle", "--ignored", "--nocapture"];
    let options: &[&str] = match *fault {
        "unsteady" => &["--deterministic"],
        fault if fault.starts_with("clock") => &["--realtime"],
        _ => &[],
    };
    let args = [options, &vehicle[..]].concat();
    let (code, ids, found) = failed(&sandbox, fault, &args);
    let unrelated: Vec<_> =
        ids.iter().filter(|id| id != must && !may.contains(&id.as_str())).collect();
    if must.is_empty() {
        assert!(ids.is_empty() && code == Some(0), "{fault}: {found:#}");
    } else {
        assert!(ids.contains(*must) && code == Some(1), "{fault} must fail {must}: {found:#}");
    }
    assert!(unrelated.is_empty(), "{fault} fails {unrelated:?}: {found:#}");
    sandbox.wait_until_nobody_lives();
    sandbox.assert_clean();
}
