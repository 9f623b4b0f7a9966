//! The vehicle model: single track (its lateral half is `lateral`), steering chain, speed PI to throttle and brake, pedal
//! lag, gear selector, dead times of both commands.
//!
//! Pure: the seed is an argument, one call of [`SimulatedVehicle::step`] is one tick. The state lives at
//! the rear axle; what is reported is the tracked point, `tracked_point_m` ahead of it.
//!
//! A tick is one step of integration, unless a dead time is no whole number of ticks. Then the tick is cut where a command
//! arrives, and each part is a step of its own: a command acts as it was given, only later.

use std::sync::Arc;

use config::{Noise, RunConfig, Vehicle};
use tracking::{DelayLine, Part, Pose, SteeringActuator, SteeringStep, parts_of_tick};

use crate::lateral::Lateral;
use crate::noise::PoseNoise;
use crate::road::Road;

/// What the vehicle's sensors report at one tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observation {
    /// Pose of the tracked point as measured, in the map frame.
    pub measured: Pose,
    /// True pose of the tracked point, in the map frame.
    pub truth: Pose,
    /// Forward speed of the rear axle.
    pub speed_mps: f64,
    /// Yaw rate.
    pub yaw_rate_radps: f64,
    /// Angle of the road wheels, positive to the left.
    pub steering_rad: f64,
    /// Whether the body has left the road.
    pub collision: bool,
}

/// One simulated vehicle.
#[derive(Debug, Clone)]
pub struct SimulatedVehicle {
    /// Shared by a fleet, so that the state of each vehicle fits into the nearest cache.
    kind: Arc<Kind>,
    road: Option<Road>,
    noise: Option<Box<PoseNoise>>,
    gear: GearSelector,
    lateral: Lateral,
    /// Without dead times, nothing is on the way; boxed, so that it takes no room in the cache then.
    on_the_way: Option<Box<DelayLine<Commanded>>>,

    rear_axle: Pose,
    speed_mps: f64,
    yaw_rate_radps: f64,
    steering_rad: f64,
    /// ki times the integral of the speed's error.
    integral: f64,
    throttle: f64,
    brake: f64,
}

/// The part of a vehicle that never changes.
#[derive(Debug)]
struct Kind {
    vehicle: Vehicle,
    noise: Noise,
    /// The parts of a tick; a single one if dead times are whole numbers of ticks.
    steps: Vec<Step>,
    gear: GearTimes,
    start: Start,
}

/// How a drive begins: at rest, or rolling at a speed that it holds.
#[derive(Debug)]
struct Start {
    speed_mps: f64,
    throttle: f64,
    integral: f64,
}

impl Start {
    fn new(config: &RunConfig) -> Self {
        let (vehicle, speed_mps) = (&config.vehicle, config.drive.start_speed_mps);
        if speed_mps == 0.0 {
            return Self { speed_mps, throttle: 0.0, integral: 0.0 };
        }
        // What holds the speed against drag and rolling resistance; as far as it can, the integral holds it.
        let held_mps2 = vehicle.drag_per_s * speed_mps + vehicle.rolling_decel_mps2;
        let throttle = (held_mps2 / vehicle.throttle_accel_mps2).clamp(0.0, 1.0);
        let bounds = (vehicle.speed_integral_min, vehicle.speed_integral_max);
        let has_integral = vehicle.speed_ki > 0.0;
        let integral = if has_integral { throttle.clamp(bounds.0, bounds.1) } else { 0.0 };
        Self { speed_mps, throttle, integral }
    }
}

/// A command of a tick: forward speed, and steering angle of the road wheels.
#[derive(Debug, Clone, Copy, Default)]
struct Commanded {
    speed_mps: f64,
    steering_rad: f64,
}

/// One step of integration.
#[derive(Debug)]
struct Step {
    part: Part<2>,
    steering: SteeringStep,
    /// Share of its way that a pedal makes in the step.
    pedal_share: f64,
}

