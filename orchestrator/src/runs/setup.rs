//! From options to a plan: configuration, processes and folder of a run, checked before anything starts.

use std::fs;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::time::Duration;

use config::launch::{Launch, ProcessEntry, Role};
use config::{
    LawConfig, Layers, RecordedPath, RunConfig, StartAt, SweepKind, SweepPlan, read_small,
};
use runtime::Wait;
use runtime::chaos::Script;

use crate::cli::{PathReading, SetupArgs, WaitArg};
use crate::pipeline::cores::Placement;
use crate::pipeline::interrupts::Interrupts;
use crate::pipeline::plan::Plan;
use crate::pipeline::restart::Budget;
use crate::pipeline::services::Services;
use crate::pipeline::strays::sweep_dead_runs;
use crate::runs::{folder, preflight};
use crate::words::terminal::tell_once;
use crate::words::{Failure, known};

/// Where the keys of a configuration come from, in the order in which they are laid upon each other but for the path.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sources<'a> {
    pub(crate) path: Option<&'a Path>,
    pub(crate) reading: &'a PathReading,
    pub(crate) vehicle: Option<&'a str>,
    pub(crate) law: Option<&'a str>,
    pub(crate) objective: Option<&'a str>,
    pub(crate) config: Option<&'a Path>,
    pub(crate) laps: Option<u32>,
    pub(crate) start: Option<StartAt>,
    pub(crate) set: &'a [String],
}

impl<'a> From<&'a SetupArgs> for Sources<'a> {
    fn from(args: &'a SetupArgs) -> Self {
        Self {
            path: args.path.as_deref(),
            reading: &args.reading,
            vehicle: args.vehicle.as_deref(),
            law: args.law.as_deref(),
            objective: args.objective.as_deref(),
            config: args.config.as_deref(),
            laps: args.laps,
            start: args.start,
            set: &args.set,
        }
    }
}

/// The layers that every command shares: manoeuvre or own path, file, vehicle, law, objective, single keys.
pub(crate) fn layers<'a>(
    maneuver: Option<&str>,
    args: impl Into<Sources<'a>>,
    tuner: Option<&str>,
) -> Result<Layers, Failure> {
    let args = args.into();
    let mut layers = match (maneuver, args.path) {
        (Some(maneuver), _) => Layers::maneuver(maneuver)?,
        (None, Some(_)) => Layers::own_path(),
        (None, None) => match args.config {
            // A resolved configuration names its own manoeuvre.
            Some(file) => Layers::of_document(&read(file, "--config")?)?,
            None => {
                let why = "name a manoeuvre, or a path with --path FILE";
                return Err(Failure::User(why.to_owned()));
            }
        },
    };
    // Before the user's file and single keys, which may set what belongs to them, such as a grid or settings.
    let chosen = Chosen { law: args.law, objective: args.objective, tuner };
    chosen.choose(&mut layers)?;
    if let Some(file) = args.config {
        let (origin, text) = (file.display().to_string(), read(file, "--config")?);
        folder::refuse_earlier(&origin, &text)?;
        layers.add_document(&origin, &text)?;
        // An option counts more than a file that names another one.
        chosen.choose(&mut layers)?;
    }
    if let Some(vehicle) = args.vehicle {
        layers.set_vehicle("--vehicle", vehicle)?;
    }
    // What is made of a path depends on these; keys that are derived from it can still be overridden by hand.
    let of_path = ["reference.", "path.laps", "vehicle.", "supervisor."];
    let (before, after): (Vec<_>, Vec<_>) =
        args.set.iter().partition(|it| of_path.iter().any(|key| it.starts_with(key)));
    for assignment in before {
        layers.set(assignment)?;
    }
    if let Some(laps) = args.laps {
        layers.put("--laps", "path.laps", i64::from(laps))?;
    }
    if let Some(path) = args.path {
        add_path(&mut layers, path, args.start, args.reading)?;
    }
    for assignment in after {
        layers.set(assignment)?;
    }
    // A configuration with a mistake has one message, that of the mistake. How files were read, and what they leave out, is
    // no progress: it is told in quiet runs, too.
    let borrowed = layers.borrowed();
    let notes: Vec<&String> = borrowed.iter().chain(layers.notes()).collect();
    if !notes.is_empty() && layers.clone().resolve().is_ok() {
        notes.into_iter().for_each(|note| tell_once(note));
    }
    Ok(layers)
}

