//! The place of an agent relative to the path that another drives in the sample.

use super::pairs::Agents;
use super::{AgentSelector, SceneContext};
use crate::geometry::Vec2;
use candle_core::{D, DType, Result, Tensor};

/// The step below which a heading does not follow from a motion, meters.
const LEAST_STEP_M: f64 = 0.05;
/// Rounding of the distance beside a path at zero, meters.
const ROUNDING_M: f64 = 0.05;

/// An agent relative to the path of another, from its nearest pose, (B, T) each. The path is held: no gradient pulls at
/// it.
pub(super) struct PathFrame {
    /// Distance along the path from its owner at this timestep, less half of both lengths, meters.
    pub(super) gap_m: Tensor,
    /// Distance beside the path, to either side, rounded at zero, meters.
    pub(super) beside_m: Tensor,
    /// Half of both widths together, (B, 1), meters.
    pub(super) half_widths_m: Tensor,
    /// The agent's speed along the path, from the timestep before, m/s.
    pub(super) agent_mps: Tensor,
    /// The owner's speed, m/s.
    pub(super) owner_mps: Tensor,
    /// 1 if both have a state, and that of the agent is generated.
    pub(super) counts: Tensor,
}

impl PathFrame {
    /// The frame for the agent of each row that is named `agent`, relative to the path of the one named `owner`.
    pub(super) fn between(
        states: &Tensor,
        context: &SceneContext,
        owner: &AgentSelector,
        agent: &AgentSelector,
    ) -> Result<Self> {
        let [owners, agents] = [owner, agent].map(|selector| Agents::named(states, context, selector));
        let (owners, agents) = (owners?, agents?);
        let paths = Paths::new(&owners, &agents, context)?;
        let states = &agents.states;
        let (n_rows, n_timesteps, _) = states.dims3()?;
        let on_device = |values: Vec<f64>| {
            Tensor::from_vec(values, (n_rows, n_timesteps), states.device())?.to_dtype(states.dtype())
        };
        let coordinate = |dim: usize| states.narrow(D::Minus1, dim, 1)?.squeeze(D::Minus1);
        let (x, y) = (coordinate(0)?, coordinate(1)?);
        let (cos, sin) = (on_device(paths.cos)?, on_device(paths.sin)?);
        let along = |x: &Tensor, y: &Tensor| -> Result<Tensor> { (x * &cos)? + (y * &sin)? };
        let (dx, dy) = ((&x - on_device(paths.x)?)?, (&y - on_device(paths.y)?)?);
        let across_m = ((&dy * &cos)? - (&dx * &sin)?)?;
        let halves_m = ((&owners.extent_m + &agents.extent_m)? * 0.5)?;
        let along_m = (along(&dx, &dy)? + on_device(paths.station_m)?)?;
        Ok(Self {
            gap_m: along_m.broadcast_sub(&halves_m.narrow(1, 0, 1)?)?,
            half_widths_m: halves_m.narrow(1, 1, 1)?,
            beside_m: (across_m.sqr()? + ROUNDING_M * ROUNDING_M)?.sqrt()?,
            agent_mps: along(&backward_rate(&x, context.dt_s)?, &backward_rate(&y, context.dt_s)?)?,
            owner_mps: on_device(paths.speed_mps)?,
            counts: ((&agents.valid * on_device(paths.is_known)?)? * &agents.latent)?,
        })
    }
}

/// Differences to the timestep before, per second, (B, T); the first is that of the second.
fn backward_rate(x: &Tensor, dt_s: f64) -> Result<Tensor> {
    let n = x.dim(1)?.saturating_sub(1);
    let rate = ((x.narrow(1, 1, n)? - x.narrow(1, 0, n)?)? * (1.0 / dt_s))?;
    Tensor::cat(&[&rate.narrow(1, 0, 1)?, &rate], 1)
}

/// Values read off the paths, for each row and timestep: plain numbers without gradients.
struct Paths {
    /// Position of the pose of the path that is nearest to the other, meters.
    x: Vec<f64>,
    y: Vec<f64>,
    /// Direction of that pose.
    cos: Vec<f64>,
    sin: Vec<f64>,
    /// Distance along the path from its owner at this timestep to that pose, negative if it is behind, meters.
    station_m: Vec<f64>,
    /// The owner's speed, m/s.
    speed_mps: Vec<f64>,
    /// 1 if the owner has a state.
    is_known: Vec<f64>,
}

impl Paths {
    /// The paths of `owners`, as far as they have states, seen from `others`.
    fn new(owners: &Agents, others: &Agents, context: &SceneContext) -> Result<Self> {
        let (n_rows, n_timesteps, _) = owners.states.dims3()?;
        let host = |tensor: &Tensor| tensor.detach().to_dtype(DType::F64)?.flatten_all()?.to_vec1::<f64>();
        let (owners, others, is_known) = (host(&owners.states)?, host(&others.states)?, host(&owners.valid)?);
        let n = n_rows * n_timesteps;
        let zeros = || vec![0.0; n];
        let mut paths = Self {
            x: zeros(),
            y: zeros(),
            cos: zeros(),
            sin: zeros(),
            station_m: zeros(),
            speed_mps: zeros(),
            is_known,
        };
        let present = context.n_history.saturating_sub(1);
        for row in 0..n_rows {
            let first = row * n_timesteps;
            let known: Vec<usize> = (present..n_timesteps).filter(|t| paths.is_known[first + t] > 0.0).collect();
            let position = |t: usize| Vec2::new(owners[3 * (first + t)], owners[3 * (first + t) + 1]);
            let mut poses: Vec<Pose> = Vec::with_capacity(known.len());
            for &t in &known {
                let before = poses.last().copied();
                let step_m = before.map_or(0.0, |before| before.position.distance(position(t)));
                let mut heading_rad = owners[3 * (first + t) + 2];
                if let (false, Some(before)) = (context.generates_headings, before) {
                    let step = position(t) - before.position;
                    heading_rad = if step_m < LEAST_STEP_M { before.heading_rad } else { step.y.atan2(step.x) };
                }
                let station_m = before.map_or(0.0, |before| before.station_m + step_m);
                poses.push(Pose { position: position(t), heading_rad, station_m });
            }
            for (i, &t) in known.iter().enumerate() {
                let at = first + t;
                let place = Vec2::new(others[3 * at], others[3 * at + 1]);
                let nearest =
                    poses.iter().min_by(|a, b| a.position.distance(place).total_cmp(&b.position.distance(place)));
                let Some(nearest) = nearest else { continue };
                (paths.x[at], paths.y[at]) = (nearest.position.x, nearest.position.y);
                (paths.sin[at], paths.cos[at]) = nearest.heading_rad.sin_cos();
                paths.station_m[at] = nearest.station_m - poses[i].station_m;
                let (a, b) = if i == 0 { (0, 1.min(known.len() - 1)) } else { (i - 1, i) };
                let elapsed_s = (known[b] - known[a]).max(1) as f64 * context.dt_s;
                paths.speed_mps[at] = (poses[b].station_m - poses[a].station_m) / elapsed_s;
            }
        }
        Ok(paths)
    }
}

/// A pose of a path.
#[derive(Clone, Copy)]
struct Pose {
    position: Vec2,
    heading_rad: f64,
    /// Way driven since the present, meters.
    station_m: f64,
}
