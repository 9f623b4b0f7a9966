//! Gains of a training, promoted to a vehicle's file: with provenance, all or nothing, and back.

mod support;

use std::fs;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::process::Output;
use std::time::Duration;

use config::{Layers, NamedParameters, Vehicle};
use serde_json::Value;
use support::Sandbox;

const CAR: &str = "# My car, as measured.\nname = \"mine\"  # since spring\n\n[safety]\n# Softly.\njerk_limit_mps3 = 60.0\n# To be measured again.\n";

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Runs `pathtune gains` to a good end; what it printed.
fn gains(sandbox: &Sandbox, args: &[&str]) -> String {
    let output = sandbox.run(&[&["gains"], args].concat());
    assert!(output.status.success(), "{args:?}: {}", stderr(&output));
    String::from_utf8(output.stdout).unwrap()
}

/// Runs `pathtune gains` with a mistake: one line with all parts, and nothing has changed.
fn refused(sandbox: &Sandbox, args: &[&str], parts: &[&str]) {
    let file = sandbox.path("car.toml");
    let before = fs::read(&file).ok();
    let output = sandbox.run(&[&["gains"], args].concat());
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(64), "{args:?}: {said}");
    assert_eq!(said.trim_end().lines().count(), 1, "{args:?}: {said}");
    for part in parts {
        assert!(said.contains(part), "{args:?}: {part:?} is missing in {said:?}");
    }
    assert_eq!(fs::read(&file).ok(), before, "{args:?} has changed the file");
    assert!(!sandbox.path(".car.toml.part").exists());
}

fn car(sandbox: &Sandbox) -> Vehicle {
    Layers::vehicle_of_file(sandbox.path("car.toml").to_str().unwrap()).unwrap()
}

fn gains_of(value: &Value) -> NamedParameters {
    let of = |key: &str| (key.to_owned(), value[key].as_f64().unwrap());
    NamedParameters(["kv", "kl", "ks", "ki"].map(of).to_vec())
}

/// A sandbox with a car and a short training; its result.
fn trained() -> (Sandbox, Value) {
    let sandbox = Sandbox::new();
    fs::write(sandbox.path("car.toml"), CAR).unwrap();
    let result = sandbox.train("first", &["lane_change", "--episodes", "2"]);
    (sandbox, result)
}

