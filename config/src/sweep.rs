//! What a pipeline drives outside a training: a list of parameter sets, in a file next to the configuration.

use serde::{Deserialize, Serialize};

use crate::{ConfigError, LawConfig, NamedParameters, Parameters};

/// What a pipeline drives outside a training.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SweepPlan {
    /// Which sets are driven, and for which result.
    pub kind: SweepKind,
    /// Noisy drives of each set, with the noise seeds 1, 2, …; only for a validation.
    pub repeats: u32,
    /// The vehicle paces by the clock: a restarted process joins the drive under way, which is never made again.
    pub realtime: bool,
    /// Sets that the user gave: for each, one set for every manoeuvre of the path, or one for all.
    pub sets: Vec<Vec<NamedParameters>>,
}

/// The purpose of the drives.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SweepKind {
    /// Each given set without noise and with it, compared with the paper's figures.
    Validate,
    /// Every set of the grid without noise, and the given ones among them.
    Grid,
    /// The first given set, once.
    Drive,
}

impl SweepPlan {
    /// Name of the file in the run's folder.
    pub const FILE: &'static str = "sweep.toml";

    /// The sets as parameters of a run's law.
    ///
    /// # Errors
    /// If they are not that law's parameters.
    pub fn parameters(&self, law: &LawConfig) -> Result<Vec<Vec<Parameters>>, ConfigError> {
        let of = |set: &NamedParameters| {
            law.parameters_of(set)
                .map_err(|(key, problem)| ConfigError::new(Self::FILE, key, problem))
        };
        self.sets.iter().map(|sets| sets.iter().map(of).collect()).collect()
    }

    /// Parses the plan that the orchestrator wrote.
    ///
    /// # Errors
    /// If the text is not a plan.
    pub fn parse(text: &str) -> Result<Self, ConfigError> {
        toml::from_str(text)
            .map_err(|error| ConfigError::new(Self::FILE, "", error.message().to_owned()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plan_survives_its_file() {
        let law = crate::paper_law();
        let set = Parameters::of(&[0.1, 1.0, 6.0, 0.7]);
        let sets = vec![vec![law.named(&set); 2]];
        let plan = SweepPlan { kind: SweepKind::Validate, repeats: 10, realtime: false, sets };
        let again = SweepPlan::parse(&toml::to_string(&plan).unwrap()).unwrap();
        assert_eq!(again.parameters(&law).unwrap(), [[set; 2]]);
    }
}
