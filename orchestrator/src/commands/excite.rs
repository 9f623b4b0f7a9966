//! `pathtune excite`: a drive of the law `excitation`, recorded.

use std::ffi::OsString;
use std::path::Path;

use clap::Parser;
use config::FULL_SIZE_WHEELBASE_M;

use crate::ExciteTools;
use crate::cli::{Cli, Command, ExciteArgs};
use crate::commands::sweep::parse_sets;
use crate::commands::{DriveTools, drive, vehicle_of};
use crate::pipeline::services::Services;
use crate::runs::{EndedRun, setup};
use crate::words::Failure;
use crate::words::terminal::{say, tell};

/// Keys of such a drive. It follows no path, and how the car responds is what it is to find.
const KEYS: [&str; 5] = [
    "path.pieces=[{kind='straight',length_m=2000.0}]",
    "controller.compensate_dead_time=false",
    "vehicle.safety.path_distance_limit_m=inf",
    "vehicle.safety.path_heading_limit_rad=inf",
    "vehicle.safety.watch_response='off'",
];

/// The least speed of the excitation.
const LEAST_MPS: f64 = 0.1;
/// Speed of the path, which nobody follows.
const PATH_SPEED_MPS: f64 = 1.5;

/// Drives what a car is identified by, and names the command that identifies it.
///
/// # Errors
/// As those of `pathtune drive`; if the drive needs more ground than there is.
pub(crate) fn excite(
    args: &ExciteArgs,
    services: Services,
    ExciteTools { lasts_s, ground }: ExciteTools,
    tools: DriveTools,
) -> Result<EndedRun, Failure> {
    let vehicle = vehicle_of(Path::new(&args.vehicle))?;
    // As much lateral acceleration for its size as a full-size car has.
    let usual_mps = 2.0 * (vehicle.wheelbase_m / FULL_SIZE_WHEELBASE_M).sqrt();
    // The fastest part of the drive is twice as fast as the steps.
    let usual_mps =
        ((usual_mps * 100.0).round() / 100.0).min(floor_milli(0.5 * vehicle.speed_limit_mps));
    let speed_mps = args.speed.unwrap_or(usual_mps.max(LEAST_MPS));
    if 2.0 * speed_mps > vehicle.speed_limit_mps {
        tell!(
            "pathtune: parts of the drive are at {:.2} m/s, and the vehicle's limit of {} m/s cuts them; less --speed tells more of \
             its speed loop",
            2.0 * speed_mps,
            vehicle.speed_limit_mps
        );
    }
    let (usual_rad, mut turn_rad) = if args.compact { (0.2, 0.25) } else { (0.25, 0.0) };
    let mut steering_rad = args.steering.unwrap_or(usual_rad);
    // A car whose wheels turn less gets smaller steps, unless the user says how large they are.
    if args.steering.is_none() && steering_rad + turn_rad > vehicle.steering_limit_rad {
        let share = vehicle.steering_limit_rad / (steering_rad + turn_rad);
        (steering_rad, turn_rad) =
            (floor_milli(share * steering_rad), floor_milli(share * turn_rad));
        tell!(
            "pathtune: the wheels turn by {:.3} rad at most: steps of {steering_rad} rad, around {turn_rad} rad",
            vehicle.steering_limit_rad
        );
    }
    if args.steering.is_some() && steering_rad <= vehicle.steering_limit_rad {
        turn_rad = floor_milli(turn_rad.min(vehicle.steering_limit_rad - steering_rad));
    }
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
    option("--set", &format!("drive.loop_time_s={lasts_s:?}"));
    if vehicle.speed_limit_mps < PATH_SPEED_MPS {
        // Nobody follows the path, but its speed is one that the car must be able to drive.
        option("--set", &format!("reference.speed_mps={:?}", vehicle.speed_limit_mps));
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
    let Command::Drive(mut as_drive) =
        Cli::try_parse_from(words).map_err(anyhow::Error::from)?.command
    else {
        unreachable!("the words begin with drive");
    };
    let config = setup::layers(as_drive.maneuver.as_deref(), &as_drive.setup, None)?.resolve()?;
    let options = [("--steering", "steering", steering_rad), ("--speed", "speed", speed_mps)];
    for (option, key, value) in options {
        let parameter = config.law.parameters.iter().find(|it| it.key == key);
        if let Some(it) = parameter.filter(|it| !(it.min..=it.max).contains(&value)) {
            return Err(Failure::User(format!(
                "{option}: is {value}, but must lie in [{}, {}]",
                it.min, it.max
            )));
        }
    }
    let set = parse_sets(std::slice::from_ref(&gains), &config)?.remove(0);
    let needed = ground(&config, &set);
    match args.ground {
        Some(there) => {
            let area = place(needed, there, args)?;
            let bounds = area.map(|bound| format!("{bound:?}")).join(", ");
            as_drive.setup.set.push(format!("drive.area_m=[{bounds}]"));
        }
        None => {
            let [length_m, width_m] = sides(needed);
            tell!(
                "pathtune: the drive takes {length_m:.0} m by {width_m:.0} m, the way to a stop included; with --box the car is \
                 kept on its ground"
            );
        }
    }
    let (ended, _) = drive(&as_drive, services, tools)?;
    if ended.stopped.is_none() {
        let recording = ended.folder.join("recording.mcap");
        say!("pathtune identify {} --vehicle {}", recording.display(), args.vehicle);
    }
    Ok(ended)
}

/// Rounded down to thousandths.
fn floor_milli(value: f64) -> f64 {
    (value * 1e3).floor() / 1e3
}

/// Length and width of an area.
fn sides([least_x, most_x, least_y, most_y]: [f64; 4]) -> [f64; 2] {
    [most_x - least_x, most_y - least_y]
}

/// Lays what the drive needs in the middle of the ground that there is; says where the car has to stand.
fn place(needed: [f64; 4], there: [f64; 2], args: &ExciteArgs) -> Result<[f64; 4], Failure> {
    let [length_m, width_m] = sides(needed);
    let spare_m = [there[0] - length_m, there[1] - width_m];
    if spare_m.iter().any(|spare| *spare < 0.0) {
        let compact = if args.compact { "" } else { " with --compact," };
        return Err(Failure::User(format!(
            "--box {}x{}: the drive takes {length_m:.1} m along the car's heading and {width_m:.1} m across, the way to a stop \
             included; drive it{compact} slower with --speed or with smaller steps with --steering",
            there[0], there[1]
        )));
    }
    let [along_m, across_m] = spare_m.map(|spare| 0.5 * spare);
    let [least_x, most_x, least_y, most_y] = needed;
    let area = [least_x - along_m, most_x + along_m, least_y - across_m, most_y + across_m];
    tell!(
        "pathtune: the drive takes {length_m:.1} m by {width_m:.1} m; start with the tracked point {:.1} m ahead of the rear edge of \
         the ground and {:.1} m from its right edge, heading along its {} m",
        -area[0],
        -area[2],
        there[0]
    );
    Ok(area)
}
