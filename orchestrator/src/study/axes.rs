//! A study file, and the list of jobs for which it stands.
//!
//! Pure. A study file holds one or more tables `[[jobs]]`. Each key of such a table is an axis, with one value or a list
//! of them; the table stands for every combination of them. `[common]` holds axes of all tables that do not name them
//! themselves. The jobs come in the order of the tables, and within a table in the order of [`AXES`], with the seed
//! running fastest.

use std::collections::BTreeMap;

use toml::{Table, Value};

/// The axes besides `set` and `seed`, in the order in which they are combined, with the option that each is. The command
/// and the manoeuvre have none: they are the first words.
const AXES: [(&str, &str); 17] = [
    (COMMAND, ""),
    ("maneuver", ""),
    ("path", "--path"),
    ("vehicle", "--vehicle"),
    ("law", "--law"),
    ("objective", "--objective"),
    ("tuner", "--tuner"),
    ("config", "--config"),
    ("noise", "--noise"),
    ("over", "--over"),
    ("over_by", "--over-by"),
    ("episodes", "--episodes"),
    ("drives", "--drives"),
    ("fleet", "--fleet"),
    ("gains", "--gains"),
    ("repeats", "--repeats"),
    (COMPARE, ""),
];

/// The axis that says what a job is: a training, or the validation of one set with `gains` and `repeats`.
const COMMAND: &str = "command";
/// What a job may be.
const COMMANDS: [&str; 2] = ["train", "validate"];

/// The axis that asks for what `pathtune compare` says of a training, over so many drives. It is no option of `train`.
pub(crate) const COMPARE: &str = "compare";

/// Axes whose value is, or may be, the name of a file.
const FILES: [&str; 5] = ["path", "vehicle", "law", "config", "over"];

/// What `set` axes are called in tables of results: this and the key.
const SET: &str = "set.";

/// The most jobs of one study. More would fill a manifest of gigabytes by mistake.
pub(crate) const MOST_JOBS: u64 = 10_000_000;

/// One job: a value for each axis that the study names.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Choice {
    /// The values by the names of their axes, as they stand in tables of results.
    pub(crate) axes: BTreeMap<String, String>,
    /// The words after `pathtune`.
    pub(crate) command: Vec<String>,
}

/// Places of the axes that a study names, so that its tables have the same order of columns as its jobs.
pub(crate) fn in_order<'a>(names: impl IntoIterator<Item = &'a str>) -> Vec<&'a str> {
    let mut names: Vec<&str> = names.into_iter().collect();
    let rank = |name: &str| match AXES.iter().position(|(axis, _)| *axis == name) {
        Some(place) => place,
        None if name == "seed" => usize::MAX,
        None => AXES.len(),
    };
    names.sort_by_key(|name| (rank(name), *name));
    names
}

/// The tables of a study file: what stands in `[common]`, and each table of `[[jobs]]` on top of it.
pub(crate) struct Study {
    tables: Vec<Vec<Axis>>,
}

/// An axis with its values.
#[derive(Debug, Clone)]
struct Axis {
    name: String,
    values: Values,
}

#[derive(Debug, Clone)]
enum Values {
    Listed(Vec<Value>),
    /// From the first to the last, both included.
    Seeds(Vec<(u64, u64)>),
}

impl Values {
    fn len(&self) -> u64 {
        match self {
            Self::Listed(values) => values.len() as u64,
            Self::Seeds(ranges) => ranges
                .iter()
                .map(|(from, to)| (to - from).saturating_add(1))
                .fold(0, u64::saturating_add),
        }
    }
}

