//! The intelligent driver model (Treiber, Hennecke and Helbing 2000) along the way of the ego.

use super::way::{advanced, advanced_gently, eased, ego, seen};
use crate::behavior::following::opens_mps;
use crate::metrics::{Seen, acceleration_mps2, half_width_m};
use crate::scene::State;
use crate::simulate::driver::{Driver, Failed};
use crate::simulate::{Situation, World};

/// Within which time a driver loses speed to fall back after an event, and within which it gains speed again, seconds.
const COMES_TO_S: f64 = 2.0;
const GAINS_S: f64 = 6.0;
/// The distance that is left when both are as fast, and the least over which speed is lost, meters.
const LEAVES_M: f64 = 2.0;
const LEAST_M: f64 = 0.5;
/// Who comes over by at least this, m/s over the last moment, seconds, and would be in the way within the next time, is
/// expected there.
const COMES_MPS: f64 = 0.3;
const MOMENT_S: f64 = 0.3;
const EXPECTED_S: f64 = 2.0;

/// The intelligent driver model. It knows no rules of right of way, and reacts only to the nearest agent in its way.
#[derive(Debug, Clone, Copy, Default)]
pub(in crate::simulate) struct Idm;

impl Driver for Idm {
    fn begin(&mut self, _situation: &Situation, _world: &World) -> Result<(), Failed> {
        Ok(())
    }

    fn next(&mut self, situation: &Situation, world: &World, _sampled: Option<State>) -> Result<State, Failed> {
        let state = ego(situation, world)?;
        let wanted_mps2 = behind_nearest(situation, &state, &seen(situation, world, world.now()));
        Ok(advanced(situation, &state, eased(situation, world, wanted_mps2)))
    }
}

impl Idm {
    /// The next state of an ego that goes on after an event: it does not brake hard for a gap that is short but opens,
    /// and keeps its distance from who comes over, too.
    pub(super) fn settling(situation: &Situation, world: &World) -> Result<State, Failed> {
        let (state, seen) = (ego(situation, world)?, expected_soon(situation, world));
        let mps2 = behind_nearest(situation, &state, &seen);
        let wanted_mps2 =
            nearest(situation, &seen).map_or(mps2, |nearest| calm_mps2(mps2, state.speed_mps(), &nearest));
        Ok(advanced_gently(situation, world, wanted_mps2).unwrap_or_else(|| advanced(situation, &state, wanted_mps2)))
    }
}

/// The model's acceleration, m/s², but no harder braking than is needed to stay at a standstill's distance if the one
/// ahead keeps its speed, or to fall back from it slowly. The model alone brakes at once, and fully, for a gap that is
/// short but opens.
fn calm_mps2(model_mps2: f64, ego_mps: f64, ahead: &Seen) -> f64 {
    let free_m = (ahead.gap_m - LEAVES_M).min(ahead.gap_m / 2.0);
    let needed_mps2 = -ahead.closing_mps.powi(2) / (2.0 * free_m.max(LEAST_M));
    let to_gain_mps = -(ahead.closing_mps + opens_mps(ego_mps, ahead.gap_m));
    let falls_back_mps2 = to_gain_mps / if to_gain_mps > 0.0 { GAINS_S } else { COMES_TO_S };
    let calm_mps2 = if ahead.closing_mps > 0.0 { needed_mps2.min(falls_back_mps2) } else { falls_back_mps2 };
    model_mps2.max(calm_mps2)
}

/// The other agents as seen from the ego's way, in it those that come over to it.
fn expected_soon(situation: &Situation, world: &World) -> Vec<Option<Seen>> {
    let n_before = (MOMENT_S / situation.scene.dt_s).round().max(1.0);
    let mut all = seen(situation, world, world.now());
    let before = world.now().checked_sub(n_before as usize).map(|timestep| seen(situation, world, timestep));
    for (now, before) in all.iter_mut().zip(before.unwrap_or_default()) {
        let Some((now, before)) = now.as_mut().zip(before) else { continue };
        let comes_mps = (before.offset_m - now.offset_m) / (n_before * situation.scene.dt_s);
        if comes_mps > COMES_MPS {
            now.flank_m -= comes_mps * EXPECTED_S;
        }
    }
    all
}

/// The model's acceleration behind the nearest agent in the way of the ego, m/s².
fn behind_nearest(situation: &Situation, ego: &State, seen: &[Option<Seen>]) -> f64 {
    acceleration(situation, ego, nearest(situation, seen).into_iter())
}

/// The nearest agent in the way of the ego.
fn nearest(situation: &Situation, seen: &[Option<Seen>]) -> Option<Seen> {
    leaders(situation, seen).map(|(_, seen)| seen).min_by(|a, b| a.gap_m.total_cmp(&b.gap_m))
}

/// The agents ahead in the way of the ego, with their present states as seen from it.
pub(super) fn leaders(situation: &Situation, seen: &[Option<Seen>]) -> impl Iterator<Item = (usize, Seen)> {
    let half_width_m = half_width_m(situation.scene.tracks[situation.ego_idx].extent_or_least().width_m);
    let all = seen.iter().enumerate().filter_map(|(agent_idx, seen)| Some((agent_idx, (*seen)?)));
    all.filter(move |(agent_idx, seen)| situation.can_touch(*agent_idx) && seen.leads(half_width_m))
}

/// The distance to the nearest agent in the way of the ego now, meters; infinite if there is none.
pub(in crate::simulate) fn free_m(situation: &Situation, world: &World) -> f64 {
    leaders(situation, &seen(situation, world, world.now())).map(|(_, seen)| seen.gap_m).fold(f64::INFINITY, f64::min)
}

/// The model's acceleration behind these leaders, m/s²; without any, that on a free road.
pub(super) fn acceleration(situation: &Situation, ego: &State, leaders: impl Iterator<Item = Seen>) -> f64 {
    acceleration_mps2(ego.speed_mps(), situation.way.wanted_speed_mps(ego.position), leaders)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nobody_brakes_hard_for_a_short_gap_that_opens() {
        let calm = |model_mps2: f64, gap_m: f64, closing_mps: f64| {
            let ahead = Seen { offset_m: 0.0, flank_m: 0.0, gap_m, closing_mps, lengths_m: 9.0, is_on_foot: false };
            calm_mps2(model_mps2, 10.0, &ahead)
        };
        // By hand: it falls back with 2 m/s, 0.5 of which it has; and it comes to the speed ahead.
        assert!((calm(-7.5, 2.0, -0.5) + 0.75).abs() < 1e-12);
        assert!((calm(-6.0, 10.0, 5.0) + 2.5).abs() < 1e-12);
        // It comes up again where the gap opens faster.
        assert!((calm(-1.0, 6.0, -1.5) - 0.5 / 6.0).abs() < 1e-12 && (calm(-1.0, 6.0, -4.0) - 0.5).abs() < 1e-12);
        // It brakes for what is needed, and no harder than the model.
        assert!((calm(-9.0, 4.0, 5.0) + 6.25).abs() < 1e-12);
        // Of 8 m, it uses 4: 36 / 8.
        assert!((calm(-9.0, 8.0, 6.0) + 4.5).abs() < 1e-12);
        assert_eq!([calm(0.5, 2.0, -0.5), calm(-5.0, 2.5, 5.0)], [0.5, -5.0]);
    }
}
