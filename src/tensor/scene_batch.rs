//! A batch of scenes as tensors, and the decoding of samples to scenes.

use super::{AgentFrame, FeatureLayout, RepeatedRows, RowSurroundings, SurroundingsLayout};
use crate::scene::Scene;
use candle_core::{D, Result, Tensor, bail};
use std::ops::Deref;
use std::sync::Arc;

/// Scenes as padded tensors: B scenes, A agents, T timesteps, L polylines, D dimensions of a diffused state.
///
/// An entry is *latent* when it is to be generated, *observed* when it is given, *valid* when it is either. Everything
/// else is padding, and zero. Diffused values x are related to meters and radians in the row's ego frame by `decode`:
/// base + rotation · (unit · path · x) on latent entries; observed entries are the base itself.
///
/// The tensors are those of [`SceneTensors`], read-only: their shapes, types and devices agree.
#[derive(Debug, Clone)]
pub struct SceneBatch(SceneTensors);

/// The tensors that a [`SceneBatch`] is made of.
#[derive(Debug, Clone)]
pub struct SceneTensors {
    /// Clean diffused states, (B, A, T, D): zero except on latent entries.
    pub x0: Tensor,
    /// Known states as inputs of the network, (B, A, T, D), in scene units: observed states; on latent entries zero
    /// (scene parametrization) or the kinematic reference (the others).
    pub context: Tensor,
    /// 1 if the state is given, (B, A, T).
    pub observed: Tensor,
    /// 1 if the state is to be generated, (B, A, T).
    pub latent: Tensor,
    /// 1 if the state is generated and was recorded, so that it counts in losses, (B, A, T).
    pub scored: Tensor,
    /// 1 if the state is observed or latent, (B, A, T).
    pub valid: Tensor,
    /// The observed motion of agents in units of x, (B, A, T, D), zero except on observed entries: the network sees it
    /// in place of x, in the motion parametrization.
    pub observed_motion: Option<Tensor>,
    /// Agent features c, (B, A, T, C).
    pub features: Tensor,
    /// Lane polylines in the ego frame, (B, L, F).
    pub lanes: Tensor,
    /// 1 if a polyline is not padding, (B, L).
    pub lane_valid: Tensor,
    /// Decoding: base (B, A, T, 3), meters and radians.
    pub base: Tensor,
    /// Decoding: cosine and sine of each agent's frame in the ego frame, (B, A, 2).
    pub rotation: Tensor,
    /// Decoding: meters and radians per unit of x, (B, A, 3).
    pub unit: Tensor,
    /// Decoding: the matrix of each agent by which residuals along time follow from x, (B, A, T, T), in the motion
    /// parametrization; in the others x is the residual itself.
    pub path: Option<Tensor>,
    /// The agents and the frame of each row.
    pub frames: Vec<Arc<AgentFrame>>,
    /// The surroundings of each agent, if the collator has `Sight`.
    pub surroundings: Option<Surroundings>,
}

/// The surroundings of the agents of a batch: B scenes, A agents, L pieces of lanes, T timesteps, D dimensions of a
/// diffused state.
#[derive(Debug, Clone)]
pub struct Surroundings {
    /// The origin of each agent's own frame, in the row's ego frame, (B, A, 2), meters. Its rotation is that of
    /// decoding.
    pub origin: Tensor,
    /// Attributes of agents, (B, A, `SurroundingsLayout::AGENT`).
    pub attributes: Tensor,
    /// Pieces of lanes in each agent's own frame, (B, A, L, `SurroundingsLayout::PIECE`).
    pub lanes: Tensor,
    /// 1 if a piece is not padding, (B, A, L).
    pub lane_valid: Tensor,
    /// Modes of each agent's motion, (B, A, D, T, T): orthonormal rows over the latent timesteps.
    pub modes: Tensor,
    /// Variance of x along each mode, (B, A, D, T); 0 in rows without a mode.
    pub variances: Tensor,
    /// The lanes as geometry, and sizes.
    pub rows: Vec<Arc<RowSurroundings>>,
}

impl Deref for SceneBatch {
    type Target = SceneTensors;

    fn deref(&self) -> &SceneTensors {
        &self.0
    }
}

