//! The fits one after the other: speed, yaw rate, yaw rate with poses; and which keys the drive tells at all.

use config::Vehicle;
use nalgebra::DVector;

use crate::drive::Stretch;
use crate::levenberg::{Axis, Model, Spread, Weights, cost, descend, even, settle, spread, weigh};
use crate::speed::{self, Speed};
use crate::steering::{self, Steering};

/// Half the width of a 95 % interval in standard deviations.
pub(crate) const Z95: f64 = 1.96;
/// A fit that is worse by no more than this (twice the logarithm of the likelihood) agrees with the value that it was held
/// at.
const AGREES: f64 = 1.0;
/// One that is worse by this much contradicts it.
const CONTRADICTED: f64 = 15.0;
/// A parameter with a wider half of an interval is not even told roughly: as a logarithm, a factor of ten.
const MOST_ROUGH: f64 = 2.3;
/// A drive that would be no worse than this by a value without end has not seen the parameter's effect.
const UNSEEN: f64 = 15.0;

/// The place and the spread of a fit with all parameters free, but for those that a car has only where a drive proves it.
#[derive(Debug, Clone)]
pub(crate) struct Whole {
    pub(crate) at: Vec<f64>,
    spread: Spread,
}

/// How wide half of an interval may be for a key to count as identified, in the coordinates of the fit.
pub(crate) type Limit = f64;

/// A fit that is done.
#[derive(Debug, Clone)]
pub(crate) struct Fitted {
    pub(crate) at: Vec<f64>,
    pub(crate) axes: Vec<Axis>,
    pub(crate) weights: Weights,
    pub(crate) spread: Spread,
    /// The same drive, before a parameter was held that it does not tell.
    pub(crate) whole: Whole,
    /// By parameter: what came of it.
    pub(crate) told: Vec<Told>,
}

/// What a drive tells of a parameter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Told {
    /// It is identified.
    Identified,
    /// Its interval is too wide; it keeps the file's value.
    TooWide {
        /// Half the width that it had.
        half: f64,
    },
    /// Its interval is wide, but the file's value fits worse. Where the others take the values of this fit, it has to do
    /// the same: a mixture of both would be no car.
    Roughly,
    /// Its interval is too wide and open to one side, but the file's value fits worse.
    Contradicted {
        /// Half the width that it has.
        half: f64,
    },
    /// A value without end would do as well, or nearly: it is at least so much.
    AtLeast {
        /// A lower one does not fit the drive.
        least: f64,
        /// Whether the file's value does not fit.
        contradicted: bool,
    },
    /// It was never to be fitted.
    Held,
}

impl Fitted {
    /// Variance of a combination of parameters (a factor for some of them) by a spread. Parameters that are held in it have
    /// none.
    fn variance(&self, spread: &Spread, of: &[(usize, f64)]) -> f64 {
        let mut factors = DVector::zeros(spread.free.len());
        for (index, factor) in of {
            if let Some(row) = spread.free.iter().position(|it| it == index) {
                factors[row] += factor;
            }
        }
        // Nothing is known less well than before the drive. Where a model misses something, its blocks may say so.
        let widths = spread.free.iter().map(|&index| self.axes[index].prior_sd);
        let before: f64 =
            factors.iter().zip(widths).map(|(it, sd): (&f64, f64)| (it * sd).powi(2)).sum();
        spread.variance(&factors).min(before)
    }

    /// Half the width of the 95 % interval of a combination, if those that are held are what the file says.
    pub(crate) fn half(&self, of: &[(usize, f64)]) -> f64 {
        Z95 * self.variance(&self.spread, of).max(0.0).sqrt()
    }

    /// The same, with what those that are held leave open.
    pub(crate) fn half_of_whole(&self, of: &[(usize, f64)]) -> f64 {
        self.half(of).max(Z95 * self.variance(&self.whole.spread, of).max(0.0).sqrt())
    }
}

/// A model whose parameters can be held.
pub(crate) trait Held: Model {
    fn axes_mut(&mut self) -> &mut Vec<Axis>;
}

