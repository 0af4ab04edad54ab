//! Does a generated scenario meet the request, and is there room for it?

use super::config::RequestConfig;
use super::event_values::EventValues;
use super::facts::{CAREFUL_MARGIN, Facts};
use super::ledger::{CellTally, Ledger, ShardTally};
use super::limits;
use super::pool::Pool;
use super::resolve::ResolvedRequest;
use super::rounds::RoundShard;
use crate::behavior::Behavior;
use crate::generate::{Cell, Error, Generator};
use crate::metrics::{CarefulReplay, PairPath, SampleGroup};
use crate::scenario::{BucketTag, RequestOutcome, RequestTag, ScenarioRecord};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// The part of the decision that does not depend on other scenarios.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Placement {
    NotFound,
    Outside,
    BeyondLimits(usize),
    Hit(usize),
}

/// The bucket of a scenario of a shard, with or without room: enough to decide on the scenario later, in its turn.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PlacedScenario {
    /// The place of its cell within the shard.
    cell: usize,
    placement: Placement,
    /// The motion of the requested agents; present for hits.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    path: Option<PairPath>,
    /// The event; present for hits.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    event: Option<EventValues>,
}

impl Generator<'_> {
    /// Tags the records of a finished shard of `request`, in round `round`, with their outcome, and counts them.
    /// `ledger` holds all earlier shards. Scenarios of one cell count in the order of their records.
    pub fn judge(
        &self,
        (request, round): (&ResolvedRequest, usize),
        (pool, shard): (&Pool, &RoundShard),
        ledger: &Ledger,
        records: &mut [ScenarioRecord],
    ) -> Result<ShardTally, Error> {
        let placed = self.place(request, (pool, shard), records)?;
        let (tally, tags) = request.decide(round, shard, ledger, &placed);
        records.iter_mut().zip(tags).for_each(|(record, tag)| record.request = Some(tag));
        Ok(tally)
    }

    /// Finds the buckets of the records of a finished shard of `request`, in order.
    pub fn place(
        &self,
        request: &ResolvedRequest,
        (pool, shard): (&Pool, &RoundShard),
        records: &[ScenarioRecord],
    ) -> Result<Vec<PlacedScenario>, Error> {
        let own_cell = |record: &ScenarioRecord| {
            let provenance = &record.scenario.provenance;
            let is_own = |cell: &Cell| cell.scene_id == provenance.scene_id && cell.roles == provenance.guidance.roles;
            shard.members.iter().position(|member| is_own(&pool.cells[*member])).ok_or_else(|| Error::Stale {
                scene_id: provenance.scene_id.clone(),
                detail: "a scenario does not belong to any cell of its shard".to_owned(),
            })
        };
        let place = |record: &ScenarioRecord| {
            let cell = own_cell(record)?;
            let placement = self.placement(request, &pool.cells[shard.members[cell]], record)?;
            let asked = &record.scenario.provenance.guidance.roles;
            let is_hit = matches!(placement, Placement::Hit(_));
            let path = if is_hit { PairPath::of(&record.scenario.scene, asked) } else { None };
            let names = request.told_apart_by(self.behavior(&self.config.sweeps[shard.plan.sweep_idx]));
            let event = record.main_event().filter(|_| is_hit);
            let event = event.map(|event| EventValues::of(event, names.iter().map(String::as_str)));
            Ok(PlacedScenario { cell, placement, path, event })
        };
        records.par_iter().map(place).collect()
    }

    fn placement(&self, request: &ResolvedRequest, cell: &Cell, record: &ScenarioRecord) -> Result<Placement, Error> {
        let Some(event) = record.main_event() else { return Ok(Placement::NotFound) };
        let scene = &record.scenario.scene;
        let RequestConfig { buckets, conditions, .. } = &request.config;
        let subject = record.subject_idx();
        let subject =
            subject.filter(|_| buckets.contains_key(CAREFUL_MARGIN) || conditions.contains_key(CAREFUL_MARGIN));
        let replay = subject.and_then(|subject_idx| CarefulReplay::of(scene, subject_idx));
        let facts = Facts { scene, event, careful_margin_s: replay.map(|replay| replay.margin_s()) };
        let is_allowed = request.config.conditions.iter().all(|(name, condition)| facts.satisfies(name, condition));
        let Some(bucket) = request.buckets.place(&facts).filter(|_| is_allowed) else { return Ok(Placement::Outside) };
        let recorded = self.load(cell.scene_idx, &cell.scene_id)?;
        let asked = &record.scenario.provenance.guidance.roles;
        let asked_to_collide = record.asks_for_collision();
        let alone = SampleGroup::equally_likely(&recorded, std::slice::from_ref(scene));
        let sample = SampleGroup { asked, asked_to_collide, ..alone };
        let is_within_limits = limits::are_met(&request.config.limits, &sample, &self.metric_settings);
        let ending = record.ending();
        let ends_well = ending.is_none_or(|(_, ending)| ending.remaining_mps.is_none());
        let is_explained = record.explanation() != Some(None);
        let is_valid = ends_well && is_explained && is_within_limits && record.is_as_driven(self.behaviors);
        Ok(if is_valid { Placement::Hit(bucket) } else { Placement::BeyondLimits(bucket) })
    }
}

