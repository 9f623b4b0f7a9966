//! From the command line to an exit code: which command does what.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::error::ErrorKind;
use clap::{CommandFactory, FromArgMatches};
use config::{Parameters, RunConfig, ZoneRegion};
use outcome::Margin;
use runtime::limits;

use crate::bench::bench;
use crate::cli::{
    CalibrateArgs, CertifyArgs, Cli, Command, CompareArgs, IdentifyArgs, MonitorArgs, RecordArgs,
    ReplayArgs,
};
use crate::commands;
use crate::conformance::conformance;
use crate::pipeline::services::Services;
use crate::runs::EndedRun;
use crate::runs::folder::refuse_earlier_run;
use crate::runs::result::name_files;
use crate::runs::setup::{BagReader, read_bags_with};
use crate::study::{StudyTools, sweep};
use crate::words::terminal::tell;
use crate::words::{Failure, print_failure, print_line, print_usage_error};

/// What the binary hands in: the parts that link services, which this library does not.
#[derive(Debug, Clone, Copy)]
pub struct House {
    /// Our own services.
    pub services: Services,
    /// Tools that are used alongside a pipeline.
    pub tools: Tools,
}

/// What gives the regions to which changes of gains along a path are held; or why there are none.
pub(crate) type RegionsOf = fn(&RunConfig, &[Parameters]) -> Result<Vec<ZoneRegion>, String>;

/// What `excite` drives.
#[derive(Debug, Clone, Copy)]
pub struct ExciteTools {
    /// How long it takes, in s.
    pub lasts_s: f64,
    /// The ground that a drive of our simulator takes with these parameters, the car's body and the way to a stop included:
    /// least and largest x, least and largest y (m), in the frame of the path.
    pub ground: fn(&RunConfig, &[Parameters]) -> [f64; 4],
}

/// Commands that observe a run from outside, or read what it has left.
#[derive(Debug, Clone, Copy)]
pub struct Tools {
    /// Draws the report of the run in a folder; returns the path of its page.
    pub report: fn(&Path) -> Result<PathBuf, String>,
    /// Compares tuners by plain calls: no pipeline, no run.
    pub compare: fn(&CompareArgs) -> Result<(), Failure>,
    /// What a study needs of them.
    pub study: StudyTools,
    /// Watches a living run.
    pub monitor: fn(MonitorArgs) -> Result<(), Failure>,
    /// Records a living run.
    pub record: fn(&RecordArgs) -> Result<(), Failure>,
    /// Replays a recording; returns whether nothing differed.
    pub replay: fn(&ReplayArgs, Services) -> Result<bool, Failure>,
    /// How much later the steering may act with these parameters, in this configuration, at this speed (m/s).
    pub margin: fn(&RunConfig, &Parameters, f64) -> Margin,
    /// What `excite` needs of them.
    pub excite: ExciteTools,
    /// Computes the regions to which changes of gains along a path are held.
    pub zone_regions: RegionsOf,
    /// Says what is certain of gains; returns whether what it was to verify holds.
    pub certify: fn(&CertifyArgs) -> Result<bool, Failure>,
    /// Calibrates an envelope.
    pub calibrate: fn(&CalibrateArgs) -> Result<(), Failure>,
    /// Notes a drive's score beside the envelope's file, and says whether the car has changed, in words; none if nothing was driven.
    pub journal: fn(&Path, &Path) -> Result<String, Failure>,
    /// What an envelope's file has seen of its car, in words.
    pub evidence: fn(&Path) -> Result<String, Failure>,
    /// Identifies a car from recorded drives.
    pub identify: fn(&IdentifyArgs) -> Result<(), Failure>,
    /// Reads the path of a bag of ROS 2.
    pub path_of_bag: BagReader,
}

/// Does what the command line says.
pub fn run(house: House) -> ExitCode {
    limits::raise();
    match limits::check_stack() {
        Ok(()) => run_with_stack(house),
        Err(why) => {
            print_failure(&Failure::User(why));
            ExitCode::from(64)
        }
    }
}

/// The command line. `-1` behind an option is its value, which that option may refuse by name, and no option of its own.
fn parsed() -> Result<Cli, clap::Error> {
    fn with_negative_values(command: clap::Command) -> clap::Command {
        let of_arg = |arg: clap::Arg| {
            let takes_values = arg.get_action().takes_values() && !arg.is_positional();
            if takes_values { arg.allow_negative_numbers(true) } else { arg }
        };
        command.mut_args(of_arg).mut_subcommands(with_negative_values)
    }
    let mut matches = with_negative_values(Cli::command()).try_get_matches()?;
    Cli::from_arg_matches_mut(&mut matches)
}

/// Not inlined: the check before it must come before the stack is used.
#[inline(never)]
fn run_with_stack(house: House) -> ExitCode {
    match parsed() {
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

/// Returns whether all is well. A finding is not a failure: what is wrong has been printed already.
fn execute(command: Command, house: House) -> Result<bool, Failure> {
    let House { services, tools } = house;
    read_bags_with(tools.path_of_bag);
    let draw = |ended: EndedRun| name_files(&ended, (tools.report)(&ended.folder));
    let of_drive = commands::DriveTools { regions: tools.zone_regions, evidence: tools.evidence };
    match command {
        Command::Train(args) => commands::train(&args, services).and_then(draw),
        Command::Validate(args) => commands::validate(&args, services).and_then(draw),
        Command::Drive(args) => {
            commands::drive(&args, services, of_drive).and_then(|(ended, held_to)| {
                let folder = ended.folder.clone();
                let drawn = draw(ended);
                // A drive that was stopped counts, too.
                if let Some(words) =
                    held_to.map(|file| (tools.journal)(&file, &folder)).transpose()?
                    && !words.is_empty()
                {
                    match args.setup.json {
                        true => tell!("pathtune: {words}"),
                        false => print_line(&words)?,
                    }
                }
                drawn
            })
        }
        Command::Rearm { run, vehicle } => commands::rearm(run.name(), vehicle),
        Command::Grid(args) => commands::grid(&args, services).and_then(draw),
        Command::Compare(args) => (tools.compare)(&args),
        Command::Sweep(command) => sweep(&command, services, tools.study),
        Command::Report { run } => report(&run, tools),
        Command::Record(args) => (tools.record)(&args),
        Command::Replay(args) => return (tools.replay)(&args, services),
        Command::Certify(args) => return (tools.certify)(&args),
        Command::Calibrate(args) => (tools.calibrate)(&args),
        Command::Bench(args) => bench(&args),
        Command::Monitor(args) => (tools.monitor)(args),
        Command::Status { run, json, iox2 } => commands::status(run.name(), json, iox2),
        Command::Stop { run } => commands::stop(run.name()),
        Command::Logs { run, process, lines } => {
            commands::logs(run.name(), process.as_deref(), lines)
        }
        Command::Clean { dry_run } => commands::clean(dry_run),
        Command::Doctor { json } => commands::doctor(json),
        Command::Config(command) => commands::show_config(&command),
        Command::Conformance(args) => return conformance(&args),
        Command::Schema(args) => commands::print_schema(&args),
        Command::Excite(args) => {
            commands::excite(&args, services, tools.excite, of_drive).and_then(draw)
        }
        Command::Identify(args) => (tools.identify)(&args),
        Command::Gains(command) => commands::gains(&command, tools.margin),
        Command::Service { name, words } => services.run(&name, &words),
    }
    .map(|()| true)
}

fn report(run: &Path, tools: Tools) -> Result<(), Failure> {
    refuse_earlier_run(run)?;
    let page = (tools.report)(run).map_err(Failure::User)?;
    print_line(&page.display().to_string())
}
