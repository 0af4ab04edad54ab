//! Chooses the scenarios of each sweep to draw, from thousands that are offered one by one.
//!
//! Sweeps with a requested behavior are represented by single scenarios: the hardest accepted ones, and some that
//! failed (before an evaluation, new verified ones from as many scenes as possible); requests by accepted scenarios of
//! each bucket. Other sweeps are represented by scenes with several samples, if possible the same scenes in all of
//! these sweeps, so that they can be compared. Limits bound how much of a sweep is kept in memory.

use super::accepted::Accepted;
use super::card::Verdict;
use super::config::ReportConfig;
use crate::scenario::{BucketTag, RequestOutcome, ScenarioRecord};
use crate::scene::SceneId;
use crate::store::SceneSet;
use std::collections::BTreeMap;

/// The most samples of a scene to draw over each other: as many as a sweep has by default.
const N_SAMPLES_DRAWN: usize = 6;
/// Scenarios of a sweep with a behavior that are verified and not accepted, and as many without the behavior.
const N_FAILED_DRAWN: usize = 3;
/// Accepted scenarios of each bucket of a request.
const N_DRAWN_PER_BUCKET: usize = 2;
/// Scenes of a sweep without a behavior, at each strength.
const N_SCENES_DRAWN: usize = 2;

/// How much of a sweep is drawn, and its limit.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Drawn {
    /// The sweep.
    pub sweep: String,
    /// The kind of scenario that is drawn, such as `verified scenarios`.
    pub what: String,
    /// How many are drawn.
    pub n_drawn: usize,
    /// How many exist.
    pub n_there: usize,
    /// The limit, or the setting of it: `report.n_drawn = 100`.
    pub limit: String,
}

/// The content of a drawing.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Chosen {
    /// One scenario.
    Alone(Box<ScenarioRecord>),
    /// Samples of one scene with the same settings.
    Together(Vec<ScenarioRecord>),
}

/// Collects candidates sweep by sweep.
pub(super) struct Choice<'a> {
    config: &'a ReportConfig,
    /// `None` if acceptance was not decided.
    accepted: Option<&'a Accepted>,
    sweeps: Vec<(String, Candidates)>,
    /// Accepted scenarios of requests, by request and bucket.
    buckets: BTreeMap<(String, usize), Ranked>,
}

enum Candidates {
    Asked(Box<AskedCandidates>),
    Galleries(Galleries),
}

/// The candidates of a sweep with a behavior.
struct AskedCandidates {
    accepted: Hardest,
    new: Ranked,
    recorded: Ranked,
    failed: Ranked,
}

impl<'a> Choice<'a> {
    pub(super) const fn new(config: &'a ReportConfig, accepted: Option<&'a Accepted>) -> Self {
        Self { config, accepted, sweeps: Vec::new(), buckets: BTreeMap::new() }
    }

    /// Offers the next scenario, in the order of the samples; its scene has this position in the store.
    pub(super) fn offer(&mut self, record: &ScenarioRecord, scene_idx: usize) {
        if let Some((request, bucket)) = accepted_into(record) {
            let of_bucket = self.buckets.entry((request.to_owned(), bucket.idx));
            return of_bucket.or_insert_with(|| Ranked::new(N_DRAWN_PER_BUCKET)).offer(record, scene_idx);
        }
        let at = self.sweeps.iter().position(|(sweep, _)| *sweep == record.sweep).unwrap_or_else(|| {
            self.sweeps.push((record.sweep.clone(), self.candidates(record)));
            self.sweeps.len() - 1
        });
        let min_ttc_s = self.accepted.and_then(|accepted| accepted.min_ttc_s(&record.scenario.id));
        match &mut self.sweeps[at].1 {
            Candidates::Asked(asked) => match (min_ttc_s, Verdict::of(record)) {
                (Some(min_ttc_s), _) => asked.accepted.offer(record, min_ttc_s),
                (None, Verdict::New) => asked.new.offer(record, scene_idx),
                (None, Verdict::Recorded) => asked.recorded.offer(record, scene_idx),
                (None, Verdict::NotVerified | Verdict::NotAsked) => asked.failed.offer(record, scene_idx),
            },
            Candidates::Galleries(galleries) => galleries.offer(record, scene_idx, N_SAMPLES_DRAWN),
        }
    }

