//! From a steering command to the angle of the road wheels: the chain of a car's steering, and commands on their way
//! through a dead time.
//!
//! A command passes through the chain in this order:
//!
//! 1. *Dead time*: it takes effect `steering_delay_s` after it was given.
//! 2. *Gain and offset*: it asks for the angle `steering_gain` · command + `steering_offset_rad` of the road wheels, which
//!    is brought within ± `steering_limit_rad`. The offset is that of wheels that are not aligned: a car at rest has it,
//!    too.
//! 3. *Dead band*: the wheels stay where they are while that angle is within ± `steering_dead_band_rad` of theirs, and
//!    otherwise aim at the near end of this band. This is the hysteresis of a play.
//! 4. *Lag and rate*: dδ/dt = (aim − δ)/T, with T = `steering_lag_s`, but no faster than ± `steering_rate_radps`. Without
//!    lag the wheels turn at that rate until they are there.
//!
//! The rate limits the wheels themselves and not what the lag is fed with, so that one number is all of the state, and
//! its motion under a command that is held has a closed form. These are the equations of Autoware's planning simulator
//! (`SimModelDelaySteerAcc`), so that dead times, lags, limits and dead bands found for it hold here.

use config::Vehicle;

/// Dead times that are a whole number of ticks but for rounding count as whole.
const ROUNDING_TICKS: f64 = 1e-6;

/// What turns the road wheels of one kind of car: the chain without its dead time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SteeringActuator {
    gain: f64,
    offset_rad: f64,
    limit_rad: f64,
    dead_band_rad: f64,
    lag_s: f64,
    rate_radps: f64,
}

impl SteeringActuator {
    /// That of a vehicle.
    pub fn new(vehicle: &Vehicle) -> Self {
        Self {
            gain: vehicle.steering_gain,
            offset_rad: vehicle.steering_offset_rad,
            limit_rad: vehicle.steering_limit_rad,
            dead_band_rad: vehicle.steering_dead_band_rad,
            lag_s: vehicle.steering_lag_s,
            rate_radps: vehicle.steering_rate_radps,
        }
    }

    /// The angle of the road wheels that a command asks for in the end, but for the dead band.
    pub fn target_rad(&self, command_rad: f64) -> f64 {
        (self.gain * command_rad + self.offset_rad).clamp(-self.limit_rad, self.limit_rad)
    }

    /// The angle of the road wheels `held_s` later, while a command is held: exact, however long that is.
    #[inline]
    pub fn turn(&self, angle_rad: f64, command_rad: f64, held_s: f64) -> f64 {
        self.turn_by(angle_rad, command_rad, held_s, |rest_s| self.share(rest_s))
    }

    /// The share of its way that the lag alone makes in a time.
    #[inline]
    fn share(&self, time_s: f64) -> f64 {
        -libm::expm1(-time_s / self.lag_s)
    }

    #[inline]
    fn turn_by(
        &self,
        angle_rad: f64,
        command_rad: f64,
        held_s: f64,
        share: impl Fn(f64) -> f64,
    ) -> f64 {
        let (target_rad, band_rad) = (self.target_rad(command_rad), self.dead_band_rad);
        let aim_rad = angle_rad.max(target_rad - band_rad).min(target_rad + band_rad);
        let error_rad = aim_rad - angle_rad;
        let reach_rad = self.rate_radps * held_s;
        if self.lag_s == 0.0 {
            return angle_rad + error_rad.clamp(-reach_rad, reach_rad);
        }
        // At the limit of the rate until the lag alone is slower; from there on exponentially.
        let error_abs_rad = error_rad.abs();
        let limited_rad = (error_abs_rad - self.rate_radps * self.lag_s).clamp(0.0, reach_rad);
        let rest_s = (held_s - limited_rad / self.rate_radps).max(0.0);
        let turned_rad = limited_rad + share(rest_s) * (error_abs_rad - limited_rad);
        angle_rad + turned_rad.copysign(error_rad)
    }
}

/// An actuator whose commands are all held for the same time: the same angles to the bit, for less.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SteeringStep {
    actuator: SteeringActuator,
    held_s: f64,
    /// The share of its way that the lag makes in a whole step.
    share: f64,
}

impl SteeringStep {
    /// Steps of this length.
    pub fn new(actuator: SteeringActuator, held_s: f64) -> Self {
        Self { actuator, held_s, share: actuator.share(held_s) }
    }

    /// The actuator itself.
    pub fn actuator(&self) -> &SteeringActuator {
        &self.actuator
    }

    /// As [`SteeringActuator::turn`], over a step.
    #[inline]
    pub fn turn(&self, angle_rad: f64, command_rad: f64) -> f64 {
        let share = |rest_s| {
            if rest_s == self.held_s { self.share } else { self.actuator.share(rest_s) }
        };
        self.actuator.turn_by(angle_rad, command_rad, self.held_s, share)
    }
}

