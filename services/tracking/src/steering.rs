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
        let share = -libm::expm1(-rest_s / self.lag_s);
        let turned_rad = limited_rad + share * (error_abs_rad - limited_rad);
        angle_rad + turned_rad.copysign(error_rad)
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
    parts: Vec<Part<1>>,
    on_the_way: DelayLine<f64>,
    angle_rad: f64,
}

impl SteeringChain {
    /// That of a vehicle at rest that was commanded to go straight on.
    pub fn new(vehicle: &Vehicle, tick_s: f64) -> Self {
        let actuator = SteeringActuator::new(vehicle);
        let parts = parts_of_tick([vehicle.steering_delay_s], tick_s);
        let on_the_way = DelayLine::new(&parts, 0.0);
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
        for part in &self.parts {
            let command_rad = self.on_the_way.given(part.ago[0]);
            self.angle_rad = self.actuator.turn(self.angle_rad, command_rad, part.length_s);
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
