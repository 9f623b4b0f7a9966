//! How a vehicle drives: its deviation from the path, and its response to commands.

use config::{Layers, RunConfig};
use ipc_types::{Command, Safety};
use supervisor::{Action, Deviation, Movement, RawCommand, Response, State, Watch};
use tracking::Pose;

const TICK_S: f64 = 0.01;

/// A straight of 50 m along x, and the guarded car.
fn config(sets: &[&str]) -> RunConfig {
    let mut layers = Layers::maneuver("lane_change").unwrap();
    layers.set_vehicle("test", "tesla_model_3_guarded").unwrap();
    layers.set("path.pieces=[{kind='straight',length_m=50.0}]").unwrap();
    layers.set("vehicle.gear_engaged=true").unwrap();
    for set in sets {
        layers.set(set).unwrap();
    }
    layers.resolve().unwrap()
}

fn pose(x_m: f64, y_m: f64, yaw_rad: f64) -> Pose {
    Pose { x_m, y_m, yaw_rad }
}

fn deviation_faults(config: &RunConfig, poses: impl Iterator<Item = Pose>) -> u32 {
    let mut deviation = Deviation::new(config).unwrap();
    poses.for_each(|pose| deviation.see(pose));
    deviation.faults()
}

#[test]
fn distance_and_heading_are_limited_as_means() {
    let config = config(&[]);
    let stay = |at: Pose| std::iter::repeat_n(at, 10);
    let check = |at: Pose, wanted: u32| assert_eq!(deviation_faults(&config, stay(at)), wanted);
    check(pose(10.0, 2.99, 0.0), 0);
    check(pose(10.0, -3.01, 0.0), Safety::PATH_DISTANCE);
    check(pose(53.1, 0.0, 0.0), Safety::PATH_DISTANCE);
    check(pose(10.0, 0.0, -0.79), 0);
    check(pose(10.0, 0.0, 0.81), Safety::PATH_HEADING);
    // A yaw that has gone around, or wraps around within a mean, is the same.
    check(pose(10.0, 0.0, std::f64::consts::TAU), 0);
    let wrapping = (0..10).map(|tick| {
        let yaw_rad = std::f64::consts::PI - 0.01 + 0.002 * f64::from(tick);
        pose(10.0, 4.0, tracking::wrap_angle(yaw_rad))
    });
    assert_eq!(deviation_faults(&config, wrapping), Safety::PATH_DISTANCE | Safety::PATH_HEADING);
    // Less than a mean says nothing, and neither do single poses that are far off.
    assert_eq!(deviation_faults(&config, stay(pose(10.0, 9.0, 0.0)).take(9)), 0);
    let noisy = (0..10).map(|tick| pose(10.0, if tick % 2 == 0 { 5.0 } else { -5.0 }, 0.0));
    assert_eq!(deviation_faults(&config, noisy), 0);
}

#[test]
fn limits_scale_with_the_wheelbase_and_with_noise_and_are_off_for_the_paper() {
    let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-12, "{a} {b}");
    near(config(&[]).path_distance_limit_m(), 3.0);
    near(
        config(&["vehicle.wheelbase_m=0.575", "vehicle.tracked_point_m=0.1"])
            .path_distance_limit_m(),
        0.6,
    );
    near(config(&["noise.enabled=true"]).path_distance_limit_m(), 3.1);
    near(config(&["noise.enabled=true"]).path_heading_limit_rad(), 0.888);
    near(config(&["vehicle.safety.path_distance_limit_m=2"]).path_distance_limit_m(), 2.0);
    let paper = Layers::maneuver("lane_change").unwrap().resolve().unwrap();
    assert!(Deviation::new(&paper).is_none() && Response::new(&paper).is_none());
    let off = config(&["vehicle.safety.watch_response='off'"]);
    assert!(Response::new(&off).is_none() && Deviation::new(&off).is_some());
    let mut layers = Layers::maneuver("lane_change").unwrap();
    let wrong = layers.set("vehicle.safety.path_distance_limit_m='wide'");
    assert!(wrong.is_err() || layers.resolve().is_err());
}

