//! How far the vehicle is from its path, and how far its heading differs from the path's.
//!
//! Both are looked at as means over 0.1 s: the noise of a single pose would exceed a small car's limits. The nearest
//! place of the path is looked for near the last one, so that another stretch of the path that comes near does not count.
//!
//! A vehicle that was rearmed beside its path may be farther away than its limit. It is allowed to return: its limit counts
//! from the nearest that it has come to the path since, until it is as near as the limit itself.

use config::RunConfig;
use ipc_types::Safety;
use tracking::{Path, PathFollower, Pose, wrap_angle};

use crate::mean::Means;

/// The deviation of one vehicle from its path.
#[derive(Debug, Clone, PartialEq)]
pub struct Deviation {
    path: Path,
    follower: PathFollower,
    limit_m: f64,
    limit_rad: f64,
    /// Of x, y and yaw against those of the mean's first pose: numbers that are small lose nothing.
    means: Means<3>,
    first: Pose,
    is_lost: bool,
    /// It was rearmed, and has not been seen since.
    is_rearmed: bool,
    /// How far it may be: `limit_m`, or more while it returns to its path after a rearm.
    allowed_m: f64,
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
            path,
            limit_m,
            limit_rad,
            means: Means::new(config),
            first: Pose::default(),
            is_lost: false,
            is_rearmed: false,
            allowed_m: limit_m,
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
        let heading_rad = wrap_angle(mean.yaw_rad - self.path.at(along_m).yaw_rad);
        // How far it may be counts from where it was rearmed, and shrinks while it comes nearer.
        let by_return_m = distance_m + self.limit_m;
        self.allowed_m = match std::mem::take(&mut self.is_rearmed) {
            true if distance_m > self.limit_m => by_return_m,
            true => self.limit_m,
            false if distance_m > self.limit_m => self.allowed_m.min(by_return_m),
            false => self.limit_m,
        };
        self.faults = 0;
        if distance_m > self.allowed_m {
            self.faults |= Safety::PATH_DISTANCE;
        }
        if heading_rad.abs() > self.limit_rad {
            self.faults |= Safety::PATH_HEADING;
        }
    }

    /// [`Safety::PATH_DISTANCE`] and [`Safety::PATH_HEADING`], if the last mean was beyond their limits.
    pub fn faults(&self) -> u32 {
        self.faults
    }
}
