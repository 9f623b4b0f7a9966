//! What a vehicle's file states beyond its values: the noise of its odometry, and how well its values are known.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use toml::{Table, Value};

use crate::Vehicle;
use crate::plants::PlantChange;
use crate::validate::{Problem, within};

/// The noise of a vehicle's odometry, `[noise]` in its file. A drive with noise takes it in place of the defaults of
/// `[noise]` in readings.toml.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StatedNoise {
    /// Standard deviation of the Gaussian noise on x and on y, m.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub position_sd_m: Option<f64>,
    /// Largest noise on the heading: half the base of its triangular distribution, rad; √6 times its standard deviation.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub heading_half_width_rad: Option<f64>,
    /// Standard deviation of the noise on the speed, m/s. For the reader: our simulator measures the speed without noise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub speed_sd_mps: Option<f64>,
    /// Standard deviation of the noise on the yaw rate, rad/s. For the reader, too.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub yaw_rate_sd_radps: Option<f64>,
}

impl StatedNoise {
    /// Whether nothing is stated.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }
}

/// How well the values of a vehicle are known, `[uncertainty]` in its file: beside its own keys, one for each key of the
/// vehicle whose value is not certain.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Table")]
pub struct Uncertainty {
    /// Whether the intervals were found by `pathtune identify`. Then they say what noise can do, not what the model lacks,
    /// and a training over plants takes the eight default plants around the estimate rather than these intervals.
    #[serde(skip_serializing_if = "is_false")]
    pub identified: bool,
    /// Number of plants that the intervals become; 16 if absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub plants: Option<u32>,
    /// For each key of the vehicle the half-width of its 95 % interval, or the interval [low, high].
    #[serde(flatten)]
    pub within: BTreeMap<String, Spread>,
}

impl TryFrom<Table> for Uncertainty {
    type Error = String;

    fn try_from(table: Table) -> Result<Self, String> {
        let mut stated = Self::default();
        for (key, value) in table {
            let wrong = |wants: &str| format!("{key}: is {value}, and must be {wants}");
            match &*key {
                "identified" => {
                    stated.identified = value.as_bool().ok_or_else(|| wrong("true or false"))?;
                }
                "plants" => {
                    let count = value.as_integer().and_then(|count| u32::try_from(count).ok());
                    stated.plants = Some(count.ok_or_else(|| wrong("a number of plants"))?);
                }
                _ => {
                    let wants = "a half-width, as in 0.01, or an interval, as in [0.32, 0.34]";
                    let spread = value.clone().try_into().map_err(|_| wrong(wants))?;
                    stated.within.insert(key, spread);
                }
            }
        }
        Ok(stated)
    }
}

fn is_false(it: &bool) -> bool {
    !it
}

/// Where a value lies, with 95 % probability.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Spread {
    /// At most this far from the file's value, to both sides.
    HalfWidth(f64),
    /// Between these two.
    Between([f64; 2]),
}

impl Spread {
    /// Half the width.
    fn half(self) -> f64 {
        match self {
            Self::HalfWidth(half) => half,
            Self::Between([low, high]) => 0.5 * (high - low),
        }
    }

    /// The interval around a value.
    fn around(self, value: f64) -> [f64; 2] {
        match self {
            Self::HalfWidth(half) => [value - half, value + half],
            Self::Between(interval) => interval,
        }
    }
}

/// A dead time with at most this on either side of it is told well.
const MOST_LATE_S: f64 = 0.02;

/// The number of plants that intervals become if the file does not say.
const DEFAULT_PLANTS: u32 = 16;

impl Uncertainty {
    /// Whether nothing is stated.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// Whether `pathtune identify` has told the steering's dead time well enough that the default plants need not allow for much.
    pub(crate) fn tells_dead_time(&self) -> bool {
        let told = self.within.get("steering_delay_s").filter(|_| self.identified);
        told.is_some_and(|it| it.half() <= MOST_LATE_S)
    }

    /// The plants that the intervals of a user become: the vehicle itself, and then one for each point of an evenly spread
    /// sequence in the box of the intervals (Roberts' R_d, shifted by the seed), so that a few plants cover all keys.
    /// `None` if there are no intervals, or `pathtune identify` found them.
    pub(crate) fn plant_changes(&self, vehicle: &Vehicle, seed: u64) -> Option<Vec<PlantChange>> {
        if self.identified || self.within.is_empty() {
            return None;
        }
        let table = numbers(vehicle);
        let steps = steps(self.within.len());
        // Any odd multiplier of this size spreads the seeds; 0 leaves the sequence as it is.
        let shift = (seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 11) as f64 / (1u64 << 53) as f64;
        let mut plants = vec![PlantChange { name: AS_STATED.to_owned(), ..Default::default() }];
        for count in 1..self.plants.unwrap_or(DEFAULT_PLANTS) {
            let mut add = BTreeMap::new();
            for ((key, spread), step) in self.within.iter().zip(&steps) {
                let value = table[key];
                let [low, high] = spread.around(value);
                let place = (0.5 + shift + f64::from(count) * step).fract();
                let drawn = low + place * (high - low);
                // What cannot be negative in the file is not negative in a plant.
                let drawn =
                    if value >= 0.0 && !SIGNED.contains(&&**key) { drawn.max(0.0) } else { drawn };
                add.insert(key.clone(), drawn - value);
            }
            plants.push(PlantChange { name: format!("drawn {count}"), add, ..Default::default() });
        }
        Some(plants)
    }
}

