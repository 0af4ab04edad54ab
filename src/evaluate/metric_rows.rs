//! Turns the figures of cells into rows: one for each scene, each scenario, each place, and all places together.
//!
//! Rows are spooled to files, because aggregates come first in the table but are known last. Memory grows with series,
//! places and metrics, not with scenes.

use super::cells::CellFigures;
use super::error::Result;
use super::measures::MetricDoc;
use crate::metrics::{AggregateTally, Group, MetricRow, SeriesKey};
use crate::scene::SceneId;
use crate::store::{self, Spool, Spooled};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A scene, and its scenarios that form a cell.
pub(super) struct CellNames<'a> {
    pub(super) series: &'a SeriesKey,
    pub(super) place: &'a str,
    pub(super) scene_id: &'a SceneId,
    /// The scenarios, in order.
    pub(super) scenario_ids: &'a [String],
}

/// The values of all metrics for a scene in a series, or for one of its scenarios.
#[derive(Debug, Serialize, Deserialize)]
struct Values {
    series: usize,
    place: String,
    scene_id: SceneId,
    /// `None` for the samples of the scene together.
    scenario_id: Option<String>,
    n_samples: u64,
    /// One for each metric; `None` where it is not defined.
    values: Vec<Option<f64>>,
}

/// Collects figures in files: one for each series of scenes, and one for the scenarios.
pub(super) struct MetricRows {
    docs: Vec<MetricDoc>,
    scratch: PathBuf,
    series: Vec<(SeriesKey, Spool<Values>)>,
    of_scenarios: Spool<Values>,
}

impl MetricRows {
    /// Starts without rows of these metrics. Creates files in the folder `scratch`, which last until the rows are
    /// removed.
    pub(super) fn create(docs: Vec<MetricDoc>, scratch: &Path) -> Result<Self> {
        let of_scenarios = Spool::create(&scratch.join("metrics.scenarios.spool"))?;
        Ok(Self { docs, scratch: scratch.to_owned(), series: Vec::new(), of_scenarios })
    }

    pub(super) fn add(&mut self, cell: &CellNames<'_>, figures: &CellFigures) -> Result<()> {
        let CellNames { series, place, scene_id, scenario_ids } = *cell;
        let parts = [
            (&SeriesKey::reference(Group::Recorded, &series.sweep), 1, figures.recorded.as_ref()),
            (&SeriesKey::reference(Group::ConstantVelocity, &series.sweep), 1, figures.constant_velocity.as_ref()),
            (series, scenario_ids.len() as u64, Some(&figures.together)),
        ];
        for (key, n_samples, values) in parts {
            let Some(values) = values.cloned() else { continue };
            let series = self.number_of(key)?;
            let (place, scene_id) = (place.to_owned(), scene_id.clone());
            let values = Values { series, place, scene_id, scenario_id: None, n_samples, values };
            self.series[series].1.push(&values)?;
        }
        let series = self.number_of(series)?;
        for (scenario_id, values) in scenario_ids.iter().zip(&figures.alone) {
            let (place, scene_id, scenario_id) = (place.to_owned(), scene_id.clone(), Some(scenario_id.clone()));
            let values = Values { series, place, scene_id, scenario_id, n_samples: 1, values: values.clone() };
            self.of_scenarios.push(&values)?;
        }
        Ok(())
    }

    /// Closes the files.
    pub(super) fn finish(self) -> Result<FinishedRows> {
        let series = self.series.into_iter().map(|(key, spool)| Ok((key, spool.finish()?)));
        Ok(FinishedRows {
            docs: self.docs,
            series: series.collect::<Result<_>>()?,
            of_scenarios: self.of_scenarios.finish()?,
        })
    }

    /// The number of a series; begins its file if it is new.
    fn number_of(&mut self, key: &SeriesKey) -> Result<usize> {
        if let Some(at) = self.series.iter().position(|(known, _)| known == key) {
            return Ok(at);
        }
        let name = format!("metrics.series-{}.spool", self.series.len());
        self.series.push((key.clone(), Spool::create(&self.scratch.join(name))?));
        Ok(self.series.len() - 1)
    }
}

/// The figures of an evaluation, in files that last until [`FinishedRows::remove`].
#[derive(Debug)]
pub(super) struct FinishedRows {
    docs: Vec<MetricDoc>,
    series: Vec<(SeriesKey, Spooled<Values>)>,
    of_scenarios: Spooled<Values>,
}

