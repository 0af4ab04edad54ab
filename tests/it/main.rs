//! The single integration-test binary: one link instead of one per file.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on fails, and says where")]

mod architecture;
mod batch_tensors;
mod cli;
mod config;
mod corpus;
mod damage;
mod documents;
mod drive;
mod drive_frames;
mod export;
mod fuzz;
mod golden;
mod malformed;
mod mixture;
#[cfg(feature = "cloud")]
mod object_store;
mod parts;
mod pipelines;
mod pytorch;
mod rates;
mod report;
mod requests;
mod safety;
mod schema;
mod settings;
#[cfg(target_os = "linux")]
mod signals;
mod situations;
#[path = "../skipped.rs"]
mod skipped;
mod stages;
mod start;
#[cfg(unix)]
mod submit;
mod support;
