//! The safety gate: no command reaches the vehicle unless it has passed the gate.
//!
//! It knows the last command that it passed, and lets the next one differ from it no more than the limits allow. All
//! limits hold at the same time for every command, whatever is asked for:
//!
//! - the highest and lowest speed; the steering angle;
//! - how fast the speed changes, and how fast that changes (jerk), where a full brake may have a limit of its own; how fast
//!   the steering angle changes;
//! - the lateral acceleration v²·tan|φ|/L of the command.
//!
//! The yaw rate of a command is that of its speed and its steering angle, v·tan φ/L, so it is limited with them.
//!
//! They cannot contradict each other, because the gate looks ahead: it never allows an acceleration that could not be
//! taken back, within the jerk limit, before the speed limit is reached, and never a steering angle that the speed
//! reached by then would not allow.

use std::f64::consts::FRAC_PI_2;

use config::RunConfig;

/// Bounds for the time between two commands: a shorter or longer time counts as the bound.
const SHORTEST_S: f64 = 1e-6;
const LONGEST_S: f64 = 1.0;
/// No command is lower than this, even where reversing is not limited: far larger numbers would break the arithmetic.
const LOWEST_MPS: f64 = -1000.0;

/// What the controller wants of one vehicle, before the gate has changed it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RawCommand {
    /// Forward speed.
    pub speed_mps: f64,
    /// Yaw rate.
    pub yaw_rate_radps: f64,
    /// Steering angle, positive to the left.
    pub steering_rad: f64,
}

impl RawCommand {
    /// Whether it could be sent to a vehicle.
    pub fn is_finite(self) -> bool {
        self.speed_mps.is_finite()
            && self.yaw_rate_radps.is_finite()
            && self.steering_rad.is_finite()
    }
}

/// What the gate did to a command, as flags that the command carries.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Change {
    /// The speed was out of its limits.
    pub speed_limited: bool,
    /// The steering angle was out of its range.
    pub steering_limited: bool,
    /// The speed changed faster than acceleration, deceleration and jerk allow.
    pub acceleration_limited: bool,
    /// The steering angle changed faster than its rate allows.
    pub steering_rate_limited: bool,
    /// Speed or steering angle were too high for the lateral acceleration.
    pub lateral_limited: bool,
    /// A number was not finite: the command was replaced by one that slows down.
    pub rejected: bool,
}

impl Change {
    /// Whether anything was changed.
    pub fn is_any(self) -> bool {
        self != Self::default()
    }
}

/// A command that may be sent to the vehicle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Passed {
    /// Forward speed.
    pub speed_mps: f64,
    /// The yaw rate of this speed and this steering angle.
    pub yaw_rate_radps: f64,
    /// Steering angle, positive to the left.
    pub steering_rad: f64,
    /// What was changed.
    pub change: Change,
}

/// The gate of one vehicle: its limits, and what it passed last.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gate {
    limits: Limits,
    speed_mps: f64,
    acceleration_mps2: f64,
    steering_rad: f64,
}

/// Limits of a command; an infinite limit has no effect.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Limits {
    speed_mps: f64,
    reverse_mps: f64,
    acceleration_mps2: f64,
    deceleration_mps2: f64,
    jerk_mps3: f64,
    stop_mps2: f64,
    /// In a full brake, in place of the limits of deceleration and jerk, where it is stated.
    full_brake_mps2: Option<f64>,
    steering_rad: f64,
    steering_rate_radps: f64,
    lateral_mps2: f64,
    wheelbase_m: f64,
}

impl Gate {
    /// The gate of a configuration, for a vehicle at rest.
    pub fn new(config: &RunConfig) -> Self {
        let safety = config.vehicle.safety;
        let limits = Limits {
            speed_mps: config.supervisor.speed_limit_mps,
            reverse_mps: safety.reverse_limit_mps.min(-LOWEST_MPS),
            acceleration_mps2: safety.acceleration_limit_mps2,
            deceleration_mps2: safety.deceleration_limit_mps2,
            jerk_mps3: safety.jerk_limit_mps3,
            stop_mps2: safety.stop_deceleration_mps2,
            full_brake_mps2: safety.own_full_brake_mps2(),
            // The law keeps within the same limit: a command beyond it cannot come from a healthy controller.
            steering_rad: config.controller.steering_limit_rad,
            steering_rate_radps: safety.steering_rate_limit_radps,
            lateral_mps2: safety.lateral_acceleration_limit_mps2,
            wheelbase_m: config.vehicle.wheelbase_m,
        };
        Self { limits, speed_mps: 0.0, acceleration_mps2: 0.0, steering_rad: 0.0 }
    }

