//! Drives of a car without a network.

use super::*;
use crate::messages::Time;
use proptest::prelude::*;

const MS: u64 = 1_000_000;
const TICK: u64 = 10 * MS;
const T0: u64 = 1_000_000 * MS;

fn config(align: Align) -> RunConfig {
    let mut layers = config::Layers::maneuver("lane_change").unwrap();
    layers.set_vehicle("--vehicle", "ackermann").unwrap();
    let mut config = layers.resolve().unwrap();
    config.vehicle.ros2.align = align;
    config.vehicle.safety.command_age_limit_s = 0.1;
    config
}

fn reading(x_m: f64, speed_mps: f64, stamp: i32) -> Reading {
    let pose = Pose { x_m, y_m: 2.0, yaw_rad: 0.0 };
    let stamp = Time { sec: stamp, nanosec: 0 };
    Reading { pose, speed_mps, yaw_rate_radps: 0.0, stamp, age_ns: None }
}

const ALONE: Around = Around { is_heard: true, is_answered: true, other_drivers: 0 };

/// A car that hears us, and nobody else.
fn car(align: Align) -> Car {
    let mut car = Car::new(&config(align), 7);
    car.look_around(ALONE);
    car.is_followed = true;
    car.newest = Some((reading(0.0, 0.0, 0), 0));
    car
}

fn batch(batch: u64) -> BatchHeader {
    let attempt = Attempt { run: 7, batch, attempt: 1, reserved: 0 };
    BatchHeader { attempt, sent_ns: T0, ..BatchHeader::default() }
}

fn command(tick: u64, sent_ns: u64, speed_mps: f64, flags: u32) -> (TickHeader, [Command; 1]) {
    let header = TickHeader {
        attempt: batch(1).attempt,
        tick,
        supervisor_sent_ns: sent_ns,
        ..TickHeader::default()
    };
    (header, [Command { speed_mps, steering_rad: 0.1, flags, ..Command::default() }])
}

/// A car whose drive has begun at `T0`.
fn driving(align: Align) -> Car {
    let mut car = car(align);
    car.see(reading(0.0, 0.0, 1), T0);
    assert!(car.request(batch(1), &[DriveRequest::default()], T0));
    let step = car.step(T0);
    assert!(step.begun.is_some(), "{car:?}");
    assert_eq!(step.odometry.unwrap().0.tick, 0);
    car
}

fn odometry(step: Step) -> (TickHeader, Odometry) {
    step.odometry.expect("odometry is due")
}

#[test]
fn a_drive_ticks_by_the_clock_from_where_the_car_stands() {
    let mut car = driving(Align::Start);
    assert_eq!(car.due_ns(), T0 + TICK);
    assert_eq!(car.step(T0 + TICK - 1), Step::default());
    car.see(reading(1.5, 1.0, 2), T0 + 5 * MS);
    let (header, sent) = odometry(car.step(T0 + TICK));
    assert_eq!((header.tick, header.odometry_sent_ns, header.applied_ns), (1, T0 + TICK, 0));
    // It stood at (0, 2), which is where the path starts.
    assert_eq!((sent.measured.x_m, sent.measured.y_m), (1.5, 0.0));
    assert_eq!((sent.speed_mps, sent.status), (1.0, 0));
    // Missed ticks are skipped.
    let (header, _) = odometry(car.step(T0 + 5 * TICK + 3));
    assert_eq!(header.tick, 5);
    assert_eq!(car.due_ns(), T0 + 6 * TICK);
    assert_eq!(car.progress(), (1, 6));
}

