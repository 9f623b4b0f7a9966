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
