//! OpenSCENARIO XML 1.2: a scenario as entities that follow trajectories.
//!
//! Every road user follows a polyline of timed vertices. Players interpret times differently, so the files use a form
//! that all of them read: vertices have times of the scenario (`absolute`), as some players assume anyway, and
//! conditions have no edge (`rising` would never fire at the start).

mod entities;
mod storyboard;
#[cfg(test)]
mod tests;

use super::text::{number, plain};
use super::xml::{Element, element};
use super::{EgoMotion, Error, ExportOutcome, Exporter, Item, Result, Written, opendrive};
use crate::scene::{SceneId, State};
use crate::store::write_atomically;
use entities::Body;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

pub(super) const NOTES: &str = "<id>.xosc: OpenSCENARIO XML 1.2, valid against its schema. Every road user follows a \
    trajectory, whose times are those of the scenario; positions of vehicles are those of their rear axles, as the \
    standard has it, and the bounding box says where the center is. Who enters later is added when it does, and who \
    leaves is deleted. roads/<id>.xodr: OpenDRIVE 1.7 with the lanes near the scenario, one file for all scenarios of \
    a scene, on a plane; roads are named for their lanes from left to right, which are side by side wherever they \
    begin and end together. Sizes along the vertical, axles and performance are not recorded; usual ones are written. \
    The date in the files is a placeholder: equal corpora give equal files.";

const ROADS_FOLDER: &str = "roads";
/// A fixed date, because the format requires one.
const DATE: &str = "1970-01-01T00:00:00";

/// Writes a file for each scenario, and one with its roads for each scene.
pub(super) struct OpenScenario {
    dir: PathBuf,
    ego: EgoMotion,
    roads: BTreeMap<SceneId, Roads>,
}

/// The roads of a scene.
#[derive(Debug, Clone, Default)]
struct Roads {
    /// The path relative to the export's folder; `None` if the scene has no lanes.
    file: Option<String>,
    assumed: Vec<(&'static str, u64)>,
}

impl OpenScenario {
    pub(super) fn new(dir: &Path, ego: EgoMotion) -> Self {
        Self { dir: dir.to_owned(), ego, roads: BTreeMap::new() }
    }

