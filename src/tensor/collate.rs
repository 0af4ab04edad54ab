//! Builds batches: chooses agents, centers each scene on its ego agent, and writes states, masks and features.

use super::features::lane_polylines;
use super::hidden_states::generated_timesteps;
use super::motion::MotionChain;
use super::motion_modes::{ModeTable, MotionModes};
use super::reference::Reference;
use super::scene_batch::Surroundings;
use super::surroundings::{AgentPath, RowSurroundings, SurroundingsLayout, agent_attributes};
use super::{FeatureLayout, Normalizer, SceneBatch, StateParametrization};
use crate::geometry::{Transform2, Vec2, angle_difference, unwrap_angles};
use crate::scene::{AgentClass, ObservationMask, Scene, Track};
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

/// The agents of a row and the frame its coordinates are in.
#[derive(Debug, Clone, PartialEq)]
pub struct AgentFrame {
    /// From the scene frame to the row's ego frame.
    pub ego_from_scene: Transform2,
    /// Indices of the scene's tracks, in the order of the batch's agent axis.
    pub agents: Vec<usize>,
    ego_idx: usize,
    mask: ObservationMask,
    /// Whether headings that recordings do not hold follow from the motion instead of being generated.
    derives_headings: bool,
}

impl AgentFrame {
    /// Whether the mask observes this state of the scene's track.
    pub fn observed(&self, track_idx: usize, timestep: usize) -> bool {
        timestep < self.mask.n_timesteps() && self.mask.is_observed(track_idx, timestep)
    }

    /// The place on the batch's agent axis of the ego agent, if it is in the batch.
    pub fn ego_slot(&self) -> Option<usize> {
        self.slot(self.ego_idx)
    }

    /// Whether the heading of this track follows from its motion: INTERACTION records none of those who walk or ride a bicycle,
    /// and what was derived for them while they stand is noise.
    pub(super) fn derives_heading(&self, track: &Track) -> bool {
        self.derives_headings && track.class == AgentClass::PedestrianOrCyclist
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
    /// What is looked up around each agent, for networks that see it.
    pub sight: Option<Sight>,
}

/// How far agents see, and what is remembered of it between batches.
#[derive(Debug, Clone)]
pub struct Sight {
    /// Pieces of lanes that each agent is shown.
    pub n_lanes: usize,
    modes: Arc<ModeTable>,
}

impl Sight {
    /// Sight of `n_lanes` pieces of lanes an agent.
    pub fn new(n_lanes: usize) -> Self {
        Self { n_lanes, modes: Arc::default() }
    }
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
        let mut surroundings = self.sight.as_ref().map(|_| SurroundingsBuffers::default());
        for (row, (view, frame)) in views.iter().zip(&frames).enumerate() {
            for (slot, agent_idx) in frame.agents.iter().enumerate() {
                let modes = self.write_agent(&mut rows, row * n_agents + slot, view, frame, *agent_idx, validity);
                if let Some(buffers) = &mut surroundings {
                    buffers.modes.push((row * n_agents + slot, modes));
                }
            }
            rows.write_lanes(row, &lanes[row]);
        }
        let mut batch = rows.into_batch(frames, device)?;
        if let (Some(sight), Some(buffers)) = (&self.sight, surroundings) {
            batch.surroundings = Some(self.surroundings(sight, views, &batch.frames, buffers, n_agents, device)?);
        }
        Ok(batch)
    }