#[test]
fn a_vehicle_that_was_lost_is_looked_for_near_the_reference() {
    let mut deviation = Deviation::new(&config(&[])).unwrap();
    let see = |deviation: &mut Deviation| {
        (0..10).for_each(|_| deviation.see(pose(30.0, 4.0, 0.0)));
        deviation.faults()
    };
    assert_eq!(see(&mut deviation), Safety::PATH_DISTANCE);
    deviation.lose();
    assert_eq!((deviation.faults(), see(&mut deviation)), (0, 0));
    deviation.look_near(30.0);
    assert_eq!(see(&mut deviation), Safety::PATH_DISTANCE);
}

#[test]
fn a_vehicle_that_was_rearmed_beside_its_path_may_return_to_it() {
    let config = config(&[]);
    let rearmed_at = |y_m: f64| {
        let mut deviation = Deviation::new(&config).unwrap();
        deviation.lose();
        deviation.rearm();
        deviation.look_near(30.0);
        (0..10).for_each(|_| deviation.see(pose(30.0, y_m, 0.0)));
        deviation
    };
    let see = |deviation: &mut Deviation, y_m: f64| {
        (0..10).for_each(|_| deviation.see(pose(30.0, y_m, 0.0)));
        deviation.faults()
    };
    // The limit, 3 m, counts from where it was rearmed.
    let mut beside = rearmed_at(5.0);
    assert_eq!((beside.faults(), see(&mut beside, 7.99)), (0, 0));
    assert_eq!(see(&mut beside, 8.01), Safety::PATH_DISTANCE);
    // It shrinks while the vehicle returns, and does not grow again.
    assert_eq!(see(&mut beside, 4.0), 0);
    assert_eq!((see(&mut beside, 6.99), see(&mut beside, 7.01)), (0, Safety::PATH_DISTANCE));
    // Once it is back, the limit is what it was, and stays so.
    assert_eq!(see(&mut beside, 2.99), 0);
    assert_eq!(see(&mut beside, 3.01), Safety::PATH_DISTANCE);
    assert_eq!(see(&mut beside, 5.0), Safety::PATH_DISTANCE);
    // One that was near is allowed nothing more.
    let mut near = rearmed_at(2.0);
    assert_eq!((near.faults(), see(&mut near, 3.01)), (0, Safety::PATH_DISTANCE));
}

#[test]
fn a_vehicle_that_was_rearmed_across_its_path_may_turn_back_to_it() {
    let config = config(&[]);
    let rearmed_at = |y_m: f64, yaw_rad: f64| {
        let mut deviation = Deviation::new(&config).unwrap();
        deviation.lose();
        deviation.rearm();
        deviation.look_near(30.0);
        (0..10).for_each(|_| deviation.see(pose(30.0, y_m, yaw_rad)));
        deviation
    };
    let see = |deviation: &mut Deviation, y_m: f64, yaw_rad: f64| {
        (0..10).for_each(|_| deviation.see(pose(30.0, y_m, yaw_rad)));
        deviation.faults()
    };
    let heading = Safety::PATH_HEADING;
    // The limit, 0.8 rad, counts from how it was rearmed, and shrinks while it turns back.
    let mut across = rearmed_at(1.0, 1.2);
    assert_eq!(
        (across.faults(), see(&mut across, 1.0, -1.99), see(&mut across, 1.0, -2.01)),
        (0, 0, heading)
    );
    assert_eq!((see(&mut across, 1.0, 0.9), see(&mut across, 1.0, 1.69)), (0, 0));
    assert_eq!(see(&mut across, 1.0, 1.71), heading);
    assert_eq!((see(&mut across, 1.0, 0.79), see(&mut across, 1.0, 0.81)), (0, heading));
    // One that returns from beside its path drives across to it, and turns in once it is near.
    let mut beside = rearmed_at(5.0, 0.0);
    assert_eq!((see(&mut beside, 4.0, -1.57), see(&mut beside, 4.0, -1.58)), (0, heading));
    assert_eq!((see(&mut beside, 2.9, -1.5), see(&mut beside, 2.0, -0.7)), (0, 0));
    assert_eq!(see(&mut beside, 2.0, -0.81), heading);
    // One that was rearmed on its path is allowed nothing more.
    assert_eq!(see(&mut rearmed_at(1.0, 0.7), 1.0, 0.81), heading);
}

