//! Passing a place shortly before another agent gets there, as in left turns across oncoming traffic: both continue
//! along their ways, and the other gives no more gas once it sees the first coming, eases off, or brakes if it has to.

use super::{Driver, Maneuver, Pace};
use crate::behavior::footprint::{Bounds, Footprint};
use crate::behavior::lane_relation::SceneLanes;
use crate::behavior::limits::{REACTIONS_S, effort};
use crate::behavior::template::InTheWay;
use crate::scene::{Extent, Scene};
use std::f64::consts::FRAC_PI_6;

/// Accelerations of the agent that goes first, and of the other until it brakes, m/s².
const FIRST_MPS2: [f64; 4] = [0.0, 0.8, 1.6, 2.4];
const OTHER_MPS2: [f64; 4] = [0.0, 0.6, 1.25, -1.0];
/// How long before the first gets into its way the other sees it coming and gives no more gas, seconds.
const NOTICES_S: f64 = 1.5;
/// How hard the other brakes, m/s², if it would follow by at least this, seconds; and how hard it accelerates once it
/// can, or this long after the first has left its way; if it has braked for this long.
const BRAKES_MPS2: [f64; 3] = [1.5, 3.8, 5.5];
const FOLLOWS_S: [f64; 3] = [1.0, 0.5, 0.0];
const SEES_IT_LEAVE_S: f64 = 0.4;
const GOES_ON_MPS2: f64 = 0.5;
const LEAST_BRAKING_S: f64 = 0.5;
/// No agent brakes so hard without need that it would stop within this time, seconds.
const LEAST_STOPPING_S: f64 = 1.5;
/// Spacing of the times at which the other is tried to let go of the brake, seconds.
const GOES_ON_SPACING_S: f64 = 0.3;
/// How far apart the boxes stay, meters.
const APART_M: f64 = 0.4;
/// Agents that head along the way of the other within this do not cross it, radians.
const FOLLOWING_RAD: f64 = FRAC_PI_6;
/// The longest time between the two agents being in a place, seconds, and the spacing by which maneuvers are
/// distinguished.
const MOST_DELAY_S: f64 = 2.5;
const DELAY_SPACING_S: f64 = 0.4;

/// A drive along a rail.
struct RailDrive {
    rail: usize,
    mps2: f64,
    driven_m: Vec<f64>,
    boxes: Vec<Footprint>,
    bounds: Bounds,
}

/// Two agents by their ways, the first of which passes ahead of the other.
struct Pair<'a> {
    first: &'a Driver,
    other: &'a Driver,
    extents: [Extent; 2],
    dt_s: f64,
}

/// Maneuvers in which the first of `agents` passes a place across the way of the other shortly before that one. Their
/// outcomes name `parameters`.
pub(super) fn passing_ahead(scene: &Scene, agents: [usize; 2], parameters: &'static [&'static str]) -> Vec<Maneuver> {
    let lanes = SceneLanes::new(&scene.lanes);
    let drivers = agents.map(|agent_idx| Driver::new(scene, &lanes, agent_idx));
    let [Some(first), Some(other)] = &drivers else { return Vec::new() };
    let extents = agents.map(|agent_idx| scene.tracks[agent_idx].extent_or_nominal());
    let pair = Pair { first, other, extents, dt_s: scene.dt_s };
    let paces = |driver: &Driver, mps2: &'static [f64]| {
        (0..driver.rails.len()).flat_map(move |rail| mps2.iter().map(move |mps2| (rail, *mps2)))
    };
    let course = |(driver, extent), (rail, mps2)| RailDrive::new(driver, extent, rail, mps2, &Pace::steady(mps2));
    let firsts: Vec<RailDrive> =
        paces(first, &FIRST_MPS2).filter_map(|pace| course((first, extents[0]), pace)).collect();
    let others: Vec<RailDrive> =
        paces(other, &OTHER_MPS2).filter_map(|pace| course((other, extents[1]), pace)).collect();
    let pairs = firsts.iter().flat_map(|own| others.iter().map(move |theirs| (own, theirs)));
    pairs.flat_map(|(own, theirs)| pair.maneuvers(own, theirs, parameters)).collect()
}

