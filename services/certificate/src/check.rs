//! Whether an ellipsoid is what it claims to be. Apart from the search that found it: from the numbers alone, with the
//! rounding of this very check taken into account.
//!
//! V = xᵀ·P·x, E = {V ≤ 1}, and H·x stands for the wheels' turn where the limit ρ of their rate acts. For every vertex, with
//! the matrix M of a tick for δ⁺ = F·x (no limit) and for δ⁺ = δ + H·x (limit), γ·P − Mᵀ·P·M must be positive definite: then
//! V falls, also for every mixture of the two, as which each limited turn can be written while |H·x| ≤ ρ. And in E the
//! steering stays within its limit, |H·x| within ρ, and the heading within [`HEADING_RAD`].
//!
//! A matrix counts as positive definite if its Cholesky factorisation succeeds after a bound of all rounding has been
//! taken off its diagonal. The bound is the sum of the absolute values of all entries and of all that was added up to
//! make them, times [`ROUNDING`]: each entry is a sum of at most 30 products, so the true error is below a fifth of it.

use std::fmt;

use crate::region::Region;
use crate::small::{Square, cholesky, product, quadratic, transposed};
use crate::vertices::{HEADING_RAD, State, Vertex, vertices};
use crate::{Car, Equilibrium, Gains};

/// By how much V falls in a tick, at least, as a share.
pub(crate) const FALL: f64 = 1e-5;

/// The rounding that an entry may have suffered, relative to what was added up to make it.
pub(crate) const ROUNDING: f64 = 300.0 * f64::EPSILON;

/// Why an ellipsoid is refused.
#[derive(Debug, Clone, PartialEq)]
pub enum Refusal {
    /// A number is not finite, or P is not symmetric.
    NotAMatrix,
    /// P is not positive definite.
    NotAnEllipsoid,
    /// The loop does not settle on this path at this speed as the region says.
    OtherEquilibrium,
    /// V may rise at this many of so many vertices.
    Rises {
        /// Vertices at which it may.
        at: usize,
        /// All vertices.
        of: usize,
    },
    /// A state inside exceeds this limit.
    Exceeds(&'static str),
    /// The claimed extent lies outside.
    TooFar,
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::NotAMatrix => write!(f, "P and H are not finite, or P is not symmetric"),
            Self::NotAnEllipsoid => write!(f, "P is not positive definite"),
            Self::OtherEquilibrium => {
                write!(f, "the loop does not settle where the certificate says")
            }
            Self::Rises { at, of } => write!(f, "V may rise at {at} of {of} vertices"),
            Self::Exceeds(limit) => write!(f, "states inside exceed the limit of {limit}"),
            Self::TooFar => write!(f, "the extent that is claimed lies outside of the ellipsoid"),
        }
    }
}

/// Verifies a region for a car and gains.
///
/// # Errors
/// If anything that the region claims cannot be confirmed.
pub fn check(car: &Car, gains: &Gains, region: &Region) -> Result<(), Refusal> {
    let Region { equilibrium: at, intervals, p, held, extent } = region;
    let is_symmetric = (0..4).all(|row| (0..4).all(|column| p[row][column] == p[column][row]));
    let is_finite = p.iter().flatten().chain(held).all(|it| it.is_finite());
    if !is_symmetric || !is_finite {
        return Err(Refusal::NotAMatrix);
    }
    if !is_positive(p, p) {
        return Err(Refusal::NotAnEllipsoid);
    }
    let settled = Equilibrium::new(car, gains, at.reference_mps, at.curvature);
    if !settled.is_some_and(|it| it.is_near(at)) {
        return Err(Refusal::OtherEquilibrium);
    }
    let vertices = vertices(car, gains, at, intervals);
    let good = vertices.iter().filter(|vertex| falls_at(p, vertex, held)).count();
    if good < vertices.len() {
        return Err(Refusal::Rises { at: vertices.len() - good, of: vertices.len() });
    }
    let left_rad = car.steering_limit_rad - at.steering_rad.abs();
    if left_rad <= 0.0 || !vertices.iter().all(|it| is_within(p, &it.filter, left_rad)) {
        return Err(Refusal::Exceeds("the steering angle"));
    }
    if !is_within(p, held, car.steering_rate_radps * car.tick_s) {
        return Err(Refusal::Exceeds("the steering rate"));
    }
    if !is_within(p, &[0.0, 1.0, 0.0, 0.0], HEADING_RAD) {
        return Err(Refusal::Exceeds("the heading"));
    }
    let inside = |corner: &State| quadratic(p, corner) <= 1.0 + ROUNDING;
    if !region.corners(car, *extent).iter().all(inside) {
        return Err(Refusal::TooFar);
    }
    Ok(())
}

