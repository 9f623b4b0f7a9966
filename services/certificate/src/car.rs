//! What the loop is made of: the car and the gains.

use config::{Parameters, RunConfig};
use tracking::Turning;

/// The gains of the paper's law; see `config/laws/paper.toml`.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Gains {
    /// Speed per distance to the reference, 1/s.
    pub kv: f64,
    /// Yaw rate per cross-track error, rad/(m·s).
    pub kl: f64,
    /// Yaw rate per heading error, 1/s.
    pub ks: f64,
    /// Pole of the low-pass filter of the steering angle.
    pub ki: f64,
}

impl Gains {
    /// The gains of a set of parameters of the paper's law.
    pub fn new(parameters: &Parameters) -> Self {
        let [kv, kl, ks, ki, ..] = parameters.0;
        Self { kv, kl, ks, ki }
    }
}

/// What the lateral loop knows of a car and of the law's tick.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Car {
    /// The law's tick.
    pub tick_s: f64,
    /// Axle to axle.
    pub wheelbase_m: f64,
    /// The tracked point lies this far ahead of the rear axle.
    pub tracked_point_m: f64,
    /// The least of the limits of the steering angle: the law's and the car's.
    pub steering_limit_rad: f64,
    /// The least of the limits of the steering angle's rate: the gate's and the car's.
    pub steering_rate_radps: f64,
    /// Dead time of the steering.
    pub steering_delay_s: f64,
    /// Time constant of the steering's first-order lag.
    pub steering_lag_s: f64,
    /// Angle of the road wheels per commanded angle.
    pub steering_gain: f64,
    /// Slip angle of the rear axle per lateral acceleration, rad/(m/s²).
    #[serde(default, skip_serializing_if = "is_zero")]
    pub rear_slip_s2pm: f64,
    /// How much later the yaw rate comes for each m/s, s²/m.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub yaw_lag_s2pm: f64,
    /// Gradient of understeer, s²/m.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub understeer_s2pm: f64,
}

#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde wants it")]
fn is_zero(number: &f64) -> bool {
    *number == 0.0
}

impl Car {
    /// The car of a configuration.
    pub fn new(config: &RunConfig) -> Self {
        let vehicle = &config.vehicle;
        let gate_radps = vehicle.safety.steering_rate_limit_radps;
        Self {
            tick_s: config.drive.tick_s,
            wheelbase_m: vehicle.wheelbase_m,
            tracked_point_m: vehicle.tracked_point_m,
            steering_limit_rad: config
                .controller
                .steering_limit_rad
                .min(vehicle.steering_limit_rad),
            steering_rate_radps: vehicle.steering_rate_radps.min(gate_radps),
            steering_delay_s: vehicle.steering_delay_s,
            steering_lag_s: vehicle.steering_lag_s,
            steering_gain: vehicle.steering_gain,
            rear_slip_s2pm: vehicle.rear_slip_s2pm,
            yaw_lag_s2pm: vehicle.yaw_lag_s2pm,
            understeer_s2pm: vehicle.understeer_s2pm,
        }
    }

    /// How far the tracked point lies ahead of the one that moves where the car points, m: of the rear axle, or at a speed
    /// at which its tyres slip, of a point ahead of it. Seen from there the loop is that of a car that does not slip.
    pub fn tracked_m(&self, speed_mps: f64) -> f64 {
        self.tracked_point_m - self.rear_slip_s2pm * speed_mps * speed_mps
    }

    /// How it turns.
    pub(crate) fn turning(&self) -> Turning {
        Turning::with(self.wheelbase_m, self.understeer_s2pm, self.yaw_lag_s2pm)
    }

    /// What is left of the additional dead time of a loop whose yaw rate is not late ([`tracking::Turning`]): a lag costs a
    /// loop no more than a dead time that is as long.
    pub(crate) fn beyond_yaw_lag_s(&self, additional_s: f64, speed_mps: f64) -> f64 {
        (additional_s - self.yaw_lag_s2pm * speed_mps).max(0.0)
    }
}
