//! What decides the result of a job, and the hash of it that names the job.
//!
//! Two jobs with the same identity come to the same bytes, on any machine. The resolved configuration decides, files of
//! the user's included, together with the seed and the version of pathtune. The size of the fleet and the memory of drives
//! do not.

use clap::Parser;
use config::launch::Launch;
use config::{RunConfig, SweepPlan};
use sha2::{Digest, Sha256};

use crate::cli::{Cli, Command, TrainArgs, ValidateArgs};
use crate::commands::{resolve_training, resolve_validation};
use crate::runs::preflight::check_scales;
use crate::study::manifest::IDENTITY;
use crate::words::Failure;

/// The options of a job's command.
#[derive(Debug)]
pub(crate) enum JobOptions {
    Train(Box<TrainArgs>),
    /// Of one set.
    Validate(Box<ValidateArgs>),
}

/// The options of a job's command.
///
/// # Errors
/// If it is no command of a job.
pub(crate) fn options_of(command: &[String]) -> Result<JobOptions, Failure> {
    let typed = || format!("pathtune {}", shell_words::join(command));
    let words = std::iter::once("pathtune").chain(command.iter().map(String::as_str));
    match Cli::try_parse_from(words.chain(["--quiet"])) {
        Ok(Cli { command: Command::Train(options) }) if options.resume.is_none() => {
            Ok(JobOptions::Train(options))
        }
        Ok(Cli { command: Command::Validate(options) }) => match options.gains.len() {
            1 => Ok(JobOptions::Validate(options)),
            _ => Err(Failure::User(format!(
                "{}: a job validates one set; name it as gains",
                typed()
            ))),
        },
        Ok(_) => Err(Failure::User(format!("{}: is no training", typed()))),
        Err(error) => {
            let text = error.to_string();
            let first = text.lines().next().unwrap_or_default();
            let first = first.strip_prefix("error: ").unwrap_or(first);
            Err(Failure::User(format!("{}: {first}", typed())))
        }
    }
}

/// What a job's command comes to.
#[derive(Debug)]
pub(crate) struct Resolved {
    /// The configuration, checked.
    pub(crate) config: RunConfig,
    /// The drives of a validation.
    pub(crate) plan: Option<SweepPlan>,
}

impl Resolved {
    /// Elements of the longest message of its pipeline.
    pub(crate) fn max_len(&self) -> usize {
        self.config.fleet().max(self.config.learners())
    }
}

/// Resolves the command of a job.
///
/// # Errors
/// If its configuration holds a mistake; its line names the job's command.
pub(crate) fn resolve(command: &[String]) -> Result<Resolved, Failure> {
    let launch = Launch::train();
    let resolved = match options_of(command)? {
        JobOptions::Train(options) => resolve_training(&options, &launch)
            .and_then(|config| check_scales(&config, &launch).map(|()| config))
            .map(|config| Resolved { config, plan: None }),
        JobOptions::Validate(options) => {
            resolve_validation(&options).map(|(config, plan)| Resolved { config, plan: Some(plan) })
        }
    };
    let resolved = resolved.map_err(|failure| match failure {
        Failure::User(why) => {
            let typed = shell_words::join(command);
            Failure::User(format!("pathtune {typed}: {why}"))
        }
        other => other,
    })?;
    if resolved.config.run.realtime {
        let why = "run.realtime: a study drives in lockstep; leave this key out";
        return Err(Failure::User(why.to_owned()));
    }
    Ok(resolved)
}

/// What the identities of jobs have in common that differ in nothing but the seed.
pub(crate) struct Family(Sha256);

impl Family {
    /// That of a command, whatever the seed.
    pub(crate) fn of(resolved: &Resolved) -> Self {
        let mut config = resolved.config.clone();
        (config.run.seed, config.run.fleet, config.run.memo) = (0, 0, true);
        let text = toml::to_string(&config).expect("a configuration is plain data");
        let mut hash = Sha256::new();
        hash.update(concat!("pathtune job ", env!("CARGO_PKG_VERSION"), "\n"));
        hash.update(text);
        if let Some(plan) = &resolved.plan {
            hash.update(toml::to_string(plan).expect("plain data"));
        }
        Self(hash)
    }

    /// The family of the same jobs, if each is also compared over so many drives.
    pub(crate) fn compared(mut self, drives: Option<u32>) -> Self {
        if let Some(drives) = drives {
            self.0.update(format!("compared over {drives} drives\n"));
        }
        self
    }

    /// The identity of its job with this seed.
    pub(crate) fn identity(&self, seed: u64) -> String {
        let hash = self.0.clone().chain_update(seed.to_le_bytes()).finalize();
        let digits: String = hash.iter().map(|byte| format!("{byte:02x}")).collect();
        digits[..IDENTITY].to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn identity(command: &str) -> String {
        let words: Vec<String> = command.split(' ').map(str::to_owned).collect();
        let resolved = resolve(&words).unwrap();
        Family::of(&resolved).identity(resolved.config.run.seed)
    }

    #[test]
    fn what_decides_the_result_decides_the_identity() {
        let plain = identity("train lane_change");
        assert_eq!(plain.len(), IDENTITY);
        for same in ["--seed 1", "--fleet 3", "--no-memo", "--law paper", "--tuner educated-q"] {
            assert_eq!(identity(&format!("train lane_change {same}")), plain, "{same}");
        }
        for other in ["--seed 2", "--noise", "--law stanley", "--episodes 3", "--tuner q"] {
            assert_ne!(identity(&format!("train lane_change {other}")), plain, "{other}");
        }
        let validated = |more: &str| identity(&format!("validate lane_change --gains {more}"));
        assert_eq!(validated("3,21,21,0.7"), validated("3,21,21,0.7 --repeats 10 --fleet 2"));
        for other in ["3,21,21,0.98", "3,21,21,0.7 --repeats 3"] {
            assert_ne!(validated(other), validated("3,21,21,0.7"), "{other}");
        }
    }

    #[test]
    fn what_is_no_training_is_refused_with_the_command() {
        for (command, part) in [
            ("grid lane_change", "pathtune grid lane_change: is no training"),
            ("train --resume x", "is no training"),
            ("validate lane_change", "a job validates one set; name it as gains"),
            ("validate lane_change --gains 1,2 --seed 1", "unexpected argument '--seed'"),
            ("train lane_change --sed 1", "unexpected argument '--sed'"),
            ("train lane_chang", "pathtune train lane_chang: maneuver: unknown: lane_chang"),
            ("train lane_change --set run.realtime=true", "lockstep"),
        ] {
            let words: Vec<String> = command.split(' ').map(str::to_owned).collect();
            let why = resolve(&words).map(|it| it.config.maneuver).unwrap_err();
            assert_eq!(why.code(), 64);
            assert!(why.message().contains(part), "{}", why.message());
        }
    }
}
