//! The obstacles of a scenario as tracks.

use super::map::point;
use super::shape::enclosing;
use crate::geometry::Vec2;
use crate::ingest::error::Malformed;
use crate::ingest::recorded_track::{Observation, RecordedTrack};
use crate::ingest::source::Horizon;
use crate::ingest::vicinity::Vicinity;
use crate::ingest::xml_tree::Element;
use crate::scene::{AgentClass, Track, TrackId, TrackRole, Trajectory};
use crate::settings::in_words;
use std::collections::BTreeSet;

/// The longest scenario, timesteps: times further apart are an error.
const MAX_TIME_STEPS: i64 = 1_000_000;

/// The obstacles of a scenario.
#[derive(Default)]
pub(super) struct Obstacles {
    pub(super) read: Vec<Obstacle>,
    /// The reasons for those that are left out.
    pub(super) left_out: Vec<String>,
    /// Obstacles and predictions that nobody recorded, which are not read.
    pub(super) ignored: Vec<String>,
}

pub(super) struct Obstacle {
    track: RecordedTrack,
    is_static: bool,
}

/// The obstacles, and the reasons for those that are left out.
pub(super) fn read(root: &Element, vicinity: Vicinity) -> Obstacles {
    let mut found = Obstacles::default();
    let mut ids = BTreeSet::new();
    for element in root.children() {
        let (id, line) = (element.attribute("id").unwrap_or("without id"), element.line);
        let is_static = match element.name.as_str() {
            "dynamicObstacle" => false,
            "staticObstacle" => true,
            // The format before 2020.
            "obstacle" => element.find(&["role"]).is_some_and(|role| role.text() == "static"),
            "phantomObstacle" | "environmentObstacle" => {
                found.ignored.push(format!("<{}> {id} on line {line}", element.name));
                continue;
            }
            _ => continue,
        };
        if let Some(set) = element.find(&["occupancySet"]) {
            found.ignored.push(format!("<occupancySet> of obstacle {id} on line {}", set.line));
        }
        match obstacle(element, is_static, vicinity) {
            Ok(obstacle) if ids.insert(obstacle.track.id.clone()) => found.read.push(obstacle),
            Ok(_) => found.left_out.push(format!("obstacle {id} on line {line}: the first of this id is kept")),
            Err(what) => found.left_out.push(format!("obstacle {id} on line {line}: {what}")),
        }
    }
    found
}

/// First and last time step at which any obstacle moves.
pub(super) fn time_steps(obstacles: &[Obstacle]) -> Option<(i64, i64)> {
    let moving = obstacles.iter().filter(|obstacle| !obstacle.is_static);
    let ends = moving.filter_map(|obstacle| obstacle.track.frames());
    ends.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
}

impl Obstacle {
    /// Its track over the timesteps from `first` on; `None` if it is absent throughout.
    pub(super) fn cut(&self, first: i64, horizon: Horizon) -> Option<Track> {
        let n_timesteps = horizon.n_timesteps();
        if !self.is_static {
            return self.track.cut(first, n_timesteps, horizon.n_history);
        }
        let track = self.track.cut(self.track.frames()?.0, 1, 1)?;
        let state = track.trajectory.get(0).copied();
        Some(Track { trajectory: Trajectory::new(vec![state; n_timesteps]), ..track })
    }
}

fn obstacle(element: &Element, is_static: bool, vicinity: Vicinity) -> Result<Obstacle, Malformed> {
    let id = TrackId(element.id("id")?.to_string());
    let kind = element.find(&["type"]).map(Element::text).unwrap_or_default();
    let class = class_of(kind).ok_or_else(|| format!("is of type \"{kind}\", which the format does not list"))?;
    let initial = element.find(&["initialState"]).ok_or("has no <initialState>")?;
    let later = element.find(&["trajectory"]).into_iter().flat_map(|trajectory| trajectory.all("state"));
    let states = std::iter::once(initial).chain(later).map(|state| observation(state, vicinity));
    let mut states = states.collect::<Result<Vec<_>, _>>()?;
    states.sort_by_key(|state| state.frame);
    if let Some(twice) = states.windows(2).find(|pair| pair[0].frame == pair[1].frame) {
        return Err(format!("has two states at time {}", twice[0].frame).into());
    }
    let (extent, center) = enclosing(element)?.unzip();
    let role = if is_static && class.is_motorized() { TrackRole::Parked } else { TrackRole::Context };
    let mut track = RecordedTrack::new(id, class, role, extent, &states);
    // A position is that of any point of the obstacle, such as its rear axle.
    for (_, state, _) in &mut track.states {
        state.position = state.position + center.unwrap_or(Vec2::ZERO).rotated(state.heading_rad);
    }
    Ok(Obstacle { track, is_static })
}

fn observation(element: &Element, vicinity: Vicinity) -> Result<Observation, Malformed> {
    let time = element.number(&["time", "exact"])?;
    if time.fract() != 0.0 || !(0.0..=MAX_TIME_STEPS as f64).contains(&time) {
        return Err(format!("has time {}, expected a whole number from 0 to {MAX_TIME_STEPS}", in_words(time)).into());
    }
    // Positions that are areas are predictions, not recordings.
    let position =
        element.find(&["position", "point"]).ok_or_else(|| format!("has no exact position at time {time}"))?;
    let exact = |name: &str| element.find(&[name]).map(|_| element.number(&[name, "exact"])).transpose();
    let heading_rad = exact("orientation")?;
    // Along the heading and to its left; along x and y if there is no heading.
    let speed = |name: &str| match element.find(&[name, "exact"]) {
        Some(_) => element.number(&[name, "exact"]),
        None => Ok(0.0),
    };
    let velocity = Vec2::new(speed("velocity")?, speed("velocityY")?).rotated(heading_rad.unwrap_or(0.0));
    Ok(Observation { frame: time as i64, position: vicinity.checked(point(position)?)?, velocity, heading_rad })
}

/// The class of a type; `None` if the format does not list it.
fn class_of(kind: &str) -> Option<AgentClass> {
    Some(match kind {
        "car" | "truck" | "priorityVehicle" | "taxi" | "parkedVehicle" => AgentClass::Vehicle,
        "bus" => AgentClass::Bus,
        "motorcycle" => AgentClass::Motorcyclist,
        "bicycle" => AgentClass::Cyclist,
        "pedestrian" => AgentClass::Pedestrian,
        "roadBoundary" | "constructionZone" | "building" | "pillar" | "median_strip" | "medianStrip" => {
            AgentClass::Static
        }
        "unknown" | "train" => AgentClass::Unknown,
        _ => return None,
    })
}
