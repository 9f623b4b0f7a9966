//! Odometry whose yaw rate is computed from the commanded steering angle.
//!
//! Some drivers take the commanded steering angle for the real one: their yaw rate is v·tan φ/L, with an L of their own and
//! no lag. A car that steers wrongly, or not at all, then looks as if it did as it is told. What gives such a driver away
//! is steering that changes: a real one lags behind, and what measures it is noisy.

use config::RunConfig;

/// A driver may use a command that is up to so many ticks old.
const AGES: usize = 5;
/// Over so long, steering has to have changed by this much.
const RECENT_S: f64 = 0.1;
const CHANGED_RAD: f64 = 0.02;
/// Smaller angles say little about a ratio.
const CLEAR_RAD: f64 = 0.04;
/// How exactly a formula is followed.
const SHARE: f64 = 0.005;
/// So many ticks with changing steering are needed, and one in so many of them may be off.
const ENOUGH: u32 = 100;
const OFF_ONE_IN: u32 = 20;

/// Compares the yaw rate of one vehicle with its commands.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Unseen {
    /// Commanded steering angles, and the tangents of those that are clear: a ring whose length is a power of two, from the
    /// newest on, which stands at `newest`.
    told: Vec<(f64, f64)>,
    newest: usize,
    /// How many ticks before an angle the one is that it is compared with.
    recent: usize,
    /// For each age of the command: the wheelbase that the first tick shows, and how many ticks agree and differ.
    by_age: [Agreement; AGES],
    is_computed: bool,
}

#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Agreement {
    wheelbase_m: f64,
    agree: u32,
    differ: u32,
}

impl Unseen {
    /// Before the first command.
    pub(crate) fn new(config: &RunConfig) -> Self {
        let recent = (RECENT_S / config.drive.tick_s).round().max(1.0) as usize;
        Self {
            told: vec![(0.0, 0.0); (AGES + recent).next_power_of_two()],
            newest: 0,
            recent,
            by_age: [Agreement::default(); AGES],
            is_computed: false,
        }
    }

    /// Takes the command that the vehicle has, and what its odometry says.
    #[inline]
    pub(crate) fn see(&mut self, steering_rad: f64, speed_mps: f64, yaw_rate_radps: f64) {
        if self.is_computed {
            return;
        }
        // Each tangent serves for all ages.
        let tangent = if steering_rad.abs() < CLEAR_RAD { 0.0 } else { libm::tan(steering_rad) };
        let mask = self.told.len() - 1;
        self.newest = self.newest.wrapping_sub(1) & mask;
        self.told[self.newest] = (steering_rad, tangent);
        let ago = |ticks: usize| self.told[(self.newest + ticks) & mask];
        for (age, agreement) in self.by_age.iter_mut().enumerate() {
            let ((told_rad, tangent), (before_rad, _)) = (ago(age), ago(age + self.recent));
            if told_rad.abs() < CLEAR_RAD || (told_rad - before_rad).abs() < CHANGED_RAD {
                continue;
            }
            let wheelbase_m = speed_mps * tangent / yaw_rate_radps;
            if (wheelbase_m - agreement.wheelbase_m).abs() <= SHARE * agreement.wheelbase_m.abs() {
                agreement.agree += 1;
            } else {
                agreement.differ += 1;
            }
            if agreement.differ > 2 + agreement.agree / OFF_ONE_IN {
                // The first tick may have been one that was off.
                *agreement = Agreement { wheelbase_m, ..Agreement::default() };
            }
            self.is_computed |= agreement.agree >= ENOUGH;
        }
    }

    /// Whether the yaw rate has turned out to be computed.
    pub(crate) fn is_computed(&self) -> bool {
        self.is_computed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whether a yaw rate of `wheel(command, tick)` is found out in a drive of 20 s with swinging steering.
    fn found(mut wheel: impl FnMut(f64, u32) -> f64) -> bool {
        let config = config::Layers::maneuver("lane_change").unwrap().resolve().unwrap();
        let mut unseen = Unseen::new(&config);
        for tick in 0..2000 {
            let told_rad = 0.2 * libm::sin(f64::from(tick) * 0.02);
            let speed_mps = 2.0 + 0.5 * libm::sin(f64::from(tick) * 0.003);
            let yaw_rate_radps = speed_mps * libm::tan(wheel(told_rad, tick)) / 0.31;
            unseen.see(told_rad, speed_mps, yaw_rate_radps);
        }
        unseen.is_computed()
    }

    #[test]
    fn a_formula_is_told_from_a_car() {
        assert!(found(|told_rad, _| told_rad));
        // Published at half the rate, a tick late.
        let mut held = (0.0, 0.0);
        assert!(found(|told_rad, tick| {
            held.1 = held.0;
            held.0 = told_rad;
            let _ = tick;
            held.1
        }));
        // A lag of 30 ms, and noise of 1 mrad on the angle.
        let mut lagging = 0.0;
        assert!(!found(|told_rad, _| {
            lagging += (told_rad - lagging) * 0.3;
            lagging
        }));
        let mut noise = 0.3_f64;
        assert!(!found(|told_rad, _| {
            noise = 3.9 * noise * (1.0 - noise);
            told_rad + 4e-3 * (noise - 0.5)
        }));
        // A steering that is held does not show whether it lags.
        assert!(!found(|_, _| 0.0));
    }
}
