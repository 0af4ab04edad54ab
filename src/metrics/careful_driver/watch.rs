//! What the careful driver knows of one other, from all that it has seen of it: is it a risk, and a danger?

use super::braking::Braking;
use super::regulation::{
    CROSSES_MPS, DANGER_S, DELAY_S, INTRUSION_M, LANE_WIDTH_M, LEADER_BRAKES_MPS2, MAX_DECELERATION_MPS2, PERCEPTION_S,
    RAMP_S, SPARE_M, WALKS_MPS, WANDERING_M,
};
use std::collections::VecDeque;

/// Half the width that counts as the lane of the path, meters: up to 0.3 m beyond its markings.
pub(super) const IN_LANE_M: f64 = LANE_WIDTH_M / 2.0 - INTRUSION_M;
/// The braking of others is judged over this time, seconds: over a shorter one it is noise.
const BRAKES_OVER_S: f64 = 0.3;
/// Braking below this, m/s², has ended.
const BRAKES_NO_MORE_MPS2: f64 = 1.0;
/// An ego that is slower, m/s, stands.
const STANDING_MPS: f64 = 0.3;

/// Another road user, relative to the ego's path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Seen {
    /// Distance of its center from the path, meters.
    pub offset_m: f64,
    /// Distance of its nearer flank from the path, meters; negative if it is beyond the path.
    pub flank_m: f64,
    /// From the ego's front to the nearest part of it, meters along the path.
    pub gap_m: f64,
    /// The speed at which the ego approaches it along the path, m/s.
    pub closing_mps: f64,
    /// The length of both together, meters.
    pub lengths_m: f64,
    /// Whether it is a pedestrian.
    pub is_on_foot: bool,
}

/// The ego at a look.
#[derive(Debug, Clone, Copy)]
pub(super) struct Looking {
    /// Seconds since some origin, and since the last look.
    pub(super) now_s: f64,
    pub(super) dt_s: f64,
    pub(super) ego_mps: f64,
    /// Half the width that it needs, meters.
    pub(super) half_width_m: f64,
}

/// The knowledge of one other. A time of perception is when the risk began and 0.4 s more.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Watch {
    farthest_m: f64,
    farthest_at_s: f64,
    nearest_m: Option<f64>,
    last_offset_m: Option<f64>,
    /// Whether it is in the way of the ego, or will be within 2 s at its present speed across.
    is_in_way: bool,
    /// Its speeds along the path at the last looks, m/s.
    speeds_mps: VecDeque<f64>,
    /// When it is perceived that it is in the lane or comes there.
    coming_s: Option<f64>,
    /// When it is perceived that it brakes.
    braking_s: Option<f64>,
    /// Whether somebody ahead hides it, and when it is perceived since that one left.
    was_hidden: bool,
    revealed_s: Option<f64>,
    danger_s: Option<f64>,
}

impl Watch {
    /// Looks at the other; `None` if it is not there. `is_hidden` if somebody in the lane ahead of it hides it.
    pub(super) fn look(&mut self, look: &Looking, seen: Option<&Seen>, is_hidden: bool) {
        let Some(seen) = seen else {
            *self = Self::default();
            return;
        };
        let &Looking { now_s, dt_s, ego_mps, half_width_m } = look;
        let toward_mps = self.last_offset_m.map_or(0.0, |last_m| (last_m - seen.offset_m) / dt_s);
        let brakes_mps2 = self.remember(look, seen);
        let perceives_s = now_s + PERCEPTION_S;
        if is_hidden {
            (self.was_hidden, self.danger_s) = (true, None);
            return;
        }
        if std::mem::take(&mut self.was_hidden) {
            self.revealed_s = Some(perceives_s);
        }
        let is_within = seen.flank_m <= IN_LANE_M;
        let comes = match seen.is_on_foot {
            true => toward_mps >= WALKS_MPS,
            false => self.farthest_m - seen.offset_m > WANDERING_M,
        };
        if is_within || comes {
            self.coming_s.get_or_insert(perceives_s);
        }
        if seen.leads(half_width_m) && brakes_mps2 > LEADER_BRAKES_MPS2 {
            self.braking_s.get_or_insert(perceives_s);
        } else if self.danger_s.is_none() && brakes_mps2 < BRAKES_NO_MORE_MPS2 {
            self.braking_s = None;
        }
        // Whoever begins to walk may soon walk faster.
        let walks = seen.is_on_foot && toward_mps >= WALKS_MPS;
        let expected_mps = if walks { toward_mps.max(CROSSES_MPS) } else { toward_mps.max(0.0) };
        self.is_in_way = seen.flank_m - expected_mps * DANGER_S < half_width_m;
        if self.is_in_way && self.is_danger(look, seen, expected_mps) {
            self.danger_s.get_or_insert(now_s);
        } else if self.is_over(seen, toward_mps, ego_mps) {
            (self.danger_s, self.braking_s, self.revealed_s) = (None, None, None);
        }
    }

