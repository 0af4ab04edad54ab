//! Turns the poses of an estimate into features of each agent at each token: its own pose, its nearest neighbors, its
//! nearest lanes.
//!
//! All of it is looked up on the host and outside of every gradient: the nearest neighbor or lane changes abruptly, and
//! a network that sees them at every noise level has its gradients through the states themselves.

mod lanes;

pub(super) use self::lanes::LANE;

use self::lanes::nearest_lanes;
use crate::tensor::{AgentSurroundings, RowSurroundings, SceneBatch};
use candle_core::{DType, Device, Result, Tensor};
use rayon::prelude::*;

/// Features of an agent's own pose and velocity.
pub(super) const OWN: usize = 10;
/// Features of a neighbor.
pub(super) const NEIGHBOR: usize = 17;

/// Meters per unit of positions in an agent's own frame, and the distance at which positions relative to a neighbor are
/// half of their limit.
const POSITION_M: f32 = 10.0;
/// Meters per unit of positions in the ego frame.
const EGO_POSITION_M: f32 = 50.0;
/// Meters per second per unit of velocity.
const SPEED_MPS: f32 = 10.0;

/// Features of the estimate that the network sees: B rows, A agents, N tokens, K neighbors, L lanes.
pub(super) struct Relations {
    /// (B, A, N, `OWN`).
    pub(super) own: Tensor,
    /// (B, A, N, K, `NEIGHBOR`).
    pub(super) neighbors: Tensor,
    /// 1 if there is a neighbor, (B, A, N, K).
    pub(super) neighbor_valid: Tensor,
    /// (B, A, N, L, `LANE`).
    pub(super) lanes: Tensor,
    /// 1 if there is a lane, (B, A, N, L).
    pub(super) lane_valid: Tensor,
}

/// The length of a token, and the numbers of its neighbors and lanes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Counts {
    /// Timesteps of a token.
    pub(super) patch: usize,
    /// Neighbors K of a token.
    pub(super) neighbors: usize,
    /// Lanes L of a token.
    pub(super) lanes: usize,
}

/// An agent at the end of a token, in the row's ego frame.
#[derive(Debug, Clone, Copy, Default)]
struct Pose {
    x: f32,
    y: f32,
    heading_rad: f32,
    cos: f32,
    sin: f32,
    vx: f32,
    vy: f32,
}

/// One row of the features, while it is written.
struct FeatureRow<'a> {
    own: &'a mut [f32],
    neighbors: &'a mut [f32],
    neighbor_valid: &'a mut [f32],
    lanes: &'a mut [f32],
    lane_valid: &'a mut [f32],
}

impl Relations {
    /// The surroundings of the agents of `batch` at decoded `poses` (B, A, T, 3), meters and radians in the ego frame
    /// of each row.
    pub(super) fn new(batch: &SceneBatch, poses: &Tensor, counts: Counts) -> Result<Self> {
        let Some(surroundings) = &batch.surroundings else {
            candle_core::bail!("the batch lacks the geometry that surrounds its agents; collate it with `Sight`");
        };
        let (b, a, t, _) = poses.dims4()?;
        let n = t.div_ceil(counts.patch);
        let host = |tensor: &Tensor| tensor.detach().to_dtype(DType::F32)?.flatten_all()?.to_vec1::<f32>();
        let (poses_host, valid) = (host(poses)?, host(&batch.valid)?);
        let (origin, rotation) = (host(&surroundings.origin)?, host(&batch.rotation)?);
        // Without any there is one entry that is not valid.
        let (k, l) = (counts.neighbors.max(1), counts.lanes.max(1));
        let mut own = vec![0.0f32; b * a * n * OWN];
        let mut neighbors = vec![0.0f32; b * a * n * k * NEIGHBOR];
        let mut neighbor_valid = vec![0.0f32; b * a * n * k];
        let mut lanes = vec![0.0f32; b * a * n * l * LANE];
        let mut lane_valid = vec![0.0f32; b * a * n * l];
        (own.par_chunks_mut(a * n * OWN), neighbors.par_chunks_mut(a * n * k * NEIGHBOR))
            .into_par_iter()
            .zip((neighbor_valid.par_chunks_mut(a * n * k), lanes.par_chunks_mut(a * n * l * LANE)))
            .zip(lane_valid.par_chunks_mut(a * n * l))
            .enumerate()
            .for_each(|(i, (((own, neighbors), (neighbor_valid, lanes)), lane_valid))| {
                let poses = token_poses(
                    &poses_host[i * a * t * 3..(i + 1) * a * t * 3],
                    &valid[i * a * t..(i + 1) * a * t],
                    [a, t, n, counts.patch],
                    surroundings.rows[i].dt_s,
                );
                let mut row = FeatureRow { own, neighbors, neighbor_valid, lanes, lane_valid };
                let own_frames = (&origin[i * a * 2..(i + 1) * a * 2], &rotation[i * a * 2..(i + 1) * a * 2]);
                row.write(&poses, &surroundings.rows[i], own_frames, [a, n], counts);
            });
        let device: &Device = poses.device();
        Ok(Self {
            own: Tensor::from_vec(own, (b, a, n, OWN), device)?,
            neighbors: Tensor::from_vec(neighbors, (b, a, n, k, NEIGHBOR), device)?,
            neighbor_valid: Tensor::from_vec(neighbor_valid, (b, a, n, k), device)?,
            lanes: Tensor::from_vec(lanes, (b, a, n, l, LANE), device)?,
            lane_valid: Tensor::from_vec(lane_valid, (b, a, n, l), device)?,
        })
    }
}

