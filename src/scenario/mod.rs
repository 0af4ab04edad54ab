//! A generated scenario's record: what was requested, what was found, and how was it judged?

mod assessment;
mod drive_row;
mod record;
mod request_tag;
mod verdict;

pub use assessment::Assessment;
pub use drive_row::DriveRow;
pub use record::ScenarioRecord;
pub use request_tag::{BucketTag, RequestOutcome, RequestTag};
pub use verdict::VerdictRow;
