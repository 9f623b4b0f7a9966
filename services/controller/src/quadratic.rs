//! A small quadratic programme: the angles of a steering plan that cost least, within the limits of angle and rate.
//!
//! By the alternating direction method of multipliers, in the form of Stellato and others, "OSQP: an operator splitting
//! solver for quadratic programs", Mathematical Programming Computation 12 (2020), with one penalty. All sizes are fixed and all loops are here, so that the same numbers come out on every machine: the
//! matrix products of libraries pick their order of summation by the processor.

#![allow(clippy::needless_range_loop, reason = "indices as in the equations")]

/// Number of angles of a plan.
pub(crate) const N: usize = 20;

/// One number for each angle of a plan.
pub(crate) type Plan = [f64; N];

/// A symmetric matrix over a plan.
pub(crate) type Square = [[f64; N]; N];

/// The limits of a plan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Limits {
    /// The largest angle to either side, rad.
    pub angle_rad: f64,
    /// The largest change from one angle to the next, rad.
    pub change_rad: f64,
    /// The angle before the first, rad.
    pub last_rad: f64,
}

impl Limits {
    /// What is limited: each angle, and each change; the first change against zero instead of the angle before it.
    fn rows(x: &Plan) -> [Plan; 2] {
        let mut changes = *x;
        for i in 1..N {
            changes[i] = x[i] - x[i - 1];
        }
        [*x, changes]
    }

    /// The nearest values within the limits.
    fn project(&self, rows: [Plan; 2]) -> [Plan; 2] {
        let [mut angles, mut changes] = rows;
        for angle in &mut angles {
            *angle = angle.clamp(-self.angle_rad, self.angle_rad);
        }
        for (i, change) in changes.iter_mut().enumerate() {
            let centre = if i == 0 { self.last_rad } else { 0.0 };
            *change = change.clamp(centre - self.change_rad, centre + self.change_rad);
        }
        [angles, changes]
    }

    /// A plan within the limits that follows another one from the first angle on.
    fn keep(&self, mut x: Plan) -> Plan {
        let mut last_rad = self.last_rad;
        for angle in &mut x {
            last_rad = angle
                .clamp(last_rad - self.change_rad, last_rad + self.change_rad)
                .clamp(-self.angle_rad, self.angle_rad);
            *angle = last_rad;
        }
        x
    }
}

/// The plan x that makes ½·xᵀ·H·x + gᵀ·x least within the limits: to a billionth of a radian where a thousand steps
/// suffice, as they do for plans of a car, and otherwise roughly, but within the limits, too. `None` if H is not positive definite.
pub(crate) fn least(h: &Square, g: &Plan, limits: &Limits) -> Option<Plan> {
    const MOST_STEPS: usize = 1000;
    const CLOSE: f64 = 1e-9;
    const RELAXATION: f64 = 1.6;
    let mut x = solve(&cholesky(h)?, &g.map(|it| -it));
    let rows = Limits::rows(&x);
    let mut inside = limits.project(rows);
    if inside == rows {
        return Some(x);
    }
    // The penalty of leaving the limits: between the cheapest and the dearest part of the plan.
    let diagonal = (0..N).map(|i| h[i][i]);
    let (cheapest, dearest) =
        diagonal.fold((f64::INFINITY, 0.0_f64), |(low, high), it| (low.min(it), high.max(it)));
    let penalty = (cheapest * dearest).sqrt();
    let mut penalised = *h;
    for i in 0..N {
        // Of each angle itself, and of the changes before and after it.
        penalised[i][i] += penalty * if i + 1 < N { 3.0 } else { 2.0 };
        if i > 0 {
            penalised[i][i - 1] -= penalty;
            penalised[i - 1][i] -= penalty;
        }
    }
    let factor = cholesky(&penalised)?;
    let mut outside = [[0.0; N]; 2];
    for _ in 0..MOST_STEPS {
        let mut right = g.map(|it| -it);
        for i in 0..N {
            let pull = |row: usize, i: usize| inside[row][i] - outside[row][i];
            let after = if i + 1 < N { pull(1, i + 1) } else { 0.0 };
            right[i] += penalty * (pull(0, i) + pull(1, i) - after);
        }
        x = solve(&factor, &right);
        let rows = Limits::rows(&x);
        let mut wanted = rows;
        for row in 0..2 {
            for i in 0..N {
                wanted[row][i] = RELAXATION * rows[row][i]
                    + (1.0 - RELAXATION) * inside[row][i]
                    + outside[row][i];
            }
        }
        let next = limits.project(wanted);
        let mut apart = 0.0_f64;
        for row in 0..2 {
            for i in 0..N {
                outside[row][i] = wanted[row][i] - next[row][i];
                apart = apart
                    .max((rows[row][i] - next[row][i]).abs())
                    .max((next[row][i] - inside[row][i]).abs());
            }
        }
        inside = next;
        if apart < CLOSE {
            return Some(x);
        }
    }
    Some(limits.keep(x))
}

