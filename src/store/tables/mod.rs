//! One file per table: its columns, and the conversion between our types and rows.

pub(crate) mod assessment;
pub(crate) mod columns;
pub(crate) mod coverage;
pub(crate) mod drive;
pub(crate) mod driven;
pub(crate) mod event;
mod event_list;
pub(crate) mod exposure;
pub(crate) mod lane;
pub(crate) mod metric;
mod parameter_descriptions;
mod parameters;
mod provenance;
pub(crate) mod rate;
pub(crate) mod recording;
mod request;
mod roles;
pub(crate) mod sample;
pub(crate) mod scenario;
pub(crate) mod scene;
mod scene_derived;
pub(crate) mod scene_header;
pub(crate) mod scene_tracks;
mod state_rows;
pub(crate) mod tag;
pub(crate) mod track;
pub(crate) mod verdict;

use super::schema::{ColumnExt, column};
use arrow::datatypes::{DataType, Field};

/// The strength of a guidance level.
fn strength_column() -> Field {
    column("strength", DataType::Float64, "Strength α of guidance; 0 without.").unit("1")
}

/// The weight of a guidance level.
fn weight_column() -> Field {
    column("weight", DataType::Float64, "Weight λ of classifier-free guidance; 0 without.").unit("1")
}
