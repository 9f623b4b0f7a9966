//! Robust nonlinear least squares: Levenberg–Marquardt with Huber's weights, bounds and a weak prior.
//!
//! What is made small is Σ (wᵢ rᵢ(p))² + Σ ((pⱼ − mⱼ) / sⱼ)². The first sum runs over the residuals; their weights wᵢ = √hᵢ / σ
//! hold Huber's weight hᵢ and the spread σ of the residual's channel, and stay as they are while the parameters move. The
//! second sum is the prior.

use nalgebra::{DMatrix, DVector};

use crate::fit::Z95;

/// Huber's constant: 95 % as efficient as plain least squares where the noise is Gaussian.
pub(crate) const HUBER: f64 = 1.345;
/// Median of |x| of a Gaussian x with a standard deviation of 1, inverted.
const MAD_TO_SD: f64 = 1.4826;

/// A step that gains less (in units of twice the logarithm of the likelihood) is the last one: it moves no parameter by more
/// than a fifth of its standard deviation.
const ENOUGH: f64 = 0.03;

/// No parameter moves by more than this in a step, in standard deviations of its prior.
const LONGEST_STEP: f64 = 0.4;

/// One parameter, in the coordinates in which it is fitted (logarithms of what is positive).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Axis {
    pub(crate) low: f64,
    pub(crate) high: f64,
    /// Centre and standard deviation of the prior.
    pub(crate) prior: f64,
    pub(crate) prior_sd: f64,
    /// The file's value; the lowest one for a 0 whose logarithm is fitted.
    pub(crate) file: f64,
    /// Step of the difference quotients.
    pub(crate) step: f64,
    /// Whether they look to both sides, as a function with kinks needs it.
    pub(crate) is_two_sided: bool,
    /// Whether it is fitted; it stays where it is otherwise.
    pub(crate) free: bool,
}

/// Where a residual belongs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Place {
    /// Residuals of a channel have one spread.
    pub(crate) channel: usize,
    /// Residuals of a block (some seconds of a drive) may depend on each other.
    pub(crate) block: usize,
    /// Whether it tells anything about its channel's spread: a car that stands does not.
    pub(crate) telling: bool,
}

/// What is fitted.
pub(crate) trait Model {
    /// All parameters.
    fn axes(&self) -> &[Axis];
    /// Where each residual belongs.
    fn places(&self) -> &[Place];
    /// The least spread of each channel.
    fn floors(&self) -> &[f64];
    /// The residuals; `weights` are those of the present pass.
    fn residuals(&self, at: &[f64], weights: &[f64], out: &mut [f64]);
}

/// Weights of the residuals, and spreads of the channels.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Weights {
    pub(crate) each: Vec<f64>,
    /// Told by medians, as if the noise were normal.
    pub(crate) spreads: Vec<f64>,
    /// Standard deviations of what is within a few spreads, whatever the noise is like: of noise that is even, a median tells
    /// 1.3 times as much.
    pub(crate) deviations: Vec<f64>,
}

/// Median; 0 of nothing.
pub(crate) fn median(values: &mut [f64]) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// Standard deviation of values around 0, told by the median of their absolutes.
pub(crate) fn robust_sd(values: impl Iterator<Item = f64>) -> f64 {
    let mut absolutes: Vec<f64> = values.map(f64::abs).collect();
    MAD_TO_SD * median(&mut absolutes)
}

/// What is farther from 0 than so many spreads is no noise.
const OUTLIERS: f64 = 4.0;

/// Standard deviation around 0 of the values that are no farther from it than `within`; 0 of nothing.
fn sd_within(values: &[f64], within: f64) -> f64 {
    let near = values.iter().filter(|it| it.abs() <= within);
    let (sum, count) = near.fold((0.0, 0_usize), |(sum, count), it| (sum + it * it, count + 1));
    (sum / count.max(1) as f64).sqrt()
}

