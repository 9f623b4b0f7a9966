//! Dead-time compensation: a law sees the car where it will be when its command takes effect.
//!
//! The pose is predicted over the dead time and the lag of the steering, with the commands that are on the way through the
//! steering's gain, offset, rate and lag, at the measured speed, on a kinematic car. The known offset and gain of the
//! steering are taken out of the command. This is the predictor of Smith (1957) for a process whose model is the car's
//! file; odometry that is late counts as dead time of the steering.

use config::RunConfig;
use tracking::{DelayLine, Part, Pose, Reference, SteeringActuator, SteeringStep, Turning};

use crate::Sight;
use crate::laws::{LawState, RawCommand};
use crate::sight::Points;

/// What is known about the steering of one car: its commands on the way, and what its wheels will do by them.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Compensation {
    /// The steering over a tick.
    steering: SteeringStep,
    gain: f64,
    offset_rad: f64,
    command_limit_rad: f64,
    points: Points,
    turning: Turning,
    tick_s: f64,
    /// Ticks until a command reaches the wheels, and until they have followed it by the most part.
    delay_ticks: usize,
    lag_ticks: usize,
    /// As many as the dead time needs. The oldest one has arrived: it tells where the wheels are now.
    on_the_way: DelayLine<Given>,
}

/// A command, and what it does in the tick in which it arrives at the wheels. That does not change while it is on its way.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Given {
    command_rad: f64,
    /// The angle of the road wheels at the end of that tick.
    wheels_rad: f64,
    /// By what the car turns in it; see [`Turning::tangent`].
    tangent: f64,
}

impl Compensation {
    /// For the vehicle of a configuration, at the start of a drive; `None` if the configuration does not want it, or the
    /// steering has nothing to compensate.
    pub(crate) fn new(config: &RunConfig) -> Option<Self> {
        let vehicle = &config.vehicle;
        let tick_s = config.drive.tick_s;
        let ticks = |time_s: f64| (time_s / tick_s).round() as usize;
        let (delay_ticks, lag_ticks) =
            (ticks(vehicle.steering_delay_s), ticks(vehicle.steering_lag_s));
        let is_plain = delay_ticks + lag_ticks == 0
            && vehicle.steering_gain == 1.0
            && vehicle.steering_offset_rad == 0.0;
        if is_plain || !config.controller.compensate_dead_time {
            return None;
        }
        let part = Part { length_s: tick_s, ago: [delay_ticks] };
        let none = Given { command_rad: 0.0, wheels_rad: 0.0, tangent: 0.0 };
        let mut new = Self {
            steering: SteeringStep::new(SteeringActuator::new(vehicle), tick_s),
            gain: vehicle.steering_gain,
            offset_rad: vehicle.steering_offset_rad,
            command_limit_rad: config.controller.steering_limit_rad,
            points: Points::new(vehicle),
            turning: Turning::new(vehicle),
            tick_s,
            delay_ticks,
            lag_ticks,
            on_the_way: DelayLine::new(&[part], none),
        };
        new.restart(0.0);
        Some(new)
    }

    /// Forgets everything except the angle that was commanded last, for long enough that the wheels are there.
    pub(crate) fn restart(&mut self, command_rad: f64) {
        self.rest(self.steering.actuator().target_rad(command_rad), command_rad);
    }

    /// Forgets everything: a command has arrived, and the wheels are at an angle.
    fn rest(&mut self, wheels_rad: f64, command_rad: f64) {
        let tangent = self.turning.tangent([wheels_rad; 2]);
        self.on_the_way.reset(Given { command_rad, wheels_rad, tangent });
    }

    /// What a command does in the tick after another one.
    #[inline]
    fn after(&self, before: Given, command_rad: f64) -> Given {
        let wheels_rad = self.steering.turn(before.wheels_rad, command_rad);
        let tangent = self.turning.tangent([before.wheels_rad, wheels_rad]);
        Given { command_rad, wheels_rad, tangent }
    }

    /// The steering angle that a law wants of the wheels when the car was commanded this angle.
    pub(crate) fn wanted_rad(&self, command_rad: f64) -> f64 {
        self.gain * command_rad + self.offset_rad
    }

