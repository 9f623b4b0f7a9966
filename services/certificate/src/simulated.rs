//! From where the loop converges when it is simulated: not certain, but for larger offsets and for cars with dead time.
//!
//! The model is the whole kinematic car with its steering chain, in the frame of the reference pose on a path of constant
//! curvature; speed and lead stay where they settle. If 300 of 300 random starts converge, at least 99 % do with a
//! confidence of 95 %.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::region::start;
use crate::small::{cholesky, inverse};
use crate::vertices::State;
use crate::{Car, Equilibrium, Gains, Region};

/// Starts of which all must converge.
pub const STARTS: usize = 300;

/// From one size to the next.
const GROWTH: f64 = 1.1;

/// Values of V above this are not tried.
pub const LARGEST_LEVEL: f64 = 24.0;

/// The least and the largest multiple of the start that is tried.
const EXTENTS: [f64; 2] = [0.02, 2.0];

/// How long a start may take to converge.
const LONGEST_S: f64 = 60.0;

/// The loop on a path of constant curvature, to be simulated from many starts.
#[derive(Debug, Clone)]
pub struct Simulated {
    car: Car,
    gains: Gains,
    at: Equilibrium,
    /// Commands that are on the way, in whole ticks.
    delay: usize,
    /// Who is inside has converged.
    region: Option<Region>,
}

impl Simulated {
    /// The loop around an equilibrium. The dead time counts in whole ticks, the next larger number.
    pub fn new(car: &Car, gains: &Gains, at: &Equilibrium) -> Self {
        let delay = libm::ceil(car.steering_delay_s / car.tick_s - 1e-6) as usize;
        Self { car: *car, gains: *gains, at: *at, delay, region: None }
    }

    /// Whoever comes into this region has converged: that spares time.
    pub fn within(self, region: &Region) -> Self {
        Self { region: Some(region.clone()), ..self }
    }

    /// The multiple of [`START`](crate::START) within which all starts converge: offset and heading anywhere in the
    /// rectangle, the steering as if the loop had settled. `None` if not even from a fiftieth of it; more than
    /// twice of it is not tried.
    pub fn extent(&self, seed: u64) -> Option<f64> {
        let [y, heading] = start(&self.car);
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let shares: Vec<[f64; 2]> = (0..STARTS)
            .map(|index| {
                let mut share = || rng.random_range(-1.0..=1.0);
                let [a, b] = [share(), share()];
                // A quarter of them on each edge's corner region: there it is decided.
                match index % 4 {
                    0 => [1.0, b],
                    1 => [a, 1.0],
                    2 => [-1.0, b],
                    _ => [a, -1.0],
                }
            })
            .collect();
        let all = |size: f64| {
            shares
                .iter()
                .all(|[a, b]| self.converges(&[size * a * y, size * b * heading, 0.0, 0.0]))
        };
        let mut best = None;
        let mut size = EXTENTS[0];
        while size < EXTENTS[1] && all(size) {
            best = Some(size);
            size *= GROWTH;
        }
        best
    }

    /// Random starts in a rectangle of this multiple of [`START`](crate::START), and which of them converge.
    pub(crate) fn starts(&self, size: f64, seed: u64) -> Vec<Start> {
        starts(&self.car, size, seed, |[y, heading]| self.converges(&[y, heading, 0.0, 0.0]))
    }

    /// The value of V up to which all starts converge, with random filter and wheels: on the boundary of larger and
    /// larger ellipsoids, up to the first that fails, or to
    /// [`LARGEST_LEVEL`].
    pub fn level(&self, region: &Region, seed: u64) -> f64 {
        let Some(t) = inverse(&region.p).and_then(|q| cholesky(&q)) else { return 0.0 };
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let starts: Vec<State> = (0..STARTS).map(|_| direction(&mut rng)).collect();
        let at = |u: &State, size: f64| -> State {
            std::array::from_fn(|row| size * (0..4).map(|k| t[row][k] * u[k]).sum::<f64>())
        };
        let mut best = 0.0;
        let mut size = 0.5;
        while best < LARGEST_LEVEL {
            if !starts.iter().all(|u| self.converges(&at(u, size))) {
                break;
            }
            best = size * size;
            size *= GROWTH;
        }
        best
    }

