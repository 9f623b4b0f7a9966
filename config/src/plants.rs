//! Plants: vehicles that a car may really be, as changes of the values in its file.

use std::collections::BTreeMap;
use std::path::Path;

use serde::{Deserialize, Serialize};
use toml::Value;

use crate::presets::nearest;
use crate::schema::choice;
use crate::validate::Problem;
use crate::{ConfigError, Layers, RunConfig, Vehicle};

choice!(
    /// By what a set is judged that is driven on several plants.
    OverBy {
        /// One drive, of the vehicle as its file has it.
        Nominal,
        /// The mean of the errors over the plants; it arrives only if it does on all of them.
        Mean,
        /// The drive that nine of ten plants do not exceed by the objective.
        P90,
        /// The drive that is worst by the objective.
        Worst,
    }
);

/// On which plants a set is driven, and how the drives are judged together.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
#[allow(missing_docs, reason = "documented key by key in readings.toml")]
pub struct Over {
    pub by: OverBy,
    pub plants: Vec<PlantChange>,
}

impl Default for Over {
    fn default() -> Self {
        Self { by: OverBy::Nominal, plants: Vec::new() }
    }
}

/// How a plant differs from the vehicle's file.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlantChange {
    /// What it is called in tables.
    pub name: String,
    /// What is added to keys of the vehicle, in their units.
    #[serde(default)]
    pub add: BTreeMap<String, f64>,
    /// What keys of the vehicle are multiplied by, before something is added.
    #[serde(default)]
    pub scale: BTreeMap<String, f64>,
}

impl PlantChange {
    fn new(name: &str, add: &[(&str, f64)], scale: &[(&str, f64)]) -> Self {
        let of = |pairs: &[(&str, f64)]| {
            pairs.iter().map(|&(key, by)| (key.to_owned(), by)).collect::<BTreeMap<_, _>>()
        };
        Self { name: name.to_owned(), add: of(add), scale: of(scale) }
    }

    /// The vehicle that it makes of another one.
    ///
    /// # Errors
    /// If it changes a key that a vehicle does not have, or that is no number.
    fn of(&self, vehicle: &Vehicle) -> Result<Vehicle, Problem> {
        let mut table = match Value::try_from(vehicle) {
            Ok(Value::Table(table)) => table,
            _ => unreachable!("a vehicle is a table"),
        };
        let numbers: Vec<String> = table
            .iter()
            .filter(|(_, value)| value.is_float())
            .map(|(key, _)| key.clone())
            .collect();
        let scaled = self.scale.iter().map(|(key, by)| ("scale", key, *by));
        let added = self.add.iter().map(|(key, by)| ("add", key, *by));
        for (how, key, by) in scaled.chain(added) {
            let Some(Value::Float(value)) = table.get_mut(key) else {
                let known = numbers.iter().map(String::as_str);
                let advice = nearest(key, known)
                    .map_or(String::new(), |near| format!("; did you mean {near}?"));
                let problem = format!("is no number of a vehicle{advice}");
                return Err((format!("{how}.{key}"), problem));
            };
            if !by.is_finite() {
                return Err((format!("{how}.{key}"), format!("is {by}, but must be finite")));
            }
            *value = if how == "scale" { *value * by } else { *value + by };
        }
        Value::Table(table)
            .try_into()
            .map_err(|why: toml::de::Error| (String::new(), why.to_string()))
    }
}

/// Largest number of plants: each is a drive of every set.
const MAX_PLANTS: usize = 64;
/// The plants that are assumed where nobody has named any, for a car whose values are estimates.
const MORE_UNDERSTEER_S2PM: f64 = 0.004;

impl Layers {
    /// Puts the plants of a file on top.
    ///
    /// # Errors
    /// If the file cannot be read, or holds anything but `[[plants]]`.
    pub fn add_plants(&mut self, file: &Path) -> Result<(), ConfigError> {
        #[derive(Deserialize)]
        #[serde(deny_unknown_fields)]
        struct File {
            plants: Vec<PlantChange>,
        }
        let origin = file.display().to_string();
        let advice = "name a TOML file with [[plants]], or `default`";
        let text = crate::read_small(file)
            .map_err(|why| ConfigError::new(&origin, "", format!("{why}; {advice}")))?;
        let File { plants } = toml::from_str(&text)
            .map_err(|why| ConfigError::new(&origin, "", format!("{}; {advice}", why.message())))?;
        if plants.is_empty() {
            return Err(ConfigError::new(&origin, "plants", format!("is empty; {advice}")));
        }
        let value = Value::try_from(plants).expect("plants are plain data");
        self.put(&origin, "over.plants", value)
    }
}

