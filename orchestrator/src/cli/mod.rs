//! The command line.

mod time;

use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, Parser, Subcommand, ValueEnum};

/// Tunes a path-tracking controller by reinforcement learning, as separate processes over shared memory.
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
    /// Train a manoeuvre to its end, and say how good the gains are
    Train(Box<TrainArgs>),
    /// Drive gain sets without noise and with it, beside the paper's figures
    Validate(Box<ValidateArgs>),
    /// Drive once with given gains: in lockstep, or in real time with our simulator or a vehicle of yours
    Drive(Box<DriveArgs>),
    /// Let a vehicle that was stopped drive again, from where it stands
    Rearm {
        /// The start of the run's number, or its folder; may be left out if there is only one
        run: Option<String>,
        /// Slot of the fleet [default: all that are stopped]
        #[arg(long, value_name = "I")]
        vehicle: Option<u32>,
    },
    /// Drive every gain set of the grid: the best, how flat the optimum is, which gain matters
    Grid(Box<GridArgs>),
    /// Draw a run: one HTML page, and its pictures as SVG files
    Report {
        /// The run's folder
        run: PathBuf,
    },
    /// Record a living run into an MCAP file, from now on; `--record` of train, validate and grid records all of it
    Record(RecordArgs),
    /// Drive a recording again, and say where the answers differ from the recorded ones
    Replay(ReplayArgs),
    /// Measure what a tick costs, beside a bare ring of the same bytes
    Bench(BenchArgs),
    /// Look into a living run: how long each hop takes, how regular the ticks are
    Monitor(MonitorArgs),
    /// List the living runs
    Status {
        /// Print them as JSON
        #[arg(long)]
        json: bool,
    },
    /// Stop a living run
    Stop {
        /// The start of its number, or its folder; may be left out if there is only one
        run: Option<String>,
    },
    /// Print the ends of a run's logs
    Logs {
        /// The start of a living run's number, or a folder; may be left out if there is only one
        run: Option<String>,
        /// Only of this process
        #[arg(long, value_name = "NAME")]
        process: Option<String>,
        /// Lines of each
        #[arg(long, value_name = "N", default_value_t = 20)]
        lines: usize,
    },
    /// Remove what dead runs left behind
    Clean {
        /// Only say what would be removed
        #[arg(long)]
        dry_run: bool,
    },
    /// Check what a run needs of this machine, and say what to do
    Doctor {
        /// Print the findings as JSON
        #[arg(long)]
        json: bool,
    },
    /// Show or write the presets
    #[command(subcommand)]
    Config(ConfigCommand),
    /// Check that a program can fill the vehicle's role
    Conformance(Box<ConformanceArgs>),
    /// Print the messages and topics for a process in another language, or the schema of result.json
    Schema(SchemaArgs),
    /// The gains in a vehicle's file: bring those of a training there, and back
    #[command(subcommand)]
    Gains(GainsCommand),
    /// A process of a pipeline; started by the orchestrator, not by hand
    #[command(hide = true)]
    Service {
        /// Its name
        name: String,
        /// Words for it
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        words: Vec<String>,
    },
}

/// Options of `train`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  pathtune train lane_change
  pathtune train roundabout --seed 7 --alphas 0.1,0.5 --out runs/mine
  pathtune train lane_change --set learning.gamma=0.8 --json
  pathtune train lane_change --tuner q --objective path
  pathtune train --path slalom.csv --noise
  pathtune train lane_change --replace vehicle='python3 my_vehicle.py'")]
