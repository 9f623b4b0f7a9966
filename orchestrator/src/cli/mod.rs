//! The command line.

mod calibrate;
mod compare;
mod excite;
mod identify;
mod over;
mod path;
mod sweep;
mod time;

use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, Parser, Subcommand, ValueEnum};
use config::StartAt;

pub use calibrate::CalibrateArgs;
pub use compare::CompareArgs;
pub use excite::ExciteArgs;
pub use identify::{CommandType, IdentifyArgs};
pub use over::OverArgs;
pub use path::PathReading;
pub use sweep::{EngineArgs, KubernetesArgs, RunJobsArgs, SlurmArgs, StudyArg, SweepCommand};

/// Tunes a path-tracking controller by reinforcement learning, in separate processes that communicate over shared
/// memory.
#[derive(Debug, Parser)]
#[command(name = "pathtune", version, arg_required_else_help = true)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// What to do.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Run a training for a manoeuvre to its end, and report how good the gains are
    Train(Box<TrainArgs>),
    /// Drive gain sets without noise and with it, and show the results next to the paper's figures
    Validate(Box<ValidateArgs>),
    /// Drive once with given gains: in lockstep, or in real time with our simulator or your own vehicle
    Drive(Box<DriveArgs>),
    /// Let a vehicle that was stopped drive again, from where it stands
    Rearm {
        /// The run.
        #[command(flatten)]
        run: RunArg,
        /// The vehicle's slot in the fleet [default: all stopped vehicles]
        #[arg(long, value_name = "I")]
        vehicle: Option<u32>,
    },
    /// Drive every gain set of the grid, and report the best, how flat the optimum is, and which gain matters
    Grid(Box<GridArgs>),
    /// Compare tuners over many seeds: how many drives they need, and how good the sets are that they recommend
    Compare(Box<CompareArgs>),
    /// Run a study of many trainings, on this machine or with the engine of a cluster
    #[command(subcommand)]
    Sweep(SweepCommand),
    /// Draw a report of a run: one HTML page, and its pictures as SVG files
    Report {
        /// The run's folder
        run: PathBuf,
    },
    /// Record a living run into an MCAP file from now on; to record a run from its first tick, start it with `--record`
    Record(RecordArgs),
    /// Drive a recording again, and say where the answers differ from the recorded ones
    Replay(ReplayArgs),
    /// Say what is certain of gains before they are driven: margins, regions of attraction, and how the path's joints look
    Certify(Box<CertifyArgs>),
    /// Learn what good drives with gains look like, so that the supervisor knows a drive that is none, with few false alarms
    Calibrate(Box<CalibrateArgs>),
    /// Measure what a tick costs, compared with a bare ring that passes on the same bytes
    Bench(BenchArgs),
    /// Watch a living run: how long each hop takes, and how regular the ticks are
    Monitor(MonitorArgs),
    /// List the living runs
    Status {
        /// The run.
        #[command(flatten)]
        run: RunArg,
        /// Print them as JSON, each with the root path and the prefix of its iceoryx2 and the folder of its results
        #[arg(long)]
        json: bool,
        /// Print the configuration with which iceoryx2's own command line sees the run
        #[arg(long, conflicts_with = "json")]
        iox2: bool,
    },
    /// Stop a living run
    Stop {
        /// The run.
        #[command(flatten)]
        run: RunArg,
    },
    /// Print the last lines of a run's logs
    Logs {
        /// The run, which may have ended if its folder is named.
        #[command(flatten)]
        run: RunArg,
        /// Print only the log of this process
        #[arg(long, value_name = "NAME")]
        process: Option<String>,
        /// Number of lines from each log
        #[arg(long, value_name = "N", default_value_t = 20)]
        lines: usize,
    },
    /// Remove what dead runs left behind
    Clean {
        /// Only say what would be removed
        #[arg(long)]
        dry_run: bool,
    },
    /// Check whether this machine has what a run needs, and say what to do if not
    Doctor {
        /// Print the findings as JSON
        #[arg(long)]
        json: bool,
    },
    /// List, print or write the presets
    #[command(subcommand)]
    Config(ConfigCommand),
    /// Check that a program can fill the vehicle's role
    Conformance(Box<ConformanceArgs>),
    /// Print the messages and topics for a process in another language, or the schema of result.json
    Schema(SchemaArgs),
    /// Drive what a vehicle is identified by (steering steps, a sine, speed steps), and record it
    Excite(Box<ExciteArgs>),
    /// Find a vehicle's values (wheelbase, dead times, lag, …) from recorded drives in it
    Identify(Box<IdentifyArgs>),
    /// Manage the gains in a vehicle's file: promote those of a training, or roll back
    #[command(subcommand)]
    Gains(GainsCommand),
    /// A process of a pipeline; started by the orchestrator, not by hand
    #[command(hide = true)]
    Service {
        /// Its name
        name: String,
        /// Its arguments
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        words: Vec<String>,
    },
}

