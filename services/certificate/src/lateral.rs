//! The lateral loop along a straight, linearised: exact for small offsets, with dead time and lag.
//!
//! Offset y of the tracked point (left positive), heading θ against the path, angle δ of the road wheels, filter φ; speed
//! v, lead s, tick h, wheelbase L, tracked point p ahead of the rear axle. In each tick, first the law, then the car:
//!
//! ω = −Kl·y − (Ks + Kl·s)·θ,  φ⁺ = Ki·φ + Ki·h·ω
//!
//! δ⁺ follows φ⁺ through dead time and lag,  θ⁺ = θ + (h·v/L)·δ⁺,  y⁺ = y + h·v·θ + (h·v·p/L + h²·v²/2L)·δ⁺
//!
//! A dead time that is no whole number of ticks cuts the tick into parts, each with these equations, as in the simulator.

use std::f64::consts::{PI, TAU};

use nalgebra::Complex;
use tracking::{Part, parts_of_tick};

use crate::spectrum::spectral_radius;
use crate::{Car, Gains};

/// A set whose additional dead time is below this is fragile.
///
/// Of 16,500 noisy drives of all sets of both manoeuvres at four speeds with three cars, 4,402 ended more than 0.5 m off
/// the path: this bound finds all but 6 of them, and flags a fifth of the good ones.
pub const FRAGILE_BELOW_S: f64 = 0.2;

/// The loop of one car, one set of gains, at one speed.
#[derive(Debug, Clone)]
pub struct LateralLoop {
    gains: Gains,
    tick_s: f64,
    lead_m: f64,
    wheels: Wheels,
    /// The length of the state; see [`LateralLoop::step`].
    order: usize,
}

/// What stands between the steering command and what the law sees, for small offsets: dead time, lag, and the car.
#[derive(Debug, Clone)]
pub(crate) struct Wheels {
    parts: Vec<Step>,
    /// The yaw rate per angle of the wheels.
    yaw_rate: f64,
}

/// One part of a tick, linear in (y, θ, δ) and the command that acts in it.
#[derive(Debug, Clone)]
struct Step {
    part: Part<1>,
    /// Share of its way to the commanded angle that a wheel makes, and the angle per command.
    share: f64,
    gain: f64,
    /// y += sideways · θ + (δ's share below) · δ; θ += turn · δ.
    sideways: f64,
    turn: f64,
    shift: f64,
}

impl Step {
    fn apply<T>(&self, [y, heading, wheel]: [T; 3], command: T) -> [T; 3]
    where
        T: Copy
            + std::ops::Add<Output = T>
            + std::ops::Sub<Output = T>
            + std::ops::Mul<f64, Output = T>,
    {
        let wheel = wheel + (command * self.gain - wheel) * self.share;
        [y + heading * self.sideways + wheel * self.shift, heading + wheel * self.turn, wheel]
    }
}

impl Wheels {
    /// Those of a car at a speed.
    pub(crate) fn new(car: &Car, speed_mps: f64) -> Self {
        let step = |part: Part<1>| {
            let h = part.length_s;
            let (v, wheelbase) = (speed_mps, car.turning().wheelbase_m(speed_mps));
            Step {
                part,
                share: match car.steering_lag_s {
                    0.0 => 1.0,
                    lag_s => -libm::expm1(-h / lag_s),
                },
                gain: car.steering_gain,
                sideways: h * v,
                turn: h * v / wheelbase,
                shift: h * v * car.tracked_m(v) / wheelbase + h * h * v * v / (2.0 * wheelbase),
            }
        };
        let parts = parts_of_tick([car.steering_delay_s], car.tick_s);
        let parts = parts.into_iter().map(step).collect();
        Self { parts, yaw_rate: speed_mps / car.turning().wheelbase_m(speed_mps) }
    }

    /// How offset, heading and yaw rate answer to the command, at a point z of which `turned` gives the powers.
    pub(crate) fn answer(&self, turned: impl Fn(f64) -> Complex<f64>) -> [Complex<f64>; 3] {
        let z = turned(1.0);
        // One tick of the car: its state times a triangular matrix, and what a command of size 1 at this point adds.
        let zero = Complex::new(0.0, 0.0);
        let mut added = [zero; 3];
        let mut by_heading = [0.0, 1.0, 0.0];
        let mut by_wheel = [0.0, 0.0, 1.0];
        for step in &self.parts {
            added = step.apply(added, turned(-(step.part.ago[0] as f64)));
            by_heading = step.apply(by_heading, 0.0);
            by_wheel = step.apply(by_wheel, 0.0);
        }
        let wheel = added[2] / (z - by_wheel[2]);
        let heading = (added[1] + wheel * by_wheel[1]) / (z - 1.0);
        let offset = (added[0] + wheel * by_wheel[0] + heading * by_heading[0]) / (z - 1.0);
        [offset, heading, wheel * self.yaw_rate]
    }
}

