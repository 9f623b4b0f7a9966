//! Lengths among the parameters of a law: their numbers are made for a car of one size, and fit another's when they are
//! scaled with the wheelbase.

use toml::{Table, Value};

/// Scales the bounds, default and grid of every length to the vehicle of these layers. A grid that is not the law's own
/// belongs to the manoeuvre or the user, and stays as it is.
pub(crate) fn fit_lengths(values: &mut Table) {
    let wheelbase = values.get("vehicle").and_then(|vehicle| number(vehicle.get("wheelbase_m")));
    let law = values.get("law");
    let Some((wheelbase_m, Value::Array(parameters))) =
        wheelbase.zip(law.and_then(|law| law.get("parameters")).cloned())
    else {
        return;
    };
    let fitted = parameters.into_iter().map(|mut parameter| {
        let own_grid = parameter.get("grid").cloned();
        if fit(&mut parameter, wheelbase_m)
            && let Some(Value::Table(grid)) = values.get_mut("grid")
            && let Some(axis) = parameter.get("key").and_then(Value::as_str).map(str::to_owned)
            && let (Some(own), Some(fitted)) = (own_grid, parameter.get("grid"))
            && grid.get(&axis) == Some(&own)
        {
            grid.insert(axis, fitted.clone());
        }
        parameter
    });
    let fitted = Value::Array(fitted.collect());
    if let Some(Value::Table(law)) = values.get_mut("law") {
        law.insert("parameters".to_owned(), fitted);
    }
}

/// Scales one parameter; returns whether it is a length that did not fit the wheelbase yet.
fn fit(parameter: &mut Value, wheelbase_m: f64) -> bool {
    let Some(made_for_m) = number(parameter.get("for_wheelbase_m")) else { return false };
    let ratio = wheelbase_m / made_for_m;
    if ratio == 1.0 || !ratio.is_finite() || ratio <= 0.0 {
        return false;
    }
    let is_log = parameter.get("scale").and_then(Value::as_str) == Some("log");
    let scale = |table: Option<&mut Value>, key: &str| {
        if let Some(value) = table.and_then(|table| table.get_mut(key))
            && let Some(length_m) = number(Some(value))
        {
            *value = Value::Float(length_m * ratio);
        }
    };
    for key in ["min", "max", "default"] {
        scale(Some(parameter), key);
    }
    // The step of a log scale is a ratio.
    for key in if is_log { &["min", "max"][..] } else { &["min", "max", "step"] } {
        scale(parameter.get_mut("grid"), key);
    }
    if let Value::Table(parameter) = parameter {
        parameter.insert("for_wheelbase_m".to_owned(), Value::Float(wheelbase_m));
    }
    true
}

fn number(value: Option<&Value>) -> Option<f64> {
    match value? {
        Value::Float(number) => Some(*number),
        Value::Integer(number) => Some(*number as f64),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use crate::Layers;

    fn pure_pursuit(steps: impl Fn(&mut Layers)) -> crate::RunConfig {
        let mut layers = Layers::maneuver("lane_change").unwrap();
        steps(&mut layers);
        layers.resolve().unwrap()
    }

    #[test]
    fn lengths_fit_the_car_whichever_comes_first() {
        let full_size = pure_pursuit(|it| it.set_law("test", "pure_pursuit").unwrap());
        let parameters = &full_size.law.parameters;
        assert_eq!((parameters[1].default, full_size.grid["ld_min"].max), (2.0, 8.0));
        let law_first = pure_pursuit(|it| {
            it.set_law("test", "pure_pursuit").unwrap();
            it.set_vehicle("test", "f1tenth").unwrap();
        });
        let vehicle_first = pure_pursuit(|it| {
            it.set_vehicle("test", "f1tenth").unwrap();
            it.set_law("test", "pure_pursuit").unwrap();
        });
        assert_eq!(law_first, vehicle_first);
        let (ratio, small) = (0.3302 / 2.875, &law_first.law.parameters);
        assert_eq!(small[1].default, 2.0 * ratio);
        assert_eq!((small[1].min, small[1].max), (0.1 * ratio, 20.0 * ratio));
        assert_eq!(law_first.grid["ld_min"].min, 0.5 * ratio);
        // A length for each metre a second is a length.
        assert_eq!((small[2].default, law_first.grid["ld_s"].step), (0.8 * ratio, 0.4 * ratio));
        // The step of a log scale and what is no length stay.
        assert_eq!(law_first.grid["ld_min"].step, 2.0);
        assert_eq!(small[3], parameters[3]);
        assert_eq!(law_first.grid().len(), full_size.grid().len());
    }

    #[test]
    fn a_resolved_configuration_is_not_scaled_again_and_neither_is_a_plant_of_another_wheelbase() {
        let small = pure_pursuit(|it| {
            it.set_vehicle("test", "f1tenth").unwrap();
            it.set_law("test", "pure_pursuit").unwrap();
        });
        let text = toml::to_string(&small).unwrap();
        let again = pure_pursuit(|it| it.add_document("resolved.toml", &text).unwrap());
        assert_eq!(again.law, small.law);
        assert_eq!(again.grid, small.grid);
        let plant = pure_pursuit(|it| {
            it.set_law("test", "pure_pursuit").unwrap();
            it.set("vehicle.wheelbase_m=3.306").unwrap();
        });
        assert_eq!(plant.law.parameters[1].default, 2.0);
    }

    #[test]
    fn a_grid_of_the_user_s_own_stays() {
        let config = pure_pursuit(|it| {
            it.set_law("test", "pure_pursuit").unwrap();
            it.set("grid.ld_min={min=1.0,max=2.0,step=2.0}").unwrap();
            it.set_vehicle("test", "f1tenth").unwrap();
        });
        assert_eq!(config.grid["ld_min"].max, 2.0);
    }
}
