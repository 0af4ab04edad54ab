//! The context of a batch for objectives, beside its states: roles, validity, sizes of agents, the road.

use super::AgentSelector;
use super::lane_ways::LaneWays;
use super::road_corridors::RoadCorridors;
use crate::scene::{Roles, Scene};
use crate::tensor::{RepeatedRows, SceneBatch};
use candle_core::{DType, Result, Tensor, bail};
use std::collections::BTreeMap;
use std::sync::Arc;

/// The target of an event: intervals (least, most) of its parameters, by name.
pub type Target = BTreeMap<String, [f64; 2]>;

/// The source of a row of a batch.
#[derive(Debug, Clone, Copy)]
pub struct ContextRow<'a> {
    /// Its scene.
    pub scene: &'a Scene,
    /// The track at the center of the row: the ego of its frame.
    pub ego_idx: usize,
    /// Roles and their tracks; every row of a batch has the same roles.
    pub roles: &'a Roles,
}

/// A batch as objectives see it: everything that does not change while a sample is denoised.
#[derive(Debug, Clone)]
pub struct SceneContext {
    /// Time between timesteps, seconds.
    pub dt_s: f64,
    /// Observed timesteps t_obs; the present is timestep `n_history` - 1.
    pub n_history: usize,
    /// Whether headings are generated. If not, they follow the motion once a sample is done, and decoded states hold
    /// those of the kinematic reference.
    pub generates_headings: bool,
    /// 1 if there is a state, observed or generated, (B, A, T).
    pub valid: Tensor,
    /// 1 if the state is generated, (B, A, T).
    pub latent: Tensor,
    /// Length and width of each agent, meters, (B, A, 2); 0 for padding.
    pub extent_m: Tensor,
    /// 1 for agents that drive on lanes, as far as known, (B, A).
    pub motorized: Tensor,
    /// The road of each row, in its ego frame.
    pub(super) roads: Vec<Arc<RoadCorridors>>,
    /// The lanes of each row, with the way into its ego frame.
    pub(super) ways: Vec<Arc<LaneWays>>,
    /// Place on the agent axis of the agent at the center of each row.
    pub(super) ego: Vec<usize>,
    /// Places on the agent axis, one a row, by role.
    pub(super) roles: BTreeMap<String, Vec<usize>>,
    /// The target of each row's event.
    pub(super) targets: Vec<Target>,
}

