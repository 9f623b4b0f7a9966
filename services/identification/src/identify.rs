//! From recorded drives to the values of a vehicle's file.

use config::{Vehicle, VehicleModel};
use serde::Serialize;

use crate::compared::{Compared, compared};
use crate::computed::{Computed, computed, follows, speed_is_commanded};
use crate::drive::{Drive, STANDING_MPS, Stretch, choose, stretches};
use crate::fit::{Fitted, fit_speed, fit_steering, refit};
use crate::levenberg::{median, white_noise_sd};
use crate::prediction::{self, Car, FOLDS, Prediction, is_held_out};
use crate::refusal::Refusal;
use crate::rows::{
    Row, SPEED_STEPS, allow_for_late_commands, delay_and_lag, limits_of_speed, limits_of_steering,
    point_with_slip, slip_row, speed_rows, steering_rows,
};
use crate::slip::{Slip, fit_slip};
use crate::speed::Speed;
use crate::steering::{self, GRIP_MPS2, HEADING, POSITION, Steering};
use crate::units::{wrong_unit, wrong_unit_of_odometry};

/// Which key of a vehicle's file says where the point of the recorded poses lies.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Point {
    /// `tracked_point_m`: the recording holds what the pipeline saw.
    #[default]
    Tracked,
    /// `ros2.odometry_point_m`: the recording holds what the car published.
    Odometry,
}

impl Point {
    /// How far the point lies ahead of the rear axle, as a vehicle's file says.
    fn of(self, vehicle: &Vehicle) -> f64 {
        match self {
            Self::Tracked => vehicle.tracked_point_m,
            Self::Odometry => vehicle.ros2.odometry_point_m,
        }
    }
}

/// What the user knows.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Options {
    /// Which key the recorded poses tell.
    pub point: Point,
    /// The file's wheelbase was measured at the car: then the steering's gain is found in its place. A drive tells only
    /// their ratio.
    pub wheelbase_is_measured: bool,
    /// The drive is a simulation's, so that odometry may follow the commands without lag and noise.
    pub is_simulated: bool,
}

/// Noise of the odometry, as `[noise]` of a run's configuration has it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct NoiseFound {
    /// Standard deviation of x and of y.
    pub position_sd_m: f64,
    /// Half the width of the heading's triangular distribution that has the standard deviation which was found.
    pub heading_half_width_rad: f64,
    /// Standard deviation of the speed; `None` if the drive does not tell it, as where it is rounded coarsely.
    pub speed_sd_mps: Option<f64>,
    /// Standard deviation of the yaw rate; `None` if it is not measured, or not told either.
    pub yaw_rate_sd_radps: Option<f64>,
}

/// What the fit leaves of the drive: standard deviations, told by medians.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Residuals {
    /// Of the speed, as it follows from the commands alone.
    pub speed_mps: f64,
    /// Of the yaw rate; `None` if it is not measured.
    pub yaw_rate_radps: Option<f64>,
    /// Of each coordinate, within windows of 3 s.
    pub position_m: f64,
    /// Of the heading, within these.
    pub heading_rad: f64,
}

/// What drives tell of a car.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Identification {
    /// Key by key.
    pub rows: Vec<Row>,
    /// Dead time and lag of the steering together, which a drive tells better than the two apart.
    pub delay_and_lag: Row,
    /// Predictions over 1 s and 3 s, each of a part of the drive by a fit of the rest.
    pub predictions: Vec<Prediction>,
    /// Noise of the odometry.
    pub noise: NoiseFound,
    /// What the fit leaves.
    pub residuals: Residuals,
    /// How many times too large the measured speed is, against the poses.
    pub speed_scale: f64,
    /// Seconds in which the car moved, of what was fitted.
    pub moving_s: f64,
    /// Seconds of the recording, and how many of them were fitted: of long ones, those with the most steering.
    pub recorded_s: f64,
    /// See `recorded_s`.
    pub fitted_s: f64,
    /// What the user should know.
    pub warnings: Vec<String>,
    /// What to drive so that more keys show.
    pub drive_next: Vec<String>,
    /// The vehicle with the values that were identified.
    #[serde(skip)]
    pub vehicle: Vehicle,
    /// What was measured beside what is predicted.
    #[serde(skip)]
    pub compared: Compared,
}

impl Identification {
    /// Whether the new values predict better than the file's, over 1 s as well as over 3 s.
    pub fn is_better(&self) -> bool {
        self.predictions.iter().all(Prediction::is_better)
    }
}

