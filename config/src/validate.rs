//! Checks ranges, and values that must fit together.

use crate::{
    Advance, Axis, Grid, Limit, Piece, RunConfig, Scale, TunerConfig, Vehicle, VehicleModel, law,
    points,
};

/// The largest fleet that one message carries.
pub(crate) const MAX_FLEET: u32 = 256;
/// The largest grid: the exhaustive ranking visits every set.
const MAX_GRID: usize = 100_000;
/// The largest Q-table, in entries: bins² · 3^parameters. About 1.2 GB for each learner.
const MAX_Q_TABLE: f64 = 1e8;
/// The longest drive, in ticks.
const MAX_TICKS: f64 = 1e6;

pub(crate) type Problem = (String, String);

/// Finds the first value that is out of range, as (dotted key, problem).
pub(crate) fn validate(config: &RunConfig) -> Result<(), Problem> {
    let c = config;
    // First: whatever drives the vehicle, and the path, may be refused for what is wrong with it.
    vehicle(c)?;
    for region in &c.switch_regions {
        region.check(c.path.zones.len()).map_err(|why| ("switch_regions".to_owned(), why))?;
    }
    if let Some(envelope) = &c.envelope {
        envelope.check().map_err(|why| ("envelope".to_owned(), why))?;
    }
    above("reference.speed_mps", c.reference.speed_mps, 0.0, 50.0)?;
    within("reference.ramp_s", c.reference.ramp_s, 0.0, 60.0)?;
    if c.reference.advance == Advance::Projection {
        above("reference.lookahead_m", c.reference.lookahead_m, 0.0, 100.0)?;
    }
    waiting(c)?;
    above("drive.loop_time_s", c.drive.loop_time_s, 0.0, 3600.0)?;
    within("drive.tick_s", c.drive.tick_s, 0.001, 0.1)?;
    if c.ticks() < 1 || c.drive.loop_time_s / c.drive.tick_s > MAX_TICKS {
        let problem = format!("holds {} ticks, but must hold 1 to {MAX_TICKS}", c.ticks());
        return Err(("drive.loop_time_s".to_owned(), problem));
    }
    within("drive.goal_radius_m", c.drive.goal_radius_m, 0.0, 100.0)?;
    above("drive.patience_s", c.drive.patience_s, 0.0, f64::INFINITY)?;
    area(c)?;
    let fastest_mps = c.vehicle.speed_limit_mps.min(c.supervisor.speed_limit_mps).min(50.0);
    within("drive.start_speed_mps", c.drive.start_speed_mps, 0.0, fastest_mps)?;
    angle("controller.steering_limit_rad", c.controller.steering_limit_rad, 1.5)?;
    above("supervisor.speed_limit_mps", c.supervisor.speed_limit_mps, 0.0, 100.0)?;
    within("supervisor.speed_margin_mps", c.supervisor.speed_margin_mps, 0.0, 100.0)?;
    within("supervisor.speed_foresight_s", c.supervisor.speed_foresight_s, 0.0, 10.0)?;
    within("supervisor.speed_gain", c.supervisor.speed_gain, 0.0, 1000.0)?;
    within("supervisor.zone_hysteresis_m", c.supervisor.zone_hysteresis_m, 0.0, 10.0)?;
    within("noise.position_sd_m", c.noise.position_sd_m, 0.0, 10.0)?;
    within("noise.heading_half_width_rad", c.noise.heading_half_width_rad, 0.0, 1.0)?;
    above("collision.lane_half_width_m", c.collision.lane_half_width_m, 0.0, 100.0)?;
    within("collision.margin_m", c.collision.margin_m, 0.0, 100.0)?;
    within("collision.penalty", c.collision.penalty, 0.0, 100.0)?;
    paper(c)?;
    whole("ranking.repeats", c.ranking.repeats.into(), 1, 1000)?;
    whole("robust.finalists", c.robust.finalists.into(), 1, 1000)?;
    whole("robust.repeats", c.robust.repeats.into(), 2, 1000)?;
    whole("robust.fresh", c.robust.fresh.into(), 2, 1000)?;
    whole("robust.holdout", c.robust.holdout.into(), 1, 10_000)?;
    crate::fits::validate(c)?;
    path(c)?;
    presets(c)?;
    grid(c)?;
    scales(c)?;
    learning(c)?;
    run(c)?;
    crate::plants::validate(c)
}

