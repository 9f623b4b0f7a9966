//! Drives that tell less than they seem to, or nothing.
#![allow(clippy::disallowed_methods, clippy::disallowed_types, reason = "a test")]

mod support;

use config::Vehicle;
use identification::{Drive, Options, Refusal, identify};
use support::{Dice, SENSORS, Sensors, drive, excite, hidden_car};
use tracking::{EXCITATION_S, excitation};

const EXACT: Sensors =
    Sensors { position_sd_m: 0.0, heading_sd_rad: 0.0, speed_sd_mps: 0.0, yaw_rate_sd_radps: 0.0 };

fn car() -> (Vehicle, Vehicle, Dice) {
    let mut dice = Dice::new(7);
    let (car, file) = hidden_car(&mut dice);
    (car, file, dice)
}

fn refusal(drive: Drive, file: &Vehicle) -> Refusal {
    identify(&[drive], file, Options::default()).unwrap_err()
}

#[test]
fn odometry_that_is_computed_from_the_command_is_refused() {
    let (car, file, mut dice) = car();
    let mut computed = excite(&car, &SENSORS, &mut dice);
    let mut yaw_rad = 0.0;
    for at in 1..computed.odometry.len() {
        // A tick late, rounded as in a text, and some commands another tick late: as drivers do it.
        let late = at.saturating_sub(1 + usize::from(at % 3 == 0));
        let command = computed.commands[late].steering_rad;
        let seen = &mut computed.odometry[at];
        let rate = seen.speed_mps * libm::tan(command) / 0.25;
        seen.yaw_rate_radps = (1e5 * rate).round() / 1e5;
        yaw_rad += 0.01 * rate;
        seen.yaw_rad = yaw_rad;
    }
    match refusal(computed.clone(), &file) {
        Refusal::Computed { wheelbase_m } => assert!((wheelbase_m - 0.25).abs() < 1e-3),
        other => panic!("{other}"),
    }
    // The heading tells the same, where there is no yaw rate.
    for seen in &mut computed.odometry {
        seen.yaw_rate_radps = f64::NAN;
    }
    assert!(matches!(refusal(computed.clone(), &file), Refusal::Computed { .. }));
    for seen in &mut computed.odometry {
        (seen.yaw_rate_radps, seen.yaw_rad) = (0.0, 0.0);
    }
    assert_eq!(refusal(computed, &file), Refusal::NoYawRate);
}

#[test]
fn a_yaw_rate_computed_with_a_servo_s_gain_and_trim_is_refused_as_well() {
    let (car, file, mut dice) = car();
    let mut computed = excite(&car, &SENSORS, &mut dice);
    let mut yaw_rad = 0.0;
    for at in 1..computed.odometry.len() {
        let command = computed.commands[at - 1].steering_rad;
        let seen = &mut computed.odometry[at];
        let rate = seen.speed_mps * libm::tan(0.9 * command + 0.02) / 0.3;
        seen.yaw_rate_radps = (1e5 * rate).round() / 1e5;
        yaw_rad += 0.01 * rate;
        seen.yaw_rad = yaw_rad;
    }
    assert_eq!(refusal(computed, &file), Refusal::OfCommand);
}

#[test]
fn a_speed_that_is_the_commanded_one_tells_nothing_of_the_speed_loop() {
    let (car, file, mut dice) = car();
    let measured = excite(&car, &SENSORS, &mut dice);
    let found = identify(std::slice::from_ref(&measured), &file, Options::default()).unwrap();
    let of_loop = |row: &&identification::Row| row.key == "speed_kp";
    assert!(found.rows.iter().find(of_loop).unwrap().identified);
    let mut computed = measured;
    for at in 1..computed.odometry.len() {
        computed.odometry[at].speed_mps = computed.commands[at - 1].speed_mps;
    }
    let found = identify(&[computed], &file, Options::default()).unwrap();
    let speed_loop = ["speed_delay_s", "speed_kp", "speed_ki", "brake_decel_mps2", "pedal_lag_s"];
    for row in found.rows.iter().filter(|row| speed_loop.contains(&row.key)) {
        assert!(!row.identified && row.after == row.before, "{row:?}");
    }
    assert_eq!(found.vehicle.speed_kp, file.speed_kp);
    assert!(found.warnings.iter().any(|it| it.contains("commanded one")), "{:?}", found.warnings);
}

#[test]
fn noise_of_the_heading_is_told_by_its_standard_deviation_whatever_it_is_like() {
    let (car, file, mut dice) = car();
    let sensors = Sensors { heading_sd_rad: 0.0, ..SENSORS };
    let exact = excite(&car, &sensors, &mut dice);
    // Normal, and even: of the latter the median of the absolutes is larger.
    for is_even in [false, true] {
        let mut noisy = exact.clone();
        for seen in &mut noisy.odometry {
            let draw =
                if is_even { 3.0_f64.sqrt() * dice.uniform(-1.0, 1.0) } else { dice.normal() };
            seen.yaw_rad += 0.01 * draw;
        }
        let found = identify(&[noisy], &file, Options::default()).unwrap();
        let share = found.noise.heading_half_width_rad / 6.0_f64.sqrt() / 0.01;
        assert!((share - 1.0).abs() < 0.05, "even: {is_even}, {share}");
    }
}

