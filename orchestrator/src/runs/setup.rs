//! From options to a plan: configuration, processes and folder of a run, checked before anything starts.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use config::launch::{Launch, Role};
use config::{Layers, RunConfig, SweepPlan};
use runtime::Wait;
use runtime::chaos::Script;
use runtime::run::sweep_dead_runs;

use crate::cli::{SetupArgs, WaitArg};
use crate::pipeline::main_loop::{Interrupts, Plan};
use crate::pipeline::restart::Budget;
use crate::runs::preflight;
use crate::words::Failure;
use crate::words::terminal::{say, tell};

/// The layers that every command shares: manoeuvre or own path, vehicle, file, single keys.
pub(crate) fn layers(maneuver: Option<&str>, args: &SetupArgs) -> Result<Layers, Failure> {
    let mut layers = match (maneuver, &args.path) {
        (Some(maneuver), _) => Layers::maneuver(maneuver)?,
        (None, Some(_)) => Layers::own_path(),
        (None, None) => match &args.config {
            // A resolved configuration says whose it is.
            Some(file) => Layers::of_document(&read(file, "--config")?)?,
            None => {
                let why = "name a manoeuvre, or a path with --path FILE";
                return Err(Failure::User(why.to_owned()));
            }
        },
    };
    if let Some(file) = &args.config {
        layers.add_document(&file.display().to_string(), &read(file, "--config")?)?;
    }
    if let Some(vehicle) = &args.vehicle {
        layers.set_vehicle("--vehicle", vehicle)?;
    }
    // What a path's length makes of the other keys can still be set by hand.
    let (before, after): (Vec<_>, Vec<_>) =
        args.set.iter().partition(|assignment| assignment.starts_with("reference."));
    for assignment in before {
        layers.set(assignment)?;
    }
    if let Some(path) = &args.path {
        layers.add_path(path)?;
    }
    for assignment in after {
        layers.set(assignment)?;
    }
    Ok(layers)
}

/// The processes of a pipeline; `service` fills the trainer's role where nothing else was named for it.
pub(crate) fn launch(args: &SetupArgs, service: Option<&str>) -> Result<Launch, Failure> {
    let mut launch = match &args.launch {
        None => Launch::train(),
        Some(file) => Launch::parse(&file.display().to_string(), &read(file, "--launch")?)?,
    };
    if args.record {
        launch.record(args.record_split);
    }
    for replacement in &args.replace {
        launch.replace(replacement)?;
    }
    if let Some(service) = service {
        launch.prefer_service(Role::Trainer, service);
    }
    Ok(launch)
}

/// Where a run writes, and what it goes on with.
pub(crate) enum Folder<'a> {
    /// A new folder, named by the user or after the run and the time.
    New(&'a str),
    /// The folder of a training that was interrupted.
    Old(&'a Path),
}

/// A plan, with the lock on its folder: as long as that is held, nobody else writes there.
pub(crate) struct Ready {
    pub(crate) plan: Plan,
    _lock: fs::File,
}

/// A run that has come to its end.
#[derive(Debug)]
pub struct Ended {
    /// Its folder.
    pub folder: PathBuf,
    /// Standard output belongs to its JSON.
    pub json: bool,
}

/// Names the files of an ended run that people will want to open.
///
/// # Errors
/// If standard output does not take it.
pub fn name_files(ended: &Ended, report: Result<PathBuf, String>) -> Result<(), Failure> {
    let here = std::env::current_dir().unwrap_or_default();
    let near = |path: &Path| path.strip_prefix(&here).unwrap_or(path).display().to_string();
    match (report, ended.json) {
        // The result stands, whatever becomes of its pictures.
        (Err(why), _) => tell!("pathtune: no report: {why}"),
        (Ok(_), true) => {}
        (Ok(report), false) => {
            say!("{}", near(&ended.folder.join("result.json")));
            say!("{}", near(&report));
        }
    }
    Ok(())
}

/// Checks what a run needs of the machine, and makes its folder.
pub(crate) fn prepare(
    args: &SetupArgs,
    config: RunConfig,
    launch: Launch,
    sweep: Option<SweepPlan>,
    folder: Folder,
) -> Result<Ready, Failure> {
    if let Some(script) = &args.chaos {
        Script::parse(script).map_err(|why| Failure::User(format!("--chaos: {why}")))?;
    }
    let wait = match args.wait {
        WaitArg::Auto => None,
        WaitArg::Yield => Some(Wait::Yield),
        WaitArg::Spin => Some(Wait::Spin),
        WaitArg::Block => Some(Wait::Block),
    };
    if let Some(priority) = args.fifo {
        preflight::ask_for_fifo(priority, config.run.realtime)?;
    }
    // Until here a signal may simply end us; from here on it ends in order.
    let interrupted = Interrupts::new()?;
    preflight::check_commands(&launch)?;
    sweep_dead_runs();
    preflight::check_shared_memory(config.fleet().max(config.run.alphas.len()))?;
    let folder = match folder {
        Folder::Old(folder) => fs::canonicalize(folder)?,
        Folder::New(name) => preflight::make_folder(&match &args.out {
            Some(folder) => folder.clone(),
            None => folder_named_after(name),
        })?,
    };
    let lock = preflight::lock_folder(&folder)?;
    let plan = Plan {
        config,
        launch,
        sweep,
        folder,
        budget: Budget { restarts: args.restart_budget, within: Duration::from_secs(10) },
        chaos: args.chaos.clone().map(|script| (script, args.chaos_seed)),
        quiet: args.quiet || args.json,
        wait,
        fifo: args.fifo,
        interrupted,
    };
    Ok(Ready { plan, _lock: lock })
}

pub(crate) fn read(file: &Path, option: &str) -> Result<String, Failure> {
    fs::read_to_string(file)
        .map_err(|error| Failure::User(format!("{option} {}: {error}", file.display())))
}

fn folder_named_after(name: &str) -> PathBuf {
    let time = jiff::Zoned::now().strftime("%Y%m%d-%H%M%S").to_string();
    let name = format!("runs/{name}-{time}");
    // Two runs may start in the same second.
    let numbered = (2..).map(|number| format!("{name}-{number}"));
    std::iter::once(name.clone())
        .chain(numbered)
        .map(PathBuf::from)
        .find(|folder| !folder.exists())
        .expect("some number is free")
}
