//! What the pure cores cost, one by one: the work of a tick without any pipeline around it.
//!
//! `rollout_tick` is all of a tick; what stands above it should add up to about as much.

use config::{ChannelScale, Envelope, Layers, MadeFor, Parameters, Promise, RunConfig};
use controller::clock::Phase;
use controller::{ControlLaw, DriveController, Seen, Sight};
use divan::counter::ItemsCount;
use divan::{Bencher, black_box};
use rollout::Rollout;
use simulator::SimulatedVehicle;
use supervisor::{Movement, RawCommand, Watch};
use tracking::{
    DriveRecord, Objective, PathFollower, Pose, Reference, ZoneTracker, tracking_error,
};
use trainer::Training;

fn main() {
    divan::main();
}

const MANEUVERS: [&str; 3] = ["lane_change", "roundabout", "circuit"];

fn config(maneuver: &str, vehicle: &str) -> RunConfig {
    let mut layers = Layers::maneuver(maneuver).expect("a preset");
    layers.set_vehicle("bench", vehicle).expect("a preset");
    layers.resolve().expect("the presets are sound")
}

fn parameters() -> Parameters {
    Parameters::of(&[3.0, 21.0, 21.0, 0.7])
}

fn pose() -> Pose {
    Pose { x_m: 1.0, y_m: 0.1, yaw_rad: 0.02 }
}

#[divan::bench]
fn error_in_the_vehicle_frame(bencher: Bencher) {
    let reference = Pose { x_m: 1.5, y_m: -0.1, yaw_rad: 0.3 };
    bencher.bench(|| tracking_error(black_box(reference), black_box(pose())));
}

#[divan::bench(args = MANEUVERS)]
fn reference_advances(bencher: Bencher, maneuver: &str) {
    let config = config(maneuver, "tesla_model_3");
    let (mut reference, mut tick) = (Reference::new(&config), 0);
    bencher.bench_local(move || {
        tick = (tick + 1) % config.ticks();
        if tick == 0 {
            reference.reset();
        }
        reference.advance(tick as f64, black_box(pose()))
    });
}

#[divan::bench]
fn control_law(bencher: Bencher) {
    let config = config("lane_change", "tesla_model_3");
    let mut law = ControlLaw::new(&config);
    let reference = Reference::new(&config);
    let reference_pose = Pose { x_m: 1.5, y_m: -0.1, yaw_rad: 0.3 };
    let sight = Sight::new(&config, &reference, 0.0, reference_pose, pose(), 1.0, 0.1);
    let parameters = parameters();
    bencher.bench_local(move || law.command(black_box(&parameters), black_box(&sight)));
}

#[divan::bench]
fn controller_tick(bencher: Bencher) {
    let config = config("roundabout", "tesla_model_3");
    let mut drive = DriveController::new(&config);
    let mut tick = config.ticks();
    let seen = Seen {
        measured: pose(),
        speed_mps: 1.0,
        yaw_rate_radps: 0.1,
        truth: Some(pose()),
        collision: false,
    };
    bencher.bench_local(move || {
        tick += 1;
        if tick >= config.ticks() {
            drive.reset(parameters(), config.ticks());
            tick = 0;
        }
        drive.tick(Phase::from(tick), black_box(seen))
    });
}

#[divan::bench(args = ["tesla_model_3", "tesla_model_3_guarded"])]
fn gate_and_watch(bencher: Bencher, vehicle: &str) {
    let mut watch = Watch::new(&config("lane_change", vehicle));
    let wanted = RawCommand { speed_mps: 2.0, yaw_rate_radps: 0.1, steering_rad: 0.05 };
    let movement = Movement { pose: pose(), speed_mps: 2.0, yaw_rate_radps: 0.1 };
    let mut tick = 0;
    bencher.bench_local(move || {
        tick += 1;
        watch.see(tick, black_box(movement), true);
        watch.command(0.01, 0, Some(black_box(wanted)))
    });
}

