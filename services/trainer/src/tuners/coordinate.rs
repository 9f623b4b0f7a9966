//! Coordinate search: one parameter after the other is tried at several values, and keeps the best. Once a round over all
//! parameters has changed nothing, the search starts again from the best set with half of its parameters drawn anew. It
//! starts first in the middle.

use config::RunConfig;

use crate::search::{Known, Method, Point, Search, Space};

/// An axis of the grid with at most so many values is tried at all of them.
const ALL: usize = 9;
/// Otherwise it is tried at so many values on each side, over a span that becomes half as long with each round.
const EACH_SIDE: i32 = 3;
/// How often a start near the best set is drawn, until it is new.
const TRIES: usize = 20;
/// The least span, as a share of the axis.
const LEAST_SPAN: f64 = 1.0 / 128.0;

/// The tuner.
pub(super) fn new(config: &RunConfig) -> Search<Coordinate> {
    Search::new(config, Coordinate::new)
}

/// Where the search stands.
#[derive(Debug, Clone)]
pub(crate) struct Coordinate {
    /// The best point since the last start, and its value.
    at: Point,
    value: f64,
    /// The axes in the order of this round, and how many of them are done.
    order: Vec<usize>,
    done: usize,
    /// How far from the point an axis is tried, as a share of the axis.
    span: f64,
    has_improved: bool,
    /// The points proposed last.
    tried: Vec<Point>,
}

impl Coordinate {
    fn new(space: &mut Space) -> Self {
        let dimensions = space.cube.dimensions();
        let mut it = Self {
            at: Vec::new(),
            value: f64::INFINITY,
            order: (0..dimensions).collect(),
            done: 0,
            span: 1.0,
            has_improved: false,
            tried: Vec::new(),
        };
        it.start(space.cube.nearest(&vec![0.5; dimensions]), space);
        it
    }

    fn start(&mut self, at: Point, space: &mut Space) {
        self.at = at;
        (self.value, self.span) = (f64::INFINITY, 1.0);
        self.start_round(space);
    }

    fn start_round(&mut self, space: &mut Space) {
        for last in (1..self.order.len()).rev() {
            let other = space.rng.below(last + 1);
            self.order.swap(last, other);
        }
        (self.done, self.has_improved) = (0, false);
    }
}

/// The best set so far with half of its parameters drawn anew; a set drawn at random if none of those is new.
fn near_best(space: &mut Space) -> Point {
    let better = |a: &&Known, b: &&Known| a.mean().total_cmp(&b.mean());
    let Some(best) = space.known.iter().min_by(better).map(|it| it.point.clone()) else {
        return space.draw();
    };
    for _ in 0..TRIES {
        let (mut point, drawn) = (best.clone(), space.draw());
        let mut axes: Vec<usize> = (0..point.len()).collect();
        for _ in 0..point.len().div_ceil(2) {
            let axis = axes.swap_remove(space.rng.below(axes.len()));
            point[axis] = drawn[axis];
        }
        if space.is_new(&point, &[]) {
            return point;
        }
    }
    space.draw_new(&[]).unwrap_or_else(|| space.draw())
}

impl Method for Coordinate {
    fn propose(&mut self, space: &mut Space, _room: usize) -> Vec<Point> {
        if self.done == self.order.len() {
            let is_fine = (0..self.order.len())
                .all(|axis| space.cube.values(axis).is_some_and(|values| values <= ALL));
            self.span /= 2.0;
            if self.has_improved || (!is_fine && self.span >= LEAST_SPAN) {
                self.start_round(space);
            } else {
                let at = near_best(space);
                self.start(at, space);
            }
        }
        let axis = self.order[self.done];
        self.done += 1;
        let along = |coordinate: f64| {
            let mut point = self.at.clone();
            point[axis] = coordinate;
            space.cube.nearest(&point)
        };
        self.tried = match space.cube.values(axis) {
            Some(1) => Vec::new(),
            Some(values) if values <= ALL => {
                (0..values).map(|it| along(it as f64 / (values - 1) as f64)).collect()
            }
            _ => {
                // In the first round over the whole axis, wherever the point lies.
                let centre = if self.span == 1.0 { 0.5 } else { self.at[axis] };
                let side = |it: i32| {
                    along(centre + f64::from(it) / f64::from(EACH_SIDE) * self.span / 2.0)
                };
                (-EACH_SIDE..=EACH_SIDE).map(side).collect()
            }
        };
        if self.value.is_infinite() {
            self.tried.insert(0, self.at.clone());
        }
        self.tried.clone()
    }

    fn learn(&mut self, values: &[f64]) {
        for (point, value) in std::mem::take(&mut self.tried).into_iter().zip(values) {
            if *value < self.value {
                self.has_improved |= self.value.is_finite() && point != self.at;
                (self.at, self.value) = (point, *value);
            }
        }
    }

    fn state(&self) -> Vec<f64> {
        let mut state = vec![self.value, self.done as f64, self.span, f64::from(self.has_improved)];
        state.extend(&self.at);
        state.extend(self.order.iter().map(|axis| *axis as f64));
        state.extend(self.tried.iter().flatten());
        state
    }

    fn restore(&mut self, state: &[f64]) -> bool {
        let count = self.order.len();
        let Some((head, rest)) = state.split_at_checked(4) else { return false };
        if rest.len() < 2 * count || rest.len() % count != 0 {
            return false;
        }
        let (at, order, tried) = (&rest[..count], &rest[count..2 * count], &rest[2 * count..]);
        let mut sorted: Vec<usize> = order.iter().map(|axis| *axis as usize).collect();
        sorted.sort_unstable();
        let is_share = |it: &f64| (0.0..=1.0).contains(it);
        if !sorted.into_iter().eq(0..count)
            || !(0.0..=count as f64).contains(&head[1])
            || !at.iter().chain(tried).all(is_share)
        {
            return false;
        }
        (self.value, self.done, self.span) = (head[0], head[1] as usize, head[2]);
        self.has_improved = head[3] != 0.0;
        self.at = at.to_vec();
        self.order = order.iter().map(|axis| *axis as usize).collect();
        self.tried = tried.chunks(count).map(<[f64]>::to_vec).collect();
        true
    }
}
