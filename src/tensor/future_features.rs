//! The inputs of a classifier of clean futures: two agents in the frame of the first, with their sizes and lanes.

use super::{RepeatedRows, SceneBatch};
use crate::behavior::observed_line;
use crate::geometry::{Polyline, Vec2};
use crate::scene::Scene;
use candle_core::{D, DType, Device, Result, Tensor, bail};
use std::sync::Arc;

/// Lengths beyond which a feature no longer grows in proportion, meters: of positions, of ways along a lane, of offsets from it.
const POSITION_M: f64 = 40.0;
const ALONG_M: f64 = 30.0;
const OFFSET_M: f64 = 5.0;
/// Units of speeds, accelerations, lengths and widths.
const SPEED_MPS: f64 = 10.0;
const ACCELERATION_MPS2: f64 = 5.0;
const SIZE_M: f64 = 5.0;
/// Accelerations are differences over this time, seconds: a clean estimate is rougher than a recording from timestep to timestep.
const ACCELERATION_S: f64 = 0.5;
/// A course is a direction only well above this speed, m/s.
const STANDING_MPS: f64 = 1.0;

/// A row's pair: its scene, and the tracks of the first and the second role; the same twice for behaviors of one agent.
#[derive(Debug, Clone, Copy)]
pub struct ScenePair<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// Indices of the tracks. The first is the agent at the center of the row.
    pub agents: (usize, usize),
}

/// What of a pair does not change while its future is sampled: who they are, how large, and which lanes they keep. Makes features of any
/// future of theirs, differentiable in its states.
///
/// The frame is the first agent's at present. Lanes are those that the past and the map predict, so that no recorded
/// future is among the features. The direction of an agent is that of its motion: a classifier that saw headings could be
/// satisfied by turning a vehicle on the spot, and not every denoiser generates them.
#[derive(Debug, Clone)]
pub struct FutureFeatures {
    /// Places of the two on the batch's agent axis, row by row.
    slots: Vec<[usize; 2]>,
    /// Center lines of the lanes that the two keep, in the row's frame.
    lines: Vec<Arc<[Polyline; 2]>>,
    /// 1 where there is a state, (B, 2, T).
    valid: Tensor,
    /// Length and width of the first, then of the second, (B, 4), in units of features.
    sizes: Tensor,
    present: usize,
    dt_s: f64,
}

/// Features of the moments of futures from the present on, M of them.
#[derive(Debug, Clone)]
pub struct Moments {
    /// (B, M, [`FutureFeatures::MOMENT`]).
    pub features: Tensor,
    /// 1 where both agents have a state, (B, M).
    pub valid: Tensor,
}

impl FutureFeatures {
    /// Features of an agent at a moment: position, velocity, course and acceleration.
    const AGENT: usize = 8;
    /// Features of a pair at a moment relative to a lane: offset of either, their difference, the way from the first to the second.
    const LANE: usize = 4;
    /// Features of a moment: both agents, both lanes, four sizes, and the share of the future that has passed.
    pub const MOMENT: usize = 2 * Self::AGENT + 2 * Self::LANE + 5;

