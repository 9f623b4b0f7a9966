//! What is known of the cube: the points that were driven, with their values, and the random stream of the search.

use std::collections::HashMap;

use config::{MAX_PARAMETERS, RunConfig};

use super::{Cube, Point, Sobol};
use crate::rng::Stream;

/// A point that was driven.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Known {
    pub(crate) point: Point,
    /// Sum of the values of its drives, of their squares, and their number.
    pub(crate) sum: f64,
    pub(crate) squares: f64,
    pub(crate) drives: u32,
}

impl Known {
    /// Mean value of its drives.
    pub(crate) fn mean(&self) -> f64 {
        self.sum / f64::from(self.drives)
    }

    /// Sum of the squared differences of its drives' values from their mean, as shares of the mean.
    pub(crate) fn scatter(&self) -> f64 {
        let mean = self.mean();
        match self.drives > 1 && mean > 0.0 {
            true => ((self.squares - self.sum * mean) / (mean * mean)).max(0.0),
            false => 0.0,
        }
    }
}

/// The cube with what is known of it.
#[derive(Debug, Clone)]
pub(crate) struct Space {
    pub(crate) cube: Cube,
    pub(crate) rng: Stream,
    /// Whether two drives of the same set may differ.
    pub(crate) noise: bool,
    /// The points that were driven, in the order of their first drives.
    pub(crate) known: Vec<Known>,
    numbers: HashMap<[u64; MAX_PARAMETERS], usize>,
}

impl Space {
    pub(super) fn new(config: &RunConfig) -> Self {
        Self {
            cube: Cube::new(config),
            rng: Stream::new(config.run.seed, 0),
            noise: config.drives_differ(),
            known: Vec::new(),
            numbers: HashMap::new(),
        }
    }

    /// The least value of a set that was driven; infinite before the first drive.
    pub(crate) fn least(&self) -> f64 {
        self.known.iter().map(Known::mean).fold(f64::INFINITY, f64::min)
    }

    /// What is known of a point.
    pub(crate) fn find(&self, point: &[f64]) -> Option<&Known> {
        self.numbers.get(&self.cube.set(point).to_bits()).map(|number| &self.known[*number])
    }

    /// Whether a list has the set of a point.
    pub(crate) fn holds(&self, points: &[Point], point: &[f64]) -> bool {
        let set = self.cube.set(point);
        points.iter().any(|other| self.cube.set(other) == set)
    }

    /// Whether every set of the grid was driven.
    pub(crate) fn is_finished(&self) -> bool {
        self.cube.len().is_some_and(|sets| self.known.len() >= sets)
    }

    /// Adds a drive.
    pub(super) fn add(&mut self, point: &[f64], value: f64) {
        self.put(Known { point: point.to_vec(), sum: value, squares: value * value, drives: 1 });
    }

    pub(super) fn put(&mut self, drive: Known) {
        let next = self.known.len();
        let number = *self.numbers.entry(self.cube.set(&drive.point).to_bits()).or_insert(next);
        match self.known.get_mut(number) {
            Some(known) => {
                known.sum += drive.sum;
                known.squares += drive.squares;
                known.drives = known.drives.saturating_add(drive.drives);
            }
            None => self.known.push(drive),
        }
    }

    /// A point drawn evenly.
    pub(crate) fn draw(&mut self) -> Point {
        let drawn: Vec<f64> = (0..self.cube.dimensions()).map(|_| self.rng.uniform()).collect();
        self.cube.evenly(&drawn)
    }

    /// A point drawn evenly from those that were not driven and are not in the list; `None` if there is none.
    pub(crate) fn draw_new(&mut self, but: &[Point]) -> Option<Point> {
        for _ in 0..100 {
            let point = self.draw();
            if self.is_new(&point, but) {
                return Some(point);
            }
        }
        let count = self.cube.len()?;
        let first = self.rng.below(count);
        let mut all = (0..count).map(|it| self.cube.numbered((first + it) % count));
        all.find(|point| self.is_new(point, but))
    }

    /// Whether a point was not driven and is not in a list.
    pub(crate) fn is_new(&self, point: &[f64], but: &[Point]) -> bool {
        self.find(point).is_none() && !self.holds(but, point)
    }

    /// A scrambled Sobol sequence of this seed.
    pub(crate) fn sobol(&mut self) -> Sobol {
        let mut seed = || (self.rng.uniform() * (1u64 << 32) as f64) as u32;
        Sobol::new((0..self.cube.dimensions()).map(|_| seed()).collect())
    }
}
