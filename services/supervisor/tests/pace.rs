//! The pace of a reference: when its clock runs slower, and when it stands.

use config::{Layers, RunConfig};
use proptest::prelude::*;
use supervisor::{Pace, Progress};
use tracking::Pose;

/// A straight path of 100 m, to be driven at 2 m/s.
fn config(sets: &[&str]) -> RunConfig {
    let mut layers = Layers::own_path();
    let all = [
        "path.pieces=[{kind='straight',length_m=100.0}]",
        "reference.speed_mps=2.0",
        "reference.wait_from_speed=1.5",
        "reference.wait_to_speed=2.5",
        "reference.wait_from_s=4.0",
        "reference.wait_to_s=8.0",
    ];
    for set in all.iter().chain(sets) {
        layers.set(set).unwrap();
    }
    layers.resolve().unwrap()
}

/// Ten ticks in which the law asks for this speed, with the car so far behind its reference.
fn look(pace: &mut Pace, from_tick: u64, asked_mps: f64, late_m: f64) -> f64 {
    let along_m = 50.0;
    let pose = Pose { x_m: along_m - late_m, ..Pose::default() };
    for tick in from_tick..from_tick + 10 {
        pace.update(tick, pose, Progress { asked_mps, along_m, origin_m: 0.0 });
    }
    pace.rate()
}

/// The rate after ten ticks like this, and the look that follows them.
fn rate(sets: &[&str], asked_mps: f64, late_m: f64) -> f64 {
    let mut pace = Pace::new(&config(sets));
    look(&mut pace, 1, asked_mps, late_m);
    look(&mut pace, 11, asked_mps, late_m)
}

#[test]
fn it_falls_with_the_speed_that_the_law_asks_for() {
    for (asked_mps, expected) in
        [(0.0, 1.0), (3.0, 1.0), (3.5, 0.75), (4.0, 0.5), (4.75, 0.125), (5.0, 0.0), (300.0, 0.0)]
    {
        assert_eq!(rate(&[], asked_mps, 0.0), expected, "{asked_mps}");
    }
    assert_eq!(rate(&["reference.wait_to_speed=inf"], 300.0, 0.0), 1.0);
}

#[test]
fn it_falls_with_the_time_by_which_the_vehicle_is_late() {
    for (late_m, expected) in
        [(-5.0, 1.0), (8.0, 1.0), (10.0, 0.75), (12.0, 0.5), (16.0, 0.0), (40.0, 0.0)]
    {
        assert_eq!(rate(&[], 2.0, late_m), expected, "{late_m}");
    }
    assert_eq!(rate(&["reference.wait_to_s=inf"], 2.0, 40.0), 1.0);
    // The lower of the two counts.
    assert_eq!(rate(&[], 4.0, 10.0), 0.5);
    assert_eq!(rate(&[], 3.5, 12.0), 0.5);
}

#[test]
fn it_looks_at_means_ten_times_a_second_and_small_changes_leave_it_alone() {
    let mut pace = Pace::new(&config(&[]));
    let at = |asked_mps| Progress { asked_mps, along_m: 0.0, origin_m: 0.0 };
    let mut rates = Vec::new();
    // It looks at the ticks 0, 10, 20 and 30.
    for tick in 0..40 {
        let asked_mps = match tick {
            ..=9 => 0.0,
            // A mean of 4 m/s at tick 20.
            10..=20 => 4.0 + if tick % 2 == 0 { 1.0 } else { -1.0 },
            _ => 4.2,
        };
        pace.update(tick, Pose::default(), at(asked_mps));
        rates.push(pace.rate());
    }
    assert!(rates[..20].iter().all(|rate| *rate == 1.0), "{rates:?}");
    assert!(rates[20..].iter().all(|rate| *rate == 0.5), "{rates:?}");
}

#[test]
fn it_begins_anew_where_the_reference_does() {
    let mut pace = Pace::new(&config(&[]));
    assert_eq!(look(&mut pace, 1, 5.0, 40.0), 0.0);
    let pose = Pose { x_m: 10.0, ..Pose::default() };
    let anew = Progress { asked_mps: 0.0, along_m: 10.0, origin_m: 10.0 };
    pace.update(11, pose, anew);
    assert_eq!(pace.rate(), 1.0);
    // Who joins a drive knows at once what its predecessor knew.
    let mut joins = Pace::new(&config(&[]));
    joins.update(217, pose, Progress { asked_mps: 9.0, ..anew });
    assert_eq!(joins.rate(), 0.0);
}

proptest! {
    #[test]
    fn whatever_is_told_it_is_a_rate(
        told in prop::collection::vec((1..50u64, any::<f64>(), any::<f64>(), any::<f64>(), 0..3u8), 1..60),
    ) {
        let mut pace = Pace::new(&config(&[]));
        let mut tick = 0;
        for (since, asked_mps, along_m, x_m, origin) in told {
            tick += since;
            let pose = Pose { x_m: if x_m.is_finite() { x_m } else { 0.0 }, ..Pose::default() };
            let origin_m = [0.0, 1.0, f64::NAN][usize::from(origin)];
            pace.update(tick, pose, Progress { asked_mps, along_m, origin_m });
            prop_assert!((0.0..=1.0).contains(&pace.rate()) && (pace.rate() * 8.0).fract() == 0.0);
        }
    }
}
