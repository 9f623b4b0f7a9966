//! What the configuration says about a control law: its parameters, in order, and its settings. The code of a law is in
//! `services/controller/src/laws`; everything else is in a file of `config/laws`.

use std::collections::BTreeMap;
use std::fmt;

use serde::de::{MapAccess, Visitor};
use serde::ser::SerializeMap;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::Axis;
use crate::validate::{Problem, above, within};

/// The largest number of parameters of a law.
pub const MAX_PARAMETERS: usize = 16;

/// The parameters of a law: one value each, in the order of [`LawConfig::parameters`]; unused ones are 0.
///
/// Only the law knows their names; [`LawConfig::named`] adds them.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Parameters(pub [f64; MAX_PARAMETERS]);

impl Parameters {
    /// The parameters with these first values.
    ///
    /// # Panics
    /// If there are more than [`MAX_PARAMETERS`].
    pub fn of(values: &[f64]) -> Self {
        let mut all = [0.0; MAX_PARAMETERS];
        all[..values.len()].copy_from_slice(values);
        Self(all)
    }

    /// The bits of all values: what makes two sets the same.
    pub fn to_bits(&self) -> [u64; MAX_PARAMETERS] {
        self.0.map(f64::to_bits)
    }
}

/// Parameters with their names, as written in TOML and JSON: `{ kv = 3.0, kl = 21.0 }`.
///
/// Those that [`LawConfig::named`] makes are in the law's order. In a file, the order has no meaning.
#[derive(Debug, Clone, Default)]
pub struct NamedParameters(pub Vec<(String, f64)>);

impl PartialEq for NamedParameters {
    fn eq(&self, other: &Self) -> bool {
        let holds = |(name, value): &(String, f64)| other.get(name) == Some(*value);
        self.0.len() == other.0.len() && self.0.iter().all(holds)
    }
}

impl NamedParameters {
    /// The values, in order.
    pub fn values(&self) -> impl Iterator<Item = f64> {
        self.0.iter().map(|(_, value)| *value)
    }

    /// The value with this name.
    pub fn get(&self, key: &str) -> Option<f64> {
        self.0.iter().find(|(name, _)| name == key).map(|(_, value)| *value)
    }
}

/// As in `kv=3, kl=21`: for log lines and sentences.
impl fmt::Display for NamedParameters {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        for (place, (name, value)) in self.0.iter().enumerate() {
            let comma = if place > 0 { ", " } else { "" };
            write!(f, "{comma}{name}={value}")?;
        }
        Ok(())
    }
}

impl Serialize for NamedParameters {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(self.0.len()))?;
        for (name, value) in &self.0 {
            map.serialize_entry(name, value)?;
        }
        map.end()
    }
}

impl<'de> Deserialize<'de> for NamedParameters {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Entries;

        impl<'de> Visitor<'de> for Entries {
            type Value = NamedParameters;

            fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
                f.write_str("a table of parameters, as in { kv = 3.0, kl = 21.0 }")
            }

            fn visit_map<M: MapAccess<'de>>(self, mut map: M) -> Result<NamedParameters, M::Error> {
                let mut entries = Vec::new();
                while let Some(entry) = map.next_entry()? {
                    entries.push(entry);
                }
                Ok(NamedParameters(entries))
            }
        }

        deserializer.deserialize_map(Entries)
    }
}

/// A control law, as the configuration describes it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LawConfig {
    /// Name of its code: a row in `services/controller/src/laws/mod.rs`.
    pub name: String,
    /// What it is, in one line.
    pub summary: String,
    /// Whether it is to follow the path. If not, distances from the path say nothing of it, and it cannot be tuned.
    #[serde(default = "yes", skip_serializing_if = "is_true")]
    pub follows_path: bool,
    /// What is tuned, in the law's order.
    pub parameters: Vec<ParameterConfig>,
    /// The law's own settings, which are not tuned.
    #[serde(default)]
    pub settings: Settings,
    /// The words that a setting may be, by its key; for settings that are words.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub choices: BTreeMap<String, Vec<String>>,
}

fn yes() -> bool {
    true
}

fn is_true(it: &bool) -> bool {
    *it
}

/// One parameter of a law.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ParameterConfig {
    /// Its name in TOML, JSON and on the command line.
    pub key: String,
    /// Its name in tables and equations.
    pub symbol: String,
    /// Its unit; empty if it has none.
    pub unit: String,
    /// The least value that can be driven.
    pub min: f64,
    /// The largest value that can be driven.
    pub max: f64,
    /// How a tuner moves along it.
    pub scale: Scale,
    /// The value for a drive that does not name another.
    pub default: f64,
    /// Its values in the grid, unless the manoeuvre or the user gives others.
    pub grid: Axis,
    /// Of a length alone: the wheelbase of the car that these numbers are made for, m. They are scaled when the vehicle
    /// is chosen, and this names its wheelbase afterwards.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub for_wheelbase_m: Option<f64>,
}

