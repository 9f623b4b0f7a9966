//! What `pathtune certify` is about: a configuration and the gains. The figures come from a tool, see `Tools`.

use std::path::Path;

use config::{Layers, OverBy, Parameters, PlantChange, RunConfig};

use crate::cli::CertifyArgs;
use crate::commands::drive::{choose, describe, tuned_parameters};
use crate::runs::resolved_config;
use crate::runs::setup::{add_path, read};
use crate::words::Failure;
use crate::words::terminal::tell;

/// What is to be certified.
#[derive(Debug, Clone)]
pub struct Certifiable {
    /// Path, car, law and speed.
    pub config: RunConfig,
    /// One set, or one for each manoeuvre that is due.
    pub sets: Vec<Parameters>,
    /// The plants of which it is to be said, too.
    pub plants: Vec<PlantChange>,
    /// Which gains these are, and where they come from.
    pub note: String,
}

/// Reads what is to be certified: a manoeuvre or a path with gains, or what a training has found.
///
/// # Errors
/// On a user's mistake.
pub fn certifiable(args: &CertifyArgs) -> Result<Certifiable, Failure> {
    let name = args.what.as_deref();
    let run = name.map(Path::new).filter(|path| path.join("config.toml").is_file());
    let mut config = match run {
        Some(run) => of_run(args, run)?,
        None => of_manoeuvre(args, name)?,
    };
    let plants = match &args.over {
        None => Vec::new(),
        Some(over) => plants(over, &mut config)?,
    };
    let (sets, origin) = match run {
        Some(run) if args.gains.is_none() => {
            (vec![tuned_parameters(run, &config, "")?.1], run.display().to_string())
        }
        _ => choose(args.gains.as_ref(), &args.from, &config)?,
    };
    let note = describe(&config, &sets, &origin);
    Ok(Certifiable { config, sets, plants, note })
}

/// The plants of `--over`.
fn plants(over: &str, config: &mut RunConfig) -> Result<Vec<PlantChange>, Failure> {
    // Judged over plants, the default ones have a faster drive among them.
    config.over.by = OverBy::Mean;
    if over == "default" {
        config.over.plants = Vec::new();
    } else {
        let mut layers = Layers::maneuver("lane_change")?;
        layers.add_plants(Path::new(over))?;
        config.over.plants = layers.resolve()?.over.plants;
    }
    Ok(config.plant_changes())
}

/// The configuration of a run, with another vehicle if one is named.
fn of_run(args: &CertifyArgs, run: &Path) -> Result<RunConfig, Failure> {
    let file = run.join("config.toml");
    let mut config = resolved_config(&file.display().to_string(), &read(&file, "")?)?;
    let of_manoeuvres = [
        ("--path", args.path.is_some()),
        ("--law", args.law.is_some()),
        ("--set", !args.set.is_empty()),
    ];
    if let Some((option, _)) = of_manoeuvres.iter().find(|(_, is_given)| *is_given) {
        let run = run.display();
        return Err(Failure::User(format!(
            "{option}: {run} is a run, which has its own; leave it out"
        )));
    }
    if let Some(vehicle) = &args.vehicle {
        let mut layers = Layers::maneuver("lane_change")?;
        layers.set_vehicle("--vehicle", vehicle)?;
        let other = layers.resolve()?;
        (config.vehicle, config.vehicle_preset) = (other.vehicle, other.vehicle_preset);
    }
    Ok(config)
}

/// The configuration of a manoeuvre, or of a path of the user's own.
fn of_manoeuvre(args: &CertifyArgs, name: Option<&str>) -> Result<RunConfig, Failure> {
    let mut layers = match (name, &args.path) {
        (Some(name), _) if Path::new(name).is_dir() => {
            let why = "holds no config.toml of a run; name a manoeuvre, or the folder of a finished training";
            return Err(Failure::User(format!("{name}: {why}")));
        }
        (Some(name), _) => Layers::maneuver(name)?,
        (None, Some(_)) => Layers::own_path(),
        (None, None) => {
            let why =
                "name a manoeuvre, the folder of a finished training, or a path with --path FILE";
            return Err(Failure::User(why.to_owned()));
        }
    };
    if let Some(law) = &args.law {
        layers.set_law("--law", law)?;
    }
    if let Some(vehicle) = &args.vehicle {
        layers.set_vehicle("--vehicle", vehicle)?;
    }
    if let Some(path) = &args.path {
        add_path(&mut layers, path, None, &args.reading)?;
        for note in layers.notes() {
            tell!("pathtune: {note}");
        }
    }
    for assignment in &args.set {
        layers.set(assignment)?;
    }
    Ok(layers.resolve()?)
}
