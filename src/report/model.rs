//! What a report says, as plain data: the page is one rendering of it, JSON another.

use super::card::SceneCard;
use super::distribution::Distribution;
use super::plain::PlainSection;
use crate::behavior::BehaviorEntry;
use crate::generate::RequestSummary;
use crate::ingest::IngestReport;
use crate::metrics::{Direction, MetricSpec};
use crate::store::MetricRow;
use crate::train::NoiseLevelReport;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Everything that a report shows. Parts that a run did not produce are empty and their sections are left out.
///
/// Nothing in here may depend on the clock: a resumed run must give the same page as an undisturbed one.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct ReportModel {
    /// The page's title, such as the pipeline's name.
    pub title: String,
    /// What a reader must know of the run as a whole: name, seed, program version, device.
    pub facts: Vec<Fact>,
    /// What a reader must know before trusting a figure; shown first.
    pub warnings: Vec<Warning>,
    /// What was read from the recordings.
    pub ingest: Option<IngestReport>,
    /// Which behaviors the recordings hold.
    pub mining: Option<MiningSummary>,
    /// How the networks were trained, one entry each.
    pub training: Vec<TrainingSummary>,
    /// How well the classifier tells the behavior at each noise level.
    pub classifier_quality: Vec<NoiseLevelReport>,
    /// What was asked of the sampler and what came out, one row for each sweep and guidance strength.
    pub sampling: Vec<SamplingRow>,
    /// What requests asked for and what they got.
    pub requests: Vec<RequestSummary>,
    /// Metrics of generated scenes with those of the recording and of the baseline beside them.
    pub metrics: MetricTable,
    /// How far the motion of whole sweeps is from that of the recording.
    pub realism: Vec<RealismRow>,
    /// What became of the scenarios of each sweep.
    #[serde(default)]
    pub acceptance: Vec<AcceptanceRow>,
    /// Why samples are not accepted.
    #[serde(default)]
    pub left_out: Vec<LeftOutRow>,
    /// Who fails which check of validity, the recordings too.
    #[serde(default)]
    pub validity: Vec<ValidityRow>,
    /// Distributions of quantities, recorded and generated.
    pub distributions: Vec<Distribution>,
    /// Generated scenes beside their source recording.
    pub scenes: Vec<SceneCard>,
    /// Further parts, which come after the scenes, as plain tables and charts.
    #[serde(default)]
    pub more: Vec<PlainSection>,
    /// The resolved configuration, as TOML.
    pub config: String,
}

/// A name and what it is.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Fact {
    /// What the value is of.
    pub name: String,
    /// The value with its unit.
    pub value: String,
}

impl Fact {
    /// A fact from anything that can be written.
    pub fn new(name: impl Into<String>, value: impl std::fmt::Display) -> Self {
        Self { name: name.into(), value: value.to_string() }
    }
}

/// Something a reader must know before trusting a figure.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Warning {
    /// The stage it is about, such as `ingest`.
    pub stage: String,
    /// One sentence, and what to do about it.
    pub message: String,
}

/// What the miner found in the recordings.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct MiningSummary {
    /// The definition of each mined behavior.
    pub definitions: Vec<BehaviorDoc>,
    /// Counts by behavior, split and place.
    pub counts: Vec<BehaviorCount>,
}

/// The definition of a behavior.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct BehaviorDoc {
    /// Its name, such as `cut_in`.
    pub behavior: String,
    /// When it starts, when it is complete and what does not count.
    pub definition: String,
}

impl From<&BehaviorEntry> for BehaviorDoc {
    fn from(entry: &BehaviorEntry) -> Self {
        Self { behavior: entry.id.to_owned(), definition: entry.description.to_owned() }
    }
}

/// How often a behavior was found in one part of the recordings.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct BehaviorCount {
    /// Its name.
    pub behavior: String,
    /// The split.
    pub split: String,
    /// The place.
    pub place: String,
    /// Scenes searched.
    pub n_scenes: u64,
    /// Scenes with at least one positive event.
    pub n_scenes_with: u64,
    /// Positive events.
    pub n_positive: u64,
    /// Hard negatives.
    pub n_negative: u64,
}

/// How a network was trained.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TrainingSummary {
    /// The network, such as `denoiser`.
    pub name: String,
    /// Parameters, steps, batch size, final loss, …
    pub facts: Vec<Fact>,
    /// Curves over training.
    pub charts: Vec<Chart>,
}

/// Curves over a common axis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Chart {
    /// What is shown.
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
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Curve {
    /// Its name in the legend.
    pub name: String,
    /// (x, y) in drawing order; points that are not finite are left out.
    pub points: Vec<[f64; 2]>,
    /// How sure each of the points is: least and greatest y, drawn as whiskers. Empty where nothing is known of that.
    #[serde(default)]
    pub intervals: Vec<[f64; 2]>,
    /// What is written beside each of the points; empty for nothing.
    #[serde(default)]
    pub labels: Vec<String>,
}

