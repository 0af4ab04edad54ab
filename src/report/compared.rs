//! Whose motion, and which events, are compared with the recorded ones?

use super::distribution::Distribution;
use super::quantities::{MotionDistributions, event_distributions};
use crate::behavior::{BehaviorEvent, EventLabel};
use crate::scene::{GuidanceTag, Provenance, Scene};
use crate::store::ScenarioRecord;
use std::collections::{BTreeMap, BTreeSet};

/// Collects what is compared: at most `limit` scenes of each group.
pub(super) struct Compared {
    limit: usize,
    recorded_ids: BTreeSet<String>,
    n_generated: BTreeMap<&'static str, usize>,
    motion: MotionDistributions,
    events: Vec<BehaviorEvent>,
    behaviors: BTreeSet<String>,
}

impl Compared {
    pub(super) fn new(limit: usize) -> Self {
        Self {
            limit,
            recorded_ids: BTreeSet::new(),
            n_generated: BTreeMap::new(),
            motion: MotionDistributions::default(),
            events: Vec::new(),
            behaviors: BTreeSet::new(),
        }
    }

    pub(super) fn wants_recording(&self, scene_id: &str) -> bool {
        self.recorded_ids.len() < self.limit && !self.recorded_ids.contains(scene_id)
    }

    pub(super) fn add_recording(&mut self, scene_id: &str, recorded: &Scene) {
        if self.wants_recording(scene_id) {
            self.recorded_ids.insert(scene_id.to_owned());
            self.motion.add("recorded", recorded);
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
            self.events.extend(record.main_event().cloned());
        }
    }

    /// How road users move, recorded and generated.
    pub(super) fn motion(&self) -> Vec<Distribution> {
        self.motion.finish()
    }

    /// Whether a recorded event is one of a behavior that was asked for.
    pub(super) fn wants_event(&self, event: &BehaviorEvent) -> bool {
        event.label == EventLabel::Positive && self.behaviors.contains(&event.behavior)
    }

    /// Parameters of the recorded events that are [wanted](Self::wants_event), beside those of the new ones.
    pub(super) fn events(&self, recorded: &[BehaviorEvent]) -> Vec<Distribution> {
        let recorded: Vec<&BehaviorEvent> = recorded.iter().collect();
        let generated: Vec<&BehaviorEvent> = self.events.iter().collect();
        if generated.is_empty() {
            return Vec::new();
        }
        event_distributions(&[("recorded events", &recorded), ("generated events", &generated)])
    }
}

/// What generated traffic is compared by. What is edited and not guided is neither a forecast nor guided.
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
        let mut compared = Compared::new(9);
        compared.add_recording("a", &recorded());
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
