//! The content of a report as plain data, before it becomes a page.

use super::accepted::HardnessSummary;
use super::card::SceneCard;
use super::choice::Drawn;
use super::distribution::Distribution;
use super::plain::{PlainSection, PlainTable};
use crate::coverage::CoverageRow;
use crate::evaluate::{EvaluationSummary, MiningSummary};
use crate::generate::RequestSummary;
use crate::ingest::IngestReport;
use crate::rates::{Calibration, RateRow};
use crate::train::NoiseLevelReport;

/// The content of a report. Parts that a run did not produce are empty, and their sections are left out.
///
/// Nothing in it may depend on the clock: a resumed run must give the same page as an uninterrupted one.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ReportModel {
    /// The page's title, such as the pipeline's name.
    pub title: String,
    /// Facts about the run as a whole: name, seed, program version, device.
    pub facts: Vec<Fact>,
    /// Cautions, which are shown first.
    pub warnings: Vec<Warning>,
    /// The report of the ingest.
    pub ingest: Option<IngestReport>,
    /// How often behaviors were recorded.
    pub rates: Vec<RateRow>,
    /// Recorded and generated parts of the operational design domain.
    pub coverage: Vec<CoverageRow>,
    /// Modeled against recorded rates.
    pub calibration: Vec<Calibration>,
    /// How often behaviors happen in closed loops of the model, where that is as recorded.
    pub modeled: Vec<RateRow>,
    /// The mined behaviors.
    pub mining: Option<MiningSummary>,
    /// The training of each network.
    pub training: Vec<TrainingSummary>,
    /// The quality of the classifier at each noise level.
    pub classifier_quality: Vec<NoiseLevelReport>,
    /// The requests and their results.
    pub requests: Vec<RequestSummary>,
    /// The tables of the evaluation.
    pub evaluation: EvaluationSummary,
    /// Distributions of quantities, recorded and generated.
    pub distributions: Vec<Distribution>,
    /// Generated scenes beside their source recording.
    pub scenes: Vec<SceneCard>,
    /// Number of recorded scenes that are continued.
    pub n_continued: usize,
    /// How hard the accepted scenarios are; `None` if acceptance was not decided.
    pub hardness: Option<HardnessSummary>,
    /// How much of each sweep is drawn.
    pub drawn: Vec<Drawn>,
    /// Further parts, which come after the scenes, as plain tables and charts.
    pub more: Vec<PlainSection>,
    /// The resolved configuration, as TOML.
    pub config: String,
}

/// A name and its value.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Fact {
    /// The name.
    pub name: String,
    /// The value with its unit.
    pub value: String,
}

impl Fact {
    /// A fact whose value is anything that can be displayed.
    pub fn new(name: impl Into<String>, value: impl std::fmt::Display) -> Self {
        Self { name: name.into(), value: value.to_string() }
    }
}

/// A caution that a reader must see before trusting a figure.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Warning {
    /// The stage, such as `ingest`.
    pub stage: String,
    /// One sentence, and what to do about it.
    pub message: String,
}

/// The training of a network.
#[derive(Debug, Clone, PartialEq)]
pub struct TrainingSummary {
    /// The network, such as `denoiser`.
    pub name: String,
    /// Parameters, steps, batch size, final loss, …
    pub facts: Vec<Fact>,
    /// Curves over training.
    pub charts: Vec<Chart>,
    /// Its final evaluation.
    pub tables: Vec<PlainTable>,
}

/// Curves over a common axis.
#[derive(Debug, Clone, PartialEq)]
pub struct Chart {
    /// The title.
    pub title: String,
    /// The horizontal quantity with its unit.
    pub x_label: String,
    /// The vertical quantity with its unit.
    pub y_label: String,
    /// Whether the horizontal axis is logarithmic.
    pub log_x: bool,
    /// The curves.
    pub curves: Vec<Curve>,
}

/// One curve.
#[derive(Debug, Clone, PartialEq)]
pub struct Curve {
    /// Its name in the legend.
    pub name: String,
    /// (x, y) in drawing order; points that are not finite are left out.
    pub points: Vec<[f64; 2]>,
    /// The interval of each point: least and greatest y, drawn as whiskers; empty if unknown.
    pub intervals: Vec<[f64; 2]>,
}

impl Curve {
    /// A plain curve.
    pub fn new(name: impl Into<String>, points: Vec<[f64; 2]>) -> Self {
        Self { name: name.into(), points, intervals: Vec::new() }
    }
}
