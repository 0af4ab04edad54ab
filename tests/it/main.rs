//! The single integration-test binary: one link instead of one per file.

mod architecture;
mod cli;
mod config;
mod determinism;
mod documents;
mod report;
mod schema;
mod stages;
mod support;