    /// Where the reference and the car will be when the command of this tick takes effect, as the law's sight.
    ///
    /// `reference` is room for a copy of the reference.
    pub(crate) fn look_ahead<'a>(&self, sight: &Sight, reference: &'a mut Reference) -> Sight<'a> {
        // The yaw rate comes as much later than the wheels.
        let late_s = self.turning.late_s(sight.speed_mps);
        let ticks = (self.delay_ticks + self.lag_ticks) as f64 + late_s / self.tick_s;
        let pose = self.predict(sight.pose, sight.speed_mps, sight.yaw_rate_radps, late_s);
        sight.ahead(reference, ticks, pose)
    }

    /// The pose of the tracked point after the dead time, the lag, and `late_s` more. A car that turns late turns as it does
    /// now, and comes to what its wheels ask for later; the yaw rate of now is the measured one.
    fn predict(&self, pose: Pose, speed_mps: f64, yaw_rate_radps: f64, late_s: f64) -> Pose {
        let now = self.on_the_way.given(self.delay_ticks);
        let mut turning = self.turning;
        turning.set(yaw_rate_radps, turning.asked_radps(now.wheels_rad, speed_mps));
        let mut moving = Moving::new(pose, self.points.tracked_m(speed_mps));
        let tick = turning.step(speed_mps, self.tick_s);
        let mut last = now;
        for ago in (0..self.delay_ticks).rev() {
            last = self.on_the_way.given(ago);
            let asked_radps = turning.asked_by(last.tangent, speed_mps);
            moving.step(speed_mps * self.tick_s, turning.turn_over(asked_radps, &tick));
        }
        // All have arrived: the newest one is held.
        for _ in 0..self.lag_ticks {
            last = self.after(last, last.command_rad);
            let asked_radps = turning.asked_by(last.tangent, speed_mps);
            moving.step(speed_mps * self.tick_s, turning.turn_over(asked_radps, &tick));
        }
        if late_s > 0.0 {
            let Given { command_rad, wheels_rad, .. } = last;
            let turned_rad = self.steering.actuator().turn(wheels_rad, command_rad, late_s);
            let turn_rad = turning.turn_evenly([wheels_rad, turned_rad], speed_mps, late_s);
            moving.step(speed_mps * late_s, turn_rad);
        }
        moving.pose()
    }

    /// Turns what a law wants of the wheels into the command that gives it, and notes that it was given.
    pub(crate) fn give(&mut self, wanted: RawCommand) -> RawCommand {
        let limit_rad = self.command_limit_rad;
        let command_rad = (wanted.steering_rad - self.offset_rad) / self.gain;
        let steering_rad = command_rad.clamp(-limit_rad, limit_rad);
        self.on_the_way.push(self.after(self.on_the_way.given(0), steering_rad));
        RawCommand { steering_rad, ..wanted }
    }

    /// Adds what a successor needs to a law's state: the angle of the wheels, and the commands on the way from the newest
    /// one on, as far as there is room.
    pub(crate) fn add_to(&self, law: &LawState) -> LawState {
        let mut numbers = law.numbers().to_vec();
        numbers.push(self.on_the_way.given(self.delay_ticks).wheels_rad);
        let room = LawState::MOST - numbers.len();
        let commands = (0..=self.delay_ticks).map(|ago| self.on_the_way.given(ago).command_rad);
        numbers.extend(commands.take(room));
        LawState::of(&numbers)
    }

    /// Goes on from what [`Compensation::add_to`] added behind the `count` numbers of the law.
    pub(crate) fn resume(&mut self, state: &LawState, count: usize) {
        let Some((wheels_rad, given)) = state.numbers().get(count..).and_then(<[f64]>::split_first)
        else {
            return;
        };
        let within = |angle_rad: f64, limit_rad: f64| angle_rad.clamp(-limit_rad, limit_rad);
        let limit_rad = self.command_limit_rad;
        // What did not fit is taken to be the oldest that did.
        let oldest = given.last().copied().unwrap_or_default();
        let command_rad = |ago: usize| within(given.get(ago).copied().unwrap_or(oldest), limit_rad);
        self.rest(within(*wheels_rad, std::f64::consts::FRAC_PI_2), command_rad(self.delay_ticks));
        for ago in (0..self.delay_ticks).rev() {
            self.on_the_way.push(self.after(self.on_the_way.given(0), command_rad(ago)));
        }
    }
}

/// A car that moves where it points: the point of it that does so, and how far the tracked one lies ahead.
struct Moving {
    pose: Pose,
    /// Sine and cosine of the yaw.
    direction: (f64, f64),
    tracked_m: f64,
}

