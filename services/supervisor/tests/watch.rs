//! Faults and what is done about them: plausibility, the state machine, and the watch that joins them with the gate.

use config::{Layers, RunConfig};
use ipc_types::Safety;
use supervisor::{Guard, Movement, Plausibility, RawCommand, SpeedGovernor, State, Watch};
use tracking::Pose;

const TICK_S: f64 = 0.01;

fn config(sets: &[&str]) -> RunConfig {
    let mut layers = Layers::maneuver("lane_change").unwrap();
    for set in sets {
        layers.set(set).unwrap();
    }
    layers.resolve().unwrap()
}

const JUMPS: [&str; 2] = ["vehicle.safety.jump_limit_m=0.5", "vehicle.safety.jump_limit_rad=0.2"];

fn at(x_m: f64) -> Movement {
    Movement { pose: Pose { x_m, ..Pose::default() }, ..Movement::default() }
}

#[test]
fn states_have_their_numbers_on_the_wire() {
    let numbers =
        [State::Normal, State::Degraded, State::Stopping, State::Stopped].map(State::number);
    assert_eq!(numbers, [Safety::NORMAL, Safety::DEGRADED, Safety::STOPPING, Safety::STOPPED]);
    let latched =
        [State::Normal, State::Degraded, State::Stopping, State::Stopped].map(State::is_latched);
    assert_eq!(latched, [false, false, true, true]);
}

#[test]
fn a_short_fault_degrades_and_a_long_one_stops() {
    let mut guard = Guard::new(&config(&["vehicle.safety.degraded_limit_s=0.02"]));
    let stale = Safety::COMMAND_STALE;
    assert_eq!((guard.state(), guard.reasons()), (State::Normal, 0));
    assert_eq!(guard.update(TICK_S, 0, 1.0, 1.0), State::Normal);
    assert_eq!(guard.update(TICK_S, stale, 1.0, 1.0), State::Degraded);
    assert_eq!(guard.reasons(), stale);
    assert_eq!(guard.update(2.0 * TICK_S, 0, 1.0, 1.0), State::Normal);
    assert_eq!(guard.reasons(), 0);
    // Exactly the limit is still borne.
    assert_eq!(guard.update(2.0 * TICK_S, stale, 1.0, 1.0), State::Degraded);
    assert_eq!(guard.update(0.5 * TICK_S, 0, 1.0, 1.0), State::Normal);
    assert_eq!(guard.update(TICK_S, stale, 1.0, 1.0), State::Stopping);
    assert_eq!((guard.state(), guard.reasons()), (State::Stopping, stale));
    // Nothing leads back by itself.
    assert_eq!(guard.update(TICK_S, 0, 1.0, 1.0), State::Stopping);
    assert_eq!(guard.reasons(), stale);
}

#[test]
fn what_was_mended_for_long_is_forgotten_and_no_more_than_that() {
    let mut guard = Guard::new(&config(&["vehicle.safety.degraded_limit_s=0.025"]));
    for _ in 0..100 {
        guard.update(TICK_S, 0, 1.0, 1.0);
    }
    for _ in 0..2 {
        assert_eq!(guard.update(TICK_S, Safety::ODOMETRY_JUMP, 1.0, 1.0), State::Degraded);
    }
    assert_eq!(guard.update(TICK_S, Safety::ODOMETRY_JUMP, 1.0, 1.0), State::Stopping);
}

#[test]
fn a_fault_that_comes_and_goes_stops_as_well() {
    // For how many of 100 ticks the fault is there, and whether it stops the vehicle in the end.
    for (fault, ticks, stops) in [
        (Safety::COMMAND_STALE, 50, true),
        (Safety::ODOMETRY_STALE, 40, false),
        (Safety::STEERING_IGNORED, 25, true),
        (Safety::PATH_DISTANCE, 15, false),
        (Safety::ODOMETRY_JUMP, 50, true),
        (Safety::STANDS, 100, false),
    ] {
        let mut guard = Guard::new(&config(&["vehicle.safety.degraded_limit_s=0.5"]));
        for tick in 0..2000 {
            // At once and together, and in turn with good ones: both come to the same.
            let here = if tick < 1000 { tick % 100 < ticks } else { tick * ticks % 100 < ticks };
            guard.update(TICK_S, if here { fault } else { 0 }, 1.0, 1.0);
        }
        assert_eq!(guard.state().is_latched(), stops, "{fault}");
    }
}

