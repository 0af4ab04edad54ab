//! A cell of the operational design domain, and how many cells are covered.

use super::Tag;
use crate::settings::named;
use crate::statistics::Interval;

/// What was recorded and made of a behavior in surroundings with one tag, two, or any.
#[derive(Debug, Clone, PartialEq)]
pub struct CoverageRow {
    /// The tags, by attribute; `None` for any.
    pub tags: [Option<Tag>; 2],
    /// The behavior.
    pub behavior: String,
    /// The ranges of parameters, as text; empty for all events.
    pub within: String,
    /// Time that was recorded in such surroundings, hours.
    pub observed_h: f64,
    /// Recorded events, each once.
    pub n_recorded: u64,
    /// Recorded events an hour; `None` if no such surroundings were recorded.
    pub rate_per_hour: Option<f64>,
    /// Its 95 % interval.
    pub per_hour: Option<Interval>,
    /// Generated scenarios in which the behavior was asked for and found.
    pub n_generated: u64,
    /// Those of them that were accepted.
    pub n_accepted: u64,
}

/// What a cell is to one who asks for coverage.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum CellState {
    /// There are accepted scenarios.
    Covered,
    /// It was recorded, and there is no accepted scenario.
    Missing,
    /// Such surroundings were recorded, and it never happened in them: their rate says how rare it must be.
    NeverRecorded,
    /// No such surroundings were recorded.
    NoSuchPlace,
}

named! { CellState {
    Covered = "covered", Missing = "missing", NeverRecorded = "never_recorded", NoSuchPlace = "no_such_place",
} }

impl CoverageRow {
    /// What it is to one who asks for coverage.
    pub fn state(&self) -> CellState {
        match self {
            Self { n_accepted: 1.., .. } => CellState::Covered,
            Self { n_recorded: 1.., .. } => CellState::Missing,
            _ if self.observed_h > 0.0 => CellState::NeverRecorded,
            _ => CellState::NoSuchPlace,
        }
    }

    /// The number of its tags.
    pub fn n_tags(&self) -> usize {
        self.tags.iter().flatten().count()
    }
}

/// How many of the cells that were recorded have accepted scenarios.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct CoverageShare {
    /// Cells with recorded events.
    pub n_recorded: usize,
    /// Those of them with accepted scenarios.
    pub n_covered: usize,
}

/// The shares of cells with one tag, and of cells with two; buckets of parameters count beside all events.
pub fn shares(rows: &[CoverageRow]) -> [CoverageShare; 2] {
    [1, 2].map(|n_tags| {
        let recorded = || rows.iter().filter(|row| row.n_tags() == n_tags && row.n_recorded > 0);
        let n_covered = recorded().filter(|row| row.state() == CellState::Covered).count();
        CoverageShare { n_recorded: recorded().count(), n_covered }
    })
}
