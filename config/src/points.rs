//! Checks a path through points: their number, their speeds, and that the vehicle can drive its curves.

use crate::speed_profile::{SpeedLimits, too_abrupt};
use crate::validate::{Problem, above, within};
use crate::{PathConfig, Supervisor, Vehicle};

/// The largest number of points of a path: at a quarter of a metre, 25 km.
pub(crate) const MAX_POINTS: usize = 100_000;

/// The largest number of laps, and of points of all laps together: each process holds an arc for each of them.
const MAX_LAPS: u32 = 1000;
const MAX_LAP_POINTS: u64 = 500_000;

/// How far the start may be from the first point: far below anything that matters, far above rounding.
const START_TOLERANCE_M: f64 = 1e-3;

/// By how much a curve may be tighter than the vehicle's tightest circle; otherwise rounded points of just that circle
/// would be refused.
pub(crate) const CURVATURE_MARGIN: f64 = 1.005;

/// Finds the first problem of a path's points, as (dotted key, problem); none if the path is made of pieces.
pub(crate) fn validate(
    path: &PathConfig,
    vehicle: &Vehicle,
    supervisor: &Supervisor,
    reference_mps: f64,
) -> Result<(), Problem> {
    let PathConfig { start, pieces, points, speeds_mps, laps, .. } = path;
    let fail = |key: String, problem: String| Err((key, problem));
    if !(1..=MAX_LAPS).contains(laps) {
        let problem = format!("is {laps}, but must lie in [1, {MAX_LAPS}]");
        return fail("path.laps".to_owned(), problem);
    }
    if *laps > 1 && points.is_empty() {
        let problem = format!(
            "is {laps}, but a path of pieces is driven once; use a path of points, as with --path FILE"
        );
        return fail("path.laps".to_owned(), problem);
    }
    match (pieces.is_empty(), points.is_empty()) {
        (true, true) => {
            let problem = "is empty, and so is path.points; a path needs a piece, or 2 points";
            return fail("path.pieces".to_owned(), problem.to_owned());
        }
        (false, false) => {
            let problem = "is set together with path.pieces; a path has only one of them, so set the other to []";
            return fail("path.points".to_owned(), problem.to_owned());
        }
        (false, true) if speeds_mps.is_empty() => return Ok(()),
        (false, true) => {
            let problem = "needs path.points; for pieces, set reference.speed_mps";
            return fail("path.speeds_mps".to_owned(), problem.to_owned());
        }
        (true, false) => {}
    }
    let count = points.len();
    if !(2..=MAX_POINTS).contains(&count) {
        let problem = format!("holds {count} points, but must hold 2 to {MAX_POINTS}");
        return fail("path.points".to_owned(), problem);
    }
    for (index, [x_m, y_m]) in points.iter().enumerate() {
        let key = format!("path.points[{index}]");
        within(&key, *x_m, -1e6, 1e6)?;
        within(&key, *y_m, -1e6, 1e6)?;
        if index > 0 && points[index - 1] == [*x_m, *y_m] {
            return fail(key, "repeats the point before it; remove one of them".to_owned());
        }
    }
    if *laps > 1 {
        check_laps(path)?;
    }
    if !speeds_mps.is_empty() && speeds_mps.len() != count {
        let problem = format!("holds {} speeds for {count} points", speeds_mps.len());
        return fail("path.speeds_mps".to_owned(), problem);
    }
    for (index, speed_mps) in speeds_mps.iter().enumerate() {
        let key = format!("path.speeds_mps[{index}]");
        // Only at the end of the path it may be 0: the vehicle comes to stand there.
        if !(*speed_mps == 0.0 && index + 1 == count) {
            above(&key, *speed_mps, 0.0, 50.0)?;
        }
        let limit_mps = vehicle.speed_limit_mps.min(supervisor.speed_limit_mps);
        if *speed_mps > limit_mps {
            let problem = format!(
                "is {speed_mps}, but the limit is {limit_mps}; lower it (--speed-profile does), or raise \
                 vehicle.speed_limit_mps and supervisor.speed_limit_mps"
            );
            return fail(key, problem);
        }
    }
    if !path.widths_m.is_empty() && path.widths_m.len() != count {
        let problem = format!("holds {} pairs for {count} points", path.widths_m.len());
        return fail("path.widths_m".to_owned(), problem);
    }
    for (index, width_m) in path.widths_m.iter().flatten().enumerate() {
        within(&format!("path.widths_m[{}]", index / 2), *width_m, 0.0, 1000.0)?;
    }
    let apart_m = libm::hypot(start.x_m - points[0][0], start.y_m - points[0][1]);
    if apart_m > START_TOLERANCE_M {
        let problem =
            format!("lies {apart_m:.3} m from path.points[0], but must be the same point");
        return fail("path.start".to_owned(), problem);
    }
    curvature(points, vehicle)?;
    speeds(path, vehicle, reference_mps)
}

