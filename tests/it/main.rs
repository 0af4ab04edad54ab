//! The single integration-test binary: one link instead of one per file.

mod architecture;
mod documents;
mod report;
mod schema;
