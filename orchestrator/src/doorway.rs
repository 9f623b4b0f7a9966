//! From the command line to an exit code: which command does what.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::Parser;
use clap::error::ErrorKind;

use crate::bench::bench;
use crate::cli::{Cli, Command, MonitorArgs, RecordArgs, ReplayArgs};
use crate::commands;
use crate::conformance::conformance;
use crate::pipeline::services::Services;
use crate::runs::EndedRun;
use crate::runs::folder::refuse_earlier_run;
use crate::runs::result::name_files;
use crate::words::{Failure, print_failure, print_line, print_usage_error};

/// What the binary hands in: whatever links a service, which this library does not.
#[derive(Debug, Clone, Copy)]
pub struct House {
    /// Our own services.
    pub services: Services,
    /// What is done beside a pipeline.
    pub tools: Tools,
}

/// Commands that look at a run from outside, or at what it left.
#[derive(Debug, Clone, Copy)]
pub struct Tools {
    /// Draws the report of the run in a folder; names its page.
    pub report: fn(&Path) -> Result<PathBuf, String>,
    /// Looks into a living run.
    pub monitor: fn(MonitorArgs) -> Result<(), Failure>,
    /// Records a living run.
    pub record: fn(&RecordArgs) -> Result<(), Failure>,
    /// Replays a recording; whether nothing differed.
    pub replay: fn(&ReplayArgs, Services) -> Result<bool, Failure>,
}

/// Does what the command line says.
pub fn run(house: House) -> ExitCode {
    match Cli::try_parse() {
        Ok(cli) => match execute(cli.command, house) {
            Ok(true) => ExitCode::SUCCESS,
            Ok(false) => ExitCode::from(1),
            Err(failure) => {
                print_failure(&failure);
                ExitCode::from(failure.code())
            }
        },
        Err(error) => match error.kind() {
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
        },
    }
}

/// Whether all is well; what is not is printed already: a finding is no failure.
fn execute(command: Command, house: House) -> Result<bool, Failure> {
    let House { services, tools } = house;
    let draw = |ended: EndedRun| name_files(&ended, (tools.report)(&ended.folder));
    match command {
        Command::Train(args) => commands::train(&args, services).and_then(draw),
        Command::Validate(args) => commands::validate(&args, services).and_then(draw),
        Command::Drive(args) => commands::drive(&args, services).and_then(draw),
        Command::Rearm { run, vehicle } => commands::rearm(run.as_deref(), vehicle),
        Command::Grid(args) => commands::grid(&args, services).and_then(draw),
        Command::Report { run } => report(&run, tools),
        Command::Record(args) => (tools.record)(&args),
        Command::Replay(args) => return (tools.replay)(&args, services),
        Command::Bench(args) => bench(&args),
        Command::Monitor(args) => (tools.monitor)(args),
        Command::Status { json } => commands::status(json),
        Command::Stop { run } => commands::stop(run.as_deref()),
        Command::Logs { run, process, lines } => {
            commands::logs(run.as_deref(), process.as_deref(), lines)
        }
        Command::Clean { dry_run } => commands::clean(dry_run),
        Command::Doctor { json } => commands::doctor(json),
        Command::Config(command) => commands::show_config(&command),
        Command::Conformance(args) => return conformance(&args),
        Command::Schema(args) => commands::print_schema(&args),
        Command::Gains(command) => commands::gains(&command),
        Command::Service { name, words } => services.run(&name, &words),
    }
    .map(|()| true)
}

fn report(run: &Path, tools: Tools) -> Result<(), Failure> {
    refuse_earlier_run(run)?;
    let page = (tools.report)(run).map_err(Failure::User)?;
    print_line(&page.display().to_string())
}
