//! The careful driver: from all that it has seen so far to its acceleration.

use super::ordinary::{BRAKES_MPS2, acceleration_mps2, eased_mps2, half_width_m};
use super::watch::{Looking, Seen, Watch};

/// The careful driver. Its knowledge is a function of what it has looked at.
#[derive(Debug, Clone, Default)]
pub struct CarefulDriver {
    /// How much longer than the regulation's driver it takes to react, seconds.
    later_s: f64,
    half_width_m: f64,
    now_s: f64,
    watches: Vec<(Watch, Option<Seen>)>,
}

impl CarefulDriver {
    /// A driver of an ego of this width among so many others, who has seen nothing yet and reacts `later_s` later than
    /// the regulation's.
    pub fn new(n_others: usize, ego_width_m: f64, later_s: f64) -> Self {
        let watches = vec![(Watch::default(), None); n_others];
        Self { later_s, half_width_m: half_width_m(ego_width_m), now_s: 0.0, watches }
    }

    /// Looks at the others at `now_s`, `dt_s` after the last look; `None` for those that are not there.
    pub fn look(&mut self, [now_s, dt_s]: [f64; 2], ego_mps: f64, all: impl Iterator<Item = Option<Seen>>) {
        self.now_s = now_s;
        let look = Looking { now_s, dt_s, ego_mps, half_width_m: self.half_width_m };
        self.watches.iter_mut().zip(all).for_each(|((_, last), seen)| *last = seen);
        let hiding = self.watches.iter().filter_map(|(watch, seen)| Some((watch, seen.as_ref()?)));
        let hidden_from_m = hiding.filter(|(watch, seen)| watch.hides(seen)).map(|(_, seen)| seen.gap_m);
        let hidden_from_m = hidden_from_m.fold(f64::INFINITY, f64::min);
        for (watch, seen) in &mut self.watches {
            let is_hidden = seen.is_some_and(|seen| seen.flank_m <= 0.0 && seen.gap_m > hidden_from_m);
            watch.look(&look, seen.as_ref(), is_hidden);
        }
    }

    /// Its acceleration over the timestep of `dt_s` after the last look, m/s², if it has `own_mps2` and would like to
    /// drive at `wanted_mps`: it keeps its distance with at most 2 m/s², and brakes hard for a danger.
    pub fn acceleration_mps2(&self, [ego_mps, own_mps2]: [f64; 2], wanted_mps: f64, dt_s: f64) -> f64 {
        let known_s = self.now_s - self.later_s.max(0.0);
        let seen = self.watches.iter().filter_map(|(watch, seen)| Some((watch, (*seen)?)));
        let leaders = seen.filter(|(watch, seen)| watch.is_kept_from(seen, known_s)).map(|(_, seen)| seen);
        let ordinary_mps2 = acceleration_mps2(ego_mps, wanted_mps, leaders).max(-BRAKES_MPS2);
        let ordinary_mps2 = eased_mps2(ordinary_mps2, own_mps2, dt_s);
        // As braking is on average over the timestep.
        let braking_mps2 = self.braking_mps2(self.now_s + dt_s / 2.0);
        if braking_mps2 > 0.0 { ordinary_mps2.min(-braking_mps2) } else { ordinary_mps2 }
    }

    /// The hard braking at a time, m/s².
    pub(super) fn braking_mps2(&self, at_s: f64) -> f64 {
        self.watches.iter().map(|(watch, _)| watch.braking_mps2(at_s, self.later_s)).fold(0.0, f64::max)
    }

    /// Whether anybody is a danger or to be kept from, however late it reacts.
    pub(super) fn answers(&self) -> bool {
        self.watches
            .iter()
            .any(|(watch, seen)| watch.is_dangerous() || seen.is_some_and(|seen| watch.is_kept_from(&seen, self.now_s)))
    }

    /// Whether anybody is a danger.
    pub(super) fn is_in_danger(&self) -> bool {
        self.watches.iter().any(|(watch, _)| watch.is_dangerous())
    }

    /// For how long this other has moved toward the path, seconds.
    pub(super) fn moves_for_s(&self, other: usize) -> f64 {
        self.watches[other].0.moves_for_s(self.now_s)
    }
}