/// The living run that is meant.
#[derive(Debug, Args)]
pub struct RunArg {
    /// The run: the beginning of its number, or its folder; may be left out if there is only one
    #[arg(value_name = "RUN")]
    run: Option<String>,
    /// As `record` and `monitor` have named it before.
    #[arg(long = "run", value_name = "RUN", hide = true, conflicts_with = "run")]
    option: Option<String>,
}

impl RunArg {
    /// What the user has named, if anything.
    pub fn name(&self) -> Option<&str> {
        self.run.as_deref().or(self.option.as_deref())
    }
}

/// Options of `train`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  pathtune train lane_change
  pathtune train roundabout --seed 7 --alphas 0.1,0.5 --out runs/mine
  pathtune train lane_change --set learning.gamma=0.8 --json
  pathtune train lane_change --tuner q --objective path
  pathtune train --path slalom.csv --noise
  pathtune train lane_change --replace vehicle='python3 my_vehicle.py'
  pathtune train lane_change --replace vehicle='./my_simulator' --deterministic")]
pub struct TrainArgs {
    /// The manoeuvre: lane_change, smooth_lane, roundabout or circuit; may be left out with --path
    pub maneuver: Option<String>,
    /// Resume a training that was stopped or killed; it comes to the same result as if left alone
    #[arg(
        long,
        value_name = "DIR",
        conflicts_with_all = [
            "maneuver", "alphas", "seed", "fleet", "episodes", "noise", "no_memo", "law", "objective",
            "tuner", "drives", "over", "over_by", "simulate_first", "within", "out",
            "config", "set", "launch", "replace", "deterministic", "path", "vehicle", "record", "record_split",
        ]
    )]
    pub resume: Option<PathBuf>,
    /// Learning rates in (0, 1], with one learner for each
    #[arg(long, value_delimiter = ',', value_name = "A,B,…", allow_negative_numbers = true)]
    pub alphas: Option<Vec<f64>>,
    /// Seed from which every random choice derives
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(..=i64::MAX as u64))]
    pub seed: Option<u64>,
    /// Episodes of each learner [default: the manoeuvre's]
    #[arg(long, value_name = "N")]
    pub episodes: Option<u32>,
    /// Put noise on the odometry
    #[arg(long)]
    pub noise: bool,
    /// Repeat drives that were made before instead of remembering them; does not change the result
    #[arg(long)]
    pub no_memo: bool,
    /// The tuner: a preset; `pathtune config list` lists them [default: educated-q]
    #[arg(long, value_name = "NAME")]
    pub tuner: Option<String>,
    /// Budget of drives, repeats under noise included; with --over, of sets, each driven on all plants; only for tuners
    /// without episodes [default: the tuner's]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub drives: Option<u32>,
    /// Simulate all sets on N plants first, which are vehicles that the car may really be; then drive few of them, of --drives
    /// K in all: the best ones in turn with the textbook's set, and the best of them at the end
    #[arg(
        long, value_name = "N", conflicts_with_all = ["tuner", "episodes", "alphas", "over"],
        value_parser = clap::value_parser!(u32).range(2..=256),
    )]
    pub simulate_first: Option<u32>,
    /// Drive only sets that stay within M metres of the path on all simulated plants [default: 1, or where the supervisor
    /// stops the car, if that is less]
    #[arg(long, value_name = "M", requires = "simulate_first")]
    pub within: Option<f64>,
    /// Over which plants each set is driven.
    #[command(flatten)]
    pub over: OverArgs,
    /// Options that every run has.
    #[command(flatten)]
    pub setup: SetupArgs,
}