/// The steering of one car, its dead time included: what becomes of the commands of tick after tick.
///
/// # Examples
/// ```
/// use tracking::SteeringChain;
/// let mut vehicle = config::Layers::maneuver("lane_change")?.resolve()?.vehicle;
/// vehicle.steering_delay_s = 0.02;
/// let mut steering = SteeringChain::new(&vehicle, 0.01);
/// assert_eq!((steering.step(0.1), steering.step(0.1)), (0.0, 0.0));
/// assert!(steering.step(0.1) > 0.0);
/// # Ok::<(), config::ConfigError>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct SteeringChain {
    actuator: SteeringActuator,
    parts: Vec<(Part<1>, SteeringStep)>,
    on_the_way: DelayLine<f64>,
    angle_rad: f64,
}

impl SteeringChain {
    /// That of a vehicle at rest that was commanded to go straight on.
    pub fn new(vehicle: &Vehicle, tick_s: f64) -> Self {
        let actuator = SteeringActuator::new(vehicle);
        let parts = parts_of_tick([vehicle.steering_delay_s], tick_s);
        let on_the_way = DelayLine::new(&parts, 0.0);
        let step = |part: Part<1>| (part, SteeringStep::new(actuator, part.length_s));
        let parts = parts.into_iter().map(step).collect();
        Self { actuator, parts, on_the_way, angle_rad: actuator.target_rad(0.0) }
    }

    /// Returns to rest, commanded to go straight on.
    pub fn reset(&mut self) {
        self.on_the_way.reset(0.0);
        self.angle_rad = self.actuator.target_rad(0.0);
    }

    /// Takes the command of a tick, which is held until the next one; returns the angle of the road wheels at the tick's
    /// end.
    pub fn step(&mut self, command_rad: f64) -> f64 {
        self.on_the_way.push(command_rad);
        for (part, step) in &self.parts {
            let command_rad = self.on_the_way.given(part.ago[0]);
            self.angle_rad = step.turn(self.angle_rad, command_rad);
        }
        self.angle_rad
    }

    /// The angle of the road wheels at the end of the last tick.
    pub fn angle_rad(&self) -> f64 {
        self.angle_rad
    }
}

/// A part of a tick in which no command arrives at any of N actuators: dead times that are no whole number of ticks cut
/// the tick into such parts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Part<const N: usize> {
    /// How long it is.
    pub length_s: f64,
    /// How many ticks ago the command was given that acts on each actuator; 0 is the command of this tick.
    pub ago: [usize; N],
}

/// The parts of a tick for N actuators with these dead times, in order. Each command is held for a whole tick, and so
/// arrives as it was given, only later.
pub fn parts_of_tick<const N: usize>(dead_times_s: [f64; N], tick_s: f64) -> Vec<Part<N>> {
    // In ticks: whole ones, and the rest, which is where in a tick the commands arrive.
    let dead_times = dead_times_s.map(|dead_time_s| {
        let ticks = dead_time_s / tick_s;
        let whole = (ticks + ROUNDING_TICKS).floor();
        let arrival = ticks - whole;
        (whole as usize, if arrival < ROUNDING_TICKS { 0.0 } else { arrival })
    });
    let mut cuts: Vec<f64> = dead_times.iter().map(|(_, arrival)| *arrival).collect();
    cuts.extend([0.0, 1.0]);
    cuts.sort_by(f64::total_cmp);
    cuts.dedup();
    let part = |ends: &[f64]| Part {
        length_s: (ends[1] - ends[0]) * tick_s,
        ago: dead_times.map(|(whole, arrival)| whole + usize::from(ends[0] < arrival)),
    };
    cuts.windows(2).map(part).collect()
}

/// Commands on their way: those of the last ticks, as many as a dead time needs.
#[derive(Debug, Clone, PartialEq)]
pub struct DelayLine<T> {
    ring: Box<[T]>,
    newest: usize,
}

impl<T: Copy> DelayLine<T> {
    /// One that is long enough for these parts of a tick, and on which `rest` was commanded all the time.
    pub fn new<const N: usize>(parts: &[Part<N>], rest: T) -> Self {
        let longest = parts.iter().flat_map(|part| part.ago).max().unwrap_or(0);
        Self { ring: vec![rest; longest + 1].into(), newest: 0 }
    }

    /// Forgets what is on the way: `rest` was commanded all the time.
    pub fn reset(&mut self, rest: T) {
        self.ring.fill(rest);
    }

    /// Takes the command of a tick.
    pub fn push(&mut self, command: T) {
        self.newest = self.newest.checked_sub(1).unwrap_or(self.ring.len() - 1);
        self.ring[self.newest] = command;
    }

