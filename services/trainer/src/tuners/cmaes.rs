//! CMA-ES: generations drawn from a normal distribution whose mean, width and shape follow the better half of them.
//!
//! N. Hansen, "The CMA Evolution Strategy: A Tutorial" (2016), with its default constants. Sets are drawn with the Cholesky
//! factor of the covariance, and so is the path of the width kept (O. Krause, D. R. Arbonès, C. Igel, "CMA-ES with optimal
//! covariance update and storage complexity", 2016). A distribution that has become narrow, or that finds nothing new, is
//! replaced by a new one around a set drawn at random.

use config::RunConfig;

use crate::search::{Cholesky, Method, Point, SETTLED, Search, Space};

/// Width of a new distribution, as a share of the axes.
const WIDTH: f64 = 0.3;
/// The greatest width.
const WIDEST: f64 = 1.0;
/// A distribution narrower than this is replaced; on a grid, one narrower than this share of the finest step.
const NARROW: f64 = 1e-3;
const NARROW_IN_STEPS: f64 = 0.3;
/// Generations in a row without a new set, after which a distribution is replaced.
const BARREN: u32 = 3;

/// The tuner.
pub(super) fn new(config: &RunConfig) -> Search<Cmaes> {
    let population = config.tuner.settings.number("population") as usize;
    Search::new(config, |space| Cmaes::new(population, space))
}

/// A distribution, and what was drawn from it last.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Cmaes {
    weights: Vec<f64>,
    population: usize,
    narrow: f64,
    mean: Vec<f64>,
    width: f64,
    /// Row by row.
    covariance: Vec<f64>,
    /// Paths of the mean, in units of the distribution and in those of the cube.
    width_path: Vec<f64>,
    shape_path: Vec<f64>,
    /// Generations that this distribution has learnt from, and those in a row that held nothing new.
    learnt: u32,
    barren: u32,
    /// The least value when a distribution was replaced, which nothing was clearly better than since; else infinite.
    settled_at: f64,
    /// The points drawn last, before they were moved onto the grid.
    drawn: Vec<Point>,
}

impl Cmaes {
    fn new(population: usize, space: &Space) -> Self {
        let dimensions = space.cube.dimensions();
        let raw =
            |rank: usize| libm::log(population as f64 / 2.0 + 0.5) - libm::log(rank as f64 + 1.0);
        let better = (population / 2).max(1);
        let sum: f64 = (0..better).map(raw).sum();
        let finest = (0..dimensions)
            .filter_map(|axis| space.cube.values(axis))
            .filter(|values| *values > 1)
            .map(|values| 1.0 / (values - 1) as f64)
            .fold(f64::INFINITY, f64::min);
        let narrow = if finest.is_finite() { NARROW_IN_STEPS * finest } else { NARROW };
        let mut it = Self {
            weights: (0..better).map(|rank| raw(rank) / sum).collect(),
            population,
            narrow,
            mean: Vec::new(),
            width: WIDTH,
            covariance: Vec::new(),
            width_path: Vec::new(),
            shape_path: Vec::new(),
            learnt: 0,
            barren: 0,
            settled_at: f64::INFINITY,
            drawn: Vec::new(),
        };
        it.start(vec![0.5; dimensions]);
        it
    }

    fn start(&mut self, mean: Point) {
        let count = mean.len();
        self.mean = mean;
        self.width = WIDTH;
        self.covariance =
            (0..count * count).map(|it| if it % (count + 1) == 0 { 1.0 } else { 0.0 }).collect();
        self.width_path = vec![0.0; count];
        self.shape_path = vec![0.0; count];
        (self.learnt, self.barren) = (0, 0);
        self.drawn.clear();
    }

    fn is_narrow(&self) -> bool {
        let count = self.mean.len();
        let widest = (0..count).map(|axis| self.covariance[axis * (count + 1)]).fold(0.0, f64::max);
        self.width * widest.sqrt() < self.narrow
    }

    fn factor(&self) -> Option<Cholesky> {
        Cholesky::of(self.covariance.clone(), self.mean.len())
    }
}

