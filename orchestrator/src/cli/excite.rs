//! Options of `excite`.

use std::path::PathBuf;

use clap::Args;

/// Options of `excite`.
#[derive(Debug, Args)]
#[command(
    after_help = "It stands for 1 s and drives for 46 s: 3 s straight on, steering steps, a sine that gets quicker, and speeds of \
up to twice that of the steps. It takes some 90 m by 30 m at 2 m/s, or 30 m by 30 m with --compact; what your car needs is \
told first. It follows no path, so the gate does not watch the path; --box keeps the car on its ground. Nor does the gate \
watch how the car responds, because that is what the drive is to find. All else in the gate is on: have the room, and a \
hand on the car's own stop.

Examples:
  pathtune excite --vehicle car.toml
  pathtune excite --vehicle car.toml --adapter ros2-vehicle --compact --box 30x30
  pathtune excite --vehicle car.toml --realtime --replace vehicle='python3 my_car.py' --speed 1"
)]
pub struct ExciteArgs {
    /// The vehicle: a file, or a preset
    #[arg(long, value_name = "NAME|FILE")]
    pub vehicle: String,
    /// Speed of the steering steps, in m/s; the speed steps reach twice as much [default: 2 for a full-size car, less for a
    /// smaller one]
    #[arg(long, value_name = "MPS")]
    pub speed: Option<f64>,
    /// The largest steering step, in rad [default: 0.25, and 0.2 with --compact]
    #[arg(long, value_name = "RAD")]
    pub steering: Option<f64>,
    /// Drive in circles, around an angle of 0.25 rad
    #[arg(long)]
    pub compact: bool,
    /// The ground that there is, in metres: along the car's heading at the start, and across it. Refused if the drive needs
    /// more; the place to start from is told, and the car is stopped before its body leaves the ground
    #[arg(long = "box", value_name = "LENGTHxWIDTH", value_parser = parse_box)]
    pub ground: Option<[f64; 2]>,
    /// Drive by the clock
    #[arg(long)]
    pub realtime: bool,
    /// Use one of our adapters instead of the simulator: ros2-vehicle; implies --realtime
    #[arg(long, value_name = "SERVICE", conflicts_with = "replace")]
    pub adapter: Option<String>,
    /// Run a program of yours in the vehicle's role, as in vehicle='python3 my_car.py'; repeatable
    #[arg(long, value_name = "ROLE=COMMAND")]
    pub replace: Vec<String>,
    /// Put noise on the odometry of our simulator
    #[arg(long)]
    pub noise: bool,
    /// Folder of the run [default: runs/drive-excitation-TIME]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Set one key, overriding everything else; repeatable
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
}

fn parse_box(text: &str) -> Result<[f64; 2], String> {
    let sides = text.split_once(['x', '×']).and_then(|(length, width)| {
        let side = |text: &str| text.trim().parse().ok().filter(|it: &f64| *it > 0.0 && *it < 1e6);
        Some([side(length)?, side(width)?])
    });
    sides.ok_or_else(|| "give length and width in metres, as in 30x30".to_owned())
}
