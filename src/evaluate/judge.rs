//! Judges single scenarios, apart from their requested behavior: are they possible, how critical are they, are they
//! new?

use super::error::Result;
use crate::behavior::{BehaviorEvent, EventLabel};
use crate::metrics::{
    CarefulJudgment, CarefulReplay, Check, EventSpace, Judged, MetricSettings, MotionHistograms, PairCriticality,
    RecordedRanges, SceneCriticality, Violation,
};
use crate::scenario::{Assessment, ScenarioRecord};
use crate::scene::{Roles, Scene, SituationKind};
use crate::store::{SceneStore, read_events};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Number of recorded scenes for the ranges of motion: enough to estimate a thousandth at either end, few enough to be
/// fast.
const N_REFERENCE_SCENES: usize = 400;
/// The behaviors in which somebody comes into the lane of the ego.
const CUT_INS: [&str; 2] = ["cut_in", "cut_in_paper"];
/// The behavior that comes from behind: braking is no answer to it.
const FROM_BEHIND: &str = "tailgating";

/// The outcome for the careful driver in place of the subject. `None` without a subject, and if the event is its own or
/// comes from behind.
fn careful(record: &ScenarioRecord) -> Option<CarefulJudgment> {
    let (scene, event) = (&record.scenario.scene, record.main_event()?);
    let subject_idx = record.subject_idx().filter(|_| event.behavior != FROM_BEHIND)?;
    let mut others = event.roles.tracks().filter_map(|id| scene.track_idx(id)).filter(|idx| *idx != subject_idx);
    let other = others.next()?;
    let cuts_in = CUT_INS.contains(&event.behavior.as_str());
    Some(CarefulReplay::of(scene, subject_idx)?.judgment_with_margin(cuts_in.then_some(other)))
}

/// Everything that scenarios are judged by.
pub(super) struct Judge<'a> {
    settings: &'a MetricSettings,
    ranges: RecordedRanges,
    /// The table of recorded events.
    events: Option<&'a Path>,
    /// The recorded events of the behaviors requested so far.
    spaces: BTreeMap<String, Option<EventSpace>>,
}

/// The judgment of the recording of a cell, or of a baseline, as if it had been generated.
#[derive(Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct ReferenceJudgment {
    /// The checks that it fails.
    pub(super) violations: Vec<Violation>,
    /// Share of its motion within the recorded ranges.
    pub(super) plausibility: Option<f64>,
}

impl<'a> Judge<'a> {
    /// A judge with ranges from at most 400 recorded scenes, evenly spread over the store, and with access to the
    /// recorded `events`.
    pub(super) fn new(settings: &'a MetricSettings, store: &SceneStore, events: Option<&'a Path>) -> Result<Self> {
        let entries = store.index().iter().enumerate();
        let is_recorded = |situation: SituationKind| situation == SituationKind::Recorded;
        let recorded: Vec<usize> =
            entries.filter(|(_, entry)| is_recorded(entry.situation)).map(|(position, _)| position).collect();
        let n_scenes = recorded.len().min(N_REFERENCE_SCENES);
        let motion: Vec<MotionHistograms> = (0..n_scenes)
            .into_par_iter()
            .map(|i| Ok(MotionHistograms::of([&store.scene(recorded[i * recorded.len() / n_scenes])?])))
            .collect::<Result<_>>()?;
        let mut all = MotionHistograms::default();
        motion.iter().for_each(|of_scene| all.merge(of_scene));
        Ok(Self { settings, ranges: RecordedRanges::of(&all), events, spaces: BTreeMap::new() })
    }

    /// Reads the recorded events of these behaviors, once each. Events of other behaviors take no memory.
    pub(super) fn learn_events<'b>(&mut self, behaviors: impl Iterator<Item = &'b str>) -> Result<()> {
        let Some(events) = self.events else { return Ok(()) };
        let unknown: BTreeSet<&str> = behaviors.filter(|behavior| !self.spaces.contains_key(*behavior)).collect();
        if !unknown.is_empty() {
            let is_one = |event: &BehaviorEvent| {
                event.label == EventLabel::Positive && unknown.contains(event.behavior.as_str())
            };
            let events = read_events(events, is_one)?;
            let space = |behavior: &str| (behavior.to_owned(), EventSpace::new(behavior, &events));
            self.spaces.extend(unknown.iter().map(|behavior| space(behavior)));
        }
        Ok(())
    }

    /// A judge without recorded traffic.
    #[cfg(test)]
    pub(super) fn without_recordings(settings: &'a MetricSettings) -> Self {
        let ranges = RecordedRanges::of(&MotionHistograms::default());
        Self { settings, ranges, events: None, spaces: BTreeMap::new() }
    }

    /// The judgment of a scenario, except for near-duplicates.
    pub(super) fn assess(&self, record: &ScenarioRecord) -> Assessment {
        let (scene, observed) = (&record.scenario.scene, &record.scenario.observed);
        let roles = &record.scenario.provenance.guidance.roles;
        let judged = Judged::new(scene, roles, |agent_idx, timestep| !observed.is_observed(agent_idx, timestep))
            .with_gaps(&self.settings.map_gaps)
            .excused_if(record.asks_for_collision());
        let track = |idx: usize| scene.track_idx(&roles.get(idx)?.1);
        let pair = track(0).zip(track(1)).map(|(first, second)| [first, second]);
        let asked = record.requested_behavior.as_deref();
        let ending = record.ending();
        let mut violations = judged.violations(&self.settings.validity);
        let is_judged = !self.settings.validity.skip.contains(&Check::ContactAfterEnd);
        violations.extend(
            ending.filter(|_| is_judged).and_then(|(subject_idx, ending)| ending.violation(scene, subject_idx)),
        );
        let space = asked.and_then(|asked| self.spaces.get(asked)?.as_ref());
        Assessment {
            accepted: false,
            violations,
            plausibility: self.ranges.plausibility(scene),
            recorded_likeness: None,
            pair: pair.and_then(|pair| PairCriticality::of(scene, pair)),
            scene: SceneCriticality::of(scene),
            careful: careful(record),
            ending: ending.map(|(_, ending)| ending),
            explanation: record.explanation().flatten(),
            nearest_recorded_event: record
                .main_event()
                .zip(space)
                .and_then(|(event, space)| space.distance_to_nearest(event)),
            nearest_scenario_m: None,
            near_duplicate_of: None,
            rate: None,
        }
    }

    /// Whether the map of the scene's place shows the whole road.
    pub(super) fn sees_road(&self, scene: &Scene) -> bool {
        !self.settings.map_gaps.places.contains(&scene.source.place)
    }

    /// The judgment of `scene` as if its whole future had been generated.
    pub(super) fn judge_reference(&self, scene: &Scene) -> ReferenceJudgment {
        let judged = Judged::future_of(scene, Roles::none()).with_gaps(&self.settings.map_gaps);
        ReferenceJudgment {
            violations: judged.violations(&self.settings.validity),
            plausibility: self.ranges.plausibility(scene),
        }
    }
}
