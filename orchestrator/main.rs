//! The doorway: one binary that is the orchestrator, and every process that it starts.

use std::process::ExitCode;
use std::time::Duration;

use clap::Parser;
use clap::error::ErrorKind;
use monitor::MonitorError;
use orchestrator::bench::{self, bench};
use orchestrator::cli::{
    Cli, Command, HopArg, MonitorArgs, RecordArgs, ReplayArgs, ServiceCommand,
};
use orchestrator::commands::{self, LivingRun};
use orchestrator::conformance::conformance;
use orchestrator::runs::{Ended, name_files};
use orchestrator::words::{Failure, print_failure, print_line, print_usage_error};
use runtime::clock::now_ns;
use runtime::ring::Hop;

fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => {
            return match error.kind() {
                ErrorKind::DisplayHelp | ErrorKind::DisplayVersion => {
                    let _ = error.print();
                    ExitCode::SUCCESS
                }
                ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand => {
                    let _ = error.print();
                    ExitCode::from(64)
                }
                _ => {
                    print_usage_error(&error);
                    ExitCode::from(64)
                }
            };
        }
    };
    let result = match cli.command {
        Command::Train(args) => commands::train(&args).and_then(draw),
        Command::Validate(args) => commands::validate(&args).and_then(draw),
        Command::Drive(args) => commands::drive(&args).and_then(draw),
        Command::Rearm { run, vehicle } => commands::rearm(run.as_deref(), vehicle),
        Command::Grid(args) => commands::grid(&args).and_then(draw),
        Command::Report { run } => report::write_report(&run)
            .map_err(|why| Failure::User(why.to_string()))
            .and_then(|page| print_line(&page.display().to_string())),
        Command::Record(args) => record(&args),
        Command::Replay(args) => match replay(&args) {
            Ok(true) => Ok(()),
            // A difference is a finding, not a failure: it is printed already.
            Ok(false) => return ExitCode::from(1),
            Err(failure) => Err(failure),
        },
        Command::Bench(args) => bench(&args),
        Command::Monitor(args) => look(args),
        Command::Status { json } => commands::status(json),
        Command::Stop { run } => commands::stop(run.as_deref()),
        Command::Logs { run, process, lines } => {
            commands::logs(run.as_deref(), process.as_deref(), lines)
        }
        Command::Clean { dry_run } => commands::clean(dry_run),
        Command::Doctor { json } => commands::doctor(json),
        Command::Config(command) => commands::show_config(&command),
        Command::Conformance(args) => match conformance(&args) {
            Ok(true) => Ok(()),
            // What failed is printed already.
            Ok(false) => return ExitCode::from(1),
            Err(failure) => Err(failure),
        },
        Command::Schema(args) => commands::print_schema(&args),
        Command::Gains(command) => commands::gains(&command),
        Command::Service { service } => {
            serve(service).map_err(|error| match error.downcast::<ros2_vehicle::Refused>() {
                Ok(refused) => Failure::User(refused.to_string()),
                Err(error) => Failure::Other(error),
            })
        }
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            print_failure(&failure);
            ExitCode::from(failure.code())
        }
    }
}

/// Draws the report of a run that has just ended, and names it.
fn draw(ended: Ended) -> Result<(), Failure> {
    let report = report::write_report(&ended.folder).map_err(|why| why.to_string());
    name_files(&ended, report)
}

/// Looks into a living run.
fn look(args: MonitorArgs) -> Result<(), Failure> {
    let MonitorArgs { run, vehicle, json, csv, duration, once, budget, prometheus } = args;
    let LivingRun { names, folder } = commands::living_run(run.as_deref())?;
    let options =
        monitor::Options { names, folder, vehicle, json, csv, duration, once, budget, prometheus };
    monitor::run(&options).map_err(|error| match error {
        MonitorError::User(why) => Failure::User(why),
        MonitorError::Other(error) => Failure::Other(error),
    })
}

