//! Where do recordings of a place see traffic?
//!
//! A closed loop goes on as far as the map does, but recordings mostly end before. A scene shows what a recorder would.

use crate::geometry::Vec2;
use crate::scene::{Scene, State, Track, Trajectory};

/// How far beyond the recorded states something is still seen, meters.
const BEYOND_M: f64 = 1.0;

/// The convex hull of the recorded states of a place, in the frame of its recordings, counterclockwise.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Sight(Vec<Vec2>);

impl Sight {
    /// What these scenes of a place show.
    pub(super) fn of(scenes: &[Scene]) -> Self {
        let of_scene = |scene: &Scene| {
            let states = scene.tracks.iter().flat_map(|track| track.trajectory.valid());
            states.map(|(_, state)| scene.world_from_scene.point(state.position)).collect::<Vec<_>>()
        };
        Self(hull(scenes.iter().flat_map(of_scene).collect()))
    }

    fn holds(&self, point: Vec2) -> bool {
        let sides = self.0.iter().zip(self.0.iter().cycle().skip(1));
        let beyond_m = |(from, to): (&Vec2, &Vec2)| {
            let side = *to - *from;
            (point - *from).cross(side) / side.norm().max(f64::MIN_POSITIVE)
        };
        self.0.len() < 3 || sides.map(beyond_m).all(|beyond_m| beyond_m <= BEYOND_M)
    }

    /// The track without the states that a recorder would not see. Who has been out of sight does not come back.
    pub(super) fn seen(&self, track: Track, present: usize) -> Track {
        let is_seen = |state: &State| self.holds(state.position);
        let entries = track.trajectory.entries();
        let all_seen =
            |timesteps: &[Option<State>]| timesteps.iter().flatten().all(|state: &State| self.holds(state.position));
        let entry = |(timestep, state): (usize, &Option<State>)| {
            let between = if timestep < present { &entries[timestep..present] } else { &entries[present..timestep] };
            state.filter(|state| is_seen(state) && all_seen(between))
        };
        Track { trajectory: Trajectory::new(entries.iter().enumerate().map(entry).collect()), ..track }
    }
}

/// The convex hull of points, counterclockwise (Andrew 1979).
fn hull(mut points: Vec<Vec2>) -> Vec<Vec2> {
    points.retain(|point| point.is_finite());
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
        let sight = Sight(found);
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
}
