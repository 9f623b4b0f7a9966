//! The gate's watch over whole drives: it stops no healthy vehicle, and each faulty one in time.
//!
//! `PATHTUNE_DRIVES` is the number of drives of each kind.

// A test reads its number of drives, and writes the file of a path.
#![allow(clippy::disallowed_methods)]

mod bends;

use bends::own_path;
use config::{Layers, Parameters, RunConfig};
use ipc_types::Safety;
use rollout::{Fault, FaultyCar, Rollout};
use tracking::{DriveRecord, EndReason};

/// Numbers of drives: few by default.
fn drives(default: u64) -> u64 {
    std::env::var("PATHTUNE_DRIVES").map_or(default, |text| text.parse().unwrap())
}

fn maneuver(maneuver: &str, vehicle: &str, sets: &[&str]) -> RunConfig {
    let mut layers = Layers::maneuver(maneuver).unwrap();
    layers.set_vehicle("test", vehicle).unwrap();
    for set in sets {
        layers.set(set).unwrap();
    }
    layers.resolve().unwrap()
}

fn names(reasons: u32) -> String {
    Safety::reason_names(reasons).join("+")
}

/// Gains of the paper, which serve on paths of the size of any car.
fn gains() -> Parameters {
    Parameters::of(&[3.0, 21.0, 21.0, 0.7])
}

#[test]
fn healthy_vehicles_are_not_stopped() {
    let noise = ["noise.enabled=true"];
    let engaged = ["noise.enabled=true", "vehicle.gear_engaged=true"];
    let guarded = "tesla_model_3_guarded";
    for (name, config) in [
        ("lane_change guarded", maneuver("lane_change", guarded, &noise)),
        ("lane_change guarded engaged", maneuver("lane_change", guarded, &engaged)),
        ("roundabout guarded", maneuver("roundabout", guarded, &noise)),
        ("circuit guarded", maneuver("circuit", guarded, &noise)),
        ("smooth_lane guarded", maneuver("smooth_lane", guarded, &noise)),
        ("smooth_lane ackermann", maneuver("smooth_lane", "ackermann", &noise)),
        ("smooth_lane f1tenth", maneuver("smooth_lane", "f1tenth", &noise)),
        ("lane_change f1tenth", maneuver("lane_change", "f1tenth", &noise)),
        ("roundabout f1tenth", maneuver("roundabout", "f1tenth", &noise)),
        ("circuit f1tenth", maneuver("circuit", "f1tenth", &noise)),
        ("lane_change ackermann", maneuver("lane_change", "ackermann", &noise)),
        ("roundabout ackermann", maneuver("roundabout", "ackermann", &noise)),
        ("circuit ackermann", maneuver("circuit", "ackermann", &noise)),
        ("own path guarded", own_path(guarded, 1.5, &noise)),
        ("own path ackermann", own_path("ackermann", 2.0, &noise)),
        ("own path f1tenth", own_path("f1tenth", 1.5, &noise)),
    ] {
        let mut rollout = Rollout::new(&config);
        let (mut stops, mut slowed, mut farthest_m) = (0, 0, 0.0f64);
        let count = drives(3);
        let set = config.paper_set().unwrap_or(gains());
        let sets = match config.paper_rows().into_iter().find(|row| row.chosen) {
            Some(row) => config.sets_by_zone(&row.sets),
            None => vec![set],
        };
        let sets = if sets.len() == 1 { vec![set] } else { sets };
        let mut why = 0;
        for seed in 0..count {
            let record = rollout.drive_scheduled(&sets, Some(seed), |_, _| {});
            stops += u64::from(record.stopped_for != 0);
            slowed += u64::from(record.slowed_for & !Safety::STANDS != 0);
            why |= record.stopped_for | record.slowed_for;
            farthest_m = farthest_m.max(record.path_max_m);
        }
        println!(
            "{name}: {stops} of {count} stopped, {slowed} slowed down ({}), at most {farthest_m:.2} m off the path",
            names(why)
        );
        assert_eq!(stops, 0, "{name}: {}", names(why));
    }
}

/// Steering that can be told from noise: as a mean over about this time, beyond this angle.
const STEERED_OVER_S: f64 = 0.3;
const CLEAR_RAD: f64 = 0.02;

