//! Which cut-ins could a pair of vehicles still show?

use super::CutIn;
use crate::behavior::outcome::Outcome;
use crate::geometry::{Vec2, angle_difference};
use crate::scene::{Scene, State, Track};
use std::f64::consts::FRAC_PI_4;

/// The lateral acceleration of a brisk lane change, m/s². Half of the way accelerates with it and half of it brakes.
const LATERAL_ACCELERATION_MPS2: f64 = 2.0;
/// How hard the other may brake and accelerate on the way, m/s².
const ACCELERATIONS_MPS2: std::ops::RangeInclusive<f64> = -4.0..=2.5;
/// Spacing of the accelerations and of the times that are tried, m/s² and seconds.
const SPACING: f64 = 0.25;
/// How far the boxes shall share a path, and the least gap, meters.
const SHARE_M: f64 = 0.3;
/// Speeds at which the ego counts as standing, m/s: nobody reaches the other's place then.
const STANDING_MPS: f64 = 0.5;

impl CutIn {
    /// What `other` could come to before `ego`, if the ego goes on straight at its present speed and the other moves over with at most
    /// 2 m/s² across and -4 to 2.5 m/s² along the way.
    ///
    /// Empty where the other is in the ego's way already, comes toward it or crosses, or is too far to the side or behind.
    pub(super) fn outcomes(&self, scene: &Scene, ego: &Track, other: &Track) -> Vec<Outcome> {
        let at_present = |track: &Track| {
            let state = track.trajectory.get(scene.current_timestep()).filter(|state| state.is_finite()).copied();
            state.filter(|_| self.config.agents.admits(track.class))
        };
        let Some((own, theirs)) = at_present(ego).zip(at_present(other)) else { return Vec::new() };
        let (own_extent, their_extent) = (ego.extent_or_nominal(), other.extent_or_nominal());
        let along = Vec2::from_angle(own.heading_rad);
        let between = theirs.position - own.position;
        let aside_m = along.cross(between).abs();
        let shift_m = aside_m - (own_extent.width_m + their_extent.width_m) / 2.0 + SHARE_M;
        let turned_rad = angle_difference(theirs.heading_rad, own.heading_rad).abs();
        let (own_mps, their_mps) = (own.speed_mps(), along_mps(&theirs, along));
        if shift_m <= SHARE_M || turned_rad >= FRAC_PI_4 || own_mps < STANDING_MPS {
            return Vec::new();
        }
        let gap_now_m = along.dot(between) - (own_extent.length_m + their_extent.length_m) / 2.0;
        let side = if along.cross(between) < 0.0 { -1.0 } else { 1.0 };
        let horizon_s = scene.n_timesteps.saturating_sub(scene.n_history) as f64 * scene.dt_s;
        let least_s = 2.0 * (shift_m / LATERAL_ACCELERATION_MPS2).sqrt();
        let n = |range: f64| (range / SPACING).floor().max(0.0) as usize;
        let mut outcomes = Vec::new();
        if least_s > horizon_s {
            return outcomes;
        }
        for time_s in (0..=n(horizon_s - least_s)).map(|i| least_s + i as f64 * SPACING) {
            for i in 0..=n(ACCELERATIONS_MPS2.end() - ACCELERATIONS_MPS2.start()) {
                let acceleration_mps2 = ACCELERATIONS_MPS2.start() + i as f64 * SPACING;
                let then_mps = their_mps + acceleration_mps2 * time_s;
                let gap_m = gap_now_m + ((their_mps + then_mps) / 2.0 - own_mps) * time_s;
                if then_mps < 0.0 || gap_m < SHARE_M || gap_m >= own_mps * self.config.max_delay_s {
                    continue;
                }
                let relative_mps = own_mps - then_mps;
                outcomes.push(
                    Outcome::default()
                        .with("gap_m", gap_m)
                        .with("relative_speed_mps", relative_mps)
                        .with("ego_speed_mps", own_mps)
                        .with("other_speed_mps", then_mps)
                        .with("ttc_s", (relative_mps > 0.1).then(|| gap_m / relative_mps))
                        .with("time_headway_s", gap_m / own_mps)
                        .with("side", side)
                        .with("ego_length_m", own_extent.length_m)
                        .with("other_length_m", their_extent.length_m)
                        .at_effort(effort(acceleration_mps2).max((least_s / time_s).powi(2))),
                );
            }
        }
        outcomes
    }
}

/// The share of the limits that an acceleration takes.
fn effort(acceleration_mps2: f64) -> f64 {
    let limit = if acceleration_mps2 < 0.0 { *ACCELERATIONS_MPS2.start() } else { *ACCELERATIONS_MPS2.end() };
    acceleration_mps2 / limit
}

/// The speed of a state in a direction, m/s.
fn along_mps(state: &State, along: Vec2) -> f64 {
    state.velocity.dot(along)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::behavior::{Behavior, CutInConfig};
    use crate::scene::testing::{Drive, scene};

    /// What the second of two cars could come to before the first, which drives along x at 10 m/s.
    fn outcomes(other: Drive) -> Vec<Outcome> {
        let mut scene = scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0), other]);
        // Four seconds of future.
        scene.dt_s = 0.5;
        CutIn::new(CutInConfig::default()).feasible(&scene, &[0, 1])
    }

    fn drive(x: f64, y: f64, heading_rad: f64, speed_mps: f64) -> Drive {
        Drive::straight(x, y, heading_rad, speed_mps)
    }

    #[test]
    fn who_drives_beside_and_ahead_can_cut_in_within_the_limits_of_driving() {
        let found = outcomes(drive(12.0, 3.5, 0.0, 10.0));
        assert!(!found.is_empty());
        for outcome in &found {
            let value = |name| outcome.get(name).unwrap();
            // Which side, and nobody brakes or accelerates more than the limits within the future of the scene.
            assert_eq!(value("side"), 1.0);
            let changed_mps = value("other_speed_mps") - 10.0;
            assert!((-4.0 * 4.0..=2.5 * 4.0).contains(&changed_mps), "{changed_mps}");
            assert!((value("relative_speed_mps") + changed_mps).abs() < 1e-9);
            assert!((0.0..=1.0).contains(&outcome.effort()));
        }
    }

    #[test]
    fn who_is_in_the_way_behind_or_comes_toward_cannot() {
        for impossible in [
            drive(12.0, 0.5, 0.0, 10.0),
            drive(-30.0, 3.5, 0.0, 10.0),
            drive(12.0, 3.5, std::f64::consts::PI, 10.0),
            drive(12.0, 40.0, 0.0, 10.0),
        ] {
            assert!(outcomes(impossible).is_empty());
        }
    }
}
