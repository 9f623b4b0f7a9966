//! Cars that the plant does not know: a servo of second order, a dead band, understeer, and another speed loop.
#![allow(clippy::disallowed_methods, clippy::disallowed_types, reason = "a test")]

mod support;

use identification::{Options, identify};
use support::foreign;

/// `PATHTUNE_HIDDEN_CARS=300 cargo test -p identification --release --test foreign_cars -- --nocapture` tells the figures of
/// many.
#[test]
fn cars_that_the_plant_does_not_know_are_predicted_better_all_the_same() {
    let n = std::env::var("PATHTUNE_HIDDEN_CARS").map_or(2, |text| text.parse().unwrap());
    let (mut better, mut told, mut neither) = (0, 0, Vec::new());
    let (mut before, mut after) = ([const { Vec::new() }; 2], [const { Vec::new() }; 2]);
    for seed in 0..n {
        let (file, car, driven) = foreign::case(seed);
        let found = identify(&[driven], &file, Options::default()).unwrap();
        for over in 0..2 {
            before[over].push(found.predictions[over].before_m);
            after[over].push(found.predictions[over].after_m);
        }
        let misfit = found.warnings.iter().any(|it| it.contains("the model leaves"));
        better += u64::from(found.is_better());
        told += u64::from(misfit);
        if !found.is_better() {
            neither.push((seed, found.predictions.clone(), misfit));
        }
        // Understeer counts as wheelbase, and so does the dead band.
        let share = libm::log(found.vehicle.wheelbase_m / car.wheelbase_m);
        assert!((-0.05..0.1).contains(&share), "car {seed}: wheelbase off by {share:.3}");
        // What was not identified is never changed.
        for row in &found.rows {
            assert!(row.identified || row.before.to_bits() == row.after.to_bits(), "{row:?}");
        }
    }
    let describe = |of: &mut Vec<f64>| {
        of.sort_by(f64::total_cmp);
        let at = |share: f64| of[((of.len() - 1) as f64 * share).round() as usize];
        let mean = of.iter().sum::<f64>() / of.len() as f64;
        format!("mean {mean:.3}, p90 {:.3}, worst {:.3}", at(0.9), at(1.0))
    };
    for (over, over_s) in [(0, 1), (1, 3)] {
        println!("{over_s} s before: {}", describe(&mut before[over]));
        println!("{over_s} s after: {}", describe(&mut after[over]));
    }
    println!("better in {better} of {n}; a misfit is told in {told}");
    println!("not better: {neither:?}");
    assert!(better * 100 >= n * 95, "{better} of {n}: {neither:?}");
    assert!(*after[1].last().unwrap() < 0.2, "{after:?}");
}
