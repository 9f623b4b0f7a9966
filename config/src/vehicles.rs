//! Where the values of a vehicle come from: its file, and the vehicle that this one is based on.
//!
//! A preset names every key of a vehicle, or the preset whose values it has otherwise (`based_on`), so that no car drives
//! with a speed controller or tyres that somebody forgot to replace. A file of the user's may leave keys out without
//! saying so: then they are told which car's values it has.

use toml::{Table, Value};

use crate::ConfigError;
use crate::layers::{find, keys, merge, parse_table};
use crate::presets::{hint, names_in, preset};

/// The key of a vehicle's file that names the preset below it.
pub(crate) const BASED_ON: &str = "based_on";
/// The preset below a file that names none.
pub(crate) const DEFAULT: &str = "tesla_model_3";
/// The part that describes how the ROS 2 adapter speaks: its defaults are no car's, so every file may leave keys out.
const ADAPTER: &str = "ros2";

/// The values of a vehicle's preset, all of them.
///
/// # Errors
/// If there is no preset with this name.
pub(crate) fn of_preset(name: &str) -> Result<Table, ConfigError> {
    let Some(file) = preset(&format!("vehicles/{name}.toml")) else {
        let known: Vec<&str> = names_in("vehicles").collect();
        let problem = format!("is {name:?}, which is no preset; {}", hint(name, &known));
        return Err(ConfigError::new("", BASED_ON, problem));
    };
    let mut vehicle = parse_table(file.path, file.text)?;
    let mut below = match vehicle.remove(BASED_ON) {
        Some(Value::String(base)) => of_preset(&base)?,
        _ if name == DEFAULT => Table::new(),
        _ => {
            let mut default = of_preset(DEFAULT)?;
            default.retain(|key, _| key == ADAPTER);
            default
        }
    };
    merge(&mut below, vehicle);
    Ok(below)
}

/// The keys of a vehicle that a file does not name; those of the adapter left out.
pub(crate) fn left_out(file: &Table) -> Vec<String> {
    let mut all = Vec::new();
    let default = of_preset(DEFAULT).expect("embedded");
    keys(&default, "", &mut all);
    let is_named = |key: &str| find(file, key).is_some();
    all.retain(|key| !key.starts_with(&format!("{ADAPTER}.")) && !is_named(key));
    all
}

/// What the user has to know of the keys that a file leaves out without naming a preset.
pub(crate) fn borrowed(file: &str, left_out: &[String]) -> String {
    format!(
        "{file} leaves out {} keys of a vehicle, which have the values of another car, {DEFAULT}: {}; name them, or the \
         preset whose values are right, as in {BASED_ON} = \"{DEFAULT}\"",
        left_out.len(),
        left_out.join(", "),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Layers, RunConfig};

    fn with_vehicle(text: &str) -> Result<(RunConfig, Option<String>), ConfigError> {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("car.toml");
        std::fs::write(&file, text).unwrap();
        let mut layers = Layers::maneuver("lane_change").unwrap();
        layers.set_vehicle("--vehicle", file.to_str().unwrap())?;
        let borrowed = layers.borrowed().map(str::to_owned);
        Ok((layers.resolve()?, borrowed))
    }

    #[test]
    fn a_preset_names_every_key_or_the_preset_that_it_is_based_on() {
        for name in names_in("vehicles") {
            let text = preset(&format!("vehicles/{name}.toml")).unwrap().text;
            let file: Table = text.parse().unwrap();
            let left_out = left_out(&file);
            assert!(file.contains_key(BASED_ON) || left_out.is_empty(), "{name}: {left_out:?}");
            let mut layers = Layers::maneuver("lane_change").unwrap();
            layers.set_vehicle("test", name).unwrap();
            assert_eq!(layers.borrowed(), None);
            let vehicle = layers.resolve().unwrap().vehicle;
            assert_eq!(vehicle.name, name);
            // Its own file says the same, read as a user's.
            assert_eq!(with_vehicle(text).unwrap().0.vehicle, vehicle);
            assert_eq!(with_vehicle(text).unwrap().1, None, "{name}");
        }
    }

    #[test]
    fn a_file_that_leaves_keys_out_is_told_whose_values_it_has() {
        let (config, borrowed) = with_vehicle("name = 'mine'\nwheelbase_m = 0.3\n").unwrap();
        assert_eq!((config.vehicle.wheelbase_m, config.vehicle.mass_kg), (0.3, 2035.0));
        let borrowed = borrowed.unwrap();
        for part in
            ["car.toml", "tesla_model_3", "mass_kg", "safety.jump_limit_m", "steering_delay_s"]
        {
            assert!(borrowed.contains(part), "{borrowed:?} lacks {part:?}");
        }
        assert!(!borrowed.contains("wheelbase_m") && !borrowed.contains("ros2"), "{borrowed:?}");

        let based = "based_on = 'f1tenth'\nname = 'mine'\nwheelbase_m = 0.3\n";
        let (config, borrowed) = with_vehicle(based).unwrap();
        assert_eq!((config.vehicle.wheelbase_m, config.vehicle.mass_kg), (0.3, 3.74));
        assert_eq!(borrowed, None);
        let carla = with_vehicle("based_on = 'carla'").unwrap().0.vehicle;
        assert_eq!((carla.ros2.odometry_point_m, carla.mass_kg), (1.44, 2035.0));
    }

    #[test]
    fn mistakes_name_file_and_way_out() {
        let check = |text: &str, parts: &[&str]| {
            let message = with_vehicle(text).unwrap_err().to_string();
            for part in parts {
                assert!(message.contains(part), "{message:?} lacks {part:?}");
            }
        };
        check("based_on = 'f1tent'", &["car.toml", "based_on", "mean f1tenth?"]);
        check("based_on = 3", &["car.toml:1", "based_on", "string"]);
        check("steering_delay_s = 1.5", &["car.toml:1", "steering_delay_s", "1.5", "[0, 1]"]);
        check("steering_gain = -1.0", &["car.toml:1", "steering_gain", "-1", "[0.1, 10]"]);
        check("steering_lag_s = -0.1", &["steering_lag_s", "[0, 10]"]);
        check("steering_offset_rad = 0.6", &["steering_offset_rad", "[-0.5, 0.5]"]);
        check("steering_dead_band_rad = nan", &["steering_dead_band_rad", "NaN"]);
        check("speed_delay_s = -0.01", &["speed_delay_s", "[0, 1]"]);
    }

    #[test]
    fn a_manoeuvre_s_keys_count_for_its_own_vehicle() {
        let smooth_lane = || Layers::maneuver("smooth_lane").unwrap();
        let config = smooth_lane().resolve().unwrap();
        assert_eq!(config.vehicle_preset, "tesla_model_3_guarded");
        assert!(config.vehicle.gear_engaged && config.vehicle.safety.jump_limit_m == 0.6);
        let mut other = smooth_lane();
        other.set_vehicle("--vehicle", "tesla_model_3").unwrap();
        assert!(!other.resolve().unwrap().vehicle.gear_engaged);
    }
}