#[test]
fn a_car_without_noise_is_not_taken_for_a_formula_if_its_steering_is_one_of_a_car() {
    let (car, file, mut dice) = car();
    let found = identify(&[excite(&car, &EXACT, &mut dice)], &file, Options::default()).unwrap();
    assert!((found.vehicle.wheelbase_m / car.wheelbase_m - 1.0).abs() < 1e-3);
    assert!((found.vehicle.steering_delay_s - car.steering_delay_s).abs() < 2e-3);
    assert!(found.is_better());
}

#[test]
fn a_car_that_turns_the_wrong_way_or_as_it_likes_is_refused() {
    let (car, file, mut dice) = car();
    let driven = excite(&car, &SENSORS, &mut dice);
    let mut wrong = driven.clone();
    wrong.commands.iter_mut().for_each(|it| it.steering_rad = -it.steering_rad);
    assert_eq!(refusal(wrong, &file), Refusal::WrongWay);
    let mut by_hand = driven.clone();
    by_hand.commands.iter_mut().for_each(|it| it.steering_rad = 0.01 * dice.normal());
    assert!(matches!(refusal(by_hand, &file), Refusal::DoesNotFollow { .. }));
    let mut in_degrees = driven.clone();
    in_degrees.commands.iter_mut().for_each(|it| it.steering_rad = it.steering_rad.to_degrees());
    assert!(matches!(refusal(in_degrees, &file), Refusal::NotRadians { .. }));
    let mut short = driven;
    short.odometry.truncate(1500);
    assert!(matches!(refusal(short, &file), Refusal::TooShort { .. }));
    assert!(matches!(refusal(Drive::default(), &file), Refusal::TooShort { .. }));
}

#[test]
fn outliers_late_samples_a_wrong_wheel_and_a_biased_gyro_do_not_mislead() {
    let (car, file, mut dice) = car();
    let mut driven = excite(&car, &SENSORS, &mut dice);
    for seen in &mut driven.odometry {
        if dice.uniform(0.0, 1.0) < 0.05 {
            seen.x_m += 2.0 * dice.normal();
            seen.yaw_rate_radps += dice.normal();
        }
        seen.speed_mps *= 1.03;
        seen.yaw_rate_radps += 0.004;
    }
    let found = identify(&[driven], &file, Options::default()).unwrap();
    assert!((found.vehicle.wheelbase_m / car.wheelbase_m - 1.0).abs() < 0.006);
    assert!((found.speed_scale - 1.03).abs() < 0.002, "{}", found.speed_scale);
    assert!(found.warnings.iter().any(|it| it.contains("3.0 % more")), "{:?}", found.warnings);
    let sum_s = car.steering_delay_s + car.steering_lag_s;
    assert!((found.delay_and_lag.after - sum_s).abs() < 0.006);
}

#[test]
fn what_is_missing_is_named() {
    // Straight on and gentle bends at one speed: neither rates nor pedals come to their ends.
    let (car, file, mut dice) = car();
    let gentle = |time_s: f64| match time_s {
        ..1.0 => (0.0, 0.0),
        _ => (0.04 * libm::sin(0.5 * time_s), 1.5),
    };
    let found =
        identify(&[drive(&car, 60.0, &SENSORS, &mut dice, gentle)], &file, Options::default());
    let found = found.unwrap();
    for key in ["steering_rate_radps", "brake_decel_mps2"] {
        let row = found.rows.iter().find(|row| row.key == key).unwrap();
        assert!(!row.identified && row.before.to_bits() == row.after.to_bits(), "{row:?}");
        let next = row.drive_next().unwrap();
        assert!(found.drive_next.iter().any(|it| it == next));
    }
    // What was driven is not asked for again, whatever it did not tell.
    let found = identify(&[excite(&car, &SENSORS, &mut dice)], &file, Options::default()).unwrap();
    assert!(found.rows.iter().any(|row| row.key == "speed_kp" && row.identified));
    assert!(found.drive_next.iter().all(|it| !it.starts_with("steps of the commanded speed")));
}

#[test]
fn a_measured_wheelbase_gives_the_gain_in_its_place() {
    let (mut car, mut file, mut dice) = car();
    car.steering_gain = 0.9;
    file.wheelbase_m = car.wheelbase_m;
    let driven = excite(&car, &SENSORS, &mut dice);
    let options = Options { wheelbase_is_measured: true, ..Options::default() };
    let found = identify(&[driven], &file, options).unwrap();
    assert_eq!(found.vehicle.wheelbase_m.to_bits(), car.wheelbase_m.to_bits());
    assert!((found.vehicle.steering_gain - 0.9).abs() < 0.005, "{}", found.vehicle.steering_gain);
}