impl Held for Speed<'_> {
    fn axes_mut(&mut self) -> &mut Vec<Axis> {
        &mut self.axes
    }
}

impl Held for Steering<'_> {
    fn axes_mut(&mut self) -> &mut Vec<Axis> {
        &mut self.axes
    }
}

/// The best of some starts after a few iterations.
fn best_start(
    model: &impl Model,
    starts: Vec<Vec<f64>>,
    iterations: usize,
) -> Option<(Vec<f64>, Weights)> {
    let all = |_: usize| true;
    let weights = weigh(model, starts.first()?, &even(model), &all);
    let ends = starts.into_iter().map(|start| {
        let end = descend(model, &weights, &start, iterations);
        (cost(model, &weights, &end), end)
    });
    let (_, best) = ends.min_by(|a, b| a.0.total_cmp(&b.0))?;
    Some((best, weights))
}

/// Holds one parameter after the other that the drive does not tell at the file's value, where the drive agrees with it: the
/// least told first, because another one may be told once it is held. `open_sided` is never told roughly, nor told where a value
/// without end would do as well: beside the edge of its effect, its interval is narrow. `extras` are held
/// unless the file's value is outside of their interval, all others free: slow cars do not show them.
fn hold_what_is_not_told<M: Held>(
    model: &mut M,
    mut at: Vec<f64>,
    mut weights: Weights,
    limits: &dyn Fn(usize, &[f64]) -> Limit,
    open_sided: Option<usize>,
    extras: &[usize],
) -> Option<Fitted> {
    let all = |_: usize| true;
    let told = |axis: &Axis| if axis.free { Told::Identified } else { Told::Held };
    let mut told: Vec<Told> = model.axes().iter().map(told).collect();
    let mut extras = extras.to_vec();
    let mut whole = None;
    loop {
        let spread = spread(model, &weights, &at)?;
        let here = Whole { at: at.clone(), spread: spread.clone() };
        let fitted = Fitted {
            at: at.clone(),
            axes: model.axes().to_vec(),
            weights: weights.clone(),
            spread,
            whole: whole.clone().unwrap_or_else(|| here.clone()),
            told: told.clone(),
        };
        let half = |index: usize| fitted.half(&[(index, 1.0)]);
        let excess = |index: usize| half(index) / limits(index, &at);
        // Extras first, while all others are free: held too soon, these would leave what is their own to the extras.
        extras.retain(|&it| told[it] == Told::Identified);
        extras.sort_by(|a, b| excess(*a).total_cmp(&excess(*b)));
        let extra = extras.pop();
        if extra.is_none() {
            whole.get_or_insert(here);
        }
        let worst = (0..at.len())
            .filter(|&index| told[index] == Told::Identified)
            .max_by(|a, b| excess(*a).total_cmp(&excess(*b)))
            .filter(|&index| excess(index) > 1.0);
        let open = open_sided.filter(|it| told[*it] == Told::Identified);
        let unseen = || open.filter(|&it| is_unseen(model, &weights, &at, it));
        let Some(worst) = extra.or(worst).or_else(unseen) else { return Some(fitted) };
        let half = half(worst);
        let least = (open == Some(worst)).then(|| least(model, &weights, &at, worst));
        let as_told = |contradicted: bool| match (least, contradicted) {
            (Some(least), contradicted) => Told::AtLeast { least, contradicted },
            (None, true) => Told::Contradicted { half },
            (None, false) => Told::TooWide { half },
        };
        let is_wide = excess(worst) > 1.0;
        let is_within = (at[worst] - model.axes()[worst].file).abs() <= half;
        let agrees = match extra {
            Some(_) if is_wide || is_within => f64::INFINITY,
            Some(_) => Z95 * Z95,
            None => AGREES,
        };
        let before = cost(model, &weights, &at);
        let mut held = at.clone();
        held[worst] = model.axes()[worst].file;
        model.axes_mut()[worst].free = false;
        let held = descend(model, &weights, &held, 12);
        let worse = cost(model, &weights, &held) - before;
        if worse <= agrees {
            told[worst] = as_told(false);
            (at, weights) = settle(model, weights, &held, 1, &all);
            continue;
        }
        // Held at the file's value, it would mislead the others: they are better told by a fit that leaves it free.
        model.axes_mut()[worst].free = true;
        if extra.is_some() {
            continue;
        }
        told[worst] = match open_sided != Some(worst) && half < MOST_ROUGH {
            true => Told::Roughly,
            false => as_told(worse > CONTRADICTED),
        };
    }
}

