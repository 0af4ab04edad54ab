//! The one agent of each row that an objective is about, and how far it is from a line.

use super::motion::norm;
use super::pairs::Agents;
use super::{AgentSelector, SceneContext, Side};
use crate::geometry::{Polyline, Vec2};
use crate::guidance::lane_ways::WayPose;
use candle_core::{D, DType, Result, Tensor};

/// The parameter that says to which side one goes, as events report it: +1 left, -1 right.
pub(super) const SIDE: &str = "side";

/// One agent a row.
pub(super) struct OneAgent {
    /// Its states, (B, T, 3).
    states: Tensor,
    /// 1 where they are generated and valid, (B, T).
    pub(super) counts: Tensor,
    /// The same on the host.
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

    /// Where it is at a timestep.
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

    /// Its speed at present, m/s: that of the last two states up to then. `None` if it is not seen at present.
    pub(super) fn present_speed_mps(&self, row: usize, dt_s: f64) -> Option<f64> {
        let is_seen = |timestep: usize| self.is_valid[row * self.n_timesteps + timestep] > 0.0;
        let before = self.present.checked_sub(1).filter(|before| is_seen(*before) && is_seen(self.present));
        match before {
            Some(before) => Some(self.position(row, before).distance(self.position(row, self.present)) / dt_s),
            None => is_seen(self.present).then_some(0.0),
        }
    }

    /// The time that is generated, seconds.
    pub(super) fn future_s(&self, dt_s: f64) -> f64 {
        (self.n_timesteps - 1 - self.present) as f64 * dt_s
    }

    /// 1 at the last timestep of each row whose state is generated and valid, row by row, B · T numbers.
    pub(super) fn last_counted(&self) -> Result<Tensor> {
        let n = self.n_timesteps;
        let counts = self.counts.detach().to_dtype(DType::F64)?.to_vec2::<f64>()?;
        let last = |own: &Vec<f64>| own.iter().rposition(|counts| *counts > 0.0);
        let rows = counts.iter().map(last);
        let values: Vec<f64> =
            rows.flat_map(|last| (0..n).map(move |t| f64::from(u8::from(Some(t) == last)))).collect();
        Tensor::from_vec(values, (counts.len(), n), self.counts.device())?.to_dtype(self.counts.dtype())
    }

    /// The mean speed of each row where its line is between two stations, (B, 1), m/s, and 1 for rows that have one, (B).
    pub(super) fn mean_speed(
        &self,
        frame: &LineFrame,
        between_m: &[Option<[f64; 2]>],
        dt_s: f64,
    ) -> Result<(Tensor, Tensor)> {
        let n = self.n_timesteps;
        let stations = frame.station_m.detach().to_dtype(DType::F64)?.to_vec2::<f64>()?;
        let is_valid = |row: usize, timestep: usize| self.is_valid[row * n + timestep] > 0.0;
        let mut is_in = vec![0.0; between_m.len() * (n - 1)];
        for (row, bend) in between_m.iter().enumerate() {
            let Some([begin_m, end_m]) = *bend else { continue };
            for t in 1..n {
                let is_inside = (begin_m..=end_m).contains(&stations[row][t]);
                let is_driven = is_inside && is_valid(row, t) && is_valid(row, t - 1);
                is_in[row * (n - 1) + t - 1] = f64::from(u8::from(is_driven));
            }
        }
        let is_in = Tensor::from_vec(is_in, (between_m.len(), n - 1), self.states.device())?;
        let is_in = (is_in.to_dtype(self.states.dtype())? * self.counts.narrow(1, 1, n - 1)?)?;
        let at = self.states.narrow(D::Minus1, 0, 2)?;
        let speed_mps = norm(&((at.narrow(1, 1, n - 1)? - at.narrow(1, 0, n - 1)?)? * (1.0 / dt_s))?)?;
        let n_in = is_in.sum_keepdim(1)?;
        let mean_mps = ((speed_mps * is_in)?.sum_keepdim(1)? / (&n_in + 1e-6)?)?;
        Ok((mean_mps, n_in.squeeze(1)?.minimum(1.0)?))
    }

    /// The first and the last timestep at which it has a state.
    fn span(&self, row: usize) -> Option<(usize, usize)> {
        let own = &self.is_valid[row * self.n_timesteps..(row + 1) * self.n_timesteps];
        own.iter().position(|valid| *valid > 0.0).zip(own.iter().rposition(|valid| *valid > 0.0))
    }

    /// The center line of a lane beside the agent's own on the `configured` side, or on that of the target, or on
    /// either: the one that the agent is nearest to when it was last seen.
    pub(super) fn line_beside(&self, context: &SceneContext, row: usize, configured: Option<Side>) -> Option<Polyline> {
        let sides = match (configured, context.targets[row].get(SIDE)) {
            (Some(side), _) => vec![side.sign()],
            (None, Some([least, most])) => vec![(least + most).signum()],
            (None, None) => vec![1.0, -1.0],
        };
        let lines = sides.into_iter().flat_map(|side| context.ways[row].beside(self.pose(row), side));
        self.nearest(row, lines)
    }

    /// The center line of an oncoming lane beside the agent's own, in the agent's direction: the one that the agent is
    /// nearest to when it was last seen.
    pub(super) fn oncoming_line(&self, context: &SceneContext, row: usize) -> Option<Polyline> {
        self.nearest(row, context.ways[row].oncoming(self.pose(row)).into_iter())
    }

    fn nearest(&self, row: usize, lines: impl Iterator<Item = Polyline>) -> Option<Polyline> {
        let end = self.position(row, self.span(row)?.1);
        let aside_m = |line: &Polyline| line.project(end).map_or(f64::INFINITY, |place| place.offset_m.abs());
        lines.min_by(|a, b| aside_m(a).total_cmp(&aside_m(b)))
    }

    /// The agents across one line a row; where there is none, they are 0 beside it. The nearest point of a line is found on the host and held:
    /// by the envelope theorem the gradients are those of the offset.
    pub(super) fn across(&self, lines: &[Option<Polyline>]) -> Result<LineFrame> {
        let n_rows = lines.len();
        let list = || Vec::with_capacity(n_rows * self.n_timesteps);
        let (mut x, mut y, mut cos, mut sin, mut station_m) = (list(), list(), list(), list(), list());
        for (row, line) in lines.iter().enumerate() {
            for timestep in 0..self.n_timesteps {
                let place = self.position(row, timestep);
                let near = line.as_ref().and_then(|line| line.project(place));
                let (point, along, at_m) = near.map_or((place, Vec2::ZERO, 0.0), |near| {
                    (near.point, Vec2::from_angle(near.heading_rad), near.station_m)
                });
                station_m.push(at_m);
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
        let station_m = (((&dx * &cos)? + (&dy * &sin)?)? + constant(station_m)?)?;
        let has_line: Vec<f64> = lines.iter().map(|line| f64::from(u8::from(line.is_some()))).collect();
        let has_line = Tensor::from_vec(has_line, n_rows, states.device())?.to_dtype(states.dtype())?;
        Ok(LineFrame { across_m, station_m, has_line })
    }
}

/// Where agents are relative to one line a row.
pub(super) struct LineFrame {
    /// Way to the left of it, (B, T), meters.
    pub(super) across_m: Tensor,
    /// Way along it, (B, T), meters.
    pub(super) station_m: Tensor,
    /// 1 for rows with a line, (B).
    pub(super) has_line: Tensor,
}
