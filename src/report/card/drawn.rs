//! Lanes and road users in drawings, rounded to visible precision.

use super::ViewRect;
use crate::scene::{Lane, ObservationMask, Roles, Scene};
use crate::settings::named;
use std::ops::RangeInclusive;

/// How far a drawn lane may lie from the mapped one, meters.
const LANE_TOLERANCE_M: f64 = 0.05;

/// A lane's lines in the scene frame, meters; empty if the map has none.
#[derive(Debug, Clone, PartialEq)]
pub struct DrawnLane {
    /// Points in driving direction.
    pub centerline: Vec<[f64; 2]>,
    /// Left boundary.
    pub left: Vec<[f64; 2]>,
    /// Right boundary.
    pub right: Vec<[f64; 2]>,
    /// What the light at its beginning shows, from its first to its last timestep each; empty without a light.
    pub lights: Vec<(Light, RangeInclusive<usize>)>,
}

/// What a light shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Light {
    /// It was not seen.
    Unknown,
    /// Red.
    Stop,
    /// Yellow.
    Caution,
    /// Green.
    Go,
}

named! { Light { Unknown = "unknown", Stop = "stop", Caution = "caution", Go = "go" } }

/// One drawing: a recording, or overlaid samples of its future.
#[derive(Debug, Clone, PartialEq)]
pub struct ScenePanel {
    /// Its title, such as `recorded`.
    pub title: String,
    /// Whether all of it was recorded.
    pub is_recorded: bool,
    /// Seconds between timesteps.
    pub dt_s: f64,
    /// Timesteps of the history; the last of them is the present.
    pub n_history: usize,
    /// The recording alone, or one entry a sample.
    pub samples: Vec<DrawnSample>,
}

/// One recording or sample.
#[derive(Debug, Clone, PartialEq)]
pub struct DrawnSample {
    /// Its name, such as `sample 4`.
    pub name: String,
    /// The agents that come into view.
    pub agents: Vec<DrawnAgent>,
}

/// One road user over time.
#[derive(Debug, Clone, PartialEq)]
pub struct DrawnAgent {
    /// Its track id.
    pub id: String,
    /// Its role in the event, such as `ego`; `None` for others.
    pub role: Option<String>,
    /// Length along the heading, meters.
    pub length_m: f64,
    /// Width, meters.
    pub width_m: f64,
    /// x (m), y (m) and heading (rad) in the scene frame by timestep; `None` if it was not tracked.
    pub states: Vec<Option<[f64; 3]>>,
    /// Whether the state was given to the model, by timestep; for a recording, whether it is history.
    pub observed: Vec<bool>,
}

impl DrawnLane {
    /// The lanes of a scene that come into view.
    pub(super) fn all(scene: &Scene, view: &ViewRect) -> Vec<Self> {
        scene.lanes.lanes().iter().map(|lane| Self::of(scene, lane)).filter(|lane| lane.is_in(view)).collect()
    }

    fn of(scene: &Scene, lane: &Lane) -> Self {
        let points = |line: &crate::geometry::Polyline| {
            let rounded: Vec<[f64; 2]> = line.0.iter().map(|p| [centi(p.x), centi(p.y)]).collect();
            simplified(&rounded)
        };
        // Arrows and flashing lights mean what others mean.
        let light = |state: &str| {
            let plain = ["arrow_", "flashing_"].into_iter().find_map(|kind| state.strip_prefix(kind));
            Light::from_name(plain.unwrap_or(state)).unwrap_or(Light::Unknown)
        };
        Self {
            centerline: points(&lane.centerline),
            left: points(&lane.left),
            right: points(&lane.right),
            lights: scene.lights(lane).map(|(state, timesteps)| (light(state), timesteps)).collect(),
        }
    }

    /// The light at a timestep; `None` where there is none at all.
    pub(in crate::report) fn light(&self, timestep: usize) -> Option<Light> {
        let shown = self.lights.iter().find(|(_, timesteps)| timesteps.contains(&timestep));
        (!self.lights.is_empty()).then(|| shown.map_or(Light::Unknown, |(light, _)| *light))
    }

    fn is_in(&self, view: &ViewRect) -> bool {
        [&self.centerline, &self.left, &self.right].into_iter().any(|line| view.touches(line))
    }
}

impl DrawnSample {
    /// The agents of `scene` that come into view. `observed` tells which states were observed.
    pub(super) fn of(name: &str, scene: &Scene, observed: &ObservationMask, roles: &Roles, view: &ViewRect) -> Self {
        let agent = |(agent_idx, track): (usize, &crate::scene::Track)| {
            let extent = track.extent_or_nominal();
            let state = |state: &crate::scene::State| {
                state.is_finite().then(|| [centi(state.position.x), centi(state.position.y), centi(state.heading_rad)])
            };
            let states: Vec<_> =
                track.trajectory.entries().iter().map(|entry| entry.as_ref().and_then(state)).collect();
            let is_given = |timestep: usize| {
                agent_idx < observed.n_agents()
                    && timestep < observed.n_timesteps()
                    && observed.is_observed(agent_idx, timestep)
            };
            DrawnAgent {
                id: track.id.0.clone(),
                role: roles.role_of(&track.id).map(str::to_owned),
                length_m: centi(extent.length_m),
                width_m: centi(extent.width_m),
                observed: (0..states.len()).map(is_given).collect(),
                states,
            }
        };
        let is_seen = |agent: &DrawnAgent| agent.states.iter().flatten().any(|[x, y, _]| view.contains(*x, *y));
        Self { name: name.to_owned(), agents: scene.tracks.iter().enumerate().map(agent).filter(is_seen).collect() }
    }
}

