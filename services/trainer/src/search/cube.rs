//! The unit cube in which tuners search: one coordinate from 0 to 1 for each parameter, on the scale that the law names.

use config::{Grid, GridPosition, Parameters, RunConfig};

/// A point of the cube, one coordinate for each parameter.
pub(crate) type Point = Vec<f64>;

/// The cube, and which of its points can be driven: all of them, or those of the grid.
#[derive(Debug, Clone)]
pub(crate) struct Cube {
    grid: Grid,
    on_grid: bool,
}

impl Cube {
    /// The cube of a configuration, whose tuner has the setting `draw`.
    pub(crate) fn new(config: &RunConfig) -> Self {
        Self { grid: config.grid(), on_grid: config.tuner.settings.text("draw") == "grid" }
    }

    /// Number of coordinates.
    pub(crate) fn dimensions(&self) -> usize {
        self.grid.axes().len()
    }

    /// Number of points that can be driven; `None` if there is no end of them.
    pub(crate) fn len(&self) -> Option<usize> {
        self.on_grid.then(|| self.grid.len())
    }

    /// Number of values along a coordinate; `None` if there is no end of them.
    pub(crate) fn values(&self, axis: usize) -> Option<usize> {
        self.on_grid.then(|| self.grid.axes()[axis].len())
    }

    /// The point with a number, if the points have numbers.
    pub(crate) fn numbered(&self, index: usize) -> Point {
        let position = self.grid.position(index);
        (0..self.dimensions()).map(|axis| self.coordinate(axis, position.0[axis].into())).collect()
    }

    /// The point that can be driven nearest to these coordinates.
    pub(crate) fn nearest(&self, coordinates: &[f64]) -> Point {
        let each = coordinates.iter().map(|it| it.clamp(0.0, 1.0)).enumerate();
        each.map(
            |(axis, it)| {
                if self.on_grid { self.coordinate(axis, self.place(axis, it)) } else { it }
            },
        )
        .collect()
    }

    /// The point for coordinates that were drawn evenly from [0, 1): along the grid, each value is as likely.
    pub(crate) fn evenly(&self, drawn: &[f64]) -> Point {
        if !self.on_grid {
            return drawn.to_vec();
        }
        let place = |(axis, it): (usize, &f64)| {
            let values = self.grid.axes()[axis].len();
            self.coordinate(axis, ((it * values as f64) as usize).min(values - 1))
        };
        drawn.iter().enumerate().map(place).collect()
    }

    /// The parameters at a point.
    pub(crate) fn set(&self, point: &[f64]) -> Parameters {
        if self.on_grid {
            let places: Vec<u16> =
                point.iter().enumerate().map(|(axis, it)| self.place(axis, *it) as u16).collect();
            return self.grid.set(GridPosition::of(&places));
        }
        let each = point.iter().zip(self.grid.axes());
        Parameters::of(&each.map(|(share, axis)| axis.at(*share)).collect::<Vec<_>>())
    }

    /// Where a value of the grid lies in the cube; the only value of an axis lies in the middle.
    fn coordinate(&self, axis: usize, place: usize) -> f64 {
        let last = self.grid.axes()[axis].len() - 1;
        if last == 0 { 0.5 } else { place as f64 / last as f64 }
    }

    fn place(&self, axis: usize, coordinate: f64) -> usize {
        let last = self.grid.axes()[axis].len() - 1;
        ((coordinate.clamp(0.0, 1.0) * last as f64).round() as usize).min(last)
    }
}