/// The pose of each agent at the last valid timestep of each token, with its mean velocity since the token before,
/// (A, N).
fn token_poses(poses: &[f32], valid: &[f32], [a, t, n, patch]: [usize; 4], dt_s: f32) -> Vec<Option<Pose>> {
    let mut found = vec![None; a * n];
    for agent in 0..a {
        let at = |timestep: usize| &poses[(agent * t + timestep) * 3..(agent * t + timestep) * 3 + 3];
        let is_valid = |timestep: &usize| valid[agent * t + timestep] != 0.0;
        let mut before: Option<usize> = None;
        for token in 0..n {
            let (first, end) = (token * patch, ((token + 1) * patch).min(t));
            let Some(last) = (first..end).rev().find(is_valid) else { continue };
            // Without a token before it, motion within the token has to do.
            let since = before.or_else(|| (first..last).find(is_valid));
            let pose = at(last);
            let mut this = Pose { x: pose[0], y: pose[1], heading_rad: pose[2], ..Pose::default() };
            (this.sin, this.cos) = this.heading_rad.sin_cos();
            if let Some(since) = since {
                let elapsed_s = (last - since) as f32 * dt_s;
                (this.vx, this.vy) = ((pose[0] - at(since)[0]) / elapsed_s, (pose[1] - at(since)[1]) / elapsed_s);
            }
            found[agent * n + token] = Some(this);
            before = Some(last);
        }
    }
    found
}

impl FeatureRow<'_> {
    fn write(
        &mut self,
        poses: &[Option<Pose>],
        row: &RowSurroundings,
        (origin, rotation): (&[f32], &[f32]),
        [a, n]: [usize; 2],
        counts: Counts,
    ) {
        let (k, l) = (counts.neighbors.max(1), counts.lanes.max(1));
        let mut ranked: Vec<(f32, usize)> = Vec::with_capacity(a);
        // Agents beyond those of the row are padding.
        for agent in 0..a.min(row.agents.len()) {
            for token in 0..n {
                let at = agent * n + token;
                let Some(pose) = &poses[at] else { continue };
                let frame = [origin[agent * 2], origin[agent * 2 + 1], rotation[agent * 2], rotation[agent * 2 + 1]];
                self.own[at * OWN..(at + 1) * OWN].copy_from_slice(&own_features(pose, frame));

                ranked.clear();
                for other in (0..row.agents.len()).filter(|other| *other != agent) {
                    if let Some(them) = &poses[other * n + token] {
                        ranked.push((gap_m(pose, &row.agents[agent], them, &row.agents[other]), other));
                    }
                }
                ranked.sort_by(|x, y| x.0.total_cmp(&y.0).then(x.1.cmp(&y.1)));
                for (i, (gap, other)) in ranked.iter().take(counts.neighbors).enumerate() {
                    let Some(them) = &poses[other * n + token] else { continue };
                    let features = neighbor_features(pose, them, &row.agents[*other], *gap);
                    let to = at * k + i;
                    self.neighbors[to * NEIGHBOR..(to + 1) * NEIGHBOR].copy_from_slice(&features);
                    self.neighbor_valid[to] = 1.0;
                }

                for (i, features) in nearest_lanes(pose, row, agent, counts.lanes).into_iter().enumerate() {
                    let to = at * l + i;
                    self.lanes[to * LANE..(to + 1) * LANE].copy_from_slice(&features);
                    self.lane_valid[to] = 1.0;
                }
            }
        }
    }
}

/// Pose in the agent's own frame and in the ego frame, velocity along and across its heading.
fn own_features(pose: &Pose, [x0, y0, cos0, sin0]: [f32; 4]) -> [f32; OWN] {
    let (dx, dy) = (pose.x - x0, pose.y - y0);
    [
        (dx * cos0 + dy * sin0) / POSITION_M,
        (dy * cos0 - dx * sin0) / POSITION_M,
        pose.cos * cos0 + pose.sin * sin0,
        pose.sin * cos0 - pose.cos * sin0,
        pose.x / EGO_POSITION_M,
        pose.y / EGO_POSITION_M,
        pose.cos,
        pose.sin,
        (pose.vx * pose.cos + pose.vy * pose.sin) / SPEED_MPS,
        (pose.vy * pose.cos - pose.vx * pose.sin) / SPEED_MPS,
    ]
}

