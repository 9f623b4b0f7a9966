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

    /// Passes a command, changed where a limit asks for it. `allowed_mps` is what the [`SpeedGovernor`] allows.
    pub fn pass(
        &self,
        allowed_mps: f64,
        speed_mps: f64,
        yaw_rate_radps: f64,
        steering_rad: f64,
    ) -> Passed {
        if !(speed_mps.is_finite() && yaw_rate_radps.is_finite() && steering_rad.is_finite()) {
            let change = Change { rejected: true, ..Change::default() };
            return Passed { speed_mps: 0.0, yaw_rate_radps: 0.0, steering_rad: 0.0, change };
        }
        let limit_rad = self.steering_limit_rad;
        let limit_mps = self.speed_limit_mps.min(allowed_mps);
        Passed {
            speed_mps: speed_mps.min(limit_mps),
            yaw_rate_radps,
            steering_rad: steering_rad.clamp(-limit_rad, limit_rad),
            change: Change {
                speed_limited: speed_mps > limit_mps,
                steering_limited: steering_rad.abs() > limit_rad,
                rejected: false,
            },
        }
    }
}

/// Keeps the vehicle itself below the speed limit, where a limited command alone would not: a speed controller that
/// has wound up goes on beyond what it is told.
///
/// It looks a moment ahead by the acceleration since the last tick. Where that comes nearer to the limit than a
/// margin, it allows the less the farther it comes; far from the limit it allows all of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpeedGovernor {
    limit_mps: f64,
    margin_mps: f64,
    foresight_s: f64,
    gain: f64,
    tick_s: f64,
    last_mps: Option<f64>,
}

impl SpeedGovernor {
    /// The governor of a configuration, at rest.
    pub fn new(config: &RunConfig) -> Self {
        let supervisor = config.supervisor;
        Self {
            limit_mps: supervisor.speed_limit_mps,
            margin_mps: supervisor.speed_margin_mps,
            foresight_s: supervisor.speed_foresight_s,
            gain: supervisor.speed_gain,
            tick_s: config.drive.tick_s,
            last_mps: None,
        }
    }

    /// Back to rest.
    pub fn reset(&mut self) {
        self.last_mps = None;
    }

    /// The highest speed that may be commanded, with the speed that was measured now. A measurement that is not
    /// finite is taken for the last one that was.
    pub fn allowed_mps(&mut self, measured_mps: f64) -> f64 {
        let last_mps = self.last_mps.unwrap_or_default();
        let now_mps = if measured_mps.is_finite() { measured_mps } else { last_mps };
        let gained_mps = now_mps - self.last_mps.unwrap_or(now_mps);
        self.last_mps = Some(now_mps);
        let coming_mps = now_mps + gained_mps / self.tick_s * self.foresight_s;
        let aim_mps = self.limit_mps - self.margin_mps;
        if coming_mps <= aim_mps {
            return self.limit_mps;
        }
        (aim_mps - self.gain * (coming_mps - aim_mps)).clamp(0.0, self.limit_mps)
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
        let passed = gate().pass(9.0, 9.0, 70.0, -0.5);
        assert_eq!(
            (passed.speed_mps, passed.yaw_rate_radps, passed.steering_rad),
            (9.0, 70.0, -0.5)
        );
        assert_eq!(passed.change, Change::default());
    }

    #[test]
    fn limits_are_flagged() {
        let passed = gate().pass(9.0, 9.1, 0.0, 0.6);
        assert_eq!((passed.speed_mps, passed.steering_rad), (9.0, gate().steering_limit_rad));
        assert!(passed.change.speed_limited && passed.change.steering_limited);
        assert!(gate().pass(9.0, f64::NAN, 0.0, 0.0).change.rejected);
        assert!(gate().pass(9.0, 0.0, f64::INFINITY, 0.0).change.rejected);
        assert!(gate().pass(9.0, 0.0, 0.0, f64::NAN).change.rejected);
    }

    #[test]
    fn the_governor_looks_ahead() {
        let mut layers = Layers::maneuver("circuit").unwrap();
        layers.set("supervisor.speed_margin_mps=0.1").unwrap();
        let mut governor = SpeedGovernor::new(&layers.resolve().unwrap());
        // Slow, or near the limit but not getting faster: all of it.
        assert_eq!(governor.allowed_mps(0.0), 4.0);
        assert_eq!(governor.allowed_mps(0.02), 4.0);
        governor.reset();
        assert_eq!((governor.allowed_mps(3.85), governor.allowed_mps(3.85)), (4.0, 4.0));
        // Getting faster: less, long before the limit.
        let nearing = governor.allowed_mps(3.87);
        assert!(nearing < 3.9, "{nearing}");
        assert!(governor.allowed_mps(3.95) < nearing);
        assert_eq!(governor.allowed_mps(100.0), 0.0);
        assert_eq!(governor.allowed_mps(f64::NAN), 0.0);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(20_000))]
        #[test]
        fn nothing_out_of_limits_passes(
            measured in ANY, speed in ANY, yaw_rate in ANY, steering in ANY,
        ) {
            let config = Layers::maneuver("lane_change").unwrap().resolve().unwrap();
            let mut governor = SpeedGovernor::new(&config);
            governor.allowed_mps(1.0);
            let allowed = governor.allowed_mps(measured);
            prop_assert!((0.0..=9.0).contains(&allowed));
            let passed = gate().pass(allowed, speed, yaw_rate, steering);
            prop_assert!(passed.speed_mps <= 9.0);
            prop_assert!(passed.steering_rad.abs() <= gate().steering_limit_rad);
            prop_assert!(passed.speed_mps.is_finite() && passed.yaw_rate_radps.is_finite());
        }
    }
}