/// Standard deviation of white noise, whatever the car did, from every four samples that follow each other: differences of the
/// third order know no motion that is smooth.
pub(crate) fn white_noise_sd<'a>(fours: impl Iterator<Item = &'a [f64]>) -> f64 {
    let differences = fours.map(|it| it[3] - 3.0 * it[2] + 3.0 * it[1] - it[0]);
    robust_sd(differences) / 20.0_f64.sqrt()
}

/// All the same.
pub(crate) fn even(model: &impl Model) -> Weights {
    let channels = model.floors().len();
    let ones = || vec![1.0; channels];
    Weights { each: vec![1.0; model.places().len()], spreads: ones(), deviations: ones() }
}

/// The weights at a place. `counts` says which blocks are fitted; the others have weight 0.
pub(crate) fn weigh(
    model: &impl Model,
    at: &[f64],
    last: &Weights,
    counts: &dyn Fn(usize) -> bool,
) -> Weights {
    let places = model.places();
    let mut residuals = vec![0.0; places.len()];
    model.residuals(at, &last.each, &mut residuals);
    let (spreads, deviations): (Vec<f64>, Vec<f64>) = (0..model.floors().len())
        .map(|channel| {
            let of = places.iter().zip(&residuals);
            let of = of.filter(|(it, _)| it.channel == channel && it.telling && counts(it.block));
            let of: Vec<f64> = of.map(|(_, residual)| *residual).collect();
            let spread = robust_sd(of.iter().copied()).max(model.floors()[channel]);
            (spread, sd_within(&of, OUTLIERS * spread))
        })
        .unzip();
    let weight = |(place, residual): (&Place, &f64)| {
        if !counts(place.block) {
            return 0.0;
        }
        let share = HUBER * spreads[place.channel] / residual.abs().max(1e-300);
        share.min(1.0).sqrt() / spreads[place.channel]
    };
    Weights { each: places.iter().zip(&residuals).map(weight).collect(), spreads, deviations }
}

/// Residuals and cost at a place.
struct Here {
    residuals: Vec<f64>,
    cost: f64,
}

fn look(model: &impl Model, weights: &Weights, at: &[f64]) -> Here {
    let mut residuals = vec![0.0; weights.each.len()];
    model.residuals(at, &weights.each, &mut residuals);
    let data: f64 = residuals.iter().zip(&weights.each).map(|(r, w)| (r * w) * (r * w)).sum();
    let prior = |(axis, at): (&Axis, &f64)| {
        if axis.free { ((at - axis.prior) / axis.prior_sd).powi(2) } else { 0.0 }
    };
    let cost = data + model.axes().iter().zip(at).map(prior).sum::<f64>();
    Here { residuals, cost: if cost.is_finite() { cost } else { f64::INFINITY } }
}

/// The cost at a place.
pub(crate) fn cost(model: &impl Model, weights: &Weights, at: &[f64]) -> f64 {
    look(model, weights, at).cost
}

/// Numbers of the parameters that are fitted.
pub(crate) fn free(axes: &[Axis]) -> Vec<usize> {
    (0..axes.len()).filter(|&index| axes[index].free).collect()
}

