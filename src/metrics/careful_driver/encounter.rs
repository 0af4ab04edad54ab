//! A cut-in seen from the ego's path: when the driver perceives it, when it becomes dangerous, and whether the boxes
//! touch.

use super::braking::Braking;
use super::regulation::{DANGER_TTC_S, INTRUSION_M, LANE_WIDTH_M, PERCEPTION_S, WANDERING_M};
use crate::behavior::driven_path::DrivenPath;
use crate::behavior::footprint::Footprint;
use crate::geometry::{OrientedBox, Vec2, wrap_angle};
use crate::scene::{Extent, Scene, State, Track};

/// Steps of the simulation within a timestep.
const N_SUBSTEPS: usize = 4;
/// The simulation continues this long after the scene, seconds: enough to stop from 180 km/h.
const AFTERMATH_S: f64 = 10.0;

/// Two vehicles from the present on.
pub(super) struct Encounter<'a> {
    scene: &'a Scene,
    other: &'a Track,
    path: DrivenPath,
    ego_extent: Extent,
    /// The ego's speed at the present, m/s.
    pub(super) ego_speed_mps: f64,
    /// The other relative to the path at each timestep of the scene.
    places: Vec<Option<RelativePosition>>,
}

/// The position of the other relative to the ego's path.
#[derive(Clone, Copy)]
struct RelativePosition {
    /// Distance of its center from the path, meters; positive on the side on which it is at present.
    offset_m: f64,
    /// Distance of its nearer flank from the path, meters; negative if it is beyond the path.
    flank_m: f64,
    /// From the ego's front at present to the nearest part of the other, meters along the path.
    ahead_m: f64,
    /// Its speed along the path, m/s.
    along_mps: f64,
}

/// The moment at which the other is in the lane of the ego.
pub(super) struct Intrusion {
    /// From the ego's front to the nearest part of the other, meters.
    pub(super) gap_m: f64,
    /// The ego's speed then, m/s.
    pub(super) ego_speed_mps: f64,
    /// The other's speed along the path, m/s.
    pub(super) other_speed_mps: f64,
}

/// Whether a vehicle `gap_m` ahead of the ego's front, along the path, is dangerous at this closing speed. The ego need
/// not brake for one behind it, by more than `lengths_m` of both, but for one alongside.
pub(super) fn is_danger(gap_m: f64, closing_mps: f64, lengths_m: f64) -> bool {
    closing_mps > 0.0 && gap_m >= -lengths_m && gap_m <= DANGER_TTC_S * closing_mps
}

impl<'a> Encounter<'a> {
    /// `None` if either is not tracked at present.
    pub(super) fn of(scene: &'a Scene, [ego_idx, other_idx]: [usize; 2]) -> Option<Self> {
        let present = scene.current_timestep();
        let (ego, other) = (scene.tracks.get(ego_idx)?, scene.tracks.get(other_idx)?);
        let ego_state = ego.trajectory.get(present).filter(|state| state.is_finite())?;
        let other_state = other.trajectory.get(present).filter(|state| state.is_finite())?;
        let path = DrivenPath::from(ego, present)?;
        let side = path.project(other_state.position)?.offset_m.signum();
        let place = |state: &State| {
            let projection = path.project(state.position)?;
            let body = other.footprint(state);
            let across = Vec2::from_angle(projection.heading_rad + std::f64::consts::FRAC_PI_2);
            let offset_m = side * projection.offset_m;
            Some(RelativePosition {
                offset_m,
                flank_m: offset_m.abs() - Footprint::new(&body).half_extent_m(across),
                ahead_m: path.gap_m(&body)?,
                along_mps: state.velocity.dot(Vec2::from_angle(projection.heading_rad)),
            })
        };
        let places =
            other.trajectory.entries().iter().map(|state| state.as_ref().filter(|s| s.is_finite()).and_then(place));
        Some(Self {
            scene,
            other,
            ego_extent: ego.extent_or_nominal(),
            ego_speed_mps: ego_state.speed_mps(),
            places: places.collect(),
            path,
        })
    }

    /// The first moment from the present on at which the other is in the lane, while the ego keeps its present speed;
    /// `None` if it never is.
    pub(super) fn intrusion(&self) -> Option<Intrusion> {
        let limit_m = LANE_WIDTH_M / 2.0 - INTRUSION_M;
        self.future().find(|(_, place)| place.flank_m <= limit_m).map(|(time_s, place)| Intrusion {
            gap_m: place.ahead_m - self.ego_speed_mps * time_s,
            ego_speed_mps: self.ego_speed_mps,
            other_speed_mps: place.along_mps,
        })
    }

