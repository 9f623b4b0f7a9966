//! Paths as chains of straight and circular segments, each with its closed form.

use std::sync::Arc;

use config::{PathConfig, Piece};
use nalgebra::Vector2;

use crate::{Pose, wrap_angle};

/// A point of a path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PathPoint {
    /// Distance along the path.
    pub along_m: f64,
    /// Distance of the projected position from this point; positive to the left of the path.
    pub offset_m: f64,
    /// Pose of the path here.
    pub pose: Pose,
}

/// A path, addressed by the distance along it.
#[derive(Debug, Clone, PartialEq)]
pub struct Path {
    /// Shared by all copies: a fleet drives the same path. Those of all laps, one after the other.
    segments: Arc<[Segment]>,
    laps: usize,
    /// It ends where it begins, and what follows its end is its beginning.
    is_closed: bool,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Segment {
    from_m: f64,
    length_m: f64,
    start: Pose,
    /// sin and cos of the yaw at the start.
    sin: f64,
    cos: f64,
    /// 1/m, positive to the left; 0 on a straight.
    curvature: f64,
    /// Where it ends.
    end: (f64, f64),
    /// The centre of an arc's circle, and the direction from there to its start.
    centre: (f64, f64),
    from_centre_rad: f64,
}

impl Segment {
    fn new(from_m: f64, length_m: f64, start: Pose, curvature: f64) -> Self {
        let (sin, cos) = (libm::sin(start.yaw_rad), libm::cos(start.yaw_rad));
        let mut segment = Self {
            from_m,
            length_m,
            start,
            sin,
            cos,
            curvature,
            end: (0.0, 0.0),
            centre: (0.0, 0.0),
            from_centre_rad: 0.0,
        };
        let end = segment.at(length_m);
        segment.end = (end.x_m, end.y_m);
        if curvature != 0.0 {
            segment.centre = (start.x_m - sin / curvature, start.y_m + cos / curvature);
            segment.from_centre_rad = libm::atan2(-cos / curvature, sin / curvature);
        }
        segment
    }

    /// Square of the distance from (x, y) to the nearest point of the segment. Computes no angle, because this is
    /// called in every tick of every drive.
    #[inline]
    fn apart_squared(&self, x_m: f64, y_m: f64) -> f64 {
        let (dx, dy) = (x_m - self.start.x_m, y_m - self.start.y_m);
        if self.curvature == 0.0 {
            let ahead_m = dx * self.cos + dy * self.sin;
            let beyond_m = ahead_m - ahead_m.clamp(0.0, self.length_m);
            let aside_m = dy * self.cos - dx * self.sin;
            return beyond_m * beyond_m + aside_m * aside_m;
        }
        // From the centre: to the position, to the start, to the end.
        let (px, py) = (x_m - self.centre.0, y_m - self.centre.1);
        let (sx, sy) = (self.start.x_m - self.centre.0, self.start.y_m - self.centre.1);
        let (ex, ey) = (self.end.0 - self.centre.0, self.end.1 - self.centre.1);
        let side = self.curvature.signum();
        let (behind_start, before_end) = (side * (sx * py - sy * px), side * (px * ey - py * ex));
        let turn_rad = self.length_m * self.curvature.abs();
        let is_beside = if turn_rad <= std::f64::consts::PI {
            behind_start >= 0.0 && before_end >= 0.0
        } else {
            behind_start >= 0.0 || before_end >= 0.0
        };
        if is_beside {
            let off_m = (px * px + py * py).sqrt() - 1.0 / self.curvature.abs();
            return off_m * off_m;
        }
        let (ux, uy) = (x_m - self.end.0, y_m - self.end.1);
        (dx * dx + dy * dy).min(ux * ux + uy * uy)
    }

    /// The pose `ahead_m` after the segment's start, also beyond its end.
    fn at(&self, ahead_m: f64) -> Pose {
        self.at_with_direction(ahead_m).0
    }

    /// The same, with the sine and the cosine of its yaw.
    #[inline]
    fn at_with_direction(&self, ahead_m: f64) -> (Pose, (f64, f64)) {
        let Segment { start, sin, cos, curvature, .. } = *self;
        if curvature == 0.0 {
            let (x_m, y_m) = (start.x_m + ahead_m * cos, start.y_m + ahead_m * sin);
            return (Pose { x_m, y_m, yaw_rad: start.yaw_rad }, (sin, cos));
        }
        let yaw_rad = start.yaw_rad + curvature * ahead_m;
        let (sin_there, cos_there) = libm::sincos(yaw_rad);
        let x_m = start.x_m + (sin_there - sin) / curvature;
        let y_m = start.y_m - (cos_there - cos) / curvature;
        (Pose { x_m, y_m, yaw_rad }, (sin_there, cos_there))
    }

