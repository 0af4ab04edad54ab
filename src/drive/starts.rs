//! Chooses the scenarios to drive and makes ready their situations, some at a time.

use super::rates::{Buckets, bucket};
use super::{DriveConfig, Error, Origin, Result};
use crate::scenario::EgoChoice;
use crate::simulate::{self, MOST_HORIZON_S, Maps, Places, Situation};
use crate::store::{CorpusReader, SceneStore};
use std::collections::BTreeMap;
use std::path::Path;

/// The situations from which to drive, in the order of the corpus.
pub(super) struct Starts<'a> {
    corpus: &'a Path,
    reader: &'a CorpusReader,
    from: &'a Origin<'a>,
    ego: &'a EgoChoice,
    config: &'a DriveConfig,
    seed: u64,
    maps: Maps<'a>,
    positions: std::vec::IntoIter<usize>,
    n_chosen: usize,
    limit: usize,
    /// Scenarios that cannot be driven, by reason.
    left_out: BTreeMap<String, u64>,
    buckets: Buckets,
}

impl<'a> Starts<'a> {
    /// Those of `from`; recorded arrivals are those of `scenes`, or of the corpus without it.
    pub(super) fn new(
        (corpus, reader): (&'a Path, &'a CorpusReader),
        scenes: Option<&'a SceneStore>,
        (from, ego): (&'a Origin<'a>, &'a EgoChoice),
        config: &'a DriveConfig,
        seed: u64,
    ) -> Result<Self> {
        let (positions, limit) = match from {
            Origin::Scenarios(selection) => (selection.positions(reader)?, selection.limit.unwrap_or(usize::MAX)),
            Origin::State(world) => (vec![reader.position(&world.scenario_id)?], 1),
        };
        let maps = Maps::new(reader, scenes.map_or(reader, |scenes| scenes as &dyn Places));
        let (positions, left_out, buckets) = (positions.into_iter(), BTreeMap::new(), Buckets::new());
        Ok(Self { corpus, reader, from, ego, config, seed, maps, positions, n_chosen: 0, limit, left_out, buckets })
    }

    /// The most scenarios that there are to drive.
    pub(super) fn n_most(&self) -> usize {
        self.positions.len().min(self.limit)
    }

    /// The next situations, at most `n_most`; none at the end.
    pub(super) fn next(&mut self, n_most: usize) -> Result<Vec<Situation>> {
        let mut chunk = Vec::new();
        while chunk.len() < n_most && self.n_chosen < self.limit {
            let Some(position) = self.positions.next() else { break };
            let record = self.reader.scenario(position)?;
            if matches!(self.from, Origin::Scenarios(selection) if !selection.wants(&record)) {
                continue;
            }
            self.n_chosen += 1;
            match self.maps.situation(&record, self.ego) {
                Ok(mut situation) => {
                    let dt_s = situation.scene.dt_s;
                    let [n_steps, _] = self.config.rollout.n_steps(dt_s);
                    // A saved state may be from a longer drive.
                    let (n_tracks, n_known) = match self.from {
                        Origin::Scenarios(_) => (0, n_steps),
                        Origin::State(world) => (world.n_tracks(), (MOST_HORIZON_S / dt_s) as usize),
                    };
                    self.maps.expect_arrivals(&mut situation, self.seed, [n_steps, n_tracks, n_known])?;
                    chunk.push(situation);
                    let bucket = bucket(&record, self.reader.manifest());
                    self.buckets.extend(bucket.map(|bucket| (record.scenario.id.clone(), bucket)));
                }
                Err(simulate::Error::Unfit { why, .. }) => *self.left_out.entry(why).or_default() += 1,
                Err(error) => return Err(error.into()),
            }
        }
        Ok(chunk)
    }

    /// The scenarios that could not be driven, by reason, and the buckets of the others, once all are.
    pub(super) fn finish(self) -> Result<(BTreeMap<String, u64>, Buckets)> {
        let n_left_out: u64 = self.left_out.values().sum();
        match self.n_chosen {
            0 => {
                let wanted = match self.from {
                    Origin::Scenarios(selection) => selection.words(),
                    Origin::State(_) => "there".to_owned(),
                };
                let (corpus, n_scenarios) = (self.corpus.to_owned(), self.reader.len());
                Err(Error::NothingSelected { corpus, n_scenarios, wanted })
            }
            n_chosen if n_left_out == n_chosen as u64 => {
                let reasons: Vec<String> =
                    self.left_out.iter().map(|(why, n)| format!("{n} times, it {why}")).collect();
                Err(Error::NothingDriven { n_chosen, why: reasons.join("; ") })
            }
            _ => Ok((self.left_out, self.buckets)),
        }
    }
}
