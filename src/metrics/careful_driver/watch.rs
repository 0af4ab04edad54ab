//! The careful driver in a closed loop: what it has seen of another agent so far, and how hard it brakes for it.
//!
//! Perception, danger, delay and ramp are those of [`CutInJudgment`](super::CutInJudgment), but timestep by timestep,
//! so that the other may answer to the braking. Because it is not known beforehand which vehicle cuts in, one is in the
//! way if its flank is in the lane of the path, or will be within the time that counts as danger at its present lateral
//! speed.

use super::encounter::is_danger;
use super::regulation::{
    DANGER_TTC_S, DELAY_S, INTRUSION_M, LANE_WIDTH_M, MAX_DECELERATION_MPS2, PERCEPTION_S, RAMP_S, WANDERING_M,
};

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
}

/// The knowledge of the careful driver of one other.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CarefulWatch {
    farthest_m: f64,
    last_offset_m: Option<f64>,
    perceived_s: Option<f64>,
    danger_s: Option<f64>,
}

impl CarefulWatch {
    /// Looks at the other at `now_s`, `dt_s` after the last look; `None` if it is not visible.
    pub fn look(&mut self, now_s: f64, dt_s: f64, seen: Option<&Seen>) {
        let Some(seen) = seen else {
            *self = Self::default();
            return;
        };
        let limit_m = LANE_WIDTH_M / 2.0 - INTRUSION_M;
        let toward_mps = self.last_offset_m.map_or(0.0, |last_m| (last_m - seen.offset_m) / dt_s);
        self.last_offset_m = Some(seen.offset_m);
        self.farthest_m = self.farthest_m.max(seen.offset_m);
        let is_within = seen.flank_m <= limit_m;
        if is_within || self.farthest_m - seen.offset_m > WANDERING_M {
            self.perceived_s.get_or_insert(now_s + PERCEPTION_S);
        }
        let is_in_way = is_within || seen.flank_m - toward_mps * DANGER_TTC_S <= limit_m;
        // Times of timesteps are rounded products; rounding must not decide.
        let is_perceived = self.perceived_s.is_some_and(|perceived_s| now_s >= perceived_s - 1e-9);
        if is_in_way && is_perceived && is_danger(seen.gap_m, seen.closing_mps, seen.lengths_m) {
            self.danger_s.get_or_insert(now_s);
        } else if !is_in_way || seen.closing_mps <= 0.0 {
            self.danger_s = None;
        }
    }

    /// Whether it has perceived by `now_s` that the other is, or comes, in the way.
    pub fn has_perceived(&self, now_s: f64) -> bool {
        self.perceived_s.is_some_and(|perceived_s| now_s >= perceived_s - 1e-9)
    }

    /// The deceleration for the other at `now_s`, m/s²; 0 before braking begins.
    pub fn braking_mps2(&self, now_s: f64) -> f64 {
        let ramp = self.danger_s.map_or(0.0, |danger_s| (now_s - danger_s - DELAY_S) / RAMP_S);
        MAX_DECELERATION_MPS2 * ramp.clamp(0.0, 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A car, with a total length of both of 9 m, 20 m ahead and 10 m/s slower, `offset_m` beside the path.
    fn seen(offset_m: f64, closing_mps: f64) -> Seen {
        Seen { offset_m, flank_m: offset_m - 0.9, gap_m: 19.9, closing_mps, lengths_m: 9.0 }
    }

    #[test]
    fn it_brakes_after_perception_and_delay_and_until_the_gap_opens() {
        let mut watch = CarefulWatch::default();
        let mut brakes_from_s = None;
        for step in 0..40 {
            let now_s = f64::from(step) * 0.1;
            // It comes over with 1 m/s from 1 s on: after 1.4 s it has moved by 0.4 m, which is seen 0.4 s later.
            let offset_m = 3.5 - (now_s - 1.0).max(0.0);
            watch.look(now_s, 0.1, Some(&seen(offset_m, 10.0)));
            if watch.braking_mps2(now_s) > 0.0 {
                brakes_from_s = brakes_from_s.or(Some(now_s));
            }
        }
        // 1.4 + 0.4 + 0.75 s, and the next timestep in the ramp.
        assert!((brakes_from_s.unwrap() - 2.6).abs() < 1e-9, "{brakes_from_s:?}");
        assert!((watch.braking_mps2(4.0) - MAX_DECELERATION_MPS2).abs() < 1e-9);
        watch.look(4.0, 0.1, Some(&seen(0.0, -1.0)));
        assert_eq!(watch.braking_mps2(4.0), 0.0);
    }

    #[test]
    fn who_keeps_beside_the_lane_is_no_danger() {
        let mut watch = CarefulWatch::default();
        for step in 0..40 {
            // It wanders by half a meter within its own lane, and stays there.
            let offset_m = if step < 5 { 3.8 } else { 3.3 };
            watch.look(f64::from(step) * 0.1, 0.1, Some(&seen(offset_m, 10.0)));
        }
        assert!(watch.has_perceived(3.9) && watch.braking_mps2(3.9) == 0.0);
        watch.look(4.0, 0.1, None);
        assert_eq!(watch, CarefulWatch::default());
    }
}
