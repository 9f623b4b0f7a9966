//! What drives by plain calls on many plants say of the sets that may be driven, before the vehicle in the ring drives
//! any of them.
//!
//! The sets are fixed beforehand. [`Ensemble`] drives all of them on all plants; [`Belief`] takes mean and covariance of a
//! Gaussian process from these drives, and learns from those of the vehicle; [`told`] says what came out, on plants that
//! chose nothing.

mod belief;
mod ensemble;
mod told;

pub(crate) use belief::{Belief, Reading};
pub(crate) use ensemble::{Candidate, Ensemble};
pub(crate) use told::{Driven, simulated_first};

/// The least value that has a logarithm of its own.
const LEAST: f64 = 1e-9;
/// A value that is no number, or beyond this, counts as this.
const WORST: f64 = 1e12;

/// The logarithm of a value of the objective, by which sets are told apart.
pub(crate) fn log_value(value: f64) -> f64 {
    libm::log(if value.is_nan() { WORST } else { value.clamp(LEAST, WORST) })
}
