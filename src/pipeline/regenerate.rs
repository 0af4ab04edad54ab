//! Generates a scenario again from its provenance and compares every column.

use super::StageId;
use super::layout::Layout;
use super::stages::{
    FoundShard, LoadedModels, SampleManifest, SampleSettings, SampledWith, checkpoint_file, find_shard, needed_models,
    roll_out, shard_name,
};
use crate::engine::{Failure, Result};
use crate::generate::{Generator, Ledger, ResolvedGeneration, SampleKey, ShardOutput};
use crate::nn::Compute;
use crate::progress::Silent;
use crate::scenario::ScenarioRecord;
use crate::scene::Split;
use crate::store::{CorpusReader, Difference, SceneStore, differences, sample_ids};
use std::path::Path;

/// A scenario as it was stored, and as it was generated again.
#[derive(Debug)]
pub struct Regenerated {
    /// The stored scenario.
    pub stored: ScenarioRecord,
    /// The regenerated scenario.
    pub again: ScenarioRecord,
    /// The columns in which they differ.
    pub differences: Vec<Difference>,
    /// Number of columns compared.
    pub n_columns: usize,
}

/// Generates scenario `id` again, from the samples, scenes and models of `layout`, and compares it with its row there,
/// or with that of `corpus`.
///
/// The batch in which it was denoised is denoised as a whole, because the last digits depend on it; nothing else is.
///
/// # Errors
/// The input's fault when there is no such scenario, or the scenes or a model differ from those it was generated with;
/// the machine's when one of them, or the plan, is missing.
pub fn regenerate(id: &str, layout: &Layout, corpus: Option<&Path>, compute: &Compute) -> Result<Regenerated> {
    let manifest = SampleManifest::read(&layout.samples)?;
    let settings = SampleSettings::read(&layout.samples)?;
    let behaviors = settings.mine.build()?;
    let resolved = settings.generate.resolve(&behaviors)?;
    let store = open_scenes(layout, &manifest.sampled_with)?;
    let models = open_models(layout, &resolved, &manifest.sampled_with, compute)?;
    let from_corpus = corpus.map(|dir| -> Result<ScenarioRecord> {
        let reader = CorpusReader::open(dir)?;
        Ok(reader.scenario(reader.position(id)?)?)
    });
    let from_corpus = from_corpus.transpose()?;
    let id = from_corpus.as_ref().map_or(id, |record| &record.scenario.id);
    let (shard_at, rows) = rows_until(id, &manifest, &layout.samples, &store, from_corpus.as_ref())?;
    let Some(row) = rows.last() else { return Err(unknown(id, &layout.samples)) };

    // The run that sampled a scene knew whether it was held out of its trainings.
    let split = row.scenario.scene.source.split;
    let load = |idx: usize| {
        let mut scene = store.scene(idx)?;
        scene.source.split = if scene.source.split == Split::Unsplit { split } else { scene.source.split };
        Ok(scene)
    };
    let metric_settings = settings.metric_settings.unwrap_or_default();
    let generator = Generator::new(&resolved, models.borrowed(), &behaviors, &load, metric_settings, &compute.device)?;
    let found = find_shard(&layout.samples, row.shard)?;
    let plan = match &found {
        FoundShard::OfSweep(plan) => plan,
        FoundShard::OfRequest { shard, .. } => &shard.plan,
    };
    let wanted = SampleKey::of(plan, &row.scenario.provenance).ok_or_else(|| {
        Failure::fault(anyhow::anyhow!(
            "the plan of shard {} no longer has the cell of scenario {id}; the plan was changed",
            row.shard
        ))
    })?;
    let mut output =
        ShardOutput { records: generator.regenerate(plan, wanted)?.into_iter().collect(), ..Default::default() };
    roll_out(&mut output, &resolved.sweeps[plan.sweep_idx], (&generator, &store), &Silent)?;
    let mut again = output.records.pop().ok_or_else(|| {
        Failure::input_message(format_args!(
            "scenario {id} could not be generated again: its sample is not a valid scenario"
        ))
    })?;
    if let FoundShard::OfRequest { request, round, pool, shard } = &found {
        // Whether a request had room for it depends on all earlier scenarios: those of earlier shards, and the earlier
        // rows of its own.
        let request = &resolved.requests[*request];
        let mut ledger = Ledger::new(request, pool);
        let earlier = manifest.shards[..shard_at].iter().filter_map(|shard| shard.request.as_ref());
        earlier.filter(|tally| tally.request == request.config.name).for_each(|tally| ledger.add(tally));
        let mut records: Vec<ScenarioRecord> = rows[..rows.len() - 1].to_vec();
        records.push(again);
        generator.judge((request, *round), (pool, shard), &ledger, &mut records)?;
        again = records.remove(records.len() - 1);
    }
    let stored = from_corpus.unwrap_or_else(|| row.clone());
    let (differences, n_columns) = differences(&stored, &again)?;
    Ok(Regenerated { stored, again, differences, n_columns })
}