impl SceneContext {
    /// The context of `batch`, whose row b was made from `rows[b]`.
    ///
    /// # Errors
    /// When there is not one row each, or an agent with a role is not in the batch.
    pub fn new(batch: &SceneBatch, rows: &[ContextRow<'_>]) -> Result<Self> {
        let (n_rows, n_agents, _) = batch.latent.dims3()?;
        let Some(first) = rows.first().filter(|_| rows.len() == n_rows) else {
            bail!("{} rows of context given for a batch of {n_rows}", rows.len());
        };
        let mut extent_m = vec![0.0f32; n_rows * n_agents * 2];
        let mut motorized = vec![0.0f32; n_rows * n_agents];
        let mut context = Self {
            dt_s: first.scene.dt_s,
            n_history: first.scene.n_history,
            generates_headings: batch.x0.dim(3)? > 2,
            valid: batch.valid.clone(),
            latent: batch.latent.clone(),
            extent_m: batch.latent.clone(),
            motorized: batch.latent.clone(),
            roads: Vec::with_capacity(n_rows),
            ways: Vec::with_capacity(n_rows),
            ego: Vec::with_capacity(n_rows),
            roles: BTreeMap::new(),
            targets: vec![Target::new(); n_rows],
        };
        for (row, (ContextRow { scene, ego_idx, roles, .. }, frame)) in rows.iter().zip(&batch.frames).enumerate() {
            for (slot, track_idx) in frame.agents.iter().enumerate() {
                let (at, track) = (row * n_agents + slot, &scene.tracks[*track_idx]);
                let extent = track.extent_or_nominal();
                extent_m[at * 2..at * 2 + 2].copy_from_slice(&[extent.length_m as f32, extent.width_m as f32]);
                motorized[at] = f32::from(u8::from(track.class.is_motorized()));
            }
            let slot = |track_idx: Option<usize>| track_idx.and_then(|track_idx| frame.slot(track_idx));
            let Some(ego) = slot(Some(*ego_idx)) else { bail!("the ego agent of {} is not in its row", scene.id) };
            context.ego.push(ego);
            for (role, track) in roles.iter() {
                let Some(slot) = slot(scene.track_idx(track)) else {
                    bail!("track {track} of {}, the {role}, is not among the agents of its row", scene.id);
                };
                context.roles.entry(role.clone()).or_default().push(slot);
            }
            context.roads.push(Arc::new(RoadCorridors::new(&scene.lanes, &frame.ego_from_scene)));
            context.ways.push(Arc::new(LaneWays::new(&scene.lanes, &frame.ego_from_scene)));
        }
        if let Some((role, slots)) = context.roles.iter().find(|(_, slots)| slots.len() != n_rows) {
            bail!("{} of {n_rows} rows have the role {role}, expected all", slots.len());
        }
        let device = batch.latent.device();
        context.extent_m = Tensor::from_vec(extent_m, (n_rows, n_agents, 2), device)?;
        context.motorized = Tensor::from_vec(motorized, (n_rows, n_agents), device)?;
        Ok(context)
    }

    /// Every row `n` times in a row, as [`SceneBatch::repeated`] has them.
    pub fn repeated(&self, n: usize) -> Result<Self> {
        let rows = RepeatedRows::new(self.ego.len(), n, self.valid.device())?;
        let repeat = |tensor: &Tensor| rows.tensor(tensor);
        Ok(Self {
            valid: repeat(&self.valid)?,
            latent: repeat(&self.latent)?,
            extent_m: repeat(&self.extent_m)?,
            motorized: repeat(&self.motorized)?,
            roads: rows.items(&self.roads),
            ways: rows.items(&self.ways),
            ego: rows.items(&self.ego),
            roles: self.roles.iter().map(|(role, own)| (role.clone(), rows.items(own))).collect(),
            targets: rows.items(&self.targets),
            ..*self
        })
    }

    /// Removes the roads of rows at places for which `shows` is false: the map shows only parts of the road there, so
    /// departures from it cannot be judged.
    #[must_use]
    pub fn with_roads_where(mut self, shows: impl Fn(usize) -> bool) -> Self {
        self.roads.iter_mut().enumerate().filter(|(row, _)| !shows(*row)).for_each(|(_, road)| *road = Arc::default());
        self
    }

    /// Sets the target of the event of each row.
    ///
    /// # Errors
    /// If there is not one target for each row.
    pub fn aiming_at(self, targets: Vec<Target>) -> Result<Self> {
        if targets.len() != self.ego.len() {
            bail!("{} targets given for {} rows", targets.len(), self.ego.len());
        }
        Ok(Self { targets, ..self })
    }

    /// The target interval of the parameter `name` for each row, (B, 2); `any` for rows without one.
    pub(super) fn wanted(&self, name: &str, any: [f64; 2], like: &Tensor) -> Result<Tensor> {
        let of_row = |target: &Target| target.get(name).copied().unwrap_or(any);
        let intervals: Vec<f64> = self.targets.iter().flat_map(of_row).collect();
        Tensor::from_vec(intervals, (self.targets.len(), 2), like.device())?.to_dtype(like.dtype())
    }

    /// 1 for the agents that `selector` names, (B, A). Padding may be among them: it has no valid entry.
    ///
    /// # Errors
    /// When it names no agent.
    pub fn selected(&self, selector: &AgentSelector) -> Result<Tensor> {
        let (n_rows, n_agents) = self.motorized.dims2()?;
        if selector.name() == AgentSelector::ALL {
            return self.motorized.ones_like();
        }
        let slots = self.slots(selector)?;
        let mut selected = vec![0.0; n_rows * n_agents];
        slots.iter().enumerate().for_each(|(row, slot)| selected[row * n_agents + slot] = 1.0);
        Tensor::from_vec(selected, (n_rows, n_agents), self.motorized.device())?.to_dtype(self.motorized.dtype())
    }

    /// The place on the agent axis of the one agent that `selector` names, row by row.
    pub(super) fn slots(&self, selector: &AgentSelector) -> Result<&[usize]> {
        match (selector.name(), self.roles.get(selector.name())) {
            (_, Some(slots)) => Ok(slots),
            (AgentSelector::EGO, None) => Ok(&self.ego),
            (name, None) => bail!(
                "no agent has the role {name}; use ego, a role of the behavior, or, where several may be meant, all"
            ),
        }
    }

    /// 1 if a term over the states of `order` + 1 timesteps from t on counts, (B, A, T - `order`): all of them are
    /// valid, and at least one is generated.
    ///
    /// # Errors
    /// When there are fewer timesteps.
    pub fn terms(&self, order: usize) -> Result<Tensor> {
        let n_timesteps = self.valid.dim(2)?;
        let Some(n_terms) = n_timesteps.checked_sub(order).filter(|n| *n > 0) else {
            bail!("{n_timesteps} timesteps are too few for terms over {} of them", order + 1);
        };
        let mut all_valid = self.valid.narrow(2, 0, n_terms)?;
        let mut all_known = (1.0 - self.latent.narrow(2, 0, n_terms)?)?;
        for step in 1..=order {
            all_valid = (all_valid * self.valid.narrow(2, step, n_terms)?)?;
            all_known = (all_known * (1.0 - self.latent.narrow(2, step, n_terms)?)?)?;
        }
        all_valid * (1.0 - all_known)?
    }

    /// Converts its tensors to another type.
    pub fn to_dtype(&self, dtype: DType) -> Result<Self> {
        Ok(Self {
            valid: self.valid.to_dtype(dtype)?,
            latent: self.latent.to_dtype(dtype)?,
            extent_m: self.extent_m.to_dtype(dtype)?,
            motorized: self.motorized.to_dtype(dtype)?,
            ..self.clone()
        })
    }
}
