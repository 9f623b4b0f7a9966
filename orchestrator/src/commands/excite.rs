//! `pathtune excite`: a drive of the law `excitation`, recorded.

use std::ffi::OsString;
use std::path::Path;

use clap::Parser;

use crate::cli::{Cli, Command, ExciteArgs};
use crate::commands::{drive, vehicle_of};
use crate::pipeline::services::Services;
use crate::runs::EndedRun;
use crate::words::Failure;
use crate::words::terminal::say;

/// The wheelbase for which 2 m/s are the usual speed.
const FULL_SIZE_M: f64 = 2.875;
/// Keys of such a drive. It follows no path, and how the car responds is what it is to find.
const KEYS: [&str; 6] = [
    "path.pieces=[{kind='straight',length_m=2000.0}]",
    "drive.loop_time_s=47.0",
    "controller.compensate_dead_time=false",
    "vehicle.safety.path_distance_limit_m=inf",
    "vehicle.safety.path_heading_limit_rad=inf",
    "vehicle.safety.watch_response='off'",
];

/// Drives what a car is identified by, and names the command that identifies it.
///
/// # Errors
/// As those of `pathtune drive`.
pub(crate) fn excite(args: &ExciteArgs, services: Services) -> Result<EndedRun, Failure> {
    let vehicle = vehicle_of(Path::new(&args.vehicle))?;
    // As much lateral acceleration for its size as a full-size car has.
    let usual_mps = 2.0 * (vehicle.wheelbase_m / FULL_SIZE_M).sqrt();
    let speed_mps = args.speed.unwrap_or((usual_mps * 100.0).round() / 100.0);
    let steering_rad = args.steering.unwrap_or(if args.compact { 0.2 } else { 0.25 });
    let turn_rad = if args.compact { 0.25 } else { 0.0 };
    if steering_rad + turn_rad > vehicle.steering_limit_rad {
        return Err(Failure::User(format!(
            "--vehicle {}: turns its wheels by {:.3} rad at most, and this drive needs {:.3}; give less with --steering",
            args.vehicle,
            vehicle.steering_limit_rad,
            steering_rad + turn_rad
        )));
    }
    let gains = format!("{steering_rad},{speed_mps},{turn_rad}");
    let mut words: Vec<OsString> =
        ["pathtune", "drive", "lane_change", "--law", "excitation", "--record", "--quiet"]
            .map(OsString::from)
            .to_vec();
    let mut option = |name: &str, value: &dyn AsRef<std::ffi::OsStr>| {
        words.extend([OsString::from(name), value.as_ref().to_owned()]);
    };
    option("--vehicle", &args.vehicle);
    option("--gains", &gains);
    for key in KEYS {
        option("--set", &key);
    }
    for key in &args.set {
        option("--set", key);
    }
    for replace in &args.replace {
        option("--replace", replace);
    }
    if let Some(adapter) = &args.adapter {
        option("--adapter", adapter);
    }
    if let Some(out) = &args.out {
        option("--out", out);
    }
    for (is_on, word) in [(args.realtime, "--realtime"), (args.noise, "--noise")] {
        words.extend(is_on.then(|| OsString::from(word)));
    }
    // The same command that a user would type: it has its checks and its messages.
    let Command::Drive(as_drive) = Cli::try_parse_from(words).map_err(anyhow::Error::from)?.command
    else {
        unreachable!("the words begin with drive");
    };
    let ended = drive(&as_drive, services)?;
    if ended.stopped.is_none() {
        let recording = ended.folder.join("recording.mcap");
        say!("pathtune identify {} --vehicle {}", recording.display(), args.vehicle);
    }
    Ok(ended)
}
