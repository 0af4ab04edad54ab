//! Chooses the scenes to draw, and collects motion and events to compare, from all samples of a run one by one.

use super::accepted::{Accepted, HardnessSummary};
use super::beside_recordings::BesideRecordings;
use super::card::{Acceptance, SceneCard};
use super::choice::{Choice, Chosen, Drawn};
use super::config::ReportConfig;
use super::distribution::Distribution;
use super::figures_of_scenarios::FiguresOfScenarios;
use crate::behavior::BehaviorEvent;
use crate::evaluate::{Error, Result};
use crate::metrics::MetricRow;
use crate::scenario::{ScenarioRecord, VerdictRow};
use crate::scene::{Scene, SceneId, TrackId};
use crate::store::{self, SceneSet, SceneStore};
use std::collections::{BTreeMap, BTreeSet};

/// Recorded scenes, and scenarios of each kind, whose motion is compared.
const N_COMPARED: usize = 300;

/// The report's part on single scenes.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Drawings {
    /// The drawn scenes.
    pub scenes: Vec<SceneCard>,
    /// How much of each sweep is drawn.
    pub drawn: Vec<Drawn>,
    /// Number of recorded scenes that are continued.
    pub n_continued: usize,
    /// How hard the accepted scenarios are; `None` if acceptance was not decided.
    pub hardness: Option<HardnessSummary>,
    /// Motion and events, recorded and generated.
    pub distributions: Vec<Distribution>,
}

/// Keeps a choice of the samples of a run, bounded by the configuration.
pub struct Gallery<'a> {
    store: &'a SceneStore,
    choice: Choice<'a>,
    compared: BesideRecordings,
    accepted: Option<&'a Accepted>,
    continued: SceneSet,
    /// The scenes of accepted scenarios, by their positions, and the tracks of their events.
    situations: BTreeSet<(usize, Vec<TrackId>)>,
}

impl<'a> Gallery<'a> {
    /// An empty gallery for samples that continue scenes of `store`. `accepted` is `None` if acceptance was not
    /// decided.
    pub fn new(config: &'a ReportConfig, store: &'a SceneStore, accepted: Option<&'a Accepted>) -> Self {
        Self {
            store,
            choice: Choice::new(config, accepted),
            compared: BesideRecordings::new(N_COMPARED),
            accepted,
            continued: SceneSet::default(),
            situations: BTreeSet::new(),
        }
    }

    /// Offers the next scenario, in the order of the samples.
    pub fn offer(&mut self, record: &ScenarioRecord) -> Result<()> {
        let scene_id = &record.scenario.provenance.scene_id;
        let idx = self.store.position(scene_id).ok_or_else(|| Error::UnknownScene(scene_id.clone()))?;
        if self.compared.wants_recording(idx) {
            self.compared.add_recording(idx, &self.store.scene(idx)?);
        }
        self.compared.add(record);
        self.choice.offer(record, idx);
        self.continued.insert(idx);
        if self.accepted.is_some_and(|accepted| accepted.min_ttc_s(&record.scenario.id).is_some()) {
            let event = record.main_event();
            let tracks = event.map(|event| event.roles.tracks().cloned().collect());
            self.situations.insert((idx, tracks.unwrap_or_default()));
        }
        Ok(())
    }

    /// Draws the chosen scenarios with their `metrics` and `verdicts`, which may be empty. Events are compared with the
    /// `recorded` ones, if there are any.
    ///
    /// # Errors
    /// When a recording is missing or cannot be read; errors of the tables.
    pub fn finish(
        self,
        recorded: Option<impl Iterator<Item = store::Result<BehaviorEvent>>>,
        metrics: impl Iterator<Item = store::Result<MetricRow>>,
        verdicts: impl Iterator<Item = store::Result<VerdictRow>>,
    ) -> Result<Drawings> {
        let Self { store, choice, compared, accepted, continued, situations } = self;
        let mut distributions = compared.motion();
        if let Some(recorded) = recorded {
            distributions.extend(compared.events(recorded)?);
        }
        let drawn = choice.drawn();
        let chosen = choice.finish();
        let figures = FiguresOfScenarios::new(metrics, records(&chosen))?;
        let decisions = decisions(verdicts, records(&chosen))?;
        let mut scenes = Vec::new();
        for chosen in &chosen {
            scenes.extend(card(chosen, store, &figures, &decisions)?);
        }
        // Accepted ones first, across all sweeps, the hardest first.
        scenes.sort_by(|a, b| a.key.rank_s().total_cmp(&b.key.rank_s()));
        let hardness = accepted.map(|accepted| accepted.summary(situations.len()));
        Ok(Drawings { scenes, drawn, n_continued: continued.len(), hardness, distributions })
    }
}

fn records(chosen: &[Chosen]) -> impl Iterator<Item = &ScenarioRecord> {
    chosen.iter().flat_map(|chosen| match chosen {
        Chosen::Alone(record) => std::slice::from_ref(record.as_ref()),
        Chosen::Together(records) => records.as_slice(),
    })
}

/// Whether each of `records` was accepted, and why not, by id.
fn decisions<'r>(
    verdicts: impl Iterator<Item = store::Result<VerdictRow>>,
    records: impl Iterator<Item = &'r ScenarioRecord>,
) -> Result<BTreeMap<String, Acceptance>> {
    let ids: BTreeSet<&str> = records.map(|record| record.scenario.id.as_str()).collect();
    let of_record = |row: VerdictRow| {
        let is_shown = ids.contains(row.scenario_id.as_str());
        is_shown.then_some((row.scenario_id, Acceptance { reasons: row.reasons }))
    };
    Ok(verdicts.filter_map(|row| row.map(of_record).transpose()).collect::<store::Result<_>>()?)
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
    let idx = store.position(scene_id).ok_or_else(|| Error::UnknownScene(scene_id.clone()))?;
    Ok(store.scene(idx)?)
}