    /// Starts again for a vehicle at rest.
    pub fn reset(&mut self) {
        self.resume(0.0, 0.0);
    }

    /// Starts again for a vehicle that moves, with the measured speed and steering angle. The next commands start from
    /// these values, brought within the limits. A value that is not finite counts as 0.
    pub fn resume(&mut self, speed_mps: f64, steering_rad: f64) {
        let or_zero = |number: f64| if number.is_finite() { number } else { 0.0 };
        let limit_rad = self.limits.steering_rad;
        self.steering_rad = or_zero(steering_rad).clamp(-limit_rad, limit_rad);
        let (floor_mps, cap_mps) = self.limits.speeds_mps(self.steering_rad);
        self.speed_mps = or_zero(speed_mps).clamp(floor_mps, cap_mps);
        self.acceleration_mps2 = 0.0;
    }

    /// The steering angle that was passed last.
    pub fn steering_rad(&self) -> f64 {
        self.steering_rad
    }

    /// The speed that was passed last.
    pub fn speed_mps(&self) -> f64 {
        self.speed_mps
    }

    /// Passes a command `dt_s` after the last one, changed where a limit requires it. `allowed_mps` is what the
    /// [`SpeedGovernor`](crate::SpeedGovernor) allows.
    pub fn pass(&mut self, dt_s: f64, allowed_mps: f64, raw: RawCommand) -> Passed {
        if !raw.is_finite() {
            let mut slower = self.slow_down(dt_s);
            slower.change.rejected = true;
            return slower;
        }
        let RawCommand { speed_mps, steering_rad, .. } = raw;
        let limited_mps =
            speed_mps.min(self.limits.speed_mps.min(allowed_mps)).max(-self.limits.reverse_mps);
        let mut passed = self.shape(dt_s, limited_mps, f64::INFINITY, steering_rad);
        passed.change.speed_limited = limited_mps != speed_mps;
        passed
    }

    /// A command of the gate's own: slower, with the steering held.
    pub fn slow_down(&mut self, dt_s: f64) -> Passed {
        self.shape(dt_s, 0.0, self.limits.stop_mps2, self.steering_rad)
    }

    /// A command of the gate's own: as fast as the limits allow to this speed, 0 or less, and steered as wanted. Steering
    /// that is not finite is held. `measured_mps` is the vehicle's own speed: where a full brake has a limit of its own, the
    /// command falls ahead of the vehicle, whose lateral acceleration still counts.
    pub fn brake(
        &mut self,
        dt_s: f64,
        speed_mps: f64,
        wanted_rad: f64,
        measured_mps: f64,
    ) -> Passed {
        let wanted_rad = if wanted_rad.is_finite() { wanted_rad } else { self.steering_rad };
        let speed_mps = speed_mps.min(0.0).max(-self.limits.reverse_mps);
        let Some(full_mps2) = self.limits.full_brake_mps2 else {
            return self.shape(dt_s, speed_mps, f64::INFINITY, wanted_rad);
        };
        let limits = self.limits;
        let kept = limits.lateral_rad(measured_mps).max(self.steering_rad.abs());
        let bound_rad = if measured_mps.is_finite() { kept } else { self.steering_rad.abs() };
        self.limits.deceleration_mps2 = full_mps2;
        self.limits.jerk_mps3 = f64::INFINITY;
        let mut passed =
            self.shape(dt_s, speed_mps, f64::INFINITY, wanted_rad.clamp(-bound_rad, bound_rad));
        self.limits = limits;
        // What comes after the brake starts from a command that rests, as the vehicle does.
        self.acceleration_mps2 = 0.0;
        passed.change.lateral_limited |= wanted_rad.abs() > bound_rad;
        passed
    }

    /// A command of the gate's own: slower, and straight on.
    pub fn stop(&mut self, dt_s: f64) -> Passed {
        self.shape(dt_s, 0.0, self.limits.stop_mps2, 0.0)
    }

