//! The ladder: what is done about an alarm, from the gentlest action to the hardest.
//!
//! What raised the alarm decides what is done, because it decides what can still be trusted:
//! - the vehicle is carried off, or its measurement is worse than it was, but it steers as it should: [`Action::Rest`];
//! - it leaves its path, or steers or drives in another way than it is told to: [`Action::Brake`]. Its steering is still
//!   the best that there is: a vehicle that understeers stays near its path as long as it is steered;
//! - nobody knows where it is, nobody steers it, or it steers the wrong way round: [`Action::BrakeStraight`].
//!
//! While the steering loop stays closed, the reference must come to rest where the vehicle does; if it ran on, the law
//! would steer for a place that the vehicle never reaches. So its clock comes to rest within the time in which a full
//! brake brings the vehicle to rest. A vehicle that drives on all the same runs away: then the reference goes along with it
//! ([`Watch::clock_rate`](crate::Watch::clock_rate)).
//!
//! Time is the vehicle's, so that a drive is the same on every host.

use config::RunConfig;
use ipc_types::Safety;

use crate::{Channel, State};

/// The speed that is commanded for a full brake, where the vehicle takes a negative speed for one.
const BRAKE_MPS: f64 = -1.0;
/// A clock that slows down starts from at least this speed: a vehicle that hardly moves needs no time.
const LEAST_MPS: f64 = 0.1;
/// So long after the reference has come to rest, a vehicle that was to follow it is braked.
const RESTED_S: f64 = 1.0;

/// What is done about an alarm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Action {
    /// The reference comes to rest, and the vehicle follows it; then it is braked.
    Rest,
    /// A full brake; the law goes on steering.
    Brake,
    /// A full brake, with the wheels straight.
    BrakeStraight,
}

impl Action {
    /// What is done for these bits of [`Safety::reasons`]; `None` if nothing is.
    pub fn of(reasons: u32) -> Option<Self> {
        match reasons {
            _ if reasons & Safety::STRAIGHTENS != 0 => Some(Self::BrakeStraight),
            _ if reasons & Safety::BRAKES != 0 => Some(Self::Brake),
            _ if reasons & Safety::RESTS != 0 => Some(Self::Rest),
            _ => None,
        }
    }

    /// Whether the law goes on steering.
    pub fn is_steered(self) -> bool {
        self != Self::BrakeStraight
    }
}

impl Channel {
    /// Its bit of [`Safety::reasons`], for a drive that it takes out of the envelope.
    pub fn reason(self) -> u32 {
        match self {
            Self::Quality => Safety::OUT_BY_QUALITY,
            Self::LateralError => Safety::OUT_BY_LATERAL_ERROR,
            Self::Along => Safety::OUT_BY_ALONG,
            Self::Lateral => Safety::OUT_BY_LATERAL,
            Self::Yaw => Safety::OUT_BY_YAW,
            Self::Noise => Safety::OUT_BY_NOISE,
        }
    }
}

/// What the vehicle is to be told in a tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Step {
    /// What the law wants.
    Pass,
    /// To slow down gently, with its steering held: what is missing may come back.
    SlowDown,
    /// To brake to this speed, steered by the law.
    Steered {
        /// The speed, 0 or less.
        speed_mps: f64,
    },
    /// To brake to this speed, with its wheels straight.
    Straight {
        /// The speed, 0 or less.
        speed_mps: f64,
    },
    /// To stand.
    Stand,
}

/// The ladder of one vehicle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ladder {
    action: Option<Action>,
    /// The share of its rate at which the reference's clock runs, and how fast that falls.
    share: f64,
    falls_per_s: f64,
    /// For how long the clock has been at rest.
    rested_s: f64,
    /// For how long pose or answers have been missing during an action, less the time with them since then.
    blind_s: f64,
    /// It drives faster than an action allows for.
    runs_away: bool,
    count: u64,
    brake_mps: f64,
    deceleration_mps2: f64,
    blind_limit_s: f64,
    standstill_mps: f64,
}

impl Ladder {
    /// The ladder of a configuration, of which nobody has asked anything.
    pub fn new(config: &RunConfig) -> Self {
        let vehicle = &config.vehicle;
        let safety = vehicle.safety;
        Self {
            action: None,
            share: 1.0,
            falls_per_s: 0.0,
            rested_s: 0.0,
            blind_s: 0.0,
            runs_away: false,
            count: 0,
            brake_mps: BRAKE_MPS.max(-safety.reverse_limit_mps),
            deceleration_mps2: vehicle.brake_decel_mps2.min(safety.full_brake_mps2()),
            blind_limit_s: safety.degraded_limit_s,
            standstill_mps: safety.standstill_mps,
        }
    }

