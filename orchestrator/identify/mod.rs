//! `pathtune identify`: reads drives, identifies the car, and says what came of it.

mod bag;
mod csv_drive;
mod recording;
mod table;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use config::Vehicle;
use identification::{Drive, Identification, Odometry, Options, Point};
use orchestrator::cli::IdentifyArgs;
use orchestrator::commands;
use orchestrator::words::Failure;
use serde_json::json;

use crate::tools::refuse_others;

/// The most samples that are kept: those of some hours.
pub(crate) const MOST_SAMPLES: usize = 4_000_000;

/// A file's drives.
#[derive(Debug, Default)]
pub(crate) struct Read {
    pub(crate) drives: Vec<Drive>,
    pub(crate) point: Point,
    pub(crate) is_simulated: bool,
    /// Commands are yaw rates. They were made of steering angles by the file's wheelbase, and will be again: if another one
    /// were identified, the car would answer differently by as much.
    pub(crate) are_twists: bool,
    /// What the user should know of the file.
    pub(crate) warnings: Vec<String>,
    /// What the user should know of what comes out.
    pub(crate) caveats: Vec<String>,
}

/// Files that were read: none counts twice, by whatever names it is given.
#[derive(Debug, Default)]
pub(crate) struct Seen {
    files: BTreeSet<PathBuf>,
    /// Those that came again.
    again: Vec<PathBuf>,
}

impl Seen {
    /// Notes a file; tells whether it is none of those before.
    pub(crate) fn is_new(&mut self, file: &Path) -> bool {
        let whole = std::fs::canonicalize(file).unwrap_or_else(|_| file.to_owned());
        let is_new = self.files.insert(whole);
        if !is_new && !self.again.iter().any(|it| it == file) {
            self.again.push(file.to_owned());
        }
        is_new
    }

    /// What to tell of those that came again.
    fn told(&self) -> Option<String> {
        let names: Vec<String> = self.again.iter().map(|it| it.display().to_string()).collect();
        (!names.is_empty()).then(|| {
            format!("{}: named twice, or continues another one; counts once", names.join(", "))
        })
    }
}

/// Whether a sample tells something. The yaw rate may be missing.
pub(crate) fn is_finite(it: &Odometry) -> bool {
    [it.x_m, it.y_m, it.yaw_rad, it.speed_mps].iter().all(|it| it.is_finite())
}

/// Puts the last yaw rate where one is missing, unless there is none at all.
pub(crate) fn fill_gaps(odometry: &mut [Odometry]) {
    let Some(mut last) = odometry.iter().map(|it| it.yaw_rate_radps).find(|it| it.is_finite())
    else {
        return;
    };
    for it in odometry {
        match it.yaw_rate_radps.is_finite() {
            true => last = it.yaw_rate_radps,
            false => it.yaw_rate_radps = last,
        }
    }
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
    let (mut warnings, mut caveats) = (Vec::new(), Vec::new());
    let mut seen = Seen::default();
    for (index, file) in args.drives.iter().enumerate() {
        if !seen.is_new(file) {
            continue;
        }
        let read = read(file, &vehicle, args, &mut seen)
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
        options.wheelbase_is_measured |= read.are_twists;
        if read.are_twists {
            caveats.push(format!(
                "{}: a twist asks for a yaw rate, and the car turns its wheels for it by a wheelbase of its own: wheelbase_m stays \
                 {} m, by which angles become twists, and steering_gain says how much more or less the car turns",
                file.display(),
                vehicle.wheelbase_m
            ));
        }
        drives.extend(read.drives);
        warnings.extend(read.warnings);
        caveats.extend(read.caveats);
    }
    warnings.extend(seen.told());
    let mut found = identification::identify(&drives, &vehicle, options).map_err(|why| {
        let names: Vec<String> = args.drives.iter().map(|it| it.display().to_string()).collect();
        // A drive that was not read to its end may be too short for that reason.
        let lacks: String = warnings.iter().map(|it| format!("; {it}")).collect();
        Failure::User(format!("{}: {why}{lacks}", names.join(", ")))
    })?;
    warnings.append(&mut caveats);
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
        found: for_file(&found),
        drives: args.drives.clone(),
        refusal,
    };
    if let Some(folder) = &args.report {
        draw(folder, &vehicle.name, &report, &found)?;
    }
    commands::conclude(&report, &args.vehicle, args.json, args.write)
}

/// Draws what was measured beside what is predicted.
fn draw(
    folder: &Path,
    vehicle: &str,
    it: &commands::Identified,
    found: &Identification,
) -> Result<(), Failure> {
    refuse_others("--report", folder)?;
    let drives: Vec<String> = it.drives.iter().map(|it| it.display().to_string()).collect();
    let car = report::IdentifiedCar {
        vehicle,
        drives: &drives,
        rows: &it.rows,
        notes: &it.notes,
        warnings: &it.warnings,
        compared: &found.compared,
    };
    let page = report::write_identified(folder, car)
        .map_err(|why| Failure::User(format!("--report {why}")))?;
    eprintln!("pathtune: wrote {}", page.display());
    Ok(())
}