    /// Goes as near to a wanted speed and steering angle as the limits allow, slowing down by at most `braking_mps2`.
    fn shape(&mut self, dt_s: f64, wanted_mps: f64, braking_mps2: f64, wanted_rad: f64) -> Passed {
        let limits = self.limits;
        // In two steps, because a clamp would keep a time that is NaN.
        let at_least_s = dt_s.max(SHORTEST_S);
        let dt_s = at_least_s.min(LONGEST_S);
        let (floor_mps, cap_mps) = limits.speeds_mps(self.steering_rad);
        let target_mps = wanted_mps.max(floor_mps).min(cap_mps);
        let gentle_mps =
            self.approach_mps(dt_s, target_mps).max(self.speed_mps - braking_mps2 * dt_s);
        let jerk_mps2 = limits.jerk_mps3 * dt_s;
        let least_mps2 = (self.acceleration_mps2 - jerk_mps2).max(-limits.deceleration_mps2);
        let most_mps2 = (self.acceleration_mps2 + jerk_mps2).min(limits.acceleration_mps2);
        let speed_mps = gentle_mps
            .max(self.speed_mps + least_mps2 * dt_s)
            .min(self.speed_mps + most_mps2 * dt_s)
            // This holds already, except for the last bit.
            .clamp(floor_mps, cap_mps);
        let acceleration_mps2 = (speed_mps - self.speed_mps) / dt_s;

        let ranged_rad = wanted_rad.clamp(-limits.steering_rad, limits.steering_rad);
        let reach_rad = limits.steering_rate_radps * dt_s;
        let turned_rad =
            ranged_rad.clamp(self.steering_rad - reach_rad, self.steering_rad + reach_rad);
        // The speed goes on changing until the jerk has taken the acceleration back.
        let coming_mps =
            speed_mps + acceleration_mps2 * acceleration_mps2.abs() / (2.0 * limits.jerk_mps3);
        let fastest_mps = speed_mps.abs().max(coming_mps.abs());
        let bound_rad = limits.lateral_rad(fastest_mps).max(self.steering_rad.abs());
        let steering_rad = turned_rad.clamp(-bound_rad, bound_rad);

        self.speed_mps = speed_mps;
        self.acceleration_mps2 = acceleration_mps2;
        self.steering_rad = steering_rad;
        Passed {
            speed_mps,
            yaw_rate_radps: speed_mps * libm::tan(steering_rad) / limits.wheelbase_m,
            steering_rad,
            change: Change {
                speed_limited: false,
                steering_limited: ranged_rad != wanted_rad,
                acceleration_limited: speed_mps != target_mps,
                steering_rate_limited: turned_rad != ranged_rad,
                lateral_limited: target_mps != wanted_mps || steering_rad != turned_rad,
                rejected: false,
            },
        }
    }

    /// The speed after the next `dt_s` on the way to a target speed, such that the acceleration is 0 when the target is
    /// reached, within the jerk limit.
    ///
    /// An acceleration a held for dt and then taken back takes the speed by at most a·dt + a²/2j; solved for a.
    fn approach_mps(&self, dt_s: f64, target_mps: f64) -> f64 {
        let jerk_mps3 = self.limits.jerk_mps3;
        if jerk_mps3.is_infinite() {
            return target_mps;
        }
        let apart_mps = target_mps - self.speed_mps;
        let root_s = (dt_s * dt_s + 2.0 * apart_mps.abs() / jerk_mps3).sqrt();
        self.speed_mps + 2.0 * apart_mps * dt_s / (dt_s + root_s)
    }
}

impl Limits {
    /// The lowest and the highest speed that may be commanded with a steering angle.
    fn speeds_mps(&self, steering_rad: f64) -> (f64, f64) {
        if self.lateral_mps2.is_infinite() {
            return (-self.reverse_mps, self.speed_mps);
        }
        let lateral_mps =
            (self.lateral_mps2 * self.wheelbase_m / libm::tan(steering_rad.abs())).sqrt();
        (-self.reverse_mps.min(lateral_mps), self.speed_mps.min(lateral_mps))
    }

    /// The largest steering angle that a speed allows.
    fn lateral_rad(&self, speed_mps: f64) -> f64 {
        if self.lateral_mps2.is_infinite() {
            return FRAC_PI_2;
        }
        libm::atan(self.lateral_mps2 * self.wheelbase_m / (speed_mps * speed_mps))
    }
}
