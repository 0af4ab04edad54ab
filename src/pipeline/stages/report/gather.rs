//! Gathers the content of the report from the files of each stage.

use super::Report;
use super::drawings::drawings;
use crate::engine::{Classify, Result};
use crate::evaluate::{EvaluationSummary, MapFitRow};
use crate::generate::RequestSummary;
use crate::ingest::IngestReport;
use crate::model::{DenoiserSpec, TrainedDenoiser, TrainedSceneTransformer};
use crate::nn::Compute;
use crate::pipeline::StageId;
use crate::pipeline::layout::{COVERAGE, METRICS_SUMMARY, MINE_SUMMARY, MODELED_RATES, MODELED_SUMMARY, RATES};
use crate::pipeline::stages::{ModeledSummary, SampleManifest, checkpoint_file, read_requests};
use crate::report::{Drawings, Fact, ReportModel, TrainingSummary, Warning, cautions};
use crate::store::{CorpusManifest, SceneManifest, read_json, read_table};
use crate::train::{ClassifierReport, FitStatistics, map_warnings};
use std::path::Path;

/// Everything that the report shows.
pub(super) fn model(stage: &Report<'_>) -> Result<ReportModel> {
    let about = &stage.about;
    let mut model = ReportModel {
        title: about.pipeline.clone(),
        facts: vec![
            Fact::new("Pipeline", &about.pipeline),
            Fact::new("Seed", about.seed),
            Fact::new("Written by", format!("djinn {}", env!("CARGO_PKG_VERSION"))),
            Fact::new("Computed on", &about.device),
        ],
        config: about.config.clone(),
        ..ReportModel::default()
    };
    if stage.has(StageId::Ingest) {
        add_ingest(&mut model, &stage.layout.scenes)?;
    }
    if stage.has(StageId::Mine) {
        model.mining = Some(read_json(&stage.layout.events.with_file_name(MINE_SUMMARY)).blame_input()?);
        // Events alone may come from elsewhere.
        let rates = stage.layout.events.with_file_name(RATES);
        model.rates = if rates.exists() { read_table(&rates)? } else { Vec::new() };
    }
    if stage.has(StageId::Rates) {
        let path = |name: &str| stage.layout.modeled.with_file_name(name);
        let summary: ModeledSummary = read_json(&path(MODELED_SUMMARY)).blame_input()?;
        (model.calibration, model.modeled) = (summary.calibration, read_table(&path(MODELED_RATES))?);
    }
    if stage.has(StageId::TrainDenoiser) {
        add_denoiser(&mut model, &stage.layout.denoiser)?;
    }
    if stage.has(StageId::TrainClassifier) {
        add_classifier(&mut model, &stage.layout.classifier)?;
    }
    if stage.has(StageId::TrainDistill) {
        model.training.push(denoiser("distilled denoiser", &stage.layout.distilled)?.0);
    }
    if stage.has(StageId::TrainBaseline) {
        model.training.push(baseline(&stage.layout.baseline)?);
    }
    if stage.has(StageId::Evaluate) {
        let path = stage.layout.metrics.with_file_name(METRICS_SUMMARY);
        add_evaluation(&mut model, read_json(&path).blame_input()?);
        let coverage = stage.layout.metrics.with_file_name(COVERAGE);
        model.coverage = if coverage.exists() { read_table(&coverage)? } else { Vec::new() };
        let sources = CorpusManifest::read(&stage.layout.corpus)?.sources;
        model.facts.extend(sources.iter().map(|(dataset, terms)| Fact::new(format!("Terms of {dataset}"), terms)));
    }
    if stage.has(StageId::Generate) {
        add_samples(&mut model, stage)?;
    }
    Ok(model)
}

fn add_ingest(model: &mut ReportModel, scenes: &Path) -> Result<()> {
    let manifest = SceneManifest::read(scenes)?;
    let report: IngestReport = serde_json::from_value(manifest.report).map_err(anyhow::Error::from)?;
    if report.n_rejects() > 0 {
        let message =
            format!("{} recordings or scenes were rejected; the reasons are listed below.", report.n_rejects());
        model.warnings.push(warning(StageId::Ingest, message));
    }
    model.warnings.extend(report.warnings().map(|message| warning(StageId::Ingest, message)));
    model.ingest = Some(report);
    Ok(())
}

fn add_denoiser(model: &mut ReportModel, dir: &Path) -> Result<()> {
    let (summary, spec) = denoiser("denoiser", dir)?;
    let warnings = map_warnings(&spec.changed_losses).into_iter();
    model.warnings.extend(warnings.map(|message| warning(StageId::TrainDenoiser, message)));
    model.training.push(summary.with_losses(&spec.changed_losses, &spec.losses_by_place));
    Ok(())
}

