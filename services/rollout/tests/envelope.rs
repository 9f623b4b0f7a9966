//! The envelope, held to what it promises on drives of the whole loop: false alarms on fresh drives of varied vehicles, and
//! faults that are seen.
//!
//! `PATHTUNE_ENVELOPE_DRIVES` is how many drives are calibrated on, and about how many are judged: few by default.

#![allow(clippy::disallowed_methods, reason = "a test")]

use config::{Envelope, Layers, Parameters, RunConfig};
use rollout::{Plant, Rollout};
use simulator::{Observation, SimulatedVehicle};
use supervisor::Movement;
use supervisor::envelope::{Envelope as Watched, Evidence, Martingale};
use tracking::Pose;
use trainer::calibration::Spread::{self, Nothing, Varied};
use trainer::calibration::{Traced, calibrate, varied};

/// Under noise, the gear selector takes seconds to engage. A fault that is there before the vehicle rolls is part of how the
/// path is aligned.
const ENGAGED: &str = "vehicle.gear_engaged=true";
/// Faults that only a threshold of many drives, some 2,000, shows for certain.
const SMALL: [&str; 4] =
    ["odometry 0.3 m", "drift 0.1 m/s", "wheelbase + 20 %", "speed sensor - 20 %"];
/// Seeds of calibrations and of fresh drives differ by this.
const FRESH: u64 = 1 << 40;

fn drives() -> u32 {
    let given = std::env::var("PATHTUNE_ENVELOPE_DRIVES");
    given.map_or(240, |text| text.parse().expect("PATHTUNE_ENVELOPE_DRIVES: a number of drives"))
}

fn config(maneuver: &str, sets: &[&str]) -> RunConfig {
    let mut layers = Layers::maneuver(maneuver).unwrap();
    sets.iter().for_each(|set| layers.set(set).unwrap());
    layers.resolve().unwrap()
}

/// The paper's choice: one set, or one for each manoeuvre that is due.
fn paper_sets(config: &RunConfig) -> Vec<Parameters> {
    let chosen = config.paper.iter().find(|it| it.chosen).unwrap();
    chosen.gains.iter().map(|gains| config.law.parameters_of(gains).unwrap()).collect()
}

fn by_zone(config: &RunConfig, sets: &[Parameters]) -> Vec<Parameters> {
    if sets.len() == 1 { sets.to_vec() } else { config.sets_by_zone(sets) }
}

/// Scores of fresh drives of varied vehicles; those of drives too far from the path apart.
fn fresh(
    config: &RunConfig,
    sets: &[Parameters],
    envelope: &Envelope,
    drives: u32,
) -> [Vec<f64>; 2] {
    let mut scores = [Vec::new(), Vec::new()];
    for number in 0..drives {
        let (plant, seed) = varied(config, FRESH, number, Varied);
        let mut rollout = Rollout::on_plant(config, &plant);
        let traced = Traced::drive(&mut rollout, config, &by_zone(config, sets), seed);
        let place = usize::from(!traced.is_good(config));
        scores[place].push(traced.trace.score(&envelope.channels));
    }
    scores
}

#[test]
fn what_calibrated_drives_were_too_short_for_is_not_held_against_a_longer_one() {
    let [short, long] = ["drive.loop_time_s=7.0", "drive.loop_time_s=16.0"]
        .map(|loop_time| config("roundabout", &[loop_time, ENGAGED]));
    let sets = paper_sets(&short);
    let envelope = calibrate(&short, &sets, 40, Varied, |_| {}).unwrap();
    for number in 0..4 {
        let (plant, seed) = varied(&long, FRESH, number, Varied);
        let mut rollout = Rollout::on_plant(&long, &plant);
        let traced = Traced::drive(&mut rollout, &long, &sets, seed);
        let score = traced.trace.score(&envelope.channels);
        assert!(score < 2.0 * envelope.threshold, "{score}");
    }
}

/// What is wrong with a vehicle from a tick on, beyond what its file can say.
#[derive(Debug, Clone, Copy)]
enum Wrong {
    Nothing,
    Sign,
    StuckAtZero,
    StuckAsIs,
    Understeer(f64),
    OdometryToTheLeft(f64),
    SpeedSensor(f64),
    Drift(f64),
}

#[derive(Debug, Clone)]
struct Broken {
    car: SimulatedVehicle,
    wrong: Wrong,
    from_tick: u64,
    tick: u64,
    stuck_rad: Option<f64>,
    carried: (f64, f64),
    yaw_rad: f64,
}

