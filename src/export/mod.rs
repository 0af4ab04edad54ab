//! Exports corpora to other formats.
//!
//! Every format is an `Exporter`, which gets one scenario after the other. [`export_corpus`] chooses scenarios,
//! counts what a format cannot represent, and writes the files of all exports: `index.tsv` and `tracks.tsv` (scenarios
//! and tracks by their names in the corpus), `NOTICE.txt` (sources and their terms) and, last, `export.json`. All
//! positions are in the recording's frame, where the maps of the sources lie, too.

mod argoverse2;
mod commonroad;
mod ego;
mod error;
mod index;
mod interaction;
mod lane_bounds;
mod notice;
mod opendrive;
mod openlabel;
mod openscenario;
mod report;
mod run;
mod selection;
#[cfg(test)]
mod testing;
mod text;
mod womd;
mod xml;

pub use ego::EgoMotion;
pub use error::{Error, Result};
pub use report::{ExportReport, LeftOut};
pub use run::{EXPORT_FILE, INDEX_FILE, NOTICE_FILE, TRACKS_FILE, export_corpus};
pub use selection::Selection;

use crate::scenario::ScenarioRecord;
use crate::scene::{Scene, State, Track};
use crate::settings::named;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// The formats.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ExportFormat {
    /// Cases of the INTERACTION dataset.
    Interaction,
    /// Scenarios of Argoverse 2 motion forecasting.
    Argoverse2,
    /// Scenarios of Waymo Open Motion.
    Womd,
    /// CommonRoad scenarios with planning problems.
    CommonRoad,
    /// OpenSCENARIO XML with trajectories, and OpenDRIVE with the roads.
    OpenScenario,
    /// OpenLABEL scenario tags.
    OpenLabel,
}

named! { ExportFormat {
    Interaction = "interaction", Argoverse2 = "argoverse2", Womd = "womd", CommonRoad = "commonroad",
    OpenScenario = "openscenario", OpenLabel = "openlabel",
} }

impl ExportFormat {
    /// Its description in a line.
    pub const fn description(self) -> &'static str {
        match self {
            Self::Interaction => "cases as INTERACTION v1.2 has them: one CSV for each place and split",
            Self::Argoverse2 => "Argoverse 2 motion forecasting: a folder for each scenario with Parquet and map JSON",
            Self::Womd => "Waymo Open Motion: Scenario protos with their maps, one TFRecord for each split",
            Self::CommonRoad => "CommonRoad 2020a XML: lanelets, obstacles from the present on, a planning problem",
            Self::OpenScenario => {
                "OpenSCENARIO XML 1.2: every road user follows its trajectory, on roads in OpenDRIVE 1.7"
            }
            Self::OpenLabel => "OpenLABEL 1.0 JSON: tags for behaviors, roles, parameters and provenance; no states",
        }
    }

    /// Notes for readers of its files, which go into `NOTICE.txt`.
    const fn notes(self) -> &'static str {
        match self {
            Self::Interaction => interaction::NOTES,
            Self::Argoverse2 => argoverse2::NOTES,
            Self::Womd => womd::NOTES,
            Self::CommonRoad => commonroad::NOTES,
            Self::OpenScenario => openscenario::NOTES,
            Self::OpenLabel => openlabel::NOTES,
        }
    }

    /// Begins an export into `dir`, which exists and is empty.
    fn begin(self, dir: &Path, ego: EgoMotion) -> Box<dyn Exporter> {
        match self {
            Self::Interaction => Box::new(interaction::Interaction::new(dir)),
            Self::Argoverse2 => Box::new(argoverse2::Argoverse2::new(dir)),
            Self::Womd => Box::new(womd::Womd::new(dir)),
            Self::CommonRoad => Box::new(commonroad::CommonRoad::new(dir, ego)),
            Self::OpenScenario => Box::new(openscenario::OpenScenario::new(dir, ego)),
            Self::OpenLabel => Box::new(openlabel::OpenLabel::new(dir)),
        }
    }

    /// Whether the ego can be left free. Formats of recordings contain all agents.
    pub const fn can_free_ego(self) -> bool {
        matches!(self, Self::CommonRoad | Self::OpenScenario)
    }

    /// The default motion of the ego. CommonRoad is for planners, which would collide with a replayed ego at their
    /// first step.
    pub const fn usual_ego(self) -> EgoMotion {
        match self {
            Self::CommonRoad => EgoMotion::Free,
            Self::Interaction | Self::Argoverse2 | Self::Womd | Self::OpenScenario | Self::OpenLabel => {
                EgoMotion::Replayed
            }
        }
    }
}

/// A writer of one format.
trait Exporter {
    /// Adds a scenario.
    ///
    /// # Errors
    /// On I/O errors. A scenario that the format cannot represent is not an error but
    /// [`ExportOutcome::LeftOut`].
    fn add(&mut self, item: &Item<'_>) -> Result<ExportOutcome>;

    /// Finishes files that span scenarios.
    fn finish(self: Box<Self>) -> Result<()> {
        Ok(())
    }
}

/// A scenario to be exported.
struct Item<'a> {
    record: &'a ScenarioRecord,
    /// Counted from 1 over the scenarios that were chosen.
    number: usize,
    /// The scenario's id in a form that can name a file; unique in an export.
    stem: String,
    /// Index into the scene's tracks.
    ego_idx: usize,
    terms: &'a str,
}

impl Item<'_> {
    const fn scene(&self) -> &Scene {
        &self.record.scenario.scene
    }

    fn ego(&self) -> &Track {
        &self.scene().tracks[self.ego_idx]
    }

    /// The states of an agent in the recording's frame, one entry a timestep.
    fn world_states(&self, agent_idx: usize) -> Vec<Option<State>> {
        let scene = self.scene();
        let entries = scene.tracks[agent_idx].trajectory.entries();
        entries.iter().map(|state| state.map(|state| state.transformed(&scene.world_from_scene))).collect()
    }

    /// The role of a track in the requested event.
    fn event_role(&self, agent_idx: usize) -> Option<&str> {
        let id = &self.scene().tracks[agent_idx].id;
        let event = self.record.main_event()?;
        event.roles.role_of(id)
    }
}

enum ExportOutcome {
    Written(Written),
    /// Why it was left out: a stable code, such as `no_lanes`.
    LeftOut(&'static str),
}

/// A scenario as it was written.
struct Written {
    /// The file or folder, relative to the export's.
    file: String,
    /// The scenario's name in the format, such as the number of a case.
    name: String,
    /// The scenario's timestep at the format's first time.
    first_timestep: usize,
    /// For each track its name in the file, or a stable code for the reason why it is left out.
    tracks: Vec<std::result::Result<String, &'static str>>,
    /// Counts by stable code of values that the format requires and the scenario lacks, or that the format cannot
    /// represent.
    assumed: Vec<(&'static str, u64)>,
}
