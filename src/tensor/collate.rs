//! Builds batches: chooses agents and centers each scene on its ego agent.

use super::agent_row::AgentRow;
use super::batch_buffers::BatchBuffers;
use super::features::lane_polylines;
use super::motion_modes::MotionModes;
use super::observation_errors::without_errors;
use super::{AgentFrame, FeatureLayout, FutureValidity, Normalizer, SceneBatch, SceneView, Sight};
use crate::geometry::Transform2;
use crate::scene::Scene;
use candle_core::{Device, Result, bail};
use rayon::prelude::*;
use std::borrow::Cow;

/// Turns scenes into batches.
#[derive(Debug, Clone)]
pub struct Collator {
    /// Scales.
    pub normalizer: Normalizer,
    /// Timesteps of a row; scenes with fewer (history only) are padded with entries to generate.
    pub n_timesteps: usize,
    /// The most agents per row: those nearest to the ego agent at the last timestep of the history, with parked
    /// vehicles last.
    pub max_agents: usize,
    /// The most lane polylines per row, nearest first.
    pub max_lanes: usize,
    /// The look-up of surroundings, for networks that see them.
    pub sight: Option<Sight>,
}

impl Collator {
    /// One row for each view, padded to the largest row.
    pub fn collate(&self, views: &[SceneView<'_>], validity: FutureValidity, device: &Device) -> Result<SceneBatch> {
        if self.sight.is_some() && self.normalizer.motion_covariance.is_none() {
            bail!(
                "surroundings need the covariance of motion, which the normalizer does not have: no training scene has \
                 a track that is recorded throughout"
            );
        }
        let believed: Vec<Cow<'_, Scene>> = views.par_iter().map(|view| self.believed(view)).collect();
        let recorded = views;
        let views: Vec<SceneView<'_>> =
            views.iter().zip(&believed).map(|(view, scene)| SceneView { scene, ..*view }).collect();
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
                let recorded = &recorded[row].scene.tracks[*agent_idx];
                let agent = AgentRow::new(self, view, frame, *agent_idx, validity, at);
                let mut agent = agent.rough_like(view, recorded, *agent_idx);
                // A network in training does not see the errors that would be left after the present.
                if validity == FutureValidity::Everything {
                    agent = agent.fading_from(view.scene, recorded);
                }
                let modes = agent.write(&mut rows);
                modes_of_agents.extend(modes.map(|modes| (at, modes)));
            }
            rows.write_lanes(row, &lanes[row]);
        }
        let mut tensors = rows.into_tensors(frames, device)?;
        if let Some(sight) = &self.sight {
            let sizes = [n_agents, self.n_timesteps, self.normalizer.state_dim];
            let covariance = self.normalizer.motion_covariance.as_ref();
            let surroundings =
                sight.surroundings(&views, &tensors.frames, &modes_of_agents, sizes, covariance, device)?;
            tensors.surroundings = Some(surroundings);
        }
        SceneBatch::new(tensors)
    }

    /// The scene without the errors of its observed states, as far as the covariance of motion reveals them.
    fn believed<'a>(&self, view: &SceneView<'a>) -> Cow<'a, Scene> {
        let Some(covariance) = &self.normalizer.motion_covariance else { return Cow::Borrowed(view.scene) };
        without_errors(view, covariance, self.normalizer.motion_units())
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
            let is_parked = |agent_idx: &usize| view.scene.tracks[*agent_idx].is_parked() && *agent_idx != view.ego_idx;
            let order =
                |a: &usize, b: &usize| is_parked(a).cmp(&is_parked(b)).then(distance(a).total_cmp(&distance(b)));
            agents.sort_by(|a, b| order(a, b).then(a.cmp(b)));
            agents.truncate(self.max_agents);
            agents.sort_unstable();
        }
        AgentFrame {
            ego_from_scene,
            agents,
            ego_idx: view.ego_idx,
            mask: view.mask.clone(),
            derives_headings: self.sight.is_some(),
            // If no heading is diffused, there is none to leave out.
            has_headings: self.normalizer.state_dim < 3 || view.scene.source.dataset.facts().has_headings,
        }
    }
}