/// Options of `validate`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  pathtune validate lane_change
  pathtune validate circuit --json
  pathtune validate lane_change --gains 3,21,21,0.7 --gains 1.26,11,21,0.84 --repeats 100
  pathtune validate circuit --gains 3,21,21,0.7/3.4,21,1,0.84
  pathtune validate --path slalom.csv --gains 3,21,21,0.7")]
pub struct ValidateArgs {
    /// The manoeuvre: lane_change, smooth_lane, roundabout or circuit; may be left out with --path
    pub maneuver: Option<String>,
    /// Gains to drive instead of the paper's: numbers in the law's order, Kv,Kl,Ks,Ki for the paper's law; for a path
    /// with several manoeuvres, one set for each, as in 3,21,21,0.7/3.4,21,1,0.84; repeatable
    #[arg(long, value_name = "A,B,…", allow_hyphen_values = true)]
    pub gains: Vec<String>,
    /// Noisy drives of each set, with the noise seeds 1, 2, …
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u32).range(2..=10_000))]
    pub repeats: u32,
    /// Hold the drives of a single set to an envelope that `calibrate` wrote for it, as `drive --envelope` does
    #[arg(long, value_name = "FILE")]
    pub envelope: Option<PathBuf>,
    /// Options that every run has.
    #[command(flatten)]
    pub setup: SetupArgs,
}

/// Options of `drive`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  pathtune drive lane_change --realtime
  pathtune drive circuit --realtime --gains 3,21,21,0.7/3.4,21,1,0.84
  pathtune drive lane_change --realtime --from runs/mine
  pathtune drive lane_change --adapter ros2-vehicle --vehicle my_car.toml
  pathtune drive --path slalom.csv --gains 3,21,21,0.7 --realtime --replace vehicle='python3 my_car.py'")]
pub struct DriveArgs {
    /// The manoeuvre: lane_change, smooth_lane, roundabout or circuit; may be left out with --path
    pub maneuver: Option<String>,
    /// The gains: numbers in the law's order, Kv,Kl,Ks,Ki for the paper's law; for a path with several manoeuvres, one
    /// set for each, as in 3,21,21,0.7/3.4,21,1,0.84 [default: those promoted to the vehicle, or the paper's, or
    /// another law's defaults]
    #[arg(long, value_name = "A,B,…", allow_hyphen_values = true)]
    pub gains: Option<String>,
    /// Use the gains that a training has found; for a path with several manoeuvres, give one training for each;
    /// repeatable
    #[arg(long, value_name = "RUN", conflicts_with = "gains")]
    pub from: Vec<PathBuf>,
    /// Drive by the clock: the vehicle publishes every tick without waiting for answers, late answers are not made up
    /// for, and a restarted process joins the drive under way
    #[arg(long)]
    pub realtime: bool,
    /// Put noise on the odometry of our simulator
    #[arg(long)]
    pub noise: bool,
    /// Hold the drive to an envelope that `calibrate` wrote for it: the gate stops the vehicle once it drives otherwise
    /// than good drives do, and the result has the drive's score
    #[arg(long, value_name = "FILE")]
    pub envelope: Option<PathBuf>,
    /// Only tell whether the drive was out of its envelope, and do not stop it for that
    #[arg(long)]
    pub only_judge: bool,
    /// Put off a change of gains along the path as long as the gains to come are not certain to hold the vehicle as it
    /// drives then: until V of their certified region is at most 1
    #[arg(long)]
    pub hold_switches: bool,
    /// Use one of our adapters instead of the simulator: ros2-vehicle; implies --realtime
    #[arg(long, value_name = "SERVICE", conflicts_with = "replace")]
    pub adapter: Option<String>,
    /// Options that every run has.
    #[command(flatten)]
    pub setup: SetupArgs,
}

