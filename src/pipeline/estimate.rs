//! The cost of generation: samples and evaluations by sweep and request, and what a batch takes if there is a denoiser
//! to try.

use super::config::PipelineConfig;
use super::layout::Layout;
use super::stages::{checkpoint_file, generation};
use crate::diffusion::Denoiser;
use crate::engine::{Failure, Result};
use crate::generate::{GenerateConfig, Pool, ResolvedGeneration, ResolvedRequest};
use crate::model::TrainedDenoiser;
use crate::nn::Compute;
use crate::scene::{ObservationMask, Scene};
use crate::store::SceneStore;
use crate::tensor::{FutureValidity, SceneView};
use candle_core::{DType, Tensor};
use std::time::Instant;

/// Number of timed evaluations, after one that is not timed.
const N_TIMED: usize = 3;

/// The plan of generation as lines for people, with its maximal cost; empty if nothing is generated.
///
/// # Errors
/// If the section is invalid, or a tensor operation fails.
pub fn estimate(config: &PipelineConfig, layout: &Layout) -> Result<Vec<String>> {
    let Some(generate) = &config.generate else { return Ok(Vec::new()) };
    let resolved = generate.resolve(&config.mine.clone().unwrap_or_default().build()?)?;
    let (mut lines, mut n_evaluations) = (vec!["generate, at most:".to_owned()], 0);
    for sweep in &resolved.sweeps[..resolved.n_sweeps] {
        let n_pairs = if sweep.behavior.is_some() { sweep.pairs.per_scene } else { 1 };
        let n_samples = (sweep.n_scenes * n_pairs * sweep.levels().len() * sweep.n_samples) as u64;
        let each = sweep.n_evaluations();
        n_evaluations += n_samples * each;
        lines.push(format!(
            "  sweep {}: {n_samples} samples, {} evaluations of the network",
            sweep.name,
            n_samples * each
        ));
    }
    let compute = config.run.compute().open()?;
    // The run decides once more which pairs can reach which bucket: where there are many scenes, most of its time.
    let began = Instant::now();
    let pools = generation(config, layout).map(|stage| stage.pools(&compute)).transpose()?.flatten();
    let deciding_s = began.elapsed().as_secs_f64();
    for (idx, request) in resolved.requests.iter().enumerate() {
        n_evaluations += describe(request, &resolved, pools.as_ref().map(|pools| &pools[idx]), &mut lines);
    }
    let time = match evaluations_per_second(config, generate, layout, &compute)? {
        None => "time unknown until there are scenes and a denoiser to measure".to_owned(),
        Some(rate) => {
            let seconds = deciding_s + n_evaluations as f64 / rate;
            let (threads, memory) = (rayon::current_num_threads(), peak_memory().unwrap_or_default());
            format!(
                "{} at {rate:.0} evaluations per second and with {} for pairs (measured now, on a batch of a recorded \
                 scene with {threads} threads{memory}; excludes guidance)",
                duration(seconds),
                duration(deciding_s),
            )
        }
    };
    lines.push(format!("  in all {n_evaluations} evaluations: {time}"));
    Ok(lines)
}

/// Adds the lines of a request, with its pairs if there is a `pool`. Returns its maximal number of evaluations.
fn describe(
    request: &ResolvedRequest,
    resolved: &ResolvedGeneration,
    pool: Option<&Pool>,
    lines: &mut Vec<String>,
) -> u64 {
    let config = &request.config;
    let dearest = request.arms.iter().map(|arm| arm.n_evaluations).max().unwrap_or(1);
    let cheapest = request.arms.iter().map(|arm| arm.n_evaluations).min().unwrap_or(1).max(1);
    let by_samples = config.budget.n_samples.map(|n| n.saturating_mul(dearest));
    let most_evaluations = by_samples.into_iter().chain(config.budget.n_evaluations).min().unwrap_or(0);
    let by_evaluations = config.budget.n_evaluations.map(|n| n / cheapest);
    let most_samples = config.budget.n_samples.into_iter().chain(by_evaluations).min().unwrap_or(0);
    let wanted = request.buckets.wanted();
    lines.push(format!(
        "  request {}: {} scenarios in {} buckets; {most_samples} samples, {most_evaluations} evaluations",
        config.name,
        wanted.iter().sum::<u64>(),
        wanted.len()
    ));
    lines.push(match pool {
        None => "    pairs that can reach a bucket are counted once scenes and models exist".to_owned(),
        Some(Pool { unmet: Some(why), .. }) => format!("    {why}"),
        Some(pool) => format!(
            "    {} pairs of {} scenes; {} more can reach no bucket",
            pool.cells.len(),
            pool.n_scenes,
            pool.n_infeasible
        ),
    });
    for arm in &request.arms {
        let sampler = resolved.sweeps[arm.sweep_idx].sampler_name();
        lines.push(format!("    arm {}: {sampler}, {} evaluations per sample", arm.name, arm.n_evaluations));
    }
    for (bucket, n) in wanted.iter().enumerate() {
        let pairs = match pool.map(|pool| pool.n_feasible(bucket)) {
            None => String::new(),
            Some(0) => ", but no pair can reach it".to_owned(),
            Some(1) => ", 1 pair can reach it".to_owned(),
            Some(n) => format!(", {n} pairs can reach it"),
        };
        lines.push(format!("    bucket {bucket}: {}: {n} wanted{pairs}", request.buckets.ranges(bucket)));
    }
    if pool.is_some_and(|pool| pool.cells.is_empty()) { 0 } else { most_evaluations }
}

