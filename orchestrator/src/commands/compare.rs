//! `pathtune compare`: which configurations are compared, and how the comparison is shown.

use config::RunConfig;
use outcome::Compared;

use crate::cli::CompareArgs;
use crate::commands::train::put_plants;
use crate::runs::setup::{self, Sources};
use crate::words::terminal::{say, tell};
use crate::words::{Failure, comparison};

/// The tuner beside which all others are seen.
const RANDOM: &str = "random";

/// For each law a configuration for each tuner; those of a law differ in nothing else.
///
/// # Errors
/// On a user's mistake.
pub fn compare_configs(args: &CompareArgs) -> Result<Vec<Vec<RunConfig>>, Failure> {
    for tuner in &args.tuners {
        setup::check_preset("--tuners", "tuners", tuner, false)?;
    }
    check_once("--tuners", &args.tuners)?;
    check_once("--laws", &args.laws)?;
    let mut tuners: Vec<&str> = args.tuners.iter().map(String::as_str).collect();
    if !tuners.contains(&RANDOM) {
        tuners.push(RANDOM);
    }
    let mut laws: Vec<Option<&str>> = args.laws.iter().map(|law| Some(law.as_str())).collect();
    if laws.is_empty() {
        laws.push(args.law.as_deref());
    }
    let config = |law, tuner: &&str| config_of(args, law, tuner);
    laws.into_iter().map(|law| tuners.iter().map(|tuner| config(law, tuner)).collect()).collect()
}

fn check_once(option: &str, names: &[String]) -> Result<(), Failure> {
    match names.iter().enumerate().find(|(place, name)| names[..*place].contains(name)) {
        None => Ok(()),
        Some((_, name)) => {
            Err(Failure::User(format!("{option}: names {name} twice; name it once")))
        }
    }
}

fn config_of(args: &CompareArgs, law: Option<&str>, tuner: &str) -> Result<RunConfig, Failure> {
    let sources = Sources {
        path: args.path.as_deref(),
        reading: &args.reading,
        vehicle: args.vehicle.as_deref(),
        law,
        objective: args.objective.as_deref(),
        config: args.config.as_deref(),
        laps: None,
        start: None,
        set: &args.set,
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
    setup::check_law(&config.law)?;
    // Computed by plain calls, in which the same drive is the same again.
    config.run.memo = true;
    if config.noise.enabled && config.robust.engage_gear {
        config.vehicle.gear_engaged = true;
    }
    Ok(config)
}

/// Tells that all trainings of a tuner are over.
pub fn tell_compared(args: &CompareArgs, law: &str, tuner: &str) {
    if args.quiet {
        return;
    }
    let law = if args.laws.is_empty() { String::new() } else { format!("{law}, ") };
    tell!("pathtune: {law}{tuner}: {} trainings are over", args.seeds);
}

/// Prints the comparison of each law as tables, as JSON or as CSV.
///
/// # Errors
/// If it cannot be written to standard output.
pub fn print_comparisons(args: &CompareArgs, laws: &[Compared]) -> Result<(), Failure> {
    if args.json {
        let json = match &laws {
            [one] if args.laws.is_empty() => outcome::to_json(&one.result),
            _ => outcome::to_json(&laws.iter().map(|it| &it.result).collect::<Vec<_>>()),
        };
        say!("{}", String::from_utf8_lossy(&json).trim_end());
        return Ok(());
    }
    if args.csv {
        say!("{}", comparison::csv(laws, !args.laws.is_empty()));
        return Ok(());
    }
    for (place, it) in laws.iter().enumerate() {
        if place > 0 {
            say!("");
        }
        comparison::print(&it.result)?;
    }
    if laws.len() > 1 {
        say!("");
        comparison::print_laws(laws)?;
    }
    Ok(())
}