impl DrawnAgent {
    /// Runs of tracked states that are either all observed or all generated: whether observed, first timestep, one past
    /// the last.
    pub(in crate::report) fn stretches(&self) -> Vec<(bool, usize, usize)> {
        let mut stretches: Vec<(bool, usize, usize)> = Vec::new();
        for (timestep, state) in self.states.iter().enumerate() {
            if state.is_none() {
                continue;
            }
            let observed = self.observed.get(timestep).copied().unwrap_or(false);
            match stretches.last_mut() {
                Some((same, _, end)) if *same == observed && *end == timestep => *end += 1,
                _ => stretches.push((observed, timestep, timestep + 1)),
            }
        }
        stretches
    }
}

/// Hundredths: centimeters, and half a degree.
fn centi(value: f64) -> f64 {
    (value * 100.0).round() / 100.0
}

/// Leaves out points that lie on the line within [`LANE_TOLERANCE_M`] (Ramer 1972, Douglas and Peucker 1973).
fn simplified(points: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let (Some(first), Some(last)) = (points.first(), points.last()) else { return Vec::new() };
    let off_line = |p: &[f64; 2]| {
        let ([ax, ay], [bx, by]) = (*first, *last);
        let (dx, dy) = (bx - ax, by - ay);
        let square = dx * dx + dy * dy;
        let at = if square > 0.0 { (((p[0] - ax) * dx + (p[1] - ay) * dy) / square).clamp(0.0, 1.0) } else { 0.0 };
        (p[0] - ax - at * dx).hypot(p[1] - ay - at * dy)
    };
    let farthest =
        (1..points.len().saturating_sub(1)).max_by(|a, b| off_line(&points[*a]).total_cmp(&off_line(&points[*b])));
    match farthest.filter(|at| off_line(&points[*at]) > LANE_TOLERANCE_M) {
        Some(at) => {
            let mut kept = simplified(&points[..=at]);
            kept.pop();
            kept.extend(simplified(&points[at..]));
            kept
        }
        None if points.len() == 1 => vec![*first],
        None => vec![*first, *last],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Polyline, Vec2};
    use crate::scene::testing::{self, Drive};

    #[test]
    fn lights_have_the_color_of_each_timestep() {
        let scene = testing::scene(&[Drive::straight(0.0, 0.0, 0.0, 1.0)]);
        let line = Polyline(vec![Vec2::ZERO, Vec2::new(9.0, 0.0)]);
        let mut lane = Lane::unconnected(1, line, Default::default());
        assert_eq!(DrawnLane::of(&scene, &lane).light(0), None);
        let shown = ("traffic_light".to_owned(), "arrow_stop:0-4;flashing_caution:6-6;go:7-90".to_owned());
        std::sync::Arc::make_mut(&mut lane.attributes).tags.extend([shown]);
        let drawn = DrawnLane::of(&scene, &lane);
        let expected =
            [(4, Light::Stop), (5, Light::Unknown), (6, Light::Caution), (90, Light::Go), (91, Light::Unknown)];
        assert!(expected.iter().all(|(timestep, light)| drawn.light(*timestep) == Some(*light)), "{drawn:?}");
    }

    #[test]
    fn straight_lines_need_their_ends_and_corners_stay() {
        let straight: Vec<[f64; 2]> = (0..61).map(|i| [f64::from(i), 2.0 * f64::from(i)]).collect();
        assert_eq!(simplified(&straight), [[0.0, 0.0], [60.0, 120.0]]);
        let bent = [[0.0, 0.0], [5.0, 0.04], [10.0, 0.0], [10.0, 5.0], [10.0, 10.0]];
        assert_eq!(simplified(&bent), [[0.0, 0.0], [10.0, 0.0], [10.0, 10.0]]);
        let closed = [[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 0.0]];
        assert_eq!(simplified(&closed), closed);
        assert_eq!(simplified(&[[1.0, 1.0]]), [[1.0, 1.0]]);
        assert!(simplified(&[]).is_empty());
    }

    #[test]
    fn stretches_end_where_the_kind_of_state_changes_and_where_states_are_missing() {
        let state = Some([0.0; 3]);
        let agent = DrawnAgent {
            id: "1".into(),
            role: None,
            length_m: 4.0,
            width_m: 2.0,
            states: vec![state, state, None, state, state, state],
            observed: vec![true, true, false, true, false, false],
        };
        assert_eq!(agent.stretches(), [(true, 0, 2), (true, 3, 4), (false, 4, 6)]);
    }
}