/// Weighted derivatives of the residuals: a column for each parameter that is fitted.
fn slopes(model: &impl Model, weights: &Weights, at: &[f64], here: &Here) -> Vec<Vec<f64>> {
    let axes = model.axes();
    let mut moved = vec![0.0; here.residuals.len()];
    let mut behind = moved.clone();
    free(axes)
        .into_iter()
        .map(|index| {
            let axis = &axes[index];
            let mut there = at.to_vec();
            there[index] = (at[index] + axis.step).min(axis.high);
            model.residuals(&there, &weights.each, &mut moved);
            let ahead = there[index];
            // At a bound, inwards.
            if axis.is_two_sided || ahead == at[index] {
                there[index] = (at[index] - axis.step).max(axis.low);
                model.residuals(&there, &weights.each, &mut behind);
            } else {
                there[index] = at[index];
                behind.copy_from_slice(&here.residuals);
            }
            let width = ahead - there[index];
            let slope = moved.iter().zip(&behind).zip(&weights.each);
            slope.map(|((moved, behind), weight)| (moved - behind) / width * weight).collect()
        })
        .collect()
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Goes downhill from `start`, for at most so many iterations; returns where it came to.
pub(crate) fn descend(
    model: &impl Model,
    weights: &Weights,
    start: &[f64],
    iterations: usize,
) -> Vec<f64> {
    let axes = model.axes();
    let free = free(axes);
    let mut at: Vec<f64> =
        start.iter().zip(axes).map(|(at, axis)| at.clamp(axis.low, axis.high)).collect();
    let mut here = look(model, weights, &at);
    let mut damping = 1e-3;
    for _ in 0..iterations {
        let slopes = slopes(model, weights, &at, &here);
        let weighted: Vec<f64> =
            here.residuals.iter().zip(&weights.each).map(|(r, w)| r * w).collect();
        let count = free.len();
        let mut normal = DMatrix::zeros(count, count);
        let mut gradient = DVector::zeros(count);
        for (row, &index) in free.iter().enumerate() {
            for column in 0..=row {
                normal[(row, column)] = dot(&slopes[row], &slopes[column]);
                normal[(column, row)] = normal[(row, column)];
            }
            let axis = &axes[index];
            let tight = 1.0 / (axis.prior_sd * axis.prior_sd);
            normal[(row, row)] += tight;
            gradient[row] = dot(&slopes[row], &weighted) + tight * (at[index] - axis.prior);
        }
        let mut is_done = true;
        for _ in 0..8 {
            let mut damped = normal.clone();
            for row in 0..count {
                damped[(row, row)] *= 1.0 + damping;
            }
            let Some(cholesky) = damped.cholesky() else {
                damping *= 10.0;
                continue;
            };
            let mut step = cholesky.solve(&gradient);
            // Far from the minimum the model is not linear: no parameter may run away.
            let longest = free.iter().enumerate().fold(0.0_f64, |longest, (row, &index)| {
                longest.max(step[row].abs() / axes[index].prior_sd)
            });
            if longest > LONGEST_STEP {
                step *= LONGEST_STEP / longest;
            }
            let mut there = at.clone();
            for (row, &index) in free.iter().enumerate() {
                there[index] = (at[index] - step[row]).clamp(axes[index].low, axes[index].high);
            }
            let next = look(model, weights, &there);
            if next.cost < here.cost {
                is_done = here.cost - next.cost < ENOUGH;
                (at, here) = (there, next);
                damping = (damping / 5.0).max(1e-9);
                break;
            }
            damping *= 5.0;
        }
        if is_done {
            break;
        }
    }
    at
}

/// Goes downhill in several passes, each with the weights of the place where the last one ended. The weights that come back
/// are those of the end: they tell what the fit leaves.
pub(crate) fn settle(
    model: &impl Model,
    weights: Weights,
    start: &[f64],
    passes: usize,
    counts: &dyn Fn(usize) -> bool,
) -> (Vec<f64>, Weights) {
    let (mut at, mut weights) = (start.to_vec(), weights);
    for _ in 0..passes {
        weights = weigh(model, &at, &weights, counts);
        at = descend(model, &weights, &at, 10);
    }
    weights = weigh(model, &at, &weights, counts);
    (at, weights)
}

/// How uncertain parameters are.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Spread {
    /// Numbers of the parameters that were fitted, in the order of rows and columns.
    pub(crate) free: Vec<usize>,
    /// Covariance if each residual is independent of the others.
    pub(crate) independent: DMatrix<f64>,
    /// Covariance if only blocks are independent: that of a linearised bootstrap over blocks in the limit of many draws.
    pub(crate) by_blocks: DMatrix<f64>,
    /// What each block tells: JᵀW²J of its residuals.
    pub(crate) told_by: Vec<DMatrix<f64>>,
}