/// The values for the vehicle's file: those that changed.
fn values(found: &Identification) -> Vec<(String, f64)> {
    let changed = |row: &&identification::Row| row.identified && row.after != row.before;
    found.rows.iter().filter(changed).map(|row| (row.key.to_owned(), row.after)).collect()
}

/// What goes into the vehicle's file: values, intervals, noise, and what the fit left.
fn for_file(found: &Identification) -> config::identified::Found {
    let mut values = values(found);
    let noise = found.noise;
    // Four digits that count are more than an estimate has.
    let mut put = |key: &str, value: f64| {
        let digits = 4 - value.abs().max(1e-9).log10().floor() as i32;
        let factor = 10.0_f64.powi(digits);
        values.push((format!("noise.{key}"), (value * factor).round() / factor));
    };
    put("position_sd_m", noise.position_sd_m);
    put("heading_half_width_rad", noise.heading_half_width_rad);
    if let Some(sd_mps) = noise.speed_sd_mps {
        put("speed_sd_mps", sd_mps);
    }
    if let Some(sd_radps) = noise.yaw_rate_sd_radps {
        put("yaw_rate_sd_radps", sd_radps);
    }
    // Keys of a part, as of the adapter, have no interval in the file.
    let rows = found.rows.iter().filter(|row| row.identified && !row.key.contains('.'));
    let around = |row: &identification::Row| {
        let [low, high] = row.interval?;
        // The value is rounded, and may lie just outside.
        Some((row.key.to_owned(), [low.min(row.after), high.max(row.after)]))
    };
    let left = found.residuals;
    let rate = left
        .yaw_rate_radps
        .map_or_else(String::new, |it| format!(", yaw rate {:.2} mrad/s", 1e3 * it));
    let mut provenance = vec![
        format!(
            "Fitted: {:.1} s of {:.1} s, {:.1} s of them moving.",
            found.fitted_s, found.recorded_s, found.moving_s
        ),
        format!(
            "Left by the fit: speed {:.2} cm/s{rate}, position {:.2} cm, heading {:.2} mrad.",
            1e2 * left.speed_mps,
            1e2 * left.position_m,
            1e3 * left.heading_rad
        ),
    ];
    for it in &found.predictions {
        provenance.push(format!(
            "Predicted over {} s, where no fit has seen the drive: off by {:.3} m; with the values before, {:.3} m.",
            it.over_s, it.after_m, it.before_m
        ));
    }
    config::identified::Found { values, intervals: rows.filter_map(around).collect(), provenance }
}

fn refusal(found: &Identification) -> Option<String> {
    if values(found).is_empty() {
        return Some("no value is identified that the file has not already".to_owned());
    }
    let worse = found.predictions.iter().find(|it| !it.is_better())?;
    if worse.windows == 0 {
        return Some(format!("no {} s of the drive could be predicted", worse.over_s));
    }
    let figures = format!("{:.3} m, the file's {:.3} m", worse.after_m, worse.before_m);
    let over_s = worse.over_s;
    Some(if worse.after_m < worse.before_m {
        let [low, high] = worse.ratio.map(|it| 100.0 * it);
        format!(
            "over {over_s} s the new values predict the drive better ({figures}), but that may be chance ({low:.0} to {high:.0} %); \
             drive for longer"
        )
    } else {
        format!("the new values do not predict the drive better over {over_s} s ({figures})")
    })
}

/// Reads a drive in whichever form it is.
fn read(
    file: &Path,
    vehicle: &Vehicle,
    args: &IdentifyArgs,
    seen: &mut Seen,
) -> anyhow::Result<Read> {
    use std::io::Read as _;
    let mut first = [0; 8];
    let count = config::open_regular(file)?.read(&mut first)?;
    if first[..count] == *b"\x89MCAP0\r\n" {
        // A recording of ours holds ROS messages, too: whoever names their topics wants these.
        let names_topics = args.odometry.is_some() || args.command.is_some();
        return match !names_topics && recorder::reading::is_ours(file)? {
            true => recording::read(file, seen),
            false => bag::read(file, vehicle, args),
        };
    }
    let of_bags = [
        ("--odometry", args.odometry.is_some()),
        ("--command", args.command.is_some()),
        ("--command-type", args.command_type.is_some()),
    ];
    if let Some((option, _)) = of_bags.into_iter().find(|(_, is_given)| *is_given) {
        anyhow::bail!("is no bag, and {option} is about the topics of one; leave it out");
    }
    csv_drive::read(file)
}