impl Step {
    /// The command that acts in this step.
    #[inline]
    fn arrived(&self, given: Commanded, on_the_way: Option<&DelayLine<Commanded>>) -> Commanded {
        let Some(line) = on_the_way else { return given };
        let [speed_ago, steering_ago] = self.part.ago;
        Commanded {
            speed_mps: line.given(speed_ago).speed_mps,
            steering_rad: line.given(steering_ago).steering_rad,
        }
    }
}

impl SimulatedVehicle {
    /// A vehicle of the configured kind at the start of the configured path.
    pub fn new(config: &RunConfig) -> Self {
        let vehicle = config.vehicle.clone();
        let tick_s = config.drive.tick_s;
        let parts = parts_of_tick([vehicle.speed_delay_s, vehicle.steering_delay_s], tick_s);
        let is_delayed = vehicle.speed_delay_s > 0.0 || vehicle.steering_delay_s > 0.0;
        let steering = SteeringActuator::new(&vehicle);
        let pedal_share = |step_s: f64| 1.0 - libm::exp(-step_s / vehicle.pedal_lag_s);
        let mut new = Self {
            road: Road::new(config),
            noise: None,
            gear: GearSelector::new(&vehicle),
            lateral: Lateral::new(&vehicle),
            on_the_way: is_delayed.then(|| Box::new(DelayLine::new(&parts, Commanded::default()))),
            rear_axle: Pose::default(),
            speed_mps: 0.0,
            yaw_rate_radps: 0.0,
            steering_rad: 0.0,
            integral: 0.0,
            throttle: 0.0,
            brake: 0.0,
            kind: Arc::new(Kind {
                noise: config.noise,
                steps: parts
                    .into_iter()
                    .map(|part| Step {
                        pedal_share: pedal_share(part.length_s),
                        steering: SteeringStep::new(steering, part.length_s),
                        part,
                    })
                    .collect(),
                gear: GearTimes::new(&vehicle, tick_s),
                start: Start::new(config),
                vehicle,
            }),
        };
        new.reset(config.path.start.into(), None);
        new
    }

    /// Puts the tracked point at `start`, at rest or rolling straight on at the configured speed, and restarts the noise
    /// from its seed, if there is any.
    pub fn reset(&mut self, start: Pose, noise_seed: Option<u64>) {
        let Kind { vehicle, noise, steps, start: begin, .. } = &*self.kind;
        let back = start.ahead(-vehicle.tracked_point_m);
        self.rear_axle = Pose { x_m: back.x, y_m: back.y, yaw_rad: start.yaw_rad };
        self.noise = noise_seed.map(|seed| Box::new(PoseNoise::new(*noise, seed)));
        self.gear = GearSelector::new(vehicle);
        self.lateral.reset();
        if let Some(on_the_way) = &mut self.on_the_way {
            on_the_way.reset(Commanded { speed_mps: begin.speed_mps, steering_rad: 0.0 });
        }
        self.gear.engaged |= begin.speed_mps > 0.0;
        self.speed_mps = begin.speed_mps;
        self.yaw_rate_radps = 0.0;
        self.steering_rad = steps[0].steering.actuator().target_rad(0.0);
        self.integral = begin.integral;
        self.throttle = begin.throttle;
        self.brake = 0.0;
        if let Some(road) = &mut self.road {
            road.reset();
        }
    }

    /// What the sensors report now. Draws noise: call it once a tick.
    pub fn observe(&mut self) -> Observation {
        let vehicle = &self.kind.vehicle;
        let at = self.rear_axle.ahead(vehicle.tracked_point_m);
        let truth = Pose { x_m: at.x, y_m: at.y, yaw_rad: self.rear_axle.yaw_rad };
        let measured = self.noise.as_mut().map_or(truth, |noise| noise.disturb(truth));
        let collision =
            self.road.as_mut().is_some_and(|road| road.is_left(vehicle, self.rear_axle));
        Observation {
            measured,
            truth,
            speed_mps: self.speed_mps,
            yaw_rate_radps: self.yaw_rate_radps,
            steering_rad: self.steering_rad,
            collision,
        }
    }

