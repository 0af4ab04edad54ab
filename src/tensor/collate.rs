//! Builds batches: chooses agents, centers each scene on its ego agent, and writes states, masks and features.

use super::features::lane_polylines;
use super::hidden_states::generated_timesteps;
use super::motion::MotionChain;
use super::reference::Reference;
use super::{FeatureLayout, Normalizer, SceneBatch, StateParametrization};
use crate::geometry::{Transform2, Vec2, angle_difference, unwrap_angles};
use crate::scene::{ObservationMask, Scene};
use candle_core::{Device, Result, Tensor};
use rayon::prelude::*;
use std::sync::Arc;

/// Which of the states that are not observed are to be generated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FutureValidity {
    /// Those that were recorded: for training and for losses.
    Recorded,
    /// Every stretch of hidden states that follows or precedes an observed state of the agent, whatever was recorded in it:
    /// for sampling. Where the mask shows that the agent was not tracked, it stays absent.
    Everything,
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

/// The agents of a row and the frame its coordinates are in.
#[derive(Debug, Clone, PartialEq)]
pub struct AgentFrame {
    /// From the scene frame to the row's ego frame.
    pub ego_from_scene: Transform2,
    /// Indices of the scene's tracks, in the order of the batch's agent axis.
    pub agents: Vec<usize>,
    mask: ObservationMask,
}

impl AgentFrame {
    /// Whether the mask observes this state of the scene's track.
    pub fn observed(&self, track_idx: usize, timestep: usize) -> bool {
        timestep < self.mask.n_timesteps() && self.mask.is_observed(track_idx, timestep)
    }

    /// The place on the batch's agent axis of the scene's track, if it is in the batch.
    pub fn slot(&self, track_idx: usize) -> Option<usize> {
        self.agents.iter().position(|agent| *agent == track_idx)
    }
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
}