/// What the watch costs in a whole drive, tick by tick as the gate saw it: with and without distance, heading and answers
/// watched. The difference may be 40 ns.
#[divan::bench(args = [false, true], sample_size = 1)]
fn watch_in_a_drive(bencher: Bencher, is_on: bool) {
    let mut layers = Layers::maneuver("roundabout").expect("a preset");
    layers.set_vehicle("bench", "tesla_model_3_guarded").expect("a preset");
    if !is_on {
        for set in [
            "vehicle.safety.path_distance_limit_m=inf",
            "vehicle.safety.path_heading_limit_rad=inf",
            "vehicle.safety.watch_response=\"off\"",
        ] {
            layers.set(set).expect("a key");
        }
    }
    let config = layers.resolve().expect("the presets are sound");
    let (mut car, mut drive) = (SimulatedVehicle::new(&config), DriveController::new(&config));
    car.reset(config.path.start.into(), None);
    drive.reset(parameters(), config.ticks());
    let mut gate = Watch::new(&config);
    let mut ticks = Vec::new();
    for tick in 0..config.ticks() {
        let it = car.observe();
        let movement = Movement {
            pose: it.measured,
            speed_mps: it.speed_mps,
            yaw_rate_radps: it.yaw_rate_radps,
        };
        let seen = Seen {
            measured: it.measured,
            speed_mps: it.speed_mps,
            yaw_rate_radps: it.yaw_rate_radps,
            truth: Some(it.truth),
            collision: false,
        };
        let decision = drive.tick(Phase::from(tick), seen);
        let wanted = RawCommand {
            speed_mps: decision.command.speed_mps,
            yaw_rate_radps: decision.command.yaw_rate_radps,
            steering_rad: decision.command.steering_rad,
        };
        ticks.push((movement, decision.reference_along_m, wanted));
        gate.see(tick, movement, true);
        gate.follow(decision.reference_along_m);
        let passed = gate.command(0.01, 0, Some(wanted));
        car.step(passed.speed_mps, passed.steering_rad);
    }
    let new = Watch::new(&config);
    bencher.counter(ItemsCount::new(ticks.len())).bench_local(move || {
        let mut watch = new.clone();
        for (tick, (movement, along_m, wanted)) in ticks.iter().enumerate() {
            watch.see(tick as u64, black_box(*movement), true);
            watch.follow(*along_m);
            black_box(watch.command(0.01, 0, Some(*wanted)));
        }
    });
}

/// An envelope that no drive leaves.
fn wide() -> Envelope {
    let of = |(index, (kind, over_s)): (usize, (&str, f64))| {
        let numbers = if index < 2 { 100 } else { 1 };
        let (mean, sd) = (vec![0.0; numbers], vec![1.0; numbers]);
        ChannelScale { kind: kind.to_owned(), over_s, limit: 1e9, mean, sd }
    };
    Envelope {
        made_for: MadeFor::of(&config("lane_change", "tesla_model_3"), Vec::new()),
        promise: Promise {
            alpha: 0.01,
            delta: 0.01,
            scaled_on: 500,
            threshold_on: 500,
            above: 0,
            left_out: 0,
            varied: String::new(),
        },
        threshold: 1.0,
        channels: Envelope::CHANNELS.into_iter().enumerate().map(of).collect(),
        scores: Vec::new(),
    }
}

/// As `gate_and_watch` with the paper's car, which does as it is told here, so that nothing stops it: with no other watch,
/// with an envelope, and as an envelope has it without being asked, with the response watched, too.
#[divan::bench(args = ["nothing", "envelope", "envelope and response"])]
fn gate_in_an_envelope(bencher: Bencher, held: &str) {
    let mut config = config("lane_change", "tesla_model_3");
    config.envelope = (held != "nothing").then(|| Box::new(wide()));
    if held == "envelope" {
        config.vehicle.safety.watch_response = config::Watched::Off;
    }
    let mut watch = Watch::new(&config);
    let yaw_rate_radps = 2.0 * 0.05_f64.tan() / config.vehicle.wheelbase_m;
    let wanted = RawCommand { speed_mps: 2.0, yaw_rate_radps: 0.1, steering_rad: 0.05 };
    let mut tick = 0;
    bencher.bench_local(move || {
        tick += 1;
        let at = Pose { x_m: 0.02 * tick as f64, ..pose() };
        watch.see(tick, black_box(Movement { pose: at, speed_mps: 2.0, yaw_rate_radps }), true);
        watch.follow(black_box(1.0));
        watch.command(0.01, 0, Some(black_box(wanted)))
    });
}

#[divan::bench]
fn zone(bencher: Bencher) {
    let mut zones = ZoneTracker::new(&config("circuit", "tesla_model_3"));
    bencher.bench_local(move || zones.update(black_box(pose()), black_box(1.0)));
}