#[test]
fn it_stands_once_command_and_measurement_say_so() {
    let mut guard = Guard::new(&config(&["vehicle.safety.standstill_mps=0.05"]));
    guard.stop(Safety::RESTARTED);
    guard.stop(Safety::COMMAND_STALE);
    assert_eq!(guard.state(), State::Stopping);
    assert_eq!(guard.reasons(), Safety::RESTARTED | Safety::COMMAND_STALE);
    assert_eq!(guard.update(TICK_S, 0, 0.05, 0.0), State::Stopping);
    assert_eq!(guard.update(TICK_S, 0, 0.0, -0.05), State::Stopping);
    assert_eq!(guard.update(TICK_S, Safety::ODOMETRY_STALE, 0.0, 0.0), State::Stopping);
    assert!(!guard.rearm(0), "it does not stand yet");
    assert_eq!(guard.update(TICK_S, Safety::COMMAND_STALE, 0.04, 0.04), State::Stopped);
    // It stays so, whatever comes, and a further reason to stop is no step back.
    assert_eq!(guard.update(TICK_S, 0, 3.0, 3.0), State::Stopped);
    guard.stop(Safety::ODOMETRY_JUMP);
    assert_eq!(guard.state(), State::Stopped);
    assert!(
        !guard.rearm(Safety::ODOMETRY_STALE)
            && !guard.rearm(Safety::COMMAND_STALE | Safety::TIME_BACK)
    );
    assert!(guard.rearm(Safety::COMMAND_STALE));
    assert_eq!((guard.state(), guard.reasons()), (State::Normal, 0));
    assert!(!guard.rearm(0), "there is nothing to rearm");
    // The time of the faults before is forgotten.
    assert_eq!(guard.update(0.3, Safety::COMMAND_STALE, 0.0, 0.0), State::Degraded);
}

#[test]
fn odometry_is_believed_unless_it_is_none_or_goes_back() {
    let mut plausibility = Plausibility::new(&config(&[]));
    assert_eq!(plausibility.believed(), None);
    let none = [
        at(f64::NAN),
        Movement { speed_mps: f64::INFINITY, ..at(0.0) },
        Movement { yaw_rate_radps: f64::NAN, ..at(0.0) },
    ];
    for movement in none {
        assert_eq!(plausibility.check(0, movement), Safety::ODOMETRY_INVALID);
    }
    assert_eq!(plausibility.check(5, at(1.0)), 0);
    assert_eq!(plausibility.check(5, at(2.0)), Safety::TIME_BACK);
    assert_eq!(plausibility.check(4, at(2.0)), Safety::TIME_BACK);
    assert_eq!(plausibility.believed(), Some(at(1.0)));
    // Without limits it may be anywhere.
    assert_eq!(plausibility.check(6, at(1e6)), 0);
    assert_eq!(plausibility.believed(), Some(at(1e6)));
}

#[test]
fn a_pose_that_moves_more_than_the_speed_has_jumped() {
    let fresh = || {
        let mut it = Plausibility::new(&config(&JUMPS));
        assert_eq!(it.check(0, Movement { speed_mps: 2.0, ..at(0.0) }), 0);
        it
    };
    // 2 m/s for a tick, and half a metre.
    assert_eq!(fresh().check(1, at(0.519)), 0);
    assert_eq!(fresh().check(1, at(0.521)), Safety::ODOMETRY_JUMP);
    assert_eq!(fresh().check(1, at(-0.521)), Safety::ODOMETRY_JUMP);
    // For ten ticks, and by the higher one of both speeds.
    assert_eq!(fresh().check(10, at(0.699)), 0);
    assert_eq!(fresh().check(10, at(0.701)), Safety::ODOMETRY_JUMP);
    assert_eq!(fresh().check(10, Movement { speed_mps: -4.0, ..at(0.899) }), 0);
    assert_eq!(fresh().check(10, Movement { speed_mps: -4.0, ..at(0.901) }), Safety::ODOMETRY_JUMP);
    // The tracked point, 0.7 m ahead of the axle, turns around it.
    let turning = |x_m| Movement { yaw_rate_radps: 1.0, ..at(x_m) };
    assert_eq!(fresh().check(10, turning(0.769)), 0);
    assert_eq!(fresh().check(10, turning(0.771)), Safety::ODOMETRY_JUMP);
    // A jump is not believed: what comes behind it is measured against what was.
    let mut it = fresh();
    assert_eq!(it.check(1, at(9.0)), Safety::ODOMETRY_JUMP);
    assert_eq!(it.check(2, at(9.0)), Safety::ODOMETRY_JUMP);
    assert_eq!(it.check(3, at(0.03)), 0);
    it.forget();
    assert_eq!(it.check(1, at(9.0)), 0);
}

