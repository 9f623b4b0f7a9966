//! The plant against the figures of an independent prototype, which fits the paper's tables.

use config::{Layers, Parameters, RunConfig};
use rollout::Rollout;

fn config(maneuver: &str) -> RunConfig {
    Layers::maneuver(maneuver).unwrap().resolve().unwrap()
}

fn near(what: &str, got: f64, wanted: f64, tolerance: f64) {
    let apart = got / wanted - 1.0;
    println!("{what}: {got:.4}, wanted {wanted} ({:+.2} %)", 100.0 * apart);
    assert!(apart.abs() <= tolerance, "{what}: {got}, wanted {wanted}");
}

/// d min, 1 %, median, max over the grid.
fn grid_figures(maneuver: &str, size: usize, wanted: [f64; 4]) {
    let config = config(maneuver);
    let grid = config.grid();
    assert_eq!(grid.len(), size);
    let mut rollout = Rollout::new(&config);
    let mut distances: Vec<f64> = grid
        .positions()
        .map(|position| {
            let record = rollout.drive(grid.set(position), None);
            record.distance(config.learning.heading_weight)
        })
        .collect();
    distances.sort_by(f64::total_cmp);
    let got = [0, size / 100, size / 2, size - 1].map(|index| distances[index]);
    for (name, (got, wanted)) in
        ["min", "1 %", "median", "max"].iter().zip(got.into_iter().zip(wanted))
    {
        near(&format!("{maneuver} d {name}"), got, wanted, 0.02);
    }
}

#[test]
fn grid_of_the_lane_change() {
    grid_figures("lane_change", 750, [0.791, 0.792, 0.935, 1.79]);
}

#[test]
fn grid_of_the_roundabout() {
    grid_figures("roundabout", 625, [0.130, 0.134, 0.285, 4.13]);
}

#[test]
fn mse_of_the_paper_s_sets() {
    let check = |maneuver: &str, rows: &[([f64; 4], f64)]| {
        let config = config(maneuver);
        let mut rollout = Rollout::new(&config);
        for &(gains, mse) in rows {
            let record = rollout.drive(Parameters::of(&gains), None);
            near(&format!("{maneuver} {gains:?} mse"), record.mse_m2(), mse, 0.02);
        }
    };
    check(
        "lane_change",
        &[
            ([0.1, 1.0, 6.0, 0.7], 5.69),
            ([0.68, 21.0, 21.0, 0.77], 2.28),
            ([1.26, 6.0, 11.0, 0.84], 1.57),
            ([3.0, 21.0, 16.0, 0.7], 1.452),
            ([3.0, 21.0, 21.0, 0.7], 1.451),
            ([3.0, 21.0, 21.0, 0.98], 1.506),
        ],
    );
    check(
        "roundabout",
        &[
            ([2.2, 21.0, 1.0, 0.98], 0.229),
            ([2.2, 16.0, 21.0, 0.77], 0.249),
            ([3.4, 11.0, 21.0, 0.84], 0.186),
            ([3.4, 21.0, 1.0, 0.84], 0.183),
            ([3.4, 21.0, 11.0, 0.77], 0.191),
            ([4.6, 6.0, 1.0, 0.84], 0.270),
        ],
    );
}