/// Distance of two boxes along the axis on which they are farthest apart, negative if they overlap (separating axes).
fn gap_m(a: &Pose, of_a: &AgentSurroundings, b: &Pose, of_b: &AgentSurroundings) -> f32 {
    let (dx, dy) = (b.x - a.x, b.y - a.y);
    let (cos, sin) = ((a.cos * b.cos + a.sin * b.sin).abs(), (a.cos * b.sin - a.sin * b.cos).abs());
    let ([la, wa], [lb, wb]) = (of_a.half_size_m, of_b.half_size_m);
    let along_a = (dx * a.cos + dy * a.sin).abs() - la - (lb * cos + wb * sin);
    let across_a = (dy * a.cos - dx * a.sin).abs() - wa - (lb * sin + wb * cos);
    let along_b = (dx * b.cos + dy * b.sin).abs() - lb - (la * cos + wa * sin);
    let across_b = (dy * b.cos - dx * b.sin).abs() - wb - (la * sin + wa * cos);
    along_a.max(across_a).max(along_b).max(across_b)
}

/// A neighbor in the estimated frame of the agent.
fn neighbor_features(pose: &Pose, them: &Pose, of_them: &AgentSurroundings, gap: f32) -> [f32; NEIGHBOR] {
    let turned = |x: f32, y: f32| (x * pose.cos + y * pose.sin, y * pose.cos - x * pose.sin);
    let (dx, dy) = turned(them.x - pose.x, them.y - pose.y);
    let (vx, vy) = turned(them.vx - pose.vx, them.vy - pose.vy);
    let distance = (dx * dx + dy * dy).sqrt();
    let closing = -(dx * vx + dy * vy) / distance.max(0.1);
    let shrunk = 1.0 / (POSITION_M + distance);
    [
        dx * shrunk,
        dy * shrunk,
        (dx / 4.0).tanh(),
        (dy / 4.0).tanh(),
        them.cos * pose.cos + them.sin * pose.sin,
        them.sin * pose.cos - them.cos * pose.sin,
        vx / SPEED_MPS,
        vy / SPEED_MPS,
        (gap / 2.0).tanh(),
        (gap / 10.0).tanh(),
        (-gap.max(-1.0)).exp(),
        closing / SPEED_MPS,
        (closing / gap.max(0.5)).tanh(),
        of_them.half_size_m[0] / 3.0,
        of_them.half_size_m[1] / 1.5,
        f32::from(u8::from(of_them.is_vulnerable)),
        (pose.vx * pose.vx + pose.vy * pose.vy).sqrt() / SPEED_MPS,
    ]
}

/// Agents for tests.
#[cfg(test)]
mod testing {
    use super::Pose;
    use crate::tensor::AgentSurroundings;

    pub(super) fn car() -> AgentSurroundings {
        AgentSurroundings { half_size_m: [2.0, 1.0], is_vulnerable: false, lanes: Vec::new() }
    }

    pub(super) fn pose(x: f32, y: f32, heading_rad: f32) -> Pose {
        let (sin, cos) = heading_rad.sin_cos();
        Pose { x, y, heading_rad, cos, sin, vx: 0.0, vy: 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::testing::{car, pose};
    use super::*;

    #[test]
    fn gaps_are_those_of_the_boxes() {
        let quarter = std::f32::consts::FRAC_PI_2;
        for (other, expected) in [
            (pose(10.0, 0.0, 0.0), 6.0),
            (pose(0.0, 5.0, 0.0), 3.0),
            (pose(10.0, 0.0, quarter), 7.0),
            (pose(3.0, 0.5, 0.0), -1.0),
            (pose(10.0, 6.0, std::f32::consts::PI), 6.0),
        ] {
            let there = gap_m(&pose(0.0, 0.0, 0.0), &car(), &other, &car());
            let back = gap_m(&other, &car(), &pose(0.0, 0.0, 0.0), &car());
            assert!((there - expected).abs() < 1e-5 && (back - expected).abs() < 1e-5, "{there} {back} {expected}");
        }
    }

    #[test]
    fn velocities_are_those_since_the_token_before() {
        // One agent at 10 m/s along x, with a gap; tokens of two timesteps.
        let poses: Vec<f32> = (0..6).flat_map(|t| [t as f32, 0.0, 0.0]).collect();
        let found = token_poses(&poses, &[1.0, 1.0, 1.0, 0.0, 0.0, 0.0], [1, 6, 3, 2], 0.1);
        let [Some(first), Some(second), None] = found[..] else { panic!("{found:?}") };
        assert!((first.x, second.x) == (1.0, 2.0) && (first.vx - 10.0).abs() < 1e-4 && (second.vx - 10.0).abs() < 1e-4);
    }
}
