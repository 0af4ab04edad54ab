//! Turns downloaded datasets into scenes.
//!
//! A [`RecordingSource`] knows the formats of one dataset: it cuts files into [`RawUnit`]s, which are parsed in
//! parallel into [`RawScene`]s. The rest is the same for all datasets: ego, scene frame, agent cap, lanes, counts.
//!
//! A reader thread cuts folders and archives into units without unpacking to disk; one batch is stored while the next
//! is parsed. Velocities are derived from positions, those of the past from the past alone: recorded ones come from a
//! tracker, and trajectories that continue with them jump. A bad unit among many is rejected and counted by reason; a
//! missing map is an error, and so is an ingest that finds no scenes.

pub mod archive;
mod argoverse1;
mod argoverse2;
mod assemble;
pub(crate) mod assumed_bounds;
mod batches;
mod commonroad;
mod config;
mod copies;
mod csv_rows;
mod decimal;
mod driver;
mod error;
mod explanation;
mod files;
mod ids;
mod interaction;
mod interruptions;
mod lane_index;
mod lane_topology;
pub mod lanelet2;
mod map_catalog;
mod map_report;
mod map_text;
mod opendrive;
mod pairing;
mod parquet_columns;
mod places;
mod plausible_lanes;
mod plausible_tracks;
mod projection;
mod quotes;
mod raw;
mod recorded_track;
mod report;
mod source;
mod standing;
mod table;
#[cfg(test)]
mod test_data;
mod vicinity;
mod windows;
pub(crate) mod womd;
mod xml_tree;

pub use assemble::assemble_window;
pub use config::{IngestConfig, MapsConfig};
pub use driver::{Done, IngestBatch, ingest};
pub use error::{BoxError, Error};
pub use explanation::Explanation;
pub use places::NO_PLACE;
pub use projection::GeoPoint;
pub use raw::{Companion, Finding, HeadingGap, RawScene, RawUnit, Reject, UnitSplit, map_id};
pub use report::{IngestReport, RejectCount};
pub use source::{EmitUnit, Horizon, MapFile, PendingScene, RecordingSource, UnitReader};
pub use table::{HeadingUnit, PositionOf, TableColumns, TableMapping};
#[cfg(test)]
pub(crate) use test_data::{scenes as scenes_of, test_data};

use crate::scene::Dataset;

/// The configured timesteps of scenes.
///
/// # Errors
/// When more are configured than the dataset has.
pub fn usual_horizon(config: &IngestConfig) -> Result<Horizon, Error> {
    Ok(source_of(config)?.horizon())
}

/// The formats of the configured dataset.
fn source_of(config: &IngestConfig) -> Result<Box<dyn RecordingSource + '_>, Error> {
    let source: Box<dyn RecordingSource + '_> = match config.dataset {
        Dataset::Argoverse1 => Box::new(argoverse1::Argoverse1::new(config)?),
        Dataset::Argoverse2 => Box::new(argoverse2::Argoverse2::new(config)?),
        Dataset::Interaction => Box::new(interaction::Interaction::new(config)),
        Dataset::CommonRoad => Box::new(commonroad::CommonRoad::new(config)),
        Dataset::Womd => Box::new(womd::Womd::new(config)?),
        Dataset::Table => Box::new(table::Tables::new(config)?),
    };
    if source.has_own_maps() && !config.map_inputs.is_empty() {
        let detail = format!("cannot be used with {}: every scenario has its own map", config.dataset.name());
        return Err(Error::Config { key: "map_inputs".to_owned(), detail });
    }
    Ok(source)
}