/// A car has to move for so long.
const SHORTEST_S: f64 = 20.0;
/// Yaw rate and command must go together this well.
const FOLLOWS: f64 = 0.5;
/// No more than this is fitted.
const LONGEST_S: f64 = 150.0;
/// Wheels turn by less than a right angle; commands beyond it are degrees, or those of a servo.
const MOST_STEERING_RAD: f64 = std::f64::consts::FRAC_PI_2;
/// How far ahead is predicted.
const HORIZONS_S: [f64; 2] = [1.0, 3.0];
/// Above this share, the measured speed is called wrong.
const SCALE_SHARE: f64 = 0.01;
/// By this factor, nobody is off who has measured a wheelbase.
const FAR_OFF: f64 = 1.3;
/// Poses that are older or younger than the yaw rate by more than this are told: some ticks of a controller.
const POSE_AGE_S: f64 = 0.02;

/// The largest commanded angle, but for one command in a hundred, which may be a slip of the recorder.
fn most_steering_rad(drive: &[Stretch]) -> f64 {
    let commands = drive.iter().flat_map(|it| &it.commands);
    let mut angles: Vec<f64> = commands.map(|it| it.steering_rad.abs()).collect();
    angles.sort_by(f64::total_cmp);
    angles.get((99 * angles.len()) / 100).copied().unwrap_or_default()
}

/// Identifies a car from drives in it.
///
/// # Errors
/// If the drives cannot tell it: they are too short, the car did not follow the commands or turned the wrong way, or the
/// odometry was computed from the commands.
pub fn identify(
    drives: &[Drive],
    vehicle: &Vehicle,
    options: Options,
) -> Result<Identification, Refusal> {
    let whole: Vec<Stretch> = drives.iter().flat_map(stretches).collect();
    let length_s = |all: &[Stretch]| all.iter().map(|it| it.tick_s * it.len() as f64).sum::<f64>();
    let recorded_s = length_s(&whole);
    let chosen = choose(whole, LONGEST_S);
    let moving_s = chosen.iter().map(Stretch::moving_s).fold(0.0, |sum, it| sum + it);
    if moving_s < SHORTEST_S {
        let apart_s = usual_step_s(drives);
        let all = drives.iter().flat_map(|it| &it.odometry);
        let back = all.filter(|it| it.speed_mps < -STANDING_MPS);
        let is_backwards = back.count() as f64 * apart_s > moving_s;
        return Err(Refusal::TooShort { moving_s, needed_s: SHORTEST_S, apart_s, is_backwards });
    }
    if let Some(wrong) = wrong_unit_of_odometry(&chosen) {
        return Err(wrong);
    }
    let most_rad = most_steering_rad(&chosen);
    if most_rad > MOST_STEERING_RAD {
        return Err(Refusal::NotRadians { most_rad });
    }
    let how_made = computed(&chosen);
    match how_made {
        Some(Computed::Zero) => return Err(Refusal::NoYawRate),
        Some(Computed::FromCommand { wheelbase_m }) if !options.is_simulated => {
            return Err(Refusal::Computed { wheelbase_m });
        }
        Some(Computed::OfCommand) if !options.is_simulated => return Err(Refusal::OfCommand),
        _ => {}
    }
    let correlation = follows(&chosen);
    if correlation < -FOLLOWS {
        return Err(Refusal::WrongWay);
    }
    if correlation < FOLLOWS {
        return Err(Refusal::DoesNotFollow { correlation });
    }
    let point_m = options.point.of(vehicle);
    let undetermined = || Refusal::Undetermined;
    let of_slip = slip_of(&chosen, vehicle, &|_| true);
    let slip = of_slip.map(|it| slip_row(it, vehicle));
    let measured = options.wheelbase_is_measured;
    let limits = limits_of_steering(vehicle);
    let (of_steering, tyres_are_at_limit) =
        fit_steering(&chosen, &slipping(vehicle, &slip), point_m, measured, &limits)
            .ok_or_else(undetermined)?;
    let steered = steering::to_vehicle(&of_steering.at, vehicle);
    let of_speed = fit_speed(&chosen, &steered, &limits_of_speed).ok_or_else(undetermined)?;

    let mut rows = steering_rows(&of_steering, vehicle, point_m, options);
    rows.extend(slip);
    point_with_slip(&mut rows, of_slip.flatten());
    let is_commanded = !options.is_simulated && speed_is_commanded(&chosen);
    rows.extend(speed_rows(&of_speed, vehicle, is_commanded));
    let new = apply(vehicle, &rows, options);

    let predictions = predict(&chosen, vehicle, options, (&of_speed, is_commanded), &of_steering);
    let has_yaw_rate =
        chosen.iter().all(|it| it.yaw_rate_radps.iter().all(|rate| rate.is_finite()));
    let measured = |of: f64| has_yaw_rate.then_some(of);
    let noise = NoiseFound {
        speed_sd_mps: noise_of(&chosen, |it| &it.speed_mps),
        yaw_rate_sd_radps: noise_of(&chosen, |it| &it.yaw_rate_radps).filter(|_| has_yaw_rate),
        position_sd_m: of_steering.weights.deviations[POSITION],
        // A triangular distribution of half width h has a standard deviation of h/√6.
        heading_half_width_rad: 6.0_f64.sqrt() * of_steering.weights.deviations[HEADING],
    };
    let spreads = &of_steering.weights.spreads;
    let residuals = Residuals {
        speed_mps: of_speed.weights.spreads[0],
        yaw_rate_radps: measured(spreads[0]),
        position_m: spreads[POSITION],
        heading_rad: spreads[HEADING],
    };
    let fitted_s = length_s(&chosen);
    let (old_car, new_car) =
        (Car { vehicle, point_m }, Car { vehicle: &new, point_m: options.point.of(&new) });
    let compared = compared(&chosen, old_car, new_car);
    let mut delay_and_lag = delay_and_lag(&of_steering, vehicle);
    let late_commands_s = drives.iter().map(|it| it.late_commands_s).fold(0.0, f64::max);
    allow_for_late_commands(rows.iter_mut().chain([&mut delay_and_lag]), late_commands_s);
    let mut found = Identification {
        delay_and_lag,
        predictions,
        noise,
        residuals,
        speed_scale: libm::exp(-of_steering.at[steering::SCALE]),
        moving_s,
        recorded_s,
        fitted_s,
        warnings: Vec::new(),
        drive_next: Vec::new(),
        vehicle: new,
        compared,
        rows,
    };
    found.warnings = warnings(&found, &of_steering);
    if is_commanded {
        found.warnings.push(
            "the measured speed follows the commanded one without any lag, computed and not measured: nothing is told of the \
             speed loop; give the speed of the wheels, or of a localised pose"
                .to_owned(),
        );
    }
    if tyres_are_at_limit {
        found.warnings.push(format!(
            "beyond {GRIP_MPS2} m/s² to the side the car turned less than its wheels were told, and not below: its tyres may have \
             been at their limit; drive bends slowly to tell the steering"
        ));
    }
    if how_made == Some(Computed::Unknown) && !options.is_simulated {
        found.warnings.push(
            "the car steers too little to tell whether its yaw rate was measured or computed from the commands: if its driver \
             computes it, these values are the driver's and not the car's"
                .to_owned(),
        );
    }
    found.warnings.extend(beyond_limits(&chosen, most_rad, vehicle));
    found.warnings.extend(wrong_unit(&chosen));
    found.drive_next = drive_next(&found.rows);
    Ok(found)
}

