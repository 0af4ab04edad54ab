//! Which events are one and the same, seen in several scenes?

use super::{ExposureTally, SceneExposure, ShownScene};
use crate::behavior::{BehaviorEvent, EventLabel};
use crate::scene::{SceneId, TrackId};
use std::collections::BTreeMap;

/// Events of the same road users are one if the next begins within this time after the last one, seconds.
const SAME_WITHIN_S: f64 = 1.0;

/// An event, and its number among those of its scene and behavior.
pub type Numbered = (BehaviorEvent, usize);

/// Finds the events of scenes that overlap, each once, in the view that shows most of it. The windows of a recording
/// must come by time.
#[derive(Debug, Default)]
pub struct OccurrenceTally {
    /// The events that later windows may show again.
    open: BTreeMap<(usize, String, Vec<TrackId>), Open>,
}

#[derive(Debug)]
struct Open {
    until_frame: i64,
    n_frames: usize,
    best: Numbered,
}

impl OccurrenceTally {
    /// Adds all events of a scene, and returns those that no later scene can show.
    pub fn add(
        &mut self,
        scene: &SceneExposure,
        shown: ShownScene,
        events: &[BehaviorEvent],
        exposure: &ExposureTally,
    ) -> Vec<Numbered> {
        let ShownScene { recording, first_frame, .. } = shown;
        let margin = (SAME_WITHIN_S / scene.dt_s).round() as i64;
        let mut over = self.close(|(of, ..), open| *of == recording && open.until_frame + margin < first_frame);
        let mut n_seen: BTreeMap<&str, usize> = BTreeMap::new();
        for event in events {
            let next = n_seen.entry(&event.behavior).or_default();
            let number = *next;
            *next += 1;
            let [from, to] = [event.start_timestep, event.end_timestep].map(|timestep| first_frame + timestep as i64);
            let is_elsewhere = || [from, to].iter().all(|frame| exposure.is_elsewhere(recording, *frame));
            if event.label != EventLabel::Positive || is_elsewhere() {
                continue;
            }
            let mut tracks: Vec<TrackId> = event.roles.tracks().cloned().collect();
            tracks.sort_unstable();
            let key = (recording, event.behavior.clone(), tracks);
            let n_frames = event.end_timestep - event.start_timestep;
            match self.open.get_mut(&key).filter(|open| from <= open.until_frame + margin) {
                Some(open) => {
                    open.until_frame = open.until_frame.max(to);
                    // The first of views that show as much is kept.
                    if n_frames > open.n_frames {
                        (open.n_frames, open.best) = (n_frames, (event.clone(), number));
                    }
                }
                None => {
                    let best = (event.clone(), number);
                    let earlier = self.open.insert(key, Open { until_frame: to, n_frames, best });
                    over.extend(earlier.map(|open| open.best));
                }
            }
        }
        if SceneId::window_of(&scene.id.0).is_none() {
            over.extend(self.close(|(of, ..), _| *of == recording));
        }
        over
    }

    /// The events that are still open after the last scene.
    pub fn finish(mut self) -> Vec<Numbered> {
        self.close(|_, _| true)
    }

    fn close(&mut self, is_over: impl Fn(&(usize, String, Vec<TrackId>), &Open) -> bool) -> Vec<Numbered> {
        let (over, open) = std::mem::take(&mut self.open).into_iter().partition(|(key, open)| is_over(key, open));
        self.open = open;
        BTreeMap::into_values(over).map(|open| open.best).collect()
    }
}
