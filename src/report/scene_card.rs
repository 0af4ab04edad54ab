//! What is drawn of a scene, and how large is the view?

use super::model::Fact;
use crate::geometry::Vec2;
use crate::scene::{Lane, Scene, TrackId};
use serde::{Deserialize, Serialize};

/// Around the tracks of interest, metres.
const MARGIN_M: f64 = 9.0;
/// The least extent of a view in each direction, metres.
const MIN_VIEW_M: Vec2 = Vec2 { x: 60.0, y: 20.0 };

/// Drawings of one scene side by side, at one scale: the recording and what was generated from it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SceneCard {
    /// Unique within the report, such as the scenario's id.
    pub id: String,
    /// What happens, in a few words.
    pub title: String,
    /// Provenance, verdict, parameters of the event.
    pub facts: Vec<Fact>,
    /// The part of the scene frame that is shown.
    pub view: ViewRect,
    /// The lanes in view.
    pub lanes: Vec<DrawnLane>,
    /// The drawings, normally the recording first.
    pub panels: Vec<ScenePanel>,
}

/// An axis-parallel part of the scene frame, metres.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ViewRect {
    /// Least coordinates.
    pub min: [f64; 2],
    /// Greatest coordinates.
    pub max: [f64; 2],
}

/// A lane's lines in the scene frame, metres; empty where the map has none.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DrawnLane {
    /// Points in driving direction.
    pub centerline: Vec<[f64; 2]>,
    /// Left boundary.
    pub left: Vec<[f64; 2]>,
    /// Right boundary.
    pub right: Vec<[f64; 2]>,
}

/// One drawing.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ScenePanel {
    /// What it is, such as `recorded`.
    pub title: String,
    /// Seconds between timesteps.
    pub dt_s: f64,
    /// Timesteps that were observed; the last of them is the present.
    pub n_history: usize,
    /// The agents that come into view.
    pub agents: Vec<DrawnAgent>,
}

/// One road user over time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DrawnAgent {
    /// Its track id.
    pub id: String,
    /// Its part in the event, such as `ego`; `None` for everybody else.
    pub role: Option<String>,
    /// Length along the heading, metres.
    pub length_m: f64,
    /// Width, metres.
    pub width_m: f64,
    /// x (m), y (m) and heading (rad) in the scene frame by timestep; `None` where it was not tracked.
    pub states: Vec<Option<[f64; 3]>>,
}

impl SceneCard {
    /// Draws `scenes` (title and scene, all in the same frame) with `roles` highlighted; the view follows those tracks, or the
    /// ego where there are no roles.
    pub fn new(
        id: impl Into<String>,
        title: impl Into<String>,
        facts: Vec<Fact>,
        scenes: &[(&str, &Scene)],
        roles: &[(String, TrackId)],
    ) -> Self {
        let view = ViewRect::around(scenes, roles);
        let lanes = scenes.first().map_or_else(Vec::new, |(_, scene)| {
            scene.lanes.lanes().iter().map(DrawnLane::of).filter(|lane| lane.is_in(&view)).collect()
        });
        let panels = scenes.iter().map(|(name, scene)| ScenePanel::of(name, scene, roles, &view)).collect();
        Self { id: id.into(), title: title.into(), facts, view, lanes, panels }
    }
}

impl ViewRect {
    fn around(scenes: &[(&str, &Scene)], roles: &[(String, TrackId)]) -> Self {
        let mut points: Vec<Vec2> = Vec::new();
        for (_, scene) in scenes {
            for (i, track) in scene.tracks.iter().enumerate() {
                let followed =
                    if roles.is_empty() { i == scene.ego_idx } else { roles.iter().any(|(_, id)| *id == track.id) };
                if followed {
                    points.extend(track.trajectory.valid().map(|(_, state)| state.position).filter(|p| p.is_finite()));
                }
            }
        }
        let Some(first) = points.first().copied() else {
            return Self {
                min: [-MIN_VIEW_M.x / 2.0, -MIN_VIEW_M.y / 2.0],
                max: [MIN_VIEW_M.x / 2.0, MIN_VIEW_M.y / 2.0],
            };
        };
        let (mut min, mut max) = ([first.x, first.y], [first.x, first.y]);
        for point in points {
            min = [min[0].min(point.x), min[1].min(point.y)];
            max = [max[0].max(point.x), max[1].max(point.y)];
        }
        for (axis, least) in [MIN_VIEW_M.x, MIN_VIEW_M.y].into_iter().enumerate() {
            let missing = ((least - (max[axis] - min[axis])) / 2.0).max(MARGIN_M);
            min[axis] = (min[axis] - missing).floor();
            max[axis] = (max[axis] + missing).ceil();
        }
        Self { min, max }
    }

    /// Whether drawings of it stand better one below the other than side by side.
    pub fn is_long(&self) -> bool {
        let [width, height] = self.size();
        width > 1.6 * height
    }

    /// Width and height, metres.
    pub fn size(&self) -> [f64; 2] {
        [self.max[0] - self.min[0], self.max[1] - self.min[1]]
    }

    fn contains(&self, x: f64, y: f64) -> bool {
        (self.min[0]..=self.max[0]).contains(&x) && (self.min[1]..=self.max[1]).contains(&y)
    }

    /// Whether the bounding box of `points` reaches into the view.
    fn touches(&self, points: &[[f64; 2]]) -> bool {
        !points.is_empty()
            && (0..2).all(|axis| {
                points.iter().any(|p| p[axis] <= self.max[axis]) && points.iter().any(|p| p[axis] >= self.min[axis])
            })
    }
}

impl DrawnLane {
    fn of(lane: &Lane) -> Self {
        let points = |line: &crate::geometry::Polyline| line.0.iter().map(|p| [centi(p.x), centi(p.y)]).collect();
        Self { centerline: points(&lane.centerline), left: points(&lane.left), right: points(&lane.right) }
    }

    fn is_in(&self, view: &ViewRect) -> bool {
        [&self.centerline, &self.left, &self.right].into_iter().any(|line| view.touches(line))
    }
}

impl ScenePanel {
    fn of(title: &str, scene: &Scene, roles: &[(String, TrackId)], view: &ViewRect) -> Self {
        let agents = scene
            .tracks
            .iter()
            .map(|track| {
                let extent = track.extent_or_nominal();
                let state = |state: &crate::scene::State| {
                    state
                        .is_finite()
                        .then(|| [centi(state.position.x), centi(state.position.y), milli(state.heading_rad)])
                };
                DrawnAgent {
                    id: track.id.0.clone(),
                    role: roles.iter().find(|(_, id)| *id == track.id).map(|(role, _)| role.clone()),
                    length_m: extent.length_m,
                    width_m: extent.width_m,
                    states: track.trajectory.entries().iter().map(|entry| entry.as_ref().and_then(state)).collect(),
                }
            })
            .filter(|agent| agent.states.iter().flatten().any(|[x, y, _]| view.contains(*x, *y)))
            .collect();
        Self { title: title.to_owned(), dt_s: scene.dt_s, n_history: scene.n_history, agents }
    }
}

fn centi(value: f64) -> f64 {
    (value * 100.0).round() / 100.0
}

fn milli(value: f64) -> f64 {
    (value * 1000.0).round() / 1000.0
}
