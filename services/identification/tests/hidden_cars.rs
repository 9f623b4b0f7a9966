//! Hidden cars of the plant's kind: how near their identified values are to the true ones.
#![allow(clippy::disallowed_methods, clippy::disallowed_types, reason = "a test")]

mod support;

use config::Vehicle;
use identification::{Identification, Options, identify};
use support::{Dice, SENSORS, excite, hidden_car};

/// One key of one car: error, half of the interval (in the same measure), and whether it is called identified.
#[derive(Debug, Clone, Copy)]
struct Reading {
    error: f64,
    half: f64,
    identified: bool,
    covered: bool,
}

/// Name, unit of its error, how to read it, and whether its error is relative.
type Key = (&'static str, &'static str, fn(&Vehicle) -> f64, bool);

const KEYS: [Key; 14] = [
    ("wheelbase_m", "%", |it| it.wheelbase_m, true),
    ("steering_delay_s", "ms", |it| it.steering_delay_s, false),
    ("steering_lag_s", "%", |it| it.steering_lag_s, true),
    ("steering_rate_radps", "%", |it| it.steering_rate_radps, true),
    ("steering_offset_rad", "mrad", |it| it.steering_offset_rad, false),
    ("tracked_point_m", "mm", |it| it.tracked_point_m, false),
    ("speed_delay_s", "ms", |it| it.speed_delay_s, false),
    ("speed_kp", "%", |it| it.speed_kp * it.throttle_accel_mps2, true),
    ("speed_ki", "%", |it| it.speed_ki * it.throttle_accel_mps2, true),
    ("brake_decel_mps2", "%", |it| it.brake_decel_mps2, true),
    ("throttle_accel_mps2", "%", |it| it.throttle_accel_mps2, true),
    ("pedal_lag_s", "%", |it| it.pedal_lag_s, true),
    ("drag_per_s", "%", |it| it.drag_per_s, true),
    ("rolling_decel_mps2", "%", |it| it.rolling_decel_mps2, true),
];

fn read(
    found: &Identification,
    car: &Vehicle,
    key: &str,
    of: fn(&Vehicle) -> f64,
    log: bool,
) -> Reading {
    let row = found.rows.iter().find(|row| row.key == key).unwrap();
    let [low, high] = row.interval.unwrap_or([f64::NAN; 2]);
    // The products with the throttle: intervals are those of the key.
    let (value, truth) = (of(&found.vehicle), of(car));
    let (error, half) = match log {
        true => (100.0 * libm::log(value / truth), 50.0 * libm::log(high / low)),
        false => (1e3 * (value - truth), 500.0 * (high - low)),
    };
    let plain = match key {
        "speed_kp" if row.only_with.is_none() => Some(car.speed_kp),
        "speed_ki" if row.only_with.is_none() => Some(car.speed_ki),
        "speed_kp" | "speed_ki" => Some(truth / found.vehicle.throttle_accel_mps2),
        "brake_decel_mps2" if row.only_with.is_some() => {
            Some(truth / car.throttle_accel_mps2 * found.vehicle.throttle_accel_mps2)
        }
        _ => None,
    };
    let truth = plain.unwrap_or(truth);
    Reading { error, half, identified: row.identified, covered: low <= truth && truth <= high }
}

fn cars(count: usize) -> Vec<(Vehicle, Vehicle, Identification)> {
    (0..count as u64)
        .map(|seed| {
            let mut dice = Dice::new(seed);
            let (car, file) = hidden_car(&mut dice);
            let driven = excite(&car, &SENSORS, &mut dice);
            let found = identify(&[driven], &file, Options::default())
                .unwrap_or_else(|why| panic!("car {seed}: {why}"));
            (car, file, found)
        })
        .collect()
}

/// How many stops of the steering are told.
fn stops(found: &Identification) -> usize {
    found.rows.iter().filter(|row| row.key == "steering_limit_rad").count()
}

fn count(default: usize) -> usize {
    std::env::var("PATHTUNE_HIDDEN_CARS").map_or(default, |text| text.parse().unwrap())
}

/// The probability that a share of 0.95 gives at most, or at least, so many of n (the smaller one, twice): the exact
/// binomial test.
fn binomial_p(covered: usize, n: usize) -> f64 {
    let log_choose = |n: usize, k: usize| {
        libm::lgamma(n as f64 + 1.0)
            - libm::lgamma(k as f64 + 1.0)
            - libm::lgamma((n - k) as f64 + 1.0)
    };
    let of = |k: usize| {
        libm::exp(log_choose(n, k) + k as f64 * libm::log(0.95) + (n - k) as f64 * libm::log(0.05))
    };
    let low: f64 = (0..=covered).map(of).sum();
    let high: f64 = (covered..=n).map(of).sum();
    (2.0 * low.min(high)).min(1.0)
}

fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(((values.len() as f64 - 1.0) * share).round() as usize).copied().unwrap_or(f64::NAN)
}

