//! The additional dead time: its table, its meaning in ticks, and how many sets of the grids it flags.

use certificate::{Car, FRAGILE_BELOW_S, Gains, LateralLoop};
use config::{Layers, RunConfig};

fn config(maneuver: &str) -> RunConfig {
    Layers::maneuver(maneuver).unwrap().resolve().unwrap()
}

fn car(delay_s: f64, lag_s: f64) -> Car {
    Car { steering_delay_s: delay_s, steering_lag_s: lag_s, ..Car::new(&config("roundabout")) }
}

fn gains([kv, kl, ks, ki]: [f64; 4]) -> Gains {
    Gains { kv, kl, ks, ki }
}

const CARS: [(f64, f64); 3] = [(0.0, 0.0), (0.12, 0.08), (0.24, 0.27)];

#[test]
fn the_table_of_known_sets() {
    // Milliseconds at 1.2, 1.5, 3.5 and 4 m/s, for each of the three cars; 0 where the loop is unstable.
    let table: [([f64; 4], [[f64; 3]; 4]); 4] = [
        (
            [3.0, 21.0, 21.0, 0.7],
            [
                [1325.0, 1131.0, 827.0],
                [1078.0, 884.0, 583.0],
                [483.0, 291.0, 22.0],
                [421.0, 231.0, 0.0],
            ],
        ),
        (
            [3.4, 21.0, 1.0, 0.84],
            [[726.0, 531.0, 228.0], [602.0, 407.0, 108.0], [281.0, 91.0, 0.0], [244.0, 55.0, 0.0]],
        ),
        (
            [5.8, 11.0, 11.0, 0.98],
            [[156.0, 0.0, 0.0], [108.0, 0.0, 0.0], [15.0, 0.0, 0.0], [9.0, 0.0, 0.0]],
        ),
        (
            [5.8, 21.0, 21.0, 0.91],
            [[591.0, 401.0, 142.0], [451.0, 263.0, 15.0], [144.0, 0.0, 0.0], [119.0, 0.0, 0.0]],
        ),
    ];
    for (set, by_speed) in table {
        for (speed_mps, row) in [1.2, 1.5, 3.5, 4.0].into_iter().zip(by_speed) {
            for ((delay_s, lag_s), wanted) in CARS.into_iter().zip(row) {
                let it = LateralLoop::steady(&car(delay_s, lag_s), &gains(set), speed_mps);
                let got = 1000.0 * it.additional_dead_time_s();
                println!("{set:?} {speed_mps} ({delay_s}, {lag_s}): {got:.1} wanted {wanted}");
                assert!(
                    (got - wanted).abs() < 1.0,
                    "{set:?} {speed_mps} ({delay_s}, {lag_s}): {got}"
                );
                assert_eq!(it.is_stable(), wanted > 0.0);
            }
        }
    }
}

#[test]
fn that_many_ticks_more_are_stable_and_one_more_is_not() {
    for maneuver in ["lane_change", "roundabout"] {
        let config = config(maneuver);
        let grid = config.grid();
        for position in grid.positions().step_by(37) {
            let gains = Gains::new(&grid.set(position));
            let later = |ticks: f64, speed| {
                LateralLoop::steady(&car(0.12 + 0.01 * ticks, 0.08), &gains, speed)
            };
            for speed_mps in [1.5, 3.5] {
                let margin_s = later(0.0, speed_mps).additional_dead_time_s();
                let ticks = (margin_s / 0.01).floor();
                if margin_s > 0.0 && ticks < 90.0 {
                    assert!(
                        later(ticks, speed_mps).is_stable(),
                        "{gains:?} {speed_mps} {margin_s}"
                    );
                    assert!(!later(ticks + 1.0, speed_mps).is_stable(), "{gains:?} {margin_s}");
                }
            }
        }
    }
}

#[test]
fn a_yaw_rate_that_comes_late_is_taken_from_what_the_steering_may_be_late() {
    let plain = config("lane_change");
    let mut late = plain.clone();
    late.vehicle.yaw_lag_s2pm = 0.005;
    let mut under = plain.clone();
    under.vehicle.understeer_s2pm = 0.01;
    let set = plain.grid().set(plain.grid().positions().nth(300).unwrap());
    let margin_s = |config| certificate::additional_dead_time_s(config, &set, 3.0).unwrap();
    assert!(margin_s(&plain) > 0.05);
    assert!((margin_s(&plain) - margin_s(&late) - 0.015).abs() < 1e-12);
    // A car that turns less is steadier.
    assert!(margin_s(&under) > margin_s(&plain) + 1e-4);
}

/// How many sets of a manoeuvre's grid are unstable, and how many fragile.
fn count(maneuver: &str, speed_mps: f64, car: &Car) -> (usize, usize) {
    let config = config(maneuver);
    let grid = config.grid();
    let margin = |position| {
        LateralLoop::steady(car, &Gains::new(&grid.set(position)), speed_mps)
            .additional_dead_time_s()
    };
    let margins: Vec<f64> = grid.positions().map(margin).collect();
    let below = |bound_s: f64| margins.iter().filter(|it| **it < bound_s).count();
    (margins.iter().filter(|it| **it == 0.0).count(), below(FRAGILE_BELOW_S))
}

#[test]
fn the_unstable_and_the_fragile_sets_of_both_grids() {
    for (maneuver, speed_mps, (delay_s, lag_s), wanted) in [
        ("lane_change", 1.5, (0.12, 0.08), (149, 199)),
        ("lane_change", 3.5, (0.24, 0.27), (471, 605)),
        ("roundabout", 4.0, (0.0, 0.0), (17, 205)),
        ("roundabout", 3.5, (0.24, 0.27), (391, 507)),
    ] {
        let got = count(maneuver, speed_mps, &car(delay_s, lag_s));
        println!("{maneuver} {speed_mps} ({delay_s}, {lag_s}): {got:?}, wanted {wanted:?}");
        assert!(
            got.0.abs_diff(wanted.0) <= 1 && got.1.abs_diff(wanted.1) <= 1,
            "{got:?} {wanted:?}"
        );
    }
}