    /// When the driver perceives that the other cuts in, seconds since the present; negative before it. `None` if it
    /// never does.
    pub(super) fn perceived_s(&self) -> Option<f64> {
        let mut farthest_m = f64::NEG_INFINITY;
        for (timestep, place) in self.places.iter().enumerate() {
            let Some(place) = place else { continue };
            farthest_m = farthest_m.max(place.offset_m);
            if farthest_m - place.offset_m > WANDERING_M {
                return Some(self.time_s(timestep) + PERCEPTION_S);
            }
        }
        None
    }

    /// When, from `perceived_s` on, the time to collision along the path is dangerous, seconds since the present.
    /// `None` if it never is.
    pub(super) fn danger_s(&self, perceived_s: f64) -> Option<f64> {
        let is_danger = |(time_s, place): &(f64, RelativePosition)| {
            let gap_m = place.ahead_m - self.ego_speed_mps * time_s;
            let closing_mps = self.ego_speed_mps - place.along_mps;
            is_danger(gap_m, closing_mps, self.ego_extent.length_m + self.other.extent_or_nominal().length_m)
        };
        // Times of timesteps are rounded products; rounding must not decide.
        self.future()
            .find(|(time_s, place)| *time_s >= perceived_s - 1e-9 && is_danger(&(*time_s, *place)))
            .map(|(t, _)| t)
    }

    /// Whether the boxes touch while the ego brakes like this.
    pub(super) fn touches(&self, braking: &Braking) -> bool {
        let step_s = self.scene.dt_s / N_SUBSTEPS as f64;
        let end_s = self.time_s(self.scene.n_timesteps.saturating_sub(1));
        let n_steps = ((end_s + AFTERMATH_S) / step_s).ceil() as usize;
        for step in 0..=n_steps {
            let time_s = step as f64 * step_s;
            let Some(other) = self.other_at(time_s) else { continue };
            let (center, heading_rad) = self.path.pose_at(braking.driven_m(time_s));
            let Extent { length_m, width_m } = self.ego_extent;
            let own = OrientedBox { center, heading_rad, length_m, width_m };
            if own.overlaps(&self.other.footprint(&other)) {
                return true;
            }
            // After the scene the other keeps its velocity, so nothing can happen once the ego has braked enough or
            // need not brake.
            let along_mps = other.velocity.dot(Vec2::from_angle(heading_rad)).max(0.0);
            let is_over =
                braking.from_s.is_none_or(|from_s| time_s >= from_s && braking.speed_mps(time_s) <= along_mps);
            if time_s >= end_s && is_over {
                return false;
            }
        }
        false
    }

    /// The other's positions from the present on, with seconds since then.
    fn future(&self) -> impl Iterator<Item = (f64, RelativePosition)> + '_ {
        let present = self.scene.current_timestep();
        let places = self.places.iter().enumerate().skip(present);
        places.filter_map(|(timestep, place)| Some((self.time_s(timestep), (*place)?)))
    }

    fn time_s(&self, timestep: usize) -> f64 {
        (timestep as f64 - self.scene.current_timestep() as f64) * self.scene.dt_s
    }

    /// The other at a time since the present: interpolated between timesteps, at its last velocity after them. `None`
    /// in gaps of its track.
    fn other_at(&self, time_s: f64) -> Option<State> {
        let at = self.scene.current_timestep() as f64 + time_s / self.scene.dt_s;
        let (last, last_state) = self.other.trajectory.valid().next_back()?;
        if at >= last as f64 {
            let elapsed_s = (at - last as f64) * self.scene.dt_s;
            return Some(State { position: last_state.position + last_state.velocity * elapsed_s, ..*last_state });
        }
        let (before, share) = (at.floor() as usize, at.fract());
        let (a, b) = (self.other.trajectory.get(before)?, self.other.trajectory.get(before + 1)?);
        Some(State {
            position: a.position.lerp(b.position, share),
            heading_rad: wrap_angle(a.heading_rad + wrap_angle(b.heading_rad - a.heading_rad) * share),
            velocity: a.velocity.lerp(b.velocity, share),
        })
    }
}
