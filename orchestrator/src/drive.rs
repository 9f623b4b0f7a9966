//! `pathtune drive`: one drive with given gains, through the same pipeline, in lockstep or by the clock.

use std::fs;
use std::path::Path;

use config::{Gains, RunConfig, SweepKind, SweepPlan, check_gains};
use serde_json::Value;

use crate::Failure;
use crate::cli::DriveArgs;
use crate::setup::{self, Ended};
use crate::sweep::{parse_sets, sweep};
use crate::tables;

/// Drives once.
///
/// # Errors
/// The user's mistakes, before anything was started; a pipeline that could not be kept alive.
pub fn drive(args: &DriveArgs) -> Result<Ended, Failure> {
    let mut layers = setup::layers(args.maneuver.as_deref(), &args.setup)?;
    if args.noise {
        layers.put("--noise", "noise.enabled", true)?;
    }
    if args.realtime || args.adapter.is_some() {
        layers.put("--realtime", "run.realtime", true)?;
    }
    let mut config = layers.resolve()?;
    let set = choose(args, &config)?;
    config.run.fleet = 1;
    let realtime = config.run.realtime;
    let plan = SweepPlan { kind: SweepKind::Drive, repeats: 0, realtime, sets: vec![set] };
    let name = format!("drive-{}", config.maneuver);
    sweep(&args.setup, args.adapter.as_deref(), config, plan, &name, "drive", tables::print_drive)
}

/// The gains to drive with: named ones, those of trainings, or the paper's.
fn choose(args: &DriveArgs, config: &RunConfig) -> Result<Vec<Gains>, Failure> {
    if let Some(text) = &args.gains {
        return Ok(parse_sets(std::slice::from_ref(text), config)?.remove(0));
    }
    if !args.from.is_empty() {
        return from_trainings(&args.from, config);
    }
    let chosen = config.paper_rows().find(|row| row.chosen);
    chosen.map(|row| row.gains.clone()).ok_or_else(|| {
        let why = "the paper has no gains for this path; name some with --gains Kv,Kl,Ks,Ki, or a training with \
                   --from RUN";
        Failure::User(why.to_owned())
    })
}

/// The tuned gains of trainings: of a single one for the whole path, or of one for each manoeuvre that is due.
fn from_trainings(runs: &[impl AsRef<Path>], config: &RunConfig) -> Result<Vec<Gains>, Failure> {
    let mut tuned = Vec::new();
    for run in runs {
        tuned.push(tuned_gains(run.as_ref())?);
    }
    if let [(_, gains)] = tuned[..] {
        return Ok(vec![gains]);
    }
    config
        .maneuvers_due()
        .into_iter()
        .map(|due| {
            let found = tuned.iter().find(|(maneuver, _)| maneuver == due).map(|(_, gains)| *gains);
            found.ok_or_else(|| {
                let names: Vec<_> = tuned.iter().map(|(maneuver, _)| maneuver.as_str()).collect();
                Failure::User(format!(
                    "--from: the path asks for {due}, and the trainings are of {}",
                    names.join(", ")
                ))
            })
        })
        .collect()
}

/// The manoeuvre and the tuned gains of a finished training.
pub(crate) fn tuned_gains(run: &Path) -> Result<(String, Gains), Failure> {
    let path = run.join("result.json");
    let wrong = |why: &str| Failure::User(format!("--from {}: {why}", path.display()));
    let text = fs::read(&path).map_err(|error| {
        wrong(&format!("{error}; name the folder of a training that has come to its end"))
    })?;
    let result: Value = serde_json::from_slice(&text).map_err(|error| wrong(&error.to_string()))?;
    if result["kind"] != "train" {
        return Err(wrong("is not the result of a training"));
    }
    let gains = Gains::from_array(
        Gains::NAMES.map(|name| result["gains"][name].as_f64().unwrap_or(f64::NAN)),
    );
    check_gains(gains).map_err(|(name, problem)| wrong(&format!("gains.{name} {problem}")))?;
    Ok((result["maneuver"].as_str().unwrap_or_default().to_owned(), gains))
}