/// The area in which the vehicle may drive.
fn area(config: &RunConfig) -> Result<(), Problem> {
    let [least_x, most_x, least_y, most_y] = config.drive.area_m;
    let key = || "drive.area_m".to_owned();
    if !(least_x < most_x && least_y < most_y) {
        let problem =
            "must hold least x, largest x, least y and largest y, the least below the largest";
        return Err((key(), problem.to_owned()));
    }
    let [x_m, y_m] = match config.path.points.first() {
        Some(point) => *point,
        None => [config.path.start.x_m, config.path.start.y_m],
    };
    if !(least_x..=most_x).contains(&x_m) || !(least_y..=most_y).contains(&y_m) {
        return Err((key(), format!("does not hold the start of the path, ({x_m}, {y_m})")));
    }
    Ok(())
}

/// Bounds between which the reference waits.
fn waiting(config: &RunConfig) -> Result<(), Problem> {
    let r = &config.reference;
    above("reference.wait_from_speed", r.wait_from_speed, 1.0, 1e6)?;
    within("reference.wait_from_s", r.wait_from_s, 0.0, 1e6)?;
    for (key, from, to) in [
        ("reference.wait_to_speed", r.wait_from_speed, r.wait_to_speed),
        ("reference.wait_to_s", r.wait_from_s, r.wait_to_s),
    ] {
        above(key, to, from, f64::INFINITY)?;
    }
    above("reference.wait_limit_s", r.wait_limit_s, 0.0, f64::INFINITY)
}

fn paper(config: &RunConfig) -> Result<(), Problem> {
    for (row, set) in config.paper.iter().enumerate() {
        let key = format!("paper[{row}].gains");
        if set.gains.is_empty() {
            return Err((key, "is empty; give a set for each manoeuvre of the path".to_owned()));
        }
        for (index, gains) in set.gains.iter().enumerate() {
            law::paper_law()
                .parameters_of(gains)
                .map_err(|(name, problem)| (format!("{key}[{index}].{name}"), problem))?;
        }
        above(&format!("paper[{row}].mse_m2"), set.mse_m2, 0.0, 1e9)?;
        above(&format!("paper[{row}].noisy_mse_m2"), set.noisy_mse_m2, 0.0, 1e9)?;
    }
    Ok(())
}

fn path(config: &RunConfig) -> Result<(), Problem> {
    let path = &config.path;
    for (key, value) in [
        ("path.start.x_m", path.start.x_m),
        ("path.start.y_m", path.start.y_m),
        ("path.start.yaw_rad", path.start.yaw_rad),
    ] {
        within(key, value, -1e6, 1e6)?;
    }
    // A reference that the vehicle pushes ahead of itself has no speed of its own.
    let by_time = config.reference.advance == Advance::Time;
    let reference_mps = if by_time { config.reference.speed_mps } else { 0.0 };
    let limit_rad = config.controller.steering_limit_rad;
    if limit_rad < config.vehicle.steering_limit_rad {
        // The law turns the wheels no farther than this.
        let limited = Vehicle { steering_limit_rad: limit_rad, ..config.vehicle.clone() };
        points::validate(path, &limited, &config.supervisor, reference_mps).map_err(
            |(key, problem)| {
                (
                    key,
                    problem.replace("vehicle.steering_limit_rad", "controller.steering_limit_rad"),
                )
            },
        )?;
    } else {
        points::validate(path, &config.vehicle, &config.supervisor, reference_mps)?;
    }
    for (index, piece) in path.pieces.iter().enumerate() {
        let key = |field: &str| format!("path.pieces[{index}].{field}");
        match *piece {
            Piece::Straight { length_m } => above(&key("length_m"), length_m, 0.0, 1e5)?,
            Piece::Diagonal { length_m, offset_m } | Piece::Cosine { length_m, offset_m } => {
                above(&key("length_m"), length_m, 0.0, 1e5)?;
                within(&key("offset_m"), offset_m, -1e5, 1e5)?;
            }
            Piece::Arc { radius_m, angle_deg } => {
                within(&key("radius_m"), radius_m, 0.01, 1e5)?;
                within(&key("angle_deg"), angle_deg, -3600.0, 3600.0)?;
                if angle_deg == 0.0 {
                    return Err((key("angle_deg"), "is 0; use a straight piece".to_owned()));
                }
            }
        }
    }
    let mut last = -1.0;
    for (index, zone) in path.zones.iter().enumerate() {
        let key = format!("path.zones[{index}].from_m");
        let name = &zone.name;
        if name.is_empty() || name.len() > 40 || name.chars().any(char::is_control) {
            let problem = "must be a name of 1 to 40 characters on one line".to_owned();
            return Err((format!("path.zones[{index}].name"), problem));
        }
        within(&key, zone.from_m, 0.0, 1e6)?;
        if index == 0 && zone.from_m != 0.0 {
            return Err((key, "is not 0; the first zone begins where the path does".to_owned()));
        }
        if zone.from_m <= last {
            return Err((key, "lies before the zone above; order them along the path".to_owned()));
        }
        last = zone.from_m;
    }
    if path.zones.is_empty() {
        return Err(("path.zones".to_owned(), "is empty; name at least one zone".to_owned()));
    }
    Ok(())
}

