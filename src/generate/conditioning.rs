//! What is a sample conditioned on? The states that it observes, target states that it leans toward, and the edited
//! recording it starts from.

use super::observe::{Subject, rule_mask};
use super::{Cell, ClassifierFreeConfig, EditConfig, Error, Generator, ResolvedSweep};
use crate::behavior::Template;
use crate::diffusion::NoiseSource;
use crate::geometry::Vec2;
use crate::guidance::Target;
use crate::metrics::PairPath;
use crate::scene::{AgentRef, ObservationMask, Roles, Scene, State, Trajectory, UnfitScene};
use crate::seed::Seed;
use crate::tensor::{FeatureLayout, SceneBatch, SceneTensors, SceneView};
use candle_core::Tensor;

/// The scene of a cell as the denoiser sees it.
#[derive(Debug)]
pub(super) struct Conditioned {
    /// The recording, edited if the sweep has edits.
    pub(super) scene: Scene,
    /// The observed part of the scene.
    pub(super) mask: ObservationMask,
    /// The requested agents; the first is at the center.
    pub(super) agents: (usize, usize),
    /// The agents that follow a template, each with its states after the end of the scene.
    performers: Vec<(usize, Vec<State>)>,
    /// Whether its template resembles that of an earlier sample of the shard.
    pub(super) repeats: bool,
}

impl Conditioned {
    /// A scene with its observed part, without requested agents and templates.
    pub(super) const fn new(scene: Scene, mask: ObservationMask, center_idx: usize) -> Self {
        Self { scene, mask, agents: (center_idx, center_idx), performers: Vec::new(), repeats: false }
    }

    pub(super) const fn view(&self) -> SceneView<'_> {
        SceneView { scene: &self.scene, ego_idx: self.agents.0, mask: &self.mask }
    }

    /// The sample of this scene with what its template does after the end of the sample.
    pub(super) fn with_maneuver(&self, sample: Scene) -> Scene {
        let n_further = self.performers.iter().map(|(_, further)| further.len()).max().unwrap_or_default();
        if n_further == 0 {
            return sample;
        }
        let mut scene = sample.lasting(sample.n_timesteps + n_further);
        for (agent_idx, further) in &self.performers {
            let states = sample.tracks[*agent_idx].trajectory.entries().iter().copied();
            scene.tracks[*agent_idx].trajectory =
                Trajectory::new(states.chain(further.iter().copied().map(Some)).collect());
        }
        scene
    }

    /// How the requested agents move in its template; `None` without one.
    pub(super) fn path(&self, asked: &Roles) -> Option<PairPath> {
        (!self.performers.is_empty()).then(|| PairPath::of(&self.with_maneuver(self.scene.clone()), asked)).flatten()
    }

    /// The observed states of a scenario that continues this scene. States of a template count as generated, although
    /// the denoiser observes them.
    pub(super) fn observed(&self, generated: &Scene) -> ObservationMask {
        ObservationMask::from_fn(generated.tracks.len(), generated.n_timesteps, |agent_idx, timestep| {
            let performs = self.performers.iter().any(|(performer, _)| *performer == agent_idx);
            !(performs && timestep >= generated.n_history)
                && timestep < self.mask.n_timesteps()
                && self.mask.is_observed(agent_idx, timestep)
                && generated.state(agent_idx, timestep).is_some()
        })
    }
}

/// Which template a sample follows.
#[derive(Debug, Clone, Copy)]
pub(super) enum Variant {
    /// The next one in turn, or one that comes so many `further`.
    Usual { sample_idx: usize, further: usize },
    /// The one with this number.
    Planned(usize),
}

/// The templates of a cell that were solved so far, by target.
#[derive(Debug, Default)]
pub(super) struct Templates {
    /// How many are solved for a target at most.
    n: usize,
    solved: Vec<(Target, Vec<Template>)>,
}

impl Templates {
    pub(super) const fn new(n: usize) -> Self {
        Self { n, solved: Vec::new() }
    }

    /// The template with this number, cyclically, with this target; at first call `solve` lists so many of the target.
    fn get(&mut self, target: &Target, number: usize, solve: impl FnOnce(usize) -> Vec<Template>) -> Option<Template> {
        let known = self.solved.iter().position(|(known, _)| known == target);
        let at = known.unwrap_or_else(|| {
            self.solved.push((target.clone(), solve(self.n)));
            self.solved.len() - 1
        });
        let templates = &self.solved[at].1;
        templates.get(number % templates.len().max(1)).cloned()
    }
}

/// Target states of a sample: its scene with them moved, and the mask that observes them as well.
pub(super) struct Wanted {
    pub(super) scene: Scene,
    pub(super) mask: ObservationMask,
}