    /// Remembers where it is; returns how hard it brakes, m/s².
    fn remember(&mut self, look: &Looking, seen: &Seen) -> f64 {
        if self.last_offset_m.is_none() || seen.offset_m >= self.farthest_m {
            (self.farthest_m, self.farthest_at_s) = (seen.offset_m, look.now_s);
        }
        self.last_offset_m = Some(seen.offset_m);
        self.nearest_m = Some(self.nearest_m.map_or(seen.offset_m, |nearest_m| nearest_m.min(seen.offset_m)));
        let n = (BRAKES_OVER_S / look.dt_s).round().max(1.0) as usize;
        self.speeds_mps.push_back(look.ego_mps - seen.closing_mps);
        if self.speeds_mps.len() > n + 1 {
            self.speeds_mps.pop_front();
        }
        let n_steps = self.speeds_mps.len() - 1;
        let fallen_mps = self.speeds_mps[0] - self.speeds_mps[n_steps];
        if n_steps == n { fallen_mps / (n as f64 * look.dt_s) } else { 0.0 }
    }

    /// Whether the other, which is or comes in the way, is a danger by one of the cases.
    fn is_danger(&self, look: &Looking, seen: &Seen, expected_mps: f64) -> bool {
        let &Seen { gap_m, closing_mps, lengths_m, .. } = seen;
        // The ego need not brake for one behind it, by more than the lengths of both, but for one alongside.
        if closing_mps <= 0.0 || gap_m < -lengths_m {
            return false;
        }
        let is_perceived = |at_s: Option<f64>| is_past(at_s, look.now_s);
        if seen.is_on_foot {
            let stops_m = closing_mps * DELAY_S + stopping_m(closing_mps) + SPARE_M;
            // Whoever has passed before the other steps in need not brake.
            let enters_s = (seen.flank_m - look.half_width_m) / expected_mps.max(1e-9);
            let is_met = seen.flank_m < look.half_width_m || enters_s < (gap_m + lengths_m) / closing_mps;
            return is_perceived(self.coming_s) && is_met && gap_m <= stops_m.max(DANGER_S * closing_mps);
        }
        let follows = seen.leads(look.half_width_m) && gap_m <= DANGER_S * look.ego_mps;
        is_perceived(self.coming_s) && gap_m <= DANGER_S * closing_mps
            || follows && (is_perceived(self.braking_s) || is_perceived(self.revealed_s))
    }

    /// Whether a danger is over.
    fn is_over(&self, seen: &Seen, toward_mps: f64, ego_mps: f64) -> bool {
        match seen.is_on_foot {
            // Whoever waits beside the lane may step in at any time.
            true => {
                let is_away = seen.flank_m > IN_LANE_M && toward_mps <= -WALKS_MPS;
                ego_mps < STANDING_MPS || is_away || seen.gap_m < -seen.lengths_m
            }
            false => !self.is_in_way || seen.closing_mps <= 0.0,
        }
    }

    /// Whether a vehicle ahead hides what is behind it: it is in the lane, and has not left its place there.
    pub(super) fn hides(&self, seen: &Seen) -> bool {
        let has_left = self.nearest_m.is_some_and(|nearest_m| seen.offset_m - nearest_m > WANDERING_M);
        !seen.is_on_foot && seen.flank_m <= 0.0 && seen.gap_m >= 0.0 && !has_left
    }

    /// Whether a driver keeps its distance from the other: it is ahead in the way or comes there, which has been
    /// perceived by then.
    pub(super) fn is_kept_from(&self, seen: &Seen, known_s: f64) -> bool {
        let is_ahead = seen.gap_m > -seen.lengths_m / 2.0;
        is_ahead && self.is_in_way && !self.was_hidden && is_past(self.coming_s, known_s)
    }

    /// Whether it is a danger.
    pub(super) const fn is_dangerous(&self) -> bool {
        self.danger_s.is_some()
    }

    /// For how long it has moved toward the path, seconds.
    pub(super) fn moves_for_s(&self, now_s: f64) -> f64 {
        now_s - self.farthest_at_s
    }

    /// The deceleration for the other by a driver who takes `later_s` longer than the regulation's, m/s²; 0 before
    /// braking begins.
    pub(super) fn braking_mps2(&self, now_s: f64, later_s: f64) -> f64 {
        let ramp = self.danger_s.map_or(0.0, |danger_s| (now_s - danger_s - DELAY_S - later_s) / RAMP_S);
        MAX_DECELERATION_MPS2 * ramp.clamp(0.0, 1.0)
    }
}

/// Whether a time has come. Times of timesteps are rounded products; rounding must not decide.
fn is_past(at_s: Option<f64>, now_s: f64) -> bool {
    at_s.is_some_and(|at_s| now_s >= at_s - 1e-9)
}

/// The distance that full braking takes from this speed until the vehicle stands, meters.
fn stopping_m(speed_mps: f64) -> f64 {
    Braking::careful(speed_mps, Some(0.0)).driven_m(f64::INFINITY)
}
