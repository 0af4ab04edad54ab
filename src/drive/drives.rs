//! What the drivers made of one situation.

use super::margin::Margin;
use crate::generate::NamedDriver;
use crate::simulate::Driven;
use serde::{Deserialize, Serialize};

/// The drives from a situation.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Drives {
    /// Each with the name of its driver in tables, that under test first.
    pub(super) all: Vec<(String, Driven)>,
    /// The margin, where it was asked for.
    pub(super) margin: Option<Margin>,
}

impl Drives {
    /// The drive of a driver that has a name.
    pub(super) fn of(&self, driver: NamedDriver) -> Option<&Driven> {
        self.all.iter().find(|(name, _)| name == driver.name()).map(|(_, driven)| driven)
    }
}
