//! The change between the diffused states of one noisy scene under two observation masks.

use super::BranchChange;
use crate::tensor::SceneBatch;
use candle_core::{Error, Result, Tensor};

/// The map from batches of a base mask to those of an extended one, which observes more, and back.
///
/// Under each mask diffused states are an affine image of scene coordinates, agent by agent: y = b + A x on latent
/// entries. Base b and matrix A follow from what is observed, so they differ for agents of whom more is observed. Let S
/// be the entries that are latent under both masks and C those that only the extended one observes. White noise σ n in
/// the state of the base mask is noise σ A n in scene coordinates.
///
/// - **State.** Where C is known, so is its noise, and where noise is correlated over time (A mixes timesteps) that
///   says something of the noise on S. What is left, x' = A'⁻¹ (yₛ - P (y_c - y_c0) - b'ₛ) with P = Σₛ_c Σ_cc⁻¹ and
///   Σ = A Aᵀ, is all that x says of S; with uncorrelated noise it is just yₛ in the coordinates of the extended mask.
/// - **Noise level.** The noise of x' is σ G n with G the linear part of the map, white at the same σ exactly if G
///   Gᵀ = 1. That holds wherever the two masks give an agent the same frame and units: always in the scene
///   parametrization, and in the others for agents that the base mask observes up to the present, because their frame
///   is that of the last such state. (Brownian noise, known at the entries C, is the noise of the bridges of the
///   extended mask.) An agent that only the extended mask observes changes its frame and units; its noise is then of a
///   wrong share.
pub struct MaskChange {
    /// Places on the flattened (B · A) axis of the agents whose masks differ, (K); the others have the same mask in
    /// both.
    changed: Option<Changed>,
}

struct Changed {
    agents: Tensor,
    /// G: (K, N, N) with N = T · D, and its shift (K, N, 1).
    forward: (Tensor, Tensor),
    /// The way of clean estimates back.
    back: (Tensor, Tensor),
}

/// Matrices by rows.
type Matrix = Vec<Vec<f64>>;

/// One agent under one mask.
struct AgentMap {
    /// Which of the N entries are latent.
    latent: Vec<usize>,
    /// A, (N, N).
    linear: Matrix,
    /// b, (N).
    base: Vec<f64>,
}

impl MaskChange {
    /// The change between two batches of the same scenes, seen from the same agents. All latent entries of `extended`
    /// are latent in `base`, too.
    ///
    /// # Errors
    /// When the batches do not belong together.
    pub fn new(base: &SceneBatch, extended: &SceneBatch) -> Result<Self> {
        if base.x0.dims() != extended.x0.dims() {
            candle_core::bail!("the batches of the two masks have different shapes");
        }
        let (n_rows, n_agents, n_timesteps, state_dim) = base.x0.dims4()?;
        let differs = (&base.latent - &extended.latent)?.abs()?.sum(2)?.flatten_all()?.to_vec1::<f32>()?;
        let places: Vec<u32> = (0..(n_rows * n_agents) as u32).filter(|i| differs[*i as usize] > 0.0).collect();
        if places.is_empty() {
            return Ok(Self { changed: None });
        }
        let n_changed = places.len();
        let agents = Tensor::from_vec(places, n_changed, base.x0.device())?;
        let (before, after) = (agent_maps(base, &agents)?, agent_maps(extended, &agents)?);
        let n = n_timesteps * state_dim;
        let mut all: [Vec<f32>; 4] = std::array::from_fn(|_| Vec::with_capacity(n_changed * n));
        for (before, after) in before.iter().zip(&after) {
            let [forward, back] = change(before, after)?;
            for (i, (linear, shift)) in [forward, back].into_iter().enumerate() {
                all[2 * i].extend(linear.iter().flatten().map(|value| *value as f32));
                all[2 * i + 1].extend(shift.iter().map(|value| *value as f32));
            }
        }
        let [forward, forward_shift, back, back_shift] = all;
        let tensor = |values: Vec<f32>, width: usize| {
            Tensor::from_vec(values, (n_changed, n, width), base.x0.device())?.to_dtype(base.x0.dtype())
        };
        Ok(Self {
            changed: Some(Changed {
                agents,
                forward: (tensor(forward, n)?, tensor(forward_shift, 1)?),
                back: (tensor(back, n)?, tensor(back_shift, 1)?),
            }),
        })
    }
}

impl BranchChange for MaskChange {
    fn to_conditional(&self, x: &Tensor) -> Result<Tensor> {
        self.changed.as_ref().map_or_else(|| Ok(x.clone()), |changed| changed.apply(&changed.forward, x))
    }

    fn to_unconditional(&self, x0_hat: &Tensor) -> Result<Tensor> {
        self.changed.as_ref().map_or_else(|| Ok(x0_hat.clone()), |changed| changed.apply(&changed.back, x0_hat))
    }
}