impl Study {
    /// Parses a study file.
    ///
    /// # Errors
    /// With the key and what is wrong with it.
    pub(crate) fn parse(text: &str) -> Result<Self, String> {
        let table: Table = toml::from_str(text).map_err(|error| {
            let line = error.span().map_or(1, |span| 1 + text[..span.start].matches('\n').count());
            format!("line {line}: {}", error.message().replace('\n', " "))
        })?;
        let mut common = Table::new();
        let mut jobs = None;
        for (key, value) in table {
            match (key.as_str(), value) {
                ("common", Value::Table(table)) => common = table,
                ("jobs", Value::Array(tables)) => jobs = Some(tables),
                ("common", _) => return Err("common: is no table; write [common]".to_owned()),
                ("jobs", _) => return Err("jobs: is no list of tables; write [[jobs]]".to_owned()),
                _ => {
                    return Err(format!(
                        "{key}: unknown; a study has [common] and [[jobs]], and axes below them"
                    ));
                }
            }
        }
        let jobs = jobs.filter(|jobs| !jobs.is_empty());
        let jobs = jobs.ok_or("jobs: is missing; write [[jobs]], and the axes below it")?;
        let mut tables = Vec::new();
        for (number, job) in jobs.into_iter().enumerate() {
            let place = format!("jobs[{number}]");
            let Value::Table(job) = job else {
                return Err(format!("{place}: is no table; write [[jobs]]"));
            };
            let below = axes_of("common", &common)?;
            let mut axes = axes_of(&place, &job)?;
            for axis in below {
                if !axes.iter().any(|own| own.name == axis.name) {
                    axes.push(axis);
                }
            }
            if !axes.iter().any(|axis| ["maneuver", "path", "config"].contains(&&*axis.name)) {
                return Err(format!("{place}: names neither a maneuver nor a path"));
            }
            let order = in_order(axes.iter().map(|axis| axis.name.as_str()));
            let place_of: BTreeMap<String, usize> =
                order.iter().enumerate().map(|(place, name)| ((*name).to_owned(), place)).collect();
            axes.sort_by_key(|axis| place_of[&axis.name]);
            tables.push(axes);
        }
        let study = Self { tables };
        match study.len() {
            0..=MOST_JOBS => Ok(study),
            count => Err(format!("has {count} jobs; the most is {MOST_JOBS}")),
        }
    }

    /// Number of jobs.
    pub(crate) fn len(&self) -> u64 {
        let of = |axes: &Vec<Axis>| {
            axes.iter().map(|axis| axis.values.len()).fold(1, u64::saturating_mul)
        };
        self.tables.iter().map(of).fold(0, u64::saturating_add)
    }

    /// Calls `take` with each job that differs from the one before in more than the seed, without a seed, and with the
    /// seeds of the jobs that are like it; `None` if the study leaves the seed to the configuration. `file` turns the
    /// name of a file into the one by which jobs find it.
    ///
    /// # Errors
    /// Those of `take`.
    pub(crate) fn for_each_family<E>(
        &self,
        file: impl Fn(&str) -> String,
        mut take: impl FnMut(&Choice, Option<&mut dyn Iterator<Item = u64>>) -> Result<(), E>,
    ) -> Result<(), E> {
        for axes in &self.tables {
            let (seeds, listed): (Vec<&Axis>, Vec<&Axis>) =
                axes.iter().partition(|axis| matches!(axis.values, Values::Seeds(_)));
            let lists: Vec<(&str, &[Value])> = listed
                .iter()
                .filter_map(|axis| match &axis.values {
                    Values::Listed(values) => Some((axis.name.as_str(), values.as_slice())),
                    Values::Seeds(_) => None,
                })
                .collect();
            let count: usize = lists.iter().map(|(_, values)| values.len()).product();
            for number in 0..count {
                // The last axis runs fastest.
                let mut rest = number;
                let mut chosen: Vec<(&str, &Value)> = lists
                    .iter()
                    .rev()
                    .map(|(name, values)| {
                        let value = &values[rest % values.len()];
                        rest /= values.len();
                        (*name, value)
                    })
                    .collect();
                chosen.reverse();
                let choice = Choice::new(&chosen, &file);
                match seeds.first().map(|axis| &axis.values) {
                    Some(Values::Seeds(ranges)) => {
                        let mut seeds = ranges.iter().flat_map(|(from, to)| *from..=*to);
                        take(&choice, Some(&mut seeds))?;
                    }
                    _ => take(&choice, None)?,
                }
            }
        }
        Ok(())
    }
}