    /// Whether the loop comes back from a deviation.
    fn converges(&self, from: &State) -> bool {
        let Self { car, gains, at, delay, region } = self;
        let Gains { kl, ks, ki, .. } = *gains;
        let (h, v, lead) = (car.tick_s, at.speed_mps, at.lead_m);
        let (limit, rate) = (car.steering_limit_rad, car.steering_rate_radps);
        let bend_radps = at.curvature * at.reference_mps;
        let p = car.tracked_m(v);
        let mut offset = at.offset_m + from[0];
        let mut heading = at.heading_rad + from[1];
        let mut filter = (at.steering_rad + from[2]).clamp(-limit, limit);
        let mut wheels = (at.steering_rad + from[3]).clamp(-limit, limit);
        let mut turning = car.turning();
        let asked_radps = turning.asked_radps(wheels, v);
        turning.set(asked_radps, asked_radps);
        let mut line = vec![filter; delay + 1];
        let mut newest = 0;
        let reach = rate * h;
        let near_m = 0.02 * car.wheelbase_m;
        let mut near_for = 0;
        let ticks = (LONGEST_S / h) as usize;
        for tick in 0..ticks {
            if tick % 16 == 0
                && let Some(region) = region
            {
                let steering = at.steering_rad;
                let state = [
                    offset - at.offset_m,
                    heading - at.heading_rad,
                    filter - steering,
                    wheels - steering,
                ];
                if region.value(&state) <= 1.0 {
                    return true;
                }
            }
            let (sin, cos) = (libm::sin(heading), libm::cos(heading));
            let omega = -ks * wrapped(heading) - kl * (offset * cos + lead * sin);
            filter = (ki * filter + ki * h * omega).clamp(-limit, limit);
            line[newest] = filter;
            newest = if newest == *delay { 0 } else { newest + 1 };
            // The oldest, which the next tick overwrites.
            let acting = line[newest];
            let acting = (car.steering_gain * acting).clamp(-limit, limit);
            let error = acting - wheels;
            wheels += if car.steering_lag_s == 0.0 {
                error.clamp(-reach, reach)
            } else {
                (-libm::expm1(-h / car.steering_lag_s) * error).clamp(-reach, reach)
            };
            let turned = turning.turn(wheels, v, h);
            let middle = heading + 0.5 * turned;
            offset += h * v * libm::sin(middle)
                + p * (libm::sin(heading + turned) - sin)
                + h * bend_radps * lead;
            heading += turned - h * bend_radps;
            let is_near = (offset - at.offset_m).abs() < near_m
                && (heading - at.heading_rad).abs() < 0.02
                && (wheels - at.steering_rad).abs() < 0.02;
            near_for = if is_near { near_for + 1 } else { 0 };
            if near_for == 100 {
                return true;
            }
            if offset.is_nan() || offset.abs() > 1e3 * car.wheelbase_m {
                return false;
            }
        }
        false
    }
}

/// A start of a simulation, and what came of it.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Start {
    /// Offset from where the loop settles.
    pub offset_m: f64,
    /// Heading from where it settles.
    pub heading_rad: f64,
    /// Whether the loop settled there.
    pub converges: bool,
}

/// Random starts, each as likely, in a rectangle of a multiple of [`START`](crate::START).
pub(crate) fn starts(
    car: &Car,
    size: f64,
    seed: u64,
    converges: impl Fn([f64; 2]) -> bool,
) -> Vec<Start> {
    let [y, heading] = start(car);
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut within = |most: f64| size * most * rng.random_range(-1.0..=1.0);
    let one = |_| {
        let [offset_m, heading_rad] = [within(y), within(heading)];
        Start { offset_m, heading_rad, converges: converges([offset_m, heading_rad]) }
    };
    (0..STARTS).map(one).collect()
}

/// An angle within ± π.
fn wrapped(angle: f64) -> f64 {
    let turns = libm::round(angle / std::f64::consts::TAU);
    angle - turns * std::f64::consts::TAU
}

/// A point of the unit sphere, each as likely.
fn direction(rng: &mut ChaCha8Rng) -> State {
    loop {
        let point: State = std::array::from_fn(|_| rng.random_range(-1.0..1.0));
        let square: f64 = point.iter().map(|it| it * it).sum();
        if (1e-4..1.0).contains(&square) {
            return point.map(|it| it / square.sqrt());
        }
    }
}
