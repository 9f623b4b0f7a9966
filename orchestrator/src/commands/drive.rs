//! `pathtune drive`: one drive with given gains, through the same pipeline, in lockstep or by the clock.

use std::path::{Path, PathBuf};

use config::promote::geometry_difference;
use config::slots::{self, Held};
use config::{
    Envelope, MadeFor, Parameters, RunConfig, SweepKind, SweepPlan, TunedGains, Vehicle, read_small,
};
use outcome::{Outcome, RESULT_FILE, read_result};

use crate::cli::DriveArgs;
use crate::commands::envelopes::of_promoted;
use crate::commands::sweep::{Kind, list, no_paper_gains, parse_sets, plan, sweep};
use crate::doorway::RegionsOf;
use crate::pipeline::services::Services;
use crate::runs::EndedRun;
use crate::runs::folder::resolved_config;
use crate::runs::setup;
use crate::words::Failure;
use crate::words::tables;
use crate::words::terminal::tell_once;

/// What a drive needs of the tools that know more than the orchestrator.
#[derive(Clone, Copy)]
pub(crate) struct DriveTools {
    /// The regions to which changes of gains are held.
    pub(crate) regions: RegionsOf,
    /// What an envelope's file has seen of its car, in words.
    pub(crate) evidence: fn(&Path) -> Result<String, Failure>,
}

/// Drives once. Also returns the file of the envelope to which the drive was held.
///
/// # Errors
/// On a user's mistake, before anything is started; if the pipeline cannot be kept alive.
pub(crate) fn drive(
    args: &DriveArgs,
    services: Services,
    tools: DriveTools,
) -> Result<(EndedRun, Option<PathBuf>), Failure> {
    let mut layers = setup::layers(args.maneuver.as_deref(), &args.setup, None)?;
    if args.noise {
        layers.put("--noise", "noise.enabled", true)?;
    }
    if args.realtime || args.adapter.is_some() {
        layers.put("--realtime", "run.realtime", true)?;
    }
    let mut config = layers.resolve()?;
    let (set, origin) = choose(args.gains.as_ref(), &args.from, &config)?;
    let mut note = describe(&config, &set, &origin);
    let mut held_to = args.envelope.clone();
    if let Some(file) = &args.envelope {
        config.envelope = Some(Box::new(envelope(file, &config, &set)?));
    } else if args.gains.is_none() && args.from.is_empty() && !config.vehicle.gains.is_empty() {
        match of_promoted(&config, &set)? {
            Some(Ok((file, envelope))) => {
                note += &format!("; held to {}, --only-judge does not stop it", file.display());
                config.envelope = Some(Box::new(envelope));
                held_to = Some(file);
            }
            Some(Err(why)) => note += &format!("; {why}"),
            None => {}
        }
    }
    config.envelope_only_judges = args.only_judge && config.envelope.is_some();
    if args.hold_switches {
        note += &hold_switches(&mut config, &set, tools.regions)?;
    }
    let car = held_to.as_deref().map(tools.evidence).transpose()?;
    config.run.fleet = 1;
    let realtime = config.run.realtime;
    let plan = SweepPlan { realtime, ..plan(&config, SweepKind::Drive, 0, &[set]) };
    let (vehicle, note) = (args.adapter.as_deref(), Some(&*note));
    let kind = Kind { name: "drive", vehicle, note, car: car.as_deref() };
    Ok((sweep(&args.setup, config, services, plan, kind)?, held_to))
}

/// Holds the changes of gains along the path to certified regions; returns how many, in words.
fn hold_switches(
    config: &mut RunConfig,
    sets: &[Parameters],
    regions_of: RegionsOf,
) -> Result<String, Failure> {
    let wrong = |why: &str| Failure::User(format!("--hold-switches: {why}; leave it out"));
    if sets.len() == 1 {
        return Err(wrong("the gains do not change along the path"));
    }
    config.switch_regions = regions_of(config, sets).map_err(|why| wrong(&why))?;
    let held = config.switch_regions.len();
    if held == 0 {
        return Err(wrong("no zone's gains have a certified region where it begins"));
    }
    let zones = config.path.zones.len();
    Ok(format!("; they change only within the certified regions of {held} of {zones} zones"))
}

/// Reads an envelope, which must be one for this drive.
pub(crate) fn envelope(
    file: &Path,
    config: &RunConfig,
    sets: &[Parameters],
) -> Result<Envelope, Failure> {
    let user = |why: String| Failure::User(format!("--envelope {}: {why}", file.display()));
    let text = read_small(file).map_err(|why| user(why.to_string()))?;
    let envelope = Envelope::parse(&text).map_err(user)?;
    let gains = sets.iter().map(|set| config.law.named(set)).collect();
    if let Some((what, there, here)) = envelope.made_for.difference(&MadeFor::of(config, gains)) {
        return Err(user(format!(
            "was calibrated for another drive: its {what} is {there}, and here it is {here}; calibrate one for this drive"
        )));
    }
    Ok(envelope)
}

