//! The grid: the parameter sets that can be chosen, and how they are numbered.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::law::{LawConfig, MAX_PARAMETERS, Parameters, Scale};

/// The values of the grid along each parameter, by the parameter's name.
pub type Axes = BTreeMap<String, Axis>;

/// One axis of the grid.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Axis {
    /// First value.
    pub min: f64,
    /// Last value, up to rounding.
    pub max: f64,
    /// Difference between neighbouring values; on a log scale, their ratio.
    pub step: f64,
}

/// An axis whose scale is known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GridAxis {
    axis: Axis,
    scale: Scale,
}

impl Default for GridAxis {
    /// The single value 0, for places beyond the law's parameters.
    fn default() -> Self {
        Self { axis: Axis { min: 0.0, max: 0.0, step: 1.0 }, scale: Scale::Linear }
    }
}

impl GridAxis {
    /// An axis on its scale.
    pub fn new(axis: Axis, scale: Scale) -> Self {
        Self { axis, scale }
    }

    /// Number of values.
    pub fn len(&self) -> usize {
        let Axis { min, max, step } = self.axis;
        let steps = match self.scale {
            Scale::Linear => (max - min) / step,
            Scale::Log => libm::log(max / min) / libm::log(step),
        };
        // The ends of a decimal grid miss each other by some bits: 0.1 + 5 · 0.58 is not 3.
        (steps + 1e-6).floor() as usize + 1
    }

    /// Never: an axis holds at least its first value.
    pub fn is_empty(&self) -> bool {
        false
    }

    /// The value at `index`; the last one is `max` itself if the steps reach it up to rounding.
    pub fn value(&self, index: usize) -> f64 {
        let Axis { min, max, step } = self.axis;
        let (value, apart) = match self.scale {
            Scale::Linear => (min + step * index as f64, step),
            Scale::Log => (min * libm::pow(step, index as f64), max),
        };
        if (value - max).abs() < 1e-6 * apart { max } else { value }
    }

    /// The least value.
    pub fn min(&self) -> f64 {
        self.axis.min
    }

    /// The largest value, which the steps need not meet.
    pub fn max(&self) -> f64 {
        self.axis.max
    }

    /// The value at a share, from 0 to 1, of the way from the least value to the largest, on the axis's scale: what a
    /// tuner asks for that does not keep to the grid's values.
    pub fn at(&self, share: f64) -> f64 {
        let Axis { min, max, .. } = self.axis;
        let value = match self.scale {
            Scale::Linear => min + share * (max - min),
            Scale::Log => min * libm::pow(max / min, share),
        };
        value.clamp(min, max)
    }

    /// Whether a value is the least or the largest of an axis that has more than one.
    fn is_on_bound(&self, value: f64) -> bool {
        let near =
            |bound: f64| (value - bound).abs() <= 1e-6 * self.axis.step * bound.abs().max(1.0);
        let is_end_of_grid = near(self.value(0)) || near(self.value(self.len() - 1));
        // Between the values of the grid, sets reach an end that the steps need not meet.
        (self.len() > 1 && is_end_of_grid) || (self.max() > self.min() && near(self.max()))
    }

    /// The place of a value, if the axis holds it (up to a millionth of a step).
    fn find(&self, value: f64) -> Option<usize> {
        let Axis { min, step, .. } = self.axis;
        let (steps, apart) = match self.scale {
            Scale::Linear => (((value - min) / step).round(), step),
            Scale::Log => ((libm::log(value / min) / libm::log(step)).round(), value),
        };
        if !(0.0..self.len() as f64).contains(&steps) {
            return None;
        }
        ((self.value(steps as usize) - value).abs() <= 1e-6 * apart).then_some(steps as usize)
    }
}

/// The parameter sets that can be chosen: the product of the axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grid {
    axes: [GridAxis; MAX_PARAMETERS],
    count: usize,
}

impl Grid {
    /// The grid of a law, with the axes that the configuration holds for its parameters.
    ///
    /// # Panics
    /// If a parameter has no axis; a resolved configuration has one for each.
    pub fn new(law: &LawConfig, axes: &Axes) -> Self {
        let mut all = [GridAxis::default(); MAX_PARAMETERS];
        for (place, parameter) in all.iter_mut().zip(&law.parameters) {
            *place = GridAxis::new(axes[&parameter.key], parameter.scale);
        }
        Self { axes: all, count: law.count() }
    }