impl ResolvedRequest {
    /// The parameters in which two accepted scenarios of one situation must differ: those of its buckets, and those
    /// that templates of the behavior are solved for.
    pub(super) fn told_apart_by(&self, behavior: Option<&dyn Behavior>) -> Vec<String> {
        let solved = behavior.map_or(&[][..], Behavior::template_parameters);
        self.config.buckets.keys().cloned().chain(solved.iter().map(|name| (*name).to_owned())).collect()
    }

    /// Whether these placements can belong to this shard.
    pub fn may_decide(&self, shard: &RoundShard, placed: &[PlacedScenario]) -> bool {
        let is_known = |placement: Placement| match placement {
            Placement::NotFound | Placement::Outside => true,
            Placement::BeyondLimits(bucket) | Placement::Hit(bucket) => bucket < self.buckets.len(),
        };
        placed.iter().all(|scenario| scenario.cell < shard.members.len() && is_known(scenario.placement))
    }

    /// Decides on the scenarios of a shard in round `round`, in their order, when `ledger` holds all earlier shards.
    /// Returns the counts, and the tag of each scenario. Placements from a file must pass
    /// [`ResolvedRequest::may_decide`] first.
    pub fn decide(
        &self,
        round: usize,
        shard: &RoundShard,
        ledger: &Ledger,
        placed: &[PlacedScenario],
    ) -> (ShardTally, Vec<RequestTag>) {
        let cell_tally = |(at, cell): (usize, &usize)| {
            let n_samples = shard.plan.n_samples_of(at, self.arms[shard.arm].n_samples);
            let aim = shard.aims.get(at).copied().flatten();
            let numbers = shard.plan.templates.get(at).into_iter().flatten();
            CellTally {
                cell: *cell,
                aimed: aim.map(|aim| aim.bucket),
                tried: aim.map_or_else(Vec::new, |aim| numbers.map(|number| (aim.solved_for, *number)).collect()),
                n_samples: n_samples as u64,
                next_sample: shard.plan.first_sample + n_samples,
                ..CellTally::default()
            }
        };
        let mut cells: Vec<CellTally> = shard.members.iter().enumerate().map(cell_tally).collect();
        let mut accepted = Accepted { by_bucket: ledger.accepted.clone(), paths: Vec::new(), events: Vec::new() };
        let mut tags = Vec::new();
        for scenario in placed {
            let (outcome, bucket) = outcome(scenario, &mut cells[scenario.cell], ledger, &mut accepted);
            tags.push(RequestTag {
                request: self.config.name.clone(),
                round,
                outcome,
                bucket: bucket.map(|idx| BucketTag { idx, ranges: self.buckets.ranges(idx) }),
            });
        }
        (ShardTally { request: self.config.name.clone(), round, arm: shard.arm, cells }, tags)
    }
}