    /// Drives one tick with a command: forward speed, and steering angle of the road wheels.
    pub fn step(&mut self, speed_mps: f64, steering_rad: f64) {
        let Kind { vehicle, steps, gear, .. } = &*self.kind;
        let given = Commanded { speed_mps: speed_mps.min(vehicle.speed_limit_mps), steering_rad };
        if let Some(on_the_way) = &mut self.on_the_way {
            on_the_way.push(given);
        }
        let on_the_way = self.on_the_way.as_deref();
        self.gear.update(gear, steps[0].arrived(given, on_the_way).speed_mps, self.speed_mps);
        for step in steps {
            let Commanded { speed_mps: speed_command, steering_rad: steering_command } =
                step.arrived(given, on_the_way);
            let step_s = step.part.length_s;

            let error = speed_command - self.speed_mps;
            self.integral = (self.integral + vehicle.speed_ki * error * step_s)
                .clamp(vehicle.speed_integral_min, vehicle.speed_integral_max);
            let mut pedals = (vehicle.speed_kp * error + self.integral).clamp(-1.0, 1.0);
            if speed_command < 0.0 {
                pedals = pedals.min(0.0);
            }
            self.throttle += step.pedal_share * (pedals.max(0.0) - self.throttle);
            self.brake += step.pedal_share * ((-pedals).max(0.0) - self.brake);

            let mut accel_mps2 =
                -vehicle.drag_per_s * self.speed_mps - vehicle.brake_decel_mps2 * self.brake;
            if self.gear.engaged {
                accel_mps2 += vehicle.throttle_accel_mps2 * self.throttle;
            }
            // Rolling resistance and brake hold a standing car; they do not push it backwards.
            self.speed_mps =
                (self.speed_mps + (accel_mps2 - vehicle.rolling_decel_mps2) * step_s).max(0.0);

            self.steering_rad = step.steering.turn(self.steering_rad, steering_command);
            self.yaw_rate_radps =
                self.lateral.step(&mut self.rear_axle, self.speed_mps, self.steering_rad, step_s);
        }
    }
}

/// The gear selector: drive engages some time after a positive command, later if a negative one put it
/// into reverse before. It acts until drive has engaged once.
#[derive(Debug, Clone)]
struct GearSelector {
    engaged: bool,
    in_reverse: bool,
    /// Ticks until drive engages, once it was requested.
    wait_ticks: Option<u64>,
    tick: u64,
}

/// How long a gear selector takes.
#[derive(Debug)]
struct GearTimes {
    poll_ticks: u64,
    drive_ticks: u64,
    reverse_ticks: u64,
    standing_mps: f64,
}

impl GearTimes {
    fn new(vehicle: &Vehicle, tick_s: f64) -> Self {
        let ticks = |time_s: f64| (time_s / tick_s).round() as u64;
        Self {
            poll_ticks: ticks(vehicle.gear_poll_s).max(1),
            drive_ticks: ticks(vehicle.gear_drive_s),
            reverse_ticks: ticks(vehicle.gear_reverse_s),
            standing_mps: vehicle.gear_speed_mps,
        }
    }
}

impl GearSelector {
    fn new(vehicle: &Vehicle) -> Self {
        Self { engaged: vehicle.gear_engaged, in_reverse: false, wait_ticks: None, tick: 0 }
    }