/// Records a living run from another terminal.
fn record(args: &RecordArgs) -> Result<(), Failure> {
    let run = commands::living_run(args.run.as_deref())?;
    if let Some(out) = args.out.as_deref().filter(|out| out.exists()) {
        return Err(Failure::User(format!("--out {}: is there already", out.display())));
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
    // A loss is no failure: an observer may not stop a vehicle. It is never silent, though.
    if let Some(gaps) = summary.gaps() {
        eprintln!("pathtune: the recording has gaps: {gaps}");
    }
    if !summary.behind.is_zero() {
        eprintln!("pathtune: could not keep up for {:.1} s", summary.behind.as_secs_f64());
    }
    print_line(&summary.file.display().to_string())
}

/// Replays a recording; whether nothing differed.
fn replay(args: &ReplayArgs) -> Result<bool, Failure> {
    let user = |why: String| Failure::User(why);
    let recorded = replayer::check(&args.file).map_err(|why| user(format!("{why:#}")))?;
    let config = commands::replay_config(args, &recorded)?;
    let tick_s = config.drive.tick_s;
    let by_zone = match &args.gains {
        None => Vec::new(),
        Some(text) => {
            let sets = config::Gains::parse_sets(text)
                .map_err(|why| user(format!("--gains {text}: {why}")))?;
            let due = config.maneuvers_due().len();
            if sets.len() != 1 && sets.len() != due {
                let (held, due) = (sets.len(), due);
                return Err(user(format!("--gains {text}: holds {held} sets; give 1, or {due}")));
            }
            config.gains_by_zone(&sets)
        }
    };
    let order = replayer::Order {
        file: std::fs::canonicalize(&args.file)?,
        by_zone,
        from_tick: (args.from / tick_s).round() as u64,
        // A file holds numbers of 63 bits.
        to_tick: args.to.map_or(i64::MAX as u64, |to| (to / tick_s).round() as u64),
        speed: if args.realtime { Some(1.0) } else { args.speed },
    };
    let text = toml::to_string(&order).map_err(anyhow::Error::from)?;
    let outcome = commands::replay(config, replayer::Order::FILE, &text)?;
    let outcome: replayer::reviewer::Outcome =
        serde_json::from_value(outcome).map_err(anyhow::Error::from)?;
    let replayer::reviewer::Outcome { compared, batches, difference } = outcome;
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

fn serve(service: ServiceCommand) -> anyhow::Result<()> {
    match service {
        ServiceCommand::Simulator => simulator::service::run(),
        ServiceCommand::Controller => controller::service::run(),
        ServiceCommand::Supervisor => supervisor::service::run(),
        ServiceCommand::Trainer => trainer::service::run(),
        ServiceCommand::Schedule => trainer::schedule::run(),
        ServiceCommand::Ring { hop, rounds } => runtime::ring::run(to_hop(hop, rounds)),
        ServiceCommand::StreamRing { hop, rounds } => {
            runtime::ring::run_over_streams(to_hop(hop, rounds))
        }
        ServiceCommand::Calls => time_calls(),
        ServiceCommand::Recorder => recorder::service::run(),
        ServiceCommand::Replayer { file } => replayer::vehicle::run(file.as_deref()),
        ServiceCommand::Reviewer => replayer::reviewer::run(),
        ServiceCommand::Ros2Vehicle => ros2_vehicle::run(),
        ServiceCommand::Cleaner => runtime::cleanup::run_helper(),
        ServiceCommand::Wake { pid, after_ms } => {
            runtime::chaos::wake_later(pid, Duration::from_millis(after_ms));
            Ok(())
        }
        ServiceCommand::Exec { words } => Err(orchestrator::pipeline::process::exec(&words)),
    }
}

/// Times plain calls over the grid that the benchmark's pipelines drive, and prints nanoseconds a tick: mean, and over
/// the drives median and 99th percentile. Like a ring, to standard error.
fn time_calls() -> anyhow::Result<()> {
    let mut layers = config::Layers::maneuver(bench::MANEUVER)?;
    for setting in bench::spread(512)? {
        layers.set(&setting)?;
    }
    let config = layers.resolve()?;
    let mut rollout = rollout::Rollout::new(&config);
    let mut ticks_ns: Vec<f64> = config
        .grid
        .positions()
        .map(|position| {
            let started_ns = now_ns();
            let ended = rollout.drive(config.grid.gains(position), None);
            (now_ns() - started_ns) as f64 / ended.metrics.ticks as f64
        })
        .collect();
    ticks_ns.sort_by(f64::total_cmp);
    let mean_ns = ticks_ns.iter().sum::<f64>() / ticks_ns.len() as f64;
    let at = |share: f64| ticks_ns[((ticks_ns.len() - 1) as f64 * share) as usize];
    eprintln!("{mean_ns} {} {}", at(0.5), at(0.99));
    Ok(())
}

fn to_hop(hop: HopArg, rounds: u64) -> Hop {
    match hop {
        HopArg::First => Hop::First { rounds },
        HopArg::Second => Hop::Second,
        HopArg::Third => Hop::Third,
    }
}