#[test]
fn of_a_long_recording_some_minutes_are_fitted_and_it_repeats_bit_for_bit() {
    let (car, file, mut dice) = car();
    let lively = |time_s: f64| match time_s % 150.0 {
        ..EXCITATION_S => excitation(time_s % 150.0, 0.25, 2.0, 0.0),
        _ => (0.0, 2.0),
    };
    let long = [drive(&car, 300.0, &SENSORS, &mut dice, lively)];
    let found = identify(&long, &file, Options::default()).unwrap();
    assert!(found.fitted_s <= 150.0 && found.recorded_s > 290.0, "{}", found.fitted_s);
    assert!((found.vehicle.wheelbase_m / car.wheelbase_m - 1.0).abs() < 0.01);
    assert_eq!(found, identify(&long, &file, Options::default()).unwrap());
}

/// The speed loop is in the middle of something where a recording begins while the car changes its speed, and behind a gap.
#[test]
fn a_recording_that_begins_midway_or_has_gaps_tells_the_same_speed_loop() {
    let (car, file, mut dice) = car();
    let driven = excite(&car, &SENSORS, &mut dice);
    let without = |from_s: f64, to_s: f64| {
        let mut cut = driven.clone();
        cut.odometry.retain(|it| !(from_s..to_s).contains(&it.time_s));
        cut.commands.retain(|it| from_s > 0.0 || it.time_s >= to_s);
        cut
    };
    // While it speeds up, brakes, and speeds up to twice the speed.
    for cut in [without(0.0, 16.0), without(26.4, 27.0), without(30.3, 30.9), without(34.4, 35.0)] {
        let found = identify(&[cut], &file, Options::default()).unwrap();
        let (kp, throttle) = (found.vehicle.speed_kp, found.vehicle.throttle_accel_mps2);
        assert!((kp / car.speed_kp - 1.0).abs() < 0.1, "{kp} {}", car.speed_kp);
        assert!((throttle / car.throttle_accel_mps2 - 1.0).abs() < 0.1, "{throttle}");
        assert!(found.predictions[1].after_m < 0.08, "{:?}", found.predictions);
    }
}

#[test]
fn rear_tyres_that_slip_are_found_by_fast_bends_and_others_are_left_alone() {
    let mut dice = Dice::new(8);
    let (mut car, mut file) = hidden_car(&mut dice);
    // A car with linear tyres, of which the file knows nothing: c = m·a/(L·Cr), with a the way from the front axle to the
    // centre of gravity.
    car.model = config::VehicleModel::Dynamic;
    car.front_axle_to_cg_m = 0.5 * car.wheelbase_m;
    let slip_s2pm = car.mass_kg * 0.5 / car.cornering_stiffness_rear_npr;
    file.model = config::VehicleModel::Kinematic;
    let at = |base_mps: f64, car: &Vehicle, dice: &mut Dice| {
        drive(car, EXCITATION_S, &SENSORS, dice, |time_s| excitation(time_s, 0.2, base_mps, 0.0))
    };
    let of = |found: &identification::Identification, key: &str| {
        found.rows.iter().find(|row| row.key == key).unwrap().clone()
    };
    let slip = |found: &identification::Identification| of(found, "rear_slip_s2pm");
    let found = identify(&[at(3.2, &car, &mut dice)], &file, Options::default()).unwrap();
    for row in &found.rows {
        eprintln!("{} {} {:?} {:?}", row.key, row.after, row.interval, row.why);
    }
    eprintln!("{car:?}");
    let row = slip(&found);
    let [low, high] = row.interval.unwrap();
    assert!(low < slip_s2pm && slip_s2pm < high && high - low < 0.003, "{row:?} {slip_s2pm}");
    assert_eq!(found.vehicle.rear_slip_s2pm.to_bits(), row.after.to_bits());
    // Its front tyres slip more, and its body has to be turned.
    let understeer_s2pm = car.mass_kg * 0.5 / car.cornering_stiffness_front_npr - slip_s2pm;
    let tyres_nm2 = car.cornering_stiffness_front_npr + car.cornering_stiffness_rear_npr;
    let lag_s2pm = car.yaw_inertia_kgm2 / (car.front_axle_to_cg_m.powi(2) * tyres_nm2);
    eprintln!(
        "{:?} {understeer_s2pm}\n{:?} {lag_s2pm} wheelbase {}",
        of(&found, "understeer_s2pm"),
        of(&found, "yaw_lag_s2pm"),
        car.wheelbase_m
    );
    eprintln!("{:?}", found.rows);
    assert!((found.vehicle.tracked_point_m - car.tracked_point_m).abs() < 0.05);
    // Half of that speed tells it of tyres that slip as much as a family car's, as the last bend is long.
    let soft_npr = car.mass_kg * 0.5 / 0.004;
    let soft = Vehicle {
        cornering_stiffness_front_npr: soft_npr,
        cornering_stiffness_rear_npr: soft_npr,
        ..car.clone()
    };
    let slow = [excite(&soft, &SENSORS, &mut dice)];
    let [low, high] = slip(&identify(&slow, &file, Options::default()).unwrap()).interval.unwrap();
    assert!(low < 0.004 && 0.004 < high && high - low < 0.005, "{low} {high}");
    // Tyres that do not slip are told to do as the file says, and nothing more has to be driven for them.
    car.model = config::VehicleModel::Kinematic;
    let found = identify(&[at(3.2, &car, &mut dice)], &file, Options::default()).unwrap();
    let row = slip(&found);
    assert!(!row.identified && row.agrees && row.after == 0.0, "{row:?}");
    assert!(!found.drive_next.iter().any(|it| it.contains("as fast as")), "{:?}", found.drive_next);
}