#[test]
fn only_a_rearm_lets_a_vehicle_far_off_drive_on() {
    let mut watch = Watch::new(&config(&[]));
    let wanted = RawCommand { speed_mps: 1.5, yaw_rate_radps: 0.0, steering_rad: 0.0 };
    let drive = |watch: &mut Watch, ticks: std::ops::Range<u64>, speed_mps: f64| {
        let mut last = State::Normal;
        for tick in ticks {
            watch.see(
                tick,
                Movement { pose: pose(30.0, 4.0, 0.0), speed_mps, ..Movement::default() },
                true,
            );
            watch.look_near(30.0);
            watch.command(TICK_S, 0, Some(wanted));
            last = watch.state();
        }
        last
    };
    watch.stop(Safety::ODOMETRY_JUMP);
    assert_eq!(drive(&mut watch, 0..100, 0.0), State::Stopped);
    assert!(watch.rearm(0));
    assert_eq!(drive(&mut watch, 100..250, 1.5), State::Normal);
    // A supervisor that joins it there has rearmed nothing.
    let mut joined = Watch::new(&config(&[]));
    joined.resume(
        Movement { pose: pose(30.0, 4.0, 0.0), speed_mps: 1.5, ..Movement::default() },
        0.0,
    );
    assert_ne!(drive(&mut joined, 0..250, 1.5), State::Normal);
}

/// Drives with a command for some seconds; the vehicle's speed and the tangent of its steering angle are given.
fn respond(
    response: &mut Response,
    seconds: f64,
    (told_mps, told_rad): (f64, f64),
    (speed_mps, shown): (f64, f64),
) -> u32 {
    let first = 1 + (TICK_S.recip() * 1000.0) as u64 * u64::from(response.faults() != 0);
    for tick in first..first + (seconds / TICK_S) as u64 {
        response.tell(told_mps, told_rad);
        let yaw_rate_radps = speed_mps * shown / 2.875;
        let pose = pose(speed_mps * TICK_S * tick as f64, 0.0, 0.0);
        response.see(tick, Movement { pose, speed_mps, yaw_rate_radps }, true);
    }
    response.faults()
}

#[test]
fn each_way_of_not_doing_as_told_has_its_reason() {
    let check = |seconds: f64, told: (f64, f64), does: (f64, f64), wanted: u32| {
        let mut response = Response::new(&config(&[])).unwrap();
        let faults = respond(&mut response, seconds, told, does);
        assert_eq!(faults, wanted, "{told:?} {does:?} after {seconds} s");
    };
    let tan = |angle: f64| libm::tan(angle);
    check(10.0, (1.5, 0.2), (1.5, tan(0.2)), 0);
    check(1.0, (1.5, 0.2), (1.5, -tan(0.2)), Safety::STEERING_REVERSED | Safety::STEERING_IGNORED);
    check(0.8, (1.5, 0.05), (1.5, -tan(0.05)), Safety::STEERING_REVERSED);
    check(0.1, (1.5, 0.05), (1.5, -tan(0.05)), 0);
    check(0.2, (1.5, 0.05), (1.5, -tan(0.05)), Safety::STEERING_REVERSED);
    // It creeps: the yaw rate says nothing.
    check(5.0, (0.5, 0.2), (0.5, -tan(0.2)), 0);
    check(1.5, (1.5, 0.3), (1.5, 0.0), Safety::STEERING_IGNORED);
    check(1.5, (1.5, 0.0), (1.5, 0.12), Safety::STEERING_IGNORED);
    check(10.0, (1.5, 0.0), (1.5, 0.04), 0);
    check(10.0, (1.5, 0.3), (1.5, 0.7 * tan(0.3)), 0);
    check(1.0, (1.5, 0.0), (4.0, 0.0), Safety::SPEED_IGNORED);
    check(10.0, (1.5, 0.0), (1.7, 0.0), 0);
    check(10.0, (-4.0, 0.0), (0.0, 0.0), 0);
    check(1.9, (1.5, 0.0), (0.0, 0.0), 0);
    check(2.3, (1.5, 0.0), (0.0, 0.0), Safety::STANDS);
    check(10.0, (0.1, 0.0), (0.0, 0.0), 0);
}

