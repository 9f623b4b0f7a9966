//! Gains that were promoted to a vehicle, as written in its file below `gains.MANEUVER`.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use toml::{Table, Value};

use crate::law::{self, NamedParameters};
use crate::stated;
use crate::validate::{Problem, within};

/// The tuned parameters of a vehicle for one manoeuvre.
///
/// Files of earlier versions have the four gains of the paper's law without a separate table; they are read, too.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Written")]
pub struct TunedGains {
    /// Name of the law to which they belong.
    pub law: String,
    /// The parameters.
    pub parameters: NamedParameters,
    /// Where they come from; those written by hand have none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub provenance: Option<Provenance>,
    /// The gains that were here before, the newest last.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub history: Vec<PastGains>,
}

/// Parameters that were in a vehicle's file before.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Written")]
pub struct PastGains {
    /// Name of the law to which they belong.
    pub law: String,
    /// The parameters.
    pub parameters: NamedParameters,
    /// When they were replaced (RFC 3339).
    pub replaced_at: String,
    /// What replaced them.
    pub replaced_by: Replacement,
    /// Where they come from; those written by hand have none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub provenance: Option<Provenance>,
}

/// A set as written in a file: in this version's form, or in that of earlier versions.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Written {
    law: Option<String>,
    parameters: Option<NamedParameters>,
    kv: Option<f64>,
    kl: Option<f64>,
    ks: Option<f64>,
    ki: Option<f64>,
    replaced_at: Option<String>,
    replaced_by: Option<Replacement>,
    provenance: Option<Provenance>,
    history: Option<Vec<PastGains>>,
}

impl Written {
    /// The law's name and the parameters, from either form.
    fn set(&mut self) -> Result<(String, NamedParameters), String> {
        let gains = [("kv", self.kv), ("kl", self.kl), ("ks", self.ks), ("ki", self.ki)];
        if let Some(parameters) = self.parameters.take() {
            if let Some((name, _)) = gains.iter().find(|(_, gain)| gain.is_some()) {
                return Err(format!(
                    "has both {name} and the table `parameters`; keep one of the two"
                ));
            }
            let law = self.law.take().ok_or("missing field `law`: the law of these parameters")?;
            return Ok((law, parameters));
        }
        if self.law.is_some() {
            return Err("missing field `parameters`".to_owned());
        }
        let named = gains.into_iter().map(|(name, gain)| {
            let gain = gain.ok_or_else(|| format!("missing field `{name}`"))?;
            Ok((name.to_owned(), gain))
        });
        Ok(("paper".to_owned(), NamedParameters(named.collect::<Result<_, String>>()?)))
    }
}

impl TryFrom<Written> for TunedGains {
    type Error = String;

    fn try_from(mut written: Written) -> Result<Self, String> {
        if written.replaced_at.is_some() || written.replaced_by.is_some() {
            return Err("replaced_at and replaced_by belong in its history".to_owned());
        }
        let (law, parameters) = written.set()?;
        let history = written.history.unwrap_or_default();
        Ok(Self { law, parameters, provenance: written.provenance, history })
    }
}

impl TryFrom<Written> for PastGains {
    type Error = String;

    fn try_from(mut written: Written) -> Result<Self, String> {
        if written.history.is_some() {
            return Err("a set of the history cannot have a history".to_owned());
        }
        let (law, parameters) = written.set()?;
        Ok(Self {
            law,
            parameters,
            replaced_at: written.replaced_at.ok_or("missing field `replaced_at`")?,
            replaced_by: written.replaced_by.ok_or("missing field `replaced_by`")?,
            provenance: written.provenance,
        })
    }
}

/// What replaced gains.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Replacement {
    /// Gains of a training.
    Promotion,
    /// Older gains, by a rollback.
    Rollback,
}

impl Replacement {
    /// The word in the file.
    pub fn name(self) -> &'static str {
        match self {
            Self::Promotion => "promotion",
            Self::Rollback => "rollback",
        }
    }
}

