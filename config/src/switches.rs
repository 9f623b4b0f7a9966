//! When gains may change during a drive: only where the ones to come are certain to hold the car.

use serde::{Deserialize, Serialize};

/// The states that the gains of a zone are certain to bring back, where the zone begins: {x: (x − at)ᵀ·P·(x − at) ≤ 1}, with
/// the state x = (offset of the tracked point to the left of the reference's heading, heading, the law's steering angle, the
/// angle of the road wheels), in the frame of the reference, in m and rad.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ZoneRegion {
    /// The number of the zone within the path, from 0.
    pub zone: usize,
    /// Where the car settles.
    pub at: [f64; 4],
    /// P.
    pub p: [[f64; 4]; 4],
}

impl ZoneRegion {
    /// V = (x − at)ᵀ·P·(x − at) of a state.
    pub fn value(&self, state: &[f64; 4]) -> f64 {
        let x: Vec<f64> = state.iter().zip(self.at).map(|(x, at)| x - at).collect();
        let row = |row: &[f64; 4]| row.iter().zip(&x).map(|(p, x)| p * x).sum::<f64>();
        self.p.iter().zip(&x).map(|(p, x)| x * row(p)).sum()
    }

    /// Checks what the types do not.
    pub(crate) fn check(&self, zones: usize) -> Result<(), String> {
        let numbers = self.at.iter().chain(self.p.iter().flatten());
        match (self.zone < zones, numbers.clone().all(|it| it.is_finite())) {
            (false, _) => {
                Err(format!("zone: there is no zone {}, the path has {zones}", self.zone))
            }
            (_, false) => Err("holds something that is not a number".to_owned()),
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn v_is_a_square_form_around_where_the_car_settles() {
        let mut region = ZoneRegion { zone: 1, at: [0.1, 0.0, 0.0, 0.0], p: [[0.0; 4]; 4] };
        (region.p[0][0], region.p[1][1]) = (4.0, 9.0);
        (region.p[0][1], region.p[1][0]) = (1.0, 1.0);
        // 4·0.2² + 2·0.2·0.5 + 9·0.5².
        assert!((region.value(&[0.3, 0.5, 7.0, 7.0]) - 2.61).abs() < 1e-12);
        assert!(region.check(2).is_ok() && region.check(1).unwrap_err().contains("no zone 1"));
        region.at[3] = f64::NAN;
        assert!(region.check(2).is_err());
    }
}
