//! Can a sweep be sampled as written? The only place that checks it and fills in defaults.

use super::{Aim, ClassifierScope, Diffusion, ResolvedSweep, SampledModel, SweepConfig, SweepGuidance, SweepModel};
use crate::behavior::Behavior;
use crate::diffusion::SamplerKind;
use crate::generate::{GenerateConfig, ObserveConfig, RequestConfig};
use crate::guidance::ObjectiveConfig;
use crate::scene::{GuidanceLevel, LevelAxis};
use crate::settings::{self, Issue, Result};

/// The context that the parts of a sweep must agree with.
struct Purpose<'a> {
    /// The section, which provides the defaults of sweeps.
    config: &'a GenerateConfig,
    behavior: Option<&'a dyn Behavior>,
}

impl SweepConfig {
    /// Resolves the sweep for these mined behaviors.
    pub(in crate::generate) fn resolve(
        &self,
        config: &GenerateConfig,
        behaviors: &[Box<dyn Behavior>],
    ) -> Result<ResolvedSweep> {
        if self.n_scenes == 0 {
            return Err(Issue::new("n_scenes", "is 0, expected at least 1"));
        }
        let behavior = self.behavior.as_deref().map(|id| mined(id, behaviors)).transpose()?;
        let model = self.resolve_model(&Purpose { config, behavior })?;
        let sweep = ResolvedSweep {
            name: self.name.clone(),
            n_scenes: self.n_scenes,
            n_samples: self.n_samples,
            behavior: self.behavior.clone(),
            pairs: self.pairs.clone(),
            aim: self.aim,
            rollout: self.rollout,
            observe: self.observe.clone(),
            model,
        };
        let can_aim = behavior.is_some() && !sweep.aims_at().is_empty();
        if self.aim != Aim::Anything && !can_aim {
            return Err(Issue::new(
                "aim",
                "is \"feasible\", which needs a behavior and what can aim at the event's parameters: template = true, \
                 or strengths other than 0 and an objective, such as \
                 objectives = [{ kind = \"cut_in\" }]",
            ));
        }
        if self.aim == Aim::Hard && self.pairs.ranking.is_some() {
            let why = "is set, but aim = \"hard\" ranks pairs by how hard their events can be; remove one of them";
            return Err(Issue::new("pairs.ranking", why));
        }
        Ok(sweep)
    }

    /// Refuses settings of an arm that no request could try, whatever its behavior.
    pub(in crate::generate) fn validate_arm(&self) -> Result {
        settings::printable_name("name", &self.name)?;
        if self.name.contains(['/', '@']) {
            return Err(Issue::new("name", format_args!("is \"{}\", expected one without / and @", self.name)));
        }
        self.check_arm()?;
        match self.model {
            SampledModel::Baseline => Err(Issue::new(
                "model",
                "is \"baseline\", which has a fixed number of futures per scene; use \"denoiser\" or \"distilled\"",
            )),
            SampledModel::Denoiser | SampledModel::Distilled => self.all_levels().map(drop),
        }
    }

    /// The sweeps that try this arm for a request: one for each level.
    pub(in crate::generate) fn resolve_arm(
        &self,
        request: &RequestConfig,
        config: &GenerateConfig,
        behavior: &dyn Behavior,
    ) -> Result<Vec<(ResolvedSweep, GuidanceLevel)>> {
        let behavior = Some(behavior);
        let model = self.resolve_model(&Purpose { config, behavior })?;
        let sweep = ResolvedSweep {
            name: format!("{}/{}", request.name, self.name),
            n_scenes: request.n_scenes,
            n_samples: self.n_samples,
            behavior: Some(request.behavior.clone()),
            pairs: request.pairs.clone(),
            aim: Aim::default(),
            rollout: self.rollout,
            observe: self.observe.clone(),
            model,
        };
        let levels = sweep.levels();
        if let &[level] = levels {
            return Ok(vec![(sweep, level)]);
        }
        let axis = LevelAxis::of(levels.iter().copied());
        let at = |level: &GuidanceLevel| {
            let mut one = ResolvedSweep { name: format!("{}@{}", sweep.name, axis.read(*level)), ..sweep.clone() };
            if let SweepModel::Denoiser(diffusion) | SweepModel::Distilled(diffusion) = &mut one.model {
                diffusion.levels = vec![*level];
            }
            (one, *level)
        };
        Ok(levels.iter().map(at).collect())
    }
}

pub(in crate::generate) fn mined<'a>(id: &str, behaviors: &'a [Box<dyn Behavior>]) -> Result<&'a dyn Behavior> {
    behaviors.iter().map(AsRef::as_ref).find(|behavior| behavior.id() == id).ok_or_else(|| {
        let known: Vec<&str> = behaviors.iter().map(|behavior| behavior.id()).collect();
        let known = known.join(", ");
        Issue::new("behavior", format_args!("is \"{id}\", expected one of mine.behaviors, which are {known}"))
    })
}