impl Pair<'_> {
    /// The maneuvers in which the first agent drives as given, and the other does so until it sees the first coming.
    fn maneuvers(&self, own: &RailDrive, theirs: &RailDrive, parameters: &'static [&'static str]) -> Vec<Maneuver> {
        let Some((enters, delay)) = own.passes_ahead_of(theirs, (MOST_DELAY_S / self.dt_s) as usize) else {
            return Vec::new();
        };
        let [enters_s, leaves_s] = [enters, own.last_in_way_of(theirs)].map(|step| (step + 1) as f64 * self.dt_s);
        let latest_s = leaves_s + SEES_IT_LEAVE_S;
        let eased = Pace::steady(theirs.mps2).then((enters_s - NOTICES_S).max(0.0), theirs.mps2.min(0.0));
        let delay_s = delay as f64 * self.dt_s;
        let hard_enough = FOLLOWS_S.iter().position(|least_s| delay_s >= *least_s).unwrap_or_default();
        let stopping_mps2 = self.other.state.speed_mps() / LEAST_STOPPING_S;
        let ordinary = BRAKES_MPS2.iter().rposition(|mps2| *mps2 <= stopping_mps2).unwrap_or_default();
        let spacing = (DELAY_SPACING_S / self.dt_s).max(1.0) as usize;
        let maneuver = |reacts_s: f64, (nth, brakes_mps2): (usize, &f64)| {
            let brakes_s = enters_s + reacts_s;
            let earliest_s = brakes_s + LEAST_BRAKING_S;
            let n_times = ((latest_s - earliest_s) / GOES_ON_SPACING_S).ceil().max(0.0) as usize;
            let drive = |pace: &Pace| RailDrive::new(self.other, self.extents[1], theirs.rail, theirs.mps2, pace);
            let pace = eased.clone().then(brakes_s, theirs.mps2.min(-brakes_mps2));
            // It lets go of the brake as soon as that keeps the distance.
            let mut times = (0..=n_times).map(|i| earliest_s + i as f64 * GOES_ON_SPACING_S);
            let braking = times.find_map(|goes_on_s| {
                drive(&pace.clone().then(goes_on_s, GOES_ON_MPS2)).filter(|braking| own.keeps(braking, APART_M))
            })?;
            Some(Maneuver {
                kind: [own.rail * self.other.rails.len() + theirs.rail, nth * 100 + delay / spacing],
                effort: effort(own.mps2).max(effort(theirs.mps2)),
                parameters,
                in_the_way: Some(InTheWay::Ahead),
                others: Vec::new(),
                positions: vec![
                    self.first.positions(own.rail, &own.driven_m),
                    self.other.positions(theirs.rail, &braking.driven_m),
                ],
            })
        };
        // No harder than it has to, but like a driver who sees how close it is.
        let mut hard = BRAKES_MPS2.iter().enumerate().skip(hard_enough.min(ordinary));
        hard.find_map(|braking| REACTIONS_S.into_iter().find_map(|reacts_s| maneuver(reacts_s, braking)))
            .into_iter()
            .collect()
    }
}

impl RailDrive {
    fn new(driver: &Driver, extent: Extent, rail: usize, mps2: f64, pace: &Pace) -> Option<Self> {
        let driven_m = driver.travel(rail, pace).driven_m;
        let boxes = driver.boxes(rail, &driven_m, extent);
        let bounds = boxes.iter().map(|body| body.bounds).reduce(Bounds::union)?;
        Some(Self { rail, mps2, driven_m, boxes, bounds })
    }

    /// The first step at which it is where the other is later, across its way, and the shortest delay of the other.
    /// `None` if the other is there first, or more than `most_delay` steps later.
    fn passes_ahead_of(&self, other: &Self, most_delay: usize) -> Option<(usize, usize)> {
        if !self.bounds.is_within(&other.bounds, 0.0) {
            return None;
        }
        let is_there = |own: &Footprint, theirs: &Footprint| {
            own.forward.dot(theirs.forward) < FOLLOWING_RAD.cos() && own.overlaps(theirs)
        };
        // For each own step, the first step at which the other is there.
        let n_steps = self.boxes.len();
        let arrivals: Vec<(usize, usize)> = (0..n_steps)
            .filter(|step| self.boxes[*step].bounds.is_within(&other.bounds, 0.0))
            .filter_map(|step| {
                let body = &self.boxes[step];
                Some((step, other.boxes.iter().position(|theirs| is_there(body, theirs))?))
            })
            .collect();
        let (enters, _) = *arrivals.first()?;
        let is_first = arrivals.iter().all(|(_, arrives)| *arrives > enters);
        let delay = arrivals.iter().map(|(step, arrives)| arrives.saturating_sub(*step)).min()?;
        (is_first && delay <= most_delay).then_some((enters, delay))
    }

    /// The last step at which it is anywhere that the other is at some time.
    fn last_in_way_of(&self, other: &Self) -> usize {
        let is_there = |own: &&Footprint| {
            own.bounds.is_within(&other.bounds, 0.0) && other.boxes.iter().any(|theirs| own.overlaps(theirs))
        };
        self.boxes.iter().rposition(|own| is_there(&own)).unwrap_or_default()
    }

    /// Whether the boxes of the two always stay this far apart.
    fn keeps(&self, other: &Self, distance_m: f64) -> bool {
        !self.boxes.iter().zip(&other.boxes).any(|(own, others)| own.is_closer_than(others, distance_m))
    }
}