/// Limits of the file that the car did not have.
fn beyond_limits(drive: &[Stretch], most_rad: f64, vehicle: &Vehicle) -> Vec<String> {
    const ROUNDING: f64 = 1.01;
    /// The largest command, if they are shares.
    const NORMALISED: std::ops::RangeInclusive<f64> = 0.95..=1.001;
    let fastest_mps =
        drive.iter().flat_map(|it| &it.smooth_mps).fold(0.0_f64, |most, it| most.max(*it));
    let wheels = (
        most_rad,
        vehicle.steering_limit_rad,
        format!(
            "commands go up to {most_rad:.3} rad, and the file's steering_limit_rad is {}: by the file, the wheels turned no \
             further; correct it if the car's do{}",
            vehicle.steering_limit_rad,
            if NORMALISED.contains(&most_rad) {
                ", or give the commands in radians if they are shares of the full angle, from -1 to 1"
            } else {
                ""
            }
        ),
    );
    let speed = (
        fastest_mps,
        vehicle.speed_limit_mps,
        format!(
            "the car drove at up to {fastest_mps:.2} m/s, and the file's speed_limit_mps is {}: correct it if it may",
            vehicle.speed_limit_mps
        ),
    );
    let passed = [wheels, speed].into_iter().filter(|(most, limit, _)| *most > ROUNDING * limit);
    passed.map(|(_, _, words)| words).collect()
}