impl Spread {
    /// Variance of a linear combination of the fitted parameters (`of` has one factor for each): the wider of both. A scatter
    /// over few blocks is itself uncertain, so that of the blocks is taken for as much wider as Student's interval is than the
    /// normal one, with as many blocks as tell this combination evenly.
    pub(crate) fn variance(&self, of: &DVector<f64>) -> f64 {
        let quadratic = |matrix: &DMatrix<f64>| (of.transpose() * matrix * of)[(0, 0)];
        let tells = &self.independent * of;
        let shares = self.told_by.iter().map(|it| (tells.transpose() * it * &tells)[(0, 0)]);
        let (sum, squares) =
            shares.fold((0.0, 0.0), |(sum, squares): (f64, f64), it| (sum + it, squares + it * it));
        let blocks = if squares > 0.0 { sum * sum / squares } else { f64::INFINITY };
        let wider = student(blocks - 1.0) / Z95;
        quadratic(&self.independent).max(wider * wider * quadratic(&self.by_blocks))
    }
}

/// The 97.5th percentile of Student's distribution with so many degrees of freedom, at least three: by Cornish and Fisher's
/// expansion, within 2 %.
fn student(freedom: f64) -> f64 {
    let (n, z) = (freedom.max(3.0), Z95);
    let cubed = z * z * z;
    z + (cubed + z) / (4.0 * n) + (5.0 * cubed * z * z + 16.0 * cubed + 3.0 * z) / (96.0 * n * n)
}

/// The spread of the parameters around the place that a fit has found; `None` if a parameter has no effect whatever.
///
/// With H = JᵀW²J + P (P is the prior's share) and gᵦ the gradient of block b, the covariances are H⁻¹ and
/// H⁻¹ (n/(n − 1) Σ gᵦgᵦᵀ + P) H⁻¹.
pub(crate) fn spread(model: &impl Model, weights: &Weights, at: &[f64]) -> Option<Spread> {
    let axes = model.axes();
    let free = free(axes);
    let count = free.len();
    let here = look(model, weights, at);
    let slopes = slopes(model, weights, at, &here);
    let mut normal = DMatrix::<f64>::zeros(count, count);
    for row in 0..count {
        for column in 0..count {
            normal[(row, column)] = dot(&slopes[row], &slopes[column]);
        }
    }
    let mut prior = DMatrix::<f64>::zeros(count, count);
    for (row, &index) in free.iter().enumerate() {
        prior[(row, row)] = 1.0 / (axes[index].prior_sd * axes[index].prior_sd);
    }
    let inverse = (normal + &prior).cholesky()?.inverse();
    let blocks = model.places().iter().map(|it| it.block + 1).max().unwrap_or(0);
    let mut gradients = vec![DVector::<f64>::zeros(count); blocks];
    let mut told_by = vec![DMatrix::<f64>::zeros(count, count); blocks];
    let mut is_used = vec![false; blocks];
    for (index, place) in model.places().iter().enumerate() {
        let weighted = here.residuals[index] * weights.each[index];
        is_used[place.block] |= weights.each[index] > 0.0;
        let told = &mut told_by[place.block];
        for (row, slope) in slopes.iter().enumerate() {
            gradients[place.block][row] += slope[index] * weighted;
            for (column, other) in slopes.iter().enumerate() {
                told[(row, column)] += slope[index] * other[index];
            }
        }
    }
    let used = is_used.iter().filter(|used| **used).count().max(2) as f64;
    let mut scatter: DMatrix<f64> = prior;
    for gradient in gradients {
        scatter += &gradient * gradient.transpose() * (used / (used - 1.0));
    }
    let by_blocks = &inverse * scatter * &inverse;
    Some(Spread { free, independent: inverse, by_blocks, told_by })
}
