//! Checks the steps from point to point, and closes a path whose ends are the same up to rounding.

use super::{PathFile, geo, mistake};
use crate::ConfigError;

/// The shortest path that is worth a drive.
const SHORTEST_M: f64 = 1.0;
/// The longest path: a drive's time is limited to an hour.
const LONGEST_M: f64 = 1e5;
/// Points nearer to each other than this are the same: below what any localisation can mean.
const SAME_POINT_M: f64 = 1e-3;
/// So are points nearer than this share of the usual step, up to a length: where the recorded car stood, its localisation did
/// not.
const STANDING_SHARE: f64 = 0.3;
const STANDING_M: f64 = 0.03;
/// A step is a gap if it is this many times the usual step, …
const GAP_FACTOR: f64 = 10.0;
/// … which of so many steps is the one that this share of them is below: where the recorded car stood for long, its localisation
/// drifted in most of them.
const MANY_STEPS: usize = 20;
const USUAL_SHARE: f64 = 0.8;
/// … and longer than this: dense points may be uneven although none is missing.
const GAP_M: f64 = 1.0;
/// Usual steps longer than this are hardly in metres.
const LONG_STEP_M: f64 = 20.0;

/// The path without points that repeat the one before, if its steps are those of a path.
pub(super) fn checked(origin: &str, file: PathFile) -> Result<PathFile, ConfigError> {
    let same_m = (STANDING_SHARE * usual_step_m(&file.points)).clamp(SAME_POINT_M, STANDING_M);
    let mut file = without_repeats(file, same_m);
    let steps: Vec<_> = file.points.windows(2).map(|pair| apart_m(pair[0], pair[1])).collect();
    let lines = &file.lines;
    let length_m: f64 = steps.iter().sum();
    let last = file.points.len() - 1;
    let mut sorted = steps.clone();
    sorted.sort_by(f64::total_cmp);
    let median_m = sorted[(sorted.len() - 1) / 2];
    let usual_m = match steps.len() {
        count if count >= MANY_STEPS => sorted[((count - 1) as f64 * USUAL_SHARE) as usize],
        _ => median_m,
    };
    let is_gap = |step_m: f64| step_m > (GAP_FACTOR * usual_m).max(GAP_M);
    if let Some(index) = steps.iter().position(|step_m| is_gap(*step_m)) {
        return Err(gap(origin, &file, index, usual_m, is_gap));
    }
    if !(SHORTEST_M..=LONGEST_M).contains(&length_m) {
        let way_out = match () {
            () if length_m < SHORTEST_M && geo::looks_like_degrees(&file.points) => {
                "the numbers look like degrees: name the columns lat and lon, or say --crs wgs84 (x being the longitude) or \
                 --columns lat=1,lon=2"
            }
            () if length_m > LONGEST_M => {
                "x_m and y_m are in metres; for millimetres or centimetres say --columns x_mm=1,y_mm=2 or x_cm=1,y_cm=2"
            }
            () => "x_m and y_m are in metres",
        };
        let problem = format!(
            "ends a path of {length_m:.2} m, but a path must be {SHORTEST_M} m to {} km long; {way_out}",
            LONGEST_M / 1000.0
        );
        return Err(mistake(origin, lines[last], problem));
    }
    if median_m > LONG_STEP_M && last >= 10 {
        file.notes.push(format!(
            "its points are {median_m:.0} m apart; if the numbers are millimetres or centimetres, say --columns x_mm=1,y_mm=2"
        ));
    }
    let gap_m = apart_m(file.points[0], file.points[last]);
    if gap_m <= SAME_POINT_M && last >= 3 {
        file.points[last] = file.points[0];
    } else if gap_m <= same_m && last >= 3 && is_lap(&file.points) {
        // Another point so near would be a kink, or a step back.
        file.points[last] = file.points[0];
        file.notes
            .push(format!("its end lies {:.0} mm from its start: closed there", 1000.0 * gap_m));
    } else if is_steps_open(&file.points, gap_m, median_m, UNEVEN) {
        // Racelines leave out the last point, because it is the first one.
        file.points.push(file.points[0]);
        file.lines.push(file.lines[last]);
        if let Some(&speed_mps) = file.speeds_mps.first() {
            file.speeds_mps.push(speed_mps);
        }
        if let Some(&width_m) = file.widths_m.first() {
            file.widths_m.push(width_m);
        }
        file.notes.push(format!("its end is one step ({gap_m:.2} m) from its start: closed"));
    } else if is_steps_open(&file.points, gap_m, median_m, NEARLY) {
        file.notes.push(format!(
            "its end is {gap_m:.2} m from its start, and it is not closed; for laps, let it end at its first point"
        ));
    } else if let Some(index) = full_lap(&file.points, median_m) {
        file.notes.push(format!(
            "it comes by its start again at line {}, and goes on; for laps, leave out the lines behind that one",
            file.lines[index]
        ));
    }
    Ok(file)
}