#[test]
fn gains_are_promoted_listed_shown_and_driven() {
    let (sandbox, result) = trained();
    let dry = gains(&sandbox, &["promote", "first", "car.toml", "--dry-run"]);
    assert!(dry.contains("lane_change would be promoted"), "{dry}");
    assert_eq!(fs::read_to_string(sandbox.path("car.toml")).unwrap(), CAR);
    assert!(gains(&sandbox, &["list", "car.toml"]).contains("no gains yet"));
    // Until then the paper's are driven.
    let plain = sandbox.run(&["drive", "lane_change", "--vehicle", "car.toml", "--out", "plain"]);
    assert!(stderr(&plain).contains("from the paper"), "{}", stderr(&plain));

    // How much later the steering may act counts with the car that is to drive with them.
    let late = format!("steering_delay_s = 0.5\nsteering_lag_s = 0.5\n{CAR}");
    fs::write(sandbox.path("late.toml"), late).unwrap();
    let args = ["gains", "promote", "first", "late.toml"];
    let said = sandbox.run(&args);
    assert_eq!(said.status.code(), Some(64), "{}", stderr(&said));
    assert!(stderr(&said).contains("the set is fragile, with this vehicle"), "{}", stderr(&said));
    let said = gains(&sandbox, &["promote", "first", "late.toml", "--force", "--dry-run"]);
    assert!(said.contains("(Δ)"), "{said}");

    let promoted = sandbox.run(&["gains", "promote", "first", "car.toml"]);
    assert!(promoted.status.success(), "{}", stderr(&promoted));
    let said = String::from_utf8_lossy(&promoted.stdout);
    assert!(said.contains("ms later") && said.contains("(Δ)"), "{said}");
    for part in ["certain to come back to a straight path", "when simulated"] {
        assert!(said.contains(part), "{part}: {said}");
    }
    let margin = &result["plants"]["margin"];
    assert!(margin["certified"]["offset_m"].as_f64() > Some(0.0), "{margin}");
    assert!(margin["simulated"]["offset_m"].as_f64() > margin["certified"]["offset_m"].as_f64());
    let bounds = result["on_bound"].as_array().unwrap();
    assert_eq!(stderr(&promoted).contains("warning: on a bound"), !bounds.is_empty());
    let text = fs::read_to_string(sandbox.path("car.toml")).unwrap();
    assert!(text.starts_with(CAR), "{text}");
    let set = &car(&sandbox).gains["lane_change"];
    let origin = set.provenance.clone().unwrap();
    assert_eq!(set.parameters, gains_of(&result["gains"]));
    assert_eq!(result["digest"], *origin.digest);
    assert_eq!((&*origin.run, &*origin.maneuver), ("first", "lane_change"));
    assert_eq!((&*origin.vehicle, origin.noise), ("tesla_model_3", false));
    assert_eq!(result["grid"]["rank_distance"].as_u64(), origin.rank_distance);
    assert_eq!(result["distance"], origin.distance);

    let short = &origin.digest[..12];
    let listed = gains(&sandbox, &["list", "car.toml"]);
    assert!(listed.contains("lane_change") && listed.contains(short), "{listed}");
    let listed: Value =
        serde_json::from_str(&gains(&sandbox, &["list", "car.toml", "--json"])).unwrap();
    assert_eq!(listed["gains"]["lane_change"]["provenance"]["digest"], result["digest"]);
    let shown = gains(&sandbox, &["show", "car.toml", "lane_change"]);
    assert!(shown.contains("seed") && shown.contains(&origin.digest), "{shown}");
    let shown: Value =
        serde_json::from_str(&gains(&sandbox, &["show", "car.toml", "lane_change", "--json"]))
            .unwrap();
    assert_eq!(gains_of(&shown["gains"]), set.parameters);

    let args = ["drive", "lane_change", "--vehicle", "car.toml", "--out", "driven"];
    let driven = sandbox.run(&args);
    let said = stderr(&driven);
    assert!(driven.status.success(), "{said}");
    assert!(said.contains("from car.toml (run first, digest") && said.contains(short), "{said}");
    assert_eq!(sandbox.result("driven")["gains"][0], result["gains"]);
    let quiet = sandbox.run(&["drive", "lane_change", "--vehicle", "car.toml", "-q"]);
    // Whose values it has is told all the same.
    let said = stderr(&quiet);
    assert!(said.lines().count() == 1 && said.contains("the values of another car"), "{said}");
    // A path with a manoeuvre that the car has no gains for.
    let args = ["drive", "circuit", "--vehicle", "car.toml", "--out", "circuit"];
    let said = stderr(&sandbox.run(&args));
    assert!(said.contains("from the paper, as car.toml has none for roundabout"), "{said}");
    // The car is trained on, and the training is gone on with.
    let again =
        sandbox.train("again", &["lane_change", "--episodes", "2", "--vehicle", "car.toml"]);
    let output = sandbox.run(&["train", "--resume", "again", "-q"]);
    assert!(output.status.success(), "{}", stderr(&output));
    assert_eq!(sandbox.result("again")["digest"], again["digest"]);
    sandbox.assert_clean();
}

