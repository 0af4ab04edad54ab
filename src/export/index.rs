//! The tables `index.tsv` and `tracks.tsv`, which map scenarios to files and tracks to names in them.
//!
//! Their cells are separated by tabs, because readers of INTERACTION take every `.csv` for a table of tracks.

use super::selection::is_accepted;
use super::{Error, Item, Result, Written};
use crate::rates::BucketRate;
use crate::store::AtomicFile;
use std::borrow::Cow;
use std::path::Path;

/// Writes `index.tsv`, one row a scenario, and `tracks.tsv`, one row a track.
pub(super) struct Index {
    scenarios: Table,
    tracks: Table,
}

impl Index {
    pub(super) fn begin(index: &Path, tracks: &Path) -> Result<Self> {
        let scenarios = [
            "scenario_id",
            "file",
            "name",
            "first_timestep",
            "scene_id",
            "dataset",
            "split",
            "place",
            "ego_track_id",
            "sweep",
            "requested_behavior",
            "verified",
            "accepted",
            "rate_per_1000_km",
            "rate_low",
            "rate_high",
            "rate_source",
        ];
        let track = ["scenario_id", "track_id", "name", "class", "is_ego", "event_role", "left_out"];
        Ok(Self { scenarios: Table::begin(index, b'\t', &scenarios)?, tracks: Table::begin(tracks, b'\t', &track)? })
    }

    pub(super) fn add(&mut self, item: &Item<'_>, written: &Written) -> Result<()> {
        let (record, scene) = (item.record, item.scene());
        let scenario_id = record.scenario.id.as_str();
        let rate = record.assessment.as_ref().and_then(|assessment| assessment.rate);
        let of_rate = |of: fn(BucketRate) -> Option<f64>| rate.and_then(of).map_or_else(String::new, |v| v.to_string());
        self.scenarios.row(&[
            scenario_id,
            &written.file,
            &written.name,
            &written.first_timestep.to_string(),
            &scene.id.0,
            scene.source.dataset.name(),
            scene.source.split.name(),
            &scene.source.place,
            &item.ego().id.0,
            &record.sweep,
            record.requested_behavior.as_deref().unwrap_or_default(),
            if record.verified { "true" } else { "false" },
            if is_accepted(record) { "true" } else { "false" },
            &of_rate(|rate| rate.per_1000_km),
            &of_rate(|rate| Some(rate.interval?.low)),
            &of_rate(|rate| Some(rate.interval?.high)),
            rate.map_or("", |rate| rate.source.name()),
        ])?;
        for (agent_idx, (track, name)) in scene.tracks.iter().zip(&written.tracks).enumerate() {
            self.tracks.row(&[
                scenario_id,
                &track.id.0,
                name.as_deref().unwrap_or_default(),
                track.class.name(),
                if agent_idx == item.ego_idx { "true" } else { "false" },
                item.event_role(agent_idx).unwrap_or_default(),
                name.as_ref().err().copied().unwrap_or_default(),
            ])?;
        }
        Ok(())
    }

    pub(super) fn finish(self) -> Result<()> {
        self.scenarios.finish()?;
        self.tracks.finish()
    }
}

/// A cell that spreadsheets take for text: with an apostrophe before anything that they would run as a formula.
fn no_formula(cell: &str) -> Cow<'_, str> {
    match cell.starts_with(['=', '+', '-', '@', '\t', '\r']) && cell.parse::<f64>().is_err() {
        true => Cow::Owned(format!("'{cell}")),
        false => Cow::Borrowed(cell),
    }
}

/// A table of text, which appears when it is complete.
pub(super) struct Table {
    path: std::path::PathBuf,
    writer: csv::Writer<AtomicFile>,
}

impl Table {
    pub(super) fn begin(path: &Path, delimiter: u8, header: &[&str]) -> Result<Self> {
        let writer = csv::WriterBuilder::new().delimiter(delimiter).from_writer(AtomicFile::create(path)?);
        let mut table = Self { path: path.to_owned(), writer };
        table.row(header)?;
        Ok(table)
    }

    pub(super) fn row(&mut self, cells: &[&str]) -> Result<()> {
        self.writer.write_record(cells.iter().map(|cell| no_formula(cell).into_owned())).map_err(|error| {
            match error.into_kind() {
                csv::ErrorKind::Io(io) => Error::Io(io),
                kind => Error::encode(&self.path)(format!("{kind:?}")),
            }
        })
    }

    pub(super) fn finish(self) -> Result<()> {
        let file = self.writer.into_inner().map_err(|error| Error::Io(error.into_error()))?;
        file.commit()?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_cell_is_a_formula_and_numbers_stay() {
        for formula in ["=HYPERLINK(\"x\")", "=cmd|' /C calc'!A0", "@SUM(1)", "+1+cmd", "-2+3", "\t=1", "\r=1"] {
            assert_eq!(no_formula(formula), format!("'{formula}"));
        }
        for text in ["", "-1", "+1.5", "-1e5", "a=b", "12", "DR_USA"] {
            assert_eq!(no_formula(text), text);
        }
    }
}