/// Whether the drive would be as well with the largest value that the parameter may have.
fn is_unseen<M: Held>(model: &mut M, weights: &Weights, at: &[f64], index: usize) -> bool {
    let mut end = at.to_vec();
    end[index] = model.axes()[index].high;
    let before = cost(model, weights, at);
    model.axes_mut()[index].free = false;
    let end = descend(model, weights, &end, 12);
    model.axes_mut()[index].free = true;
    cost(model, weights, &end) - before <= UNSEEN
}

/// The least value of a parameter that fits the drive, the others where they are.
fn least(model: &impl Model, weights: &Weights, at: &[f64], index: usize) -> f64 {
    let before = cost(model, weights, at);
    let mut there = at.to_vec();
    let (mut low, mut high) = (model.axes()[index].low, at[index]);
    for _ in 0..12 {
        there[index] = 0.5 * (low + high);
        match cost(model, weights, &there) - before > UNSEEN {
            true => low = there[index],
            false => high = there[index],
        }
    }
    high
}

/// Fits the speed loop.
pub(crate) fn fit_speed(
    stretches: &[Stretch],
    vehicle: &Vehicle,
    limits: &dyn Fn(usize, &[f64]) -> Limit,
) -> Option<Fitted> {
    let mut model = Speed::new(stretches, vehicle);
    let file = speed::of_vehicle(vehicle).to_vec();
    let mut starts = Vec::new();
    for delay_s in [0.0, 0.15, 0.3] {
        for pedals in [-0.4, 0.0, 0.5] {
            let mut start = file.clone();
            start[speed::DELAY] = delay_s;
            start[speed::THROTTLE] += pedals;
            starts.push(start);
        }
    }
    let (start, weights) = best_start(&model, starts, 6)?;
    let (at, weights) = settle(&model, weights, &start, 4, &|_| true);
    hold_what_is_not_told(&mut model, at, weights, limits, None, &[])
}

/// Fits steering, wheelbase and the odometry's point.
pub(crate) fn fit_steering(
    stretches: &[Stretch],
    vehicle: &Vehicle,
    point_m: f64,
    wheelbase_is_measured: bool,
    limits: &dyn Fn(usize, &[f64]) -> Limit,
) -> Option<Fitted> {
    let alone = Steering::new(stretches, vehicle, point_m, wheelbase_is_measured, false);
    let file = steering::of_vehicle(vehicle, point_m).to_vec();
    let mut starts = Vec::new();
    for delay_s in [0.0, 0.1, 0.2, 0.35] {
        for rate_radps in [0.2, 0.5, 1.2] {
            let mut start = file.clone();
            start[steering::DELAY] = delay_s;
            start[steering::RATE] = libm::log(rate_radps);
            starts.push(start);
        }
    }
    let (start, weights) = best_start(&alone, starts, 4)?;
    let (start, _) = settle(&alone, weights, &start, 2, &|_| true);
    let mut joint = Steering::new(stretches, vehicle, point_m, wheelbase_is_measured, true);
    let weights = even(&joint);
    let (at, weights) = settle(&joint, weights, &start, 4, &|_| true);
    // Wheels that never turned as fast as they can tell a least rate, and no greatest one.
    let extras = [steering::YAW_LAG, steering::UNDERSTEER];
    hold_what_is_not_told(&mut joint, at, weights, limits, Some(steering::RATE), &extras)
}

/// The fit of some blocks alone, with the same parameters held.
pub(crate) fn refit<M: Held>(
    mut model: M,
    fitted: &Fitted,
    counts: &dyn Fn(usize) -> bool,
) -> Vec<f64> {
    *model.axes_mut() = fitted.axes.clone();
    settle(&model, fitted.weights.clone(), &fitted.at, 1, counts).0
}
