//! The speed governor: keeps the vehicle itself below the speed limit.

use config::RunConfig;

/// Keeps the vehicle itself below the speed limit, where a limited command alone would not: a speed controller whose
/// integral part has wound up exceeds its command.
///
/// It looks a moment ahead by the acceleration since the last tick. If the predicted speed comes nearer to the limit
/// than a margin, it allows a lower speed, the lower the nearer it comes; far from the limit it allows the full speed.
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

    /// Returns to the state at rest.
    pub fn reset(&mut self) {
        self.last_mps = None;
    }

    /// The highest speed that may be commanded, given the speed that is measured now. If the measurement is not
    /// finite, the last one that was finite stands in for it.
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

    #[test]
    fn the_governor_looks_ahead() {
        let mut layers = Layers::maneuver("circuit").unwrap();
        layers.set("supervisor.speed_margin_mps=0.1").unwrap();
        let mut governor = SpeedGovernor::new(&layers.resolve().unwrap());
        // Slow, or near the limit but not getting faster: the full speed is allowed.
        assert_eq!(governor.allowed_mps(0.0), 4.0);
        assert_eq!(governor.allowed_mps(0.02), 4.0);
        governor.reset();
        assert_eq!((governor.allowed_mps(3.85), governor.allowed_mps(3.85)), (4.0, 4.0));
        // Getting faster: less is allowed, long before the limit.
        let nearing = governor.allowed_mps(3.87);
        assert!(nearing < 3.9, "{nearing}");
        assert!(governor.allowed_mps(3.95) < nearing);
        assert_eq!(governor.allowed_mps(100.0), 0.0);
        assert_eq!(governor.allowed_mps(f64::NAN), 0.0);
    }
}