impl Changed {
    fn apply(&self, (linear, shift): &(Tensor, Tensor), x: &Tensor) -> Result<Tensor> {
        let (n_rows, n_agents, n_timesteps, state_dim) = x.dims4()?;
        let flat = x.contiguous()?.reshape((n_rows * n_agents, n_timesteps * state_dim, 1))?;
        let own = flat.index_select(&self.agents, 0)?;
        let mapped = (linear.matmul(&own)? + shift)?;
        flat.index_add(&self.agents, &(mapped - own)?, 0)?.reshape(x.shape())
    }
}

/// The affine maps of these agents of a batch. They are read off its decoding, column by column.
fn agent_maps(batch: &SceneBatch, agents: &Tensor) -> Result<Vec<AgentMap>> {
    let (n_rows, n_agents, n_timesteps, state_dim) = batch.x0.dims4()?;
    let n = n_timesteps * state_dim;
    let of_agents = |decoded: &Tensor| -> Result<Matrix> {
        let flat = decoded.narrow(3, 0, state_dim)?.contiguous()?.reshape((n_rows * n_agents, n))?;
        flat.index_select(agents, 0)?.to_dtype(candle_core::DType::F64)?.to_vec2()
    };
    let bases = of_agents(&batch.decode(&batch.x0.zeros_like()?)?)?;
    let latent = batch.latent.unsqueeze(3)?.broadcast_as(batch.x0.shape())?.contiguous()?;
    let latent = latent.reshape((n_rows * n_agents, n))?.index_select(agents, 0)?.to_vec2::<f32>()?;
    let mut matrices = vec![vec![vec![0.0; n]; n]; bases.len()];
    for column in 0..n {
        let mut unit = vec![0f32; n];
        unit[column] = 1.0;
        let unit = Tensor::from_vec(unit, (1, 1, n_timesteps, state_dim), batch.x0.device())?;
        let decoded =
            batch.decode_offsets(&unit.to_dtype(batch.x0.dtype())?.broadcast_as(batch.x0.shape())?.contiguous()?)?;
        for (matrix, image) in matrices.iter_mut().zip(of_agents(&decoded)?) {
            for (row, value) in matrix.iter_mut().zip(image) {
                row[column] = value;
            }
        }
    }
    let maps = matrices.into_iter().zip(bases).zip(latent).map(|((linear, base), latent)| AgentMap {
        latent: (0..n).filter(|i| latent[*i] > 0.0).collect(),
        linear,
        base,
    });
    Ok(maps.collect())
}

