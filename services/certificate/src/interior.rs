//! The largest value of a linear function under linear matrix inequalities, by a primal-dual interior-point method: the
//! direction of Helmberg, Kojima and Monteiro with Mehrotra's predictor and corrector (as in B. Borchers, "CSDP",
//! Optimization Methods and Software 11 (1999) 613–623).
//!
//! Maximise bᵀy where each Z = A₀ + Σ yᵢ·Gᵢ is positive definite; the dual has an X for each, with −tr(Gᵢ·X) = bᵢ in sum.
//! It needs no point inside to begin with. What it finds is a proposal: the check that counts is elsewhere, and uses
//! nothing of this.

// As in the equations: rows and columns by their numbers.
#![allow(clippy::needless_range_loop)]

use crate::small::{Square, cholesky, lower_inverse, product, transposed};

/// The most variables of a problem.
pub(crate) const VARIABLES: usize = 15;

/// The values of the variables.
pub(crate) type Point = [f64; VARIABLES];

/// One inequality: a constant, and for each variable in it its symmetric matrix.
#[derive(Debug, Clone)]
pub(crate) struct Inequality<const N: usize> {
    constant: Square<N>,
    terms: Vec<Term>,
}

/// A variable's part of an inequality: row, column and value of what is not 0, both triangles.
#[derive(Debug, Clone)]
struct Term {
    variable: usize,
    entries: Vec<(usize, usize, f64)>,
}

impl<const N: usize> Inequality<N> {
    /// The inequality of an affine function of the variables.
    pub(crate) fn new(value: impl Fn(&Point) -> Square<N>) -> Self {
        let constant = value(&[0.0; VARIABLES]);
        let mut terms = Vec::new();
        for variable in 0..VARIABLES {
            let mut unit = [0.0; VARIABLES];
            unit[variable] = 1.0;
            let at = value(&unit);
            let mut entries = Vec::new();
            for row in 0..N {
                for column in 0..N {
                    let entry = at[row][column] - constant[row][column];
                    if entry != 0.0 {
                        entries.push((row, column, entry));
                    }
                }
            }
            if !entries.is_empty() {
                terms.push(Term { variable, entries });
            }
        }
        Self { constant, terms }
    }

    /// `start` + Σ yᵢ·Gᵢ.
    fn add_terms(&self, start: Square<N>, y: &Point) -> Square<N> {
        let mut value = start;
        for Term { variable, entries } in &self.terms {
            for &(row, column, entry) in entries {
                value[row][column] += y[*variable] * entry;
            }
        }
        value
    }
}

/// An inequality with its two matrices and their steps.
#[derive(Debug, Clone)]
struct Block<const N: usize> {
    inequality: Inequality<N>,
    z: Square<N>,
    x: Square<N>,
    z_inverse: Square<N>,
    /// A₀ + Σ yᵢ·Gᵢ − Z.
    residual: Square<N>,
    dz: Square<N>,
    dx: Square<N>,
}

fn combined<const N: usize>(a: &Square<N>, share: f64, b: &Square<N>) -> Square<N> {
    std::array::from_fn(|row| std::array::from_fn(|column| a[row][column] + share * b[row][column]))
}

fn trace_of_product<const N: usize>(a: &Square<N>, b: &Square<N>) -> f64 {
    a.iter().flatten().zip(b.iter().flatten()).map(|(a, b)| a * b).sum()
}

/// The largest share, up to 1, of a step after which a matrix is still positive definite, with some distance.
fn longest<const N: usize>(matrix: &Square<N>, step: &Square<N>, mut share: f64) -> f64 {
    while share > 1e-10 && cholesky(&combined(matrix, share, step)).is_none() {
        share *= 0.8;
    }
    share
}

impl<const N: usize> Block<N> {
    fn new(inequality: Inequality<N>, size: f64) -> Self {
        let unit: Square<N> = std::array::from_fn(|row| {
            std::array::from_fn(|column| if row == column { size } else { 0.0 })
        });
        let zero = [[0.0; N]; N];
        Self { inequality, z: unit, x: unit, z_inverse: zero, residual: zero, dz: zero, dx: zero }
    }

