//! Which cut-ins can a pair of vehicles still show?

use super::CutIn;
use crate::behavior::kept_lane::KeptLane;
use crate::behavior::lane_relation::SceneLanes;
use crate::behavior::limits::{ACCELERATIONS_MPS2, effort, horizon_s};
use crate::behavior::outcome::Outcome;
use crate::behavior::sideways::{CHANGE_PEAK, CUT_IN, Manner};
use crate::behavior::template::settled_mps;
use crate::geometry::{Vec2, angle_difference};
use crate::scene::Scene;

/// Spacing of the tried accelerations, m/s², and times, seconds.
const SPACING_MPS2: f64 = 0.5;
const SPACING_S: f64 = 0.25;
/// The least headway of drivers who are in no hurry, seconds: of 34 recorded cut-ins, the least begins at 0.27 s,
/// and 95 % at 0.4 s or more.
const LEAST_HEADWAY_S: f64 = 0.4;
/// The smallest gap, and by how much a corner of a box that is turned enters the path before its side, meters.
const LEAST_GAP_M: f64 = 0.3;
const CORNER_M: f64 = 0.2;
/// How long before the end of the scene the ego must reach the place where the other came in, even if it brakes,
/// seconds.
const TO_SPARE_S: f64 = 0.5;
/// A vehicle that drifts away from the ego's lane faster than this does not cut in at once, m/s.
const AWAY_MPS: f64 = 0.5;
/// A vehicle farther than this from the middle of its lane is between lanes, meters.
const IN_LANE_M: f64 = 0.9;
/// How much slower a vehicle becomes before it cuts in than it was, or than a slower one close ahead, m/s: nine of ten
/// of 34 recorded ones lose less within 3 s. Close is what it comes to within the former time at its speed, or within
/// the latter at the speed at which the gap closes, seconds.
const LOSES_MPS: f64 = 1.5;
const CLOSE_S: f64 = 2.0;
const CLOSES_S: f64 = 5.0;
/// Below this speed an agent stands, m/s, and there is no cut-in.
const STANDING_MPS: f64 = 1.0;

/// A pair in which one could cut in before the other, judged from the past.
pub(super) struct Pair {
    /// The lane that the ego keeps, and how far beside its center line the ego drives, meters.
    pub(super) lane: KeptLane,
    pub(super) own_offset_m: f64,
    /// The lane that the other keeps, and its position there, meters.
    pub(super) their_lane: KeptLane,
    pub(super) their_station_m: f64,
    pub(super) their_offset_m: f64,
    /// The other's speed along the ego's lane, and the ego's, m/s, once they let go of their pedals.
    pub(super) their_mps: f64,
    /// The other's least speed when it cuts in, m/s.
    pub(super) least_mps: f64,
    pub(super) own_station_m: f64,
    pub(super) own_mps: f64,
    /// Sizes of the ego and the other, meters.
    pub(super) widths_m: [f64; 2],
    pub(super) lengths_m: [f64; 2],
    /// The side from which the other comes: 1 for the left, -1 for the right.
    pub(super) side: f64,
    /// How the other moves over.
    pub(super) manner: Manner,
    /// Everybody else ahead of the ego in its lane: the station, meters, and the speed along it, m/s.
    pub(super) ahead: Vec<[f64; 2]>,
    /// From the present to the end of the scene, seconds.
    pub(super) horizon_s: f64,
}

pub(super) struct CutInPlan {
    /// When the boxes begin to share a path, seconds after the present.
    pub(super) time_s: f64,
    /// The other's speed then, m/s; it changes at a constant rate.
    pub(super) then_mps: f64,
    /// How far the other's lane is from the ego's path at that time, and how far the other has to move over, meters.
    pub(super) aside_m: f64,
    pub(super) shift_m: f64,
    pub(super) outcome: Outcome,
}