pub struct TrainArgs {
    /// The manoeuvre: lane_change, roundabout or circuit; may be left out with --path
    pub maneuver: Option<String>,
    /// Go on with a training that was stopped or killed, to the same result
    #[arg(
        long,
        value_name = "DIR",
        conflicts_with_all = [
            "maneuver", "alphas", "seed", "fleet", "episodes", "noise", "no_memo", "law", "objective",
            "tuner", "out",
            "config", "set", "launch", "replace", "path", "vehicle", "record", "record_split",
        ]
    )]
    pub resume: Option<PathBuf>,
    /// Learning rates, one learner each, in (0, 1]
    #[arg(long, value_delimiter = ',', value_name = "A,B,…", allow_negative_numbers = true)]
    pub alphas: Option<Vec<f64>>,
    /// Every random choice derives from it
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(..=i64::MAX as u64))]
    pub seed: Option<u64>,
    /// Episodes of each learner [default: the manoeuvre's]
    #[arg(long, value_name = "N")]
    pub episodes: Option<u32>,
    /// Put noise on the odometry
    #[arg(long)]
    pub noise: bool,
    /// Drive again what was driven before; changes no result
    #[arg(long)]
    pub no_memo: bool,
    /// Who tunes: a preset, as `pathtune config list` names them [default: educated-q]
    #[arg(long, value_name = "NAME")]
    pub tuner: Option<String>,
    /// What every run can be told.
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
    /// The manoeuvre: lane_change, roundabout or circuit; may be left out with --path
    pub maneuver: Option<String>,
    /// Gains instead of the paper's: numbers in the law's order, Kv,Kl,Ks,Ki for the paper's law; for a path with several manoeuvres a set for each, as in 3,21,21,0.7/3.4,21,1,0.84; repeatable
    #[arg(long, value_name = "A,B,…", allow_hyphen_values = true)]
    pub gains: Vec<String>,
    /// Noisy drives of each set, with the noise seeds 1, 2, …
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u32).range(2..=10_000))]
    pub repeats: u32,
    /// What every run can be told.
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
    /// The manoeuvre: lane_change, roundabout or circuit; may be left out with --path
    pub maneuver: Option<String>,
    /// The gains: numbers in the law's order, Kv,Kl,Ks,Ki for the paper's law; for a path with several manoeuvres a set for each, as in 3,21,21,0.7/3.4,21,1,0.84 [default: those promoted to the vehicle, or the paper's, or another law's defaults]
    #[arg(long, value_name = "A,B,…", allow_hyphen_values = true)]
    pub gains: Option<String>,
    /// The gains that a training has found; for a path with several manoeuvres a training of each; repeatable
    #[arg(long, value_name = "RUN", conflicts_with = "gains")]
    pub from: Vec<PathBuf>,
    /// By the clock: the vehicle publishes every tick and waits for nobody, late answers are late, and a restarted process joins
    #[arg(long)]
    pub realtime: bool,
    /// Put noise on the odometry of our simulator
    #[arg(long)]
    pub noise: bool,
    /// One of our adapters instead of the simulator: ros2-vehicle; implies --realtime
    #[arg(long, value_name = "SERVICE", conflicts_with = "replace")]
    pub adapter: Option<String>,
    /// What every run can be told.
    #[command(flatten)]
    pub setup: SetupArgs,
}

/// Options of `grid`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  pathtune grid lane_change
  pathtune grid roundabout --gains 3.4,21,1,0.84 --json")]
pub struct GridArgs {
    /// The manoeuvre: lane_change, roundabout or circuit; may be left out with --path
    pub maneuver: Option<String>,
    /// Gains to be ranked among those of the grid: numbers in the law's order, Kv,Kl,Ks,Ki for the paper's law; repeatable
    #[arg(long, value_name = "A,B,…", allow_hyphen_values = true)]
    pub gains: Vec<String>,
    /// What every run can be told.
    #[command(flatten)]
    pub setup: SetupArgs,
}

