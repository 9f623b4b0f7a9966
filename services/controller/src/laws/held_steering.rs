//! The steering angle that a law commanded last: the state of its low-pass filter.

use config::RunConfig;

use super::LawState;

/// The steering angle that a law commanded last, within the limit of the steering. The limit clamps the state itself, so
/// that a filter does not wind up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct HeldSteering {
    limit_rad: f64,
    angle_rad: f64,
}

impl HeldSteering {
    /// Straight ahead, with the steering limit of a configuration.
    pub(super) fn new(config: &RunConfig) -> Self {
        Self { limit_rad: config.controller.steering_limit_rad, angle_rad: 0.0 }
    }

    /// The angle that was commanded last.
    #[inline]
    pub(super) fn angle_rad(&self) -> f64 {
        self.angle_rad
    }

    /// Commands an angle; returns it within the limit.
    #[inline]
    pub(super) fn hold(&mut self, angle_rad: f64) -> f64 {
        self.angle_rad = angle_rad.clamp(-self.limit_rad, self.limit_rad);
        self.angle_rad
    }

    /// Commands `share` of the last angle and the rest of a new one; returns the sum within the limit.
    #[inline]
    pub(super) fn filter(&mut self, share: f64, angle_rad: f64) -> f64 {
        self.hold(share * self.angle_rad + (1.0 - share) * angle_rad)
    }

    /// A law's state, for a law that has no other.
    pub(super) fn state(&self) -> LawState {
        LawState::of(&[self.angle_rad])
    }

    /// Goes on from [`HeldSteering::state`], or straight ahead if there is none.
    pub(super) fn resume(&mut self, state: &LawState) {
        self.hold(state.numbers().first().copied().unwrap_or_default());
    }
}