#[test]
fn in_the_map_s_frame_the_car_must_stand_at_the_start() {
    let mut car = car(Align::Map);
    assert_eq!(car.waits(T0), Some(Waits::Odometry), "what came at time 0 is old");
    car.see(reading(0.0, 0.0, 1), T0);
    assert_eq!(car.offset(T0), Some(Offset { distance_m: 2.0, heading_rad: 0.0 }));
    assert!(car.request(batch(1), &[DriveRequest::default()], T0));
    assert_eq!(car.step(T0), Step::default());
    assert!(car.is_awaited());
    let mut at = reading(0.1, 0.3, 2);
    at.pose.y_m = 0.1;
    // There, but not at rest.
    car.see(at, T0 + 50 * TICK);
    assert_eq!(car.step(T0 + 50 * TICK).odometry, None);
    (at.speed_mps, at.stamp.sec) = (0.0, 3);
    car.see(at, T0 + 51 * TICK);
    let (header, sent) = odometry(car.step(T0 + 51 * TICK));
    assert_eq!((header.tick, sent.measured.x_m, sent.measured.y_m), (0, 0.1, 0.1));
    assert!(!car.is_awaited());
}

#[test]
fn commands_are_held_until_they_are_too_old() {
    let mut car = driving(Align::Start);
    let (header, commands) = command(0, T0 + MS, 2.0, 0);
    let told = car.obey(header, &commands, T0 + 2 * MS).unwrap();
    assert_eq!((told.speed_mps, told.steering_rad), (2.0, 0.1));
    let mut speeds = Vec::new();
    for k in 1..130 {
        let now = T0 + k * TICK;
        car.see(reading(0.0, 2.0, k as i32 + 1), now);
        let step = car.step(now);
        let (header, sent) = odometry(step);
        let setpoint = step.setpoint.unwrap();
        assert_eq!(header.applied_ns, T0 + 2 * MS);
        let is_old = now - (T0 + MS) > 100 * MS;
        assert_eq!(has(sent.status, Odometry::OWN_STOP), is_old, "{k}");
        assert_eq!(setpoint.steering_rad, if is_old { 0.0 } else { 0.1 });
        speeds.push(setpoint.speed_mps);
    }
    // 2 m/s at 2 m/s², after 0.1 s of the command's age.
    assert!(speeds.is_sorted_by(|a, b| a >= b));
    assert!((speeds[59] - 1.0).abs() < 0.03, "{speeds:?}");
    assert_eq!(speeds.last(), Some(&0.0));
    // The next fresh one ends it.
    let now = T0 + 130 * TICK;
    let (header, commands) = command(129, now, 1.0, 0);
    assert!(car.obey(header, &commands, now).is_some());
    car.see(reading(0.0, 0.0, 500), now);
    assert_eq!(odometry(car.step(now)).1.status, 0);
}

#[test]
fn late_old_strange_and_broken_commands_move_nothing() {
    let mut car = driving(Align::Start);
    let now = T0 + 20 * TICK;
    let (late, one) = command(3, now - 101 * MS, 2.0, 0);
    assert_eq!(car.obey(late, &one, now), None);
    assert_eq!(car.anomalies().late, 1);
    let (good, one) = command(10, now, 2.0, 0);
    assert!(car.obey(good, &one, now).is_some());
    let strange = [
        TickHeader { tick: 9, ..good },
        TickHeader { attempt: Attempt { run: 8, ..good.attempt }, ..good },
        TickHeader { attempt: Attempt { batch: 2, ..good.attempt }, ..good },
        TickHeader { attempt: Attempt { attempt: 2, ..good.attempt }, ..good },
    ];
    for header in strange {
        assert_eq!(car.obey(header, &one, now), None);
    }
    assert_eq!(car.obey(good, &[one[0], one[0]], now), None);
    assert_eq!(car.anomalies().dropped, 5);
    let broken = [Command { speed_mps: f64::NAN, ..one[0] }];
    assert_eq!(car.obey(good, &broken, now), Some(Setpoint::default()));
    assert_eq!(car.anomalies().rejected, 1);
    let strange = Attempt { run: 8, ..batch(2).attempt };
    assert!(!car.request(
        BatchHeader { attempt: strange, ..batch(2) },
        &[DriveRequest::default()],
        now
    ));
    assert!(!car.request(batch(2), &[DriveRequest::default(); 2], now));
    assert_eq!(car.progress().0, 1);
}

