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
    pub repeats: u32,
    #[serde(default = "choosing_plants")]
    pub choosing: u32,
    pub fragile_below_s: f64,
}

/// For configurations that were written before there was the key.
fn choosing_plants() -> u32 {
    Over::default().choosing
}

impl Default for Over {
    fn default() -> Self {
        Self {
            by: OverBy::Nominal,
            plants: Vec::new(),
            repeats: 2,
            choosing: 36,
            fragile_below_s: 0.2,
        }
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
    /// What keys of the vehicle are multiplied by, before something is added; and [`PlantChange::SPEED`].
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

    /// The key of the speeds at which the path is driven: a car is to hold at another speed, too.
    pub const SPEED: &str = "reference.speed_mps";

    /// By what the speeds of the reference are multiplied.
    pub fn speed_factor(&self) -> f64 {
        self.scale.get(Self::SPEED).copied().unwrap_or(1.0)
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
        let of_vehicle = self.scale.iter().filter(|(key, _)| *key != Self::SPEED);
        let scaled = of_vehicle.map(|(key, by)| ("scale", key, *by));
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

/// What a process makes of the configuration to drive with, made once for each plant that wants another than the
/// configured vehicle does.
#[derive(Debug, Clone)]
pub struct PerPlant<T> {
    of_vehicle: T,
    /// By the numbers of drive requests; `None` where that of the vehicle serves.
    of_plants: BTreeMap<u32, Option<T>>,
}

impl<T> PerPlant<T> {
    /// With what drives the configured vehicle.
    pub fn new(of_vehicle: T) -> Self {
        Self { of_vehicle, of_plants: BTreeMap::new() }
    }

    /// What drives the plant of a drive request, see [`RunConfig::driving_plant_number`].
    pub fn of(&mut self, config: &RunConfig, plant: u32, make: impl Fn(&RunConfig) -> T) -> &T {
        if plant == 0 {
            return &self.of_vehicle;
        }
        let made = self.of_plants.entry(plant);
        made.or_insert_with(|| config.driving_plant_number(plant).as_ref().map(make))
            .as_ref()
            .unwrap_or(&self.of_vehicle)
    }
}

/// Largest number of plants: each is a drive of every set.
const MAX_PLANTS: usize = 64;
/// How much faster a set is to hold that is chosen over the plants that nobody has named.
const FASTER: f64 = 1.5;
/// The largest speed of a reference, as `reference.speed_mps` has it.
const FASTEST_MPS: f64 = 50.0;
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
        let File { plants } = toml::from_str(&text).map_err(|why| {
            let line = crate::layers::line_of(&text, why.span().map_or(0, |span| span.start));
            ConfigError::new(format!("{origin}:{line}"), "", format!("{}; {advice}", why.message()))
        })?;
        if plants.is_empty() {
            return Err(ConfigError::new(&origin, "plants", format!("is empty; {advice}")));
        }
        let value = Value::try_from(plants).expect("plants are plain data");
        self.put(&origin, "over.plants", value)
    }
}

impl RunConfig {
    /// How plants differ from the vehicle that this car may be: those that the configuration names, those within the
    /// intervals that a user states in the vehicle's file, or eight around the estimate. The eight are errors of a model,
    /// not draws of measured uncertainty: dead times and lag that are longer, steering that turns more slowly, understeer,
    /// and an offset to both sides. A set that is chosen over plants is also to hold when it drives faster than it was
    /// trained for, which the eight do not ask: so there is a ninth then. It tells nothing of whether a set is fragile, as
    /// every car is farther from the path when it drives faster.
    pub fn plant_changes(&self) -> Vec<PlantChange> {
        let named = self.named_plants();
        if !named.is_empty() {
            return named;
        }
        let uncertainty = &self.vehicle.uncertainty;
        // At the reference's speed, a gradient of understeer acts like a longer wheelbase.
        let longer_m = MORE_UNDERSTEER_S2PM * self.reference.speed_mps * self.reference.speed_mps;
        let late = |ms: u32| {
            let s = f64::from(ms) / 1000.0;
            let later = [("steering_delay_s", s), ("speed_delay_s", s)];
            PlantChange::new(&format!("dead times +{ms} ms"), &later, &[])
        };
        // A drive that told the dead time to some milliseconds leaves no room for 60 more, and a choice that allows for them
        // stays farther from the path than it has to.
        let [late, later] =
            if uncertainty.tells_dead_time() { [10, 20] } else { [30, 60] }.map(late);
        let around = [
            PlantChange::new("as in the vehicle's file", &[], &[]),
            late,
            later,
            PlantChange::new("steering rate × 0.8", &[], &[("steering_rate_radps", 0.8)]),
            PlantChange::new("steering lag +50 ms", &[("steering_lag_s", 0.05)], &[]),
            PlantChange::new("understeer +0.004 s²/m", &[("wheelbase_m", longer_m)], &[]),
            PlantChange::new("steering offset +10 mrad", &[("steering_offset_rad", 0.01)], &[]),
            PlantChange::new("steering offset −10 mrad", &[("steering_offset_rad", -0.01)], &[]),
        ];
        let mut around = around.to_vec();
        let faster_mps = FASTER * self.reference.speed_mps;
        // A path with speeds of its own is driven as fast as the car can.
        let may_be_faster =
            self.path.speeds_mps.is_empty() && faster_mps <= self.supervisor.speed_limit_mps;
        if self.over.by != OverBy::Nominal && may_be_faster {
            around.push(PlantChange::new(
                "reference 1.5 × as fast",
                &[],
                &[(PlantChange::SPEED, FASTER)],
            ));
        }
        // A car whose file is at the edge of what a vehicle can have is not asked for more than that.
        around.into_iter().filter(|it| self.check_plant(it).is_ok()).collect()
    }

