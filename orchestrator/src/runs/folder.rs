//! Reads what a run's folder holds, after the run.

use std::path::Path;

use config::launch::Launch;
use config::{ConfigError, RunConfig, read_small};
use outcome::OutcomeError;
use toml::Table;

use crate::words::Failure;

/// The resolved configuration of a run; `origin` names its source in errors.
///
/// # Errors
/// If an earlier version of pathtune wrote it, or it is not a resolved configuration.
pub fn resolved_config(origin: &str, text: &str) -> Result<RunConfig, Failure> {
    refuse_earlier(origin, text)?;
    Ok(RunConfig::from_resolved(text)
        .map_err(|error| ConfigError::new(origin, error.key, error.problem))?)
}

/// Refuses the resolved configuration of an earlier version of pathtune, which knew only one law and does not name it.
pub(crate) fn refuse_earlier(origin: &str, text: &str) -> Result<(), Failure> {
    match text.parse::<Table>() {
        // If it cannot be read at all, the code that reads it reports that.
        // Only a resolved configuration holds all of the vehicle.
        Ok(table)
            if table.contains_key("maneuver")
                && table
                    .get("vehicle")
                    .is_some_and(|vehicle| vehicle.get("wheelbase_m").is_some())
                && !table.contains_key("law") =>
        {
            Err(Failure::User(format!(
                "{origin}: made by an earlier version of pathtune (it names no law); use that version for it, or run \
                 again"
            )))
        }
        _ => Ok(()),
    }
}

/// Refuses the folder of a run that an earlier version of pathtune made, judging by the files in it.
pub(crate) fn refuse_earlier_run(folder: &Path) -> Result<(), Failure> {
    let config = folder.join("config.toml");
    if let Ok(text) = read_small(&config) {
        refuse_earlier(&config.display().to_string(), &text)?;
    }
    match outcome::read_result(folder) {
        Err(error @ OutcomeError::Earlier { .. }) => Err(Failure::User(error.to_string())),
        _ => Ok(()),
    }
}

/// Configuration and processes of a run in `folder`, which the user named with `option`. `missing` is the error if the
/// folder holds none.
pub(crate) fn of_earlier_start(
    folder: &Path,
    option: &str,
    missing: &str,
) -> Result<(RunConfig, Launch), Failure> {
    let read = |name: &str| {
        let path = folder.join(name);
        let origin = format!("{option} {}", path.display());
        read_small(&path)
            .map_err(|error| Failure::User(format!("{origin}: {missing}: {error}")))
            .map(|text| (origin, text))
    };
    let (origin, text) = read("config.toml")?;
    let config = resolved_config(&origin, &text)?;
    let (origin, text) = read("launch.toml")?;
    Ok((config, Launch::parse(&origin, &text)?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn folders_of_earlier_versions_are_refused_in_one_line() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| fs::write(folder.path().join(name), text).unwrap();
        refuse_earlier_run(folder.path()).unwrap();
        let check = || {
            let failure = refuse_earlier_run(folder.path()).unwrap_err();
            assert_eq!(failure.code(), 64);
            let said = failure.message();
            assert!(said.contains("earlier version of pathtune") && !said.contains('\n'), "{said}");
        };
        write("result.json", "{ \"schema\": 1, \"kind\": \"train\" }");
        check();
        write("result.json", "{}");
        write("config.toml", "maneuver = \"lane_change\"\n[vehicle]\nwheelbase_m = 2.875\n");
        check();
        let config = config::Layers::maneuver("lane_change").unwrap().resolve().unwrap();
        write("config.toml", &toml::to_string(&config).unwrap());
        refuse_earlier_run(folder.path()).unwrap();
    }
}
