//! One file a table: its columns, and how our types become rows and rows become our types.

pub(crate) mod assessment;
pub(crate) mod columns;
pub(crate) mod event;
mod event_list;
pub(crate) mod lane;
pub(crate) mod metric;
mod parameter_descriptions;
mod parameters;
pub(crate) mod prediction;
mod provenance;
pub(crate) mod recording;
mod request;
mod roles;
pub(crate) mod sample;
pub(crate) mod scenario;
pub(crate) mod scene;
mod scene_derived;
mod scene_header;
pub(crate) mod scene_tracks;
mod state_rows;
pub(crate) mod track;
pub(crate) mod verdict;
