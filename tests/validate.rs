//! The paper's tables from the pipeline, and the pipeline's drives against plain calls.

mod support;

use std::path::Path;

use config::{Layers, Parameters, RunConfig};
use rollout::{Rollout, TickRecord};
use serde_json::Value;
use support::Sandbox;
use tracking::{Pose, ZoneTracker, tracking_error};

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

fn rows(result: &Value) -> &[Value] {
    result["rows"].as_array().unwrap()
}

/// A configuration as a validation drives it.
fn config(maneuver: &str) -> RunConfig {
    let mut layers = Layers::maneuver(maneuver).unwrap();
    layers.set("collision.enabled=true").unwrap();
    layers.resolve().unwrap()
}

/// Digests over the reports of all drives, as they have been since the first version: every gain, mean error, mse and
/// trace, bit for bit. Not to be changed without a reason in the changelog.
const VALIDATED: [(&str, &str); 3] = [
    ("lane_change", "304fbe63d9551707b9b83f9a24ede4c4c21b65aca77165757a9550cbf2216cd7"),
    ("roundabout", "8b8add2a79aa462a0192aa65f72d50edef6802875b8ace3f7511b768d298f91e"),
    ("circuit", "5189ad2814c74a111615ff6b215e382d766453448e2c45c9edeed32595acc695"),
];
/// The same of the grids, with the set 1.26, 11, 21, 0.84 named.
const GRIDS: [(&str, &str); 2] = [
    ("lane_change", "0ea6272a1d23736f6a5229bc36dbab5276631dc10d0e4eec64ff96c0fec5abff"),
    ("roundabout", "90b38b41c6f9a0ec90fa6f4669a4e55681f186bd0f4e630066a9e667260f8e41"),
];

fn is_as_ever(figures: &[(&str, &str)], maneuver: &str, result: &Value) {
    let (_, digest) = figures.iter().find(|(name, _)| *name == maneuver).unwrap();
    assert_eq!(result["digest"], *digest, "{maneuver}");
}

#[test]
fn both_tables_of_the_maneuvers_are_met() {
    let mut logs = Vec::new();
    for maneuver in ["lane_change", "roundabout"] {
        let sandbox = Sandbox::new();
        let result = sandbox.json("out", &["validate", maneuver]);
        sandbox.assert_clean();
        is_as_ever(&VALIDATED, maneuver, &result);
        assert_eq!(rows(&result).len(), 6);
        let chosen = rows(&result).iter().find(|row| row["chosen_by_paper"] == true).unwrap();
        for row in rows(&result) {
            for (kind, mse) in [("noise_free", "mse_m2"), ("noisy", "mse_m2_worst")] {
                let factor = number(&row[kind][mse]) / number(&row[kind]["paper_mse_m2"]);
                assert!((1.0 / 1.3..=1.3).contains(&factor), "{maneuver} {kind}: {row}");
                assert!((number(&row[kind]["factor"]) - factor.max(1.0 / factor)).abs() < 1e-12);
                logs.push(factor.ln());
                let (ours, least) = (number(&row[kind][mse]), number(&chosen[kind][mse]));
                if row != chosen && kind == "noise_free" {
                    assert!(ours > least, "{maneuver}: {row}");
                }
                assert!(least <= 1.01 * ours, "{maneuver} {kind}: {row}");
            }
            assert_eq!(row["noise_free"]["collisions"], 0);
        }
        assert!(number(&result["rms_factor"]) <= 1.15);
    }
    let square = logs.iter().map(|log| log * log).sum::<f64>() / logs.len() as f64;
    assert_eq!(logs.len(), 24);
    assert!(square.sqrt().exp() <= 1.15);
}