impl Moving {
    fn new(tracked: Pose, tracked_m: f64) -> Self {
        let at = tracked.ahead(-tracked_m);
        let pose = Pose { x_m: at.x, y_m: at.y, yaw_rad: tracked.yaw_rad };
        Self { pose, direction: libm::sincos(tracked.yaw_rad), tracked_m }
    }

    /// Moves along an arc of a length, which turns by an angle: along its chord.
    #[inline]
    fn step(&mut self, length_m: f64, turn_rad: f64) {
        let half = direction_of(0.5 * turn_rad);
        let (sin, cos) = turned(self.direction, half);
        self.direction = turned((sin, cos), half);
        self.pose.x_m += length_m * cos;
        self.pose.y_m += length_m * sin;
        self.pose.yaw_rad += turn_rad;
    }

    /// The pose of the tracked point.
    fn pose(&self) -> Pose {
        let at = self.pose.ahead(self.tracked_m);
        Pose { x_m: at.x, y_m: at.y, yaw_rad: self.pose.yaw_rad }
    }
}

/// Sine and cosine of the sum of two angles.
#[inline]
fn turned((sin_a, cos_a): (f64, f64), (sin_b, cos_b): (f64, f64)) -> (f64, f64) {
    (sin_a * cos_b + cos_a * sin_b, cos_a * cos_b - sin_a * sin_b)
}