/// Options of `grid`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  pathtune grid lane_change
  pathtune grid roundabout --gains 3.4,21,1,0.84 --json")]
pub struct GridArgs {
    /// The manoeuvre: lane_change, smooth_lane, roundabout or circuit; may be left out with --path
    pub maneuver: Option<String>,
    /// Gains to rank among those of the grid: numbers in the law's order, Kv,Kl,Ks,Ki for the paper's law; repeatable
    #[arg(long, value_name = "A,B,…", allow_hyphen_values = true)]
    pub gains: Vec<String>,
    /// Over which plants each set is driven.
    #[command(flatten)]
    pub over: OverArgs,
    /// Put noise on the odometry; with --over alone, where each plant has the same noise for all sets
    #[arg(long, requires = "over")]
    pub noise: bool,
    /// Options that every run has.
    #[command(flatten)]
    pub setup: SetupArgs,
}

/// Options of every command that runs a pipeline.
#[derive(Debug, Args)]
pub struct SetupArgs {
    /// A path of your own: a table with the columns x_m,y_m and optionally v_mps, a raceline separated by ';', waypoints
    /// without a header, UTM, latitude and longitude, GPX; how it was read is told. A TOML file next to it may hold zones
    #[arg(long, value_name = "FILE")]
    pub path: Option<PathBuf>,
    /// How its file is read.
    #[command(flatten)]
    pub reading: PathReading,
    /// Drives a path that ends where it begins N times (the key path.laps); result.json holds time and distance of each
    /// lap [default: 1]
    #[arg(long, value_name = "N", requires = "path")]
    pub laps: Option<u32>,
    /// Begins a path that ends where it begins at the point nearest to this place, in metres in the path's frame; where it
    /// passes twice, the heading in radians decides [default: the first point of the file]
    #[arg(long, value_name = "X,Y[,YAW]", requires = "path", allow_hyphen_values = true)]
    pub start: Option<StartAt>,
    /// The vehicle: a preset, or a file that overrides keys of the default vehicle
    #[arg(long, value_name = "NAME|FILE")]
    pub vehicle: Option<String>,
    /// The control law: a preset, or a file that overrides keys of one; `pathtune config list` lists the presets
    /// [default: paper]
    #[arg(long, value_name = "NAME|FILE")]
    pub law: Option<String>,
    /// The objective by which drives are judged, smaller being better: a preset; `pathtune config list` lists them
    /// [default: distance]
    #[arg(long, value_name = "NAME")]
    pub objective: Option<String>,
    /// Number of vehicles that drive in the same tick; does not change the result [default: one per learner, or as many
    /// as there are drives]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=256))]
    pub fleet: Option<u32>,
    /// Folder for configuration, journal, logs and result [default: runs/MANEUVER-TIME]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// TOML file that overrides keys of the presets
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Set one key, overriding everything else, as in --set learning.gamma=0.8; repeatable
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Launch file: lists the processes that make up the pipeline
    #[arg(long, value_name = "FILE")]
    pub launch: Option<PathBuf>,
    /// Run a program of yours in a role (vehicle, supervisor, controller, trainer); repeatable
    #[arg(long, value_name = "ROLE=COMMAND")]
    pub replace: Vec<String>,
    /// Declare that what --replace puts in place gives the same drive for the same request: then drives may be answered
    /// from memory, and one drive of a set is enough
    #[arg(long, requires = "replace")]
    pub deterministic: bool,
    /// Record the run from its first tick, without loss, into recording.mcap in its folder
    #[arg(long)]
    pub record: bool,
    /// Continue in another file (recording-0001.mcap, …) once one reaches this size, as in 500M
    #[arg(long, value_name = "SIZE", requires = "record", value_parser = parse_size)]
    pub record_split: Option<u64>,
    /// How often each process may die within ten seconds and be started again; once more, and the run is given up.
    /// Drives that are finished in between clear the count. A launch file may say another number for a process
    #[arg(long, value_name = "N", default_value_t = 5)]
    pub restart_budget: u32,
    /// Inject faults, as in 'kill controller@drive=12,tick=300; stop simulator@drive=20 for 2s; drop command p=0.001;
    /// delay odometry 5ms; random:2'
    #[arg(long, value_name = "SCRIPT")]
    pub chaos: Option<String>,
    /// Seed of random faults
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub chaos_seed: u64,
    /// How the processes of the ring wait for each other
    #[arg(long, value_enum, default_value_t = WaitArg::Auto)]
    pub wait: WaitArg,
    /// How many rings of processes share the drives, each on a core of its own [default: one for 32 vehicles of the fleet, while
    /// cores are free]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=32))]
    pub rings: Option<u8>,
    /// When driving by the clock: request SCHED_FIFO with this priority, and locked memory [default: 50]
    #[arg(
        long,
        value_name = "PRIORITY",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = "50",
        value_parser = clap::value_parser!(u8).range(1..=99)
    )]
    pub fifo: Option<u8>,
    /// Do not show progress
    #[arg(long, short)]
    pub quiet: bool,
    /// Print result.json instead of the table
    #[arg(long)]
    pub json: bool,
}

