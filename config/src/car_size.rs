//! What is made for a car of full size, fitted to a car of another one: on a path of the user's own, and where nobody has set
//! it.

use std::collections::BTreeMap;

use toml::{Table, Value};

use crate::FULL_SIZE_WHEELBASE_M;
use crate::layers::{find, find_mut, number};

/// How far from the goal a car may pass it: as far as it drives in this time,
const GOAL_S: f64 = 0.1;
/// but no farther than this part of its wheelbase,
const GOAL_WHEELBASES: f64 = 0.25;
/// and as far as odometry is off that is no better than usual.
const LEAST_GOAL_M: f64 = 0.05;

/// Fits to the car the additional dead time below which a set is fragile, and on a path of the user's own the range of the
/// learners' states, which is a length, the weight of a squared angle beside squared lengths, and the goal's radius.
pub(crate) fn scale_to_the_car(values: &mut Table, origins: &BTreeMap<String, String>) {
    let is_own_path =
        find(values, "maneuver").and_then(Value::as_str) == Some(crate::presets::OWN_PATH);
    let Some(wheelbase_m) = find(values, "vehicle.wheelbase_m").and_then(number) else { return };
    let ratio = wheelbase_m / FULL_SIZE_WHEELBASE_M;
    if !(ratio > 0.0 && ratio.is_finite()) {
        return;
    }
    // A small car turns within less time, and shakes by less lateness only.
    if ratio < 1.0 {
        fit(values, origins, "over.fragile_below_s", &|it| it * ratio.sqrt());
    }
    if !is_own_path {
        return;
    }
    if ratio != 1.0 {
        fit(values, origins, "learning.error_high_cross_m", &|it| it * ratio);
        fit(values, origins, "learning.heading_weight", &|it| it * ratio * ratio);
    }
    let Some(speed_mps) = speed_at_goal_mps(values) else { return };
    let by_speed_m = (GOAL_S * speed_mps).min(GOAL_WHEELBASES * wheelbase_m);
    fit(values, origins, "drive.goal_radius_m", &|it| {
        (it * ratio).max(by_speed_m).max(LEAST_GOAL_M)
    });
}

/// Replaces a number that nobody has set.
fn fit(
    values: &mut Table,
    origins: &BTreeMap<String, String>,
    key: &str,
    fitted: &dyn Fn(f64) -> f64,
) {
    if let Some(place) = find_mut(values, key).filter(|_| !origins.contains_key(key))
        && let Some(full_size) = number(place)
    {
        *place = Value::Float(fitted(full_size));
    }
}

/// The speed that the path has at its end, if it is a number that a car can have.
fn speed_at_goal_mps(values: &Table) -> Option<f64> {
    let of_path = find(values, "path.speeds_mps").and_then(Value::as_array);
    let last = of_path.and_then(|it| it.last()).and_then(number);
    let speed_mps = last.or_else(|| find(values, "reference.speed_mps").and_then(number))?;
    (speed_mps >= 0.0 && speed_mps.is_finite()).then_some(speed_mps)
}

#[cfg(test)]
#[allow(clippy::disallowed_methods, reason = "a test writes a path's file")]
mod tests {
    use super::*;
    use crate::Layers;

    #[test]
    fn a_small_car_may_have_less_additional_dead_time() {
        let below_s = |maneuver: &str, sets: &[&str]| {
            let mut layers = Layers::maneuver(maneuver).unwrap();
            sets.iter().for_each(|set| layers.set(set).unwrap());
            layers.resolve().unwrap().over.fragile_below_s
        };
        assert_eq!(below_s("roundabout", &[]), 0.2);
        // A longer car gets no more, and a user's own number is kept.
        assert_eq!(below_s("roundabout", &["vehicle.wheelbase_m=3.306"]), 0.2);
        let small = ["vehicle_preset=f1tenth"];
        assert!((below_s("smooth_lane", &small) - 0.0678).abs() < 1e-4);
        let own = ["vehicle_preset=f1tenth", "over.fragile_below_s=0.15"];
        assert_eq!(below_s("smooth_lane", &own), 0.15);
    }

    #[test]
    fn the_goal_is_as_wide_as_the_car_is_long_and_fast_unless_somebody_set_it() {
        let folder = tempfile::tempdir().unwrap();
        let radius_m = |vehicle: &str, last_mps: f64, sets: &[&str]| {
            let file = folder.path().join("path.csv");
            let path = format!("x_m,y_m,v_mps\n0,0,1\n40,0,{last_mps}\n");
            std::fs::write(&file, path).unwrap();
            let mut layers = Layers::own_path();
            layers.set_vehicle("--vehicle", vehicle).unwrap();
            sets.iter().for_each(|set| layers.set(set).unwrap());
            layers.add_path(&file).unwrap();
            layers.resolve().unwrap().drive.goal_radius_m
        };
        let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-9, "{a}, {b}");
        near(radius_m("tesla_model_3", 1.5, &[]), 0.2);
        near(radius_m("tesla_model_3", 3.0, &[]), 0.3);
        let of_small: Vec<f64> = [0.2, 0.6, 3.0].map(|mps| radius_m("f1tenth", mps, &[])).to_vec();
        near(of_small[0], LEAST_GOAL_M);
        near(of_small[1], 0.06);
        assert!(of_small[2] < 0.1, "{of_small:?}");
        near(radius_m("tesla_model_3", 3.0, &["drive.goal_radius_m=0.7"]), 0.7);
        // The paper's manoeuvres keep theirs, for every car.
        let mut layers = Layers::maneuver("roundabout").unwrap();
        layers.set("reference.speed_mps=6.0").unwrap();
        near(layers.resolve().unwrap().drive.goal_radius_m, 0.2);
    }
}
