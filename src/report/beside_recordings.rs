//! Collects motion and events to compare with the recorded ones.

use super::distribution::Distribution;
use super::quantities::{EventParameters, MotionDistributions, event_distributions};
use crate::behavior::{BehaviorEvent, EventLabel};
use crate::scenario::ScenarioRecord;
use crate::scene::{GuidanceTag, Provenance, Scene, SituationKind};
use crate::store::{Result, SceneSet};
use std::collections::{BTreeMap, BTreeSet};

/// Collects at most `limit` scenes of each group, and the parameters of events.
pub(super) struct BesideRecordings {
    limit: usize,
    recorded: SceneSet,
    n_generated: BTreeMap<&'static str, usize>,
    motion: MotionDistributions,
    events: EventParameters,
    behaviors: BTreeSet<String>,
}

impl BesideRecordings {
    pub(super) fn new(limit: usize) -> Self {
        Self {
            limit,
            recorded: SceneSet::default(),
            n_generated: BTreeMap::new(),
            motion: MotionDistributions::default(),
            events: EventParameters::default(),
            behaviors: BTreeSet::new(),
        }
    }

    /// Whether to add the recording at this position of the store.
    pub(super) fn wants_recording(&self, scene_idx: usize) -> bool {
        self.recorded.len() < self.limit && !self.recorded.contains(scene_idx)
    }

    pub(super) fn add_recording(&mut self, scene_idx: usize, recorded: &Scene) {
        if self.wants_recording(scene_idx) {
            self.recorded.insert(scene_idx);
            if recorded.source.situation == SituationKind::Recorded {
                self.motion.add("recorded", recorded);
            }
        }
    }

    pub(super) fn add(&mut self, record: &ScenarioRecord) {
        let group = kind_of_traffic(&record.scenario.provenance);
        let n_generated = self.n_generated.entry(group).or_default();
        if *n_generated < self.limit {
            *n_generated += 1;
            self.motion.add(group, &record.scenario.scene);
        }
        self.behaviors.extend(record.requested_behavior.clone());
        if record.verified && !record.recorded_event {
            record.main_event().into_iter().for_each(|event| self.events.add(event));
        }
    }

    /// Distributions of motion, recorded and generated.
    pub(super) fn motion(&self) -> Vec<Distribution> {
        self.motion.finish()
    }

    /// Parameters of recorded events of the requested behaviors, beside those of new ones. Recorded events are read
    /// only if there are new ones.
    pub(super) fn events(&self, all: impl Iterator<Item = Result<BehaviorEvent>>) -> Result<Vec<Distribution>> {
        if self.events.is_empty() {
            return Ok(Vec::new());
        }
        let mut recorded = EventParameters::default();
        for event in all {
            let event = event?;
            if event.label == EventLabel::Positive && self.behaviors.contains(&event.behavior) {
                recorded.add(&event);
            }
        }
        Ok(event_distributions(&[("recorded events", &recorded), ("generated events", &self.events)]))
    }
}

/// The group of generated traffic in comparisons. Edited scenarios without guidance are neither forecasts nor guided.
fn kind_of_traffic(provenance: &Provenance) -> &'static str {
    match provenance.guidance.kind.as_str() {
        _ if provenance.is_unguided() => "unguided",
        GuidanceTag::NONE => "edited",
        _ => "guided",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluate::testing::{record, recorded};

    #[test]
    fn edited_scenarios_are_not_compared_as_unguided_traffic() {
        let mut compared = BesideRecordings::new(9);
        compared.add_recording(0, &recorded());
        let mut guided = record(2.0, false, false, recorded());
        compared.add(&guided);
        guided.scenario.provenance.guidance.kind = GuidanceTag::NONE.to_owned();
        compared.add(&guided);
        guided.scenario.provenance.edit_tau = Some(0.4);
        compared.add(&guided);
        let motion = compared.motion();
        let names: Vec<&str> = motion[0].series.iter().map(|series| series.name.as_str()).collect();
        assert_eq!(names, ["recorded", "guided", "unguided", "edited"]);
    }
}