    /// Whether no point of the segment can be as near to (x, y) as `apart_m`: no point of it is farther from its start than
    /// the segment is long. Cheap, and never true by rounding alone.
    #[inline]
    fn is_beyond(&self, x_m: f64, y_m: f64, apart_m: f64) -> bool {
        const ROUNDING_M: f64 = 1e-6;
        let (dx, dy) = (x_m - self.start.x_m, y_m - self.start.y_m);
        let reach_m = apart_m + self.length_m + ROUNDING_M;
        dx * dx + dy * dy > reach_m * reach_m
    }

    /// Distance along the segment of the point nearest to (x, y), within its ends.
    fn nearest(&self, x_m: f64, y_m: f64) -> f64 {
        let Segment { start, sin, cos, curvature, length_m, .. } = *self;
        let (dx, dy) = (x_m - start.x_m, y_m - start.y_m);
        if curvature == 0.0 {
            return (dx * cos + dy * sin).clamp(0.0, length_m);
        }
        // Angle swept around the centre, which lies 1/curvature to the left of the start.
        let (cx, cy) = (dx + sin / curvature, dy - cos / curvature);
        let swept = wrap_angle(libm::atan2(cy, cx) - self.from_centre_rad);
        let turn = std::f64::consts::TAU / curvature.abs();
        let mut ahead_m = swept / curvature;
        // Long arcs pass an angle more than once; short ones may be missed on either side.
        if ahead_m < 0.0 && ahead_m + turn <= length_m {
            ahead_m += turn;
        }
        if ahead_m < 0.0 {
            // Outside: the nearer end, seen around the circle.
            return if -ahead_m < ahead_m + turn - length_m { 0.0 } else { length_m };
        }
        if ahead_m > length_m {
            return if turn - ahead_m < ahead_m - length_m { 0.0 } else { length_m };
        }
        ahead_m
    }
}

impl Path {
    /// The path of a configuration. A path that is driven several times is as long as all of its laps: so a place along
    /// it says which lap it is in.
    ///
    /// # Panics
    /// If the configuration holds neither a piece nor two points; a resolved one does.
    pub fn new(config: &PathConfig) -> Self {
        if config.points.is_empty() {
            return Self::from_pieces(config);
        }
        let laps = config.laps.max(1) as usize;
        // The last point of a lap is the first one of the next.
        let more = config.points[1..].iter().cycle().take((config.points.len() - 1) * (laps - 1));
        let points: Vec<_> = config.points.iter().chain(more).copied().collect();
        Self { segments: arcs_through(&points).into(), laps, is_closed: config.is_closed() }
    }

    fn from_pieces(config: &PathConfig) -> Self {
        let mut segments = Vec::with_capacity(config.pieces.len());
        let mut at = Pose::from(config.start);
        let mut from_m = 0.0;
        for piece in config.pieces.iter().flat_map(parts_of) {
            let (length_m, curvature, turn_rad) = match piece {
                Piece::Cosine { length_m, offset_m } => {
                    segments.extend(cosine(from_m, at, length_m, offset_m));
                    let last = segments[segments.len() - 1];
                    from_m = last.from_m + last.length_m;
                    at = Pose { x_m: last.end.0, y_m: last.end.1, ..at };
                    continue;
                }
                Piece::Straight { length_m } => (length_m, 0.0, 0.0),
                Piece::Diagonal { length_m, offset_m } => {
                    (libm::hypot(length_m, offset_m), 0.0, libm::atan2(offset_m, length_m))
                }
                Piece::Arc { radius_m, angle_deg } => {
                    let angle_rad: f64 = angle_deg.to_radians();
                    (radius_m * angle_rad.abs(), angle_rad.signum() / radius_m, 0.0)
                }
            };
            let heading_rad = at.yaw_rad;
            let start = Pose { yaw_rad: heading_rad + turn_rad, ..at };
            let segment = Segment::new(from_m, length_m, start, curvature);
            at = segment.at(length_m);
            if turn_rad != 0.0 {
                at.yaw_rad = heading_rad;
            }
            from_m += length_m;
            segments.push(segment);
        }
        assert!(!segments.is_empty(), "a resolved path has a piece");
        Self { segments: segments.into(), laps: 1, is_closed: false }
    }

    /// How many laps it has; 1 unless a closed path is driven several times.
    pub fn laps(&self) -> usize {
        self.laps
    }

