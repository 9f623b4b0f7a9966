//! What a pipeline drives outside a training: a list of gain sets, written beside the configuration.

use serde::{Deserialize, Serialize};

use crate::{ConfigError, Gains};

/// What a pipeline drives outside a training.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SweepPlan {
    /// Which sets, and what is made of them.
    pub kind: SweepKind,
    /// Noisy drives of each set, with the noise seeds 1, 2, …; only of a validation.
    pub repeats: u32,
    /// The vehicle paces by the clock: a restarted process joins the drive under way, which is never made again.
    pub realtime: bool,
    /// Gain sets that were named, each with one set for every manoeuvre of the path, or one for all.
    pub sets: Vec<Vec<Gains>>,
}

/// What is made of the drives.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SweepKind {
    /// Each named set without noise and with it, beside the paper's figures.
    Validate,
    /// Every set of the grid without noise, and the named ones among them.
    Grid,
    /// The first named set, once.
    Drive,
}

impl SweepPlan {
    /// Name of the file in the run's folder.
    pub const FILE: &'static str = "sweep.toml";

    /// Parses what the orchestrator wrote.
    ///
    /// # Errors
    /// If the text is no plan.
    pub fn parse(text: &str) -> Result<Self, ConfigError> {
        toml::from_str(text)
            .map_err(|error| ConfigError::new(Self::FILE, "", error.message().to_owned()))
    }
}

impl Gains {
    /// Parses gain sets from numbers: `Kv,Kl,Ks,Ki`, and a slash before each further set.
    ///
    /// # Errors
    /// If there are not four numbers a set, or one of them is no gain; says which.
    pub fn parse_sets(text: &str) -> Result<Vec<Self>, String> {
        text.split('/')
            .map(|set| {
                let numbers: Vec<&str> = set.split(',').map(str::trim).collect();
                let [kv, kl, ks, ki] = numbers[..] else {
                    let count = numbers.len();
                    return Err(format!(
                        "{set:?} holds {count} numbers, and must hold Kv,Kl,Ks,Ki"
                    ));
                };
                let mut gains = [0.0; 4];
                for (gain, number) in gains.iter_mut().zip([kv, kl, ks, ki]) {
                    *gain = number.parse().map_err(|_| format!("{number:?} is not a number"))?;
                }
                let gains = Self::from_array(gains);
                crate::check_gains(gains).map_err(|(name, problem)| format!("{name} {problem}"))?;
                Ok(gains)
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sets_are_parsed_or_refused_with_a_reason() {
        let set = Gains { kv: 3.0, kl: 21.0, ks: 21.0, ki: 0.7 };
        assert_eq!(Gains::parse_sets("3, 21,21,.7").unwrap(), [set]);
        assert_eq!(Gains::parse_sets("3,21,21,.7/3,21,21,0.7").unwrap(), [set, set]);
        let check = |text: &str, part: &str| {
            let error = Gains::parse_sets(text).unwrap_err();
            assert!(error.contains(part), "{text}: {error}");
        };
        check("", "1 numbers");
        check("3,21,21", "3 numbers");
        check("3,21,21,x", "\"x\" is not a number");
        check("3,21,21,nan", "ki is NaN");
        check("3,21,21,1.5", "[0, 1]");
        check("-3,21,21,.7", "kv is -3");
    }

    #[test]
    fn a_plan_survives_its_file() {
        let sets = vec![vec![Gains { kv: 0.1, kl: 1.0, ks: 6.0, ki: 0.7 }; 2]];
        let plan = SweepPlan { kind: SweepKind::Validate, repeats: 10, realtime: false, sets };
        assert_eq!(SweepPlan::parse(&toml::to_string(&plan).unwrap()).unwrap(), plan);
    }
}
