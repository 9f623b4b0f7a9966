//! The reference waits for a vehicle that does not follow: whole drives, in which the gear is not engaged for a while.

use config::{Layers, Parameters, RunConfig};
use rollout::Rollout;
use tracking::{DriveRecord, EndReason};

const PATH_MPS: f64 = 1.5;

/// A path of 40 m with a bend, for a car that does not move before `held_s`.
fn config(vehicle: &str, held_s: f64, sets: &[&str]) -> RunConfig {
    let mut layers = Layers::own_path();
    layers.set_vehicle("test", vehicle).unwrap();
    let path = "path.pieces=[{kind='straight',length_m=12.0},{kind='arc',radius_m=14.0,angle_deg=90.0},\
                {kind='straight',length_m=6.0}]";
    let held = format!("vehicle.gear_drive_s={held_s:?}");
    let common = [path, "drive.loop_time_s=36.0", &held, "vehicle.gear_engaged=false"];
    for set in common.iter().chain(sets) {
        layers.set(set).unwrap();
    }
    layers.resolve().unwrap()
}

const NEVER_WAITS: [&str; 2] = ["reference.wait_to_speed=inf", "reference.wait_to_s=inf"];

/// The drive, and its highest speed.
fn drive(config: &RunConfig, kv: f64) -> (DriveRecord, f64) {
    let mut highest_mps = 0.0f64;
    let parameters = Parameters::of(&[kv, 21.0, 21.0, 0.7]);
    let record = Rollout::new(config).drive_with(parameters, None, |_, tick| {
        highest_mps = highest_mps.max(tick.observation.speed_mps);
    });
    (record, highest_mps)
}

#[test]
fn a_car_that_was_held_arrives_and_never_drives_much_faster_than_the_path_says() {
    for (vehicle, held_s) in [("tesla_model_3", 2.0), ("ackermann", 8.0), ("f1tenth", 8.0)] {
        for kv in [0.68, 1.26, 1.84, 2.42, 3.0, 5.8] {
            let (record, highest_mps) = drive(&config(vehicle, held_s, &[]), kv);
            println!(
                "{vehicle}, {held_s} s, Kv {kv}: {highest_mps:.2} m/s, {} ticks",
                record.ticks
            );
            assert_eq!(record.reason, EndReason::Goal, "{vehicle} {kv}");
            assert!(highest_mps < 1.6 * PATH_MPS, "{vehicle} {kv}: {highest_mps}");
        }
        let (_, highest_mps) = drive(&config(vehicle, held_s, &NEVER_WAITS), 3.0);
        assert!(highest_mps > 2.5 * PATH_MPS, "without waiting {vehicle} drove {highest_mps}");
    }
}

#[test]
fn a_car_that_follows_is_hardly_waited_for() {
    for vehicle in ["tesla_model_3", "tesla_model_3_guarded", "ackermann", "f1tenth"] {
        for kv in [0.68, 1.26, 1.84, 2.42, 3.0] {
            let engaged = "vehicle.gear_engaged=true";
            let ticks = |sets: &[&str]| drive(&config(vehicle, 0.0, sets), kv).0.ticks as f64;
            let (with, without) =
                (ticks(&[engaged]), ticks(&[&[engaged][..], &NEVER_WAITS].concat()));
            assert!((with / without - 1.0).abs() < 0.01, "{vehicle} {kv}: {with} {without}");
        }
    }
}

#[test]
fn a_car_that_never_moves_ends_the_drive() {
    let (record, highest_mps) =
        drive(&config("ackermann", 60.0, &["reference.wait_limit_s=5.0"]), 3.0);
    assert_eq!((record.reason, highest_mps), (EndReason::Held, 0.0));
    assert!(!record.arrived() && record.progress == 0.0);
    // It waits for 5 s in all, after the 2 s or so in which the law does not ask for too much speed yet.
    assert!((500..900).contains(&record.ticks), "{}", record.ticks);
}

#[test]
fn the_paper_s_reference_waits_for_nobody() {
    for maneuver in ["lane_change", "roundabout", "circuit"] {
        let mut layers = Layers::maneuver(maneuver).unwrap();
        // The tightest bounds that there are.
        for set in
            ["wait_from_speed=1.001", "wait_to_speed=1.002", "wait_from_s=0.0", "wait_to_s=0.001"]
        {
            layers.set(&format!("reference.{set}")).unwrap();
        }
        let parameters = Parameters::of(&[3.0, 21.0, 21.0, 0.7]);
        let plain = Layers::maneuver(maneuver).unwrap().resolve().unwrap();
        let drive = |config: &RunConfig| rollout::rollout(config, parameters, Some(7));
        assert_eq!(drive(&layers.resolve().unwrap()), drive(&plain));
    }
}
