//! What the gate does about faults: a small state machine for each vehicle.

use config::RunConfig;
use ipc_types::Safety;

/// Faults that stop the vehicle at once: nobody can drive it, and whatever is told makes it worse; or they rest on
/// seconds of evidence already; or there is just the room for a stop.
const AT_ONCE: [u32; 4] =
    [Safety::STEERING_REVERSED, Safety::OUT_OF_ENVELOPE, Safety::AREA, Safety::POSE_STANDS];

/// The share of the time without faults that makes up for time with them. A fault that comes and goes adds up: what comes
/// late, as on a machine that is busy for a moment, for more than 3 of 7 parts of the time, and what is wrong for more than a
/// fifth of it.
const FORGIVES_LATE: f64 = 0.75;
const FORGIVES_WRONG: f64 = 0.25;

/// How the vehicle is allowed to drive.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum State {
    /// Commands pass, within limits.
    Normal,
    /// Something is missing or implausible, or the vehicle does not drive as it should: it slows down until all is well
    /// again.
    Degraded,
    /// That lasted too long: the vehicle stops, as the [`Ladder`](crate::Ladder) says.
    Stopping,
    /// The vehicle stands; only a rearm lets it drive again.
    Stopped,
}

impl State {
    /// The state's number on the wire: [`Safety::NORMAL`] or one of the values after it.
    pub fn number(self) -> u32 {
        match self {
            Self::Normal => Safety::NORMAL,
            Self::Degraded => Safety::DEGRADED,
            Self::Stopping => Safety::STOPPING,
            Self::Stopped => Safety::STOPPED,
        }
    }

    /// Whether only a rearm leads back to normal.
    pub fn is_latched(self) -> bool {
        matches!(self, Self::Stopping | Self::Stopped)
    }
}

/// The state machine. Faults are the bits of [`Safety::reasons`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Guard {
    state: State,
    reasons: u32,
    /// Time with faults, less a share of the time without since then.
    faulty_s: f64,
    forgives: f64,
    degraded_limit_s: f64,
    standstill_mps: f64,
}

impl Guard {
    /// A guard that has seen no fault.
    pub fn new(config: &RunConfig) -> Self {
        let safety = config.vehicle.safety;
        Self {
            state: State::Normal,
            reasons: 0,
            faulty_s: 0.0,
            forgives: FORGIVES_LATE,
            degraded_limit_s: safety.degraded_limit_s,
            standstill_mps: safety.standstill_mps,
        }
    }

    /// Takes the present faults, `dt_s` after the last call, with the speeds of the last command and of the
    /// vehicle.
    pub fn update(
        &mut self,
        dt_s: f64,
        faults: u32,
        commanded_mps: f64,
        measured_mps: f64,
    ) -> State {
        match self.state {
            State::Normal | State::Degraded if faults & !Safety::TOLD == 0 => {
                self.faulty_s = (self.faulty_s - self.forgives * dt_s).max(0.0);
                if self.faulty_s == 0.0 {
                    self.forgives = FORGIVES_LATE;
                }
                self.reasons = faults;
                self.state = State::Normal;
            }
            State::Normal | State::Degraded => {
                self.faulty_s += dt_s;
                let late = [Safety::COMMAND_STALE, Safety::ODOMETRY_STALE];
                if late.iter().fold(faults & !Safety::TOLD, |left, late| left & !late) != 0 {
                    self.forgives = FORGIVES_WRONG;
                }
                self.reasons = faults;
                let stops = self.faulty_s > self.degraded_limit_s
                    || AT_ONCE.iter().any(|it| faults & it != 0);
                self.state = if stops { State::Stopping } else { State::Degraded };
            }
            State::Stopping => {
                // A negative command only brakes.
                let stands = self.stands(commanded_mps.max(0.0), measured_mps);
                // A speed that has not been measured lately says nothing.
                if stands && faults & Safety::ODOMETRY_STALE == 0 {
                    self.state = State::Stopped;
                }
            }
            State::Stopped => {}
        }
        self.state
    }

    /// Whether these speeds, of the last command and of the vehicle, are those of a vehicle that stands.
    pub fn stands(&self, commanded_mps: f64, measured_mps: f64) -> bool {
        commanded_mps.abs().max(measured_mps.abs()) < self.standstill_mps
    }

    /// Stops the vehicle for good.
    pub fn stop(&mut self, reasons: u32) {
        self.reasons |= reasons;
        if !self.state.is_latched() {
            self.state = State::Stopping;
        }
    }

    /// Lets a stopped vehicle drive again, if nothing is wrong except what is unavoidable while it stands: that the
    /// controller's reference stands still. Returns whether it does. That it has no leg of the path to drive on is kept
    /// as a reason until the next try.
    pub fn rearm(&mut self, faults: u32) -> bool {
        let ready = self.state == State::Stopped && faults & !Safety::COMMAND_STALE == 0;
        if ready {
            (self.state, self.reasons) = (State::Normal, 0);
            (self.faulty_s, self.forgives) = (0.0, FORGIVES_LATE);
        } else if self.state.is_latched() {
            self.reasons = (self.reasons | Safety::NO_LEG) & (faults | !Safety::NO_LEG);
        }
        ready
    }

    /// The state.
    pub fn state(&self) -> State {
        self.state
    }

    /// What is wrong now, or was when the vehicle was stopped.
    pub fn reasons(&self) -> u32 {
        self.reasons
    }
}
