//! Tools for finished corpora: they check, merge and filter them.
//!
//! Every tool reads a corpus from its beginning to its end, a few scenarios at a time, so that memory does not grow
//! with states, but only with hashes of ids. Tools that write make a new folder beside the final one and rename it when
//! it is whole ([`NewFolder`](crate::files::NewFolder)): a folder under its final name is always whole.

mod condition;
mod copy;
mod error;
mod filter;
mod merge;
mod rows;
#[cfg(test)]
mod testing;
#[cfg(test)]
mod tests;
mod validate;

pub use condition::Condition;
pub use copy::CopyOutcome;
pub use error::{Error, Result};
pub use filter::{FilterOptions, Top, filter};
pub use merge::merge;
pub use validate::{Finding, Severity, ValidationReport, validate};