impl Generator<'_> {
    /// The scene of a cell, with these requested `agents`, as the denoiser sees it for all samples or, with a template,
    /// for one of them.
    pub(super) fn condition(
        &self,
        sweep: &ResolvedSweep,
        cell: &Cell,
        recorded: &Scene,
        agents: (usize, usize),
        variant: Variant,
        templates: &mut Templates,
    ) -> Result<Conditioned, Error> {
        let refuse = |UnfitScene(why)| Error::Config(format!("sweep {}: scene {} {why}", sweep.name, cell.scene_id));
        let mut scene = recorded.clone();
        let edit = sweep.diffusion().and_then(|diffusion| diffusion.edit.as_ref());
        if let Some(edit) = edit {
            let resolve = |agent: &AgentRef| agent.resolve(recorded, agents.0, &cell.roles);
            for scene_edit in &edit.edits {
                scene = scene_edit.apply(&scene, &resolve).map_err(refuse)?;
            }
        }
        let performers = self.follow_template(sweep, (cell, variant), (recorded, &mut scene), templates);
        let subject = Subject { scene: &scene, ego_idx: agents.0, roles: &cell.roles };
        let mask = sweep.observe.mask(&subject, self.mask_seed("observe", cell)).map_err(refuse)?;
        if sweep.needs_classifier() {
            let hidden = first_hidden(&scene, &mask);
            if let Some((agent_idx, timestep)) = hidden {
                let track = &scene.tracks[agent_idx].id;
                return Err(refuse(UnfitScene(format!(
                    "has track {track} unobserved at timestep {timestep} of its history, which the classifier that \
                     guides the sweep looks at; observe the history, or let objectives guide alone \
                     (classifier_scope = \"none\")"
                ))));
            }
        }
        if edit.is_some() {
            // A guide needs a value for every generated state.
            scene = scene.completed(|agent_idx, timestep| !mask.is_observed(agent_idx, timestep));
        }
        let mask = ObservationMask::from_fn(mask.n_agents(), mask.n_timesteps(), |agent_idx, timestep| {
            let is_of_template = performers.iter().any(|(performer, _)| *performer == agent_idx)
                && scene.state(agent_idx, timestep).is_some();
            is_of_template || mask.is_observed(agent_idx, timestep)
        });
        Ok(Conditioned { scene, mask, agents, performers, repeats: false })
    }

    /// Puts the template of a sample into `scene`: one that reaches the sample's target, or else any. Returns the
    /// agents that follow it, each with its states after the end of the scene; none if there is no template.
    fn follow_template(
        &self,
        sweep: &ResolvedSweep,
        (cell, variant): (&Cell, Variant),
        (recorded, scene): (&Scene, &mut Scene),
        templates: &mut Templates,
    ) -> Vec<(usize, Vec<State>)> {
        let Some(behavior) = self.behavior(sweep).filter(|_| sweep.uses_template()) else { return Vec::new() };
        let asked: Vec<usize> = cell.roles.tracks().filter_map(|track| recorded.track_idx(track)).collect();
        let (mut target, number, number_of_any) = match variant {
            // The number of earlier samples of the pair with this target.
            Variant::Usual { sample_idx, further } => {
                let n_earlier = sample_idx / cell.targets.len().max(1);
                (cell.target(sample_idx), n_earlier + further, sample_idx + further)
            }
            Variant::Planned(number) => (cell.target(0), number, number),
        };
        target.retain(|name, _| behavior.template_parameters().contains(&name.as_str()));
        let planned = sweep.planned(recorded);
        let mut solved = |target: &Target, number: usize| {
            templates.get(target, number, |n| behavior.templates(&planned, &asked, target, n))
        };
        let template = match solved(&target, number) {
            None if !target.is_empty() => solved(&Target::new(), number_of_any),
            template => template,
        };
        let Some(template) = template else { return Vec::new() };
        let performers: Vec<usize> = template.agents().collect();
        let mut performed = planned.into_owned();
        template.apply(&mut performed);
        let follow = |agent_idx: usize| {
            let (sampled, further) = performed.tracks[agent_idx].trajectory.entries().split_at(scene.n_timesteps);
            scene.tracks[agent_idx].trajectory = Trajectory::new(sampled.to_vec());
            (agent_idx, further.iter().copied().flatten().collect())
        };
        performers.into_iter().map(follow).collect()
    }

    /// The first `n` templates of a cell at most, as [`Variant::Planned`] numbers them: each as a scene of the agents
    /// that follow it and of those requested, of which the others do not go on after the present.
    pub(super) fn templates_alone(&self, sweep: &ResolvedSweep, cell: &Cell, recorded: &Scene, n: usize) -> Vec<Scene> {
        let Some(behavior) = self.behavior(sweep).filter(|_| sweep.uses_template()) else { return Vec::new() };
        let asked: Vec<usize> = cell.roles.tracks().filter_map(|track| recorded.track_idx(track)).collect();
        let mut target = cell.target(0);
        target.retain(|name, _| behavior.template_parameters().contains(&name.as_str()));
        let planned = sweep.planned(recorded);
        let mut templates = behavior.templates(&planned, &asked, &target, n);
        if templates.is_empty() && !target.is_empty() {
            templates = behavior.templates(&planned, &asked, &Target::new(), n);
        }
        let past = planned.lasting(planned.n_history).lasting(planned.n_timesteps);
        let alone = |template: Template| {
            let mut agents: Vec<usize> = template.agents().chain(asked.iter().copied()).collect();
            agents.sort_unstable();
            agents.dedup();
            let mut scene = past.clone();
            template.apply(&mut scene);
            let tracks = agents.into_iter().map(|idx| scene.tracks[idx].clone()).collect();
            Scene { tracks, ego_idx: 0, ..scene }
        };
        templates.into_iter().map(alone).collect()
    }

    /// The target states of some samples of a cell, among the states that `base` generates in row `row`.
    pub(super) fn wanted_of_cell(
        &self,
        config: &ClassifierFreeConfig,
        (cell, given): (&Cell, &Conditioned),
        samples: std::ops::Range<usize>,
        (base, row): (&SceneBatch, usize),
    ) -> Result<Vec<Wanted>, Error> {
        let Conditioned { scene, mask, agents, .. } = given;
        let subject = Subject { scene, ego_idx: agents.0, roles: &cell.roles };
        let extra = rule_mask(&config.extra, &subject, self.mask_seed("extra", cell));
        let latent = base.latent.get(row)?.to_vec2::<f32>()?;
        let frame = &base.frames[row];
        let is_wanted = |agent_idx: usize, timestep: usize| {
            let is_generated = frame.slot(agent_idx).is_some_and(|slot| latent[slot][timestep] > 0.0);
            is_generated && extra.is_observed(agent_idx, timestep) && scene.state(agent_idx, timestep).is_some()
        };
        let mask = ObservationMask::from_fn(mask.n_agents(), mask.n_timesteps(), |agent_idx, timestep| {
            mask.is_observed(agent_idx, timestep) || is_wanted(agent_idx, timestep)
        });
        let seed = self.mask_seed("wanted", cell);
        let moved = samples.map(|sample_idx| {
            let seed = seed.derive("sample", &[sample_idx as u64]);
            Wanted { scene: displaced(scene, config.goal_std_m, seed, &is_wanted), mask: mask.clone() }
        });
        Ok(moved.collect())
    }

    /// The seed of draws for a scene and its requested agents.
    fn mask_seed(&self, purpose: &str, cell: &Cell) -> Seed {
        let scene = self.seed().derive_named(purpose, &cell.scene_id.0);
        cell.roles.iter().fold(scene, |seed, (role, track)| seed.derive_named(role, &track.0))
    }
}

