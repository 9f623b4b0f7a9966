//! Where the loop settles on a path of constant curvature.
//!
//! In the frame of the reference pose (x along the path): the tracked point is at (−s, Y), the heading is θ. Of a car at
//! speed v behind a reference at speed v_r on a curvature κ, with r = κ·v_r and the tracked point p ahead of the rear axle:
//!
//! v·cos θ = v_r·(1 − κ·Y) + p·r·sin θ,  v·sin θ + p·r·cos θ + r·s = 0,  tan δ = L·r/v,
//!
//! (1 − Ki)·δ/(Ki·h) = −Ks·θ − Kl·(Y·cos θ + s·sin θ),  v/Kv = s·cos θ − Y·sin θ

use crate::{Car, Gains};

/// Where the loop settles.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Equilibrium {
    /// Curvature of the path, 1/m, positive to the left.
    pub curvature: f64,
    /// Speed of the reference.
    pub reference_mps: f64,
    /// Speed of the car.
    pub speed_mps: f64,
    /// How far the reference is ahead, s.
    pub lead_m: f64,
    /// Offset of the tracked point in the reference's frame, Y.
    pub offset_m: f64,
    /// Heading in the reference's frame, θ.
    pub heading_rad: f64,
    /// Angle of the road wheels, δ, and of the law's filter.
    pub steering_rad: f64,
}

impl Equilibrium {
    /// Where the loop settles on a straight: on it, this far behind the reference.
    pub fn straight(reference_mps: f64, lead_m: f64) -> Self {
        Self {
            curvature: 0.0,
            reference_mps,
            speed_mps: reference_mps,
            lead_m,
            offset_m: 0.0,
            heading_rad: 0.0,
            steering_rad: 0.0,
        }
    }

    /// Where the loop settles on this curvature, at this speed of the reference; `None` if nowhere.
    pub fn new(car: &Car, gains: &Gains, reference_mps: f64, curvature: f64) -> Option<Self> {
        let Gains { kv, kl, ks, ki } = *gains;
        let turning = curvature * reference_mps;
        let mut at = Self { curvature, ..Self::straight(reference_mps, reference_mps / kv) };
        if curvature == 0.0 {
            return Some(at);
        }
        for _ in 0..2000 {
            let (sin, cos) = (libm::sin(at.heading_rad), libm::cos(at.heading_rad));
            let steering_rad =
                libm::atan(car.turning().wheelbase_m(at.speed_mps) * turning / at.speed_mps);
            let filter = (1.0 - ki) * steering_rad / (ki * car.tick_s);
            let offset_m = -((filter + ks * at.heading_rad) / kl + at.lead_m * sin) / cos;
            let pushed = car.tracked_m(reference_mps) * turning;
            let speed_mps = (reference_mps * (1.0 - curvature * offset_m) + pushed * sin) / cos;
            let lead_m = (speed_mps / kv + offset_m * sin) / cos;
            let heading_rad = libm::asin(-(pushed * cos + turning * lead_m) / speed_mps);
            let next = Self { speed_mps, lead_m, offset_m, heading_rad, steering_rad, ..at };
            let numbers =
                |it: &Self| [it.speed_mps, it.lead_m, it.offset_m, it.heading_rad, it.steering_rad];
            let (old, new) = (numbers(&at), numbers(&next));
            if !new.iter().all(|it| it.is_finite()) {
                return None;
            }
            let moved = old.iter().zip(new).map(|(old, new)| (old - new).abs()).fold(0.0, f64::max);
            if moved < 1e-12 {
                return Some(next);
            }
            let half = |old: f64, new: f64| old + 0.5 * (new - old);
            at = Self {
                speed_mps: half(at.speed_mps, speed_mps),
                lead_m: half(at.lead_m, lead_m),
                offset_m: half(at.offset_m, offset_m),
                heading_rad: half(at.heading_rad, heading_rad),
                steering_rad,
                ..at
            };
        }
        None
    }

    /// Whether all numbers are the same, but for rounding.
    pub(crate) fn is_near(&self, other: &Self) -> bool {
        let numbers = |it: &Self| {
            let angles = [it.heading_rad, it.steering_rad];
            [it.speed_mps, it.lead_m, it.offset_m, angles[0], angles[1]]
        };
        numbers(self).iter().zip(numbers(other)).all(|(a, b)| (a - b).abs() < 1e-9)
    }
}
