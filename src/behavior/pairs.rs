//! Ordered pairs of agents: which of them show a behavior, and which only come close?

use super::swept_boxes::SweptBoxes;
use super::{BehaviorEvent, EventLabel};
use crate::scene::Scene;
use std::ops::Range;

/// A search over the ordered pairs of vehicles that are tracked at present.
pub(super) struct PairSearch<'a> {
    pub(super) scene: &'a Scene,
    /// Name and roles of the behavior.
    pub(super) names: (&'static str, &'static [&'static str]),
    /// Pairs without the behavior are hard negatives if their boxes come closer than this, meters. Pairs that stay
    /// farther apart are skipped.
    pub(super) negative_distance_m: f64,
    /// The timesteps at which that counts; also the start and end of hard negatives.
    pub(super) judged: Range<usize>,
    /// Whether only states at the same time are compared.
    pub(super) same_time: bool,
}

impl PairSearch<'_> {
    /// The events of all pairs. `positive` makes the event of a pair (first role, second role); a pair without one may
    /// be a hard negative. Pairs come in the order of tracks, each first with the earlier track in the first role, then
    /// with the later one. All events have `min_distance_m`, the smallest distance of the boxes at the same time, from
    /// the present on.
    pub(super) fn events(
        &self,
        positive: impl Fn([usize; 2], &SweptBoxes, &SweptBoxes) -> Option<BehaviorEvent>,
    ) -> Vec<BehaviorEvent> {
        let scene = self.scene;
        let present = scene.current_timestep();
        if scene.n_history == 0 || !scene.has_future() {
            return Vec::new();
        }
        let takes_part = |agent_idx: &usize| {
            scene.tracks[*agent_idx].class.is_motorized()
                && scene.state(*agent_idx, present).is_some_and(|state| state.is_finite())
        };
        let sweeps: Vec<(usize, SweptBoxes)> = (0..scene.tracks.len())
            .filter(takes_part)
            .filter_map(|agent_idx| Some((agent_idx, SweptBoxes::new(&scene.tracks[agent_idx])?)))
            .collect();
        let mut events = Vec::new();
        for (i, (first_idx, first)) in sweeps.iter().enumerate() {
            for (second_idx, second) in &sweeps[i + 1..] {
                if !first.may_come_within(second, self.negative_distance_m.max(0.0)) {
                    continue;
                }
                let pairs = [[*first_idx, *second_idx], [*second_idx, *first_idx]];
                let found = [positive(pairs[0], first, second), positive(pairs[1], second, first)];
                let is_near = found.iter().any(Option::is_none) && self.is_near(first, second);
                // The distance is the most expensive part, so it is computed only for events.
                let min_distance_m = (is_near || found.iter().any(Option::is_some))
                    .then(|| first.min_distance_m(second, present..scene.n_timesteps))
                    .flatten()
                    .map(|(distance_m, _)| distance_m);
                for (pair, found) in pairs.into_iter().zip(found) {
                    let event = found.or_else(|| is_near.then(|| self.negative(pair)));
                    events.extend(event.map(|event| event.with("min_distance_m", min_distance_m)));
                }
            }
        }
        events
    }

    fn is_near(&self, first: &SweptBoxes, second: &SweptBoxes) -> bool {
        if self.same_time {
            first.comes_within_at_same_time(second, self.judged.clone(), self.negative_distance_m)
        } else {
            first.comes_within(second, self.judged.clone(), self.negative_distance_m)
        }
    }

    fn negative(&self, pair: [usize; 2]) -> BehaviorEvent {
        let last = self.judged.end.saturating_sub(1);
        BehaviorEvent::new(self.names, self.scene, EventLabel::Negative, &pair, self.judged.start..=last)
    }
}
