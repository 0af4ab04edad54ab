//! How does traffic develop over a drive: how many agents are there, who comes and goes, and what goes wrong?

use super::situation::Situation;
use super::world::World;
use crate::metrics::collisions;
use crate::scene::{Scene, Track};
use serde::{Deserialize, Serialize};
use std::ops::AddAssign;

/// The stretches of a drive over which traffic is counted, seconds after the present; a drive ends before the last.
pub const BANDS_S: [[f64; 2]; 4] = [[0.0, 2.0], [2.0, 5.0], [5.0, 8.0], [8.0, 600.0]];

/// Slower vehicles, m/s, are standing.
const STANDING_MPS: f64 = 0.3;
/// A vehicle that stands for this long at the end of a drive, seconds, is stuck.
const STUCK_S: f64 = 15.0;
/// A vehicle farther off the road than this, meters, is off it, as in the check of validity. Every few timesteps are
/// checked.
const OFF_ROAD_M: f64 = 0.3;
const STRIDE: usize = 5;

/// Counts over drives, by stretch.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Traffic {
    /// Seconds of presence, summed over agents.
    pub agent_s: [f64; 4],
    /// Seconds of presence if as many agents had been there as were recorded at present.
    pub agent_s_as_recorded: [f64; 4],
    /// Seconds that were driven.
    pub driven_s: [f64; 4],
    /// Agents that drive into another for the first time: of pairs that are apart at present and of which one moves.
    pub n_collided: [u64; 4],
    /// Seconds that vehicles other than the ego that begin on the road were off it, and all their seconds.
    pub off_road_s: [f64; 4],
    /// See `off_road_s`.
    pub on_map_s: [f64; 4],
    /// Seconds that vehicles stood, and those if as many had stood as at present.
    pub standing_s: [f64; 4],
    /// See `standing_s`.
    pub standing_s_as_recorded: [f64; 4],
    /// Agents that arrived.
    pub n_arrived: [u64; 4],
    /// Arrivals that are those of the recording.
    pub n_arrived_recorded: [u64; 4],
    /// Agents that left.
    pub n_left: [u64; 4],
    /// Arrivals that found no gap.
    pub n_held_back: u64,
    /// Vehicles that stood for the last 15 s of their drive.
    pub n_stuck: u64,
}

impl Traffic {
    /// The traffic of a drive.
    pub(super) fn of(situation: &Situation, world: &World) -> Self {
        let (scene, mut traffic) = (situation.driven(world), Self::default());
        let present = scene.current_timestep();
        let since_s = |timestep: usize| (timestep - present) as f64 * scene.dt_s;
        let band = |timestep: usize| BANDS_S.iter().position(|[_, end_s]| since_s(timestep) < end_s + 1e-9);
        let stands = |track: &Track, timestep: usize| {
            let state = track.trajectory.get(timestep);
            track.class.is_motorized() && state.is_some_and(|state| state.speed_mps() < STANDING_MPS)
        };
        let n_there = |t: usize| scene.tracks.iter().filter(|track| track.trajectory.is_valid(t)).count() as f64;
        let n_standing = |t: usize| scene.tracks.iter().filter(|track| stands(track, t)).count() as f64;
        let at_present = [n_there(present), n_standing(present)].map(|n| n * scene.dt_s);
        for timestep in scene.n_history..scene.n_timesteps {
            let Some(band) = band(timestep) else { continue };
            traffic.driven_s[band] += scene.dt_s;
            traffic.agent_s[band] += n_there(timestep) * scene.dt_s;
            traffic.agent_s_as_recorded[band] += at_present[0];
            traffic.standing_s[band] += n_standing(timestep) * scene.dt_s;
            traffic.standing_s_as_recorded[band] += at_present[1];
        }
        for (agent_idx, track) in scene.tracks.iter().enumerate() {
            traffic.add_track(situation, &scene, (agent_idx, track), &band);
        }
        let n_stuck = (STUCK_S / scene.dt_s).round() as usize;
        if scene.n_timesteps - scene.n_history >= n_stuck {
            let is_stuck = |track: &&Track| (scene.n_timesteps - n_stuck..scene.n_timesteps).all(|t| stands(track, t));
            traffic.n_stuck = scene.tracks.iter().filter(is_stuck).count() as u64;
        }
        let mut first: Vec<Option<usize>> = vec![None; scene.tracks.len()];
        for collision in collisions(&scene) {
            for agent_idx in collision.pair {
                let known = first[agent_idx].unwrap_or(usize::MAX);
                first[agent_idx] = Some(known.min(collision.timestep));
            }
        }
        first.into_iter().flatten().filter_map(band).for_each(|band| traffic.n_collided[band] += 1);
        traffic
    }

