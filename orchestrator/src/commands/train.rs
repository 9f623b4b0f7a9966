//! `pathtune train`: from options to a result.

use std::fs::{self, File, OpenOptions};
use std::path::Path;
use std::sync::Mutex;

use anyhow::Context;
use config::launch::Launch;
use config::{RunConfig, SweepPlan};
use runtime::run::{LOCK_FILE, RunNames};

use crate::cli::{TrainArgs, TunerArg};
use crate::pipeline::main_loop::{Pipeline, Plan, log_of_orchestrator};
use crate::pipeline::progress::Progress;
use crate::runs::preflight;
use crate::runs::result::{RunFacts, write_result};
use crate::runs::setup::{self, Ended, Folder, Ready};
use crate::words::terminal::say;
use crate::words::{Failure, tables};

/// Trains a manoeuvre to its end, or goes on with a training that was interrupted.
///
/// # Errors
/// The user's mistakes, before anything was started; a pipeline that could not be kept alive.
pub fn train(args: &TrainArgs) -> Result<Ended, Failure> {
    let (config, launch) = match &args.resume {
        Some(folder) => resolved_before(folder)?,
        None => {
            let launch = setup::launch(&args.setup, None)?;
            (resolve_config(args, &launch)?, launch)
        }
    };
    let name = config.maneuver.clone();
    let folder = args.resume.as_deref().map_or(Folder::New(&name), Folder::Old);
    let ready = setup::prepare(&args.setup, config, launch, None, folder)?;
    let facts = run_or_unmake(&ready, args.resume.is_none())?;
    let plan = &ready.plan;
    let result = write_result(&plan.folder, "train", &plan.config, &facts)?;
    if args.setup.json {
        say!("{}", serde_json::to_string_pretty(&result).context("result.json")?);
    } else {
        tables::print_training(&plan.config, &result)?;
    }
    Ok(Ended { folder: plan.folder.clone(), json: args.setup.json })
}

/// Runs a plan. If that fails by the user's mistake, a folder that is `new` is removed again.
pub(crate) fn run_or_unmake(ready: &Ready, new: bool) -> Result<RunFacts, Failure> {
    run(&ready.plan).inspect_err(|failure| {
        if new && matches!(failure, Failure::User(_)) {
            preflight::unmake_folder(&ready.plan.folder);
        }
    })
}

/// The configuration and processes of a training that was interrupted.
fn resolved_before(folder: &Path) -> Result<(RunConfig, Launch), Failure> {
    let read = |name: &str| {
        let path = folder.join(name);
        fs::read_to_string(&path).map_err(|error| {
            Failure::User(format!(
                "--resume {}: no training to go on with: {error}",
                path.display()
            ))
        })
    };
    if folder.join(SweepPlan::FILE).exists() {
        let problem = "not a training; validations and grids are driven anew";
        return Err(Failure::User(format!("--resume {}: {problem}", folder.display())));
    }
    let config = RunConfig::from_resolved(&read("config.toml")?)?;
    let launch = Launch::parse("launch.toml", &read("launch.toml")?)?;
    Ok((config, launch))
}

/// Runs the pipeline; whatever happens, nothing of it stays in shared memory.
pub(crate) fn run(plan: &Plan) -> Result<RunFacts, Failure> {
    let names = RunNames::create().map_err(|error| Failure::User(error.to_string()))?;
    let names = Removed(names);
    // Held until the end: as long as it is, nobody sweeps this run away.
    let lock = File::create(names.0.root.join(LOCK_FILE))?;
    lock.lock()?;

    let folder = &plan.folder;
    let text = toml::to_string(&plan.config).context("the configuration")?;
    write(&folder.join("config.toml"), &text)?;
    let text = toml::to_string(&plan.launch).context("the launch file")?;
    write(&folder.join("launch.toml"), &text)?;
    if let Some(sweep) = &plan.sweep {
        let text = toml::to_string(sweep).context("the list of drives")?;
        write(&folder.join(SweepPlan::FILE), &text)?;
    }
    log_to(&log_of_orchestrator(folder))?;

    let span = tracing::info_span!("run", run = format!("{:016x}", names.0.run));
    span.in_scope(|| {
        let mut progress = Progress::new(plan.quiet, plan.config.drive.tick_s);
        let result = Pipeline::new(plan, &names.0, &mut progress)
            .and_then(|mut pipeline| pipeline.run_to_end());
        progress.finish();
        result
    })
}

/// Everything of a run, removed with this.
struct Removed(RunNames);

impl Drop for Removed {
    fn drop(&mut self) {
        self.0.remove();
    }
}

fn write(path: &Path, text: &str) -> Result<(), Failure> {
    fs::write(path, text).with_context(|| format!("failed to write {path:?}"))?;
    Ok(())
}

/// The orchestrator's own log goes to a file: the terminal belongs to the user.
fn log_to(path: &Path) -> Result<(), Failure> {
    let file = OpenOptions::new()
        .create(true)
        .append(true)
        .open(path)
        .with_context(|| format!("failed to write {path:?}"))?;
    runtime::logging::init_to(Mutex::new(file));
    Ok(())
}

fn resolve_config(args: &TrainArgs, launch: &Launch) -> Result<RunConfig, Failure> {
    let mut layers = setup::layers(args.maneuver.as_deref(), &args.setup)?;
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
    // Drives of a vehicle that does not repeat itself must not be taken for each other.
    let repeats = launch.process.iter().all(|entry| entry.is_deterministic());
    if args.no_memo || !repeats {
        layers.put("--no-memo", "run.memo", false)?;
    }
    if let Some(tuner) = args.tuner {
        let name = match tuner {
            TunerArg::EducatedQ => "educated-q",
            TunerArg::Q => "q",
        };
        layers.put("--tuner", "learning.tuner", name)?;
    }
    let mut config = layers.resolve()?;
    if config.noise.enabled && config.robust.engage_gear {
        config.vehicle.gear_engaged = true;
    }
    Ok(config)
}