/// The training from which gains come.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Provenance {
    /// Digest of the training.
    pub digest: String,
    /// When they were promoted (RFC 3339).
    pub promoted_at: String,
    /// Name of the run's folder.
    pub run: String,
    /// The manoeuvre that was trained.
    pub maneuver: String,
    /// Hash of the path, if it is one of the user's own; earlier versions did not note it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub path_hash: Option<String>,
    /// Name of the vehicle in the training.
    pub vehicle: String,
    /// Seed of the training.
    pub seed: u64,
    /// The tuner; versions from before objectives could be chosen do not name it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tuner: Option<String>,
    /// The objective by which drives were judged; the distance in earlier versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub objective: Option<String>,
    /// The learning rates of the Q-learning tuners.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub alphas: Vec<f64>,
    /// Whether the dead time of the steering was compensated; earlier versions did not note it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub compensate_dead_time: Option<bool>,
    /// Whether there was noise on the odometry.
    pub noise: bool,
    /// Number of drives of a vehicle that is not our simulator over which the figures are means; absent if they are those
    /// of our simulator.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub drives: Option<u32>,
    /// Distance of the mean errors, noise-free.
    pub distance: f64,
    /// Mean squared error, noise-free.
    pub mse_m2: f64,
    /// Mean distance of the true pose from the path, noise-free.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub path_mean_m: Option<f64>,
    /// Its largest value.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub path_max_m: Option<f64>,
    /// Number of sets of the grid; `None` if the grid was not driven.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub grid_size: Option<u64>,
    /// Rank in the grid by the objective of the training, noise-free.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rank_value: Option<u64>,
    /// Rank in the grid by the distance, noise-free.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rank_distance: Option<u64>,
    /// Rank in the grid by the mean of the objective under noise.
    #[serde(default, skip_serializing_if = "Option::is_none", alias = "rank_mean_distance")]
    pub rank_mean: Option<u64>,
    /// Lower end of the bootstrap interval of the objective's mean: under noise, or over the drives of a vehicle that does
    /// not repeat itself.
    #[serde(default, skip_serializing_if = "Option::is_none", alias = "mean_distance_low")]
    pub mean_low: Option<f64>,
    /// Its upper end.
    #[serde(default, skip_serializing_if = "Option::is_none", alias = "mean_distance_high")]
    pub mean_high: Option<f64>,
    /// Version of pathtune that promoted them.
    pub pathtune: String,
}

/// The longest text of a provenance.
const MAX_TEXT: usize = 300;

/// Checks the gains of a vehicle of this wheelbase.
pub(crate) fn validate(
    gains: &BTreeMap<String, TunedGains>,
    wheelbase_m: f64,
) -> Result<(), Problem> {
    for (maneuver, set) in gains {
        let key = format!("vehicle.gains.{maneuver}");
        if !(1..=60).contains(&maneuver.chars().count()) || maneuver.chars().any(char::is_control) {
            let problem = "must be below a name of 1 to 60 characters on one line".to_owned();
            return Err((key, problem));
        }
        check_set(&key, wheelbase_m, &set.law, &set.parameters, set.provenance.as_ref())?;
        for (index, past) in set.history.iter().enumerate() {
            let key = format!("{key}.history[{index}]");
            check_set(&key, wheelbase_m, &past.law, &past.parameters, past.provenance.as_ref())?;
            check_text(&key, "replaced_at", &past.replaced_at)?;
        }
    }
    Ok(())
}

fn check_set(
    key: &str,
    wheelbase_m: f64,
    law: &str,
    parameters: &NamedParameters,
    provenance: Option<&Provenance>,
) -> Result<(), Problem> {
    let Some(of_law) = law::preset(law) else {
        let known: Vec<&str> = crate::names_in("laws").collect();
        let hint = crate::presets::hint(law, &known);
        return Err((format!("{key}.law"), format!("is {law:?}, which is unknown; {hint}")));
    };
    // The bounds of lengths go with the wheelbase, which may have been measured anew since; what is driven is checked again.
    let mut of_law = crate::textbook::fitted(&of_law, wheelbase_m);
    for length in of_law.parameters.iter_mut().filter(|it| it.for_wheelbase_m.is_some()) {
        length.min *= 0.5;
        length.max *= 2.0;
    }
    of_law
        .parameters_of(parameters)
        .map_err(|(name, problem)| (format!("{key}.parameters.{name}"), problem))?;
    let Some(it) = provenance else { return Ok(()) };
    let key = format!("{key}.provenance");
    for (name, text) in [
        ("digest", &it.digest),
        ("promoted_at", &it.promoted_at),
        ("run", &it.run),
        ("maneuver", &it.maneuver),
        ("vehicle", &it.vehicle),
        ("pathtune", &it.pathtune),
    ] {
        check_text(&key, name, text)?;
    }
    check_text(&key, "path_hash", it.path_hash.as_deref().unwrap_or_default())?;
    for (name, number) in [
        ("distance", Some(it.distance)),
        ("mse_m2", Some(it.mse_m2)),
        ("path_mean_m", it.path_mean_m),
        ("path_max_m", it.path_max_m),
        ("mean_high", it.mean_high),
    ] {
        within(&format!("{key}.{name}"), number.unwrap_or_default(), 0.0, 1e12)?;
    }
    // The interval of a mean over few drives of which one went wrong reaches below 0.
    within(&format!("{key}.mean_low"), it.mean_low.unwrap_or_default(), -1e12, 1e12)?;
    Ok(())
}

