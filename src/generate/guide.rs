//! Guides the denoiser of a batch with the settings of its sweep: by the classifier and the objectives, nested.

use super::pairs::slots;
use super::{Cell, ClassifierScope, Diffusion, Error, Generator, ResolvedSweep};
use crate::behavior::BehaviorEntry;
use crate::diffusion::Denoiser;
use crate::guidance::{
    AgentSelector, ClassifierGuidance, CleanGuidedDenoiser, ContextRow, GuidanceConfig, GuidedDenoiser, NoCollision,
    ObjectiveConfig, ObjectiveSum, SceneContext, StayOnRoad,
};
use crate::model::TrainedClassifier;
use crate::scene::{GuidanceLevel, GuidanceTag, Scene};
use crate::tensor::SceneBatch;
use std::collections::BTreeSet;
use std::ops::Range;

/// The rules of traffic for every sample: boxes stay a hand's breadth apart (recordings have no more), centers no
/// farther off the road than they are. Agents of a requested collision may touch each other.
fn rules_of_traffic(sweep: &ResolvedSweep) -> [ObjectiveConfig; 2] {
    let roles = sweep.behavior.as_deref().and_then(BehaviorEntry::of).map_or(&[][..], |behavior| behavior.roles);
    let may_collide = <[&str; 2]>::try_from(roles).ok();
    let may_collide = may_collide.filter(|_| sweep.asks_for_collision());
    let except = may_collide.map(|roles| roles.map(AgentSelector::new));
    [ObjectiveConfig::new(1.0, NoCollision { except, margin_m: 0.3 }), ObjectiveConfig::new(3.0, StayOnRoad {})]
}

/// A batch to be guided.
pub(super) struct Guided<'a> {
    pub(super) sweep: &'a ResolvedSweep,
    /// The settings with which its denoiser is sampled.
    pub(super) diffusion: &'a Diffusion,
    /// Strength of the guidance, and weight of the target states.
    pub(super) level: GuidanceLevel,
    pub(super) cells: &'a [(&'a Cell, &'a Scene)],
    /// The requested agents of each cell; the first is at the center.
    pub(super) agents: &'a [(usize, usize)],
    /// One row for each cell.
    pub(super) batch: &'a SceneBatch,
    /// A row for each sample of each cell.
    pub(super) repeated: &'a SceneBatch,
    /// The samples of each cell, by their numbers.
    pub(super) samples: Range<usize>,
    /// The places whose maps lack parts of the road.
    pub(super) places_without_road: &'a BTreeSet<String>,
}

impl Guided<'_> {
    /// The context of the sampled batch for objectives.
    fn objective_context(&self) -> Result<SceneContext, Error> {
        let rows: Vec<ContextRow<'_>> = (self.cells.iter().zip(self.agents))
            .map(|((cell, scene), agents)| ContextRow { scene, ego_idx: agents.0, roles: &cell.roles })
            .collect();
        let targets = self.cells.iter().flat_map(|(cell, _)| self.samples.clone().map(|sample| cell.target(sample)));
        let shows_road = |row: usize| !self.places_without_road.contains(&self.cells[row].1.source.place);
        let context = SceneContext::new(self.batch, &rows)?.with_roads_where(shows_road);
        let context = context.repeated(self.samples.len())?;
        Ok(context.aiming_at(targets.collect())?)
    }
}

impl<'g> Generator<'g> {
    /// The classifier that guides samples of this strength, if any.
    pub(super) fn guiding_classifier(&self, sweep: &ResolvedSweep, strength: f64) -> Option<&'g TrainedClassifier> {
        let guides = |diffusion: &Diffusion| diffusion.guidance.classifier_scope != ClassifierScope::None;
        self.classifier(sweep).filter(|_| strength != 0.0 && sweep.diffusion().is_some_and(guides))
    }

    /// The kind of guidance at this level, as recorded: `none`, or the classifier and the objectives in order, such as
    /// `classifier:cut_in+no_collision`; `classifier_free` where samples lean toward states.
    pub(super) fn guidance_kind(&self, sweep: &ResolvedSweep, diffusion: &Diffusion, level: GuidanceLevel) -> String {
        let classifier = self.guiding_classifier(sweep, level.strength);
        let mut parts: Vec<String> =
            classifier.map(|c| format!("classifier:{}", c.spec.behavior)).into_iter().collect();
        if level.strength != 0.0 {
            let objectives = &diffusion.guidance.objectives;
            parts.extend(objectives.iter().map(|objective| objective.kind().to_owned()));
        }
        if level.weight != 0.0 {
            parts.push("classifier_free".to_owned());
        }
        if sweep.uses_template() {
            parts.push(GuidanceTag::TEMPLATE.to_owned());
        }
        if parts.is_empty() { GuidanceTag::NONE.to_owned() } else { parts.join("+") }
    }

    /// Calls `sample` with `inner`, guided with the settings of the sweep. The strength multiplies classifier and
    /// objectives alike; each of the two shifts is limited on its own, and objectives judge the estimate that the
    /// classifier has shifted. The rules of traffic come last, with a strength of their own.
    pub(super) fn guided<T>(
        &self,
        guided: &Guided<'_>,
        inner: &dyn Denoiser,
        sample: impl FnOnce(&dyn Denoiser) -> Result<T, Error>,
    ) -> Result<T, Error> {
        let Guided { sweep, diffusion, level: GuidanceLevel { strength, .. }, .. } = *guided;
        let Some(classifier) = self.guiding_classifier(sweep, strength) else {
            return guided_by_objectives(guided, inner, sample);
        };
        let agents: Vec<(usize, usize)> =
            guided.agents.iter().flat_map(|agents| std::iter::repeat_n(*agents, guided.samples.len())).collect();
        let guidance = ClassifierGuidance {
            classifier: &classifier.network,
            pairs: classifier.spec.features(guided.repeated, &slots(guided.repeated, &agents)?)?,
            potential: diffusion.guidance.classifier_potential,
        };
        let config = diffusion.guidance.gate;
        let inner = GuidedDenoiser { inner, guidance: &guidance, strength, config };
        guided_by_objectives(guided, &inner, sample)
    }
}

/// Guides with only the objectives of the sweep and the rules of traffic.
fn guided_by_objectives<T>(
    guided: &Guided<'_>,
    inner: &dyn Denoiser,
    sample: impl FnOnce(&dyn Denoiser) -> Result<T, Error>,
) -> Result<T, Error> {
    let Guided { sweep, diffusion, level: GuidanceLevel { strength, .. }, .. } = *guided;
    let (asked, validity_strength) = (&diffusion.guidance, diffusion.validity_strength);
    let has_objectives = strength != 0.0 && !asked.objectives.is_empty();
    if !has_objectives && validity_strength == 0.0 {
        return sample(inner);
    }
    let context = guided.objective_context()?;
    let sum = |objectives| ObjectiveSum { objectives, batch: guided.repeated, context: &context };
    let (wished, rules) = (sum(&asked.objectives), rules_of_traffic(sweep));
    let rules = sum(&rules);
    let modes = guided.repeated.surroundings.as_ref();
    let wishing = CleanGuidedDenoiser { inner, potential: &wished, strength, gate: asked.gate, to_mode: true, modes };
    let inner: &dyn Denoiser = if has_objectives { &wishing } else { inner };
    if validity_strength == 0.0 {
        return sample(inner);
    }
    let (strength, gate) = (validity_strength, GuidanceConfig::default());
    sample(&CleanGuidedDenoiser { inner, potential: &rules, strength, gate, to_mode: false, modes })
}
