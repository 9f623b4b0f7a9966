//! `pathtune train`: from options to a result.

use std::fs::{self, File, OpenOptions};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::Duration;

use anyhow::Context;
use config::launch::Launch;
use config::{Layers, RunConfig};
use runtime::run::{LOCK_FILE, RunNames, sweep_dead_runs};

use crate::cli::{TrainArgs, TunerArg};
use crate::pipeline::{Pipeline, Plan, log_of_orchestrator};
use crate::progress::Progress;
use crate::report::{RunFacts, print_table, write_result};
use crate::restart::Budget;
use crate::{Failure, preflight};

/// Trains a manoeuvre to its end.
///
/// # Errors
/// The user's mistakes, before anything was started; a pipeline that could not be kept alive.
pub fn train(args: &TrainArgs) -> Result<(), Failure> {
    let launch = resolve_launch(args)?;
    let config = resolve_config(args, &launch)?;
    preflight::check_commands(&launch)?;
    sweep_dead_runs();
    preflight::check_shared_memory(config.fleet().max(config.run.alphas.len()))?;
    let folder = preflight::make_folder(&folder_of(args, &config))?;
    let plan = Plan {
        config,
        launch,
        folder,
        budget: Budget { restarts: args.restart_budget, within: Duration::from_secs(10) },
        quiet: args.quiet || args.json,
    };

    let facts = match run(&plan) {
        Ok(facts) => facts,
        Err(failure) => {
            if matches!(failure, Failure::User(_)) {
                preflight::unmake_folder(&plan.folder);
            }
            return Err(failure);
        }
    };
    let result = write_result(&plan.folder, &plan.config, &facts)?;
    if args.json {
        println!("{}", serde_json::to_string_pretty(&result).context("result.json")?);
    } else {
        print_table(&plan.config, &result, &plan.folder);
    }
    Ok(())
}

/// Runs the pipeline; whatever happens, nothing of it stays in shared memory.
pub(crate) fn run(plan: &Plan) -> Result<RunFacts, Failure> {
    let folder = &plan.folder;
    let text = toml::to_string(&plan.config).context("the configuration")?;
    write(&folder.join("config.toml"), &text)?;
    let text = toml::to_string(&plan.launch).context("the launch file")?;
    write(&folder.join("launch.toml"), &text)?;
    log_to(&log_of_orchestrator(folder))?;

    let names = RunNames::create().map_err(|error| Failure::User(error.to_string()))?;
    // Held until the end: as long as it is, nobody sweeps this run away.
    let lock = File::create(names.root.join(LOCK_FILE))?;
    lock.lock()?;
    let span = tracing::info_span!("run", run = format!("{:016x}", names.run));
    let result = span.in_scope(|| {
        let mut progress = Progress::new(plan.quiet, plan.config.drive.tick_s);
        let result = Pipeline::new(plan, &names, &mut progress)
            .and_then(|mut pipeline| pipeline.run_to_end());
        progress.finish();
        result
    });
    names.remove();
    result
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

fn resolve_launch(args: &TrainArgs) -> Result<Launch, Failure> {
    let mut launch = match &args.launch {
        None => Launch::train(),
        Some(file) => Launch::parse(&file.display().to_string(), &read(file, "--launch")?)?,
    };
    for replacement in &args.replace {
        launch.replace(replacement)?;
    }
    Ok(launch)
}

fn resolve_config(args: &TrainArgs, launch: &Launch) -> Result<RunConfig, Failure> {
    let mut layers = Layers::maneuver(&args.maneuver)?;
    if let Some(file) = &args.config {
        layers.add_document(&file.display().to_string(), &read(file, "--config")?)?;
    }
    for assignment in &args.set {
        layers.set(assignment)?;
    }
    if let Some(alphas) = &args.alphas {
        layers.put("--alphas", "run.alphas", alphas.clone())?;
    }
    if let Some(seed) = args.seed {
        layers.put("--seed", "run.seed", seed as i64)?;
    }
    if let Some(fleet) = args.fleet {
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
    Ok(layers.resolve()?)
}

fn read(file: &Path, option: &str) -> Result<String, Failure> {
    fs::read_to_string(file)
        .map_err(|error| Failure::User(format!("{option} {}: {error}", file.display())))
}

/// The output folder that was named, or one named after manoeuvre and time.
fn folder_of(args: &TrainArgs, config: &RunConfig) -> PathBuf {
    if let Some(folder) = &args.out {
        return folder.clone();
    }
    let time = jiff::Zoned::now().strftime("%Y%m%d-%H%M%S").to_string();
    let name = format!("runs/{}-{time}", config.maneuver);
    // Two runs may start in the same second.
    let numbered = (2..).map(|number| format!("{name}-{number}"));
    std::iter::once(name.clone())
        .chain(numbered)
        .map(PathBuf::from)
        .find(|folder| !folder.exists())
        .expect("some number is free")
}