    /// The axes, in the order of the law's parameters.
    pub fn axes(&self) -> &[GridAxis] {
        &self.axes[..self.count]
    }

    /// Number of sets.
    pub fn len(&self) -> usize {
        self.axes().iter().map(GridAxis::len).product()
    }

    /// Never: each axis holds at least one value.
    pub fn is_empty(&self) -> bool {
        false
    }

    /// The set at one position along each axis.
    pub fn set(&self, position: GridPosition) -> Parameters {
        let mut set = Parameters::default();
        for ((value, axis), place) in set.0.iter_mut().zip(self.axes()).zip(position.0) {
            *value = axis.value(place as usize);
        }
        set
    }

    /// The position with number `index`, the last parameter running fastest.
    pub fn position(&self, index: usize) -> GridPosition {
        let mut rest = index;
        let mut position = GridPosition::default();
        for (axis, place) in self.axes().iter().zip(&mut position.0[..self.count]).rev() {
            *place = (rest % axis.len()) as u16;
            rest /= axis.len();
        }
        position
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

    /// The position of a set, if the grid holds it (up to a millionth of a step).
    pub fn find(&self, set: &Parameters) -> Option<GridPosition> {
        let mut position = GridPosition::default();
        for ((axis, value), place) in self.axes().iter().zip(set.0).zip(&mut position.0) {
            *place = axis.find(value)? as u16;
        }
        Some(position)
    }

    /// The parameters of a set that lie on a bound of an axis with more than one value, by their places in the law. The
    /// set need not be one of the grid.
    pub fn on_bound(&self, set: &Parameters) -> Vec<usize> {
        let axes = self.axes().iter().zip(set.0).enumerate();
        axes.filter(|(_, (axis, value))| axis.is_on_bound(*value)).map(|(place, _)| place).collect()
    }
}

/// A set of the grid, as its position along each axis, in the order of the law's parameters; those beyond are 0.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct GridPosition(pub [u16; MAX_PARAMETERS]);

impl GridPosition {
    /// The position with these first places.
    ///
    /// # Panics
    /// If there are more than [`MAX_PARAMETERS`].
    pub fn of(places: &[u16]) -> Self {
        let mut position = Self::default();
        position.0[..places.len()].copy_from_slice(places);
        position
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::law::paper_law;

    #[test]
    fn numbers_positions_and_sets_agree() {
        let law = paper_law();
        let axes = law.parameters.iter().map(|it| (it.key.clone(), it.grid)).collect();
        let grid = Grid::new(&law, &axes);
        assert_eq!(grid.len(), 750);
        for (index, position) in grid.positions().enumerate() {
            assert_eq!(grid.index(position), index);
            assert_eq!(grid.find(&grid.set(position)), Some(position));
        }
        assert_eq!(grid.set(grid.position(1)).0[..4], [0.1, 1.0, 1.0, 0.7 + 0.07]);
        assert_eq!(grid.on_bound(&grid.set(GridPosition::of(&[5, 2, 0, 1]))), [0, 2]);
        assert_eq!(grid.on_bound(&Parameters::of(&[3.0, 20.0, 21.0, 0.7])), [0, 2, 3]);
    }

    #[test]
    fn the_end_of_a_range_is_a_bound_whether_the_steps_meet_it_or_not() {
        let is_on_bound = |min, max, step, value| {
            GridAxis::new(Axis { min, max, step }, Scale::Linear).is_on_bound(value)
        };
        assert!([0.5, 2.5, 4.0].iter().all(|value| is_on_bound(0.5, 4.0, 2.0, *value)));
        assert!(!is_on_bound(0.5, 4.0, 2.0, 3.0));
        // One value is no choice, unless a set lies between the values of the grid.
        assert!(!is_on_bound(1.0, 1.0, 1.0, 1.0) && is_on_bound(0.5, 4.0, 10.0, 4.0));
    }

    #[test]
    fn a_log_scale_steps_by_a_ratio() {
        let axis = GridAxis::new(Axis { min: 0.1, max: 6.4, step: 2.0 }, Scale::Log);
        assert_eq!(axis.len(), 7);
        assert_eq!((axis.value(0), axis.value(6)), (0.1, 6.4));
        assert!((axis.value(3) - 0.8).abs() < 1e-12);
        assert_eq!((axis.find(0.8), axis.find(0.9)), (Some(3), None));
        assert_eq!((axis.at(0.0), axis.at(1.0)), (0.1, 6.4));
        assert!((axis.at(0.5) - 0.8).abs() < 1e-12);
    }
}
