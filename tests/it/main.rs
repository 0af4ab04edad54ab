//! The single integration-test binary: one link instead of one per file.

mod schema;
