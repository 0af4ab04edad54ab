//! From the samples to the drawings of the report, and to the motion that is compared.

use super::Report;
use super::choice::{Choice, Chosen};
use super::compared::Compared;
use super::figures_of_scenarios::FiguresOfScenarios;
use crate::pipeline::layout::VERDICTS;
use crate::pipeline::stages::SampleManifest;
use crate::pipeline::{Failure, Result, StageId};
use crate::report::{Acceptance, Distribution, SceneCard};
use crate::scene::{Scene, SceneId};
use crate::store::{ScenarioRecord, SceneStore, read_events, read_verdicts};
use std::collections::BTreeMap;
use std::path::Path;

/// What the report shows of single scenes.
pub(super) struct Gallery {
    pub(super) scenes: Vec<SceneCard>,
    pub(super) distributions: Vec<Distribution>,
}

/// Reads all samples once, shard by shard, draws those that are chosen, and compares motion and events.
pub(super) fn gallery(stage: &Report<'_>, manifest: &SampleManifest) -> Result<Gallery> {
    let store = SceneStore::open(&stage.layout.scenes)?;
    let mut choice = Choice::new(stage.config);
    let mut compared = Compared::new(stage.config.n_compared);
    for shard in &manifest.shards {
        for record in SampleManifest::read_shard(&stage.layout.samples, shard, &store)? {
            let scene_id = &record.scenario.provenance.scene_id;
            if compared.wants_recording(&scene_id.0)
                && let Some(idx) = store.position(scene_id)
            {
                compared.add_recording(&scene_id.0, &store.scene(idx)?);
            }
            compared.add(&record);
            choice.offer(&record);
        }
    }
    let mut distributions = compared.motion();
    if stage.has(StageId::Mine) {
        distributions.extend(compared.events(&read_events(&stage.layout.events, |event| compared.wants_event(event))?));
    }
    let chosen = choice.finish();
    let figures = match stage.has(StageId::Evaluate) {
        true => FiguresOfScenarios::read(&stage.layout.metrics, records(&chosen))?,
        false => FiguresOfScenarios::default(),
    };
    let decisions = match stage.has(StageId::Evaluate) {
        true => decisions(&stage.layout.metrics.with_file_name(VERDICTS), records(&chosen))?,
        false => BTreeMap::new(),
    };
    let mut scenes = Vec::new();
    for chosen in &chosen {
        scenes.extend(card(chosen, &store, &figures, &decisions)?);
    }
    Ok(Gallery { scenes, distributions })
}

fn records(chosen: &[Chosen]) -> impl Iterator<Item = &ScenarioRecord> {
    chosen.iter().flat_map(|chosen| match chosen {
        Chosen::Alone(record) => std::slice::from_ref(record.as_ref()),
        Chosen::Together(records) => records.as_slice(),
    })
}

/// Which of `records` were accepted, and why others were not, by their ids. A folder of an earlier version has no such table.
fn decisions<'a>(
    path: &Path,
    records: impl Iterator<Item = &'a ScenarioRecord>,
) -> Result<BTreeMap<String, Acceptance>> {
    if !path.exists() {
        return Ok(BTreeMap::new());
    }
    let mut reasons: BTreeMap<String, Vec<String>> =
        read_verdicts(path)?.into_iter().map(|row| (row.scenario_id, row.reasons)).collect();
    let of_record = |record: &ScenarioRecord| {
        let (id, reasons) = reasons.remove_entry(&record.scenario.id)?;
        Some((id, Acceptance { reasons }))
    };
    Ok(records.filter_map(of_record).collect())
}

fn card(
    chosen: &Chosen,
    store: &SceneStore,
    figures: &FiguresOfScenarios,
    decisions: &BTreeMap<String, Acceptance>,
) -> Result<Option<SceneCard>> {
    Ok(match chosen {
        Chosen::Alone(record) => {
            let recorded = recording(&record.scenario.provenance.scene_id, store)?;
            let id = &record.scenario.id;
            Some(SceneCard::of_record(record, &recorded, &figures.of(id), decisions.get(id)))
        }
        Chosen::Together(records) => match records.first() {
            Some(first) => {
                let recorded = recording(&first.scenario.provenance.scene_id, store)?;
                let ids: Vec<&str> = records.iter().map(|record| record.scenario.id.as_str()).collect();
                SceneCard::of_samples(records, &recorded, &figures.mean_of(&ids))
            }
            None => None,
        },
    })
}

fn recording(scene_id: &SceneId, store: &SceneStore) -> Result<Scene> {
    let idx = store.position(scene_id).ok_or_else(|| {
        Failure::input_message(format_args!("scene {scene_id} of the samples is not among the scenes"))
            .with_hint("give the scenes that the samples were generated from")
    })?;
    Ok(store.scene(idx)?)
}
