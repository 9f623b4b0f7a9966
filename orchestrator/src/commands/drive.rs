//! `pathtune drive`: one drive with given gains, through the same pipeline, in lockstep or by the clock.

use std::fs;
use std::path::Path;

use config::{Gains, RunConfig, SweepKind, SweepPlan, TunedGains, check_gains};
use serde_json::Value;

use crate::cli::DriveArgs;
use crate::commands::sweep::{Kind, parse_sets, sweep};
use crate::runs::setup::{self, Ended};
use crate::words::Failure;
use crate::words::tables;

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
    let (set, origin) = choose(args, &config)?;
    let note = describe(&config, &set, &origin);
    config.run.fleet = 1;
    let realtime = config.run.realtime;
    let plan = SweepPlan { kind: SweepKind::Drive, repeats: 0, realtime, sets: vec![set] };
    let kind = Kind {
        name: "drive",
        print: tables::print_drive,
        vehicle: args.adapter.as_deref(),
        note: Some(&note),
    };
    sweep(&args.setup, config, plan, kind)
}

/// The gains to drive with, and where they come from: named ones, those of trainings, those that were promoted to the
/// vehicle, or the paper's.
fn choose(args: &DriveArgs, config: &RunConfig) -> Result<(Vec<Gains>, String), Failure> {
    if let Some(text) = &args.gains {
        let set = parse_sets(std::slice::from_ref(text), config)?.remove(0);
        return Ok((set, "--gains".to_owned()));
    }
    if !args.from.is_empty() {
        let names: Vec<String> = args.from.iter().map(|run| run.display().to_string()).collect();
        return Ok((from_trainings(&args.from, config)?, names.join(", ")));
    }
    if let Some(promoted) = promoted(config) {
        return Ok(promoted);
    }
    let missing = missing(config);
    let chosen = config.paper_rows().find(|row| row.chosen);
    let paper = chosen.map(|row| (row.gains.clone(), format!("the paper{missing}")));
    paper.ok_or_else(|| {
        Failure::User(format!(
            "the paper has no gains for this path{missing}; name some with --gains Kv,Kl,Ks,Ki, or a training with \
             --from RUN"
        ))
    })
}

/// The gains that were promoted to the vehicle: for each manoeuvre that is due, or for the path as a whole.
fn promoted(config: &RunConfig) -> Option<(Vec<Gains>, String)> {
    let of = |maneuver: &str| config.vehicle.gains.get(maneuver);
    let due = config.maneuvers_due();
    let sets: Vec<&TunedGains> = match due.iter().map(|name| of(name)).collect() {
        Some(sets) => sets,
        None => vec![of(&config.maneuver)?],
    };
    let origins: Vec<String> = sets
        .iter()
        .map(|set| match &set.provenance {
            Some(it) => format!("run {}, digest {:.12}", it.run, it.digest),
            None => "by hand".to_owned(),
        })
        .collect();
    let origin = format!("{} ({})", config.vehicle_preset, origins.join("; "));
    Some((sets.into_iter().map(TunedGains::gains).collect(), origin))
}

/// Which promoted gains were of no use, and why.
fn missing(config: &RunConfig) -> String {
    let held = &config.vehicle.gains;
    if held.is_empty() {
        return String::new();
    }
    let names: Vec<&str> =
        config.maneuvers_due().into_iter().filter(|name| !held.contains_key(*name)).collect();
    format!(", as {} has none for {}", config.vehicle_preset, names.join(", "))
}

/// Which gains a drive takes, and where from.
fn describe(config: &RunConfig, set: &[Gains], origin: &str) -> String {
    let numbers = |gains: &Gains| gains.to_array().map(tables::trim).join(" ");
    let each: Vec<String> = match set {
        [one] => vec![numbers(one)],
        _ => {
            let due = config.maneuvers_due();
            due.iter().zip(set).map(|(name, gains)| format!("{name} {}", numbers(gains))).collect()
        }
    };
    format!("gains {} from {origin}", each.join(", "))
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