/// The parameters to drive with, and where they come from: named ones, those of trainings, those that were promoted to
/// the vehicle, the paper's, or the defaults of another law.
pub(crate) fn choose(
    gains: Option<&String>,
    from: &[PathBuf],
    config: &RunConfig,
) -> Result<(Vec<Parameters>, String), Failure> {
    if let Some(text) = gains {
        let set = parse_sets(std::slice::from_ref(text), config)?.remove(0);
        return Ok((set, "--gains".to_owned()));
    }
    if !from.is_empty() {
        let names: Vec<String> = from.iter().map(|run| run.display().to_string()).collect();
        return Ok((from_trainings(from, config)?, names.join(", ")));
    }
    if let Some(promoted) = promoted(config)? {
        return Ok(promoted);
    }
    let missing = missing(config);
    if let Some(row) = config.paper_rows().into_iter().find(|row| row.chosen) {
        return Ok((row.sets, format!("the paper{missing}")));
    }
    let law = &config.law;
    if law.name != "paper" {
        let origin = format!("the defaults of the law {}{missing}", config.law_preset);
        return Ok((vec![law.defaults()], origin));
    }
    Err(Failure::User(format!(
        "{}{missing}; give some with --gains {}, or a training with --from RUN",
        no_paper_gains(config),
        list(config)
    )))
}

/// The parameters that were promoted to the vehicle: for each manoeuvre that is due, or for the path as a whole.
fn promoted(config: &RunConfig) -> Result<Option<(Vec<Parameters>, String)>, Failure> {
    let of = |name: &str| slots::held(&config.vehicle.gains, name, &config.law.name);
    let is_of_own_path =
        |set: &TunedGains| set.provenance.as_ref().is_some_and(|it| it.path_hash.is_some());
    let of_others = |name: &str| {
        Failure::User(format!(
            "{}: gains.{name} are for another path, which has the same name; train on this one, or give parameters with \
             --gains {}",
            config.vehicle_preset,
            list(config)
        ))
    };
    let due = config.maneuvers_due();
    let sets: Option<Vec<(&String, &TunedGains)>> = match config.gains_name() == config.path.name {
        // The path has no manoeuvres of its own.
        true => None,
        false => due.iter().map(|name| of(name)).collect(),
    };
    let mut unknown = "";
    let sets = match (sets, config.gains_of_path()) {
        (Some(sets), _) => {
            if let Some((name, _)) = sets.iter().find(|(_, set)| is_of_own_path(set)) {
                return Err(of_others(name));
            }
            sets
        }
        (None, Some(Held::Own(name, set))) => vec![(name, set)],
        (None, Some(Held::Unknown(name, set))) => {
            unknown = ", which does not say for which path they are";
            vec![(name, set)]
        }
        (None, Some(Held::Others(name, _))) => return Err(of_others(name)),
        (None, None) => return Ok(None),
    };
    let origins: Vec<String> = sets
        .iter()
        .map(|(_, set)| match &set.provenance {
            Some(it) => format!("run {}, digest {:.12}", it.run, it.digest),
            None => "by hand".to_owned(),
        })
        .collect();
    let origin = format!("{} ({}){unknown}", config.vehicle_preset, origins.join("; "));
    let parameters = sets.into_iter().map(|(maneuver, set)| {
        let what = format!("{}: gains.{maneuver}", config.vehicle_preset);
        let compensated = set.provenance.as_ref().and_then(|it| it.compensate_dead_time);
        if let Some(theirs) = compensated {
            tell_compensation(&what, theirs, config);
        }
        check_law(&what, &set.law, config)?;
        config
            .law
            .parameters_of(&set.parameters)
            .map_err(|(key, problem)| Failure::User(format!("{what}: {key} {problem}")))
    });
    Ok(Some((parameters.collect::<Result<_, _>>()?, origin)))
}

/// Refuses parameters of a law other than the one that is to drive; `what` names them in the error.
fn check_law(what: &str, law: &str, config: &RunConfig) -> Result<(), Failure> {
    let ours = &config.law.name;
    if law == ours {
        return Ok(());
    }
    Err(Failure::User(format!(
        "{what} are parameters of the law {law}, but the law {ours} is to drive; add --law {law}, or give parameters \
         of {ours} with --gains {}",
        list(config)
    )))
}

/// Says which promoted gains are missing.
fn missing(config: &RunConfig) -> String {
    let held = &config.vehicle.gains;
    if held.is_empty() {
        return String::new();
    }
    let whole = config.gains_name();
    let due = match whole == config.path.name {
        true => vec![&*whole],
        false => config.maneuvers_due(),
    };
    let names: Vec<&str> = due.into_iter().filter(|name| !held.contains_key(*name)).collect();
    format!(", as {} has none for {}", config.vehicle_preset, names.join(", "))
}

