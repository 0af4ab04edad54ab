//! The one agent of each row for an objective, and its distance from a line.

use super::pairs::Agents;
use super::{AgentSelector, SceneContext, Side};
use crate::geometry::{Polyline, Vec2};
use crate::guidance::lane_ways::WayPose;
use candle_core::{D, DType, Result, Tensor};

/// The parameter for the side to which an agent goes, as events report it: +1 left, -1 right.
pub(super) const SIDE: &str = "side";

/// One agent per row.
pub(super) struct OneAgent {
    /// Its states, (B, T, 3).
    states: Tensor,
    /// 1 if they are generated and valid, (B, T).
    pub(super) counts: Tensor,
    /// The states on the host.
    at: Vec<f64>,
    is_valid: Vec<f64>,
    n_timesteps: usize,
    present: usize,
}

impl OneAgent {
    /// The agents that `selector` names.
    pub(super) fn gather(states: &Tensor, context: &SceneContext, selector: &AgentSelector) -> Result<Self> {
        let Agents { states, valid, latent, .. } = Agents::named(states, context, selector)?;
        let n_timesteps = valid.dim(1)?;
        let host = |tensor: &Tensor| tensor.detach().to_dtype(DType::F64)?.flatten_all()?.to_vec1::<f64>();
        let counts = (&valid * latent)?;
        let (at, is_valid) = (host(&states)?, host(&valid)?);
        Ok(Self { states, counts, at, is_valid, n_timesteps, present: context.n_history.saturating_sub(1) })
    }

    fn position(&self, row: usize, timestep: usize) -> Vec2 {
        let at = 3 * (row * self.n_timesteps + timestep);
        Vec2::new(self.at[at], self.at[at + 1])
    }

    /// Its pose at present.
    pub(super) fn pose(&self, row: usize) -> WayPose {
        let heading_rad = self.at[3 * (row * self.n_timesteps + self.present) + 2];
        WayPose { position: self.position(row, self.present), heading_rad }
    }

    /// The center line of a lane beside the agent's own on the `configured` side, or on that of the target, or on
    /// either: the line nearest to the agent's last observed place.
    pub(super) fn line_beside(&self, context: &SceneContext, row: usize, configured: Option<Side>) -> Option<Polyline> {
        let sides = match (configured, context.targets[row].get(SIDE)) {
            (Some(side), _) => vec![side.sign()],
            (None, Some([least, most])) => vec![(least + most).signum()],
            (None, None) => vec![1.0, -1.0],
        };
        let lines = sides.into_iter().flat_map(|side| context.ways[row].beside(self.pose(row), side));
        let own = &self.is_valid[row * self.n_timesteps..(row + 1) * self.n_timesteps];
        let end = self.position(row, own.iter().rposition(|valid| *valid > 0.0)?);
        let aside_m = |line: &Polyline| line.project(end).map_or(f64::INFINITY, |place| place.offset_m.abs());
        lines.min_by(|a, b| aside_m(a).total_cmp(&aside_m(b)))
    }

    /// The agents across one line per row; if there is none, their distance from it is 0. The nearest point of a line
    /// is found on the host and held: by the envelope theorem the gradients are those of the offset.
    pub(super) fn across(&self, lines: &[Option<Polyline>]) -> Result<LineFrame> {
        let n_rows = lines.len();
        let list = || Vec::with_capacity(n_rows * self.n_timesteps);
        let (mut x, mut y, mut cos, mut sin) = (list(), list(), list(), list());
        for (row, line) in lines.iter().enumerate() {
            for timestep in 0..self.n_timesteps {
                let place = self.position(row, timestep);
                let near = line.as_ref().and_then(|line| line.project(place));
                let (point, along) =
                    near.map_or((place, Vec2::ZERO), |near| (near.point, Vec2::from_angle(near.heading_rad)));
                x.push(point.x);
                y.push(point.y);
                cos.push(along.x);
                sin.push(along.y);
            }
        }
        let states = &self.states;
        let constant = |values: Vec<f64>| {
            Tensor::from_vec(values, (n_rows, self.n_timesteps), states.device())?.to_dtype(states.dtype())
        };
        let coordinate = |dim: usize| states.narrow(D::Minus1, dim, 1)?.squeeze(D::Minus1);
        let (dx, dy) = ((coordinate(0)? - constant(x)?)?, (coordinate(1)? - constant(y)?)?);
        let (cos, sin) = (constant(cos)?, constant(sin)?);
        let across_m = ((&dy * &cos)? - (&dx * &sin)?)?;
        let has_line: Vec<f64> = lines.iter().map(|line| f64::from(u8::from(line.is_some()))).collect();
        let has_line = Tensor::from_vec(has_line, n_rows, states.device())?.to_dtype(states.dtype())?;
        Ok(LineFrame { across_m, has_line })
    }
}

/// The places of agents relative to one line per row.
pub(super) struct LineFrame {
    /// Way to the left of it, (B, T), meters.
    pub(super) across_m: Tensor,
    /// 1 for rows with a line, (B).
    pub(super) has_line: Tensor,
}