/// Options of `certify`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  pathtune certify circuit --gains 3,21,21,0.7/3.4,21,1,0.84 --speeds 1.45,4
  pathtune certify runs/mine --vehicle my_car.toml
  pathtune certify lane_change --over default --report pictures
  pathtune certify lane_change --write lane_change.json
  pathtune certify --check lane_change.json")]
pub struct CertifyArgs {
    /// The folder of a finished training, or a manoeuvre: lane_change, smooth_lane, roundabout or circuit; may be left out
    /// with --path
    #[arg(value_name = "RUN|MANEUVER")]
    pub what: Option<String>,
    /// The gains of the paper's law, Kv,Kl,Ks,Ki; for a path with several manoeuvres, one set for each, as in
    /// 3,21,21,0.7/3.4,21,1,0.84 [default: those of the training; else those promoted to the vehicle, or the paper's]
    #[arg(long, value_name = "A,B,…", allow_hyphen_values = true)]
    pub gains: Option<String>,
    /// Use the gains that a training has found; for a path with several manoeuvres, give one training for each;
    /// repeatable
    #[arg(long, value_name = "RUN", conflicts_with = "gains")]
    pub from: Vec<PathBuf>,
    /// Speeds of the reference in m/s [default: that of the path]
    #[arg(long, value_name = "V,W,…", value_delimiter = ',', value_parser = speed, allow_hyphen_values = true)]
    pub speeds: Vec<f64>,
    /// A path of your own, as for `drive`
    #[arg(long, value_name = "FILE", conflicts_with = "what")]
    pub path: Option<PathBuf>,
    /// How its file is read.
    #[command(flatten)]
    pub reading: PathReading,
    /// The vehicle: a preset, or a file that overrides keys of the default vehicle
    #[arg(long, value_name = "NAME|FILE")]
    pub vehicle: Option<String>,
    /// The control law; there are certificates for the paper's alone, and Δ and the simulated region for all
    #[arg(long, value_name = "NAME|FILE")]
    pub law: Option<String>,
    /// Set one key, overriding everything else; repeatable
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Say the same of plants, too, which are vehicles that the car may really be: `default` for eight around the vehicle's
    /// file and a faster drive, or a TOML file of `plants`, as for `train`
    #[arg(long, value_name = "default|FILE")]
    pub over: Option<String>,
    /// Print all figures as JSON
    #[arg(long)]
    pub json: bool,
    /// Draw the regions with simulated starts, and Δ over the speed, as a page with SVG pictures in this folder
    #[arg(long, value_name = "DIR")]
    pub report: Option<PathBuf>,
    /// Write the certified regions into a new file, which --check verifies
    #[arg(long, value_name = "FILE")]
    pub write: Option<PathBuf>,
    /// Verify such a file, from its numbers alone; ends with 1 if anything in it is not so
    #[arg(
        long,
        value_name = "FILE",
        conflicts_with_all = [
            "what", "gains", "from", "speeds", "path", "vehicle", "law", "set", "write", "over", "report",
        ]
    )]
    pub check: Option<PathBuf>,
}