#[test]
fn poses_that_are_older_than_the_yaw_rate_are_told_and_do_not_bend_the_dead_time() {
    let (car, file, mut dice) = car();
    let mut driven = excite(&car, &SENSORS, &mut dice);
    let fresh = driven.odometry.clone();
    for (at, seen) in driven.odometry.iter_mut().enumerate() {
        let old = fresh[at.saturating_sub(4)];
        (seen.x_m, seen.y_m, seen.yaw_rad) = (old.x_m, old.y_m, old.yaw_rad);
    }
    let found = identify(&[driven.clone()], &file, Options::default()).unwrap();
    let off_s = found.vehicle.steering_delay_s - car.steering_delay_s;
    assert!(off_s.abs() < 0.003, "{off_s}");
    let told = |it: &&String| it.starts_with("the poses in the odometry come");
    let told = found.warnings.iter().find(told).unwrap();
    assert!(["35 ms", "34 ms", "36 ms"].iter().any(|age| told.contains(age)), "{told}");
    let fresh = Drive { odometry: fresh, ..driven };
    let found = identify(&[fresh], &file, Options::default()).unwrap();
    assert!(found.warnings.is_empty(), "{:?}", found.warnings);
}

#[test]
fn limits_of_the_file_that_the_car_does_not_have_are_told() {
    let (car, mut file, mut dice) = car();
    let driven = excite(&car, &SENSORS, &mut dice);
    (file.steering_limit_rad, file.speed_limit_mps) = (0.2, 3.0);
    let found = identify(&[driven], &file, Options::default()).unwrap();
    for told in [
        "commands go up to 0.250 rad, and the file's steering_limit_rad is 0.2",
        "speed_limit_mps is 3:",
    ] {
        assert!(found.warnings.iter().any(|it| it.contains(told)), "{:?}", found.warnings);
    }
}

/// The speed controller of another's car: in the model's terms much throttle, much drag and little gain. No pedal comes to its
/// end, so the drive tells the throttle only roughly, but with the file's throttle it would.
#[test]
fn a_value_that_does_not_fit_gives_way_even_if_the_drive_hardly_tells_it() {
    let (mut car, mut file, mut dice) = car();
    (car.throttle_accel_mps2, car.speed_kp, car.speed_ki) = (30.0, 0.064, 0.13);
    (car.drag_per_s, car.rolling_decel_mps2, car.pedal_lag_s) = (2.0, 1.4, 0.003);
    (file.throttle_accel_mps2, file.speed_kp, file.speed_ki) = (3.0, 0.67, 0.05);
    (file.drag_per_s, file.rolling_decel_mps2, file.pedal_lag_s) = (0.05, 0.15, 0.1);
    let found = identify(&[excite(&car, &SENSORS, &mut dice)], &file, Options::default()).unwrap();
    assert!(found.is_better(), "{:?}", found.predictions);
    assert!(found.predictions.iter().all(|it| it.after_m < 0.05), "{:?}", found.predictions);
    assert!(found.vehicle.throttle_accel_mps2 > 6.0, "{}", found.vehicle.throttle_accel_mps2);
}

/// The value of a key that was identified, and its interval.
fn told(found: &identification::Identification, key: &str) -> Option<(f64, [f64; 2])> {
    let row = found.rows.iter().find(|it| it.key == key)?;
    Some((row.after, row.interval?))
}

#[test]
fn wheels_that_stop_before_the_file_s_limit_are_not_taken_for_slow_ones() {
    let (mut car, file, mut dice) = car();
    car.steering_limit_rad = 0.19;
    let found = identify(&[excite(&car, &SENSORS, &mut dice)], &file, Options::default()).unwrap();
    let (stop, [low, high]) = told(&found, "steering_limit_rad").unwrap();
    assert!(
        (stop / 0.19 - 1.0).abs() < 0.01 && low <= 0.19 && 0.19 <= high,
        "{stop} [{low}, {high}]"
    );
    assert_eq!(found.vehicle.steering_limit_rad, stop);
    let (rate, _) = told(&found, "steering_rate_radps").unwrap();
    assert!((rate / car.steering_rate_radps - 1.0).abs() < 0.05, "{rate}");
    let off = found.vehicle.wheelbase_m / car.wheelbase_m - 1.0;
    assert!(off.abs() < 0.01, "{off}");
}

