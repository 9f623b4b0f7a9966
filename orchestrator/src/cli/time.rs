//! How a time is written on the command line: `10s`, `1m30s`, `500ms`, or a number of seconds.

use std::time::Duration;

use jiff::SignedDuration;

/// A time above zero.
pub(super) fn above_zero(text: &str) -> Result<Duration, String> {
    let time = parse(text).filter(|time| !time.is_zero());
    time.ok_or_else(|| "expected a time above zero, as in 500ms, 10s or 1m30s".to_owned())
}

/// A time of zero or more.
pub(super) fn from_zero(text: &str) -> Result<Duration, String> {
    parse(text).ok_or_else(|| "expected a time, as in 0s, 500ms, 10s or 1m30s".to_owned())
}

fn parse(text: &str) -> Option<Duration> {
    match text.parse::<f64>() {
        Ok(seconds) => Duration::try_from_secs_f64(seconds).ok(),
        Err(_) => text.parse::<SignedDuration>().ok()?.try_into().ok(),
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
        check("1m 30s", 90_000);
        check("500ms", 500);
        check("1h2m3s4ms", 3_723_004);
        check("0.25s", 250);
        check("0s", 0);
        check("2.5", 2500);
        assert_eq!(from_zero("2500us"), Ok(Duration::from_micros(2500)));
        for text in [
            "", "s", "soon", "-1s", "-1", "nan", "inf", "1s1m", "1s1s", "1parsec", ".s", "1..5s",
            "9e99s",
        ] {
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