impl FinishedRows {
    /// Means over scenes: of all places together, then place by place, each in the order of series and metrics.
    pub(super) fn aggregates(&self) -> Result<Vec<MetricRow>> {
        let none = vec![vec![AggregateTally::default(); self.docs.len()]; self.series.len()];
        let mut by_place: BTreeMap<String, Vec<Vec<AggregateTally>>> = BTreeMap::from([(String::new(), none.clone())]);
        for visit in [AggregateTally::add, AggregateTally::compare] {
            for (at, (_, spool)) in self.series.iter().enumerate() {
                for scene in spool.values()? {
                    let Values { place, values, .. } = scene?;
                    if !by_place.contains_key(&place) {
                        by_place.insert(place.clone(), none.clone());
                    }
                    for place in ["", &place] {
                        let Some(here) = by_place.get_mut(place) else { continue };
                        let tallies = here[at].iter_mut().zip(&values);
                        tallies.for_each(|(tally, value)| value.iter().for_each(|value| visit(tally, *value)));
                    }
                }
            }
        }
        let mut rows = Vec::new();
        for (place, here) in &by_place {
            for ((key, _), tallies) in self.series.iter().zip(here) {
                for (doc, tally) in self.docs.iter().zip(tallies) {
                    let Some(aggregate) = tally.finish() else { continue };
                    let row = row(key, place, &doc.metric, aggregate.mean, aggregate.n);
                    rows.push(MetricRow { std_error: aggregate.std_error, ..row });
                }
            }
        }
        Ok(rows)
    }

    /// The values of every scene, in the order of series.
    pub(super) fn of_scenes(&self) -> Result<impl Iterator<Item = store::Result<MetricRow>>> {
        let spools = self.series.iter().map(|(_, spool)| self.rows(spool));
        Ok(spools.collect::<Result<Vec<_>>>()?.into_iter().flatten())
    }

    /// The values of every scenario, in the order of the samples.
    pub(super) fn of_scenarios(&self) -> Result<impl Iterator<Item = store::Result<MetricRow>>> {
        self.rows(&self.of_scenarios)
    }

    pub(super) fn remove(self) -> Result<()> {
        let mut spools = self.series.into_iter().map(|(_, spool)| spool).chain([self.of_scenarios]);
        Ok(spools.try_for_each(Spooled::remove)?)
    }

    /// A row for each metric with a value.
    fn rows<'r>(
        &'r self,
        spool: &'r Spooled<Values>,
    ) -> Result<impl Iterator<Item = store::Result<MetricRow>> + use<'r>> {
        Ok(spool.values()?.flat_map(|values| {
            let (rows, error) = match values.and_then(|values| self.rows_of(spool, values)) {
                Ok(rows) => (rows, None),
                Err(error) => (Vec::new(), Some(Err(error))),
            };
            rows.into_iter().map(Ok).chain(error)
        }))
    }

    fn rows_of(&self, spool: &Spooled<Values>, of: Values) -> store::Result<Vec<MetricRow>> {
        let series = self.series.get(of.series).filter(|_| of.values.len() == self.docs.len());
        let (key, _) = series.ok_or_else(|| spool.corrupt("a value is of no series or of other metrics"))?;
        let metrics = self.docs.iter().zip(of.values);
        let defined = metrics.filter_map(|(doc, value)| {
            let row = row(key, &of.place, &doc.metric, value?, of.n_samples);
            Some(MetricRow { scene_id: Some(of.scene_id.clone()), scenario_id: of.scenario_id.clone(), ..row })
        });
        Ok(defined.collect())
    }
}

