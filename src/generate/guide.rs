//! How does a batch's denoiser come to lean toward what its sweep wishes? Classifier and objectives, one around the other.

use super::pairs::{possible_pairs, slots};
use super::{Cell, ClassifierScope, Error, Generator, SweepConfig};
use crate::diffusion::Denoiser;
use crate::guidance::{
    AnyPairGuidance, ClassifierGuidance, CleanGuidedDenoiser, ContextRow, Guidance, GuidedDenoiser, ObjectiveSum,
    SceneContext,
};
use crate::model::TrainedClassifier;
use crate::scene::Scene;
use crate::tensor::SceneBatch;

/// Pairs of a scene that guidance toward any pair looks at: those nearest to each other.
const MAX_ANY_PAIRS: usize = 32;

/// What is to be guided.
pub(super) struct Guided<'a> {
    /// The sweep.
    pub(super) sweep: &'a SweepConfig,
    /// Strength of the guidance; 0 is none.
    pub(super) strength: f64,
    /// The cells with their scenes.
    pub(super) cells: &'a [(&'a Cell, &'a Scene)],
    /// The agents that each cell asks; the first is at the center.
    pub(super) agents: &'a [(usize, usize)],
    /// One row for each cell.
    pub(super) batch: &'a SceneBatch,
    /// `n_samples` rows for each cell.
    pub(super) repeated: &'a SceneBatch,
    /// Samples of each cell.
    pub(super) n_samples: usize,
}

impl<'g> Generator<'g> {
    /// The classifier that guides samples of this strength, if one does.
    pub(super) fn guiding_classifier(&self, sweep: &SweepConfig, strength: f64) -> Option<&'g TrainedClassifier> {
        let guides =
            strength != 0.0 && sweep.classifier_scope != ClassifierScope::None && sweep.classifier_free.is_none();
        self.classifier(sweep).filter(|_| guides)
    }

    /// What guides samples of this strength: `none`, or the classifier and the objectives in order, such as
    /// `classifier:cut_in+no_collision`; `classifier_any_pair:cut_in` where nobody in particular is asked; `classifier_free` where samples lean toward states.
    pub(super) fn guidance_kind(&self, sweep: &SweepConfig, strength: f64) -> String {
        if sweep.classifier_free.is_some() && strength != 0.0 {
            return "classifier_free".to_owned();
        }
        let scope =
            if sweep.classifier_scope == ClassifierScope::AnyPair { "classifier_any_pair" } else { "classifier" };
        let classifier = self.guiding_classifier(sweep, strength);
        let mut parts: Vec<String> = classifier.map(|c| format!("{scope}:{}", c.spec.behavior)).into_iter().collect();
        if strength != 0.0 {
            parts.extend(sweep.objectives.iter().map(|objective| objective.objective().kind().to_owned()));
        }
        if parts.is_empty() { "none".to_owned() } else { parts.join("+") }
    }

    /// Calls `sample` with `inner`, guided as the sweep says. The strength multiplies classifier and objectives alike; each
    /// of the two shifts is limited on its own, and objectives judge the estimate that the classifier has shifted.
    pub(super) fn guided<T>(
        &self,
        guided: &Guided<'_>,
        inner: &dyn Denoiser,
        sample: impl FnOnce(&dyn Denoiser) -> Result<T, Error>,
    ) -> Result<T, Error> {
        let Guided { sweep, strength, .. } = *guided;
        let guidance = match self.guiding_classifier(sweep, strength) {
            Some(classifier) => Some(self.classifier_guidance(guided, classifier)?),
            None => None,
        };
        let classified = guidance.as_ref().map(|guidance| GuidedDenoiser {
            inner,
            guidance: guidance.as_ref(),
            strength,
            config: sweep.guidance,
        });
        let inner: &dyn Denoiser = classified.as_ref().map_or(inner, |denoiser| denoiser);
        if strength == 0.0 || sweep.objectives.is_empty() {
            return sample(inner);
        }
        let rows: Vec<ContextRow<'_>> = (guided.cells.iter().zip(guided.agents))
            .map(|((cell, scene), agents)| ContextRow { scene, ego_idx: agents.0, roles: &cell.roles })
            .collect();
        let context = SceneContext::new(guided.batch, &rows)?.repeated(guided.n_samples)?;
        let potential = ObjectiveSum { objectives: &sweep.objectives, batch: guided.repeated, context: &context };
        sample(&CleanGuidedDenoiser {
            inner,
            potential: &potential,
            strength,
            gate: sweep.guidance,
            config: sweep.objective_guidance,
            sigma_data: self.spec().edm.sigma_data,
        })
    }

    fn classifier_guidance<'a>(
        &self,
        guided: &Guided<'_>,
        classifier: &'a TrainedClassifier,
    ) -> Result<Box<dyn Guidance + 'a>, Error> {
        let every = |row: usize| std::iter::repeat_n(row, guided.n_samples);
        if guided.sweep.classifier_scope == ClassifierScope::AnyPair {
            let own: Vec<Vec<(usize, usize)>> =
                (0..guided.cells.len()).map(|row| self.any_pairs(guided, row)).collect();
            let pairs: Vec<_> = (0..own.len()).flat_map(every).map(|row| own[row].clone()).collect();
            return Ok(Box::new(AnyPairGuidance::new(classifier, guided.repeated, &pairs)?));
        }
        let agents: Vec<(usize, usize)> =
            (0..guided.agents.len()).flat_map(every).map(|row| guided.agents[row]).collect();
        let pairs = classifier.spec.features(guided.repeated, &slots(guided.repeated, &agents)?)?;
        Ok(Box::new(ClassifierGuidance { classifier: &classifier.classifier, pairs }))
    }

    /// The pairs of a cell's scene that may perform the behavior, nearest first, as places on the agent axis of its row.
    fn any_pairs(&self, guided: &Guided<'_>, row: usize) -> Vec<(usize, usize)> {
        let Some(behavior) = self.behavior(guided.sweep) else { return Vec::new() };
        let mut candidates = possible_pairs(guided.sweep, behavior, guided.cells[row].1);
        candidates.sort_by(|a, b| b.score.total_cmp(&a.score));
        let frame = &guided.batch.frames[row];
        let places = candidates.iter().filter_map(|pair| frame.slot(pair.agents.0).zip(frame.slot(pair.agents.1)));
        places.take(MAX_ANY_PAIRS).collect()
    }
}
