//! What is made of a path's file before it is a layer: smoothed, evenly spaced, with speeds that the car can drive.

use crate::path_file::PathFile;
use crate::points::{CURVATURE_MARGIN, MAX_POINTS, tightest};
use crate::resample::{Resampled, resample};
use crate::smooth::smooth;
use crate::speed_profile::{SpeedLimits, profile, too_abrupt};
use crate::{ConfigError, PathOptions, Vehicle};

/// Without --smooth, points are smoothed only where they lie to and fro or cannot be driven, and only if the car can drive
/// the smoothed line, which moves by less than localisation can mean: at the mean, and at most.
const UNASKED_MEAN_M: f64 = 0.05;
const UNASKED_MOST_M: f64 = 0.2;
/// The share of the vehicle's limits that a profile asks for: what drives it needs some of them to correct.
const PROFILE_SHARE: f64 = 0.9;
/// The slowest speed on the way: where a file says 0, the reference passes at this speed instead of standing for ever.
const SLOWEST_MPS: f64 = 0.1;
/// The fewest points that can be smoothed.
const FEWEST: usize = 5;

/// What the layers below the path say of the car.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Below<'a> {
    /// `None` if its keys are no vehicle, which is reported when they are resolved.
    pub(crate) vehicle: Option<&'a Vehicle>,
    pub(crate) reference_mps: Option<f64>,
    /// The highest speed that the vehicle and the gate allow.
    pub(crate) most_mps: f64,
}

/// A path that is ready to be driven; what was made of it is added to the file's notes.
pub(crate) fn make(
    origin: &str,
    file: &mut PathFile,
    below: Below,
    options: &PathOptions,
) -> Result<Resampled, ConfigError> {
    let sharpest = below.vehicle.map(|it| libm::tan(it.steering_limit_rad) / it.wheelbase_m);
    let sharpest = sharpest.filter(|it| it.is_finite() && *it > 0.0).unwrap_or(0.2);
    stand_at_the_end(origin, file)?;
    let mut path = resample(&file.points, &file.speeds_mps, MAX_POINTS);
    let is_drivable = |path: &Resampled| tightest(&path.points).1 <= sharpest * CURVATURE_MARGIN;
    let zigzags = zigzags(&file.points);
    if (options.smooth_m.is_some() || zigzags || !is_drivable(&path)) && file.points.len() >= FEWEST
    {
        let bound_m = options.smooth_m.unwrap_or(UNASKED_MEAN_M);
        let smoothed = smooth(&file.points, sharpest, bound_m);
        let is_taken = match options.smooth_m {
            Some(_) if smoothed.mean_m > bound_m => {
                let problem = format!(
                    "holds points that lie {:.2} m from the least smooth line at the mean, but --smooth allows {bound_m} m; try \
                     --smooth {:.1}",
                    smoothed.mean_m,
                    (10.0 * smoothed.mean_m).ceil() / 10.0
                );
                return Err(ConfigError::new(origin, "", problem));
            }
            Some(_) => true,
            None => {
                smoothed.is_drivable
                    && smoothed.mean_m <= UNASKED_MEAN_M
                    && smoothed.greatest_m <= UNASKED_MOST_M
            }
        };
        if is_taken {
            let why = if options.smooth_m.is_some() {
                "smoothed"
            } else if is_drivable(&path) {
                "smoothed, since its points lie to and fro beside the line, as noise does"
            } else {
                "smoothed, since noise made turns that the car cannot drive"
            };
            file.notes.push(format!(
                "{why}: the line lies {:.3} m from the points at the mean, {:.2} m at most",
                smoothed.mean_m, smoothed.greatest_m
            ));
            take(file, smoothed.points, &smoothed.given);
            path = resample(&file.points, &file.speeds_mps, MAX_POINTS);
        }
    }
    tell_of_swings(file, &path);
    if !path.speeds_mps.is_empty() {
        keep_stops(&file.speeds_mps, &mut path);
        let last = path.speeds_mps.len() - 1;
        for speed_mps in &mut path.speeds_mps[..last] {
            *speed_mps = speed_mps.max(SLOWEST_MPS);
        }
    }
    if let Some(vehicle) = below.vehicle {
        let limits = SpeedLimits::of(vehicle);
        if options.speed_profile {
            lower(file, &mut path, below, limits.times(PROFILE_SHARE));
        } else if !path.speeds_mps.is_empty() {
            let step_m = path.length_m / (path.points.len() - 1) as f64;
            if let Some((index, mps2)) = too_abrupt(&path.speeds_mps, step_m, limits) {
                file.notes.push(format!(
                    "its speeds change by {:.1} m/s² behind line {}, more than the vehicle can do; --speed-profile lowers them",
                    mps2.abs(),
                    file.lines[path.given[index]]
                ));
            }
        }
    }
    path.count_time();
    keep_widths(file, &mut path);
    Ok(path)
}