/// How a tuner moves along a parameter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Scale {
    /// Equal differences count alike.
    Linear,
    /// Equal ratios count alike.
    Log,
}

/// Settings of a law, a tuner or an objective: the keys of its file, whose values a user may change.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Settings(pub BTreeMap<String, toml::Value>);

impl Settings {
    /// A number.
    ///
    /// # Panics
    /// If the file of the law, tuner or objective has no such number: its code and its file must match.
    pub fn number(&self, key: &str) -> f64 {
        match self.0.get(key) {
            Some(toml::Value::Float(number)) => *number,
            Some(toml::Value::Integer(number)) => *number as f64,
            _ => panic!("the settings have no number {key}"),
        }
    }

    /// A text.
    ///
    /// # Panics
    /// If the file has no such text, see [`Settings::number`].
    pub fn text(&self, key: &str) -> &str {
        let text = self.0.get(key).and_then(toml::Value::as_str);
        text.unwrap_or_else(|| panic!("the settings have no text {key}"))
    }
}

impl LawConfig {
    /// Number of parameters.
    pub fn count(&self) -> usize {
        self.parameters.len()
    }

    /// Names of the parameters, in order.
    pub fn keys(&self) -> impl Iterator<Item = &str> {
        self.parameters.iter().map(|it| it.key.as_str())
    }

    /// Symbols of the parameters, in order: the header of a table.
    pub fn symbols(&self) -> impl Iterator<Item = &str> {
        self.parameters.iter().map(|it| it.symbol.as_str())
    }

    /// The symbols as they are typed on the command line: `Kv,Kl,Ks,Ki`.
    pub fn symbol_list(&self) -> String {
        self.symbols().collect::<Vec<_>>().join(",")
    }

    /// The values that belong to this law's parameters, in order.
    pub fn values<'a>(&self, parameters: &'a Parameters) -> &'a [f64] {
        &parameters.0[..self.count()]
    }

    /// The parameters with their names.
    pub fn named(&self, parameters: &Parameters) -> NamedParameters {
        let names = self.keys().map(str::to_owned);
        NamedParameters(names.zip(parameters.0).collect())
    }

    /// The parameters that a table names, in the law's order.
    ///
    /// # Errors
    /// If one is missing, unknown or out of its bounds; the error is its name, and what is wrong.
    pub fn parameters_of(&self, named: &NamedParameters) -> Result<Parameters, Problem> {
        let mut all = Parameters::default();
        for (place, key) in self.keys().enumerate() {
            let missing = || (key.to_owned(), format!("missing; {} has it", self.describe()));
            all.0[place] = named.get(key).ok_or_else(missing)?;
        }
        if let Some((key, _)) = named.0.iter().find(|(key, _)| !self.keys().any(|it| it == key)) {
            return Err((
                key.clone(),
                format!("unknown; {} has no such parameter", self.describe()),
            ));
        }
        self.check(&all)?;
        Ok(all)
    }

    /// Whether these parameters can be driven.
    ///
    /// # Errors
    /// If one is not finite or out of its bounds; the error is its name, and what is wrong.
    pub fn check(&self, parameters: &Parameters) -> Result<(), Problem> {
        for (parameter, value) in self.parameters.iter().zip(parameters.0) {
            within(&parameter.key, value, parameter.min, parameter.max)?;
        }
        Ok(())
    }

    /// The default parameters: a textbook's, or the paper's.
    pub fn defaults(&self) -> Parameters {
        Parameters::of(&self.parameters.iter().map(|it| it.default).collect::<Vec<_>>())
    }

    /// Parses sets from numbers in the law's order: `Kv,Kl,Ks,Ki`, with a slash before each further set.
    ///
    /// # Errors
    /// If a set does not have as many numbers as the law has parameters, or one of them cannot be driven; the error
    /// says which.
    pub fn parse_sets(&self, text: &str) -> Result<Vec<Parameters>, String> {
        text.split('/').map(|set| self.parse_set(set)).collect()
    }

    fn parse_set(&self, set: &str) -> Result<Parameters, String> {
        let numbers: Vec<&str> = set.split(',').map(str::trim).collect();
        if numbers.len() != self.count() {
            let (held, list) = (numbers.len(), self.symbol_list());
            return Err(format!("{set:?} holds {held} numbers, but must hold {list}"));
        }
        let mut parameters = Parameters::default();
        for (value, number) in parameters.0.iter_mut().zip(numbers) {
            *value = number.parse().map_err(|_| format!("{number:?} is not a number"))?;
        }
        self.check(&parameters).map_err(|(name, problem)| format!("{name} {problem}"))?;
        Ok(parameters)
    }

    /// For errors: `the law paper (kv, kl, ks, ki)`.
    fn describe(&self) -> String {
        format!("the law {} ({})", self.name, self.keys().collect::<Vec<_>>().join(", "))
    }
}