/// The lower triangle L of H = L·Lᵀ; `None` if H is not positive definite.
fn cholesky(h: &Square) -> Option<Square> {
    let mut l = [[0.0; N]; N];
    for i in 0..N {
        for j in 0..=i {
            let mut sum = h[i][j];
            for k in 0..j {
                sum -= l[i][k] * l[j][k];
            }
            if i > j {
                l[i][j] = sum / l[j][j];
            } else if sum > 0.0 {
                l[i][i] = sum.sqrt();
            } else {
                return None;
            }
        }
    }
    Some(l)
}

/// Solves L·Lᵀ·x = b.
fn solve(l: &Square, b: &Plan) -> Plan {
    let mut x = *b;
    for i in 0..N {
        for k in 0..i {
            x[i] -= l[i][k] * x[k];
        }
        x[i] /= l[i][i];
    }
    for i in (0..N).rev() {
        for k in i + 1..N {
            x[i] -= l[k][i] * x[k];
        }
        x[i] /= l[i][i];
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A positive definite matrix: B·Bᵀ + I.
    fn square(b: &[f64]) -> Square {
        let mut h = [[0.0; N]; N];
        for (i, row) in h.iter_mut().enumerate() {
            for (j, it) in row.iter_mut().enumerate() {
                *it = (0..N).map(|k| b[i * N + k] * b[j * N + k]).sum::<f64>();
                *it += if i == j { 1.0 } else { 0.0 };
            }
        }
        h
    }

    fn cost(h: &Square, g: &Plan, x: &Plan) -> f64 {
        (0..N).map(|i| g[i] * x[i] + 0.5 * (0..N).map(|j| x[i] * h[i][j] * x[j]).sum::<f64>()).sum()
    }

    /// The largest amount by which a plan leaves the limits.
    fn outside(x: &Plan, limits: &Limits) -> f64 {
        let rows = Limits::rows(x);
        let inside = limits.project(rows);
        rows.iter()
            .zip(&inside)
            .flat_map(|(a, b)| a.iter().zip(b))
            .fold(0.0, |most, (a, b)| f64::max(most, (a - b).abs()))
    }

    proptest! {
        /// The programme is convex: what no feasible direction improves is its only solution.
        #[test]
        fn no_feasible_plan_costs_less(
            b in prop::collection::vec(-1.0..1.0f64, N * N),
            g in prop::collection::vec(-5.0..5.0f64, N),
            others in prop::collection::vec(prop::collection::vec(-0.6..0.6f64, N), 20),
            change_rad in 0.01..0.5f64,
            last_rad in -0.5..0.5f64,
        ) {
            let (h, g) = (square(&b), <Plan>::try_from(g).unwrap());
            let limits = Limits { angle_rad: 0.5, change_rad, last_rad };
            let x = least(&h, &g, &limits).unwrap();
            prop_assert!(outside(&x, &limits) < 2e-9, "{}", outside(&x, &limits));
            let best = cost(&h, &g, &x);
            for other in others {
                // A feasible plan: limited angle by angle.
                let other = limits.keep(<Plan>::try_from(other).unwrap());
                // Also a small step of the way to it.
                for share in [1.0, 1e-3] {
                    let other: Plan =
                        std::array::from_fn(|i| x[i] + share * (other[i] - x[i]));
                    prop_assert!(cost(&h, &g, &other) > best - 1e-2, "{share}");
                }
            }
        }
    }

    #[test]
    fn without_a_limit_in_reach_it_is_the_solution_of_the_equations() {
        let b: Vec<f64> = (0..N * N).map(|i| libm::sin(i as f64)).collect();
        let (h, g) = (square(&b), std::array::from_fn(|i| libm::cos(i as f64)));
        let limits = Limits { angle_rad: 1e9, change_rad: 1e9, last_rad: 0.0 };
        let x = least(&h, &g, &limits).unwrap();
        for i in 0..N {
            let left: f64 = (0..N).map(|j| h[i][j] * x[j]).sum();
            assert!((left + g[i]).abs() < 1e-9);
        }
        assert_eq!(least(&[[0.0; N]; N], &g, &limits), None);
    }
}