impl CutIn {
    /// The pair, if the other could cut in at all.
    pub(super) fn pair(&self, scene: &Scene, ego_idx: usize, other_idx: usize) -> Option<Pair> {
        let lanes = SceneLanes::new(&scene.lanes);
        let (ego, other) = (scene.tracks.get(ego_idx)?, scene.tracks.get(other_idx)?);
        let at_present = |idx: usize| scene.state(idx, scene.current_timestep()).filter(|state| state.is_finite());
        let (own, theirs) = (at_present(ego_idx)?, at_present(other_idx)?);
        let lane = KeptLane::as_observed(scene, &lanes, ego_idx)?;
        let (own_place, place) = (lane.project(own.position)?, lane.project(theirs.position)?);
        let turned_rad = angle_difference(theirs.heading_rad, place.heading_rad).abs();
        let their_mps = theirs.velocity.dot(Vec2::from_angle(place.heading_rad));
        let own_mps = settled_mps(scene, ego_idx, own.speed_mps());
        let their_mps = settled_mps(scene, other_idx, their_mps);
        let is_possible = [ego, other].iter().all(|track| track.class.is_motorized())
            && turned_rad < super::ALONG_RAD
            && own_place.offset_m.abs() < IN_LANE_M
            && own_mps.min(their_mps) >= STANDING_MPS
            && !lane.holds(theirs.position);
        let side = if place.offset_m < own_place.offset_m { -1.0 } else { 1.0 };
        let away_mps = side * Vec2::from_angle(place.heading_rad).cross(theirs.velocity);
        let (own_extent, their_extent) = (ego.extent_or_nominal(), other.extent_or_nominal());
        // A vehicle that is partly in the ego's path already cannot cut into it.
        let across_m = their_extent.length_m * turned_rad.sin() + their_extent.width_m * turned_rad.cos();
        let is_aside = (place.offset_m - own_place.offset_m).abs() > (own_extent.width_m + across_m) / 2.0;
        if !is_possible || !is_aside || away_mps >= AWAY_MPS {
            return None;
        }
        let their_lane =
            KeptLane::as_observed(scene, &lanes, other_idx).unwrap_or_else(|| KeptLane::straight_on(theirs));
        let their_place = their_lane.project(theirs.position)?;
        let in_egos = ahead(scene, &lane, [ego_idx, other_idx], own_place.station_m);
        let in_own = ahead(scene, &their_lane, [ego_idx, other_idx], their_place.station_m);
        let before = |[station_m, mps]: &&[f64; 2], from_m: f64| {
            let close_m = (CLOSE_S * their_mps).max(CLOSES_S * (their_mps - mps));
            (0.0..close_m).contains(&(station_m - from_m))
        };
        let leaders = in_egos.iter().filter(|leader| before(leader, place.station_m));
        let leaders = leaders.chain(in_own.iter().filter(|leader| before(leader, their_place.station_m)));
        let slowest_mps = leaders.map(|[_, mps]| *mps).fold(their_mps, f64::min);
        Some(Pair {
            own_offset_m: own_place.offset_m,
            their_station_m: their_place.station_m,
            their_offset_m: their_place.offset_m,
            their_mps,
            least_mps: (slowest_mps - LOSES_MPS * self.hurry).max(STANDING_MPS),
            own_station_m: own_place.station_m,
            own_mps,
            widths_m: [own_extent.width_m, their_extent.width_m],
            lengths_m: [own_extent.length_m, their_extent.length_m],
            side,
            manner: CUT_IN.of(self.hurry, their_extent.length_m),
            ahead: in_egos,
            horizon_s: horizon_s(scene),
            lane,
            their_lane,
        })
    }

    /// The plans on a grid of times and of mean accelerations whose peaks are within the limits.
    pub(super) fn plans(&self, pair: &Pair) -> Option<Vec<CutInPlan>> {
        let n = |range: f64, spacing: f64| (range / spacing).floor().max(0.0) as i32;
        let [hardest, most] = [ACCELERATIONS_MPS2.start(), ACCELERATIONS_MPS2.end()]
            .map(|mps2| n(mps2.abs() / CHANGE_PEAK, SPACING_MPS2));
        let mut plans = Vec::new();
        for time_s in (1..=n(pair.horizon_s, SPACING_S)).map(|i| f64::from(i) * SPACING_S) {
            for acceleration_mps2 in (-hardest..=most).map(|i| f64::from(i) * SPACING_MPS2) {
                plans.extend(self.plan(pair, time_s, acceleration_mps2)?);
            }
        }
        Some(plans)
    }

