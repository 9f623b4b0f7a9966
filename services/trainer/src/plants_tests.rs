use config::{Layers, Parameters, RunConfig};
use rollout::Rollout;
use tracking::DriveRecord;

use super::{HELD_S, additional_dead_time, held_speed_mps, lacking_margin};

#[test]
fn a_speed_counts_that_is_held_and_not_the_peak_of_a_moment() {
    let mut speeds = vec![0.0; 100];
    speeds.extend(vec![4.0; 50]);
    speeds.extend(vec![1.2; 250]);
    speeds.extend(vec![1.5; 220]);
    assert_eq!(held_speed_mps(&speeds, 0.01, 0.5), 4.0);
    assert_eq!(held_speed_mps(&speeds, 0.01, 1.0), 1.5);
    assert_eq!(held_speed_mps(&speeds, 0.01, 2.5), 1.2);
    // A drive that is shorter than that holds its least speed.
    assert_eq!(held_speed_mps(&speeds, 0.01, 60.0), 0.0);
    assert_eq!(held_speed_mps(&[], 0.01, 1.0), 0.0);
}

#[test]
fn of_a_single_plant_those_that_are_drawn_lie_between_it_and_the_vehicle_s_file() {
    let late = |s: f64| config::PlantChange {
        add: [("steering_delay_s".to_owned(), s)].into(),
        ..config::PlantChange::default()
    };
    let drawn = |changes: &[config::PlantChange]| -> Vec<f64> {
        let mut random = crate::rng::Stream::new(1, 2);
        (0..20).map(|_| super::drawn(changes, &mut random).add["steering_delay_s"]).collect()
    };
    let of_one = drawn(&[late(0.1)]);
    assert!(of_one.iter().all(|it| (0.0..=0.1).contains(it)));
    assert!(of_one.iter().any(|it| *it < 0.03) && of_one.iter().any(|it| *it > 0.07));
    assert!(drawn(&[late(0.1), late(0.2)]).iter().all(|it| (0.1..=0.2).contains(it)));
}

#[test]
fn over_plants_a_set_without_margin_counts_as_worse_to_a_search() {
    let config = |over: &str| {
        let mut layers = Layers::maneuver("roundabout").unwrap();
        layers.set_tuner("test", "random").unwrap();
        layers.set(over).unwrap();
        layers.resolve().unwrap()
    };
    let over = config("over.by=mean");
    let fragile = Parameters::of(&[5.8, 11.0, 11.0, 0.98]);
    let steady = Parameters::of(&[5.8, 21.0, 21.0, 0.91]);
    assert!(lacking_margin(&over, &fragile) > 0.1 && lacking_margin(&over, &steady) == 0.0);
    // Sets that lack some margin are a little better by their drives.
    let recommended = |config: &RunConfig| {
        let mut tuner = crate::tuners::tuner("random", config);
        for _ in 0..12 {
            let ask = tuner.wanted(0).unwrap();
            let lacks = lacking_margin(config, &ask.parameters) > 0.1;
            tuner.tell(&ask, &DriveRecord::default(), if lacks { 0.5 } else { 0.6 });
        }
        let set = tuner.recommend(&|_, _| std::cmp::Ordering::Equal);
        lacking_margin(config, &set) > 0.1
    };
    assert!(!recommended(&over) && recommended(&config("over.by=nominal")));
}

/// Of the drives of some sets with noise, how many are bad, and how many are found fragile at the speed held for a while.
#[derive(Debug, Default, Clone, Copy)]
struct Found {
    bad: u32,
    good: u32,
    bad_found: u32,
    good_flagged: u32,
}

/// A car catches up from rest, much faster than its path says, and then drives steadily.
fn steady_drive(maneuver: &str, speed_mps: f64, delay_s: f64, lag_s: f64) -> RunConfig {
    let mut layers = Layers::maneuver(maneuver).unwrap();
    let pieces = match maneuver {
        "roundabout" => {
            "[{kind='straight',length_m=4.0},{kind='arc',radius_m=18.0,angle_deg=350.0},{kind='straight',length_m=100.0}]"
        }
        _ => {
            "[{kind='straight',length_m=5.0},{kind='cosine',length_m=18.0,offset_m=-3.5},{kind='straight',length_m=180.0}]"
        }
    };
    for set in [
        format!("path.pieces={pieces}"),
        format!("reference.speed_mps={speed_mps:?}"),
        format!("vehicle.steering_delay_s={delay_s:?}"),
        format!("vehicle.steering_lag_s={lag_s:?}"),
        "drive.loop_time_s=40.0".to_owned(),
        "controller.compensate_dead_time=false".to_owned(),
        "noise.position_sd_m=0.1".to_owned(),
    ] {
        layers.set(&set).unwrap();
    }
    layers.resolve().unwrap()
}

