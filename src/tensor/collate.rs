//! Builds batches: chooses agents, centers each scene on its ego agent, and writes states, masks and features.

use super::batch_buffers::BatchBuffers;
use super::features::lane_polylines;
use super::hidden_states::generated_timesteps;
use super::motion::MotionChain;
use super::motion_modes::MotionModes;
use super::reference::Reference;
use super::{AgentFrame, FeatureLayout, Normalizer, SceneBatch, Sight, StateParametrization};
use crate::geometry::{Transform2, Vec2, angle_difference, unwrap_angles};
use crate::scene::{ObservationMask, Scene};
use candle_core::{Device, Result, bail};
use rayon::prelude::*;

/// Which of the states that are not observed are to be generated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FutureValidity {
    /// Those that were recorded: for training and for losses.
    Recorded,
    /// Every stretch of hidden states that follows or precedes an observed state of the agent, whatever was recorded in it:
    /// for sampling. Where the mask shows that the agent was not tracked, it stays absent.
    Everything,
    /// The same stretches as for sampling, of which those that were recorded are scored: for training a network that is told
    /// the same in training as when sampling. What was not recorded goes on with the last motion that was.
    Continued,
}

/// A scene as one row of a batch: seen from which agent, with which states observed.
#[derive(Debug, Clone, Copy)]
pub struct SceneView<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// The agent at the origin. Where it is not tracked at the last timestep of the history, the scene frame is kept.
    pub ego_idx: usize,
    /// Which states are observed; one entry for each track and timestep of the scene.
    pub mask: &'a ObservationMask,
}

/// Turns scenes into batches.
#[derive(Debug, Clone)]
pub struct Collator {
    /// Scales.
    pub normalizer: Normalizer,
    /// Timesteps of a row; scenes with fewer (history only) are padded with entries to generate.
    pub n_timesteps: usize,
    /// At most so many agents a row: those nearest to the ego agent at the last timestep of the history.
    pub max_agents: usize,
    /// At most so many lane polylines a row, nearest first.
    pub max_lanes: usize,
    /// What is looked up around each agent, for networks that see it.
    pub sight: Option<Sight>,
}