    /// Where a lap begins, along the path; the first one is lap 0.
    pub fn lap_from_m(&self, lap: usize) -> f64 {
        self.segments[lap * (self.segments.len() / self.laps)].from_m
    }

    /// Length of the path.
    pub fn length_m(&self) -> f64 {
        let last = self.segments[self.segments.len() - 1];
        last.from_m + last.length_m
    }

    /// Where the segments of the path meet, as distances along it, from its start to its end: of a path
    /// through points, one for each point.
    pub fn joints_m(&self) -> impl Iterator<Item = f64> {
        let ends = self.segments.iter().map(|segment| segment.from_m + segment.length_m);
        std::iter::once(0.0).chain(ends)
    }

    /// Curvature at a distance along the path, 1/m, positive to the left; at a joint that of the later segment.
    pub fn curvature(&self, along_m: f64) -> f64 {
        let after = self.segments.partition_point(|segment| segment.from_m <= along_m);
        self.segments[after.saturating_sub(1)].curvature
    }

    /// The pose at a distance along the path, held at its ends. At a joint the later segment counts.
    pub fn at(&self, along_m: f64) -> Pose {
        let after = self.segments.partition_point(|segment| segment.from_m <= along_m);
        let segment = &self.segments[after.saturating_sub(1)];
        segment.at((along_m - segment.from_m).clamp(0.0, segment.length_m))
    }

    /// As [`Path::at`], but beyond the end of a closed path lies its beginning.
    pub fn at_or_round(&self, along_m: f64) -> Pose {
        let beyond_m = along_m - self.length_m();
        self.at(if self.is_closed && beyond_m > 0.0 { beyond_m } else { along_m })
    }

    /// Whether it is a closed path through points, in laps or once round.
    pub fn is_closed(&self) -> bool {
        self.is_closed
    }

    /// Pose of the path's end.
    pub fn end(&self) -> Pose {
        self.at(self.length_m())
    }

    /// The point of the path nearest to a position, among those at most `window_m` away from `near_m`
    /// along the path: where a path meets itself, the vehicle's earlier place decides.
    pub fn project(&self, x_m: f64, y_m: f64, near_m: f64, window_m: f64) -> PathPoint {
        self.nearest(x_m, y_m, near_m, window_m, |_| true).unwrap_or_else(|| {
            let along_m = near_m.clamp(0.0, self.length_m());
            PathPoint { along_m, offset_m: 0.0, pose: self.at(along_m) }
        })
    }

    /// As [`Path::project`], on the legs of the path alone that a vehicle with this heading drives along: the headings
    /// are less than 90° apart. `None` if there is no such leg in the window.
    pub fn project_along(&self, pose: Pose, near_m: f64, window_m: f64) -> Option<PathPoint> {
        let fits = |at: Pose| libm::cos(at.yaw_rad - pose.yaw_rad) > 0.0;
        self.nearest(pose.x_m, pose.y_m, near_m, window_m, fits)
    }

    /// The nearest of the points within the window that the segments have to offer, one each, and that count.
    #[inline]
    fn nearest(
        &self,
        x_m: f64,
        y_m: f64,
        near_m: f64,
        window_m: f64,
        counts: impl Fn(Pose) -> bool,
    ) -> Option<PathPoint> {
        let (low, high) = (near_m - window_m, near_m + window_m);
        let offer = |segment: &Segment| {
            let (from, to) = (segment.from_m, segment.from_m + segment.length_m);
            let along_m = (from + segment.nearest(x_m, y_m)).clamp(low.max(from), high.min(to));
            let (pose, (sin, cos)) = segment.at_with_direction(along_m - from);
            let (dx, dy) = (x_m - pose.x_m, y_m - pose.y_m);
            let offset_m = dy * cos - dx * sin;
            let point = PathPoint { along_m, offset_m, pose };
            counts(pose).then_some((dx * dx + dy * dy, point))
        };
        // A path through points has thousands of segments, and the window a few dozen.
        let first =
            self.segments.partition_point(|segment| segment.from_m + segment.length_m < low);
        let end = self.segments.partition_point(|segment| segment.from_m <= high).max(first);
        let window = &self.segments[first..end];
        // The one at the middle is mostly the nearest. What it offers keeps most others from being looked at closely.
        let middle = window.partition_point(|segment| segment.from_m + segment.length_m < near_m);
        let of_middle = window.get(middle).and_then(offer);
        let mut least_m = of_middle.map_or(f64::INFINITY, |(apart, _)| apart.sqrt());
        let mut best: Option<(f64, PathPoint)> = None;
        for (index, segment) in window.iter().enumerate() {
            if segment.is_beyond(x_m, y_m, least_m) {
                continue;
            }
            let offered = if index == middle { of_middle } else { offer(segment) };
            if let Some((apart, point)) = offered
                && best.is_none_or(|(least, _)| apart < least)
            {
                best = Some((apart, point));
                least_m = least_m.min(apart.sqrt());
            }
        }
        best.map(|(_, point)| point)
    }
}

/// Follows a position along a path: where it is nearest, from tick to tick.
///
/// The search for the nearest point starts from the last one: where a path meets itself, the vehicle's earlier
/// place decides.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct PathFollower {
    /// The segment of the nearest point.
    segment: usize,
}

