//! The region of attraction: the largest ellipsoid of a kind that the loop does not leave and in which it converges, in
//! spite of the limits of the steering.
//!
//! With Q = P⁻¹ and Z = H·Q all conditions of [`check`](crate::check()) are linear matrix inequalities (T. Hu, Z. Lin,
//! Systems & Control Letters 45 (2002) 97–112). The ellipsoid is to contain α·(1 m, ±0.3 rad) with the largest α, for a car
//! of 2.875 m; the metre grows with the wheelbase.

// As in the equations: rows and columns by their numbers.
#![allow(clippy::needless_range_loop)]

use config::FULL_SIZE_WHEELBASE_M;
use serde::{Deserialize, Serialize};

use crate::check::{FALL, check};
use crate::interior::{Inequality, Point, Problem, VARIABLES};
use crate::small::{
    Square, cholesky, inverse, lower_inverse, product, quadratic, row_times, transposed,
};
use crate::vertices::{HEADING_RAD, Intervals, State, Vertex, vertices};
use crate::{Car, Equilibrium, Gains};

/// The start whose largest multiple is looked for: offset in metres for a car of 2.875 m, and heading either way.
pub const START: (f64, f64) = (1.0, 0.3);

/// Variables: ten of Q, four of Z, then α or the slack.
const LAST: usize = 14;

/// An ellipsoid of states: {x: xᵀ·P·x ≤ 1}.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Region {
    /// Where the loop settles: the states are deviations from it.
    pub equilibrium: Equilibrium,
    /// How much speed and lead may deviate.
    pub intervals: Intervals,
    /// P.
    pub p: [[f64; 4]; 4],
    /// H: in the ellipsoid |H·x| is within what the wheels turn in a tick.
    pub held: State,
    /// α: the ellipsoid contains this multiple of [`START`], both ways.
    pub extent: f64,
}

impl Region {
    /// Searches the region around an equilibrium. `None` if there is none of this kind, or if the check refuses what was
    /// found.
    pub fn find(car: &Car, gains: &Gains, at: &Equilibrium, intervals: Intervals) -> Option<Self> {
        let vertices = vertices(car, gains, at, &intervals);
        Self::find_among(&vertices, car, gains, at, intervals)
    }

    /// As [`Region::find`], but searching with these vertices alone; the check knows them all.
    fn find_among(
        vertices: &[Vertex],
        car: &Car,
        gains: &Gains,
        at: &Equilibrium,
        intervals: Intervals,
    ) -> Option<Self> {
        let region = Search::new(car, at, vertices)?.region(*at, intervals)?;
        check(car, gains, &region).ok().map(|()| region)
    }

    /// V of a state.
    pub fn value(&self, state: &State) -> f64 {
        quadratic(&self.p, state)
    }

    /// The states at a multiple of [`START`].
    pub(crate) fn corners(&self, car: &Car, extent: f64) -> [State; 2] {
        [1.0, -1.0].map(|side| {
            let [y, heading] = start(car);
            [extent * y, extent * side * heading, 0.0, 0.0]
        })
    }
}

/// [`START`] for a car: m and rad.
pub(crate) fn start(car: &Car) -> [f64; 2] {
    [START.0 * car.wheelbase_m / FULL_SIZE_WHEELBASE_M, START.1]
}

/// A search. Its inequalities are written in coordinates z with x = T·z in which the ellipsoid at hand is the unit ball:
/// so the numbers are of one size.
struct Search<'a> {
    vertices: &'a [Vertex],
    /// The different F.
    filters: Vec<State>,
    tick_rad: f64,
    left_rad: f64,
    corners: [State; 2],
}

/// An ellipsoid at hand: Q and H.
#[derive(Debug, Clone, Copy)]
struct Candidate {
    q: Square<4>,
    held: State,
}

/// The symmetric matrix of the first ten variables.
fn symmetric(x: &Point) -> Square<4> {
    let mut out = [[0.0; 4]; 4];
    let mut place = 0;
    for row in 0..4 {
        for column in row..4 {
            (out[row][column], out[column][row]) = (x[place], x[place]);
            place += 1;
        }
    }
    out
}

fn z_row(x: &Point) -> State {
    [x[10], x[11], x[12], x[13]]
}

/// [γQ, (MQ)ᵀ; MQ, Q], given D·Q with D = M − 1. The first block row is subtracted from the second, and columns alike:
/// the determinant is the same, and nothing cancels, although M is nearly 1.
fn falling(q: &Square<4>, dq: &Square<4>) -> Square<8> {
    let mut out = [[0.0; 8]; 8];
    for row in 0..4 {
        for column in 0..4 {
            let less = FALL_ASKED * q[row][column];
            out[row][column] = q[row][column] - less;
            let other = dq[row][column] + less;
            (out[row + 4][column], out[column][row + 4]) = (other, other);
            out[row + 4][column + 4] = -less - dq[row][column] - dq[column][row];
        }
    }
    out
}