fn check_text(key: &str, name: &str, text: &str) -> Result<(), Problem> {
    if text.len() <= MAX_TEXT && !text.chars().any(char::is_control) {
        return Ok(());
    }
    let problem = format!("must be a text of at most {MAX_TEXT} bytes on one line");
    Err((format!("{key}.{name}"), problem))
}

/// Whether `key` is that of a table of a vehicle that no preset has, in a document whose other keys are `known`: promoted
/// gains, or what the file states of noise and uncertainty. The keys below are checked when they are parsed.
pub(crate) fn is_map(known: &Table, key: &str) -> bool {
    let (name, holder) = match key.strip_prefix("vehicle.") {
        Some(name) => (name, "vehicle"),
        // A vehicle's own file.
        None => (key, "wheelbase_m"),
    };
    (name == "gains" || stated::TABLES.contains(&name)) && known.contains_key(holder)
}

/// Puts such a table on top of the present one: the gains of a manoeuvre are replaced as a whole, as is every other key.
pub(crate) fn lay_on(values: &mut Table, key: &str, above: Value) {
    let (values, name) = match key.split_once('.') {
        Some((head, name)) => (values.get_mut(head).and_then(Value::as_table_mut), name),
        None => (Some(values), key),
    };
    let Some(values) = values else { return };
    match (values.get_mut(name), above) {
        (Some(Value::Table(below)), Value::Table(above)) => below.extend(above),
        (_, above) => {
            values.insert(name.to_owned(), above);
        }
    }
}

/// Collects the places of `item` and of everything below it.
pub(crate) fn note_places(
    item: &toml_edit::Item,
    key: &str,
    place: &dyn Fn(Option<std::ops::Range<usize>>) -> String,
    places: &mut BTreeMap<String, String>,
) {
    if let Some(tables) = item.as_array_of_tables() {
        for (index, table) in tables.iter().enumerate() {
            note_table(table, &format!("{key}[{index}]"), place, places);
        }
    } else if let Some(array) = item.as_array() {
        for (index, value) in array.iter().enumerate() {
            let key = format!("{key}[{index}]");
            places.insert(key.clone(), place(value.span()));
            if let Some(table) = value.as_inline_table() {
                note_table(table, &key, place, places);
            }
        }
    } else if let Some(table) = item.as_table_like() {
        note_table(table, key, place, places);
    }
}

fn note_table(
    table: &dyn toml_edit::TableLike,
    above: &str,
    place: &dyn Fn(Option<std::ops::Range<usize>>) -> String,
    places: &mut BTreeMap<String, String>,
) {
    for (name, item) in table.iter() {
        let key = format!("{above}.{name}");
        let span = table.key(name).and_then(toml_edit::Key::span).or_else(|| item.span());
        places.insert(key.clone(), place(span));
        note_places(item, &key, place, places);
    }
}

#[cfg(test)]
mod tests {
    use crate::{Layers, RunConfig};

    const FILE: &str = "name = 'mine'\n\n[gains.lane_change]\nkv = 3.0\nkl = 21\nks = 21.0\nki = 0.7\n\n\
        [[gains.lane_change.history]]\nkv = 1.0\nkl = 2.0\nks = 3.0\nki = 0.5\n\
        replaced_at = '2025-01-01T00:00:00Z'\nreplaced_by = 'promotion'\n";

    fn resolve(text: &str) -> Result<RunConfig, String> {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("mine.toml");
        std::fs::write(&file, text).unwrap();
        let mut layers = Layers::maneuver("lane_change").unwrap();
        layers
            .set_vehicle("--vehicle", file.to_str().unwrap())
            .and_then(|()| layers.resolve())
            .map_err(|error| error.to_string())
    }

