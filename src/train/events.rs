//! The mined events of a training: which count, in which units are their values, and what does a step show of one?

use super::{Error, EventTraining, MinedEvent, TrainingData};
use crate::behavior::{BehaviorEntry, BehaviorEvent, EventLabel};
use crate::scene::{Scene, TrackId};
use crate::seed::{Seed, SeededRng};
use crate::tensor::{EventExample, EventVocabulary, KnownBehavior, ONSET, ToldEvent, present_of};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// Examples of each behavior that a checkpoint keeps.
const N_EXAMPLES: usize = 200;

/// A mined event that a network can be conditioned on.
#[derive(Debug, Clone, PartialEq)]
pub struct LearnedEvent {
    /// Index of the scene in the dataset.
    pub scene_idx: usize,
    /// The behavior.
    pub behavior: String,
    /// The agents that take part, in the order of the roles.
    pub tracks: Vec<TrackId>,
    /// Its values: the onset, and its parameters.
    pub values: BTreeMap<String, f64>,
}

/// The events of a training.
#[derive(Debug, Clone, PartialEq)]
pub struct LearnedEvents {
    /// The events to train on.
    pub events: Vec<LearnedEvent>,
    /// Indices of the events of each behavior; none is empty.
    pub by_behavior: Vec<Vec<usize>>,
    /// Held-out events to evaluate on; the behaviors take turns.
    pub held_out: Vec<LearnedEvent>,
    /// The events that the network has inputs for.
    pub vocabulary: EventVocabulary,
    /// How often they are shown.
    pub config: EventTraining,
}

impl LearnedEvents {
    /// The events of `data` that count: positive ones of the configured behaviors that begin after the present. At most
    /// `n_held_out` of the held-out scenes are kept. `section` is what the user configured.
    ///
    /// # Errors
    /// When a behavior has none, or a scene cannot be loaded.
    pub(super) fn gather(
        section: &str,
        config: &EventTraining,
        data: &TrainingData<'_>,
        (n_history, dt_s): (usize, f64),
        n_held_out: usize,
        seed: Seed,
    ) -> Result<Self, Error> {
        let all: Vec<LearnedEvent> =
            data.events.iter().filter_map(|mined| LearnedEvent::new(mined, n_history, dt_s)).collect();
        let in_scenes = |scenes: BTreeSet<usize>| -> Vec<LearnedEvent> {
            all.iter().filter(|event| scenes.contains(&event.scene_idx)).cloned().collect()
        };
        let events = in_scenes(data.sources.iter().flat_map(|source| source.train.iter().copied()).collect());
        let held_out = in_scenes(data.sources.iter().flat_map(|source| source.held_out.iter().copied()).collect());
        let by_behavior = grouped(config, &events);
        if let Some(at) = by_behavior.iter().position(Vec::is_empty) {
            return Err(Error::Config(format!(
                "{section}.events.behaviors.{at} is \"{0}\", but no training scene has a mined {0} that begins after \
                 the present: add {{ kind = \"{0}\" }} to mine.behaviors, or remove it here",
                config.behaviors[at]
            )));
        }
        let known = config.behaviors.iter().zip(&by_behavior).map(|(id, own)| {
            let own: Vec<&LearnedEvent> = own.iter().map(|i| &events[*i]).collect();
            known_behavior(id, &own, data, seed.derive_named("event examples", id))
        });
        Ok(Self {
            vocabulary: EventVocabulary { behaviors: known.collect::<Result<_, Error>>()? },
            held_out: in_turns(config, &held_out, n_held_out, seed.derive("held-out events", &[])),
            by_behavior,
            events,
            config: config.clone(),
        })
    }

    /// The values of an event that a training step shows, with some left out at random.
    pub(super) fn told_in_part(
        &self,
        event: &LearnedEvent,
        scene: &Scene,
        rng: &mut SeededRng,
    ) -> Result<ToldEvent, Error> {
        let dropout = self.config.value_dropout;
        let tells_any = rng.uniform() >= dropout;
        let mut told = event.told(scene)?;
        // Every value takes a draw, so that one does not depend on another.
        told.values.retain(|_, _| rng.uniform() >= dropout && tells_any);
        Ok(told)
    }
}