/// The name of the plant that is the vehicle itself.
const AS_STATED: &str = "as in the vehicle's file";

/// Keys of a vehicle that may have either sign.
const SIGNED: [&str; 3] = ["steering_offset_rad", "tracked_point_m", "speed_integral_min"];

/// The steps of the R_d sequence: 1/g, 1/g², … with the positive root g of g^(d+1) = g + 1.
fn steps(dimensions: usize) -> Vec<f64> {
    let exponent = 1.0 / (dimensions as f64 + 1.0);
    // A contraction: 60 rounds end at the root's last bits.
    let root = (0..60).fold(1.5, |root: f64, _| libm::pow(1.0 + root, exponent));
    (1..=dimensions as i32).map(|power| libm::pow(root, -f64::from(power))).collect()
}

/// The keys of a vehicle that are numbers, with their values.
fn numbers(vehicle: &Vehicle) -> BTreeMap<String, f64> {
    let Ok(Value::Table(table)) = Value::try_from(vehicle) else { unreachable!("a table") };
    let number = |(key, value): (String, Value)| Some((key, value.as_float()?));
    table.into_iter().filter_map(number).collect()
}

pub(crate) fn validate(vehicle: &Vehicle) -> Result<(), Problem> {
    let noise = &vehicle.noise;
    for (key, value, most) in [
        ("position_sd_m", noise.position_sd_m, 10.0),
        ("heading_half_width_rad", noise.heading_half_width_rad, 1.0),
        ("speed_sd_mps", noise.speed_sd_mps, 10.0),
        ("yaw_rate_sd_radps", noise.yaw_rate_sd_radps, 10.0),
    ] {
        within(&format!("vehicle.noise.{key}"), value.unwrap_or_default(), 0.0, most)?;
    }
    let stated = &vehicle.uncertainty;
    if let Some(plants) = stated.plants {
        within("vehicle.uncertainty.plants", plants.into(), 2.0, 64.0)?;
    }
    if stated.within.is_empty() {
        return Ok(());
    }
    let known = numbers(vehicle);
    for (name, spread) in &stated.within {
        let key = format!("vehicle.uncertainty.{name}");
        let Some(&value) = known.get(name) else {
            let hint = match crate::nearest(name, known.keys().map(String::as_str)) {
                Some(near) => format!("did you mean {near}?"),
                None => "name one of the vehicle's keys, such as wheelbase_m".to_owned(),
            };
            return Err((key, format!("is no number of a vehicle; {hint}")));
        };
        if let Spread::HalfWidth(half) = spread
            && !(*half >= 0.0 && half.is_finite())
        {
            let problem = format!("is {half}, and must be a half-width of at least 0");
            return Err((key, problem));
        }
        let [low, high] = spread.around(value);
        if !(low <= value && value <= high && (high - low).is_finite()) {
            let problem = format!(
                "is [{low}, {high}], and must be an interval around the file's value, {value}; or give its half-width as \
                 one number"
            );
            return Err((key, problem));
        }
    }
    Ok(())
}

/// What not every preset of a vehicle has, so that it is checked when it is parsed: tables of its file, and the list of
/// borrowed keys of a resolved configuration.
pub(crate) const TABLES: [&str; 3] = ["noise", "uncertainty", "borrowed"];

#[cfg(test)]
mod tests {
    use crate::{ConfigError, Layers, RunConfig};

    fn with_vehicle(text: &str, sets: &[&str]) -> Result<RunConfig, ConfigError> {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("car.toml");
        std::fs::write(&file, format!("base = 'f1tenth'\nname = 'mine'\n{text}")).unwrap();
        let mut layers = Layers::maneuver("circuit").unwrap();
        layers.set_vehicle("--vehicle", file.to_str().unwrap())?;
        for set in sets {
            layers.set(set)?;
        }
        layers.resolve()
    }

    const STATED: &str = "[noise]\nposition_sd_m = 0.02\nspeed_sd_mps = 0.05\n\
                          [uncertainty]\nwheelbase_m = 0.01\nsteering_delay_s = [0, 0.08]\n";

