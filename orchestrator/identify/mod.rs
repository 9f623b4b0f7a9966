//! `pathtune identify`: reads drives, identifies the car, and says what came of it.

mod bag;
mod csv_drive;
mod recording;
mod table;

use std::path::Path;

use config::Vehicle;
use identification::{Drive, Identification, Options, Point};
use orchestrator::cli::IdentifyArgs;
use orchestrator::commands;
use orchestrator::words::Failure;
use serde_json::json;

/// The most samples that are kept: those of some hours.
pub(crate) const MOST_SAMPLES: usize = 4_000_000;

/// A file's drives.
#[derive(Debug, Default)]
pub(crate) struct Read {
    pub(crate) drives: Vec<Drive>,
    pub(crate) point: Point,
    pub(crate) is_simulated: bool,
    /// What the user should know of the file.
    pub(crate) warnings: Vec<String>,
}

/// Identifies a car.
pub(crate) fn identify(args: &IdentifyArgs) -> Result<(), Failure> {
    if args.rollback {
        return commands::roll_back(&args.vehicle);
    }
    let vehicle = commands::vehicle_of(&args.vehicle)?;
    let mut drives = Vec::new();
    let mut options = Options {
        point: Point::default(),
        wheelbase_is_measured: args.wheelbase_measured,
        is_simulated: args.simulated,
    };
    let mut warnings = Vec::new();
    for (index, file) in args.drives.iter().enumerate() {
        let read = read(file, &vehicle, args)
            .map_err(|why| Failure::User(format!("{}: {why:#}", file.display())))?;
        if index > 0 && read.point != options.point {
            return Err(Failure::User(format!(
                "{}: tells another point of the car than {}: identify recordings of ours, CSV files and bags apart",
                file.display(),
                args.drives[0].display()
            )));
        }
        options.point = read.point;
        options.is_simulated |= read.is_simulated;
        drives.extend(read.drives);
        warnings.extend(read.warnings);
    }
    let mut found = identification::identify(&drives, &vehicle, options).map_err(|why| {
        let names: Vec<String> = args.drives.iter().map(|it| it.display().to_string()).collect();
        Failure::User(format!("{}: {why}", names.join(", ")))
    })?;
    warnings.append(&mut found.warnings);
    let refusal = refusal(&found);
    let report = commands::Identified {
        rows: table::rows(&found),
        notes: table::notes(&found, refusal.as_deref(), args.write, &args.vehicle),
        json: json!({
            "schema": 1,
            "vehicle": vehicle.name,
            "identification": &found,
            "predicts_better": found.is_better(),
            "warnings": &warnings,
        }),
        warnings,
        values: values(&found),
        refusal,
    };
    commands::conclude(&report, &args.vehicle, args.json, args.write)
}

/// The values for the vehicle's file: those that changed.
fn values(found: &Identification) -> Vec<(String, f64)> {
    let changed = |row: &&identification::Row| row.identified && row.after != row.before;
    found.rows.iter().filter(changed).map(|row| (row.key.to_owned(), row.after)).collect()
}

fn refusal(found: &Identification) -> Option<String> {
    if values(found).is_empty() {
        return Some("no value is identified that the file has not already".to_owned());
    }
    let worse = found.predictions.iter().find(|it| !it.is_better())?;
    if worse.windows == 0 {
        return Some(format!("no {} s of the drive could be predicted", worse.over_s));
    }
    Some(format!(
        "the new values do not predict the drive better over {} s ({:.3} m, the file's {:.3} m)",
        worse.over_s, worse.after_m, worse.before_m
    ))
}

/// Reads a drive in whichever form it is.
fn read(file: &Path, vehicle: &Vehicle, args: &IdentifyArgs) -> anyhow::Result<Read> {
    use std::io::Read as _;
    let mut first = [0; 8];
    let count = config::open_regular(file)?.read(&mut first)?;
    if first[..count] == *b"\x89MCAP0\r\n" {
        // A recording of ours holds ROS messages, too: whoever names their topics wants these.
        let names_topics = args.odometry.is_some() || args.command.is_some();
        return match !names_topics && recorder::reading::is_ours(file)? {
            true => recording::read(file),
            false => bag::read(file, vehicle, args),
        };
    }
    csv_drive::read(file)
}
