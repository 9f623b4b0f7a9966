//! The examples: what a reader would copy must work, and say what the contract says.

mod support;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

use serde_json::Value;
use support::Sandbox;

fn example(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("examples").join(path)
}

fn skip(why: &str) {
    assert!(std::env::var_os("PATHTUNE_NO_SKIPS").is_none(), "{why}");
    eprintln!("skipped: {why}");
}

/// The vehicle in Python as a command, if there is an interpreter with what it needs.
fn python_vehicle() -> Option<Vec<String>> {
    let python = std::env::var("PATHTUNE_PYTHON").ok().filter(|python| {
        let import = Command::new(python).args(["-c", "import iceoryx2, tomllib"]).output();
        import.is_ok_and(|output| output.status.success())
    });
    let Some(python) = python else {
        skip("PATHTUNE_PYTHON names no interpreter of Python 3.11 with iceoryx2");
        return None;
    };
    // -B: the sources' folder stays as it is.
    Some(vec![python, "-B".to_owned(), example("python_vehicle/vehicle.py").display().to_string()])
}

/// The vehicle in Rust as a command: built once, in the folder of the build that runs.
fn rust_vehicle() -> Vec<String> {
    static BUILT: OnceLock<PathBuf> = OnceLock::new();
    let program = BUILT.get_or_init(|| {
        let folder = Path::new(env!("CARGO_BIN_EXE_pathtune")).parent().unwrap();
        let target = folder.parent().unwrap();
        let mut cargo = Command::new(env!("CARGO"));
        cargo
            .args(["build", "--offline", "--locked", "--quiet", "--manifest-path"])
            .arg(example("rust_vehicle/Cargo.toml"))
            .arg("--target-dir")
            .arg(target);
        if folder.ends_with("release") {
            cargo.arg("--release");
        }
        let output = cargo.output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        folder.join("rust_vehicle")
    });
    vec![program.display().to_string()]
}

fn passes(vehicle: &[String], args: &[&str]) {
    let sandbox = Sandbox::new();
    let mut all: Vec<&str> = vec!["conformance", "--json", "--allow-motion"];
    all.extend(args);
    all.push("--");
    all.extend(vehicle.iter().map(String::as_str));
    let output = sandbox.run(&all);
    let found: Value = serde_json::from_slice(&output.stdout)
        .unwrap_or_else(|error| panic!("{error}: {}", String::from_utf8_lossy(&output.stderr)));
    let failed: Vec<&Value> = found["checks"]
        .as_array()
        .unwrap()
        .iter()
        .filter(|check| {
            check["verdict"] == "fail" || check["seen"].as_str().unwrap().starts_with("not reached")
        })
        .collect();
    assert!(output.status.success() && failed.is_empty(), "{failed:#?}\n{}", found["log"]);
    sandbox.assert_clean();
}

#[test]
fn the_mirrors_in_python_and_c_are_what_the_schema_says() {
    let sandbox = Sandbox::new();
    let python = sandbox.run(&["schema", "--python"]);
    let mirror = std::fs::read(example("python_vehicle/pathtune_messages.py")).unwrap();
    assert!(python.stdout == mirror, "make it again: pathtune schema --python");
    // Its sizes and offsets are asserted when it is imported.
    let interpreter = std::env::var("PATHTUNE_PYTHON").unwrap_or("python3".to_owned());
    let import = "import pathtune_messages as m; assert m.Command.type_name().startswith('pathtune.Command#')";
    match Command::new(interpreter)
        .args(["-B", "-c", import])
        .current_dir(example("python_vehicle"))
        .output()
    {
        Ok(output) => assert!(output.status.success(), "{output:?}"),
        Err(_) => skip("there is no Python"),
    }
    let c = sandbox.run(&["schema", "--c"]);
    std::fs::write(sandbox.path("pathtune.h"), c.stdout).unwrap();
    let source = "#include \"pathtune.h\"\nint main(void) { return sizeof(struct pathtune_Odometry) != 80; }\n";
    std::fs::write(sandbox.path("it.c"), source).unwrap();
    match Command::new("cc")
        .args(["-std=c11", "-Wall", "-Wextra", "-Werror", "it.c", "-o", "it"])
        .current_dir(sandbox.path("."))
        .output()
    {
        Ok(output) => {
            assert!(output.status.success(), "{output:?}");
            assert!(Command::new(sandbox.path("it")).status().unwrap().success());
        }
        Err(_) => skip("there is no C compiler"),
    }
    for wrong in [&["schema"][..], &["schema", "--c", "--python"]] {
        assert_eq!(sandbox.run(wrong).status.code(), Some(64));
    }
}