#[test]
fn a_large_change_is_refused_then_forced_and_rolled_back() {
    let (sandbox, _) = trained();
    let hand = "\n[gains.lane_change]\nkv = 1e-1 # by feel\nkl = 2.10\nks = 1_000\nki = 0.1\n";
    let by_hand = format!("{CAR}{hand}");
    fs::write(sandbox.path("car.toml"), &by_hand).unwrap();
    let parts = ["car.toml", "gains.lane_change", "kv from 0.1 to", "%", "--force"];
    refused(&sandbox, &["promote", "first", "car.toml"], &parts);
    refused(
        &sandbox,
        &["rollback", "car.toml"],
        &["lane_change", "there were no gains before these"],
    );
    let forced = gains(&sandbox, &["promote", "first", "car.toml", "--force"]);
    assert!(forced.contains("kv 0.1 ->"), "{forced}");
    let first = car(&sandbox).gains["lane_change"].clone();
    let again = gains(&sandbox, &["promote", "first", "car.toml"]);
    assert!(again.contains("has these gains already"), "{again}");

    gains(&sandbox, &["rollback", "car.toml"]);
    let text = fs::read_to_string(sandbox.path("car.toml")).unwrap();
    // In the form of this version, as it was written, with its comment.
    let rewritten = "\n[gains.lane_change]\nlaw = \"paper\"\n";
    assert!(text.starts_with(&format!("{CAR}{rewritten}")), "{text}");
    let table =
        "[gains.lane_change.parameters]\nkv = 1e-1 # by feel\nkl = 2.10\nks = 1_000\nki = 0.1\n";
    assert!(text.contains(table), "{text}");
    let set = car(&sandbox).gains["lane_change"].clone();
    assert_eq!((set.provenance, set.history.len()), (None, 1));
    refused(&sandbox, &["rollback", "car.toml"], &["--to N restores"]);
    refused(&sandbox, &["rollback", "car.toml", "--to", "2"], &["--to 2", "history holds 1"]);
    refused(&sandbox, &["rollback", "car.toml", "roundabout"], &["roundabout", "lane_change"]);
    gains(&sandbox, &["rollback", "car.toml", "lane_change", "--to", "1"]);
    let set = car(&sandbox).gains["lane_change"].clone();
    assert_eq!((set.parameters, set.provenance), (first.parameters, first.provenance));
}

#[test]
fn what_is_no_finished_training_is_refused() {
    let (sandbox, _) = trained();
    let promote =
        |run: &str, parts: &[&str]| refused(&sandbox, &["promote", run, "car.toml"], parts);
    promote("nowhere", &["nowhere"]);
    promote("car.toml", &["car.toml", "folder"]);
    sandbox.json("driven", &["drive", "lane_change"]);
    promote("driven", &["driven", "a run of drive"]);

    // A training that lives has no result; one with a result is gone on with.
    let mut training = sandbox.start_training("living", &["lane_change", "--no-memo"]);
    training.wait_until_it_drives();
    promote("living", &["living", "a living run trains in this folder"]);
    training.interrupt();
    training.finish();
    promote("living", &["living", "is not a finished training", "--resume living"]);
    // A result that is somebody else's, without the trainer's own and with it.
    let copy = |from: &str, name: &str| {
        fs::copy(sandbox.path(from).join(name), sandbox.path("living").join(name)).unwrap();
    };
    copy("first", "result.json");
    promote("living", &["living", "is not a finished training", "outcome.json"]);
    sandbox.train("other", &["lane_change", "--episodes", "1", "--seed", "2"]);
    copy("other", "outcome.json");
    promote("living", &["living", "result.json does not belong to outcome.json"]);
    sandbox.assert_clean();
}

#[test]
fn what_is_no_file_of_the_users_is_refused() {
    let (sandbox, _) = trained();
    let promote = |car: &str, parts: &[&str]| refused(&sandbox, &["promote", "first", car], parts);
    promote("tesla_model_3", &["is a preset", "pathtune config init"]);
    promote("none.toml", &["none.toml", "no such file", "pathtune config init"]);
    promote(".", &["is not a vehicle's file"]);
    refused(&sandbox, &["list", "f1tenth"], &["is a preset", "vehicles/f1tenth.toml"]);

    // Another car than the training's.
    fs::write(sandbox.path("car.toml"), format!("wheelbase_m = 3.0\n{CAR}")).unwrap();
    promote("car.toml", &["wheelbase_m is 3", "2.875", "--force"]);
    gains(&sandbox, &["promote", "first", "car.toml", "--force"]);

    let with = |set: &str| fs::write(sandbox.path("car.toml"), format!("{CAR}\n{set}")).unwrap();
    with("[gains.lane_change]\nkv = 1.0\nkl = 1.0\nks = 1.0\nki = 0.5\nkd = 2.0\n");
    promote("car.toml", &["car.toml:14", "vehicle.gains.lane_change.kd", "unknown"]);
    refused(&sandbox, &["list", "car.toml"], &["car.toml:14", "kd"]);
    with("[gains.lane_change]\nkv = -1.0\nkl = 1.0\nks = 1.0\nki = 0.5\n");
    refused(&sandbox, &["list", "car.toml"], &["car.toml:10", "kv", "is -1"]);
    with("[gain.lane_change]\nkv = 1.0\n");
    refused(&sandbox, &["list", "car.toml"], &["car.toml:9", "gain", "unknown key"]);
    fs::write(sandbox.path("car.toml"), "name = ").unwrap();
    promote("car.toml", &["car.toml:1"]);
}

