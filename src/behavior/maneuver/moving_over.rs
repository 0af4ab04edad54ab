//! Moving over to the lane beside, as in lane changes and cut-outs, or to the oncoming one.

use super::reason::Others;
use super::{Driver, Pace};
use crate::behavior::kept_lane::KeptLane;
use crate::behavior::lane_relation::SceneLanes;
use crate::behavior::limits::effort;
use crate::behavior::sideways::{LANE_CHANGE, Manner, OVERTAKING};
use crate::behavior::template::MOST_ANGLE_RAD;
use crate::geometry::{OrientedBox, Vec2, angle_difference};
use crate::scene::{Extent, STANDING_STEP_M, Scene};
use std::f64::consts::FRAC_PI_4;

/// A vehicle is in a lane only if it heads along it within this angle, radians.
const ALONG_RAD: f64 = FRAC_PI_4;
/// The least speed at which vehicles move over, m/s.
const LEAST_SPEED_MPS: f64 = 2.0;
/// When moving over begins, earlier by up to this, as drivers differ, seconds.
const BEGINS_S: [f64; 3] = [0.3, 0.9, 1.5];
const EARLIER_S: f64 = 0.3;
/// The least headway in the new lane, seconds, and from how long before being midway between the lanes on, when the
/// first corner is over the line; how hard the faster of two agents slows down there, m/s²; and the least distance
/// between two bodies on the way, meters.
const ROOM_S: f64 = 0.7;
const OVER_LINE_S: f64 = 0.5;
const ORDINARY_BRAKING_MPS2: f64 = 2.0;
const CLEARANCE_M: f64 = 0.6;
/// For how long before being midway nobody is alongside in the new lane, seconds, and how far aside that is between
/// the bodies, meters.
const LOOKS_BESIDE_S: f64 = 1.2;
const NEW_LANE_M: f64 = 2.5;
/// Accelerations along the lane, m/s², and how long they last, seconds.
const ALONG_MPS2: [f64; 3] = [0.0, 0.8, -0.6];
const ALONG_S: f64 = 2.5;
/// An agent that moves to the other side at present faster than this does not move over, m/s.
const AWAY_MPS: f64 = 0.3;
/// Who moves aside faster than this leaves its lane, m/s.
const LEAVES_MPS: f64 = 0.5;

/// One way to move over.
pub(super) struct MovingOver {
    /// The side: 1 for the left, -1 for the right.
    pub(super) side: f64,
    /// Whether the agent slows down for it.
    pub(super) slows: bool,
    /// When the center is midway between the lanes, seconds after the present.
    pub(super) midway_s: f64,
    /// The share of the limits of driving that it uses.
    pub(super) effort: f64,
    /// The positions at present and at each timestep after it.
    pub(super) positions: Vec<Vec2>,
}

/// The ways in which an agent can move over to a lane beside its own, at most `hurry` times as fast as drivers do.
/// Empty if it is in no lane, or too slow.
pub(super) fn ways_over(scene: &Scene, lanes: &SceneLanes<'_>, agent_idx: usize, hurry: f64) -> Vec<MovingOver> {
    let Some(driver) = Driver::new(scene, lanes, agent_idx) else { return Vec::new() };
    let now = driver.state;
    let is_along = |heading_rad: f64| angle_difference(heading_rad, now.heading_rad).abs() < ALONG_RAD;
    let own = lanes.lanes_at(now.position).filter(|(_, place)| is_along(place.heading_rad));
    let mut beside: Vec<_> = own.flat_map(|(own, _)| lanes.beside(own, now.position)).collect();
    beside.sort_by_key(|(lane, side)| (lane.lane.id, *side > 0.0));
    beside.dedup_by_key(|(lane, side)| (lane.lane.id, *side > 0.0));
    let targets = beside.into_iter().map(|(lane, side)| (KeptLane::from_lane(lanes, lane), side));
    let manner = LANE_CHANGE.of(hurry, scene.tracks[agent_idx].extent_or_nominal().length_m);
    targets.flat_map(|(target, side)| over_to(scene, &driver, &target, side, manner)).collect()
}

