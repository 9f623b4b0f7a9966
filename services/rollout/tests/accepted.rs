//! Whatever a configuration accepts can be driven: strange numbers are refused with one line, or the drive ends.

use config::{Layers, RunConfig};
use proptest::prelude::*;
use proptest::sample::Index;
use rollout::Rollout;
use toml::Value;

/// The manoeuvres, and a law that is driven in them.
const DRIVES: [(&str, &str); 5] = [
    ("lane_change", "paper"),
    ("roundabout", "pure_pursuit"),
    ("smooth_lane", "stanley"),
    ("smooth_lane", "lqr"),
    ("smooth_lane", "mpc"),
];
/// Longer drives take no other branch.
const MOST_TICKS: u64 = 20_000;

fn layers((maneuver, law): (&str, &str)) -> Layers {
    let mut layers = Layers::maneuver(maneuver).unwrap();
    if law != "paper" {
        layers.set_law("test", law).unwrap();
    }
    layers
}

/// All keys below a table that hold a number, with it.
fn numbers(value: &Value, at: &str, all: &mut Vec<(String, f64)>) {
    match value {
        Value::Table(table) => {
            for (key, value) in table {
                numbers(
                    value,
                    &if at.is_empty() { key.clone() } else { format!("{at}.{key}") },
                    all,
                );
            }
        }
        Value::Integer(number) => all.push((at.to_owned(), *number as f64)),
        Value::Float(number) => all.push((at.to_owned(), *number)),
        _ => {}
    }
}

fn keys(config: &RunConfig) -> Vec<(String, f64)> {
    let mut all = Vec::new();
    numbers(&Value::try_from(config).unwrap(), "", &mut all);
    all
}

proptest! {
    // PROPTEST_CASES sets another number of cases.
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]
    #[test]
    fn what_is_accepted_can_be_driven(
        drive in 0usize..DRIVES.len(),
        strange in prop::collection::vec(
            (any::<Index>(), prop::sample::select(vec![
                0.0, -1.0, 1e-9, 1e-3, 0.1, 0.5, 0.9, 1.1, 2.0, 10.0, 1e3, 1e9, 1e300, f64::INFINITY,
            ])),
            1..3,
        ),
        noise_seed in prop::option::of(any::<u64>()),
    ) {
        let mut layers = layers(DRIVES[drive]);
        let known = keys(&layers.clone().resolve().unwrap());
        let mut sets = Vec::new();
        for (key, factor) in strange {
            let (key, number) = key.get(&known);
            let number = if *number == 0.0 { factor } else { number * factor };
            sets.push(format!("{key}={number:?}"));
            // What holds whole numbers takes no other.
            let _ = layers.set(&format!("{key}={number:?}")).or_else(|_| layers.set(&format!("{key}={number:.0}")));
        }
        match layers.resolve() {
            Err(error) => {
                let told = error.to_string();
                prop_assert!(told.len() < 1000 && !told.contains('\n'), "{told}");
            }
            Ok(config) if config.ticks() <= MOST_TICKS => {
                let first = || config.grid().set(config.grid().positions().next().unwrap());
                let record = Rollout::new(&config).drive(config.paper_set().unwrap_or_else(first), noise_seed);
                // A reference that waits for the car takes more time than the drive has, and no more than a minute.
                let most = config.ticks() + (60.0 / config.drive.tick_s) as u64;
                prop_assert!(record.ticks <= most, "{sets:?}: {} of {most}", record.ticks);
                for number in [record.path_mean_m, record.path_max_m, record.mean_abs_heading_rad, record.progress] {
                    prop_assert!(number.is_finite(), "{sets:?}: {record:?}");
                }
            }
            Ok(_) => {}
        }
    }
}