#[test]
fn permissions_and_links_stay_and_a_read_only_file_is_refused() {
    let (sandbox, _) = trained();
    let file = sandbox.path("car.toml");
    let chmod = |mode| fs::set_permissions(&file, fs::Permissions::from_mode(mode)).unwrap();
    chmod(0o440);
    refused(&sandbox, &["promote", "first", "car.toml"], &["car.toml", "is read-only", "chmod"]);
    chmod(0o664);
    fs::create_dir(sandbox.path("links")).unwrap();
    symlink("../car.toml", sandbox.path("links/link.toml")).unwrap();
    // What a killed predecessor left, or somebody else laid there.
    fs::write(sandbox.path("other"), "other").unwrap();
    symlink("other", sandbox.path(".car.toml.part")).unwrap();
    gains(&sandbox, &["promote", "first", "links/link.toml"]);
    assert!(fs::symlink_metadata(sandbox.path("links/link.toml")).unwrap().is_symlink());
    assert!(!fs::symlink_metadata(&file).unwrap().is_symlink());
    assert_eq!(fs::metadata(&file).unwrap().permissions().mode() & 0o777, 0o664);
    assert_eq!(car(&sandbox).gains.len(), 1);
    assert_eq!(fs::read_to_string(sandbox.path("other")).unwrap(), "other");
    assert_eq!(fs::read_dir(sandbox.path("links")).unwrap().count(), 1);

    // A folder in which nothing can be written; root can everywhere.
    if rustix::process::getuid().is_root() {
        eprintln!("SKIPPED a read-only folder: root writes there");
        return;
    }
    let folder = sandbox.path("closed");
    fs::create_dir(&folder).unwrap();
    fs::write(folder.join("car.toml"), CAR).unwrap();
    fs::set_permissions(&folder, fs::Permissions::from_mode(0o555)).unwrap();
    let parts = ["closed/car.toml", "cannot be written"];
    refused(&sandbox, &["promote", "first", "closed/car.toml"], &parts);
    fs::set_permissions(&folder, fs::Permissions::from_mode(0o755)).unwrap();
}

#[test]
fn whoever_is_killed_leaves_the_old_file_or_the_new_one() {
    let (sandbox, first) = trained();
    let second = sandbox.train("second", &["lane_change", "--episodes", "2", "--seed", "7"]);
    assert_ne!(first["digest"], second["digest"]);
    gains(&sandbox, &["promote", "first", "car.toml"]);
    let file = sandbox.path("car.toml");
    let (mut killed, mut replaced) = (0, 0);
    for round in 0..150u64 {
        let before = fs::read_to_string(&file).unwrap();
        let run = if before.lines().any(|line| line == "run = \"first\"") && round % 2 == 0 {
            "second"
        } else {
            "first"
        };
        let args = ["gains", "promote", run, "car.toml", "--force"];
        let mut child = sandbox.command(&args).spawn().unwrap();
        std::thread::sleep(Duration::from_micros(round * 7919 % 9000));
        child.kill().unwrap();
        killed += usize::from(!child.wait().unwrap().success());
        let after = fs::read_to_string(&file).unwrap();
        assert!(after.starts_with(CAR), "{after}");
        let set = car(&sandbox).gains["lane_change"].clone();
        if after != before {
            replaced += 1;
            assert_eq!(set.provenance.unwrap().run, run);
            assert!(!set.history.is_empty());
        }
    }
    println!("{killed} of 150 killed, {replaced} had replaced the file");
    assert!(killed > 0);
    // Two at a time: one behind the other, and what the killed ones left is gone.
    let history = |car: &Vehicle| car.gains["lane_change"].history.len();
    fs::write(&file, CAR).unwrap();
    gains(&sandbox, &["promote", "first", "car.toml"]);
    for _ in 0..4 {
        let before = history(&car(&sandbox));
        let start = |run| {
            let args = ["gains", "promote", run, "car.toml", "--force"];
            sandbox.command(&args).spawn().unwrap()
        };
        for child in [start("second"), start("first")] {
            assert!(child.wait_with_output().unwrap().status.success());
        }
        let new = history(&car(&sandbox)) - before;
        assert!((1..=2).contains(&new), "{new}");
    }
    assert!(!sandbox.path(".car.toml.part").exists());
}