fn grid(config: &RunConfig) -> Result<(), Problem> {
    for parameter in &config.law.parameters {
        let key = format!("grid.{}", parameter.key);
        let Some(Axis { min, max, step }) = config.grid.get(&parameter.key).copied() else {
            return Err((key, "is missing; give min, max and step".to_owned()));
        };
        within(&format!("{key}.min"), min, parameter.min, parameter.max)?;
        within(&format!("{key}.max"), max, parameter.min, parameter.max)?;
        if max < min {
            return Err((key, format!("is reversed: min {min} is above max {max}")));
        }
        let steps = match parameter.scale {
            Scale::Linear => {
                above(&format!("{key}.step"), step, 0.0, 1e9)?;
                (max - min) / step
            }
            Scale::Log => {
                above(&format!("{key}.step"), step, 1.0, 1e9)?;
                libm::log(max / min) / libm::log(step)
            }
        };
        if steps > 1e4 {
            return Err((key, "holds more than 10000 values; use a larger step".to_owned()));
        }
    }
    let known = |key: &String| config.law.keys().any(|it| it == key);
    if let Some(key) = config.grid.keys().find(|key| !known(key)) {
        let keys: Vec<&str> = config.law.keys().collect();
        let problem = format!(
            "is not a parameter of the law {}; it has {}",
            config.law.name,
            keys.join(", ")
        );
        return Err((format!("grid.{key}"), problem));
    }
    let grid = Grid::new(&config.law, &config.grid);
    let sets = grid.axes().iter().map(|axis| axis.len() as f64).product::<f64>();
    if sets > MAX_GRID as f64 {
        let problem =
            format!("holds {sets} sets, but may hold at most {MAX_GRID}; use larger steps");
        return Err(("grid".to_owned(), problem));
    }
    Ok(())
}

/// Checks names that must be those of a preset, and what belongs to them.
fn presets(config: &RunConfig) -> Result<(), Problem> {
    for (key, folder, name) in [
        ("law.name", "laws", &config.law.name),
        ("learning.tuner", "tuners", &config.learning.tuner),
        ("objective.name", "objectives", &config.objective.name),
    ] {
        let known: Vec<&str> = crate::names_in(folder).collect();
        if !known.contains(&name.as_str()) {
            let hint = crate::presets::hint(name, &known);
            return Err((key.to_owned(), format!("is {name:?}, which is unknown; {hint}")));
        }
    }
    law::validate(&config.law)?;
    tuner(&config.learning.tuner, &config.tuner)?;
    objective_settings(config)?;
    let limits = &config.objective.limits;
    for (key, limit) in [
        ("steering_travel_price_radps", limits.steering_travel_price_radps),
        ("steering_travel_radps", limits.steering_travel_radps),
        ("steering_rate_p95_radps", limits.steering_rate_p95_radps),
        ("lateral_acceleration_p95_mps2", limits.lateral_acceleration_p95_mps2),
        ("lateral_acceleration_max_mps2", limits.lateral_acceleration_max_mps2),
        ("lateral_jerk_p95_mps3", limits.lateral_jerk_p95_mps3),
        ("lateral_jerk_max_mps3", limits.lateral_jerk_max_mps3),
    ] {
        within(&format!("objective.limits.{key}"), limit, 0.0, 1000.0)?;
    }
    within("objective.limits.progress", limits.progress, 0.0, 1.0)?;
    within("objective.cap_wheelbases", config.objective.cap_wheelbases, 0.0, 1000.0)
}