    fn candidates(&self, record: &ScenarioRecord) -> Candidates {
        if record.requested_behavior.is_some() {
            let [new, recorded] = [self.n_verified_drawn(); 2].map(Ranked::new);
            let accepted = Hardest { limit: self.config.n_drawn, n_offered: 0, list: Vec::new() };
            let failed = Ranked::new(N_FAILED_DRAWN);
            return Candidates::Asked(Box::new(AskedCandidates { accepted, new, recorded, failed }));
        }
        let mut of_others = self.sweeps.iter().filter_map(|(_, candidates)| match candidates {
            Candidates::Galleries(galleries) => Some(galleries.own.clone()),
            Candidates::Asked(_) => None,
        });
        let preferred = of_others.next().unwrap_or_default();
        Candidates::Galleries(Galleries {
            limit: N_SCENES_DRAWN,
            scenes: SceneSet::default(),
            preferred,
            own: Vec::new(),
            kept: Vec::new(),
        })
    }

    /// How many verified scenarios of a sweep to draw if none is known to be accepted.
    const fn n_verified_drawn(&self) -> usize {
        if self.accepted.is_some() { N_FAILED_DRAWN } else { self.config.n_drawn }
    }

    /// How much of each sweep is drawn, in the order of the sweeps.
    pub(super) fn drawn(&self) -> Vec<Drawn> {
        let n_drawn = self.config.n_drawn;
        let row = |sweep: &str, what: &str, n_there: usize, limit: usize| Drawn {
            sweep: sweep.to_owned(),
            what: what.to_owned(),
            n_drawn: n_there.min(limit),
            n_there,
            limit: limit.to_string(),
        };
        let set = |row: Drawn| Drawn { limit: format!("report.n_drawn = {n_drawn}"), ..row };
        let rows = self.sweeps.iter().flat_map(|(sweep, candidates)| match candidates {
            Candidates::Asked(asked) => {
                let AskedCandidates { accepted, new, recorded, failed } = asked.as_ref();
                let n_verified = new.n_offered + recorded.n_offered;
                let verified = match self.accepted {
                    Some(_) => row(sweep, "verified, not accepted", n_verified, N_FAILED_DRAWN),
                    None => set(row(sweep, "verified scenarios", n_verified, n_drawn)),
                };
                let is_decided = self.accepted.is_some();
                let accepted = set(row(sweep, "accepted scenarios", accepted.n_offered, n_drawn));
                let failed = row(sweep, "without the behavior", failed.n_offered, N_FAILED_DRAWN);
                is_decided.then_some(accepted).into_iter().chain([verified, failed]).collect()
            }
            Candidates::Galleries(galleries) => {
                vec![row(sweep, "scenes, at each strength", galleries.scenes.len(), N_SCENES_DRAWN)]
            }
        });
        rows.chain(self.drawn_of_requests()).collect()
    }

    fn drawn_of_requests(&self) -> Vec<Drawn> {
        let mut rows: Vec<Drawn> = Vec::new();
        for ((request, _), accepted) in &self.buckets {
            if rows.last().is_none_or(|row| row.sweep != *request) {
                rows.push(Drawn {
                    sweep: request.clone(),
                    what: "accepted scenarios, of each bucket".to_owned(),
                    n_drawn: 0,
                    n_there: 0,
                    limit: N_DRAWN_PER_BUCKET.to_string(),
                });
            }
            if let Some(row) = rows.last_mut() {
                row.n_drawn += accepted.n_offered.min(N_DRAWN_PER_BUCKET);
                row.n_there += accepted.n_offered;
            }
        }
        rows
    }

    /// The choice: requests, bucket by bucket, then sweeps in their order.
    pub(super) fn finish(self) -> Vec<Chosen> {
        let n_verified = self.n_verified_drawn();
        let of_buckets = self.buckets.into_values().flat_map(Ranked::take);
        let mut chosen: Vec<Chosen> = of_buckets.map(|record| Chosen::Alone(Box::new(record))).collect();
        for (_, candidates) in self.sweeps {
            match candidates {
                Candidates::Asked(asked) => {
                    let AskedCandidates { accepted, new, recorded, failed } = *asked;
                    let accepted = accepted.list.into_iter().map(|(_, record)| record);
                    let verified = new.take().chain(recorded.take()).take(n_verified);
                    let all = accepted.chain(verified).chain(failed.take());
                    chosen.extend(all.map(|record| Chosen::Alone(Box::new(record))));
                }
                Candidates::Galleries(galleries) => chosen.extend(galleries.take().map(Chosen::Together)),
            }
        }
        chosen
    }
}

