//! How does a sample become a scenario with its provenance, its events and its id?

use super::{Cell, Error, Generator, ResolvedSweep, requested_events};
use crate::scenario::ScenarioRecord;
use crate::scene::{GuidanceLevel, GuidanceTag, ObservationMask, Provenance, Scenario, Scene};
use crate::store::as_stored;

impl Generator<'_> {
    /// The scenario of a sample of a cell, checked for the requested behavior; `recorded_event` says whether the
    /// recording shows it already.
    pub(super) fn record(
        &self,
        sweep: &ResolvedSweep,
        cell: &Cell,
        recorded_event: bool,
        (generated, observed): (&Scene, ObservationMask),
        (level, sample_idx, probability): (GuidanceLevel, usize, Option<f64>),
    ) -> Result<ScenarioRecord, Error> {
        let classifier = self.guiding_classifier(sweep, level.strength);
        let (checkpoint, kind, edit) = match sweep.diffusion() {
            Some(diffusion) => {
                let kind = self.guidance_kind(sweep, diffusion, level);
                (&self.denoiser(sweep)?.fingerprint, kind, diffusion.edit.as_ref())
            }
            None => (&self.baseline(sweep)?.fingerprint, GuidanceTag::BASELINE.to_owned(), None),
        };
        let provenance = Provenance {
            scene_id: cell.scene_id.clone(),
            observation: sweep.observe.name().to_owned(),
            edit_tau: edit.map(|edit| edit.tau),
            checkpoint: checkpoint.clone(),
            classifier: classifier.map(|classifier| classifier.fingerprint.clone()),
            seed: self.config.seed,
            sample_idx,
            probability,
            guidance: GuidanceTag { kind, level, roles: cell.roles.clone() },
            sampler: sweep.sampler_name(),
            ego_driver: None,
            settings: sweep.settings(level),
        };
        // The verified states must be the written ones.
        let scene = as_stored(generated);
        let events_of = |behavior| requested_events(behavior, &cell.roles, &scene);
        let (verified, events) = self.behavior(sweep).map_or_else(Default::default, events_of);
        Ok(ScenarioRecord {
            scenario: Scenario { id: scenario_id(&sweep.name, &provenance), scene, observed, provenance },
            sweep: sweep.name.clone(),
            requested_behavior: sweep.behavior.clone(),
            verified,
            events,
            recorded_event,
            assessment: None,
            shard: 0,
            request: None,
        })
    }
}

/// 16 hexadecimal digits that belong to this sweep and provenance.
fn scenario_id(sweep: &str, provenance: &Provenance) -> String {
    // The probability and the driver follow from the rest.
    let Provenance {
        scene_id,
        observation,
        edit_tau,
        checkpoint,
        classifier,
        seed,
        sample_idx,
        probability: _,
        ego_driver: _,
        guidance,
        sampler,
        settings,
    } = provenance;
    let mut hasher = blake3::Hasher::new();
    // Every part ends in a zero byte, which no name contains, so different parts cannot make the same text.
    let mut add = |part: &str| {
        hasher.update(part.as_bytes());
        hasher.update(&[0]);
    };
    for part in [
        sweep,
        &scene_id.0,
        observation,
        checkpoint,
        classifier.as_deref().unwrap_or(""),
        &guidance.kind,
        sampler,
        settings,
    ] {
        add(part);
    }
    for (role, track) in guidance.roles.iter() {
        add(role);
        add(&track.0);
    }
    // The settings name both numbers of the level if both act.
    let GuidanceLevel { strength, weight } = guidance.level;
    let level = if strength == 0.0 { weight } else { strength };
    add(&format!("{seed} {sample_idx} {level} {edit_tau:?}"));
    hasher.finalize().to_hex()[..16].to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::CorpusReader;

    #[test]
    fn ids_stay_what_they_were() {
        let fixture = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fixtures/corpus/cut_ins");
        let corpus = CorpusReader::open(std::path::Path::new(fixture)).unwrap();
        for i in 0..corpus.len() {
            let ScenarioRecord { sweep, scenario, .. } = corpus.scenario(i).unwrap();
            assert_eq!(scenario_id(&sweep, &scenario.provenance), scenario.id);
        }
    }
}
