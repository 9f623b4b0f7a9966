//! Everything that the supervisor keeps for one vehicle: the movement that is believed, the state, and the gate.

use config::RunConfig;
use ipc_types::{Command, Safety};
use tracking::Pose;

use crate::area::Area;
use crate::envelope::{Alarm, Envelope};
use crate::runaway::Runaway;
use crate::{
    Action, Deviation, Gate, Guard, Ladder, Movement, Passed, Plausibility, RawCommand, Response,
    SpeedGovernor, State, Step,
};

/// The supervisor of one vehicle.
#[derive(Debug, Clone, PartialEq)]
pub struct Watch {
    plausibility: Plausibility,
    /// `None` where they are not watched.
    deviation: Option<Deviation>,
    response: Option<Response>,
    /// Boxed, because it is large, and most drives have none.
    envelope: Option<Box<Envelope>>,
    area: Option<Area>,
    governor: SpeedGovernor,
    guard: Guard,
    ladder: Ladder,
    /// `None` where nobody sees that a vehicle runs away.
    runaway: Option<Runaway>,
    /// The rate of the reference's clock beside a vehicle that runs away.
    kept_rate: Option<f64>,
    /// What the ladder made of the last tick.
    step: Step,
    gate: Gate,
    /// What was wrong with the last odometry.
    odometry_faults: u32,
    /// The last speed that was believed, and what the governor makes of it.
    speed_mps: f64,
    allowed_mps: f64,
    /// The last pose that was believed, and where the reference is along the path.
    pose: Pose,
    along_m: f64,
    changed: u64,
    own: u64,
}

impl Watch {
    /// The supervisor of a configuration, before a vehicle at rest, or rolling where drives begin so.
    pub fn new(config: &RunConfig) -> Self {
        let mut new = Self {
            plausibility: Plausibility::new(config),
            deviation: Deviation::new(config),
            response: Response::new(config),
            envelope: Envelope::at_work(config).map(Box::new),
            area: Area::new(config),
            governor: SpeedGovernor::new(config),
            guard: Guard::new(config),
            ladder: Ladder::new(config),
            runaway: config.watches_response().then(|| Runaway::new(config)),
            kept_rate: None,
            step: Step::Pass,
            gate: Gate::new(config),
            odometry_faults: 0,
            speed_mps: 0.0,
            allowed_mps: config.supervisor.speed_limit_mps,
            pose: config.path.start.into(),
            along_m: 0.0,
            changed: 0,
            own: 0,
        };
        let start_mps = config.drive.start_speed_mps;
        if start_mps > 0.0 {
            new.speed_mps = start_mps;
            new.gate.resume(start_mps, 0.0);
            if let Some(response) = &mut new.response {
                response.resume(start_mps, 0.0);
            }
        }
        new
    }

    /// Goes on with a vehicle that is driving already and of which nothing was known: slowly, until all is well.
    pub fn resume(&mut self, movement: Movement, steering_rad: f64) {
        self.gate.resume(movement.speed_mps, steering_rad);
        if let Some(response) = &mut self.response {
            response.resume(self.gate.speed_mps(), self.gate.steering_rad());
        }
        if let Some(deviation) = &mut self.deviation {
            deviation.lose();
        }
        if let Some(envelope) = &mut self.envelope {
            envelope.lose();
        }
    }

    /// Tells where the reference of a tick is, along the path.
    #[inline]
    pub fn follow(&mut self, along_m: f64) {
        self.along_m = along_m;
        if let Some(envelope) = &mut self.envelope {
            envelope.follow(along_m);
        }
    }

    /// The vehicle tells the truth beside what it measures: it is simulated.
    pub fn tells_truth(&mut self) {
        if let Some(response) = &mut self.response {
            response.tells_truth();
        }
    }

    /// Tells where the reference is, along the path: a vehicle that may be elsewhere than it was is looked for there.
    pub fn look_near(&mut self, along_m: f64) {
        if let Some(deviation) = &mut self.deviation {
            deviation.look_near(along_m);
        }
    }

