//! The careful driver in place of an agent of a scene, whose others move as they do there.

use super::driver::CarefulDriver;
use super::regulation::{DELAY_S, VISIBLE_S, least_ttc_s};
use super::watch::{IN_LANE_M, Seen};
use super::way::{Place, Way, body};
use crate::geometry::OrientedBox;
use crate::scene::{Scene, State};
use serde::{Deserialize, Serialize};

/// After the end of the scene, everybody keeps their velocity until no danger is left, at most this long, seconds.
const AFTERMATH_S: f64 = 5.0;
/// The longest delays that are tried, seconds; one that survives a delay in steps of `STRIDE_S` is tried with the next,
/// and the first step that ends in a contact is bisected. With a long delay the ego may pass before the others come:
/// surviving it says nothing of shorter ones.
pub(super) const MOST_LATER_S: f64 = 2.0;
const STRIDE_S: f64 = 0.25;
const N_HALVINGS: usize = 3;

/// The careful driver's judgment of a scene.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct CarefulJudgment {
    /// Whether it avoids any contact but at its rear.
    pub preventable: bool,
    /// When it begins to brake hard, seconds since the present; `None` if it does not.
    pub braking_from_s: Option<f64>,
    /// By how much later it could react and still avoid any contact, seconds, at most 2; negative if it would have to
    /// react sooner, and -0.75 if that is not enough either. `None` where it was not asked for.
    pub margin_s: Option<f64>,
    /// Time to collision at the intrusion of a cut-in, seconds; `None` if the gap does not close then.
    pub intrusion_ttc_s: Option<f64>,
    /// Whether paragraph 5.2.5.2 requires that a collision be avoided; `None` if it says nothing of the intrusion: the
    /// other is alongside, or not slower.
    pub avoidance_required: Option<bool>,
}

/// A scene with all others as seen from the way of one of its agents.
pub struct CarefulReplay<'a> {
    scene: &'a Scene,
    ego_idx: usize,
    way: Way,
    /// By agent, then by timestep of the scene: where it is relative to the way, and its box.
    places: Vec<Vec<Option<(Place, OrientedBox)>>>,
    /// Whether each agent can be touched: not the ego, nor whoever overlaps it at present.
    can_touch: Vec<bool>,
}

/// A drive of the careful driver.
#[derive(Debug, Clone, Copy, Default)]
struct Drive {
    /// When it touches an agent, seconds since the present, and which.
    contact: Option<(f64, usize)>,
    braking_from_s: Option<f64>,
    /// Whether it answers to anybody at all.
    answers: bool,
    /// The first look at which the other of a cut-in is in the lane, and for how long it has moved toward it by then.
    intrusion: Option<(Seen, f64)>,
}

impl<'a> CarefulReplay<'a> {
    /// The replay in place of this agent. `None` if it is absent at present.
    pub fn of(scene: &'a Scene, ego_idx: usize) -> Option<Self> {
        let way = Way::of(scene, ego_idx)?;
        let places = scene.tracks.iter().enumerate().map(|(agent_idx, track)| {
            let entries = if agent_idx == ego_idx { &[] } else { track.trajectory.entries() };
            let states = entries.iter().map(|state| state.as_ref().filter(|state| state.is_finite()));
            states.map(|state| state.and_then(|state| Some((way.place(track, state)?, body(track, state))))).collect()
        });
        let places: Vec<Vec<Option<(Place, OrientedBox)>>> = places.collect();
        let present = scene.current_timestep();
        let own = body(&scene.tracks[ego_idx], scene.state(ego_idx, present)?);
        let is_apart = |places: &Vec<Option<(Place, OrientedBox)>>| {
            places.get(present).is_some_and(|place| place.is_none_or(|(_, body)| !body.overlaps(&own)))
        };
        let can_touch = places.iter().map(is_apart).collect();
        Some(Self { scene, ego_idx, way, places, can_touch })
    }

    /// The judgment, with the intrusion of this other.
    pub fn judgment(&self, other: Option<usize>) -> CarefulJudgment {
        let drive = self.drive(0.0, other);
        let intrusion_ttc_s = drive
            .intrusion
            .and_then(|(seen, _)| (seen.closing_mps > 0.0 && seen.gap_m >= 0.0).then(|| seen.gap_m / seen.closing_mps));
        let avoidance_required = intrusion_ttc_s.zip(drive.intrusion).map(|(ttc_s, (seen, moves_for_s))| {
            moves_for_s >= VISIBLE_S - 1e-9 && ttc_s > least_ttc_s(seen.closing_mps)
        });
        CarefulJudgment {
            preventable: drive.contact.is_none(),
            braking_from_s: drive.braking_from_s,
            margin_s: None,
            intrusion_ttc_s,
            avoidance_required,
        }
    }

    /// The judgment with the margin.
    pub fn judgment_with_margin(&self, other: Option<usize>) -> CarefulJudgment {
        CarefulJudgment { margin_s: Some(self.margin_s()), ..self.judgment(other) }
    }

    /// Whether this other comes into the lane of the way in the future.
    pub fn intrudes(&self, other: usize) -> bool {
        let future = self.places[other].iter().take(self.scene.n_timesteps).skip(self.scene.current_timestep());
        future.flatten().any(|(place, _)| place.is_in_lane())
    }

    /// When the careful driver touches an agent, seconds since the present, and which.
    pub fn contact(&self) -> Option<(f64, usize)> {
        self.drive(0.0, None).contact
    }