/// Sine and cosine of an angle that is mostly small: of half a turn in a tick. The series are exact to 1e-16 there.
#[inline]
fn direction_of(angle_rad: f64) -> (f64, f64) {
    const SMALL_RAD: f64 = 0.02;
    if angle_rad.abs() > SMALL_RAD {
        return libm::sincos(angle_rad);
    }
    let square = angle_rad * angle_rad;
    (
        angle_rad * (1.0 - square / 6.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0))),
        1.0 - square / 2.0 * (1.0 - square / 12.0 * (1.0 - square / 30.0)),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::Layers;
    use tracking::SteeringChain;

    fn config(sets: &[&str]) -> RunConfig {
        let mut layers = Layers::maneuver("lane_change").unwrap();
        layers.set("controller.compensate_dead_time=true").unwrap();
        for set in sets {
            layers.set(set).unwrap();
        }
        layers.resolve().unwrap()
    }

    /// A kinematic car behind the steering of a configuration, at a constant speed.
    struct Car {
        steering: SteeringChain,
        rear: Pose,
        rear_slip_s2pm: f64,
        turning: Turning,
    }

    impl Car {
        fn tick(&mut self, command_rad: f64, speed_mps: f64) {
            let before_rad = self.steering.angle_rad();
            let after_rad = self.steering.step(command_rad);
            let turn_rad = self.turning.turn_evenly([before_rad, after_rad], speed_mps, 0.01);
            let heading_rad = self.rear.yaw_rad + 0.5 * turn_rad;
            self.rear.x_m += 0.01 * speed_mps * libm::cos(heading_rad);
            self.rear.y_m += 0.01 * speed_mps * libm::sin(heading_rad);
            let out_m = self.rear_slip_s2pm * speed_mps * speed_mps * turn_rad;
            self.rear.x_m += out_m * libm::sin(heading_rad);
            self.rear.y_m -= out_m * libm::cos(heading_rad);
            self.rear.yaw_rad += turn_rad;
        }

        fn tracked(&self) -> Pose {
            let at = self.rear.ahead(0.7);
            Pose { x_m: at.x, y_m: at.y, yaw_rad: self.rear.yaw_rad }
        }
    }

    #[test]
    fn the_pose_is_predicted_to_where_the_car_is_when_the_command_arrives() {
        predicts("vehicle.rear_slip_s2pm=0.0", 1e-9);
        // The point that stands for a rear axle that slips is exact but for a turn within a tick.
        predicts("vehicle.rear_slip_s2pm=0.004", 1e-5);
        predicts("vehicle.yaw_lag_s2pm=0.005", 1e-9);
        predicts("vehicle.understeer_s2pm=0.002", 1e-9);
    }

    fn predicts(slip: &str, exact_m: f64) {
        let config = config(&[
            slip,
            "vehicle.steering_delay_s=0.2",
            "vehicle.steering_lag_s=0.1",
            "vehicle.steering_gain=1.1",
            "vehicle.steering_offset_rad=0.02",
        ]);
        let mut compensation = Compensation::new(&config).unwrap();
        let mut car = Car {
            steering: SteeringChain::new(&config.vehicle, 0.01),
            rear: Pose::default(),
            rear_slip_s2pm: config.vehicle.rear_slip_s2pm,
            turning: Turning::new(&config.vehicle),
        };
        car.turning.set(0.0, car.turning.asked_radps(car.steering.angle_rad(), 3.5));
        let mut predicted = Vec::new();
        let mut driven = Vec::new();
        for tick in 0..400 {
            driven.push(car.tracked());
            // Over the dead time alone the prediction has to be exact: nothing after it has been commanded yet.
            let over_delay = Compensation { lag_ticks: 0, ..compensation.clone() };
            predicted.push(over_delay.predict(
                car.tracked(),
                3.5,
                car.turning.yaw_rate_radps(),
                0.0,
            ));
            let wanted_rad = 0.3 * libm::sin(0.05 * f64::from(tick));
            let wanted = RawCommand { steering_rad: wanted_rad, ..RawCommand::default() };
            let given = compensation.give(wanted);
            // Gain and offset are taken out: these wheels come to what was wanted.
            assert!((1.1 * given.steering_rad + 0.02 - wanted_rad).abs() < 1e-12);
            car.tick(given.steering_rad, 3.5);
        }
        for (predicted, driven) in predicted.iter().zip(&driven[20..]) {
            let apart_m = libm::hypot(predicted.x_m - driven.x_m, predicted.y_m - driven.y_m);
            assert!(apart_m < exact_m, "{apart_m} m");
            assert!((predicted.yaw_rad - driven.yaw_rad).abs() < 1e-9);
        }
    }

    #[test]
    fn small_turns_add_up_to_large_ones() {
        for (turn_rad, steps) in [(1e-9, 100), (0.01, 150), (0.04, 50), (-0.039, 50), (0.3, 9)] {
            let mut moving = Moving::new(Pose { x_m: 1.0, y_m: 2.0, yaw_rad: 0.4 }, 0.7);
            (0..steps).for_each(|_| moving.step(0.05, turn_rad));
            let all_rad = f64::from(steps) * turn_rad;
            let yaw_rad = 0.4 + all_rad;
            let (sin, cos) = moving.direction;
            assert!((sin - libm::sin(yaw_rad)).abs() < 1e-14, "{turn_rad}");
            assert!((cos - libm::cos(yaw_rad)).abs() < 1e-14, "{turn_rad}");
            // A polygon in a circle: its last corner lies at the end of one chord.
            let chord_m = 0.05 * libm::sin(0.5 * all_rad) / libm::sin(0.5 * turn_rad);
            let (sin, cos) = libm::sincos(0.5 * (0.4 + yaw_rad));
            let from = Pose { x_m: 1.0, y_m: 2.0, yaw_rad: 0.4 }.ahead(-0.7);
            let at = moving.pose;
            assert!((at.x_m - from.x - chord_m * cos).abs() < 1e-12, "{turn_rad}");
            assert!((at.y_m - from.y - chord_m * sin).abs() < 1e-12, "{turn_rad}");
        }
    }

    #[test]
    fn a_successor_knows_the_commands_on_the_way_as_far_as_there_is_room() {
        for (delay, exact) in [("0.3", true), ("0.9", false)] {
            let delay = format!("vehicle.steering_delay_s={delay}");
            let mut compensation = Compensation::new(&config(&[&delay])).unwrap();
            let fresh = compensation.clone();
            for tick in 0..200 {
                let steering_rad = 0.2 * libm::sin(0.1 * f64::from(tick));
                compensation.give(RawCommand { steering_rad, ..RawCommand::default() });
            }
            let state = compensation.add_to(&LawState::of(&[0.5]));
            let mut successor = fresh;
            successor.resume(&state, 1);
            let pose = |it: &Compensation| it.predict(Pose::default(), 3.0, 0.0, 0.0);
            let (wanted, found) = (pose(&compensation), pose(&successor));
            let apart_m = libm::hypot(wanted.x_m - found.x_m, wanted.y_m - found.y_m);
            assert_eq!(apart_m == 0.0, exact, "{delay}: {apart_m} m");
            assert!(apart_m < 0.2, "{delay}: {apart_m} m");
        }
    }

    #[test]
    fn a_car_without_delay_lag_gain_and_offset_needs_none_and_who_does_not_want_it_has_none() {
        assert_eq!(Compensation::new(&config(&[])), None);
        let delay = "vehicle.steering_delay_s=0.2";
        assert!(Compensation::new(&config(&[delay])).is_some());
        assert_eq!(
            Compensation::new(&config(&[delay, "controller.compensate_dead_time=false"])),
            None
        );
    }
}
