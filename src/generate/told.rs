//! The event that a sample's denoiser is conditioned on: values of a mined event that began alike, or those it aims at.

use super::{Cell, Error, Generator, ResolvedSweep};
use crate::guidance::Target;
use crate::scene::Scene;
use crate::seed::SeededRng;
use crate::tensor::{EventExample, EventVocabulary, KnownBehavior, ToldEvent, present_of};

/// A sample takes the values of one of so many mined events whose agents were most alike at the present.
const N_ALIKE: usize = 16;
/// Differences at the present that weigh the same: of speeds, m/s, and of places, meters.
const ALIKE_MPS: f64 = 2.0;
const ALIKE_M: f64 = 5.0;

impl Generator<'_> {
    /// The event that the denoiser is conditioned on for a sample; `None` if the sweep has no event conditioning.
    ///
    /// A mined event has values that belong together, and of those that began like the pair many can still happen. If
    /// no mined event meets the sample's target, the denoiser sees the target alone.
    pub(super) fn told_event(
        &self,
        sweep: &ResolvedSweep,
        cell: &Cell,
        scene: &Scene,
        sample_idx: usize,
    ) -> Result<Option<ToldEvent>, Error> {
        let Some(behavior) = sweep.behavior.as_deref().filter(|_| sweep.tells_event()) else { return Ok(None) };
        let known = self.known_behavior(sweep, behavior)?;
        let agents: Vec<usize> = cell.roles.tracks().filter_map(|track| scene.track_idx(track)).collect();
        let mut rng = self.mask_seed("told", cell).derive("sample", &[sample_idx as u64]).rng();
        let target = cell.target(sample_idx);
        let hits = |example: &&EventExample| {
            let is_hit = |(name, [least, most]): (&String, &[f64; 2])| {
                example.values.get(name).is_some_and(|value| (least..=most).contains(&value))
            };
            target.iter().filter(|(name, _)| has_value(known, name)).all(is_hit)
        };
        let examples: Vec<&EventExample> = known.examples.iter().filter(hits).collect();
        let alike = most_alike(examples, present_of(scene, &agents));
        let values = match alike.len() {
            0 => drawn_within(&target, known, &mut rng),
            n => alike[rng.below(n)].values.clone(),
        };
        Ok(Some(ToldEvent { behavior: behavior.to_owned(), agents, values }))
    }

    /// The events that the denoiser of a sweep can be conditioned on.
    pub(super) fn vocabulary(&self, sweep: &ResolvedSweep) -> Result<&EventVocabulary, Error> {
        let spec = &self.denoiser(sweep)?.spec;
        spec.events.as_ref().ok_or_else(|| {
            let (which, section) =
                if sweep.uses_distilled() { ("distilled denoiser", "distill") } else { ("denoiser", "denoiser") };
            Error::Config(format!(
                "sweep {}: classifier_free.event is true, but the {which} was not trained on events; train it with \
                 [train.{section}.events]",
                sweep.name
            ))
        })
    }

    /// The behavior as the denoiser of a sweep knows it.
    pub(super) fn known_behavior(&self, sweep: &ResolvedSweep, behavior: &str) -> Result<&KnownBehavior, Error> {
        let vocabulary = self.vocabulary(sweep)?;
        vocabulary.behavior(behavior).ok_or_else(|| {
            Error::Config(format!(
                "sweep {}: the denoiser cannot be told of {behavior}, because it was trained on {}; add {behavior} to \
                 events.behaviors in its section and train it again, or remove classifier_free.event",
                sweep.name,
                vocabulary.names()
            ))
        })
    }
}

fn has_value(known: &KnownBehavior, name: &str) -> bool {
    known.values.iter().any(|unit| unit.name == name)
}

/// The examples that began most like `present`, at most [`N_ALIKE`]; without it, all.
fn most_alike(mut examples: Vec<&EventExample>, present: Option<Vec<f64>>) -> Vec<&EventExample> {
    let Some(present) = present else { return examples };
    // One speed for each agent, then two coordinates for each but the first: 3 n - 2 in all.
    let n_agents = present.len().div_ceil(3);
    let unit = |i: usize| if i < n_agents { ALIKE_MPS } else { ALIKE_M };
    let distance = |example: &EventExample| -> f64 {
        let differences = example.present.iter().zip(&present).enumerate();
        differences.map(|(i, (then, now))| ((then - now) / unit(i)).powi(2)).sum()
    };
    examples.sort_by(|a, b| distance(a).total_cmp(&distance(b)));
    examples.truncate(N_ALIKE);
    examples
}

/// A value from each interval of `target` that the network has an input for.
fn drawn_within(
    target: &Target,
    known: &KnownBehavior,
    rng: &mut SeededRng,
) -> std::collections::BTreeMap<String, f64> {
    let told = target.iter().filter(|(name, _)| has_value(known, name));
    told.map(|(name, [least, most])| (name.clone(), least + rng.uniform() * (most - least))).collect()
}
