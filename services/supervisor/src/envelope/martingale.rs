//! Whether the drives of a car have changed since it was calibrated: a conformal test martingale between drives.
//!
//! Each drive's score has a rank among all scores so far, those of the calibration included, and with it a p-value. While
//! drives stay alike, the p-values are uniform or larger, and wealth that is bet on small ones does not grow on average:
//! by J. Ville (1939) it ever reaches 100 with a probability of at most 1 %. The bets are Π ε·p^(ε−1) for five ε, in
//! equal parts (V. Vovk and others, arXiv 2006.02329).

/// What the powers of the bets are.
const BETS: [f64; 5] = [0.2, 0.35, 0.5, 0.65, 0.8];
/// The wealth at which the car counts as changed.
const CHANGED_AT: f64 = 100.0;

/// The martingale of one car and one envelope.
#[derive(Debug, Clone, PartialEq)]
pub struct Martingale {
    /// All scores so far, ascending.
    scores: Vec<f64>,
    /// The logarithm of what each bet has become.
    logs: [f64; BETS.len()],
    wealth: f64,
    highest: f64,
}

impl Martingale {
    /// Before the first drive after a calibration with these scores.
    pub fn new(calibrated: &[f64]) -> Self {
        let mut scores = calibrated.to_vec();
        scores.sort_by(f64::total_cmp);
        Self { scores, logs: [0.0; BETS.len()], wealth: 1.0, highest: 1.0 }
    }

    /// Takes the score of the next drive; returns its p-value.
    pub fn add(&mut self, score: f64) -> f64 {
        let place = self.scores.partition_point(|it| *it < score);
        // Among as many scores as large or larger, itself included: never too small.
        let p = (self.scores.len() - place + 1) as f64 / (self.scores.len() + 1) as f64;
        self.scores.insert(place, score);
        for (log, bet) in self.logs.iter_mut().zip(BETS) {
            *log += libm::log(bet) + (bet - 1.0) * libm::log(p);
        }
        self.wealth = self.logs.iter().map(|log| libm::exp(*log)).sum::<f64>() / BETS.len() as f64;
        self.highest = self.highest.max(self.wealth);
        p
    }

    /// The wealth now; 1 at the start.
    pub fn wealth(&self) -> f64 {
        self.wealth
    }

    /// Whether the car has changed since it was calibrated, but for a probability of 1 %.
    pub fn has_changed(&self) -> bool {
        self.highest >= CHANGED_AT
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_bet_is_as_computed_by_hand() {
        let mut martingale = Martingale::new(&[1.0, 2.0, 3.0]);
        assert_eq!(martingale.add(9.0), 0.25);
        // Means of ε·4^(1−ε).
        let by_hand =
            [0.2 * 3.031_433, 0.35 * 2.462_289, 0.5 * 2.0, 0.65 * 1.624_505, 0.8 * 1.319_508];
        assert!((martingale.wealth() - by_hand.iter().sum::<f64>() / 5.0).abs() < 1e-5);
        // Ties count as larger.
        assert_eq!(martingale.add(3.0), 3.0 / 5.0);
    }

    #[test]
    fn drives_that_are_alike_change_nothing_and_worse_ones_do() {
        let calibrated: Vec<f64> = (0..1000).map(f64::from).collect();
        let mut alike = Martingale::new(&calibrated);
        (0..2000).for_each(|number| {
            alike.add(f64::from(number * 617 % 1000));
        });
        assert!(!alike.has_changed());
        let mut worse = Martingale::new(&calibrated);
        let drives = (1..).find(|_| {
            worse.add(999.5);
            worse.has_changed()
        });
        assert!(drives.is_some_and(|drives| drives <= 4), "{drives:?}");
    }
}