    /// The pairs of `batch`, one a row.
    ///
    /// # Errors
    /// When there is not one pair a row, an agent is not in its row or not tracked at present, or the first agent is not at its
    /// center.
    pub fn new(batch: &SceneBatch, pairs: &[ScenePair<'_>]) -> Result<Self> {
        let Some(first) = pairs.first().filter(|_| pairs.len() == batch.n_rows()) else {
            bail!("{} pairs given for a batch of {}", pairs.len(), batch.n_rows());
        };
        let (mut slots, mut lines, mut sizes) = (Vec::new(), Vec::new(), Vec::new());
        for (ScenePair { scene, agents }, frame) in pairs.iter().zip(&batch.frames) {
            let Some(own) = frame.slot(agents.0).zip(frame.slot(agents.1)) else {
                bail!("agents {agents:?} of {} are not among the agents of their row", scene.id);
            };
            if frame.ego_slot() != Some(own.0) {
                bail!("the first agent of the pair is not at the center of its row, {}", scene.id);
            }
            let line = |agent_idx: usize| -> Option<Polyline> {
                let line = observed_line(scene, agent_idx)?;
                Some(Polyline(line.0.iter().map(|point| frame.ego_from_scene.point(*point)).collect()))
            };
            let Some(kept) = line(agents.0).zip(line(agents.1)) else {
                bail!("agents {agents:?} of {} are not both tracked at present", scene.id);
            };
            slots.push([own.0, own.1]);
            lines.push(Arc::new([kept.0, kept.1]));
            for agent_idx in [agents.0, agents.1] {
                let extent = scene.tracks[agent_idx].extent_or_nominal();
                sizes.extend([extent.length_m / SIZE_M, extent.width_m / SIZE_M].map(|size| size as f32));
            }
        }
        let sizes = Tensor::from_vec(sizes, (pairs.len(), 4), batch.x0.device())?;
        let valid = of_pairs(&batch.valid.unsqueeze(3)?, &slots)?.squeeze(3)?;
        let present = first.scene.current_timestep();
        Ok(Self { slots, lines, valid, sizes, present, dt_s: first.scene.dt_s })
    }

    /// Every pair `n` times in a row, as [`SceneBatch::repeated`] has them.
    ///
    /// # Errors
    /// When the device runs out of memory.
    pub fn repeated(&self, n: usize) -> Result<Self> {
        let rows = RepeatedRows::new(self.slots.len(), n, self.valid.device())?;
        Ok(Self {
            slots: rows.items(&self.slots),
            lines: rows.items(&self.lines),
            valid: rows.tensor(&self.valid)?,
            sizes: rows.tensor(&self.sizes)?,
            ..*self
        })
    }

    /// The features of decoded states (B, A, T, 3), of which only those of the pairs are read.
    ///
    /// # Errors
    /// When shapes do not agree with the batch that the pairs are of.
    pub fn moments(&self, states: &Tensor) -> Result<Moments> {
        let (valid, dtype) = (self.valid.to_dtype(states.dtype())?, states.dtype());
        // (B, 2, T, 2) each.
        let position = of_pairs(&states.narrow(D::Minus1, 0, 2)?, &self.slots)?;
        let (velocity, moves) = rate(&position, &valid, 1, self.dt_s)?;
        let lag = ((ACCELERATION_S / self.dt_s).round() as usize).max(1);
        let (acceleration, _) = rate(&velocity, &moves, lag, self.dt_s)?;
        let speed = (velocity.sqr()?.sum_keepdim(D::Minus1)? + STANDING_MPS * STANDING_MPS)?.sqrt()?;
        let agents = [
            within(&position, POSITION_M)?,
            (&velocity / SPEED_MPS)?,
            velocity.broadcast_div(&speed)?,
            (acceleration / ACCELERATION_MPS2)?,
        ];
        let agents = Tensor::cat(&agents, D::Minus1)?.broadcast_mul(&valid.unsqueeze(3)?)?;
        let lanes = self.lane_features(&position)?;
        let both = (valid.narrow(1, 0, 1)? * valid.narrow(1, 1, 1)?)?.squeeze(1)?;

        let n_moments = position.dim(2)? - self.present;
        let (n_rows, passed) = (self.slots.len(), share_passed(n_moments, dtype, states.device())?);
        let future = |x: &Tensor, dim: usize| x.narrow(dim, self.present, n_moments);
        let own = |agent: usize| future(&agents, 2)?.narrow(1, agent, 1)?.squeeze(1);
        let sizes = self.sizes.to_dtype(dtype)?.unsqueeze(1)?.broadcast_as((n_rows, n_moments, 4))?;
        let passed = passed.broadcast_as((n_rows, n_moments, 1))?;
        let features =
            Tensor::cat(&[own(0)?, own(1)?, future(&lanes, 1)?, sizes.contiguous()?, passed.contiguous()?], 2)?;
        let valid = future(&both, 1)?.contiguous()?;
        Ok(Moments { features: features.broadcast_mul(&valid.unsqueeze(2)?)?, valid })
    }

    /// Offsets and ways along both lanes of positions (B, 2, T, 2): (B, T, 2 [`Self::LANE`]).
    fn lane_features(&self, position: &Tensor) -> Result<Tensor> {
        let mut features = Vec::new();
        for line in 0..2 {
            let (along_m, offset_m) = self.in_lane(position, line)?;
            let of = |x: &Tensor, agent: usize| x.narrow(1, agent, 1)?.squeeze(1);
            let (first_m, second_m) = (of(&offset_m, 0)?, of(&offset_m, 1)?);
            let ahead_m = (of(&along_m, 1)? - of(&along_m, 0)?)?;
            let beside_m = (&second_m - &first_m)?;
            for (x, length) in [(first_m, OFFSET_M), (second_m, OFFSET_M), (beside_m, OFFSET_M), (ahead_m, ALONG_M)] {
                features.push(within(&x, length)?.unsqueeze(2)?);
            }
        }
        Tensor::cat(&features, 2)
    }

    /// Ways along line 0 or 1 of each row, and offsets to its left, of positions (B, 2, T, 2): (B, 2, T) each, meters. The nearest place of the
    /// line is looked up outside of the gradient; from there both are linear in the position.
    fn in_lane(&self, position: &Tensor, line: usize) -> Result<(Tensor, Tensor)> {
        let (n_rows, _, n_timesteps, _) = position.dims4()?;
        let points = position.detach().to_dtype(DType::F64)?.reshape((n_rows, 2 * n_timesteps, 2))?.to_vec3::<f64>()?;
        let n = n_rows * 2 * n_timesteps;
        let mut columns: [Vec<f64>; 5] = std::array::from_fn(|_| Vec::with_capacity(n));
        for (row, lines) in points.iter().zip(&self.lines) {
            for point in row {
                let place = lines[line].project(Vec2::new(point[0], point[1]));
                let values = place.map_or([0.0; 5], |place| {
                    let (sin, cos) = place.heading_rad.sin_cos();
                    [place.point.x, place.point.y, cos, sin, place.station_m]
                });
                columns.iter_mut().zip(values).for_each(|(column, value)| column.push(value));
            }
        }
        let on_device = |column: Vec<f64>| {
            Tensor::from_vec(column, (n_rows, 2, n_timesteps), position.device())?.to_dtype(position.dtype())
        };
        let [x, y, cos, sin, station_m] = columns;
        let (cos, sin) = (on_device(cos)?, on_device(sin)?);
        let coordinate = |dim: usize| position.narrow(3, dim, 1)?.squeeze(3);
        let (dx, dy) = ((coordinate(0)? - on_device(x)?)?, (coordinate(1)? - on_device(y)?)?);
        let along_m = (((&dx * &cos)? + (&dy * &sin)?)? + on_device(station_m)?)?;
        let offset_m = ((dy * &cos)? - (dx * &sin)?)?;
        Ok((along_m, offset_m))
    }
}

/// The entries of the pairs at `slots` among those of all agents, (B, A, T, D) to (B, 2, T, D).
fn of_pairs(x: &Tensor, slots: &[[usize; 2]]) -> Result<Tensor> {
    let (n_rows, n_agents, n_timesteps, dim) = x.dims4()?;
    let flat = |(row, own): (usize, &[usize; 2])| own.map(|slot| (row * n_agents + slot) as u32);
    let rows: Vec<u32> = slots.iter().enumerate().flat_map(flat).collect();
    let rows = Tensor::from_vec(rows, slots.len() * 2, x.device())?;
    x.reshape((n_rows * n_agents, n_timesteps, dim))?.index_select(&rows, 0)?.reshape((n_rows, 2, n_timesteps, dim))
}

/// Backward differences of `x` (B, 2, T, D) over `lag` timesteps, per second, and where they exist, (B, 2, T): 0 where one of the two
/// values is missing.
fn rate(x: &Tensor, valid: &Tensor, lag: usize, dt_s: f64) -> Result<(Tensor, Tensor)> {
    let n = x.dim(2)?.saturating_sub(lag);
    let padding = |x: &Tensor| x.narrow(2, 0, x.dim(2)? - n)?.zeros_like();
    let both = (valid.narrow(2, valid.dim(2)? - n, n)? * valid.narrow(2, 0, n)?)?;
    let both = Tensor::cat(&[padding(valid)?, both], 2)?;
    let difference = ((x.narrow(2, x.dim(2)? - n, n)? - x.narrow(2, 0, n)?)? / (lag as f64 * dt_s))?;
    let rate = Tensor::cat(&[padding(x)?, difference], 2)?.broadcast_mul(&both.unsqueeze(3)?)?;
    Ok((rate, both))
}

/// x / length for small x, and never beyond 1: x / √(length² + x²), whose gradient fades but does not end.
fn within(x: &Tensor, length: f64) -> Result<Tensor> {
    x / (x.sqr()? + length * length)?.sqrt()?
}

/// The share of the future that has passed at each of its moments, (1, M, 1).
fn share_passed(n_moments: usize, dtype: DType, device: &Device) -> Result<Tensor> {
    let shares: Vec<f64> = (0..n_moments).map(|i| i as f64 / (n_moments.max(2) - 1) as f64).collect();
    Tensor::from_vec(shares, (1, n_moments, 1), device)?.to_dtype(dtype)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::testing::{Drive, scene};
    use crate::tensor::testing::collator;
    use crate::tensor::{FutureValidity, StateParametrization};

    fn batch(scene: &Scene) -> SceneBatch {
        collator([scene], StateParametrization::Motion).predictive(&[scene], FutureValidity::Everything)
    }

    fn moments(scene: &Scene, agents: (usize, usize)) -> Vec<Vec<f32>> {
        let batch = batch(scene);
        let pairs = FutureFeatures::new(&batch, &[ScenePair { scene, agents }]).unwrap();
        let moments = pairs.moments(&batch.decode(&batch.x0).unwrap()).unwrap();
        assert_eq!(moments.valid.to_vec2::<f32>().unwrap(), [[1.0; 9]]);
        moments.features.squeeze(0).unwrap().to_vec2().unwrap()
    }

    #[track_caller]
    fn assert_close(found: &[f32], expected: &[f64]) {
        assert_eq!(found.len(), expected.len());
        let worst = found.iter().zip(expected).map(|(a, b)| (f64::from(*a) - b).abs()).fold(0.0, f64::max);
        assert!(worst < 2e-4, "{found:?}, expected {expected:?}");
    }

    /// The ego on the lane at 10 m/s and the other 3.5 m to its left, in no lane, at 8 m/s, 19.4 m ahead at present.
    #[test]
    fn the_present_of_two_vehicles_as_worked_out_by_hand() {
        let scene = scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0), Drive::straight(20.0, 3.5, 0.0, 8.0)]);
        let found = moments(&scene, (0, 1));
        let own = |x: f64, length: f64| x / (length * length + x * x).sqrt();
        let first = [0.0, 0.0, 1.0, 0.0, 10.0 / 101f64.sqrt(), 0.0, 0.0, 0.0];
        let second = [own(19.4, 40.0), own(3.5, 40.0), 0.8, 0.0, 8.0 / 65f64.sqrt(), 0.0, 0.0, 0.0];
        let (aside, ahead) = (own(3.5, 5.0), own(19.4, 30.0));
        let lanes = [0.0, aside, aside, ahead, -aside, 0.0, aside, ahead];
        let sizes = [0.9, 0.36, 0.9, 0.36];
        let expected: Vec<f64> = [&first[..], &second, &lanes, &sizes, &[0.0]].concat();
        assert_close(&found[0], &expected);
        assert_close(&found[8][FutureFeatures::MOMENT - 1..], &[1.0]);
        // The other falls back by 2 m/s.
        assert_close(&found[8][19..20], &[own(19.4 - 1.6, 30.0)]);
    }

    /// On a circle of 20 m at 10 m/s the velocity turns by 0.25 rad in half a second: 2 · 10 m/s · sin 0.125 / 0.5 s.
    #[test]
    fn accelerations_are_taken_over_half_a_second() {
        let turning = Drive { curvature_1pm: 0.05, ..Drive::straight(0.0, 0.0, 0.0, 10.0) };
        let found = moments(&scene(&[turning]), (0, 0));
        let last = &found[8];
        let size = 5.0 * f64::from(last[6].powi(2) + last[7].powi(2)).sqrt();
        assert!((size - 40.0 * 0.125f64.sin()).abs() < 0.02, "{size}");
        // One agent is both.
        assert_eq!(last[..8], last[8..16]);
    }

    #[test]
    fn pairs_are_repeated_as_batches_are() {
        let scene = scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0), Drive::straight(20.0, 3.5, 0.0, 8.0)]);
        let batch = batch(&scene);
        let pairs = FutureFeatures::new(&batch, &[ScenePair { scene: &scene, agents: (0, 1) }]).unwrap();
        let many = batch.repeated(3).unwrap();
        let repeated = pairs.repeated(3).unwrap().moments(&many.decode(&many.x0).unwrap()).unwrap().features;
        let once = pairs.moments(&batch.decode(&batch.x0).unwrap()).unwrap().features.to_vec3::<f32>().unwrap();
        assert_eq!(repeated.to_vec3::<f32>().unwrap(), vec![once[0].clone(); 3]);
        let why = FutureFeatures::new(&batch, &[ScenePair { scene: &scene, agents: (1, 0) }]).unwrap_err();
        assert!(why.to_string().contains("not at the center of its row"), "{why}");
        let why = FutureFeatures::new(&batch, &[]).unwrap_err();
        assert!(why.to_string().contains("0 pairs given for a batch of 1"), "{why}");
    }
}