    /// The plan to cut in after `time_s` with this acceleration. `Some(None)` if it exceeds the limits, or the ego does
    /// not reach the place where the other came in.
    fn plan(&self, pair: &Pair, time_s: f64, acceleration_mps2: f64) -> Option<Option<CutInPlan>> {
        let Pair { own_mps, lengths_m: [own_length_m, their_length_m], .. } = *pair;
        let then_mps = pair.their_mps + acceleration_mps2 * time_s;
        if then_mps < pair.least_mps {
            return Some(None);
        }
        let driven_m = (pair.their_mps + then_mps) / 2.0 * time_s;
        // Its position in its own lane, at the present offset from the center line.
        let on_lane = pair.their_lane.point_at(pair.their_station_m + driven_m)?;
        let then = pair.lane.project(on_lane)?;
        let half_lengths_m = (own_length_m + their_length_m) / 2.0;
        let gap_m = then.station_m - pair.own_station_m - own_mps * time_s - half_lengths_m;
        // Nobody may be between the two.
        if pair.ahead.iter().any(|[station_m, mps]| station_m + mps * time_s < then.station_m) {
            return Some(None);
        }
        // The ego must get there before the scene ends.
        let left_s = self.max_delay_s.min(pair.horizon_s - TO_SPARE_S - time_s);
        let least_m = LEAST_GAP_M.max(LEAST_HEADWAY_S / self.hurry * own_mps);
        if !(least_m..own_mps * left_s).contains(&gap_m) {
            return Some(None);
        }
        let aside_m = (then.offset_m + pair.their_offset_m - pair.own_offset_m).abs();
        let half_widths_m = (pair.widths_m[0] + pair.widths_m[1]) / 2.0;
        let shift_m = (aside_m - half_widths_m - CORNER_M).max(0.0);
        let fastest = pair.manner.fastest(aside_m);
        let least_s = fastest.reaches_s(shift_m);
        if least_s > time_s {
            return Some(None);
        }
        // Its center must be in the lane, too, before the scene ends.
        let beyond_m = pair.lane.beyond_m(on_lane, pair.side)? + pair.side * pair.their_offset_m;
        let crossed_s = time_s - least_s + fastest.reaches_s(beyond_m.clamp(shift_m, aside_m));
        if crossed_s > pair.horizon_s - TO_SPARE_S {
            return Some(None);
        }
        let relative_mps = own_mps - then_mps;
        let outcome = Outcome::default()
            .with("gap_m", gap_m)
            .with("relative_speed_mps", relative_mps)
            .with("ego_speed_mps", own_mps)
            .with("other_speed_mps", then_mps)
            .with("ttc_s", (relative_mps > 0.1).then(|| gap_m / relative_mps))
            .with("time_headway_s", gap_m / own_mps)
            .with("side", pair.side)
            .with("ego_length_m", own_length_m)
            .with("other_length_m", their_length_m)
            .at_effort(effort(acceleration_mps2).max((least_s / time_s).powi(2)));
        Some(Some(CutInPlan { time_s, then_mps, aside_m, shift_m, outcome }))
    }
}