    fn update(&mut self, times: &GearTimes, speed_command_mps: f64, speed_mps: f64) {
        if self.engaged {
            return;
        }
        let polls = self.tick.is_multiple_of(times.poll_ticks);
        self.tick += 1;
        if let Some(ticks) = &mut self.wait_ticks {
            *ticks = ticks.saturating_sub(1);
        }
        if self.wait_ticks == Some(0) {
            self.engaged = true;
            return;
        }
        if !polls || speed_mps.abs() >= times.standing_mps {
            return;
        }
        if speed_command_mps < 0.0 {
            self.in_reverse = true;
            self.wait_ticks = None;
        } else if speed_command_mps > 0.0 && self.wait_ticks.is_none() {
            let ticks = if self.in_reverse { times.reverse_ticks } else { times.drive_ticks };
            self.wait_ticks = Some(ticks);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::Layers;
    use proptest::prelude::*;

    fn vehicle(sets: &[&str]) -> SimulatedVehicle {
        let mut layers = Layers::maneuver("lane_change").unwrap();
        for set in sets {
            layers.set(set).unwrap();
        }
        SimulatedVehicle::new(&layers.resolve().unwrap())
    }

    fn first_move(mut vehicle: SimulatedVehicle, command: impl Fn(u64) -> f64) -> Option<u64> {
        (0..2000).find(|&tick| {
            vehicle.step(command(tick), 0.0);
            vehicle.observe().speed_mps > 0.0
        })
    }

    #[test]
    fn drive_engages_after_the_selector_s_delay() {
        assert_eq!(first_move(vehicle(&[]), |_| 2.0), Some(200));
        assert_eq!(first_move(vehicle(&["vehicle.gear_engaged=true"]), |_| 2.0), Some(0));
        // A negative command on a poll selects reverse; drive then takes 4 s from the next poll.
        let reversed = first_move(vehicle(&[]), |tick| if tick == 50 { -0.1 } else { 2.0 });
        assert_eq!(reversed, Some(460));
        assert_eq!(first_move(vehicle(&[]), |tick| if tick == 55 { -0.1 } else { 2.0 }), Some(200));
        assert_eq!(first_move(vehicle(&[]), |_| 0.0), None);
    }

    #[test]
    fn a_reset_drive_repeats_bit_for_bit() {
        repeats(vehicle(&["noise.enabled=true"]));
        repeats(vehicle(&["noise.enabled=true", "vehicle.model=dynamic"]));
    }

    fn repeats(mut vehicle: SimulatedVehicle) {
        let mut drive = |seed| {
            vehicle.reset(Pose::default(), Some(seed));
            (0..600)
                .map(|tick| {
                    let seen = vehicle.observe();
                    vehicle.step(1.5, 0.2 * f64::from(tick % 7));
                    [seen.measured.x_m.to_bits(), seen.truth.yaw_rad.to_bits()]
                })
                .collect::<Vec<_>>()
        };
        assert_eq!(drive(3), drive(3));
        assert_ne!(drive(3), drive(4));
    }

    #[test]
    fn steering_left_turns_left() {
        let mut vehicle = vehicle(&["vehicle.gear_engaged=true"]);
        for _ in 0..300 {
            vehicle.step(2.0, 0.3);
        }
        let seen = vehicle.observe();
        assert!(seen.yaw_rate_radps > 0.0 && seen.truth.yaw_rad > 0.0 && seen.truth.y_m > 0.0);
    }

    #[test]
    fn the_steady_circle_has_the_single_track_s_radius() {
        let mut vehicle = vehicle(&["vehicle.gear_engaged=true"]);
        for _ in 0..5000 {
            vehicle.step(2.0, 0.3);
        }
        let seen = vehicle.observe();
        let radius_m = seen.speed_mps / seen.yaw_rate_radps;
        assert!((radius_m - 2.875 / 0.3f64.tan()).abs() < 1e-9);
    }

    /// What a vehicle that is configured like this reports after each of these commands.
    fn drive(sets: &[&str], commands: impl Iterator<Item = (f64, f64)>) -> Vec<Observation> {
        let sets = [&["vehicle.gear_engaged=true"], sets].concat();
        let mut vehicle = vehicle(&sets);
        let step = |(speed_mps, steering_rad)| {
            vehicle.step(speed_mps, steering_rad);
            vehicle.observe()
        };
        commands.map(step).collect()
    }

    #[test]
    fn a_command_takes_as_long_as_its_dead_time_says_also_within_a_tick() {
        // At a speed that no longer changes, the heading tells when the wheels turned.
        let heading = |delay_s: f64| {
            let delay = format!("vehicle.steering_delay_s={delay_s:?}");
            let turn = |tick: u32| (2.0, if tick < 6000 { 0.0 } else { 0.2 });
            let sets = ["vehicle.steering_rate_radps=100.0", &delay];
            let seen = drive(&sets, (0..6200).map(turn));
            let last = seen[seen.len() - 1];
            (last.truth.yaw_rad, last.yaw_rate_radps)
        };
        let (at_once_rad, rate_radps) = heading(0.0);
        for delay_s in [0.01, 0.013, 0.1, 0.1571, 1.0] {
            let late_s = (at_once_rad - heading(delay_s).0) / rate_radps;
            // The wheels turn within the first 2 ms of a part of a tick, which counts as a whole.
            assert!((late_s - delay_s).abs() < 1e-6, "{delay_s}: {late_s}");
        }
    }

    #[test]
    fn the_gear_selector_sees_a_command_when_it_arrives() {
        let late = |delay: &str| first_move(vehicle(&[delay]), |_| 2.0);
        assert_eq!(late("vehicle.speed_delay_s=0.1"), Some(210));
        assert_eq!(late("vehicle.steering_delay_s=0.1"), Some(200));
    }

    #[test]
    fn a_car_that_is_not_aligned_drives_in_a_circle_until_it_is_told_otherwise() {
        let sets = ["vehicle.steering_offset_rad=0.02", "vehicle.steering_gain=0.5"];
        let straight = drive(&sets, (0..2000).map(|_| (2.0, 0.0)));
        assert!(straight[0].steering_rad == 0.02 && straight[1999].yaw_rate_radps > 0.01);
        let corrected = drive(&sets, (0..2000).map(|_| (2.0, -0.04)));
        assert!(corrected[1999].yaw_rate_radps.abs() < 1e-12);
    }

    proptest! {
        #[test]
        fn dead_times_of_whole_ticks_shift_a_drive_exactly(
            commands in prop::collection::vec((-1.0..8.0f64, -0.5..0.5f64, 1usize..50), 1..12),
            speed_ticks in 0usize..100, steering_ticks in 0usize..100, dynamic: bool,
        ) {
            let preset = ["tesla_model_3", "tesla_model_3_dynamic"][usize::from(dynamic)];
            let preset = format!("vehicle_preset={preset}");
            let chain = ["vehicle.steering_lag_s=0.1", "vehicle.steering_dead_band_rad=0.01"];
            let commands: Vec<_> = commands
                .into_iter()
                .flat_map(|(speed, angle, ticks)| vec![(speed, angle); ticks])
                .collect();
            let late = |ticks: usize, tick: usize| tick.checked_sub(ticks).map(|tick| commands[tick]);
            let delays = [
                format!("vehicle.speed_delay_s={}", speed_ticks as f64 * 0.01),
                format!("vehicle.steering_delay_s={}", steering_ticks as f64 * 0.01),
            ];
            let sets = [&preset, chain[0], chain[1], &delays[0], &delays[1]];
            let delayed = drive(&sets, commands.iter().copied());
            let by_hand = drive(&sets[..3], (0..commands.len()).map(|tick| {
                let speed = late(speed_ticks, tick).map_or(0.0, |(speed, _)| speed);
                (speed, late(steering_ticks, tick).map_or(0.0, |(_, angle)| angle))
            }));
            prop_assert_eq!(delayed, by_hand);
        }

        #[test]
        fn the_state_stays_finite_and_within_limits(
            commands in prop::collection::vec((-20.0..20.0f64, -2.0..2.0f64), 1..400),
            dynamic: bool, delay_s in 0.0..0.1f64, lag_s in 0.0..0.2f64,
        ) {
            let preset = ["tesla_model_3", "tesla_model_3_dynamic"][usize::from(dynamic)];
            let mut vehicle = vehicle(&[
                &format!("vehicle_preset={preset}"),
                "vehicle.gear_engaged=true",
                &format!("vehicle.steering_delay_s={delay_s:?}"),
                &format!("vehicle.speed_delay_s={:?}", 0.7 * delay_s),
                &format!("vehicle.steering_lag_s={lag_s:?}"),
            ]);
            let mut steering = 0.0;
            for (speed, angle) in commands {
                vehicle.step(speed, angle);
                let seen = vehicle.observe();
                prop_assert!(seen.truth.is_finite());
                prop_assert!((0.0..=9.0 + 1e-9).contains(&seen.speed_mps));
                prop_assert!((seen.steering_rad - steering).abs() <= 0.6 * 0.01 + 1e-12);
                prop_assert!(seen.steering_rad.abs() <= vehicle.kind.vehicle.steering_limit_rad);
                steering = seen.steering_rad;
            }
        }
    }
}
