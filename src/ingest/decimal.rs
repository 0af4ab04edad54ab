//! Parses the numbers of tables, with a fast path for short decimals, which nearly all are.

/// Maximum number of digits of whole numbers that are exact as floats.
const MAX_DIGITS: usize = 15;

const POWERS_OF_TEN: [f64; MAX_DIGITS + 1] =
    [1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15];

/// The float nearest to the number in `cell`; `None` if it is not a number. It may be written as infinite or NaN, or
/// overflow.
pub(super) fn number(cell: &[u8]) -> Option<f64> {
    short_decimal(cell).or_else(|| std::str::from_utf8(cell).ok()?.parse().ok())
}

/// The whole number in `cell`, which may be printed as a float such as `12.0`; `None` if it is not a whole number or
/// beyond `i64`.
pub(super) fn whole_number(cell: &[u8]) -> Option<i64> {
    if let Some(whole) = short_whole(cell) {
        return Some(whole);
    }
    // Beyond 2^53 not every whole number is a float.
    let is_exact = |number: &f64| number.fract() == 0.0 && number.abs() < 9e15;
    match number(cell).filter(is_exact) {
        Some(number) => Some(number as i64),
        None => std::str::from_utf8(cell).ok()?.parse().ok(),
    }
}

/// A whole number of at most 15 digits, without a sign.
fn short_whole(cell: &[u8]) -> Option<i64> {
    if cell.is_empty() || cell.len() > MAX_DIGITS {
        return None;
    }
    let mut whole = 0i64;
    for byte in cell {
        let digit = byte.wrapping_sub(b'0');
        if digit > 9 {
            return None;
        }
        whole = whole * 10 + i64::from(digit);
    }
    Some(whole)
}

/// A decimal such as `-12.345` of at most 15 digits. Its digits as a whole number and the power of ten are exact
/// floats, so their quotient is rounded once, to the nearest float (Clinger 1990), as in the standard library.
fn short_decimal(cell: &[u8]) -> Option<f64> {
    let (is_negative, text) = match cell {
        [b'-', text @ ..] => (true, text),
        text => (false, text),
    };
    let (whole, n_decimals) = fifteen_digits(text)?;
    let magnitude = whole as f64 / POWERS_OF_TEN[n_decimals];
    Some(if is_negative { -magnitude } else { magnitude })
}

/// The digits of a decimal as a whole number, and the number of digits after the point.
fn fifteen_digits(text: &[u8]) -> Option<(u64, usize)> {
    // With the point among them, they fit into the whole number in any case.
    if text.len() > MAX_DIGITS + 1 {
        return None;
    }
    let (mut whole, mut point) = (0u64, text.len());
    for (at, byte) in text.iter().enumerate() {
        let digit = byte.wrapping_sub(b'0');
        if digit <= 9 {
            whole = whole * 10 + u64::from(digit);
        } else if *byte == b'.' && point == text.len() {
            point = at;
        } else {
            return None;
        }
    }
    let n_decimals = text.len().saturating_sub(point + 1);
    (1..=MAX_DIGITS).contains(&(point + n_decimals)).then_some((whole, n_decimals))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::seed::Seed;

    #[test]
    fn numbers_are_those_of_the_library_to_the_last_bit() {
        let mut rng = Seed(1).rng();
        for i in 0..20_000 {
            let value = (rng.uniform() - 0.5) * 10f64.powi(i % 9);
            for text in [format!("{value:.3}"), format!("{value:.9}"), format!("{value}"), format!("{value:.0}")] {
                let expected: f64 = text.parse().unwrap();
                assert_eq!(number(text.as_bytes()).unwrap().to_bits(), expected.to_bits(), "{text}");
            }
        }
    }

    #[test]
    fn whatever_the_library_reads_is_read_alike() {
        let texts = "1. 12345678 1234567. .1234567 -.123456 -1234.5678 0 -0 -0.0 7. .5 -.5 1e3 +1.5 1.5E-3 \
            nan inf -Infinity 0.1 000123 123456789012345 1234567890123456 9007199254740993 \
            0.000000000000001 1e400 99999.9999999999";
        for text in texts.split(' ') {
            let expected: f64 = text.parse().unwrap();
            assert_eq!(number(text.as_bytes()).map(f64::to_bits), Some(expected.to_bits()), "{text}");
        }
        let others = "|-|.|-.|1.2.3|1,5|0x10|1 | 1|--1|1-|1.2.|..|1\0|\0|12345/78|1:|-1234567x|\u{ff11}";
        for text in others.split('|') {
            assert!(text.parse::<f64>().is_err() && number(text.as_bytes()).is_none(), "{text}");
        }
        for text in [&b"1\xff"[..], b"\xff.2", b"123\xae567"] {
            assert!(number(text).is_none());
        }
    }

    #[test]
    fn whole_numbers_may_be_printed_as_floats() {
        let exact = [
            ("0", 0),
            ("300", 300),
            ("-3", -3),
            ("12.0", 12),
            ("1e3", 1000),
            ("9007199254740993", 9_007_199_254_740_993),
        ];
        for (text, expected) in
            exact.into_iter().chain([("9223372036854775807", i64::MAX), ("000000000000000000007", 7)])
        {
            assert_eq!(whole_number(text.as_bytes()), Some(expected), "{text}");
        }
        for text in ["", "-", "3.5", "nan", "inf", "1e30", "9223372036854775808", "12a", " 1"] {
            assert_eq!(whole_number(text.as_bytes()), None, "{text}");
        }
    }
}