impl SweepConfig {
    fn resolve_model(&self, purpose: &Purpose<'_>) -> Result<SweepModel> {
        let roles = purpose.behavior.map_or(&[][..], Behavior::roles);
        self.observe.validate(roles)?;
        if let Some(rollout) = &self.rollout {
            rollout.validate().map_err(|issue| issue.within("rollout"))?;
            if self.observe != ObserveConfig::default() {
                let why =
                    "is set, but plans are sampled from the past alone; remove it, or set observe = \"predictive\"";
                return Err(Issue::new("rollout", why));
            }
        }
        match self.model {
            SampledModel::Denoiser => Ok(SweepModel::Denoiser(self.resolve_diffusion(purpose)?)),
            SampledModel::Distilled => {
                let resolved = self.resolve_diffusion(purpose)?;
                if resolved.sampler.kind != SamplerKind::Euler {
                    return Err(Issue::new(
                        "sampler",
                        format_args!(
                            "is {}, which expects a denoiser that predicts means; a distilled one does not, and \
                             samples would be far too wide; set sampler = {{ kind = \"euler\", n_steps = 2, \
                             grid = … }} as in train.distill.method",
                            resolved.sampler.name()
                        ),
                    ));
                }
                Ok(SweepModel::Distilled(resolved))
            }
            SampledModel::Baseline => self.check_baseline().map(|()| SweepModel::Baseline),
        }
    }

    fn resolve_diffusion(&self, purpose: &Purpose<'_>) -> Result<Diffusion> {
        let levels = self.all_levels()?;
        if let Some(sampler) = &self.sampler {
            sampler.validate().map_err(|issue| issue.within("sampler"))?;
        }
        let roles = purpose.behavior.map_or(&[][..], Behavior::roles);
        if let Some(config) = &self.classifier_free {
            config.validate(roles).map_err(|issue| issue.within("classifier_free"))?;
        }
        if let Some(edit) = &self.edit {
            edit.validate(roles).map_err(|issue| issue.within("edit"))?;
        }
        let resolved = Diffusion {
            sampler: self.sampler.unwrap_or(purpose.config.sampler).resolved(),
            validity_strength: self.validity_strength.unwrap_or(purpose.config.validity_strength),
            levels,
            guidance: SweepGuidance {
                gate: self.guidance,
                classifier_scope: self.classifier_scope,
                classifier_potential: self.classifier_potential,
                objectives: self.objectives.iter().map(ObjectiveConfig::spelled_out).collect(),
            },
            classifier_free: self.classifier_free.clone(),
            edit: self.edit.clone(),
            template: self.template_parameters(purpose)?,
        };
        resolved.check_guidance(purpose, &self.observe).map(|()| resolved)
    }

    /// The parameters for which templates are solved; empty without templates.
    fn template_parameters(&self, purpose: &Purpose<'_>) -> Result<&'static [&'static str]> {
        if !self.template {
            return Ok(&[]);
        }
        let refuse = |why: String| Err(Issue::new("template", format_args!("is true, but {why}")));
        if self.classifier_scope != ClassifierScope::None && self.strengths.iter().any(|strength| *strength != 0.0) {
            return refuse("the classifier does not know templates; set classifier_scope = \"none\"".to_owned());
        }
        if self.edit.is_some() {
            return refuse("the sweep edits recordings, too; remove edit or template".to_owned());
        }
        match purpose.behavior.map(|behavior| (behavior.id(), behavior.template_parameters())) {
            None => {
                refuse("no behavior is requested; add one that has templates, such as behavior = \"cut_in\"".to_owned())
            }
            Some((id, [])) => {
                refuse(format!("{id} has no templates; remove it, or request one that has, such as \"cut_in\""))
            }
            Some((_, parameters)) => Ok(parameters),
        }
    }
}

impl Diffusion {
    /// Whether the classifier of the behavior guides.
    fn classifies(&self, purpose: &Purpose<'_>) -> bool {
        self.is_guided() && purpose.behavior.is_some() && self.guidance.classifier_scope != ClassifierScope::None
    }

    fn check_guidance(&self, purpose: &Purpose<'_>, observe: &ObserveConfig) -> Result {
        let guidance = &self.guidance;
        let classifies = self.classifies(purpose);
        let has_objectives = !guidance.objectives.is_empty();
        if self.is_guided() && !has_objectives && !classifies {
            let missing = match purpose.behavior {
                Some(_) => "are guided, but classifier_scope = \"none\" disables the classifier; add objectives",
                None => "are guided, which needs a behavior, such as behavior = \"cut_in\", or objectives",
            };
            return Err(Issue::new("strengths", missing));
        }
        if has_objectives && !self.is_guided() {
            return Err(Issue::new(
                "objectives",
                "have no effect at strength 0; add a strength, such as strengths = [1.0]",
            ));
        }
        let roles = purpose.behavior.map_or(&[][..], Behavior::roles);
        for (i, objective) in guidance.objectives.iter().enumerate() {
            let (key, kind) = (format!("objectives.{i}"), objective.kind());
            objective.validate(roles).map_err(|why| Issue::new(key, format_args!("({kind}): {why}")))?;
        }
        if classifies && *observe != ObserveConfig::default() {
            return Err(Issue::new(
                "observe",
                "is set, but the classifier knows only observe = \"predictive\"; remove it, or set classifier_scope = \
                 \"none\" and objectives",
            ));
        }
        Ok(())
    }
}
