//! The page of drives: where a planner fails but a careful driver does not, with both drives side by side.

use super::card::SceneCard;
use super::model::Fact;
use super::number::value;
use super::plain::PlainTable;

/// The page as plain data.
#[derive(Debug, Clone, PartialEq)]
pub struct DrivesPage {
    /// Its title.
    pub title: String,
    /// Facts about the drives.
    pub facts: Vec<Fact>,
    /// Tables of outcomes and traffic.
    pub tables: Vec<PlainTable>,
    /// Failures by behavior and surroundings, and by two parameters of each behavior.
    pub grids: Vec<DriveGrid>,
    /// The drawn scenarios that the careful driver survives and the planner does not, hardest first.
    pub scenes: Vec<SceneCard>,
    /// The number of all such scenarios, drawn or not.
    pub n_matter: usize,
}

/// Failures in cells of a grid, such as by two parameters of a behavior.
#[derive(Debug, Clone, PartialEq)]
pub struct DriveGrid {
    /// Its title.
    pub title: String,
    /// What columns are of, and rows.
    pub axes: [String; 2],
    /// The names of columns, and of rows.
    pub names: [Vec<String>; 2],
    /// By row and column.
    pub cells: Vec<Vec<DriveCell>>,
}

impl DriveGrid {
    /// The name of a range of a parameter.
    pub fn range([low, high]: [f64; 2]) -> String {
        format!("{} to {}", value(low), value(high))
    }
}

/// The scenarios of a cell.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct DriveCell {
    /// Scenarios.
    pub n: u64,
    /// Scenarios that the planner fails, and those of them that the careful driver survives.
    pub n_failed: u64,
    /// See `n_failed`.
    pub n_avoidable: u64,
    /// Scenarios that the careful driver fails.
    pub n_careful_failed: u64,
}