/// Writes a closed path's file: the points of a curve with a parameter from 0 to 2π.
fn closed_path(sandbox: &Sandbox, name: &str, at: impl Fn(f64) -> [f64; 2]) {
    let rows = (0..=60).map(|step| {
        let [x_m, y_m] = at(f64::from(step % 60) / 60.0 * std::f64::consts::TAU);
        format!("{x_m:.4},{y_m:.4}\n")
    });
    fs::write(sandbox.path(name), format!("x_m,y_m\n{}", rows.collect::<String>())).unwrap();
}

/// An ellipse that a car of scale 1:10 can drive.
fn oval(turn: f64) -> [f64; 2] {
    [4.0 * libm::sin(turn), 2.0 - 2.0 * libm::cos(turn)]
}

/// An F1TENTH car, trained on a path by the objective `path`: what it chooses is about the best of the grid by the true
/// distance from the path, and arrives.
fn chosen_is_the_best_of_the_grid(at: impl Fn(f64) -> [f64; 2]) {
    let sandbox = Sandbox::new();
    closed_path(&sandbox, "track.csv", at);
    let args = ["--path", "track.csv", "--vehicle", "f1tenth", "--objective", "path"];
    let result = sandbox.train("first", &args);
    let of = |value: &Value| value.as_f64().unwrap();
    let (chosen_m, best_m) = (of(&result["path_mean_m"]), of(&result["grid"]["best_path_mean_m"]));
    assert!(chosen_m <= 1.05 * best_m, "{chosen_m} m, and the best is {best_m} m");
    assert_eq!(result["arrived"], true);
    sandbox.assert_clean();
}

#[test]
fn tuned_gains_twice_as_far_off() {
    chosen_is_the_best_of_the_grid(oval);
}

#[test]
fn best_of_the_grid_never_arrives() {
    chosen_is_the_best_of_the_grid(|turn| [4.0 * libm::sin(turn), 2.0 * libm::sin(2.0 * turn)]);
}

/// README's "From nothing to a drive", in lockstep: it ends with gains in the car's file and a drive that arrives.
#[test]
fn from_nothing_to_a_drive() {
    let sandbox = Sandbox::new();
    let car = "base = \"f1tenth\"\nname = \"mine\"\nwheelbase_m = 0.33\nsteering_limit_rad = 0.41\n\
               speed_limit_mps = 4.0\n";
    fs::write(sandbox.path("car.toml"), car).unwrap();
    let rows = (0..240).map(|it| oval(std::f64::consts::TAU * f64::from(it) / 240.0));
    let rows: String = rows.map(|[x, y]| format!("{x:.4},{y:.4},2.0\n")).collect();
    fs::write(sandbox.path("raceline.csv"), rows).unwrap();
    let of = ["--path", "raceline.csv", "--vehicle", "car.toml", "--law", "pure_pursuit"];
    let mut args = [&of[..], &["--over", "default", "--tuner", "sobol", "--drives", "24"]].concat();
    let few = ["over.choosing=6", "robust.finalists=6", "robust.fresh=4", "ranking.max_ticks=1"];
    few.iter().for_each(|set| args.extend(["--set", set]));
    let tuned = sandbox.train("tuned", &args);
    assert_eq!(tuned["plants"]["fragile"], Value::Null, "{}", tuned["plants"]);
    let said = gains(&sandbox, &["promote", "tuned", "car.toml"]);
    assert!(said.contains("raceline promoted for the path raceline ("), "{said}");
    let driven = sandbox.json("driven", &[&["drive"], &of[..]].concat());
    assert_eq!((&driven["arrived"], &driven["gains"][0]), (&true.into(), &tuned["gains"]));
    assert!(driven["path_mean_m"].as_f64().unwrap() < 0.05, "{driven}");
    sandbox.assert_clean();
}

