//! The doorway: one binary that is the orchestrator, and every process that it starts.

use std::process::ExitCode;
use std::time::Duration;

use clap::Parser;
use clap::error::ErrorKind;
use monitor::MonitorError;
use orchestrator::cli::{Cli, Command, HopArg, MonitorArgs, ServiceCommand};
use orchestrator::{Ended, Failure, LivingRun};
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
                    orchestrator::print_usage_error(&error);
                    ExitCode::from(64)
                }
            };
        }
    };
    let result = match cli.command {
        Command::Train(args) => orchestrator::train(&args).and_then(draw),
        Command::Validate(args) => orchestrator::validate(&args).and_then(draw),
        Command::Grid(args) => orchestrator::grid(&args).and_then(draw),
        Command::Report { run } => report::write_report(&run)
            .map_err(|why| Failure::User(why.to_string()))
            .and_then(|page| orchestrator::print_line(&page.display().to_string())),
        Command::Bench(args) => orchestrator::bench(&args),
        Command::Monitor(args) => look(args),
        Command::Status { json } => orchestrator::status(json),
        Command::Stop { run } => orchestrator::stop(run.as_deref()),
        Command::Logs { run, process, lines } => {
            orchestrator::logs(run.as_deref(), process.as_deref(), lines)
        }
        Command::Clean { dry_run } => orchestrator::clean(dry_run),
        Command::Doctor { json } => orchestrator::doctor(json),
        Command::Config(command) => orchestrator::show_config(&command),
        Command::Service { service } => serve(service).map_err(Failure::from),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            orchestrator::print_failure(&failure);
            ExitCode::from(failure.code())
        }
    }
}

/// Draws the report of a run that has just ended, and names it.
fn draw(ended: Ended) -> Result<(), Failure> {
    let report = report::write_report(&ended.folder).map_err(|why| why.to_string());
    orchestrator::name_files(&ended, report)
}

/// Looks into a living run.
fn look(args: MonitorArgs) -> Result<(), Failure> {
    let MonitorArgs { run, vehicle, json, csv, duration, once, budget, prometheus } = args;
    let LivingRun { names, folder } = orchestrator::living_run(run.as_deref())?;
    let options =
        monitor::Options { names, folder, vehicle, json, csv, duration, once, budget, prometheus };
    monitor::run(&options).map_err(|error| match error {
        MonitorError::User(why) => Failure::User(why),
        MonitorError::Other(error) => Failure::Other(error),
    })
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
        ServiceCommand::Cleaner => runtime::cleanup::run_helper(),
        ServiceCommand::Wake { pid, after_ms } => {
            runtime::chaos::wake_later(pid, Duration::from_millis(after_ms));
            Ok(())
        }
        ServiceCommand::Exec { words } => Err(orchestrator::process::exec(&words)),
    }
}

/// Times plain calls over a grid, and prints nanoseconds a tick: mean, and over the drives median and 99th
/// percentile. Like a ring, to standard error.
fn time_calls() -> anyhow::Result<()> {
    let config = config::Layers::maneuver("lane_change")?.resolve()?;
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