    /// Takes odometry. What is wrong with it, as bits of [`Safety::reasons`]; 0 if it is believed. `obeys`: the vehicle
    /// follows commands, and does not stop on its own.
    pub fn see(&mut self, tick: u64, movement: Movement, obeys: bool) -> u32 {
        if self.guard.state() == State::Stopped {
            // The vehicle may have been pushed.
            self.plausibility.forget();
            if let Some(response) = &mut self.response {
                response.forgive();
            }
            if let Some(deviation) = &mut self.deviation {
                deviation.lose();
            }
        }
        self.odometry_faults = self.plausibility.check(tick, movement);
        // Whether the vehicle stands does not depend on where it is.
        let only_of_pose = Safety::ODOMETRY_JUMP | Safety::ODOMETRY_INVALID;
        if self.odometry_faults & !only_of_pose == 0 && movement.speed_mps.is_finite() {
            self.speed_mps = movement.speed_mps;
        }
        if self.odometry_faults == 0 {
            self.pose = movement.pose;
            self.allowed_mps = self.governor.allowed_mps(movement.speed_mps);
            if let Some(deviation) = &mut self.deviation {
                deviation.see(movement.pose);
            }
            if let Some(response) = &mut self.response {
                response.see(tick, movement, obeys);
            }
            if let Some(area) = &mut self.area {
                area.see(movement);
            }
            // How a vehicle is stopped is not how good drives drive.
            if let Some(envelope) = &mut self.envelope
                && !self.guard.state().is_latched()
            {
                envelope.see(tick, movement, obeys);
            }
        }
        self.odometry_faults
    }

    /// Takes odometry of which only the speed means something. `faults`: what is wrong with it, as bits of
    /// [`Safety::reasons`].
    pub fn disbelieve(&mut self, faults: u32, speed_mps: f64) {
        self.odometry_faults = faults;
        if speed_mps.is_finite() {
            self.speed_mps = speed_mps;
        }
    }

    /// What is wrong with how the vehicle drives, as bits of [`Safety::reasons`].
    fn drive_faults(&self) -> u32 {
        self.deviation.as_ref().map_or(0, Deviation::faults)
            | self.response.as_ref().map_or(0, Response::faults)
            | self.alarm().map_or(0, |it| it.channel.reason())
            | self.area.as_ref().map_or(0, Area::faults)
    }

    /// The command at a moment `dt_s` after the last one: the raw command, within limits, or one of the
    /// supervisor's own. `faults` are those of the loop, in addition to what the odometry and the numbers show.
    pub fn command(&mut self, dt_s: f64, faults: u32, raw: Option<RawCommand>) -> Passed {
        let usable = raw.filter(|raw| raw.is_finite());
        let missing = match (raw, usable) {
            (_, Some(_)) => 0,
            (Some(_), None) => Safety::COMMAND_INVALID,
            (None, None) => Safety::COMMAND_STALE,
        };
        let mut faults = faults | missing;
        faults |= self.odometry_faults | self.drive_faults();
        if self.guard.state() == State::Stopping && self.action() == Some(Action::Brake) {
            faults |= self.response.as_ref().map_or(0, Response::suspicions);
        }
        let state = self.guard.update(dt_s, faults, self.gate.speed_mps(), self.speed_mps);
        let (step, harder) =
            self.ladder.step(dt_s, (state, self.guard.reasons()), faults, self.speed_mps);
        if harder != 0 {
            self.guard.stop(harder);
        }
        self.step = step;
        self.keep_pace();
        let steering_rad = usable.map_or(f64::NAN, |usable| usable.steering_rad);
        let mut passed = match (step, usable) {
            (Step::Pass, Some(usable)) => self.gate.pass(dt_s, self.allowed_mps, usable),
            (Step::Pass | Step::SlowDown, _) => self.gate.slow_down(dt_s),
            (Step::Steered { speed_mps }, _) => {
                self.gate.brake(dt_s, speed_mps, steering_rad, self.speed_mps)
            }
            (Step::Straight { speed_mps }, _) => {
                self.gate.brake(dt_s, speed_mps, 0.0, self.speed_mps)
            }
            (Step::Stand, _) => self.gate.stop(dt_s),
        };
        passed.change.rejected |= missing == Safety::COMMAND_INVALID;
        if state == State::Normal {
            self.changed += u64::from(passed.change.is_any());
        } else {
            self.own += 1;
        }
        if let Some(response) = &mut self.response {
            response.tell(passed.speed_mps, passed.steering_rad);
        }
        if let Some(envelope) = &mut self.envelope
            && !state.is_latched()
        {
            envelope.tell(passed.steering_rad);
        }
        passed
    }

