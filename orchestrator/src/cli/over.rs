//! The options that drive each set over plants.

use clap::Args;

/// Over which plants each set is driven.
#[derive(Debug, Args)]
pub struct OverArgs {
    /// Judge each set by its drives on several plants, which are vehicles that the car may really be: `default` for eight
    /// around the vehicle's file and a faster drive, or a TOML file of `plants`, each with a name, `add` and `scale`. With
    /// --noise each plant is driven several times (over.repeats), with the same noise for all sets
    #[arg(long, value_name = "default|FILE")]
    pub over: Option<String>,
    /// How the drives over plants are judged together
    #[arg(long, value_name = "HOW", default_value = "mean", requires = "over", value_parser = ["mean", "p90", "worst"])]
    pub over_by: String,
}