impl Broken {
    fn new(plant: &RunConfig, wrong: Wrong, from_tick: u64) -> Self {
        let car = SimulatedVehicle::new(plant);
        Self { car, wrong, from_tick, tick: 0, stuck_rad: None, carried: (0.0, 0.0), yaw_rad: 0.0 }
    }
}

impl Plant for Broken {
    fn reset(&mut self, start: Pose, noise_seed: Option<u64>) {
        self.car.reset(start, noise_seed);
        (self.tick, self.stuck_rad, self.carried) = (0, None, (0.0, 0.0));
    }

    fn observe(&mut self) -> Observation {
        let mut seen = self.car.observe();
        self.yaw_rad = seen.truth.yaw_rad;
        for pose in [&mut seen.truth, &mut seen.measured] {
            pose.x_m += self.carried.0;
            pose.y_m += self.carried.1;
        }
        if self.tick < self.from_tick {
            return seen;
        }
        match self.wrong {
            Wrong::OdometryToTheLeft(by_m) => {
                seen.measured.x_m -= by_m * libm::sin(self.yaw_rad);
                seen.measured.y_m += by_m * libm::cos(self.yaw_rad);
            }
            Wrong::SpeedSensor(share) => seen.speed_mps *= share,
            Wrong::StuckAsIs => {
                self.stuck_rad.get_or_insert(seen.steering_rad);
            }
            _ => {}
        }
        seen
    }

    fn step(&mut self, speed_mps: f64, steering_rad: f64) {
        let mut does_rad = steering_rad;
        if self.tick >= self.from_tick {
            match self.wrong {
                Wrong::Sign => does_rad = -steering_rad,
                Wrong::StuckAtZero => does_rad = 0.0,
                Wrong::StuckAsIs => does_rad = self.stuck_rad.unwrap_or(steering_rad),
                Wrong::Understeer(by) => does_rad = libm::atan(libm::tan(steering_rad) / by),
                Wrong::Drift(mps) => {
                    self.carried.0 -= 0.01 * mps * libm::sin(self.yaw_rad);
                    self.carried.1 += 0.01 * mps * libm::cos(self.yaw_rad);
                }
                _ => {}
            }
        }
        self.tick += 1;
        self.car.step(speed_mps, does_rad);
    }
}

/// How many of some drives with a fault are out of the envelope, and 95 % of how many seconds that takes from the fault.
fn seen(
    config: &RunConfig,
    sets: &[Parameters],
    envelope: &Envelope,
    drives: u32,
    change: fn(&mut RunConfig),
    (wrong, from_tick): (Wrong, u64),
) -> (u32, f64) {
    let mut watched_config = config.clone();
    watched_config.envelope = Some(Box::new(envelope.clone()));
    let mut after_s = Vec::new();
    for number in 0..drives {
        let (mut plant, seed) = varied(config, 2 * FRESH, number, Varied);
        change(&mut plant);
        let mut rollout = Rollout::around(Broken::new(&plant, wrong, from_tick), config);
        let mut watched = Watched::new(&watched_config).unwrap();
        rollout.drive_scheduled(&by_zone(config, sets), Some(seed), |tick, it| {
            look(&mut watched, tick, it);
        });
        if let Some(alarm) = watched.alarm() {
            after_s.push((alarm.tick.saturating_sub(from_tick)) as f64 * config.drive.tick_s);
        }
    }
    after_s.sort_by(f64::total_cmp);
    let p95_s = after_s.get((after_s.len() * 95).div_ceil(100).max(1) - 1).copied();
    (after_s.len() as u32, p95_s.unwrap_or(f64::NAN))
}

fn look(watched: &mut Watched, tick: u64, it: &rollout::TickRecord) {
    let seen = it.observation;
    let (pose, speed_mps, yaw_rate_radps) = (seen.measured, seen.speed_mps, seen.yaw_rate_radps);
    watched.see(tick, Movement { pose, speed_mps, yaw_rate_radps }, true);
    watched.follow(it.decision.reference_along_m);
    if it.decision.ended.is_none() {
        watched.tell(it.passed.steering_rad);
    }
}

