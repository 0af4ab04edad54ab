//! Finds ids of a recording that may be the same number, such as `7` and `07`.
//!
//! Ids are texts: `07` is kept as written. If there is `7` as well, nobody can tell whether they are the same.

use super::quotes::printable;
use std::collections::BTreeMap;

/// The reason of rejects.
pub(super) const AMBIGUOUS: &str = "ambiguous_id";

/// Each id that is another spelling of an earlier one, after that one.
pub(super) fn ambiguous<'a>(ids: impl Iterator<Item = &'a [u8]>) -> impl Iterator<Item = [&'a [u8]; 2]> {
    let mut numbers: BTreeMap<&[u8], &[u8]> = BTreeMap::new();
    ids.filter_map(move |id| Some([*numbers.entry(number(id)?).or_insert(id), id])).filter(|[first, id]| first != id)
}

/// The detail of a reject for such a pair; `what` names the things, such as `track`.
pub(super) fn in_words(what: &str, pair: [&[u8]; 2]) -> String {
    let [first, id] = pair.map(printable);
    format!("{what} {first} is also written {id}; write each id in one way")
}

/// A whole number without the zeros behind its point, as which programs write it that count in floating-point numbers;
/// any other text unchanged.
pub(super) fn whole_number(text: &str) -> &str {
    let Some((whole, zeros)) = text.split_once('.') else { return text };
    let is_whole =
        !whole.is_empty() && whole.strip_prefix('-').unwrap_or(whole).bytes().all(|byte| byte.is_ascii_digit());
    if is_whole && !zeros.is_empty() && zeros.bytes().all(|byte| byte == b'0') { whole } else { text }
}

/// The digits of an id that is a whole number, without optional ones.
fn number(id: &[u8]) -> Option<&[u8]> {
    let id = id.strip_prefix(b"+").unwrap_or(id);
    let mut parts = id.splitn(2, |byte| *byte == b'.');
    let (whole, rest) = (parts.next()?, parts.next().unwrap_or_default());
    let is_number = !whole.is_empty() && whole.iter().all(u8::is_ascii_digit) && rest.iter().all(|byte| *byte == b'0');
    let n_zeros = whole.iter().take_while(|byte| **byte == b'0').count();
    is_number.then(|| &whole[n_zeros..])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_written_in_one_way() {
        for (one, other) in [("7", "07"), ("007", "07"), ("7", "+7"), ("7", "7.00"), ("0", "00"), ("7.", "7")] {
            let ids = [one, "8", other].map(str::as_bytes);
            let said: Vec<String> = ambiguous(ids.into_iter()).map(|pair| in_words("track", pair)).collect();
            assert_eq!(said, [format!("track {one} is also written {other}; write each id in one way")]);
        }
        for (one, other) in [("7", "70"), ("P7", "P07"), ("7", "7.5"), ("", "0"), ("7", "-7"), ("7", "7")] {
            assert_eq!(ambiguous([one, other].map(str::as_bytes).into_iter()).next(), None, "{one} {other}");
        }
    }
}