/// A speed of the reference.
fn speed(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(speed) if speed > 0.0 && speed <= 100.0 => Ok(speed),
        _ => Err("is not a speed above 0 and up to 100 m/s".to_owned()),
    }
}

/// Options of `record`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  pathtune record
  pathtune record 3f --out drive.mcap --for 10s")]
pub struct RecordArgs {
    /// The run.
    #[command(flatten)]
    pub run: RunArg,
    /// The file to write [default: recording.mcap in the run's folder, or the same with the next free number]
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// How long, as in 10s, 1m30s or 500ms [default: until the run ends]
    #[arg(long = "for", value_name = "TIME", value_parser = time::above_zero, allow_hyphen_values = true)]
    pub time: Option<Duration>,
    /// Continue in another file once one reaches this size, as in 500M
    #[arg(long, value_name = "SIZE", value_parser = parse_size)]
    pub record_split: Option<u64>,
}

/// Options of `replay`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  pathtune replay runs/mine/recording.mcap
  pathtune replay recording.mcap --gains 3,21,21,0.7/3.4,21,1,0.9
  pathtune replay recording.mcap --from 25s --to 30s --realtime")]
pub struct ReplayArgs {
    /// The recording of a run that was started with --record
    pub file: PathBuf,
    /// Gains to use instead of the recorded ones: numbers in the law's order, Kv,Kl,Ks,Ki for the paper's law; for a
    /// path with several manoeuvres, one set for each
    #[arg(long, value_name = "A,B,…", allow_hyphen_values = true)]
    pub gains: Option<String>,
    /// TOML file that overrides keys of the recorded configuration
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Set one key, overriding everything else, as in --set supervisor.speed_limit_mps=3; repeatable
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Compare each drive from this time on, as in 25s or 1m30s; the drive itself still begins at its start
    #[arg(long, value_name = "TIME", default_value = "0s", value_parser = time::from_zero, allow_hyphen_values = true)]
    pub from: Duration,
    /// Compare each drive up to this time
    #[arg(long, value_name = "TIME", value_parser = time::from_zero, allow_hyphen_values = true)]
    pub to: Option<Duration>,
    /// Replay at the speed at which it was driven, not as fast as possible
    #[arg(long)]
    pub realtime: bool,
    /// Replay this many times as fast as it was driven
    #[arg(long, value_name = "X", conflicts_with = "realtime", value_parser = parse_speed)]
    pub speed: Option<f64>,
}

/// Below a tenth, a tick would last longer than a process may be silent before it is taken for frozen.
fn parse_speed(text: &str) -> Result<f64, String> {
    let number = text.parse::<f64>().ok().filter(|it| (0.1..=1e6).contains(it));
    number.ok_or_else(|| "is not a number from 0.1 to 1e6".to_owned())
}

