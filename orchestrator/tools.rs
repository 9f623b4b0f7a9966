//! Tools that are used alongside a pipeline: monitor, recorder, replay, report, certificate, identification.

use std::ffi::OsStr;
use std::path::Path;

use crate::identify;
use config::{Parameters, RunConfig};
use monitor::MonitorError;
use orchestrator::cli::{CompareArgs, MonitorArgs, RecordArgs, ReplayArgs};
use orchestrator::commands::CompareProgress;
use orchestrator::runs::{LivingRun, known_of_car, living_run};
use orchestrator::words::{Failure, print_line};
use orchestrator::{ExciteTools, Services, StudyTools, Tools, commands};
use replayer::reviewer::Outcome;

pub(crate) const TOOLS: Tools = Tools {
    report: |folder| report::write_report(folder).map_err(|why| why.to_string()),
    compare,
    study: StudyTools {
        draw: |table, compared| report::write_study(table, compared).map_err(|why| why.to_string()),
        course: trainer::compare::course,
        joined: trainer::compare::joined,
    },
    monitor: look,
    record,
    replay,
    margin: trainer::margin,
    excite: ExciteTools { lasts_s: tracking::EXCITATION_S, ground },
    zone_regions: certificate::zone_regions,
    certify: crate::certify::certify,
    calibrate: crate::calibrate::calibrate,
    journal: crate::calibrate::journal::note,
    evidence: crate::calibrate::journal::evidence,
    identify: identify::identify,
    path_of_bag: crate::path_bag::read,
};

/// The ground that a simulated drive takes.
fn ground(config: &RunConfig, by_zone: &[Parameters]) -> [f64; 4] {
    let footprint = supervisor::Footprint::new(&config.vehicle);
    let mut area = [f64::INFINITY, f64::NEG_INFINITY, f64::INFINITY, f64::NEG_INFINITY];
    rollout::Rollout::new(config).drive_scheduled(by_zone, None, |_, tick| {
        let seen = tick.observation;
        for [x, y] in footprint.corners_m(seen.truth, seen.speed_mps) {
            area = [area[0].min(x), area[1].max(x), area[2].min(y), area[3].max(y)];
        }
    });
    area
}

/// Compares tuners.
fn compare(args: &CompareArgs) -> Result<(), Failure> {
    let seeds = u64::from(args.seeds);
    let mut laws = Vec::new();
    let failed = |why: report::ReportError| Failure::User(why.to_string());
    let studies = commands::compare_configs(args)?;
    for configs in &studies {
        trainer::compare::check_grid(&configs[0]).map_err(Failure::User)?;
    }
    if let Some(folder) = &args.report {
        report::make_folder(folder).map_err(failed)?;
    }
    for configs in studies {
        let mut progress = CompareProgress::new(args, &configs[0].law.name);
        let tell = |what: trainer::compare::Progress<'_>| match what {
            trainer::compare::Progress::Grid { done, all } => progress.tell_grid(done, all),
            trainer::compare::Progress::Trainings { tuner, done } => {
                progress.tell_trainings(tuner, done);
            }
        };
        let compared = trainer::compare::compare(&configs, seeds, args.drives, tell);
        laws.push(compared.map_err(Failure::User)?);
    }
    commands::print_comparisons(args, &laws)?;
    if let Some(folder) = &args.report {
        let page = report::write_compared(folder, &laws).map_err(failed)?;
        eprintln!("pathtune: {}", page.display());
    }
    Ok(())
}

/// Watches a living run.
fn look(args: MonitorArgs) -> Result<(), Failure> {
    let MonitorArgs { run, vehicle, json, csv, duration, once, budget, prometheus } = args;
    let LivingRun { names, folder } = living_run(run.name())?;
    if let Some(words) = known_of_car(&folder) {
        eprintln!("pathtune: {words}");
    }
    let options =
        monitor::Options { names, folder, vehicle, json, csv, duration, once, budget, prometheus };
    monitor::run(&options).map_err(|error| match error {
        MonitorError::User(why) => Failure::User(why),
        MonitorError::Other(error) => Failure::Other(error),
    })
}