/// Odometry that comes less often than ticks do repeats each pose until the next one.
#[test]
fn a_step_counts_from_when_the_pose_last_changed() {
    let fast = |x_m| Movement { speed_mps: 5.0, ..at(x_m) };
    let fresh = |ticks: u64| {
        let mut it = Plausibility::new(&config(&JUMPS));
        for tick in 0..ticks {
            assert_eq!(it.check(tick, fast(0.0)), 0);
        }
        it
    };
    // 20 Hz: a twentieth of a second at 5 m/s, and half a metre.
    assert_eq!(fresh(5).check(5, fast(0.749)), 0);
    assert_eq!(fresh(5).check(5, fast(0.751)), Safety::ODOMETRY_JUMP);
    // One that was too large is none any more once the vehicle may have come so far, however often it is repeated.
    let mut it = fresh(5);
    assert_eq!([5, 6, 7, 8].map(|tick| it.check(tick, fast(0.88))), [16, 16, 16, 0]);
    // A localisation that hangs does not allow for every step in the end: half a second, and the tick.
    assert_eq!(fresh(300).check(300, fast(3.04)), 0);
    assert_eq!(fresh(300).check(300, fast(3.06)), Safety::ODOMETRY_JUMP);
    // Messages that are missing were driven.
    assert_eq!(fresh(5).check(104, fast(5.69)), 0);
    // Ticks that go back between jumps are no long time.
    let mut it = fresh(5);
    assert_eq!(
        [20, 15].map(|tick| it.check(tick, fast(90.0))),
        [Safety::ODOMETRY_JUMP, Safety::TIME_BACK]
    );
}

/// Fast, a vehicle might have come as far as the jump while it lasts; but its odometry has shown how far it came.
#[test]
fn a_jump_that_lasts_is_not_believed_in_the_end_and_one_that_goes_back_is_forgotten() {
    for (heading_rad, turned_rad) in [(0.0, 0.0), (0.0, 3.0), (0.7, 1.1)] {
        // In the frame to which the odometry has jumped, the vehicle may head elsewhere.
        let seen = |tick: u64, has_jumped: bool| {
            let (way_m, speed_mps) = (0.04 * tick as f64, 4.0);
            let (yaw_rad, y_m) = match has_jumped {
                true => (heading_rad + turned_rad, 1.0),
                false => (heading_rad, 0.0),
            };
            let (sin, cos) = (libm::sin(yaw_rad), libm::cos(yaw_rad));
            let pose = Pose { x_m: cos * way_m, y_m: sin * way_m + y_m, yaw_rad };
            Movement { pose, speed_mps, yaw_rate_radps: 0.0 }
        };
        let mut it = Plausibility::new(&config(&JUMPS));
        assert_eq!(it.check(0, seen(0, false)), 0);
        // Some messages are missing.
        for tick in (1..100).filter(|tick| tick % 7 != 0) {
            assert_eq!(it.check(tick, seen(tick, true)), Safety::ODOMETRY_JUMP, "tick {tick}");
        }
        assert_eq!(it.check(100, seen(100, false)), 0);
        assert_eq!(it.believed(), Some(seen(100, false)));
    }
}

