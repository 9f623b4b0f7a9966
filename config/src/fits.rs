//! Checks that a vehicle is one that can be, and that what drives it fits it.

use crate::validate::Problem;
use crate::{RunConfig, Vehicle};

/// A command has to live this many ticks at least, or else the vehicle stops on its own before the next one comes.
const LEAST_TICKS: f64 = 1.2;

/// The gate's limits of a jump must be this many standard deviations of the difference of two measurements: noise alone
/// exceeds them about once in ten million ticks then.
const NOISE_REACH: f64 = 4.0;

pub(crate) fn validate(config: &RunConfig) -> Result<(), Problem> {
    shape(&config.vehicle)?;
    noise(&config.vehicle)?;
    speeds(config)?;
    tick(config)
}

/// Axles, body and tracked point.
fn shape(v: &Vehicle) -> Result<(), Problem> {
    let wheelbase_m = v.wheelbase_m;
    if v.tracked_point_m > wheelbase_m {
        let problem = format!(
            "is {}, which is ahead of the front axle (vehicle.wheelbase_m is {wheelbase_m}); give how far the point whose \
             pose is reported lies ahead of the rear axle",
            v.tracked_point_m
        );
        return Err(("vehicle.tracked_point_m".to_owned(), problem));
    }
    if v.body_front_m < wheelbase_m {
        let problem = format!(
            "is {}, so the body ends behind the front axle (vehicle.wheelbase_m is {wheelbase_m}); give the distance from \
             the rear axle to the front end",
            v.body_front_m
        );
        return Err(("vehicle.body_front_m".to_owned(), problem));
    }
    Ok(())
}

/// The noise that the file states for the odometry must not be what the gate takes for a jump.
fn noise(v: &Vehicle) -> Result<(), Problem> {
    let sd_m = v.noise.position_sd_m.unwrap_or_default();
    let half_width_rad = v.noise.heading_half_width_rad.unwrap_or_default();
    for (key, stated, limit_key, limit, reach) in [
        (
            "vehicle.noise.position_sd_m",
            sd_m,
            "vehicle.safety.jump_limit_m",
            v.safety.jump_limit_m,
            NOISE_REACH * std::f64::consts::SQRT_2 * sd_m,
        ),
        (
            "vehicle.noise.heading_half_width_rad",
            half_width_rad,
            "vehicle.safety.jump_limit_rad",
            v.safety.jump_limit_rad,
            2.0 * half_width_rad,
        ),
    ] {
        if reach > limit {
            let problem = format!(
                "is {stated}: this noise alone moves the measured pose by up to {reach:.2} from tick to tick, which the gate \
                 would take for jumps, as {limit_key} is {limit}; raise {limit_key} to {reach:.2} or more, or state less noise"
            );
            return Err((key.to_owned(), problem));
        }
    }
    Ok(())
}

/// The speed that is asked for must be one that is allowed.
fn speeds(config: &RunConfig) -> Result<(), Problem> {
    let (asked_mps, limit_mps) = (config.reference.speed_mps, config.supervisor.speed_limit_mps);
    let is_asked_for = config.path.speeds_mps.is_empty();
    let limit_mps = limit_mps.min(config.vehicle.speed_limit_mps);
    if !is_asked_for || asked_mps <= limit_mps {
        return Ok(());
    }
    let problem = format!(
        "is {asked_mps}, but the limit is {limit_mps}; drive more slowly, as with --set reference.speed_mps={limit_mps}, or raise \
         vehicle.speed_limit_mps and supervisor.speed_limit_mps"
    );
    Err(("reference.speed_mps".to_owned(), problem))
}

/// By the clock, commands come once a tick, and a vehicle stops on its own when its newest one is too old.
fn tick(config: &RunConfig) -> Result<(), Problem> {
    let (tick_s, age_s) = (config.drive.tick_s, config.vehicle.safety.command_age_limit_s);
    if !config.run.realtime || age_s >= LEAST_TICKS * tick_s {
        return Ok(());
    }
    let problem = format!(
        "is {tick_s}, but the vehicle stops on its own when its newest command is older than \
         vehicle.safety.command_age_limit_s, {age_s}: it would stop in every tick; use a shorter tick, or set \
         vehicle.safety.command_age_limit_s to {} or more",
        (3000.0 * tick_s).round() / 1000.0
    );
    Err(("drive.tick_s".to_owned(), problem))
}