#[test]
fn the_score_at_the_end_of_a_drive_is_that_of_its_trace_and_alarms_come_at_the_threshold() {
    let config = config("roundabout", &["drive.loop_time_s=16.0"]);
    let sets = paper_sets(&config);
    let mut envelope = calibrate(&config, &sets, 24, Varied, |_| {}).unwrap();
    envelope.check().unwrap();
    let text = toml::to_string(&envelope).unwrap();
    assert_eq!(Envelope::parse(&text).unwrap(), envelope);
    for number in 0..4 {
        let (plant, seed) = varied(&config, FRESH, number, Varied);
        let mut rollout = Rollout::on_plant(&config, &plant);
        let traced = Traced::drive(&mut rollout, &config, &sets, seed);
        let score = traced.trace.score(&envelope.channels);
        for (threshold, trips) in [(score, false), (score - 1e-9, true)] {
            envelope.threshold = threshold;
            let mut watched_config = config.clone();
            watched_config.envelope = Some(Box::new(envelope.clone()));
            let mut watched = Watched::new(&watched_config).unwrap();
            rollout.drive_with(sets[0], Some(seed), |tick, it| look(&mut watched, tick, it));
            assert_eq!(watched.score().0.to_bits(), score.to_bits());
            assert_eq!(watched.alarm().is_some(), trips, "{:?}", watched.alarm());
            assert!(watched.alarm().is_none_or(|it| it.index == watched.score().1));
        }
    }
}

#[test]
fn the_scores_of_an_envelope_are_those_of_drives_that_made_no_scale() {
    let config = config("roundabout", &["drive.loop_time_s=7.0", ENGAGED]);
    let sets = paper_sets(&config);
    let envelope = calibrate(&config, &sets, 24, Varied, |_| {}).unwrap();
    let score = |number: u32| {
        let (plant, seed) = varied(&config, config.run.seed, number, Varied);
        let mut rollout = Rollout::on_plant(&config, &plant);
        let traced = Traced::drive(&mut rollout, &config, &sets, seed);
        assert!(traced.is_good(&config));
        traced.trace.score(&envelope.channels)
    };
    let mut others: Vec<f64> = (12..24).map(score).collect();
    others.sort_by(f64::total_cmp);
    assert_eq!(envelope.scores, others);
    assert_eq!((envelope.promise.scaled_on, envelope.promise.threshold_on), (12, 12));
    assert_eq!(envelope.threshold, others[11]);
}

#[test]
fn without_noise_a_vehicle_comes_as_far_as_dead_reckoning_says() {
    let chain = ["vehicle.steering_delay_s=0.12", "vehicle.steering_lag_s=0.08"];
    for sets in [&[][..], &chain] {
        let config = config("roundabout", &[&["drive.loop_time_s=14.0", ENGAGED], sets].concat());
        let mut evidence = Evidence::new(&config);
        let mut looks = 0;
        Rollout::new(&config).drive_with(paper_sets(&config)[0], None, |tick, it| {
            let seen = it.observation;
            let (pose, speed_mps) = (seen.measured, seen.speed_mps);
            let yaw_rate_radps = seen.yaw_rate_radps;
            evidence.see(tick, Movement { pose, speed_mps, yaw_rate_radps }, true);
            evidence.follow(it.decision.reference_along_m);
            if let Some(look) = evidence.tell(it.passed.steering_rad) {
                let residuals = look.values[2..11].iter().filter(|it| !it.is_nan());
                residuals.for_each(|it| assert!(it.abs() < 1e-4, "{look:?}"));
                // As the law reads it, but that the mean is over a block.
                let cross_m = look.values[1];
                assert!(cross_m.is_nan() || cross_m.abs() < 0.3);
                looks += 1;
            }
        });
        assert!(looks > 120, "{looks}");
    }
}

