//! A certificate as a file: all that is needed to verify it, and nothing that has to be believed.

use serde::{Deserialize, Serialize};

use crate::assessment::Certified;
use crate::check::{FALL, ROUNDING, check};
use crate::{CLAIM, Car, Refusal};

/// What the first key of the file says.
const FORMAT: &str = "pathtune certificate 1";

/// A certificate: regions of a car.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Certificate {
    /// What this is.
    format: String,
    /// What is claimed of each region.
    claim: String,
    /// Name of the vehicle.
    pub vehicle: String,
    /// The bound of the check.
    bound: Bound,
    /// The car.
    pub car: Car,
    /// The regions.
    pub regions: Vec<Certified>,
}

/// The bound of the check.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Bound {
    /// V falls by this share at least, at every tick.
    fall: f64,
    /// What rounding may do to an entry of a matrix, relative to what was added up to make it.
    rounding: f64,
}

impl Certificate {
    /// A certificate of these regions.
    pub fn new(vehicle: &str, car: &Car, regions: Vec<Certified>) -> Self {
        Self {
            format: FORMAT.to_owned(),
            claim: CLAIM.to_owned(),
            vehicle: vehicle.to_owned(),
            bound: Bound { fall: FALL, rounding: ROUNDING },
            car: *car,
            regions,
        }
    }

    /// Verifies every region from its numbers alone.
    ///
    /// # Errors
    /// If the file claims something else than this program verifies.
    pub fn verify(&self) -> Result<Vec<Result<(), Refusal>>, String> {
        if self.format != FORMAT {
            return Err(format!("format: is {:?}, not {FORMAT:?}", self.format));
        }
        if self.claim != CLAIM {
            return Err("claim: is not the one that is verified here".to_owned());
        }
        if self.bound != (Bound { fall: FALL, rounding: ROUNDING }) {
            return Err("bound: is not the one of this program".to_owned());
        }
        if self.car.steering_delay_s != 0.0
            || self.car.steering_lag_s != 0.0
            || self.car.steering_gain != 1.0
        {
            return Err(
                "car: its steering has dead time, lag or a gain; there is no certificate for that"
                    .to_owned(),
            );
        }
        Ok(self.regions.iter().map(|it| check(&self.car, &it.gains, &it.region)).collect())
    }
}
