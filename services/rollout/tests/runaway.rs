//! A vehicle whose accelerator is stuck drives on whatever it is told, but it steers: the reference keeps pace with it, so
//! that it stays near its path as long as there is path.
//!
//! `PATHTUNE_DRIVES` is the number of drives of each kind, `PATHTUNE_SEED` that of the first, and `PATHTUNE_GAINS=3,21,21,0.7` another set to drive with.

// A test reads what it is to drive.
#![allow(clippy::disallowed_methods)]

mod bends;

use bends::of_bends;
use config::{Parameters, RunConfig};
use ipc_types::Safety;
use rollout::{Fault, FaultyCar, Rollout};
use tracking::{Path, PathFollower};

fn drives(default: u64) -> u64 {
    std::env::var("PATHTUNE_DRIVES").map_or(default, |text| text.parse().unwrap())
}

/// The seed of the first drive.
fn first() -> u64 {
    std::env::var("PATHTUNE_SEED").map_or(0, |text| text.parse().unwrap())
}

fn gains(config: &RunConfig) -> Parameters {
    match std::env::var("PATHTUNE_GAINS") {
        Ok(text) => config.law.parse_sets(&text).unwrap()[0],
        Err(_) => Parameters::of(&[3.0, 21.0, 21.0, 0.7]),
    }
}

/// What became of a drive, from the fault on.
struct Story {
    /// The largest distance from the path before the vehicle came to its end, and at all.
    along_m: f64,
    farthest_m: f64,
    /// How far along the path it came, in wheelbases, and how fast it became.
    came_m: f64,
    fastest_mps: f64,
    stopped_for: u32,
}

fn drive(config: &RunConfig, stuck_mps: f64, from_s: f64, seed: u64) -> Story {
    let from = (from_s / config.drive.tick_s) as u64;
    let fault = Fault::StuckThrottle { speed_mps: stuck_mps };
    let car = FaultyCar::new(config, fault, from, u64::MAX);
    let path = Path::new(&config.path);
    let mut follower = PathFollower::new(&path, 0.0);
    let mut is_over = false;
    let mut story =
        Story { along_m: 0.0, farthest_m: 0.0, came_m: 0.0, fastest_mps: 0.0, stopped_for: 0 };
    let record = Rollout::around(car, config).drive_with(gains(config), Some(seed), |tick, it| {
        let at = it.observation.truth;
        let off_m = follower.distance_m(&path, at.x_m, at.y_m);
        story.came_m = follower.along_m(&path, at.x_m, at.y_m);
        is_over |= story.came_m >= path.length_m();
        if tick < from {
            return;
        }
        story.farthest_m = story.farthest_m.max(off_m);
        story.fastest_mps = story.fastest_mps.max(it.observation.speed_mps);
        if !is_over {
            story.along_m = story.along_m.max(off_m);
        }
    });
    Story { stopped_for: record.stopped_for, ..story }
}

#[test]
fn a_vehicle_that_runs_away_is_kept_near_its_path_as_long_as_there_is_path() {
    // In wheelbases: bends that the wheels can turn, and more of them than the drive has time for.
    let straight = (6.0, 0.0);
    let once = [straight, (8.0, 0.2), (4.0, 0.0), (5.0, -0.25), (5.0, 0.25)];
    let bends: Vec<(f64, f64)> = (0..6).flat_map(|_| once).chain([straight]).collect();
    for (vehicle, speed_mps, bound_m) in
        [("tesla_model_3_guarded", 1.5, 3.5), ("ackermann", 2.0, 3.5), ("f1tenth", 1.0, 0.6)]
    {
        let config = of_bends(vehicle, speed_mps, &bends, &["noise.enabled=true"]);
        let sharpest = 0.25 / config.vehicle.wheelbase_m;
        for times in [1.5, 2.0, 3.0, 4.0] {
            let stuck_mps = times * speed_mps;
            let lateral_mps2 = stuck_mps * stuck_mps * sharpest;
            let first = first();
            let stories: Vec<Story> = (0..drives(2))
                .map(|seed| {
                    drive(&config, stuck_mps, 4.0 + 0.35 * (seed % 20) as f64, first + seed)
                })
                .collect();
            let most = |of: fn(&Story) -> f64| stories.iter().map(of).fold(0.0, f64::max);
            let why = stories.iter().fold(0, |all, it| all | it.stopped_for);
            println!(
                "| {vehicle} | {speed_mps} | {stuck_mps} ({:.1}) | {lateral_mps2:.1} | {:.2} | {:.2} | {:.0} | {} |",
                most(|it| it.fastest_mps),
                most(|it| it.along_m),
                most(|it| it.farthest_m),
                most(|it| it.came_m) / config.vehicle.wheelbase_m,
                Safety::reason_names(why).join("+"),
            );
            for story in &stories {
                assert!(story.stopped_for & Safety::SPEED_IGNORED != 0, "{vehicle} at {stuck_mps}");
                // No tyre holds a car in a bend that asks for more.
                assert!(
                    story.along_m < bound_m || lateral_mps2 > 10.0,
                    "{vehicle} at {stuck_mps} m/s: {} m off its path",
                    story.along_m
                );
            }
        }
    }
}