    /// Prepares a step, and adds to the linear equations for dy: to the matrix tr(Gᵢ·X·Gⱼ·Z⁻¹), to the right side
    /// −tr(Gᵢ·X·R·Z⁻¹), where R is the residual.
    fn prepare(
        &mut self,
        y: &Point,
        matrix: &mut Square<VARIABLES>,
        side: &mut Point,
    ) -> Option<()> {
        let lower = lower_inverse(&cholesky(&self.z)?);
        self.z_inverse = product(&transposed(&lower), &lower);
        self.residual =
            combined(&self.inequality.add_terms(self.inequality.constant, y), -1.0, &self.z);
        let by_residual = product(&product(&self.x, &self.residual), &self.z_inverse);
        for term in &self.inequality.terms {
            let mut seen = [[0.0; N]; N];
            for &(row, column, entry) in &term.entries {
                for at in 0..N {
                    let factor = self.x[at][row] * entry;
                    for place in 0..N {
                        seen[at][place] += factor * self.z_inverse[column][place];
                    }
                }
            }
            for other in &self.inequality.terms {
                matrix[other.variable][term.variable] += other.trace_with(&seen);
            }
            side[term.variable] -= term.trace_with(&by_residual);
        }
        Some(())
    }

    /// Adds what centring to `target` and the correction of second order add to the right side.
    fn add_side(&self, target: f64, is_corrected: bool, side: &mut Point) {
        let correction = self.correction();
        for term in &self.inequality.terms {
            side[term.variable] += target * term.trace_with(&self.z_inverse);
            if is_corrected {
                side[term.variable] -= term.trace_with(&correction);
            }
        }
    }

    /// dX·dZ·Z⁻¹ of the predictor.
    fn correction(&self) -> Square<N> {
        product(&product(&self.dx, &self.dz), &self.z_inverse)
    }

    /// The steps that belong to dy: dZ = R + Σ dyᵢ·Gᵢ, dX = target·Z⁻¹ − X − X·dZ·Z⁻¹ − correction, made symmetric.
    fn set_steps(&mut self, dy: &Point, target: f64, is_corrected: bool) {
        let correction = self.correction();
        self.dz = self.inequality.add_terms(self.residual, dy);
        let moved = product(&product(&self.x, &self.dz), &self.z_inverse);
        let mut dx = combined(&combined(&moved, 1.0, &self.x), -target, &self.z_inverse);
        if is_corrected {
            dx = combined(&dx, 1.0, &correction);
        }
        self.dx = std::array::from_fn(|row| {
            std::array::from_fn(|column| -0.5 * (dx[row][column] + dx[column][row]))
        });
    }

    fn go(&mut self, x_share: f64, z_share: f64) {
        self.x = combined(&self.x, x_share, &self.dx);
        self.z = combined(&self.z, z_share, &self.dz);
    }
}

impl Term {
    /// tr(Gᵢ·A).
    fn trace_with<const N: usize>(&self, a: &Square<N>) -> f64 {
        self.entries.iter().map(|&(row, column, entry)| entry * a[column][row]).sum()
    }
}

/// A problem: inequalities of three sizes, and the function that is made large.
#[derive(Debug, Clone)]
pub(crate) struct Problem {
    pub(crate) large: Vec<Inequality<8>>,
    pub(crate) middle: Vec<Inequality<5>>,
    pub(crate) single: Vec<Inequality<1>>,
    pub(crate) objective: Point,
}

/// Iterations after which there is no solution, or none that can be reached: about 30 suffice.
const ITERATIONS: usize = 80;

struct Blocks {
    large: Vec<Block<8>>,
    middle: Vec<Block<5>>,
    single: Vec<Block<1>>,
}

/// The same for blocks of every size.
macro_rules! each {
    ($blocks:expr, $name:ident => $body:expr) => {{
        for $name in &mut $blocks.large {
            $body;
        }
        for $name in &mut $blocks.middle {
            $body;
        }
        for $name in &mut $blocks.single {
            $body;
        }
    }};
}