/// Says which parameters a drive uses, and where they come from.
pub(crate) fn describe(config: &RunConfig, set: &[Parameters], origin: &str) -> String {
    let numbers = |set: &Parameters| {
        let numbers = config.law.values(set).iter().map(|value| tables::trim(*value));
        numbers.collect::<Vec<_>>().join(" ")
    };
    let each: Vec<String> = match set {
        [one] => vec![numbers(one)],
        _ => {
            let due = config.maneuvers_due();
            due.iter().zip(set).map(|(name, set)| format!("{name} {}", numbers(set))).collect()
        }
    };
    format!("gains {} from {origin}", each.join(", "))
}

/// The tuned parameters of trainings: of a single one for the whole path, or of one for each manoeuvre that is due.
fn from_trainings(runs: &[PathBuf], config: &RunConfig) -> Result<Vec<Parameters>, Failure> {
    let mut tuned = Vec::new();
    for run in runs {
        tuned.push(tuned_parameters(run, config, "--from ")?);
    }
    if let [(_, set)] = tuned[..] {
        tell_what_differs(&runs[0], config);
        return Ok(vec![set]);
    }
    config
        .maneuvers_due()
        .into_iter()
        .map(|due| {
            let found = tuned.iter().find(|(maneuver, _)| maneuver == due).map(|(_, set)| *set);
            found.ok_or_else(|| {
                let names: Vec<_> = tuned.iter().map(|(maneuver, _)| maneuver.as_str()).collect();
                Failure::User(format!(
                    "--from: the path needs {due}, but the trainings are of {}",
                    names.join(", ")
                ))
            })
        })
        .collect()
}

/// Tells in what this drive differs from the training that its gains come from, as far as that one can be read.
fn tell_what_differs(run: &Path, config: &RunConfig) {
    let file = run.join("config.toml");
    let text = config::read_small(&file).ok();
    let Some(of) = text.and_then(|it| resolved_config(&file.display().to_string(), &it).ok())
    else {
        return;
    };
    let run = run.display();
    let is_other_path = match of.is_own_path() && config.is_own_path() {
        true => of.path_hash() != config.path_hash(),
        false => of.maneuver != config.maneuver,
    };
    if is_other_path {
        tell_once(&format!("--from {run}: its gains were found on another path"));
    }
    if of.vehicle.name != config.vehicle.name {
        let (theirs, ours) = (&of.vehicle.name, &config.vehicle.name);
        tell_once(&format!(
            "--from {run}: its gains were found for {theirs}, and this drives {ours}"
        ));
    } else if let Some((key, then, now)) = vehicle_difference(&of.vehicle, &config.vehicle) {
        tell_once(&format!(
            "--from {run}: its gains were found for a vehicle whose {key} was {then}, and here it is {now}"
        ));
    }
    tell_compensation(&format!("--from {run}"), of.controller.compensate_dead_time, config);
}

/// The first value by which vehicles of one name differ in how they follow commands.
fn vehicle_difference(a: &Vehicle, b: &Vehicle) -> Option<(&'static str, String, String)> {
    let others = [
        ("steering_delay_s", a.steering_delay_s, b.steering_delay_s),
        ("steering_lag_s", a.steering_lag_s, b.steering_lag_s),
        ("steering_gain", a.steering_gain, b.steering_gain),
        ("steering_offset_rad", a.steering_offset_rad, b.steering_offset_rad),
        ("speed_delay_s", a.speed_delay_s, b.speed_delay_s),
    ];
    let differs = others.into_iter().find(|(_, a, b)| a != b);
    geometry_difference(a, b)
        .or_else(|| differs.map(|(key, a, b)| (key, a.to_string(), b.to_string())))
}

/// Tells if gains were found with the dead time compensated, and this drives without, or the other way around.
fn tell_compensation(whose: &str, theirs: bool, config: &RunConfig) {
    let ours = config.controller.compensate_dead_time;
    if theirs != ours {
        tell_once(&format!(
            "{whose}: these gains were found with controller.compensate_dead_time = {theirs}, and this drives with {ours}"
        ));
    }
}

/// The manoeuvre and the tuned parameters of a finished training; `option` stands before its name in errors.
pub(crate) fn tuned_parameters(
    run: &Path,
    config: &RunConfig,
    option: &str,
) -> Result<(String, Parameters), Failure> {
    let path = run.join(RESULT_FILE);
    let wrong = |why: String| Failure::User(format!("{option}{}: {why}", path.display()));
    let decided = match read_result(run) {
        Ok(result) => result.decided,
        Err(outcome::OutcomeError::Io { source, .. }) => {
            let why = format!("{source}; name the folder of a finished training");
            return Err(wrong(why));
        }
        Err(error) => return Err(Failure::User(format!("{option}{error}"))),
    };
    let Outcome::Train(training) = &decided.outcome else {
        return Err(wrong("is not the result of a training".to_owned()));
    };
    check_law(&format!("{option}{}: its gains", path.display()), &decided.law, config)?;
    let set = config.law.parameters_of(&training.gains);
    let set = set.map_err(|(key, problem)| wrong(format!("gains.{key} {problem}")))?;
    Ok((decided.maneuver, set))
}
