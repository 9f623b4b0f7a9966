//! The spectral radius of a matrix.

/// Squarings after which the estimate stands: its error is the logarithm of the matrix's condition over 2 to this power.
const SQUARINGS: i32 = 32;

/// The spectral radius of an n × n matrix, given row by row: the limit of ‖Aᵏ‖^(1/k), reached by squaring.
///
/// An iteration for eigenvalues may fail to converge; this cannot, and it takes the same steps on every host.
pub(crate) fn spectral_radius(n: usize, matrix: &[f64]) -> f64 {
    let mut power = matrix.to_vec();
    let mut square = vec![0.0; n * n];
    // The matrix to the power of 2ᵏ is `power` · exp(log_scale).
    let mut log_scale = 0.0;
    let mut exponent = 1.0;
    for _ in 0..SQUARINGS {
        let norm = power.iter().map(|it| it * it).sum::<f64>().sqrt();
        if norm == 0.0 {
            return 0.0;
        }
        power.iter_mut().for_each(|it| *it /= norm);
        log_scale = 2.0 * (log_scale + libm::log(norm));
        exponent *= 2.0;
        square.fill(0.0);
        for (row, out) in power.chunks_exact(n).zip(square.chunks_exact_mut(n)) {
            for (&factor, other) in row.iter().zip(power.chunks_exact(n)) {
                if factor != 0.0 {
                    out.iter_mut().zip(other).for_each(|(sum, it)| *sum += factor * it);
                }
            }
        }
        std::mem::swap(&mut power, &mut square);
    }
    let norm = power.iter().map(|it| it * it).sum::<f64>().sqrt();
    if norm == 0.0 { 0.0 } else { libm::exp((log_scale + libm::log(norm)) / exponent) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn matrices_whose_eigenvalues_are_known() {
        let check = |n: usize, matrix: &[f64], wanted: f64| {
            let got = spectral_radius(n, matrix);
            assert!((got - wanted).abs() < 1e-7, "{got} {wanted}");
        };
        check(1, &[-0.5], 0.5);
        // A pair of complex ones, a block that is not diagonal, one that dies out, and one of very different sizes.
        check(2, &[0.6, -0.8, 0.8, 0.6], 1.0);
        check(2, &[0.9, 1.0, 0.0, 0.9], 0.9);
        check(3, &[0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], 0.0);
        check(2, &[0.999, 1e6, 0.0, 0.998], 0.999);
        check(2, &[0.5, 0.0, 0.0, 1.001], 1.001);
    }
}