/// [corner, f; fᵀ, Q].
fn bordered(corner: f64, q: &Square<4>, f: &State) -> Square<5> {
    let mut out = [[0.0; 5]; 5];
    out[0][0] = corner;
    for row in 0..4 {
        (out[0][row + 1], out[row + 1][0]) = (f[row], f[row]);
        out[row + 1][1..].copy_from_slice(&q[row]);
    }
    out
}

/// M − 1.
fn difference(matrix: &Square<4>) -> Square<4> {
    let mut out = *matrix;
    for (place, row) in out.iter_mut().enumerate() {
        row[place] -= 1.0;
    }
    out
}

impl<'a> Search<'a> {
    fn new(car: &Car, at: &Equilibrium, vertices: &'a [Vertex]) -> Option<Self> {
        let left_rad = car.steering_limit_rad - at.steering_rad.abs();
        if left_rad <= 0.0 {
            return None;
        }
        let mut filters: Vec<State> = Vec::new();
        for vertex in vertices {
            if !filters.contains(&vertex.filter) {
                filters.push(vertex.filter);
            }
        }
        let [y, angle] = start(car);
        let corners = [1.0, -1.0].map(|side| [y, side * angle, 0.0, 0.0]);
        let tick_rad = car.steering_rate_radps * car.tick_s;
        Some(Self { vertices, filters, tick_rad, left_rad, corners })
    }

    /// The inequalities in coordinates T: the ellipsoid contains the start, and the last variable is the square of how many
    /// times it is too large for the limits.
    fn problem(&self, t: &Square<4>) -> Problem {
        let back = lower_inverse(t);
        let seen = |matrix: &Square<4>| product(&product(&back, matrix), t);
        let into = |column: &State| -> State {
            std::array::from_fn(|row| (0..4).map(|k| back[row][k] * column[k]).sum())
        };
        let mut large = Vec::with_capacity(2 * self.vertices.len());
        for vertex in self.vertices {
            let free = seen(&difference(&vertex.matrix(&vertex.filter)));
            large.push(Inequality::new(|x| {
                let q = symmetric(x);
                falling(&q, &product(&free, &q))
            }));
            let base = seen(&difference(&vertex.matrix(&[0.0, 0.0, 0.0, 1.0])));
            let column = into(&[vertex.shift, vertex.turn, 0.0, 1.0]);
            large.push(Inequality::new(|x| {
                let q = symmetric(x);
                let mut dq = product(&base, &q);
                let z = z_row(x);
                for row in 0..4 {
                    for place in 0..4 {
                        dq[row][place] += column[row] * z[place];
                    }
                }
                falling(&q, &dq)
            }));
        }
        let within = |row: &State, most: f64| {
            let row = row_times(&row.map(|it| it / most), t);
            Inequality::new(move |x| {
                let q = symmetric(x);
                bordered(x[LAST], &q, &row_times(&row, &q))
            })
        };
        let mut middle: Vec<Inequality<5>> =
            self.filters.iter().map(|filter| within(filter, self.left_rad)).collect();
        middle.push(Inequality::new(|x| {
            bordered(x[LAST], &symmetric(x), &z_row(x).map(|it| it / self.tick_rad))
        }));
        let mut objective = [0.0; VARIABLES];
        objective[LAST] = -1.0;
        for corner in &self.corners {
            let corner = into(corner);
            middle.push(Inequality::new(|x| bordered(1.0, &symmetric(x), &corner)));
        }
        let heading_row = t[1].map(|it| it / HEADING_RAD);
        let single =
            vec![Inequality::new(|x| [[x[LAST] - quadratic(&symmetric(x), &heading_row)]])];
        Problem { large, middle, single, objective }
    }

    /// The largest α.
    fn extent(&self, p: &Square<4>) -> f64 {
        1.0 / self.corners.iter().map(|it| quadratic(p, it)).fold(0.0, f64::max).sqrt()
    }

    /// How many times too large an ellipsoid is for the limits, as the square of a length.
    fn fullness(&self, it: &Candidate) -> f64 {
        let full = |row: &State, most: f64| quadratic(&it.q, row) / (most * most);
        let filter = self.filters.iter().map(|row| full(row, self.left_rad));
        let others = [full(&it.held, self.tick_rad), full(&[0.0, 1.0, 0.0, 0.0], HEADING_RAD)];
        filter.chain(others).fold(0.0, f64::max)
    }