/// Whether V falls at a vertex, while the wheels turn freely and while their rate is limited.
fn falls_at(p: &Square<4>, vertex: &Vertex, held: &State) -> bool {
    let mut wheels = *held;
    wheels[3] += 1.0;
    falls(p, &vertex.matrix(&vertex.filter)) && falls(p, &vertex.matrix(&wheels))
}

/// Whether V falls by its share at least in a tick with this matrix.
fn falls(p: &Square<4>, matrix: &Square<4>) -> bool {
    let magnitudes = |a: &Square<4>| a.map(|row| row.map(f64::abs));
    let after = product(&product(&transposed(matrix), p), matrix);
    let m = magnitudes(matrix);
    let largest = product(&product(&transposed(&m), &magnitudes(p)), &m);
    let mut left = [[0.0; 4]; 4];
    let mut added = [[0.0; 4]; 4];
    for row in 0..4 {
        for column in 0..4 {
            left[row][column] = (1.0 - FALL) * p[row][column] - after[row][column];
            added[row][column] = p[row][column].abs() + largest[row][column];
        }
    }
    is_positive(&left, &added)
}

/// Whether |f·x| ≤ `most` for all x in the ellipsoid: most²·P − fᵀ·f is positive definite.
fn is_within(p: &Square<4>, f: &State, most: f64) -> bool {
    let mut left = [[0.0; 4]; 4];
    let mut added = [[0.0; 4]; 4];
    for row in 0..4 {
        for column in 0..4 {
            left[row][column] = p[row][column] - f[row] / most * (f[column] / most);
            added[row][column] = p[row][column].abs() + (f[row] / most * (f[column] / most)).abs();
        }
    }
    is_positive(&left, &added)
}