    /// Adds when a track comes and goes, and how long it is off the road.
    fn add_track(
        &mut self,
        situation: &Situation,
        scene: &Scene,
        (agent_idx, track): (usize, &Track),
        band: &dyn Fn(usize) -> Option<usize>,
    ) {
        let after = |timestep: &usize| *timestep >= scene.current_timestep();
        let number = (agent_idx + situation.arrivals.n_expected()).checked_sub(scene.tracks.len());
        let mut there = track.trajectory.valid().map(|(timestep, _)| timestep).filter(after);
        let Some(first) = there.next() else {
            let is_due = number.is_some_and(|number| number < situation.arrivals.n_until(scene.n_timesteps));
            self.n_held_back += u64::from(is_due);
            return;
        };
        let last = there.next_back().unwrap_or(first);
        if let Some(band) = band(first).filter(|_| first > scene.current_timestep()) {
            self.n_arrived[band] += 1;
            let is_recorded = number.is_some_and(|number| situation.arrivals.is_recorded(number));
            self.n_arrived_recorded[band] += u64::from(is_recorded);
        }
        if let Some(band) = band(last + 1).filter(|_| last + 1 < scene.n_timesteps) {
            self.n_left[band] += 1;
        }
        let off_m = |timestep: usize| situation.off_road_m(&scene.state(agent_idx, timestep).copied()?);
        let is_judged = agent_idx != situation.ego_idx && track.class.is_motorized();
        if is_judged && off_m(first).is_some_and(|off_m| off_m <= OFF_ROAD_M) {
            for timestep in (scene.n_history.max(first)..=last).step_by(STRIDE) {
                let Some((band, off_m)) = band(timestep).zip(off_m(timestep)) else { continue };
                let lasts_s = STRIDE as f64 * scene.dt_s;
                self.on_map_s[band] += lasts_s;
                self.off_road_s[band] += if off_m > OFF_ROAD_M { lasts_s } else { 0.0 };
            }
        }
    }

    /// The sum of both.
    #[must_use]
    pub fn with(mut self, other: &Self) -> Self {
        add(&mut self.agent_s, &other.agent_s);
        add(&mut self.agent_s_as_recorded, &other.agent_s_as_recorded);
        add(&mut self.driven_s, &other.driven_s);
        add(&mut self.n_collided, &other.n_collided);
        add(&mut self.off_road_s, &other.off_road_s);
        add(&mut self.on_map_s, &other.on_map_s);
        add(&mut self.standing_s, &other.standing_s);
        add(&mut self.standing_s_as_recorded, &other.standing_s_as_recorded);
        add(&mut self.n_arrived, &other.n_arrived);
        add(&mut self.n_arrived_recorded, &other.n_arrived_recorded);
        add(&mut self.n_left, &other.n_left);
        self.n_held_back += other.n_held_back;
        self.n_stuck += other.n_stuck;
        self
    }
}

fn add<T: AddAssign + Copy>(ours: &mut [T; 4], theirs: &[T; 4]) {
    ours.iter_mut().zip(theirs).for_each(|(ours, theirs)| *ours += *theirs);
}