/// Scenarios accepted before this one.
struct Accepted<'a> {
    /// Their number by bucket.
    by_bucket: Vec<u64>,
    /// The paths of accepted ones in the same shard; the ledger has those of earlier shards.
    paths: Vec<&'a PairPath>,
    /// The events of accepted ones in the same shard, each with its cell.
    events: Vec<(usize, &'a EventValues)>,
}

/// Decides on and counts a scenario of `cell`; returns its outcome and its bucket.
fn outcome<'a>(
    scenario: &'a PlacedScenario,
    cell: &mut CellTally,
    ledger: &Ledger,
    accepted: &mut Accepted<'a>,
) -> (RequestOutcome, Option<usize>) {
    cell.n_found += u64::from(scenario.placement != Placement::NotFound);
    match scenario.placement {
        Placement::NotFound => (RequestOutcome::NotFound, None),
        Placement::Outside => {
            cell.n_outside += 1;
            (RequestOutcome::Outside, None)
        }
        Placement::BeyondLimits(bucket) => {
            cell.n_beyond_limits += 1;
            (RequestOutcome::BeyondLimits, Some(bucket))
        }
        Placement::Hit(bucket) => {
            let hits = cell.hits.entry(bucket).or_default();
            let n_of_cell = ledger.accepted_of_cell(cell.cell, bucket) + hits.n_accepted;
            let path = scenario.path.as_ref();
            let outcome = if accepted.by_bucket[bucket] >= ledger.wanted[bucket] {
                hits.n_surplus += 1;
                RequestOutcome::Surplus
            } else if n_of_cell >= ledger.max_per_scene {
                hits.n_repeated += 1;
                RequestOutcome::Repeated
            } else if path.is_some_and(|path| ledger.has_like(path, &accepted.paths))
                || scenario
                    .event
                    .as_ref()
                    .is_some_and(|event| ledger.has_like_event(cell.cell, event, &accepted.events))
            {
                hits.n_near_duplicates += 1;
                RequestOutcome::NearDuplicate
            } else {
                hits.n_accepted += 1;
                accepted.by_bucket[bucket] += 1;
                accepted.paths.extend(path);
                accepted.events.extend(scenario.event.as_ref().map(|event| (cell.cell, event)));
                cell.accepted_paths.extend(path.cloned());
                cell.accepted_events.extend(scenario.event.clone());
                RequestOutcome::Accepted
            };
            (outcome, Some(bucket))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{pool, tight};
    use super::*;
    use crate::behavior::{BehaviorConfig, BehaviorEvent};
    use crate::generate::testing::{denoiser, load};
    use crate::generate::{GenerateConfig, Models, ShardPlan};
    use crate::geometry::Vec2;
    use crate::guidance::testing::scene;
    use crate::metrics::MetricSettings;
    use crate::scene::{Roles, Scene, State, Trajectory};
    use crate::store::testing;
    use candle_core::Device;
    use std::collections::BTreeMap;

    const REQUEST: &str = "
        [[arms]]
        name = 'plain'
        n_samples = 3
        [[requests]]
        name = 'tight'
        behavior = 'cut_in'
        buckets = { gap_m = [0, 5] }
        arms = ['plain']
        per_bucket = 9
        budget = { n_samples = 9 }";
    /// The cars of the scenes jump at the present.
    const ANYTHING: &str = "limits = { validity_rate = 0.0 }";

    /// A scenario of the scene in which the agents in the roles show a cut-in with this gap.
    fn record(scene: &Scene, roles: &Roles, gap_m: f64) -> ScenarioRecord {
        let mut record = testing::record(scene, 0);
        record.scenario.provenance.scene_id = scene.id.clone();
        record.scenario.provenance.guidance.roles = roles.clone();
        (record.verified, record.requested_behavior) = (true, Some("cut_in".to_owned()));
        let (roles, event) = (roles.clone(), testing::event(&scene.id, "cut_in", &[("gap_m", gap_m)]));
        record.events = vec![BehaviorEvent { roles, start_timestep: scene.n_history, ..event }];
        record
    }

    /// The scene with the second agent in place of the third from the present on.
    fn collided(idx: usize) -> Scene {
        let mut scene = scene(idx);
        let [other, own] = [1, 2].map(|agent| scene.tracks[agent].trajectory.entries().to_vec());
        let states = [&own[..scene.n_history], &other[scene.n_history..]].concat();
        scene.tracks[2].trajectory = Trajectory::new(states);
        scene
    }

    /// The scene in which the car behind ends right behind the other, at 40 m/s.
    fn about_to_collide(idx: usize) -> Scene {
        let mut scene = scene(idx);
        let ahead = *scene.state(2, scene.n_timesteps - 1).unwrap();
        let mut states = scene.tracks[1].trajectory.entries().to_vec();
        let (position, velocity) = (ahead.position - Vec2::new(8.0, 0.0), Vec2::new(40.0, 0.0));
        *states.last_mut().unwrap() = Some(State { position, velocity, heading_rad: 0.0 });
        scene.tracks[1].trajectory = Trajectory::new(states);
        scene
    }

    /// Judges records as those of one shard with these cells; returns their outcomes, and the tallies of the cells.
    fn judged(
        more: &str,
        cells: &[Cell],
        mut records: Vec<ScenarioRecord>,
    ) -> Result<(Vec<RequestOutcome>, Vec<CellTally>), Error> {
        let config: GenerateConfig = toml::from_str(&format!("{REQUEST}\n{more}")).unwrap();
        let behaviors = [BehaviorConfig::from_id("cut_in").unwrap().build()];
        let (config, denoiser) = (config.resolve(&behaviors).unwrap(), denoiser(0));
        let models = Models { denoiser: &denoiser, classifiers: &[], distilled: None, baseline: None };
        let (request, metric_settings) = (&config.requests[0], MetricSettings::default());
        let generator = Generator::new(&config, models, &behaviors, &load, metric_settings, &Device::Cpu).unwrap();
        let pool = Pool {
            request: "tight".to_owned(),
            cells: cells.to_vec(),
            n_scenes: cells.len(),
            feasible: vec![BTreeMap::from([(0, 0.0)]); cells.len()],
            n_infeasible: 0,
            unmet: None,
        };
        let plan = ShardPlan { idx: 0, sweep_idx: 0, cells: cells.to_vec(), first_sample: 0, templates: Vec::new() };
        let shard = RoundShard { arm: 0, members: (0..cells.len()).collect(), aims: vec![None; cells.len()], plan };
        let tally = generator.judge((request, 0), (&pool, &shard), &Ledger::new(request, &pool), &mut records)?;
        Ok((records.iter().map(|record| record.request.as_ref().unwrap().outcome).collect(), tally.cells))
    }

    fn cell(idx: usize, roles: &Roles) -> Cell {
        Cell { scene_idx: idx, scene_id: scene(idx).id, roles: roles.clone(), targets: Vec::new() }
    }

    #[test]
    fn scenarios_count_in_the_cell_of_their_scene_and_agents() {
        let [there, back] =
            [["behind", "ahead"], ["ahead", "behind"]].map(|[a, b]| Roles::from([("ego", a), ("other", b)]));
        // Cells that share the scene or the roles with the one after them.
        let cells = [cell(1, &there), cell(2, &there), cell(2, &back)];
        let records =
            vec![record(&scene(2), &back, 2.0), record(&scene(2), &there, 7.0), record(&scene(1), &there, 2.0)];
        let (outcomes, tallies) = judged(ANYTHING, &cells, records.clone()).unwrap();
        assert_eq!(outcomes, [RequestOutcome::Accepted, RequestOutcome::Outside, RequestOutcome::Accepted]);
        let counts =
            |tally: &CellTally| (tally.n_found, tally.n_outside, tally.hits.get(&0).map_or(0, |hits| hits.n_accepted));
        assert_eq!(tallies.iter().map(counts).collect::<Vec<_>>(), [(1, 0, 1), (1, 1, 0), (1, 0, 1)]);
        assert!(matches!(judged(ANYTHING, &cells[1..], records), Err(Error::Stale { .. })));
    }

    #[test]
    fn limits_are_on_each_scenario_and_without_others_those_of_validity_are() {
        let roles = Roles::from([("ego", "behind"), ("other", "ahead")]);
        let records = || vec![record(&scene(1), &roles, 2.0), record(&collided(1), &roles, 3.0)];
        let (within, beyond) = (RequestOutcome::Accepted, RequestOutcome::BeyondLimits);
        // No limit allows an end that leads to a collision.
        let ends_badly = vec![record(&about_to_collide(1), &roles, 2.0)];
        assert_eq!(judged(ANYTHING, &[cell(1, &roles)], ends_badly).unwrap().0, [beyond]);
        for (limits, expected) in [
            ("", [beyond; 2]),
            ("limits = { min_scene_ade_m = { at_most = 1e3 } }", [beyond; 2]),
            (ANYTHING, [within; 2]),
            ("limits = { validity_rate = 0.0, collision_rate = 0.0 }", [within, beyond]),
        ] {
            let (outcomes, tallies) = judged(limits, &[cell(1, &roles)], records()).unwrap();
            assert_eq!(outcomes, expected, "{limits}");
            let n_beyond = expected.iter().filter(|outcome| **outcome == beyond).count();
            assert_eq!((tallies[0].n_beyond_limits, tallies[0].n_found), (n_beyond as u64, 2));
        }
    }

    #[test]
    fn samples_are_numbered_on_from_those_of_earlier_rounds() {
        let (request, pool) = (tight("per_bucket = 5\nbudget = { n_samples = 60 }"), pool(2));
        let plan =
            ShardPlan { idx: 3, sweep_idx: 0, cells: pool.cells.clone(), first_sample: 6, templates: Vec::new() };
        let shard = RoundShard { arm: 0, members: vec![0, 1], aims: vec![None; 2], plan };
        let (tally, _) = request.decide(2, &shard, &Ledger::new(&request, &pool), &[]);
        // An arm draws three.
        assert_eq!(tally.cells.iter().map(|cell| cell.next_sample).collect::<Vec<_>>(), [9, 9]);
    }

    #[test]
    fn who_moves_as_in_an_accepted_scenario_is_not_accepted_again() {
        let roles = Roles::from([("ego", "behind"), ("other", "ahead")]);
        let moved = |left_m: f64| {
            let mut scene = scene(1);
            let states = scene.tracks[1].trajectory.entries().iter().enumerate().map(|(timestep, state)| {
                let offset = Vec2::new(0.0, if timestep < scene.n_history { 0.0 } else { left_m });
                state.map(|state| State { position: state.position + offset, ..state })
            });
            scene.tracks[1].trajectory = Trajectory::new(states.collect());
            scene
        };
        let with_gap = |left_m: f64, gap_m: f64| record(&moved(left_m), &roles, gap_m);
        // The mean over two agents, one of which is moved: 0.2 and 0.3 m. In the fourth they move otherwise, but it is
        // the same event as the third to half a meter; the same in another situation is another event.
        let records = vec![with_gap(0.0, 2.0), with_gap(0.4, 3.0), with_gap(0.6, 4.0), with_gap(1.2, 4.4)];
        let (outcomes, tallies) = judged(ANYTHING, &[cell(1, &roles)], records).unwrap();
        let (taken, like) = (RequestOutcome::Accepted, RequestOutcome::NearDuplicate);
        assert_eq!(outcomes, [taken, like, taken, like]);
        let hits = tallies[0].hits[&0];
        assert_eq!((hits.n_accepted, hits.n_near_duplicates, hits.n(), tallies[0].accepted_paths.len()), (2, 2, 2, 2));
        let elsewhere = record(&scene(2), &roles, 4.4);
        let records = vec![with_gap(0.6, 4.0), elsewhere];
        let (outcomes, _) = judged(ANYTHING, &[cell(1, &roles), cell(2, &roles)], records).unwrap();
        assert_eq!(outcomes, [taken, taken]);
    }
}