/// `64k`, `500M`, `2G`: powers of 1024.
fn parse_size(text: &str) -> Result<u64, String> {
    let why = || "is not a size; write it as in 500M or 2G; the least is 64k".to_owned();
    let split = text.find(|c: char| c.is_ascii_alphabetic()).unwrap_or(text.len());
    let shift =
        match text[split..].to_ascii_lowercase().trim_end_matches("ib").trim_end_matches('b') {
            "" => 0,
            "k" => 10,
            "m" => 20,
            "g" => 30,
            "t" => 40,
            _ => return Err(why()),
        };
    let number: u64 = text[..split].parse().map_err(|_| why())?;
    number.checked_mul(1 << shift).filter(|size| *size >= 64 << 10).ok_or_else(why)
}

/// Options of `bench`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  pathtune bench
  pathtune bench --only pipeline/ --only calls --json
  pathtune bench --realtime 60s")]
pub struct BenchArgs {
    /// Number of measurements for each row
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub rounds: u32,
    /// Measure only the rows whose names begin with this; repeatable
    #[arg(long, value_name = "NAME")]
    pub only: Vec<String>,
    /// Instead, drive at 100 Hz for this long (as in 10s or 1m30s), first on a quiet machine and then with a load on
    /// all cores, and report how late commands are
    #[arg(long, value_name = "TIME", value_parser = time::above_zero, conflicts_with_all = ["only", "rounds"])]
    pub realtime: Option<Duration>,
    /// Print the rows as JSON
    #[arg(long)]
    pub json: bool,
}

/// Options of `monitor`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  pathtune monitor
  pathtune monitor --json --for 10s
  pathtune monitor --once --budget 1ms
  pathtune monitor 3f --vehicle 2 --csv latency.csv")]
pub struct MonitorArgs {
    /// The run.
    #[command(flatten)]
    pub run: RunArg,
    /// Show the flags of the vehicle in this slot of the fleet
    #[arg(long, value_name = "I", default_value_t = 0)]
    pub vehicle: usize,
    /// Print one JSON object per second: percentiles of the last second, counts since the beginning
    #[arg(long)]
    pub json: bool,
    /// Write the same figures to this file, one row per second
    #[arg(long, value_name = "FILE")]
    pub csv: Option<PathBuf>,
    /// How long to watch, as in 10s, 1m30s or 500ms [default: until the run ends]
    #[arg(long = "for", value_name = "TIME", value_parser = time::above_zero, allow_hyphen_values = true)]
    pub duration: Option<Duration>,
    /// Print a single report, over a second in which ticks are driven or over the time given by --for, and end
    #[arg(long)]
    pub once: bool,
    /// How long it may take from odometry to the applied command, as in 1ms; anything longer is a deadline miss
    /// [default: the run's tick]
    #[arg(long, value_name = "TIME", value_parser = time::above_zero, allow_hyphen_values = true)]
    pub budget: Option<Duration>,
    /// Serve the figures to Prometheus on this address, as in 127.0.0.1:9464; not available in every build
    #[arg(long, value_name = "ADDR")]
    pub prometheus: Option<SocketAddr>,
}

/// How processes wait for each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum WaitArg {
    /// Chosen to suit the cores, the fleet and the mode
    Auto,
    /// All share one core, and each yields it to the next; a process goes to sleep after waiting 100 µs
    Yield,
    /// Each has a core of its own and keeps polling; a process goes to sleep after waiting 100 µs
    Spin,
    /// Each goes to sleep at once, and is woken by each message
    Block,
}

/// Options of `conformance`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  pathtune conformance -- python3 my_vehicle.py
  pathtune conformance --allow-motion --json -- python3 my_vehicle.py
  pathtune conformance --allow-motion --realtime -- ./my_car --port 3
  pathtune conformance --allow-motion -- pathtune service simulator")]