#[test]
fn behind_its_end_the_car_stops_and_still_tells_where_it_is() {
    let mut car = driving(Align::Start);
    let (header, one) = command(0, T0, 2.0, 0);
    car.obey(header, &one, T0);
    // Even if it comes too late.
    let (header, one) = command(1, T0, 2.0, Command::ENDED);
    assert_eq!(car.obey(header, &one, T0 + 50 * TICK), None);
    car.see(reading(0.0, 2.0, 9), T0 + 50 * TICK);
    let step = car.step(T0 + 50 * TICK);
    assert_eq!(odometry(step).1.status, Odometry::ENDED);
    assert!(step.setpoint.unwrap().speed_mps < 2.0);
    let now = T0 + 55 * TICK;
    let (header, one) = command(55, now, 0.5, Command::ENDED);
    assert_eq!(car.obey(header, &one, now).unwrap().speed_mps, 0.5, "it is brought to a stop");
    assert_eq!(car.step(now).setpoint.unwrap().speed_mps, 0.5);
    let (header, one) = command(60, T0 + 60 * TICK, 2.0, 0);
    assert_eq!(car.obey(header, &one, T0 + 60 * TICK), None, "it does not go on");
    // The next request waits until it stands, and begins there.
    assert!(car.request(batch(2), &[DriveRequest::default()], T0 + 60 * TICK));
    car.see(reading(5.0, 0.5, 10), T0 + 60 * TICK);
    let step = car.step(T0 + 60 * TICK);
    assert!(step.odometry.is_none() && step.setpoint.is_some());
    car.see(reading(6.0, 0.0, 11), T0 + 200 * TICK);
    let (header, sent) = odometry(car.step(T0 + 200 * TICK));
    assert_eq!((header.attempt.batch, header.tick), (2, 0));
    assert_eq!((sent.measured.x_m, sent.status), (0.0, 0));
}

#[test]
fn old_odometry_is_not_passed_on_and_repeating_it_makes_it_no_younger() {
    let mut car = driving(Align::Start);
    for k in 1..=20 {
        let now = T0 + k * TICK;
        car.see(reading(0.0, 0.0, 1), now);
        let step = car.step(now);
        assert_eq!(step.odometry.is_some(), k <= 10, "{k}");
        assert!(step.setpoint.is_some());
    }
    assert_eq!((car.anomalies().stale, car.anomalies().late), (10, 10));
    assert_eq!(car.odometry_age_ns(T0 + 20 * TICK), Some(20 * TICK));
    car.see(reading(0.0, 0.0, 2), T0 + 21 * TICK);
    assert!(car.step(T0 + 21 * TICK).odometry.is_some());
}

#[test]
fn the_age_of_odometry_counts_from_its_measurement_where_that_is_known() {
    let mut car = driving(Align::Start);
    let measured = |ms: u64, stamp| Reading { age_ns: Some(ms * MS), ..reading(1.0, 1.0, stamp) };
    assert_eq!(car.see(measured(80, 2), T0 + TICK), None);
    assert_eq!(car.odometry_age_ns(T0 + TICK), Some(80 * MS));
    assert!(car.step(T0 + 3 * TICK).odometry.is_some());
    // 0.1 s are allowed.
    assert!(car.step(T0 + 4 * TICK).odometry.is_none());
    let old = NotUsed::Old { age_s: 5.0, limit_s: 0.1 };
    assert_eq!(car.see(measured(5000, 3), T0 + 5 * TICK), Some(old));
    assert!(car.step(T0 + 5 * TICK).odometry.is_none());
    let stands = Some(NotUsed::StampStands(Time { sec: 2, nanosec: 0 }));
    assert_eq!(car.see(measured(0, 2), T0 + 6 * TICK), stands);
}

