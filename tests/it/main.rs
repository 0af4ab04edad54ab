//! The single integration-test binary: one link instead of one per file.

mod architecture;
mod report;
mod schema;
