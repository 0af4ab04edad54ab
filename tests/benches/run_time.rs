//! How long does one scene take, against the number of its agents (paper, Appendix: model runtime)?
//!
//! The networks have the paper's size and random weights, which cost what trained ones do. One scene at a time, as in
//! the paper; a sweep samples many at once and is faster for each.

use crate::cpu_time::{Elapsed, timed};
use crate::scenes::scene;
use candle_core::{Device, Result};
use djinn::diffusion::{Edm, NoiseSource, SamplerConfig};
use djinn::model::{NetworkConfig, SceneDenoiser, SceneTransformer, SceneTransformerConfig};
use djinn::nn::{Compute, Params, keep_freed_memory};
use djinn::scene::{ObservationMask, Scene};
use djinn::seed::Seed;
use djinn::tensor::{Collator, FutureValidity, NormalizerFit, SceneBatch, SceneView, StateParametrization};

/// INTERACTION's shape.
const N_TIMESTEPS: usize = 40;
const N_HISTORY: usize = 10;
const N_LANES: usize = 100;
const PARAMETRIZATION: StateParametrization = StateParametrization::Scene;

/// Prints one row for each number of agents.
pub(crate) fn run(arguments: &[String]) -> std::result::Result<(), String> {
    let (mut agents, mut steps) = (Vec::new(), Vec::new());
    let mut is_steps = false;
    for argument in arguments {
        match argument.parse::<usize>() {
            Ok(number) if number > 0 => (if is_steps { &mut steps } else { &mut agents }).push(number),
            _ if argument == "--steps" => is_steps = true,
            _ => return Err(format!("{argument:?} is neither a number above 0 nor --steps")),
        }
    }
    let or = |given: Vec<usize>, default: &[usize]| if given.is_empty() { default.to_vec() } else { given };
    table(&or(agents, &[8, 16, 32, 64]), &or(steps, &[25, 50])).map_err(|error| error.to_string())
}

fn table(agents: &[usize], steps: &[usize]) -> Result<()> {
    keep_freed_memory();
    let (compute, edm) = (Compute::cpu(), Edm::default());
    let mut params = Params::new(&compute).frozen();
    let denoiser = SceneDenoiser::new(&mut params, &NetworkConfig::default(), 3, edm, Seed(1))?;
    let mut baseline_params = Params::new(&compute).frozen();
    let config = SceneTransformerConfig::default();
    let baseline = SceneTransformer::new(&mut baseline_params, &config, 3, PARAMETRIZATION, Seed(1))?;
    println!(
        "Seconds for one scene of T = {N_TIMESTEPS}, L = {N_LANES}: on the clock (of the processor); denoiser {:.1} M, \
         Scene Transformer {:.1} M parameters",
        params.n_parameters() as f64 * 1e-6,
        baseline_params.n_parameters() as f64 * 1e-6
    );
    let heads: Vec<String> = steps.iter().map(|n| format!("{:>18}", format!("Heun-{n} ({})", 2 * n - 1))).collect();
    println!("{:>6} {:>18} {:>18} {}", "agents", "Scene Transformer", "one evaluation", heads.join(" "));
    for &n_agents in agents {
        let batch = batch(&scene(n_agents, N_TIMESTEPS, N_HISTORY, N_LANES))?;
        let bound = denoiser.bind(&batch, 1)?;
        let draw = |n_steps: usize| -> Result<Elapsed> {
            let mut noise = NoiseSource::new(vec![Seed(2)]);
            let sampler = SamplerConfig::heun(n_steps);
            let dims = &batch.x0.dims()[1..];
            let (sample, elapsed) = timed(|| {
                sampler.sample(&edm, &bound, dims, &batch.x0, &mut noise, &mut |_: &djinn::diffusion::Step<'_>| ())
            });
            sample.map(|_| elapsed)
        };
        let forward = || -> Result<Elapsed> {
            let (futures, elapsed) = timed(|| baseline.forward(&batch));
            futures.map(|_| elapsed)
        };
        // The first calls are slower: they fetch memory.
        forward()?;
        draw(1)?;
        let mut cells = vec![cell(forward()?), cell(draw(1)?)];
        for &n_steps in steps {
            cells.push(cell(draw(n_steps)?));
        }
        println!("{n_agents:>6} {}", cells.join(" "));
    }
    Ok(())
}

fn cell(elapsed: Elapsed) -> String {
    format!("{:>18}", format!("{:.3} ({:.3})", elapsed.wall_s, elapsed.cpu_s))
}

fn batch(scene: &Scene) -> Result<SceneBatch> {
    let mut fit = NormalizerFit::default();
    fit.add(scene);
    let collator = Collator {
        normalizer: fit.finish(PARAMETRIZATION, 3),
        n_timesteps: N_TIMESTEPS,
        max_agents: scene.tracks.len(),
        max_lanes: N_LANES,
        sight: None,
    };
    let mask = ObservationMask::predictive(scene.tracks.len(), N_TIMESTEPS, N_HISTORY);
    collator.collate(&[SceneView { scene, ego_idx: 0, mask: &mask }], FutureValidity::Everything, &Device::Cpu)
}