/// Checks that the vehicle can drive the turns at their speeds, and change its speed as they do.
fn speeds(path: &PathConfig, vehicle: &Vehicle, reference_mps: f64) -> Result<(), Problem> {
    /// By how much a turn may be faster than the limit: points are rounded, and the place of a turn's beginning is not exact.
    const TURN_MARGIN: f64 = 1.1;
    /// What the pedals are asked for may be more than they give for a while, since the reference waits; but not this much.
    const ABRUPT: f64 = 2.0;
    let PathConfig { points, speeds_mps, .. } = path;
    let limits = SpeedLimits::of(vehicle);
    let lower = "lower it, or let --speed-profile lower it to what the vehicle can drive";
    for (index, curvature) in curvatures(points) {
        let speed_mps = speeds_mps.get(index).copied().unwrap_or(reference_mps);
        let lateral_mps2 = speed_mps * speed_mps * curvature;
        if lateral_mps2 > TURN_MARGIN * limits.lateral_mps2 {
            let key = if speeds_mps.is_empty() { "points" } else { "speeds_mps" };
            let problem = format!(
                "{} is {speed_mps:.2} m/s in a turn of radius {:.2} m: {lateral_mps2:.1} m/s² sideways, but the vehicle's limit is \
                 {:.1}; {lower}",
                if speeds_mps.is_empty() { "reference.speed_mps" } else { "the speed" },
                1.0 / curvature,
                limits.lateral_mps2
            );
            return Err((format!("path.{key}[{index}]"), problem));
        }
    }
    if speeds_mps.is_empty() {
        return Ok(());
    }
    let step_m = libm::hypot(points[1][0] - points[0][0], points[1][1] - points[0][1]);
    if let Some((index, mps2)) = too_abrupt(speeds_mps, step_m, limits.times(ABRUPT)) {
        let (what, limit) = if mps2 > 0.0 {
            ("rise", limits.acceleration_mps2)
        } else {
            ("fall", limits.deceleration_mps2)
        };
        let problem = format!(
            "the speeds {what} by {:.1} m/s² behind it, but the vehicle's limit is {limit:.1}; {lower}",
            mps2.abs()
        );
        return Err((format!("path.speeds_mps[{index}]"), problem));
    }
    Ok(())
}

/// Checks that a path can be driven in laps. The problem is one of the path's file, whatever asks for laps.
fn check_laps(path: &PathConfig) -> Result<(), Problem> {
    let PathConfig { points, laps, .. } = path;
    let (first, last) = (points[0], points[points.len() - 1]);
    if !path.is_closed() {
        let gap_m = libm::hypot(last[0] - first[0], last[1] - first[1]);
        let problem = format!(
            "end {gap_m:.2} m from their start, so the path cannot be driven for {laps} laps; let it end where it begins, \
             with the same heading, or leave out --laps (path.laps)"
        );
        return Err(("path.points".to_owned(), problem));
    }
    let all = points.len() as u64 * u64::from(*laps);
    if all > MAX_LAP_POINTS {
        let most = MAX_LAP_POINTS / points.len() as u64;
        let problem = format!(
            "is {laps}, but a lap of {} points is driven at most {most} times",
            points.len()
        );
        return Err(("path.laps".to_owned(), problem));
    }
    Ok(())
}

