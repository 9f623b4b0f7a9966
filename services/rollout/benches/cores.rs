//! What the pure cores cost, one by one: the work of a tick without any pipeline around it.
//!
//! `rollout_tick` is all of a tick; what stands above it should add up to about as much.

use config::{ChannelScale, Envelope, Layers, Limit, MadeFor, Parameters, Promise, RunConfig};
use controller::clock::Phase;
use controller::{ControlLaw, DriveController, Seen, Sight};
use divan::counter::ItemsCount;
use divan::{Bencher, black_box};
use rollout::Rollout;
use simulator::SimulatedVehicle;
use supervisor::{Movement, Passed, RawCommand, State, Watch};
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

/// What the gate is told in each tick of a drive: movement, where the reference is, and the law's command.
type Told = (Movement, f64, RawCommand);

/// A drive in the roundabout without noise, tick by tick as the gate of this configuration sees it. Nothing stops it.
fn driven(config: &RunConfig) -> Vec<Told> {
    let (mut car, mut drive) = (SimulatedVehicle::new(config), DriveController::new(config));
    car.reset(config.path.start.into(), None);
    drive.reset(parameters(), config.ticks());
    let mut gate = Watch::new(config);
    let mut ticks = Vec::new();
    for tick in 0..config.ticks() {
        let it = car.observe();
        let (pose, speed_mps, yaw_rate_radps) = (it.measured, it.speed_mps, it.yaw_rate_radps);
        let movement = Movement { pose, speed_mps, yaw_rate_radps };
        let seen = Seen {
            measured: pose,
            speed_mps,
            yaw_rate_radps,
            truth: Some(it.truth),
            collision: false,
        };
        let decision = drive.tick(Phase::from(tick), seen);
        let controller::RawCommand { speed_mps, yaw_rate_radps, steering_rad } = decision.command;
        let wanted = RawCommand { speed_mps, yaw_rate_radps, steering_rad };
        let told = (movement, decision.reference_along_m, wanted);
        let passed = gated(&mut gate, tick, told);
        car.step(passed.speed_mps, passed.steering_rad);
        ticks.push(told);
    }
    assert_eq!((gate.state(), gate.safety().own), (State::Normal, 0), "the gate stopped the car");
    ticks
}

/// A tick of the gate.
fn gated(gate: &mut Watch, tick: u64, (movement, along_m, wanted): Told) -> Passed {
    gate.see(tick, movement, true);
    gate.follow(along_m);
    gate.command(0.01, 0, Some(wanted))
}

/// What gate and watch cost in a tick of a whole drive: items are ticks, so 20 Mitem/s are 50 ns. Beside the paper's car, with
/// nothing but the gate, the same in an envelope; as an envelope has it without being asked, with the response watched, too;
/// the guarded car; and that one without what it has beyond the paper's. An envelope may cost 100 ns, distance, heading and
/// answers 40.
#[divan::bench(
    args = ["nothing", "envelope", "envelope and response", "guarded", "guarded, unwatched"],
    sample_size = 1,
)]
fn gate_in_a_drive(bencher: Bencher, watched: &str) {
    let is_guarded = watched.starts_with("guarded");
    let vehicle = if is_guarded { "tesla_model_3_guarded" } else { "tesla_model_3" };
    let mut config = config("roundabout", vehicle);
    if watched.starts_with("envelope") {
        config.envelope = Some(Box::new(wide()));
    }
    let safety = &mut config.vehicle.safety;
    if watched == "guarded, unwatched" {
        safety.path_distance_limit_m = Limit::Is(f64::INFINITY);
        safety.path_heading_limit_rad = Limit::Is(f64::INFINITY);
    }
    if matches!(watched, "envelope" | "guarded, unwatched") {
        safety.watch_response = config::Watched::Off;
    }
    let (ticks, new) = (driven(&config), Watch::new(&config));
    bencher.counter(ItemsCount::new(ticks.len())).bench_local(move || {
        let mut gate = new.clone();
        for (tick, told) in (0..).zip(&ticks) {
            black_box(gated(&mut gate, tick, black_box(*told)));
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
        made_for: MadeFor::of(&config("roundabout", "tesla_model_3"), Vec::new()),
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

/// A tick of a whole drive with pure pursuit by how the car steers: at once, late with a law that does not know it, and
/// late with a law that is shown where the car will be.
#[divan::bench(args = ["in time", "late", "late, compensated"], sample_size = 1)]
fn tick_by_steering(bencher: Bencher, steering: &str) {
    let mut layers = Layers::maneuver("smooth_lane").expect("a preset");
    layers.set("law_preset=pure_pursuit").expect("a law");
    layers
        .set(&format!("controller.compensate_dead_time={}", steering.ends_with("compensated")))
        .expect("a key");
    if steering != "in time" {
        for set in ["steering_delay_s=0.2", "steering_lag_s=0.15", "speed_delay_s=0.1"] {
            layers.set(&format!("vehicle.{set}")).expect("a key");
        }
    }
    let config = layers.resolve().expect("the presets are sound");
    let set = config.textbook_sets()[0].parameters;
    let mut rollout = Rollout::new(&config);
    let ticks = rollout.drive(set, None).ticks;
    bencher
        .counter(ItemsCount::new(ticks))
        .bench_local(move || rollout.drive(black_box(set), None));
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
