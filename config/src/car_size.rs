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

/// Fits to the car the range of the learners' states, which is a length, the weight of a squared angle beside squared
/// lengths, and the goal's radius.
pub(crate) fn scale_to_the_car(values: &mut Table, origins: &BTreeMap<String, String>) {
    let is_own_path =
        find(values, "maneuver").and_then(Value::as_str) == Some(crate::presets::OWN_PATH);
    let Some(wheelbase_m) = find(values, "vehicle.wheelbase_m").and_then(number) else { return };
    let ratio = wheelbase_m / FULL_SIZE_WHEELBASE_M;
    if !is_own_path || !(ratio > 0.0 && ratio.is_finite()) {
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