impl Choice {
    fn new(chosen: &[(&str, &Value)], file: impl Fn(&str) -> String) -> Self {
        let mut axes = BTreeMap::new();
        let named = chosen.iter().find(|(name, _)| *name == COMMAND).map(|(_, value)| plain(value));
        let (mut command, mut sets) =
            (vec![named.unwrap_or_else(|| COMMANDS[0].to_owned())], Vec::new());
        for (name, value) in chosen {
            axes.insert((*name).to_owned(), plain(value));
            if let Some(key) = name.strip_prefix(SET) {
                sets.extend(["--set".to_owned(), format!("{key}={value}")]);
                continue;
            }
            let option =
                AXES.iter().find(|(axis, _)| axis == name).map_or("", |(_, option)| option);
            match (*name, value) {
                ("noise", Value::Boolean(true)) => command.push(option.to_owned()),
                ("noise", _) | (COMMAND | COMPARE, _) => {}
                ("maneuver", value) => command.push(plain(value)),
                (name, value) => {
                    let value = plain(value);
                    let is_file = FILES.contains(&name);
                    command.extend([option.to_owned(), if is_file { file(&value) } else { value }]);
                }
            }
        }
        command.extend(sets);
        Self { axes, command }
    }

    /// The drives over which it is compared, if it is; see [`compared_over`].
    pub(crate) fn compared_over(&self) -> Option<u32> {
        compared_over(&self.axes)
    }

    /// The same job with this seed.
    pub(crate) fn with_seed(&self, seed: u64) -> Self {
        let mut job = self.clone();
        job.axes.insert("seed".to_owned(), seed.to_string());
        job.command.extend(["--seed".to_owned(), seed.to_string()]);
        job
    }
}

/// The drives over which a job with these axes is compared, as `pathtune compare` does, if the study asks for it.
pub(crate) fn compared_over(axes: &BTreeMap<String, String>) -> Option<u32> {
    axes.get(COMPARE)?.parse().ok()
}

/// A value without the quotes that TOML puts around texts.
fn plain(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}

/// The axes of a table of a study file; `place` names it in errors.
fn axes_of(place: &str, table: &Table) -> Result<Vec<Axis>, String> {
    let mut axes = Vec::new();
    for (key, value) in table {
        let place = format!("{place}.{key}");
        match (key.as_str(), value) {
            ("seed", value) => {
                let ranges = seeds_of(value).map_err(|why| format!("{place}: {why}"))?;
                axes.push(Axis { name: "seed".to_owned(), values: Values::Seeds(ranges) });
            }
            ("set", Value::Table(keys)) => {
                for (key, value) in keys {
                    let place = format!("{place}.{key}");
                    // A key written without quotes is a table in a table.
                    if value.is_table() {
                        return Err(format!(
                            "{place}: write the whole key in quotes, as in set.\"learning.gamma\" = [0.8, 0.9]"
                        ));
                    }
                    let values = Values::Listed(listed(&place, value)?);
                    axes.push(Axis { name: format!("{SET}{key}"), values });
                }
            }
            ("set", _) => {
                let how = "is no table; write set.\"learning.gamma\" = [0.8, 0.9]";
                return Err(format!("{place}: {how}"));
            }
            (key, value) if AXES.iter().any(|(axis, _)| *axis == key) => {
                let values = listed(&place, value)?;
                if let Some(wrong) = values.iter().find(|value| !fits(key, value)) {
                    let wanted = match key {
                        "noise" => "true or false",
                        COMPARE => "a number of drives, from 1 to 10000",
                        COMMAND => "\"train\" or \"validate\"",
                        "episodes" | "drives" | "fleet" | "repeats" => "a whole number",
                        _ => "a name in quotes",
                    };
                    return Err(format!("{place}: is {wrong}, but must be {wanted}"));
                }
                axes.push(Axis { name: key.to_owned(), values: Values::Listed(values) });
            }
            (key, _) => {
                let names: Vec<&str> =
                    AXES.iter().map(|(axis, _)| *axis).chain(["seed", "set"]).collect();
                let near = config::nearest(key, names.iter().copied())
                    .map_or(String::new(), |near| format!("did you mean {near}? "));
                let all = names.join(", ");
                return Err(format!("{place}: no such axis; {near}There are {all}"));
            }
        }
    }
    Ok(axes)
}

