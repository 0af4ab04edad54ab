//! The pipeline: which stages does it have, and where are their results?
//!
//! [`config`] reads a pipeline file, [`stages`] connects the sections to the domain code and passes them to the
//! [`engine`](crate::engine). [`cluster`] submits a pipeline to many machines, [`status`] reports its progress.

pub mod cluster;
pub mod config;
pub mod driven_by;
pub mod estimate;
pub mod inspect;
pub mod layout;
pub mod regenerate;
mod stage_id;
pub mod stages;
pub mod status;

pub use stage_id::{KINDS, StageId, kinds};
