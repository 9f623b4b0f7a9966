//! `pathtune sweep plan`: from a study file to its manifest.

use std::fs;
use std::path::{Path, PathBuf};

use config::read_small;

use crate::study::axes::{Choice, Study};
use crate::study::identity::{Family, resolve};
use crate::study::manifest::{self, Job};
use crate::words::Failure;
use crate::words::terminal::say;

/// Writes the manifest of a study.
///
/// # Errors
/// If the study file or the configuration of a job holds a mistake; then no manifest is written.
pub(crate) fn plan(file: &Path, out: Option<&Path>) -> Result<(), Failure> {
    let text =
        read_small(file).map_err(|error| Failure::User(format!("{}: {error}", file.display())))?;
    let study =
        Study::parse(&text).map_err(|why| Failure::User(format!("{}: {why}", file.display())))?;
    let out = out.map_or_else(|| file.with_extension("jsonl"), Path::to_owned);
    if out == file {
        let why = "would be overwritten by its manifest; name another file with --out";
        return Err(Failure::User(format!("{}: {why}", file.display())));
    }
    let (study_folder, out_folder) = (folder_of(file)?, folder_of(&out)?);
    let name = out.file_name().unwrap_or_default().to_owned();
    // Jobs run in the manifest's folder: so that both can be moved together, names of files stay as they are if the study
    // lies there, too.
    std::env::set_current_dir(&out_folder)?;
    let named = |name: &str| {
        let there = study_folder.join(name);
        match study_folder == out_folder || !there.is_file() {
            true => name.to_owned(),
            false => there.display().to_string(),
        }
    };
    let mut families = Vec::new();
    study.for_each_family(named, |choice: &Choice, _| {
        families.push(
            resolve(&choice.command)
                .and_then(|resolved| {
                    let compared = choice.compared_over();
                    if compared.is_some() && resolved.plan.is_some() {
                        let why = "compare: a validation has no tuner to compare; leave it out";
                        return Err(Failure::User(why.to_owned()));
                    }
                    Ok((Family::of(&resolved).compared(compared), resolved.config.run.seed))
                })
                .map_err(|failure| failure.with(|why| format!("{}: {why}", file.display())))?,
        );
        Ok::<(), Failure>(())
    })?;
    manifest::write(&out_folder.join(&name), |take| {
        let (mut index, mut at) = (0, 0);
        study.for_each_family(named, |choice, seeds| {
            let (family, seed) = &families[at];
            at += 1;
            let mut put = |choice: Choice, seed: u64| {
                let Choice { axes, command } = choice;
                let job = Job { index, job: family.identity(seed), axes, command };
                index += 1;
                take(&job)
            };
            match seeds {
                None => put(choice.clone(), *seed),
                Some(seeds) => {
                    for seed in seeds {
                        put(choice.with_seed(seed), seed)?;
                    }
                    Ok(())
                }
            }
        })
    })?;
    let count = study.len();
    say!("{}: {count} {}", out.display(), if count == 1 { "job" } else { "jobs" });
    Ok(())
}

/// The whole path of the folder of a file.
fn folder_of(file: &Path) -> Result<PathBuf, Failure> {
    let folder = file.parent().filter(|it| !it.as_os_str().is_empty()).unwrap_or(Path::new("."));
    fs::canonicalize(folder)
        .map_err(|error| Failure::User(format!("{}: {error}", folder.display())))
}