#[test]
fn the_circuit_switches_where_the_poses_say() {
    let sandbox = Sandbox::new();
    let result = sandbox.json("out", &["validate", "circuit"]);
    is_as_ever(&VALIDATED, "circuit", &result);
    let config = config("circuit");
    assert_eq!(rows(&result).len(), 3);
    for row in rows(&result) {
        assert!(number(&row["noise_free"]["factor"]) <= 1.25, "{row}");
        assert!(number(&row["noisy"]["factor"]) <= 1.7, "{row}");
        assert_eq!(
            (&row["noise_free"]["collisions"], &row["noisy"]["collisions"]),
            (&0.into(), &0.into())
        );
    }
    let chosen = rows(&result).iter().find(|row| row["chosen_by_paper"] == true).unwrap();
    assert!(
        number(&chosen["noise_free"]["mse_m2"])
            < 0.25 * number(&rows(&result)[0]["noise_free"]["mse_m2"])
    );

    // Whoever reads the recording finds the zones by the poses in it, and the switches by the zones.
    let drive = recording(&sandbox.path("out"), "paper_noise_free");
    let mut tracker = ZoneTracker::new(&config);
    let mut zone = 0;
    let mut switches = Vec::new();
    for tick in &drive {
        let measured = tick.pose("measured_");
        // In this manoeuvre the zones go by the measured pose alone.
        let entered = tracker.update(measured, f64::NAN);
        if entered != zone {
            zone = entered;
            switches.push((tick.number("tick") as u64 + 1, zone as u64));
        }
    }
    // One tick of full throttle above the limit, at most, with noise as well.
    for tick in drive.iter().chain(&recording(&sandbox.path("out"), "paper_noisy")) {
        assert!(tick.number("command_speed_mps") <= 4.0);
        assert!(tick.number("speed_mps") <= 4.0 + 0.01 * config.vehicle.throttle_accel_mps2);
    }
    let told: Vec<(u64, u64)> = chosen["switches"]
        .as_array()
        .unwrap()
        .iter()
        .map(|it| (it["tick"].as_u64().unwrap(), it["zone"].as_u64().unwrap()))
        .collect();
    assert_eq!(told, switches);
    assert_eq!(switches.len(), 2);
    // Each switch stands in the logs, with tick, zone and gains.
    let log = std::fs::read_to_string(sandbox.path("out").join("logs/schedule.log")).unwrap();
    let first = format!("tick={} ", switches[0].0);
    assert!(
        log.lines().any(|line| line.contains(&first)
            && line.contains("roundabout")
            && line.contains("kv=3.4")),
        "{log}"
    );
    sandbox.assert_clean();

    // The same in every run, whatever the fleet, and whoever dies.
    let faults = "kill controller@drive=1,tick=2563; kill supervisor@drive=2,tick=2562; \
                  kill trainer@drive=3,tick=2563; kill simulator@drive=4,tick=9000";
    let again = sandbox.json("again", &["validate", "circuit", "--fleet", "7", "--chaos", faults]);
    assert_eq!(again["digest"], result["digest"]);
    assert_eq!(again["rows"], result["rows"]);
    assert!(
        again["run"]["recovery"]["recoveries"].as_u64().unwrap() >= 4,
        "{}",
        again["run"]["recovery"]
    );
    sandbox.assert_clean();
}

#[test]
fn recorded_drives_equal_plain_calls_bit_for_bit() {
    for maneuver in ["lane_change", "circuit"] {
        let sandbox = Sandbox::new();
        let result = sandbox.json("out", &["validate", maneuver, "--repeats", "2"]);
        let config = config(maneuver);
        let paper_rows = config.paper_rows();
        let chosen = paper_rows.iter().position(|row| row.chosen).unwrap();
        let by_zone = config.sets_by_zone(&paper_rows[chosen].sets);
        for (name, seed) in [("paper_noise_free", None), ("paper_noisy", Some(1))] {
            let mut records: Vec<TickRecord> = Vec::new();
            let mut rollout = Rollout::new(&config);
            let ended = rollout.drive_scheduled(&by_zone, seed, |_, record| records.push(*record));
            let drive = recording(&sandbox.path("out"), name);
            assert_eq!(drive.len(), records.len());
            for (tick, record) in drive.iter().zip(&records) {
                let seen = record.observation;
                tick.is_pose("", seen.truth);
                tick.is_pose("measured_", seen.measured);
                tick.is("speed_mps", seen.speed_mps);
                tick.is("yaw_rate_radps", seen.yaw_rate_radps);
                tick.is("steering_rad", seen.steering_rad);
                tick.is("command_yaw_rate_radps", record.passed.yaw_rate_radps);
                tick.is("command_steering_rad", record.passed.steering_rad);
                tick.is("command_speed_mps", record.passed.speed_mps);
                assert_eq!(tick.number("zone") as usize, record.zone);
                // The reference is told by the error that the law read, and so only up to rounding.
                let error = tracking_error(tick.pose("reference_"), seen.measured);
                let read = record.decision.error;
                assert!((error.along_track_m - read.along_track_m).abs() < 1e-9);
                assert!((error.cross_track_m - read.cross_track_m).abs() < 1e-9);
            }
            if seed.is_none() {
                let plain = &result["rows"][chosen]["noise_free"];
                assert_eq!(number(&plain["mse_m2"]), ended.mse_m2());
                assert_eq!(number(&plain["distance"]), ended.distance(10.0));
                assert_eq!(number(&plain["max_cross_track_m"]), ended.max_abs_cross_m);
                assert_eq!(number(&plain["path_mean_m"]), ended.path_mean_m);
                assert_eq!(number(&plain["path_p95_m"]), ended.path_p95_m);
                assert_eq!(number(&plain["path_max_m"]), ended.path_max_m);
            }
        }
        // Repeat r of every set uses noise seed r.
        for (row, paper) in rows(&result).iter().zip(&paper_rows) {
            let by_zone = config.sets_by_zone(&paper.sets);
            let mut rollout = Rollout::new(&config);
            let mut mse = |seed| rollout.drive_scheduled(&by_zone, Some(seed), |_, _| {}).mse_m2();
            let (first, second) = (mse(1), mse(2));
            assert_eq!(number(&row["noisy"]["mse_m2_worst"]), first.max(second));
            assert_eq!(number(&row["noisy"]["mse_m2_mean"]), (first + second) / 2.0);
        }
    }
}

