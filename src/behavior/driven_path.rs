//! The path an agent drives from some timestep on, and places relative to it.

use crate::geometry::{OrientedBox, Path, Polyline, Projection, Vec2};
use crate::scene::{State, Track};

/// Positions closer together than this are noise of the tracker, not path.
const MIN_SPACING_M: f64 = 0.1;
/// How far the path runs straight on at both ends, so that boxes behind the first and beyond the last position have a
/// place on it. Longer than any road user.
const EXTENSION_M: f64 = 50.0;

/// The centers of an agent from a timestep to the end of its track, carried straight on at both ends.
#[derive(Debug, Clone)]
pub(crate) struct DrivenPath {
    path: Path,
    /// Half the length of the agent: its front bumper is this far ahead of its center.
    half_length_m: f64,
}

impl DrivenPath {
    /// The path of `track` from `timestep` on. `None` when it is not tracked then.
    pub(crate) fn from(track: &Track, timestep: usize) -> Option<Self> {
        let start = track.trajectory.get(timestep).filter(|state| state.is_finite())?;
        let forward = |state: &State| Vec2::from_angle(state.heading_rad) * EXTENSION_M;
        let mut points = vec![start.position - forward(start), start.position];
        let (mut kept, mut last) = (start.position, start);
        for (_, state) in track.trajectory.valid().filter(|(t, state)| *t > timestep && state.is_finite()) {
            last = state;
            if state.position.distance(kept) >= MIN_SPACING_M {
                kept = state.position;
                points.push(kept);
            }
        }
        points.push(kept + forward(last));
        Some(Self { path: Path::new(Polyline(points)), half_length_m: track.extent_or_nominal().length_m / 2.0 })
    }

    /// The path through `points`, carried straight on at both ends, of an agent of this length. `None` with fewer than
    /// two distinct points.
    pub(crate) fn along(points: &[Vec2], length_m: f64) -> Option<Self> {
        let mut kept: Vec<Vec2> = Vec::with_capacity(points.len() + 2);
        for point in points {
            if kept.last().is_none_or(|last| last.distance(*point) >= MIN_SPACING_M) {
                kept.push(*point);
            }
        }
        let [first, second, ..] = kept[..] else { return None };
        let (before, last) = (kept[kept.len() - 2], kept[kept.len() - 1]);
        kept.insert(0, first + Vec2::from_angle((first - second).angle()) * EXTENSION_M);
        kept.push(last + Vec2::from_angle((last - before).angle()) * EXTENSION_M);
        Some(Self { path: Path::new(Polyline(kept)), half_length_m: length_m / 2.0 })
    }

    /// Its length without the extensions, meters.
    pub(crate) fn length_m(&self) -> f64 {
        self.path.length_m() - 2.0 * EXTENSION_M
    }

    /// How far along the path `point` is from its start, meters; negative before it.
    pub(crate) fn driven_m(&self, point: Vec2) -> Option<f64> {
        self.project(point).map(|place| place.station_m - EXTENSION_M)
    }

    /// The position of `point` relative to the path.
    pub(crate) fn project(&self, point: Vec2) -> Option<Projection> {
        self.path.project(point)
    }

    /// Distance along the path from the agent's front bumper to something whose center is there, and that reaches this
    /// far before it, meters.
    pub(crate) fn ahead_m(&self, center: &Projection, reaches_m: f64) -> f64 {
        center.station_m - reaches_m - EXTENSION_M - self.half_length_m
    }

    /// The position and heading of the agent after it has driven `driven_m` along the path. Past the end it goes
    /// straight on.
    pub(crate) fn pose_at(&self, driven_m: f64) -> (Vec2, f64) {
        let station_m = (driven_m + EXTENSION_M).max(0.0);
        let (point, heading_rad) = self.path.pose_at(station_m).unwrap_or_default();
        (point + Vec2::from_angle(heading_rad) * (station_m - self.path.length_m()).max(0.0), heading_rad)
    }

    /// Distance along the path from the agent's front bumper to the nearest part of `body`, meters; negative where they
    /// are alongside each other.
    pub(crate) fn gap_m(&self, body: &OrientedBox) -> Option<f64> {
        let stations = body.corners().into_iter().filter_map(|corner| self.project(corner)).map(|p| p.station_m);
        stations.reduce(f64::min).map(|nearest_m| nearest_m - EXTENSION_M - self.half_length_m)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{AgentClass, Extent, TrackRole, Trajectory};

    /// Ten meters east, then north, one meter a timestep.
    fn corner_track() -> Track {
        let state = |t: usize| {
            let (position, heading_rad) = if t <= 10 {
                (Vec2::new(t as f64, 0.0), 0.0)
            } else {
                (Vec2::new(10.0, (t - 10) as f64), std::f64::consts::FRAC_PI_2)
            };
            Some(State { position, heading_rad, velocity: Vec2::from_angle(heading_rad) })
        };
        Track {
            id: "a".into(),
            class: AgentClass::Vehicle,
            role: TrackRole::Context,
            extent: Some(Extent { length_m: 4.0, width_m: 2.0 }),
            trajectory: Trajectory::new((0..20).map(state).collect()),
        }
    }

    #[test]
    fn gaps_are_measured_from_bumper_to_bumper_along_the_bend() {
        let path = DrivenPath::from(&corner_track(), 2).expect("tracked");
        let heading_rad = std::f64::consts::FRAC_PI_2;
        let body = |x: f64, y: f64| OrientedBox { center: Vec2::new(x, y), heading_rad, length_m: 4.0, width_m: 2.0 };
        // 8 m from (2, 0) to the corner, five more to the rear bumper at y = 5; half a length is 2 m.
        assert!((path.gap_m(&body(10.0, 7.0)).expect("on the path") - 11.0).abs() < 1e-9);
        // Beyond the last position the path runs straight on.
        assert!((path.gap_m(&body(10.0, 27.0)).expect("on the path") - 31.0).abs() < 1e-9);
        assert!(DrivenPath::from(&corner_track(), 30).is_none());
    }

    #[test]
    fn poses_follow_the_path_and_go_on_straight() {
        let path = DrivenPath::from(&corner_track(), 2).expect("tracked");
        let near = |driven_m: f64, x: f64, y: f64, heading_rad: f64| {
            let (point, heading) = path.pose_at(driven_m);
            point.distance(Vec2::new(x, y)) < 1e-9 && (heading - heading_rad).abs() < 1e-9
        };
        let north = std::f64::consts::FRAC_PI_2;
        assert!(near(0.0, 2.0, 0.0, 0.0) && near(5.0, 7.0, 0.0, 0.0) && near(11.0, 10.0, 3.0, north));
        // The last position is 9 m up; the straight end is 50 m long, and goes on.
        assert!(near(27.0, 10.0, 19.0, north) && near(108.0, 10.0, 100.0, north));
    }

    #[test]
    fn points_have_a_side() {
        let path = DrivenPath::from(&corner_track(), 2).expect("tracked");
        assert!(path.project(Vec2::new(5.0, 1.0)).expect("on the path").offset_m > 0.0);
        assert!(path.project(Vec2::new(5.0, -1.0)).expect("on the path").offset_m < 0.0);
    }
}
