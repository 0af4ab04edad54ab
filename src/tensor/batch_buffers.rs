//! Host buffers of a batch's tensors.

use super::{AgentFrame, FeatureLayout, Normalizer, SceneTensors, StateParametrization};
use crate::geometry::Vec2;
use candle_core::{Device, Result, Tensor};
use std::sync::Arc;

/// The batch's tensors while they are written on the host.
pub(super) struct BatchBuffers {
    shape: [usize; 5],
    x0: Vec<f32>,
    context: Vec<f32>,
    pub(super) observed: Vec<f32>,
    pub(super) latent: Vec<f32>,
    pub(super) scored: Vec<f32>,
    pub(super) features: Vec<f32>,
    lanes: Vec<f32>,
    lane_valid: Vec<f32>,
    base: Vec<f32>,
    pub(super) rotation: Vec<f32>,
    pub(super) unit: Vec<f32>,
    path: Option<Vec<f32>>,
    observed_motion: Option<Vec<f32>>,
}

impl BatchBuffers {
    pub(super) fn new([n_rows, n_agents, n_timesteps, n_lanes]: [usize; 4], normalizer: &Normalizer) -> Self {
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

    /// Writes the clean diffused states of the agent at `at` in (B, A), given by timestep in meters and radians.
    pub(super) fn write_x0(&mut self, at: usize, values: impl IntoIterator<Item = (usize, [f64; 3])>, unit: &[f64; 3]) {
        write_entries(&mut self.x0, at, &self.shape, values, unit);
    }

    pub(super) fn write_observed_motion(
        &mut self,
        at: usize,
        values: impl IntoIterator<Item = (usize, [f64; 3])>,
        unit: &[f64; 3],
    ) {
        if let Some(motion) = &mut self.observed_motion {
            write_entries(motion, at, &self.shape, values, unit);
        }
    }

    pub(super) fn write_path(&mut self, at: usize, matrix: &[f32]) {
        if let Some(path) = &mut self.path {
            path[at * matrix.len()..(at + 1) * matrix.len()].copy_from_slice(matrix);
        }
    }

    pub(super) fn write_base(
        &mut self,
        entry: usize,
        position: Vec2,
        heading: f64,
        normalizer: &Normalizer,
        is_known: bool,
    ) {
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

    pub(super) fn write_lanes(&mut self, row: usize, lanes: &[[f32; FeatureLayout::LANE]]) {
        let n_lanes = self.shape[3];
        for (i, lane) in lanes.iter().enumerate() {
            let at = row * n_lanes + i;
            self.lanes[at * FeatureLayout::LANE..(at + 1) * FeatureLayout::LANE].copy_from_slice(lane);
            self.lane_valid[at] = 1.0;
        }
    }

    pub(super) fn into_tensors(self, frames: Vec<AgentFrame>, device: &Device) -> Result<SceneTensors> {
        let [b, a, t, l, d] = self.shape;
        let valid: Vec<f32> = self.observed.iter().zip(&self.latent).map(|(o, l)| o + l).collect();
        Ok(SceneTensors {
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

/// Writes values in meters and radians, by timestep, as those of the agent at `at` in (B, A) of a (B, A, T, D) buffer.
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
