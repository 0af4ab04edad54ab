//! Looks up the surroundings of agents: lanes, frames and modes of motion.

use super::motion_modes::{ModeTable, MotionModes};
use super::reference::Reference;
use super::surroundings::{AgentPath, agent_attributes};
use super::{AgentFrame, MotionCovariance, RowSurroundings, SceneView, Surroundings, SurroundingsLayout};
use crate::geometry::Vec2;
use candle_core::{Device, Result, Tensor};
use rayon::prelude::*;
use std::sync::Arc;

/// The number of lane pieces that agents see, and the cache of modes between batches.
#[derive(Debug, Clone)]
pub struct Sight {
    /// Pieces of lanes for each agent.
    pub n_lanes: usize,
    modes: Arc<ModeTable>,
}

impl Sight {
    /// Sight of `n_lanes` pieces of lanes an agent.
    pub fn new(n_lanes: usize) -> Self {
        Self { n_lanes, modes: Arc::default() }
    }

    /// The modes of an agent's motion, given its `observed` and `latent` timesteps; after the last observed one, its
    /// motion is predicted from `n_past` steps and has this texture.
    pub(super) fn modes_of_motion(
        &self,
        covariance: &MotionCovariance,
        observed: (&[usize], usize, [f64; 3]),
        latent: &[usize],
        n_timesteps: usize,
    ) -> MotionModes {
        self.modes.modes(covariance, observed, latent, n_timesteps)
    }

    /// The surroundings of the agents of all rows, A agents and T timesteps with D diffused dimensions a row.
    /// `modes_of_agents` have the place of their agent in (B, A); `covariance` predicts how agents continue.
    pub(super) fn surroundings(
        &self,
        views: &[SceneView<'_>],
        frames: &[Arc<AgentFrame>],
        modes_of_agents: &[(usize, MotionModes)],
        [n_agents, t, d]: [usize; 3],
        covariance: Option<&MotionCovariance>,
        device: &Device,
    ) -> Result<Surroundings> {
        let n_rows = views.len();
        let seen: Vec<(RowSurroundings, Vec<(Vec2, f64)>)> =
            views.par_iter().zip(frames).map(|(view, frame)| self.look_around(view, frame, covariance, t)).collect();
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
        for (at, MotionModes { vectors, variances: of_modes }) in modes_of_agents {
            modes[at * d * t * t..(at + 1) * d * t * t].copy_from_slice(vectors);
            variances[at * d * t..(at + 1) * d * t].copy_from_slice(of_modes);
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

    /// The surroundings of the agents of a row, and each agent's own frame in the row's ego frame.
    fn look_around(
        &self,
        view: &SceneView<'_>,
        frame: &AgentFrame,
        covariance: Option<&MotionCovariance>,
        n_timesteps: usize,
    ) -> (RowSurroundings, Vec<(Vec2, f64)>) {
        let scene = view.scene;
        let present = scene.current_timestep();
        let paths: Vec<AgentPath<'_>> = (frame.agents.iter())
            .map(|agent_idx| {
                let track = &scene.tracks[*agent_idx];
                let observed = |t: usize| frame.observed(*agent_idx, t) && track.trajectory.is_valid(t);
                let reference = Reference::new(track, scene.dt_s, present, observed).continued(covariance, true);
                let position = |t: usize| reference.at(t).map(|pose| frame.ego_from_scene.point(pose.position));
                let anchor = reference.anchor_timestep();
                // Five positions from the anchor to the end of the row describe the path.
                let path =
                    (0..=4).filter_map(|i| position(anchor + n_timesteps.saturating_sub(1 + anchor) * i / 4)).collect();
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
        let horizon_s = n_timesteps.saturating_sub(scene.n_history) as f64 * scene.dt_s;
        let surroundings = RowSurroundings::new(&lanes, &paths, self.n_lanes, scene.dt_s, horizon_s);
        (surroundings, paths.into_iter().map(|path| (path.origin, path.heading_rad)).collect())
    }
}
