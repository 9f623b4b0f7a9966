//! The safety gate: what it has not passed does not reach the vehicle.

use config::RunConfig;

/// What the gate did to a command, as flags that the command carries.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Change {
    /// The speed was above its limit, and was lowered to it.
    pub speed_limited: bool,
    /// The steering angle was outside its range, and was brought to its bound.
    pub steering_limited: bool,
    /// A number was not finite: the command was replaced by one that stops straight on.
    pub rejected: bool,
}

/// A command that the vehicle may have.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Passed {
    /// Forward speed.
    pub speed_mps: f64,
    /// Wanted yaw rate, as the controller gave it.
    pub yaw_rate_radps: f64,
    /// Steering angle, positive to the left.
    pub steering_rad: f64,
    /// What was changed.
    pub change: Change,
}

/// The gate with its limits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gate {
    speed_limit_mps: f64,
    steering_limit_rad: f64,
}

impl Gate {
    /// The gate of a configuration.
    pub fn new(config: &RunConfig) -> Self {
        Self {
            speed_limit_mps: config.supervisor.speed_limit_mps,
            // The law keeps within the same limit: a command beyond it comes from no healthy controller.
            steering_limit_rad: config.controller.steering_limit_rad,
        }
    }

    /// Passes a command, changed where a limit asks for it.
    pub fn pass(&self, speed_mps: f64, yaw_rate_radps: f64, steering_rad: f64) -> Passed {
        if !(speed_mps.is_finite() && yaw_rate_radps.is_finite() && steering_rad.is_finite()) {
            let change = Change { rejected: true, ..Change::default() };
            return Passed { speed_mps: 0.0, yaw_rate_radps: 0.0, steering_rad: 0.0, change };
        }
        let limit_rad = self.steering_limit_rad;
        Passed {
            speed_mps: speed_mps.min(self.speed_limit_mps),
            yaw_rate_radps,
            steering_rad: steering_rad.clamp(-limit_rad, limit_rad),
            change: Change {
                speed_limited: speed_mps > self.speed_limit_mps,
                steering_limited: steering_rad.abs() > limit_rad,
                rejected: false,
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::Layers;
    use proptest::num::f64::ANY;
    use proptest::prelude::*;
    use std::sync::LazyLock;

    fn gate() -> Gate {
        static GATE: LazyLock<Gate> = LazyLock::new(|| {
            Gate::new(&Layers::maneuver("lane_change").unwrap().resolve().unwrap())
        });
        *GATE
    }

    #[test]
    fn a_command_within_limits_passes_untouched() {
        let passed = gate().pass(9.0, 70.0, -0.5);
        assert_eq!(
            (passed.speed_mps, passed.yaw_rate_radps, passed.steering_rad),
            (9.0, 70.0, -0.5)
        );
        assert_eq!(passed.change, Change::default());
    }

    #[test]
    fn limits_are_flagged() {
        let passed = gate().pass(9.1, 0.0, 0.6);
        assert_eq!((passed.speed_mps, passed.steering_rad), (9.0, gate().steering_limit_rad));
        assert!(passed.change.speed_limited && passed.change.steering_limited);
        assert!(gate().pass(f64::NAN, 0.0, 0.0).change.rejected);
        assert!(gate().pass(0.0, f64::INFINITY, 0.0).change.rejected);
        assert!(gate().pass(0.0, 0.0, f64::NAN).change.rejected);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(20_000))]
        #[test]
        fn nothing_out_of_limits_passes(speed in ANY, yaw_rate in ANY, steering in ANY) {
            let passed = gate().pass(speed, yaw_rate, steering);
            prop_assert!(passed.speed_mps <= 9.0);
            prop_assert!(passed.steering_rad.abs() <= gate().steering_limit_rad);
            prop_assert!(passed.speed_mps.is_finite() && passed.yaw_rate_radps.is_finite());
        }
    }
}