/// Checks that the rear axle can follow the path; an error names the tightest place.
fn curvature(points: &[[f64; 2]], vehicle: &Vehicle) -> Result<(), Problem> {
    let sharpest = libm::tan(vehicle.steering_limit_rad) / vehicle.wheelbase_m;
    let (tightest, curvature) = tightest(points);
    if curvature <= sharpest * CURVATURE_MARGIN {
        return Ok(());
    }
    let problem = format!(
        "lies in a turn of radius {:.2} m, but the vehicle's least is {:.2} m (for its rear axle, from \
         vehicle.wheelbase_m and vehicle.steering_limit_rad); widen the turn, or, if the points were measured with noise, smooth \
         them, as with --smooth 0.2",
        1.0 / curvature,
        1.0 / sharpest
    );
    Err((format!("path.points[{tightest}]"), problem))
}

/// The point in the tightest turn, and the curvature there, 1/m.
pub(crate) fn tightest(points: &[[f64; 2]]) -> (usize, f64) {
    let (mut tightest, mut curvature) = (0, 0.0);
    for (index, here) in curvatures(points) {
        if here > curvature {
            (tightest, curvature) = (index, here);
        }
    }
    (tightest, curvature)
}

/// The absolute curvature at each point that has neighbours, by the turn between the chords to the points
/// two before and two after it: over only one point, the rounding of a file's decimals would look like curves.
pub(crate) fn curvatures(points: &[[f64; 2]]) -> impl Iterator<Item = (usize, f64)> {
    let count = points.len();
    let reach = if count >= 5 { 2 } else { 1 };
    let closed = points[0] == points[count - 1] && count > 2 * reach;
    // The last point of a closed path is its first, so there is one point less.
    let around = if closed { count - 1 } else { count };
    let inner = if closed { 0..around } else { reach..count.saturating_sub(reach).max(reach) };
    inner.map(move |index| {
        let before = points[(index + around - reach) % around];
        let (here, behind) = (points[index], points[(index + reach) % around]);
        let (ax, ay) = (here[0] - before[0], here[1] - before[1]);
        let (bx, by) = (behind[0] - here[0], behind[1] - here[1]);
        let turn_rad = libm::atan2(ax * by - ay * bx, ax * bx + ay * by).abs();
        let chord_m = 0.5 * (libm::hypot(ax, ay) + libm::hypot(bx, by));
        // Exact on a circle: its chord is 2R·sin(half the angle), and the turn is the angle.
        (index, 2.0 * libm::sin(0.5 * turn_rad) / chord_m.max(f64::MIN_POSITIVE))
    })
}

#[cfg(test)]
mod tests {
    use crate::{Layers, RunConfig};

    fn resolve(points: &str, sets: &[&str]) -> Result<RunConfig, crate::ConfigError> {
        let mut layers = Layers::maneuver("lane_change").unwrap();
        layers.set("path.pieces=[]").unwrap();
        layers.set(&format!("path.points={points}")).unwrap();
        for set in sets {
            layers.set(set).unwrap();
        }
        layers.resolve()
    }

    fn circle(radius_m: f64, count: usize, turns: f64) -> String {
        let points: Vec<_> = (0..count)
            .map(|index| {
                let angle = std::f64::consts::TAU * turns * index as f64 / (count - 1) as f64;
                let angle = if turns == 1.0 && index + 1 == count { 0.0 } else { angle };
                [radius_m * libm::sin(angle), radius_m * (1.0 - libm::cos(angle))]
            })
            .collect();
        format!("{points:?}")
    }

