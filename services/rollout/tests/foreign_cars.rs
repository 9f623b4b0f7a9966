//! From an excitation to a drive, on cars that the plant does not know: identified, tuned on the estimate or on the plants
//! that a training takes, and driven. By plain calls, without noise but in the recording.
#![allow(clippy::disallowed_methods, clippy::disallowed_types, reason = "a test")]

#[path = "../../identification/tests/support/mod.rs"]
mod support;

use config::{Layers, OverBy, Parameters, PlantChange, RunConfig, Spread, Vehicle};
use identification::{Identification, Options, identify};
use rollout::{Plant, Rollout};
use simulator::Observation;
use support::Dice;
use support::foreign::{Driven, Foreign, case};
use tracking::{DriveRecord, Objective, Pose};

/// A foreign car as a plant; it measures without noise.
#[derive(Debug, Clone)]
struct Car(Foreign, Driven);

impl Car {
    fn new(car: &Foreign) -> Self {
        Self(car.clone(), Driven::at(car, Pose { x_m: 0.0, y_m: 0.0, yaw_rad: 0.0 }))
    }
}

impl Plant for Car {
    fn reset(&mut self, start: Pose, _: Option<u64>) {
        self.1 = Driven::at(&self.0, start);
    }

    fn observe(&mut self) -> Observation {
        let Self(_, driven) = self;
        Observation {
            measured: driven.point(),
            truth: driven.point(),
            speed_mps: driven.speed_mps,
            yaw_rate_radps: driven.yaw_rate_radps,
            steering_rad: driven.wheel_rad,
            collision: false,
        }
    }

    fn step(&mut self, speed_mps: f64, steering_rad: f64) {
        self.1.step(speed_mps, steering_rad);
    }
}

/// `smooth_lane` with a law, driven with the values of a vehicle's file.
fn config(law: &str, vehicle: &Vehicle, compensates: bool) -> RunConfig {
    let mut layers = Layers::maneuver("smooth_lane").unwrap();
    layers.set_law("test", law).unwrap();
    let mut config = layers.resolve().unwrap();
    config.collision.enabled = false;
    config.controller.compensate_dead_time = compensates;
    config.vehicle = vehicle.clone();
    config
}

/// Laws with the sets of textbooks, which nobody has tuned.
const UNTUNED: [(&str, &str); 5] = [
    ("pure_pursuit", "1,2,0.8,0"),
    ("pure_pursuit", "1,2,1,0"),
    ("stanley", "1,1,1,0"),
    ("stanley", "1,2.5,1,0"),
    ("paper", ""),
];

/// The mean distance from the path of the best of them in hindsight, with the file as it was.
fn best_untuned_m(car: &Foreign, file: &Vehicle) -> f64 {
    let drive = |(law, set): (&str, &str)| {
        let config = config(law, file, false);
        let set = match set {
            "" => {
                config.paper_set().unwrap_or_else(|| config.grid().set(config.grid().position(0)))
            }
            set => config.law.parse_sets(set).unwrap()[0],
        };
        let driven = Rollout::around(Car::new(car), &config).drive(set, None);
        if driven.arrived() { driven.path_mean_m } else { f64::INFINITY }
    };
    UNTUNED.into_iter().map(drive).fold(f64::INFINITY, f64::min)
}

/// What a choice came to in the true car.
#[derive(Debug, Clone, Copy)]
struct Chosen {
    mean_m: f64,
    max_m: f64,
    /// How much farther from the path, in per cent and in millimetres, than the best of all sets.
    regret: f64,
    regret_mm: f64,
}

struct Told {
    untuned_m: f64,
    on_estimate: Chosen,
    /// On eight cars drawn from the intervals that the drive told, key by key: as sure of itself as the fit is.
    on_draws: Chosen,
    /// On the eight plants of errors of the model.
    on_eight: Chosen,
    /// With the ninth, which drives faster: as a training chooses.
    on_nine: Chosen,
}

/// The vehicle as `identify --write` leaves it.
fn as_written(found: &Identification) -> Vehicle {
    let mut vehicle = found.vehicle.clone();
    vehicle.uncertainty.identified = true;
    let told = found.rows.iter().find(|row| row.key == "steering_delay_s");
    if let Some(interval) = told.and_then(|row| row.interval) {
        vehicle.uncertainty.within.insert("steering_delay_s".to_owned(), Spread::Between(interval));
    }
    vehicle
}

/// Eight cars drawn from the intervals of what was identified.
fn draws(found: &Identification, seed: u64) -> Vec<PlantChange> {
    let mut dice = Dice::new(seed);
    let keys = found.rows.iter().filter(|row| !row.key.contains('.'));
    let spreads: Vec<(&str, f64)> = keys
        .filter_map(|row| Some((row.key, row.interval.map(|[low, high]| high - low)? / 3.92)))
        .collect();
    let draw = |number: usize| PlantChange {
        name: format!("drawn {number}"),
        add: spreads.iter().map(|(key, sd)| ((*key).to_owned(), sd * dice.normal())).collect(),
        ..PlantChange::default()
    };
    (0..8).map(draw).collect()
}