/// The speed of the denoiser on a recorded scene, in evaluations of single samples per second. `None` without one of
/// the two.
fn evaluations_per_second(
    config: &PipelineConfig,
    generate: &GenerateConfig,
    layout: &Layout,
    compute: &Compute,
) -> Result<Option<f64>> {
    let trained = checkpoint_file(&layout.denoiser);
    let taken_over = config.train.denoiser.as_ref().and_then(|denoiser| denoiser.checkpoint.as_deref());
    let path = match (trained.is_file(), taken_over) {
        (true, _) => trained,
        (false, Some(path)) => checkpoint_file(path),
        (false, None) => return Ok(None),
    };
    // Errors are reported by the stage that reads the model; a damaged model of this run is made again.
    let Ok(TrainedDenoiser { network: denoiser, spec, .. }) = TrainedDenoiser::read(&path, compute) else {
        return Ok(None);
    };
    let is_alike = |scene: &Scene| scene.n_history == spec.n_history && scene.n_timesteps == spec.n_timesteps;
    // Recordings may begin with scenes without a future.
    let store = SceneStore::open(&layout.scenes).ok();
    let recorded = store.and_then(|store| (0..store.len()).filter_map(|idx| store.scene(idx).ok()).find(is_alike));
    let Some(scene) = recorded else { return Ok(None) };
    let mask = ObservationMask::predictive(scene.tracks.len(), scene.n_timesteps, scene.n_history);
    let view = SceneView { scene: &scene, ego_idx: scene.ego_idx, mask: &mask };
    let time = || -> candle_core::Result<f64> {
        let batch = spec.sampling_collator().collate(&[view], FutureValidity::Everything, &compute.device)?;
        let n_rows = generate.batch_size;
        let bound = denoiser.bind(&batch, n_rows)?;
        let x = batch.repeated(n_rows)?.x0.clone();
        let sigma = Tensor::full(1.0, n_rows, &compute.device)?.to_dtype(DType::F32)?;
        bound.denoise(&x, &sigma)?;
        let began = Instant::now();
        for _ in 0..N_TIMED {
            bound.denoise(&x, &sigma)?;
        }
        Ok((N_TIMED * n_rows) as f64 / began.elapsed().as_secs_f64().max(1e-6))
    };
    Ok(Some(time().map_err(Failure::fault)?))
}

/// The most memory that the process has had so far, such as `, 0.4 GB of memory`. `None` if the system does not tell.
fn peak_memory() -> Option<String> {
    let status = fs_err::read_to_string("/proc/self/status").ok()?;
    let kilobytes = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?.trim().strip_suffix("kB")?;
    Some(format!(", {:.1} GB of memory", kilobytes.trim().parse::<f64>().ok()? * 1024.0 / 1e9))
}

/// `about 40 s`, `about 12 min`, `about 3.4 h`.
fn duration(seconds: f64) -> String {
    match seconds {
        s if s < 100.0 => format!("about {s:.0} s"),
        s if s < 6000.0 => format!("about {:.0} min", s / 60.0),
        s => format!("about {:.1} h", s / 3600.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_are_short() {
        assert_eq!([12.4, 150.0, 9000.0].map(duration), ["about 12 s", "about 2 min", "about 2.5 h"]);
    }

    #[test]
    fn plans_are_counted() {
        let config: PipelineConfig = toml::from_str(
            "[[generate.sweeps]]\nname = 'plain'\nn_scenes = 4\nn_samples = 3\nsampler = { kind = 'euler', n_steps = 5 }
            [[generate.arms]]\nname = 'short'\nsampler = { kind = 'heun', n_steps = 5 }
            [[generate.arms]]\nname = 'long'\nsampler = { kind = 'heun', n_steps = 20 }
            [[generate.requests]]\nname = 'tight'\nbehavior = 'cut_in'\nper_bucket = 2
            buckets = { gap_m = [0, 5, 10] }\narms = ['short', 'long']\nbudget = { n_samples = 100 }",
        )
        .unwrap();
        let lines = estimate(&config, &Layout::below(std::path::Path::new("/nowhere"))).unwrap();
        let text = lines.join("\n");
        for part in [
            "sweep plain: 12 samples, 60 evaluations",
            "request tight: 4 scenarios in 2 buckets; 100 samples, 3900 evaluations",
            "arm long: heun-20, 39 evaluations per sample",
            "bucket 1: gap_m 5..10: 2 wanted",
            "in all 3960 evaluations: time unknown",
        ] {
            assert!(text.contains(part), "`{part}` is not in\n{text}");
        }
    }
}