/// Weights and scales, of which at least one weight counts.
fn objective_settings(config: &RunConfig) -> Result<(), Problem> {
    const MOST: f64 = 1e9;
    const WEIGHT: &str = "_weight";
    let settings = &config.objective.settings;
    for (setting, value) in &settings.0 {
        let key = format!("objective.settings.{setting}");
        if value.is_str() {
            return Err((key, format!("is {value}, but must be a number in [0, {MOST}]")));
        }
        within(&key, settings.number(setting), 0.0, MOST)?;
    }
    let mut weights = settings.0.keys().filter(|setting| setting.ends_with(WEIGHT)).peekable();
    if weights.peek().is_some() && weights.all(|weight| settings.number(weight) == 0.0) {
        let problem = "has weights that are all 0, so that every set is as good; raise one of them";
        return Err(("objective.settings".to_owned(), problem.to_owned()));
    }
    Ok(())
}

/// A scale of 0, which stands for an objective's least value in the grid, needs a grid that is driven.
fn scales(config: &RunConfig) -> Result<(), Problem> {
    let ticks = u128::from(config.ticks()) * config.grid().len() as u128;
    if ticks <= u128::from(config.ranking.max_ticks) {
        return Ok(());
    }
    let Some(key) = config.scale_from_grid() else { return Ok(()) };
    let problem = format!(
        "is 0, which stands for the least value in the grid, but the grid takes {ticks} ticks and is driven only up to {} \
         (ranking.max_ticks); give a scale, or raise ranking.max_ticks",
        config.ranking.max_ticks
    );
    Err((key, problem))
}

/// Every setting of a tuner that is a number has a range in the tuner's file, and keeps to it; a word is one of those that
/// the file names. What the file holds as a whole number stays one.
fn tuner(name: &str, tuner: &TunerConfig) -> Result<(), Problem> {
    for (setting, choices) in &tuner.choices {
        let value = tuner.settings.0.get(setting);
        let word = value.and_then(toml::Value::as_str);
        if !choices.iter().any(|choice| Some(choice.as_str()) == word) {
            let found = value.map_or("is missing".to_owned(), |value| format!("is {value}"));
            let problem = format!("{found}, and must be one of {}", choices.join(", "));
            return Err((format!("tuner.settings.{setting}"), problem));
        }
    }
    for (setting, value) in &tuner.settings.0 {
        let key = format!("tuner.settings.{setting}");
        let is_number = matches!(value, toml::Value::Float(_) | toml::Value::Integer(_));
        let Some([low, high]) = tuner.ranges.get(setting) else {
            if is_number {
                let problem =
                    format!("is missing: the least and the largest value of the setting {setting}");
                return Err((format!("tuner.ranges.{setting}"), problem));
            }
            continue;
        };
        if !is_number {
            let problem = format!("is {value}, but must be a number in [{low}, {high}]");
            return Err((key, problem));
        }
        let number = tuner.settings.number(setting);
        within(&key, number, *low, *high)?;
        if setting == "best" && number > tuner.settings.number("population") {
            let population = tuner.settings.number("population");
            let problem = format!(
                "is {value}, but a generation has tuner.settings.population = {population} sets; lower one, or raise the other"
            );
            return Err((key, problem));
        }
        if number.fract() != 0.0 && is_whole_number(name, setting) {
            let problem = format!("is {value}, but must be a whole number in [{low}, {high}]");
            return Err((key, problem));
        }
    }
    Ok(())
}

/// Whether the file of a tuner holds a setting as a whole number.
fn is_whole_number(tuner: &str, setting: &str) -> bool {
    let file = crate::presets::preset(&format!("tuners/{tuner}.toml"));
    let file: Option<toml::Table> = file.and_then(|file| toml::from_str(file.text).ok());
    let settings = file.as_ref().and_then(|file| file.get("settings")?.as_table());
    settings.and_then(|it| it.get(setting)).is_some_and(toml::Value::is_integer)
}