    /// The plants that the configuration names, or those within the intervals that a user states, which the seed spreads; none
    /// if nobody has named any.
    pub fn named_plants(&self) -> Vec<PlantChange> {
        if !self.over.plants.is_empty() {
            return self.over.plants.clone();
        }
        let stated = self.vehicle.uncertainty.plant_changes(&self.vehicle, self.run.seed);
        stated.unwrap_or_default()
    }

    /// The configuration with the vehicle that a change makes of this one. It is for the plant alone: what drives it
    /// goes on believing in the vehicle's file, see [`RunConfig::driving_plant`].
    ///
    /// # Panics
    /// If the change is none of a resolved configuration.
    pub fn with_plant(&self, change: &PlantChange) -> Self {
        let vehicle = change.of(&self.vehicle).expect("a resolved configuration was checked");
        Self { vehicle, ..self.driving_plant(change) }
    }

    /// The configuration of what drives a plant: the vehicle of the file, and the reference's speeds of the plant.
    pub fn driving_plant(&self, change: &PlantChange) -> Self {
        let mut driving = self.clone();
        let factor = change.speed_factor();
        driving.reference.speed_mps *= factor;
        for speed_mps in &mut driving.path.speeds_mps {
            *speed_mps *= factor;
        }
        driving
    }

    /// The configuration of what drives the plant of a drive request: 0 is the configured vehicle, n the n-th plant.
    /// `None` if it drives that as it drives the configured vehicle, or if there is no such plant.
    pub fn driving_plant_number(&self, plant: u32) -> Option<Self> {
        let change = self.plant_changes().into_iter().nth((plant as usize).checked_sub(1)?)?;
        (change.speed_factor() != 1.0).then(|| self.driving_plant(&change))
    }

