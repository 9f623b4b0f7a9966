//! Certificates: what is said of gains before they are driven, as a file, and verified by itself.

mod support;

use std::fs;
use std::process::Output;

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