fn row(key: &SeriesKey, place: &str, metric: &str, value: f64, n: u64) -> MetricRow {
    MetricRow {
        group: key.group.clone(),
        sweep: key.sweep.clone(),
        level: key.level,
        place: place.to_owned(),
        scene_id: None,
        scenario_id: None,
        metric: metric.to_owned(),
        value,
        n,
        std_error: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluate::testing::{evaluated_cell, record, recorded};
    use crate::scene::GuidanceLevel;

    #[test]
    fn scenes_and_scenarios_have_a_row_for_each_value_that_is_defined() {
        let (_, mut figures, docs) = evaluated_cell(&record(2.0, false, false, recorded()), &recorded());
        let n_values = figures.alone[0].iter().flatten().count();
        assert!(0 < n_values && n_values < docs.len());
        figures.alone.push(figures.alone[0].clone());
        let scratch = tempfile::tempdir().unwrap();
        let own = Group::Sweep("guided".to_owned());
        let series =
            SeriesKey { group: own.clone(), sweep: "guided".to_owned(), level: GuidanceLevel::of_strength(2.0) };
        let mut rows = MetricRows::create(docs, scratch.path()).unwrap();
        let scenario_ids = ["s-4".to_owned(), "s-5".to_owned()];
        let cell = CellNames { series: &series, place: "Test", scene_id: &recorded().id, scenario_ids: &scenario_ids };
        rows.add(&cell, &figures).unwrap();
        let rows = rows.finish().unwrap();

        let of_scenes: Vec<MetricRow> = rows.of_scenes().unwrap().collect::<store::Result<_>>().unwrap();
        let n_of = |group: &Group, n: u64| of_scenes.iter().filter(|row| row.group == *group && row.n == n).count();
        assert_eq!((n_of(&Group::Recorded, 1), n_of(&own, 2), n_of(&own, 1)), (n_values, n_values, 0));
        let all: Vec<MetricRow> = rows.of_scenarios().unwrap().collect::<store::Result<_>>().unwrap();
        let n_named = |id: &str| all.iter().filter(|row| row.scenario_id.as_deref() == Some(id)).count();
        assert_eq!((all.len(), n_named("s-4"), n_named("s-5")), (2 * n_values, n_values, n_values));
        assert_eq!(all[0].scenario_id.as_deref(), Some("s-4"));
        assert!(all.iter().all(|row| row.series() == series && row.place == "Test" && row.n == 1));
        assert!(all.iter().all(|row| row.scene_id == Some(recorded().id) && row.std_error.is_none()));
        rows.remove().unwrap();
        assert!(!scratch.path().join("metrics.scenarios.spool").exists());
    }

    #[test]
    fn figures_of_no_series_or_of_other_metrics_are_an_error() {
        let (_, figures, docs) = evaluated_cell(&record(2.0, false, false, recorded()), &recorded());
        let scratch = tempfile::tempdir().unwrap();
        let series = SeriesKey { group: Group::Unguided, sweep: "s".to_owned(), level: GuidanceLevel::UNGUIDED };
        let mut rows = MetricRows::create(docs, scratch.path()).unwrap();
        let scenario_ids = ["s-4".to_owned()];
        let cell = CellNames { series: &series, place: "A", scene_id: &recorded().id, scenario_ids: &scenario_ids };
        rows.add(&cell, &figures).unwrap();
        let mut rows = rows.finish().unwrap();
        let errors = |rows: &FinishedRows| {
            let found = rows.of_scenarios().unwrap().filter_map(|row| Some(row.err()?.to_string()));
            found.collect::<Vec<_>>()
        };
        assert_eq!(errors(&rows), [""; 0]);
        let doc = rows.docs.pop().unwrap();
        let of_other_metrics = errors(&rows);
        rows.docs.push(doc);
        rows.series.clear();
        for said in [of_other_metrics, errors(&rows)] {
            assert!(said.len() == 1 && said[0].contains("metrics.scenarios.spool"), "{said:?}");
        }
    }

    #[test]
    fn means_are_of_all_places_together_and_of_each() {
        let (_, figures, docs) = evaluated_cell(&record(2.0, false, false, recorded()), &recorded());
        let idx = figures.together.iter().position(Option::is_some).expect("a value");
        let scratch = tempfile::tempdir().unwrap();
        let series = SeriesKey { group: Group::Unguided, sweep: "s".to_owned(), level: GuidanceLevel::UNGUIDED };
        let mut rows = MetricRows::create(docs.clone(), scratch.path()).unwrap();
        for (place, value) in [("B", 1.0), ("A", 2.0), ("B", 5.0), ("B", 6.0)] {
            let mut figures = CellFigures { recorded: None, constant_velocity: None, ..figures.clone() };
            figures.together = vec![None; docs.len()];
            figures.together[idx] = Some(value);
            rows.add(&CellNames { series: &series, place, scene_id: &recorded().id, scenario_ids: &[] }, &figures)
                .unwrap();
        }
        let found = rows.finish().unwrap().aggregates().unwrap();
        let told: Vec<_> = found.iter().map(|row| (row.place.as_str(), row.value, row.n, row.std_error)).collect();
        // Deviations -2.5, -1.5, 1.5, 2.5: s² = 17 / 3; at B, -3, 1, 2: s² = 14 / 2.
        let [together, at_b] = [(17.0_f64 / 3.0 / 4.0).sqrt(), (7.0_f64 / 3.0).sqrt()];
        assert_eq!(told, [("", 3.5, 4, Some(together)), ("A", 2.0, 1, None), ("B", 4.0, 3, Some(at_b))]);
        assert!(found.iter().all(|row| row.metric == docs[idx].metric && row.series() == series));
    }
}
