//! Whether odometry can be believed.

use config::RunConfig;
use ipc_types::Safety;
use tracking::{Pose, wrap_angle};

/// What the vehicle reports about its movement at one tick.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Movement {
    /// Measured pose of the tracked point.
    pub pose: Pose,
    /// Forward speed.
    pub speed_mps: f64,
    /// Yaw rate.
    pub yaw_rate_radps: f64,
}

/// Compares each odometry message with the last one that was believed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plausibility {
    /// The newest tick, and what was believed last with the tick since which its pose has been the same.
    newest: u64,
    last: Option<(u64, Movement)>,
    /// The last message, if it had jumped.
    jumped: Option<(u64, Movement)>,
    tick_s: f64,
    reach_m: f64,
    limit_m: f64,
    limit_rad: f64,
}

/// The distance of two poses that noise alone exceeds once in a million times, in standard deviations of the noise on x
/// and on y: √2·√(2·ln 10⁶).
const NOISE_REACH: f64 = 7.43;
/// A pose that stays the same to the bit, while odometry comes less often than ticks do, moves on for so long at most.
const HELD_S: f64 = 0.5;

impl Plausibility {
    /// Believes the first odometry message, if it is finite.
    pub fn new(config: &RunConfig) -> Self {
        let safety = config.vehicle.safety;
        // The limits are those of the vehicle; simulated noise comes on top.
        let noise = config.noise;
        let (noise_m, noise_rad) = match noise.enabled {
            true => (NOISE_REACH * noise.position_sd_m, 2.0 * noise.heading_half_width_rad),
            false => (0.0, 0.0),
        };
        Self {
            newest: 0,
            last: None,
            jumped: None,
            tick_s: config.drive.tick_s,
            // The speed is that of the rear axle; the tracked point turns around it.
            reach_m: config.vehicle.tracked_point_m.abs(),
            limit_m: safety.jump_limit_m + noise_m,
            limit_rad: safety.jump_limit_rad + noise_rad,
        }
    }

    /// Forgets what was believed: the next finite odometry is believed.
    pub fn forget(&mut self) {
        (self.last, self.jumped) = (None, None);
    }

    /// The last movement that was believed.
    pub fn believed(&self) -> Option<Movement> {
        self.last.map(|(_, movement)| movement)
    }

    /// What is wrong with the odometry of a tick, as bits of [`Safety::reasons`]; 0 if it is believed.
    pub fn check(&mut self, tick: u64, now: Movement) -> u32 {
        let Movement { pose, speed_mps, yaw_rate_radps } = now;
        if !(pose.is_finite() && speed_mps.is_finite() && yaw_rate_radps.is_finite()) {
            return Safety::ODOMETRY_INVALID;
        }
        if let Some((last_tick, last)) = self.last {
            if tick <= self.newest {
                return Safety::TIME_BACK;
            }
            if pose == last.pose {
                // The vehicle has moved on since then, although it has not told yet.
                (self.newest, self.last, self.jumped) = (tick, Some((last_tick, now)), None);
                return 0;
            }
            if self.is_jump((last_tick, last), (tick, now)) {
                match self.jumped {
                    Some((since, jumped)) if jumped.pose == pose => {
                        self.jumped = Some((since, now));
                    }
                    jumped => {
                        // Else the vehicle may have come the farther the longer the jump lasts, and it would be believed in
                        // the end.
                        if let Some(jumped) = jumped
                            && !self.is_jump(jumped, (tick, now))
                        {
                            let pose = carried(last.pose, jumped.1.pose, now.pose);
                            self.last = Some((tick, Movement { pose, ..now }));
                        }
                        self.jumped = Some((tick, now));
                    }
                }
                self.newest = tick;
                return Safety::ODOMETRY_JUMP;
            }
        }
        (self.newest, self.last, self.jumped) = (tick, Some((tick, now)), None);
        0
    }

    fn is_jump(&self, (last_tick, last): (u64, Movement), (tick, now): (u64, Movement)) -> bool {
        if self.limit_m.is_infinite() && self.limit_rad.is_infinite() {
            return false;
        }
        // Since the newest message, and for how long the pose had stood by then.
        let held_s = self.newest.saturating_sub(last_tick) as f64 * self.tick_s;
        let dt_s = tick.saturating_sub(self.newest) as f64 * self.tick_s + held_s.min(HELD_S);
        let rate_radps = last.yaw_rate_radps.abs().max(now.yaw_rate_radps.abs());
        let speed_mps = last.speed_mps.abs().max(now.speed_mps.abs()) + rate_radps * self.reach_m;
        let (x_m, y_m) = (now.pose.x_m - last.pose.x_m, now.pose.y_m - last.pose.y_m);
        // A yaw that wraps around has not jumped.
        let turned_rad = wrap_angle(now.pose.yaw_rad - last.pose.yaw_rad);
        let reach_m = speed_mps * dt_s + self.limit_m;
        // The sum is never less than the distance, and costs less.
        x_m.abs() + y_m.abs() > reach_m && libm::hypot(x_m, y_m) > reach_m
            || turned_rad.abs() > rate_radps * dt_s + self.limit_rad
    }
}

/// A pose that moves as another one does, from one place to the next.
fn carried(pose: Pose, from: Pose, to: Pose) -> Pose {
    let turned_rad = pose.yaw_rad - from.yaw_rad;
    let (sin, cos) = (libm::sin(turned_rad), libm::cos(turned_rad));
    let (x_m, y_m) = (to.x_m - from.x_m, to.y_m - from.y_m);
    Pose {
        x_m: pose.x_m + cos * x_m - sin * y_m,
        y_m: pose.y_m + sin * x_m + cos * y_m,
        yaw_rad: pose.yaw_rad + to.yaw_rad - from.yaw_rad,
    }
}