#[test]
fn a_gear_that_is_not_engaged_yet_is_waited_for() {
    let config = config(&["vehicle.gear_engaged=false"]);
    let mut response = Response::new(&config).unwrap();
    // 4 s from reverse, as a command to brake leaves it, and 0.1 s until the selector looks.
    assert_eq!(respond(&mut response, 6.0, (1.5, 0.0), (0.0, 0.0)), 0);
    let mut response = Response::new(&config).unwrap();
    assert_eq!(respond(&mut response, 6.4, (1.5, 0.0), (0.0, 0.0)), Safety::STANDS);
}

#[test]
fn a_vehicle_that_stops_on_its_own_steers_straight_and_is_told_once_it_stands() {
    let mut response = Response::new(&config(&[])).unwrap();
    response.resume(1.5, 0.0);
    let mut x_m = 0.0;
    for tick in 0..1000 {
        response.tell(1.5, 0.3);
        let speed_mps = (1.5 - 2.0 * TICK_S * tick as f64).max(0.0);
        x_m += speed_mps * TICK_S;
        response.see(
            tick,
            Movement { pose: pose(x_m, 0.0, 0.0), speed_mps, yaw_rate_radps: 0.0 },
            false,
        );
        // It stands after 0.75 s, and may for 2 s.
        if !(250..300).contains(&tick) {
            assert_eq!(
                response.faults(),
                if tick < 250 { 0 } else { Safety::STANDS },
                "tick {tick}"
            );
        }
    }
}

/// A localisation that hangs repeats the last pose; one that is slow, or a speed that is a fifth too high, is no fault.
#[test]
fn a_pose_that_does_not_come_along_is_told() {
    let told_after_m = |speed_mps: f64, seen: fn(f64) -> f64| {
        let mut response = Response::new(&config(&[])).unwrap();
        response.resume(speed_mps, 0.0);
        let told = (0..2000).find(|tick| {
            response.tell(speed_mps, 0.0);
            let at = pose(seen(speed_mps * TICK_S * *tick as f64), 0.0, 0.0);
            response.see(*tick, Movement { pose: at, speed_mps, yaw_rate_radps: 0.0 }, true);
            assert_eq!(response.faults() & !Safety::POSE_STANDS, 0);
            response.faults() != 0
        });
        told.map(|tick| speed_mps * TICK_S * tick as f64)
    };
    for speed_mps in [1.5, 4.0] {
        // Half a wheelbase and 0.2 s, of seven tenths of the way.
        let due_m = (0.5 * 2.875 + 0.2 * speed_mps) / 0.7;
        let told_m = told_after_m(speed_mps, |_| 0.0).unwrap();
        assert!((due_m..due_m + 0.3 * speed_mps).contains(&told_m), "{told_m} m at {speed_mps}");
        assert_eq!(told_after_m(speed_mps, |x_m| x_m), None);
        assert_eq!(told_after_m(speed_mps, |x_m| 0.8 * x_m), None);
        // At 5 Hz, at 4 m/s.
        assert_eq!(told_after_m(speed_mps, |x_m| (x_m / 0.8).floor() * 0.8), None);
    }
}