fn denoiser(name: &str, dir: &Path) -> Result<(TrainingSummary, DenoiserSpec)> {
    let TrainedDenoiser { spec, fingerprint, .. } = TrainedDenoiser::read(&checkpoint_file(dir), &Compute::cpu())?;
    let statistics = fit_statistics(dir)?;
    let mut facts = vec![
        Fact::new("Layers", &spec.network.layers),
        Fact::new("Width", spec.network.width),
        Fact::new("State", spec.normalizer.parametrization.name()),
        Fact::new("Timesteps", format!("{} + {}", spec.n_history, spec.n_timesteps - spec.n_history)),
        Fact::new("Steps", spec.steps),
        Fact::new("Fingerprint", fingerprint),
    ];
    let objectives: Vec<&str> = spec.objectives.iter().filter_map(|objective| objective["kind"].as_str()).collect();
    if !objectives.is_empty() {
        facts.push(Fact::new("Trained toward", objectives.join(", ")));
    }
    Ok((TrainingSummary::of_fit(name, facts, &statistics), spec))
}

fn baseline(dir: &Path) -> Result<TrainingSummary> {
    let TrainedSceneTransformer { spec, fingerprint, .. } =
        TrainedSceneTransformer::read(&checkpoint_file(dir), &Compute::cpu())?;
    let facts = vec![
        Fact::new("Layers", format!("{} + {}", spec.network.encoder, spec.network.decoder)),
        Fact::new("Width", spec.network.width),
        Fact::new("Joint futures", spec.network.n_modes),
        Fact::new("State", spec.normalizer.parametrization.name()),
        Fact::new("Timesteps", format!("{} + {}", spec.n_history, spec.n_timesteps - spec.n_history)),
        Fact::new("Steps", spec.steps),
        Fact::new("Fingerprint", fingerprint),
    ];
    Ok(TrainingSummary::of_fit("baseline (Scene Transformer)", facts, &fit_statistics(dir)?))
}

/// The statistics of a training run; empty for a checkpoint that was used instead of training.
fn fit_statistics(dir: &Path) -> Result<Vec<FitStatistics>> {
    let path = dir.join("statistics.jsonl");
    let text = if path.exists() { fs_err::read_to_string(path)? } else { String::new() };
    let lines = text.lines().map(serde_json::from_str::<FitStatistics>);
    Ok(lines.collect::<std::result::Result<Vec<_>, _>>().map_err(anyhow::Error::from)?)
}

fn add_classifier(model: &mut ReportModel, dir: &Path) -> Result<()> {
    let path = dir.join("classifier.json");
    // A checkpoint that was used instead of training has no report.
    if !path.exists() {
        return Ok(());
    }
    let report: ClassifierReport = read_json(&path).blame_input()?;
    let name = format!("classifier of {}", report.spec.behavior);
    let facts = vec![
        Fact::new("Parameters", report.n_parameters),
        Fact::new("Positive pairs", report.spec.n_positive),
        Fact::new("Hard negative pairs", report.spec.n_negative),
        Fact::new("Steps", report.spec.steps),
        Fact::new("Fingerprint", &report.fingerprint),
    ];
    model.training.push(TrainingSummary::of_fit(name, facts, &report.statistics));
    model.classifier_quality = report.by_noise_level;
    Ok(())
}

fn add_evaluation(model: &mut ReportModel, summary: EvaluationSummary) {
    let missed = summary.gates.iter().filter(|gate| !gate.met);
    model.warnings.extend(
        missed.map(|gate| warning(StageId::Evaluate, format!("Gate not met: {} ({}).", gate.gate, gate.detail))),
    );
    model.warnings.extend(
        cautions(&summary.aggregates, &summary.sampling).into_iter().map(|message| warning(StageId::Evaluate, message)),
    );
    let of_maps = summary.maps.iter().filter_map(MapFitRow::caution);
    model.warnings.extend(of_maps.map(|message| warning(StageId::Evaluate, message)));
    model.evaluation = summary;
}

fn add_samples(model: &mut ReportModel, stage: &Report<'_>) -> Result<()> {
    let manifest = SampleManifest::read(&stage.layout.samples)?;
    for shortfall in &manifest.sampled_with.shortfalls {
        let message = format!(
            "Sweep {} continues {} of {} requested scenes; no others are suitable.",
            shortfall.sweep, shortfall.n_found, shortfall.n_wanted
        );
        model.warnings.push(warning(StageId::Generate, message));
    }
    let learned = manifest.sampled_with.caution();
    model.warnings.extend(learned.map(|message| warning(StageId::Generate, message)));
    if manifest.n_rejected > 0 {
        let message = format!("{} samples had non-finite values and were rejected.", manifest.n_rejected);
        model.warnings.push(warning(StageId::Generate, message));
    }
    model.requests = read_requests(&stage.layout.samples)?;
    model
        .warnings
        .extend(model.requests.iter().filter_map(short_buckets).map(|message| warning(StageId::Generate, message)));
    let Drawings { scenes, drawn, n_continued, hardness, distributions } = drawings(stage, &manifest)?;
    (model.n_continued, model.hardness) = (n_continued, hardness);
    (model.scenes, model.drawn) = (scenes, drawn);
    model.distributions = distributions;
    Ok(())
}

/// A caution about buckets that did not fill.
fn short_buckets(request: &RequestSummary) -> Option<String> {
    let n_short = request.short().count();
    (n_short > 0).then(|| {
        format!(
            "Request {} stayed short in {n_short} of {} buckets: {} of {} scenarios were accepted before it ended.",
            request.name,
            request.buckets.len(),
            request.n_accepted,
            request.n_wanted
        )
    })
}

fn warning(stage: StageId, message: String) -> Warning {
    Warning { stage: stage.name().to_owned(), message }
}
