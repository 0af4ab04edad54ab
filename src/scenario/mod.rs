//! The record of a generated scenario: its request, the findings and the judgment.

mod assessment;
mod drive_row;
mod ego_choice;
mod record;
mod request_tag;
mod verdict;

pub use assessment::Assessment;
pub use drive_row::DriveRow;
pub use ego_choice::EgoChoice;
pub use record::ScenarioRecord;
pub use request_tag::{BucketTag, RequestOutcome, RequestTag};
pub use verdict::VerdictRow;
