//! `pathtune validate` and `pathtune grid`: run lists of drives through the pipeline, and print their tables.

use anyhow::Context;
use config::launch::Role;
use config::{MAX_FLEET, OverBy, Parameters, RunConfig, SweepKind, SweepPlan};
use outcome::RunResult;

use crate::cli::{GridArgs, SetupArgs, ValidateArgs};
use crate::commands::drive::envelope;
use crate::commands::train::{check_plants, put_plants};
use crate::pipeline::services::Services;
use crate::runs::EndedRun;
use crate::runs::result::{conclude, write_result};
use crate::runs::running::{RunFacts, run_or_unmake};
use crate::runs::setup::{self, Folder, Ready};
use crate::runs::state::CAR_FILE;
use crate::words::Failure;
use crate::words::terminal::tell;

/// Drives the paper's gain sets, or the user's, without noise and with it.
///
/// # Errors
/// On a user's mistake, before anything is started; if the pipeline cannot be kept alive.
pub(crate) fn validate(args: &ValidateArgs, services: Services) -> Result<EndedRun, Failure> {
    let (config, plan) = resolve_validation(args)?;
    sweep(&args.setup, config, services, plan, Kind::named("validate"))
}

/// The same without a word on standard output, and without a report.
///
/// # Errors
/// As [`validate`]; [`Failure::Interrupted`] if it was stopped.
pub(crate) fn validate_silently(
    args: &ValidateArgs,
    services: Services,
) -> Result<RunResult, Failure> {
    let (config, plan) = resolve_validation(args)?;
    let (ready, facts) = run_plan(&args.setup, config, services, plan, Kind::named("validate"))?;
    if let Some(signal) = facts.pipeline.stopped_by {
        return Err(Failure::Interrupted(signal, "begin it again".to_owned()));
    }
    write_result(&ready.plan, &facts)
}

/// The configuration of a validation and its list of drives, from its options.
///
/// # Errors
/// On a user's mistake.
pub(crate) fn resolve_validation(args: &ValidateArgs) -> Result<(RunConfig, SweepPlan), Failure> {
    let mut layers = setup::layers(args.maneuver.as_deref(), &args.setup, None)?;
    // A validation also reports whether a drive leaves the road.
    if !args.setup.set.iter().any(|set| set.trim_start().starts_with("collision.enabled")) {
        layers.put("validate", "collision.enabled", true)?;
    }
    let mut config = layers.resolve()?;
    let sets = parse_sets(&args.gains, &config)?;
    let rows = if sets.is_empty() { config.paper_rows().len() } else { sets.len() };
    if rows == 0 {
        let why = no_paper_gains(&config);
        return Err(Failure::User(format!("{why}; give some with --gains {}", list(&config))));
    }
    if let Some(file) = &args.envelope {
        let [set] = &sets[..] else {
            return Err(Failure::User(format!(
                "--envelope {}: an envelope is for one set; give that one with --gains {}",
                file.display(),
                list(&config)
            )));
        };
        config.envelope = Some(Box::new(envelope(file, &config, set)?));
    }
    fill_fleet(&mut config, &args.setup, rows * (args.repeats as usize + 1));
    let plan = plan(&config, SweepKind::Validate, args.repeats, &sets);
    Ok((config, plan))
}

/// Drives every gain set of the grid: without noise, but over plants with it where that is asked for.
///
/// # Errors
/// As [`validate`].
pub(crate) fn grid(args: &GridArgs, services: Services) -> Result<EndedRun, Failure> {
    let mut layers = setup::layers(args.maneuver.as_deref(), &args.setup, None)?;
    put_plants(&mut layers, &args.over)?;
    if args.noise {
        layers.put("--noise", "noise.enabled", true)?;
    }
    let mut config = layers.resolve()?;
    setup::check_law(&config.law)?;
    if config.steps_differ() {
        let why = "noise.enabled: a grid is driven without noise, unless it is driven over plants; leave this key out, or \
                   add --over";
        return Err(Failure::User(why.to_owned()));
    }
    if config.over.by != OverBy::Nominal {
        check_plants(&config, &setup::launch(&args.setup, services, Some("schedule"))?)?;
    }
    if config.noise.enabled && config.robust.engage_gear {
        config.vehicle.gear_engaged = true;
    }
    let sets = parse_sets(&args.gains, &config)?;
    if let Some(pair) = sets.iter().position(|set| set.len() != 1) {
        let gains = &args.gains[pair];
        return Err(Failure::User(format!("--gains {gains}: a grid drives one set at a time")));
    }
    let drives = (config.grid().len() + sets.len() + 1) * config.drives_of_step();
    fill_fleet(&mut config, &args.setup, drives);
    let plan = plan(&config, SweepKind::Grid, 0, &sets);
    sweep(&args.setup, config, services, plan, Kind::named("grid"))
}