    /// What is being done.
    pub fn action(&self) -> Option<Action> {
        self.action
    }

    /// How many times an action was begun, or a harder one took its place.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// The share of its rate at which the reference's clock is to run on, 0 to 1.
    pub fn share(&self) -> f64 {
        self.share
    }

    /// Whether the vehicle drives on although it is braked, and the law goes on steering it.
    pub fn runs_away(&self) -> bool {
        self.runs_away && self.action.is_some_and(Action::is_steered)
    }

    /// The speed that is commanded for a full brake of a vehicle of this speed. What stands is not told to reverse.
    pub fn brake_mps(&self, speed_mps: f64) -> f64 {
        if speed_mps.abs() >= self.standstill_mps { self.brake_mps } else { 0.0 }
    }

    /// Goes on with an action that a predecessor began: the reference stands by now.
    pub fn resume(&mut self, action: Action) {
        (self.action, self.share) = (Some(action), 0.0);
    }

    /// One tick, `dt_s` after the last one. `reasons` are the guard's, for its state; `faults` what is wrong now;
    /// `speed_mps` the vehicle's speed. Also returns the faults that have made the action a harder one, which are reasons
    /// from now on.
    pub fn step(
        &mut self,
        dt_s: f64,
        (state, reasons): (State, u32),
        faults: u32,
        speed_mps: f64,
    ) -> (Step, u32) {
        let before = self.action;
        let mut harder = 0;
        let wanted = match state {
            State::Normal => {
                (self.action, self.share, self.rested_s, self.blind_s) = (None, 1.0, 0.0, 0.0);
                self.runs_away = false;
                return (Step::Pass, 0);
            }
            State::Stopped => {
                (self.share, self.runs_away) = (0.0, false);
                return (Step::Stand, 0);
            }
            // What is missing may come back within a moment.
            State::Degraded => Action::of(reasons & !Safety::BLIND),
            State::Stopping => {
                let now = self.faults_that_count(dt_s, faults);
                let by_reasons = Action::of(reasons).max(before).unwrap_or(Action::Brake);
                if Action::of(now) > Some(by_reasons) {
                    harder = now;
                }
                Some(by_reasons).max(Action::of(now))
            }
        };
        self.action = before.max(wanted);
        let Some(action) = self.action else {
            self.share = 0.0;
            return (Step::SlowDown, 0);
        };
        if self.action != before {
            self.count += 1;
        }
        self.runs_away |= faults & Safety::SPEED_IGNORED != 0;
        self.slow_clock(dt_s, action, before.is_none(), speed_mps);
        let speed_mps = self.brake_mps(speed_mps);
        let step = match action {
            Action::Rest if self.rested_s < RESTED_S => Step::Pass,
            Action::Rest | Action::Brake => Step::Steered { speed_mps },
            Action::BrakeStraight => Step::Straight { speed_mps },
        };
        (step, harder)
    }

    /// Of what is wrong during a stop, what counts: pose and answers may be missing for a moment.
    fn faults_that_count(&mut self, dt_s: f64, faults: u32) -> u32 {
        let blind = faults & Safety::BLIND;
        let step_s = if blind == 0 { -dt_s } else { dt_s };
        self.blind_s = (self.blind_s + step_s).max(0.0);
        if self.blind_s > self.blind_limit_s { faults } else { faults & !Safety::BLIND }
    }

