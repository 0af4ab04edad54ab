//! The obstacles of a scenario as tracks.

use super::map::point;
use crate::geometry::Vec2;
use crate::ingest::error::Malformed;
use crate::ingest::plausible_tracks::recorded_heading;
use crate::ingest::xml_tree::Element;
use crate::scene::{AgentClass, Extent, State, Track, TrackId, TrackRole, Trajectory};
use std::collections::BTreeSet;

/// The longest scenario, timesteps: times further apart are an error.
const MAX_TIME_STEPS: i64 = 1_000_000;

/// An obstacle with its states.
pub(super) struct Obstacle {
    id: TrackId,
    class: AgentClass,
    extent: Option<Extent>,
    /// By time step, in ascending order.
    states: Vec<(i64, State)>,
    is_static: bool,
}

/// The obstacles, and the reasons for those that are left out.
pub(super) fn read(root: &Element) -> (Vec<Obstacle>, Vec<String>) {
    let (mut obstacles, mut left_out): (Vec<Obstacle>, _) = (Vec::new(), Vec::new());
    let mut ids = BTreeSet::new();
    for element in root.children() {
        let is_static = match element.name.as_str() {
            "dynamicObstacle" => false,
            "staticObstacle" => true,
            // The format before 2020.
            "obstacle" => element.find(&["role"]).is_some_and(|role| role.text() == "static"),
            _ => continue,
        };
        match obstacle(element, is_static) {
            Ok(obstacle) if ids.insert(obstacle.id.clone()) => obstacles.push(obstacle),
            Ok(Obstacle { id, .. }) => {
                left_out.push(format!("obstacle {id} on line {}: the first of this id is kept", element.line));
            }
            Err(what) => {
                let (id, line) = (element.attribute("id").unwrap_or("without id"), element.line);
                left_out.push(format!("obstacle {id} on line {line}: {what}"));
            }
        }
    }
    (obstacles, left_out)
}

/// First and last time step at which any obstacle moves.
pub(super) fn time_steps(obstacles: &[Obstacle]) -> Option<(i64, i64)> {
    let moving = obstacles.iter().filter(|obstacle| !obstacle.is_static);
    let ends = moving.filter_map(|obstacle| Some((obstacle.states.first()?.0, obstacle.states.last()?.0)));
    ends.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
}

impl Obstacle {
    /// Its track over `n_timesteps` from `first` on; `None` if it is absent throughout.
    pub(super) fn cut(&self, first: i64, n_timesteps: usize) -> Option<Track> {
        let mut states = vec![None; n_timesteps];
        if self.is_static {
            states.fill(self.states.first().map(|(_, state)| *state));
        }
        for (time_step, state) in self.states.iter().filter(|_| !self.is_static) {
            let slot = usize::try_from(time_step - first).ok().and_then(|timestep| states.get_mut(timestep));
            slot.into_iter().for_each(|slot| *slot = Some(*state));
        }
        states.iter().any(Option::is_some).then(|| Track {
            id: self.id.clone(),
            class: self.class,
            role: if self.is_static && self.class.is_motorized() { TrackRole::Parked } else { TrackRole::Context },
            extent: self.extent,
            trajectory: Trajectory::new(states),
        })
    }
}

fn obstacle(element: &Element, is_static: bool) -> Result<Obstacle, Malformed> {
    let id = element.id("id")?;
    let kind = element.find(&["type"]).map(Element::text).unwrap_or_default();
    let class = class_of(kind).ok_or_else(|| format!("is of type \"{kind}\", which the format does not list"))?;
    let initial = element.find(&["initialState"]).ok_or("has no <initialState>")?;
    let later = element.find(&["trajectory"]).into_iter().flat_map(|trajectory| trajectory.all("state"));
    let states = std::iter::once(initial).chain(later).map(|state| read_state(state, class));
    let mut states = states.collect::<Result<Vec<_>, _>>()?;
    states.sort_by_key(|(time_step, _)| *time_step);
    if let Some(twice) = states.windows(2).find(|pair| pair[0].0 == pair[1].0) {
        return Err(format!("has two states at time {}", twice[0].0).into());
    }
    Ok(Obstacle { id: TrackId(id.to_string()), class, extent: extent(element)?, states, is_static })
}

fn read_state(element: &Element, class: AgentClass) -> Result<(i64, State), Malformed> {
    let time = element.number(&["time", "exact"])?;
    if time.fract() != 0.0 || time.abs() > MAX_TIME_STEPS as f64 {
        return Err(format!("has time {time}, expected a whole number up to {MAX_TIME_STEPS}").into());
    }
    // Positions that are areas are predictions, not recordings.
    let position =
        element.find(&["position", "point"]).ok_or_else(|| format!("has no exact position at time {time}"))?;
    let heading_rad = recorded_heading(element.number(&["orientation", "exact"])?, class);
    // Along the heading and to its left.
    let speed = |name: &str| match element.find(&[name, "exact"]) {
        Some(_) => element.number(&[name, "exact"]),
        None => Ok(0.0),
    };
    let velocity = Vec2::new(speed("velocity")?, speed("velocityY")?).rotated(heading_rad);
    Ok((time as i64, State { position: point(position)?, heading_rad, velocity }))
}

/// The size of its shape: of a rectangle, a circle, or the box around the points of a polygon.
fn extent(element: &Element) -> Result<Option<Extent>, Malformed> {
    let Some(shape) = element.find(&["shape"]) else { return Ok(None) };
    if let Some(rectangle) = shape.find(&["rectangle"]) {
        let (length_m, width_m) = (rectangle.number(&["length"])?, rectangle.number(&["width"])?);
        return sized(length_m, width_m);
    }
    if let Some(circle) = shape.find(&["circle"]) {
        let across_m = 2.0 * circle.number(&["radius"])?;
        return sized(across_m, across_m);
    }
    let Some(polygon) = shape.find(&["polygon"]) else { return Ok(None) };
    let points = polygon.all("point").map(point).collect::<Result<Vec<_>, _>>()?;
    let across = |of: fn(&Vec2) -> f64| {
        let (low, high) =
            points.iter().map(of).fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        high - low
    };
    sized(across(|point| point.x), across(|point| point.y))
}

fn sized(length_m: f64, width_m: f64) -> Result<Option<Extent>, Malformed> {
    match length_m > 0.0 && width_m > 0.0 {
        true => Ok(Some(Extent { length_m, width_m })),
        false => Err(format!("is {length_m} by {width_m} m in size").into()),
    }
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
