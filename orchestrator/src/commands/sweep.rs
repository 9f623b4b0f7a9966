//! `pathtune validate` and `pathtune grid`: lists of drives through the pipeline, and their tables.

use anyhow::Context;
use config::launch::Role;
use config::{Gains, MAX_FLEET, RunConfig, SweepKind, SweepPlan};
use serde_json::Value;

use crate::cli::{GridArgs, SetupArgs, ValidateArgs};
use crate::commands::train::run_or_unmake;
use crate::runs::result::write_result;
use crate::runs::setup::{self, Ended, Folder};
use crate::words::terminal::{say, tell};
use crate::words::{Failure, tables};

/// Drives the paper's gain sets, or the user's, without noise and with it.
///
/// # Errors
/// The user's mistakes, before anything was started; a pipeline that could not be kept alive.
pub fn validate(args: &ValidateArgs) -> Result<Ended, Failure> {
    let mut layers = setup::layers(args.maneuver.as_deref(), &args.setup)?;
    // Whether a drive leaves the road is part of what a validation tells.
    if !args.setup.set.iter().any(|set| set.trim_start().starts_with("collision.enabled")) {
        layers.put("validate", "collision.enabled", true)?;
    }
    let mut config = layers.resolve()?;
    let sets = parse_sets(&args.gains, &config)?;
    let rows = if sets.is_empty() { config.paper_rows().count() } else { sets.len() };
    if rows == 0 {
        let why = "the paper has no gains for this path; name some with --gains Kv,Kl,Ks,Ki";
        return Err(Failure::User(why.to_owned()));
    }
    fill_fleet(&mut config, &args.setup, rows * (args.repeats as usize + 1));
    let plan =
        SweepPlan { kind: SweepKind::Validate, repeats: args.repeats, realtime: false, sets };
    sweep(&args.setup, config, plan, Kind::new("validate", tables::print_validation))
}

/// Drives every gain set of the grid without noise.
///
/// # Errors
/// As [`validate`].
pub fn grid(args: &GridArgs) -> Result<Ended, Failure> {
    let mut config = setup::layers(args.maneuver.as_deref(), &args.setup)?.resolve()?;
    if config.noise.enabled {
        let why = "noise.enabled: a grid is driven without noise; leave it out";
        return Err(Failure::User(why.to_owned()));
    }
    let sets = parse_sets(&args.gains, &config)?;
    if let Some(pair) = sets.iter().position(|set| set.len() != 1) {
        let gains = &args.gains[pair];
        return Err(Failure::User(format!("--gains {gains}: a grid drives one set at a time")));
    }
    let drives = config.grid.len() + sets.len() + 1;
    fill_fleet(&mut config, &args.setup, drives);
    let plan = SweepPlan { kind: SweepKind::Grid, repeats: 0, realtime: false, sets };
    sweep(&args.setup, config, plan, Kind::new("grid", tables::print_grid))
}

/// A fleet in which as many drives as possible are made at once, unless the user wants another.
fn fill_fleet(config: &mut RunConfig, args: &SetupArgs, drives: usize) {
    config.run.fleet = args.fleet.unwrap_or(drives.min(MAX_FLEET) as u32);
}

pub(crate) fn parse_sets(gains: &[String], config: &RunConfig) -> Result<Vec<Vec<Gains>>, Failure> {
    let due = config.maneuvers_due();
    gains
        .iter()
        .map(|text| {
            let fail = |why: String| Failure::User(format!("--gains {text}: {why}"));
            let sets = Gains::parse_sets(text).map_err(fail)?;
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

/// What is particular to a command that makes the drives of a plan.
pub(crate) struct Kind<'a> {
    /// Its name.
    pub(crate) name: &'a str,
    /// Prints what the drives have come to.
    pub(crate) print: fn(&RunConfig, &Value) -> Result<(), Failure>,
    /// One of our services in the vehicle's role, if it is not to be the usual one.
    pub(crate) vehicle: Option<&'a str>,
    /// Said before the first drive.
    pub(crate) note: Option<&'a str>,
}

impl<'a> Kind<'a> {
    fn new(name: &'a str, print: fn(&RunConfig, &Value) -> Result<(), Failure>) -> Self {
        Self { name, print, vehicle: None, note: None }
    }
}

/// Makes the drives of a plan, and prints what they have come to.
pub(crate) fn sweep(
    args: &SetupArgs,
    config: RunConfig,
    plan: SweepPlan,
    kind: Kind,
) -> Result<Ended, Failure> {
    let mut launch = setup::launch(args, Some("schedule"))?;
    if let Some(service) = kind.vehicle {
        launch.fill(Role::Vehicle, service)?;
    }
    let name = format!("{}-{}", kind.name, config.maneuver);
    let ready = setup::prepare(args, config, launch, Some(plan), Folder::New(&name))?;
    // Behind every check of what the user asked for: a mistake is told in one line.
    if let Some(note) = kind.note.filter(|_| !ready.plan.quiet) {
        tell!("{note}");
    }
    let facts = run_or_unmake(&ready, true)?;
    let plan = &ready.plan;
    let result = write_result(&plan.folder, kind.name, &plan.config, &facts)?;
    if args.json {
        say!("{}", serde_json::to_string_pretty(&result).context("result.json")?);
    } else {
        (kind.print)(&plan.config, &result)?;
    }
    Ok(Ended { folder: plan.folder.clone(), json: args.json })
}
