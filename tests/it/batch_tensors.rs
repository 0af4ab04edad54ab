//! A batch as named tensors, as the scripts in PyTorch read it. The benchmarks share this file.

use candle_core::{Result, Tensor};
use djinn::tensor::{PIECE_POINTS, SceneBatch, Surroundings};
use std::collections::HashMap;

/// Every tensor of a batch that a denoiser reads, and what surrounds its agents as geometry.
pub(crate) fn tensors(batch: &SceneBatch) -> Result<HashMap<String, Tensor>> {
    let mut named: HashMap<String, Tensor> = [
        ("x0", &batch.x0),
        ("context", &batch.context),
        ("observed", &batch.observed),
        ("latent", &batch.latent),
        ("valid", &batch.valid),
        ("features", &batch.features),
        ("lanes", &batch.lanes),
        ("lane_valid", &batch.lane_valid),
        ("base", &batch.base),
        ("rotation", &batch.rotation),
        ("unit", &batch.unit),
    ]
    .into_iter()
    .chain(batch.observed_motion.iter().map(|motion| ("observed_motion", motion)))
    .chain(batch.path.iter().map(|path| ("path", path)))
    .map(|(name, tensor)| (name.to_owned(), tensor.clone()))
    .collect();
    if let Some(surroundings) = &batch.surroundings {
        add_surroundings(&mut named, surroundings)?;
    }
    Ok(named)
}

fn add_surroundings(named: &mut HashMap<String, Tensor>, surroundings: &Surroundings) -> Result<()> {
    for (name, tensor) in [
        ("origin", &surroundings.origin),
        ("attributes", &surroundings.attributes),
        ("agent_lanes", &surroundings.lanes),
        ("agent_lane_valid", &surroundings.lane_valid),
        ("modes", &surroundings.modes),
        ("variances", &surroundings.variances),
    ] {
        named.insert(name.to_owned(), tensor.clone());
    }
    let (b, a, s) = surroundings.lane_valid.dims3()?;
    let p = surroundings.rows.iter().map(|row| row.pieces.len()).max().unwrap_or(0).max(1);
    let mut written = Written { named, device: surroundings.origin.device() };
    let n = PIECE_POINTS;
    let [mut points, mut edges, mut has_edges] = [3, 2, 1].map(|width| vec![0.0; b * p * n * width]);
    let [mut lane, mut length] = [(); 2].map(|()| vec![0.0; b * p]);
    let [mut seen_piece, mut seen_reach, mut is_reached] = [(); 3].map(|()| vec![0.0; b * a * s]);
    let (mut half_size, mut is_vulnerable) = (vec![0.0; b * a * 2], vec![0.0; b * a]);
    for (i, row) in surroundings.rows.iter().enumerate() {
        for (j, piece) in row.pieces.iter().enumerate() {
            let at = i * p + j;
            (lane[at], length[at]) = (piece.lane as f32, piece.length_m);
            for (k, point) in piece.points.iter().enumerate() {
                let at = at * n + k;
                points[at * 3..at * 3 + 3].copy_from_slice(&[point.x, point.y, point.heading_rad]);
                edges[at * 2..at * 2 + 2].copy_from_slice(&point.edges_m.unwrap_or_default());
                has_edges[at] = f32::from(u8::from(point.edges_m.is_some()));
            }
        }
        for (j, agent) in row.agents.iter().enumerate() {
            let at = i * a + j;
            half_size[at * 2..at * 2 + 2].copy_from_slice(&agent.half_size_m);
            is_vulnerable[at] = f32::from(u8::from(agent.is_vulnerable));
            for (k, seen) in agent.lanes.iter().enumerate() {
                let at = at * s + k;
                (seen_piece[at], seen_reach[at]) = (seen.piece as f32, seen.reach_m.unwrap_or_default());
                is_reached[at] = f32::from(u8::from(seen.reach_m.is_some()));
            }
        }
    }
    written.put("piece_points", points, &[b, p, n, 3])?;
    written.put("piece_edges", edges, &[b, p, n, 2])?;
    written.put("piece_has_edges", has_edges, &[b, p, n])?;
    written.put("piece_lane", lane, &[b, p])?;
    written.put("piece_length", length, &[b, p])?;
    written.put("seen_piece", seen_piece, &[b, a, s])?;
    written.put("seen_reach", seen_reach, &[b, a, s])?;
    written.put("seen_is_reached", is_reached, &[b, a, s])?;
    written.put("half_size", half_size, &[b, a, 2])?;
    written.put("is_vulnerable", is_vulnerable, &[b, a])?;
    written.put("dt_s", surroundings.rows.iter().map(|row| row.dt_s).collect(), &[b])
}

/// Tensors by name, while they are written.
struct Written<'a> {
    named: &'a mut HashMap<String, Tensor>,
    device: &'a candle_core::Device,
}

impl Written<'_> {
    fn put(&mut self, name: &str, values: Vec<f32>, shape: &[usize]) -> Result<()> {
        self.named.insert(name.to_owned(), Tensor::from_vec(values, shape, self.device)?);
        Ok(())
    }
}
