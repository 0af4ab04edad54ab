//! Recordings in: how do downloaded datasets become scenes?

pub mod archive;
mod config;
mod error;
mod raw;
mod report;
mod source;

pub use config::{AgentsPresent, IngestConfig, MapsConfig};
pub use error::{BoxError, Error};
pub use raw::{Companion, RawScene, RawUnit, Reject, UnitSplit, map_id};
pub use report::{IngestReport, RejectCount};
pub use source::{EmitUnit, Horizon, RecordingSource, UnitReader};