/// How a speed that is held for some time tells sets that shake from others, beside the highest speed of the drive:
/// `PATHTUNE_MARGIN=1` looks at every set of the grids, otherwise at one in so many.
#[test]
fn the_speed_that_is_held_finds_the_sets_that_shake_and_flags_fewer_of_the_others() {
    let every = std::env::var("PATHTUNE_MARGIN").map_or(97, |text| text.parse().unwrap());
    const HOLDS_S: [f64; 6] = [0.0, 0.5, 1.0, 2.0, 3.0, 5.0];
    let mut found = [Found::default(); HOLDS_S.len()];
    for maneuver in ["lane_change", "roundabout"] {
        for speed_mps in [1.2, 1.5, 3.5, 4.0] {
            for (delay_s, lag_s) in [(0.0, 0.0), (0.12, 0.08), (0.24, 0.27)] {
                let config = steady_drive(maneuver, speed_mps, delay_s, lag_s);
                let tick_s = config.drive.tick_s;
                let mut rollout = Rollout::new(&config);
                let grid = config.grid();
                for at in grid.positions().step_by(every) {
                    let set: Parameters = grid.set(at);
                    let mut speeds = Vec::new();
                    rollout.drive_with(set, None, |_, it| speeds.push(it.observation.speed_mps));
                    let mut off = Vec::new();
                    rollout.drive_with(set, Some(7), |tick, it| {
                        if tick as f64 * tick_s >= 25.0 {
                            off.push(it.decision.path_distance_m);
                        }
                    });
                    let is_bad = off.is_empty() || off.iter().any(|it| *it > 0.5);
                    for (hold_s, found) in HOLDS_S.into_iter().zip(&mut found) {
                        let speed_mps = held_speed_mps(&speeds, tick_s, hold_s);
                        let margin = additional_dead_time(&config, &set, speed_mps);
                        let is_flagged = margin.why_fragile().is_some();
                        *if is_bad { &mut found.bad } else { &mut found.good } += 1;
                        *if is_bad { &mut found.bad_found } else { &mut found.good_flagged } +=
                            u32::from(is_flagged);
                    }
                }
            }
        }
    }
    for (hold_s, it) in HOLDS_S.into_iter().zip(&found) {
        println!(
            "held {hold_s} s: found {} of {} bad ones, flagged {} of {} good ones",
            it.bad_found, it.bad, it.good_flagged, it.good
        );
    }
    let at = |hold_s: f64| found[HOLDS_S.iter().position(|it| *it == hold_s).unwrap()];
    let (peak, held) = (at(0.0), at(HELD_S));
    assert!(f64::from(held.bad_found) >= 0.95 * f64::from(peak.bad_found), "{held:?} {peak:?}");
    assert!(held.good_flagged < peak.good_flagged, "{held:?} {peak:?}");
}

/// A car of scale 1:10 that catches up from rest, changes its lane, and drives steadily.
fn steady_small_drive(law: &str, speed_mps: f64, delay_s: f64, lag_s: f64) -> RunConfig {
    let mut layers = Layers::maneuver("lane_change").unwrap();
    layers.set_vehicle("--vehicle", "f1tenth").unwrap();
    layers.set_law("--law", law).unwrap();
    let length_m = 45.0 * speed_mps;
    for set in [
        format!(
            "path.pieces=[{{kind='straight',length_m=1.0}},{{kind='cosine',length_m=4.0,offset_m=-0.4}},{{kind='straight',length_m={length_m:?}}}]"
        ),
        format!("reference.speed_mps={speed_mps:?}"),
        format!("vehicle.steering_delay_s={delay_s:?}"),
        format!("vehicle.steering_lag_s={lag_s:?}"),
        "drive.loop_time_s=40.0".to_owned(),
        "controller.compensate_dead_time=false".to_owned(),
    ] {
        layers.set(&set).unwrap();
    }
    layers.resolve().unwrap()
}

/// Below the limit of Δ that is scaled to a small car most of its sets shake, and above it hardly one does.
/// `PATHTUNE_SMALL_MARGIN=1` looks at every set of the grids, otherwise at one in so many, and prints bands of Δ.
#[test]
fn a_small_car_s_sets_shake_below_its_own_limit_of_the_additional_dead_time() {
    let every = std::env::var("PATHTUNE_SMALL_MARGIN").map_or(97, |text| text.parse().unwrap());
    const BANDS_MS: [f64; 11] =
        [0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 75.0, 100.0, 200.0, f64::INFINITY];
    let mut bands = [[0u32; 2]; BANDS_MS.len()];
    let (mut below, mut above) = ([0u32; 2], [0u32; 2]);
    for law in ["paper", "pure_pursuit", "stanley"] {
        for speed_mps in [1.0, 2.0, 3.0, 4.0] {
            for (delay_s, lag_s) in [(0.02, 0.0), (0.05, 0.03), (0.1, 0.05)] {
                let config = steady_small_drive(law, speed_mps, delay_s, lag_s);
                let far_m = 0.5 * config.vehicle.wheelbase_m / 2.875;
                let tick_s = config.drive.tick_s;
                let mut rollout = Rollout::new(&config);
                let grid = config.grid();
                for at in grid.positions().step_by(every) {
                    let set: Parameters = grid.set(at);
                    let mut speeds = Vec::new();
                    rollout.drive_with(set, None, |_, it| speeds.push(it.observation.speed_mps));
                    let mut off = Vec::new();
                    rollout.drive_with(set, Some(7), |tick, it| {
                        if tick as f64 * tick_s >= 25.0 {
                            off.push(it.decision.path_distance_m);
                        }
                    });
                    let is_far = off.is_empty() || off.iter().any(|it| *it > far_m);
                    let speed_mps = held_speed_mps(&speeds, tick_s, HELD_S);
                    let margin = additional_dead_time(&config, &set, speed_mps);
                    if margin.unknown.is_some() {
                        continue;
                    }
                    let margin_s = margin.additional_dead_time_s.unwrap_or(f64::INFINITY);
                    let band = BANDS_MS.iter().position(|it| 1000.0 * margin_s <= *it).unwrap();
                    let side = if margin.why_fragile().is_some() { &mut below } else { &mut above };
                    for count in [&mut bands[band], side] {
                        count[0] += u32::from(is_far);
                        count[1] += 1;
                    }
                }
            }
        }
    }
    for (most_ms, [far, all]) in BANDS_MS.iter().zip(&bands) {
        println!("Δ up to {most_ms} ms: {far} of {all} far from the path");
    }
    let share = |[far, all]: [u32; 2]| f64::from(far) / f64::from(all);
    println!("below the limit {below:?}, above it {above:?}");
    assert!(share(below) > 0.5 && share(above) < 0.08, "{below:?} {above:?}");
}
