//! Synthesis of rare-event traffic scenarios: from recordings to a checked corpus.
//!
//! Modules in reading order; each may use only those above it (ARCHITECTURE.md, enforced by
//! `tests/it/architecture.rs`).

pub mod containment;
pub mod files;
pub mod geometry;
pub mod progress;
pub mod quantile;
pub mod seed;
pub mod settings;
pub mod statistics;

pub mod cloud;
pub mod scene;

pub mod behavior;
pub mod ingest;
pub mod metrics;
pub mod rates;

pub mod coverage;
pub mod diffusion;
pub mod nn;
pub mod scenario;
pub mod tensor;

pub mod model;
pub mod store;

pub mod corpus;
pub mod guidance;

pub mod generate;
pub mod train;

pub mod simulate;

pub mod evaluate;

pub mod export;
pub mod report;

pub mod drive;
pub mod engine;

pub mod pipeline;

pub mod cli;
