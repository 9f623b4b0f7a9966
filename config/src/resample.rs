//! Smooths a path's points, and spaces them evenly along it.
//!
//! A cubic connects each two neighbouring points. Its tangent at a point is that of the parabola through the point and
//! its neighbours over their distances (the three-point formula for uneven steps), which on a circle is the
//! circle's tangent. The lengths of its tangents are those with which it follows the arc of a circle. So coarse points
//! of a circle do not become a polygon with corners. Curves and their time derivatives are pure arithmetic and
//! libm: the same bytes on every host.

/// Distance between points along the path. Over this distance a car turns by at most a twentieth of a radian, so that
/// arcs between the points miss the smooth path by less than a millimetre, and a projection on a few metres of the
/// path still visits only a few dozen of them.
pub(crate) const SPACING_M: f64 = 0.25;

/// Number of parts of a spacing over which the arc's length is summed up: its error is then a millionth.
const PARTS: f64 = 8.0;

/// A resampled path.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Resampled {
    /// Evenly spaced points, with the same ends as the given points.
    pub(crate) points: Vec<[f64; 2]>,
    /// The speed at each point, if there were any.
    pub(crate) speeds_mps: Vec<f64>,
    /// From each point to the road's edges on the left and on the right, if they are known.
    pub(crate) widths_m: Vec<[f64; 2]>,
    /// For each point, the index of the given point at or before it.
    pub(crate) given: Vec<usize>,
    /// Heading of the path at its start, in (-π, π].
    pub(crate) yaw_rad: f64,
    /// Length of the path.
    pub(crate) length_m: f64,
    /// Time to the end at these speeds, beginning at the first one; 0 without speeds.
    pub(crate) time_s: f64,
}

/// The cubic between two points, in Bernstein's form.
#[derive(Debug, Clone, Copy)]
struct Cubic([[f64; 2]; 4]);

impl Cubic {
    /// From `from` to `to` with headings at both.
    fn new(from: [f64; 2], to: [f64; 2], from_rad: f64, to_rad: f64) -> Self {
        let chord_m = libm::hypot(to[0] - from[0], to[1] - from[1]);
        let turn_rad = wrap(to_rad - from_rad);
        let cos = libm::cos(0.25 * turn_rad);
        // A third of 4R·tan(turn/4), the tangent of the cubic that lies on a circle, with R from the chord.
        let handle_m = chord_m / (3.0 * cos * cos);
        let (from_sin, from_cos) = (libm::sin(from_rad), libm::cos(from_rad));
        let (to_sin, to_cos) = (libm::sin(to_rad), libm::cos(to_rad));
        Self([
            from,
            [from[0] + handle_m * from_cos, from[1] + handle_m * from_sin],
            [to[0] - handle_m * to_cos, to[1] - handle_m * to_sin],
            to,
        ])
    }

    /// The point at `t` in [0, 1].
    fn at(&self, t: f64) -> [f64; 2] {
        let s = 1.0 - t;
        let weights = [s * s * s, 3.0 * s * s * t, 3.0 * s * t * t, t * t * t];
        [0, 1].map(|axis| {
            self.0.iter().zip(weights).map(|(point, weight)| weight * point[axis]).sum::<f64>()
        })
    }
}