#[test]
fn what_is_only_told_changes_no_state_and_a_wrong_sign_stops_at_once() {
    let drive = |shown: f64, speed_mps: f64, told_rad: f64| {
        let mut watch = Watch::new(&config(&[]));
        let wanted = RawCommand { speed_mps: 1.5, yaw_rate_radps: 0.0, steering_rad: told_rad };
        let (mut states, mut reasons) = (Vec::new(), 0);
        for tick in 0..300 {
            let yaw_rate_radps = speed_mps * shown / 2.875;
            let pose = pose(speed_mps * TICK_S * tick as f64, 0.0, 0.0);
            watch.see(tick, Movement { pose, speed_mps, yaw_rate_radps }, true);
            watch.command(TICK_S, 0, Some(wanted));
            states.push(watch.state());
            reasons |= watch.reasons();
        }
        states.dedup();
        (states, reasons)
    };
    assert_eq!(drive(0.0, 0.0, 0.0), (vec![State::Normal], Safety::STANDS));
    let (states, reasons) = drive(-0.05, 1.5, 0.05);
    assert_eq!(
        (states, reasons),
        (vec![State::Normal, State::Stopping], Safety::STEERING_REVERSED)
    );
    let (states, reasons) = drive(0.15, 1.5, 0.0);
    let all = vec![State::Normal, State::Degraded, State::Stopping];
    assert_eq!((states, reasons), (all, Safety::STEERING_IGNORED));
}

/// Drives 4 m beside the path for some ticks, with or without answers; the last command.
fn beside(
    watch: &mut Watch,
    ticks: std::ops::Range<u64>,
    speed_mps: f64,
    answers: bool,
) -> supervisor::Passed {
    let wanted = RawCommand { speed_mps: 2.0, yaw_rate_radps: 0.0, steering_rad: 0.05 };
    let one = |tick: u64| {
        let pose = pose(30.0, 4.0, 0.0);
        watch.see(tick, Movement { pose, speed_mps, ..Movement::default() }, true);
        watch.look_near(30.0);
        watch.command(TICK_S, 0, answers.then_some(wanted))
    };
    ticks.map(one).last().unwrap()
}

#[test]
fn a_vehicle_that_leaves_its_path_is_braked_while_the_law_steers() {
    let mut watch = Watch::new(&config(&["vehicle.safety.watch_response='off'"]));
    let at = pose(30.0, 4.0, 0.0);
    watch.resume(Movement { pose: at, speed_mps: 2.0, ..Movement::default() }, 0.0);
    assert_eq!((watch.clock_rate(0.5), watch.action_flags()), (0.5, 0));
    // At once, and not only when it is stopped for good.
    let passed = beside(&mut watch, 0..30, 2.0, true);
    assert_eq!((watch.state(), watch.action()), (State::Degraded, Some(Action::Brake)));
    assert!(passed.speed_mps < 1.5 && passed.steering_rad == 0.05, "{passed:?}");
    assert_eq!(watch.action_flags(), Command::BRAKED | Command::STEERED);
    // The clock falls from the mean's end on, 0.4 s long.
    let rate = watch.clock_rate(1.0);
    assert!((0.4..0.6).contains(&rate), "{rate}");
    let passed = beside(&mut watch, 30..130, 2.0, true);
    assert_eq!((watch.state(), watch.reasons()), (State::Stopping, Safety::PATH_DISTANCE));
    assert_eq!((passed.speed_mps, passed.steering_rad), (-1.0, 0.05));
    assert_eq!((watch.clock_rate(1.0), watch.actions()), (0.0, 1));

    // Nobody steers any more, for longer than a moment.
    let passed = beside(&mut watch, 130..170, 2.0, false);
    assert_eq!(passed.steering_rad, 0.05);
    let passed = beside(&mut watch, 170..220, 2.0, false);
    assert_eq!((passed.speed_mps, passed.steering_rad), (-1.0, 0.0));
    assert_eq!((watch.action_flags(), watch.actions()), (Command::BRAKED, 2));
    assert_eq!(watch.reasons(), Safety::PATH_DISTANCE | Safety::COMMAND_STALE);

    let passed = beside(&mut watch, 220..300, 0.0, true);
    assert_eq!((watch.state(), watch.action_flags()), (State::Stopped, 0));
    assert!((passed.speed_mps, passed.steering_rad) == (0.0, 0.0), "{passed:?}");
}