#[test]
fn a_jump_is_measured_from_where_and_when_the_last_one_was_and_its_limit_is_none_yet() {
    let sets = ["vehicle.safety.jump_limit_m=0.5", "vehicle.safety.jump_limit_rad=0.25"];
    let at = |x_m, y_m, yaw_rad| Movement { pose: Pose { x_m, y_m, yaw_rad }, ..at(0.0) };
    let fresh = || {
        let mut it = Plausibility::new(&config(&sets));
        assert_eq!(it.check(50, at(8.0, -4.0, 0.0)), 0);
        it
    };
    assert_eq!(fresh().check(51, at(8.5, -4.0, 0.25)), 0);
    assert_eq!(fresh().check(51, at(8.0, -4.5, -0.25)), 0);
    // The distance counts, and not the sum of both ways.
    assert_eq!(fresh().check(51, at(8.3, -3.7, 0.0)), 0);
    assert_eq!(fresh().check(51, at(8.4, -3.6, 0.0)), Safety::ODOMETRY_JUMP);
    assert_eq!(fresh().check(51, at(8.0, -4.0, 0.26)), Safety::ODOMETRY_JUMP);
    // One tick at 1 m/s, not a hundred and one.
    let fast = Movement { speed_mps: 1.0, ..at(8.6, -4.0, 0.0) };
    assert_eq!(fresh().check(51, fast), Safety::ODOMETRY_JUMP);
}

#[test]
fn each_of_some_faults_stops_at_once() {
    for fault in [
        Safety::STEERING_REVERSED,
        Safety::OUT_BY_QUALITY,
        Safety::OUT_BY_YAW,
        Safety::AREA,
        Safety::POSE_STANDS,
    ] {
        let mut guard = Guard::new(&config(&[]));
        assert_eq!(guard.update(TICK_S, fault, 1.0, 1.0), State::Stopping, "{fault:#x}");
    }
    let mut guard = Guard::new(&config(&[]));
    assert_eq!(guard.update(TICK_S, Safety::COMMAND_STALE, 1.0, 1.0), State::Degraded);
}

#[test]
fn what_comes_late_is_forgiven_sooner_than_what_is_wrong() {
    // A tenth of a second with the fault, and some ticks without it: how long a new one may last by then. After 14 healthy
    // ticks what came late is forgotten, and of what was wrong most still counts.
    let degraded_limit_s = config(&[]).vehicle.safety.degraded_limit_s;
    let lasts_after = |fault: u32, healthy: usize| {
        let mut guard = Guard::new(&config(&[]));
        for _ in 0..10 {
            guard.update(TICK_S, fault, 1.0, 1.0);
        }
        for _ in 0..healthy {
            guard.update(TICK_S, 0, 1.0, 1.0);
        }
        let ticks = 1..10_000;
        let stops = |_: &usize| guard.update(TICK_S, fault, 1.0, 1.0) == State::Stopping;
        ticks.into_iter().find(stops).expect("it stops") as f64 * TICK_S
    };
    let unhindered = lasts_after(Safety::COMMAND_STALE, 100);
    assert!((unhindered - degraded_limit_s).abs() < 2.0 * TICK_S, "{unhindered}");
    for fault in
        [Safety::COMMAND_STALE, Safety::ODOMETRY_STALE, Safety::COMMAND_STALE | Safety::TOLD]
    {
        assert!(unhindered - lasts_after(fault, 14) < 1.5 * TICK_S, "{fault:#x}");
    }
    for fault in [Safety::ODOMETRY_INVALID, Safety::ODOMETRY_JUMP, Safety::STEERING_IGNORED] {
        assert!(unhindered - lasts_after(fault, 14) > 3.5 * TICK_S, "{fault:#x}");
    }
}

#[test]
fn that_no_leg_was_found_is_told_until_the_next_try() {
    let mut guard = Guard::new(&config(&[]));
    guard.stop(Safety::ODOMETRY_JUMP);
    for _ in 0..2 {
        assert!(!guard.rearm(Safety::NO_LEG | Safety::ODOMETRY_JUMP));
        assert_eq!(guard.reasons(), Safety::ODOMETRY_JUMP | Safety::NO_LEG);
    }
    assert!(!guard.rearm(Safety::ODOMETRY_INVALID));
    assert_eq!(guard.reasons(), Safety::ODOMETRY_JUMP);
}