#[test]
fn the_python_vehicle_trains_as_ours_does() {
    let Some(vehicle) = python_vehicle() else { return };
    let sandbox = Sandbox::new();
    let ours = sandbox.train("ours", &["lane_change", "--episodes", "2"]);
    let replaced = format!("vehicle={}", vehicle.join(" "));
    // Its grid is not driven here, which would take it a minute.
    let args =
        ["lane_change", "--episodes", "2", "--set", "ranking.max_ticks=0", "--replace", &replaced];
    let theirs = sandbox.train("theirs", &[&args[..], &["--set", "robust.finalists=1"]].concat());
    assert_eq!(ours["drives"]["asked"], theirs["drives"]["asked"]);
    // By learner and step: the two fleets' drives come back in another order.
    let distances = |out: &str| -> Vec<f64> {
        let mut reader = csv::Reader::from_path(sandbox.path(out).join("drives.csv")).unwrap();
        let rows = reader.deserialize().map(Result::unwrap);
        let mut drives: Vec<BTreeMap<String, String>> = rows.collect();
        let number = |row: &BTreeMap<String, String>, key: &str| row[key].parse::<f64>().unwrap();
        drives.sort_by_key(|row| (number(row, "learner") as u32, number(row, "step") as u32));
        drives.iter().map(|row| number(row, "distance")).collect()
    };
    let (ours, theirs) = (distances("ours"), distances("theirs"));
    assert_eq!(ours.len(), theirs.len());
    for (ours, theirs) in ours.iter().zip(&theirs) {
        assert!((ours - theirs).abs() < 1e-9, "{ours} against {theirs}");
    }
    sandbox.assert_clean();
}

#[test]
fn the_python_vehicle_keeps_to_the_contract() {
    let Some(vehicle) = python_vehicle() else { return };
    passes(&vehicle, &["--deterministic"]);
}

#[test]
fn the_python_vehicle_keeps_to_the_contract_in_real_time() {
    let Some(vehicle) = python_vehicle() else { return };
    passes(&vehicle, &["--realtime"]);
}

#[test]
fn the_rust_vehicle_trains_and_keeps_to_the_contract() {
    let vehicle = rust_vehicle();
    passes(&vehicle, &["--deterministic"]);
    let sandbox = Sandbox::new();
    let replaced = format!("vehicle={}", vehicle.join(" "));
    let result = sandbox.train("out", &["lane_change", "--episodes", "2", "--replace", &replaced]);
    assert_eq!(result["drives"]["asked"], result["drives"]["driven"]);
    sandbox.assert_clean();
}

/// Each figure of a training's table against the same set in `grid --replace` on the same car.
fn figures_are_those_of_the_grid(sandbox: &Sandbox, out: &str, args: &[&str]) -> Value {
    let replaced = format!("vehicle={}", rust_vehicle().join(" "));
    let args = [&["lane_change", "--replace", &replaced, "--deterministic"], args].concat();
    let trained = sandbox.train(out, &[&args[..], &["--episodes", "2"]].concat());
    let list = |set: &Value| {
        let of = |key: &str| set[key].as_f64().unwrap().to_string();
        ["kv", "kl", "ks", "ki"].map(of).join(",")
    };
    let rows = [&trained, &trained["plain_q"], &trained["random_walk"]];
    let mut grid_args = [&["grid"], &args[..]].concat();
    let sets = rows.map(|row| list(&row["gains"]));
    sets.iter().for_each(|set| grid_args.extend(["--gains", set]));
    let grid = sandbox.json(&format!("{out}_grid"), &grid_args);

    let measures =
        ["value", "distance", "mse_m2", "path_mean_m", "path_p95_m", "path_max_m", "arrived"];
    let ranks = ["rank_value", "rank_distance", "rank_mse", "rank_path"];
    let named = grid["sets"].as_array().unwrap();
    let (paper, named) = named.split_first().unwrap();
    assert_eq!((named.len(), &paper["name"]), (3, &"paper".into()));
    for (row, of_grid) in
        rows.into_iter().chain([&trained["paper"]]).zip(named.iter().chain([paper]))
    {
        assert_eq!(row["gains"], of_grid["gains"]);
        for key in measures {
            assert_eq!(row[key], of_grid[key], "{out}: {key} of {}", row["gains"]);
        }
        for key in ranks {
            let rank = if row == &trained { &row["grid"][key] } else { &row[key] };
            assert_eq!(rank, &of_grid[key], "{out}: {key} of {}", row["gains"]);
        }
    }
    for (key, list, measure) in [
        ("best_value", "best", "value"),
        ("best_distance", "best_by_distance", "distance"),
        ("best_mse_m2", "best_by_mse", "mse_m2"),
        ("best_path_mean_m", "best_by_path", "path_mean_m"),
    ] {
        assert_eq!(trained["grid"][key], grid[list][0][measure], "{out}: {key}");
    }
    trained
}