#[test]
fn a_drive_does_not_begin_beside_another_driver_or_where_nobody_receives() {
    let mut car = Car::new(&config(Align::Start), 7);
    car.see(reading(0.0, 0.0, -1), T0);
    assert_eq!(
        car.waits(T0),
        Some(Waits::Odometry),
        "one message does not show that its stamp moves"
    );
    let mut stamp = 0;
    let mut stand = |car: &mut Car, now_ns| {
        stamp += 1;
        car.see(reading(0.0, 0.0, stamp), now_ns);
        car.step(now_ns).begun.is_some()
    };
    assert!(car.request(batch(1), &[DriveRequest::default()], T0));
    assert!(!stand(&mut car, T0));
    assert_eq!(car.waits(T0), Some(Waits::Subscriber));
    car.look_around(Around { other_drivers: 1, ..ALONE });
    assert!(!stand(&mut car, T0 + TICK));
    assert_eq!(car.waits(T0 + TICK), Some(Waits::OtherDriver));
    car.look_around(ALONE);
    assert!(stand(&mut car, T0 + 2 * TICK));
}

#[test]
fn beside_another_driver_the_car_stops_until_the_next_drive() {
    let mut car = driving(Align::Start);
    let (header, one) = command(0, T0, 2.0, 0);
    assert!(car.obey(header, &one, T0).is_some());
    car.look_around(Around { other_drivers: 1, ..ALONE });
    let mut speed_mps = 2.0;
    for k in 1..150 {
        let now = T0 + k * TICK;
        // Gone again: the drive is lost all the same.
        if k == 50 {
            car.look_around(ALONE);
        }
        let (header, one) = command(k, now, 2.0, 0);
        assert_eq!(car.obey(header, &one, now), None);
        car.see(reading(0.0, speed_mps, k as i32 + 1), now);
        let step = car.step(now);
        assert_eq!(odometry(step).1.status, Odometry::OWN_STOP);
        let told = step.setpoint.unwrap();
        assert!(told.speed_mps < speed_mps || told.speed_mps == 0.0);
        assert_eq!(told.steering_rad, 0.0);
        speed_mps = told.speed_mps;
    }
    assert_eq!(speed_mps, 0.0);
    let now = T0 + 150 * TICK;
    assert!(car.request(batch(2), &[DriveRequest::default()], now));
    car.see(reading(0.0, 0.0, 999), now);
    assert!(car.step(now).begun.is_some());
}

#[test]
fn what_nobody_received_was_not_applied() {
    let mut car = driving(Align::Start);
    let (header, one) = command(0, T0, 2.0, 0);
    car.obey(header, &one, T0 + MS);
    car.look_around(Around::default());
    let (header, one) = command(1, T0 + TICK, 2.0, 0);
    car.obey(header, &one, T0 + TICK);
    car.see(reading(0.0, 2.0, 2), T0 + TICK);
    let (header, sent) = odometry(car.step(T0 + TICK));
    assert_eq!((header.applied_ns, sent.status), (T0 + MS, 0));
    // Nor does the car stop by itself because of commands that it does not get.
    car.see(reading(0.0, 2.0, 3), T0 + 30 * TICK);
    assert_eq!(odometry(car.step(T0 + 30 * TICK)).1.status, 0);
}

#[test]
fn a_collision_is_told_until_the_next_request() {
    let mut car = driving(Align::Start);
    car.collide();
    for k in 1..3 {
        let (_, sent) = odometry(car.step(T0 + k * TICK));
        assert_eq!(sent.status, Odometry::COLLISION);
    }
    assert!(car.request(batch(2), &[DriveRequest::default()], T0 + 3 * TICK));
    // A collision before the drive does not belong to it.
    car.collide();
    assert_eq!(odometry(car.step(T0 + 3 * TICK)).1.status, 0);
}