impl SceneTensors {
    /// Checks every tensor against the B, A, T and D of `x0`.
    fn validate(&self) -> Result<()> {
        let (b, a, t, d) = self.x0.dims4()?;
        if !(2..=3).contains(&d) {
            bail!("scene batch: x0 has {d} values for each state; expected 2 (position) or 3 (position and heading)");
        }
        let n_lanes = self.lanes.dims3()?.1;
        let masks =
            [("observed", &self.observed), ("latent", &self.latent), ("scored", &self.scored), ("valid", &self.valid)];
        for (name, mask) in masks {
            self.check(name, mask, &[b, a, t])?;
        }
        self.check("context", &self.context, &[b, a, t, d])?;
        self.check("features", &self.features, &[b, a, t, FeatureLayout::AGENT])?;
        self.check("lanes", &self.lanes, &[b, n_lanes, FeatureLayout::LANE])?;
        self.check("lane_valid", &self.lane_valid, &[b, n_lanes])?;
        self.check("base", &self.base, &[b, a, t, 3])?;
        self.check("rotation", &self.rotation, &[b, a, 2])?;
        self.check("unit", &self.unit, &[b, a, 3])?;
        if let Some(motion) = &self.observed_motion {
            self.check("observed_motion", motion, &[b, a, t, d])?;
        }
        if let Some(path) = &self.path {
            self.check("path", path, &[b, a, t, t])?;
        }
        check_rows("frames", &self.frames, |frame| frame.agents.len(), [b, a])?;
        if let Some(around) = &self.surroundings {
            let n_pieces = around.lane_valid.dims3()?.2;
            self.check("surroundings.origin", &around.origin, &[b, a, 2])?;
            self.check("surroundings.attributes", &around.attributes, &[b, a, SurroundingsLayout::AGENT])?;
            self.check("surroundings.lanes", &around.lanes, &[b, a, n_pieces, SurroundingsLayout::PIECE])?;
            self.check("surroundings.lane_valid", &around.lane_valid, &[b, a, n_pieces])?;
            self.check("surroundings.modes", &around.modes, &[b, a, d, t, t])?;
            self.check("surroundings.variances", &around.variances, &[b, a, d, t])?;
            check_rows("surroundings.rows", &around.rows, |row| row.agents.len(), [b, a])?;
        }
        Ok(())
    }

    fn check(&self, name: &str, tensor: &Tensor, expected: &[usize]) -> Result<()> {
        if tensor.dims() != expected {
            bail!("scene batch: {name} has shape {:?}, expected {expected:?}", tensor.dims());
        }
        if tensor.dtype() != self.x0.dtype() {
            let (found, expected) = (tensor.dtype().as_str(), self.x0.dtype().as_str());
            bail!("scene batch: {name} holds {found}, expected {expected} as in x0");
        }
        if !tensor.device().same_device(self.x0.device()) {
            bail!("scene batch: {name} is on another device than x0");
        }
        Ok(())
    }
}

/// Checks the host data of each row: B items of at most A agents.
fn check_rows<T>(name: &str, items: &[Arc<T>], n_agents: impl Fn(&T) -> usize, [b, a]: [usize; 2]) -> Result<()> {
    if items.len() != b {
        bail!("scene batch: {name} has {} items, expected {b}, one for each row of x0", items.len());
    }
    match items.iter().map(|item| n_agents(item)).find(|n| *n > a) {
        Some(n) => bail!("scene batch: {name} has a row of {n} agents, expected at most {a} as in x0"),
        None => Ok(()),
    }
}

impl Surroundings {
    fn repeated(&self, rows: &RepeatedRows) -> Result<Self> {
        let repeat = |tensor: &Tensor| rows.tensor(tensor);
        Ok(Self {
            origin: repeat(&self.origin)?,
            attributes: repeat(&self.attributes)?,
            lanes: repeat(&self.lanes)?,
            lane_valid: repeat(&self.lane_valid)?,
            modes: repeat(&self.modes)?,
            variances: repeat(&self.variances)?,
            rows: rows.items(&self.rows),
        })
    }
}

impl SceneBatch {
    /// Makes a batch of tensors after checking them against each other. Values are not read, because they may be on a
    /// GPU.
    ///
    /// # Errors
    /// When the shape, type or device of a tensor does not fit `x0`; the message names the tensor.
    pub fn new(tensors: SceneTensors) -> Result<Self> {
        tensors.validate()?;
        Ok(Self(tensors))
    }

    /// Number of rows B.
    pub fn n_rows(&self) -> usize {
        self.frames.len()
    }