impl Collator {
    /// One row for each view, padded to the largest row.
    ///
    /// # Errors
    /// Fails when the device runs out of memory.
    pub fn collate(&self, views: &[SceneView<'_>], validity: FutureValidity, device: &Device) -> Result<SceneBatch> {
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
        let mut rows = Buffers::new([views.len(), n_agents, self.n_timesteps, n_lanes], &self.normalizer);
        for (row, (view, frame)) in views.iter().zip(&frames).enumerate() {
            for (slot, agent_idx) in frame.agents.iter().enumerate() {
                self.write_agent(&mut rows, row * n_agents + slot, view, frame, *agent_idx, validity);
            }
            rows.write_lanes(row, &lanes[row]);
        }
        rows.into_batch(frames, device)
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
        AgentFrame { ego_from_scene, agents, mask: view.mask.clone() }
    }

    /// Writes every entry of one agent; `at` is its place in (B, A).
    fn write_agent(
        &self,
        rows: &mut Buffers,
        at: usize,
        view: &SceneView<'_>,
        frame: &AgentFrame,
        agent_idx: usize,
        validity: FutureValidity,
    ) {
        let normalizer = &self.normalizer;
        let track = &view.scene.tracks[agent_idx];
        let observed = |timestep: usize| frame.observed(agent_idx, timestep) && track.trajectory.is_valid(timestep);
        let reference = Reference::new(track, view.scene.dt_s, view.scene.current_timestep(), observed);
        let is_observed_at_all = reference.at(0).is_some();
        let residual = normalizer.parametrization != StateParametrization::Scene;
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
            FutureValidity::Everything => generated_timesteps(self.n_timesteps, shown, recorded),
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
                let turn = if residual && is_observed_at_all {
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
            let chain = MotionChain::new(&timesteps(true), &timesteps(false));
            let motion = chain.encode(|timestep| residuals[timestep]);
            rows.write_x0(at, motion, &unit);
            rows.write_path(at, &chain.matrix(self.n_timesteps));
            rows.write_observed_motion(at, reference.observed_motion(), &unit);
        } else {
            rows.write_x0(at, residuals.into_iter().enumerate().filter_map(|(t, r)| Some((t, r?))), &unit);
        }
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

/// The batch's tensors while they are written on the host.
struct Buffers {
    shape: [usize; 5],
    x0: Vec<f32>,
    context: Vec<f32>,
    observed: Vec<f32>,
    latent: Vec<f32>,
    features: Vec<f32>,
    lanes: Vec<f32>,
    lane_valid: Vec<f32>,
    base: Vec<f32>,
    rotation: Vec<f32>,
    unit: Vec<f32>,
    path: Option<Vec<f32>>,
    observed_motion: Option<Vec<f32>>,
}

impl Buffers {
    fn new([n_rows, n_agents, n_timesteps, n_lanes]: [usize; 4], normalizer: &Normalizer) -> Self {
        let state_dim = normalizer.state_dim;
        let is_motion = normalizer.parametrization == StateParametrization::Motion;
        let n_entries = n_rows * n_agents * n_timesteps;
        // Padded agents keep rotation 0: whatever they hold decodes to zero.
        Self {
            shape: [n_rows, n_agents, n_timesteps, n_lanes, state_dim],
            x0: vec![0.0; n_entries * state_dim],
            context: vec![0.0; n_entries * state_dim],
            observed: vec![0.0; n_entries],
            latent: vec![0.0; n_entries],
            features: vec![0.0; n_entries * FeatureLayout::AGENT],
            lanes: vec![0.0; n_rows * n_lanes * FeatureLayout::LANE],
            lane_valid: vec![0.0; n_rows * n_lanes],
            base: vec![0.0; n_entries * 3],
            rotation: vec![0.0; n_rows * n_agents * 2],
            unit: vec![0.0; n_rows * n_agents * 3],
            path: is_motion.then(|| vec![0.0; n_entries * n_timesteps]),
            observed_motion: is_motion.then(|| vec![0.0; n_entries * state_dim]),
        }
    }

    /// Writes the clean diffused states of the agent at `at` in (B, A), given by timestep in metres and radians.
    fn write_x0(&mut self, at: usize, values: impl IntoIterator<Item = (usize, [f64; 3])>, unit: &[f64; 3]) {
        write_entries(&mut self.x0, at, &self.shape, values, unit);
    }

    fn write_observed_motion(
        &mut self,
        at: usize,
        values: impl IntoIterator<Item = (usize, [f64; 3])>,
        unit: &[f64; 3],
    ) {
        if let Some(motion) = &mut self.observed_motion {
            write_entries(motion, at, &self.shape, values, unit);
        }
    }

    fn write_path(&mut self, at: usize, matrix: &[f32]) {
        if let Some(path) = &mut self.path {
            path[at * matrix.len()..(at + 1) * matrix.len()].copy_from_slice(matrix);
        }
    }

    fn write_base(&mut self, entry: usize, position: Vec2, heading: f64, normalizer: &Normalizer, is_known: bool) {
        let base = [position.x, position.y, heading];
        self.base[entry * 3..entry * 3 + 3].copy_from_slice(&base.map(|value| value as f32));
        if is_known {
            let state_dim = normalizer.state_dim;
            let context = &mut self.context[entry * state_dim..(entry + 1) * state_dim];
            for ((slot, value), unit) in context.iter_mut().zip(base).zip(normalizer.scene_units()) {
                *slot = (value / unit) as f32;
            }
        }
    }

    fn write_lanes(&mut self, row: usize, lanes: &[[f32; FeatureLayout::LANE]]) {
        let n_lanes = self.shape[3];
        for (i, lane) in lanes.iter().enumerate() {
            let at = row * n_lanes + i;
            self.lanes[at * FeatureLayout::LANE..(at + 1) * FeatureLayout::LANE].copy_from_slice(lane);
            self.lane_valid[at] = 1.0;
        }
    }

    fn into_batch(self, frames: Vec<AgentFrame>, device: &Device) -> Result<SceneBatch> {
        let [b, a, t, l, d] = self.shape;
        let valid: Vec<f32> = self.observed.iter().zip(&self.latent).map(|(o, l)| o + l).collect();
        Ok(SceneBatch {
            x0: Tensor::from_vec(self.x0, (b, a, t, d), device)?,
            context: Tensor::from_vec(self.context, (b, a, t, d), device)?,
            observed: Tensor::from_vec(self.observed, (b, a, t), device)?,
            latent: Tensor::from_vec(self.latent, (b, a, t), device)?,
            valid: Tensor::from_vec(valid, (b, a, t), device)?,
            features: Tensor::from_vec(self.features, (b, a, t, FeatureLayout::AGENT), device)?,
            lanes: Tensor::from_vec(self.lanes, (b, l, FeatureLayout::LANE), device)?,
            lane_valid: Tensor::from_vec(self.lane_valid, (b, l), device)?,
            base: Tensor::from_vec(self.base, (b, a, t, 3), device)?,
            rotation: Tensor::from_vec(self.rotation, (b, a, 2), device)?,
            unit: Tensor::from_vec(self.unit, (b, a, 3), device)?,
            observed_motion: (self.observed_motion)
                .map(|motion| Tensor::from_vec(motion, (b, a, t, d), device))
                .transpose()?,
            path: self.path.map(|path| Tensor::from_vec(path, (b, a, t, t), device)).transpose()?,
            frames: frames.into_iter().map(Arc::new).collect(),
        })
    }
}

/// Writes values in metres and radians, by timestep, as those of the agent at `at` in (B, A) of a (B, A, T, D) buffer.
fn write_entries(
    buffer: &mut [f32],
    at: usize,
    [_, _, n_timesteps, _, state_dim]: &[usize; 5],
    values: impl IntoIterator<Item = (usize, [f64; 3])>,
    unit: &[f64; 3],
) {
    for (timestep, value) in values {
        let entry = at * n_timesteps + timestep;
        let slots = &mut buffer[entry * state_dim..(entry + 1) * state_dim];
        for ((slot, value), unit) in slots.iter_mut().zip(value).zip(unit) {
            *slot = (value / unit) as f32;
        }
    }
}
