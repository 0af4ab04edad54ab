//! Errors of settings: which setting is wrong, what is its value, and what was expected?
//!
//! The range of a single number is an attribute of its field, which becomes part of its JSON schema: it is published,
//! and checked by [`check_ranges`]. Rules that involve several settings are in their sections, which use the helpers
//! here.

mod named;
mod ranges;
#[cfg(test)]
mod tests;

pub(crate) use named::named;
pub use ranges::check_ranges;

use std::fmt::Display;

/// A setting that cannot work.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{key} {message}")]
pub struct Issue {
    /// The path of the setting from the checked section, such as `pairs.max_distance_m` or `strengths.1`.
    pub key: String,
    /// The fault and the expectation, to be read after the key: `is 0, expected 1 to 10000`.
    pub message: String,
}

/// A value that cannot be read from its text. The caller, which knows the key, adds it.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct Unreadable(pub String);

impl<T: Into<String>> From<T> for Unreadable {
    fn from(why: T) -> Self {
        Self(why.into())
    }
}

/// A number as it is written, or with its exponent if it would have many digits.
pub fn in_words(number: f64) -> String {
    if number == 0.0 || (1e-9..1e15).contains(&number.abs()) { number.to_string() } else { format!("{number:e}") }
}

/// The result of checking settings.
pub type Result<T = (), E = Issue> = std::result::Result<T, E>;

impl Issue {
    /// An issue with the setting `key`.
    pub fn new(key: impl Into<String>, message: impl Display) -> Self {
        Self { key: key.into(), message: message.to_string() }
    }

    /// The issue as seen from outside of the section.
    #[must_use]
    pub fn within(self, section: &str) -> Self {
        Self { key: format!("{section}.{}", self.key), ..self }
    }
}

/// Refuses a pair of settings if the second is below the first.
pub fn ascending((low_key, low): (&str, f64), (high_key, high): (&str, f64)) -> Result {
    match low <= high {
        true => Ok(()),
        false => Err(Issue::new(low_key, format_args!("is {low}, expected at most {high_key}, which is {high}"))),
    }
}

/// Refuses a list that has an entry twice.
pub fn distinct<T: PartialEq + Display>(key: &str, entries: &[T]) -> Result {
    match (1..entries.len()).find(|i| entries[..*i].contains(&entries[*i])) {
        Some(i) => Err(Issue::new(format!("{key}.{i}"), format_args!("is {}, which is already listed", entries[i]))),
        None => Ok(()),
    }
}

/// The longest name, bytes: file systems allow 255, some of which endings need.
const MAX_NAME_BYTES: usize = 200;

/// Refuses names that cannot be shown in tables, on pages and on terminals.
///
/// # Errors
/// When it is empty or longer than names of files may be, or holds line breaks or other control characters.
pub fn printable_name(key: &str, name: &str) -> Result {
    match name.len() {
        0 => Err(Issue::new(key, "is empty, expected a name")),
        1..=MAX_NAME_BYTES => printable(key, name),
        n_bytes => Err(Issue::new(key, format_args!("has {n_bytes} bytes, expected at most {MAX_NAME_BYTES}"))),
    }
}

/// Refuses a text with line breaks or other control characters; it may be empty.
pub fn printable(key: &str, text: &str) -> Result {
    match text.chars().find(|c| c.is_control()) {
        Some(c) => {
            let (text, c) = (text.escape_debug(), c.escape_default());
            Err(Issue::new(key, format_args!("is \"{text}\", expected a text without control characters such as {c}")))
        }
        None => Ok(()),
    }
}