/// Finds the first mistake in a law's data, as (dotted key, problem).
pub(crate) fn validate(law: &LawConfig) -> Result<(), Problem> {
    let count = law.count();
    if !(1..=MAX_PARAMETERS).contains(&count) {
        let problem = format!("holds {count} parameters, but must hold 1 to {MAX_PARAMETERS}");
        return Err(("law.parameters".to_owned(), problem));
    }
    // Code reads parameters by their place: a file may change their data, but never which parameters there are.
    if let Some(preset) = preset(&law.name)
        && !law.keys().eq(preset.keys())
    {
        let keys: Vec<&str> = preset.keys().collect();
        let problem = format!(
            "must be {}, in this order: these are the parameters of the law {}",
            keys.join(", "),
            law.name
        );
        return Err(("law.parameters".to_owned(), problem));
    }
    for (name, choices) in &law.choices {
        let word = law.settings.0.get(name).and_then(toml::Value::as_str).unwrap_or_default();
        if !choices.iter().any(|choice| choice == word) {
            let problem = format!("is {word:?}, and must be one of {}", choices.join(", "));
            return Err((format!("law.settings.{name}"), problem));
        }
    }
    for (index, it) in law.parameters.iter().enumerate() {
        let key = format!("law.parameters[{index}]");
        within(&format!("{key}.min"), it.min, -1e9, 1e9)?;
        within(&format!("{key}.max"), it.max, it.min, 1e9)?;
        within(&format!("{key}.default"), it.default, it.min, it.max)?;
        if it.scale == Scale::Log {
            above(&format!("{key}.min"), it.min, 0.0, 1e9)?;
        }
    }
    Ok(())
}

/// The embedded law with this name.
pub fn preset(name: &str) -> Option<LawConfig> {
    let preset = crate::presets::preset(&format!("laws/{name}.toml"))?;
    Some(toml::from_str(preset.text).expect("the presets are checked by a test"))
}

/// The paper's law, to which the gains of earlier versions and the rows of the paper's tables belong.
pub fn paper_law() -> LawConfig {
    preset("paper").expect("embedded")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_embedded_law_is_whole() {
        for name in crate::names_in("laws") {
            let law = preset(name).unwrap();
            assert_eq!(law.name, name);
            validate(&law).unwrap();
        }
    }

    #[test]
    fn sets_are_parsed_or_refused_with_a_reason() {
        let law = paper_law();
        let set = Parameters::of(&[3.0, 21.0, 21.0, 0.7]);
        assert_eq!(law.parse_sets("3, 21,21,.7").unwrap(), [set]);
        assert_eq!(law.parse_sets("3,21,21,.7/3,21,21,0.7").unwrap(), [set, set]);
        let check = |text: &str, part: &str| {
            let error = law.parse_sets(text).unwrap_err();
            assert!(error.contains(part), "{text}: {error}");
        };
        check("", "1 numbers");
        check("3,21,21", "3 numbers, but must hold Kv,Kl,Ks,Ki");
        check("3,21,21,x", "\"x\" is not a number");
        check("3,21,21,nan", "ki is NaN");
        check("3,21,21,1.5", "[0, 1]");
        check("-3,21,21,.7", "kv is -3");
    }

    #[test]
    fn tables_are_keyed_by_the_law_s_names_in_any_order() {
        let law = paper_law();
        let read = |text: &str| {
            let named: NamedParameters = toml::from_str(text).unwrap();
            law.parameters_of(&named)
        };
        let set = read("ki = 0.7\nkv = 3\nkl = 21.0\nks = 1.0").unwrap();
        assert_eq!(set, Parameters::of(&[3.0, 21.0, 1.0, 0.7]));
        assert_eq!(
            toml::to_string(&law.named(&set)).unwrap(),
            "kv = 3.0\nkl = 21.0\nks = 1.0\nki = 0.7\n"
        );
        assert_eq!(read("kv = 3").unwrap_err().0, "kl");
        assert_eq!(read("kv = 3\nkl = 1\nks = 1\nki = 0\nk = 2").unwrap_err().0, "k");
        assert_eq!(read("kv = 3\nkl = 1\nks = 1\nki = 1.5").unwrap_err().0, "ki");
    }
}
