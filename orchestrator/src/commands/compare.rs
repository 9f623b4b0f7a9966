//! `pathtune compare`: which configurations are compared, and how the comparison is shown.

use std::collections::BTreeSet;
use std::fmt::Arguments;
use std::path::Path;
use std::time::{Duration, Instant};

use config::{Layers, RunConfig, Settings};
use outcome::Compared;

use crate::cli::CompareArgs;
use crate::commands::train::{SIMULATE_FIRST, check_own_plants, keep_within, put_plants};
use crate::runs::setup::{self, Sources};
use crate::words::terminal::{say, tell};
use crate::words::{Failure, comparison};

/// The tuner beside which all others are seen.
const RANDOM: &str = "random";
/// What the keys of a tuner's own settings begin with.
const SETTINGS: &str = "tuner.settings.";
/// So long nothing may be told.
const SILENCE: Duration = Duration::from_secs(2);

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
    for law in &args.laws {
        setup::check_preset("--laws", "laws", law, Path::new(law).is_file())?;
    }
    let (settings, others): (Vec<String>, Vec<String>) =
        args.set.iter().cloned().partition(|it| it.starts_with(SETTINGS));
    if let Some(drives) = settings.iter().find(|it| it.starts_with("tuner.settings.drives=")) {
        let why = format!(
            "--set {drives}: all tuners of a comparison have the same budget; give --drives"
        );
        return Err(Failure::User(why));
    }
    let mut laws: Vec<Option<&str>> = args.laws.iter().map(|law| Some(law.as_str())).collect();
    if laws.is_empty() {
        laws.push(args.law.as_deref());
    }
    let mut unused: BTreeSet<&String> = settings.iter().collect();
    let mut studies = Vec::new();
    for law in laws {
        let mut configs = Vec::new();
        for tuner in &tuners {
            let mut layers = layers_of(args, law, tuner, &others)?;
            let known = layers.clone().resolve()?.tuner.settings;
            for setting in &settings {
                // Each of the tuners takes those that it has.
                if is_setting_of(&known, setting) {
                    unused.remove(setting);
                    layers.set(setting)?;
                }
            }
            configs.push(config_of(args, layers, tuner)?);
        }
        studies.push(configs);
    }
    match unused.first() {
        None => Ok(studies),
        Some(setting) => {
            let why = format!("--set {setting}: none of the tuners {} has it", tuners.join(", "));
            Err(Failure::User(why))
        }
    }
}

/// Whether `tuner.settings.KEY=VALUE` is for one of these settings.
fn is_setting_of(known: &Settings, assignment: &str) -> bool {
    let key = assignment.split_once('=').map_or(assignment, |(key, _)| key);
    known.0.contains_key(key[SETTINGS.len()..].trim())
}

fn check_once(option: &str, names: &[String]) -> Result<(), Failure> {
    match names.iter().enumerate().find(|(place, name)| names[..*place].contains(name)) {
        None => Ok(()),
        Some((_, name)) => {
            Err(Failure::User(format!("{option}: names {name} twice; name it once")))
        }
    }
}

fn layers_of(
    args: &CompareArgs,
    law: Option<&str>,
    tuner: &str,
    set: &[String],
) -> Result<Layers, Failure> {
    let sources = Sources {
        path: args.path.as_deref(),
        reading: &args.reading,
        vehicle: args.vehicle.as_deref(),
        law,
        objective: args.objective.as_deref(),
        config: args.config.as_deref(),
        laps: None,
        start: None,
        set,
    };
    let mut layers = setup::layers(args.maneuver.as_deref(), sources, Some(tuner))?;
    if let Some(seed) = args.seed {
        layers.put("--seed", "run.seed", seed as i64)?;
    }
    if args.noise {
        layers.put("--noise", "noise.enabled", true)?;
    }
    put_plants(&mut layers, &args.over)?;
    Ok(layers)
}

fn config_of(args: &CompareArgs, mut layers: Layers, tuner: &str) -> Result<RunConfig, Failure> {
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
    if tuner == SIMULATE_FIRST {
        keep_within(&mut layers)?;
    }
    let mut config = layers.resolve()?;
    setup::check_law(&config.law)?;
    check_own_plants(&config)?;
    // Computed by plain calls, in which the same drive is the same again.
    (config.run.memo, config.run.repeats) = (true, true);
    if config.noise.enabled && config.robust.engage_gear {
        config.vehicle.gear_engaged = true;
    }
    Ok(config)
}

/// Tells how far a comparison is, now and then.
#[derive(Debug)]
pub struct CompareProgress<'a> {
    args: &'a CompareArgs,
    law: &'a str,
    told: Instant,
}

impl<'a> CompareProgress<'a> {
    /// That of the comparison with this law, which begins now.
    pub fn new(args: &'a CompareArgs, law: &'a str) -> Self {
        Self { args, law, told: Instant::now() }
    }

    /// So many sets of the grid are known.
    pub fn tell_grid(&mut self, done: usize, all: usize) {
        if self.told.elapsed() >= SILENCE {
            self.tell(format_args!("{done} of {all} sets of the grid are known"));
        }
    }

    /// So many trainings of a tuner are over.
    pub fn tell_trainings(&mut self, tuner: &str, done: u64) {
        let all = u64::from(self.args.seeds);
        if done == all {
            self.tell(format_args!("{tuner}: {all} trainings are over"));
        } else if self.told.elapsed() >= SILENCE {
            self.tell(format_args!("{tuner}: {done} of {all} trainings are over"));
        }
    }

    fn tell(&mut self, what: Arguments<'_>) {
        self.told = Instant::now();
        if self.args.quiet {
            return;
        }
        match self.args.laws.is_empty() {
            true => tell!("pathtune: {what}"),
            false => tell!("pathtune: {}, {what}", self.law),
        }
    }
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