impl PathFollower {
    /// How far beyond the ends of its segment the nearest point is looked for: many ticks of any speed.
    const WINDOW_M: f64 = 1.0;

    /// Near a place along the path.
    pub fn new(path: &Path, along_m: f64) -> Self {
        let after = path.segments.partition_point(|segment| segment.from_m <= along_m);
        Self { segment: after.saturating_sub(1) }
    }

    /// Moves on to a position; returns its distance from the path.
    #[inline]
    pub fn distance_m(&mut self, path: &Path, x_m: f64, y_m: f64) -> f64 {
        let segments = &*path.segments;
        let mut best = segments[self.segment].apart_squared(x_m, y_m);
        loop {
            let from = self.segment;
            let apart_m = best.sqrt();
            let here = &segments[from];
            let (low_m, high_m) =
                (here.from_m - Self::WINDOW_M, here.from_m + here.length_m + Self::WINDOW_M);
            // A position this near to a joint may be nearest to a point beyond it.
            let is_near = |(joint_x_m, joint_y_m): (f64, f64), apart_m: f64| {
                let (dx, dy) = (x_m - joint_x_m, y_m - joint_y_m);
                let reach_m = apart_m + Self::WINDOW_M;
                dx * dx + dy * dy <= reach_m * reach_m
            };
            for (index, next) in segments.iter().enumerate().skip(from + 1) {
                let joint = (next.start.x_m, next.start.y_m);
                if next.from_m > high_m || !is_near(joint, apart_m) {
                    break;
                }
                let apart = next.apart_squared(x_m, y_m);
                // The far end of a long arc may come back to the joint.
                if apart < best && is_near(joint, apart.sqrt()) {
                    (best, self.segment) = (apart, index);
                }
            }
            for (index, last) in segments[..from].iter().enumerate().rev() {
                if last.from_m + last.length_m < low_m || !is_near(last.end, apart_m) {
                    break;
                }
                let apart = last.apart_squared(x_m, y_m);
                if apart < best && is_near(last.end, apart.sqrt()) {
                    (best, self.segment) = (apart, index);
                }
            }
            if self.segment == from {
                return apart_m;
            }
        }
    }

    /// The lap in which the nearest point lies; the first one is lap 0.
    pub fn lap(&self, path: &Path) -> usize {
        self.segment / (path.segments.len() / path.laps)
    }

    /// Distance along the path of the point nearest to a position, in the present segment.
    pub fn along_m(&self, path: &Path, x_m: f64, y_m: f64) -> f64 {
        let segment = &path.segments[self.segment];
        segment.from_m + segment.nearest(x_m, y_m)
    }
}

/// A piece, or the parts of an arc that makes a full turn: on a full turn a position does not determine the place along
/// it.
fn parts_of(piece: &Piece) -> Vec<Piece> {
    /// The longest arc that stays in one part, and the largest part of a longer one.
    const WHOLE_DEG: f64 = 355.0;
    const PART_DEG: f64 = 180.0;
    match *piece {
        Piece::Arc { radius_m, angle_deg } if angle_deg.abs() > WHOLE_DEG => {
            let parts = (angle_deg.abs() / PART_DEG).ceil();
            let part = Piece::Arc { radius_m, angle_deg: angle_deg / parts };
            vec![part; parts as usize]
        }
        whole => vec![whole],
    }
}