#[divan::bench(args = ["tesla_model_3", "tesla_model_3_dynamic"])]
fn vehicle_step(bencher: Bencher, vehicle: &str) {
    let mut car = SimulatedVehicle::new(&config("lane_change", vehicle));
    car.reset(Pose::default(), None);
    bencher.bench_local(move || {
        car.step(black_box(2.0), black_box(0.05));
        car.observe()
    });
}

/// A whole drive, counted in ticks.
#[divan::bench(args = MANEUVERS, sample_size = 1)]
fn rollout_tick(bencher: Bencher, maneuver: &str) {
    let config = config(maneuver, "tesla_model_3");
    let mut rollout = Rollout::new(&config);
    bencher
        .counter(ItemsCount::new(config.ticks()))
        .bench_local(move || rollout.drive(black_box(parameters()), None));
}

/// One tick of a fleet as the pipeline makes it, stage by stage, without the pipeline: against `rollout_tick`, what it
/// costs that a fleet does not fit into the nearest cache.
#[divan::bench(args = [1, 16, 64])]
fn fleet_tick(bencher: Bencher, fleet: usize) {
    let config = config("roundabout", "tesla_model_3");
    let mut cars = vec![SimulatedVehicle::new(&config); fleet];
    let mut drives = vec![DriveController::new(&config); fleet];
    let mut watches = vec![Watch::new(&config); fleet];
    let (mut commands, mut tick) = (vec![(0.0, 0.0); fleet], config.ticks());
    bencher.counter(ItemsCount::new(fleet)).bench_local(move || {
        tick += 1;
        if tick >= config.ticks() {
            cars.iter_mut().for_each(|car| car.reset(config.path.start.into(), None));
            drives.iter_mut().for_each(|drive| drive.reset(parameters(), config.ticks()));
            watches = vec![Watch::new(&config); fleet];
            tick = 0;
        }
        let mut seen = Vec::with_capacity(fleet);
        for (car, (speed_mps, steering_rad)) in cars.iter_mut().zip(&commands) {
            car.step(*speed_mps, *steering_rad);
            seen.push(car.observe());
        }
        let mut wanted = Vec::with_capacity(fleet);
        for (drive, seen) in drives.iter_mut().zip(&seen) {
            let seen = Seen {
                measured: seen.measured,
                speed_mps: seen.speed_mps,
                yaw_rate_radps: seen.yaw_rate_radps,
                truth: Some(seen.truth),
                collision: false,
            };
            let command = drive.tick(Phase::from(tick), seen).command;
            let (yaw_rate_radps, steering_rad) = (command.yaw_rate_radps, command.steering_rad);
            wanted.push(RawCommand { speed_mps: command.speed_mps, yaw_rate_radps, steering_rad });
        }
        for (index, watch) in watches.iter_mut().enumerate() {
            let (pose, seen) = (seen[index].measured, seen[index]);
            let movement =
                Movement { pose, speed_mps: seen.speed_mps, yaw_rate_radps: seen.yaw_rate_radps };
            watch.see(tick, movement, true);
            let passed = watch.command(0.01, 0, Some(wanted[index]));
            commands[index] = (passed.speed_mps, passed.steering_rad);
        }
    });
}

/// The distance from the path, which every tick of a drive measures.
#[divan::bench(args = MANEUVERS)]
fn distance_from_the_path(bencher: Bencher, maneuver: &str) {
    let config = config(maneuver, "tesla_model_3");
    let reference = Reference::new(&config);
    let mut follower = PathFollower::new(reference.path(), 0.0);
    let path = reference.path();
    bencher.bench_local(|| follower.distance_m(path, black_box(1.0), black_box(0.1)));
}

/// A step of Q-learning after a drive, with all that a training keeps of it.
#[divan::bench]
fn training_step(bencher: Bencher) {
    let mut config = config("lane_change", "tesla_model_3");
    config.run.memo = false;
    config.run.alphas = vec![0.5];
    let drive = DriveRecord {
        mean_abs_along_m: 0.3,
        mean_abs_cross_m: 0.2,
        mean_abs_heading_rad: 0.1,
        along_mse_m2: 0.4,
        cross_mse_m2: 0.1,
        ticks: 500,
        trace: 1,
        ..DriveRecord::default()
    };
    let new = move || Training::new(&config, Objective::new(&config));
    let (mut training, mut step) = (new(), 0);
    bencher.bench_local(move || {
        if training.is_finished() {
            (training, step) = (new(), 0);
        }
        training.take(0, step, black_box(drive));
        step += 1;
    });
}