/// False alarms and faults of a manoeuvre. Prints a table; `--nocapture` shows it.
fn holds(maneuver: &str, sets_of: &[&str], few: u32, seconds: f64) {
    let config = config(maneuver, sets_of);
    let sets = paper_sets(&config);
    let many = drives() / if maneuver == "circuit" { 4 } else { 1 };
    let envelope = calibrate(&config, &sets, many, Varied, |_| {}).unwrap();
    let promise = &envelope.promise;
    println!(
        "{maneuver}: {} + {} drives, {} left out, alpha {:.4}, threshold {:.3}",
        promise.scaled_on,
        promise.threshold_on,
        promise.left_out,
        promise.alpha,
        envelope.threshold
    );
    for it in &envelope.channels {
        let (mean, sd) = (it.mean[it.mean.len() / 2], it.sd[it.sd.len() / 2]);
        println!(
            "  {:13} {:4} s  mean {mean:.4} sd {sd:.4} limit {:.2}",
            it.kind, it.over_s, it.limit
        );
    }
    let [good, far] = fresh(&config, &sets, &envelope, 2 * many);
    let above =
        |scores: &[f64], threshold: f64| scores.iter().filter(|it| **it > threshold).count();
    let (false_alarms, judged) = (above(&good, envelope.threshold), good.len());
    println!(
        "  false alarms: {false_alarms} of {judged}; beyond 1 m: {} of {}",
        above(&far, envelope.threshold),
        far.len()
    );
    // Four standard deviations above what is promised.
    let expected = promise.alpha * judged as f64;
    assert!(
        (false_alarms as f64) < expected + 4.0 * expected.sqrt() + 1.0,
        "{false_alarms} of {judged}"
    );

    let from = (seconds / config.drive.tick_s) as u64;
    type Fault = (&'static str, fn(&mut RunConfig), Wrong, bool);
    let faults: [Fault; 22] = [
        ("understeer x 1.6", |_| {}, Wrong::Understeer(1.6), true),
        ("wheelbase + 20 %", |it| it.vehicle.wheelbase_m *= 1.2, Wrong::Nothing, true),
        ("odometry 0.3 m", |_| {}, Wrong::OdometryToTheLeft(0.3), true),
        (
            "noise x 3",
            |it| {
                it.noise.position_sd_m *= 3.0;
                it.noise.heading_half_width_rad *= 3.0;
            },
            Wrong::Nothing,
            true,
        ),
        ("speed sensor - 20 %", |_| {}, Wrong::SpeedSensor(0.8), true),
        ("drift 0.1 m/s", |_| {}, Wrong::Drift(0.1), true),
        ("drift 0.2 m/s", |_| {}, Wrong::Drift(0.2), true),
        ("wrong sign", |_| {}, Wrong::Sign, true),
        ("gain 0.6", |it| it.vehicle.steering_gain *= 0.6, Wrong::Nothing, true),
        ("stuck at 0", |_| {}, Wrong::StuckAtZero, true),
        ("stuck as it is", |_| {}, Wrong::StuckAsIs, true),
        ("rate / 3", |it| it.vehicle.steering_rate_radps /= 3.0, Wrong::Nothing, false),
        ("lag 0.3 s", |it| it.vehicle.steering_lag_s = 0.3, Wrong::Nothing, false),
        ("wheelbase + 10 %", |it| it.vehicle.wheelbase_m *= 1.1, Wrong::Nothing, false),
        ("offset 2 deg", |it| it.vehicle.steering_offset_rad = 0.0349, Wrong::Nothing, false),
        ("wheelbase + 5 %", |it| it.vehicle.wheelbase_m *= 1.05, Wrong::Nothing, false),
        // Those above come on top of what varies, ± 5 %; these are of the file's wheelbase.
        ("wheelbase 120 %", |it| it.vehicle.wheelbase_m = 1.2 * 2.875, Wrong::Nothing, false),
        ("wheelbase 114 %", |it| it.vehicle.wheelbase_m = 1.14 * 2.875, Wrong::Nothing, false),
        ("nothing", |_| {}, Wrong::Nothing, false),
        ("odometry 0.3 m late", |_| {}, Wrong::OdometryToTheLeft(0.3), false),
        ("drift 0.2 m/s late", |_| {}, Wrong::Drift(0.2), false),
        ("wrong sign late", |_| {}, Wrong::Sign, false),
    ];
    let mut missed = Vec::new();
    for (name, change, wrong, must) in faults {
        let from_tick = if matches!(wrong, Wrong::Nothing) { 0 } else { from };
        let (count, p95_s) = seen(&config, &sets, &envelope, few, change, (wrong, from_tick));
        println!(
            "  {name:20} {count} of {few}, p95 {p95_s:.1} s{}",
            if must { "" } else { " (not sold)" }
        );
        // Few drives make a high threshold: what is small shows only below that of many.
        let is_sold = must && (drives() >= 4000 || !SMALL.contains(&name));
        if is_sold && count * 100 < few * 98 {
            missed.push(format!("{name} is seen in {count} of {few}"));
        }
    }
    assert!(missed.is_empty(), "{maneuver}: {missed:?}");
}

#[test]
fn in_the_roundabout_alarms_are_rarely_false_and_faults_are_seen() {
    holds("roundabout", &[ENGAGED], (drives() / 40).min(100), 4.0);
}

#[test]
fn in_the_lane_change_alarms_are_rarely_false_and_faults_are_seen() {
    holds("lane_change", &[ENGAGED, "drive.loop_time_s=15.0"], (drives() / 40).min(100), 4.0);
}

#[test]
fn in_the_circuit_alarms_are_rarely_false_and_faults_are_seen() {
    holds("circuit", &[ENGAGED], (drives() / 80).min(100), 4.0);
}

#[test]
fn a_wheelbase_10_percent_longer_is_seen_and_with_twice_the_threshold_it_is_not() {
    let config = config("circuit", &[ENGAGED]);
    let sets = paper_sets(&config);
    let mut envelope = calibrate(&config, &sets, drives() / 4, Varied, |_| {}).unwrap();
    let few = (drives() / 24).min(100);
    let longer: fn(&mut RunConfig) = |it| it.vehicle.wheelbase_m *= 1.1;
    let mut count = |times: f64| {
        envelope.threshold *= times;
        seen(&config, &sets, &envelope, few, longer, (Wrong::Nothing, 0)).0
    };
    let (once, twice) = (count(1.0), count(2.0));
    println!("wheelbase + 10 %: {once} of {few}, with twice the threshold {twice}");
    // 63 of 100 below the threshold of 1,000 drives, and fewer below that of the default's few.
    assert!(4 * once >= few && 10 * twice <= few, "{once} and {twice} of {few}");
}

/// The score of a drive of a vehicle that differs from its file by this.
fn score_of(
    config: &RunConfig,
    envelope: &Envelope,
    number: u32,
    spread: Spread,
    longer: f64,
) -> f64 {
    let (mut plant, seed) = varied(config, FRESH, number, spread);
    plant.vehicle.wheelbase_m *= longer;
    let mut rollout = Rollout::on_plant(config, &plant);
    let sets = paper_sets(config);
    Traced::drive(&mut rollout, config, &sets, seed).trace.score(&envelope.channels)
}

#[test]
fn without_variation_a_car_that_is_a_little_different_raises_false_alarms_and_with_it_none() {
    let config = config("roundabout", &[ENGAGED]);
    let sets = paper_sets(&config);
    let nominal = calibrate(&config, &sets, drives(), Nothing, |_| {}).unwrap();
    let alarms = |envelope: &Envelope, spread: Spread| {
        let scores = (0..drives()).map(|number| score_of(&config, envelope, number, spread, 1.0));
        scores.filter(|score| *score > envelope.threshold).count() as f64 / f64::from(drives())
    };
    let (same, other) = (alarms(&nominal, Nothing), alarms(&nominal, Varied));
    println!(
        "nominal calibration: nominal drives {:.2} %, varied ones {:.2} %",
        100.0 * same,
        100.0 * other
    );
    assert!(same < 0.08 && other > 0.25, "{same} {other}");
}

#[test]
fn between_drives_a_wheelbase_that_is_5_percent_longer_shows_within_some_drives() {
    let config = config("roundabout", &[ENGAGED]);
    let sets = paper_sets(&config);
    let envelope = calibrate(&config, &sets, drives(), Nothing, |_| {}).unwrap();
    let (sequences, mut numbers) = ((drives() / 48).clamp(5, 100), 0..);
    let mut until = |longer: f64, at_most: u32| {
        let mut counts: Vec<u32> = (0..sequences)
            .map(|_| {
                let mut martingale = Martingale::new(&envelope.scores);
                let changes = (1..=at_most).find(|_| {
                    let number = numbers.next().unwrap();
                    martingale.add(score_of(&config, &envelope, number, Nothing, longer));
                    martingale.has_changed()
                });
                changes.unwrap_or(u32::MAX)
            })
            .collect();
        counts.sort_unstable();
        counts
    };
    let longer = until(1.05, 60);
    println!("wheelbase + 5 %: drives until the alarm {longer:?}");
    assert!(longer[longer.len() / 2] <= 5, "{longer:?}");
    let few = if drives() < 1000 { 20 } else { 200 };
    let same = until(1.0, few);
    let false_alarms = same.iter().filter(|it| **it < u32::MAX).count();
    println!("nothing changed: {false_alarms} of {} sequences of {few} drives", same.len());
    assert!(false_alarms * 100 <= 3 * same.len().max(34), "{same:?}");
    if drives() >= 1000 {
        let little = until(1.02, 200);
        println!("wheelbase + 2 %: median {}", little[little.len() / 2]);
    }
}
