//! A vehicle that drives on although it is braked: its accelerator is stuck, or nothing brakes it.
//!
//! It still steers, so it can be kept near its path, as long as there is path. For that the reference must be where the
//! vehicle is: one that has come to rest lies behind it soon, and a law that steers for it steers off the path. So the
//! reference's clock runs as fast as it takes to keep the reference a little ahead of the vehicle; at the end of the path
//! it stands.

use config::RunConfig;
use tracking::{FASTEST_CLOCK, PathFollower, Pose, Reference};

/// So far ahead, in wheelbases, and no farther than the vehicle comes within this time. Gains that serve at the path's speed
/// weave at several times of it; a reference that lies ahead damps them, as its cross-track error grows with the vehicle's
/// heading. One that lies farther ahead cuts bends.
const AHEAD_WHEELBASES: f64 = 1.5;
const AHEAD_S: f64 = 0.6;
/// What the reference lacks is made up for within about this time.
const WITHIN_S: f64 = 0.3;
/// The slowest speed of a path that the vehicle's is compared with.
const SLOWEST_MPS: f64 = 0.1;

/// Keeps the reference of one vehicle ahead of it.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Runaway {
    /// For the path and its speeds.
    reference: Reference,
    /// `None` while the vehicle is not looked for.
    follower: Option<PathFollower>,
    farthest_ahead_m: f64,
}

impl Runaway {
    pub(crate) fn new(config: &RunConfig) -> Self {
        let farthest_ahead_m = AHEAD_WHEELBASES * config.vehicle.wheelbase_m;
        Self { reference: Reference::new(config), follower: None, farthest_ahead_m }
    }

    /// The vehicle does not run away, or no longer.
    pub(crate) fn lose(&mut self) {
        self.follower = None;
    }

    /// The rate of the reference's clock from the next tick on, for a vehicle of this speed, with the reference at this
    /// place along the path.
    pub(crate) fn clock_rate(&mut self, pose: Pose, speed_mps: f64, along_m: f64) -> f64 {
        let path = self.reference.path();
        if along_m >= path.length_m() {
            return 0.0;
        }
        let follower = self.follower.get_or_insert_with(|| PathFollower::new(path, along_m));
        follower.distance_m(path, pose.x_m, pose.y_m);
        let ahead_m = (AHEAD_S * speed_mps).clamp(0.0, self.farthest_ahead_m);
        let lacks_m = follower.along_m(path, pose.x_m, pose.y_m) + ahead_m - along_m;
        let wanted_mps = speed_mps + lacks_m / WITHIN_S;
        let path_mps = self.reference.path_speed_mps(along_m).max(SLOWEST_MPS);
        (wanted_mps / path_mps).clamp(0.0, FASTEST_CLOCK)
    }
}
