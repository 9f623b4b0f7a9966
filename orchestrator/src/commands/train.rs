//! `pathtune train`: from options to a result.

use std::path::Path;

use config::launch::Launch;
use config::{Layers, RunConfig, SweepPlan};
use outcome::RunResult;

use crate::cli::{OverArgs, TrainArgs};
use crate::pipeline::services::Services;
use crate::runs::EndedRun;
use crate::runs::folder::of_earlier_start;
use crate::runs::result::{conclude, write_result};
use crate::runs::running::{RunFacts, run_or_unmake};
use crate::runs::setup::{self, Folder, Ready};
use crate::words::Failure;
use crate::words::terminal::tell_once;

/// The tuner of `--simulate-first`.
pub(super) const SIMULATE_FIRST: &str = "simulate-first";

/// Runs a training to its end, or resumes one that was interrupted.
///
/// # Errors
/// On a user's mistake, before anything is started; if the pipeline cannot be kept alive.
pub(crate) fn train(args: &TrainArgs, services: Services) -> Result<EndedRun, Failure> {
    let (ready, facts) = run_training(args, services)?;
    conclude(&ready.plan, &facts, args.setup.json)
}

/// The same without a word on standard output, and without a report.
///
/// # Errors
/// As [`train`].
pub(crate) fn train_silently(args: &TrainArgs, services: Services) -> Result<RunResult, Failure> {
    let (ready, facts) = run_training(args, services)?;
    write_result(&ready.plan, &facts)
}

/// Runs a training to its end. While the first of the two is held, its folder is locked.
fn run_training(args: &TrainArgs, services: Services) -> Result<(Ready, RunFacts), Failure> {
    let (config, launch) = match &args.resume {
        Some(folder) => resolved_before(folder, services)?,
        None => {
            let launch = setup::launch(&args.setup, services, None)?;
            (resolve_training(args, &launch)?, launch)
        }
    };
    let name = config.maneuver.clone();
    let folder = args.resume.as_deref().map_or(Folder::New(&name), Folder::Old);
    let ready = setup::prepare(&args.setup, config, launch, services, None, folder)?;
    let facts = run_or_unmake(&ready, args.resume.is_none()).map_err(|failure| match failure {
        Failure::GaveUp(why) => {
            let folder = ready.plan.folder.display();
            Failure::GaveUp(format!("{why}\ngo on with: pathtune train --resume {folder}"))
        }
        other => other,
    })?;
    if let Some(signal) = facts.pipeline.stopped_by {
        let folder = ready.plan.folder.display();
        let way_on = format!("go on with: pathtune train --resume {folder}");
        return Err(Failure::Interrupted(signal, way_on));
    }
    Ok((ready, facts))
}

/// The configuration and processes of a training that was interrupted.
fn resolved_before(folder: &Path, services: Services) -> Result<(RunConfig, Launch), Failure> {
    if folder.join(SweepPlan::FILE).exists() {
        let problem = "not a training; start a validation or a grid from the beginning instead";
        return Err(Failure::User(format!("--resume {}: {problem}", folder.display())));
    }
    let (config, launch) = of_earlier_start(folder, "--resume", "no training to go on with")?;
    services.check(&format!("--resume {}", folder.join("launch.toml").display()), &launch)?;
    Ok((config, launch))
}

/// The distance from the path within which sets stay that are driven after they were simulated.
const WITHIN: &str = "tuner.settings.within_m";

/// Keeps a tuner that simulates first to sets that the supervisor would not stop, if nobody has said how near they are to
/// stay: a small car is stopped before it is a metre off, and there a metre would let every set pass.
pub(super) fn keep_within(layers: &mut Layers) -> Result<(), Failure> {
    if layers.is_set(WITHIN) {
        return Ok(());
    }
    let config = layers.clone().resolve()?;
    let within_m = config.path_distance_limit_m().min(config.tuner.settings.number("within_m"));
    Ok(layers.put("--simulate-first", WITHIN, within_m)?)
}