/// Options of every command that runs a pipeline.
#[derive(Debug, Args)]
pub struct SetupArgs {
    /// A path of your own: CSV with x_m,y_m and perhaps v_mps, or a raceline with ';'; a TOML file beside it may hold zones
    #[arg(long, value_name = "FILE")]
    pub path: Option<PathBuf>,
    /// A vehicle: a preset, or a file on top of the default one
    #[arg(long, value_name = "NAME|FILE")]
    pub vehicle: Option<String>,
    /// The control law: a preset, or a file on top of one; `pathtune config list` names them [default: paper]
    #[arg(long, value_name = "NAME|FILE")]
    pub law: Option<String>,
    /// What drives are judged by, the smaller the better: a preset, as `pathtune config list` names them [default: distance]
    #[arg(long, value_name = "NAME")]
    pub objective: Option<String>,
    /// Vehicles that drive in the same tick; changes no result [default: one a learner, or as many as there is to drive]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=256))]
    pub fleet: Option<u32>,
    /// Folder for configuration, journal, logs and result [default: runs/MANEUVER-TIME]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// TOML file on top of the presets
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// One key on top of everything, as in --set learning.gamma=0.8; repeatable
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Launch file: which processes make up the pipeline
    #[arg(long, value_name = "FILE")]
    pub launch: Option<PathBuf>,
    /// A program of yours in a role (vehicle, supervisor, controller, trainer); repeatable
    #[arg(long, value_name = "ROLE=COMMAND")]
    pub replace: Vec<String>,
    /// Record the run from its first tick, without a loss, into recording.mcap in its folder
    #[arg(long)]
    pub record: bool,
    /// Go on in another file (recording-0001.mcap, …) at this size, as in 500M
    #[arg(long, value_name = "SIZE", requires = "record", value_parser = parse_size)]
    pub record_split: Option<u64>,
    /// Restarts that each process gets in ten seconds
    #[arg(long, value_name = "N", default_value_t = 5)]
    pub restart_budget: u32,
    /// Faults on purpose, as in 'kill controller@drive=12,tick=300; stop simulator@drive=20 for 2s; drop command p=0.001; delay odometry 5ms; random:2'
    #[arg(long, value_name = "SCRIPT")]
    pub chaos: Option<String>,
    /// Seed of random faults
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub chaos_seed: u64,
    /// How the processes of the ring wait for each other
    #[arg(long, value_enum, default_value_t = WaitArg::Auto)]
    pub wait: WaitArg,
    /// By the clock: ask for SCHED_FIFO with this priority, and for locked memory [default: 50]
    #[arg(
        long,
        value_name = "PRIORITY",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = "50",
        value_parser = clap::value_parser!(u8).range(1..=99)
    )]
    pub fifo: Option<u8>,
    /// No progress
    #[arg(long, short)]
    pub quiet: bool,
    /// Print result.json instead of the table
    #[arg(long)]
    pub json: bool,
}

/// Options of `record`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  pathtune record
  pathtune record --run 3f --out drive.mcap --for 10s")]
pub struct RecordArgs {
    /// The start of the run's number, or its folder; may be left out if there is only one
    #[arg(long, value_name = "RUN")]
    pub run: Option<String>,
    /// The file [default: recording.mcap in the run's folder, or the next free number]
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// How long, as in 10s, 1m30s or 500ms [default: until the run ends]
    #[arg(long = "for", value_name = "TIME", value_parser = time::above_zero, allow_hyphen_values = true)]
    pub time: Option<Duration>,
    /// Go on in another file at this size, as in 500M
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
    /// The recording: of a run with --record
    pub file: PathBuf,
    /// Gains instead of the recorded ones: numbers in the law's order, Kv,Kl,Ks,Ki for the paper's law; for a path with several manoeuvres a set for each
    #[arg(long, value_name = "A,B,…", allow_hyphen_values = true)]
    pub gains: Option<String>,
    /// TOML file on top of the recorded configuration
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// One key on top of everything, as in --set supervisor.speed_limit_mps=3; repeatable
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Compare each drive from this time on, as in 25s or 1m30s; it is driven from its start all the same
    #[arg(long, value_name = "TIME", default_value = "0s", value_parser = time::from_zero, allow_hyphen_values = true)]
    pub from: Duration,
    /// Compare each drive up to this time
    #[arg(long, value_name = "TIME", value_parser = time::from_zero, allow_hyphen_values = true)]
    pub to: Option<Duration>,
    /// As fast as it was driven, not as fast as it goes
    #[arg(long)]
    pub realtime: bool,
    /// So many times as fast as it was driven
    #[arg(long, value_name = "X", conflicts_with = "realtime", value_parser = parse_speed)]
    pub speed: Option<f64>,
}

/// Slower than a tenth, and a tick would take longer than a frozen process is waited for.
fn parse_speed(text: &str) -> Result<f64, String> {
    let number = text.parse::<f64>().ok().filter(|it| (0.1..=1e6).contains(it));
    number.ok_or_else(|| "is no number from 0.1 to 1e6".to_owned())
}

