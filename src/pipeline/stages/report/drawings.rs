//! Which scenarios are drawn, and whose motion is compared?

use super::Report;
use crate::behavior::{BehaviorEvent, EventLabel};
use crate::pipeline::stages::SampleManifest;
use crate::pipeline::{Result, StageId};
use crate::report::{Distribution, MotionDistributions, SceneCard, event_distributions};
use crate::store::{ScenarioRecord, SceneStore, read_events};
use std::collections::{BTreeMap, BTreeSet};

/// What the report shows of single scenes.
pub(super) struct Gallery {
    pub(super) scenes: Vec<SceneCard>,
    pub(super) distributions: Vec<Distribution>,
}

/// Draws new verified scenarios, at most one of each scene, and compares motion and events.
pub(super) fn gallery(stage: &Report<'_>, manifest: &SampleManifest) -> Result<Gallery> {
    let store = SceneStore::open(&stage.layout.scenes)?;
    let mut cards = Vec::new();
    let mut drawn = BTreeSet::new();
    let mut compared = Compared::new(stage.config.n_compared);
    for shard in &manifest.shards {
        for record in SampleManifest::read_shard(&stage.layout.samples, shard, &store)? {
            let scene_id = &record.scenario.provenance.scene_id;
            let Some(idx) = store.position(scene_id) else { continue };
            let is_new = record.verified && !record.recorded_event;
            let is_drawn = is_new && cards.len() < stage.config.n_drawn && drawn.insert(scene_id.clone());
            if is_drawn || compared.wants_recording(&scene_id.0) {
                let recorded = store.scene(idx)?;
                if is_drawn {
                    cards.push(SceneCard::of_record(&record, &recorded));
                }
                compared.add_recording(&scene_id.0, &recorded);
            }
            compared.add(&record);
        }
    }
    let mut distributions = compared.motion.finish();
    if stage.has(StageId::Mine) {
        distributions.extend(compared.events(&read_events(&stage.layout.events)?));
    }
    Ok(Gallery { scenes: cards, distributions })
}

/// Collects what is compared: at most `limit` scenes of each group.
struct Compared {
    limit: usize,
    recorded_ids: BTreeSet<String>,
    n_generated: BTreeMap<&'static str, usize>,
    motion: MotionDistributions,
    events: Vec<BehaviorEvent>,
    behaviors: BTreeSet<String>,
}

impl Compared {
    fn new(limit: usize) -> Self {
        Self {
            limit,
            recorded_ids: BTreeSet::new(),
            n_generated: BTreeMap::new(),
            motion: MotionDistributions::default(),
            events: Vec::new(),
            behaviors: BTreeSet::new(),
        }
    }

    fn wants_recording(&self, scene_id: &str) -> bool {
        self.recorded_ids.len() < self.limit && !self.recorded_ids.contains(scene_id)
    }

    fn add_recording(&mut self, scene_id: &str, recorded: &crate::scene::Scene) {
        if self.wants_recording(scene_id) {
            self.recorded_ids.insert(scene_id.to_owned());
            self.motion.add("recorded", recorded);
        }
    }

    fn add(&mut self, record: &ScenarioRecord) {
        let group = if record.scenario.provenance.guidance.strength == 0.0 { "unguided" } else { "guided" };
        let n_generated = self.n_generated.entry(group).or_default();
        if *n_generated < self.limit {
            *n_generated += 1;
            self.motion.add(group, &record.scenario.scene);
        }
        self.behaviors.extend(record.requested_behavior.clone());
        if record.verified && !record.recorded_event {
            self.events.extend(record.main_event().cloned());
        }
    }

    /// Parameters of the recorded events of the behaviors that were asked for, beside those of the new ones.
    fn events(&self, mined: &[BehaviorEvent]) -> Vec<Distribution> {
        let is_asked =
            |event: &&BehaviorEvent| event.label == EventLabel::Positive && self.behaviors.contains(&event.behavior);
        let recorded: Vec<&BehaviorEvent> = mined.iter().filter(is_asked).collect();
        let generated: Vec<&BehaviorEvent> = self.events.iter().collect();
        if generated.is_empty() {
            return Vec::new();
        }
        event_distributions(&[("recorded events", &recorded), ("generated events", &generated)])
    }
}