    /// By how much later than the regulation's the careful driver could react; see [`CarefulJudgment::margin_s`].
    pub fn margin_s(&self) -> f64 {
        let drive = self.drive(0.0, None);
        let survives = |later_s: f64| self.drive(later_s, None).contact.is_none();
        let [mut low_s, mut high_s] = match drive.contact {
            None if !drive.answers => return MOST_LATER_S,
            None => {
                let steps = (1..=(MOST_LATER_S / STRIDE_S) as usize).map(|i| i as f64 * STRIDE_S);
                match steps.into_iter().find(|later_s| !survives(*later_s)) {
                    None => return MOST_LATER_S,
                    Some(fails_s) => [fails_s - STRIDE_S, fails_s],
                }
            }
            Some(_) => {
                let steps = (1..=(DELAY_S / STRIDE_S) as usize).map(|i| -(i as f64) * STRIDE_S);
                match steps.into_iter().find(|later_s| survives(*later_s)) {
                    None => return -DELAY_S,
                    Some(survived_s) => [survived_s, survived_s + STRIDE_S],
                }
            }
        };
        for _ in 0..N_HALVINGS {
            let middle_s = f64::midpoint(low_s, high_s);
            if survives(middle_s) { low_s = middle_s } else { high_s = middle_s }
        }
        low_s
    }

    /// The drive of a careful driver who reacts `later_s` later than the regulation's.
    fn drive(&self, later_s: f64, other: Option<usize>) -> Drive {
        let (scene, ego_idx, dt_s) = (self.scene, self.ego_idx, self.scene.dt_s);
        let (present, end) = (scene.current_timestep(), scene.n_timesteps - 1);
        let extent = scene.tracks[ego_idx].extent_or_least();
        let since_s = |timestep: usize| (timestep as f64 - present as f64) * dt_s;
        let mut driver = CarefulDriver::new(scene.tracks.len(), extent.width_m, later_s);
        let (mut drive, mut before, mut can_touch) = (Drive::default(), None, self.can_touch.clone());
        let Some(mut ego) = scene.state(ego_idx, present).copied() else { return drive };
        let n_after = (AFTERMATH_S / dt_s).round() as usize;
        for timestep in 0..end + n_after {
            let own = if timestep < present { scene.state(ego_idx, timestep).copied() } else { Some(ego) };
            let driven_m = own.and_then(|own| self.way.route.driven_m(own.position));
            let seen = |agent_idx: usize| {
                let ((place, _), (own, driven_m)) = self.place(agent_idx, timestep).zip(own.zip(driven_m))?;
                can_touch[agent_idx].then(|| place.seen_from(driven_m, own.speed_mps(), extent.length_m))
            };
            let ego_mps = own.map_or(0.0, |own| own.speed_mps());
            driver.look([since_s(timestep), dt_s], ego_mps, (0..self.places.len()).map(seen));
            if timestep < present {
                before = own;
                continue;
            }
            if let Some((other, seen)) = other.and_then(|other| Some((other, seen(other)?)))
                && seen.flank_m <= IN_LANE_M
                && timestep <= end
            {
                drive.intrusion.get_or_insert((seen, driver.moves_for_s(other)));
            }
            if timestep >= end && !driver.is_in_danger() {
                break;
            }
            let own_mps2 = before.map_or(0.0, |before: State| (ego_mps - before.speed_mps()) / dt_s);
            let wanted_mps = self.way.wanted_speed_mps(ego.position);
            let acceleration_mps2 = driver.acceleration_mps2([ego_mps, own_mps2], wanted_mps, dt_s);
            drive.answers |= driver.answers();
            if driver.braking_mps2(since_s(timestep + 1)) > 0.0 {
                drive.braking_from_s.get_or_insert(since_s(timestep));
            }
            (before, ego) = (Some(ego), self.way.advanced(&ego, acceleration_mps2, dt_s));
            if let Some(agent_idx) = self.touched(&ego, timestep + 1, &mut can_touch) {
                drive.contact = Some((since_s(timestep + 1), agent_idx));
                break;
            }
        }
        drive
    }

    /// An agent at a timestep; after the end of the scene at its last velocity.
    fn place(&self, agent_idx: usize, timestep: usize) -> Option<(Place, OrientedBox)> {
        let (scene, places) = (self.scene, &self.places[agent_idx]);
        let Some(after) = (timestep + 1).checked_sub(places.len()).filter(|after| *after > 0) else {
            return places.get(timestep).copied().flatten();
        };
        let (track, last) = (&scene.tracks[agent_idx], places.len().checked_sub(1)?);
        let state = scene.state(agent_idx, last).filter(|state| state.is_finite())?;
        let state = State { position: state.position + state.velocity * (after as f64 * scene.dt_s), ..*state };
        Some((self.way.place(track, &state)?, body(track, &state)))
    }

    /// The first of those who can touch the ego that touches it at a timestep. Whoever does so at its rear cannot any
    /// more.
    fn touched(&self, ego: &State, timestep: usize, can_touch: &mut [bool]) -> Option<usize> {
        let own = body(&self.scene.tracks[self.ego_idx], ego);
        (0..self.places.len()).find(|agent_idx| {
            let body = self.place(*agent_idx, timestep).map(|(_, body)| body);
            let touching = body.filter(|body| can_touch[*agent_idx] && is_near(&own, body) && own.overlaps(body));
            can_touch[*agent_idx] &= !touching.is_some_and(|body| is_behind(&own, &body));
            touching.is_some() && can_touch[*agent_idx]
        })
    }
}

/// Whether the other box is rather behind than beside the first, by its sides.
fn is_behind(own: &OrientedBox, other: &OrientedBox) -> bool {
    let place = (other.center - own.center).rotated(-own.heading_rad);
    place.x / own.length_m < -(place.y / own.width_m).abs()
}

/// Whether two boxes may overlap.
fn is_near(one: &OrientedBox, other: &OrientedBox) -> bool {
    let reach_m = (one.length_m + one.width_m + other.length_m + other.width_m) / 2.0;
    one.center.distance(other.center) <= reach_m
}
