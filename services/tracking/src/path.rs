//! Paths as chains of straight and circular segments, each with its closed form.

use config::{PathConfig, Piece};

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
    segments: Vec<Segment>,
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
}

impl Segment {
    fn new(from_m: f64, length_m: f64, start: Pose, curvature: f64) -> Self {
        let (sin, cos) = (libm::sin(start.yaw_rad), libm::cos(start.yaw_rad));
        Self { from_m, length_m, start, sin, cos, curvature }
    }

    /// The pose `ahead_m` behind the segment's start, also beyond its end.
    fn at(&self, ahead_m: f64) -> Pose {
        let Segment { start, sin, cos, curvature, .. } = *self;
        if curvature == 0.0 {
            return Pose {
                x_m: start.x_m + ahead_m * cos,
                y_m: start.y_m + ahead_m * sin,
                yaw_rad: start.yaw_rad,
            };
        }
        let yaw_rad = start.yaw_rad + curvature * ahead_m;
        Pose {
            x_m: start.x_m + (libm::sin(yaw_rad) - sin) / curvature,
            y_m: start.y_m - (libm::cos(yaw_rad) - cos) / curvature,
            yaw_rad,
        }
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
        let swept =
            wrap_angle(libm::atan2(cy, cx) - libm::atan2(-cos / curvature, sin / curvature));
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
    /// The path of a configuration.
    ///
    /// # Panics
    /// If the configuration holds no piece; a resolved one does.
    pub fn new(config: &PathConfig) -> Self {
        let mut segments = Vec::with_capacity(config.pieces.len());
        let mut at = Pose::from(config.start);
        let mut from_m = 0.0;
        for piece in &config.pieces {
            let (length_m, curvature, turn_rad) = match *piece {
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
        Self { segments }
    }

    /// Length of the path.
    pub fn length_m(&self) -> f64 {
        let last = self.segments[self.segments.len() - 1];
        last.from_m + last.length_m
    }

    /// The pose at a distance along the path, held at its ends. At a joint the later segment counts.
    pub fn at(&self, along_m: f64) -> Pose {
        let after = self.segments.partition_point(|segment| segment.from_m <= along_m);
        let segment = &self.segments[after.saturating_sub(1)];
        segment.at((along_m - segment.from_m).clamp(0.0, segment.length_m))
    }

    /// Pose of the path's end.
    pub fn end(&self) -> Pose {
        self.at(self.length_m())
    }

    /// The point of the path nearest to a position, among those at most `window_m` away from `near_m`
    /// along the path: a path that meets itself is told apart by where the vehicle was.
    pub fn project(&self, x_m: f64, y_m: f64, near_m: f64, window_m: f64) -> PathPoint {
        let (low, high) = (near_m - window_m, near_m + window_m);
        let mut best: Option<(f64, PathPoint)> = None;
        for segment in &self.segments {
            let (from, to) = (segment.from_m, segment.from_m + segment.length_m);
            if to < low || from > high {
                continue;
            }
            let along_m = (from + segment.nearest(x_m, y_m)).clamp(low.max(from), high.min(to));
            let pose = segment.at(along_m - from);
            let (dx, dy) = (x_m - pose.x_m, y_m - pose.y_m);
            let apart = dx * dx + dy * dy;
            if best.is_none_or(|(least, _)| apart < least) {
                let offset_m = dy * libm::cos(pose.yaw_rad) - dx * libm::sin(pose.yaw_rad);
                best = Some((apart, PathPoint { along_m, offset_m, pose }));
            }
        }
        best.map(|(_, point)| point).unwrap_or_else(|| {
            let along_m = near_m.clamp(0.0, self.length_m());
            PathPoint { along_m, offset_m: 0.0, pose: self.at(along_m) }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::Layers;
    use proptest::prelude::*;

    fn path(pieces: &str) -> Path {
        let mut layers = Layers::maneuver("lane_change").unwrap();
        layers.set(&format!("path.pieces={pieces}")).unwrap();
        Path::new(&layers.resolve().unwrap().path)
    }

    const MIXED: &str = "[{kind='straight',length_m=4.0},{kind='arc',radius_m=18.0,angle_deg=200.0},\
        {kind='diagonal',length_m=6.0,offset_m=3.5},{kind='arc',radius_m=7.0,angle_deg=-90.0}]";

    #[test]
    fn a_diagonal_keeps_the_heading_behind_it() {
        let path = path(
            "[{kind='straight',length_m=1.0},{kind='diagonal',length_m=5.5,offset_m=-3.5},\
             {kind='straight',length_m=2.0}]",
        );
        let end = path.end();
        assert!((end.x_m - 8.5).abs() < 1e-12 && (end.y_m + 3.5).abs() < 1e-12);
        assert_eq!(end.yaw_rad, 0.0);
        assert!(path.at(2.0).yaw_rad < -0.5);
    }

    #[test]
    fn an_arc_ends_where_geometry_says() {
        let end = path("[{kind='arc',radius_m=7.0,angle_deg=90.0}]").end();
        assert!((end.x_m - 7.0).abs() < 1e-12 && (end.y_m - 7.0).abs() < 1e-12);
    }

    proptest! {
        #[test]
        fn the_path_has_no_gaps(along in 0.0..80.0f64) {
            let path = path(MIXED);
            let (a, b) = (path.at(along), path.at(along + 1e-6));
            prop_assert!(libm::hypot(a.x_m - b.x_m, a.y_m - b.y_m) < 2e-6);
        }

        #[test]
        fn a_point_beside_the_path_projects_to_where_it_came_from(
            along in 0.5..80.0f64, offset in -1.0..1.0f64, off in -2.0..2.0f64,
        ) {
            let path = path(MIXED);
            let pose = path.at(along);
            let x = pose.x_m - offset * libm::sin(pose.yaw_rad);
            let y = pose.y_m + offset * libm::cos(pose.yaw_rad);
            let point = path.project(x, y, along + off, 3.0);
            // At a kink another point may lie nearer, never farther.
            let apart = libm::hypot(x - point.pose.x_m, y - point.pose.y_m);
            prop_assert!(apart <= offset.abs() + 1e-9);
            prop_assert!((point.along_m - (along + off)).abs() <= 3.0 + 1e-9);
        }
    }
}
