//! Envelopes beside a vehicle's file: `gains promote` takes one along with the gains, and a drive of these gains finds it.
//!
//! It is a file of its own and not a part of the vehicle's, because it holds thousands of numbers. Its name tells the gains:
//! `car.toml` with gains for `roundabout` has `car.roundabout.envelope.toml`.

use std::fs;
use std::path::{Path, PathBuf};

use config::slots::{self, Held};
use config::{Envelope, MadeFor, Parameters, RunConfig, read_small};

use crate::words::Failure;

/// The name of an envelope in the folder of a training, as `calibrate RUN` writes it.
const OF_RUN: &str = "envelope.toml";

/// The file that holds the envelope of a vehicle's gains of this name.
fn beside(vehicle: &Path, name: &str) -> PathBuf {
    let stem = vehicle.file_stem().unwrap_or_default().to_string_lossy();
    vehicle.with_file_name(format!("{stem}.{}.envelope.toml", name.replace('/', ".")))
}

/// What stands beside an envelope's file: the scores of the drives since it was calibrated.
fn journal_of(file: &Path) -> PathBuf {
    let mut name = file.as_os_str().to_owned();
    name.push(".drives");
    name.into()
}

/// The envelope of a training that is to be promoted.
pub(crate) struct TakenAlong {
    text: String,
    file: PathBuf,
}

impl TakenAlong {
    /// The envelope in a training's folder, if it has one: for these gains, and for this vehicle. Also says why one that is
    /// there is left behind.
    pub(crate) fn read(
        run: &Path,
        vehicle: (&Path, &str),
        name: &str,
        made_for: &MadeFor,
    ) -> Result<Option<Self>, String> {
        let source = run.join(OF_RUN);
        if !source.exists() {
            return Ok(None);
        }
        let left = |why: String| format!("{}: is left behind: {why}", source.display());
        let text = read_small(&source).map_err(|why| left(why.to_string()))?;
        let envelope = Envelope::parse(&text).map_err(left)?;
        let wanted = MadeFor { vehicle: vehicle.1.to_owned(), ..made_for.clone() };
        if let Some((what, there, here)) = envelope.made_for.difference(&wanted) {
            return Err(left(format!(
                "it was calibrated for another drive, its {what} is {there}, and here it is {here}; calibrate again with \
                 `pathtune calibrate {} --vehicle {}`",
                run.display(),
                vehicle.0.display()
            )));
        }
        Ok(Some(Self { text, file: beside(vehicle.0, name) }))
    }

    /// Where it is to be.
    pub(crate) fn file(&self) -> &Path {
        &self.file
    }

    /// Puts it beside the vehicle's file, whole or not at all. What another one there has seen of drives is no longer compared
    /// with; it is kept under another name.
    pub(crate) fn put(&self) -> Result<(), Failure> {
        let file = &self.file;
        let failed = |why: std::io::Error| Failure::User(format!("{}: {why}", file.display()));
        if fs::read_to_string(file).is_ok_and(|there| there == self.text) {
            return Ok(());
        }
        let journal = journal_of(file);
        if journal.exists() {
            fs::rename(&journal, journal.with_extension("drives.before")).map_err(failed)?;
        }
        let part = file.with_extension("part");
        fs::write(&part, &self.text).and_then(|()| fs::rename(&part, file)).map_err(failed)?;
        Ok(())
    }
}

/// An envelope with its file, or why one that is there is not used.
type Found = Result<(PathBuf, Envelope), String>;

/// The envelope beside the vehicle's file for the gains that it holds for this path, with its file; and why one that is there
/// is not used.
///
/// # Errors
/// If there is one that cannot be read.
pub(crate) fn of_promoted(
    config: &RunConfig,
    sets: &[Parameters],
) -> Result<Option<Found>, Failure> {
    let vehicle = Path::new(&config.vehicle_preset);
    let name = match sets {
        [_] => match config.gains_of_path() {
            // Under another name, if the path's file had another one then.
            Some(Held::Own(key, _)) => key.clone(),
            _ => slots::place(&config.vehicle.gains, &config.gains_name(), &config.law.name),
        },
        _ => config.maneuver.clone(),
    };
    let file = beside(vehicle, &name);
    if !vehicle.is_file() || !file.exists() {
        return Ok(None);
    }
    let broken = |why: String| {
        Failure::User(format!("{}: {why}; mend it, calibrate again, or remove it", file.display()))
    };
    let text = read_small(&file).map_err(|why| broken(why.to_string()))?;
    let envelope = Envelope::parse(&text).map_err(broken)?;
    let gains = sets.iter().map(|set| config.law.named(set)).collect();
    Ok(Some(match envelope.made_for.difference(&MadeFor::of(config, gains)) {
        None => Ok((file, envelope)),
        Some((what, there, here)) => Err(format!(
            "{} is not used: it was calibrated for another drive, its {what} is {there}, and here it is {here}",
            file.display()
        )),
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_envelope_stands_beside_the_vehicle_under_the_name_of_its_gains() {
        let of = |name: &str| beside(Path::new("garage/car.toml"), name);
        assert_eq!(of("roundabout"), Path::new("garage/car.roundabout.envelope.toml"));
        assert_eq!(of("oval/stanley"), Path::new("garage/car.oval.stanley.envelope.toml"));
        assert_eq!(beside(Path::new("car.toml"), "a"), Path::new("car.a.envelope.toml"));
    }
}