    fn check_plant(&self, change: &PlantChange) -> Result<(), Problem> {
        let key = || format!("scale.{}", PlantChange::SPEED);
        let factor = change.speed_factor();
        let own = self.path.speeds_mps.iter().copied().fold(self.reference.speed_mps, f64::max);
        // Nothing drives faster than it may, so a plant that is asked to lags behind whatever the set.
        let may_mps = self.vehicle.speed_limit_mps.min(self.supervisor.speed_limit_mps);
        let most_mps = if factor > 1.0 { may_mps.min(FASTEST_MPS) } else { FASTEST_MPS };
        if !(factor > 0.0 && factor * own <= most_mps) {
            let problem = format!(
                "is {factor}, but must be above 0, and leave the speed at most {most_mps} m/s"
            );
            return Err((key(), problem));
        }
        if change.add.contains_key(PlantChange::SPEED) {
            let problem = "can be multiplied alone: move it to scale".to_owned();
            return Err((format!("add.{}", PlantChange::SPEED), problem));
        }
        let mut vehicle = change.of(&self.vehicle)?;
        // What the file states of its own values says nothing of a plant's, which may lie beyond an interval.
        vehicle.uncertainty = Default::default();
        let plant = Self { vehicle, ..self.clone() };
        crate::validate::vehicle(&plant).map_err(|(key, problem)| {
            (key, format!("{problem}, with the plant \"{}\"", change.name))
        })
    }

    /// Number of plants on which each set is driven in a training.
    pub fn plants(&self) -> usize {
        if self.over.by == OverBy::Nominal { 1 } else { self.plant_changes().len() }
    }

    /// Number of drives of a set on each of them: without noise they would all be the same.
    pub fn drives_of_plant(&self) -> usize {
        if self.is_noisy_over_plants() { self.over.repeats as usize } else { 1 }
    }

    /// Number of drives that one step of a training takes.
    pub fn drives_of_step(&self) -> usize {
        self.plants() * self.drives_of_plant()
    }

    /// Whether each drive of a training has a noise of its own, so that a set is another one each time it is driven. Over
    /// plants it is not: there the noise is the same for all sets, so that it does not tell them apart.
    pub fn steps_differ(&self) -> bool {
        self.noise.enabled && self.over.by == OverBy::Nominal
    }

    /// Whether a second drive of a set may differ from the first one, by noise or because the vehicle does not repeat itself.
    pub fn drives_differ(&self) -> bool {
        self.steps_differ() || !self.run.repeats
    }

    /// How the drives are made by which sets are ranked, in words.
    pub fn ranked_how(&self) -> &'static str {
        if self.is_noisy_over_plants() {
            "over the plants, with noise that chose nothing"
        } else {
            "noise-free"
        }
    }

    /// Whether each set is driven over plants.
    pub fn is_over_plants(&self) -> bool {
        self.over.by != OverBy::Nominal
    }

    /// Whether each set is driven over plants, with noise.
    pub fn is_noisy_over_plants(&self) -> bool {
        self.noise.enabled && self.is_over_plants()
    }
}