impl Curve {
    /// A plain curve.
    pub fn new(name: impl Into<String>, points: Vec<[f64; 2]>) -> Self {
        Self { name: name.into(), points, intervals: Vec::new(), labels: Vec::new() }
    }
}

/// What one sweep gave at one guidance strength.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SamplingRow {
    /// The sweep's name in the configuration.
    pub sweep: String,
    /// The behavior asked for; `None` where none was.
    pub behavior: Option<String>,
    /// The place of the source scenes; empty for all.
    pub place: String,
    /// Guidance strength α; 0 is unguided.
    pub strength: f64,
    /// The sampler and its steps, such as `heun-20`.
    pub sampler: String,
    /// Source scenes.
    pub n_scenes: u64,
    /// Scenarios sampled.
    pub n_scenarios: u64,
    /// Scenarios in which the miner finds the behavior for the roles asked for.
    pub n_verified: u64,
    /// Verified scenarios whose recording does not hold the behavior for the same roles.
    pub n_new: u64,
    /// Scenarios in which agents collide, as the metric `collision_rate` defines it.
    pub n_collision: u64,
    /// Share of vehicles that leave the road, as the metric `offroad_rate` defines it; `None` without lanes.
    pub offroad_rate: Option<f64>,
    /// Denoiser evaluations of one scenario; the classifier is evaluated as often where it guides.
    pub n_evaluations: u64,
}

/// What became of the scenarios of one sweep at one strength.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct AcceptanceRow {
    /// The sweep.
    pub sweep: String,
    /// Guidance strength α; 0 is unguided.
    pub strength: f64,
    /// Scenarios sampled.
    pub n_scenarios: u64,
    /// In which the miner finds the behavior for the roles asked for.
    pub n_verified: u64,
    /// That pass every check of validity.
    pub n_valid: u64,
    /// That are both.
    pub n_verified_valid: u64,
    /// That are both, and no near-duplicates of accepted ones before.
    pub n_accepted: u64,
    /// That are in the corpus.
    pub n_kept: u64,
}

/// How many samples of a sweep have one reason not to be accepted.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LeftOutRow {
    /// The stage that found it.
    pub stage: String,
    /// The sweep.
    pub sweep: String,
    /// Guidance strength α; `None` where samples of all strengths are counted together.
    pub strength: Option<f64>,
    /// The reason: `not_verified`, `near_duplicate`, the name of a check of validity, …
    pub reason: String,
    /// How many are not in the corpus for this reason before any other.
    pub n_left_out: u64,
    /// How many have it, alone or with others.
    pub n_found: u64,
}

/// How many scenes of a group are valid, and how many fail each check.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct ValidityRow {
    /// `recorded`, `constant_velocity`, `unguided`, or the sweep.
    pub group: String,
    /// The sweep.
    pub sweep: String,
    /// Guidance strength α; 0 is unguided.
    pub strength: f64,
    /// The place; empty for all.
    pub place: String,
    /// Scenes judged.
    pub n: u64,
    /// That pass every check.
    pub n_valid: u64,
    /// Check → how many fail it; those that nobody fails are missing.
    pub violations: BTreeMap<String, u64>,
    /// Mean share of motion within the recorded ranges.
    pub plausibility: Option<f64>,
}

/// How far the distribution of a quantity of motion over a sweep is from that over its recordings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RealismRow {
    /// What is compared with the recording: `constant_velocity`, `unguided`, or the sweep.
    pub group: String,
    /// The sweep.
    pub sweep: String,
    /// Guidance strength α; 0 is unguided.
    pub strength: f64,
    /// The quantity, such as `yaw rate`.
    pub quantity: String,
    /// Its unit.
    pub unit: String,
    /// Number of recorded values.
    pub n_recorded: u64,
    /// Number of values of the group.
    pub n: u64,
    /// Mean of the recorded values.
    pub recorded_mean: Option<f64>,
    /// Mean of the group's values.
    pub mean: Option<f64>,
    /// Wasserstein-1 distance in the quantity's unit.
    pub wasserstein: Option<f64>,
    /// Jensen-Shannon divergence in bits, 0 to 1.
    pub jensen_shannon: Option<f64>,
}

/// Metric values with what is needed to read them.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct MetricTable {
    /// The metrics, in the order of the columns.
    pub docs: Vec<MetricDoc>,
    /// Aggregated rows (those without a scene); rows of single scenes are passed over.
    pub rows: Vec<MetricRow>,
}

/// How to read a metric.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct MetricDoc {
    /// Its name in the tables.
    pub metric: String,
    /// Its unit; `1` for shares and counts.
    pub unit: String,
    /// Which way is better.
    pub direction: Direction,
    /// Its definition.
    pub description: String,
}

impl From<MetricSpec> for MetricDoc {
    fn from(spec: MetricSpec) -> Self {
        Self {
            metric: spec.id.to_owned(),
            unit: spec.unit.to_owned(),
            direction: spec.direction,
            description: spec.description.to_owned(),
        }
    }
}
