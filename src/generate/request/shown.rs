//! What do the templates of a cell show before anything is sampled?
//!
//! A sample follows its template, so that the event of the template alone tells which bucket the sample will probably
//! fall into, and whether it would be another of what there is already.

use super::event_values::EventValues;
use super::facts::{CAREFUL_MARGIN, Facts};
use super::ledger::Ledger;
use super::resolve::ResolvedRequest;
use super::rounds::{CellAim, Member, RoundContext, Taken};
use crate::behavior::BehaviorEvent;
use crate::generate::{Cell, Error, Generator, requested_events};
use crate::metrics::{CarefulReplay, PairPath};
use crate::scene::Scene;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

/// How many templates of a cell are solved for a bucket.
const N_TEMPLATES: usize = 16;
/// Templates whose margin alone is asked for with one of these added, seconds, may come to it in the scenario, where
/// others are in the way, too: they are sampled to find out.
const MARGINS_BESIDE_S: [f64; 8] = [-1.0, -0.75, -0.5, -0.25, 0.25, 0.5, 0.75, 1.0];
/// How often a motion is sampled that was not accepted: what the others do around it differs.
const N_TRIES: u64 = 2;

/// A template of a cell that is worth a sample.
#[derive(Debug, Clone, PartialEq)]
pub struct Shown {
    /// Its number among those that are solved for the bucket.
    pub(in crate::generate) number: usize,
    /// The bucket of its event; `None` if the template alone does not tell.
    pub(in crate::generate) bucket: Option<usize>,
    /// How the requested agents move in it.
    pub(super) path: Option<PairPath>,
    /// Its event.
    pub(super) event: Option<EventValues>,
}

/// The templates of a cell by arm, cell and the bucket that they are solved for; `None` where an arm has none.
pub type Templates<'a> = dyn Fn(usize, usize, usize) -> Result<Option<Arc<[Shown]>>, Error> + Sync + 'a;

/// The templates of a request that were looked at, by arm, cell and bucket.
#[derive(Debug, Default)]
pub struct KnownTemplates(Mutex<ByArmCellAndBucket>);

type ByArmCellAndBucket = BTreeMap<(usize, usize, usize), Arc<[Shown]>>;

impl KnownTemplates {
    /// Those of an arm, a cell and a bucket, which `find` lists if they are not known.
    pub fn get(
        &self,
        of: (usize, usize, usize),
        find: impl FnOnce() -> Result<Vec<Shown>, Error>,
    ) -> Result<Arc<[Shown]>, Error> {
        let known = || self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(shown) = known().get(&of) {
            return Ok(Arc::clone(shown));
        }
        let shown: Arc<[Shown]> = find()?.into();
        known().insert(of, Arc::clone(&shown));
        Ok(shown)
    }
}

impl Generator<'_> {
    /// The templates of a cell that are solved for a bucket, without those whose event is certainly not accepted. Empty
    /// if the arm has none.
    pub fn shown(
        &self,
        request: &ResolvedRequest,
        arm: usize,
        cell: &Cell,
        bucket: usize,
    ) -> Result<Vec<Shown>, Error> {
        let sweep = &self.config.sweeps[request.arms[arm].sweep_idx];
        let Some(behavior) = self.behavior(sweep) else { return Ok(Vec::new()) };
        let scene = self.load(cell.scene_idx, &cell.scene_id)?;
        let aimed = Cell { targets: vec![request.buckets.target(bucket)], ..cell.clone() };
        let names = request.told_apart_by(Some(behavior));
        let (buckets, conditions) = (&request.config.buckets, &request.config.conditions);
        let asks_margin = buckets.contains_key(CAREFUL_MARGIN) || conditions.contains_key(CAREFUL_MARGIN);
        let alone = self.templates_alone(sweep, &aimed, &scene, N_TEMPLATES);
        let shown = alone.iter().enumerate().filter_map(|(number, alone)| {
            let path = PairPath::of(alone, &cell.roles);
            let (is_found, events) = requested_events(behavior, &cell.roles, alone);
            let event = events.first().filter(|_| is_found);
            let margin_s = event.filter(|_| asks_margin).and_then(|event| margin_s(event, alone));
            let Some(event) = event.filter(|_| !asks_margin || margin_s.is_some()) else {
                return Some(Shown { number, bucket: None, path, event: None });
            };
            let bucket_at = |by_s: f64| {
                let facts = Facts { scene: &scene, event, careful_margin_s: margin_s.map(|margin_s| margin_s + by_s) };
                let is_allowed = conditions.iter().all(|(name, condition)| facts.satisfies(name, condition));
                request.buckets.place(&facts).filter(|_| is_allowed && behavior.is_as_driven(event))
            };
            let Some(bucket) = bucket_at(0.0) else {
                let may_be = asks_margin && MARGINS_BESIDE_S.into_iter().any(|by_s| bucket_at(by_s).is_some());
                return may_be.then_some(Shown { number, bucket: None, path, event: None });
            };
            let event = EventValues::of(event, names.iter().map(String::as_str));
            Some(Shown { number, bucket: Some(bucket), path, event: Some(event) })
        });
        Ok(shown.collect())
    }
}