/// What became of a drive with a fault.
struct Story {
    record: DriveRecord,
    /// The distance from the path at which the fault begins, and the largest from then on.
    began_m: f64,
    path_max_m: f64,
    /// Seconds from the fault, or from the first movement after it, until the gate gives a reason.
    told_s: Option<f64>,
    /// How far off the path it was then.
    told_m: f64,
    /// The same time until there is any steering to see.
    steers_s: Option<f64>,
    /// From the fault until the vehicle is being stopped, and until it stands.
    stopping_s: Option<f64>,
    stands_s: Option<f64>,
}

fn drive_with(config: &RunConfig, fault: Fault, from_s: f64, seed: u64) -> Story {
    let from = (from_s / config.drive.tick_s) as u64;
    drive_car(config, FaultyCar::new(config, fault, from, u64::MAX), from, seed)
}

fn drive_car(config: &RunConfig, car: FaultyCar, from: u64, seed: u64) -> Story {
    let tick_s = config.drive.tick_s;
    let mut rollout = Rollout::around(car, config);
    let (mut began_m, mut path_max_m, mut told_m, mut driven_s) = (0.0, 0.0f64, 0.0, 0.0);
    let (mut told_s, mut stopping_s, mut stands_s) = (None, None, None);
    let (mut steers_s, mut steered_rad) = (None, 0.0);
    let crawls_mps = (0.2 * config.vehicle.wheelbase_m).max(0.3);
    let seed = config.noise.enabled.then_some(seed);
    let record = rollout.drive_with(gains(), seed, |tick, it| {
        if tick < from {
            began_m = it.decision.path_distance_m;
            return;
        }
        let since_s = (tick - from) as f64 * tick_s;
        path_max_m = path_max_m.max(it.decision.path_distance_m);
        if it.observation.speed_mps > 0.05 {
            driven_s += tick_s;
        }
        // Noise alone steers to and fro.
        steered_rad += tick_s / STEERED_OVER_S * (it.passed.steering_rad - steered_rad);
        if it.observation.speed_mps < crawls_mps {
            steered_rad = 0.0;
        }
        let set = |at: &mut Option<f64>, is: bool, now_s: f64| *at = at.or(is.then_some(now_s));
        if told_s.is_none() {
            told_m = path_max_m;
        }
        set(&mut told_s, it.gate.reasons & !Safety::ODOMETRY_JUMP != 0, driven_s);
        set(&mut steers_s, steered_rad.abs() > CLEAR_RAD, driven_s);
        set(&mut stopping_s, it.gate.is_stopped, since_s);
        set(&mut stands_s, it.gate.stands, since_s);
    });
    Story { record, began_m, path_max_m, told_s, told_m, steers_s, stopping_s, stands_s }
}

/// The largest of some times, with how many there are.
fn most(times: &[Option<f64>]) -> String {
    let there: Vec<f64> = times.iter().flatten().copied().collect();
    match there.iter().copied().reduce(f64::max) {
        Some(most) if there.len() == times.len() => format!("{most:5.2}"),
        Some(most) => format!("{most:5.2} ({} of {})", there.len(), times.len()),
        None => "never".to_owned(),
    }
}

/// How long the path is under way at this speed.
fn way_s(config: &RunConfig, speed_mps: f64) -> f64 {
    let points = config.path.points.windows(2);
    let lengths = points.map(|it| libm::hypot(it[1][0] - it[0][0], it[1][1] - it[0][1]));
    lengths.sum::<f64>() / speed_mps
}

