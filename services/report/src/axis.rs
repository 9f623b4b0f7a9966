//! Axes: their ends, their ticks, and how numbers are written.

/// Values beyond this are drawn at the bound, so that the arithmetic of an axis stays finite, even that of squares.
pub(crate) const HUGE: f64 = 1e150;

/// One axis of a picture.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Axis {
    pub(crate) low: f64,
    pub(crate) high: f64,
    /// Value and label of each tick.
    pub(crate) ticks: Vec<(f64, String)>,
}

impl Axis {
    /// An axis that covers all values, with some space beyond them, and about `wanted` ticks.
    pub(crate) fn around(values: impl IntoIterator<Item = f64>, wanted: usize) -> Self {
        let (low, high) = extent(values);
        let air = 0.05 * (high - low);
        Self::between(low - air, high + air, wanted)
    }

    /// An axis that begins and ends with the values, as time does.
    pub(crate) fn tight(values: impl IntoIterator<Item = f64>, wanted: usize) -> Self {
        let (low, high) = extent(values);
        let step = nice_step((high - low) / wanted.max(1) as f64);
        // A drive of 5 s ends one tick before 5 s: then the axis ends at the round number.
        let round = (high / step).ceil() * step;
        let high = if round - high < 0.02 * (high - low) { round } else { high };
        Self::between(low, high, wanted)
    }

    /// An axis from 0, for bars, whose length is the number.
    pub(crate) fn from_zero(values: impl IntoIterator<Item = f64>, wanted: usize) -> Self {
        let (_, high) = extent(values.into_iter().chain([0.0]));
        Self::between(0.0, high * 1.05, wanted)
    }

    /// An axis of counts from 1: no tick lies between two of them.
    pub(crate) fn of_counts(highest: usize) -> Self {
        Self::between(0.5, highest.max(1) as f64 + 0.5, highest.clamp(1, 7))
    }

    /// An axis with these ends.
    pub(crate) fn between(low: f64, high: f64, wanted: usize) -> Self {
        let (low, high) = widened(low, high);
        let step = nice_step((high - low) / wanted.max(1) as f64);
        // Multiplied, not added up: with enormous values a step may be too small to change a sum.
        let first = (low / step - 1e-6).ceil();
        let count = ((high / step + 1e-6).floor() - first).clamp(0.0, 30.0) as usize;
        let ticks = (0..=count)
            .map(|index| (first + index as f64) * step)
            .map(|tick| (tick, tick_label(tick, step, low.abs().max(high.abs()))))
            .collect();
        Self { low, high, ticks }
    }

    /// A logarithmic axis of ranks from 1: values are the logarithms.
    pub(crate) fn of_ranks(highest: f64) -> Self {
        let mut ticks = Vec::new();
        let mut decade = 1.0;
        while decade <= highest {
            for factor in [1.0, 2.0, 5.0] {
                let rank = decade * factor;
                if rank <= highest * 1.001 {
                    ticks.push((f64::log10(rank), integer(rank as u64)));
                }
            }
            decade *= 10.0;
        }
        Self { low: -0.05, high: highest.max(2.0).log10() + 0.05, ticks }
    }
}

/// Least and largest of the values that can be drawn, never the same.
fn extent(values: impl IntoIterator<Item = f64>) -> (f64, f64) {
    let (low, high) = values
        .into_iter()
        .filter(|value| value.is_finite())
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
            (low.min(value.max(-HUGE)), high.max(value.min(HUGE)))
        });
    if low > high { (0.0, 1.0) } else { widened(low, high) }
}

/// The same ends, apart far enough that ticks between them differ.
fn widened(low: f64, high: f64) -> (f64, f64) {
    let least = (low.abs().max(high.abs()) * 1e-9).max(1e-12);
    if high - low >= least {
        return (low, high);
    }
    let middle = 0.5 * low + 0.5 * high;
    let half = if middle == 0.0 { 0.5 } else { 0.1 * middle.abs() };
    (middle - half, middle + half)
}

/// The number nearest to `step` that is 1, 2 or 5 times a power of ten.
fn nice_step(step: f64) -> f64 {
    let power = 10f64.powf(step.log10().floor());
    let bounds = [(1.0, 1.5), (2.0, 3.5), (5.0, 7.5)];
    let factor = bounds.into_iter().find(|(_, most)| step <= most * power);
    factor.map_or(10.0, |(factor, _)| factor) * power
}

