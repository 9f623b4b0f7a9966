//! Sobol points, scrambled.
//!
//! Direction numbers of S. Joe and F. Y. Kuo, "Constructing Sobol sequences with better two-dimensional projections"
//! (2008), for as many dimensions as a law may have parameters. The scrambling is Owen's, by a hash of the bits as in
//! S. Laine and T. Karras, "Stratified sampling for stochastic transparency" (2011).

/// For each dimension after the first: degree and coefficients of its primitive polynomial, and its first direction
/// numbers.
const TABLE: [(u32, u32, &[u32]); 15] = [
    (1, 0, &[1]),
    (2, 1, &[1, 3]),
    (3, 1, &[1, 3, 1]),
    (3, 2, &[1, 1, 1]),
    (4, 1, &[1, 1, 3, 3]),
    (4, 4, &[1, 3, 5, 13]),
    (5, 2, &[1, 1, 5, 5, 17]),
    (5, 4, &[1, 1, 5, 5, 5]),
    (5, 7, &[1, 1, 7, 11, 19]),
    (5, 11, &[1, 1, 5, 1, 1]),
    (5, 13, &[1, 1, 1, 3, 11]),
    (5, 14, &[1, 3, 5, 5, 31]),
    (6, 1, &[1, 3, 3, 9, 7, 49]),
    (6, 13, &[1, 1, 1, 15, 21, 21]),
    (6, 16, &[1, 3, 1, 13, 27, 49]),
];

/// A scrambled sequence.
#[derive(Debug, Clone)]
pub(crate) struct Sobol {
    directions: Vec<[u32; 32]>,
    seeds: Vec<u32>,
}

impl Sobol {
    /// The sequence with as many dimensions as there are seeds of its scrambling, at most 16.
    pub(crate) fn new(seeds: Vec<u32>) -> Self {
        Self { directions: (0..seeds.len()).map(directions).collect(), seeds }
    }

    /// Point number `index`, its coordinates in [0, 1).
    pub(crate) fn point(&self, index: u32) -> Vec<f64> {
        let of = |(directions, seed): (&[u32; 32], &u32)| {
            let bits = (0..32).filter(|bit| index >> bit & 1 == 1);
            let drawn = bits.fold(0, |sum, bit| sum ^ directions[bit]);
            f64::from(scrambled(drawn, *seed)) / (1u64 << 32) as f64
        };
        self.directions.iter().zip(&self.seeds).map(of).collect()
    }
}

fn directions(dimension: usize) -> [u32; 32] {
    let mut all = [0u32; 32];
    let Some(row) = dimension.checked_sub(1) else {
        (0..32).for_each(|bit| all[bit] = 1 << (31 - bit));
        return all;
    };
    let (degree, coefficients, first) = TABLE[row];
    let degree = degree as usize;
    for bit in 0..32 {
        if bit < degree {
            all[bit] = first[bit] << (31 - bit);
            continue;
        }
        all[bit] = all[bit - degree] ^ (all[bit - degree] >> degree);
        for term in 1..degree {
            if coefficients >> (degree - 1 - term) & 1 == 1 {
                all[bit] ^= all[bit - term];
            }
        }
    }
    all
}

fn scrambled(drawn: u32, seed: u32) -> u32 {
    let mut x = drawn.reverse_bits().wrapping_add(seed);
    for factor in [0x6c50_b47c, 0xb82f_1e52, 0xc7af_e638, 0x8d22_f6e6u32] {
        x ^= x.wrapping_mul(factor);
    }
    x.reverse_bits()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_interval_of_each_dimension_holds_one_point() {
        let sobol = Sobol::new((1..=16).map(|it: u32| it.wrapping_mul(0x9e37_79b9)).collect());
        for dimension in 0..16 {
            let mut held = [0; 256];
            (0..256).for_each(|it| held[(sobol.point(it)[dimension] * 256.0) as usize] += 1);
            assert_eq!(held, [1; 256], "dimension {dimension}");
        }
    }

    #[test]
    fn each_square_of_the_first_two_dimensions_holds_one_point() {
        let sobol = Sobol::new(vec![7, 8]);
        let mut held = [0; 256];
        for index in 0..256 {
            let point = sobol.point(index);
            held[(point[0] * 16.0) as usize * 16 + (point[1] * 16.0) as usize] += 1;
        }
        assert_eq!(held, [1; 256]);
    }

    #[test]
    fn the_published_points_come_out_without_scrambling() {
        // Points 1 to 3 of dimensions 1 to 4, in the order of the published program without its Gray code.
        let point = |index: u32| -> Vec<f64> {
            let bits = |directions: [u32; 32]| {
                (0..32)
                    .filter(|bit| index >> bit & 1 == 1)
                    .fold(0, |sum, bit| sum ^ directions[bit])
            };
            (0..4).map(|it| f64::from(bits(directions(it))) / (1u64 << 32) as f64).collect()
        };
        assert_eq!(point(1), [0.5; 4]);
        assert_eq!(point(2), [0.25, 0.75, 0.75, 0.75]);
        assert_eq!(point(3), [0.75, 0.25, 0.25, 0.25]);
    }

    #[test]
    fn each_polynomial_is_primitive_and_each_first_number_odd_and_small() {
        for (degree, coefficients, first) in TABLE {
            // x^degree + … + 1, its coefficients as bits. It is primitive if the powers of x meet 1 no earlier than
            // after 2^degree − 1 steps.
            let polynomial = 1 << degree | coefficients << 1 | 1;
            let (mut power, mut order) = (1u32, 0);
            loop {
                power <<= 1;
                if power >> degree & 1 == 1 {
                    power ^= polynomial;
                }
                order += 1;
                if power <= 1 {
                    break;
                }
            }
            assert_eq!((power, order), (1, (1 << degree) - 1), "{polynomial:b}");
            assert_eq!(first.len(), degree as usize);
            assert!(first.iter().enumerate().all(|(at, it)| it % 2 == 1 && *it < 2 << at));
        }
    }

    /// Sobol's property A, which the published numbers have in every dimension: of 2^d points in d dimensions, each
    /// halving of all axes holds one.
    #[test]
    fn each_part_of_the_cube_halved_along_all_axes_holds_one_point() {
        for dimensions in 1..=16 {
            let directions: Vec<[u32; 32]> = (0..dimensions).map(directions).collect();
            let mut held = vec![false; 1 << dimensions];
            for index in 0..1u32 << dimensions {
                let half = |directions: &[u32; 32]| {
                    let bits = (0..dimensions).filter(|bit| index >> bit & 1 == 1);
                    bits.fold(0, |sum, bit| sum ^ directions[bit]) >> 31
                };
                let part = directions.iter().fold(0, |part, it| part << 1 | half(it));
                assert!(!std::mem::replace(&mut held[part as usize], true), "{dimensions}");
            }
        }
    }
}
