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
/// A fit does not say what a parameter with a wider half of an interval is, only what it cannot be: as a logarithm, a factor of
/// ten.
const MOST_ROUGH: f64 = 2.3;
/// A drive that would be no worse than this by a value without end has not seen the parameter's effect.
const UNSEEN: f64 = 15.0;
/// Shares of the largest angle that commands ask for, at which the wheels may stop, and one at which none does. So many steps
/// of a fit from each, and so many more from the best ones, tell whether they do, if that is so much better (as above).
const STOPS: [f64; 9] = [1.1, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2];
const STOP_STEPS: usize = 2;
const STOP_BEST: usize = 3;
const STOP_MORE_STEPS: usize = 4;
const STOP_SHOWS: f64 = 50.0;
/// Steps of a fit without the samples at which tyres may be at their limit, from each start.
const GRIP_STEPS: usize = 8;
/// How often the way between a value that fits and one that does not is halved.
const HALVINGS: usize = 8;

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
    /// A value without end would do as well, or nearly: it is at least so much.
    AtLeast {
        /// A lower one does not fit the drive.
        least: f64,
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

/// Where a fit is on its way.
struct Stage {
    at: Vec<f64>,
    weights: Weights,
    told: Vec<Told>,
}

impl Stage {
    fn new(model: &impl Model, at: Vec<f64>, weights: Weights) -> Self {
        let told = |axis: &Axis| if axis.free { Told::Identified } else { Told::Held };
        Self { at, weights, told: model.axes().iter().map(told).collect() }
    }

    /// All that is known here. `whole`: see [`Fitted::whole`]; this place, if there is none yet.
    fn fitted(&self, model: &impl Model, whole: Option<&Whole>) -> Option<Fitted> {
        let spread = spread(model, &self.weights, &self.at)?;
        let here = || Whole { at: self.at.clone(), spread: spread.clone() };
        Some(Fitted {
            at: self.at.clone(),
            axes: model.axes().to_vec(),
            weights: self.weights.clone(),
            whole: whole.cloned().unwrap_or_else(here),
            spread,
            told: self.told.clone(),
        })
    }

    /// How much worse the fit is with a parameter held at the file's value. If that is no more than `agrees`, it is held, and
    /// `told` of it.
    fn hold<M: Held>(&mut self, model: &mut M, index: usize, agrees: f64, told: Told) -> f64 {
        let before = cost(model, &self.weights, &self.at);
        let mut held = self.at.clone();
        held[index] = model.axes()[index].file;
        model.axes_mut()[index].free = false;
        let held = descend(model, &self.weights, &held, 12);
        let worse = cost(model, &self.weights, &held) - before;
        if worse <= agrees {
            self.told[index] = told;
            (self.at, self.weights) = settle(model, self.weights.clone(), &held, 1, &|_| true);
        } else {
            model.axes_mut()[index].free = true;
        }
        worse
    }

    /// Holds a parameter at the value that fits and is the nearest to the file's, which does not fit.
    fn hold_near_file<M: Held>(&mut self, model: &mut M, index: usize) {
        let most = cost(model, &self.weights, &self.at) + Z95 * Z95;
        model.axes_mut()[index].free = false;
        let mut misfits = model.axes()[index].file;
        for _ in 0..HALVINGS {
            let mut there = self.at.clone();
            there[index] = 0.5 * (self.at[index] + misfits);
            let to = there[index];
            let there = descend(model, &self.weights, &there, 12);
            match cost(model, &self.weights, &there) <= most {
                true => self.at = there,
                false => misfits = to,
            }
        }
        (self.at, self.weights) = settle(model, self.weights.clone(), &self.at, 1, &|_| true);
    }
}

/// Holds what a car has only where a drive proves it, unless the file's value is outside of the interval, while all else is
/// free: held too soon, another parameter would leave what is its own to these. Slow cars do not show them.
fn hold_what_is_not_proven<M: Held>(
    model: &mut M,
    stage: &mut Stage,
    limits: &dyn Fn(usize, &[f64]) -> Limit,
    mut extras: Vec<usize>,
) -> Option<()> {
    extras.retain(|&it| model.axes()[it].free);
    while !extras.is_empty() {
        let fitted = stage.fitted(model, None)?;
        let half = |index: usize| fitted.half(&[(index, 1.0)]);
        let excess = |index: usize| half(index) / limits(index, &fitted.at);
        extras.sort_by(|a, b| excess(*a).total_cmp(&excess(*b)));
        let Some(worst) = extras.pop() else { break };
        let half = half(worst);
        let is_within = (fitted.at[worst] - model.axes()[worst].file).abs() <= half;
        let is_wide = excess(worst) > 1.0;
        let agrees = if is_wide || is_within { f64::INFINITY } else { Z95 * Z95 };
        stage.hold(model, worst, agrees, Told::TooWide { half });
    }
    Some(())
}

/// Holds one parameter after the other that the drive does not tell at the file's value, where the drive agrees with it: the
/// least told first, because another one may be told once it is held. `open_sided` is never told roughly, nor told where a value
/// without end would do as well: beside the edge of its effect, its interval is narrow.
fn hold_what_is_not_told<M: Held>(
    model: &mut M,
    mut stage: Stage,
    limits: &dyn Fn(usize, &[f64]) -> Limit,
    open_sided: Option<usize>,
) -> Option<Fitted> {
    let mut whole = None;
    loop {
        let fitted = stage.fitted(model, whole.as_ref())?;
        whole.get_or_insert_with(|| fitted.whole.clone());
        let (at, weights) = (&stage.at, &stage.weights);
        let half = |index: usize| fitted.half(&[(index, 1.0)]);
        let excess = |index: usize| half(index) / limits(index, at);
        let worst = (0..at.len())
            .filter(|&index| stage.told[index] == Told::Identified)
            .max_by(|a, b| excess(*a).total_cmp(&excess(*b)))
            .filter(|&index| excess(index) > 1.0);
        let open = open_sided.filter(|it| stage.told[*it] == Told::Identified);
        let unseen = || open.filter(|&it| is_unseen(model, weights, at, it));
        let Some(worst) = worst.or_else(unseen) else { return Some(fitted) };
        let half = half(worst);
        let least = (open == Some(worst)).then(|| least(model, weights, at, worst));
        let not_told = least.map_or(Told::TooWide { half }, |least| Told::AtLeast { least });
        if stage.hold(model, worst, AGREES, not_told) <= AGREES {
            continue;
        }
        // Held at the file's value, it would mislead the others: they are better told by a fit that leaves it free.
        stage.told[worst] = Told::Roughly;
        if open == Some(worst) || half >= MOST_ROUGH {
            stage.hold_near_file(model, worst);
        }
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
    let stage = Stage::new(&model, at, weights);
    hold_what_is_not_told(&mut model, stage, limits, None)
}

/// Fits steering, wheelbase and the odometry's point; and tells whether the car turned less than its wheels were told where
/// tyres come to their limit, and only there.
pub(crate) fn fit_steering(
    stretches: &[Stretch],
    vehicle: &Vehicle,
    point_m: f64,
    wheelbase_is_measured: bool,
    limits: &dyn Fn(usize, &[f64]) -> Limit,
) -> Option<(Fitted, bool)> {
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
    let (start, weights) = best_start(&alone, starts.clone(), 4)?;
    let (start, weights) = settle(&alone, weights, &start, 2, &|_| true);
    let stopped = stopped(&alone, &weights, &start, &starts);
    let tyres_are_at_limit = stopped == Stopped::ByTyres;
    let start = if let Stopped::At(there) = stopped { there } else { start };
    let mut joint = Steering::new(stretches, vehicle, point_m, wheelbase_is_measured, true);
    let is_reached = libm::exp(start[steering::STOP]) < joint.most_asked_rad(&start);
    joint.axes[steering::STOP].free = is_reached && start[steering::STOP] != file[steering::STOP];
    let weights = even(&joint);
    let (at, weights) = settle(&joint, weights, &start, 4, &|_| true);
    let mut stage = Stage::new(&joint, at, weights);
    let extras = vec![steering::YAW_LAG, steering::UNDERSTEER];
    hold_what_is_not_proven(&mut joint, &mut stage, limits, extras)?;
    // Wheels that never turned as fast as they can tell a least rate, and no greatest one.
    let fitted = hold_what_is_not_told(&mut joint, stage, limits, Some(steering::RATE))?;
    Some((fitted, tyres_are_at_limit))
}

/// Whether the wheels stop elsewhere than the file says.
#[derive(Debug, PartialEq)]
enum Stopped {
    /// Not that the drive shows.
    No,
    /// The car turns as if they did, but only where its tyres may be at their limit.
    ByTyres,
    /// They do at this place.
    At(Vec<f64>),
}

/// A place that fits the yaw rate much better, because the wheels stop before they come as far as they are told and the file
/// says, or turn farther than the file says. Without a stop, a fit takes wheels that rest at theirs for wheels that turn
/// slowly.
fn stopped(alone: &Steering<'_>, weights: &Weights, at: &[f64], starts: &[Vec<f64>]) -> Stopped {
    let (most_rad, of_file) = (alone.most_asked_rad(at), at[steering::STOP]);
    let ends = STOPS.map(|share| libm::log(share * most_rad)).into_iter();
    // Beyond all that was asked for, wheels do not stop.
    let ends = ends.filter(|it| *it < of_file || libm::log(most_rad) > of_file);
    let down = |weights: &Weights, from: &[f64], steps: usize| {
        let there = descend(alone, weights, from, steps);
        (cost(alone, weights, &there), there)
    };
    let at_stop = |stop: f64| {
        let mut there = at.to_vec();
        there[steering::STOP] = stop;
        down(weights, &there, STOP_STEPS)
    };
    let mut places: Vec<(f64, Vec<f64>)> = ends.map(at_stop).collect();
    places.sort_by(|a, b| a.0.total_cmp(&b.0));
    let places = places.iter().take(STOP_BEST).map(|it| down(weights, &it.1, STOP_MORE_STEPS));
    let best = |places: &mut dyn Iterator<Item = (f64, Vec<f64>)>| {
        places.min_by(|a, b| a.0.total_cmp(&b.0))
    };
    let Some((least, there)) = best(&mut { places }) else { return Stopped::No };
    if least >= cost(alone, weights, at) - STOP_SHOWS {
        return Stopped::No;
    }
    // Tyres at their limit let a car turn less than it is told, too.
    let grip = alone.have_grip();
    if grip.iter().all(|has| *has) {
        return Stopped::At(there);
    }
    let mut gentle = weights.clone();
    for (weight, has) in gentle.each.iter_mut().zip(grip) {
        *weight = if has { *weight } else { 0.0 };
    }
    let others = starts.iter().map(Vec::as_slice).chain([at]);
    let without = best(&mut others.map(|it| down(&gentle, it, GRIP_STEPS)));
    let (least, there) = down(&gentle, &there, GRIP_STEPS);
    match without {
        Some((without, _)) if least >= without - STOP_SHOWS => Stopped::ByTyres,
        _ => Stopped::At(there),
    }
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