/// The ways in which an agent can move over to an oncoming lane beside its own, to drive against it.
pub(super) fn ways_over_to_oncoming(scene: &Scene, lanes: &SceneLanes<'_>, agent_idx: usize) -> Vec<MovingOver> {
    let Some(driver) = Driver::new(scene, lanes, agent_idx) else { return Vec::new() };
    let oncoming = lanes.oncoming(driver.state.position, driver.state.heading_rad).into_iter();
    let targets = oncoming.map(|(lane, side)| (KeptLane::from_lane(lanes, lane).reversed(), side));
    let manner = OVERTAKING.of(1.0, scene.tracks[agent_idx].extent_or_nominal().length_m);
    targets.flat_map(|(target, side)| over_to(scene, &driver, &target, side, manner)).collect()
}

impl MovingOver {
    /// Whether an agent that moves over has room beside `all` agents but some: see [`has_room`].
    pub(super) fn has_room(&self, scene: &Scene, agent_idx: usize, all: &Others, but: &[usize]) -> bool {
        has_room(scene, agent_idx, (self.side, self.midway_s, &self.positions), all, but)
    }
}

/// All agents as they go on from the present at their speeds: along the lanes in which they drive, or straight on where
/// they are in none, or leave it.
pub(in crate::behavior) fn going_on(scene: &Scene, lanes: &SceneLanes<'_>) -> Others {
    let n_steps = scene.n_timesteps - scene.current_timestep();
    let goes_on = |idx: usize| {
        let now = scene.state(idx, scene.current_timestep()).filter(|state| state.is_finite())?;
        let lane = KeptLane::as_observed(scene, lanes, idx);
        let lane = lane.and_then(|lane| Some((lane.project(now.position)?, lane)));
        let lane = lane.filter(|(place, _)| Vec2::from_angle(place.heading_rad).cross(now.velocity).abs() < LEAVES_MPS);
        let position = |step: usize| {
            let elapsed_s = step as f64 * scene.dt_s;
            let on_lane = lane.as_ref().and_then(|(place, lane)| {
                let mps = now.velocity.dot(Vec2::from_angle(place.heading_rad));
                lane.beside(place.station_m + mps * elapsed_s, place.offset_m)
            });
            on_lane.unwrap_or(now.position + now.velocity * elapsed_s)
        };
        Some((idx, (0..n_steps).map(position).collect()))
    };
    (0..scene.tracks.len()).filter_map(goes_on).collect()
}

/// Whether an agent that moves over to this side (1 for the left, -1 for the right), is midway between two lanes after
/// this many seconds, and at these positions at present and at each timestep after it, has room beside `all` agents but
/// some, which are [`going_on`]: none closer than [`CLEARANCE_M`]; in its new lane, nobody alongside for the last
/// [`LOOKS_BESIDE_S`] before that, and a headway of [`ROOM_S`] to the agents ahead and behind, beyond the distance in
/// which the faster one slows down to the other, from [`OVER_LINE_S`] before that on.
pub(in crate::behavior) fn has_room(
    scene: &Scene,
    agent_idx: usize,
    (side, midway_s, positions): (f64, f64, &[Vec2]),
    all: &Others,
    but: &[usize],
) -> bool {
    let own = scene.tracks[agent_idx].extent_or_nominal();
    let mut others = all.iter().filter(|(idx, _)| *idx != agent_idx && !but.contains(idx));
    others.all(|(idx, theirs)| {
        let their = scene.tracks[*idx].extent_or_nominal();
        let both = positions.windows(2).zip(theirs.windows(2));
        let keeps_distance = both.enumerate().all(|(step, (pair, their_pair))| {
            let moved = pair[1] - pair[0];
            let forward = moved * moved.norm().max(f64::MIN_POSITIVE).recip();
            let offset = their_pair[1] - pair[1];
            let (along_m, aside_m) = (offset.dot(forward), side * forward.cross(offset));
            let gap_m = along_m.abs() - (own.length_m + their.length_m) / 2.0;
            let half_widths_m = (own.width_m + their.width_m) / 2.0;
            let speeds_mps = [moved.norm() / scene.dt_s, (their_pair[1] - their_pair[0]).dot(forward) / scene.dt_s];
            let [ahead_mps, behind_mps] = if along_m > 0.0 { [speeds_mps[1], speeds_mps[0]] } else { speeds_mps };
            let slows_m = (behind_mps - ahead_mps).max(0.0).powi(2) / (2.0 * ORDINARY_BRAKING_MPS2);
            let until_s = midway_s - step as f64 * scene.dt_s;
            let is_in_new_lane = (half_widths_m..half_widths_m + NEW_LANE_M).contains(&aside_m);
            let is_alongside = (0.0..LOOKS_BESIDE_S).contains(&until_s) && is_in_new_lane && gap_m <= 0.0;
            !is_alongside
                && (until_s > OVER_LINE_S
                    || aside_m.abs() > half_widths_m
                    || gap_m > ROOM_S * behind_mps.max(0.0) + slows_m)
        });
        keeps_distance && is_clear_of(scene, [agent_idx, *idx], [positions, theirs])
    })
}

