//! CommonRoad 2020a XML: a scenario as lanelets, obstacles and a planning problem.
//!
//! The format's time begins with the planning problem, at which every obstacle has its initial state: time step 0 is
//! the present of the scenario, and earlier states are not written.

mod identity;
mod lanelets;
mod obstacles;
mod planning_problem;
#[cfg(test)]
mod tests;

use super::text::number;
use super::xml::{Element, element, leaf};
use super::{EgoMotion, Error, ExportOutcome, Exporter, Item, Result, Written};
use crate::scene::State;
use crate::store::write_atomically;
use std::path::{Path, PathBuf};

pub(super) const NOTES: &str = "<benchmark id>.xml: CommonRoad 2020a, valid against its schema. Time step 0 is the \
    present of the scenario; what was observed before is not written. The planning problem begins where the ego is at \
    present; its goal is to survive: to drive on in the last second of the scenario, wherever the ego of the scenario \
    is then. The ego itself is no obstacle, unless the export was asked to replay it (tracks.tsv says which one it is \
    then): take it out before you plan. velocity is that along the heading, velocityY that to the left of it. Lanelets \
    are numbered in ascending order of the map's lane ids. The date in the files is a placeholder: equal corpora give \
    equal files. `djinn ingest --dataset commonroad` takes the files back, with ingest.n_history = 1 and \
    ingest.n_future as many steps as they go on.";

/// Writes a file for each scenario.
pub(super) struct CommonRoad {
    dir: PathBuf,
    ego: EgoMotion,
}

impl CommonRoad {
    pub(super) fn new(dir: &Path, ego: EgoMotion) -> Self {
        Self { dir: dir.to_owned(), ego }
    }
}

impl Exporter for CommonRoad {
    fn add(&mut self, item: &Item<'_>) -> Result<ExportOutcome> {
        let scene = item.scene();
        if !scene.has_future() {
            return Ok(ExportOutcome::LeftOut("no_future"));
        }
        let lanelets = lanelets::of(&scene.lanes.transformed(&scene.world_from_scene));
        if lanelets.elements.is_empty() {
            return Ok(ExportOutcome::LeftOut("no_lanes"));
        }
        let present = scene.current_timestep();
        let Some(problem) = planning_problem::of(item) else {
            return Ok(ExportOutcome::LeftOut("no_ego"));
        };
        // All elements of a file share their numbers.
        let first_obstacle_id = lanelets.elements.len() + 1;
        let obstacles = obstacles::of(item, self.ego, first_obstacle_id);
        let problem_id = first_obstacle_id + scene.tracks.len();
        let name = identity::benchmark_id(scene, item.number);
        let root = identity::root(item, &name)
            .children(lanelets.elements)
            .children(obstacles.elements)
            .child(problem.attr("id", problem_id));
        let file = format!("{name}.xml");
        write_atomically::<Error>(&self.dir.join(&file), |sink| Ok(root.write_document(sink)?))?;
        let assumed = [lanelets.assumed, obstacles.assumed].concat();
        let tracks = obstacles.tracks;
        Ok(ExportOutcome::Written(Written { file, name, first_timestep: present, tracks, assumed }))
    }
}

/// `<name><exact>…</exact></name>`.
fn exact(name: &'static str, value: impl std::fmt::Display) -> Element {
    element(name).child(leaf("exact", value))
}

/// The elements of all states: position, orientation, time, and velocity along the heading and to its left.
fn state(name: &'static str, state: &State, time_step: usize) -> Element {
    element(name)
        .child(position(state))
        .child(exact("orientation", number(state.heading_rad)))
        .child(exact("time", time_step))
        .child(exact("velocity", number(speed_mps(state))))
        .child(exact("velocityY", number(state.velocity.rotated(-state.heading_rad).y)))
}

fn position(state: &State) -> Element {
    element("position").child(point("point", state.position))
}

fn point(name: &'static str, point: crate::geometry::Vec2) -> Element {
    element(name).child(leaf("x", number(point.x))).child(leaf("y", number(point.y)))
}

/// The velocity along the heading; negative backward.
fn speed_mps(state: &State) -> f64 {
    state.velocity.dot(crate::geometry::Vec2::from_angle(state.heading_rad))
}