    /// What surrounds the agents of each row.
    fn surroundings(
        &self,
        sight: &Sight,
        views: &[SceneView<'_>],
        frames: &[Arc<AgentFrame>],
        buffers: SurroundingsBuffers,
        n_agents: usize,
        device: &Device,
    ) -> Result<Surroundings> {
        let (n_rows, t, d) = (views.len(), self.n_timesteps, self.normalizer.state_dim);
        let seen: Vec<(RowSurroundings, Vec<(Vec2, f64)>)> =
            views.par_iter().zip(frames).map(|(view, frame)| self.look_around(sight, view, frame)).collect();
        let n_lanes =
            seen.iter().flat_map(|(row, _)| &row.agents).map(|agent| agent.lanes.len()).max().unwrap_or(0).max(1);
        let n = n_rows * n_agents;
        let (piece, attribute) = (SurroundingsLayout::PIECE, SurroundingsLayout::AGENT);
        let mut origin = vec![0.0f32; n * 2];
        let mut attributes = vec![0.0f32; n * attribute];
        let mut lanes = vec![0.0f32; n * n_lanes * piece];
        let mut lane_valid = vec![0.0f32; n * n_lanes];
        for (row, (surroundings, poses)) in seen.iter().enumerate() {
            for (slot, (position, heading_rad)) in poses.iter().enumerate() {
                let at = row * n_agents + slot;
                origin[at * 2..at * 2 + 2].copy_from_slice(&[position.x as f32, position.y as f32]);
                let track = &views[row].scene.tracks[frames[row].agents[slot]];
                attributes[at * attribute..(at + 1) * attribute].copy_from_slice(&agent_attributes(track));
                for i in 0..surroundings.agents[slot].lanes.len() {
                    if let Some(features) = surroundings.piece_features(slot, i, *position, *heading_rad) {
                        let lane = at * n_lanes + i;
                        lanes[lane * piece..(lane + 1) * piece].copy_from_slice(&features);
                        lane_valid[lane] = 1.0;
                    }
                }
            }
        }
        let mut modes = vec![0.0f32; n * d * t * t];
        let mut variances = vec![0.0f32; n * d * t];
        for (at, of_agent) in buffers.modes {
            let Some(MotionModes { vectors, variances: of_modes }) = of_agent else { continue };
            modes[at * d * t * t..(at + 1) * d * t * t].copy_from_slice(&vectors);
            variances[at * d * t..(at + 1) * d * t].copy_from_slice(&of_modes);
        }
        Ok(Surroundings {
            origin: Tensor::from_vec(origin, (n_rows, n_agents, 2), device)?,
            attributes: Tensor::from_vec(attributes, (n_rows, n_agents, attribute), device)?,
            lanes: Tensor::from_vec(lanes, (n_rows, n_agents, n_lanes, piece), device)?,
            lane_valid: Tensor::from_vec(lane_valid, (n_rows, n_agents, n_lanes), device)?,
            modes: Tensor::from_vec(modes, (n_rows, n_agents, d, t, t), device)?,
            variances: Tensor::from_vec(variances, (n_rows, n_agents, d, t), device)?,
            rows: seen.into_iter().map(|(row, _)| Arc::new(row)).collect(),
        })
    }

    /// What the agents of a row have around them, and where each of them is: its own frame in the row's ego frame.
    fn look_around(
        &self,
        sight: &Sight,
        view: &SceneView<'_>,
        frame: &AgentFrame,
    ) -> (RowSurroundings, Vec<(Vec2, f64)>) {
        let scene = view.scene;
        let present = scene.current_timestep();
        let paths: Vec<AgentPath<'_>> = (frame.agents.iter())
            .map(|agent_idx| {
                let track = &scene.tracks[*agent_idx];
                let observed = |t: usize| frame.observed(*agent_idx, t) && track.trajectory.is_valid(t);
                let reference = Reference::new(track, scene.dt_s, present, observed);
                let position = |t: usize| reference.at(t).map(|pose| frame.ego_from_scene.point(pose.position));
                let anchor = reference.anchor_timestep();
                // Five places from the anchor to the end of the row tell where the path leads.
                let path = (0..=4).filter_map(|i| position(anchor + (self.n_timesteps - 1 - anchor) * i / 4)).collect();
                AgentPath {
                    track,
                    origin: position(anchor).unwrap_or(Vec2::ZERO),
                    heading_rad: match reference.at(anchor) {
                        Some(_) => frame.ego_from_scene.heading(reference.frame_heading_rad()),
                        None => 0.0,
                    },
                    speed_mps: reference.anchor_speed_mps(),
                    path,
                }
            })
            .collect();
        let lanes = scene.lanes.transformed(&frame.ego_from_scene);
        let horizon_s = (self.n_timesteps - scene.n_history.min(self.n_timesteps)) as f64 * scene.dt_s;
        let surroundings = RowSurroundings::new(&lanes, &paths, sight.n_lanes, scene.dt_s, horizon_s);
        (surroundings, paths.into_iter().map(|path| (path.origin, path.heading_rad)).collect())
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
        }
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
                let sigma_data = Normalizer::SIGMA_DATA;
                let mut modes = sight.modes.modes(covariance, &observed, &latent, self.n_timesteps, sigma_data);
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

/// What is gathered of agents' surroundings while a batch is written.
#[derive(Default)]
struct SurroundingsBuffers {
    /// Modes of motion by place in (B, A).
    modes: Vec<(usize, Option<MotionModes>)>,
}

/// The batch's tensors while they are written on the host.
struct Buffers {
    shape: [usize; 5],
    x0: Vec<f32>,
    context: Vec<f32>,
    observed: Vec<f32>,
    latent: Vec<f32>,
    scored: Vec<f32>,
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
            scored: vec![0.0; n_entries],
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
            scored: Tensor::from_vec(self.scored, (b, a, t), device)?,
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
            surroundings: None,
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