/// Reads the path of a bag of ROS 2, on this topic if one is given.
pub type BagReader = fn(&Path, Option<&str>) -> Result<RecordedPath, String>;

/// What reads bags: a part that this library does not link.
static BAGS: OnceLock<BagReader> = OnceLock::new();

/// Says what reads bags, once, before the first command.
pub(crate) fn read_bags_with(reader: BagReader) {
    let _ = BAGS.set(reader);
}

/// Puts the path of a file or of a bag on top of the layers.
pub(crate) fn add_path(
    layers: &mut Layers,
    path: &Path,
    start: Option<StartAt>,
    reading: &PathReading,
) -> Result<(), Failure> {
    let options = reading.options();
    let Some(reader) = BAGS.get().filter(|_| is_mcap(path)) else {
        if reading.path_topic.is_some() {
            let problem = "only a bag of ROS 2 in MCAP has topics, and this file is none; leave the option out";
            return Err(Failure::User(format!(
                "--path-topic with --path {}: {problem}",
                path.display()
            )));
        }
        return Ok(layers.add_path_with(path, start, &options)?);
    };
    if reading.columns.is_some() {
        let problem = "a bag has no columns; choose its topic with --path-topic";
        return Err(Failure::User(format!("--columns with --path {}: {problem}", path.display())));
    }
    let recorded = reader(path, reading.path_topic.as_deref()).map_err(Failure::User)?;
    Ok(layers.add_recorded_path(path, recorded, start, &options)?)
}

/// Whether a file begins as an MCAP file does. One that cannot be read is reported by who reads it.
fn is_mcap(path: &Path) -> bool {
    let mut start = [0; 5];
    let read = config::open_regular(path).and_then(|mut file| file.read_exact(&mut start));
    read.is_ok() && &start == b"\x89MCAP"
}

/// The parts that options of the command line name.
struct Chosen<'a> {
    law: Option<&'a str>,
    objective: Option<&'a str>,
    tuner: Option<&'a str>,
}

impl Chosen<'_> {
    /// Takes the parts that are not there already: those that are may have been changed since.
    fn choose(&self, layers: &mut Layers) -> Result<(), Failure> {
        let is_there =
            |layers: &Layers, key: &str, name: &str| layers.text(key).as_deref() == Some(name);
        if let Some(law) = self.law.filter(|law| !is_there(layers, "law_preset", law)) {
            check_preset("--law", "laws", law, Path::new(law).is_file())?;
            layers.set_law("--law", law)?;
        }
        if let Some(objective) = self.objective.filter(|it| !is_there(layers, "objective.name", it))
        {
            check_preset("--objective", "objectives", objective, false)?;
            layers.set_objective("--objective", objective)?;
        }
        if let Some(tuner) = self.tuner.filter(|tuner| !is_there(layers, "learning.tuner", tuner)) {
            check_preset("--tuner", "tuners", tuner, false)?;
            layers.set_tuner("--tuner", tuner)?;
        }
        Ok(())
    }
}

/// Checks that a folder of presets contains one of this name, or that the name is that of a file.
pub(crate) fn check_preset(
    option: &str,
    folder: &str,
    name: &str,
    is_file: bool,
) -> Result<(), Failure> {
    let mut names = config::names_in(folder);
    if is_file || names.any(|known| known == name) {
        return Ok(());
    }
    let hint = known(name, config::names_in(folder));
    let what = match folder {
        "laws" => "neither a law nor a file",
        "tuners" => "no tuner",
        _ => "no objective",
    };
    Err(Failure::User(format!("{option} {name}: {what}; {hint}")))
}

/// Checks that a law can be tuned.
pub(crate) fn check_law(law: &LawConfig) -> Result<(), Failure> {
    if law.follows_path {
        return Ok(());
    }
    let why = format!(
        "the law {} does not follow a path, so no set of it is better than another",
        law.name
    );
    Err(Failure::User(why))
}