/// Whether a matrix whose entries were added up of so much is certainly positive definite.
///
/// Both are first scaled by powers of 2, which is exact, so that the diagonal of what was added up is about 1: else the
/// rounding of the largest entries would count for the smallest.
fn is_positive(matrix: &Square<4>, added: &Square<4>) -> bool {
    let scale: State = std::array::from_fn(|place| {
        let half = libm::floor(0.5 * libm::log2(added[place][place].max(f64::MIN_POSITIVE)));
        libm::exp2(-half)
    });
    let scaled = |a: &Square<4>| -> Square<4> {
        std::array::from_fn(|row| {
            std::array::from_fn(|column| a[row][column] * scale[row] * scale[column])
        })
    };
    let mut matrix = scaled(matrix);
    let bound = ROUNDING * scaled(added).iter().flatten().sum::<f64>();
    for (place, row) in matrix.iter_mut().enumerate() {
        row[place] -= bound;
    }
    // The lower triangle alone is read: the upper one is the same but for rounding.
    cholesky(&matrix).is_some()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Intervals;
    use crate::region::lyapunov;
    use config::Layers;

    const LANE: Gains = Gains { kv: 3.0, kl: 21.0, ks: 21.0, ki: 0.7 };

    fn car() -> Car {
        Car::new(&Layers::maneuver("circuit").unwrap().resolve().unwrap())
    }

    fn found(car: &Car, gains: &Gains, curvature: f64) -> Region {
        let at = Equilibrium::new(car, gains, 1.45, curvature).unwrap();
        Region::find(car, gains, &at, Intervals::default()).unwrap()
    }

    fn diagonal(numbers: State) -> Square<4> {
        let mut out = [[0.0; 4]; 4];
        (0..4).for_each(|place| out[place][place] = numbers[place]);
        out
    }

    const ONE: State = [1.0; 4];

    #[test]
    fn what_rounding_may_have_made_positive_is_not() {
        let positive =
            |numbers: State, added: State| is_positive(&diagonal(numbers), &diagonal(added));
        assert!(positive(ONE, ONE));
        // The bound of four entries of size 1 is 2.7e-13.
        assert!(positive([1.0, 1.0, 1.0, 1e-12], ONE));
        assert!(!positive([1.0, 1.0, 1.0, 1e-13], ONE));
        // More that was added up, more rounding: entries beside the diagonal count, too.
        assert!(!is_positive(&diagonal([1.0, 1.0, 1.0, 1e-12]), &[ONE; 4]));
        // Sizes that differ, as those of metres and radians do, are no matter.
        assert!(positive([1e12, 1.0, 1e-3, 1e-9], [1e12, 1.0, 1e-3, 1e-9]));
        assert!(!positive([1.0, 1.0, 1.0, f64::NAN], ONE));
    }

    #[test]
    fn v_must_fall_by_its_share_and_not_only_not_rise() {
        let p = diagonal([1.0, 4.0, 9.0, 0.1]);
        let falls_with = |factor: f64| falls(&p, &diagonal([factor; 4]));
        assert!(falls_with(1.0 - 6e-6), "V falls by 1.2e-5");
        assert!(!falls_with(1.0 - 4e-6), "V falls by 8e-6");
        assert!(!falls_with(1.0) && !falls_with(-1.1));
        // One state that grows is enough.
        assert!(!falls(&p, &diagonal([0.5, 0.5, 1.1, 0.5])));
        // V is the sum of all, and a row that feeds another may make it rise.
        let mut feeds = diagonal([0.9; 4]);
        assert!(falls(&diagonal(ONE), &feeds));
        feeds[3][0] = 0.5;
        assert!(!falls(&diagonal(ONE), &feeds));
    }

    #[test]
    fn a_limit_holds_all_round_the_ellipsoid() {
        // The largest of 0.6·x + 0.8·y on the unit sphere is 1.
        let within = |most: f64| is_within(&diagonal(ONE), &[0.6, -0.8, 0.0, 0.0], most);
        assert!(within(1.0 + 1e-9) && !within(1.0 - 1e-9) && !within(1.0));
        assert!(is_within(&diagonal([4.0; 4]), &[0.6, -0.8, 0.0, 0.0], 0.5 + 1e-9));
    }

    #[test]
    fn each_number_of_where_the_loop_settles_is_held_to_it() {
        let (car, region) = (car(), found(&car(), &LANE, 1.0 / 7.0));
        assert_eq!(check(&car, &LANE, &region), Ok(()));
        let changes: [fn(&mut Equilibrium); 5] = [
            |it| it.speed_mps += 1e-6,
            |it| it.lead_m += 1e-6,
            |it| it.offset_m += 1e-6,
            |it| it.heading_rad += 1e-6,
            |it| it.steering_rad += 1e-6,
        ];
        for (place, change) in changes.into_iter().enumerate() {
            let mut other = region.clone();
            change(&mut other.equilibrium);
            assert_eq!(check(&car, &LANE, &other), Err(Refusal::OtherEquilibrium), "{place}");
        }
        // On such an arc no car settles.
        let mut other = region.clone();
        other.equilibrium.curvature = 3.0;
        assert_eq!(check(&car, &LANE, &other), Err(Refusal::OtherEquilibrium));
    }

    #[test]
    fn a_car_that_cannot_turn_its_wheels_as_far_as_the_arc_asks_is_refused() {
        let region = found(&car(), &LANE, 1.0 / 7.0);
        let stiff = Car { steering_limit_rad: 0.01, ..car() };
        let verdict = check(&stiff, &LANE, &region);
        assert_eq!(verdict, Err(Refusal::Exceeds("the steering angle")));
    }

    #[test]
    fn the_heading_is_held_where_nothing_else_is() {
        // Gains that hardly steer, and wheels that could turn twice as fast as was asked of them.
        let gains = Gains { kv: 3.0, kl: 0.5, ks: 1.0, ki: 0.7 };
        let region = found(&car(), &gains, 0.0);
        let larger = Region { p: region.p.map(|row| row.map(|it| it / 1.0201)), ..region };
        let quick = Car { steering_rate_radps: 2.0 * car().steering_rate_radps, ..car() };
        assert_eq!(check(&quick, &gains, &larger), Err(Refusal::Exceeds("the heading")));
    }

    #[test]
    fn v_falls_while_the_wheels_turn_freely_and_while_their_rate_is_limited() {
        let at = Equilibrium::new(&car(), &LANE, 1.45, 0.0).unwrap();
        let vertex = vertices(&car(), &LANE, &at, &Intervals::default())[0];
        let steady = [-0.077, -0.288, 0.0, -0.1];
        let wheels = [-0.077, -0.288, 0.0, 0.9];
        // P of the free loop, and an H with which the wheels run away.
        let p = lyapunov(&vertex.matrix(&vertex.filter), ONE).unwrap();
        assert!(falls(&p, &vertex.matrix(&vertex.filter)));
        assert!(!falls_at(&p, &vertex, &[0.0, 0.0, 0.0, 0.5]));
        // P of the limited loop, which knows no filter, and a filter with which they do.
        let vertex = Vertex { filter: [0.0, 0.0, 0.5, 1.5], ..vertex };
        let p = lyapunov(&vertex.matrix(&wheels), ONE).unwrap();
        assert!(falls(&p, &vertex.matrix(&wheels)));
        assert!(!falls_at(&p, &vertex, &steady));
        let region = found(&car(), &LANE, 0.0);
        let vertex = vertices(&car(), &LANE, &region.equilibrium, &region.intervals)[0];
        assert!(falls_at(&region.p, &vertex, &region.held));
    }

    #[test]
    fn what_is_no_matrix_is_refused_as_that() {
        let region = found(&car(), &LANE, 0.0);
        let refused = |change: &dyn Fn(&mut Region)| {
            let mut other = region.clone();
            change(&mut other);
            check(&car(), &LANE, &other).unwrap_err()
        };
        assert_eq!(refused(&|it| it.p[0][0] = f64::INFINITY), Refusal::NotAMatrix);
        assert_eq!(refused(&|it| it.p[2][2] = f64::NAN), Refusal::NotAMatrix);
        assert_eq!(refused(&|it| it.held[3] = f64::INFINITY), Refusal::NotAMatrix);
        assert_eq!(refused(&|it| it.p[3][1] *= 1.0 + 1e-12), Refusal::NotAMatrix);
    }

    #[test]
    fn a_refusal_is_told_in_words() {
        for (refusal, words) in [
            (Refusal::NotAMatrix, "not symmetric"),
            (Refusal::NotAnEllipsoid, "not positive definite"),
            (Refusal::OtherEquilibrium, "does not settle"),
            (Refusal::Rises { at: 3, of: 96 }, "V may rise at 3 of 96 vertices"),
            (Refusal::Exceeds("the heading"), "exceed the limit of the heading"),
            (Refusal::TooFar, "lies outside"),
        ] {
            assert!(refusal.to_string().contains(words), "{refusal}");
        }
    }
}
