//! Waiting: whatever way is chosen, the result is the same; what the machine refuses is said, and does no harm.

mod support;

use std::fs;

use serde_json::Value;
use support::Sandbox;

/// A training of a second, that drives every step.
const TRAINING: [&str; 4] = ["lane_change", "--episodes", "2", "--no-memo"];

#[test]
fn every_way_of_waiting_gives_the_same_bytes() {
    let sandbox = Sandbox::new();
    // Short: on fewer cores than processes spinning takes its time.
    let training = ["lane_change", "--episodes", "1", "--no-memo"];
    let calm = sandbox.train("auto", &training);
    for wait in ["yield", "spin", "block"] {
        for fleet in ["1", "6"] {
            let more = ["--wait", wait, "--fleet", fleet];
            let result = sandbox.train(&format!("{wait}{fleet}"), &[&training[..], &more].concat());
            assert_eq!(result["run"]["waiting"], wait);
            assert_eq!(result["digest"], calm["digest"], "{more:?}");
            assert_eq!(
                result["run"]["recovery"]["stalls"], 0,
                "{more:?}: {}",
                result["run"]["recovery"]
            );
        }
    }
    // Two that would each like a core to themselves, on whatever cores there are.
    let more = ["--wait", "spin", "--quiet", "--fleet", "1"];
    let args = [&training[..], &more].concat();
    let both = ["one", "other"].map(|out| sandbox.start_training(out, &args));
    for training in both {
        assert_eq!(training.succeed()["digest"], calm["digest"]);
    }
    sandbox.assert_clean();
}

#[test]
fn a_killed_process_comes_back_however_the_others_wait() {
    let sandbox = Sandbox::new();
    let calm = sandbox.train("calm", &TRAINING);
    let script =
        "kill controller@drive=5,tick=30; kill simulator@drive=9; stop supervisor@drive=12 for 2s";
    for wait in ["spin", "block"] {
        let more = ["--wait", wait, "--chaos", script];
        let result = sandbox.train(wait, &[&TRAINING[..], &more].concat());
        assert_eq!(result["digest"], calm["digest"]);
        assert_eq!(result["run"]["recovery"]["injected"], 3);
    }
    sandbox.assert_clean();
}

#[test]
fn a_way_that_does_not_exist_is_a_user_s_mistake() {
    let sandbox = Sandbox::new();
    let cases: [(&[&str], &str); 3] = [
        (&["train", "lane_change", "--wait", "nap"], "nap"),
        (&["train", "lane_change", "--fifo"], "--realtime"),
        (&["drive", "lane_change", "--realtime", "--fifo=100"], "100"),
    ];
    for (args, part) in cases {
        let output = sandbox.run(args);
        let told = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(64), "{args:?}: {told}");
        assert!(told.contains(part) && told.lines().count() == 1, "{args:?}: {told}");
    }
    sandbox.assert_clean();
}

/// Number of first-in-first-out scheduling in `/proc/PID/stat`.
const FIFO: &str = "1";

#[test]
fn the_ring_is_scheduled_first_in_first_out_or_the_user_is_told() {
    let sandbox = Sandbox::new();
    let args = ["lane_change", "--realtime", "--fifo=7"];
    let mut drive = sandbox.start("drive", "out", &args);
    drive.wait_for("the drive", || sandbox.has_living_run());
    let scheduled = |service: &str| {
        let pid = sandbox.service(service).unwrap();
        let stat = fs::read_to_string(format!("/proc/{pid}/stat")).unwrap();
        // Behind the name: priority and policy are the fields 40 and 41 of the whole.
        let fields: Vec<String> =
            stat.rsplit_once(')').unwrap().1.split_whitespace().map(str::to_owned).collect();
        (fields[37].clone(), fields[38].clone())
    };
    let allowed = scheduled("controller").1 == FIFO;
    for service in ["simulator", "controller", "supervisor"] {
        let expected = if allowed { ("7", FIFO) } else { ("0", "0") };
        let (priority, policy) = scheduled(service);
        assert_eq!((priority.as_str(), policy.as_str()), expected, "{service}");
    }
    // The rest is in nobody's way.
    assert_eq!(scheduled("schedule").1, "0");
    let output = drive.finish();
    let told = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{told}");
    assert_eq!(told.contains("--fifo 7 is refused here"), !allowed, "{told}");
    sandbox.assert_clean();
}

#[test]
fn a_bench_of_some_rows_tells_them() {
    let sandbox = Sandbox::new();
    let only = ["calls", "ring/pipe", "pipeline/fleet=1", "law/stanley", "law/mpc/calls"];
    let only: Vec<&str> = only.iter().flat_map(|it| ["--only", it]).collect();
    let output = sandbox.run(&[&["bench", "--rounds", "1", "--json"], &only[..]].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let told: Value = serde_json::from_slice(&output.stdout).unwrap();
    let rows = told["rows"].as_array().unwrap();
    let names: Vec<&str> = rows.iter().map(|row| row["name"].as_str().unwrap()).collect();
    let ours = ["calls", "pipeline/fleet=1", "pipeline/fleet=16", "ring/pipe"];
    let of_laws = ["law/mpc/calls", "law/stanley/calls", "law/stanley/pipeline"];
    assert_eq!(names, [&ours[..], &of_laws[..]].concat());
    for row in rows {
        for key in ["ticks_per_s", "vehicle_ticks_per_s", "p50_ns", "p99_ns"] {
            assert!(row[key].as_f64().unwrap() > 0.0, "{row}");
        }
        assert!(row["p50_ns"].as_f64() <= row["p99_ns"].as_f64(), "{row}");
    }
    let refused = sandbox.run(&["bench", "--only", "nothing"]);
    assert_eq!(refused.status.code(), Some(64));
    assert!(String::from_utf8_lossy(&refused.stderr).contains("pipeline/fleet=64"));
    sandbox.assert_clean();
}

#[test]
fn a_bench_by_the_clock_tells_what_came_late() {
    let sandbox = Sandbox::new();
    let output = sandbox.run(&["bench", "--realtime", "2s", "--json"]);
    let told: Value = serde_json::from_slice(&output.stdout)
        .unwrap_or_else(|_| panic!("{}", String::from_utf8_lossy(&output.stderr)));
    let rows = told["rows"].as_array().unwrap();
    let names: Vec<&str> = rows.iter().map(|row| row["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["realtime", "realtime/loaded", "realtime/fifo", "realtime/fifo/loaded"]);
    for row in rows {
        let ticks = row["ticks"].as_u64().unwrap();
        // Two seconds at 100 Hz, or what a loaded machine makes of them.
        assert!((100..=400).contains(&ticks), "{row}");
        assert!(row["lost"].as_u64().unwrap() < ticks, "{row}");
        assert!(
            row["p50_ns"].as_u64().unwrap() > 0 && row["p50_ns"].as_u64() <= row["max_ns"].as_u64()
        );
    }
    sandbox.assert_clean();
}