/// The rows of the shard that holds the scenario, up to and including it, and the place of the shard in the manifest.
fn rows_until(
    id: &str,
    manifest: &SampleManifest,
    samples: &Path,
    store: &SceneStore,
    known: Option<&ScenarioRecord>,
) -> Result<(usize, Vec<ScenarioRecord>)> {
    for (at, shard) in manifest.shards.iter().enumerate() {
        let is_elsewhere = known.is_some_and(|known| shard.file != format!("{}.parquet", shard_name(known.shard)));
        if is_elsewhere || !sample_ids(&samples.join(&shard.file))?.iter().any(|own| own == id) {
            continue;
        }
        let mut rows = SampleManifest::read_shard(samples, shard, store)?;
        let own = rows.iter().position(|row| row.scenario.id == id).unwrap_or(0);
        rows.truncate(own + 1);
        return Ok((at, rows));
    }
    Err(unknown(id, samples))
}

fn unknown(id: &str, samples: &Path) -> Failure {
    Failure::input_message(format_args!("scenario {id} is not among the samples of {}", samples.display()))
        .with_hint("ids are in the column scenario_id of samples and corpora; --from names the run folder")
}

fn open_scenes(layout: &Layout, sampled_with: &SampledWith) -> Result<SceneStore> {
    require(&layout.scenes, "scenes")?;
    let store = SceneStore::open_all(&layout.scene_folders())?;
    check("scenes", &layout.scenes, &sampled_with.scenes, store.fingerprint())?;
    Ok(store)
}

/// The models that samples were generated with.
fn open_models(
    layout: &Layout,
    resolved: &ResolvedGeneration,
    sampled_with: &SampledWith,
    compute: &Compute,
) -> Result<LoadedModels> {
    let sweeps = &resolved.sweeps;
    let places: Vec<_> =
        needed_models(sweeps).into_iter().filter_map(|stage| Some((stage, stage.output(layout)?))).collect();
    for (_, (name, path)) in &places {
        require(path, name)?;
        require(&checkpoint_file(path), name)?;
    }
    let models = LoadedModels::read(layout, sweeps, compute)?;
    for (stage, (name, path)) in places {
        let then = match stage {
            StageId::TrainDistill => sampled_with.distilled.as_deref(),
            StageId::TrainClassifier => sampled_with.classifier.as_deref(),
            StageId::TrainBaseline => sampled_with.baseline.as_deref(),
            _ => Some(sampled_with.denoiser.as_str()),
        };
        check(name, path, then.unwrap_or_default(), &models.fingerprint(stage).unwrap_or_default())?;
    }
    Ok(models)
}

/// A missing input is not the scenario's fault.
fn require(path: &Path, name: &str) -> Result<()> {
    if path.exists() {
        return Ok(());
    }
    let error = anyhow::anyhow!("the {name} that generated the scenario is missing: {}", path.display());
    Err(Failure::fault(error).with_hint(format!("pass its path with --{name}")))
}

fn check(name: &str, path: &Path, then: &str, now: &str) -> Result<()> {
    if then == now {
        return Ok(());
    }
    let message = format_args!(
        "the {name} in {} changed since the scenario was generated: its fingerprint was {then}, and is {now}",
        path.display()
    );
    Err(Failure::input_message(message).with_hint(format!("pass the path of the old one with --{name}")))
}