#[test]
fn faulty_vehicles_are_stopped_in_time() {
    let noise = ["noise.enabled=true"];
    for (vehicle, speed_mps) in
        [("tesla_model_3_guarded", 1.5), ("ackermann", 2.0), ("f1tenth", 1.5)]
    {
        let config = own_path(vehicle, speed_mps, &noise);
        let way_s = way_s(&config, speed_mps);
        let by_m = 1.4 * config.vehicle.wheelbase_m / 2.875;
        let bound_m = if config.vehicle.wheelbase_m > 1.0 { 3.5 } else { 0.6 };
        // With what they may be stopped for, and whether that bounds how far they come: one that does not know where it is
        // brakes blindly; a throttle that is stuck and a car that goes on with its last command cannot
        // be stopped by commands. A vehicle that ignores all commands from the start stands, which is told.
        let stuck = Fault::StuckThrottle { speed_mps: 4.0 * speed_mps };
        for (name, fault, reasons, can_be_stopped) in [
            ("wrong sign", Fault::WrongSign, Safety::STEERING_REVERSED, true),
            ("stuck throttle", stuck, Safety::SPEED_IGNORED, false),
            ("ignores commands", Fault::IgnoresCommands, Safety::OF_THE_DRIVE, false),
            ("no steering", Fault::NoSteering, Safety::OF_THE_DRIVE, true),
            (
                "bent linkage",
                Fault::BentLinkage { gain: 0.15, offset_rad: 0.12 },
                Safety::OF_THE_DRIVE,
                true,
            ),
            ("point off", Fault::PointAhead { by_m }, 0, true),
            ("pose stands", Fault::PoseStands, Safety::POSE_STANDS, false),
        ] {
            for from in ["start", "way"] {
                let stories: Vec<Story> = (0..drives(2))
                    .map(|seed| {
                        let on_the_way_s = way_s * (0.15 + 0.025 * (seed % 20) as f64);
                        let from_s = if from == "start" { 0.0 } else { on_the_way_s };
                        drive_with(&config, fault, from_s, seed)
                    })
                    .collect();
                let times = |of: fn(&Story) -> Option<f64>| -> String {
                    most(&stories.iter().map(of).collect::<Vec<_>>())
                };
                let all = |of: fn(&DriveRecord) -> u32| {
                    names(stories.iter().fold(0, |all, it| all | of(&it.record)))
                };
                let mut ends = std::collections::BTreeMap::new();
                for story in &stories {
                    *ends.entry(format!("{:?}", story.record.reason)).or_insert(0) += 1;
                }
                // From when on there is any steering to see, and how much later it is told.
                let later = |it: &Story| Some(it.told_s? - it.steers_s?);
                println!(
                    "| {vehicle} | {name} | {from} | {:.2} | {:.2} | {} | {} | {} | {} | {} | {ends:?} | {} | {} |",
                    stories.iter().map(|it| it.path_max_m).fold(0.0, f64::max),
                    stories.iter().map(|it| it.told_m).fold(0.0, f64::max),
                    times(|it| it.told_s),
                    times(|it| it.steers_s),
                    most(&stories.iter().map(later).collect::<Vec<_>>()),
                    times(|it| it.stopping_s),
                    times(|it| it.stands_s),
                    all(|it| it.stopped_for),
                    all(|it| it.slowed_for),
                );
                let stands = fault == Fault::IgnoresCommands && from == "start";
                for Story { record, began_m, path_max_m, told_m, .. } in &stories {
                    let what = format!("{vehicle}, {name} from the {from}: {record:?}");
                    assert!(!can_be_stopped || *path_max_m < bound_m, "{what}: {path_max_m} m");
                    if fault == Fault::WrongSign {
                        // Wheels that are turned in a bend need a second to come to the other side, and until then no
                        // steering is the wrong way round; a car that is off its path in the bend goes on from there.
                        let known_m = 0.5f64.max(began_m + 0.25);
                        assert!(*told_m < known_m, "{what}: told at {told_m} m, after {began_m} m");
                    }
                    if stands {
                        assert_eq!(record.reason, EndReason::Held, "{what}");
                        assert_eq!(record.slowed_for, Safety::STANDS, "{what}");
                    } else if reasons != 0 {
                        assert_eq!(record.reason, EndReason::Stopped, "{what}");
                        // What a fault in the middle of a bend looks like at first, depends on the bend.
                        let is_known = from == "start" || fault == Fault::PoseStands;
                        let reasons = if is_known { reasons } else { Safety::OF_THE_DRIVE };
                        assert!(record.stopped_for & reasons != 0, "{what}");
                    }
                }
            }
        }
    }
}