/// The usual time between two samples of the odometry.
fn usual_step_s(drives: &[Drive]) -> f64 {
    let times = drives.iter().flat_map(|it| it.odometry.windows(2));
    let mut steps: Vec<f64> = times.map(|it| it[1].time_s - it[0].time_s).collect();
    median(&mut steps)
}

/// What to drive so that more keys show, each once.
fn drive_next(rows: &[Row]) -> Vec<String> {
    let is_told = |key: &str| rows.iter().any(|it| it.key == key && it.identified);
    // Steps of the speed tell its dead time and its gain first. Where they did, more of them would tell no more.
    let has_steps = is_told("speed_delay_s") && is_told("speed_kp");
    let mut next: Vec<String> = Vec::new();
    let is_open = |row: &&Row| !row.identified && !row.agrees && !row.is_as_commanded();
    for row in rows.iter().filter(is_open) {
        let Some(drive) = row.drive_next() else { continue };
        let was_driven = has_steps && drive == SPEED_STEPS;
        if !was_driven && next.iter().all(|it| it != drive) {
            next.push(drive.to_owned());
        }
    }
    next
}

/// What blocks of the drive tell of the rear axle's slip, if anything; `None` for a model that has no such key.
fn slip_of(
    stretches: &[Stretch],
    vehicle: &Vehicle,
    counts: &dyn Fn(usize) -> bool,
) -> Option<Option<Slip>> {
    // The dynamic model's tyres slip by themselves.
    let slips = vehicle.model == VehicleModel::Kinematic;
    slips.then(|| fit_slip(stretches, vehicle.wheelbase_m, counts))
}

/// The vehicle with the slip of a row.
fn slipping(vehicle: &Vehicle, slip: &Option<Row>) -> Vehicle {
    let rear_slip_s2pm = slip.as_ref().map_or(vehicle.rear_slip_s2pm, |row| row.after);
    Vehicle { rear_slip_s2pm, ..vehicle.clone() }
}

/// Fits parts of the drive, and predicts the rest.
fn predict(
    stretches: &[Stretch],
    vehicle: &Vehicle,
    options: Options,
    (of_speed, speed_is_commanded): (&Fitted, bool),
    of_steering: &Fitted,
) -> Vec<Prediction> {
    let point_m = options.point.of(vehicle);
    let steered = steering::to_vehicle(&of_steering.at, vehicle);
    let part = |fitted: &Fitted, at: Vec<f64>| Fitted { at, ..fitted.clone() };
    let mut pairs = HORIZONS_S.map(|_| Vec::new());
    for fold in 0..FOLDS {
        let counts = |block: usize| !is_held_out(block, fold);
        let speed_at = refit(Speed::new(stretches, &steered), of_speed, &counts);
        let measured = options.wheelbase_is_measured;
        let slip = slip_of(stretches, vehicle, &counts).map(|it| slip_row(it, vehicle));
        let joint = Steering::new(stretches, &slipping(vehicle, &slip), point_m, measured, true);
        let steering_at = refit(joint, of_steering, &counts);
        let mut rows = steering_rows(&part(of_steering, steering_at), vehicle, point_m, options);
        rows.extend(slip);
        rows.extend(speed_rows(&part(of_speed, speed_at), vehicle, speed_is_commanded));
        let new = apply(vehicle, &rows, options);
        let (before, after) =
            (Car { vehicle, point_m }, Car { vehicle: &new, point_m: options.point.of(&new) });
        for (over_s, pairs) in HORIZONS_S.into_iter().zip(&mut pairs) {
            pairs.extend(prediction::pairs(stretches, before, after, over_s, fold));
        }
    }
    let sum_up = |(over_s, pairs): (f64, Vec<_>)| prediction::sum_up(&pairs, over_s);
    HORIZONS_S.into_iter().zip(pairs).map(sum_up).collect()
}

