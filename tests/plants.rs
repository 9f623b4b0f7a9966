//! Sets on plausible plants: trainings over them, and sets that are fragile.

mod support;

use std::fs;

use serde_json::Value;
use support::Sandbox;

/// A set that is nearly the best of the roundabout's grid, and shakes where the steering obeys a little later.
const FRAGILE: &str = "5.8,11,11,0.98";

#[test]
fn a_training_over_plants_is_the_same_whatever_the_fleet_and_whoever_dies() {
    let sandbox = Sandbox::new();
    let plants = "[[plants]]\nname = \"as it is\"\n[[plants]]\nname = \"late\"\nadd = { steering_delay_s = 0.05 }\n\
                  [[plants]]\nname = \"slow\"\nscale = { steering_rate_radps = 0.5 }\nadd = { steering_lag_s = 0.1 }\n";
    fs::write(sandbox.path("plants.toml"), plants).unwrap();
    let train = |name: &str, more: &[&str]| {
        let args = ["roundabout", "--tuner", "sobol", "--drives", "12", "--over", "plants.toml"];
        sandbox.train(name, &[&args[..], more].concat())
    };
    let alone = train("alone", &[]);
    let killed = "kill trainer@drive=4; kill simulator@drive=9,tick=100; kill trainer@drive=20";
    for (name, more) in [("one", &["--fleet", "1"][..]), ("killed", &["--chaos", killed])] {
        let other = train(name, more);
        assert_eq!(other["digest"], alone["digest"], "{name}");
        assert_eq!(other["gains"], alone["gains"], "{name}");
        assert_eq!(other["plants"], alone["plants"], "{name}");
        assert_eq!(other["noise"], alone["noise"], "{name}");
    }
    // Without noise, too, others than the plants of the training chose, and yet others tell.
    assert_eq!((&alone["noise"]["choosing"], &alone["noise"]["repeats"]), (&36.into(), &30.into()));
    assert_eq!(alone["plants"]["plants"].as_array().unwrap().len(), 3);
    // Another way to judge them together, another value.
    assert_ne!(train("worst", &["--over-by", "worst"])["value"], alone["value"]);
    // A plant with a faster reference is the training at that speed.
    let fast = "[[plants]]\nname = \"fast\"\nscale = { \"reference.speed_mps\" = 1.5 }\n";
    fs::write(sandbox.path("fast.toml"), fast).unwrap();
    let train = |name: &str, more: &[&str]| {
        let args = ["roundabout", "--tuner", "sobol", "--drives", "8"];
        sandbox.train(name, &[&args[..], more].concat());
        fs::read_to_string(sandbox.path(name).join("drives.csv")).unwrap()
    };
    let plant = train("plant", &["--set", "reference.speed_mps=1.0", "--over", "fast.toml"]);
    assert_eq!(plant, train("speed", &["--set", "reference.speed_mps=1.5"]));
    assert_ne!(plant, train("slow", &["--set", "reference.speed_mps=1.0"]));
    sandbox.assert_clean();
}

#[test]
fn noise_over_plants_is_the_same_for_all_sets_whatever_the_fleet_and_whoever_dies() {
    let sandbox = Sandbox::new();
    let plants = "[[plants]]\nname = \"as it is\"\n[[plants]]\nname = \"late\"\nadd = { steering_delay_s = 0.05 }\n";
    fs::write(sandbox.path("plants.toml"), plants).unwrap();
    let sets = ["drive.loop_time_s=8.0", "robust.finalists=2", "over.choosing=5", "robust.fresh=4"];
    let mut args =
        vec!["roundabout", "--noise", "--tuner", "gp", "--drives", "9", "--over", "plants.toml"];
    sets.iter().for_each(|set| args.extend(["--set", set]));
    let train = |name: &str, more: &[&str]| sandbox.train(name, &[&args[..], more].concat());
    let alone = train("alone", &[]);
    let killed = "kill trainer@drive=3; kill simulator@drive=7,tick=100; kill trainer@drive=15";
    let other = train("killed", &["--fleet", "1", "--chaos", killed]);
    for key in ["digest", "gains", "value", "noise", "grid", "plants", "baselines"] {
        assert_eq!(other[key], alone[key], "{key}");
    }
    for file in ["drives.csv", "episodes.csv"] {
        assert_eq!(sandbox.text(&format!("killed/{file}")), sandbox.text(&format!("alone/{file}")));
    }
    assert_ne!(train("seed", &["--seed", "2"])["digest"], alone["digest"]);
    // What is told comes from plants that chose nothing.
    assert_eq!((&alone["noise"]["choosing"], &alone["noise"]["repeats"]), (&5.into(), &4.into()));
    assert_eq!(alone["plants"]["fresh"]["noise"], true);

    // Plain calls come to the same, and each set was driven once: the same set with the same noise is the same drive.
    let mut layers = config::Layers::maneuver("roundabout").unwrap();
    let of_training =
        ["noise.enabled=true", "learning.tuner=gp", "over.by=mean", "vehicle.gear_engaged=false"];
    of_training.iter().chain(&sets).for_each(|set| layers.set(set).unwrap());
    layers.set("tuner.settings.drives=9").unwrap();
    layers.add_plants(&sandbox.path("plants.toml")).unwrap();
    let config = layers.resolve().unwrap();
    let oracle = trainer::train_by_rollout(&config);
    assert_eq!(alone["digest"], trainer::digest(&oracle));
    assert_eq!(oracle.visited().len(), 9);
    sandbox.assert_clean();
}

