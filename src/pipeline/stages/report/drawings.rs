//! Which scenarios are drawn, and whose motion is compared?

use super::Report;
use crate::behavior::{BehaviorEvent, EventLabel};
use crate::pipeline::stages::SampleManifest;
use crate::pipeline::{Result, StageId};
use crate::report::{Distribution, Fact, SceneCard, event_distributions, motion_distributions};
use crate::scene::Scene;
use crate::store::{ScenarioRecord, SceneStore, read_events};
use std::collections::BTreeSet;

/// What the report shows of single scenes.
pub(super) struct Gallery {
    pub(super) scenes: Vec<SceneCard>,
    pub(super) distributions: Vec<Distribution>,
}

/// Draws verified scenarios, one of each scene first, and compares motion and events.
pub(super) fn gallery(stage: &Report<'_>, manifest: &SampleManifest) -> Result<Gallery> {
    let store = SceneStore::open(&stage.layout.scenes)?;
    let mut picked = Picked { limit: stage.config.n_compared, ..Picked::default() };
    let mut cards = Vec::new();
    for shard in &manifest.shards {
        let records = SampleManifest::read_shard(&stage.layout.samples, shard, &store)?;
        let mut drawn_scenes = BTreeSet::new();
        for record in &records {
            picked.add(record, &store)?;
            let is_new = record.verified && !record.recorded_event;
            if cards.len() < stage.config.n_drawn && is_new && drawn_scenes.insert(&record.scenario.provenance.scene_id)
            {
                cards.extend(card(record, &records, &store)?);
            }
        }
    }
    let mut distributions = picked.motion();
    if stage.has(StageId::Mine) {
        distributions.extend(picked.events(&read_events(&stage.layout.events)?));
    }
    Ok(Gallery { scenes: cards, distributions })
}

/// A verified scenario beside its recording and, where there is one, the unguided sample from the same noise.
fn card(record: &ScenarioRecord, shard: &[ScenarioRecord], store: &SceneStore) -> Result<Option<SceneCard>> {
    let provenance = &record.scenario.provenance;
    let Some(idx) = store.position(&provenance.scene_id) else { return Ok(None) };
    let recorded = store.scene(idx)?;
    let twin = shard.iter().find(|other| {
        let other = &other.scenario.provenance;
        provenance.guidance.strength != 0.0
            && other.guidance.strength == 0.0
            && other.scene_id == provenance.scene_id
            && other.sample_idx == provenance.sample_idx
            && other.guidance.roles == provenance.guidance.roles
    });
    let mut panels = vec![("recorded", &recorded)];
    panels.extend(twin.map(|twin| ("unguided, same noise", &twin.scenario.scene)));
    let own = if provenance.guidance.strength == 0.0 { "unguided" } else { "guided" };
    panels.push((own, &record.scenario.scene));
    let behavior = record.requested_behavior.as_deref().unwrap_or_default().replace('_', " ");
    let mut facts = vec![
        Fact::new("Scene", &provenance.scene_id),
        Fact::new("Scenario", &record.scenario.id),
        Fact::new("Guidance", format!("{}, strength {}", provenance.guidance.kind, provenance.guidance.strength)),
        Fact::new("Sample", format!("{} of seed {}", provenance.sample_idx, provenance.seed)),
    ];
    if let Some(event) = record.main_event() {
        facts.extend(event.parameters.iter().map(|(name, value)| Fact::new(name.as_str(), format!("{value:.2}"))));
    }
    let title = format!("{behavior} at {}", recorded.source.place);
    Ok(Some(SceneCard::new(record.scenario.id.clone(), title, facts, &panels, &provenance.guidance.roles)))
}

/// Scenes for the comparison of motion.
#[derive(Default)]
struct Picked {
    limit: usize,
    recorded_ids: BTreeSet<String>,
    recorded: Vec<Scene>,
    unguided: Vec<Scene>,
    guided: Vec<Scene>,
    events: Vec<BehaviorEvent>,
    behaviors: BTreeSet<String>,
}

impl Picked {
    fn add(&mut self, record: &ScenarioRecord, store: &SceneStore) -> Result<()> {
        let provenance = &record.scenario.provenance;
        let id = &provenance.scene_id;
        if self.recorded.len() < self.limit && self.recorded_ids.insert(id.0.clone()) {
            if let Some(idx) = store.position(id) {
                self.recorded.push(store.scene(idx)?);
            }
        }
        let is_guided = provenance.guidance.strength != 0.0;
        let group = if is_guided { &mut self.guided } else { &mut self.unguided };
        if group.len() < self.limit {
            group.push(record.scenario.scene.clone());
        }
        self.behaviors.extend(record.requested_behavior.clone());
        if record.verified && !record.recorded_event {
            self.events.extend(record.main_event().cloned());
        }
        Ok(())
    }

    fn motion(&self) -> Vec<Distribution> {
        let (recorded, unguided, guided) = (refs(&self.recorded), refs(&self.unguided), refs(&self.guided));
        let mut groups: Vec<(&str, &[&Scene])> = vec![("recorded", &recorded)];
        for (name, scenes) in [("unguided", &unguided), ("guided", &guided)] {
            if !scenes.is_empty() {
                groups.push((name, scenes));
            }
        }
        motion_distributions(&groups)
    }

    /// Parameters of the recorded events of the behaviors that were asked for, beside those of the new ones.
    fn events(&self, mined: &[BehaviorEvent]) -> Vec<Distribution> {
        let is_asked =
            |event: &&BehaviorEvent| event.label == EventLabel::Positive && self.behaviors.contains(&event.behavior);
        let recorded: Vec<&BehaviorEvent> = mined.iter().filter(is_asked).collect();
        let generated = refs(&self.events);
        if generated.is_empty() {
            return Vec::new();
        }
        event_distributions(&[("recorded events", &recorded), ("generated events", &generated)])
    }
}

fn refs<T>(items: &[T]) -> Vec<&T> {
    items.iter().collect()
}