fn learning(config: &RunConfig) -> Result<(), Problem> {
    let l = &config.learning;
    whole("learning.episodes", l.episodes.into(), 1, 100_000)?;
    whole("learning.step_limit", l.step_limit.into(), 1, 100_000)?;
    within("learning.gamma", l.gamma, 0.0, 1.0)?;
    within("learning.epsilon_start", l.epsilon_start, 0.0, 1.0)?;
    above("learning.epsilon_decay_share", l.epsilon_decay_share, 0.0, 1.0)?;
    whole("learning.bins", l.bins.into(), 2, 1000)?;
    let count = config.law.count() as i32;
    let entries = f64::from(l.bins).powi(2) * 3f64.powi(count);
    if entries > MAX_Q_TABLE {
        let problem = format!(
            "is {}: with the {count} parameters of the law {} a learner's table would hold {entries:e} entries, but \
             may hold at most {MAX_Q_TABLE:e}; use fewer bins, or a law with fewer parameters",
            l.bins, config.law.name
        );
        return Err(("learning.bins".to_owned(), problem));
    }
    above("learning.error_high_cross_m", l.error_high_cross_m, 0.0, 100.0)?;
    above("learning.error_high_heading_rad", l.error_high_heading_rad, 0.0, 3.2)?;
    within("learning.heading_weight", l.heading_weight, 0.0, 1000.0)?;
    whole("learning.lock_window", l.lock_window.into(), 2, 1000)
}

fn run(config: &RunConfig) -> Result<(), Problem> {
    let run = &config.run;
    if run.alphas.is_empty() {
        return Err(("run.alphas".to_owned(), "is empty; name at least one".to_owned()));
    }
    whole("run.alphas", run.alphas.len() as u64, 1, MAX_FLEET.into()).map_err(|(key, _)| {
        (key, format!("holds {} values, but may hold at most {MAX_FLEET}", run.alphas.len()))
    })?;
    for (index, &alpha) in run.alphas.iter().enumerate() {
        above(&format!("run.alphas[{index}]"), alpha, 0.0, 1.0)?;
    }
    if let Some(value) = config.tuner.settings.0.get("learners") {
        let number = value.as_float().or(value.as_integer().map(|it| it as f64));
        within("tuner.settings.learners", number.unwrap_or(f64::NAN), 1.0, MAX_FLEET.into())?;
    }
    whole("run.fleet", run.fleet.into(), 0, MAX_FLEET.into())
}

fn safety(config: &RunConfig) -> Result<(), Problem> {
    let s = &config.vehicle.safety;
    for (key, limit) in [
        ("acceleration_limit_mps2", s.acceleration_limit_mps2),
        ("deceleration_limit_mps2", s.deceleration_limit_mps2),
        ("jerk_limit_mps3", s.jerk_limit_mps3),
        ("steering_rate_limit_radps", s.steering_rate_limit_radps),
        ("lateral_acceleration_limit_mps2", s.lateral_acceleration_limit_mps2),
        ("jump_limit_m", s.jump_limit_m),
        ("jump_limit_rad", s.jump_limit_rad),
    ] {
        above(&format!("vehicle.safety.{key}"), limit, 0.0, f64::INFINITY)?;
    }
    if let Some(limit) = s.own_full_brake_mps2() {
        above("vehicle.safety.full_brake_mps2", limit, 0.0, f64::INFINITY)?;
    }
    within("vehicle.safety.reverse_limit_mps", s.reverse_limit_mps, 0.0, f64::INFINITY)?;
    for (key, limit) in [
        ("path_distance_limit_m", s.path_distance_limit_m),
        ("path_heading_limit_rad", s.path_heading_limit_rad),
    ] {
        if let Limit::Is(limit) = limit {
            above(&format!("vehicle.safety.{key}"), limit, 0.0, f64::INFINITY)?;
        }
    }
    above("vehicle.safety.stop_deceleration_mps2", s.stop_deceleration_mps2, 0.0, 100.0)?;
    above("vehicle.safety.standstill_mps", s.standstill_mps, 0.0, 1.0)?;
    within("vehicle.safety.degraded_limit_s", s.degraded_limit_s, 0.0, 10.0)?;
    above("vehicle.safety.answer_age_limit_s", s.answer_age_limit_s, 0.0, 10.0)?;
    above("vehicle.safety.command_age_limit_s", s.command_age_limit_s, 0.0, 10.0)
}