#[test]
fn a_hidden_car_is_found_and_what_a_drive_does_not_tell_is_left_alone() {
    // The bounds are some three times what nine of ten of 300 cars keep.
    let bounds = [
        ("wheelbase_m", 0.6),
        ("steering_lag_s", 12.0),
        ("steering_rate_radps", 3.0),
        ("steering_offset_rad", 0.6),
        ("tracked_point_m", 50.0),
        ("steering_delay_s", 6.0),
        ("speed_delay_s", 20.0),
        ("speed_kp", 5.0),
    ];
    for (car, file, found) in cars(count(3)) {
        for (key, bound) in bounds {
            let (_, _, of, log) = *KEYS.iter().find(|it| it.0 == key).unwrap();
            let it = read(&found, &car, key, of, log);
            assert!(!it.identified || it.error.abs() < bound, "{key}: {it:?}");
        }
        assert_eq!(stops(&found), 0, "no wheels came to their stop");
        for row in &found.rows {
            assert_eq!(row.identified, row.interval.is_some());
            assert_eq!(row.identified, row.why.is_none());
            assert!(row.identified || row.before.to_bits() == row.after.to_bits(), "{row:?}");
        }
        let sum = found.delay_and_lag.after - car.steering_delay_s - car.steering_lag_s;
        assert!(sum.abs() < 0.01, "{sum}");
        assert!(found.is_better(), "{:?}", found.predictions);
        assert!((found.noise.position_sd_m - 0.02).abs() < 0.002);
        // Keys that are not looked for are the file's.
        assert_eq!(found.vehicle.steering_dead_band_rad, file.steering_dead_band_rad);
        assert_eq!(found.vehicle.safety, file.safety);
    }
}

/// The figures of many cars, read by hand: `PATHTUNE_HIDDEN_CARS=300 cargo test -p identification --release -- --ignored
/// --nocapture`.
#[test]
#[ignore = "prints figures to be read by hand"]
fn figures_of_many_hidden_cars() {
    let n = count(30);
    let started = std::time::Instant::now();
    let cars = cars(n);
    let each_s = started.elapsed().as_secs_f64() / n as f64;
    println!("{n} cars, {each_s:.2} s each (drive and identification)");
    let stops: usize = cars.iter().map(|(_, _, found)| stops(found)).sum();
    println!("a stop of the steering that no car came to, told: {stops}");
    println!(
        "key                    unit  |error| median     p90    mean  half p50  half/(1.96 sd)  identified  covered  p"
    );
    for (key, unit, of, log) in KEYS {
        let all: Vec<Reading> =
            cars.iter().map(|(car, _, found)| read(found, car, key, of, log)).collect();
        let known: Vec<Reading> = all.into_iter().filter(|it| it.identified).collect();
        let mut errors: Vec<f64> = known.iter().map(|it| it.error.abs()).collect();
        let mut halves: Vec<f64> = known.iter().map(|it| it.half).collect();
        let sd = (known.iter().map(|it| it.error.powi(2)).sum::<f64>() / known.len() as f64).sqrt();
        let half = quantile(&mut halves, 0.5);
        let covered = known.iter().filter(|it| it.covered).count();
        println!(
            "{key:22} {unit:5} {:14.3} {:7.3} {:7.3} {half:9.3} {:15.2} {:11} {covered:8} {:.3}",
            quantile(&mut errors, 0.5),
            quantile(&mut errors, 0.9),
            known.iter().map(|it| it.error).sum::<f64>() / known.len() as f64,
            half / (1.96 * sd),
            known.len(),
            binomial_p(covered, known.len()),
        );
    }
    let mut sums: Vec<f64> = Vec::new();
    let (mut covered, mut halves) = (0, Vec::new());
    for (car, _, found) in &cars {
        let truth = car.steering_delay_s + car.steering_lag_s;
        let row = &found.delay_and_lag;
        let [low, high] = row.interval.unwrap();
        sums.push(1e3 * (row.after - truth));
        halves.push(500.0 * (high - low));
        covered += usize::from(low <= truth && truth <= high);
    }
    let mean = sums.iter().sum::<f64>() / n as f64;
    sums.iter_mut().for_each(|it| *it = it.abs());
    println!(
        "delay + lag            ms    {:14.3} {:7.3} {mean:7.3} {:9.3}                 {n:11} {covered:8} {:.3}",
        quantile(&mut sums.clone(), 0.5),
        quantile(&mut sums, 0.9),
        quantile(&mut halves, 0.5),
        binomial_p(covered, n),
    );
    for over in 0..2 {
        let mean = |of: fn(&identification::Prediction) -> f64| {
            cars.iter().map(|(_, _, found)| of(&found.predictions[over])).sum::<f64>() / n as f64
        };
        println!(
            "prediction over {} s: {:.3} m before, {:.3} m after; better in {} of {n}",
            cars[0].2.predictions[over].over_s,
            mean(|it| it.before_m),
            mean(|it| it.after_m),
            cars.iter().filter(|(_, _, found)| found.predictions[over].is_better()).count(),
        );
    }
    for (index, (car, file, found)) in cars.iter().enumerate() {
        for (key, unit, of, log) in KEYS {
            let it = read(found, car, key, of, log);
            if it.identified && it.error.abs() > 1.8 * it.half {
                println!(
                    "car {index}: {key} is off by {:.3} {unit}, half {:.3}; file {:.4}, car {:.4}, found {:.4}",
                    it.error,
                    it.half,
                    of(file),
                    of(car),
                    of(&found.vehicle)
                );
            }
            let row = found.rows.iter().find(|row| row.key == key).unwrap();
            if let Some(why) = &row.why {
                println!("car {index}: {key}: {why}, car {:.4} file {:.4}", of(car), of(file));
            }
        }
    }
    let warned: usize = cars.iter().map(|(_, _, found)| found.warnings.len()).sum();
    println!("{warned} warnings; of the first car: {:?}", cars[0].2.warnings);
}