#[test]
fn figures_are_those_of_the_car_that_drove() {
    let sandbox = Sandbox::new();
    let ours = sandbox.train("ours", &["lane_change", "--episodes", "2"]);
    let plain = figures_are_those_of_the_grid(&sandbox, "plain", &[]);
    std::fs::write(
        sandbox.path("car.toml"),
        "name = \"late\"\nsteering_delay_s = 0.15\nsteering_lag_s = 0.1\n",
    )
    .unwrap();
    let late = figures_are_those_of_the_grid(&sandbox, "late", &["--vehicle", "car.toml"]);
    // Three cars, three grids.
    for (a, b) in [(&ours, &plain), (&plain, &late), (&ours, &late)] {
        assert_ne!(a["grid"]["best_distance"], b["grid"]["best_distance"]);
        assert_ne!(a["paper"]["distance"], b["paper"]["distance"]);
    }
    // What is promoted is what the car did.
    let promoted = sandbox.run(&["gains", "promote", "late", "car.toml"]);
    assert!(promoted.status.success(), "{}", String::from_utf8_lossy(&promoted.stderr));
    let show = sandbox.run(&["gains", "show", "car.toml", "lane_change", "--json"]);
    let show: Value = serde_json::from_slice(&show.stdout).unwrap();
    let origin = &show["gains"]["provenance"];
    for key in ["distance", "mse_m2", "path_mean_m", "path_max_m"] {
        assert_eq!(origin[key], late[key], "{key}");
    }
    assert_eq!(origin["rank_distance"], late["grid"]["rank_distance"]);
    assert_eq!((&origin["grid_size"], &origin["drives"]), (&late["grid"]["size"], &1.into()));
    sandbox.assert_clean();
}

#[test]
fn by_the_clock_figures_come_from_finalists_and_the_paper_s_set() {
    let sandbox = Sandbox::new();
    let replaced = format!("vehicle={} --realtime", rust_vehicle().join(" "));
    let output = sandbox.run(&[
        "train",
        "lane_change",
        "--replace",
        &replaced,
        "--quiet",
        "--out",
        "out",
        "--episodes",
        "1",
        "--alphas",
        "0.5",
        "--set",
        "drive.loop_time_s=0.4",
        "--set",
        "learning.step_limit=2",
        "--set",
        "robust.finalists=1",
        "--set",
        "robust.repeats=2",
    ]);
    assert!(output.status.success(), "{}", sandbox.story("out", &output));
    let result = sandbox.result("out");
    let drives = &result["vehicle_drives"];
    assert_eq!((&drives["repeats"], &drives["by_clock"]), (&false.into(), &true.into()));
    for absent in ["grid", "plain_q", "random_walk"] {
        assert!(result[absent].is_null(), "{absent}: {}", result[absent]);
    }
    for row in [&result, &result["paper"]] {
        assert_eq!(row["spread"]["drives"], 2, "{row}");
        assert!(row["mse_m2"].as_f64().unwrap() > 0.0);
    }
    // The finalists' drives are those of the table: on a car none is made twice.
    assert_eq!(drives["for_table"], 0);
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(said.contains("not ranked: the vehicle paces by the clock"), "{said}");
    sandbox.assert_clean();
}

#[test]
fn the_rust_vehicle_keeps_to_the_contract_in_real_time() {
    passes(&rust_vehicle(), &["--realtime"]);
}
