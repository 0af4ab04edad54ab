//! Draws arrivals as frequent and as fast as in the scenes of the corpus at this place.
//!
//! The flow through the first meters of an entry is the sum of the speeds of the vehicles seen there, divided by length
//! and number of scenes (Edie 1963). An arrival has the size, speed and offset of one of these vehicles, drawn in
//! proportion to its speed, since fast ones pass more often.

use super::Arrival;
use super::ends::{Ends, Seen};
use crate::scene::{Scene, Track, TrackId};
use crate::seed::Seed;

/// Arrivals have this before their number as a name.
const PREFIX: &str = "arrival_";

impl Ends {
    /// Expected arrivals per second.
    pub(super) fn rate_per_s(&self) -> f64 {
        self.seen().map(|(_, seen)| seen.rate_per_s).sum()
    }

    fn seen(&self) -> impl Iterator<Item = (usize, &Seen)> {
        let entries = self.entries.iter().enumerate();
        entries.flat_map(|(entry_idx, entry)| entry.seen.iter().map(move |seen| (entry_idx, seen)))
    }

    /// Endless random arrivals after the present of this scenario, in order of time, beside these that are `known`.
    pub(super) fn drawn<'t>(
        &self,
        scene: &'t Scene,
        known: impl Iterator<Item = &'t Track>,
        (name, seed): (&str, u64),
    ) -> impl Iterator<Item = (Arrival, Track)> {
        let (rate_per_s, mut rng) = (self.rate_per_s(), Seed(seed).derive_named("arrivals", name).rng());
        let (present, dt_s, mut after_s) = (scene.current_timestep(), scene.dt_s, 0.0);
        // A scene that continues a closed loop holds arrivals of that loop, and others may follow from its windows.
        let number_of = |track: &Track| track.id.0.strip_prefix(PREFIX)?.parse::<u64>().ok();
        let mut number = scene.tracks.iter().chain(known).filter_map(number_of).max().unwrap_or_default();
        std::iter::from_fn(move || {
            after_s -= (1.0 - rng.uniform()).ln() / rate_per_s;
            let mut left = rng.uniform() * rate_per_s;
            let drawn = self.seen().find(|(_, seen)| {
                left -= seen.rate_per_s;
                left <= 0.0
            });
            let (entry_idx, Seen { track, speed_mps, offset_m, .. }) = drawn.or_else(|| self.seen().last())?;
            let entry = self.entry(entry_idx)?;
            let state = entry.state(entry.starts_at_m, *speed_mps, *offset_m)?;
            number += 1;
            let timestep = present.saturating_add((after_s / dt_s).ceil() as usize);
            let arrival = Arrival { timestep, state, entry_idx: Some(entry_idx), is_recorded: false };
            Some((arrival, Track { id: TrackId(format!("{PREFIX}{number}")), ..track.clone() }))
        })
    }
}