    /// The reference goes along with a vehicle that runs away.
    fn keep_pace(&mut self) {
        let Some(runaway) = &mut self.runaway else { return };
        self.kept_rate = if self.ladder.runs_away() {
            Some(runaway.clock_rate(self.pose, self.speed_mps, self.along_m))
        } else {
            runaway.lose();
            None
        };
    }

    /// The command at a moment `dt_s` after the last one, once the drive has ended: slower, and straight on. What is
    /// wrong by then no longer matters. A vehicle that was being stopped and still drives, at `measured_mps`, is braked on.
    pub fn end(&mut self, dt_s: f64, measured_mps: f64) -> Passed {
        if self.guard.state() == State::Stopping {
            let speed_mps = self.ladder.brake_mps(measured_mps);
            return self.gate.brake(dt_s, speed_mps, 0.0, measured_mps);
        }
        self.gate.stop(dt_s)
    }

    /// Whether a vehicle of this speed stands, as it was told to.
    pub fn stands(&self, measured_mps: f64) -> bool {
        self.guard.stands(self.gate.speed_mps(), measured_mps)
    }

    /// Stops the vehicle for good.
    pub fn stop(&mut self, reasons: u32) {
        self.guard.stop(reasons);
    }

    /// Goes on with the stop that a predecessor began.
    pub fn resume_stop(&mut self, action: Action) {
        self.guard.stop(Safety::RESTARTED);
        self.ladder.resume(action);
    }

    /// The drive is out of its envelope: since when, and by what.
    pub fn alarm(&self) -> Option<Alarm> {
        self.envelope.as_ref().and_then(|it| it.alarm())
    }

    /// What is being done about an alarm.
    pub fn action(&self) -> Option<Action> {
        self.ladder.action()
    }

    /// What is being done about an alarm, as bits of [`Command::flags`].
    pub fn action_flags(&self) -> u32 {
        match (self.action(), self.step) {
            (None, _) | (_, Step::SlowDown | Step::Stand) => 0,
            (_, Step::Pass) => Command::STEERED,
            (_, Step::Steered { .. }) => Command::BRAKED | Command::STEERED,
            (_, Step::Straight { .. }) => Command::BRAKED,
        }
    }

    /// How many times an action was begun, or a harder one took its place.
    pub fn actions(&self) -> u64 {
        self.ladder.count()
    }

    /// The rate of the reference's clock from the next tick on, where it would be `pace` if all were well.
    pub fn clock_rate(&self, pace: f64) -> f64 {
        self.kept_rate.unwrap_or(pace * self.ladder.share())
    }

    /// Lets a stopped vehicle drive again; returns whether it may. `faults` are those of the loop.
    pub fn rearm(&mut self, faults: u32) -> bool {
        // What was seen of the drive is over once the vehicle stands: it will begin elsewhere than good drives do.
        if self.guard.state() == State::Stopped
            && let Some(envelope) = &mut self.envelope
        {
            envelope.lose();
        }
        let is_rearmed = self.guard.rearm(faults | self.odometry_faults | self.drive_faults());
        if is_rearmed && let Some(deviation) = &mut self.deviation {
            deviation.rearm();
        }
        is_rearmed
    }

    /// Bits of [`Safety::reasons`]: what is wrong now, or was when the vehicle was stopped.
    pub fn reasons(&self) -> u32 {
        self.guard.reasons()
    }

    /// The state.
    pub fn state(&self) -> State {
        self.guard.state()
    }

    /// What the supervisor reports about itself and the last tick.
    pub fn safety(&self) -> Safety {
        Safety {
            steering_rad: self.gate.steering_rad(),
            changed: self.changed,
            own: self.own,
            state: self.guard.state().number(),
            reasons: self.guard.reasons(),
            ..Safety::default()
        }
    }
}