    #[test]
    fn mistakes_name_the_point() {
        let check = |points: &str, sets: &[&str], parts: &[&str]| {
            let message = resolve(points, sets).unwrap_err().to_string();
            for part in parts {
                assert!(message.contains(part), "{message:?} lacks {part:?}");
            }
        };
        check("[]", &[], &["path.pieces", "2 points"]);
        check("[]", &["path.speeds_mps=[1.0]"], &["path.pieces", "2 points"]);
        check("[[0,0]]", &[], &["path.points", "1 points", "2 to 100000"]);
        check("[[0,0],[1,0,0]]", &[], &["path.points[1]"]);
        check("[[0,0],['a',0]]", &[], &["path.points[1]", "string"]);
        check("[[0,0],[nan,0]]", &[], &["path.points[1]", "NaN"]);
        check("[[0,0],[0,-inf]]", &[], &["path.points[1]", "-inf"]);
        check("[[0,0],[0,2e6]]", &[], &["path.points[1]", "2000000"]);
        check("[[0,0],[0,0],[1,0]]", &[], &["path.points[1]", "repeats the point"]);
        check("[[0,0],[1,0]]", &["path.speeds_mps=[1.0]"], &["path.speeds_mps", "1 speeds for 2"]);
        check("[[0,0],[1,0]]", &["path.speeds_mps=[0.0,1.0]"], &["path.speeds_mps[0]", "(0, 50]"]);
        check("[[0,0],[1,0]]", &["path.speeds_mps=[1.0,51.0]"], &["path.speeds_mps[1]", "51"]);
        check("[[2,0],[3,0]]", &[], &["path.start", "2.000 m", "path.points[0]"]);
        check(
            "[[0,0],[1,0],[2,0],[3,0],[3,1],[3,2],[3,3]]",
            &[],
            &["path.points[3]", "radius 1.41 m", "4.98 m", "widen"],
        );
        // There and back again: at a single point, and on a closed path.
        check("[[0,0],[1,0],[2,0],[1,0.001],[0,0.001]]", &[], &["path.points[2]", "radius"]);
        check("[[0,0],[1,0],[2,0],[1,0],[0,0]]", &[], &["path.points[", "radius"]);
        check(&circle(4.9, 60, 1.0), &[], &["path.points[", "radius 4.90 m"]);
        check(&circle(4.9, 30, 0.6), &[], &["path.points[", "radius 4.90 m"]);
        let mut layers = Layers::maneuver("lane_change").unwrap();
        layers.set("path.speeds_mps=[1.0]").unwrap();
        let message = layers.resolve().unwrap_err().to_string();
        assert!(message.contains("needs path.points"), "{message}");
    }

    #[test]
    fn what_the_vehicle_can_drive_is_no_mistake() {
        for (radius_m, count, turns) in [(5.0, 60, 1.0), (5.0, 30, 0.6), (50.0, 9, 1.0)] {
            resolve(&circle(radius_m, count, turns), &[]).unwrap();
        }
        resolve("[[0,0],[1,0]]", &["path.speeds_mps=[1.0,2]"]).unwrap();
        resolve("[[0,0],[1,0],[2,0.01]]", &[]).unwrap();
        resolve(&circle(4.9, 30, 0.6), &["vehicle.steering_limit_rad=0.55"]).unwrap();
    }

    #[test]
    fn a_resolved_path_of_points_is_a_layer_that_changes_nothing() {
        let sets = ["path.speeds_mps=[1.0,2.5,0.1]"];
        let config = resolve("[[0,0],[1.1,0.1],[2.3,0.3333333333333333]]", &sets).unwrap();
        let text = toml::to_string(&config).unwrap();
        let mut again = Layers::maneuver("lane_change").unwrap();
        again.add_document("resolved.toml", &text).unwrap();
        assert_eq!(again.resolve().unwrap(), config);
        assert_eq!(RunConfig::from_resolved(&text).unwrap(), config);
    }
}