#[test]
fn a_successor_goes_on_with_the_stop_that_was_begun() {
    let mut watch = Watch::new(&config(&[]));
    watch.resume(Movement { speed_mps: 2.0, ..Movement::default() }, 0.1);
    watch.resume_stop(Action::BrakeStraight);
    assert_eq!((watch.state(), watch.reasons()), (State::Stopping, Safety::RESTARTED));
    let passed = beside(&mut watch, 0..40, 2.0, true);
    assert_eq!((passed.steering_rad, watch.clock_rate(1.0)), (0.0, 0.0));
    assert_eq!(watch.action_flags(), Command::BRAKED);
    // Its drive ends, and it does not stand yet.
    let last_mps = passed.speed_mps;
    let mut end = |speed_mps| (0..100).map(|_| watch.end(TICK_S, speed_mps)).last().unwrap();
    assert!(last_mps < 1.0 && end(2.0).speed_mps == -1.0);
    assert_eq!(end(0.0).speed_mps, 0.0);
}

#[test]
fn the_body_keeps_off_the_road_s_edges() {
    let mut config = config(&[]);
    config.vehicle.body_half_width_m = 1.0;
    config.path.pieces = Vec::new();
    config.path.points = vec![[0.0, 0.0], [50.0, 0.0]];
    config.path.widths_m = vec![[2.0, 9.0]; 2];
    let stay = |x_m: f64, y_m: f64| {
        deviation_faults(&config, std::iter::repeat_n(pose(x_m, y_m, 0.0), 10))
    };
    assert_eq!((stay(10.0, 0.99), stay(10.0, 1.01)), (0, Safety::ROAD_EDGE));
    // On the right, the distance from the path is less than the road is wide.
    assert_eq!((stay(10.0, -2.99), stay(10.0, -3.01)), (0, Safety::PATH_DISTANCE));
    // One that is rearmed beyond the edge returns, and does not go further out.
    let mut deviation = Deviation::new(&config).unwrap();
    let mut see = |y_m: f64, rearmed: bool| {
        if rearmed {
            deviation.rearm();
        }
        (0..10).for_each(|_| deviation.see(pose(10.0, y_m, 0.0)));
        deviation.faults()
    };
    assert_eq!((see(1.5, false), see(1.5, true), see(1.2, false)), (Safety::ROAD_EDGE, 0, 0));
    assert_eq!((see(2.3, false), see(0.5, false)), (Safety::ROAD_EDGE, 0));
    assert_eq!(see(1.1, false), Safety::ROAD_EDGE);
}

#[test]
fn a_yaw_rate_that_is_computed_from_the_command_is_told() {
    let config = config(&["vehicle.steering_rate_radps=9.0"]);
    let drive = |tells_truth: bool, lag: f64| {
        let mut watch = Watch::new(&config);
        if tells_truth {
            watch.tells_truth();
        }
        let (mut wheel_rad, mut told_rad) = (0.0, 0.0);
        let mut x_m = 0.0;
        for tick in 0..1500 {
            wheel_rad += (told_rad - wheel_rad) * lag;
            x_m += 2.0 * TICK_S;
            let yaw_rate_radps = 2.0 * f64::tan(wheel_rad) / 2.875;
            let at = pose(x_m, 0.0, 0.0);
            watch.see(tick, Movement { pose: at, speed_mps: 2.0, yaw_rate_radps }, true);
            let steering_rad = 0.1 * (f64::from(tick as u32) * 0.03).sin();
            let raw = RawCommand { speed_mps: 2.0, yaw_rate_radps: 0.0, steering_rad };
            told_rad = watch.command(TICK_S, 0, Some(raw)).steering_rad;
        }
        (watch.state(), watch.reasons())
    };
    assert_eq!(drive(false, 1.0), (State::Normal, Safety::STEERING_UNSEEN));
    assert_eq!(drive(true, 1.0), (State::Normal, 0));
    assert_eq!(drive(false, 0.3), (State::Normal, 0));
}