#[test]
fn sets_that_do_not_arrive_over_plants_differ_by_how_many_plants_and_how_far() {
    let sandbox = Sandbox::new();
    let rows = (0..=320).map(|it| 0.25 * f64::from(it)).map(|x| {
        // The curves begin gently.
        let share = ((x - 8.0) / 16.0).clamp(0.0, 1.0);
        let wide_m = 1.9 * share * share * (3.0 - 2.0 * share);
        format!("{x},{:.5},6\n", wide_m * (std::f64::consts::TAU * (x - 8.0) / 34.0).sin())
    });
    let rows: String = rows.collect();
    fs::write(sandbox.path("curvy.csv"), format!("x_m,y_m,v_mps\n{rows}")).unwrap();
    let car = "based_on = \"ackermann\"\nname = \"mine\"\nspeed_limit_mps = 7.5\n";
    fs::write(sandbox.path("car.toml"), car).unwrap();
    let mut args = vec!["--path", "curvy.csv", "--vehicle", "car.toml", "--law", "pure_pursuit"];
    // Look-aheads from much too short to much too long, of which most leave the path on some plant.
    let axes = [
        "grid.kv={min=1.0,max=1.0,step=1.0}",
        "grid.ld_min={min=0.5,max=12.5,step=3.0}",
        "grid.ld_s={min=0.0,max=2.0,step=1.0}",
        "grid.filter={min=0.0,max=0.0,step=1.0}",
        "controller.compensate_dead_time=false",
        "vehicle.safety.path_distance_limit_m=1.0",
    ];
    axes.iter().for_each(|set| args.extend(["--set", set]));
    sandbox.json("out", &[&["grid"], &args[..], &["--over", "default", "--noise"]].concat());
    let mut reader = csv::Reader::from_path(sandbox.path("out/grid.csv")).unwrap();
    let rows = reader.deserialize().map(|row| row.unwrap());
    let sets: Vec<std::collections::BTreeMap<String, String>> = rows.collect();
    let mut lost: Vec<f64> = sets
        .iter()
        .filter(|it| it["arrived"] == "false")
        .map(|it| it["value"].parse().unwrap())
        .collect();
    let arrived = sets.iter().filter(|it| it["arrived"] == "true").map(|it| &it["value"]);
    let worst = arrived.map(|it| it.parse().unwrap()).fold(0.0, f64::max);
    lost.sort_by(f64::total_cmp);
    assert!(lost.len() >= 5, "{lost:?}");
    assert!(lost[0] > worst && lost.iter().all(|it| it.is_finite()), "{worst}, {lost:?}");
    lost.dedup();
    let count = sets.iter().filter(|it| it["arrived"] == "false").count();
    assert_eq!(lost.len(), count, "{lost:?}");
    sandbox.assert_clean();
}

#[test]
fn a_fragile_set_is_called_so_and_promoted_only_by_force() {
    let sandbox = Sandbox::new();
    fs::write(sandbox.path("car.toml"), "name = \"mine\"\n").unwrap();
    let args = ["validate", "roundabout", "--repeats", "2"];
    let sets = ["--gains", FRAGILE, "--gains", "3.4,21,1,0.84"];
    let result = sandbox.json("both", &[&args[..], &sets].concat());
    let fragile = |row: usize| result["rows"][row]["plants"]["fragile"].clone();
    let why = fragile(0).as_str().unwrap().to_owned();
    assert!(why.contains("dead times +60 ms") && why.contains("less than 200 ms"), "{why}");
    assert_eq!(fragile(1), Value::Null);
    assert_eq!(result["rows"][0]["plants"]["fresh"]["plants"], 48);

    // A training that can come to nothing else.
    let only = ["kv=5.8", "kl=11", "ks=11", "ki=0.98"].map(|pair| {
        let (key, value) = pair.split_once('=').unwrap();
        format!("grid.{key}={{min={value:},max={value:},step=1.0}}")
    });
    let mut args =
        vec!["roundabout", "--tuner", "random", "--drives", "1", "--vehicle", "car.toml"];
    only.iter().for_each(|set| args.extend(["--set", set]));
    let trained = sandbox.train("shaky", &args);
    assert!(trained["plants"]["fragile"].is_string(), "{}", trained["plants"]);
    let refused = sandbox.run(&["gains", "promote", "shaky", "car.toml"]);
    let said = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert_eq!(refused.status.code(), Some(64), "{said}");
    assert!(said.contains("fragile") && said.contains("--force"), "{said}");
    let forced = sandbox.run(&["gains", "promote", "shaky", "car.toml", "--force"]);
    assert!(forced.status.success());

    for (args, wanted) in [
        (&["--over", "nowhere.toml"][..], "nowhere.toml"),
        (&["--over", "car.toml"], "car.toml"),
        (&["--over", "default", "--replace", "vehicle=true"], "--over"),
    ] {
        let refused = sandbox.run(&[&["train", "roundabout"][..], args].concat());
        let said = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert_eq!(refused.status.code(), Some(64), "{args:?}: {said}");
        assert!(said.contains(wanted), "{args:?}: {said}");
    }
    sandbox.assert_clean();
}