pub(crate) fn vehicle(config: &RunConfig) -> Result<(), Problem> {
    safety(config)?;
    crate::ros2::validate(&config.vehicle.ros2)?;
    let v = &config.vehicle;
    within("vehicle.wheelbase_m", v.wheelbase_m, 0.01, 20.0)?;
    crate::tuned::validate(&v.gains, v.wheelbase_m)?;
    crate::stated::validate(v)?;
    within("vehicle.tracked_point_m", v.tracked_point_m, -20.0, 20.0)?;
    above("vehicle.body_front_m", v.body_front_m, 0.0, 20.0)?;
    above("vehicle.body_rear_m", v.body_rear_m, 0.0, 20.0)?;
    above("vehicle.body_half_width_m", v.body_half_width_m, 0.0, 20.0)?;
    angle("vehicle.steering_limit_rad", v.steering_limit_rad, 1.5)?;
    angle("vehicle.steering_rate_radps", v.steering_rate_radps, 100.0)?;
    within("vehicle.steering_delay_s", v.steering_delay_s, 0.0, 1.0)?;
    within("vehicle.steering_gain", v.steering_gain, 0.1, 10.0)?;
    within("vehicle.steering_offset_rad", v.steering_offset_rad, -0.5, 0.5)?;
    within("vehicle.steering_dead_band_rad", v.steering_dead_band_rad, 0.0, 0.5)?;
    within("vehicle.steering_lag_s", v.steering_lag_s, 0.0, 10.0)?;
    above("vehicle.speed_limit_mps", v.speed_limit_mps, 0.0, 100.0)?;
    within("vehicle.speed_delay_s", v.speed_delay_s, 0.0, 1.0)?;
    within("vehicle.speed_kp", v.speed_kp, 0.0, 100.0)?;
    within("vehicle.speed_ki", v.speed_ki, 0.0, 100.0)?;
    within("vehicle.speed_integral_min", v.speed_integral_min, -10.0, 10.0)?;
    within("vehicle.speed_integral_max", v.speed_integral_max, v.speed_integral_min, 10.0)?;
    within("vehicle.pedal_lag_s", v.pedal_lag_s, 1e-6, 10.0)?;
    above("vehicle.throttle_accel_mps2", v.throttle_accel_mps2, 0.0, 100.0)?;
    above("vehicle.brake_decel_mps2", v.brake_decel_mps2, 0.0, 100.0)?;
    within("vehicle.drag_per_s", v.drag_per_s, 0.0, 100.0)?;
    within("vehicle.rolling_decel_mps2", v.rolling_decel_mps2, 0.0, 100.0)?;
    within("vehicle.gear_drive_s", v.gear_drive_s, 0.0, 60.0)?;
    within("vehicle.gear_reverse_s", v.gear_reverse_s, 0.0, 60.0)?;
    above("vehicle.gear_poll_s", v.gear_poll_s, 0.0, 60.0)?;
    above("vehicle.gear_speed_mps", v.gear_speed_mps, 0.0, 10.0)?;
    above("vehicle.mass_kg", v.mass_kg, 0.0, 1e5)?;
    above("vehicle.yaw_inertia_kgm2", v.yaw_inertia_kgm2, 0.0, 1e6)?;
    above("vehicle.front_axle_to_cg_m", v.front_axle_to_cg_m, 0.0, 20.0)?;
    above("vehicle.cornering_stiffness_front_npr", v.cornering_stiffness_front_npr, 0.0, 1e7)?;
    above("vehicle.cornering_stiffness_rear_npr", v.cornering_stiffness_rear_npr, 0.0, 1e7)?;
    within("vehicle.rear_slip_s2pm", v.rear_slip_s2pm, 0.0, MOST_REAR_SLIP_S2PM)?;
    within("vehicle.yaw_lag_s2pm", v.yaw_lag_s2pm, 0.0, MOST_YAW_LAG_S2PM)?;
    within("vehicle.understeer_s2pm", v.understeer_s2pm, 0.0, MOST_UNDERSTEER_S2PM)?;
    if v.model == VehicleModel::Dynamic { dynamic_vehicle(v) } else { Ok(()) }
}

