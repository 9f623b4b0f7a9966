//! The loop around an equilibrium, as the matrices between which it always is.
//!
//! State: deviations of offset y, heading θ, filter φ, wheels δ. Speed and lead lie in intervals; sin, cos and tan are
//! replaced by their chords, whose slopes lie in intervals as long as |θ| ≤ [`HEADING_RAD`] and the wheels are within
//! their limit. With c1 = Δsin/Δθ and s1 = −Δcos/Δθ, c0 and c0′ for cos θ in the two places where it stands (they are two
//! parameters, because they multiply), and k2 = Δtan/Δδ:
//!
//! F = [−Ki·h·Kl·c0, −Ki·h·(Ks + Kl·(s·c1 − Y·s1)), Ki, 0],  φ⁺ = F·x,  δ⁺ = δ + sat(φ⁺ − δ),
//!
//! θ⁺ = θ + (h·v/L)·k2·δ⁺,  y⁺ = y + h·(v·c1 − p·r·s1)·θ + (h·v·p/L·c0′ + h²·v²/2L)·k2·δ⁺
//!
//! Every pair of a speed v and its square lies in the triangle of (v₀, v₀²), (v₁, v₁²) and ((v₀+v₁)/2, v₀·v₁), so these
//! three stand for the interval of the speed. The matrices are linear in each parameter, so the extremes suffice: 96 on a
//! straight, where s1 has no part, 192 on an arc.

use serde::{Deserialize, Serialize};

use crate::small::Square;
use crate::{Car, Equilibrium, Gains};

/// A state: deviations of offset (m), heading, filter and wheels (rad).
pub type State = [f64; 4];

/// How far the heading may deviate.
pub const HEADING_RAD: f64 = 0.35;

/// How much speed and lead may deviate from where they settle, as shares.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Intervals {
    /// Of the speed.
    pub speed: f64,
    /// Of the lead.
    pub lead: f64,
}

impl Default for Intervals {
    fn default() -> Self {
        Self { speed: 0.1, lead: 0.2 }
    }
}

/// One of the matrices.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Vertex {
    /// F.
    pub(crate) filter: State,
    /// y⁺ = y + `sideways`·θ + `shift`·δ⁺, θ⁺ = θ + `turn`·δ⁺.
    pub(crate) sideways: f64,
    pub(crate) shift: f64,
    pub(crate) turn: f64,
}

impl Vertex {
    /// The matrix of a tick, if δ⁺ is this function of the state.
    pub(crate) fn matrix(&self, wheels: &State) -> Square<4> {
        let mut out = [[0.0; 4]; 4];
        out[0] = wheels.map(|it| self.shift * it);
        out[0][0] += 1.0;
        out[0][1] += self.sideways;
        out[1] = wheels.map(|it| self.turn * it);
        out[1][1] += 1.0;
        out[2] = self.filter;
        out[3] = *wheels;
        out
    }

    /// One tick, with the limit of the steering's rate.
    #[cfg(test)]
    pub(crate) fn step(&self, x: &State, most_rad: f64) -> State {
        let filter: f64 = self.filter.iter().zip(x).map(|(f, x)| f * x).sum();
        let wheels = x[3] + (filter - x[3]).clamp(-most_rad, most_rad);
        let heading = x[1] + self.turn * wheels;
        [x[0] + self.sideways * x[1] + self.shift * wheels, heading, filter, wheels]
    }
}

/// The least and the largest value of a smooth function on an interval, no nearer than it is: sampled, and widened by
/// what a function with this bound of its second derivative may do between two samples.
fn range(from: f64, to: f64, curved: f64, value: impl Fn(f64) -> f64) -> [f64; 2] {
    const SAMPLES: u32 = 4000;
    let apart = (to - from) / f64::from(SAMPLES);
    let widened = curved * apart * apart / 8.0;
    let values = (0..=SAMPLES).map(|it| value(from + f64::from(it) * apart));
    let [low, high] = values
        .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], it| [low.min(it), high.max(it)]);
    [low - widened, high + widened]
}

/// sin(x)/x.
fn sinc(x: f64) -> f64 {
    if x.abs() < 1e-4 { 1.0 - x * x / 6.0 } else { libm::sin(x) / x }
}

/// Slope of the chord of tan between two angles: sin(a − b)/((a − b)·cos a·cos b).
fn tan_slope(a: f64, b: f64) -> f64 {
    sinc(a - b) / (libm::cos(a) * libm::cos(b))
}

/// All matrices around an equilibrium.
pub(crate) fn vertices(
    car: &Car,
    gains: &Gains,
    at: &Equilibrium,
    intervals: &Intervals,
) -> Vec<Vertex> {
    let Gains { kl, ks, ki, .. } = *gains;
    let (h, wheelbase) = (car.tick_s, car.wheelbase_m);
    let turning = at.curvature * at.reference_mps;
    let limit = car.steering_limit_rad;
    let middle = |deviation: f64| at.heading_rad + 0.5 * deviation;
    let r = HEADING_RAD;
    // Chords: Δsin = 2·cos(middle)·sin(Δ/2), −Δcos = 2·sin(middle)·sin(Δ/2). Second derivatives are below 1; that of
    // a chord of tan is below a third of the largest third derivative of tan, which is below 6/cos⁴.
    let c1s = range(-r, r, 1.0, |it| libm::cos(middle(it)) * sinc(0.5 * it));
    let s1s = range(-r, r, 1.0, |it| libm::sin(middle(it)) * sinc(0.5 * it));
    let c0s = range(at.heading_rad - r, at.heading_rad + r, 1.0, libm::cos);
    let steepest = 1.0 / (libm::cos(limit) * libm::cos(limit));
    let k2s = range(-limit, limit, 2.0 * steepest * steepest, |it| tan_slope(it, at.steering_rad));
    let s1s: &[f64] = if at.curvature == 0.0 { &[0.0] } else { &s1s };
    let (slow, fast) =
        ((1.0 - intervals.speed) * at.speed_mps, (1.0 + intervals.speed) * at.speed_mps);
    let speeds = [(slow, slow * slow), (fast, fast * fast), (0.5 * (slow + fast), slow * fast)];
    let leads = [(1.0 - intervals.lead) * at.lead_m, (1.0 + intervals.lead) * at.lead_m];
    let mut all = Vec::new();
    for (v, v_squared) in speeds {
        for lead in leads {
            for c1 in c1s {
                for &s1 in s1s {
                    for c0 in c0s {
                        let heading = ks + kl * (lead * c1 - at.offset_m * s1);
                        let filter = [-ki * h * kl * c0, -ki * h * heading, ki, 0.0];
                        let p = car.tracked_point_m;
                        let sideways = h * (v * c1 - p * turning * s1);
                        for c0_point in c0s {
                            for k2 in k2s {
                                let turn = h * v / wheelbase * k2;
                                let quadratic = h * h * v_squared / (2.0 * wheelbase);
                                let shift = (h * v * p / wheelbase * c0_point + quadratic) * k2;
                                all.push(Vertex { filter, sideways, shift, turn });
                            }
                        }
                    }
                }
            }
        }
    }
    all
}