/// Smooths and resamples the path through `points`, which holds at least 2, no two neighbours the same;
/// `speeds_mps` is empty or has one for each. At most `most` points result.
pub(crate) fn resample(points: &[[f64; 2]], speeds_mps: &[f64], most: usize) -> Resampled {
    let headings = headings(points);
    let cubics: Vec<_> = (1..points.len())
        .map(|index| {
            let before = index - 1;
            Cubic::new(points[before], points[index], headings[before], headings[index])
        })
        .collect();
    // The length up to each part of each cubic, and the part's own bounds.
    let mut parts: Vec<(f64, usize, f64, f64)> = Vec::new();
    let mut given_m = vec![0.0];
    let mut length_m = 0.0;
    for (index, cubic) in cubics.iter().enumerate() {
        let [from, .., to] = cubic.0;
        let chord_m = libm::hypot(to[0] - from[0], to[1] - from[1]);
        let count = (PARTS * chord_m / SPACING_M).ceil().max(4.0);
        let mut last = from;
        for part in 0..count as usize {
            let (low, high) = (part as f64 / count, (part + 1) as f64 / count);
            let next = cubic.at(high);
            parts.push((length_m, index, low, high));
            length_m += libm::hypot(next[0] - last[0], next[1] - last[1]);
            last = next;
        }
        given_m.push(length_m);
    }
    let steps = ((length_m / SPACING_M).round() as usize).clamp(1, most - 1);
    let mut resampled = Resampled {
        points: Vec::with_capacity(steps + 1),
        speeds_mps: Vec::new(),
        widths_m: Vec::new(),
        given: Vec::with_capacity(steps + 1),
        yaw_rad: wrap(headings[0]),
        length_m,
        time_s: 0.0,
    };
    let mut part = 0;
    for step in 0..=steps {
        let along_m = length_m * step as f64 / steps as f64;
        while parts.get(part + 1).is_some_and(|(from_m, ..)| *from_m <= along_m) {
            part += 1;
        }
        let (from_m, index, low, high) = parts[part];
        let to_m = parts.get(part + 1).map_or(length_m, |(from_m, ..)| *from_m);
        let share = ((along_m - from_m) / (to_m - from_m)).clamp(0.0, 1.0);
        let point = match step {
            0 => points[0],
            _ if step == steps => points[points.len() - 1],
            _ => cubics[index].at(low + share * (high - low)),
        };
        resampled.points.push(point);
        resampled.given.push(index);
        if !speeds_mps.is_empty() {
            let share = (along_m - given_m[index]) / (given_m[index + 1] - given_m[index]);
            let (from, to) = (speeds_mps[index], speeds_mps[index + 1]);
            // Rounding must not raise a speed above those of the file, which may be the highest allowed.
            let speed_mps = (from + share * (to - from)).clamp(from.min(to), from.max(to));
            resampled.speeds_mps.push(if step == steps { to } else { speed_mps });
        }
    }
    resampled.count_time();
    resampled
}

impl Resampled {
    /// Sums up the time to the end, after the speeds were changed.
    pub(crate) fn count_time(&mut self) {
        let step_m = self.length_m / (self.points.len() - 1) as f64;
        self.time_s =
            self.speeds_mps.windows(2).map(|pair| 2.0 * step_m / (pair[0] + pair[1])).sum();
    }
}

/// The path's heading at each point.
pub(crate) fn headings(points: &[[f64; 2]]) -> Vec<f64> {
    let last = points.len() - 1;
    let chord = |from: [f64; 2], to: [f64; 2]| (to[0] - from[0], to[1] - from[1]);
    let heading = |(x_m, y_m): (f64, f64)| libm::atan2(y_m, x_m);
    // The parabola's tangent: the direction of each chord is weighted with the length of the other one.
    let inner = |before: [f64; 2], here: [f64; 2], behind: [f64; 2]| {
        let (a, b) = (chord(before, here), chord(here, behind));
        let (a_m, b_m) = (libm::hypot(a.0, a.1), libm::hypot(b.0, b.1));
        let (a_weight, b_weight) = (b_m / a_m, a_m / b_m);
        let tangent = (a.0 * a_weight + b.0 * b_weight, a.1 * a_weight + b.1 * b_weight);
        // The path turns straight back: it has no tangent there, and keeps the direction in which it comes.
        let turns_back = libm::hypot(tangent.0, tangent.1) < 1e-9 * (a_m + b_m);
        heading(if turns_back { a } else { tangent })
    };
    let mut headings = vec![0.0; points.len()];
    for (three, heading) in points.windows(3).zip(&mut headings[1..]) {
        *heading = inner(three[0], three[1], three[2]);
    }
    let (first_chord, last_chord) =
        (heading(chord(points[0], points[1])), heading(chord(points[last - 1], points[last])));
    if last == 1 {
        return vec![first_chord; 2];
    }
    if points[0] == points[last] {
        // The point where a closed path meets itself is a point like any other.
        let seam = inner(points[last - 1], points[0], points[1]);
        (headings[0], headings[last]) = (seam, seam);
    } else {
        // The heading at an end is that of its neighbour mirrored about the chord, as on the arc of a circle.
        headings[0] = first_chord + wrap(first_chord - headings[1]);
        headings[last] = last_chord + wrap(last_chord - headings[last - 1]);
    }
    headings
}

/// The same angle in (-π, π].
fn wrap(angle_rad: f64) -> f64 {
    use std::f64::consts::{PI, TAU};
    let wrapped = angle_rad - TAU * (angle_rad / TAU).round();
    if wrapped <= -PI { wrapped + TAU } else { wrapped }
}
