//! The cross-entropy method: generations drawn from a normal distribution for each parameter, whose mean and width follow
//! the best few of each.
//!
//! R. Y. Rubinstein, "The cross-entropy method for combinatorial and continuous optimization" (1999). A distribution that
//! has become narrow, or that finds nothing new, is replaced by a new one around a set drawn at random.

use config::RunConfig;

use crate::search::{Method, Point, SETTLED, Search, Space};

/// Width of a new distribution, as a share of the axes.
const WIDTH: f64 = 0.4;
/// A distribution that is nowhere wider than this is replaced; on a grid, than this share of the finest step.
const NARROW: f64 = 1e-3;
const NARROW_IN_STEPS: f64 = 0.3;
/// Generations in a row without a new set, after which a distribution is replaced.
const BARREN: u32 = 3;

/// The tuner.
pub(super) fn new(config: &RunConfig) -> Search<Cem> {
    let number = |key: &str| config.tuner.settings.number(key);
    let (population, best) = (number("population") as usize, number("best") as usize);
    let keep = number("keep");
    Search::new(config, |space| Cem::new(population, best.min(population), keep, space))
}

/// A distribution, and what was drawn from it last.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Cem {
    population: usize,
    best: usize,
    /// Share of the old distribution that is kept.
    keep: f64,
    narrow: f64,
    mean: Vec<f64>,
    widths: Vec<f64>,
    barren: u32,
    /// The least value when a distribution was replaced, which nothing was clearly better than since; else infinite.
    settled_at: f64,
    /// The points drawn last, before they were moved onto the grid.
    drawn: Vec<Point>,
}

impl Cem {
    fn new(population: usize, best: usize, keep: f64, space: &Space) -> Self {
        let dimensions = space.cube.dimensions();
        let finest = (0..dimensions)
            .filter_map(|axis| space.cube.values(axis))
            .filter(|values| *values > 1)
            .map(|values| 1.0 / (values - 1) as f64)
            .fold(f64::INFINITY, f64::min);
        Self {
            population,
            best,
            keep,
            narrow: if finest.is_finite() { NARROW_IN_STEPS * finest } else { NARROW },
            mean: vec![0.5; dimensions],
            widths: vec![WIDTH; dimensions],
            barren: 0,
            settled_at: f64::INFINITY,
            drawn: Vec::new(),
        }
    }
}

impl Method for Cem {
    fn propose(&mut self, space: &mut Space, _room: usize) -> Vec<Point> {
        if self.barren >= BARREN || self.widths.iter().all(|it| *it < self.narrow) {
            self.settled_at = self.settled_at.min(space.least());
            self.mean = space.draw();
            self.widths.fill(WIDTH);
            self.barren = 0;
        }
        let draw = |_| {
            let each = self.mean.iter().zip(&self.widths);
            each.map(|(mean, width)| (mean + width * space.rng.normal()).clamp(0.0, 1.0)).collect()
        };
        self.drawn = (0..self.population).map(draw).collect();
        let points: Vec<Point> = self.drawn.iter().map(|it| space.cube.nearest(it)).collect();
        let is_barren = points.iter().all(|point| space.find(point).is_some());
        self.barren = if is_barren { self.barren + 1 } else { 0 };
        points
    }

    fn learn(&mut self, values: &[f64]) {
        let drawn = std::mem::take(&mut self.drawn);
        if values.iter().any(|value| *value < (1.0 - SETTLED) * self.settled_at) {
            self.settled_at = f64::INFINITY;
        }
        if values.len() < drawn.len() || drawn.is_empty() {
            return;
        }
        let mut order: Vec<usize> = (0..drawn.len()).collect();
        // Stable: ties go to what was drawn first.
        order.sort_by(|a, b| values[*a].total_cmp(&values[*b]));
        let best: Vec<&Point> = order.iter().take(self.best).map(|it| &drawn[*it]).collect();
        let count = best.len() as f64;
        for (axis, (mean, width)) in self.mean.iter_mut().zip(&mut self.widths).enumerate() {
            let new = best.iter().map(|it| it[axis]).sum::<f64>() / count;
            let spread = best.iter().map(|it| (it[axis] - new) * (it[axis] - new)).sum::<f64>();
            *mean = self.keep * *mean + (1.0 - self.keep) * new;
            *width = self.keep * *width + (1.0 - self.keep) * (spread / count).sqrt();
        }
    }

    fn is_settled(&self) -> bool {
        self.settled_at.is_finite()
    }

    fn state(&self) -> Vec<f64> {
        let mut state = vec![f64::from(self.barren), self.settled_at];
        state.extend(self.mean.iter().chain(&self.widths).chain(self.drawn.iter().flatten()));
        state
    }

    fn restore(&mut self, state: &[f64]) -> bool {
        let count = self.mean.len();
        let Some((head, rest)) = state.split_at_checked(2) else { return false };
        let Some((parts, drawn)) = rest.split_at_checked(2 * count) else { return false };
        if head[1].is_nan()
            || rest.iter().chain(&head[..1]).any(|it| !it.is_finite())
            || (!drawn.is_empty() && drawn.len() != self.population * count)
        {
            return false;
        }
        (self.barren, self.settled_at) = (head[0] as u32, head[1]);
        self.mean = parts[..count].to_vec();
        self.widths = parts[count..].to_vec();
        self.drawn = drawn.chunks(count).map(<[f64]>::to_vec).collect();
        true
    }
}