#[test]
fn a_fault_that_is_seen_twice_is_still_one() {
    let mut watch = Watch::new(&config(&[]));
    watch.see(0, at(0.0), true);
    watch.command(TICK_S, Safety::COMMAND_STALE, None);
    let safety = watch.safety();
    assert_eq!((safety.state, safety.reasons), (Safety::DEGRADED, Safety::COMMAND_STALE));
    watch.command(TICK_S, 0, Some(RAW));
    assert_eq!(watch.see(1, at(f64::NAN), true), Safety::ODOMETRY_INVALID);
    watch.command(TICK_S, Safety::ODOMETRY_INVALID, Some(RAW));
    assert_eq!(watch.safety().reasons, Safety::ODOMETRY_INVALID);
    watch.stop(Safety::RESTARTED);
    watch.see(2, at(0.0), true);
    for _ in 0..1000 {
        watch.command(TICK_S, 0, Some(RAW));
    }
    assert_eq!(watch.state(), State::Stopped);
    watch.see(3, at(f64::NAN), true);
    assert!(!watch.rearm(Safety::ODOMETRY_INVALID));
}

#[test]
fn a_yaw_that_turns_more_than_its_rate_has_jumped_and_one_that_wraps_has_not() {
    let yaw = |yaw_rad: f64, yaw_rate_radps: f64| Movement {
        pose: Pose { yaw_rad, ..Pose::default() },
        speed_mps: 0.0,
        yaw_rate_radps,
    };
    let only_yaw = config(&["vehicle.safety.jump_limit_rad=0.2"]);
    let fresh = || {
        let mut it = Plausibility::new(&only_yaw);
        assert_eq!(it.check(0, yaw(3.0, 0.5)), 0);
        it
    };
    assert_eq!(fresh().check(10, yaw(3.249, 0.0)), 0);
    assert_eq!(fresh().check(10, yaw(3.251, 0.0)), Safety::ODOMETRY_JUMP);
    assert_eq!(fresh().check(10, yaw(2.749, 0.0)), Safety::ODOMETRY_JUMP);
    assert_eq!(fresh().check(10, yaw(3.299, -1.0)), 0);
    assert_eq!(fresh().check(10, yaw(3.1 - std::f64::consts::TAU, 0.0)), 0);
    // With this limit alone the place is free, and with the other one the yaw.
    assert_eq!(
        fresh().check(
            10,
            Movement { pose: Pose { x_m: 50.0, y_m: 0.0, yaw_rad: 3.0 }, ..yaw(3.0, 0.0) }
        ),
        0
    );
    let mut place = Plausibility::new(&config(&["vehicle.safety.jump_limit_m=0.5"]));
    assert_eq!(place.check(0, yaw(0.0, 0.0)), 0);
    assert_eq!(place.check(1, yaw(2.0, 0.0)), 0);
    assert_eq!(
        place.check(
            2,
            Movement { pose: Pose { x_m: 1.0, y_m: 0.0, yaw_rad: 2.0 }, ..yaw(2.0, 0.0) }
        ),
        Safety::ODOMETRY_JUMP
    );
}

const RAW: RawCommand = RawCommand { speed_mps: 2.0, yaw_rate_radps: 0.5, steering_rad: 0.1 };

#[test]
fn a_healthy_drive_passes_and_a_sick_one_slows_down() {
    let mut watch =
        Watch::new(&config(&[&JUMPS[..], &["vehicle.safety.degraded_limit_s=0.03"]].concat()));
    assert_eq!(watch.see(0, at(0.0), true), 0);
    let passed = watch.command(TICK_S, 0, Some(RAW));
    assert_eq!((passed.speed_mps, passed.steering_rad), (2.0, 0.1));
    let safety = watch.safety();
    assert_eq!(
        (safety.state, safety.reasons, safety.own, safety.changed),
        (Safety::NORMAL, 0, 0, 0)
    );
    assert_eq!(safety.steering_rad, 0.1);

    // Nothing wanted.
    let passed = watch.command(TICK_S, 0, None);
    assert_eq!((watch.state(), watch.safety().reasons), (State::Degraded, Safety::COMMAND_STALE));
    assert!((passed.speed_mps - 1.98).abs() < 1e-12 && passed.steering_rad == 0.1);
    assert!(!passed.change.rejected);
    watch.command(TICK_S, 0, Some(RAW));
    // Something wanted that is none.
    let passed = watch.command(TICK_S, 0, Some(RawCommand { speed_mps: f64::NAN, ..RAW }));
    assert!(passed.change.rejected && passed.speed_mps < 2.0);
    assert_eq!(watch.safety().reasons, Safety::COMMAND_INVALID);
    watch.command(TICK_S, 0, Some(RAW));
    // A fault of the loop, and one of the odometry, with an answer as good as any.
    watch.command(TICK_S, Safety::ODOMETRY_STALE, Some(RAW));
    assert_eq!(watch.safety().reasons, Safety::ODOMETRY_STALE);
    watch.command(TICK_S, 0, Some(RAW));
    assert_eq!(watch.see(1, at(7.0), true), Safety::ODOMETRY_JUMP);
    watch.command(TICK_S, 0, Some(RAW));
    assert_eq!((watch.safety().reasons, watch.safety().own), (Safety::ODOMETRY_JUMP, 4));
    let passed = watch.command(TICK_S, 0, Some(RAW));
    assert_eq!(watch.state(), State::Stopping);
    assert_eq!(passed.steering_rad, 0.0);
}