impl LateralLoop {
    /// The loop at a speed, with the lead that the reference has at it.
    pub fn new(car: &Car, gains: &Gains, speed_mps: f64, lead_m: f64) -> Self {
        let wheels = Wheels::new(car, speed_mps);
        let order = 3 + wheels.parts.iter().map(|it| it.part.ago[0]).max().unwrap_or(0).max(1);
        Self { gains: *gains, tick_s: car.tick_s, lead_m, wheels, order }
    }

    /// The loop at a steady speed behind a reference that runs with time: the lead is v/Kv.
    pub fn steady(car: &Car, gains: &Gains, speed_mps: f64) -> Self {
        Self::new(car, gains, speed_mps, speed_mps / gains.kv)
    }

    /// How many numbers the state has.
    pub fn order(&self) -> usize {
        self.order
    }

    /// One tick. The state: y (m), θ (rad), δ (rad), and the commands of the last ticks (rad), the newest first.
    ///
    /// # Panics
    /// If the state is not of [`LateralLoop::order`].
    pub fn step(&self, state: &mut [f64]) {
        assert_eq!(state.len(), self.order);
        let Gains { kl, ks, ki, .. } = self.gains;
        let rate = -kl * state[0] - (ks + kl * self.lead_m) * state[1];
        let command = ki * state[3] + ki * self.tick_s * rate;
        let mut car = [state[0], state[1], state[2]];
        for step in &self.wheels.parts {
            let acting = match step.part.ago[0] {
                0 => command,
                ago => state[2 + ago],
            };
            car = step.apply(car, acting);
        }
        state[..3].copy_from_slice(&car);
        state.copy_within(3..self.order - 1, 4);
        state[3] = command;
    }

    /// The spectral radius of a tick: below 1, the loop is stable.
    pub fn spectral_radius(&self) -> f64 {
        let n = self.order;
        // The columns of the matrix as rows: the transposed matrix has the same eigenvalues.
        let mut columns = vec![0.0; n * n];
        for (index, column) in columns.chunks_exact_mut(n).enumerate() {
            column[index] = 1.0;
            self.step(column);
        }
        spectral_radius(n, &columns)
    }

    /// Whether small offsets die out.
    pub fn is_stable(&self) -> bool {
        self.spectral_radius() < 1.0
    }

    /// The open loop at a frequency, cut at the steering command: L(e^(iωh)). The closed loop is on the edge of
    /// stability where this is −1.
    fn open_loop(&self, frequency_radps: f64) -> Complex<f64> {
        let Gains { kl, ks, ki, .. } = self.gains;
        let angle = frequency_radps * self.tick_s;
        let turned = |ticks: f64| Complex::new(libm::cos(ticks * angle), libm::sin(ticks * angle));
        let [offset, heading, _] = self.wheels.answer(turned);
        let filter =
            Complex::new(ki * self.tick_s, 0.0) / (Complex::new(1.0, 0.0) - turned(-1.0) * ki);
        filter * (offset * kl + heading * (ks + kl * self.lead_m))
    }

    /// The additional dead time Δ: how much later the steering may act until the loop is on the edge of stability; 0 if
    /// it is unstable as it is. The smallest of ((arg L + π) mod 2π)/ω over all frequencies ω with |L| = 1.
    pub fn additional_dead_time_s(&self) -> f64 {
        if !self.is_stable() {
            return 0.0;
        }
        least_delay_s(self.tick_s, |frequency| self.open_loop(frequency))
    }
}

/// The least additional dead time that takes a stable loop to the edge of stability, by its open loop at a frequency.
pub(crate) fn least_delay_s(tick_s: f64, open_loop: impl Fn(f64) -> Complex<f64>) -> f64 {
    const SLOWEST_RADPS: f64 = 1e-3;
    const POINTS: usize = 800;
    let fastest_radps = PI / tick_s;
    let ratio = libm::pow(fastest_radps / SLOWEST_RADPS, 1.0 / POINTS as f64);
    let above = |frequency: f64| open_loop(frequency).norm_sqr() > 1.0;
    let mut least_s = f64::INFINITY;
    let mut low = SLOWEST_RADPS;
    let mut low_is_above = above(low);
    for point in 1..=POINTS {
        let high = if point == POINTS { fastest_radps } else { low * ratio };
        let high_is_above = above(high);
        if high_is_above != low_is_above {
            let (mut from, mut to) = (low, high);
            for _ in 0..50 {
                let middle = 0.5 * (from + to);
                if above(middle) == low_is_above { from = middle } else { to = middle }
            }
            let crossing = 0.5 * (from + to);
            let answer = open_loop(crossing);
            let phase = libm::atan2(answer.im, answer.re) + PI;
            let phase = if phase >= TAU { phase - TAU } else { phase };
            least_s = least_s.min(phase / crossing);
        }
        (low, low_is_above) = (high, high_is_above);
    }
    least_s
}