/// Makes the fleet large enough for as many drives as possible at once, unless the user has chosen its size.
fn fill_fleet(config: &mut RunConfig, args: &SetupArgs, drives: usize) {
    config.run.fleet = args.fleet.unwrap_or(drives.min(MAX_FLEET) as u32);
}

/// Parses the values of `--gains`: each is one set for all manoeuvres of the path, or one set for each of them.
pub(crate) fn parse_sets(
    gains: &[String],
    config: &RunConfig,
) -> Result<Vec<Vec<Parameters>>, Failure> {
    let due = config.maneuvers_due();
    gains
        .iter()
        .map(|text| {
            let fail = |why: String| Failure::User(format!("--gains {text}: {why}"));
            let sets = config.law.parse_sets(text).map_err(fail)?;
            if sets.len() != 1 && sets.len() != due.len() {
                let names = due.join(", ");
                return Err(fail(format!(
                    "holds {} sets; give one, or one for each of {names}",
                    sets.len()
                )));
            }
            Ok(sets)
        })
        .collect()
}

/// Says why there are no gains of the paper to drive.
pub(crate) fn no_paper_gains(config: &RunConfig) -> String {
    match &*config.law.name {
        "paper" => "the paper has no gains for this path".to_owned(),
        law => format!("the paper has no gains for the law {law}"),
    }
}

/// The names of a set's numbers, as they are typed after `--gains`.
pub(crate) fn list(config: &RunConfig) -> String {
    config.law.symbol_list()
}

/// The list of drives with these sets, in the form in which the pipeline reads it.
pub(crate) fn plan(
    config: &RunConfig,
    kind: SweepKind,
    repeats: u32,
    sets: &[Vec<Parameters>],
) -> SweepPlan {
    let named = |set: &Vec<Parameters>| set.iter().map(|set| config.law.named(set)).collect();
    SweepPlan { kind, repeats, realtime: false, sets: sets.iter().map(named).collect() }
}

/// What is specific to a command that makes the drives of a plan.
pub(crate) struct Kind<'a> {
    /// Its name.
    pub(crate) name: &'a str,
    /// The service in the vehicle's role, if it is not the usual one: `--adapter`.
    pub(crate) vehicle: Option<&'a str>,
    /// Printed before the first drive.
    pub(crate) note: Option<&'a str>,
    /// What is known of the car since its envelope was calibrated; for whoever looks at the run from another terminal.
    pub(crate) car: Option<&'a str>,
}

impl<'a> Kind<'a> {
    fn named(name: &'a str) -> Self {
        Self { name, vehicle: None, note: None, car: None }
    }
}

/// Makes the drives of a plan, and prints their results.
pub(crate) fn sweep(
    args: &SetupArgs,
    config: RunConfig,
    services: Services,
    plan: SweepPlan,
    kind: Kind,
) -> Result<EndedRun, Failure> {
    let (ready, facts) = run_plan(args, config, services, plan, kind)?;
    conclude(&ready.plan, &facts, args.json)
}

/// Makes the drives of a plan. While the first of the two is held, the run's folder is locked.
fn run_plan(
    args: &SetupArgs,
    config: RunConfig,
    services: Services,
    plan: SweepPlan,
    kind: Kind,
) -> Result<(Ready, RunFacts), Failure> {
    let mut launch = setup::launch(args, services, Some("schedule"))?;
    if let Some(name) = kind.vehicle {
        services
            .named(Role::Vehicle, name)
            .map_err(|why| Failure::User(format!("--adapter {name}: {why}")))?;
        // Only our simulator is deterministic.
        launch.fill(Role::Vehicle, name, name == services.usual(Role::Vehicle).name);
    }
    let name = format!("{}-{}", kind.name, config.maneuver);
    let ready = setup::prepare(args, config, launch, services, Some(plan), Folder::New(&name))?;
    // Printed after all checks of the user's options: a mistake is reported in a single line.
    if let Some(note) = kind.note.filter(|_| !ready.plan.quiet) {
        tell!("{note}");
    }
    if let Some(words) = kind.car {
        let file = ready.plan.folder.join(CAR_FILE);
        std::fs::write(&file, format!("{words}\n"))
            .with_context(|| format!("failed to write {}", file.display()))?;
    }
    let facts = run_or_unmake(&ready, true)?;
    Ok((ready, facts))
}
