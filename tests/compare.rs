//! `pathtune compare`: decided by configuration and seed alone, and told as a table, as JSON or as CSV.

mod support;

use serde_json::Value;
use support::Sandbox;

fn stdout(sandbox: &Sandbox, args: &[&str]) -> String {
    let output = sandbox.run(args);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{args:?}: {stderr}");
    String::from_utf8(output.stdout).unwrap()
}

#[test]
fn tuners_are_compared_with_the_same_bytes_each_time() {
    let sandbox = Sandbox::new();
    let args =
        ["compare", "lane_change", "--tuners", "gp,random,q", "--seeds", "3", "--drives", "12"];
    let json = stdout(&sandbox, &[&args[..], &["--json"]].concat());
    assert_eq!(stdout(&sandbox, &[&args[..], &["--json", "--quiet"]].concat()), json);
    let result: Value = serde_json::from_str(&json).unwrap();
    let names: Vec<&str> = result["tuners"]
        .as_array()
        .unwrap()
        .iter()
        .map(|it| it["tuner"].as_str().unwrap())
        .collect();
    assert_eq!(names, ["gp", "random", "q"]);
    assert_eq!(result["tuners"][0]["after"][1]["drives"], 12);

    // A setting is for those that have it; the others train as before.
    let set = ["--json", "--set", "tuner.settings.first=5"];
    let other: Value =
        serde_json::from_str(&stdout(&sandbox, &[&args[..], &set].concat())).unwrap();
    assert_ne!(other["tuners"][0], result["tuners"][0]);
    assert_eq!(other["tuners"][1], result["tuners"][1]);

    // The best set of the grid is that of `pathtune grid`.
    let best = result["best_value"].as_f64().unwrap();
    let grid = sandbox.json("grid", &["grid", "lane_change", "--quiet"]);
    assert_eq!(grid["best"][0]["value"].as_f64().unwrap().to_bits(), best.to_bits());

    let csv = stdout(&sandbox, &[&args[..], &["--csv"]].concat());
    let lines: Vec<&str> = csv.lines().collect();
    assert_eq!(lines.len(), 1 + 3 * 3);
    assert_eq!(
        lines[0],
        "tuner,seed,drives_to_within_2_percent,drives_to_top_1_percent,regret_after_10,regret_after_12"
    );
    let table = stdout(&sandbox, &args);
    assert!(table.contains("random") && table.contains("3 trainings with each tuner"), "{table}");
    sandbox.assert_clean();
}

/// Each law has the same tuners and budget, stands beside its textbook parameters, and `random` is there unasked.
#[test]
fn laws_are_compared_beside_their_textbook_parameters() {
    let sandbox = Sandbox::new();
    let args = ["compare", "smooth_lane", "--laws", "stanley,pure_pursuit", "--tuners", "sobol"];
    let args = [&args[..], &["--seeds", "2", "--drives", "6"]].concat();
    let laws: Value =
        serde_json::from_str(&stdout(&sandbox, &[&args[..], &["--json"]].concat())).unwrap();
    for (it, law) in laws.as_array().unwrap().iter().zip(["stanley", "pure_pursuit"]) {
        assert_eq!(it["law"], law);
        assert_eq!(it["tuners"][1]["tuner"], "random");
        assert!(it["textbook_value"].as_f64().unwrap() >= it["best_value"].as_f64().unwrap());
    }
    let alone = ["compare", "smooth_lane", "--law", "stanley", "--tuners", "sobol", "--json"];
    let alone = stdout(&sandbox, &[&alone[..], &["--seeds", "2", "--drives", "6"]].concat());
    assert_eq!(laws[0], serde_json::from_str::<Value>(&alone).unwrap());
    std::fs::write(sandbox.path("file"), "").unwrap();
    let output = sandbox.run(&[&args[..], &["--report", "file"]].concat());
    let why = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.code() == Some(64) && why.contains("name another one"), "{why}");
    // Before the first training.
    assert!(!why.contains("trainings are over"), "{why}");
    let told = stdout(&sandbox, &[&args[..], &["--report", "page"]].concat());
    assert!(told.contains("smooth_lane, tesla_model_3_guarded, by path:"), "{told}");
    let page = sandbox.text("page/index.html");
    assert!(page.contains("above the best [%]") && page.contains("Level lines: textbook"));
    for picture in ["laws", "regret", "regret-2", "study-compared"] {
        assert!(sandbox.path(&format!("page/{picture}.svg")).is_file(), "{picture}");
    }
    let csv = stdout(&sandbox, &[&args[..], &["--csv"]].concat());
    assert_eq!(csv.lines().count(), 1 + 2 * 2 * 2);
    assert!(csv.lines().nth(1).unwrap().starts_with("stanley,sobol,1,"), "{csv}");
    sandbox.assert_clean();
}

#[test]
fn what_cannot_be_compared_is_told_in_a_line() {
    let sandbox = Sandbox::new();
    for (args, part) in [
        (&["lane_change", "--tuners", "gp,sarsa"][..], "--tuners sarsa"),
        (&["lane_change", "--tuners", "gp,gp"], "names gp twice"),
        (&["lane_change", "--tuners", "gp", "--drives", "201"], "[1, 200]"),
        (&["lane_change", "--tuners", "q", "--continuous"], "keeps to the grid"),
        (&["lane_change", "--tuners", "gp", "--set", "ranking.max_ticks=1"], "ranking.max_ticks"),
        (
            &["lane_change", "--tuners", "gp", "--set", "tuner.settings.first=2.5"],
            "tuner.settings.first",
        ),
        (
            &["lane_change", "--tuners", "gp", "--set", "tuner.settings.frist=3"],
            "none of the tuners gp, random has it",
        ),
        (&["lane_change", "--laws", "stanley,stanley"], "names stanley twice"),
        (&["lane_change", "--laws", "paper,foo"], "--laws foo"),
        (&["lane_change", "--laws", "stanly"], "did you mean stanley"),
        (&[], "name a manoeuvre"),
    ] {
        let output = sandbox.run(&[&["compare"], args].concat());
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(64), "{args:?}: {stderr}");
        assert_eq!(stderr.trim_end().lines().count(), 1, "{args:?}: {stderr}");
        assert!(stderr.contains(part), "{args:?}: {part:?} is missing in {stderr:?}");
    }
    sandbox.assert_clean();
}
