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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Equilibrium, Gains, Intervals, Region};
    use config::Layers;

    #[test]
    fn a_file_is_held_to_its_own_words_and_to_the_car_that_it_is_for() {
        let car = Car::new(&Layers::maneuver("circuit").unwrap().resolve().unwrap());
        let gains = Gains { kv: 3.0, kl: 21.0, ks: 21.0, ki: 0.7 };
        let at = Equilibrium::straight(1.45, 1.45 / 3.0);
        let region = Region::find(&car, &gains, &at, Intervals::default()).unwrap();
        let region = Certified { maneuver: "circuit".to_owned(), gains, region };
        let file = Certificate::new("mine", &car, vec![region]);
        assert_eq!(file.verify(), Ok(vec![Ok(())]));
        let refused = |change: &dyn Fn(&mut Certificate), word: &str| {
            let mut other = file.clone();
            change(&mut other);
            let said = other.verify().unwrap_err();
            assert!(said.starts_with(word), "{said}");
        };
        refused(&|it| it.format.push('1'), "format: ");
        refused(&|it| it.claim.push('.'), "claim: ");
        refused(&|it| it.bound.fall *= 0.5, "bound: ");
        refused(&|it| it.bound.rounding *= 0.5, "bound: ");
        refused(&|it| it.car.steering_delay_s = 0.01, "car: ");
        refused(&|it| it.car.steering_lag_s = 0.01, "car: ");
        refused(&|it| it.car.steering_gain = 0.9, "car: ");
        // Each region has a verdict of its own.
        let mut two = file.clone();
        two.regions.push(two.regions[0].clone());
        two.regions[1].region.extent *= 1.1;
        assert_eq!(two.verify(), Ok(vec![Ok(()), Err(Refusal::TooFar)]));
    }
}
