//! Cholesky factors of small matrices, in plain loops: a library would pick its kernels by the processor, and with them
//! the order in which numbers are added.

/// The factor L of a symmetric, positive definite matrix A = L Lᵀ.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Cholesky {
    size: usize,
    /// Lᵀ, row by row; what is left of the diagonal is not used. So the inner loops run over neighbours.
    rows: Vec<f64>,
}

impl Cholesky {
    /// Factors a matrix given row by row, of which it reads the diagonal and what is right of it; `None` if the matrix is
    /// not positive definite.
    pub(crate) fn of(mut matrix: Vec<f64>, size: usize) -> Option<Self> {
        debug_assert_eq!(matrix.len(), size * size);
        for at in 0..size {
            let (done, below) = matrix.split_at_mut((at + 1) * size);
            let row = &mut done[at * size + at..];
            if row[0].is_nan() || row[0] <= 0.0 {
                return None;
            }
            let root = row[0].sqrt();
            row.iter_mut().for_each(|it| *it /= root);
            for other in at + 1..size {
                let share = row[other - at];
                let start = (other - at - 1) * size + other;
                let rest = &mut below[start..start + size - other];
                rest.iter_mut().zip(&row[other - at..]).for_each(|(it, by)| *it -= share * by);
            }
        }
        matrix.iter().all(|it| it.is_finite()).then_some(Self { size, rows: matrix })
    }

    fn row(&self, at: usize) -> &[f64] {
        &self.rows[at * self.size + at..(at + 1) * self.size]
    }

    /// ln det A.
    pub(crate) fn log_determinant(&self) -> f64 {
        2.0 * (0..self.size).map(|at| libm::log(self.row(at)[0])).sum::<f64>()
    }

    /// Solves L Y = B in place, for a matrix B of `columns` columns given row by row.
    pub(crate) fn solve_lower(&self, b: &mut [f64], columns: usize) {
        for at in 0..self.size {
            let (done, below) = b.split_at_mut((at + 1) * columns);
            let solved = &mut done[at * columns..];
            let row = self.row(at);
            solved.iter_mut().for_each(|it| *it /= row[0]);
            for (rest, share) in below.chunks_exact_mut(columns).zip(&row[1..]) {
                rest.iter_mut().zip(&*solved).for_each(|(it, by)| *it -= share * by);
            }
        }
    }

    /// Solves Lᵀ x = y in place.
    pub(crate) fn solve_upper(&self, y: &mut [f64]) {
        for at in (0..self.size).rev() {
            let row = self.row(at);
            let known: f64 = row[1..].iter().zip(&y[at + 1..]).map(|(a, b)| a * b).sum();
            y[at] = (y[at] - known) / row[0];
        }
    }

    /// L z.
    pub(crate) fn times(&self, z: &[f64]) -> Vec<f64> {
        let mut product = vec![0.0; self.size];
        for (at, share) in z.iter().enumerate() {
            product[at..].iter_mut().zip(self.row(at)).for_each(|(it, by)| *it += share * by);
        }
        product
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_factor_gives_the_matrix_back_and_solves_it() {
        // A = L Lᵀ with L = [2 0 0; 1 3 0; -1 2 1].
        let a = vec![4.0, 2.0, -2.0, 2.0, 10.0, 5.0, -2.0, 5.0, 6.0];
        let factor = Cholesky::of(a.clone(), 3).unwrap();
        assert_eq!(factor.times(&[1.0, 0.0, 0.0]), [2.0, 1.0, -1.0]);
        assert_eq!(factor.times(&[0.0, 1.0, 1.0]), [0.0, 3.0, 3.0]);
        assert!((factor.log_determinant() - libm::log(36.0)).abs() < 1e-12);
        // A x = b for x = (1, -2, 3), twice beside each other.
        let x = [1.0, -2.0, 3.0];
        let b: Vec<f64> =
            a.chunks(3).map(|row| row.iter().zip(x).map(|(a, x)| a * x).sum()).collect();
        let mut both: Vec<f64> = b.iter().flat_map(|it| [*it, 2.0 * it]).collect();
        factor.solve_lower(&mut both, 2);
        let mut solved: Vec<f64> = both.iter().copied().step_by(2).collect();
        assert!(both.chunks(2).all(|it| it[1] == 2.0 * it[0]));
        factor.solve_upper(&mut solved);
        assert!(solved.iter().zip(x).all(|(a, b)| (a - b).abs() < 1e-12), "{solved:?}");
    }

    #[test]
    fn what_is_not_positive_definite_has_no_factor() {
        assert_eq!(Cholesky::of(vec![1.0, 2.0, 2.0, 1.0], 2), None);
        assert_eq!(Cholesky::of(vec![f64::NAN], 1), None);
        assert_eq!(Cholesky::of(vec![f64::INFINITY], 1), None);
    }
}