#[test]
fn a_restarted_process_goes_on_where_the_car_is() {
    let mut car = driving(Align::Start);
    car.see(reading(3.0, 2.0, 4), T0 + 29 * TICK);
    let before = odometry(car.step(T0 + 29 * TICK));
    let begun = Begun {
        attempt: batch(1).attempt,
        alignment: Alignment { turn_rad: 0.0, x_m: 0.0, y_m: -2.0 },
    };
    let mut car = self::car(Align::Start);
    let now = T0 + 30 * TICK;
    assert!(car.request(batch(1), &[DriveRequest::default()], now));
    car.rejoin(begun, T0, now);
    car.see(reading(3.0, 2.0, 5), now);
    let step = car.step(now);
    let (header, sent) = odometry(step);
    assert_eq!((header.tick, before.0.tick), (30, 29));
    assert_eq!(sent.measured, before.1.measured);
    // Until a command of the supervisor comes it stops by itself, from its present speed.
    assert_eq!(sent.status, Odometry::OWN_STOP);
    assert_eq!(step.setpoint.unwrap().speed_mps, 2.0);
    let (header, one) = command(30, now, 2.5, 0);
    assert_eq!(car.obey(header, &one, now).unwrap().speed_mps, 2.5);
    // Another drive's beginning is of no use.
    let mut other = self::car(Align::Start);
    assert!(other.request(batch(2), &[DriveRequest::default()], now));
    other.rejoin(begun, T0, now);
    assert!(other.is_awaited());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(500))]
    #[test]
    fn ticks_grow_and_the_car_is_never_left_without_word(
        events in proptest::collection::vec((0..4u8, 0..40u64, any::<f64>()), 1..200),
    ) {
        let mut car = driving(Align::Start);
        let (mut now, mut last_tick, mut last_told) = (T0, 0, T0);
        for (kind, wait_ms, number) in events {
            now += wait_ms * MS;
            match kind {
                0 => {
                    car.see(reading(0.0, 1.0, (now / MS) as i32), now);
                }
                1 => {
                    let (header, one) = command((now - T0) / TICK, now, number, 0);
                    if let Some(told) = car.obey(header, &one, now) {
                        prop_assert!((0.0..=5.0).contains(&told.speed_mps));
                        last_told = now;
                    }
                }
                _ => {}
            }
            let step = car.step(now);
            if let Some(told) = step.setpoint {
                prop_assert!((0.0..=5.0).contains(&told.speed_mps));
                last_told = now;
            }
            prop_assert!(now - last_told < TICK);
            if let Some((header, sent)) = step.odometry {
                prop_assert!(header.tick > last_tick);
                prop_assert!(sent.measured.x_m.is_finite());
                last_tick = header.tick;
            }
        }
    }
}

#[test]
fn a_drive_begins_once_a_command_is_acknowledged_and_does_not_go_on_once_the_car_is_lost() {
    let mut car = car(Align::Start);
    car.look_around(Around { is_answered: false, ..ALONE });
    car.see(reading(0.0, 0.0, 1), T0);
    assert_eq!((car.waits(T0), car.start_waits(T0)), (None, Some(Waits::Answer)));
    // Before a drive is requested, nothing is said to the car.
    assert_eq!(car.step(T0), Step::default());
    assert!(car.request(batch(1), &[DriveRequest::default()], T0));
    for k in 0..5 {
        let step = car.step(T0 + k * TICK);
        assert_eq!(
            (step.setpoint, step.odometry, step.begun),
            (Some(Setpoint::default()), None, None)
        );
    }
    assert!(!car.lose(), "no drive is under way");
    car.look_around(ALONE);
    assert!(car.step(T0 + 5 * TICK).begun.is_some());
    let (header, commands) = command(0, T0 + 5 * TICK, 2.0, 0);
    assert_eq!(car.obey(header, &commands, T0 + 6 * TICK).unwrap().speed_mps, 2.0);
    assert!(car.is_told(T0 + 15 * TICK) && !car.is_told(T0 + 16 * TICK));
    assert!(car.lose() && !car.lose());
    let (header, commands) = command(1, T0 + 6 * TICK, 2.0, 0);
    assert_eq!(car.obey(header, &commands, T0 + 7 * TICK), None);
    car.see(reading(0.1, 2.0, 2), T0 + 8 * TICK);
    let step = car.step(T0 + 8 * TICK);
    let slower_mps = step.setpoint.unwrap().speed_mps;
    assert!(slower_mps < 2.0 && has(odometry(step).1.status, Odometry::OWN_STOP), "{step:?}");
}