impl Collator {
    /// One row for each view, padded to the largest row.
    ///
    /// # Errors
    /// Fails when the device runs out of memory.
    pub fn collate(&self, views: &[SceneView<'_>], validity: FutureValidity, device: &Device) -> Result<SceneBatch> {
        if self.sight.is_some() && self.normalizer.motion_covariance.is_none() {
            bail!("agents are to see what surrounds them, but the normalizer knows no covariance of their motion");
        }
        let frames: Vec<AgentFrame> = views.iter().map(|view| self.frame(view)).collect();
        let lanes: Vec<Vec<[f32; FeatureLayout::LANE]>> = views
            .par_iter()
            .zip(&frames)
            .map(|(view, frame)| {
                lane_polylines(&view.scene.lanes, &frame.ego_from_scene, &self.normalizer, self.max_lanes)
            })
            .collect();
        let n_agents = frames.iter().map(|frame| frame.agents.len()).max().unwrap_or(0).max(1);
        let n_lanes = lanes.iter().map(Vec::len).max().unwrap_or(0).max(1);
        let mut rows = BatchBuffers::new([views.len(), n_agents, self.n_timesteps, n_lanes], &self.normalizer);
        let mut modes_of_agents: Vec<(usize, MotionModes)> = Vec::new();
        for (row, (view, frame)) in views.iter().zip(&frames).enumerate() {
            for (slot, agent_idx) in frame.agents.iter().enumerate() {
                let at = row * n_agents + slot;
                let modes = self.write_agent(&mut rows, at, view, frame, *agent_idx, validity);
                modes_of_agents.extend(modes.map(|modes| (at, modes)));
            }
            rows.write_lanes(row, &lanes[row]);
        }
        let mut batch = rows.into_batch(frames, device)?;
        if let Some(sight) = &self.sight {
            let sizes = [n_agents, self.n_timesteps, self.normalizer.state_dim];
            batch.surroundings = Some(sight.surroundings(views, &batch.frames, &modes_of_agents, sizes, device)?);
        }
        Ok(batch)
    }

    fn frame(&self, view: &SceneView<'_>) -> AgentFrame {
        let current = view.scene.current_timestep();
        let ego = view.scene.state(view.ego_idx, current);
        let scene_from_ego =
            ego.map_or(Transform2::IDENTITY, |ego| Transform2::from_pose(ego.position, ego.heading_rad));
        let ego_from_scene = scene_from_ego.inverse();
        let mut agents: Vec<usize> = (0..view.scene.tracks.len()).collect();
        if agents.len() > self.max_agents {
            let distance = |agent_idx: &usize| {
                let state = view.scene.state(*agent_idx, current);
                state.map_or(f64::INFINITY, |state| ego_from_scene.point(state.position).norm())
            };
            agents.sort_by(|a, b| distance(a).total_cmp(&distance(b)).then(a.cmp(b)));
            agents.truncate(self.max_agents);
            agents.sort_unstable();
        }
        AgentFrame {
            ego_from_scene,
            agents,
            ego_idx: view.ego_idx,
            mask: view.mask.clone(),
            derives_headings: self.sight.is_some(),
            // Where no heading is diffused, there is none to leave out.
            has_headings: self.normalizer.state_dim < 3 || view.scene.source.dataset.facts().has_headings,
        }
    }

    /// Writes every entry of one agent; `at` is its place in (B, A).
    fn write_agent(
        &self,
        rows: &mut BatchBuffers,
        at: usize,
        view: &SceneView<'_>,
        frame: &AgentFrame,
        agent_idx: usize,
        validity: FutureValidity,
    ) -> Option<MotionModes> {
        let normalizer = &self.normalizer;
        let track = &view.scene.tracks[agent_idx];
        let observed = |timestep: usize| frame.observed(agent_idx, timestep) && track.trajectory.is_valid(timestep);
        let reference = Reference::new(track, view.scene.dt_s, view.scene.current_timestep(), observed);
        let is_observed_at_all = reference.at(0).is_some();
        let residual = normalizer.parametrization != StateParametrization::Scene;
        let derives_heading = frame.derives_heading(track);
        let ego_heading = frame.ego_from_scene.rotation_rad;
        // An agent never observed has no frame of its own: it is diffused in the ego frame, in scene units.
        let (frame_heading, unit) = if residual && is_observed_at_all {
            (reference.frame_heading_rad() + ego_heading, normalizer.agent_units())
        } else {
            (0.0, normalizer.scene_units())
        };
        rows.rotation[at * 2..at * 2 + 2].copy_from_slice(&[frame_heading.cos() as f32, frame_heading.sin() as f32]);
        rows.unit[at * 3..at * 3 + 3].copy_from_slice(&unit.map(|u| u as f32));

        let shown = |timestep: usize| frame.observed(agent_idx, timestep);
        let recorded = |timestep: usize| track.trajectory.is_valid(timestep);
        let latent: Vec<bool> = match validity {
            FutureValidity::Recorded => (0..self.n_timesteps).map(|t| recorded(t) && !shown(t)).collect(),
            FutureValidity::Everything | FutureValidity::Continued => {
                generated_timesteps(self.n_timesteps, shown, recorded)
            }
        };
        let entries: Vec<(usize, bool)> = (0..self.n_timesteps)
            .filter_map(|t| if observed(t) { Some((t, true)) } else { latent[t].then_some((t, false)) })
            .collect();
        let mut base_headings: Vec<f64> = Vec::with_capacity(entries.len());
        let mut base_positions: Vec<Vec2> = Vec::with_capacity(entries.len());
        for (timestep, is_observed) in &entries {
            let pose = if *is_observed || residual { reference.at(*timestep) } else { None };
            base_positions.push(pose.map_or(Vec2::ZERO, |pose| frame.ego_from_scene.point(pose.position)));
            base_headings.push(pose.map_or(0.0, |pose| frame.ego_from_scene.heading(pose.heading_rad)));
        }
        let recorded_headings = self.unwrapped_headings(view.scene, frame, agent_idx, &entries);
        if residual {
            unwrap_angles(&mut base_headings);
        } else {
            for (base, ((_, is_observed), recorded)) in
                base_headings.iter_mut().zip(entries.iter().zip(&recorded_headings))
            {
                if *is_observed {
                    *base = *recorded;
                }
            }
        }

        let extent = track.extent;
        let mut residuals: Vec<Option<[f64; 3]>> = vec![None; self.n_timesteps];
        for (i, (timestep, is_observed)) in entries.iter().enumerate() {
            let (entry, position, heading) = (at * self.n_timesteps + timestep, base_positions[i], base_headings[i]);
            rows.write_base(entry, position, heading, normalizer, *is_observed || (residual && is_observed_at_all));
            rows.observed[entry] = f32::from(u8::from(*is_observed));
            rows.latent[entry] = f32::from(u8::from(!*is_observed));
            let is_scored = !*is_observed && (validity != FutureValidity::Continued || recorded(*timestep));
            rows.scored[entry] = f32::from(u8::from(is_scored));
            let features = &mut rows.features[entry * FeatureLayout::AGENT..(entry + 1) * FeatureLayout::AGENT];
            let state = track.trajectory.get(*timestep);
            if let Some(state) = state.filter(|_| *is_observed) {
                let velocity = frame.ego_from_scene.vector(state.velocity) * (1.0 / normalizer.velocity_unit_mps);
                features[0] = velocity.x as f32;
                features[1] = velocity.y as f32;
            }
            features[2] = f32::from(u8::from(*is_observed));
            features[3] = 1.0;
            features[4] = extent.map_or(0.0, |e| (e.length_m / normalizer.extent_unit_m) as f32);
            features[5] = extent.map_or(0.0, |e| (e.width_m / normalizer.extent_unit_m) as f32);
            features[6] = f32::from(u8::from(!is_observed_at_all));
            if let Some(state) = state.filter(|_| !*is_observed) {
                let offset = (frame.ego_from_scene.point(state.position) - position).rotated(-frame_heading);
                let turn = if derives_heading {
                    0.0
                } else if residual && is_observed_at_all {
                    angle_difference(recorded_headings[i], heading)
                } else {
                    recorded_headings[i]
                };
                residuals[*timestep] = Some([offset.x, offset.y, turn]);
            }
        }
        if normalizer.parametrization == StateParametrization::Motion {
            let timesteps = |wanted: bool| -> Vec<usize> {
                entries.iter().filter(|(_, is_observed)| *is_observed == wanted).map(|(t, _)| *t).collect()
            };
            let (observed, latent) = (timesteps(true), timesteps(false));
            let chain = MotionChain::new(&observed, &latent);
            let mut motion = chain.encode(|timestep| residuals[timestep]);
            if validity == FutureValidity::Continued {
                for i in 1..motion.len() {
                    if residuals[motion[i].0].is_none() {
                        motion[i].1 = motion[i - 1].1;
                    }
                }
            }
            rows.write_x0(at, motion, &unit);
            rows.write_path(at, &chain.matrix(self.n_timesteps));
            let seen = |(t, [along, across, turn]): (usize, [f64; 3])| {
                (t, [along, across, if derives_heading { 0.0 } else { turn }])
            };
            rows.write_observed_motion(at, reference.observed_motion().map(seen), &unit);
            if let (Some(sight), Some(covariance)) = (&self.sight, &normalizer.motion_covariance) {
                let mut modes = sight.modes_of_motion(covariance, &observed, &latent, self.n_timesteps);
                if derives_heading {
                    modes.clear_from(2, self.n_timesteps);
                }
                return Some(modes);
            }
        } else {
            rows.write_x0(at, residuals.into_iter().enumerate().filter_map(|(t, r)| Some((t, r?))), &unit);
        }
        None
    }

    /// Recorded headings in the ego frame, continuous along time; 0 where there is no recorded state.
    fn unwrapped_headings(
        &self,
        scene: &Scene,
        frame: &AgentFrame,
        agent_idx: usize,
        entries: &[(usize, bool)],
    ) -> Vec<f64> {
        let mut last: Option<f64> = None;
        entries
            .iter()
            .map(|(timestep, _)| {
                let state = scene.state(agent_idx, *timestep);
                state.map_or(0.0, |state| {
                    let heading = frame.ego_from_scene.heading(state.heading_rad);
                    let unwrapped = last.map_or(heading, |last| last + angle_difference(heading, last));
                    last = Some(unwrapped);
                    unwrapped
                })
            })
            .collect()
    }
}
