//! Several rings share the drives of a run: the same bytes come out, whichever ring drives what and whoever is killed.

mod support;

use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use config::Layers;
use rollout::Rollout;
use serde_json::Value;
use support::Sandbox;

/// Four sets of a grid on nine plants each, a few at a time.
const GRID: [&str; 13] = [
    "grid",
    "roundabout",
    "--over",
    "default",
    "--fleet",
    "12",
    "--set",
    "grid.kv={min=3.0,max=3.0,step=1.0}",
    "--set",
    "grid.kl.step=20.0",
    "--set",
    "grid.ks={min=11.0,max=11.0,step=1.0}",
    "--set=grid.ki.step=0.28",
];

fn names(result: &Value) -> Vec<&str> {
    let processes = result["run"]["processes"].as_array().unwrap();
    processes.iter().map(|it| it["name"].as_str().unwrap()).collect()
}

#[test]
fn rings_share_the_drives_and_change_no_byte() {
    let sandbox = Sandbox::new();
    let unranked = "ranking.max_ticks=0";
    let training = ["roundabout", "--over", "default", "--episodes", "1", "--set", unranked];
    let one = sandbox.train("one", &[&training[..], &["--rings", "1"]].concat());
    assert_eq!(names(&one), ["simulator", "supervisor", "controller", "trainer"]);
    let ring = |number: u32| {
        ["simulator", "supervisor", "controller"].map(|name| format!("{name}-{number}"))
    };
    let faults =
        "kill controller@drive=2,tick=30; kill simulator@drive=3; stop supervisor@drive=4 for 2s";
    for rings in ["2", "3"] {
        let args = [&training[..], &["--rings", rings, "--chaos", faults]].concat();
        let several = sandbox.train(rings, &args);
        assert_eq!(several["run"]["rings"], rings.parse::<u32>().unwrap());
        assert_eq!(several["run"]["recovery"]["injected"], 3);
        let mut wanted = names(&one).into_iter().map(str::to_owned).collect::<Vec<_>>();
        wanted.extend((2..=rings.parse().unwrap()).flat_map(ring));
        assert_eq!(names(&several), wanted);
        assert_eq!(several["digest"], one["digest"]);
        let outcome = |out: &str| sandbox.text(&format!("{out}/outcome.json"));
        assert!(outcome(rings) == outcome("one"), "{rings} rings come to another outcome");
        assert!(sandbox.path(rings).join("logs/controller-2.log").exists());
    }
    sandbox.assert_clean();
}

#[test]
fn what_the_trainer_follows_is_driven_where_it_listens() {
    let sandbox = Sandbox::new();
    // Gains for each zone, and recorded drives.
    let one = sandbox.json("one", &["validate", "circuit", "--rings", "1"]);
    let two = sandbox.json("two", &["validate", "circuit", "--rings", "2"]);
    assert_eq!(two["run"]["rings"], 2);
    for key in ["rows", "digest"] {
        assert!(!one[key].is_null() && one[key] == two[key], "{key}");
    }
    let one = sandbox.json("grid", &[&GRID[..], &["--rings", "1"]].concat());
    let two = sandbox.json("grids", &[&GRID[..], &["--rings", "2"]].concat());
    assert_eq!(one["digest"], two["digest"]);
    sandbox.assert_clean();
}

#[test]
fn what_can_be_started_only_once_is_refused() {
    let sandbox = Sandbox::new();
    let cases: [&[&str]; 3] = [
        &["train", "lane_change", "--replace", "vehicle=true"],
        &["train", "lane_change", "--record"],
        &["drive", "lane_change", "--realtime"],
    ];
    for args in cases {
        let output = sandbox.run(&[args, &["--rings", "2", "--out", "out"]].concat());
        let told = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(64), "{args:?}: {told}");
        assert!(told.contains("--rings") && told.lines().count() == 1, "{args:?}: {told}");
        assert!(!sandbox.path("out").exists());
    }
    sandbox.assert_clean();
}

/// How long the pipeline takes for a robust training, beside plain calls of the same cores on as many threads as there are
/// processors: 48 plants × 625 sets in the roundabout, 90 million ticks, with dead time and lag.
#[test]
#[ignore = "by hand: a minute in which nothing else may run"]
fn a_grid_over_48_plants_beside_plain_calls() {
    let sandbox = Sandbox::new();
    let plants: Vec<String> = (0..48)
        .map(|number| {
            let (delay_s, lag_s) =
                (0.03 + 0.001 * f64::from(number), 0.02 + 0.0015 * f64::from(number));
            format!("{{name='{number}',add={{steering_delay_s={delay_s},steering_lag_s={lag_s}}}}}")
        })
        .collect();
    let plants = plants.join(",");
    std::fs::write(sandbox.path("plants.toml"), format!("plants=[{plants}]")).unwrap();
    let args = ["grid", "roundabout", "--over", "plants.toml"];
    let begun = Instant::now();
    let result = sandbox.json("grid", &args);
    let pipeline_s = begun.elapsed().as_secs_f64();
    let mut layers = Layers::maneuver("roundabout").unwrap();
    layers.set(&format!("over.plants=[{plants}]")).unwrap();
    layers.set("over.by=mean").unwrap();
    let config = layers.resolve().unwrap();
    let (grid, changes) = (config.grid(), config.plant_changes());
    let next = AtomicUsize::new(0);
    let begun = Instant::now();
    let ticks: u64 = std::thread::scope(|scope| {
        let drive = || {
            let mut ticks = 0;
            while let Some(change) = changes.get(next.fetch_add(1, Ordering::Relaxed)) {
                let (driver, plant) = (config.driving_plant(change), config.with_plant(change));
                let mut rollout = Rollout::on_plant(&driver, &plant);
                let sets = grid.positions().map(|position| grid.set(position));
                ticks += sets.map(|set| rollout.drive(set, None).ticks).sum::<u64>();
            }
            ticks
        };
        let threads = std::thread::available_parallelism().unwrap().get();
        let threads: Vec<_> = (0..threads).map(|_| scope.spawn(drive)).collect();
        threads.into_iter().map(|thread| thread.join().unwrap()).sum()
    });
    let calls_s = begun.elapsed().as_secs_f64();
    let rings = &result["run"]["rings"];
    println!(
        "{ticks} ticks: {pipeline_s:.1} s with {rings} rings, {calls_s:.1} s by plain calls: {:.2} ×",
        pipeline_s / calls_s
    );
}