/// Tyres that slip more than this under a load have none to speak of: a road car has 0.002 to 0.006 s²/m.
const MOST_REAR_SLIP_S2PM: f64 = 0.05;
/// A lag of the yaw rate that is longer is not one of tyres: a road car has some 0.005 s²/m.
const MOST_YAW_LAG_S2PM: f64 = 0.05;
/// A road car has up to 0.005 s²/m.
const MOST_UNDERSTEER_S2PM: f64 = 0.05;

/// Checks values that must fit together in the dynamic model, but do not matter to the kinematic one.
fn dynamic_vehicle(v: &Vehicle) -> Result<(), Problem> {
    let keys = [
        ("rear_slip_s2pm", v.rear_slip_s2pm),
        ("yaw_lag_s2pm", v.yaw_lag_s2pm),
        ("understeer_s2pm", v.understeer_s2pm),
    ];
    for (key, value) in keys {
        if value != 0.0 {
            let problem = format!(
                "is {value}, but model = \"dynamic\" has tyres that slip by themselves; make it 0, or the model \"kinematic\""
            );
            return Err((format!("vehicle.{key}"), problem));
        }
    }
    let (front_m, rear_m) = (v.front_axle_to_cg_m, v.wheelbase_m - v.front_axle_to_cg_m);
    if rear_m <= 0.0 {
        let problem =
            format!("is {front_m}, but must be less than the wheelbase, {}", v.wheelbase_m);
        return Err(("vehicle.front_axle_to_cg_m".to_owned(), problem));
    }
    let (front_npr, rear_npr) = (v.cornering_stiffness_front_npr, v.cornering_stiffness_rear_npr);
    // An oversteering car becomes unstable at this speed: it turns ever faster without any steering.
    let oversteer = v.mass_kg * (front_m * front_npr - rear_m * rear_npr);
    let stiffness = front_npr * rear_npr * v.wheelbase_m * v.wheelbase_m;
    if oversteer * v.speed_limit_mps * v.speed_limit_mps >= stiffness {
        let problem = format!(
            "is {rear_npr}, with which the car oversteers and is unstable from {:.1} m/s on; use stiffer \
             rear tyres or a vehicle.speed_limit_mps below that",
            (stiffness / oversteer).sqrt()
        );
        return Err(("vehicle.cornering_stiffness_rear_npr".to_owned(), problem));
    }
    Ok(())
}

/// `low <= value <= high`; NaN is never within.
pub(crate) fn within(key: &str, value: f64, low: f64, high: f64) -> Result<(), Problem> {
    if (low..=high).contains(&value) {
        return Ok(());
    }
    Err((key.to_owned(), format!("is {value}, but must lie in [{low}, {high}]")))
}

/// `low < value <= high`; NaN is never within.
pub(crate) fn above(key: &str, value: f64, low: f64, high: f64) -> Result<(), Problem> {
    if value > low && value <= high {
        return Ok(());
    }
    Err((key.to_owned(), format!("is {value}, but must lie in ({low}, {high}]")))
}

/// Nobody states more degrees, or degrees a second.
const MOST_DEGREES: f64 = 3600.0;

/// An angle, or its rate, above 0; one that is too large may be in degrees.
fn angle(key: &str, value: f64, high: f64) -> Result<(), Problem> {
    above(key, value, 0.0, high).map_err(|(key, problem)| {
        let in_degrees = value > high && value <= MOST_DEGREES;
        let hint = format!("; it is in radians: {value}° are {:.3}", value.to_radians());
        (key, if in_degrees { problem + &hint } else { problem })
    })
}

fn whole(key: &str, value: u64, low: u64, high: u64) -> Result<(), Problem> {
    if (low..=high).contains(&value) {
        return Ok(());
    }
    Err((key.to_owned(), format!("is {value}, but must lie in [{low}, {high}]")))
}
