//! The one way in which a time is written on the command line: `10s`, `1m30s`, `500ms`.

use std::time::Duration;

/// The units, the longest first, each with its nanoseconds.
const UNITS: [(&str, f64); 5] = [("h", 3.6e12), ("m", 6e10), ("s", 1e9), ("ms", 1e6), ("us", 1e3)];

/// A time above zero.
pub(super) fn above_zero(text: &str) -> Result<Duration, String> {
    let time = parse(text).filter(|time| !time.is_zero());
    time.ok_or_else(|| "a time above zero is meant, as in 500ms, 10s or 1m30s".to_owned())
}

/// A time from zero on.
pub(super) fn from_zero(text: &str) -> Result<Duration, String> {
    parse(text).ok_or_else(|| "a time is meant, as in 0s, 500ms, 10s or 1m30s".to_owned())
}

/// Numbers with their units behind them, the longest unit first and each at most once.
fn parse(text: &str) -> Option<Duration> {
    let mut rest = text;
    let mut units = UNITS.iter();
    let mut time_ns = 0.0;
    loop {
        let unit_at = rest.find(|c: char| c != '.' && !c.is_ascii_digit())?;
        let (number, behind) = rest.split_at(unit_at);
        let end = behind.find(|c: char| !c.is_ascii_alphabetic()).unwrap_or(behind.len());
        let (unit, behind) = behind.split_at(end);
        let (_, unit_ns) = units.by_ref().find(|(name, _)| *name == unit)?;
        time_ns += number.parse::<f64>().ok()? * unit_ns;
        if behind.is_empty() {
            // Longer ones are no time that anybody waits.
            return (time_ns < 1e18).then(|| Duration::from_nanos(time_ns.round() as u64));
        }
        rest = behind;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn times_are_read_or_refused() {
        let check = |text: &str, ms: u64| {
            assert_eq!(from_zero(text), Ok(Duration::from_millis(ms)), "{text}");
        };
        check("10s", 10_000);
        check("1m30s", 90_000);
        check("500ms", 500);
        check("1h2m3s4ms", 3_723_004);
        check("0.25s", 250);
        check("1.5m", 90_000);
        assert_eq!(from_zero("2500us"), Ok(Duration::from_micros(2500)));
        check("0s", 0);
        for text in
            ["", "1", "s", "soon", "-1s", "1 s", "1s1m", "1s1s", "1d", ".s", "1..5s", "9e99s"]
        {
            assert!(from_zero(text).is_err(), "{text}");
        }
        assert!(above_zero("0s").is_err() && above_zero("0m0s").is_err());
    }

    proptest! {
        #[test]
        fn no_text_makes_it_panic(text in ".{0,40}", digits in "[0-9.]{0,400}(h|m|s|ms|us)") {
            let _ = (parse(&text), parse(&digits));
        }
    }
}