/// Refuses a tuner that has plants of its own together with others.
pub(super) fn check_own_plants(config: &RunConfig) -> Result<(), Failure> {
    if config.learning.tuner != SIMULATE_FIRST || config.plants() == 1 {
        return Ok(());
    }
    let why = "over.by: the tuner simulate-first has plants of its own, tuner.settings.plants of them; leave it \"nominal\"";
    Err(Failure::User(why.to_owned()))
}

/// The configuration of a training, from its options.
///
/// # Errors
/// On a user's mistake.
pub(crate) fn resolve_training(args: &TrainArgs, launch: &Launch) -> Result<RunConfig, Failure> {
    let tuner = match args.simulate_first {
        Some(_) => Some(SIMULATE_FIRST),
        None => args.tuner.as_deref(),
    };
    let mut layers = setup::layers(args.maneuver.as_deref(), &args.setup, tuner)?;
    if let Some(plants) = args.simulate_first {
        layers.put("--simulate-first", "tuner.settings.plants", i64::from(plants))?;
    }
    if let Some(within_m) = args.within {
        if tuner != Some(SIMULATE_FIRST) {
            let why = "--within: keeps to sets that were simulated first; add --simulate-first N";
            return Err(Failure::User(why.to_owned()));
        }
        layers.put("--within", WITHIN, within_m)?;
    } else if tuner == Some(SIMULATE_FIRST) {
        keep_within(&mut layers)?;
    }
    if let Some(alphas) = &args.alphas {
        layers.put("--alphas", "run.alphas", alphas.clone())?;
    }
    if let Some(seed) = args.seed {
        layers.put("--seed", "run.seed", seed as i64)?;
    }
    if let Some(fleet) = args.setup.fleet {
        layers.put("--fleet", "run.fleet", i64::from(fleet))?;
    }
    if let Some(episodes) = args.episodes {
        layers.put("--episodes", "learning.episodes", i64::from(episodes))?;
    }
    if args.noise {
        layers.put("--noise", "noise.enabled", true)?;
    }
    if args.no_memo {
        layers.put("--no-memo", "run.memo", false)?;
    }
    if let Some(drives) = args.drives {
        let config = layers.clone().resolve()?;
        if !config.tuner.has_budget() {
            return Err(Failure::User(format!(
                "--drives: the tuner {} has no budget of drives; say how long it trains by --episodes and \
                 learning.step_limit, or choose another --tuner: see `pathtune config list`",
                config.learning.tuner
            )));
        }
        layers.put("--drives", "tuner.settings.drives", i64::from(drives))?;
    }
    if args.over.over.is_some() {
        put_plants(&mut layers, &args.over)?;
        check_plants(&layers.clone().resolve()?, launch)?;
    }
    let mut config = layers.resolve()?;
    setup::check_law(&config.law)?;
    if args.episodes.is_some()
        && let Some(drives) = config.tuner.settings.0.get("drives")
    {
        tell_once(&format!(
            "--episodes: the tuner {} has none and makes {drives} drives (--drives); only what stands beside it is trained so \
             long",
            config.learning.tuner
        ));
    }
    check_own_plants(&config)?;
    // Drives that do not repeat must not stand in for each other.
    config.run.repeats &= launch.repeats() && !config.run.realtime;
    config.run.memo &= config.run.repeats;
    if config.noise.enabled && config.robust.engage_gear {
        config.vehicle.gear_engaged = true;
    }
    Ok(config)
}

/// Puts the plants of the command line on top.
///
/// # Errors
/// If their file is not one of plants.
pub(crate) fn put_plants(layers: &mut Layers, args: &OverArgs) -> Result<(), Failure> {
    let Some(over) = &args.over else { return Ok(()) };
    layers.put("--over", "over.by", args.over_by.as_str())?;
    if over != "default" {
        layers.add_plants(Path::new(over))?;
    }
    Ok(())
}

/// Whether what drives can be other plants.
///
/// # Errors
/// If it is not our simulator in lockstep.
pub(crate) fn check_plants(config: &RunConfig, launch: &Launch) -> Result<(), Failure> {
    if launch.ring_is_ours() && !config.run.realtime {
        return Ok(());
    }
    let why = "--over: plants are driven by our own simulator in lockstep; leave out --replace, --launch and --realtime";
    Err(Failure::User(why.to_owned()))
}
