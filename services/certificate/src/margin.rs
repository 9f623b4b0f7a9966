//! The additional dead time of a set of parameters in a configuration.

use config::{Advance, Parameters, RunConfig};

use crate::{Car, Gains, LateralLoop, LawLoop};

/// The additional dead time Δ of a set at a speed, with the dead time and the lag of the vehicle's file: 0 if the loop is
/// unstable, infinite if there is no bound.
///
/// # Errors
/// If nothing can be said: why.
pub fn additional_dead_time_s(
    config: &RunConfig,
    set: &Parameters,
    speed_mps: f64,
) -> Result<f64, String> {
    additional_dead_time_on(config, config, set, speed_mps)
}

/// The same with the vehicle of another configuration, of which the law knows nothing.
pub(crate) fn additional_dead_time_on(
    config: &RunConfig,
    plant: &RunConfig,
    set: &Parameters,
    speed_mps: f64,
) -> Result<f64, String> {
    if speed_mps <= 0.0 {
        return Err("no Δ: the car does not drive".to_owned());
    }
    if !is_exact(config) {
        let loop_s = LawLoop::on_plant(config, plant, set, speed_mps)?.additional_dead_time_s();
        return Ok(Car::new(plant).beyond_yaw_lag_s(loop_s, speed_mps));
    }
    let (car, gains) = (Car::new(plant), Gains::new(set));
    if gains.kv <= 0.0 {
        return Err(format!("no Δ: with kv = {} the car does not drive", gains.kv));
    }
    let lead_m = match config.reference.advance {
        Advance::Time => speed_mps / gains.kv,
        Advance::Projection => config.reference.lookahead_m,
    };
    let loop_s = LateralLoop::new(&car, &gains, speed_mps, lead_m).additional_dead_time_s();
    Ok(car.beyond_yaw_lag_s(loop_s, speed_mps))
}

/// Whether the loop is written down: that of the paper's law, where it knows nothing of the steering.
pub(crate) fn is_exact(config: &RunConfig) -> bool {
    let vehicle = &config.vehicle;
    let is_plain = vehicle.steering_delay_s == 0.0
        && vehicle.steering_lag_s == 0.0
        && vehicle.steering_gain == 1.0
        && vehicle.steering_offset_rad == 0.0;
    config.law.name == "paper" && (is_plain || !config.controller.compensate_dead_time)
}
