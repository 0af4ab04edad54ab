//! What number is written in a cell of a table? Nearly all are short decimals, for which the way through text is the longest part.

/// Digits of a whole number that every float of the same size holds exactly.
const MAX_DIGITS: usize = 15;

const POWERS_OF_TEN: [f64; MAX_DIGITS + 1] =
    [1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15];

/// The float nearest to the number in `cell`; `None` where it holds none. Not finite where it is written so, or too large.
pub(super) fn number(cell: &[u8]) -> Option<f64> {
    short_decimal(cell).or_else(|| std::str::from_utf8(cell).ok()?.parse().ok())
}

/// A decimal such as `-12.345` of at most 15 digits. Its digits as a whole number and the power of ten are floats without error, and so the
/// one rounding of their quotient gives the nearest float (Clinger 1990), which is what the library gives.
fn short_decimal(cell: &[u8]) -> Option<f64> {
    let (is_negative, digits) = match cell {
        [b'-', digits @ ..] => (true, digits),
        digits => (false, digits),
    };
    let (mut whole, mut n_digits, mut n_decimals, mut has_point) = (0u64, 0, 0, false);
    for byte in digits {
        match byte {
            b'0'..=b'9' if n_digits < MAX_DIGITS => {
                whole = whole * 10 + u64::from(byte - b'0');
                n_digits += 1;
                n_decimals += usize::from(has_point);
            }
            b'.' if !has_point => has_point = true,
            _ => return None,
        }
    }
    if n_digits == 0 {
        return None;
    }
    let magnitude = whole as f64 / POWERS_OF_TEN[n_decimals];
    Some(if is_negative { -magnitude } else { magnitude })
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
        let texts = [
            "0",
            "-0",
            "-0.0",
            "7.",
            ".5",
            "-.5",
            "1e3",
            "+1.5",
            "1.5E-3",
            "nan",
            "inf",
            "-Infinity",
            "0.1",
            "000123",
            "123456789012345",
            "1234567890123456",
            "9007199254740993",
            "0.000000000000001",
            "1e400",
            "99999.9999999999",
        ];
        for text in texts {
            let expected: f64 = text.parse().unwrap();
            assert_eq!(number(text.as_bytes()).map(f64::to_bits), Some(expected.to_bits()), "{text}");
        }
        for text in ["", "-", ".", "-.", "1.2.3", "1,5", "0x10", "1 ", " 1", "--1", "1-", "\u{ff11}"] {
            assert!(text.parse::<f64>().is_err() && number(text.as_bytes()).is_none(), "{text}");
        }
        assert!(number(b"1\xff").is_none());
    }
}