/// The bounds of a length go with the size of the car, in its file as well.
#[test]
fn a_look_ahead_that_only_a_small_car_has_is_promoted_and_driven() {
    let sandbox = Sandbox::new();
    fs::write(sandbox.path("car.toml"), "base = \"f1tenth\"\nname = \"mine\"\n").unwrap();
    closed_path(&sandbox, "track.csv", oval);
    let of = ["--path", "track.csv", "--vehicle", "car.toml", "--law", "pure_pursuit"];
    let mut args = [&of[..], &["--tuner", "sobol", "--drives", "2"]].concat();
    args.extend([
        "--set",
        "grid.ld_min={min=0.08,max=0.08,step=2}",
        "--set",
        "ranking.max_ticks=1",
    ]);
    args.extend(["--set", "controller.compensate_dead_time=false"]);
    let tuned = sandbox.train("tuned", &args);
    assert_eq!(tuned["gains"]["ld_min"], 0.08);
    gains(&sandbox, &["promote", "tuned", "car.toml", "--force"]);
    for from in [&[][..], &["--from", "tuned"]] {
        let output = sandbox.run(&[&["drive", "--out", "driven"], &of[..], from].concat());
        let said = stderr(&output);
        assert!(said.contains("compensate_dead_time = false, and this drives with true"), "{said}");
        assert_eq!(sandbox.result("driven")["gains"][0], tuned["gains"]);
        fs::remove_dir_all(sandbox.path("driven")).unwrap();
    }
    sandbox.assert_clean();
}

#[test]
fn each_path_and_law_has_gains_of_its_own() {
    let sandbox = Sandbox::new();
    fs::write(sandbox.path("car.toml"), "base = \"f1tenth\"\nname = \"mine\"\n").unwrap();
    closed_path(&sandbox, "oval.csv", oval);
    let short = ["--vehicle", "car.toml", "--episodes", "1", "--set", "ranking.max_ticks=1"];
    let train = |name: &str, more: &[&str]| {
        sandbox.train(name, &[&["--path", "oval.csv"], &short[..], more].concat())
    };
    let drive = |path: &str, more: &[&str]| {
        let args = ["drive", "--path", path, "--vehicle", "car.toml", "--out", "driven"];
        let _ = fs::remove_dir_all(sandbox.path("driven"));
        let output = sandbox.run(&[&args, more].concat());
        (output.status.code(), stderr(&output))
    };
    let paper = train("paper", &[]);
    let said = gains(&sandbox, &["promote", "paper", "car.toml", "--force"]);
    assert!(said.contains("oval promoted for the path oval ("), "{said}");
    train("pursuit", &["--law", "pure_pursuit"]);
    let said = gains(&sandbox, &["promote", "pursuit", "car.toml", "--force"]);
    assert!(said.contains("oval/pure_pursuit promoted for the path oval ("), "{said}");

    for (law, run) in [("paper", "paper"), ("pure_pursuit", "pursuit")] {
        let (code, said) = drive("oval.csv", &["--law", law]);
        assert_eq!(code, Some(0), "{said}");
        assert!(said.contains(&format!("from car.toml (run {run}, digest")), "{said}");
    }
    // The same path in a file of another name, and another path in a file of the same name.
    fs::rename(sandbox.path("oval.csv"), sandbox.path("ring.csv")).unwrap();
    let (code, said) = drive("ring.csv", &[]);
    assert!(code == Some(0) && said.contains("from car.toml (run paper"), "{said}");
    assert_eq!(sandbox.result("driven")["gains"][0], paper["gains"]);
    closed_path(&sandbox, "oval.csv", |turn| oval(turn).map(|place| 1.1 * place));
    let (code, said) = drive("oval.csv", &[]);
    assert_eq!(code, Some(64), "{said}");
    for part in ["car.toml", "gains.oval", "another path", "--gains"] {
        assert!(said.contains(part), "{said:?} lacks {part:?}");
    }
    sandbox.assert_clean();
}