/// `64k`, `500M`, `2G`: powers of 1024.
fn parse_size(text: &str) -> Result<u64, String> {
    let why = || "is no size; write 500M or 2G, and at least 64k".to_owned();
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
    /// Measurements of each row
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub rounds: u32,
    /// Only the rows whose names begin like this; repeatable
    #[arg(long, value_name = "NAME")]
    pub only: Vec<String>,
    /// Instead: drive at 100 Hz for so long (as in 10s or 1m30s), quiet and beside a load on all cores, and say how late commands are
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
  pathtune monitor --run 3f --vehicle 2 --csv latency.csv")]
pub struct MonitorArgs {
    /// The start of its number, or its folder; may be left out if there is only one
    #[arg(long, value_name = "RUN")]
    pub run: Option<String>,
    /// Slot of the fleet whose flags are shown
    #[arg(long, value_name = "I", default_value_t = 0)]
    pub vehicle: usize,
    /// One JSON object a second: percentiles of the last second, counts since the beginning
    #[arg(long)]
    pub json: bool,
    /// One row a second into a file, with the same figures
    #[arg(long, value_name = "FILE")]
    pub csv: Option<PathBuf>,
    /// How long to look, as in 10s, 1m30s or 500ms [default: until the run ends]
    #[arg(long = "for", value_name = "TIME", value_parser = time::above_zero, allow_hyphen_values = true)]
    pub duration: Option<Duration>,
    /// One report over a second in which ticks are driven, or over the time of --for, and no more
    #[arg(long)]
    pub once: bool,
    /// How long odometry to applied command may take, as in 1ms; longer is a deadline miss [default: the run's tick]
    #[arg(long, value_name = "TIME", value_parser = time::above_zero, allow_hyphen_values = true)]
    pub budget: Option<Duration>,
    /// Hand out the figures to Prometheus on this address, as in 127.0.0.1:9464; not in every build
    #[arg(long, value_name = "ADDR")]
    pub prometheus: Option<SocketAddr>,
}

/// How processes wait for each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum WaitArg {
    /// As suits cores, fleet and mode
    Auto,
    /// All on one core, which each hands on to the next; asleep after 100 µs
    Yield,
    /// Each on a core of its own, looking again and again; asleep after 100 µs
    Spin,
    /// Asleep at once, woken for each message
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
    /// Make also the checks that move the vehicle: slowly, some ten metres, and to the left
    #[arg(long)]
    pub allow_motion: bool,
    /// Set run.realtime: the vehicle is to pace by the clock
    #[arg(long)]
    pub realtime: bool,
    /// The vehicle claims that the same request gives the same drive
    #[arg(long)]
    pub deterministic: bool,
    /// The manoeuvre whose configuration the vehicle reads
    #[arg(long, value_name = "NAME", default_value = "lane_change")]
    pub maneuver: String,
    /// A vehicle: a preset, or a file on top of the default one
    #[arg(long, value_name = "NAME|FILE")]
    pub vehicle: Option<String>,
    /// One key on top of everything, as in --set drive.tick_s=0.02; repeatable
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Folder for configuration and log, kept [default: one that is removed]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print the findings as JSON
    #[arg(long)]
    pub json: bool,
    /// The program that is to be checked, with its arguments
    #[arg(last = true, required = true, value_name = "CMD")]
    pub command: Vec<String>,
}

/// Of what, and in which language.
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
    /// Print the presets, each key with its description
    Show {
        /// Only the presets whose path holds this word, as in laws or lane_change
        name: Option<String>,
    },
    /// Write the presets into a folder, to be edited
    Init {
        /// The folder; made if it is not there
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
    /// Show the gains of a manoeuvre, where they come from, and what stood there before
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
        /// Also if a gain changes by more than 30 %, they replace gains of another law, or the training was of a vehicle with another geometry
        #[arg(long)]
        force: bool,
        /// Only say what would change
        #[arg(long)]
        dry_run: bool,
    },
    /// Bring back the gains that stood there before
    Rollback {
        /// The vehicle's file
        vehicle: PathBuf,
        /// The manoeuvre; may be left out if there is only one
        maneuver: Option<String>,
        /// The N-th newest of the history, as `gains show` numbers it [default: the newest that a promotion replaced]
        #[arg(long, value_name = "N")]
        to: Option<usize>,
    },
}
