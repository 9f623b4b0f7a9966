//! `pathtune compare`: which configurations are compared, and how the comparison is shown.

use config::RunConfig;
use outcome::{CompareResult, CompareRow};

use crate::cli::CompareArgs;
use crate::commands::train::put_plants;
use crate::runs::setup::{self, Sources};
use crate::words::terminal::{say, tell};
use crate::words::{Failure, comparison};

/// A configuration for each tuner; they differ in nothing else.
///
/// # Errors
/// On a user's mistake.
pub fn compare_configs(args: &CompareArgs) -> Result<Vec<RunConfig>, Failure> {
    for (place, tuner) in args.tuners.iter().enumerate() {
        setup::check_preset("--tuners", "tuners", tuner, false)?;
        if args.tuners[..place].contains(tuner) {
            return Err(Failure::User(format!("--tuners: names {tuner} twice; name it once")));
        }
    }
    args.tuners.iter().enumerate().map(|(place, tuner)| config_of(args, tuner, place > 0)).collect()
}

fn config_of(args: &CompareArgs, tuner: &str, quiet: bool) -> Result<RunConfig, Failure> {
    let sources = Sources {
        path: args.path.as_deref(),
        reading: &args.reading,
        tells_of_path: !quiet,
        vehicle: args.vehicle.as_deref(),
        law: args.law.as_deref(),
        objective: args.objective.as_deref(),
        config: args.config.as_deref(),
        laps: None,
        start: None,
        set: &args.set,
        quiet: args.quiet || quiet,
    };
    let mut layers = setup::layers(args.maneuver.as_deref(), sources, Some(tuner))?;
    if let Some(seed) = args.seed {
        layers.put("--seed", "run.seed", seed as i64)?;
    }
    if args.noise {
        layers.put("--noise", "noise.enabled", true)?;
    }
    put_plants(&mut layers, &args.over)?;
    let settings = layers.clone().resolve()?.tuner.settings.0;
    if settings.contains_key("drives") {
        layers.put("--drives", "tuner.settings.drives", i64::from(args.drives))?;
    }
    if args.continuous {
        if !settings.contains_key("draw") {
            return Err(Failure::User(format!(
                "--continuous: the tuner {tuner} keeps to the grid; leave it out of --tuners"
            )));
        }
        layers.put("--continuous", "tuner.settings.draw", "continuous")?;
    }
    let mut config = layers.resolve()?;
    // Computed by plain calls, in which the same drive is the same again.
    config.run.memo = true;
    if config.noise.enabled && config.robust.engage_gear {
        config.vehicle.gear_engaged = true;
    }
    Ok(config)
}

/// Tells that all trainings of a tuner are over.
pub fn tell_compared(args: &CompareArgs, tuner: &str) {
    if !args.quiet {
        tell!("pathtune: {tuner}: {} trainings are over", args.seeds);
    }
}

/// Prints a comparison as a table, as JSON or as CSV.
///
/// # Errors
/// If it cannot be written to standard output.
pub fn print_comparison(
    args: &CompareArgs,
    result: &CompareResult,
    rows: &[CompareRow],
) -> Result<(), Failure> {
    if args.json {
        let json = outcome::to_json(result);
        say!("{}", String::from_utf8_lossy(&json).trim_end());
        return Ok(());
    }
    if args.csv {
        say!("{}", comparison::csv(result, rows));
        return Ok(());
    }
    comparison::print(result)
}
