//! Which parts of the operational design domain were recorded, and which have scenarios?
//!
//! Every scene has one [`Tag`] of each [`ATTRIBUTES`], found from its map and its present alone. [`CoverageTally`]
//! counts recorded time, recorded events and scenarios by tags and behavior, and gives [`CoverageRow`]s: each with its
//! rate, so that what never happens is no gap.

mod roads;
mod row;
mod tags;
mod tally;

pub use row::{CellState, CoverageRow, CoverageShare, shares};
pub use tags::{ATTRIBUTES, Attribute, Tag, TaggedScene, Tags};
pub use tally::CoverageTally;