#[test]
fn wheels_that_turn_farther_than_the_file_s_limit_are_told_as_they_are() {
    let (car, mut file, mut dice) = car();
    file.steering_limit_rad = 0.2;
    let found = identify(&[excite(&car, &SENSORS, &mut dice)], &file, Options::default()).unwrap();
    let (rate, _) = told(&found, "steering_rate_radps").unwrap();
    assert!((rate / car.steering_rate_radps - 1.0).abs() < 0.05, "{rate}");
    let off = found.vehicle.wheelbase_m / car.wheelbase_m - 1.0;
    assert!(off.abs() < 0.01, "{off}");
    let is_told = |it: &String| it.contains("the file's steering_limit_rad is 0.2");
    assert!(found.warnings.iter().any(is_told), "{:?}", found.warnings);
}

/// A sample in so many.
fn thinned(mut drive: Drive, every: usize) -> Drive {
    drive.odometry = drive.odometry.into_iter().step_by(every).collect();
    drive
}

#[test]
fn commands_that_come_oftener_than_odometry_do_not_bound_the_steering_rate() {
    let (mut car, file, mut dice) = car();
    // Ramps of 0.5 rad/s at 100 Hz, between angles that are held for a while.
    let angles = [0.0_f64, 0.25, -0.25, 0.125, -0.125, 0.25, 0.0, -0.25];
    let ramped = |time_s: f64| {
        let (turn, since_s) = (((time_s - 3.0).max(0.0) / 2.0) as usize, (time_s - 3.0) % 2.0);
        let (from, to) = (angles[turn % 8], angles[(turn + 1) % 8]);
        let most = 0.5 * f64::max(since_s, 0.0);
        let speed_mps = if time_s < 1.0 { 0.0 } else { [2.0, 3.0, 1.5][turn / 8 % 3] };
        (from + (to - from).clamp(-most, most), speed_mps)
    };
    for rate_radps in [0.3, 2.0] {
        car.steering_rate_radps = rate_radps;
        let driven = drive(&car, 60.0, &SENSORS, &mut dice, ramped);
        for every in [2, 5] {
            let driven = thinned(driven.clone(), every);
            let found = identify(&[driven], &file, Options::default()).unwrap();
            let of = format!("rate {rate_radps}, every {every}: {:?}", found.rows);
            // Wheels that keep up with the ramps do not show their rate.
            let row = found.rows.iter().find(|it| it.key == "steering_rate_radps").unwrap();
            match row.identified && !row.roughly {
                true => assert!((row.after / rate_radps - 1.0).abs() < 0.05, "{of}"),
                false => assert!(rate_radps > 0.5, "{of}"),
            }
            assert_eq!(told(&found, "steering_limit_rad"), None, "{of}");
            assert!((found.vehicle.wheelbase_m / car.wheelbase_m - 1.0).abs() < 0.01, "{of}");
            let sum_s = found.delay_and_lag.after - car.steering_delay_s - car.steering_lag_s;
            assert!(sum_s.abs() < 0.02, "{sum_s} {of}");
        }
    }
}

#[test]
fn a_car_that_stands_before_its_first_command_tells_the_same_speed_loop() {
    let (car, file, mut dice) = car();
    for wait_s in [1.0, 8.0] {
        let waits = |time_s: f64| match time_s {
            time_s if time_s < wait_s => (0.0, 0.0),
            _ => excitation(time_s - wait_s + 1.1, 0.25, 2.0, 0.0),
        };
        let mut driven = drive(&car, EXCITATION_S + wait_s, &SENSORS, &mut dice, waits);
        driven.commands.retain(|it| it.time_s >= wait_s - 1e-6);
        assert!(driven.commands[0].speed_mps > 1.0);
        let found = identify(&[driven], &file, Options::default()).unwrap();
        let product = |it: &Vehicle| it.speed_kp * it.throttle_accel_mps2;
        for (of, limit) in [
            (product(&found.vehicle) / product(&car) - 1.0, 0.05),
            (found.vehicle.rolling_decel_mps2 / car.rolling_decel_mps2 - 1.0, 0.3),
            (found.vehicle.speed_delay_s - car.speed_delay_s, 0.01),
        ] {
            assert!(of.abs() < limit, "after {wait_s} s: {of}, {:?}", found.rows);
        }
    }
}