    /// The command that was given this many ticks ago.
    ///
    /// # Panics
    /// If it is too long ago.
    pub fn given(&self, ago: usize) -> T {
        assert!(ago < self.ring.len(), "longer ago than any part of a tick needs");
        let index = self.newest + ago;
        self.ring[if index < self.ring.len() { index } else { index - self.ring.len() }]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const TICK_S: f64 = 0.01;

    /// The paper's vehicle, whose chain is nothing but its rate.
    fn plain() -> Vehicle {
        config::Layers::maneuver("lane_change").unwrap().resolve().unwrap().vehicle
    }

    fn commands() -> impl Strategy<Value = Vec<f64>> {
        // Held for a while, as commands are, so that the wheels get somewhere.
        prop::collection::vec((-0.7..0.7f64, 1usize..40), 1..30).prop_map(|held| {
            held.into_iter().flat_map(|(command, ticks)| vec![command; ticks]).collect()
        })
    }

    /// Vehicles with every part of the chain, each often absent.
    fn vehicles() -> impl Strategy<Value = Vehicle> {
        let or = |absent: f64, range: std::ops::Range<f64>| prop_oneof![Just(absent), range];
        (or(0.0, 0.0..0.3), or(1.0, 0.5..1.5), or(0.0, -0.1..0.1), or(0.0, 0.0..0.05), 0.2..3.0f64)
            .prop_map(|(lag_s, gain, offset_rad, dead_band_rad, rate_radps)| Vehicle {
                steering_lag_s: lag_s,
                steering_gain: gain,
                steering_offset_rad: offset_rad,
                steering_dead_band_rad: dead_band_rad,
                steering_rate_radps: rate_radps,
                ..plain()
            })
    }

    fn angles(vehicle: &Vehicle, tick_s: f64, commands: impl IntoIterator<Item = f64>) -> Vec<f64> {
        let mut chain = SteeringChain::new(vehicle, tick_s);
        commands.into_iter().map(|command| chain.step(command)).collect()
    }

    proptest! {
        #[test]
        fn without_any_of_it_the_wheels_turn_at_their_rate(commands in commands()) {
            let vehicle = plain();
            let (limit, reach) = (vehicle.steering_limit_rad, vehicle.steering_rate_radps * TICK_S);
            let mut angle = 0.0;
            for (got, command) in angles(&vehicle, TICK_S, commands.clone()).into_iter().zip(commands) {
                angle += (command.clamp(-limit, limit) - angle).clamp(-reach, reach);
                prop_assert_eq!(got.to_bits(), f64::to_bits(angle));
            }
        }

        #[test]
        fn a_dead_time_of_whole_ticks_shifts_exactly(
            vehicle in vehicles(), commands in commands(), ticks in 1usize..100,
        ) {
            let delayed = Vehicle { steering_delay_s: ticks as f64 * TICK_S, ..vehicle.clone() };
            let rest = std::iter::repeat_n(0.0, ticks);
            prop_assert_eq!(
                angles(&delayed, TICK_S, commands.clone()),
                angles(&vehicle, TICK_S, rest.chain(commands.clone()).take(commands.len()))
            );
        }

        #[test]
        fn a_dead_time_within_a_tick_is_as_exact_as_finer_ticks(
            vehicle in vehicles(), commands in commands(), whole in 0usize..20, fifths in 1usize..5,
        ) {
            let delay_s = (whole as f64 + fifths as f64 / 5.0) * TICK_S;
            let delayed = Vehicle { steering_delay_s: delay_s, ..vehicle };
            let finer = commands.iter().flat_map(|command| [*command; 5]);
            let finer = angles(&delayed, TICK_S / 5.0, finer);
            for (coarse, fine) in angles(&delayed, TICK_S, commands).iter().zip(finer.iter().skip(4).step_by(5)) {
                prop_assert!((coarse - fine).abs() < 1e-12, "{coarse} {fine}");
            }
        }

        #[test]
        fn a_command_that_is_held_acts_the_same_in_one_step_and_in_two(
            vehicle in vehicles(), angle in -0.5..0.5f64, command in -0.7..0.7f64,
            first_s in 0.0..0.2f64, then_s in 0.0..0.2f64,
        ) {
            let actuator = SteeringActuator::new(&vehicle);
            let two = actuator.turn(actuator.turn(angle, command, first_s), command, then_s);
            let one = actuator.turn(angle, command, first_s + then_s);
            prop_assert!((one - two).abs() < 1e-12, "{one} {two}");
        }

        #[test]
        fn many_steps_of_one_length_are_the_same_to_the_bit(
            vehicle in vehicles(), angle in -0.5..0.5f64, command in -0.7..0.7f64, held_s in 0.001..0.2f64,
        ) {
            let actuator = SteeringActuator::new(&vehicle);
            let wanted_rad = actuator.turn(angle, command, held_s);
            let found_rad = SteeringStep::new(actuator, held_s).turn(angle, command);
            prop_assert_eq!(found_rad.to_bits(), wanted_rad.to_bits());
        }

        #[test]
        fn the_wheels_keep_their_rate_and_come_to_the_target(
            vehicle in vehicles(), commands in commands(), last in -0.7..0.7f64,
        ) {
            let mut chain = SteeringChain::new(&vehicle, TICK_S);
            let mut before = chain.angle_rad();
            for command in commands {
                let angle = chain.step(command);
                prop_assert!((angle - before).abs() <= vehicle.steering_rate_radps * TICK_S * (1.0 + 1e-9));
                prop_assert!(angle.abs() <= vehicle.steering_limit_rad);
                before = angle;
            }
            for _ in 0..2000 {
                chain.step(last);
            }
            let (gain, offset) = (vehicle.steering_gain, vehicle.steering_offset_rad);
            let limit = vehicle.steering_limit_rad;
            let apart = chain.angle_rad() - (gain * last + offset).clamp(-limit, limit);
            prop_assert!(apart.abs() <= vehicle.steering_dead_band_rad + 1e-9, "{apart}");
            // Nothing of it is left.
            chain.reset();
            prop_assert_eq!(chain, SteeringChain::new(&vehicle, TICK_S));
        }
    }

    #[test]
    fn a_small_step_is_answered_exponentially_and_a_large_one_at_the_limit_first() {
        let vehicle = Vehicle { steering_lag_s: 0.1, steering_rate_radps: 0.6, ..plain() };
        // The lag alone is slower than 0.6 rad/s below an error of 0.06 rad.
        for (tick, angle) in angles(&vehicle, TICK_S, [0.05; 100]).into_iter().enumerate() {
            let time_s = TICK_S * (tick + 1) as f64;
            assert!((angle - 0.05 * (1.0 - libm::exp(-time_s / 0.1))).abs() < 1e-12);
        }
        for (tick, angle) in angles(&vehicle, TICK_S, [0.36; 100]).into_iter().enumerate() {
            let time_s = TICK_S * (tick + 1) as f64;
            let wanted = match time_s {
                ..0.5 => 0.6 * time_s,
                _ => 0.36 - 0.06 * libm::exp(-(time_s - 0.5) / 0.1),
            };
            assert!((angle - wanted).abs() < 1e-9, "{time_s}: {angle} {wanted}");
        }
    }

    #[test]
    fn a_dead_band_is_a_play_that_has_to_be_taken_up_at_each_turn() {
        let vehicle =
            Vehicle { steering_dead_band_rad: 0.02, steering_rate_radps: 100.0, ..plain() };
        let commands = [0.01, 0.02, 0.1, 0.07, 0.061, 0.05, 0.0, 0.03];
        let wanted = [0.0, 0.0, 0.08, 0.08, 0.08, 0.07, 0.02, 0.02];
        for (angle, wanted) in angles(&vehicle, TICK_S, commands).into_iter().zip(wanted) {
            assert!((angle - wanted).abs() < 1e-12, "{angle} {wanted}");
        }
    }

    #[test]
    fn a_car_whose_wheels_are_not_aligned_stands_like_that() {
        let vehicle = Vehicle { steering_offset_rad: 0.03, steering_gain: 0.8, ..plain() };
        let mut chain = SteeringChain::new(&vehicle, TICK_S);
        assert_eq!((chain.angle_rad(), chain.step(0.0)), (0.03, 0.03));
    }

    #[test]
    fn ticks_are_cut_where_commands_arrive() {
        let check = |dead_times_s, wanted: &[(f64, [usize; 2])]| {
            let parts = parts_of_tick(dead_times_s, TICK_S);
            assert_eq!(parts.len(), wanted.len(), "{parts:?}");
            for (part, (length_s, ago)) in parts.iter().zip(wanted) {
                assert!((part.length_s - length_s).abs() < 1e-12, "{parts:?}");
                assert_eq!(part.ago, *ago, "{parts:?}");
            }
        };
        check([0.0, 0.0], &[(0.01, [0, 0])]);
        // 0.07 / 0.01 is a little more than 7, and 0.29 / 0.01 a little less than 29.
        check([0.07, 0.29], &[(0.01, [7, 29])]);
        check([0.004, 0.0], &[(0.004, [1, 0]), (0.006, [0, 0])]);
        check([0.157, 0.022], &[(0.002, [16, 3]), (0.005, [16, 2]), (0.003, [15, 2])]);
        assert_eq!(parts_of_tick([0.0], TICK_S)[0].length_s.to_bits(), TICK_S.to_bits());
    }
}
