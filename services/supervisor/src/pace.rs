//! How fast the clock of a vehicle's reference runs: the reference waits for a vehicle that does not follow.
//!
//! A vehicle may be held: by a deadman's button, by its own scanner, by a gear that is not engaged yet. If the reference
//! ran on, the vehicle would race after it as soon as it is let go. So the clock slows down, and then stands,
//! - the more speed the law asks for, compared with the speed that the path has there: this bounds what a vehicle
//!   catches up with, whatever the parameters of the law;
//! - the later the vehicle is, measured along the path: for laws that do not ask for more speed when they are late.
//!
//! A rate holds from the next tick on. It is looked at ten times a second, on means, and changes in steps, so that noise
//! seldom moves it.

use config::RunConfig;
use tracking::{PathFollower, Pose, Reference};

/// How often it looks.
const LOOK_EVERY_S: f64 = 0.1;
/// The steps in which the rate changes, from 0 to 1; exact in binary.
const STEPS: f64 = 8.0;

/// What the controller tells about the reference in one tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Progress {
    /// The speed that the law asks for.
    pub asked_mps: f64,
    /// Where along the path the reference is.
    pub along_m: f64,
    /// Where along the path its clock last started from rest.
    pub origin_m: f64,
}

/// Sets the rate of the clock of one vehicle's reference.
#[derive(Debug, Clone, PartialEq)]
pub struct Pace {
    rate: f64,
    /// `None` if the reference never waits.
    waiting: Option<Waiting>,
}

#[derive(Debug, Clone, PartialEq)]
struct Waiting {
    /// For the path and its speeds.
    reference: Reference,
    from_speed: f64,
    to_speed: f64,
    from_s: f64,
    to_s: f64,
    look_ticks: u64,
    next_look: u64,
    follower: PathFollower,
    /// Where the reference's clock last started from rest; `None` before the first tick.
    origin_m: Option<f64>,
    /// The sum of the speeds that were asked for since the last look, and how many.
    asked_mps: f64,
    count: f64,
}

impl Pace {
    /// The pace of a configuration, at the start of a drive.
    pub fn new(config: &RunConfig) -> Self {
        let reference = config.reference;
        let waiting = config.reference_waits().then(|| Waiting {
            reference: Reference::new(config),
            from_speed: reference.wait_from_speed,
            to_speed: reference.wait_to_speed,
            from_s: reference.wait_from_s,
            to_s: reference.wait_to_s,
            look_ticks: ((LOOK_EVERY_S / config.drive.tick_s).round() as u64).max(1),
            next_look: 0,
            follower: PathFollower::default(),
            origin_m: None,
            asked_mps: 0.0,
            count: 0.0,
        });
        Self { rate: 1.0, waiting }
    }

    /// The rate from the next tick on: ticks of the clock in a tick of the vehicle, 0 to 1.
    pub fn rate(&self) -> f64 {
        self.rate
    }

    /// Takes one tick: the measured pose, and what the controller makes of it.
    #[inline]
    pub fn update(&mut self, tick: u64, measured: Pose, progress: Progress) {
        if let Some(waiting) = &mut self.waiting
            && let Some(wanted) = waiting.look(tick, measured, progress)
            && (wanted - self.rate).abs() >= 1.0 / STEPS
        {
            self.rate = (wanted * STEPS).round() / STEPS;
        }
    }
}

/// The slowest speed of a path that commands and lateness are compared with.
const SLOWEST_MPS: f64 = 0.1;

impl Waiting {
    /// Takes one tick; the rate that fits the ticks since the last look, if it is time to look.
    fn look(&mut self, tick: u64, measured: Pose, progress: Progress) -> Option<f64> {
        let Progress { asked_mps, along_m, origin_m } = progress;
        if self.origin_m != Some(origin_m) {
            // A drive begins, is joined, or goes on after a stop: it looks at once.
            (self.origin_m, self.next_look) = (Some(origin_m), tick);
            (self.asked_mps, self.count) = (0.0, 0.0);
            self.follower = PathFollower::new(self.reference.path(), along_m);
        }
        if asked_mps.is_finite() {
            self.asked_mps += asked_mps;
            self.count += 1.0;
        }
        if tick < self.next_look {
            return None;
        }
        self.next_look = tick - tick % self.look_ticks + self.look_ticks;
        let mean_mps = self.asked_mps / self.count.max(1.0);
        (self.asked_mps, self.count) = (0.0, 0.0);
        let (path, speed_mps) = (self.reference.path(), self.reference.path_speed_mps(along_m));
        // Where a path ends at rest, any command would be many times its speed.
        let speed_mps = speed_mps.max(SLOWEST_MPS);
        self.follower.distance_m(path, measured.x_m, measured.y_m);
        let late_m = along_m - self.follower.along_m(path, measured.x_m, measured.y_m);
        let by_speed = falling(mean_mps / speed_mps, self.from_speed, self.to_speed);
        let by_time = falling(late_m / speed_mps, self.from_s, self.to_s);
        Some(by_speed.min(by_time))
    }
}

/// 1 up to `from`, 0 beyond `to`, a straight line between them; 1 if `to` is infinite.
fn falling(value: f64, from: f64, to: f64) -> f64 {
    if to.is_infinite() { 1.0 } else { ((to - value) / (to - from)).clamp(0.0, 1.0) }
}