    #[test]
    fn noise_of_the_file_is_that_of_the_drives_unless_the_user_sets_another() {
        let config = with_vehicle(STATED, &[]).unwrap();
        assert_eq!((config.noise.enabled, config.noise.position_sd_m), (false, 0.02));
        // Not stated: that of the preset on which the file is based, and without one the default.
        assert_eq!(config.noise.heading_half_width_rad, 0.04);
        let plain = Layers::maneuver("circuit").unwrap().resolve().unwrap();
        assert_eq!(plain.noise.heading_half_width_rad, 0.088);
        let own = with_vehicle(STATED, &["noise.position_sd_m=0.07"]).unwrap();
        assert_eq!(own.noise.position_sd_m, 0.07);
        let text = toml::to_string(&config).unwrap();
        assert_eq!(RunConfig::from_resolved(&text).unwrap(), config);
        let mut again = Layers::maneuver("circuit").unwrap();
        again
            .add_document("resolved.toml", &text.replace(&config.vehicle_preset, "f1tenth"))
            .unwrap();
        assert_eq!(again.resolve().unwrap().vehicle, config.vehicle);
    }

    #[test]
    fn intervals_become_plants_that_fill_them_and_identified_ones_do_not() {
        let config = with_vehicle(STATED, &["over.by=mean"]).unwrap();
        assert_eq!(config.plants(), 16);
        let plants: Vec<_> =
            config.plant_changes().iter().map(|it| config.with_plant(it).vehicle).collect();
        assert_eq!(plants[0], config.vehicle);
        for (of, low, high) in [
            (plants.iter().map(|it| it.wheelbase_m).collect::<Vec<_>>(), 0.3202, 0.3402),
            (plants.iter().map(|it| it.steering_delay_s).collect(), 0.0, 0.08),
        ] {
            let (least, most) =
                of.iter().fold((1.0f64, 0.0f64), |(a, b), x| (a.min(*x), b.max(*x)));
            assert!(least >= low && least < low + 0.15 * (high - low), "{of:?}");
            assert!(most <= high && most > high - 0.15 * (high - low), "{of:?}");
        }
        // Every run's seed has its own; each run has the same ones again.
        let other = with_vehicle(STATED, &["over.by=mean", "run.seed=2"]).unwrap();
        assert_ne!(other.plant_changes(), config.plant_changes());
        let found =
            with_vehicle(&format!("{STATED}identified = true\n"), &["over.by=mean"]).unwrap();
        // The eight of the recipe, and one whose reference is faster.
        assert_eq!(found.plants(), 9);
        // An identification is surer than the recipe: its plants lie beyond the intervals.
        let sure = "[uncertainty]\nidentified = true\nsteering_delay_s = [0.0195, 0.0205]\nwheelbase_m = 0.0001\n";
        assert_eq!(with_vehicle(sure, &["over.by=mean"]).unwrap().plants(), 9);
        assert_eq!(with_vehicle(sure, &[]).unwrap().plant_changes().len(), 8);
        let few = with_vehicle(&format!("{STATED}plants = 4\n"), &["over.by=worst"]).unwrap();
        assert_eq!(few.plants(), 4);
        // A half-width beyond 0 of what cannot be negative ends at 0.
        let wide =
            with_vehicle("[uncertainty]\nsteering_delay_s = 0.5\n", &["over.by=mean"]).unwrap();
        assert!(
            wide.plant_changes()
                .iter()
                .all(|it| wide.with_plant(it).vehicle.steering_delay_s >= 0.0)
        );
    }

    #[test]
    fn mistakes_name_file_line_and_key() {
        let check = |text: &str, parts: &[&str]| {
            let message = with_vehicle(text, &[]).unwrap_err().to_string();
            for part in parts {
                assert!(message.contains(part), "{message:?} lacks {part:?}");
            }
            assert!(!message.contains('\n'), "{message:?}");
        };
        check("[noise]\nposition_sd_m = -1", &["car.toml:4", "noise.position_sd_m", "-1"]);
        check("[noise]\nposition_sd = 1", &["car.toml:4", "noise", "position_sd"]);
        check("[uncertainty]\nwheelbase = 0.01", &["car.toml:4", "mean wheelbase_m?"]);
        check("[uncertainty]\nwheelbase_m = 'x'", &["car.toml:4", "wheelbase_m", "half-width"]);
        check("[uncertainty]\nwheelbase_m = -0.1", &["car.toml:4", "wheelbase_m", "-0.1"]);
        check("[uncertainty]\nwheelbase_m = [1, 2]", &["car.toml:4", "around", "0.3302"]);
        check("[uncertainty]\nwheelbase_m = 0.01\nplants = 100", &["car.toml:5", "[2, 64]"]);
        check("[uncertainty]\nwheelbase_m = inf", &["car.toml:4", "wheelbase_m", "inf"]);
    }
}
