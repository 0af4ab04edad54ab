//! The verdict on a generated scenario: accepted, kept in the corpus, or why not?

use crate::scene::GuidanceLevel;

/// The verdict on one generated scenario.
#[derive(Debug, Clone, PartialEq)]
pub struct VerdictRow {
    /// The scenario.
    pub scenario_id: String,
    /// The sweep that it belongs to.
    pub sweep: String,
    /// The level of its guidance.
    pub level: GuidanceLevel,
    /// Whether it is verified, valid and no near-duplicate.
    pub accepted: bool,
    /// Whether it is in the corpus.
    pub kept: bool,
    /// Why it is not accepted, the first reason first; empty if it is.
    pub reasons: Vec<String>,
    /// Whether the careful driver avoids any contact, and by how much later it could react, seconds; `None` where it
    /// was not judged.
    pub preventable: Option<bool>,
    /// See `preventable`.
    pub careful_margin_s: Option<f64>,
    /// The validity checks that were not made: of motion if the dataset does not allow them, of departures from the
    /// road if the map does not.
    pub not_checked: Vec<String>,
}