/// The mistake of a long step: a point that does not belong to the path, or points that are missing.
fn gap(
    origin: &str,
    file: &PathFile,
    index: usize,
    usual_m: f64,
    is_gap: impl Fn(f64) -> bool,
) -> ConfigError {
    let (points, lines) = (&file.points, &file.lines);
    let step_m = apart_m(points[index], points[index + 1]);
    let behind = points.get(index + 2);
    // A point apart from both neighbours, which lie near each other; or one at an end.
    let alone = match behind {
        None => Some(index + 1),
        Some(next) if !is_gap(apart_m(points[index], *next)) => Some(index + 1),
        Some(_) if index == 0 => Some(0),
        Some(_) => None,
    };
    if let Some(alone) = alone {
        let problem = format!(
            "lies {step_m:.2} m from the point {} it, but the usual step is {usual_m:.2} m; leave it out if it does not belong \
             to the path, or else fill the gap with points",
            if alone == 0 { "behind" } else { "before" },
        );
        return mistake(origin, lines[alone], problem);
    }
    let problem = format!(
        "lies {step_m:.2} m after the point of line {}, but the usual step is {usual_m:.2} m; fill the gap with points, or leave \
         out those that do not belong to the path",
        lines[index]
    );
    mistake(origin, lines[index + 1], problem)
}

/// Where a line that goes on beyond its start is nearest to it, after more than half of its way, driving in the same
/// direction.
fn full_lap(points: &[[f64; 2]], median_m: f64) -> Option<usize> {
    let step = |at: usize| {
        let (from, to) = (points[at], points[(at + 1).min(points.len() - 1)]);
        [to[0] - from[0], to[1] - from[1]]
    };
    let [ax, ay] = step(0);
    let near = (points.len() / 2..points.len() - 1).filter(|at| {
        let [bx, by] = step(*at);
        apart_m(points[*at], points[0]) <= median_m && ax * bx + ay * by > 0.0
    });
    near.min_by(|a, b| apart_m(points[*a], points[0]).total_cmp(&apart_m(points[*b], points[0])))
}

fn apart_m(a: [f64; 2], b: [f64; 2]) -> f64 {
    libm::hypot(b[0] - a[0], b[1] - a[1])
}

/// The step with which half of the way is made: where a car stood for long, most steps are none.
fn usual_step_m(points: &[[f64; 2]]) -> f64 {
    let mut steps: Vec<f64> = points.windows(2).map(|pair| apart_m(pair[0], pair[1])).collect();
    steps.sort_by(f64::total_cmp);
    let half_m = 0.5 * steps.iter().sum::<f64>();
    let mut way_m = 0.0;
    let usual = steps.into_iter().find(|step_m| {
        way_m += step_m;
        way_m >= half_m
    });
    usual.unwrap_or(0.0)
}

