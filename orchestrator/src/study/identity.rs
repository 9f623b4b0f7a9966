//! What decides the result of a job, and the hash of it that names the job.
//!
//! Two jobs with the same identity come to the same bytes, on any machine. The resolved configuration decides, files of
//! the user's included, together with the seed and the version of pathtune. The size of the fleet and the memory of drives
//! do not.

use clap::Parser;
use config::RunConfig;
use config::launch::Launch;
use sha2::{Digest, Sha256};

use crate::cli::{Cli, Command, TrainArgs};
use crate::commands::resolve_training;
use crate::runs::preflight::check_scales;
use crate::study::manifest::IDENTITY;
use crate::words::Failure;

/// The options of a job's command.
///
/// # Errors
/// If it is no command of a training.
pub(crate) fn options_of(command: &[String]) -> Result<Box<TrainArgs>, Failure> {
    let typed = || format!("pathtune {}", shell_words::join(command));
    let words = std::iter::once("pathtune").chain(command.iter().map(String::as_str));
    match Cli::try_parse_from(words.chain(["--quiet"])) {
        Ok(Cli { command: Command::Train(options) }) if options.resume.is_none() => Ok(options),
        Ok(_) => Err(Failure::User(format!("{}: is no training", typed()))),
        Err(error) => {
            let text = error.to_string();
            let first = text.lines().next().unwrap_or_default();
            let first = first.strip_prefix("error: ").unwrap_or(first);
            Err(Failure::User(format!("{}: {first}", typed())))
        }
    }
}

/// The configuration of a job, checked.
///
/// # Errors
/// If it holds a mistake; its line names the job's command.
pub(crate) fn config_of(command: &[String]) -> Result<RunConfig, Failure> {
    let options = options_of(command)?;
    let launch = Launch::train();
    let config = resolve_training(&options, &launch)
        .and_then(|config| check_scales(&config, &launch).map(|()| config))
        .map_err(|failure| match failure {
            Failure::User(why) => {
                let typed = shell_words::join(command);
                Failure::User(format!("pathtune {typed}: {why}"))
            }
            other => other,
        })?;
    if config.run.realtime {
        let why = "run.realtime: a study drives in lockstep; leave this key out";
        return Err(Failure::User(why.to_owned()));
    }
    Ok(config)
}

/// What the identities of jobs have in common that differ in nothing but the seed.
pub(crate) struct Family(Sha256);

impl Family {
    /// That of a configuration, whatever its seed.
    pub(crate) fn of(config: &RunConfig) -> Self {
        let mut config = config.clone();
        (config.run.seed, config.run.fleet, config.run.memo) = (0, 0, true);
        let text = toml::to_string(&config).expect("a configuration is plain data");
        let mut hash = Sha256::new();
        hash.update(concat!("pathtune job ", env!("CARGO_PKG_VERSION"), "\n"));
        hash.update(text);
        Self(hash)
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
        let config = config_of(&words).unwrap();
        Family::of(&config).identity(config.run.seed)
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
    }

    #[test]
    fn what_is_no_training_is_refused_with_the_command() {
        for (command, part) in [
            ("grid lane_change", "pathtune grid lane_change: is no training"),
            ("train --resume x", "is no training"),
            ("train lane_change --sed 1", "unexpected argument '--sed'"),
            ("train lane_chang", "pathtune train lane_chang: maneuver: unknown: lane_chang"),
            ("train lane_change --set run.realtime=true", "lockstep"),
        ] {
            let words: Vec<String> = command.split(' ').map(str::to_owned).collect();
            let why = config_of(&words).map(|config| config.maneuver).unwrap_err();
            assert_eq!(why.code(), 64);
            assert!(why.message().contains(part), "{}", why.message());
        }
    }
}
