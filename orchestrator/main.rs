//! The doorway: one binary that is the orchestrator, and every process that it starts.

use std::process::ExitCode;

use clap::Parser;
use clap::error::ErrorKind;
use orchestrator::Failure;
use orchestrator::cli::{Cli, Command, HopArg, ServiceCommand};
use runtime::ring::Hop;

fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => {
            let _ = error.print();
            return match error.kind() {
                ErrorKind::DisplayHelp | ErrorKind::DisplayVersion => ExitCode::SUCCESS,
                _ => ExitCode::from(64),
            };
        }
    };
    let result = match cli.command {
        Command::Train(args) => orchestrator::train(&args),
        Command::Bench(args) => orchestrator::bench(&args),
        Command::Config(command) => orchestrator::show_config(&command),
        Command::Service { service } => serve(service).map_err(Failure::from),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("pathtune: {}", failure.message());
            ExitCode::from(failure.code())
        }
    }
}

fn serve(service: ServiceCommand) -> anyhow::Result<()> {
    match service {
        ServiceCommand::Simulator => simulator::service::run(),
        ServiceCommand::Controller => controller::service::run(),
        ServiceCommand::Supervisor => supervisor::service::run(),
        ServiceCommand::Trainer => trainer::service::run(),
        ServiceCommand::Ring { hop, rounds } => runtime::ring::run(match hop {
            HopArg::First => Hop::First { rounds },
            HopArg::Second => Hop::Second,
            HopArg::Third => Hop::Third,
        }),
        ServiceCommand::Cleaner => runtime::cleanup::run_helper(),
        ServiceCommand::Exec { words } => Err(orchestrator::process::exec(&words)),
    }
}