/// Whether two agents at these positions, at present and at each timestep after it, stay [`CLEARANCE_M`] apart.
pub(super) fn is_clear_of(scene: &Scene, agents: [usize; 2], positions: [&[Vec2]; 2]) -> bool {
    let mut headings_rad = agents.map(|idx| scene.state(idx, scene.current_timestep()).map_or(0.0, |s| s.heading_rad));
    (1..positions[0].len().min(positions[1].len())).all(|step| {
        let [own, other] = std::array::from_fn(|i| {
            let moved = positions[i][step] - positions[i][step - 1];
            if moved.norm() >= STANDING_STEP_M {
                headings_rad[i] = moved.angle();
            }
            let Extent { length_m, width_m } = scene.tracks[agents[i]].extent_or_nominal();
            let margin_m = if i == 0 { 2.0 * CLEARANCE_M } else { 0.0 };
            OrientedBox {
                center: positions[i][step],
                heading_rad: headings_rad[i],
                length_m: length_m + margin_m,
                width_m: width_m + margin_m,
            }
        });
        !own.overlaps(&other)
    })
}

/// The ways in which a driver can move over to a lane on this side. Empty if it is too slow.
fn over_to(scene: &Scene, driver: &Driver, target: &KeptLane, side: f64, manner: Manner) -> Vec<MovingOver> {
    let now = driver.state;
    let Some(there) = target.project(now.position) else { return Vec::new() };
    let aside_m = there.offset_m.abs();
    let toward_mps = -there.offset_m.signum() * Vec2::from_angle(there.heading_rad).cross(now.velocity);
    let mut found = Vec::new();
    if now.speed_mps() < LEAST_SPEED_MPS || toward_mps < -AWAY_MPS {
        return found;
    }
    for (along_mps2, rail) in ALONG_MPS2.iter().flat_map(|mps2| (0..driver.rails.len()).map(move |rail| (*mps2, rail)))
    {
        let driven_m = driver.travel(rail, &Pace::steady(along_mps2).then(ALONG_S, 0.0)).driven_m;
        let on_own = driver.positions(rail, &driven_m);
        let on_target: Option<Vec<Vec2>> =
            on_own.iter().map(|at| target.point_at(target.project(*at)?.station_m)).collect();
        let Some(on_target) = on_target else { continue };
        let begins_s = BEGINS_S.map(|begins_s| begins_s - EARLIER_S * driver.style);
        for (begins_s, over) in begins_s.into_iter().flat_map(|b| manner.ways(aside_m, 1.0).map(move |over| (b, over)))
        {
            let lasts_s = over.takes_s().min(driven_m.len() as f64 * scene.dt_s - begins_s);
            let driven_m = |until_s: f64| driven_m[((until_s / scene.dt_s) as usize).clamp(1, driven_m.len()) - 1];
            let along_m = driven_m(begins_s + lasts_s) - if begins_s > 0.0 { driven_m(begins_s) } else { 0.0 };
            if over.mps * lasts_s > MOST_ANGLE_RAD.tan() * along_m {
                continue;
            }
            let share = |step: usize| over.share(step as f64 * scene.dt_s - begins_s);
            let both = on_own.iter().zip(&on_target).enumerate();
            let positions = both.map(|(step, (own, there))| own.lerp(*there, share(step))).collect();
            let midway_s = begins_s + over.midway_s();
            let effort = effort(along_mps2).max(over.mps / manner.mps[1]);
            found.push(MovingOver { side, slows: along_mps2 < 0.0, midway_s, effort, positions });
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::behavior::testing;
    use crate::scene::testing::{Drive, scene};

    #[test]
    fn nobody_squeezes_into_a_gap() {
        // At 10 m/s everywhere, a headway of .7 s is 7 m between bumpers.
        let way = |scene: &Scene| MovingOver {
            side: 1.0,
            slows: false,
            midway_s: 1.0,
            effort: 0.5,
            positions: (0..=20)
                .map(|step| {
                    let now = scene.state(0, scene.current_timestep()).unwrap().position;
                    now + Vec2::new(f64::from(step), 3.5 * f64::from(step) / 20.0)
                })
                .collect(),
        };
        let has_room = |scene: &Scene, but: &[usize]| {
            let all = going_on(&scene.lasting(scene.n_history + 30), &SceneLanes::new(&scene.lanes));
            way(scene).has_room(scene, 0, &all, but)
        };
        let length_m = |scene: &Scene| scene.tracks[0].extent_or_nominal().length_m;
        for (gap_m, expected) in [(4.0, false), (9.0, true)] {
            for side in [1.0, -1.0] {
                let at =
                    |y: f64, x: f64| scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0), Drive::straight(x, y, 0.0, 10.0)]);
                let away_m = side * (gap_m + length_m(&at(3.5, 50.0)));
                let beside = at(3.5, away_m);
                assert_eq!(has_room(&beside, &[]), expected, "{gap_m} m, {side}");
                assert!(has_room(&beside, &[1]), "whose gap is meant to be small");
                let away = at(-3.5, away_m);
                assert!(has_room(&away, &[]), "two lanes away");
            }
        }
        // Slower by 5 m/s, and 7.5 m ahead when the way is over.
        let slow = scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0), Drive::straight(22.0, 3.5, 0.0, 5.0)]);
        assert!(!has_room(&slow, &[]));
        // Alongside a second before being midway, and past by 2 m when the corner comes over the line.
        let passes = scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0), Drive::straight(-5.0, 3.5, 0.0, 30.0)]);
        assert!(!has_room(&passes, &[]));
        assert!(has_room(&passes, &[1]));
        // Two bodies beside each other, half a meter apart.
        let width_m = slow.tracks[0].extent_or_nominal().width_m;
        let both = [0.0, width_m + 0.5].map(|y| (0..5).map(|x| Vec2::new(f64::from(x), y)).collect::<Vec<_>>());
        assert!(!is_clear_of(&slow, [0, 1], [&both[0], &both[1]]));
        let apart: Vec<Vec2> = both[1].iter().map(|at| *at + Vec2::new(0.0, 0.2)).collect();
        assert!(is_clear_of(&slow, [0, 1], [&both[0], &apart]));
    }

    #[test]
    fn others_go_on_along_their_lanes() {
        // Toward an arc of 6 m to the right, that begins at y = -6: after 3 s, so far along it.
        let up = Drive::straight(0.0, -14.0, std::f64::consts::FRAC_PI_2, 5.0);
        let scene = testing::going_on(&[up], testing::merging_side_road());
        let all = going_on(&scene.lasting(scene.n_history + 30), &SceneLanes::new(&scene.lanes));
        let start_m = -6.0 - scene.state(0, scene.current_timestep()).unwrap().position.y;
        let (turned_rad, at) = ((15.0 - start_m) / 6.0, all[0].1[30]);
        let expected = Vec2::new(6.0 - 6.0 * turned_rad.cos(), 6.0 * turned_rad.sin() - 6.0);
        assert!(at.distance(expected) < 0.1, "{at:?}, expected {expected:?}");
    }
}