/// Those in a lane ahead of a station but this pair: their stations, meters, and speeds along the lane, m/s.
fn ahead(scene: &Scene, lane: &KeptLane, pair: [usize; 2], own_station_m: f64) -> Vec<[f64; 2]> {
    let others = (0..scene.tracks.len()).filter(|agent_idx| !pair.contains(agent_idx));
    let present = others.filter_map(|agent_idx| scene.state(agent_idx, scene.current_timestep()));
    let in_lane = present.filter(|state| state.is_finite() && lane.holds(state.position));
    let places = in_lane.filter_map(|state| {
        let place = lane.project(state.position)?;
        Some([place.station_m, state.velocity.dot(Vec2::from_angle(place.heading_rad))])
    });
    places.filter(|[station_m, _]| *station_m > own_station_m).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::behavior::Behavior;
    use crate::scene::testing::{Drive, scene};
    use crate::scene::{State, Trajectory};

    /// The scene with timesteps of half a second, and so four seconds of future.
    fn slowed(mut scene: Scene) -> Scene {
        let (present, dt_s) = (scene.current_timestep() as f64, 0.5);
        for track in &mut scene.tracks {
            let now = *track.trajectory.get(present as usize).unwrap();
            let entries = track.trajectory.entries().iter().enumerate().map(|(t, state)| {
                state.map(|state| State {
                    position: now.position + now.velocity * ((t as f64 - present) * dt_s),
                    ..state
                })
            });
            track.trajectory = Trajectory::new(entries.collect());
        }
        Scene { dt_s, ..scene }
    }

    /// Reachable outcomes of the second of two cars ahead of the first, which drives along x at 10 m/s.
    fn outcomes(other: Drive) -> Vec<Outcome> {
        let scene = slowed(scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0), other]));
        CutIn::default().feasible(&scene, &[0, 1])
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
            // The side, and nobody brakes or accelerates beyond the limits within the future of the scene.
            assert_eq!(value("side"), 1.0);
            let changed_mps = value("other_speed_mps") - 10.0;
            assert!((-4.0 * 4.0..=2.5 * 4.0).contains(&changed_mps), "{changed_mps}");
            assert!((value("relative_speed_mps") + changed_mps).abs() < 1e-9);
            assert!((0.0..=1.0).contains(&outcome.effort()));
        }
    }

    #[test]
    fn the_way_aside_takes_its_share_of_the_time() {
        // 3.3 m aside, less 1.8 m of two half widths and 0.2 m of a corner: 1.3 m. A speed of 1.43 m/s is reached
        // within 1.0725 s and half as many times 1.43 m, and the rest takes 0.373 s. At its speed, 7.5 m ahead of an
        // ego that needs 0.75 s for them, it can come in after 1.5 to 2.5 of the 4 s: 2.75 would leave too little time.
        let found = outcomes(drive(12.0, 3.3, 0.0, 10.0));
        let at_its_speed = found.iter().filter(|outcome| outcome.get("relative_speed_mps") == Some(0.0));
        let efforts: Vec<f64> = at_its_speed.map(Outcome::effort).collect();
        let least_s: f64 = 1.0725 / 2.0 + 1.3 / 1.43;
        let expected = [2.5, 2.25, 2.0, 1.75, 1.5].map(|time_s| (least_s / time_s).powi(2));
        assert!(efforts.len() >= 3, "{efforts:?}");
        for (effort, expected) in efforts.iter().rev().zip(expected) {
            assert!((effort - expected).abs() < 1e-6, "{effort}, {expected}");
        }
    }

    #[test]
    fn who_is_behind_a_third_cannot_be_cut_off() {
        let behind = |third: Drive| {
            let pair = [drive(0.0, 0.0, 0.0, 10.0), drive(12.0, 3.5, 0.0, 10.0)];
            let scene = slowed(scene(&[pair[0], pair[1], third]));
            CutIn::default().feasible(&scene, &[0, 1]).len()
        };
        let n = outcomes(drive(12.0, 3.5, 0.0, 10.0)).len();
        // Between the two, as fast; far ahead, and behind.
        assert_eq!([7.0, 60.0, -60.0].map(|x| behind(drive(x, 0.0, 0.0, 10.0))), [0, n, n]);
    }

    #[test]
    fn the_future_is_not_looked_at() {
        let known = slowed(scene(&[drive(0.0, 0.0, 0.0, 10.0), drive(12.0, 3.5, 0.0, 10.0)]));
        let mut unknown = known.clone();
        for track in &mut unknown.tracks {
            let observed = |t: usize| track.trajectory.get(t).copied().filter(|_| t < known.n_history);
            track.trajectory = Trajectory::new((0..known.n_timesteps).map(observed).collect());
        }
        let of = |scene: &Scene| CutIn::default().feasible(scene, &[0, 1]);
        assert!(!of(&known).is_empty());
        assert_eq!(of(&known), of(&unknown));
    }

    #[test]
    fn who_is_in_the_way_behind_or_comes_toward_cannot() {
        for impossible in [
            drive(12.0, 0.5, 0.0, 10.0),
            drive(12.0, 1.7, 0.0, 10.0),
            drive(-30.0, 3.5, 0.0, 10.0),
            drive(12.0, 3.5, std::f64::consts::PI, 10.0),
            drive(12.0, 40.0, 0.0, 10.0),
        ] {
            assert!(outcomes(impossible).is_empty());
        }
    }
}