    /// Every row `n` times in a row, as [`RepeatedRows`] has them.
    pub fn repeated(&self, n: usize) -> Result<Self> {
        let rows = RepeatedRows::new(self.n_rows(), n, self.x0.device())?;
        let repeat = |tensor: &Tensor| rows.tensor(tensor);
        Ok(Self(SceneTensors {
            x0: repeat(&self.x0)?,
            context: repeat(&self.context)?,
            observed: repeat(&self.observed)?,
            latent: repeat(&self.latent)?,
            scored: repeat(&self.scored)?,
            valid: repeat(&self.valid)?,
            features: repeat(&self.features)?,
            lanes: repeat(&self.lanes)?,
            lane_valid: repeat(&self.lane_valid)?,
            base: repeat(&self.base)?,
            rotation: repeat(&self.rotation)?,
            unit: repeat(&self.unit)?,
            observed_motion: self.observed_motion.as_ref().map(repeat).transpose()?,
            path: self.path.as_ref().map(repeat).transpose()?,
            frames: rows.items(&self.frames),
            surroundings: self.surroundings.as_ref().map(|around| around.repeated(&rows)).transpose()?,
        }))
    }

    /// Positions and headings of diffused states `x` (B, A, T, D): (B, A, T, 3), meters and radians in each row's
    /// ego frame. Linear in `x`, and differentiable. Without a diffused heading (D = 2) the base heading is returned.
    ///
    /// # Errors
    /// Fails when `x` has another shape than `x0`.
    pub fn decode(&self, x: &Tensor) -> Result<Tensor> {
        self.decode_offsets(x)? + &self.base
    }

    /// The linear part of [`decode`](Self::decode), which is added to the base, (B, A, T, 3).
    ///
    /// # Errors
    /// Fails when `x` has another shape than `x0`.
    pub fn decode_offsets(&self, x: &Tensor) -> Result<Tensor> {
        let state_dim = x.dim(D::Minus1)?;
        let x = x.broadcast_mul(&self.latent.unsqueeze(3)?)?;
        let x = self.path.as_ref().map_or(Ok(x.clone()), |path| path.matmul(&x))?;
        let scaled = x.broadcast_mul(&self.unit.narrow(2, 0, state_dim)?.unsqueeze(2)?)?;
        let (along, across) = (scaled.narrow(3, 0, 1)?, scaled.narrow(3, 1, 1)?);
        let cos = self.rotation.narrow(2, 0, 1)?.unsqueeze(2)?;
        let sin = self.rotation.narrow(2, 1, 1)?.unsqueeze(2)?;
        let dx = (along.broadcast_mul(&cos)? - across.broadcast_mul(&sin)?)?;
        let dy = (along.broadcast_mul(&sin)? + across.broadcast_mul(&cos)?)?;
        let turn = if state_dim > 2 { scaled.narrow(3, 2, 1)? } else { dx.zeros_like()? };
        Tensor::cat(&[dx, dy, turn], 3)
    }

    /// `path` with rows of norm 1 (or 0), so that the sums of white x have unit variance; `None` without a path.
    pub fn unit_path(&self) -> Result<Option<Tensor>> {
        let unit = |path: &Tensor| path.broadcast_div(&path.sqr()?.sum_keepdim(D::Minus1)?.sqrt()?.maximum(1e-6)?);
        self.path.as_ref().map(unit).transpose()
    }

    /// The scenes of the samples `x` (B, A, T, D). `sources[b]` is the scene from which row b was made.
    ///
    /// Each has the tracks of its source in the same order: observed states as recorded, latent states decoded, with
    /// velocities from three positions in a row; agents that the batch left out keep their observed states only.
    /// Without a diffused heading, headings follow the motion.
    pub fn decode_scenes(&self, x: &Tensor, sources: &[&Scene]) -> Result<Vec<Scene>> {
        let with_heading = x.dim(D::Minus1)? > 2;
        let decoded = self.decode(x)?.to_dtype(candle_core::DType::F64)?;
        let latent = self.latent.to_dtype(candle_core::DType::U8)?;
        (0..self.n_rows())
            .map(|row| {
                let states = decoded.get(row)?.to_vec3::<f64>()?;
                let latent = latent.get(row)?.to_vec2::<u8>()?;
                Ok(self.frames[row].scene(sources[row], &states, &latent, with_heading))
            })
            .collect()
    }
}
