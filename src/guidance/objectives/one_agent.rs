//! The one agent of each row for an objective, and its distance from a line.

use super::pairs::Agents;
use super::{AgentSelector, SceneContext, Side};
use crate::geometry::{Polyline, Vec2};
use crate::guidance::lane_ways::WayPose;
use candle_core::{D, DType, Result, Tensor};
use std::ops::Range;

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

    /// Its position at a timestep.
    fn position(&self, row: usize, timestep: usize) -> Vec2 {
        let at = 3 * (row * self.n_timesteps + timestep);
        Vec2::new(self.at[at], self.at[at + 1])
    }

    /// Its pose at present.
    pub(super) fn pose(&self, row: usize) -> WayPose {
        let heading_rad = self.at[3 * (row * self.n_timesteps + self.present) + 2];
        WayPose { position: self.position(row, self.present), heading_rad }
    }

    /// The heading with which it is first seen, radians.
    pub(super) fn first_heading_rad(&self, row: usize) -> Option<f64> {
        let (first, _) = self.span(row)?;
        Some(self.at[3 * (row * self.n_timesteps + first) + 2])
    }

    /// Its speed at present, m/s: that of the last two states up to then. `None` if it has no state at present.
    pub(super) fn present_speed_mps(&self, row: usize, dt_s: f64) -> Option<f64> {
        let is_seen = |timestep: usize| self.is_valid[row * self.n_timesteps + timestep] > 0.0;
        let before = self.present.checked_sub(1).filter(|before| is_seen(*before) && is_seen(self.present));
        match before {
            Some(before) => Some(self.position(row, before).distance(self.position(row, self.present)) / dt_s),
            None => is_seen(self.present).then_some(0.0),
        }
    }

    /// The timesteps after the present.
    pub(super) fn future(&self) -> Range<usize> {
        self.present + 1..self.n_timesteps
    }

    /// The distances that it drives from one timestep to the next after the present, meters; 0 if it is absent.
    pub(super) fn steps_m(&self, row: usize) -> Vec<f64> {
        let is_there = |t: usize| self.is_valid[row * self.n_timesteps + t] > 0.0;
        let step_m = |t: usize| match is_there(t - 1) && is_there(t) {
            true => self.position(row, t - 1).distance(self.position(row, t)),
            false => 0.0,
        };
        self.future().map(step_m).collect()
    }

    /// Places (B, F, 2) and headings (B, F) at the timesteps after the present, and which of them count (B, F).
    pub(super) fn futures(&self) -> Result<(Tensor, Tensor, Tensor)> {
        let Range { start, end } = self.future();
        let states = self.states.narrow(1, start, end - start)?;
        let headings = states.narrow(D::Minus1, 2, 1)?.squeeze(D::Minus1)?;
        Ok((states.narrow(D::Minus1, 0, 2)?, headings, self.counts.narrow(1, start, end - start)?))
    }

    /// The first and the last timestep at which it has a state.
    fn span(&self, row: usize) -> Option<(usize, usize)> {
        let own = &self.is_valid[row * self.n_timesteps..(row + 1) * self.n_timesteps];
        own.iter().position(|valid| *valid > 0.0).zip(own.iter().rposition(|valid| *valid > 0.0))
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
        self.nearest(row, lines)
    }

    /// The center line of an oncoming lane beside the agent's own, in the agent's direction: the line nearest to the
    /// agent's last observed place.
    pub(super) fn oncoming_line(&self, context: &SceneContext, row: usize) -> Option<Polyline> {
        self.nearest(row, context.ways[row].oncoming(self.pose(row)).into_iter())
    }

    fn nearest(&self, row: usize, lines: impl Iterator<Item = Polyline>) -> Option<Polyline> {
        let end = self.position(row, self.span(row)?.1);
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