    /// The ellipsoid of the mean of all vertices, from its Lyapunov equation; `None` if it is not stable.
    fn nominal(&self) -> Option<Square<4>> {
        let count = self.vertices.len() as f64;
        let mean = |of: &dyn Fn(&Vertex) -> f64| self.vertices.iter().map(of).sum::<f64>() / count;
        let nominal = Vertex {
            filter: std::array::from_fn(|place| mean(&|it: &Vertex| it.filter[place])),
            sideways: mean(&|it| it.sideways),
            shift: mean(&|it| it.shift),
            turn: mean(&|it| it.turn),
        };
        let y = self.corners[0][0];
        let p = lyapunov(&nominal.matrix(&nominal.filter), [y, 0.3, 0.3, 0.3])?;
        inverse(&p)
    }

    /// The largest ellipsoid: Q and H.
    fn run(&self) -> Option<Candidate> {
        let mut q = self.nominal()?;
        let extent = self.extent(&inverse(&q)?);
        q = q.map(|row| row.map(|it| it / (extent * extent)));
        let t = cholesky(&q)?;
        let x = self.problem(&t).solve(SIZE, NEAR)?;
        let (q, back) = (symmetric(&x), lower_inverse(&t));
        let held = row_times(&row_times(&z_row(&x), &inverse(&q)?), &back);
        let mut it = Candidate { q: product(&product(&t, &q), &transposed(&t)), held };
        // As large as the limits allow.
        let fullness = self.fullness(&it);
        it.q = it.q.map(|row| row.map(|it| it / (fullness * (1.0 + 1e-6))));
        Some(it)
    }

    /// What was found, in the terms of the check.
    fn region(&self, at: Equilibrium, intervals: Intervals) -> Option<Region> {
        let it = self.run()?;
        let p = inverse(&it.q)?;
        let p: Square<4> = std::array::from_fn(|row| {
            std::array::from_fn(|column| 0.5 * (p[row][column] + p[column][row]))
        });
        // A hair less than the largest.
        let extent = (1.0 - 1e-9) * self.extent(&p);
        Some(Region { equilibrium: at, intervals, p, held: it.held, extent })
    }
}

/// The fall that the search asks for: a little more than is checked, so that rounding and the vertices that were not chosen
/// have room.
const FALL_ASKED: f64 = 1.1 * FALL;

/// The search ends this near to the largest α, as a share of it.
const NEAR: f64 = 1e-4;

/// The size of all matrices to begin with: larger than what is found.
const SIZE: f64 = 1e3;