impl Method for Cmaes {
    fn propose(&mut self, space: &mut Space, _room: usize) -> Vec<Point> {
        let mut factor = self.factor();
        if self.barren >= BARREN || self.is_narrow() || factor.is_none() {
            self.settled_at = self.settled_at.min(space.least());
            let mean = space.draw();
            self.start(mean);
            factor = self.factor();
        }
        let factor = factor.expect("a new distribution has a factor");
        let draw = |_| {
            let z: Vec<f64> = self.mean.iter().map(|_| space.rng.normal()).collect();
            let off = factor.times(&z);
            let each = self.mean.iter().zip(off);
            each.map(|(mean, off)| (mean + self.width * off).clamp(0.0, 1.0)).collect()
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
        let Some(factor) = self.factor() else { return };
        let n = self.mean.len() as f64;
        let effective = 1.0 / self.weights.iter().map(|it| it * it).sum::<f64>();
        let width_rate = (effective + 2.0) / (n + effective + 5.0);
        let damping = 1.0
            + width_rate
            + 2.0 * (((effective - 1.0) / (n + 1.0)).max(0.0).sqrt() - 1.0).max(0.0);
        let path_rate = (4.0 + effective / n) / (n + 4.0 + 2.0 * effective / n);
        let one_rate = 2.0 / ((n + 1.3) * (n + 1.3) + effective);
        let many_rate = (2.0 * (effective - 2.0 + 1.0 / effective)
            / ((n + 2.0) * (n + 2.0) + effective))
            .clamp(0.0, 1.0 - one_rate);
        let usual = n.sqrt() * (1.0 - 1.0 / (4.0 * n) + 1.0 / (21.0 * n * n));

        let mut order: Vec<usize> = (0..drawn.len()).collect();
        // Stable: ties go to what was drawn first.
        order.sort_by(|a, b| values[*a].total_cmp(&values[*b]));
        let off = |point: &Point| -> Vec<f64> {
            point.iter().zip(&self.mean).map(|(it, mean)| (it - mean) / self.width).collect()
        };
        let best: Vec<Vec<f64>> =
            order.iter().take(self.weights.len()).map(|it| off(&drawn[*it])).collect();
        let mut moved = vec![0.0; self.mean.len()];
        for (off, weight) in best.iter().zip(&self.weights) {
            moved.iter_mut().zip(off).for_each(|(it, off)| *it += weight * off);
        }
        let mut moved_z = moved.clone();
        factor.solve_lower(&mut moved_z, 1);

        let share = (width_rate * (2.0 - width_rate) * effective).sqrt();
        for (path, by) in self.width_path.iter_mut().zip(&moved_z) {
            *path = (1.0 - width_rate) * *path + share * by;
        }
        let length = self.width_path.iter().map(|it| it * it).sum::<f64>().sqrt();
        self.learnt += 1;
        let settled = 1.0 - libm::pow(1.0 - width_rate, 2.0 * f64::from(self.learnt));
        let is_slow = length / settled.sqrt() < (1.4 + 2.0 / (n + 1.0)) * usual;
        let share = if is_slow { (path_rate * (2.0 - path_rate) * effective).sqrt() } else { 0.0 };
        for (path, by) in self.shape_path.iter_mut().zip(&moved) {
            *path = (1.0 - path_rate) * *path + share * by;
        }
        let lost = if is_slow { 0.0 } else { one_rate * path_rate * (2.0 - path_rate) };
        let count = self.mean.len();
        for row in 0..count {
            for column in 0..count {
                let many: f64 = best
                    .iter()
                    .zip(&self.weights)
                    .map(|(off, weight)| weight * off[row] * off[column])
                    .sum();
                let it = &mut self.covariance[row * count + column];
                *it = (1.0 - one_rate - many_rate + lost) * *it
                    + one_rate * self.shape_path[row] * self.shape_path[column]
                    + many_rate * many;
            }
        }
        for (mean, by) in self.mean.iter_mut().zip(&moved) {
            *mean = (*mean + self.width * by).clamp(0.0, 1.0);
        }
        let faster = (width_rate / damping * (length / usual - 1.0)).min(1.0);
        self.width = (self.width * libm::exp(faster)).min(WIDEST);
    }

    fn is_settled(&self) -> bool {
        self.settled_at.is_finite()
    }

    fn state(&self) -> Vec<f64> {
        let counts = [self.learnt, self.barren].map(f64::from);
        let mut state = vec![self.width, counts[0], counts[1], self.settled_at];
        for part in [&self.mean, &self.width_path, &self.shape_path, &self.covariance] {
            state.extend(part);
        }
        state.extend(self.drawn.iter().flatten());
        state
    }

    fn restore(&mut self, state: &[f64]) -> bool {
        let count = self.mean.len();
        let Some((head, rest)) = state.split_at_checked(4) else { return false };
        let Some((parts, drawn)) = rest.split_at_checked((3 + count) * count) else { return false };
        if head[3].is_nan()
            || rest.iter().chain(&head[..3]).any(|it| !it.is_finite())
            || (!drawn.is_empty() && drawn.len() != self.population * count)
            || !(0.0..=WIDEST).contains(&head[0])
        {
            return false;
        }
        (self.width, self.learnt, self.barren) = (head[0], head[1] as u32, head[2] as u32);
        self.settled_at = head[3];
        let mut parts = parts.chunks(count);
        let mut next = || parts.next().expect("as many as were counted").to_vec();
        (self.mean, self.width_path, self.shape_path) = (next(), next(), next());
        self.covariance = parts.flatten().copied().collect();
        self.drawn = drawn.chunks(count).map(<[f64]>::to_vec).collect();
        true
    }
}

#[cfg(test)]
mod tests {
    use config::Layers;
    use tracking::DriveRecord;

    use crate::{by_values, tuners};

    #[test]
    fn a_narrow_valley_across_two_axes_is_followed() {
        for (name, within) in [("cmaes", 0.02), ("cem", 0.4)] {
            let mut layers = Layers::maneuver("lane_change").unwrap();
            for set in [
                &format!("learning.tuner={name}"),
                "tuner.settings.draw=continuous",
                "tuner.settings.drives=400",
            ] {
                layers.set(set).unwrap();
            }
            let config = layers.resolve().unwrap();
            let axes = config.grid().axes().to_vec();
            let mut tuner = tuners::tuner(name, &config);
            let value = |set: &config::Parameters| {
                let share = |at: usize| {
                    (set.0[at] - axes[at].min()) / (axes[at].max() - axes[at].min()) - 0.4
                };
                let (along, across) = (share(0) + share(1), share(0) - share(1));
                along * along + 100.0 * across * across + share(2) * share(2) + share(3) * share(3)
            };
            while !tuner.is_finished() {
                for learner in 0..tuner.learners() {
                    let Some(ask) = tuner.wanted(learner) else { continue };
                    tuner.tell(&ask, &DriveRecord::default(), value(&ask.parameters));
                }
            }
            let found = value(&tuner.recommend(&by_values));
            assert!(found < within * within, "{name}: {found}");
        }
    }
}