#[test]
fn an_envelope_goes_along_with_promoted_gains_and_is_found_by_their_drives() {
    let (sandbox, _) = trained();
    let calibrate = |args: &[&str]| {
        let output = sandbox.run(&[&["calibrate", "first", "--drives", "40"], args].concat());
        assert!(output.status.success(), "{}", stderr(&output));
    };
    // Calibrated for another car than the one that gets the gains.
    calibrate(&[]);
    let promote = ["gains", "promote", "first", "car.toml"];
    let said = stderr(&sandbox.run(&[&promote[..], &["--dry-run"]].concat()));
    for part in
        ["first/envelope.toml: is left behind", "vehicle is tesla_model_3", "--vehicle car.toml"]
    {
        assert!(said.contains(part), "{part:?} is missing in {said}");
    }
    fs::remove_file(sandbox.path("first/envelope.toml")).unwrap();
    calibrate(&["--vehicle", "car.toml"]);
    let promoted = sandbox.run(&promote);
    assert!(promoted.status.success(), "{}", stderr(&promoted));
    let told = String::from_utf8_lossy(&promoted.stdout).into_owned();
    let file = "car.lane_change.envelope.toml";
    assert!(told.contains(file), "{told} {}", stderr(&promoted));
    assert_eq!(sandbox.text(file), sandbox.text("first/envelope.toml"));

    let drive = |out: &str, args: &[&str]| {
        let named = ["drive", "lane_change", "--vehicle", "car.toml", "--noise", "--out", out];
        // It drives from the first second on.
        let engaged = ["--set", "vehicle.gear_engaged=true"];
        sandbox.run(&[&named, &engaged[..], args].concat())
    };
    let first = drive("driven", &["--only-judge"]);
    assert!(first.status.success(), "{}", stderr(&first));
    assert!(stderr(&first).contains(&format!("held to {file}")), "{}", stderr(&first));
    let seen = &sandbox.result("driven")["envelope"];
    assert!(seen["score"].as_f64().unwrap() > 0.0 && seen["quality"].as_array().unwrap().len() > 1);
    assert!(sandbox.text("driven/report/index.html").contains("In its envelope"));
    assert_eq!(sandbox.text("driven/car.txt"), "no drive since this car was calibrated\n");
    assert_eq!(sandbox.text(&format!("{file}.drives")).lines().count(), 1);
    let second = drive("again", &["--only-judge", "--json", "--set", "run.seed=7"]);
    let json: Value = serde_json::from_slice(&second.stdout).unwrap();
    assert!(json["envelope"]["score"].is_number());
    assert!(stderr(&second).contains("2 drives"), "{}", stderr(&second));
    assert!(sandbox.text("again/car.txt").contains("1 drive,"));

    // Other gains have nothing to do with it, and what it cannot judge it is not used for.
    let other = drive("other", &["--gains", "3,21,21,0.7"]);
    assert!(!stderr(&other).contains("envelope") && sandbox.result("other")["envelope"].is_null());
    let faster = drive("faster", &["--set", "reference.speed_mps=1.2"]);
    assert!(stderr(&faster).contains("is not used: it was calibrated for another drive, its path"));
    fs::write(sandbox.path(file), "nothing").unwrap();
    let broken = drive("broken", &[]);
    assert_eq!(broken.status.code(), Some(64), "{}", stderr(&broken));
    assert!(stderr(&broken).contains(file) && stderr(&broken).contains("calibrate again"));
    sandbox.assert_clean();
}