/// Odometry whose heading follows the command by v·tan(δ)/L, a tick late, at a speed that is a share of the car's.
fn by_formula(mut driven: Drive, wheelbase_m: f64, slower: f64) -> Drive {
    let mut yaw_rad = 0.0;
    for at in 1..driven.odometry.len() {
        let held_s = driven.odometry[at].time_s - driven.odometry[at - 1].time_s;
        let seen = &mut driven.odometry[at];
        for value in [&mut seen.speed_mps, &mut seen.x_m, &mut seen.y_m] {
            *value *= slower;
        }
        seen.yaw_rate_radps =
            seen.speed_mps * libm::tan(driven.commands[at - 1].steering_rad) / wheelbase_m;
        yaw_rad += held_s * seen.yaw_rate_radps;
        seen.yaw_rad = yaw_rad;
    }
    driven
}

#[test]
fn computed_odometry_is_refused_in_any_stretch_at_any_size_and_by_a_heading_that_arrives_unevenly()
{
    let (car, file, mut dice) = car();
    let excited = excite(&car, &SENSORS, &mut dice);
    // A car that creeps: the wheelbase has to tell how fast is fast.
    let slow = by_formula(excited.clone(), 0.3, 0.15);
    assert!(slow.odometry.iter().all(|it| it.speed_mps < 0.7));
    assert!(matches!(refusal(slow, &file), Refusal::Computed { .. }));
    // The longest stretch hardly steers, and a shorter one behind a gap does.
    let gentle = |time_s: f64| {
        if time_s < 50.0 { (0.0, 2.0) } else { excitation(time_s - 49.0, 0.25, 2.0, 0.0) }
    };
    let mut gap = by_formula(drive(&car, 90.0, &SENSORS, &mut dice, gentle), 0.3, 1.0);
    gap.odometry.retain(|it| !(49.0..49.5).contains(&it.time_s));
    assert!(matches!(refusal(gap, &file), Refusal::Computed { .. }));
    // A heading alone, by the time that passed between arrivals that are not even.
    let mut uneven = excited;
    for at in 0..uneven.odometry.len() {
        let time_s = uneven.odometry[at].time_s + 0.004 * dice.uniform(-1.0, 1.0);
        (uneven.odometry[at].time_s, uneven.commands[at].time_s) = (time_s, time_s);
    }
    let mut uneven = by_formula(uneven, 0.3, 1.0);
    uneven.odometry.iter_mut().for_each(|it| it.yaw_rate_radps = f64::NAN);
    assert!(matches!(refusal(uneven, &file), Refusal::Computed { .. }));
}

#[test]
fn cars_whose_yaw_rate_is_coarse_or_rare_are_not_taken_for_computed_ones() {
    let (mut car, file, mut dice) = car();
    (car.steering_delay_s, car.steering_lag_s) = (0.12, 0.06);
    let gentle = |time_s: f64| match time_s {
        ..1.0 => (0.0, 0.0),
        _ => (0.06 * libm::sin(0.3 * time_s) + 0.03 * libm::sin(0.8 * time_s), 1.5),
    };
    let quiet = Sensors { yaw_rate_sd_radps: 0.0005, ..SENSORS };
    for driven in [drive(&car, 60.0, &quiet, &mut dice, gentle), excite(&car, &quiet, &mut dice)] {
        for (grain, every) in [(0.01, 1), (0.001, 1), (0.0, 5), (0.01, 5), (0.001, 5)] {
            let mut driven = thinned(driven.clone(), every);
            for seen in driven.odometry.iter_mut().filter(|_| grain > 0.0) {
                seen.yaw_rate_radps = (seen.yaw_rate_radps / grain).round() * grain;
            }
            let found = identify(&[driven], &file, Options::default());
            assert!(found.is_ok(), "grain {grain}, every {every}: {}", found.unwrap_err());
        }
    }
    // One that hardly changes its steering cannot be told, and is warned of.
    let circle = |time_s: f64| if time_s < 1.0 { (0.0, 0.0) } else { (0.1, 2.0) };
    let driven = drive(&car, 40.0, &quiet, &mut dice, circle);
    let found = identify(&[driven], &file, Options::default()).unwrap();
    let told = |it: &String| it.contains("measured or computed");
    assert!(found.warnings.iter().any(told), "{:?}", found.warnings);
}

#[test]
fn wheels_that_stop_are_found_whatever_was_asked_of_a_car_that_stands_or_of_one_once() {
    let (mut car, file, mut dice) = car();
    car.steering_limit_rad = 0.08;
    let mut driven = excite(&car, &SENSORS, &mut dice);
    // A stick that is pushed before the car moves, and a slip of a tenth of a second.
    for command in &mut driven.commands {
        if command.time_s < 0.5 || (12.0..12.1).contains(&command.time_s) {
            command.steering_rad = 1.5;
        }
    }
    let found = identify(&[driven], &file, Options::default()).unwrap();
    let (stop, _) = told(&found, "steering_limit_rad").unwrap();
    assert!((stop / 0.08 - 1.0).abs() < 0.03, "{stop}");
    assert!((found.vehicle.wheelbase_m / car.wheelbase_m - 1.0).abs() < 0.02);
}

