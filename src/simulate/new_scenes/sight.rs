//! What do recordings of a place show of its traffic?
//!
//! A closed loop goes on as far as the map does, but recordings mostly end before, and hold positions in whole
//! millimeters. A scene shows what a recorder would.

use crate::geometry::{Vec2, wrap_angle};
use crate::scene::{Scene, State, Track, Trajectory};

/// How far beyond the recorded states something is still seen, meters.
const BEYOND_M: f64 = 1.0;

/// Positions are recorded in whole millimeters if they differ by less than this from them, meters: a part of the
/// precision in which scenes are stored.
const IS_WHOLE_M: f64 = 1e-4;

/// What recordings of a place show.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Sight {
    /// The convex hull of the recorded states, in the frame of the recordings, counterclockwise.
    hull: Vec<Vec2>,
    /// Whether positions are in whole millimeters, and headings in thousandths of a radian.
    is_rounded: bool,
}

fn thousandth(value: f64) -> f64 {
    (value * 1000.0).round_ties_even() / 1000.0
}

impl Sight {
    /// What these scenes of a place show.
    pub(super) fn of(scenes: &[Scene]) -> Self {
        let of_scene = |scene: &Scene| {
            let states = scene.tracks.iter().flat_map(|track| track.trajectory.valid());
            states.map(|(_, state)| scene.world_from_scene.point(state.position)).collect::<Vec<_>>()
        };
        let points: Vec<Vec2> = scenes.iter().flat_map(of_scene).filter(|point| point.is_finite()).collect();
        let is_whole = |value: f64| (value - thousandth(value)).abs() < IS_WHOLE_M;
        let is_rounded = !points.is_empty() && points.iter().all(|point| is_whole(point.x) && is_whole(point.y));
        Self { hull: hull(points), is_rounded }
    }

    fn holds(&self, point: Vec2) -> bool {
        let sides = self.hull.iter().zip(self.hull.iter().cycle().skip(1));
        let beyond_m = |(from, to): (&Vec2, &Vec2)| {
            let side = *to - *from;
            (point - *from).cross(side) / side.norm().max(f64::MIN_POSITIVE)
        };
        self.hull.len() < 3 || sides.map(beyond_m).all(|beyond_m| beyond_m <= BEYOND_M)
    }

    /// The state as it would be recorded.
    fn recorded(&self, state: State) -> State {
        let position = Vec2::new(thousandth(state.position.x), thousandth(state.position.y));
        let rounded = State { position, heading_rad: wrap_angle(thousandth(state.heading_rad)), ..state };
        if self.is_rounded { rounded } else { state }
    }

    /// The track without the states that a recorder would not see. Who has been out of sight does not come back.
    pub(super) fn seen(&self, track: Track, present: usize) -> Track {
        let is_seen = |state: &State| self.holds(state.position);
        let entries = track.trajectory.entries();
        let all_seen =
            |timesteps: &[Option<State>]| timesteps.iter().flatten().all(|state: &State| self.holds(state.position));
        let entry = |(timestep, state): (usize, &Option<State>)| {
            let between = if timestep < present { &entries[timestep..present] } else { &entries[present..timestep] };
            state.filter(|state| is_seen(state) && all_seen(between)).map(|state| self.recorded(state))
        };
        Track { trajectory: Trajectory::new(entries.iter().enumerate().map(entry).collect()), ..track }
    }
}

/// The convex hull of points, counterclockwise (Andrew 1979).
fn hull(mut points: Vec<Vec2>) -> Vec<Vec2> {
    points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    let half = |points: &mut dyn Iterator<Item = &Vec2>| {
        let mut chain: Vec<Vec2> = Vec::new();
        for point in points {
            while let [.., before, last] = chain[..]
                && (last - before).cross(*point - last) <= 0.0
            {
                chain.pop();
            }
            chain.push(*point);
        }
        chain.pop();
        chain
    };
    [half(&mut points.iter()), half(&mut points.iter().rev())].concat()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::testing::{Drive, scene};

    #[test]
    fn a_recorder_sees_as_far_as_recordings_do() {
        let corners = [(0.0, 0.0), (4.0, 0.0), (4.0, 3.0), (0.0, 3.0), (2.0, 1.0), (2.0, 0.0), (1.0, 3.0)];
        let found = hull(corners.map(|(x, y)| Vec2::new(x, y)).to_vec());
        assert_eq!(found, [(0.0, 0.0), (4.0, 0.0), (4.0, 3.0), (0.0, 3.0)].map(|(x, y)| Vec2::new(x, y)));
        let sight = Sight { hull: found, is_rounded: false };
        let held = [(2.0, 1.5), (4.9, 1.0), (5.1, 1.0), (2.0, -0.9), (2.0, 4.1)];
        assert_eq!(held.map(|(x, y)| sight.holds(Vec2::new(x, y))), [true, true, false, true, false]);
        assert!(Sight::default().holds(Vec2::new(1e6, 0.0)), "where nothing was recorded, all is seen");
        // A car that drives through at 10 m/s, a meter a timestep.
        let scene = scene(&[Drive::straight(0.0, 1.0, 0.0, 10.0)]);
        let present = scene.current_timestep();
        let track = sight.seen(scene.tracks[0].clone(), present);
        let seen: Vec<usize> = track.trajectory.valid().map(|(timestep, _)| timestep).collect();
        let x = |timestep: usize| scene.state(0, timestep).unwrap().position.x;
        let expected: Vec<usize> = (0..scene.n_timesteps).filter(|t| (-1.0..=5.0).contains(&x(*t))).collect();
        assert_eq!(seen, expected);
    }

    #[test]
    fn a_recorder_of_whole_millimeters_rounds_what_it_sees() {
        let recorded = |from: f64| scene(&[Drive::straight(from, 1.0, 0.0, 10.0), Drive::straight(0.0, 3.0, 0.0, 5.0)]);
        let track = recorded(0.0004).tracks[0].clone();
        let seen = |recorded: Scene| Sight::of(&[recorded]).seen(track.clone(), 0).trajectory.get(0).copied().unwrap();
        let own = *track.trajectory.get(0).unwrap();
        let whole = seen(recorded(0.0));
        assert!((whole.position.x - thousandth(own.position.x)).abs() < 1e-12 && whole.position != own.position);
        assert_eq!(seen(recorded(0.0004)), own);
    }
}