/// The maps of states from `before` to `after` and of clean estimates back, as (linear, shift), over all N entries.
fn change(before: &AgentMap, after: &AgentMap) -> Result<[(Matrix, Vec<f64>); 2]> {
    let n = before.base.len();
    let (all, kept) = (&before.latent, &after.latent);
    let known: Vec<usize> = all.iter().copied().filter(|i| !kept.contains(i)).collect();
    if all.len() != kept.len() + known.len() {
        candle_core::bail!("the extended mask hides a state that the base mask observes");
    }
    let singular = || Error::Msg("the decoding of an agent cannot be inverted".into());
    // Regression of the noise on S on that on C: Σ_cc Pᵀ = Σ_cs.
    let covariance = |i: usize, j: usize| dot(&before.linear[i], &before.linear[j]);
    let block = |rows: &[usize], columns: &[usize]| -> Matrix {
        rows.iter().map(|i| columns.iter().map(|j| covariance(*i, *j)).collect()).collect()
    };
    let regression = solved(block(&known, &known), block(&known, kept)).ok_or_else(singular)?;
    // One row for each entry of S: the coefficients of x, and a last one for the shift.
    let target = |(s, i): (usize, &usize)| {
        let mut row = before.linear[*i].clone();
        row.push(before.base[*i] - after.base[*i]);
        for (c, j) in known.iter().enumerate().filter(|(c, _)| regression[*c][s] != 0.0) {
            let share = regression[c][s];
            row.iter_mut().zip(&before.linear[*j]).for_each(|(value, noise)| *value -= share * noise);
            // The clean value of an observed entry is the base of the extended mask.
            row[n] -= share * (before.base[*j] - after.base[*j]);
        }
        row
    };
    let forward = solved(restricted(&after.linear, kept), kept.iter().enumerate().map(target).collect());
    let image = |i: &usize| {
        let is_kept = kept.contains(i);
        let mut row = if is_kept { after.linear[*i].clone() } else { vec![0.0; n] };
        row.push(after.base[*i] - before.base[*i]);
        row
    };
    let back = solved(restricted(&before.linear, all), all.iter().map(image).collect());
    let spread = |rows: Matrix, places: &[usize]| {
        let (mut linear, mut shift) = (vec![vec![0.0; n]; n], vec![0.0; n]);
        for (mut row, place) in rows.into_iter().zip(places) {
            shift[*place] = row.pop().unwrap_or_default();
            linear[*place] = row;
        }
        (linear, shift)
    };
    Ok([spread(forward.ok_or_else(singular)?, kept), spread(back.ok_or_else(singular)?, all)])
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// The rows and columns at `places`.
fn restricted(matrix: &Matrix, places: &[usize]) -> Matrix {
    places.iter().map(|i| places.iter().map(|j| matrix[*i][*j]).collect()).collect()
}

/// X with A X = B, by elimination with partial pivoting; `None` if A is singular. Zeros are skipped: A is mostly
/// block-diagonal or triangular.
fn solved(mut a: Matrix, mut b: Matrix) -> Option<Matrix> {
    let n = a.len();
    for column in 0..n {
        let pivot = (column..n).max_by(|i, j| a[*i][column].abs().total_cmp(&a[*j][column].abs()))?;
        if a[pivot][column].abs() < 1e-12 {
            return None;
        }
        a.swap(column, pivot);
        b.swap(column, pivot);
        let scale = a[column][column].recip();
        a[column][column..].iter_mut().for_each(|value| *value *= scale);
        b[column].iter_mut().for_each(|value| *value *= scale);
        let (pivot_a, pivot_b) = (a[column].clone(), b[column].clone());
        for row in (0..n).filter(|row| *row != column) {
            let factor = a[row][column];
            if factor != 0.0 {
                a[row][column..].iter_mut().zip(&pivot_a[column..]).for_each(|(value, p)| *value -= factor * p);
                b[row].iter_mut().zip(&pivot_b).for_each(|(value, p)| *value -= factor * p);
            }
        }
    }
    Some(b)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diffusion::NoiseSource;
    use crate::scene::testing::{Drive, scene};
    use crate::scene::{ObservationMask, Scene};
    use crate::seed::Seed;
    use crate::tensor::testing::collator;
    use crate::tensor::{FutureValidity, StateParametrization};

    /// One car straight on, one that turns by about 80 degrees, one without a known goal.
    fn cars() -> Scene {
        let turning = Drive { x: 30.0, y: 20.0, heading_rad: -1.6, speed_mps: 8.0, curvature_1pm: -0.2 };
        scene(&[Drive::straight(5.0, 1.0, 0.3, 12.0), turning, Drive::straight(-20.0, 3.5, 3.1, 4.0)])
    }

    /// Batches of two samples under the history, and with goals at timestep 11 (and a state at 7) of the first two.
    fn batches(parametrization: StateParametrization) -> (SceneBatch, SceneBatch) {
        let scene = cars();
        let collator = collator([&scene], parametrization);
        let collate =
            |mask: &ObservationMask| collator.masked(&scene, mask, FutureValidity::Everything).repeated(2).unwrap();
        let extended = ObservationMask::from_fn(3, 12, |a, t| t < 4 || (a < 2 && t == 11) || (a == 0 && t == 7));
        (collate(&ObservationMask::predictive(3, 12, 4)), collate(&extended))
    }

    fn noise(batch: &SceneBatch) -> Tensor {
        let mut source = NoiseSource::new(vec![Seed(1), Seed(2)]);
        source.draw_like(&batch.x0).unwrap()
    }

    /// The largest difference of (B, A, T, D) tensors where `mask` (B, A, T) is 1.
    fn difference(a: &Tensor, b: &Tensor, mask: &Tensor) -> f32 {
        let difference = (a - b).unwrap().abs().unwrap().broadcast_mul(&mask.unsqueeze(3).unwrap()).unwrap();
        difference.flatten_all().unwrap().max(0).unwrap().to_scalar().unwrap()
    }

    #[test]
    fn both_branches_describe_the_same_scene() {
        for parametrization in [StateParametrization::Scene, StateParametrization::Motion] {
            let (base, extended) = batches(parametrization);
            let change = MaskChange::new(&base, &extended).unwrap();
            let x = noise(&base);
            let moved = change.to_conditional(&x).unwrap();
            let (before, after) = (base.decode(&x).unwrap(), extended.decode(&moved).unwrap());
            // The known part of Brownian noise is removed; the rest is unchanged.
            let is_same = difference(&before, &after, &extended.latent) < 1e-3;
            assert_eq!(is_same, parametrization != StateParametrization::Motion, "{parametrization:?}");
            // The third agent's masks are the same: nothing about it changes, not even by rounding.
            assert_eq!(
                difference(
                    &x.narrow(1, 2, 1).unwrap(),
                    &moved.narrow(1, 2, 1).unwrap(),
                    &base.valid.narrow(1, 2, 1).unwrap()
                ),
                0.0
            );
            // And back: estimates decode to the same places, and goals to their own.
            let estimate = (noise(&extended) * 0.5).unwrap();
            let back = change.to_unconditional(&estimate).unwrap();
            let found = base.decode(&back).unwrap();
            let latent = extended.latent.clone();
            assert!(difference(&found, &extended.decode(&estimate).unwrap(), &latent) < 1e-3);
            let goals = (&base.latent - &extended.latent).unwrap();
            assert!(goals.sum_all().unwrap().to_scalar::<f32>().unwrap() == 6.0);
            assert!(difference(&found, &base.decode(&base.x0).unwrap(), &goals) < 1e-3, "{parametrization:?}");
        }
    }

    /// G Gᵀ of a changed agent on the entries that stay latent.
    fn noise_covariance(parametrization: StateParametrization, k: usize) -> Vec<Vec<f32>> {
        let (base, extended) = batches(parametrization);
        let changed = MaskChange::new(&base, &extended).unwrap().changed.unwrap();
        let forward = changed.forward.0.get(k).unwrap();
        forward.matmul(&forward.t().unwrap()).unwrap().to_vec2().unwrap()
    }

    #[test]
    fn noise_stays_white_even_where_a_goal_lies_behind_a_bend() {
        // Latent timesteps of the first agent: 4 to 10 without 7; of the second: 4 to 10.
        let cases = [
            (StateParametrization::Motion, 0, vec![4, 5, 6, 8, 9, 10]),
            (StateParametrization::Motion, 1, vec![4, 5, 6, 7, 8, 9, 10]),
            (StateParametrization::Scene, 0, vec![4, 5, 6, 8, 9, 10]),
            (StateParametrization::Scene, 1, vec![4, 5, 6, 7, 8, 9, 10]),
        ];
        for (parametrization, k, latent) in cases {
            let covariance = noise_covariance(parametrization, k);
            for (i, row) in covariance.iter().enumerate() {
                for (j, value) in row.iter().enumerate() {
                    let expected = if i == j && latent.contains(&(i / 3)) { 1.0 } else { 0.0 };
                    assert!((value - expected).abs() < 1e-3, "{parametrization:?} {k}: {i} {j}: {value}");
                }
            }
        }
    }

    #[test]
    fn elimination_solves_by_hand_made_systems() {
        // Needs an exchange of rows: x = (3, 2) and (-1, 5).
        let solution = solved(vec![vec![0.0, 2.0], vec![4.0, 1.0]], vec![vec![4.0, 10.0], vec![14.0, 1.0]]).unwrap();
        for (row, expected) in solution.iter().zip([[3.0, -1.0], [2.0, 5.0]]) {
            assert!(row.iter().zip(expected).all(|(x, e)| (x - e).abs() < 1e-12));
        }
        assert!(solved(vec![vec![1.0, 2.0], vec![2.0, 4.0]], vec![vec![1.0], vec![1.0]]).is_none());
    }

    #[test]
    fn correlated_noise_is_told_apart_from_what_is_known_of_it() {
        // Two entries with y₁ = x₁, y₂ = x₁ + x₂ (steps of a walk); the second is observed to be 5. What is left of the
        // first is a bridge: y₁ - (y₂ - 5) / 2 has noise of variance 1/2, white in the extended mask's unit √(1/2).
        let before = AgentMap { latent: vec![0, 1], linear: vec![vec![1.0, 0.0], vec![1.0, 1.0]], base: vec![0.0; 2] };
        let unit = 0.5f64.sqrt();
        let after = AgentMap { latent: vec![0], linear: vec![vec![unit, 0.0], vec![0.0, 0.0]], base: vec![2.0, 5.0] };
        let [(forward, shift), (back, back_shift)] = change(&before, &after).unwrap();
        let expect = |found: &[f64], expected: [f64; 2]| {
            assert!(found.iter().zip(expected).all(|(f, e)| (f - e).abs() < 1e-12), "{found:?}, expected {expected:?}");
        };
        expect(&forward[0], [0.5 / unit, -0.5 / unit]);
        expect(&forward[1], [0.0, 0.0]);
        expect(&shift, [(2.5 - 2.0) / unit, 0.0]);
        assert!((dot(&forward[0], &forward[0]) - 1.0).abs() < 1e-12, "white at the same level");
        // An estimate x̂ of the extended mask: y₁ = 2 + x̂ √½, y₂ = 5, so x₁ = y₁ and x₂ = 5 - y₁.
        expect(&back[0], [unit, 0.0]);
        expect(&back[1], [-unit, 0.0]);
        expect(&back_shift, [2.0, 3.0]);
    }
}