impl Blocks {
    /// tr(X·Z), after a share of the steps.
    fn complementarity(&mut self, x_share: f64, z_share: f64) -> f64 {
        let mut sum = 0.0;
        each!(self, it => {
            let x = combined(&it.x, x_share, &it.dx);
            sum += trace_of_product(&x, &combined(&it.z, z_share, &it.dz));
        });
        sum
    }

    /// The largest shares of the steps.
    fn longest(&mut self) -> [f64; 2] {
        let (mut x_share, mut z_share) = (1.0, 1.0);
        each!(self, it => {
            x_share = longest(&it.x, &it.dx, x_share);
            z_share = longest(&it.z, &it.dz, z_share);
        });
        [x_share, z_share]
    }
}

impl Problem {
    /// The variables with the largest value, to within `near` as a share of it, strictly inside of all inequalities; `None`
    /// if none were found.
    pub(crate) fn solve(self, size: f64, near: f64) -> Option<Point> {
        let objective = self.objective;
        let count = (8 * self.large.len() + 5 * self.middle.len() + self.single.len()) as f64;
        let mut blocks = Blocks {
            large: self.large.into_iter().map(|it| Block::new(it, size)).collect(),
            middle: self.middle.into_iter().map(|it| Block::new(it, size)).collect(),
            single: self.single.into_iter().map(|it| Block::new(it, size)).collect(),
        };
        let mut y = [0.0; VARIABLES];
        let mut is_inside = false;
        for _ in 0..ITERATIONS {
            let total = blocks.complementarity(0.0, 0.0);
            let value: f64 = objective.iter().zip(y).map(|(b, y)| b * y).sum();
            if is_inside && total < near * value.abs() {
                return Some(y);
            }
            let mut matrix = [[0.0; VARIABLES]; VARIABLES];
            let mut side = objective;
            each!(blocks, it => it.prepare(&y, &mut matrix, &mut side)?);
            let equations = Equations::new(matrix)?;
            let dy = equations.solve(&side);
            each!(blocks, it => it.set_steps(&dy, 0.0, false));
            let [x_share, z_share] = blocks.longest();
            let share = blocks.complementarity(x_share, z_share) / total;
            let target = (share * share * share).clamp(1e-4, 0.9) * total / count;
            each!(blocks, it => it.add_side(target, true, &mut side));
            let dy = equations.solve(&side);
            each!(blocks, it => it.set_steps(&dy, target, true));
            let [x_share, z_share] =
                blocks.longest().map(|share| if share < 1.0 { 0.9 * share } else { 1.0 });
            if x_share.max(z_share) < 1e-7 {
                return None;
            }
            each!(blocks, it => it.go(x_share, z_share));
            y.iter_mut().zip(dy).for_each(|(y, dy)| *y += z_share * dy);
            // After a whole step, Z is what the inequalities say.
            is_inside |= z_share == 1.0;
            if !y.iter().all(|it| it.is_finite()) {
                return None;
            }
        }
        None
    }
}

/// Symmetric linear equations, scaled to a unit diagonal.
struct Equations {
    scale: Point,
    inverse: Square<VARIABLES>,
}

impl Equations {
    fn new(mut matrix: Square<VARIABLES>) -> Option<Self> {
        let scale: Point =
            std::array::from_fn(|place| 1.0 / matrix[place][place].max(f64::MIN_POSITIVE).sqrt());
        for row in 0..VARIABLES {
            for column in 0..VARIABLES {
                matrix[row][column] *= scale[row] * scale[column];
            }
            // As little as rounding may have taken away.
            matrix[row][row] += 1e-14;
        }
        Some(Self { scale, inverse: lower_inverse(&cholesky(&matrix)?) })
    }

    fn solve(&self, side: &Point) -> Point {
        let mut out = [0.0; VARIABLES];
        for row in 0..VARIABLES {
            let half: f64 = (0..=row).map(|k| self.inverse[row][k] * self.scale[k] * side[k]).sum();
            for column in 0..=row {
                out[column] += self.inverse[row][column] * half;
            }
        }
        out.iter_mut().zip(self.scale).for_each(|(out, scale)| *out *= scale);
        out
    }
}
