//! The gain grid: the sets that can be chosen, and how they are numbered.

use serde::{Deserialize, Serialize};

use crate::Gains;

/// The gain sets that can be chosen: the product of four axes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs, reason = "documented in readings.toml")]
pub struct Grid {
    pub kv: Axis,
    pub kl: Axis,
    pub ks: Axis,
    pub ki: Axis,
}

/// One axis of the grid.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Axis {
    /// First value.
    pub min: f64,
    /// Last value, up to rounding.
    pub max: f64,
    /// Distance of neighbouring values.
    pub step: f64,
}

impl Axis {
    /// Number of values.
    pub fn len(&self) -> usize {
        // The ends of a decimal grid miss each other by some bits: 0.1 + 5 · 0.58 is not 3.
        ((self.max - self.min) / self.step + 1e-6).floor() as usize + 1
    }

    /// Never: an axis holds at least its first value.
    pub fn is_empty(&self) -> bool {
        false
    }

    /// The value at `index`; the last one is `max` itself where the steps meet it up to rounding.
    pub fn value(&self, index: usize) -> f64 {
        let value = self.min + self.step * index as f64;
        if (value - self.max).abs() < 1e-6 * self.step { self.max } else { value }
    }
}

impl Grid {
    /// The axes in the order of the gains (Kv, Kl, Ks, Ki).
    pub fn axes(&self) -> [Axis; 4] {
        [self.kv, self.kl, self.ks, self.ki]
    }

    /// Number of gain sets.
    pub fn len(&self) -> usize {
        self.axes().iter().map(Axis::len).product()
    }

    /// Never: each axis holds at least one value.
    pub fn is_empty(&self) -> bool {
        false
    }

    /// The gains at one position along each axis.
    pub fn gains(&self, position: GridPosition) -> Gains {
        let axes = self.axes();
        Gains::from_array(std::array::from_fn(|axis| axes[axis].value(position.0[axis] as usize)))
    }

    /// The position with number `index`, the last gain running fastest.
    pub fn position(&self, index: usize) -> GridPosition {
        let mut rest = index;
        let mut position = [0; 4];
        for (axis, place) in self.axes().iter().zip(&mut position).rev() {
            *place = (rest % axis.len()) as u16;
            rest /= axis.len();
        }
        GridPosition(position)
    }

    /// The number of a position; the inverse of [`Grid::position`].
    pub fn index(&self, position: GridPosition) -> usize {
        self.axes()
            .iter()
            .zip(position.0)
            .fold(0, |index, (axis, place)| index * axis.len() + place as usize)
    }

    /// Every position, in the order of their numbers.
    pub fn positions(&self) -> impl Iterator<Item = GridPosition> {
        let grid = *self;
        (0..grid.len()).map(move |index| grid.position(index))
    }

    /// The position of `gains`, if the grid holds them (up to a millionth of a step).
    pub fn find(&self, gains: Gains) -> Option<GridPosition> {
        let mut position = [0; 4];
        for ((axis, gain), place) in self.axes().iter().zip(gains.to_array()).zip(&mut position) {
            let steps = ((gain - axis.min) / axis.step).round();
            if !(0.0..axis.len() as f64).contains(&steps) {
                return None;
            }
            if (axis.value(steps as usize) - gain).abs() > 1e-6 * axis.step {
                return None;
            }
            *place = steps as u16;
        }
        Some(GridPosition(position))
    }

    /// Names of the gains that lie on a bound of an axis with more than one value.
    pub fn on_bound(&self, position: GridPosition) -> Vec<&'static str> {
        let axes = self.axes();
        (0..4)
            .filter(|&axis| {
                let place = position.0[axis] as usize;
                axes[axis].len() > 1 && (place == 0 || place + 1 == axes[axis].len())
            })
            .map(|axis| Gains::NAMES[axis])
            .collect()
    }
}

/// A gain set of the grid, as its position along each axis (Kv, Kl, Ks, Ki).
#[derive(
    Debug, Clone, Copy, Default, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize,
)]
#[serde(transparent)]
pub struct GridPosition(pub [u16; 4]);