/// Whether the points lie to and fro beside a line: white noise turns the steps by angles of which each two neighbours are
/// opposed (their correlation is -2/3), while on curves they are alike.
fn zigzags(points: &[[f64; 2]]) -> bool {
    /// The root of the mean squared turn, rad: below it, the rounding of a file's decimals looks the same.
    const TURN_RAD: f64 = 0.12;
    const OPPOSED: f64 = -0.3;
    let steps: Vec<[f64; 2]> =
        points.windows(2).map(|pair| [pair[1][0] - pair[0][0], pair[1][1] - pair[0][1]]).collect();
    let turns: Vec<f64> = steps
        .windows(2)
        .map(|pair| {
            let [[ax, ay], [bx, by]] = [pair[0], pair[1]];
            libm::atan2(ax * by - ay * bx, ax * bx + ay * by)
        })
        .collect();
    let square: f64 = turns.iter().map(|turn| turn * turn).sum();
    let beside: f64 = turns.windows(2).map(|pair| pair[0] * pair[1]).sum();
    turns.len() >= 10
        && square > TURN_RAD * TURN_RAD * turns.len() as f64
        && beside < OPPOSED * square
}

/// Tells where the line between two points swings far out of their straight connection: a few points tell little of it.
fn tell_of_swings(file: &mut PathFile, path: &Resampled) {
    /// The share of the distance of two points, between the ends of a quarter of a circle it is 0.21; and what is much
    /// for a car of any size.
    const SHARE: f64 = 0.25;
    const MUCH_M: f64 = 1.0;
    let (mut widest_m, mut at) = (0.0, 0);
    for (point, given) in path.points.iter().zip(&path.given) {
        let (Some(a), Some(b)) = (file.points.get(*given), file.points.get(given + 1)) else {
            continue;
        };
        let [dx, dy] = [b[0] - a[0], b[1] - a[1]];
        let chord_m = libm::hypot(dx, dy);
        let beside_m = ((point[0] - a[0]) * dy - (point[1] - a[1]) * dx).abs() / chord_m;
        if beside_m > (SHARE * chord_m).min(MUCH_M) && beside_m > widest_m {
            (widest_m, at) = (beside_m, *given);
        }
    }
    if widest_m > 0.0 {
        file.notes.push(format!(
            "between lines {} and {} the path swings {widest_m:.1} m out of their straight connection, as smooth lines through few \
             points do; give more points where it is to be straight",
            file.lines[at],
            file.lines[at + 1]
        ));
    }
}

/// Where the file says 0 on the way, so does the line: its own points may lie on both sides of such a point, and miss it.
fn keep_stops(given_mps: &[f64], path: &mut Resampled) {
    let last = path.speeds_mps.len() - 1;
    let inner = 1..given_mps.len().saturating_sub(1);
    for stop in inner.filter(|index| given_mps[*index] == 0.0) {
        let at = path.given.partition_point(|given| *given < stop).min(last);
        path.speeds_mps[at] = 0.0;
    }
}

/// Speeds of 0 are taken as where the car stands: at the ends, and on the way.
fn stand_at_the_end(origin: &str, file: &mut PathFile) -> Result<(), ConfigError> {
    let count = file.speeds_mps.len();
    if count == 0 {
        return Ok(());
    }
    if file.speeds_mps.iter().all(|speed_mps| *speed_mps == 0.0) {
        let problem = "holds no speed above 0; leave the column out, and set reference.speed_mps";
        return Err(ConfigError::new(format!("{origin}:{}", file.lines[0]), "", problem));
    }
    let zeros =
        |from: usize, to: usize| file.speeds_mps[from..to].iter().filter(|it| **it == 0.0).count();
    let mut words: Vec<String> = Vec::new();
    if file.speeds_mps[0] == 0.0 {
        words.push("at its start, from which the car sets out at rest".to_owned());
    }
    if file.speeds_mps[count - 1] == 0.0 {
        words.push(
            "at its end, where the drive is over within drive.goal_radius_m and the car is stopped"
                .to_owned(),
        );
    }
    let inner = if count > 2 { zeros(1, count - 1) } else { 0 };
    if inner > 0 {
        let points = if inner == 1 { "a point".to_owned() } else { format!("{inner} points") };
        let slows = format!("where the reference slows to {SLOWEST_MPS} m/s");
        words.push(match longest_stop(file) {
            Some((from, to, length_m)) => format!(
                "at {points} between, {slows}, as a drive has no stops: from line {} to line {} it creeps along {length_m:.1} m, for \
                 {:.0} s",
                file.lines[from],
                file.lines[to],
                length_m / SLOWEST_MPS
            ),
            None => format!("at {points} between, {slows} for a moment, as a drive has no stops"),
        });
    }
    if !words.is_empty() {
        file.notes.push(format!("the speed is 0 {}", words.join(", and ")));
    }
    Ok(())
}

