//! The four gains as the first of a law's parameters, as the wire has them.

use crate::Gains;

impl Gains {
    /// The gains in the paper's order, and zeros behind them.
    ///
    /// # Panics
    /// If there is no room for four.
    pub fn to_parameters<const N: usize>(self) -> [f64; N] {
        let mut parameters = [0.0; N];
        parameters[..4].copy_from_slice(&self.to_array());
        parameters
    }

    /// The first four parameters.
    ///
    /// # Panics
    /// If there are fewer.
    pub fn from_parameters(parameters: &[f64]) -> Self {
        Self::from_array(std::array::from_fn(|index| parameters[index]))
    }
}