impl RunConfig {
    /// How plants differ from the vehicle that this car may be: those that the configuration names, those within the
    /// intervals that a user states in the vehicle's file, or eight around the estimate. These are errors of a model, not draws of measured uncertainty: dead times and lag that are longer,
    /// steering that turns more slowly, understeer, and an offset to both sides.
    pub fn plant_changes(&self) -> Vec<PlantChange> {
        if !self.over.plants.is_empty() {
            return self.over.plants.clone();
        }
        let uncertainty = &self.vehicle.uncertainty;
        if let Some(stated) = uncertainty.plant_changes(&self.vehicle, self.run.seed) {
            return stated;
        }
        // At the reference's speed, a gradient of understeer acts like a longer wheelbase.
        let longer_m = MORE_UNDERSTEER_S2PM * self.reference.speed_mps * self.reference.speed_mps;
        let late = |s: f64| [("steering_delay_s", s), ("speed_delay_s", s)];
        let around = [
            PlantChange::new("as in the vehicle's file", &[], &[]),
            PlantChange::new("dead times +30 ms", &late(0.03), &[]),
            PlantChange::new("dead times +60 ms", &late(0.06), &[]),
            PlantChange::new("steering rate × 0.8", &[], &[("steering_rate_radps", 0.8)]),
            PlantChange::new("steering lag +50 ms", &[("steering_lag_s", 0.05)], &[]),
            PlantChange::new("understeer +0.004 s²/m", &[("wheelbase_m", longer_m)], &[]),
            PlantChange::new("steering offset +10 mrad", &[("steering_offset_rad", 0.01)], &[]),
            PlantChange::new("steering offset −10 mrad", &[("steering_offset_rad", -0.01)], &[]),
        ];
        // A car whose file is at the edge of what a vehicle can have is not asked for more than that.
        around.into_iter().filter(|it| self.check_plant(it).is_ok()).collect()
    }

    /// The configuration with the vehicle that a change makes of this one. It is for the plant alone: what drives it
    /// goes on believing in the vehicle's file.
    ///
    /// # Panics
    /// If the change is none of a resolved configuration.
    pub fn with_plant(&self, change: &PlantChange) -> Self {
        let vehicle = change.of(&self.vehicle).expect("a resolved configuration was checked");
        Self { vehicle, ..self.clone() }
    }

    fn check_plant(&self, change: &PlantChange) -> Result<(), Problem> {
        let plant = Self { vehicle: change.of(&self.vehicle)?, ..self.clone() };
        crate::validate::vehicle(&plant).map_err(|(key, problem)| {
            (key, format!("{problem}, with the plant \"{}\"", change.name))
        })
    }

    /// Number of plants on which each set is driven in a training.
    pub fn plants(&self) -> usize {
        if self.over.by == OverBy::Nominal { 1 } else { self.plant_changes().len() }
    }
}

pub(crate) fn validate(config: &RunConfig) -> Result<(), Problem> {
    let count = config.over.plants.len();
    if count > MAX_PLANTS {
        let problem = format!("names {count} plants, but at most {MAX_PLANTS} are driven");
        return Err(("over.plants".to_owned(), problem));
    }
    for (index, change) in config.over.plants.iter().enumerate() {
        let at = |(key, problem)| (format!("over.plants[{index}].{key}"), problem);
        config.check_plant(change).map_err(at)?;
    }
    if config.over.plants.is_empty() {
        let uncertainty = &config.vehicle.uncertainty;
        for change in uncertainty.plant_changes(&config.vehicle, config.run.seed).iter().flatten() {
            let key = |(key, problem): Problem| {
                (key.replace("vehicle.", "vehicle.uncertainty."), problem)
            };
            config.check_plant(change).map_err(key)?;
        }
    }
    if config.over.by != OverBy::Nominal && config.noise.enabled {
        let problem = "is not \"nominal\", but with noise a set is not driven over plants; leave out --noise or --over";
        return Err(("over.by".to_owned(), problem.to_owned()));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Layers;

    fn config(sets: &[&str]) -> Result<RunConfig, crate::ConfigError> {
        let mut layers = Layers::maneuver("roundabout").unwrap();
        for set in sets {
            layers.set(set)?;
        }
        layers.resolve()
    }

    #[test]
    fn without_names_there_are_eight_plants_around_the_vehicle() {
        let plain = config(&[]).unwrap();
        assert_eq!((plain.plants(), plain.plant_changes().len()), (1, 8));
        let over = config(&["over.by=mean"]).unwrap();
        assert_eq!(over.plants(), 8);
        let plants: Vec<Vehicle> =
            over.plant_changes().iter().map(|it| over.with_plant(it).vehicle).collect();
        assert_eq!(plants[0], over.vehicle);
        assert_eq!(plants[2].steering_delay_s, over.vehicle.steering_delay_s + 0.06);
        assert_eq!(plants[3].steering_rate_radps, 0.8 * over.vehicle.steering_rate_radps);
        assert!(plants[1..].iter().all(|it| *it != over.vehicle));
    }

    #[test]
    fn a_plant_that_cannot_be_is_refused_with_its_key() {
        let refused = |plant: &str| {
            let set = format!("over.plants=[{plant}]");
            config(&["over.by=\"worst\"", &set]).unwrap_err().to_string()
        };
        let typo = refused("{name='late',add={steering_dely_s=0.1}}");
        assert!(typo.contains("over.plants[0].add.steering_dely_s"), "{typo}");
        assert!(typo.contains("steering_delay_s?"), "{typo}");
        let negative = refused("{name='early',add={steering_delay_s=-0.5}}");
        assert!(negative.contains("early"), "{negative}");
        let word = refused("{name='x',scale={name=2.0}}");
        assert!(word.contains("no number"), "{word}");
        let noisy = config(&["over.by=mean", "noise.enabled=true"]).unwrap_err().to_string();
        assert!(noisy.contains("--noise"), "{noisy}");
    }
}