/// P of Mᵀ·P·M − P = −W, by doubling, for the W of states of this size; `None` unless M is stable.
pub(crate) fn lyapunov(matrix: &Square<4>, size: State) -> Option<Square<4>> {
    let mut p: Square<4> = [[0.0; 4]; 4];
    for place in 0..4 {
        p[place][place] = 1.0 / (size[place] * size[place]);
    }
    let mut power = *matrix;
    for _ in 0..40 {
        let more = product(&product(&transposed(&power), &p), &power);
        for row in 0..4 {
            for column in 0..4 {
                p[row][column] += more[row][column];
            }
        }
        power = product(&power, &power);
    }
    let largest = power.iter().flatten().map(|it| it.abs()).fold(0.0, f64::max);
    (largest < 1e-3).then_some(p)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::check::Refusal;
    use config::Layers;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    const LANE: Gains = Gains { kv: 3.0, kl: 21.0, ks: 21.0, ki: 0.7 };
    const ROUNDABOUT: Gains = Gains { kv: 3.4, kl: 21.0, ks: 1.0, ki: 0.84 };

    fn car() -> Car {
        Car::new(&Layers::maneuver("circuit").unwrap().resolve().unwrap())
    }

    fn settled(gains: &Gains, speed_mps: f64, curvature: f64) -> Equilibrium {
        Equilibrium::new(&car(), gains, speed_mps, curvature).unwrap()
    }

    fn straight(gains: &Gains, speed_mps: f64) -> Region {
        let at = settled(gains, speed_mps, 0.0);
        Region::find(&car(), gains, &at, Intervals::default()).unwrap()
    }

    #[test]
    fn what_was_found_with_two_corners_is_refused() {
        for gains in [LANE, ROUNDABOUT] {
            let at = settled(&gains, 1.45, 0.0);
            let all = vertices(&car(), &gains, &at, &Intervals::default());
            assert_eq!(all.len(), 96);
            let two = [all[0], all[95]];
            let found = Search::new(&car(), &at, &two).unwrap().region(at, Intervals::default());
            let verdict = check(&car(), &gains, &found.unwrap());
            println!("{verdict:?}");
            let Err(Refusal::Rises { at: rises, of: 96 }) = verdict else {
                panic!("{verdict:?}");
            };
            assert!(rises > 0);
            let found = Region::find_among(&two, &car(), &gains, &at, Intervals::default());
            assert_eq!(found, None, "the search trusts no ellipsoid that the check refuses");
        }
    }

    #[test]
    fn the_region_of_a_straight_is_refused_on_an_arc() {
        for (gains, radius_m) in [(LANE, 7.0), (ROUNDABOUT, 18.0), (ROUNDABOUT, 12.0)] {
            let region = Region {
                equilibrium: settled(&gains, 1.45, 1.0 / radius_m),
                ..straight(&gains, 1.45)
            };
            let verdict = check(&car(), &gains, &region);
            println!("{verdict:?}");
            assert!(matches!(verdict, Err(Refusal::Rises { of: 192, .. })), "{verdict:?}");
        }
    }

    #[test]
    fn an_ellipsoid_of_twice_the_size_is_refused() {
        for gains in [LANE, ROUNDABOUT] {
            let region = straight(&gains, 1.45);
            assert_eq!(check(&car(), &gains, &region), Ok(()));
            let larger = |times: f64| Region {
                p: region.p.map(|row| row.map(|it| it / (times * times))),
                ..region.clone()
            };
            for times in [1.01, 2.0] {
                let verdict = check(&car(), &gains, &larger(times));
                assert!(matches!(verdict, Err(Refusal::Exceeds(_))), "{times}: {verdict:?}");
            }
            // With H for that size the limits hold, but V rises.
            let slower = Region { held: region.held.map(|it| 0.5 * it), ..larger(2.0) };
            assert!(check(&car(), &gains, &slower).is_err());
        }
    }

    #[test]
    fn whatever_else_is_claimed_is_refused() {
        let region = straight(&LANE, 1.45);
        let refused = |change: &dyn Fn(&mut Region)| {
            let mut other = region.clone();
            change(&mut other);
            check(&car(), &LANE, &other).unwrap_err()
        };
        assert_eq!(refused(&|it| it.extent *= 1.001), Refusal::TooFar);
        assert_eq!(refused(&|it| it.p[0][1] += 1e-3), Refusal::NotAMatrix);
        assert_eq!(refused(&|it| it.held[0] = f64::NAN), Refusal::NotAMatrix);
        assert_eq!(
            refused(&|it| it.p = it.p.map(|row| row.map(|it| -it))),
            Refusal::NotAnEllipsoid
        );
        assert_eq!(refused(&|it| it.equilibrium.lead_m *= 1.1), Refusal::OtherEquilibrium);
        assert_eq!(refused(&|it| it.equilibrium.curvature = 0.05), Refusal::OtherEquilibrium);
        assert!(matches!(refused(&|it| it.intervals.speed = 0.3), Refusal::Rises { of: 96, .. }));
        // Wheels that stand still where their rate is limited bring nothing back.
        assert!(matches!(refused(&|it| it.held = [0.0; 4]), Refusal::Rises { of: 96, .. }));
        let rate = Car { steering_rate_radps: 0.5, ..car() };
        assert_eq!(check(&rate, &LANE, &region), Err(Refusal::Exceeds("the steering rate")));
        let angle = Car { steering_limit_rad: 0.01, ..car() };
        assert_eq!(check(&angle, &LANE, &region), Err(Refusal::Exceeds("the steering angle")));
        let other = Gains { ks: 1.0, ..LANE };
        assert!(matches!(check(&car(), &other, &region), Err(Refusal::Rises { .. })));
    }

    #[test]
    fn v_never_rises_from_the_boundary_at_any_vertex() {
        let mut rng = ChaCha8Rng::seed_from_u64(28);
        let mut steepest = f64::NEG_INFINITY;
        for (gains, speed_mps) in [(LANE, 1.45), (LANE, 4.0), (ROUNDABOUT, 1.45), (ROUNDABOUT, 4.0)]
        {
            let region = straight(&gains, speed_mps);
            let all = vertices(&car(), &gains, &region.equilibrium, &region.intervals);
            let most_rad = car().steering_rate_radps * car().tick_s;
            let t = cholesky(&inverse(&region.p).unwrap()).unwrap();
            for _ in 0..500 {
                let vertex = all[rng.random_range(0..all.len())];
                let u: State = std::array::from_fn(|_| rng.random_range(-1.0..1.0));
                let length = u.iter().map(|it| it * it).sum::<f64>().sqrt();
                let mut x: State =
                    std::array::from_fn(|row| (0..4).map(|k| t[row][k] * u[k] / length).sum());
                for _ in 0..300 {
                    let next = vertex.step(&x, most_rad);
                    steepest = steepest.max(region.value(&next) / region.value(&x) - 1.0);
                    x = next;
                }
            }
        }
        println!("steepest {steepest:e}");
        assert!(steepest < 0.0, "{steepest}");
    }
}