#[test]
fn the_grid_equals_plain_calls_bit_for_bit() {
    for maneuver in ["lane_change", "roundabout"] {
        let sandbox = Sandbox::new();
        let yours = "1.26,11,21,0.84";
        let result = sandbox.json("out", &["grid", maneuver, "--gains", yours]);
        sandbox.assert_clean();
        is_as_ever(&GRIDS, maneuver, &result);
        let config = Layers::maneuver(maneuver).unwrap().resolve().unwrap();
        let mut rollout = Rollout::new(&config);
        let mut drive = |set| rollout.drive(set, None);
        let sets = rows_of(&sandbox.path("out/grid.csv"));
        let grid = config.grid();
        assert_eq!(sets.len(), grid.len());
        for (row, position) in sets.iter().zip(grid.positions()) {
            let set = grid.set(position);
            for (key, value) in config.law.keys().zip(set.0) {
                assert_eq!(row.number(key), value);
            }
            let record = drive(set);
            // The paper's objective.
            assert_eq!(row.number("value"), record.distance(10.0));
            assert_eq!(row.number("distance"), record.distance(10.0));
            assert_eq!(row.number("mse_m2"), record.mse_m2());
            assert_eq!(row.number("path_mean_m"), record.path_mean_m);
            assert_eq!(row.number("path_p95_m"), record.path_p95_m);
            assert_eq!(row.number("path_max_m"), record.path_max_m);
            assert_eq!(row.0["arrived"], record.arrived().to_string());
        }
        let [paper, named] = &result["sets"].as_array().unwrap()[..] else { panic!("{result}") };
        assert_eq!((&paper["name"], &named["name"]), (&"paper".into(), &"yours".into()));
        let record = drive(Parameters::of(&[1.26, 11.0, 21.0, 0.84]));
        assert_eq!(number(&named["mse_m2"]), record.mse_m2());
        let all: Vec<f64> = sets.iter().map(|row| row.number("distance")).collect();
        let rank = 1 + all.iter().filter(|it| **it < number(&named["distance"])).count();
        assert_eq!(named["rank_distance"], rank);
        let best = &result["best_by_distance"][0];
        assert_eq!(number(&best["distance"]), all.iter().copied().fold(f64::INFINITY, f64::min));
    }
}

#[test]
fn named_gains_stand_beside_the_paper_s_figures_where_it_has_some() {
    let sandbox = Sandbox::new();
    let mine = ["--gains", "3,21,21,.7", "--gains", "2,11,11,0.8", "--repeats", "2"];
    let result = sandbox.json("out", &[&["validate", "lane_change"][..], &mine].concat());
    let [known, other] = rows(&result) else { panic!("{result}") };
    assert_eq!(
        (&known["chosen_by_paper"], number(&known["noise_free"]["paper_mse_m2"])),
        (&true.into(), 1.359)
    );
    assert!(other["noise_free"]["factor"].is_null() && other["noisy"]["paper_mse_m2"].is_null());

    // One set for the whole circuit: nothing to switch.
    let args = ["validate", "circuit", "--gains", "3,21,21,.7", "--repeats", "2"];
    let result = sandbox.json("circuit", &args);
    assert_eq!(rows(&result)[0]["switches"], Value::Array(Vec::new()));

    for (args, part) in [
        (&["--gains", "3,21,21"][..], "holds 3 numbers"),
        (&["--gains", "3,21,21,.7/3,21,21,.7"], "one for each of lane_change"),
        (&["--gains", "3,21,21,1.7"], "ki is 1.7"),
        (&["--repeats", "1"], "--repeats"),
    ] {
        let output = sandbox.run(&[&["validate", "lane_change"][..], args].concat());
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(64), "{args:?}: {stderr}");
        assert!(stderr.contains(part) && stderr.trim_end().lines().count() == 1, "{stderr}");
    }
    sandbox.assert_clean();
}

/// One line of a CSV file.
struct Row(std::collections::BTreeMap<String, String>);

impl Row {
    fn number(&self, column: &str) -> f64 {
        self.0[column].parse().unwrap()
    }

    fn is(&self, column: &str, wanted: f64) {
        let got = self.number(column);
        assert_eq!(
            got.to_bits(),
            wanted.to_bits(),
            "{column} of {}: {got}, {wanted}",
            self.0["tick"]
        );
    }

    fn pose(&self, prefix: &str) -> Pose {
        let number = |name: &str| self.number(&format!("{prefix}{name}"));
        Pose { x_m: number("x_m"), y_m: number("y_m"), yaw_rad: number("yaw_rad") }
    }

    fn is_pose(&self, prefix: &str, wanted: Pose) {
        self.is(&format!("{prefix}x_m"), wanted.x_m);
        self.is(&format!("{prefix}y_m"), wanted.y_m);
        self.is(&format!("{prefix}yaw_rad"), wanted.yaw_rad);
    }
}

fn recording(run: &Path, name: &str) -> Vec<Row> {
    rows_of(&run.join("drives").join(format!("{name}.csv")))
}

fn rows_of(path: &Path) -> Vec<Row> {
    let mut reader = csv::Reader::from_path(path).unwrap();
    reader.deserialize().map(|row| Row(row.unwrap())).collect()
}
