//! Options of `identify`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

/// Options of `identify`.
#[derive(Debug, Args)]
#[command(after_help = "A DRIVE is one of:
  a recording of ours (--record), of any car in the vehicle's role
  an MCAP bag of ROS 2 with nav_msgs/Odometry and the commands that the car was given
  a CSV file, whose header names the columns t_s, x_m, y_m, yaw_rad, speed_mps, command_steering_rad and
    command_speed_mps, and yaw_rate_radps if it was measured; t_s is the time of arrival; empty fields tell nothing

Examples:
  pathtune identify runs/mine/recording.mcap --vehicle car.toml
  pathtune identify monday.csv tuesday.csv --vehicle car.toml --write --report monday
  pathtune identify bag.mcap --vehicle car.toml --odometry /vesc/odom --command /drive
  pathtune identify --rollback --vehicle car.toml")]
pub struct IdentifyArgs {
    /// Recorded drives in the same car
    #[arg(value_name = "DRIVE", required_unless_present = "rollback")]
    pub drives: Vec<PathBuf>,
    /// The vehicle's file, whose values are where the search begins
    #[arg(long, value_name = "FILE")]
    pub vehicle: PathBuf,
    /// Write the values that were identified into the vehicle's file; refused unless they predict the drive better
    #[arg(long)]
    pub write: bool,
    /// Take the last --write back
    #[arg(long, conflicts_with_all = ["drives", "write", "json"])]
    pub rollback: bool,
    /// Write a page with pictures into this folder: what was measured beside what is predicted
    #[arg(long, value_name = "DIR", conflicts_with = "rollback")]
    pub report: Option<PathBuf>,
    /// Print everything as JSON
    #[arg(long)]
    pub json: bool,
    /// The drive is a simulation's: its yaw rate may follow the commands exactly
    #[arg(long)]
    pub simulated: bool,
    /// The file's wheelbase was measured at the car: find the steering's gain in its place
    #[arg(long)]
    pub wheelbase_measured: bool,
    /// Topic with the odometry in a bag [default: ros2.odometry_topic of the vehicle's file]
    #[arg(long, value_name = "TOPIC")]
    pub odometry: Option<String>,
    /// Topic with the commands in a bag [default: ros2.drive_topic of the vehicle's file]
    #[arg(long, value_name = "TOPIC")]
    pub command: Option<String>,
    /// Type of the commands in a bag [default: as the bag says, or else ros2.drive_message of the vehicle's file]
    #[arg(long, value_name = "TYPE")]
    pub command_type: Option<CommandType>,
}

/// Types of commands in a bag.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum CommandType {
    /// ackermann_msgs/AckermannDriveStamped
    Stamped,
    /// ackermann_msgs/AckermannDrive
    Bare,
    /// geometry_msgs/Twist
    Twist,
    /// geometry_msgs/TwistStamped
    TwistStamped,
}