    /// The roads of a scenario's scene, which are written for its first scenario and named for it.
    fn roads(&mut self, item: &Item<'_>) -> Result<Roads> {
        let scene = item.scene();
        if let Some(roads) = self.roads.get(&scene.id) {
            return Ok(roads.clone());
        }
        let mut roads = Roads::default();
        if let Some(network) = opendrive::of(&scene.lanes.transformed(&scene.world_from_scene)) {
            let file = format!("{ROADS_FOLDER}/{}.xodr", item.stem);
            fs_err::create_dir_all(self.dir.join(ROADS_FOLDER))?;
            write_atomically::<Error>(&self.dir.join(&file), |sink| Ok(network.root.write_document(sink)?))?;
            roads = Roads { file: Some(file), assumed: network.assumed };
        }
        self.roads.insert(scene.id.clone(), roads.clone());
        Ok(roads)
    }
}

impl Exporter for OpenScenario {
    fn add(&mut self, item: &Item<'_>) -> Result<ExportOutcome> {
        let scene = item.scene();
        let names = names(item);
        let mut tracks = Vec::new();
        let mut actors: Vec<Actor> = Vec::new();
        let (mut n_nominal, mut n_split) = (0, 0);
        for (agent_idx, name) in names.into_iter().enumerate() {
            let track = &scene.tracks[agent_idx];
            let mut stretches = stretches(&item.world_states(agent_idx));
            let is_free = self.ego == EgoMotion::Free && agent_idx == item.ego_idx;
            if is_free {
                stretches = up_to_present(stretches, scene.current_timestep());
            }
            if stretches.is_empty() {
                tracks.push(Err("no_states"));
                continue;
            }
            n_nominal += u64::from(track.extent.is_none());
            n_split += stretches.len() as u64 - 1;
            for (part, (first_timestep, states)) in stretches.into_iter().enumerate() {
                let name = if part == 0 { name.clone() } else { format!("{name}_part{}", part + 1) };
                actors.push(Actor { name, body: Body::of(track), first_timestep, states, is_free });
            }
            tracks.push(Ok(name));
        }
        if tracks.get(item.ego_idx).is_none_or(|track| track.is_err()) {
            return Ok(ExportOutcome::LeftOut("no_ego"));
        }
        let roads = self.roads(item)?;
        let logic = roads.file.as_ref().map(|file| element("LogicFile").attr("filepath", file));
        // Players assume that the first entity is the ego.
        actors.sort_by_key(|actor| actor.name != EGO_NAME);
        let object =
            |actor: &Actor| element("ScenarioObject").attr("name", &actor.name).child(actor.body.element(&actor.name));
        let root = element("OpenSCENARIO")
            .child(header(item))
            .child(element("CatalogLocations"))
            .child(element("RoadNetwork").children(logic))
            .child(element("Entities").children(actors.iter().map(object)))
            .child(storyboard::of(&actors, scene.n_timesteps, scene.dt_s));
        let file = format!("{}.xosc", item.stem);
        write_atomically::<Error>(&self.dir.join(&file), |sink| Ok(root.write_document(sink)?))?;
        let assumed = [vec![("nominal_size", n_nominal), ("split_at_gap", n_split)], roads.assumed].concat();
        Ok(ExportOutcome::Written(Written { file, name: item.stem.clone(), first_timestep: 0, tracks, assumed }))
    }
}

/// An entity and how it moves.
struct Actor {
    name: String,
    body: Body,
    /// When it enters.
    first_timestep: usize,
    /// One state a timestep, of its center, in the recording's frame; at least one.
    states: Vec<State>,
    /// Whether a driving function takes it over after its last state.
    is_free: bool,
}

impl Actor {
    /// Its positions, with headings that continue beyond ±π, so that they are interpolated the short way.
    fn positions(&self) -> Vec<Element> {
        let mut heading_rad = None;
        let position = |state: &State| {
            let next_rad = heading_rad
                .map_or(state.heading_rad, |last: f64| last + crate::geometry::wrap_angle(state.heading_rad - last));
            heading_rad = Some(next_rad);
            let place = self.body.reference_point(state);
            let world = element("WorldPosition")
                .attr("x", number(place.x))
                .attr("y", number(place.y))
                .attr("z", "0")
                .attr("h", number(next_rad))
                .attr("p", "0")
                .attr("r", "0");
            element("Position").child(world)
        };
        self.states.iter().map(position).collect()
    }
}

/// The name of the ego's entity.
const EGO_NAME: &str = "Ego";

/// The unique names of the tracks' entities.
fn names(item: &Item<'_>) -> Vec<String> {
    let scene = item.scene();
    let mut used = BTreeSet::new();
    let name = |(agent_idx, track): (usize, &crate::scene::Track)| {
        let name =
            if agent_idx == item.ego_idx { EGO_NAME.to_owned() } else { format!("track_{}", plain(&track.id.0)) };
        if used.insert(name.clone()) { name } else { format!("{name}_number{agent_idx}") }
    };
    scene.tracks.iter().enumerate().map(name).collect()
}

/// The runs of consecutive states: first timestep and states of each.
fn stretches(entries: &[Option<State>]) -> Vec<(usize, Vec<State>)> {
    let mut stretches: Vec<(usize, Vec<State>)> = Vec::new();
    for (timestep, state) in entries.iter().enumerate() {
        let Some(state) = state else { continue };
        match stretches.last_mut() {
            Some((first, states)) if *first + states.len() == timestep => states.push(*state),
            _ => stretches.push((timestep, vec![*state])),
        }
    }
    stretches
}

/// The stretch with the present, up to it; `None` if there is no state at present.
fn up_to_present(stretches: Vec<(usize, Vec<State>)>, present: usize) -> Vec<(usize, Vec<State>)> {
    let holds_present = |(first, states): &(usize, Vec<State>)| (*first..first + states.len()).contains(&present);
    let held = stretches.into_iter().filter(holds_present);
    held.map(|(first, states)| (first, states.into_iter().take(present - first + 1).collect())).collect()
}

fn header(item: &Item<'_>) -> Element {
    let (record, scene) = (item.record, item.scene());
    let dataset = scene.source.dataset;
    let asked = record.requested_behavior.as_deref().unwrap_or("nothing");
    let verdict = if record.verified { "found" } else { "not found" };
    let description = format!("Generated scenario {}; asked for: {asked} ({verdict})", record.scenario.id);
    let property = |name: &str, value: &str| element("Property").attr("name", name).attr("value", value);
    let properties = element("Properties")
        .child(property("scenario_id", &record.scenario.id))
        .child(property("scene_id", &scene.id.0))
        .child(property("sweep", &record.sweep))
        .child(property("present_s", &number(scene.current_timestep() as f64 * scene.dt_s)));
    let license = super::xml::leaf("License", item.terms).attr("name", format!("terms of {}", dataset.name()));
    element("FileHeader")
        .attr("revMajor", 1)
        .attr("revMinor", 2)
        .attr("date", DATE)
        .attr("author", "djinn")
        .attr("description", description)
        .child(license)
        .child(properties)
}