pub(crate) fn validate(config: &RunConfig) -> Result<(), Problem> {
    let count = config.over.plants.len();
    if count > MAX_PLANTS {
        let problem = format!("names {count} plants, but at most {MAX_PLANTS} are driven");
        return Err(("over.plants".to_owned(), problem));
    }
    for (index, change) in config.over.plants.iter().enumerate() {
        if config.over.plants[..index].iter().any(|it| it.name == change.name) {
            let problem =
                format!("\"{}\" is the name of an earlier plant; give each its own", change.name);
            return Err((format!("over.plants[{index}].name"), problem));
        }
        let at = |(key, problem)| (format!("over.plants[{index}].{key}"), problem);
        config.check_plant(change).map_err(at)?;
    }
    crate::validate::within("over.fragile_below_s", config.over.fragile_below_s, 0.0, 10.0)?;
    if config.over.plants.is_empty() {
        let uncertainty = &config.vehicle.uncertainty;
        for change in uncertainty.plant_changes(&config.vehicle, config.run.seed).iter().flatten() {
            let key = |(key, problem): Problem| {
                (key.replace("vehicle.", "vehicle.uncertainty."), problem)
            };
            config.check_plant(change).map_err(key)?;
        }
    }
    crate::validate::within("over.choosing", f64::from(config.over.choosing), 1.0, 1000.0)?;
    crate::validate::within("over.repeats", f64::from(config.over.repeats), 1.0, 100.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Layers, Spread};

    fn config(sets: &[&str]) -> Result<RunConfig, crate::ConfigError> {
        let mut layers = Layers::maneuver("roundabout").unwrap();
        for set in sets {
            layers.set(set)?;
        }
        layers.resolve()
    }

    #[test]
    fn without_names_there_are_eight_plants_around_the_vehicle_and_a_faster_one_to_choose_over() {
        let plain = config(&[]).unwrap();
        assert_eq!((plain.plants(), plain.plant_changes().len()), (1, 8));
        let over = config(&["over.by=mean"]).unwrap();
        assert_eq!(over.plants(), 9);
        let plants: Vec<Vehicle> =
            over.plant_changes().iter().map(|it| over.with_plant(it).vehicle).collect();
        assert_eq!(plants[0], over.vehicle);
        assert_eq!(plants[2].steering_delay_s, over.vehicle.steering_delay_s + 0.06);
        assert_eq!(plants[3].steering_rate_radps, 0.8 * over.vehicle.steering_rate_radps);
        assert!(plants[1..8].iter().all(|it| *it != over.vehicle));
        // The last one is the vehicle itself, 1.5 times as fast: what drives it knows.
        let driving = over.driving_plant_number(9).unwrap();
        assert_eq!((&driving.vehicle, &plants[8]), (&over.vehicle, &over.vehicle));
        assert_eq!(driving.reference.speed_mps, 1.5 * over.reference.speed_mps);
        assert!((0..9).all(|plant| over.driving_plant_number(plant).is_none()));
        // Not beyond what the supervisor lets pass.
        let fast = config(&["over.by=mean", "reference.speed_mps=7.0"]).unwrap();
        assert_eq!(fast.plants(), 8);
    }

    #[test]
    fn a_dead_time_that_a_drive_has_told_is_believed_more() {
        let names = |half_s: f64, identified: bool| {
            let mut config = config(&[]).unwrap();
            let stated = &mut config.vehicle.uncertainty;
            stated.identified = identified;
            let delay_s = config.vehicle.steering_delay_s;
            let interval = Spread::Between([delay_s - half_s, delay_s + half_s]);
            stated.within.insert("steering_delay_s".to_owned(), interval);
            let changes = config.plant_changes();
            [changes[1].name.clone(), changes[2].name.clone()]
        };
        assert_eq!(names(0.005, true), ["dead times +10 ms", "dead times +20 ms"]);
        assert_eq!(names(0.03, true), ["dead times +30 ms", "dead times +60 ms"]);
        // What a user states is drawn from.
        assert_eq!(names(0.005, false)[0], "drawn 1");
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
        let still = refused("{name='x',scale={'reference.speed_mps'=0.0}}");
        assert!(still.contains("over.plants[0].scale.reference.speed_mps"), "{still}");
        let added = refused("{name='x',add={'reference.speed_mps'=1.0}}");
        assert!(added.contains("move it to scale"), "{added}");
        let word = refused("{name='x',scale={name=2.0}}");
        assert!(word.contains("no number"), "{word}");
        let repeats = config(&["over.repeats=0"]).unwrap_err().to_string();
        assert!(repeats.contains("over.repeats"), "{repeats}");
    }

    #[test]
    fn with_noise_a_step_is_several_drives_on_each_plant_and_the_same_again_each_time() {
        let plain = config(&["over.by=mean"]).unwrap();
        assert_eq!((plain.drives_of_step(), plain.steps_differ()), (9, false));
        let noisy = config(&["over.by=mean", "noise.enabled=true", "over.repeats=3"]).unwrap();
        assert_eq!((noisy.drives_of_step(), noisy.steps_differ()), (27, false));
        let nominal = config(&["noise.enabled=true", "over.repeats=3"]).unwrap();
        assert_eq!((nominal.drives_of_step(), nominal.steps_differ()), (1, true));
    }
}
