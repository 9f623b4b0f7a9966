//! Small matrices, with loops of a fixed order.

// As in the equations: rows and columns by their numbers.
#![allow(clippy::needless_range_loop)]

/// A square matrix, by rows.
pub(crate) type Square<const N: usize> = [[f64; N]; N];

/// The lower triangular C with C·Cᵀ = A, of which only the lower triangle is read; `None` unless A is positive definite.
pub(crate) fn cholesky<const N: usize>(matrix: &Square<N>) -> Option<Square<N>> {
    let mut lower = [[0.0; N]; N];
    for row in 0..N {
        for column in 0..=row {
            let mut rest = matrix[row][column];
            for k in 0..column {
                rest -= lower[row][k] * lower[column][k];
            }
            if row == column {
                // Also false for what is no number.
                if !(rest > 0.0 && rest.is_finite()) {
                    return None;
                }
                lower[row][row] = rest.sqrt();
            } else {
                lower[row][column] = rest / lower[column][column];
            }
        }
    }
    Some(lower)
}

/// The inverse of a lower triangular matrix.
pub(crate) fn lower_inverse<const N: usize>(lower: &Square<N>) -> Square<N> {
    let mut inverse = [[0.0; N]; N];
    for column in 0..N {
        inverse[column][column] = 1.0 / lower[column][column];
        for row in column + 1..N {
            let mut sum = 0.0;
            for k in column..row {
                sum += lower[row][k] * inverse[k][column];
            }
            inverse[row][column] = -sum / lower[row][row];
        }
    }
    inverse
}

/// A·B.
pub(crate) fn product<const N: usize>(a: &Square<N>, b: &Square<N>) -> Square<N> {
    let mut out = [[0.0; N]; N];
    for row in 0..N {
        for k in 0..N {
            for column in 0..N {
                out[row][column] += a[row][k] * b[k][column];
            }
        }
    }
    out
}

/// Aᵀ.
pub(crate) fn transposed<const N: usize>(a: &Square<N>) -> Square<N> {
    std::array::from_fn(|row| std::array::from_fn(|column| a[column][row]))
}

/// A row times a matrix.
pub(crate) fn row_times<const N: usize>(row: &[f64; N], a: &Square<N>) -> [f64; N] {
    let mut out = [0.0; N];
    for k in 0..N {
        for column in 0..N {
            out[column] += row[k] * a[k][column];
        }
    }
    out
}

/// xᵀ·A·x.
pub(crate) fn quadratic<const N: usize>(a: &Square<N>, x: &[f64; N]) -> f64 {
    let ax = row_times(x, a);
    x.iter().zip(ax).map(|(x, ax)| x * ax).sum()
}

/// The inverse of a symmetric positive definite matrix.
pub(crate) fn inverse<const N: usize>(a: &Square<N>) -> Option<Square<N>> {
    let inverse = lower_inverse(&cholesky(a)?);
    Some(product(&transposed(&inverse), &inverse))
}
