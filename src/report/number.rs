//! Numbers for people: short, with separated thousands, and never `NaN` or `-0`.

use crate::scene::GuidanceLevel;

/// The text for a missing number.
pub(super) const ABSENT: &str = "–";

/// A whole number with separated thousands.
pub(super) fn count(n: u64) -> String {
    let digits = n.to_string();
    let mut text = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            text.push('\u{202f}');
        }
        text.push(digit);
    }
    text
}

/// A measured value with three significant digits.
pub(super) fn value(value: f64) -> String {
    if !value.is_finite() {
        return ABSENT.to_owned();
    }
    let magnitude = value.abs();
    let text = if magnitude >= 999.5 {
        count(magnitude.round() as u64)
    } else if magnitude == 0.0 {
        "0".to_owned()
    } else if magnitude < 9.995e-4 {
        format!("{magnitude:.1e}")
    } else {
        // The exponent of the last of three significant digits, after rounding.
        let rounded: f64 = format!("{magnitude:.2e}").parse().unwrap_or(magnitude);
        let decimals = (2.0 - rounded.log10().floor()).clamp(0.0, 6.0) as usize;
        format!("{magnitude:.decimals$}")
    };
    if value < 0.0 && magnitude > 0.0 { format!("−{text}") } else { text }
}

/// A number of a configuration, as written there.
pub(super) fn setting(value: f64) -> String {
    if value.is_finite() { value.to_string().replace('-', "−") } else { ABSENT.to_owned() }
}

/// A guidance level in a column of strengths α: the bare number if only the strength varies.
pub(super) fn level(level: GuidanceLevel) -> String {
    match level.weight {
        0.0 => setting(level.strength),
        _ => level.to_string().replace('-', "−"),
    }
}

/// The uncertainty of a value: two significant digits.
pub(super) fn uncertainty(error: f64) -> String {
    if !error.is_finite() || error == 0.0 || !(9.95e-4..99.5).contains(&error) {
        return value(error);
    }
    let decimals = (1.0 - error.log10().floor()).clamp(0.0, 6.0) as usize;
    format!("{error:.decimals$}")
}

/// A value if there is one.
pub(super) fn optional(number: Option<f64>) -> String {
    number.map_or_else(|| ABSENT.to_owned(), value)
}

/// A share as a percentage.
pub(super) fn percent(share: f64) -> String {
    if share.is_finite() { format!("{:.1}\u{202f}%", 100.0 * share) } else { ABSENT.to_owned() }
}

/// A share counted as `n_hits` of `n`.
pub(super) fn share(n_hits: u64, n: u64) -> String {
    if n == 0 { ABSENT.to_owned() } else { percent(n_hits as f64 / n as f64) }
}

/// The label of an axis tick: no more digits than the step needs.
pub(super) fn tick(value: f64, step: f64) -> String {
    if value != 0.0 && (value.abs() >= 1e6 || value.abs() < 1e-4) {
        return format!("{value:.0e}");
    }
    let decimals = (-step.abs().log10().floor()).clamp(0.0, 6.0) as usize;
    let text = format!("{:.decimals$}", value.abs());
    if value < 0.0 && text.bytes().any(|b| b.is_ascii_digit() && b != b'0') { format!("−{text}") } else { text }
}

/// A coordinate in a drawing, to a hundredth and as short as possible.
pub(super) fn coordinate(value: f64) -> String {
    let hundredths = (value * 100.0).round();
    if hundredths == 0.0 || !hundredths.is_finite() { "0".to_owned() } else { format!("{}", hundredths / 100.0) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_have_three_significant_digits() {
        let written: Vec<String> =
            [0.0, 0.4567, 0.999_6, 9.996, 12.345, 123.4, 999.4, 999.6, 12345.6, -1.5, 0.00012, f64::NAN]
                .map(value)
                .into();
        let expected = "0 0.457 1.00 10.0 12.3 123 999 1\u{202f}000 12\u{202f}346 −1.50 1.2e-4 –";
        assert_eq!(written.join(" "), expected);
    }

    #[test]
    fn counts_and_shares() {
        let found = (count(7), count(1000), count(1_234_567));
        assert_eq!(found, ("7".into(), "1\u{202f}000".into(), "1\u{202f}234\u{202f}567".into()));
        let seen = (uncertainty(0.0358), uncertainty(1.26), uncertainty(0.0));
        assert_eq!(seen, ("0.036".into(), "1.3".into(), "0".into()));
        assert_eq!((setting(2.0), setting(0.25), setting(-1.5)), ("2".into(), "0.25".into(), "−1.5".into()));
        assert_eq!((share(1, 8), share(1, 0)), ("12.5\u{202f}%".into(), ABSENT.into()));
    }

    #[test]
    fn ticks_and_coordinates_are_short() {
        assert_eq!((tick(0.2, 0.1), tick(20.0, 10.0), tick(-0.5, 0.5)), ("0.2".into(), "20".into(), "−0.5".into()));
        assert_eq!((tick(-0.0, 0.5), tick(1e-5, 1e-5)), ("0.0".into(), "1e-5".into()));
        let found = (coordinate(-0.001), coordinate(1.239), coordinate(-3.5));
        assert_eq!(found, ("0".into(), "1.24".into(), "-3.5".into()));
    }
}