/// An arc from each point to the next one, as many as there are gaps between them.
///
/// Each turns by as much as the path does around it: half of the angle between the previous chord and its own, and
/// half of the angle between its own and the next chord. So an arc ends at the next point exactly, and the headings
/// of two arcs that meet differ only by how unevenly the path bends.
fn arcs_through(points: &[[f64; 2]]) -> Vec<Segment> {
    /// An arc turns by no more than this; at a sharp corner it would otherwise turn back on itself.
    const MOST_TURN_RAD: f64 = std::f64::consts::FRAC_PI_2;
    let chords: Vec<_> = points.windows(2).map(|pair| chord(pair[0], pair[1])).collect();
    let count = chords.len();
    assert!(count > 0, "a resolved path has two points");
    // The curvature at each point: the turn between its chords, over the mean of their lengths.
    let bend = |before: usize, behind: usize| {
        let turn_rad = wrap_angle(chords[behind].1 - chords[before].1);
        2.0 * turn_rad / (chords[before].0 + chords[behind].0)
    };
    // A closed circle bends at the seam as everywhere; an open end bends like its neighbour, a single chord not at all.
    let seam = (points[0] == points[count]).then(|| bend(count - 1, 0));
    let inner: Vec<_> = (1..count).map(|index| bend(index - 1, index)).collect();
    let end = |beside: Option<&f64>| seam.or(beside.copied()).unwrap_or(0.0);
    let (first, last) = (end(inner.first()), end(inner.last()));
    let bends: Vec<_> = std::iter::once(first).chain(inner).chain([last]).collect();

    let mut segments = Vec::with_capacity(count);
    let (mut from_m, mut heading_rad) = (0.0, chords[0].1);
    for (index, &(chord_m, chord_rad)) in chords.iter().enumerate() {
        // Unwrapped: from one chord to the next, not from -π to π.
        heading_rad += wrap_angle(chord_rad - heading_rad);
        let turn_rad = (0.5 * chord_m * (bends[index] + bends[index + 1]))
            .clamp(-MOST_TURN_RAD, MOST_TURN_RAD);
        let segment = arc_over(from_m, points[index], (chord_m, heading_rad), turn_rad);
        from_m += segment.length_m;
        segments.push(segment);
    }
    segments
}

/// Length and heading of the straight line between two points.
fn chord(from: [f64; 2], to: [f64; 2]) -> (f64, f64) {
    let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
    (libm::hypot(dx, dy), libm::atan2(dy, dx))
}

/// The arc from a point over a chord (its length and heading) that turns by so much.
fn arc_over(from_m: f64, [x_m, y_m]: [f64; 2], chord: (f64, f64), turn_rad: f64) -> Segment {
    /// An arc that turns by less is a straight: it leaves the chord by less than a millionth of its length, and
    /// the centre of its circle would lie too far away for the arithmetic.
    const LEAST_TURN_RAD: f64 = 1e-6;

    let (chord_m, chord_rad) = chord;
    let (turn_rad, length_m, curvature) = if turn_rad.abs() < LEAST_TURN_RAD {
        (0.0, chord_m, 0.0)
    } else {
        let curvature = 2.0 * libm::sin(0.5 * turn_rad) / chord_m;
        (turn_rad, turn_rad / curvature, curvature)
    };
    let start = Pose { x_m, y_m, yaw_rad: chord_rad - 0.5 * turn_rad };
    Segment::new(from_m, length_m, start, curvature)
}

/// Half a wave of a cosine from a pose to the lane `offset_m` to the left: short arcs between points of the curve, each
/// of which turns by as much as the curve does.
fn cosine(from_m: f64, start: Pose, length_m: f64, offset_m: f64) -> Vec<Segment> {
    use std::f64::consts::PI;
    /// Short enough that the arcs of a lane change are the curve but for micrometres.
    const ARC_M: f64 = 0.25;
    const MOST_ARCS: f64 = 1000.0;

    let arcs = (length_m / ARC_M).clamp(32.0, MOST_ARCS).ceil() as u32;
    // Point and heading after a share of the curve's length.
    let at = |index: u32| {
        let phase_rad = PI * f64::from(index) / f64::from(arcs);
        let ahead_m = length_m * f64::from(index) / f64::from(arcs);
        let left_m = 0.5 * offset_m * (1.0 - libm::cos(phase_rad));
        let slope = 0.5 * PI * offset_m / length_m * libm::sin(phase_rad);
        let point = start.position() + start.rotation() * Vector2::new(ahead_m, left_m);
        ([point.x, point.y], libm::atan(slope))
    };
    let mut from_m = from_m;
    let mut heading_rad = start.yaw_rad;
    let mut segments = Vec::with_capacity(arcs as usize);
    for index in 0..arcs {
        let ((here, before_rad), (there, behind_rad)) = (at(index), at(index + 1));
        let (chord_m, chord_rad) = chord(here, there);
        // Unwrapped, as the start's heading is.
        heading_rad += wrap_angle(chord_rad - heading_rad);
        let segment = arc_over(from_m, here, (chord_m, heading_rad), behind_rad - before_rad);
        from_m += segment.length_m;
        segments.push(segment);
    }
    segments
}

#[cfg(test)]
mod tests;