/// The vehicle with the values of the rows.
fn apply(vehicle: &Vehicle, rows: &[Row], options: Options) -> Vehicle {
    let mut new = vehicle.clone();
    for row in rows.iter().filter(|row| row.identified) {
        let slot = match row.key {
            "wheelbase_m" => &mut new.wheelbase_m,
            "steering_delay_s" => &mut new.steering_delay_s,
            "steering_lag_s" => &mut new.steering_lag_s,
            "steering_rate_radps" => &mut new.steering_rate_radps,
            "steering_limit_rad" => &mut new.steering_limit_rad,
            "steering_offset_rad" => &mut new.steering_offset_rad,
            "steering_gain" => &mut new.steering_gain,
            "rear_slip_s2pm" => &mut new.rear_slip_s2pm,
            "yaw_lag_s2pm" => &mut new.yaw_lag_s2pm,
            "understeer_s2pm" => &mut new.understeer_s2pm,
            "speed_delay_s" => &mut new.speed_delay_s,
            "speed_kp" => &mut new.speed_kp,
            "speed_ki" => &mut new.speed_ki,
            "throttle_accel_mps2" => &mut new.throttle_accel_mps2,
            "brake_decel_mps2" => &mut new.brake_decel_mps2,
            "pedal_lag_s" => &mut new.pedal_lag_s,
            "drag_per_s" => &mut new.drag_per_s,
            "rolling_decel_mps2" => &mut new.rolling_decel_mps2,
            _ => match options.point {
                Point::Tracked => &mut new.tracked_point_m,
                Point::Odometry => &mut new.ros2.odometry_point_m,
            },
        };
        *slot = row.after;
    }
    new
}

fn warnings(found: &Identification, of_steering: &Fitted) -> Vec<String> {
    let mut warnings = Vec::new();
    let half = of_steering.half(&[(steering::SCALE, 1.0)]);
    let share = found.speed_scale - 1.0;
    if share.abs() > SCALE_SHARE && share.abs() > half {
        let (percent, word) = (100.0 * share.abs(), if share > 0.0 { "more" } else { "less" });
        warnings.push(format!(
            "the measured speed is {percent:.1} % {word} than the poses say: check the wheel's radius or the encoder's factor"
        ));
    }
    let age_s = of_steering.at[steering::POSE_AGE];
    if age_s.abs() > POSE_AGE_S && age_s.abs() > of_steering.half(&[(steering::POSE_AGE, 1.0)]) {
        let (one, comes, other) = match age_s > 0.0 {
            true => ("poses", "come", "yaw rate"),
            false => ("yaw rate", "comes", "poses"),
        };
        warnings.push(format!(
            "the {one} in the odometry {comes} {:.0} ms after the {other}, as with a slow filter; steering_delay_s is the dead time \
             until the yaw rate, but a controller steers by the poses: for it, the dead time is {:.3} s",
            1e3 * age_s.abs(),
            (of_steering.at[steering::DELAY] + age_s).max(0.0)
        ));
    }
    let is_length = |row: &&Row| row.key == "wheelbase_m" && row.identified;
    if let Some(row) = found.rows.iter().find(is_length)
        && !(1.0 / FAR_OFF..FAR_OFF).contains(&(row.after / row.before))
    {
        warnings.push(format!(
            "a wheelbase of {:.3} m is found, and the file's is {} m: measure it; if the file is right, the commands are not the \
             angles of the road wheels in radians, and --wheelbase-measured tells their gain",
            row.after, row.before
        ));
    }
    if found.fitted_s < 0.9 * found.recorded_s {
        warnings.push(format!(
            "{:.0} s of {:.0} s were fitted: those with the most steering and changes of speed",
            found.fitted_s, found.recorded_s
        ));
    }
    let mut check = |what: &str, unit: &str, residual: f64, noise: f64, least: f64| {
        if residual > 1.3 * noise && residual > least {
            warnings.push(format!(
                "the model leaves {residual:.2} {unit} of the {what}, the noise is {noise:.2} {unit}: this car does something \
                 that the model has not; leave a margin when you tune for it"
            ));
        }
    };
    let (left, noise) = (found.residuals, found.noise);
    if let (Some(left), Some(noise)) = (left.yaw_rate_radps, noise.yaw_rate_sd_radps) {
        check("yaw rate", "mrad/s", 1e3 * left, 1e3 * noise, 3.0);
    }
    if let Some(noise) = noise.speed_sd_mps {
        check("speed", "cm/s", 1e2 * left.speed_mps, 1e2 * noise, 1.5);
    }
    warnings
}

/// The noise of what was measured while the car moves, as a sensor at rest may have none; `None` if nothing tells it.
fn noise_of(stretches: &[Stretch], of: fn(&Stretch) -> &Vec<f64>) -> Option<f64> {
    let of_stretch = |it: &Stretch| {
        let differences = of(it).windows(4).zip(it.smooth_mps.windows(4));
        let moving = differences.filter(|(_, v)| v.iter().all(|v| *v > STANDING_MPS));
        white_noise_sd(moving.map(|(values, _)| values))
    };
    Some(stretches.iter().map(of_stretch).fold(0.0, f64::max)).filter(|sd| *sd > 0.0)
}