    #[test]
    fn they_are_read_and_survive_the_resolved_configuration() {
        let config = resolve(FILE).unwrap();
        let set = &config.vehicle.gains["lane_change"];
        assert_eq!(set.law, "paper");
        let names = ["kv", "kl", "ks", "ki"];
        assert_eq!(names.map(|name| set.parameters.get(name).unwrap()), [3.0, 21.0, 21.0, 0.7]);
        assert_eq!(set.history[0].parameters.get("ki"), Some(0.5));
        let text = toml::to_string(&config).unwrap();
        assert_eq!(RunConfig::from_resolved(&text).unwrap(), config);
        let mut again = Layers::maneuver("lane_change").unwrap();
        let text = text.replace(&config.vehicle_preset, "tesla_model_3");
        again.add_document("resolved.toml", &text).unwrap();
        assert_eq!(again.resolve().unwrap().vehicle, config.vehicle);
    }

    #[test]
    fn an_interval_of_their_mean_that_reaches_below_zero_is_none_of_the_user_s_mistakes() {
        let origin = "[gains.lane_change.provenance]\ndigest='a'\npromoted_at=''\nrun=''\nmaneuver='lane_change'\n\
            vehicle=''\nseed=1\nalphas=[]\nnoise=false\ndistance=0.1\nmse_m2=0.1\npathtune='0'\n";
        let with = |low: f64| format!("{FILE}{origin}mean_low={low}\nmean_high=0.4\n");
        let found = resolve(&with(-0.02)).unwrap().vehicle.gains["lane_change"].clone();
        assert_eq!(found.provenance.unwrap().mean_low, Some(-0.02));
        assert!(resolve(&with(-1e13)).unwrap_err().contains("mean_low"));
    }

    #[test]
    fn a_configuration_without_them_says_nothing_of_them() {
        let config = Layers::maneuver("lane_change").unwrap().resolve().unwrap();
        assert!(!toml::to_string(&config).unwrap().contains("[vehicle.gains"));
    }

    #[test]
    fn mistakes_name_file_line_and_key() {
        let check = |text: &str, parts: &[&str]| {
            let message = resolve(text).unwrap_err();
            for part in parts {
                assert!(message.contains(part), "{message:?} lacks {part:?}");
            }
            assert!(!message.contains('\n'), "{message:?}");
        };
        let with = |old: &str, new: &str| FILE.replacen(old, new, 1);
        check(&with("kv", "kx"), &["mine.toml:4", "gains.lane_change", "unknown field `kx`"]);
        check(&with("21.0", "-2"), &["mine.toml:6", "gains.lane_change.parameters.ks", "is -2"]);
        check(&with("0.7", "'x'"), &["mine.toml", "gains.lane_change", "string"]);
        check(&with("kv = 3.0\n", ""), &["mine.toml:3", "gains.lane_change", "missing field `kv`"]);
        check(
            &with("ki = 0.5", "ki = 1.5"),
            &["mine.toml:13", "history[0].parameters.ki", "[0, 1]"],
        );
        check(&with("'promotion'", "'x'"), &["mine.toml:15", "replaced_by", "rollback"]);
        check(
            "[gains.a]\nlaw = 'x'\nparameters = {}",
            &["mine.toml:2", "vehicle.gains.a.law", "'x'".trim_matches('\'')],
        );
        let own = "[gains.a]\nlaw = 'paper'\nparameters = { kv = 1, kl = 1, ks = -2, ki = 0 }";
        check(own, &["mine.toml:3", "gains.a.parameters.ks", "is -2"]);
        check("gains = 3", &["mine.toml:1", "vehicle.gains"]);
        check("gains.'' = {kv=1,kl=1,ks=1,ki=0.5}", &["mine.toml:1", "vehicle.gains"]);
        check("gain = 3", &["mine.toml:1", "unknown key"]);
    }

    #[test]
    fn only_a_vehicle_has_them() {
        let mut layers = Layers::maneuver("lane_change").unwrap();
        let error = layers.add_document("my.toml", "[gains.x]\nkv = 1.0").unwrap_err();
        assert!(error.to_string().contains("my.toml:1: gains: unknown key"), "{error}");
    }
}