/// A car at the scale of 1:10 whose wheels stop at an angle, and whose tyres hold up to a lateral acceleration.
fn small_drive(dice: &mut Dice, stop_rad: f64, grip_mps2: f64) -> Drive {
    let mut driven = Drive::default();
    let mut on_the_way = std::collections::VecDeque::from(vec![(0.0_f64, 0.0); 6]);
    let (mut x_m, mut y_m, mut yaw_rad) = (0.0, 0.0, 0.0);
    let (mut speed_mps, mut wheel_rad) = (0.0_f64, 0.0_f64);
    for tick in 0..6000_u32 {
        let time_s = 0.01 * f64::from(tick);
        let wanted_mps = match time_s {
            ..1.0 => 0.0,
            ..30.0 => 1.2,
            _ => 3.0,
        };
        let turn = [0.4, -0.4, 0.2, -0.3, 0.1, 0.0][(time_s / 1.3) as usize % 6];
        let rate_radps = speed_mps * libm::tan(wheel_rad) / 0.33;
        let most_radps = grip_mps2 / speed_mps.max(0.1);
        let rate_radps = rate_radps.clamp(-most_radps, most_radps);
        driven.odometry.push(identification::Odometry {
            time_s,
            x_m: x_m + 0.005 * dice.normal(),
            y_m: y_m + 0.005 * dice.normal(),
            yaw_rad: yaw_rad + 0.005 * dice.normal(),
            speed_mps: speed_mps + 0.02 * dice.normal(),
            yaw_rate_radps: rate_radps + 0.01 * dice.normal(),
        });
        let command = identification::Command { time_s, steering_rad: turn, speed_mps: wanted_mps };
        driven.commands.push(command);
        on_the_way.push_back((turn, wanted_mps));
        let (turn, wanted_mps) = on_the_way.pop_front().unwrap();
        let turn = turn.clamp(-stop_rad, stop_rad);
        wheel_rad += ((turn - wheel_rad) / 0.06).clamp(-4.0, 4.0) * 0.01;
        speed_mps += (wanted_mps - speed_mps) / 0.3 * 0.01;
        x_m += 0.01 * speed_mps * libm::cos(yaw_rad);
        y_m += 0.01 * speed_mps * libm::sin(yaw_rad);
        yaw_rad += 0.01 * rate_radps;
    }
    driven
}

#[test]
fn tyres_at_their_limit_are_not_taken_for_wheels_that_stop() {
    let mut dice = Dice::new(9);
    let file = config::Layers::vehicle_of_file("f1tenth").unwrap();
    let slides = |it: &String| it.contains("tyres may have");
    let found = identify(&[small_drive(&mut dice, 1.0, 4.5)], &file, Options::default()).unwrap();
    assert_eq!(told(&found, "steering_limit_rad"), None);
    assert!(found.warnings.iter().any(slides), "{:?}", found.warnings);
    // Wheels that do stop show it where tyres hold.
    let found =
        identify(&[small_drive(&mut dice, 0.25, 100.0)], &file, Options::default()).unwrap();
    let (stop, _) = told(&found, "steering_limit_rad").unwrap();
    assert!((stop / 0.25 - 1.0).abs() < 0.03, "{stop}");
    assert!(!found.warnings.iter().any(slides), "{:?}", found.warnings);
}

#[test]
fn intervals_of_dead_times_allow_for_commands_that_were_noted_late() {
    let (car, file, mut dice) = car();
    let mut driven = excite(&car, &SENSORS, &mut dice);
    // Noted with the next row of the odometry, at 20 Hz: on average, half of a row late.
    driven = thinned(driven, 5);
    let all = std::mem::take(&mut driven.commands);
    for seen in &driven.odometry {
        let last = all.iter().rfind(|it| it.time_s <= seen.time_s + 1e-9).unwrap();
        driven.commands.push(identification::Command { time_s: seen.time_s, ..*last });
    }
    let exact = identify(&[driven.clone()], &file, Options::default()).unwrap();
    driven.late_commands_s = 0.05;
    let found = identify(&[driven], &file, Options::default()).unwrap();
    for (key, truth) in
        [("steering_delay_s", car.steering_delay_s), ("speed_delay_s", car.speed_delay_s)]
    {
        let ((value, [low, high]), (same, narrow)) =
            (told(&found, key).unwrap(), told(&exact, key).unwrap());
        assert_eq!((value, low), (same, narrow[0]), "{key}");
        assert!((high - 0.05 - narrow[1]).abs() < 1e-9, "{key}: {high} {}", narrow[1]);
        assert!(low < truth && truth < high, "{key}: {truth} {low} {high}");
        // By the noise alone, the steering's is too short.
        assert!(narrow[1] < truth || key == "speed_delay_s", "{key}: {truth} {narrow:?}");
    }
    let [_, high] = found.delay_and_lag.interval.unwrap();
    assert!(car.steering_delay_s + car.steering_lag_s < high, "{high}");
}