/// The longest stretch on the way on which the speeds are 0: its first and last point, and its length, if it has one.
fn longest_stop(file: &PathFile) -> Option<(usize, usize, f64)> {
    let last = file.speeds_mps.len() - 1;
    let stands = |index: usize| (1..last).contains(&index) && file.speeds_mps[index] == 0.0;
    let mut longest: Option<(usize, usize, f64)> = None;
    let mut from = 1;
    while from < last {
        let to = (from..last).take_while(|index| stands(*index)).last().unwrap_or(from);
        let steps = file.points[from..=to].windows(2);
        let length_m: f64 =
            steps.map(|it| libm::hypot(it[1][0] - it[0][0], it[1][1] - it[0][1])).sum();
        if length_m > longest.map_or(0.0, |it| it.2) {
            longest = Some((from, to, length_m));
        }
        from = to + 1;
    }
    longest
}

/// Takes a smoothed line for the points of a file.
fn take(file: &mut PathFile, points: Vec<[f64; 2]>, given: &[(usize, usize)]) {
    let middle = |(from, to): &(usize, usize)| usize::midpoint(*from, *to - 1);
    if !file.speeds_mps.is_empty() {
        file.speeds_mps = given.iter().map(|range| file.speeds_mps[middle(range)]).collect();
    }
    if !file.widths_m.is_empty() {
        file.widths_m = given.iter().map(|range| file.widths_m[middle(range)]).collect();
    }
    file.lines = given.iter().map(|range| file.lines[middle(range)]).collect();
    file.points = points;
}

/// Spaces the widths of the road as the points are.
fn keep_widths(file: &mut PathFile, path: &mut Resampled) {
    if file.widths_m.is_empty() {
        return;
    }
    // Between two points they change evenly, as speeds do.
    let side = |side: usize| -> Vec<f64> {
        let widths: Vec<f64> = file.widths_m.iter().map(|width| width[side]).collect();
        resample(&file.points, &widths, MAX_POINTS).speeds_mps
    };
    path.widths_m = side(0).into_iter().zip(side(1)).map(|(left, right)| [left, right]).collect();
    let all = || path.widths_m.iter().flatten().copied();
    file.notes.push(format!(
        "the road's edges are {:.2} to {:.2} m away; they are drawn, and a car whose body would pass them is stopped",
        all().fold(f64::INFINITY, f64::min),
        all().fold(0.0, f64::max)
    ));
}

/// Lowers the speeds to what the car can drive.
fn lower(file: &mut PathFile, path: &mut Resampled, below: Below, limits: SpeedLimits) {
    let count = path.points.len();
    let given = if path.speeds_mps.is_empty() {
        let Some(reference_mps) = below.reference_mps.filter(|it| *it > 0.0) else { return };
        vec![reference_mps; count]
    } else {
        path.speeds_mps.clone()
    };
    let most: Vec<f64> = given.iter().map(|it| it.min(below.most_mps)).collect();
    let speeds_mps = profile(&path.points, &most, limits);
    let lowered = (0..count).filter(|index| speeds_mps[*index] < given[*index] - 1e-9).count();
    let range = |speeds: &[f64]| {
        let (low, high) = speeds
            .iter()
            .fold((f64::INFINITY, 0.0_f64), |(low, high), it| (low.min(*it), high.max(*it)));
        format!("{low:.2} to {high:.2} m/s")
    };
    file.notes.push(format!(
        "speed profile: {} instead of {}, lowered on {:.0} % of the path, within {:.1} m/s² sideways, {:.1} forwards, {:.1} braking",
        range(&speeds_mps),
        range(&given),
        100.0 * lowered as f64 / count as f64,
        limits.lateral_mps2,
        limits.acceleration_mps2,
        limits.deceleration_mps2
    ));
    path.speeds_mps = speeds_mps;
}
