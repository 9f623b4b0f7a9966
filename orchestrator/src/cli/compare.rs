//! The options of `compare`.

use std::path::PathBuf;

use clap::Args;

use super::{OverArgs, PathReading};

/// Options of `compare`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  pathtune compare lane_change
  pathtune compare roundabout --tuners gp,random,educated-q --seeds 200
  pathtune compare lane_change --noise --drives 30 --json
  pathtune compare smooth_lane --law stanley --continuous --tuners gp,cmaes,random
  pathtune compare smooth_lane --laws paper,stanley,pure_pursuit --tuners gp --report laws")]
pub struct CompareArgs {
    /// The manoeuvre: lane_change, smooth_lane, roundabout or circuit; may be left out with --path
    pub maneuver: Option<String>,
    /// The tuners; `pathtune config list` lists them. `random` is always there, for the others to be seen beside it
    #[arg(
        long,
        value_delimiter = ',',
        value_name = "A,B,…",
        default_value = "gp,coordinate,cmaes,cem,sobol,random"
    )]
    pub tuners: Vec<String>,
    /// Number of seeds: each tuner trains once with each
    #[arg(long, value_name = "N", default_value_t = 50, value_parser = clap::value_parser!(u32).range(2..=10_000))]
    pub seeds: u32,
    /// Budget of each training, in drives
    #[arg(long, value_name = "N", default_value_t = 60, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub drives: u32,
    /// The first seed; the others follow it
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(..=i64::MAX as u64))]
    pub seed: Option<u64>,
    /// Put noise on the odometry
    #[arg(long)]
    pub noise: bool,
    /// Over which plants each set is driven; each of these counts as one drive.
    #[command(flatten)]
    pub over: OverArgs,
    /// Let the tuners choose between the values of the grid; only for those that have the setting `draw`
    #[arg(long)]
    pub continuous: bool,
    /// A path of your own: a CSV file, as for `train`
    #[arg(long, value_name = "FILE")]
    pub path: Option<PathBuf>,
    /// How its file is read.
    #[command(flatten)]
    pub reading: PathReading,
    /// The vehicle: a preset, or a file that overrides keys of the default vehicle
    #[arg(long, value_name = "NAME|FILE")]
    pub vehicle: Option<String>,
    /// The control law: a preset, or a file that overrides keys of one [default: paper]
    #[arg(long, value_name = "NAME|FILE")]
    pub law: Option<String>,
    /// Several laws, each with the same tuners, seeds and budget, and beside its textbook parameters
    #[arg(long, value_delimiter = ',', value_name = "A,B,…", conflicts_with = "law")]
    pub laws: Vec<String>,
    /// The objective by which drives are judged, smaller being better: a preset [default: distance]
    #[arg(long, value_name = "NAME")]
    pub objective: Option<String>,
    /// TOML file that overrides keys of the presets
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Set one key, overriding everything else; repeatable
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Write a page with tables and pictures into this folder: regret over drives
    #[arg(long, value_name = "FOLDER")]
    pub report: Option<PathBuf>,
    /// Do not show progress
    #[arg(long, short)]
    pub quiet: bool,
    /// Print JSON instead of the table
    #[arg(long, conflicts_with = "csv")]
    pub json: bool,
    /// Print a row of CSV for each training instead of the table
    #[arg(long)]
    pub csv: bool,
}
