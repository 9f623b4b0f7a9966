//! The doorway: one binary that is the orchestrator, and every process that it starts.

use std::process::ExitCode;
use std::time::Duration;

use clap::Parser;
use clap::error::ErrorKind;
use orchestrator::cli::{Cli, Command, HopArg, RecordArgs, ServiceCommand};
use orchestrator::{Ended, Failure};
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
        Command::Record(args) => record(&args),
        Command::Bench(args) => orchestrator::bench(&args),
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

/// Records a living run from another terminal.
fn record(args: &RecordArgs) -> Result<(), Failure> {
    let run = orchestrator::living_run(args.run.as_deref())?;
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
    orchestrator::print_line(&summary.file.display().to_string())
}

fn serve(service: ServiceCommand) -> anyhow::Result<()> {
    match service {
        ServiceCommand::Simulator => simulator::service::run(),
        ServiceCommand::Controller => controller::service::run(),
        ServiceCommand::Supervisor => supervisor::service::run(),
        ServiceCommand::Trainer => trainer::service::run(),
        ServiceCommand::Schedule => trainer::schedule::run(),
        ServiceCommand::Recorder => recorder::service::run(),
        ServiceCommand::Ring { hop, rounds } => runtime::ring::run(match hop {
            HopArg::First => Hop::First { rounds },
            HopArg::Second => Hop::Second,
            HopArg::Third => Hop::Third,
        }),
        ServiceCommand::Cleaner => runtime::cleanup::run_helper(),
        ServiceCommand::Wake { pid, after_ms } => {
            runtime::chaos::wake_later(pid, Duration::from_millis(after_ms));
            Ok(())
        }
        ServiceCommand::Exec { words } => Err(orchestrator::process::exec(&words)),
    }
}