    fn slow_clock(&mut self, dt_s: f64, action: Action, begins: bool, speed_mps: f64) {
        if begins {
            self.falls_per_s = self.deceleration_mps2 / speed_mps.abs().max(LEAST_MPS);
        }
        self.share = match action {
            Action::BrakeStraight => 0.0,
            _ => (self.share - self.falls_per_s * dt_s).max(0.0),
        };
        if self.share == 0.0 {
            self.rested_s += dt_s;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::Layers;

    const TICK_S: f64 = 0.01;

    fn ladder(sets: &[&str]) -> Ladder {
        let mut layers = Layers::maneuver("circuit").unwrap();
        for set in sets {
            layers.set(set).unwrap();
        }
        Ladder::new(&layers.resolve().unwrap())
    }

    /// Some ticks of a stop for these reasons at 2 m/s, with nothing else wrong; the last step.
    fn stop(ladder: &mut Ladder, reasons: u32, ticks: u32) -> Step {
        (0..ticks).fold(Step::Pass, |_, _| {
            let (step, harder) = ladder.step(TICK_S, (State::Stopping, reasons), 0, 2.0);
            assert_eq!(harder, 0);
            step
        })
    }

    fn near(a: f64, b: f64) -> bool {
        (a - b).abs() < 1e-12
    }

    #[test]
    fn each_channel_and_each_reason_has_its_action() {
        for channel in Channel::ALL {
            let wanted = match channel {
                Channel::Quality | Channel::LateralError | Channel::Yaw => Action::Brake,
                Channel::Along | Channel::Lateral | Channel::Noise => Action::Rest,
            };
            assert_eq!(Action::of(channel.reason()), Some(wanted), "{channel:?}");
        }
        for (reasons, wanted) in [
            (0, None),
            (Safety::STANDS | Safety::NO_LEG, None),
            (Safety::PATH_DISTANCE, Some(Action::Brake)),
            (Safety::PATH_HEADING, Some(Action::Brake)),
            (Safety::STEERING_IGNORED, Some(Action::Brake)),
            (Safety::SPEED_IGNORED, Some(Action::Brake)),
            (Safety::RESTARTED, Some(Action::Brake)),
            (Safety::STEERING_REVERSED, Some(Action::BrakeStraight)),
            (Safety::COMMAND_STALE, Some(Action::BrakeStraight)),
            (Safety::COMMAND_INVALID, Some(Action::BrakeStraight)),
            (Safety::ODOMETRY_STALE, Some(Action::BrakeStraight)),
            (Safety::ODOMETRY_INVALID, Some(Action::BrakeStraight)),
            (Safety::ODOMETRY_JUMP, Some(Action::BrakeStraight)),
            (Safety::TIME_BACK, Some(Action::BrakeStraight)),
            (Safety::TIME_AHEAD, Some(Action::BrakeStraight)),
            // Of several, the hardest.
            (Safety::OUT_BY_NOISE | Safety::OUT_BY_YAW, Some(Action::Brake)),
            (Safety::OUT_BY_YAW | Safety::STEERING_REVERSED, Some(Action::BrakeStraight)),
        ] {
            assert_eq!(Action::of(reasons), wanted, "{reasons}");
        }
    }

    #[test]
    fn the_clock_rests_when_a_full_brake_would_have_stopped_the_vehicle() {
        let mut ladder = ladder(&[]);
        assert_eq!((ladder.share(), ladder.action()), (1.0, None));
        // 5 m/s² from 2 m/s: 0.4 s.
        assert_eq!(stop(&mut ladder, Safety::OUT_BY_YAW, 10), Step::Steered { speed_mps: -1.0 });
        assert!(near(ladder.share(), 0.75), "{}", ladder.share());
        stop(&mut ladder, Safety::OUT_BY_YAW, 29);
        assert!(near(ladder.share(), 0.025), "{}", ladder.share());
        stop(&mut ladder, Safety::OUT_BY_YAW, 2);
        assert_eq!((ladder.share(), ladder.count()), (0.0, 1));
        assert_eq!(ladder.action(), Some(Action::Brake));
    }

    #[test]
    fn a_vehicle_that_hardly_moves_waits_for_no_clock_and_is_not_told_to_reverse() {
        let mut ladder = ladder(&[]);
        let stopping = (State::Stopping, Safety::PATH_DISTANCE);
        let (step, _) = ladder.step(TICK_S, stopping, 0, 0.0);
        assert_eq!(step, Step::Steered { speed_mps: 0.0 });
        assert!(near(ladder.share(), 0.5), "{}", ladder.share());
    }

    #[test]
    fn what_the_vehicle_can_do_bounds_brake_and_clock() {
        let mut gentle = ladder(&[
            "vehicle.safety.reverse_limit_mps=0.0",
            "vehicle.safety.deceleration_limit_mps2=2.5",
        ]);
        assert_eq!(stop(&mut gentle, Safety::OUT_BY_YAW, 10), Step::Steered { speed_mps: 0.0 });
        assert!(near(gentle.share(), 0.875), "{}", gentle.share());
        let mut half = ladder(&["vehicle.safety.reverse_limit_mps=0.5"]);
        assert_eq!(stop(&mut half, Safety::COMMAND_STALE, 1), Step::Straight { speed_mps: -0.5 });
    }

    #[test]
    fn a_vehicle_that_follows_its_reference_to_rest_is_braked_in_the_end() {
        let mut ladder = ladder(&[]);
        // 0.4 s for the clock, and a second.
        assert_eq!(stop(&mut ladder, Safety::OUT_BY_NOISE, 137), Step::Pass);
        assert_eq!((ladder.share(), ladder.action()), (0.0, Some(Action::Rest)));
        assert_eq!(stop(&mut ladder, Safety::OUT_BY_NOISE, 3), Step::Steered { speed_mps: -1.0 });
        assert_eq!(ladder.count(), 1);
    }

    #[test]
    fn with_the_wheels_straight_the_reference_stands_at_once() {
        let mut ladder = ladder(&[]);
        let step = stop(&mut ladder, Safety::STEERING_REVERSED, 1);
        assert_eq!((step, ladder.share()), (Step::Straight { speed_mps: -1.0 }, 0.0));
        assert!(Action::Brake.is_steered() && !Action::BrakeStraight.is_steered());
    }

    #[test]
    fn a_moment_slows_down_what_is_blind_and_brakes_what_leaves_its_path() {
        let mut ladder = ladder(&[]);
        let blind = (State::Degraded, Safety::COMMAND_STALE);
        assert_eq!(ladder.step(TICK_S, blind, Safety::COMMAND_STALE, 2.0), (Step::SlowDown, 0));
        assert_eq!((ladder.share(), ladder.action(), ladder.count()), (0.0, None, 0));
        assert_eq!(ladder.step(TICK_S, (State::Normal, 0), 0, 2.0), (Step::Pass, 0));
        assert_eq!(ladder.share(), 1.0);
        let astray = (State::Degraded, Safety::STEERING_IGNORED | Safety::COMMAND_STALE);
        let (step, harder) = ladder.step(TICK_S, astray, astray.1, 2.0);
        assert_eq!((step, harder), (Step::Steered { speed_mps: -1.0 }, 0));
        assert_eq!(ladder.count(), 1);
        // All is well again.
        assert_eq!(ladder.step(TICK_S, (State::Normal, 0), 0, 2.0), (Step::Pass, 0));
        assert_eq!((ladder.share(), ladder.action(), ladder.count()), (1.0, None, 1));
    }

    #[test]
    fn the_action_becomes_harder_and_never_gentler() {
        let mut ladder = ladder(&[]);
        stop(&mut ladder, Safety::OUT_BY_ALONG, 5);
        let rests = (State::Stopping, Safety::OUT_BY_ALONG);
        let (step, harder) = ladder.step(TICK_S, rests, Safety::PATH_DISTANCE, 2.0);
        assert_eq!((step, harder), (Step::Steered { speed_mps: -1.0 }, Safety::PATH_DISTANCE));
        // The clock goes on slowing down from where it was.
        assert!(near(ladder.share(), 0.85), "{}", ladder.share());
        assert_eq!(stop(&mut ladder, Safety::OUT_BY_ALONG, 1), Step::Steered { speed_mps: -1.0 });
        let (step, harder) = ladder.step(TICK_S, rests, Safety::STEERING_REVERSED, 2.0);
        assert_eq!((step, harder), (Step::Straight { speed_mps: -1.0 }, Safety::STEERING_REVERSED));
        assert_eq!(ladder.count(), 3);
    }

    #[test]
    fn answers_may_be_missing_for_a_moment_during_a_stop() {
        let mut ladder = ladder(&["vehicle.safety.degraded_limit_s=0.025"]);
        let stopping = (State::Stopping, Safety::OUT_BY_YAW);
        let mut step = |faults: u32| ladder.step(TICK_S, stopping, faults, 2.0);
        let steered = Step::Steered { speed_mps: -1.0 };
        assert_eq!(step(Safety::COMMAND_STALE), (steered, 0));
        assert_eq!(step(Safety::ODOMETRY_JUMP), (steered, 0));
        assert_eq!(step(0), (steered, 0));
        assert_eq!(step(Safety::COMMAND_STALE), (steered, 0));
        let straight = Step::Straight { speed_mps: -1.0 };
        assert_eq!(step(Safety::COMMAND_STALE), (straight, Safety::COMMAND_STALE));
        assert_eq!(step(0), (straight, 0));
    }

    #[test]
    fn it_goes_on_with_what_a_predecessor_began_and_stands_in_the_end() {
        let mut ladder = ladder(&[]);
        ladder.resume(Action::BrakeStraight);
        assert_eq!((ladder.share(), ladder.action()), (0.0, Some(Action::BrakeStraight)));
        let step = stop(&mut ladder, Safety::RESTARTED, 1);
        assert_eq!(step, Step::Straight { speed_mps: -1.0 });
        let stopped = ladder.step(TICK_S, (State::Stopped, Safety::RESTARTED), 0, 0.0);
        assert_eq!((stopped, ladder.share()), ((Step::Stand, 0), 0.0));
        // A stop for what has no action of its own is a brake.
        let mut ladder = Ladder { action: None, ..ladder };
        assert_eq!(stop(&mut ladder, 0, 1), Step::Steered { speed_mps: -1.0 });
    }
}
