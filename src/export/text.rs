//! Numbers and names in text formats.

/// A number with nine decimals, without trailing zeros. Values that readers compute from several numbers, such as the
/// center of a vehicle from its rear axle, heading and length, are then within a micrometer of the corpus.
pub(super) fn number(value: f64) -> String {
    let text = format!("{value:.9}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".to_owned() } else { text.to_owned() }
}

/// The text with everything but ASCII letters, digits, `-`, `_` and `.` replaced by `_`, so that it can name a file.
pub(super) fn plain(text: &str) -> String {
    text.chars().map(|c| if c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.') { c } else { '_' }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_short_and_never_negative_zero() {
        for (value, text) in [
            (0.0, "0"),
            (-0.0, "0"),
            (-1e-10, "0"),
            (12.5, "12.5"),
            (100.0, "100"),
            (-0.123_456_789_6, "-0.12345679"),
            (3.0e15, "3000000000000000"),
        ] {
            assert_eq!(number(value), text);
        }
    }

    #[test]
    fn names_hold_no_separators() {
        assert_eq!(plain("argoverse1/train/PIT 1#0.a-b"), "argoverse1_train_PIT_1_0.a-b");
    }
}