/// The first state of the history that the mask hides, among agents that it shows at all, by agent and timestep.
fn first_hidden(scene: &Scene, mask: &ObservationMask) -> Option<(usize, usize)> {
    let is_shown = |agent_idx: &usize| (0..scene.n_timesteps).any(|t| mask.is_observed(*agent_idx, t));
    let history = |agent_idx| (0..scene.n_history).map(move |timestep| (agent_idx, timestep));
    (0..scene.tracks.len()).filter(is_shown).flat_map(history).find(|(agent_idx, timestep)| {
        scene.state(*agent_idx, *timestep).is_some() && !mask.is_observed(*agent_idx, *timestep)
    })
}

/// The scene with the target states of each agent moved by the same normal offset. The present stays: it defines the
/// frame that the denoiser sees.
pub(super) fn displaced(scene: &Scene, std_m: f64, seed: Seed, is_wanted: &dyn Fn(usize, usize) -> bool) -> Scene {
    let mut displaced = scene.clone();
    for (agent_idx, track) in displaced.tracks.iter_mut().enumerate() {
        let mut rng = seed.derive("agent", &[agent_idx as u64]).rng();
        let offset = Vec2::new(rng.normal(), rng.normal()) * std_m;
        let states = track.trajectory.entries().iter().enumerate().map(|(timestep, state)| {
            let is_moved = timestep != scene.current_timestep() && is_wanted(agent_idx, timestep);
            state.map(|s| if is_moved { State { position: s.position + offset, ..s } } else { s })
        });
        track.trajectory = Trajectory::new(states.collect());
    }
    displaced
}

/// The batch without the velocities of states that it observes and `base` does not.
pub(super) fn without_wanted_velocities(batch: &SceneBatch, base: &SceneBatch) -> Result<SceneBatch, Error> {
    let wanted = (&batch.observed * (1.0 - &base.observed)?)?.unsqueeze(3)?;
    // The first two features are the velocity.
    let is_velocity: Vec<f32> = (0..FeatureLayout::AGENT).map(|i| f32::from(u8::from(i < 2))).collect();
    let is_velocity = Tensor::from_vec(is_velocity, (1, 1, 1, FeatureLayout::AGENT), batch.features.device())?;
    let kept = (1.0 - wanted.broadcast_mul(&is_velocity)?)?;
    let features = (&batch.features * kept)?;
    Ok(SceneBatch::new(SceneTensors { features, ..SceneTensors::clone(batch) })?)
}

/// The state at which denoising of a guide begins.
pub(super) fn noisy_guide(edit: &EditConfig, guide: &Tensor, noise: &mut NoiseSource) -> Result<Tensor, Error> {
    Ok((guide + (noise.draw_like(guide)? * edit.tau)?)?)
}