#[test]
fn a_stopped_vehicle_may_be_pushed_and_starts_from_there() {
    let mut watch = Watch::new(&config(&JUMPS));
    watch.see(0, at(0.0), true);
    watch.stop(Safety::RESTARTED);
    watch.command(TICK_S, 0, Some(RAW));
    assert_eq!(watch.state(), State::Stopped, "it stood already");
    assert_eq!(watch.see(1, at(7.0), true), 0);
    assert_eq!(watch.command(TICK_S, 0, Some(RAW)).speed_mps, 0.0);
    // Not while its odometry is none, nor while the loop has a fault.
    assert_eq!(watch.see(2, at(f64::NAN), true), Safety::ODOMETRY_INVALID);
    assert!(!watch.rearm(0));
    assert_eq!(watch.see(3, at(7.0), true), 0);
    assert!(!watch.rearm(Safety::ODOMETRY_STALE));
    assert!(watch.rearm(0));
    assert_eq!(watch.command(TICK_S, 0, Some(RAW)).speed_mps, 2.0);
    assert_eq!(watch.safety().changed, 0);
    watch.command(TICK_S, 0, Some(RawCommand { speed_mps: 100.0, ..RAW }));
    assert_eq!(watch.safety().changed, 1);
}

#[test]
fn the_governor_sees_speeds_that_are_believed() {
    let mut watch = Watch::new(&config(&[]));
    watch.see(0, Movement { speed_mps: 8.5, ..at(0.0) }, true);
    watch.see(1, Movement { speed_mps: 8.9, ..at(0.0) }, true);
    let fast = RawCommand { speed_mps: 9.0, ..RAW };
    assert!(watch.command(TICK_S, 0, Some(fast)).speed_mps < 8.0);
    let mut watch = Watch::new(&config(&[]));
    watch.see(0, Movement { speed_mps: 8.5, ..at(0.0) }, true);
    watch.see(0, Movement { speed_mps: 8.9, ..at(0.0) }, true);
    watch.see(1, Movement { speed_mps: 8.5, ..at(0.0) }, true);
    assert_eq!(watch.command(TICK_S, 0, Some(fast)).speed_mps, 9.0);
}

#[test]
fn it_goes_on_with_a_vehicle_that_drives() {
    let mut watch = Watch::new(&config(&["vehicle.safety.acceleration_limit_mps2=1.0"]));
    watch.resume(Movement { speed_mps: 3.0, ..at(0.0) }, 0.2);
    assert_eq!(watch.safety().steering_rad, 0.2);
    let passed = watch.command(TICK_S, 0, Some(RawCommand { speed_mps: 9.0, ..RAW }));
    assert!((passed.speed_mps - 3.01).abs() < 1e-12, "{}", passed.speed_mps);
}

#[test]
fn a_governor_at_rest_allows_all() {
    let mut governor = SpeedGovernor::new(&config(&[]));
    assert_eq!(governor.allowed_mps(0.0), 9.0);
    assert!(governor.allowed_mps(2.0) < 9.0, "200 m/s² would soon be too fast");
    governor.reset();
    assert_eq!(governor.allowed_mps(2.0), 9.0);
}
