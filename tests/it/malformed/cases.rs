//! What a case is.

use super::inputs::Input;

pub(super) struct Case {
    pub(super) name: &'static str,
    pub(super) input: Input,
    pub(super) file: &'static str,
    pub(super) edit: Edit,
    pub(super) then: Then,
    /// Parts of what is said: the file, the place in it, what was expected or what to do.
    pub(super) says: &'static [&'static str],
}

/// A change of a file.
pub(super) enum Edit {
    Whole(&'static str),
    Bytes(&'static [u8]),
    /// To so many percent of its length.
    Cut(usize),
    /// The first of each text.
    Replace(&'static [(&'static str, &'static str)]),
    Made(fn(&[u8]) -> Vec<u8>),
    Gone,
}

/// What happens.
pub(super) enum Then {
    /// The program ends with code 1.
    Ends,
    /// The recording is rejected: the program ends with code 1, and goes on if there is another recording.
    Rejected,
    /// What is wrong is left out and counted.
    GoesOn,
}

pub(super) const fn case(
    name: &'static str,
    (input, file): (Input, &'static str),
    edit: Edit,
    then: Then,
    says: &'static [&'static str],
) -> Case {
    Case { name, input, file, edit, then, says }
}

pub(super) fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

/// The table with its times in milliseconds.
pub(super) fn in_milliseconds(bytes: &[u8]) -> Vec<u8> {
    let line =
        |(i, line): (usize, &str)| line.replacen(&format!("7,{},", (i as f64 - 1.0) / 10.0), &format!("7,{}00,", i), 1);
    text(bytes).split_inclusive('\n').enumerate().map(line).collect::<String>().into_bytes()
}

/// With the last of a text replaced.
pub(super) fn replaced_last(bytes: &[u8], from: &str, to: &str) -> Vec<u8> {
    let text = text(bytes);
    let at = text.rfind(from).unwrap_or_else(|| panic!("{from} is not there"));
    [&text[..at], to, &text[at + from.len()..]].concat().into_bytes()
}