/// `every`: of the grid's sets, one in so many.
fn tell(seed: u64, every: usize) -> Told {
    let (file, car, driven) = case(seed);
    let found = identify(&[driven], &file, Options::default()).unwrap();
    let mut config = config("pure_pursuit", &as_written(&found), true);
    // As a training over plants has them.
    config.over.by = OverBy::Mean;
    let objective = Objective::new(&config);
    let grid = config.grid();
    let sets: Vec<Parameters> = grid.positions().step_by(every).map(|at| grid.set(at)).collect();
    let of = |drive: &DriveRecord| objective.of(drive);
    let on = |rollout: &mut Rollout| -> Vec<DriveRecord> {
        sets.iter().map(|set| rollout.drive(*set, None)).collect()
    };
    let on_plants = |changes: &[PlantChange]| -> Vec<Vec<DriveRecord>> {
        let drive = |change: &PlantChange| {
            on(&mut Rollout::on_plant(&config.driving_plant(change), &config.with_plant(change)))
        };
        changes.iter().map(drive).collect()
    };
    let (plants, drawn) = (on_plants(&config.plant_changes()), on_plants(&draws(&found, seed)));
    let mut truth = Rollout::around(Car::new(&car), &config);
    let truth: Vec<DriveRecord> = sets.iter().map(|set| truth.drive(*set, None)).collect();
    let least = |value: &dyn Fn(usize) -> f64| {
        (0..sets.len()).min_by(|a, b| value(*a).total_cmp(&value(*b))).unwrap()
    };
    // The first plant is the estimate.
    let on_estimate = least(&|at| of(&plants[0][at]));
    assert_eq!(plants.len(), 9);
    let over =
        |plants: &[Vec<DriveRecord>]| least(&|at| plants.iter().map(|it| of(&it[at])).sum::<f64>());
    let (on_draws, on_eight, on_nine) = (over(&drawn), over(&plants[..8]), over(&plants));
    let best_m = truth[least(&|at| of(&truth[at]))].path_mean_m;
    let chosen = |at: usize| Chosen {
        mean_m: truth[at].path_mean_m,
        max_m: truth[at].path_max_m,
        regret: 100.0 * (truth[at].path_mean_m / best_m - 1.0),
        regret_mm: 1e3 * (truth[at].path_mean_m - best_m),
    };
    Told {
        untuned_m: best_untuned_m(&car, &file),
        on_estimate: chosen(on_estimate),
        on_draws: chosen(on_draws),
        on_eight: chosen(on_eight),
        on_nine: chosen(on_nine),
    }
}

/// `PATHTUNE_FOREIGN_CARS=100 cargo test -p rollout --release --test foreign_cars -- --nocapture` tells the figures of many.
#[test]
fn a_foreign_car_that_was_identified_and_tuned_for_stays_nearer_than_the_best_of_textbooks() {
    let n = std::env::var("PATHTUNE_FOREIGN_CARS").map_or(1, |text| text.parse().unwrap());
    let all: Vec<Told> = (0..n)
        .map(|seed| {
            let told = tell(seed, if n == 1 { 19 } else { 4 });
            let words = |it: Chosen| {
                let Chosen { mean_m, max_m, regret, regret_mm } = it;
                format!("{mean_m:.4} m, max {max_m:.3} m, regret {regret:.1} % or {regret_mm:.2} mm")
            };
            println!(
                "car {seed}: best untuned {:.4} m; on the estimate {}; on draws {}; on eight plants {}; on nine {}",
                told.untuned_m,
                words(told.on_estimate),
                words(told.on_draws),
                words(told.on_eight),
                words(told.on_nine),
            );
            told
        })
        .collect();
    let sum_up = |what: &str, of: &dyn Fn(&Told) -> f64| {
        let mut values: Vec<f64> = all.iter().map(of).collect();
        values.sort_by(f64::total_cmp);
        let count = values.len() as f64;
        let mean = values.iter().sum::<f64>() / count;
        let variance = values.iter().map(|it| (it - mean).powi(2)).sum::<f64>() / (count - 1.0);
        let half = 1.98 * (variance / count).sqrt();
        let at = |share: f64| values[((count - 1.0) * share).round() as usize];
        println!(
            "{what}: mean {mean:.4} ± {half:.4}, median {:.4}, p90 {:.4}, worst {:.4}",
            at(0.5),
            at(0.9),
            at(1.0)
        );
    };
    sum_up("best untuned, m", &|it| it.untuned_m);
    type Choice = fn(&Told) -> Chosen;
    let choices: [(&str, Choice); 4] = [
        ("on the estimate", |it| it.on_estimate),
        ("on draws", |it| it.on_draws),
        ("on eight plants", |it| it.on_eight),
        ("on nine plants", |it| it.on_nine),
    ];
    for (name, of) in choices {
        sum_up(&format!("{name}: regret, %"), &|it| of(it).regret);
        sum_up(&format!("{name}: regret, mm"), &|it| of(it).regret_mm);
        sum_up(&format!("{name}: mean distance, m"), &|it| of(it).mean_m);
        sum_up(&format!("{name}: greatest distance, m"), &|it| of(it).max_m);
        let better = all.iter().filter(|it| of(it).mean_m < it.untuned_m).count();
        println!("{name}: nearer than the best untuned in {better} of {n}");
    }
    for of in [choices[2].1, choices[3].1] {
        let nearer = all.iter().filter(|it| of(it).mean_m < it.untuned_m).count();
        assert!(nearer as f64 >= 0.9 * n as f64, "{nearer} of {n}");
        assert!(all.iter().all(|it| of(it).max_m < 0.3));
    }
}
