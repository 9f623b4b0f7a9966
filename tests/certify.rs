//! Certificates: what is said of gains before they are driven, as a file, and verified by itself.

mod support;

use std::fs;
use std::process::Output;

use config::RunConfig;
use rollout::Rollout;
use serde_json::Value;
use support::Sandbox;

const PAIR: &str = "3,21,21,0.7/3.4,21,1,0.84";

fn json(sandbox: &Sandbox, args: &[&str]) -> Value {
    let output = sandbox.run(&[&["certify"], args, &["--json"]].concat());
    assert!(output.status.success(), "{args:?}: {}", stderr(&output));
    serde_json::from_slice(&output.stdout).unwrap()
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn stdout(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// A mistake: one line with these parts.
fn refused(sandbox: &Sandbox, args: &[&str], parts: &[&str]) {
    let output = sandbox.run(&[&["certify"], args].concat());
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(64), "{args:?}: {said}");
    assert_eq!(said.trim_end().lines().count(), 1, "{args:?}: {said}");
    for part in parts {
        assert!(said.contains(part), "{args:?}: {part:?} is missing in {said:?}");
    }
}

#[test]
fn a_certificate_is_written_verified_and_refused_once_it_is_changed() {
    let sandbox = Sandbox::new();
    let args = ["circuit", "--gains", PAIR, "--speeds", "4", "--write", "circuit.json"];
    let said = json(&sandbox, &args);
    let at = &said["speeds"][0];
    let near = |value: &Value, wanted: f64| {
        let value = value.as_f64().unwrap();
        assert!((value / wanted - 1.0).abs() < 0.005, "{value} {wanted}");
    };
    near(&at["sets"][0]["additional_dead_time_s"], 0.4211);
    near(&at["sets"][1]["certified"]["offset_m"], 0.0747);
    near(&at["sets"][1]["certified"]["heading_rad"], 0.3 * 0.0747);
    assert_eq!(at["joints"].as_array().unwrap().len(), 8);
    assert_eq!(at["sets"][1]["fragile"], false);
    // Again, byte by byte, and not over what is there.
    refused(&sandbox, &args, &["--write circuit.json", "exists already"]);
    let again = json(&sandbox, &[&args[..6], &["again.json"]].concat());
    assert_eq!(again, said);
    let text = fs::read_to_string(sandbox.path("circuit.json")).unwrap();
    assert_eq!(text, fs::read_to_string(sandbox.path("again.json")).unwrap());

    let check = |name: &str| sandbox.run(&["certify", "--check", name]);
    let output = check("circuit.json");
    assert!(output.status.success(), "{}{}", stdout(&output), stderr(&output));
    assert!(stdout(&output).contains("regions hold for tesla_model_3"), "{}", stdout(&output));

    let changed = |name: &str, change: &dyn Fn(&mut Value)| {
        let mut it: Value = serde_json::from_str(&text).unwrap();
        change(&mut it);
        fs::write(sandbox.path(name), serde_json::to_string(&it).unwrap()).unwrap();
    };
    // Twice as large; other gains; a car that steers slower.
    changed("large.json", &|it| {
        for row in it["regions"][0]["region"]["p"].as_array_mut().unwrap() {
            for entry in row.as_array_mut().unwrap() {
                *entry = (0.25 * entry.as_f64().unwrap()).into();
            }
        }
    });
    changed("gains.json", &|it| it["regions"][0]["gains"]["kl"] = 40.0.into());
    changed("slow.json", &|it| it["car"]["steering_rate_radps"] = 0.3.into());
    for name in ["large.json", "gains.json", "slow.json"] {
        let output = check(name);
        assert_eq!(output.status.code(), Some(1), "{name}: {}", stderr(&output));
        assert!(stdout(&output).contains("refused: "), "{name}: {}", stdout(&output));
    }
    // What claims something else is no certificate.
    changed("claim.json", &|it| it["claim"] = "it is safe".into());
    changed("late.json", &|it| it["car"]["steering_delay_s"] = 0.1.into());
    refused(&sandbox, &["--check", "claim.json"], &["--check claim.json", "claim"]);
    refused(&sandbox, &["--check", "late.json"], &["--check late.json", "dead time"]);
    fs::write(sandbox.path("none.json"), "{}").unwrap();
    refused(&sandbox, &["--check", "none.json"], &["is no certificate", "format"]);
    refused(&sandbox, &["--check", "missing.json"], &["--check missing.json"]);
}

#[test]
fn what_cannot_be_certified_is_told_with_the_reason() {
    let sandbox = Sandbox::new();
    fs::write(sandbox.path("late.toml"), "steering_delay_s = 0.12\nsteering_lag_s = 0.08\n")
        .unwrap();
    let late = ["roundabout", "--vehicle", "late.toml", "--speeds", "1.5,3.5"];
    let said = json(&sandbox, &late);
    let of = |at: usize| &said["speeds"][at]["sets"][0];
    assert_eq!((of(0)["fragile"].clone(), of(1)["fragile"].clone()), (false.into(), true.into()));
    for at in [0, 1] {
        assert!(of(at)["certified"].is_null() && of(at)["stable"] == true);
        assert!(of(at)["no_certificate"].as_str().unwrap().contains("dead time or lag"));
    }
    assert!(of(0)["simulated"]["offset_m"].as_f64() > of(1)["simulated"]["offset_m"].as_f64());
    let unstable = ["roundabout", "--gains", "5.8,11,11,0.98", "--vehicle", "late.toml"];
    let output = sandbox.run(&[&["certify"], &unstable[..]].concat());
    assert!(stdout(&output).contains("the loop is unstable"), "{}", stdout(&output));

    // Of other laws, and with compensation, what the law itself shows when it is driven.
    let stanley = json(&sandbox, &["lane_change", "--law", "stanley", "--vehicle", "late.toml"]);
    let set = &stanley["speeds"][0]["sets"][0];
    let why = set["no_certificate"].as_str().unwrap();
    assert!(why.contains("no certificate for the law stanley"), "{why}");
    assert!(set["stable"] == true && set["gains"]["k_soft"].is_number(), "{set}");
    assert!(set["additional_dead_time_s"].as_f64().unwrap() > 0.2, "{set}");
    assert!(set["simulated"]["offset_m"].as_f64().unwrap() > 0.1, "{set}");
    refused(&sandbox, &["lane_change", "--speeds", "1.5,fast"], &["fast", "m/s"]);
    refused(&sandbox, &["lane_change", "--gains", "0,21,21,0.7"], &["kv = 0"]);
    refused(&sandbox, &[&late[..], &["--write", "late.json"]].concat(), &["no certified region"]);
    refused(&sandbox, &[], &["name a manoeuvre"]);
    refused(&sandbox, &["lane_chang"], &["lane_chang"]);
}

#[test]
fn the_gains_of_a_training_are_certified() {
    let sandbox = Sandbox::new();
    let result = sandbox.train("first", &["lane_change", "--episodes", "2"]);
    let said = json(&sandbox, &["first"]);
    let set = &said["speeds"][0]["sets"][0];
    assert_eq!(said["speeds"][0]["speed_mps"], 1.5);
    for key in ["kv", "kl", "ks", "ki"] {
        assert_eq!(set["gains"][key], result["gains"][key]);
    }
    refused(&sandbox, &["first", "--law", "paper"], &["--law", "leave it out"]);
}

#[test]
fn gains_change_only_where_the_ones_to_come_are_certain_to_hold_the_car() {
    let sandbox = Sandbox::new();
    let drive = |out: &str, args: &[&str]| {
        let named = ["drive", "circuit", "--gains", PAIR, "--out", out];
        let settings = ["--set", "collision.enabled=false", "--set", "vehicle.gear_engaged=true"];
        sandbox.run(&[&named, &settings[..], args].concat())
    };
    // The paper's switches are inside: nothing changes.
    let plain = drive("plain", &[]);
    assert!(plain.status.success(), "{}", stderr(&plain));
    let held = drive("held", &["--hold-switches"]);
    assert!(
        stderr(&held).contains("they change only within the certified regions of"),
        "{}",
        stderr(&held)
    );
    assert_eq!(sandbox.result("held")["digest"], sandbox.result("plain")["digest"]);
    assert!(sandbox.result("held")["refused"].is_null());

    // A pose that jumps by decimetres may be outside, until it is inside again.
    let noisy = ["--hold-switches", "--noise", "--set", "noise.position_sd_m=0.6"];
    let fast = ["--set", "reference.speed_mps=4.0", "--set", "drive.loop_time_s=50.0"];
    let driven = drive("noisy", &[&noisy[..], &fast].concat());
    let result = sandbox.result("noisy");
    let refused = result["refused"].as_array().unwrap();
    assert!(!refused.is_empty(), "{}", stderr(&driven));
    assert!(stdout(&driven).contains("a change of gains was put off from"), "{}", stdout(&driven));
    // The same ticks as by plain calls.
    let config = RunConfig::from_resolved(&sandbox.text("noisy/config.toml")).unwrap();
    assert!(!config.switch_regions.is_empty());
    let sets = config.law.parse_sets(PAIR).unwrap();
    let (mut zone, mut entered) = (0, Vec::new());
    let by_zone = config.sets_by_zone(&sets);
    Rollout::new(&config).drive_scheduled(&by_zone, Some(config.run.seed), |tick, it| {
        if it.zone != zone {
            zone = it.zone;
            entered.push((tick + 1, zone as u64));
        }
    });
    let switches = result["switches"].as_array().unwrap().iter();
    let told: Vec<(u64, u64)> =
        switches.map(|it| (it["tick"].as_u64().unwrap(), it["zone"].as_u64().unwrap())).collect();
    assert!(told.len() > 1 && told.iter().all(|it| entered.contains(it)), "{told:?} {entered:?}");

    let one = sandbox.run(&["drive", "lane_change", "--hold-switches"]);
    assert_eq!(one.status.code(), Some(64));
    assert!(stderr(&one).contains("--hold-switches: the gains do not change along the path"));
    let late = drive("late", &["--hold-switches", "--set", "vehicle.steering_delay_s=0.1"]);
    assert_eq!(late.status.code(), Some(64));
    assert!(stderr(&late).contains("dead time"), "{}", stderr(&late));
    sandbox.assert_clean();
}

#[test]
fn plants_are_told_of_and_regions_and_margins_are_drawn() {
    let sandbox = Sandbox::new();
    let args = ["roundabout", "--gains", "3.4,21,1,0.84", "--speeds", "1.5,3.5"];
    let over = ["--over", "default", "--report", "pictures"];
    let said = json(&sandbox, &[&args[..], &over].concat());
    let plants = said["plants"].as_array().unwrap();
    assert_eq!(plants.len(), 9);
    let margin = |plant: usize, at: usize| {
        plants[plant]["speeds"][at][1][0]["additional_dead_time_s"].as_f64().unwrap()
    };
    // The file's vehicle is the first; 60 ms more of dead time leave 60 ms less for more.
    assert_eq!(plants[0]["speeds"][0][1][0], said["speeds"][0]["sets"][0]);
    for at in [0, 1] {
        let less_s = margin(0, at) - margin(2, at);
        assert!((less_s - 0.06).abs() < 1e-6, "{less_s}");
    }
    let late = &plants[1]["speeds"][0][1][0];
    assert!(late["certified"].is_null() && late["simulated"]["offset_m"].is_number(), "{late}");
    let faster = plants[8]["speeds"][0][0].as_f64().unwrap();
    assert!((faster - 2.25).abs() < 1e-12, "{faster}");

    let page = fs::read_to_string(sandbox.path("pictures/index.html")).unwrap();
    assert!(page.contains("What a certified region means"), "{page}");
    for name in ["region-roundabout-1-5", "region-roundabout-3-5", "additional-dead-time"] {
        let svg = fs::read_to_string(sandbox.path(&format!("pictures/{name}.svg"))).unwrap();
        assert!(svg.starts_with("<svg"), "{name}");
        assert!(!name.starts_with("region") || svg.contains("certain to come back"), "{name}");
    }
    fs::write(sandbox.path("pictures/mine.txt"), "keep").unwrap();
    let again = [&args[..], &["--report", "pictures"]].concat();
    refused(&sandbox, &again, &["--report pictures", "mine.txt", "name a new folder"]);
    refused(&sandbox, &["roundabout", "--over", "none.toml"], &["none.toml"]);
    let output = sandbox.run(&["certify", "roundabout", "--over", "default"]);
    assert!(stdout(&output).contains("on plants like this car"), "{}", stdout(&output));
}