impl LearnedEvent {
    /// The event, if it is positive and begins after the present.
    fn new(MinedEvent { scene_idx, event }: &MinedEvent<'_>, n_history: usize, dt_s: f64) -> Option<Self> {
        let BehaviorEvent { behavior, label, roles, start_timestep, parameters, .. } = event;
        let is_ahead = *label == EventLabel::Positive && *start_timestep >= n_history;
        is_ahead.then(|| {
            let onset_s = (start_timestep + 1 - n_history) as f64 * dt_s;
            Self {
                scene_idx: *scene_idx,
                behavior: behavior.clone(),
                tracks: roles.tracks().cloned().collect(),
                values: parameters.clone().into_iter().chain([(ONSET.to_owned(), onset_s)]).collect(),
            }
        })
    }

    /// All values of the event that the network has inputs for.
    ///
    /// # Errors
    /// When the scene lacks one of its tracks.
    pub(super) fn told(&self, scene: &Scene) -> Result<ToldEvent, Error> {
        Ok(ToldEvent { behavior: self.behavior.clone(), agents: self.agents(scene)?, values: self.values.clone() })
    }

    fn agents(&self, scene: &Scene) -> Result<Vec<usize>, Error> {
        let find = |track: &TrackId| {
            scene
                .track_idx(track)
                .ok_or_else(|| Error::Config(format!("scene {} has no track {track}; mine the scenes again", scene.id)))
        };
        self.tracks.iter().map(find).collect()
    }
}

/// The places of the events of each configured behavior.
fn grouped(config: &EventTraining, events: &[LearnedEvent]) -> Vec<Vec<usize>> {
    let own = |id: &String| (0..events.len()).filter(|i| events[*i].behavior == *id).collect();
    config.behaviors.iter().map(own).collect()
}

/// At most `n` of these events, in random order, of each behavior in turn.
fn in_turns(config: &EventTraining, events: &[LearnedEvent], n: usize, seed: Seed) -> Vec<LearnedEvent> {
    let mut groups = grouped(config, events);
    for (i, group) in groups.iter_mut().enumerate() {
        seed.derive("behavior", &[i as u64]).rng().shuffle(group);
    }
    let longest = groups.iter().map(Vec::len).max().unwrap_or(0);
    let turns = (0..longest).flat_map(|turn| groups.iter().filter_map(move |group| group.get(turn)));
    turns.take(n).map(|i| events[*i].clone()).collect()
}

/// The behavior `id` with the units of its events, and examples of which the past shows all agents.
fn known_behavior(
    id: &str,
    events: &[&LearnedEvent],
    data: &TrainingData<'_>,
    seed: Seed,
) -> Result<KnownBehavior, Error> {
    let mut order: Vec<usize> = (0..events.len()).collect();
    seed.derive("order", &[]).rng().shuffle(&mut order);
    // Some are dropped because an agent is not there at the present.
    let candidates = &order[..order.len().min(2 * N_EXAMPLES)];
    let example = |i: &usize| {
        let scene = data.dataset.scene(events[*i].scene_idx).map_err(Error::Scene)?;
        let present = present_of(&scene, &events[*i].agents(&scene)?);
        Ok(present.map(|present| EventExample { present, values: events[*i].values.clone() }))
    };
    let examples = candidates.par_iter().map(example).collect::<Result<Vec<_>, Error>>()?;
    let examples: Vec<EventExample> = examples.into_iter().flatten().collect();
    let examples = KnownBehavior::chosen_examples(&examples, N_EXAMPLES, seed.derive("chosen", &[]));
    let roles = BehaviorEntry::of(id).map_or(&[][..], |entry| entry.roles);
    let values: Vec<BTreeMap<String, f64>> = events.iter().map(|event| event.values.clone()).collect();
    Ok(KnownBehavior::new(id, roles, &values, examples))
}