/// Records a living run from another terminal.
fn record(args: &RecordArgs) -> Result<(), Failure> {
    let run = living_run(args.run.name())?;
    if let Some(out) = args.out.as_deref().filter(|out| out.exists()) {
        return Err(Failure::User(format!("--out {}: exists already", out.display())));
    }
    let options = recorder::attached::Options {
        names: run.names,
        folder: run.folder,
        out: args.out.clone(),
        time: args.time,
        split_bytes: args.record_split,
    };
    let summary =
        recorder::attached::record(&options).map_err(|why| Failure::User(format!("{why:#}")))?;
    // A loss is not a failure, because an observer must not stop a vehicle; but it is always reported.
    for line in summary.facts(true).told() {
        eprintln!("pathtune: {line}");
    }
    if !summary.behind.is_zero() {
        eprintln!(
            "pathtune: the recorder could not keep up for {:.1} s",
            summary.behind.as_secs_f64()
        );
    }
    print_line(&summary.file.display().to_string())
}

/// Replays a recording; returns whether nothing differed.
fn replay(args: &ReplayArgs, services: Services) -> Result<bool, Failure> {
    let user = |why: String| Failure::User(why);
    let recorded = replayer::check(&args.file).map_err(|why| user(format!("{why:#}")))?;
    let config = commands::replay_config(args, &recorded)?;
    let tick_s = config.drive.tick_s;
    let by_zone = match &args.gains {
        None => Vec::new(),
        Some(text) => {
            let sets = config
                .law
                .parse_sets(text)
                .map_err(|why| user(format!("--gains {text}: {why}")))?;
            let due = config.maneuvers_due().len();
            if sets.len() != 1 && sets.len() != due {
                let (held, due) = (sets.len(), due);
                return Err(user(format!("--gains {text}: holds {held} sets; give 1, or {due}")));
            }
            config.sets_by_zone(&sets).iter().map(|set| config.law.named(set)).collect()
        }
    };
    let tick_of = |time: std::time::Duration| (time.as_secs_f64() / tick_s).round() as u64;
    let order = replayer::Order {
        file: std::fs::canonicalize(&args.file)?,
        by_zone,
        from_tick: tick_of(args.from),
        // A TOML file holds integers of at most 63 bits.
        to_tick: args.to.map_or(i64::MAX as u64, tick_of),
        speed: if args.realtime { Some(1.0) } else { args.speed },
    };
    let text = toml::to_string(&order).map_err(anyhow::Error::from)?;
    let outcome = commands::replay(config, services, replayer::Order::FILE, &text)?;
    let outcome: Outcome = serde_json::from_value(outcome).map_err(anyhow::Error::from)?;
    let Outcome { compared, batches, difference } = outcome;
    let Some(it) = difference else {
        let drives = if batches == 1 { "batch" } else { "batches" };
        let line = format!("no difference: {compared} ticks of {batches} {drives} compared");
        return print_line(&line).map(|()| true);
    };
    print_line(&format!(
        "first difference: batch {}, tick {}, slot {}, {}.{}: recorded {}, replayed {}",
        it.batch, it.tick, it.slot, it.topic, it.field, it.recorded, it.replayed
    ))
    .map(|()| false)
}

/// Refuses a folder for a page of ours that holds anything else: pictures of an older page are removed.
pub(crate) fn refuse_others(option: &str, folder: &Path) -> Result<(), Failure> {
    let is_ours = |name: &OsStr| {
        let name = Path::new(name);
        name == "index.html" || name.extension().is_some_and(|it| it == "svg" || it == "part")
    };
    let others = std::fs::read_dir(folder)
        .map(|all| all.flatten().map(|entry| entry.file_name()).find(|name| !is_ours(name)));
    match others {
        Ok(Some(other)) => Err(Failure::User(format!(
            "{option} {}: holds {} already; name a new folder",
            folder.display(),
            other.to_string_lossy()
        ))),
        _ => Ok(()),
    }
}
