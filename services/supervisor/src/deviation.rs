//! How far the vehicle is from its path, and how far its heading differs from the path's.
//!
//! Both are looked at as means over 0.1 s: the noise of a single pose would exceed a small car's limits. The nearest
//! place of the path is looked for near the last one, so that another stretch of the path that comes near does not count.
//! Where a path's file tells the road's edges, the vehicle's body may not pass them either.
//!
//! A vehicle that was rearmed beside its path may be farther away than its limit, or stand across it. It is allowed to
//! return: its limits count from the nearest that it has come to the path and its heading since, until it is as near as
//! the limits themselves.

use std::f64::consts::FRAC_PI_2;

use config::RunConfig;
use ipc_types::Safety;
use tracking::{Path, PathFollower, Pose, wrap_angle};

use crate::mean::Means;
use crate::road::Road;

/// The deviation of one vehicle from its path.
#[derive(Debug, Clone, PartialEq)]
pub struct Deviation {
    path: Path,
    follower: PathFollower,
    limit_m: f64,
    limit_rad: f64,
    /// `None` where its edges are not known.
    road: Option<Road>,
    /// Of x, y and yaw against those of the mean's first pose: numbers that are small lose nothing.
    means: Means<3>,
    first: Pose,
    is_lost: bool,
    /// It was rearmed, and has not been seen since.
    is_rearmed: bool,
    /// How much farther than its limit it may be, and farther turned than that: 0, but while it returns to its path after a
    /// rearm.
    excess_m: f64,
    excess_rad: f64,
    faults: u32,
}

impl Deviation {
    /// Before a vehicle at the start of its path; `None` if neither is limited.
    pub fn new(config: &RunConfig) -> Option<Self> {
        let (limit_m, limit_rad) =
            (config.path_distance_limit_m(), config.path_heading_limit_rad());
        if limit_m.is_infinite() && limit_rad.is_infinite() {
            return None;
        }
        let path = Path::new(&config.path);
        Some(Self {
            follower: PathFollower::new(&path, 0.0),
            // Who lifts the limit of the distance does not want the path watched.
            road: Road::new(config, &path).filter(|_| limit_m.is_finite()),
            path,
            limit_m,
            limit_rad,
            means: Means::new(config),
            first: Pose::default(),
            is_lost: false,
            is_rearmed: false,
            excess_m: 0.0,
            excess_rad: 0.0,
            faults: 0,
        })
    }

    /// The vehicle may be elsewhere on the path: nothing is judged until it is known where.
    pub fn lose(&mut self) {
        self.is_lost = true;
        self.means.restart();
        self.faults = 0;
    }

    /// The vehicle was rearmed: from wherever it is, it may return to its path.
    pub fn rearm(&mut self) {
        self.is_rearmed = true;
    }

    /// Looks for the vehicle near this place of the path, if it was lost.
    pub fn look_near(&mut self, along_m: f64) {
        if std::mem::take(&mut self.is_lost) {
            self.follower = PathFollower::new(&self.path, along_m);
        }
    }

    /// Takes a pose that is believed.
    #[inline]
    pub fn see(&mut self, pose: Pose) {
        if self.is_lost {
            return;
        }
        if self.means.is_empty() {
            self.first = pose;
        }
        let first = self.first;
        let (x_m, y_m) = (pose.x_m - first.x_m, pose.y_m - first.y_m);
        if let Some([x_m, y_m, yaw_rad]) =
            self.means.add([x_m, y_m, wrap_angle(pose.yaw_rad - first.yaw_rad)])
        {
            self.judge(Pose {
                x_m: first.x_m + x_m,
                y_m: first.y_m + y_m,
                yaw_rad: first.yaw_rad + yaw_rad,
            });
        }
    }

    fn judge(&mut self, mean: Pose) {
        let distance_m = self.follower.distance_m(&self.path, mean.x_m, mean.y_m);
        let along_m = self.follower.along_m(&self.path, mean.x_m, mean.y_m);
        let at = self.path.at(along_m);
        let heading_rad = wrap_angle(mean.yaw_rad - at.yaw_rad);
        let to_the_edge_m = self.road.as_ref().map_or(f64::INFINITY, |road| {
            let (sin, cos) = (libm::sin(at.yaw_rad), libm::cos(at.yaw_rad));
            let is_left = (mean.y_m - at.y_m) * cos - (mean.x_m - at.x_m) * sin > 0.0;
            road.room_m(along_m, is_left)
        });
        let limit_m = self.limit_m.min(to_the_edge_m);
        // How far it may be counts from where it was rearmed, and shrinks while it comes nearer.
        let is_rearmed = std::mem::take(&mut self.is_rearmed);
        self.excess_m = excess(self.excess_m, limit_m, distance_m, is_rearmed);
        let off_rad = heading_rad.abs();
        self.excess_rad = excess(self.excess_rad, self.limit_rad, off_rad, is_rearmed);
        if self.excess_m > 0.0 {
            // Back to the path it drives across.
            self.excess_rad = self.excess_rad.max(FRAC_PI_2 - self.limit_rad);
        }
        self.faults = 0;
        if distance_m > limit_m + self.excess_m {
            let is_edge = distance_m <= self.limit_m;
            self.faults |= if is_edge { Safety::ROAD_EDGE } else { Safety::PATH_DISTANCE };
        }
        if off_rad > self.limit_rad + self.excess_rad {
            self.faults |= Safety::PATH_HEADING;
        }
    }

    /// [`Safety::PATH_DISTANCE`], [`Safety::ROAD_EDGE`] and [`Safety::PATH_HEADING`], if the last mean was beyond their limits.
    pub fn faults(&self) -> u32 {
        self.faults
    }
}

/// How far beyond its limit a vehicle may be that is `off` now: this counts from where it was rearmed, and shrinks while it
/// comes nearer.
fn excess(before: f64, limit: f64, off: f64, is_rearmed: bool) -> f64 {
    match is_rearmed {
        _ if off <= limit => 0.0,
        true => off,
        false => before.min(off),
    }
}
