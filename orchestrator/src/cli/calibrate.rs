//! Options of `calibrate`.

use std::path::PathBuf;

use clap::Args;

use crate::cli::PathReading;

/// Options of `calibrate`.
#[derive(Debug, Args)]
#[command(
    after_help = "The promise holds for drives like those calibrated on, and for no others. In the simulator the
drives are with noise, of vehicles that differ: noise × 0.7 to 1.4, wheelbase ± 5 %, steering rate and pedal lag ± 10 %.
Half of the drives give the scales of what is looked at, the other half the threshold. 918 drives are the fewest that
promise at most 1 % of false alarms, with a probability of 99 %. Fewer promise less; the table says how much.

Examples:
  pathtune calibrate roundabout
  pathtune calibrate circuit --gains 3,21,21,0.7/3.4,21,1,0.84 --drives 4000
  pathtune calibrate runs/mine
  pathtune calibrate --path yard.csv --vehicle car.toml --from monday/recording.mcap --from tuesday/recording.mcap
  pathtune drive roundabout --envelope roundabout.envelope.toml"
)]
pub struct CalibrateArgs {
    /// The folder of a finished training, or a manoeuvre: lane_change, smooth_lane, roundabout or circuit; may be left out
    /// with --path
    #[arg(value_name = "RUN|MANEUVER")]
    pub what: Option<String>,
    /// The gains of the law; for a path with several manoeuvres, one set for each, as in 3,21,21,0.7/3.4,21,1,0.84
    /// [default: those of the training; else those promoted to the vehicle, or the paper's]
    #[arg(long, value_name = "A,B,…", allow_hyphen_values = true)]
    pub gains: Option<String>,
    /// Number of drives in the simulator
    #[arg(long, value_name = "N", default_value_t = 2000, value_parser = clap::value_parser!(u32).range(4..=1_000_000))]
    pub drives: u32,
    /// Calibrate on the drives of a recording of ours instead, made with the same gains; repeatable
    #[arg(long, value_name = "FILE", conflicts_with_all = ["drives", "seed"])]
    pub from: Vec<PathBuf>,
    /// Seed of noise and of what varies [default: run.seed]
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// A path of your own, as for `drive`
    #[arg(long, value_name = "FILE", conflicts_with = "what")]
    pub path: Option<PathBuf>,
    /// How its file is read.
    #[command(flatten)]
    pub reading: PathReading,
    /// The vehicle: a preset, or a file that overrides keys of the default vehicle
    #[arg(long, value_name = "NAME|FILE")]
    pub vehicle: Option<String>,
    /// The control law
    #[arg(long, value_name = "NAME|FILE")]
    pub law: Option<String>,
    /// Set one key, overriding everything else; repeatable
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// The envelope's file [default: envelope.toml in the training's folder, or MANEUVER.envelope.toml;
    /// of a path of your own, its name stands for the manoeuvre]
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Print everything as JSON
    #[arg(long)]
    pub json: bool,
}