/// A contact that is loose: the fault is there for half of the time. Either the vehicle is stopped, or it stays near its
/// path all the same.
#[test]
fn faults_that_come_and_go_do_not_go_unnoticed() {
    let noise = ["noise.enabled=true"];
    for (vehicle, speed_mps) in
        [("tesla_model_3_guarded", 1.5), ("ackermann", 2.0), ("f1tenth", 1.5)]
    {
        let config = own_path(vehicle, speed_mps, &noise);
        // One that nobody notices keeps within the limit of the distance from the path.
        let is_large = config.vehicle.wheelbase_m > 1.0;
        let (bound_m, near_m) = if is_large { (3.5, 1.0) } else { (0.6, 0.35) };
        let way_s = way_s(&config, speed_mps);
        for (name, fault) in [
            ("wrong sign", Fault::WrongSign),
            ("no steering", Fault::NoSteering),
            ("bent linkage", Fault::BentLinkage { gain: 0.15, offset_rad: 0.12 }),
        ] {
            for half_s in [0.2, 0.5, 1.0] {
                let in_turn = (half_s / config.drive.tick_s) as u64;
                let (mut stopped, mut farthest_m, mut unnoticed_m, mut why) =
                    (0, 0.0f64, 0.0f64, 0);
                for seed in 0..drives(2) {
                    let from_s = way_s * (0.15 + 0.025 * (seed % 20) as f64);
                    let from = (from_s / config.drive.tick_s) as u64;
                    let car = FaultyCar::in_turn(&config, fault, from, in_turn);
                    let story = drive_car(&config, car, from, seed);
                    farthest_m = farthest_m.max(story.path_max_m);
                    match story.record.stopped_for {
                        0 => unnoticed_m = unnoticed_m.max(story.path_max_m),
                        reasons => (stopped, why) = (stopped + 1, why | reasons),
                    }
                }
                println!(
                    "| {vehicle} | {name} for {half_s} s in turn | {stopped} stopped ({}) | {farthest_m:.2} | \
                     not stopped: {unnoticed_m:.2} |",
                    names(why)
                );
                let what = format!("{vehicle}, {name} for {half_s} s in turn");
                assert!(farthest_m < bound_m, "{what}: {farthest_m} m");
                assert!(unnoticed_m < near_m, "{what}: {unnoticed_m} m, and nobody noticed");
            }
        }
    }
}

/// Something holds it that no file states, such as a gear: that is told, the reference waits, and it arrives.
#[test]
fn a_vehicle_that_is_held_for_eight_seconds_is_told_and_arrives() {
    let noise = ["noise.enabled=true", "vehicle.gear_engaged=true"];
    for (vehicle, speed_mps) in
        [("tesla_model_3_guarded", 1.5), ("ackermann", 2.0), ("f1tenth", 1.5)]
    {
        let config = own_path(vehicle, speed_mps, &noise);
        let ticks = (8.0 / config.drive.tick_s) as u64;
        let (mut highest_mps, mut farthest_m) = (0.0f64, 0.0f64);
        for seed in 0..drives(3) {
            let car = FaultyCar::new(&config, Fault::Held, 0, ticks);
            let record = Rollout::around(car, &config).drive_with(gains(), Some(seed), |_, it| {
                highest_mps = highest_mps.max(it.observation.speed_mps);
            });
            assert_eq!(record.reason, EndReason::Goal, "{vehicle}: {record:?}");
            assert_eq!((record.stopped_for, record.slowed_for), (0, Safety::STANDS), "{vehicle}");
            farthest_m = farthest_m.max(record.path_max_m);
        }
        println!(
            "{vehicle}, held for 8 s: at most {highest_mps:.2} m/s on a path for {speed_mps} m/s, {farthest_m:.2} m off"
        );
        assert!(highest_mps < 1.6 * speed_mps, "{vehicle}: {highest_mps} m/s");
    }
}

#[test]
fn a_lag_that_no_file_states_stops_no_vehicle() {
    let noise = ["noise.enabled=true", "vehicle.gear_engaged=true"];
    for (vehicle, speed_mps, lag) in
        [("tesla_model_3_guarded", 1.5, 0.15), ("ackermann", 2.0, 0.15), ("f1tenth", 1.5, 0.05)]
    {
        let config = own_path(vehicle, speed_mps, &noise);
        let mut plant = config.clone();
        plant.vehicle.steering_delay_s += lag;
        plant.vehicle.steering_lag_s += lag;
        plant.vehicle.steering_gain *= 0.9;
        plant.vehicle.steering_offset_rad += 0.02;
        let car = FaultyCar::new(&plant, Fault::None, 0, 0);
        let mut rollout = Rollout::around(car, &config);
        let (mut why, mut off_m) = (0, 0.0f64);
        for seed in 0..drives(3) {
            let record = rollout.drive(gains(), Some(seed));
            why |= record.stopped_for | record.slowed_for;
            off_m = off_m.max(record.path_max_m);
        }
        println!("{vehicle}, lag {lag}: {}, at most {off_m:.2} m off", names(why));
        assert_eq!(why & Safety::OF_THE_DRIVE, 0, "{vehicle}: {}", names(why));
    }
}