fn tick_label(tick: f64, step: f64, largest: f64) -> String {
    if !(1e-4..1e6).contains(&largest) {
        if tick.abs() < step * 0.5 {
            return "0".to_owned();
        }
        // As many digits as are needed to distinguish neighbours, but no more than fit.
        let digits = (largest.log10().floor() - step.log10().floor()).clamp(0.0, 4.0) as usize;
        return typographic(&format!("{tick:.digits$e}"));
    }
    let decimals = (-(step * 1.001).log10().floor()).clamp(0.0, 6.0) as usize;
    typographic(&format!("{tick:.decimals$}"))
}

/// A number with `digits` digits after the decimal point; in powers of ten if that would be unreadable.
pub(crate) fn number(value: f64, digits: usize) -> String {
    if !value.is_finite() {
        return "–".to_owned();
    }
    let too_small = value != 0.0 && value.abs() < 0.5 * 10f64.powi(-(digits as i32));
    if too_small || value.abs() >= 1e7 {
        return typographic(&format!("{value:.2e}"));
    }
    typographic(&format!("{value:.digits$}"))
}

/// A number that may be missing.
pub(crate) fn optional(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "–".to_owned(), |value| number(value, digits))
}

/// A parameter with as many digits as it needs: at least four significant ones.
pub(crate) fn short(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return number(value, 0);
    }
    let digits = (3.0 - value.abs().log10().floor()).clamp(4.0, 9.0) as usize;
    let text = number(value, digits);
    if text.contains('e') || !text.contains('.') {
        return text;
    }
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// A count with its thousands separated.
pub(crate) fn integer(count: u64) -> String {
    let digits = count.to_string();
    let mut text = String::new();
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index).is_multiple_of(3) && digits.len() > 4 {
            text.push('\u{202f}');
        }
        text.push(digit);
    }
    text
}

/// Replaces the hyphen by a minus sign, and removes it before a zero.
fn typographic(number: &str) -> String {
    let Some(digits) = number.strip_prefix('-') else { return number.to_owned() };
    let is_zero = digits.chars().all(|c| c == '0' || c == '.');
    if is_zero {
        digits.to_owned()
    } else {
        format!("\u{2212}{}", digits.replace("e-", "e\u{2212}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(axis: &Axis) {
        assert!(axis.low.is_finite() && axis.high.is_finite() && axis.low < axis.high, "{axis:?}");
        assert!((2..=31).contains(&axis.ticks.len()), "{axis:?}");
        let labels: std::collections::BTreeSet<_> = axis.ticks.iter().map(|tick| &tick.1).collect();
        assert_eq!(labels.len(), axis.ticks.len(), "no label twice: {axis:?}");
        assert!(axis.ticks.iter().all(|tick| tick.1.chars().count() <= 11), "{axis:?}");
    }

    #[test]
    fn axes_cope_with_everything_that_files_hold() {
        for values in [
            vec![],
            vec![0.0],
            vec![5.0],
            vec![-3.0; 10],
            vec![1e300],
            vec![-1.7e308, 1.7e308],
            vec![1e-300, 2e-300],
            vec![1e9, 1e9 + 1e-3],
            vec![123456.0, 123457.0],
            vec![f64::NAN, 1.0, f64::INFINITY],
            vec![0.795, 1.6],
            vec![0.00001, 0.00003],
        ] {
            check(&Axis::around(values.iter().copied(), 5));
            check(&Axis::tight(values.iter().copied(), 5));
            if values.iter().all(|value| *value >= 0.0) {
                check(&Axis::from_zero(values.iter().copied(), 5));
            }
        }
    }

    #[test]
    fn ticks_are_round_numbers_of_equal_length() {
        let labels = |axis: Axis| axis.ticks.into_iter().map(|tick| tick.1).collect::<Vec<_>>();
        assert_eq!(labels(Axis::between(0.0, 5.0, 5)), ["0", "1", "2", "3", "4", "5"]);
        assert_eq!(labels(Axis::between(-1.0, 1.0, 4)), ["−1.0", "−0.5", "0.0", "0.5", "1.0"]);
        assert_eq!(labels(Axis::between(0.0, 2e6, 2)), ["0", "1e6", "2e6"]);
    }

    #[test]
    fn numbers_have_sensible_digits() {
        assert_eq!(number(0.79550564, 4), "0.7955");
        assert_eq!(number(-0.00000001, 4), "−1.00e−8");
        assert_eq!(number(f64::NAN, 4), "–");
        assert_eq!(short(1.8399999999999999), "1.84");
        assert_eq!((short(21.0).as_str(), short(0.0).as_str()), ("21", "0"));
        assert_eq!((short(0.000123456).as_str(), short(-0.02).as_str()), ("0.0001235", "−0.02"));
        assert_eq!(integer(15117), "15\u{202f}117");
        assert_eq!(integer(750), "750");
    }
}