/// Leaves out points at which the recorded car stood still, at the start, midway or at the end.
fn without_repeats(file: PathFile, same_m: f64) -> PathFile {
    let mut kept: Vec<usize> = vec![0];
    let mut is_repeated = true;
    for index in 1..file.points.len() {
        let step_m = apart_m(file.points[kept[kept.len() - 1]], file.points[index]);
        if step_m > same_m {
            kept.push(index);
        } else {
            is_repeated &= step_m == 0.0;
        }
    }
    let dropped = file.points.len() - kept.len();
    // At a single place there is nothing to leave out that would help.
    if dropped == 0 || kept.len() < 2 {
        return file;
    }
    let PathFile { points, speeds_mps, widths_m, lines, crs, origin, mut notes } = file;
    let (points_do, are) = if dropped == 1 { ("point lies", "is") } else { ("points lie", "are") };
    notes.push(match is_repeated {
        true if dropped == 1 => "1 point repeats the point before, and is left out".to_owned(),
        true => format!("{dropped} points repeat the point before, and are left out"),
        false => {
            let same_mm = 1000.0 * same_m;
            format!("{dropped} {points_do} within {same_mm:.0} mm of the point before, and {are} left out")
        }
    });
    PathFile {
        points: kept.iter().map(|index| points[*index]).collect(),
        speeds_mps: if speeds_mps.is_empty() { speeds_mps } else { speeds_of(&kept, &speeds_mps) },
        widths_m: if widths_m.is_empty() {
            widths_m
        } else {
            kept.iter().map(|index| widths_m[*index]).collect()
        },
        lines: kept.iter().map(|index| lines[*index]).collect(),
        crs,
        origin,
        notes,
    }
}

/// The speeds of the points that are kept: where several are one, the one at which the car came, or at the start left.
fn speeds_of(kept: &[usize], speeds_mps: &[f64]) -> Vec<f64> {
    let ends = kept.iter().skip(1).copied().chain([speeds_mps.len()]);
    kept.iter()
        .zip(ends)
        .enumerate()
        .map(|(place, (&from, to))| {
            let all = &speeds_mps[from..to];
            match place {
                0 => all[all.len() - 1],
                // Where the recorded car stood at the end, it is to stand.
                _ if to == speeds_mps.len() => all[all.len() - 1],
                _ => all.iter().copied().fold(f64::INFINITY, f64::min),
            }
        })
        .collect()
}

/// Whether a path with its ends at one place goes on there in the direction in which it came.
fn is_lap(points: &[[f64; 2]]) -> bool {
    let count = points.len();
    let ([ax, ay], [bx, by]) = (points[0], points[1]);
    let ([cx, cy], [dx, dy]) = (points[count - 2], points[count - 1]);
    (bx - ax) * (dx - cx) + (by - ay) * (dy - cy) > 0.0
}

/// By how much the missing step of a lap may be longer than those around it; and with how many such steps missing it still
/// looks like a lap.
const UNEVEN: f64 = 1.5;
const NEARLY: f64 = 6.0;

/// Whether a lap lacks no more than so many steps: the end lies no farther from the start than they are long, and the step
/// from there to the start leads on in the direction of its neighbours.
fn is_steps_open(points: &[[f64; 2]], gap_m: f64, median_m: f64, steps: f64) -> bool {
    let count = points.len();
    let step = |from: [f64; 2], to: [f64; 2]| (to[0] - from[0], to[1] - from[1]);
    let missing = step(points[count - 1], points[0]);
    let (before, behind) = (step(points[count - 2], points[count - 1]), step(points[0], points[1]));
    let leads_on = |(x_m, y_m): (f64, f64)| x_m * missing.0 + y_m * missing.1 > 0.0;
    let length_m = |(x_m, y_m): (f64, f64)| libm::hypot(x_m, y_m);
    let usual_m = median_m.max(length_m(before)).max(length_m(behind));
    count > 3 && gap_m <= steps * usual_m && leads_on(before) && leads_on(behind)
}