/// The margin of a careful driver who meets an event among those alone who follow its template. `None` if the vehicle
/// that the event happens to is not among them.
fn margin_s(event: &BehaviorEvent, alone: &Scene) -> Option<f64> {
    Some(CarefulReplay::of(alone, event.subject_idx(alone)?)?.margin_s())
}

impl ResolvedRequest {
    /// The cell with templates that are worth a sample: solved for the first of these buckets that has some, all of
    /// them with events of one open bucket and none of them known. The outer `None` means that the arm has no
    /// templates, the inner one that the cell has no more of them.
    pub(super) fn with_templates(
        &self,
        context: &RoundContext<'_>,
        (arm, cell): (usize, usize),
        (buckets, templates): (&[usize], &Templates<'_>),
        taken: &mut Taken,
    ) -> Result<Option<Option<Member>>, Error> {
        let ledger = context.ledger;
        for &solved_for in buckets {
            let Some(shown) = templates(arm, cell, solved_for)? else { return Ok(None) };
            let (mut aim, mut numbers) = (None, Vec::new());
            for one in shown.iter() {
                let own = CellAim { bucket: one.bucket.unwrap_or(solved_for), solved_for };
                let room =
                    ledger.room_for(cell, own.bucket).saturating_sub(taken.n_of_situation(ledger, cell, own.bucket));
                let is_worth = aim.is_none_or(|aim| aim == own)
                    && numbers.len() < self.arms[arm].n_samples
                    && room > 0
                    && ledger.lack_after(taken.aimed[own.bucket], own.bucket) > 0.0
                    && !self.is_known(context, (arm, cell), (one, templates), taken)?;
                if is_worth {
                    taken.aimed[own.bucket] += 1;
                    taken.templates.push((arm, cell, own, one.clone()));
                    numbers.push(one.number);
                    aim = Some(own);
                }
            }
            if aim.is_some() {
                return Ok(Some(Some((cell, aim, Some(numbers)))));
            }
        }
        Ok(Some(None))
    }

    /// Whether the event of a template is like that of an accepted scenario of the situation, or its agents move as in
    /// one that was accepted or was tried often enough; those of the round count as accepted.
    fn is_known(
        &self,
        context: &RoundContext<'_>,
        (arm, cell): (usize, usize),
        (shown, templates): (&Shown, &Templates<'_>),
        taken: &Taken,
    ) -> Result<bool, Error> {
        let ledger = context.ledger;
        let of_round: Vec<(usize, &EventValues)> =
            taken.templates.iter().filter_map(|(_, cell, _, shown)| Some((*cell, shown.event.as_ref()?))).collect();
        // Where the event is not known, what was tried counts as accepted.
        let is_accepted =
            |other: &Shown| other.event.as_ref().is_none_or(|event| ledger.has_like_event(cell, event, &of_round));
        if shown.event.is_some() && is_accepted(shown) {
            return Ok(true);
        }
        let is_like = |other: &Shown| {
            let paths = other.path.as_ref().zip(shown.path.as_ref());
            paths.is_none_or(|(other, own)| own.distance_m(other) < self.duplicate_distance_m)
        };
        let mut of_cell = taken.templates.iter().filter(|(its_arm, its_cell, ..)| (*its_arm, *its_cell) == (arm, cell));
        if of_cell.any(|(_, _, _, other)| is_like(other)) {
            return Ok(true);
        }
        let mut n_tries = 0;
        for ((its_arm, bucket, number), n) in &ledger.cells[cell].tried {
            if *its_arm != arm {
                continue;
            }
            let others = templates(arm, cell, *bucket)?.unwrap_or_default();
            for other in others.iter().filter(|other| other.number == *number && is_like(other)) {
                n_tries += if is_accepted(other) { N_TRIES } else { *n };
            }
        }
        Ok(n_tries >= N_TRIES)
    }
}

impl Taken {
    /// Samples of the round with templates of a bucket in the situation of a cell.
    fn n_of_situation(&self, ledger: &Ledger, cell: usize, bucket: usize) -> u64 {
        let own = self.templates.iter().filter(|(_, other, aim, _)| {
            aim.bucket == bucket && ledger.situation_of_cell.get(*other) == ledger.situation_of_cell.get(cell)
        });
        own.count() as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::behavior::{BehaviorEntry, EventLabel};
    use crate::scene::testing::{Drive, scene};

    #[test]
    fn margins_are_of_the_vehicle_that_the_event_happens_to() {
        let of = |distance_m: f64, behavior: &str| {
            let alone = scene(&[Drive::straight(0.0, 0.0, 0.0, 15.0), Drive::straight(distance_m, 0.0, 0.0, 0.0)]);
            let entry = BehaviorEntry::of(behavior).unwrap();
            let event = BehaviorEvent::new((entry.id, entry.roles), &alone, EventLabel::Positive, &[0, 1], 4..=11);
            margin_s(&event, &alone)
        };
        // Full braking from 15 m/s takes 15 m, and the reaction more.
        assert_eq!(of(12.0, "cut_in"), Some(-0.75));
        assert_eq!(of(300.0, "cut_in"), Some(2.0));
        // Who stands is followed by nobody.
        assert_eq!(of(12.0, "wrong_way"), None);
    }
}