/// The processes of a pipeline; `trainer` fills the trainer's role unless another program was named for it.
pub(crate) fn launch(
    args: &SetupArgs,
    services: Services,
    trainer: Option<&str>,
) -> Result<Launch, Failure> {
    let mut launch = match &args.launch {
        None => Launch::train(),
        Some(file) => {
            let origin = file.display().to_string();
            let launch = Launch::parse(&origin, &read(file, "--launch")?)?;
            services.check(&origin, &launch)?;
            launch
        }
    };
    if args.record {
        launch.record(args.record_split);
    }
    for replacement in &args.replace {
        launch.replace(replacement, args.deterministic)?;
    }
    if let Some(trainer) = trainer {
        launch.prefer_service(Role::Trainer, trainer);
    }
    Ok(launch)
}

/// Where a run writes, and whether it resumes an earlier one.
pub(crate) enum Folder<'a> {
    /// A new folder, named by the user, or else after the run and the time.
    New(&'a str),
    /// The folder of a training that was interrupted.
    Old(&'a Path),
}

/// A plan with the lock on its folder: while it is held, nobody else writes there.
pub(crate) struct Ready {
    pub(crate) plan: Plan,
    _lock: fs::File,
}

/// Checks that the machine has what a run needs, and creates its folder.
pub(crate) fn prepare(
    args: &SetupArgs,
    config: RunConfig,
    launch: Launch,
    services: Services,
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
    let by_the_clock = config.run.realtime || sweep.as_ref().is_some_and(|plan| plan.realtime);
    let may_have_rings = !by_the_clock && can_be_many(&launch);
    if args.rings.is_some_and(|rings| rings > 1) && !may_have_rings {
        let why = "--rings: only our own services, in lockstep and without --record, can be started more than once";
        return Err(Failure::User(why.to_owned()));
    }
    // Up to here a signal may simply end this process; from here on the run ends in order.
    let interrupted = Interrupts::new()?;
    preflight::check_commands(&launch)?;
    // A grid has drives of its own for the scales.
    if sweep.as_ref().is_none_or(|plan| plan.kind != SweepKind::Grid) {
        preflight::check_scales(&config, &launch)?;
    }
    sweep_dead_runs();
    let max_len = config.fleet().max(config.drivers());
    preflight::check_resources(max_len)?;
    let rings = match args.rings {
        _ if !may_have_rings => Some(1),
        Some(rings) if !preflight::has_room_for_rings(rings.into(), max_len) => {
            let why = format!("--rings {rings}: /dev/shm has no room for so many; take fewer");
            return Err(Failure::User(why));
        }
        None if !preflight::has_room_for_rings(Placement::MOST_RINGS, max_len) => Some(1),
        chosen => chosen.map(usize::from),
    };
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
        services,
        sweep,
        folder,
        budget: Budget { restarts: args.restart_budget, within: Duration::from_secs(10) },
        chaos: args.chaos.clone().map(|script| (script, args.chaos_seed)),
        quiet: args.quiet || args.json,
        wait,
        rings,
        fifo: args.fifo,
        interrupted,
    };
    Ok(Ready { plan, _lock: lock })
}

/// Whether a pipeline of these processes may have several rings: our own services can be started more than once, and no recorder
/// listens to them.
fn can_be_many(launch: &Launch) -> bool {
    // The gain schedule is as good a trainer as ours.
    let is_usual = |entry: &ProcessEntry| match entry.role {
        Role::Trainer => entry.command.is_none(),
        _ => entry.is_usual(),
    };
    launch.process.iter().all(is_usual) && !launch.is_recorded()
}

pub(crate) fn read(file: &Path, option: &str) -> Result<String, Failure> {
    if file.is_dir() {
        let what = match option {
            "--config" => {
                "a TOML file with the keys to change, such as overlay.toml of `pathtune config init`"
            }
            _ => "a file",
        };
        let why = format!("{option} {}: is a folder; it wants {what}", file.display());
        return Err(Failure::User(why));
    }
    read_small(file).map_err(|error| Failure::User(format!("{option} {}: {error}", file.display())))
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