fn accepted_into(record: &ScenarioRecord) -> Option<(&str, &BucketTag)> {
    let tag = record.request.as_ref().filter(|tag| tag.outcome == RequestOutcome::Accepted)?;
    Some((&tag.request, tag.bucket.as_ref()?))
}

/// Up to `limit` scenarios: those with the shortest times to collision.
struct Hardest {
    limit: usize,
    n_offered: usize,
    list: Vec<(f64, ScenarioRecord)>,
}

impl Hardest {
    fn offer(&mut self, record: &ScenarioRecord, min_ttc_s: f64) {
        self.n_offered += 1;
        let at = self.list.partition_point(|(known_s, _)| known_s.total_cmp(&min_ttc_s).is_le());
        if at < self.limit {
            self.list.insert(at, (min_ttc_s, record.clone()));
            self.list.truncate(self.limit);
        }
    }
}

/// Up to `limit` scenarios, the first of each scene before further ones.
struct Ranked {
    limit: usize,
    n_offered: usize,
    scenes: SceneSet,
    firsts: Vec<ScenarioRecord>,
    further: Vec<ScenarioRecord>,
}

impl Ranked {
    fn new(limit: usize) -> Self {
        Self { limit, n_offered: 0, scenes: SceneSet::default(), firsts: Vec::new(), further: Vec::new() }
    }

    fn offer(&mut self, record: &ScenarioRecord, scene_idx: usize) {
        self.n_offered += 1;
        let is_first = self.scenes.insert(scene_idx);
        let list = if is_first { &mut self.firsts } else { &mut self.further };
        if list.len() < self.limit {
            list.push(record.clone());
        }
    }

    fn take(self) -> impl Iterator<Item = ScenarioRecord> {
        self.firsts.into_iter().chain(self.further).take(self.limit)
    }
}

/// Samples of some scenes of a sweep without a behavior, by scene and strength.
struct Galleries {
    limit: usize,
    scenes: SceneSet,
    /// Scenes that an earlier sweep drew.
    preferred: Vec<SceneId>,
    /// The first scenes of this sweep.
    own: Vec<SceneId>,
    kept: Vec<Vec<ScenarioRecord>>,
}

impl Galleries {
    fn offer(&mut self, record: &ScenarioRecord, scene_idx: usize, n_samples: usize) {
        let provenance = &record.scenario.provenance;
        let scene_id = &provenance.scene_id;
        self.scenes.insert(scene_idx);
        if !self.own.contains(scene_id) && self.own.len() < self.limit {
            self.own.push(scene_id.clone());
        }
        if !self.own.contains(scene_id) && !self.preferred.contains(scene_id) {
            return;
        }
        let is_same = |kept: &&mut Vec<ScenarioRecord>| {
            let other = &kept[0].scenario.provenance;
            other.scene_id == *scene_id && other.guidance.level == provenance.guidance.level
        };
        match self.kept.iter_mut().find(is_same) {
            Some(samples) if samples.len() < n_samples => samples.push(record.clone()),
            Some(_) => {}
            None => self.kept.push(vec![record.clone()]),
        }
    }

    /// The galleries of scenes that other sweeps draw, too, then of others up to the limit.
    fn take(self) -> impl Iterator<Item = Vec<ScenarioRecord>> {
        let scene_of = |kept: &[ScenarioRecord]| kept[0].scenario.provenance.scene_id.clone();
        let is_kept = |scene: &&SceneId| self.kept.iter().any(|kept| scene_of(kept) == **scene);
        let mut scenes: Vec<SceneId> = Vec::new();
        for scene in self.preferred.iter().chain(&self.own).filter(is_kept) {
            if scenes.len() < self.limit && !scenes.contains(scene) {
                scenes.push(scene.clone());
            }
        }
        let mut galleries: Vec<(usize, Vec<ScenarioRecord>)> = self
            .kept
            .into_iter()
            .filter_map(|kept| Some((scenes.iter().position(|scene| *scene == scene_of(&kept))?, kept)))
            .collect();
        galleries.sort_by_key(|(at, _)| *at);
        galleries.into_iter().map(|(_, kept)| kept)
    }
}