/// What is done, and for what, 0.3 s after the wheels began to follow only this share of their command;
/// `stopped` for leaving the envelope by its yaw or not at all.
fn done_about(share: f64, stopped: bool) -> (Option<Action>, u32) {
    let mut watch = Watch::new(&config(&[]));
    let at = |tick: u64| pose(1.0 + 0.03 * tick as f64, 0.0, 0.0);
    let rolling = Movement { pose: at(0), speed_mps: 3.0, yaw_rate_radps: 0.0 };
    watch.resume(rolling, 0.0);
    let mut wheels_rad: f64 = 0.0;
    let mut told_rad = 0.0;
    for tick in 0..132u64 {
        let follows = if tick < 100 { 1.0 } else { share };
        wheels_rad += (follows * told_rad - wheels_rad).clamp(-0.006, 0.006);
        let yaw_rate_radps = 3.0 * libm::tan(wheels_rad) / 2.875;
        watch.see(tick, Movement { pose: at(tick), yaw_rate_radps, ..rolling }, true);
        if tick == 100 && stopped {
            watch.stop(Safety::OUT_BY_YAW);
        }
        let raw = RawCommand { speed_mps: 3.0, yaw_rate_radps: 0.0, steering_rad: 0.1 };
        told_rad = watch.command(TICK_S, 0, Some(raw)).steering_rad;
    }
    (watch.action(), watch.reasons())
}

#[test]
fn a_vehicle_that_is_braked_and_seems_to_steer_to_the_wrong_side_gets_straight_wheels_early() {
    // One that drives on is judged with more patience.
    assert_eq!(done_about(-1.0, false), (None, 0));
    let out = Safety::OUT_BY_YAW;
    assert_eq!(
        done_about(-1.0, true),
        (Some(Action::BrakeStraight), out | Safety::STEERING_REVERSED)
    );
    // Less steering than it was told is still steering.
    for share in [1.0, 0.6, 0.0] {
        assert_eq!(done_about(share, true), (Some(Action::Brake), out), "{share}");
    }
}

#[test]
fn where_an_envelope_stops_the_paper_s_vehicle_its_response_is_watched_too() {
    let mut paper = Layers::maneuver("lane_change").unwrap().resolve().unwrap();
    assert!(!paper.watches_response());
    let promise = config::Promise {
        alpha: 0.01,
        delta: 0.01,
        scaled_on: 1000,
        threshold_on: 1000,
        above: 2,
        left_out: 0,
        varied: String::new(),
    };
    let made_for = config::MadeFor::of(&paper, Vec::new());
    let (channels, scores) = (Vec::new(), Vec::new());
    paper.envelope =
        Some(Box::new(config::Envelope { made_for, promise, threshold: 1.0, channels, scores }));
    assert!(paper.watches_response() && Response::new(&paper).is_some());
    paper.envelope_only_judges = true;
    assert!(!paper.watches_response());
}

#[test]
fn while_a_vehicle_is_braked_the_reference_comes_to_rest_with_it() {
    // It is never said to run away, however fast it is.
    let mut watch = Watch::new(&config(&["vehicle.safety.watch_response='off'"]));
    let mut rates = Vec::new();
    for tick in 0..100u64 {
        let pose = pose(1.0 + 0.03 * tick as f64, 0.0, 0.0);
        watch.see(tick, Movement { pose, speed_mps: 3.0, yaw_rate_radps: 0.0 }, true);
        if tick == 20 {
            watch.stop(Safety::OUT_BY_YAW);
        }
        let raw = RawCommand { speed_mps: 3.0, yaw_rate_radps: 0.0, steering_rad: 0.0 };
        watch.command(TICK_S, 0, Some(raw));
        // A reference that waits for its vehicle runs slower already.
        rates.push(watch.clock_rate(0.5));
    }
    assert!(rates[..20].iter().all(|rate| *rate == 0.5), "{rates:?}");
    // 5 m/s² from 3 m/s: 0.6 s.
    assert!((rates[49] - 0.25).abs() < 1e-9, "{}", rates[49]);
    assert!(rates[20..].is_sorted_by(|a, b| a >= b), "{rates:?}");
    assert!(rates[81..].iter().all(|rate| *rate == 0.0), "{rates:?}");
}
