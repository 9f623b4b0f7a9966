//! Where the values of a vehicle come from: its file, and the vehicle that this one is based on.
//!
//! A preset names every key of a vehicle, or the preset whose values it has otherwise (`base`), so that no car drives
//! with a speed controller or tyres that somebody forgot to replace. A file of the user's may leave keys out without
//! saying so: then they are told which car's values it has.

use toml::{Table, Value};

use crate::ConfigError;
use crate::layers::{find, keys, merge, number, parse_table};
use crate::presets::{hint, names_in, preset};

/// The key of a vehicle's file that names the preset below it.
pub(crate) const BASE: &str = "base";
/// The same key, as files of earlier versions have it.
pub(crate) const EARLIER_BASE: &str = "based_on";
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
        return Err(ConfigError::new("", BASE, problem));
    };
    let mut vehicle = parse_table(file.path, file.text)?;
    let mut below = match vehicle.remove(BASE) {
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

/// The preset that a file names as the one below it, with the key by which it does.
///
/// # Errors
/// If it names one by both keys.
pub(crate) fn base_of<'a>(
    name: &str,
    file: &'a Table,
) -> Result<Option<(&'static str, &'a Value)>, ConfigError> {
    let named = |key: &'static str| file.get(key).map(|preset| (key, preset));
    match (named(BASE), named(EARLIER_BASE)) {
        (Some(_), Some(_)) => {
            let problem = format!("means the same as {EARLIER_BASE}; keep {BASE} only");
            Err(ConfigError::new(name, BASE, problem))
        }
        (now, earlier) => Ok(now.or(earlier)),
    }
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

/// What a file's values make doubtful, though they may be meant so.
pub(crate) fn doubts(name: &str, file: &Table) -> Option<String> {
    /// The quickest servos of model cars turn the wheels by some 10 rad/s.
    const QUICK_RADPS: f64 = 15.0;
    const KEY: &str = "steering_rate_radps";
    let rate = find(file, KEY).and_then(number).filter(|rate| *rate > QUICK_RADPS)?;
    Some(format!(
        "{name}: {KEY} is {rate} rad/s, quicker than any car's steering; if it is in degrees, write {:.3}",
        rate.to_radians()
    ))
}

/// Values that a vehicle's file has from another car, because it neither names them nor the preset whose values are right.
#[derive(Debug, Clone)]
pub(crate) struct Borrowed {
    /// The file.
    pub(crate) file: String,
    /// The keys that it leaves out.
    pub(crate) keys: Vec<String>,
}

impl Borrowed {
    /// What the user has to know of them.
    pub(crate) fn told(&self) -> String {
        let Self { file, keys } = self;
        format!(
            "{file} leaves out {} keys of a vehicle, which have the values of another car, {DEFAULT}: {}; name them, or the \
             preset whose values are right, as in {BASE} = \"{DEFAULT}\"",
            keys.len(),
            keys.join(", "),
        )
    }

    /// What has to be said of a wrong value, if it is one of these.
    pub(crate) fn whose(self, key: &str) -> Option<String> {
        let name = key.strip_prefix("vehicle.")?;
        let Self { file, keys } = self;
        keys.iter().any(|it| it == name).then(|| {
            format!(
                " ({file} leaves {name} out, so it is that of {DEFAULT}: name it, or the preset whose values are right, as in \
                 {BASE} = \"f1tenth\")"
            )
        })
    }
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
        let borrowed = layers.borrowed();
        Ok((layers.resolve()?, borrowed))
    }

    #[test]
    fn a_preset_names_every_key_or_the_preset_that_it_is_based_on() {
        for name in names_in("vehicles") {
            let text = preset(&format!("vehicles/{name}.toml")).unwrap().text;
            let file: Table = text.parse().unwrap();
            let left_out = left_out(&file);
            assert!(file.contains_key(BASE) || left_out.is_empty(), "{name}: {left_out:?}");
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
        let (config, borrowed) = with_vehicle("name = 'mine'\nwheelbase_m = 2.3\n").unwrap();
        assert_eq!((config.vehicle.wheelbase_m, config.vehicle.mass_kg), (2.3, 2035.0));
        // The resolved configuration, which the report reads, has them as well.
        assert!(config.vehicle.borrowed.contains(&"mass_kg".to_owned()));
        let text = toml::to_string(&config).unwrap();
        assert_eq!(RunConfig::from_resolved(&text).unwrap(), config);
        let borrowed = borrowed.unwrap();
        for part in
            ["car.toml", "tesla_model_3", "mass_kg", "safety.jump_limit_m", "steering_delay_s"]
        {
            assert!(borrowed.contains(part), "{borrowed:?} lacks {part:?}");
        }
        assert!(!borrowed.contains("wheelbase_m") && !borrowed.contains("ros2"), "{borrowed:?}");

        let based = "base = 'f1tenth'\nname = 'mine'\nwheelbase_m = 0.3\n";
        let (config, borrowed) = with_vehicle(based).unwrap();
        assert_eq!((config.vehicle.wheelbase_m, config.vehicle.mass_kg), (0.3, 3.74));
        assert_eq!(borrowed, None);
        let carla = with_vehicle("base = 'carla'").unwrap().0.vehicle;
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
        check("base = 'f1tent'", &["car.toml", "base", "mean f1tenth?"]);
        check("base = 3", &["car.toml:1", "base", "string"]);
        check("steering_delay_s = 1.5", &["car.toml:1", "steering_delay_s", "1.5", "[0, 1]"]);
        check("steering_gain = -1.0", &["car.toml:1", "steering_gain", "-1", "[0.1, 10]"]);
        check("steering_lag_s = -0.1", &["steering_lag_s", "[0, 10]"]);
        check("steering_offset_rad = 0.6", &["steering_offset_rad", "[-0.5, 0.5]"]);
        check("rear_slip_s2pm = 0.1", &["rear_slip_s2pm", "0.1", "[0, 0.05]"]);
        check("understeer_s2pm = -0.1", &["understeer_s2pm", "-0.1", "[0, 0.05]"]);
        check("yaw_lag_s2pm = 0.1", &["yaw_lag_s2pm", "0.1", "[0, 0.05]"]);
        check(
            "model = 'dynamic'\nrear_slip_s2pm = 0.004",
            &["rear_slip_s2pm", "slip by themselves"],
        );
        check("model = 'dynamic'\nyaw_lag_s2pm = 0.004", &["yaw_lag_s2pm", "slip by themselves"]);
        check("steering_dead_band_rad = nan", &["steering_dead_band_rad", "NaN"]);
        check("speed_delay_s = -0.01", &["speed_delay_s", "[0, 1]"]);
    }

    #[test]
    fn the_name_that_earlier_files_have_for_the_base_is_read() {
        let of = |text: &str| with_vehicle(text).unwrap().0.vehicle;
        let earlier = of("based_on = 'f1tenth'\nname = 'mine'");
        assert_eq!(earlier, of("base = 'f1tenth'\nname = 'mine'"));
        let both = with_vehicle("base = 'carla'\nbased_on = 'f1tenth'").unwrap_err().to_string();
        assert!(both.contains("keep base only"), "{both}");
        let typo = with_vehicle("based_on = 'f1tent'").unwrap_err().to_string();
        assert!(typo.contains("based_on") && typo.contains("mean f1tenth?"), "{typo}");
    }

    #[test]
    fn a_vehicle_that_cannot_be_is_refused() {
        let check = |text: &str, parts: &[&str]| {
            let message = with_vehicle(text).unwrap_err().to_string();
            for part in parts {
                assert!(message.contains(part), "{message:?} lacks {part:?}");
            }
        };
        let own = |text: &str| format!("base = 'f1tenth'\n{text}");
        check(&own("wheelbase_m = 0"), &["car.toml:2", "vehicle.wheelbase_m", "is 0"]);
        check(&own("wheelbase_m = -0.3"), &["car.toml:2", "vehicle.wheelbase_m", "-0.3"]);
        check(&own("wheelbase_m = nan"), &["car.toml:2", "vehicle.wheelbase_m", "NaN"]);
        check(
            &own("tracked_point_m = 0.4"),
            &["car.toml:2", "tracked_point_m", "front axle", "0.33"],
        );
        check(&own("body_front_m = 0.2"), &["car.toml:2", "body_front_m", "front axle", "0.33"]);
        let limit = own("steering_limit_rad = 24");
        check(&limit, &["car.toml:2", "steering_limit_rad", "radians", "24°", "0.419"]);
        check(&own("steering_rate_radps = 180"), &["car.toml:2", "radians", "180°", "3.142"]);
        // Of a key that the file leaves out, it says whose value it is.
        let left_out = "name = 'mine'\nwheelbase_m = 0.33\n";
        check(left_out, &["car.toml", "tracked_point_m", "is 0.7", "tesla_model_3", "base ="]);
        let missing = Layers::maneuver("lane_change").unwrap().set_vehicle("--vehicle", "f1tenht");
        assert!(missing.unwrap_err().to_string().contains("did you mean f1tenth?"));
    }

    #[test]
    fn slips_in_a_file_are_told_with_what_is_right() {
        for (line, parts) in [
            ("base = f1tenth", ["car.toml:1", "in quotes"]),
            ("wheelbase_m = 0,33", ["car.toml:1", "has a point"]),
            ("wheelbase_m = .33", ["car.toml:1", "begins with a digit"]),
            ("jerk_limit_mps3 = 5.0", ["car.toml:1", "did you mean safety.jerk_limit_mps3?"]),
            ("safety.speed_limit_mps = 5.0", ["car.toml:1", "did you mean speed_limit_mps?"]),
        ] {
            let told = with_vehicle(line).unwrap_err().to_string();
            assert!(parts.iter().all(|part| told.contains(part)), "{line}: {told}");
        }
    }

    #[test]
    fn a_steering_rate_that_may_be_in_degrees_is_doubted() {
        for (rate, is_doubted) in [("35", true), ("15", false), ("3.2", false)] {
            let file: Table = format!("steering_rate_radps = {rate}").parse().unwrap();
            let told = doubts("car.toml", &file);
            assert_eq!(told.is_some(), is_doubted, "{rate}");
            assert!(told.is_none_or(|it| it.contains("car.toml") && it.contains("0.611")));
        }
    }

    #[test]
    fn noise_that_the_file_states_is_no_jump() {
        let noisy = "base = 'f1tenth'\n[noise]\nposition_sd_m = 0.1\n";
        let told = with_vehicle(noisy).unwrap_err().to_string();
        for part in
            ["car.toml:3", "noise.position_sd_m", "0.1", "safety.jump_limit_m", "0.2", "0.57"]
        {
            assert!(told.contains(part), "{told:?} lacks {part:?}");
        }
        let turning = "base = 'f1tenth'\n[noise]\nheading_half_width_rad = 0.2\n";
        let told = with_vehicle(turning).unwrap_err().to_string();
        assert!(told.contains("safety.jump_limit_rad") && told.contains("0.4"), "{told}");
        with_vehicle(&noisy.replace("0.1", "0.02")).unwrap();
        with_vehicle(&format!("{noisy}[safety]\njump_limit_m = 0.6\n")).unwrap();
        // This car has no limit.
        with_vehicle(&noisy.replace("f1tenth", "tesla_model_3")).unwrap();
    }

    #[test]
    fn what_commands_a_vehicle_keeps_to_the_vehicle_s_limits() {
        let of = |text: &str, sets: &[&str]| {
            let folder = tempfile::tempdir().unwrap();
            let file = folder.path().join("car.toml");
            std::fs::write(&file, text).unwrap();
            let mut layers = Layers::maneuver("lane_change").unwrap();
            layers.set_vehicle("--vehicle", file.to_str().unwrap()).unwrap();
            for set in sets {
                layers.set(set).unwrap();
            }
            let config = layers.resolve()?;
            Ok::<_, ConfigError>((
                config.controller.steering_limit_rad,
                config.supervisor.speed_limit_mps,
            ))
        };
        let car = "base = 'tesla_model_3'\nsteering_limit_rad = 0.9\nspeed_limit_mps = 12\n";
        assert_eq!(of(car, &[]).unwrap(), (0.9, 12.0));
        let lower = ["controller.steering_limit_rad=0.4", "supervisor.speed_limit_mps=3"];
        assert_eq!(of(car, &lower).unwrap(), (0.4, 3.0));
        let higher = ["controller.steering_limit_rad=1.2", "supervisor.speed_limit_mps=20.0"];
        assert_eq!(of(car, &higher).unwrap(), (0.9, 12.0));
        let told = of(car, &["controller.steering_limit_rad=30"]).unwrap_err().to_string();
        assert!(told.contains("radians") && told.contains("0.524"), "{told}");
        let told = of(car, &["reference.speed_mps=13"]).unwrap_err().to_string();
        assert!(
            told.contains("reference.speed_mps") && told.contains("vehicle.speed_limit_mps"),
            "{told}"
        );
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