pub struct ConformanceArgs {
    /// Also make the checks that move the vehicle: slowly, about ten metres, and to the left
    #[arg(long)]
    pub allow_motion: bool,
    /// Set run.realtime: the vehicle must pace by the clock
    #[arg(long)]
    pub realtime: bool,
    /// The vehicle claims that the same request gives the same drive
    #[arg(long)]
    pub deterministic: bool,
    /// The manoeuvre whose configuration the vehicle reads
    #[arg(long, value_name = "NAME", default_value = "lane_change")]
    pub maneuver: String,
    /// The vehicle: a preset, or a file that overrides keys of the default vehicle
    #[arg(long, value_name = "NAME|FILE")]
    pub vehicle: Option<String>,
    /// Set one key, overriding everything else, as in --set drive.tick_s=0.02; repeatable
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Folder in which to keep configuration and log [default: a temporary one]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print the findings as JSON
    #[arg(long)]
    pub json: bool,
    /// The program to check, with its arguments
    #[arg(last = true, required = true, value_name = "CMD")]
    pub command: Vec<String>,
}

/// What to print, and in which language.
#[derive(Debug, Args)]
#[group(required = true, multiple = false)]
#[command(after_help = "Examples:
  pathtune schema --python > pathtune_messages.py
  pathtune schema --c > pathtune_messages.h
  pathtune schema --result > result.schema.json")]
pub struct SchemaArgs {
    /// A Python module of ctypes structures
    #[arg(long)]
    pub python: bool,
    /// A C header
    #[arg(long)]
    pub c: bool,
    /// The JSON Schema of result.json
    #[arg(long)]
    pub result: bool,
}

/// What to do with the presets.
#[derive(Debug, Subcommand)]
pub enum ConfigCommand {
    /// List the manoeuvres, vehicles, laws, tuners and objectives
    List,
    /// Print the presets, each key with its description, or one key wherever it is set
    Show {
        /// Print only the presets whose path contains this word, as in laws or lane_change; or a key, as in goal_radius_m
        name: Option<String>,
    },
    /// Write into a folder what you can edit: overlay.toml for --config, which changes nothing until a key is uncommented, and
    /// the presets
    Init {
        /// The folder; created if it does not exist
        #[arg(default_value = "pathtune-config")]
        folder: PathBuf,
    },
}

/// What to do with the gains in a vehicle's file.
#[derive(Debug, Subcommand)]
pub enum GainsCommand {
    /// List the gains of each manoeuvre
    List {
        /// The vehicle's file
        vehicle: PathBuf,
        /// Print them as JSON
        #[arg(long)]
        json: bool,
    },
    /// Show the gains of a manoeuvre, where they come from, and which gains were there before
    Show {
        /// The vehicle's file
        vehicle: PathBuf,
        /// The manoeuvre
        maneuver: String,
        /// Print them as JSON
        #[arg(long)]
        json: bool,
    },
    /// Write the gains of a finished training into the vehicle's file
    #[command(after_help = "Examples:
  pathtune gains promote runs/mine car.toml --dry-run
  pathtune gains promote runs/mine car.toml
  pathtune drive lane_change --vehicle car.toml --realtime")]
    Promote {
        /// Folder of the training
        run: PathBuf,
        /// The vehicle's file
        vehicle: PathBuf,
        /// Promote even if the set is fragile, a gain changes by more than 30 %, the gains replace those of another law,
        /// or the training was of a vehicle with another geometry
        #[arg(long)]
        force: bool,
        /// Only say what would change
        #[arg(long)]
        dry_run: bool,
    },
    /// Restore the gains that were there before
    Rollback {
        /// The vehicle's file
        vehicle: PathBuf,
        /// The manoeuvre; may be left out if there is only one
        maneuver: Option<String>,
        /// Restore the N-th newest set of the history, as numbered by `gains show` [default: the newest that a
        /// promotion replaced]
        #[arg(long, value_name = "N")]
        to: Option<usize>,
    },
}