/// Whether an axis can have this value.
fn fits(axis: &str, value: &Value) -> bool {
    match axis {
        "noise" => value.is_bool(),
        COMPARE => value.as_integer().is_some_and(|it| (1..=10_000).contains(&it)),
        COMMAND => value.as_str().is_some_and(|it| COMMANDS.contains(&it)),
        "episodes" | "drives" | "fleet" | "repeats" => value.as_integer().is_some_and(|it| it > 0),
        // A word that begins with a dash would be taken for an option.
        _ => value.as_str().is_some_and(|it| !it.is_empty() && !it.starts_with('-')),
    }
}

/// One value, or a list of them.
fn listed(place: &str, value: &Value) -> Result<Vec<Value>, String> {
    match value {
        Value::Array(values) if values.is_empty() => {
            Err(format!("{place}: is an empty list; give a value, or leave the axis out"))
        }
        Value::Array(values) => Ok(values.clone()),
        value => Ok(vec![value.clone()]),
    }
}

/// Seeds: a number, a range as in `"1..200"` with both ends, or a list of these.
fn seeds_of(value: &Value) -> Result<Vec<(u64, u64)>, String> {
    let wrong = || {
        let how = "is not a seed; write 7, \"1..200\" (both ends belong to it), or a list of these";
        how.to_owned()
    };
    // The largest number that a TOML file can hold.
    let seed = |number: i64| u64::try_from(number).map_err(|_| wrong());
    let text = |text: &str| {
        let number = |text: &str| {
            let number = text.trim().parse::<u64>().ok().filter(|it| i64::try_from(*it).is_ok());
            number.ok_or_else(wrong)
        };
        let (from, to) = match text.split_once("..") {
            Some((from, to)) => (number(from)?, number(to)?),
            None => (number(text)?, number(text)?),
        };
        if from > to {
            return Err(format!("{text}: ends before it begins"));
        }
        Ok((from, to))
    };
    match value {
        Value::Integer(number) => seed(*number).map(|seed| vec![(seed, seed)]),
        Value::String(range) => Ok(vec![text(range)?]),
        Value::Array(parts) if !parts.is_empty() => {
            let mut ranges = Vec::new();
            for part in parts {
                match part {
                    Value::Integer(_) | Value::String(_) => ranges.extend(seeds_of(part)?),
                    _ => return Err(wrong()),
                }
            }
            Ok(ranges)
        }
        _ => Err(wrong()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The commands of a study, one a line.
    fn commands(text: &str) -> Vec<String> {
        let study = Study::parse(text).unwrap();
        let mut all = Vec::new();
        let file = |name: &str| if name.contains('.') { format!("/s/{name}") } else { name.into() };
        study
            .for_each_family(file, |choice, seeds| {
                match seeds {
                    None => all.push(choice.command.join(" ")),
                    Some(seeds) => {
                        all.extend(seeds.map(|seed| choice.with_seed(seed).command.join(" ")));
                    }
                }
                Ok::<(), ()>(())
            })
            .unwrap();
        assert_eq!(all.len() as u64, study.len());
        all
    }

    #[test]
    fn a_table_is_every_combination_of_its_values_with_the_seed_running_fastest() {
        let text = "
            [common]
            noise = [false, true]
            seed = '1..2'
            [[jobs]]
            maneuver = 'lane_change'
            vehicle = ['tesla_model_3', 'car.toml']
            [[jobs]]
            maneuver = 'roundabout'
            tuner = 'sobol'
            drives = 40
            noise = false
            seed = [7, '9..9']
            set.'learning.gamma' = [0.8, 0.9]
            set.'learning.episode_gains' = 'random'";
        assert_eq!(
            commands(text),
            [
                "train lane_change --vehicle tesla_model_3 --seed 1",
                "train lane_change --vehicle tesla_model_3 --seed 2",
                "train lane_change --vehicle tesla_model_3 --noise --seed 1",
                "train lane_change --vehicle tesla_model_3 --noise --seed 2",
                "train lane_change --vehicle /s/car.toml --seed 1",
                "train lane_change --vehicle /s/car.toml --seed 2",
                "train lane_change --vehicle /s/car.toml --noise --seed 1",
                "train lane_change --vehicle /s/car.toml --noise --seed 2",
                "train roundabout --tuner sobol --drives 40 --set learning.episode_gains=\"random\" --set \
                 learning.gamma=0.8 --seed 7",
                "train roundabout --tuner sobol --drives 40 --set learning.episode_gains=\"random\" --set \
                 learning.gamma=0.8 --seed 9",
                "train roundabout --tuner sobol --drives 40 --set learning.episode_gains=\"random\" --set \
                 learning.gamma=0.9 --seed 7",
                "train roundabout --tuner sobol --drives 40 --set learning.episode_gains=\"random\" --set \
                 learning.gamma=0.9 --seed 9",
            ]
        );
        assert_eq!(commands("[[jobs]]\nmaneuver = 'circuit'"), ["train circuit"]);
        let tables = "[[jobs]]\ncommand = 'validate'\nmaneuver = 'circuit'\ngains = ['1,2', '3']";
        let validate = |gains: &str| format!("validate circuit --gains {gains}");
        assert_eq!(commands(tables), [validate("1,2"), validate("3")]);
        let over =
            "[[jobs]]\nmaneuver = 'circuit'\nover = ['default', 'p.toml']\nover_by = 'worst'";
        let words = |plants: &str| format!("train circuit --over {plants} --over-by worst");
        assert_eq!(commands(over), [words("default"), words("/s/p.toml")]);
    }

    #[test]
    fn mistakes_are_named_with_their_place() {
        for (text, part) in [
            ("", "[[jobs]]"),
            ("jobs = 3", "jobs: is no list"),
            ("name = 'x'\n[[jobs]]\nmaneuver = 'a'", "name: unknown"),
            ("[[jobs]]\nlaw = 'paper'", "jobs[0]: names neither"),
            (
                "[[jobs]]\nmaneuver = 'a'\nlaws = 'b'",
                "jobs[0].laws: no such axis; did you mean law?",
            ),
            ("[[jobs]]\nmaneuver = []", "jobs[0].maneuver: is an empty list"),
            ("[[jobs]]\nmaneuver = '--out'", "jobs[0].maneuver: is \"--out\", but"),
            (
                "[[jobs]]\nmaneuver = 'a'\nnoise = 1",
                "jobs[0].noise: is 1, but must be true or false",
            ),
            ("[[jobs]]\nmaneuver = 'a'\nepisodes = -1", "jobs[0].episodes: is -1"),
            (
                "[[jobs]]\nmaneuver = 'a'\ncompare = 0",
                "jobs[0].compare: is 0, but must be a number",
            ),
            ("[[jobs]]\nmaneuver = 'a'\ncommand = 'grid'", "jobs[0].command: is \"grid\", but"),
            ("[[jobs]]\nmaneuver = 'a'\nseed = '2..1'", "jobs[0].seed: 2..1: ends before"),
            ("[[jobs]]\nmaneuver = 'a'\nseed = '1-3'", "jobs[0].seed: is not a seed"),
            ("[[jobs]]\nmaneuver = 'a'\nseed = -1", "jobs[0].seed: is not a seed"),
            ("[[jobs]]\nmaneuver = 'a'\nseed = [[1]]", "jobs[0].seed: is not a seed"),
            ("[[jobs]]\nmaneuver = 'a'\nset.learning.gamma = 1", "jobs[0].set.learning: write the"),
            ("[common]\nset = 1\n[[jobs]]\nmaneuver = 'a'", "common.set: is no table"),
            ("[[jobs]]\nmaneuver = 'a'\nseed = '0..10000000'", "has 10000001 jobs"),
            (
                "[[jobs]]\nmaneuver = 'a'\nseed = ['0..9223372036854775807', 1, '0..9223372036854775807']",
                "jobs; the most",
            ),
            ("[[jobs]]\nmaneuver = ", "line 2: "),
        ] {
            let why = Study::parse(text).map(|study| study.len()).unwrap_err();
            assert!(why.contains(part) && !why.contains('\n'), "{text}: {why}");
        }
    }

    #[test]
    fn columns_have_the_order_of_the_axes() {
        let names = ["seed", "set.b", "noise", "set.a", "maneuver"];
        assert_eq!(in_order(names), ["maneuver", "noise", "set.a", "set.b", "seed"]);
    }
}
