//! Driving functions in the loop: does a driver of the ego come through the scenarios of a corpus?
//!
//! [`drive_corpus`] drives every scenario in a closed loop, with a planner in a process of its own or a driver that has
//! a name, and with the careful driver of UN Regulation No. 157, too. [`score()`] takes trajectories instead, among
//! others that do not answer. `simulate` says how others answer.

mod action;
mod answer;
mod config;
mod drives;
mod ego_driver;
mod error;
mod external;
mod kept;
mod margin;
mod output;
mod page;
mod pool;
mod process;
pub mod protocol;
mod rates;
mod report;
mod run;
#[cfg(test)]
mod run_tests;
mod score;
mod starts;

pub use config::{DriveConfig, Origin, SaveAt};
pub use ego_driver::EgoDriver;
pub use error::{Error, Result};
pub use margin::{DelaySurvived, Margin, Margins};
pub use output::{DRIVE_FILE, DRIVE_PAGE, DRIVEN_FILE, DRIVES_FILE, PLANNER_LOG, STATES_DIR};
pub use process::kill_planners;
pub use rates::{BucketFailures, FailureRates, SplitFailures};
pub use report::{DriveReport, Failures, Matters, Part};
pub use run::drive_corpus;
pub use score::score;