#[test]
fn noise_is_that_of_a_car_that_moves() {
    let (car, file, mut dice) = car();
    let waits = |time_s: f64| match time_s {
        ..60.0 => (0.0, 0.0),
        _ => excitation(time_s - 60.0, 0.25, 2.0, 0.0),
    };
    let mut driven = drive(&car, EXCITATION_S + 60.0, &SENSORS, &mut dice, waits);
    // A wheel's encoder tells no noise at rest.
    for seen in driven.odometry.iter_mut().filter(|it| it.speed_mps.abs() < 0.1) {
        seen.speed_mps = 0.0;
    }
    let found = identify(&[driven.clone()], &file, Options::default()).unwrap();
    let sd_mps = found.noise.speed_sd_mps.unwrap();
    assert!((sd_mps / SENSORS.speed_sd_mps - 1.0).abs() < 0.1, "{sd_mps}");
    assert!(!found.warnings.iter().any(|it| it.contains("of the speed")), "{:?}", found.warnings);
    // Coarser than its noise, a speed tells none.
    for seen in &mut driven.odometry {
        seen.speed_mps = (seen.speed_mps / 0.2).round() * 0.2;
    }
    let found = identify(&[driven], &file, Options::default()).unwrap();
    assert_eq!(found.noise.speed_sd_mps, None);
    assert!(!found.warnings.iter().any(|it| it.contains("of the speed")), "{:?}", found.warnings);
}

#[test]
fn samples_that_arrive_several_at_a_time_tell_the_same_car() {
    let (car, file, mut dice) = car();
    let mut driven = excite(&car, &SENSORS, &mut dice);
    for (at, seen) in driven.odometry.iter_mut().enumerate() {
        // Three of four wait for the last of their batch.
        seen.time_s += 0.01 * (3 - at % 4) as f64 - 1e-5 * (3 - at % 4) as f64;
    }
    let found = identify(&[driven], &file, Options::default()).unwrap();
    assert!((found.recorded_s - EXCITATION_S).abs() < 0.1, "{}", found.recorded_s);
    assert!((found.vehicle.wheelbase_m / car.wheelbase_m - 1.0).abs() < 0.01);
    // Late by 15 ms on average.
    let sum_s = found.delay_and_lag.after - car.steering_delay_s - car.steering_lag_s;
    assert!((sum_s - 0.015).abs() < 0.01, "{sum_s}");
}

#[test]
fn what_is_driven_backwards_does_not_bend_the_speed_loop() {
    let (car, file, mut dice) = car();
    let mut driven = excite(&car, &SENSORS, &mut dice);
    let end_s = driven.odometry.last().unwrap().time_s;
    // It stops, goes back for six seconds, and drives the excitation once more.
    let mut again = excite(&car, &SENSORS, &mut dice);
    for tick in 0..900 {
        let (time_s, last) = (end_s + 0.01 * f64::from(tick + 1), *driven.odometry.last().unwrap());
        let speed_mps = if (200..800).contains(&tick) { -1.0 } else { 0.0 };
        driven.commands.push(identification::Command { time_s, steering_rad: 0.0, speed_mps });
        let odometry = identification::Odometry { time_s, yaw_rate_radps: 0.0, speed_mps, ..last };
        driven.odometry.push(odometry);
    }
    again.commands.iter_mut().for_each(|it| it.time_s += end_s + 9.01);
    again.odometry.iter_mut().for_each(|it| it.time_s += end_s + 9.01);
    driven.commands.append(&mut again.commands);
    driven.odometry.append(&mut again.odometry);
    let found = identify(&[driven], &file, Options::default()).unwrap();
    let product = |it: &Vehicle| it.speed_kp * it.throttle_accel_mps2;
    let off = product(&found.vehicle) / product(&car) - 1.0;
    assert!(off.abs() < 0.03, "{off}");
    assert!(found.residuals.speed_mps < 0.022, "{}", found.residuals.speed_mps);
}

#[test]
fn a_file_that_is_far_off_is_doubted_or_fitted_but_never_the_end() {
    let (car, mut file, mut dice) = car();
    let driven = excite(&car, &SENSORS, &mut dice);
    // A ratio of brake to throttle that no car has.
    (file.throttle_accel_mps2, file.brake_decel_mps2) = (0.01, 30.0);
    file.wheelbase_m = 1.6 * car.wheelbase_m;
    let found = identify(std::slice::from_ref(&driven), &file, Options::default()).unwrap();
    assert!((found.vehicle.wheelbase_m / car.wheelbase_m - 1.0).abs() < 0.01);
    assert!(found.warnings.iter().any(|it| it.contains("measure it")), "{:?}", found.warnings);
    // Commands that are shares of the full angle.
    let (_, file, _) = self::car();
    let mut shares = driven;
    shares.commands.iter_mut().for_each(|it| it.steering_rad /= 0.25);
    let found = identify(&[shares], &file, Options::default()).unwrap();
    assert!(found.warnings.iter().any(|it| it.contains("from -1 to 1")), "{:?}", found.warnings);
}
