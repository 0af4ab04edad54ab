//! How long do the networks' calls take beside the same networks in PyTorch, with the same weights, on the same scenes?
//!
//! First DJINN's network of the paper's size, then the geometric one of the preset `small`. Both sides take turns,
//! batch by batch, so that whatever else the machine does slows both. The peer is `scripts/bench_network.py`, which
//! first has to give the same output.

use crate::batch_tensors::tensors;
use crate::cpu_time::{Elapsed, timed};
use candle_core::{Device, Tensor};
use djinn::diffusion::{Denoiser, NoiseSource, SamplerConfig, rows_like};
use djinn::model::{DenoiserKind, DenoiserSpec, ModelSpec, SceneDenoiser};
use djinn::nn::{Adam, Compute, Params, in_pool, keep_freed_memory};
use djinn::scene::{ObservationMask, Split};
use djinn::seed::Seed;
use djinn::store::SceneStore;
use djinn::tensor::{FutureValidity, MaskSampler, NormalizerFit, SceneBatch, SceneView};
use djinn::train::{
    DenoiserTraining, DenoiserTrainingConfig, DrawnBatch, Prefetched, Preset, SceneDraws, WeightedGroups,
};
use std::collections::{BTreeMap, HashMap};
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

type Result<T> = std::result::Result<T, Box<dyn std::error::Error + Send + Sync>>;

const SEED: Seed = Seed(1);
/// The largest difference allowed between both networks, relative to the largest output.
const TOLERANCE: f64 = 1e-4;

/// The measurements to make.
struct Options {
    scenes: PathBuf,
    python: String,
    /// Scenes of a batch; left out, 4 for the paper's network and the preset's for the other.
    batch_size: Option<usize>,
    n_rounds: usize,
    n_futures: usize,
    n_steps: usize,
    presets: Vec<Preset>,
}

const fn name_of(preset: Preset) -> &'static str {
    match preset {
        Preset::Paper => "paper",
        _ => "small",
    }
}

/// Prints one row for each kind of call.
pub(crate) fn run(arguments: &[String]) -> std::result::Result<(), String> {
    let usage = "network SCENES [--python PROGRAM] [--batch N] [--rounds N] [--futures N] [--steps N] [--preset \
                 paper|small], where SCENES is the folder `scenes` of a run";
    let (scenes, rest) = arguments.split_first().ok_or(usage)?;
    let mut options = Options {
        scenes: scenes.into(),
        python: "python3".to_owned(),
        batch_size: None,
        n_rounds: 7,
        n_futures: 60,
        n_steps: 3,
        presets: vec![Preset::Paper, Preset::Small],
    };
    for pair in rest.chunks(2) {
        let [name, value] = pair else { return Err(usage.to_owned()) };
        let number = || value.parse().ok().filter(|n| *n > 0).ok_or_else(|| format!("{name} {value}: {usage}"));
        match name.as_str() {
            "--python" => options.python.clone_from(value),
            "--batch" => options.batch_size = Some(number()?),
            "--rounds" => options.n_rounds = number()?,
            "--futures" => options.n_futures = number()?,
            "--steps" => options.n_steps = number()?,
            "--preset" => {
                options.presets.retain(|preset| name_of(*preset) == value);
                if options.presets.is_empty() {
                    return Err(format!("{name} {value}: {usage}"));
                }
            }
            _ => return Err(format!("{name}: {usage}")),
        }
    }
    keep_freed_memory();
    for preset in &options.presets {
        compare(&options, *preset).map_err(|error| error.to_string())?;
    }
    Ok(())
}

/// A batch with one noise level a row.
struct Noisy {
    batch: SceneBatch,
    x: Tensor,
    sigma: Tensor,
    weight: Tensor,
}

fn compare(options: &Options, preset: Preset) -> Result<()> {
    let training = DenoiserTrainingConfig { preset, ..DenoiserTrainingConfig::default() }.resolve()?;
    let name = name_of(preset);
    let own_batch_size = if preset == Preset::Paper { 4 } else { training.common.batch_size };
    let batch_size = options.batch_size.unwrap_or(own_batch_size);
    println!("the network of the preset {name}");
    let store = SceneStore::open(&options.scenes)?;
    let train: Vec<usize> = (0..store.len()).filter(|idx| store.index().get(*idx).split == Split::Train).collect();
    let mut fit = NormalizerFit::default();
    for idx in train.iter().take(500) {
        fit.add(&store.scene(*idx)?);
    }
    let first = store.scene(*train.first().ok_or("no scene of the split train")?)?;
    let spec = DenoiserSpec {
        kind: DenoiserKind::SceneDenoiser,
        network: training.network.clone(),
        edm: training.edm,
        normalizer: fit.finish(training.parametrization, 3),
        n_history: first.n_history,
        n_timesteps: first.n_timesteps,
        dt_s: first.dt_s,
        max_agents: training.max_agents,
        max_lanes: training.max_lanes,
        steps: 0,
        seed: SEED.0,
        scenes: String::new(),
        objectives: Vec::new(),
        changed_losses: Vec::new(),
        losses_by_place: Vec::new(),
        distillation: None,
    };
    let networks = || -> Result<(Params, SceneDenoiser, SceneDenoiser)> {
        let mut params = Params::new(&Compute::cpu());
        let denoiser = SceneDenoiser::new(&mut params, &spec.network, 3, spec.edm, SEED)?;
        let frozen = SceneDenoiser::new(&mut params.clone().settled(), &spec.network, 3, spec.edm, SEED)?;
        Ok((params, denoiser, frozen))
    };
    let draws = SceneDraws {
        collator: &spec.collator(),
        dataset: &store,
        train: &[WeightedGroups::single(train)],
        held_out: &[],
        masks: &MaskSampler::new(&training.common.tasks).ok_or("no task has a weight")?,
        batch_size,
        with_context: false,
        seed: SEED,
        device: &Device::Cpu,
        ahead: Prefetched::default(),
    };
    // The first round warms both up and checks that they agree; it is not counted.
    let batches: Vec<Noisy> = (0..=options.n_rounds as u64)
        .map(|step| noisy(draws.training_batch(step)?, &training))
        .collect::<Result<_>>()?;
    let mask = ObservationMask::predictive(first.tracks.len(), first.n_timesteps, first.n_history);
    let view = SceneView { scene: &first, ego_idx: first.ego_idx, mask: &mask };
    let scene = draws.collator.collate(&[view], FutureValidity::Everything, &Device::Cpu)?;
    let (params, _, frozen) = networks()?;
    let folder = tempfile::tempdir()?;
    spec.write(&params, &folder.path().join("model.safetensors"))?;
    write_inputs(&folder.path().join("inputs.safetensors"), &batches, &scene)?;
    describe(options, &batches, &scene);
    let (drawn, elapsed) = timed(|| {
        let steps = 1000..1000 + 200u64.div_ceil(batch_size as u64);
        steps.map(|step| Ok(noisy(draws.training_batch(step)?, &training)?.batch.x0.dim(0)?)).sum::<Result<usize>>()
    });
    println!(
        "scenes read, drawn, padded and noised for training: {:.0} a second of the processor",
        drawn? as f64 / elapsed.cpu_s
    );
    let mut peer = Peer::start(&options.python, folder.path())?;

    let forward = |frozen: &SceneDenoiser, noisy: &Noisy| -> Result<Tensor> {
        Ok(frozen.bind(&noisy.batch, 1)?.denoise(&noisy.x, &noisy.sigma)?)
    };
    let expected = read_tensor(&folder.path().join("outputs.safetensors"), "output")?;
    let difference = relative_difference(&forward(&frozen, &batches[0])?, &expected)?;
    println!("largest difference of the outputs: {difference:.1e} of the largest output");
    if difference > TOLERANCE {
        return Err(format!("the networks differ by {difference:.1e}, more than {TOLERANCE:.0e}").into());
    }
    println!("{:<38} {:>18} {:>18} {:>18}", "seconds on the clock (of the processor)", "djinn", "PyTorch", "ratio");
    let n_evaluations = 2 * options.n_steps - 1;
    let (params, denoiser, frozen) = networks()?;
    let mut adam = Adam::default();
    let mut step = |noisy: &Noisy| -> Result<()> {
        let error = (denoiser.bind(&noisy.batch, 1)?.denoise(&noisy.x, &noisy.sigma)? - &noisy.batch.x0)?;
        let squared = error.broadcast_mul(&noisy.batch.latent.unsqueeze(3)?)?.sqr()?;
        let loss = squared.broadcast_mul(&noisy.weight)?.sum_all()?;
        let loss = (loss / (f64::from(noisy.batch.latent.sum_all()?.to_scalar::<f32>()?) * 3.0))?;
        let gradients = loss.backward()?;
        adam.step(&params, &gradients, 3e-4, Some(5.0))?;
        Ok(())
    };
    let sample = || -> Result<()> {
        let bound = frozen.bind(&scene, options.n_futures)?;
        let seeds = (0..options.n_futures as u64).map(|i| SEED.derive("noise", &[i])).collect();
        let sampler = SamplerConfig::heun(options.n_steps);
        let (dims, mut noise) = (&scene.x0.dims()[1..], NoiseSource::new(seeds));
        sampler.sample(&spec.edm, &bound, dims, &scene.x0, &mut noise, &mut |_: &djinn::diffusion::Step<'_>| ())?;
        Ok(())
    };
    let mut table = Table::default();
    for (round, noisy) in batches.iter().enumerate() {
        let (ours, elapsed) = timed(|| in_pool(&Device::Cpu, || forward(&frozen, noisy)));
        ours?;
        table.add("forward", elapsed, peer.ask(&format!("forward {round}"))?);
    }
    table.print("forward", &format!("forward, {batch_size} scenes"));
    for (round, noisy) in batches.iter().enumerate() {
        let (ours, elapsed) = timed(|| in_pool(&Device::Cpu, || step(noisy)));
        ours?;
        table.add("train", elapsed, peer.ask(&format!("train {round}"))?);
    }
    table.print("train", &format!("training step, {batch_size} scenes"));
    for _ in 0..4 {
        let (ours, elapsed) = timed(|| in_pool(&Device::Cpu, sample));
        ours?;
        let request = format!("sample {} {}", options.n_futures, options.n_steps);
        table.add("sample", elapsed, peer.ask(&request)?);
    }
    table.print("sample", &format!("{} futures, {n_evaluations} evaluations", options.n_futures));
    peer.stop()
}

fn noisy(drawn: DrawnBatch, training: &DenoiserTraining) -> Result<Noisy> {
    let DrawnBatch { batch, seeds, mut rngs, .. } = drawn;
    let sigmas: Vec<f64> = rngs.iter_mut().map(|rng| training.noise.draw(rng)).collect();
    let weight = sigmas.iter().map(|sigma| training.edm.loss_weight(*sigma)).collect();
    let sigma = rows_like(sigmas, &batch.x0)?;
    let noise = NoiseSource::new(seeds).draw_like(&batch.x0)?.broadcast_mul(&sigma)?;
    let x = (&batch.x0 + noise)?.broadcast_mul(&batch.latent.unsqueeze(3)?)?;
    Ok(Noisy { x, sigma: sigma.flatten_all()?, weight: rows_like(weight, &batch.x0)?, batch })
}

fn write_inputs(path: &Path, batches: &[Noisy], scene: &SceneBatch) -> Result<()> {
    let below = |prefix: String, named: HashMap<String, Tensor>| {
        named.into_iter().map(move |(name, tensor)| (format!("{prefix}.{name}"), tensor))
    };
    let mut inputs: HashMap<String, Tensor> = below("scene".to_owned(), tensors(scene)?).collect();
    for (i, noisy) in batches.iter().enumerate() {
        let mut named = tensors(&noisy.batch)?;
        for (name, tensor) in [("x", &noisy.x), ("sigma", &noisy.sigma), ("weight", &noisy.weight)] {
            named.insert(name.to_owned(), tensor.clone());
        }
        inputs.extend(below(i.to_string(), named));
    }
    Ok(candle_core::safetensors::save(&inputs, path)?)
}

fn read_tensor(path: &Path, name: &str) -> Result<Tensor> {
    let tensors = candle_core::safetensors::load(path, &Device::Cpu)?;
    Ok(tensors.get(name).ok_or_else(|| format!("{} has no {name}", path.display()))?.clone())
}

fn relative_difference(ours: &Tensor, theirs: &Tensor) -> Result<f64> {
    let largest = |x: Tensor| -> Result<f64> { Ok(f64::from(x.abs()?.max_all()?.to_scalar::<f32>()?)) };
    Ok(largest((ours - theirs)?)? / largest(theirs.clone())?)
}

fn describe(options: &Options, batches: &[Noisy], scene: &SceneBatch) {
    let share = |of: &dyn Fn(&Noisy) -> &Tensor| {
        let means = batches.iter().filter_map(|noisy| of(noisy).mean_all().ok()?.to_scalar::<f32>().ok());
        means.sum::<f32>() / batches.len() as f32
    };
    let dims: Vec<String> = batches.iter().skip(1).map(|noisy| noisy.batch.valid.dims()[1].to_string()).collect();
    println!(
        "{} threads; T = {}; A = {} and L = {} with padding; {:.0} % of states and {:.0} % of lanes are none; the \
         sampled scene has {} agents",
        n_threads(),
        scene.valid.dims()[2],
        dims.join(", "),
        batches[0].batch.lane_valid.dims()[1],
        100.0 * (1.0 - share(&|noisy| &noisy.batch.valid)),
        100.0 * (1.0 - share(&|noisy| &noisy.batch.lane_valid)),
        scene.valid.dims()[1],
    );
    println!("{} rounds of each, medians, after one that is not counted", options.n_rounds);
}

fn n_threads() -> usize {
    rayon::current_num_threads()
}

/// Times of both by the name of the call.
#[derive(Default)]
struct Table(BTreeMap<&'static str, Vec<(Elapsed, Elapsed)>>);

impl Table {
    fn add(&mut self, name: &'static str, ours: Elapsed, theirs: Elapsed) {
        self.0.entry(name).or_default().push((ours, theirs));
    }

    /// The medians of all rounds but the first.
    fn print(&self, name: &str, title: &str) {
        let rounds = self.0.get(name).map_or(&[][..], |rounds| &rounds[1..]);
        let median = |of: &dyn Fn(&(Elapsed, Elapsed)) -> f64| {
            let mut values: Vec<f64> = rounds.iter().map(of).collect();
            values.sort_by(f64::total_cmp);
            values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
        };
        let cell = |wall: f64, cpu: f64| format!("{wall:.3} ({cpu:.3})");
        println!(
            "{title:<38} {:>18} {:>18} {:>18}",
            cell(median(&|(ours, _)| ours.wall_s), median(&|(ours, _)| ours.cpu_s)),
            cell(median(&|(_, theirs)| theirs.wall_s), median(&|(_, theirs)| theirs.cpu_s)),
            cell(median(&|(a, b)| a.wall_s / b.wall_s), median(&|(a, b)| a.cpu_s / b.cpu_s)),
        );
    }
}

/// PyTorch in a process of its own, which waits while we are measured.
struct Peer {
    child: Child,
    requests: ChildStdin,
    answers: BufReader<ChildStdout>,
}

impl Peer {
    fn start(python: &str, folder: &Path) -> Result<Self> {
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("scripts/bench_network.py");
        let mut command = Command::new(python);
        command.arg(script).arg(folder).args(["--threads", &n_threads().to_string()]);
        let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn()?;
        let requests = child.stdin.take().ok_or("no way to ask the peer")?;
        let answers = BufReader::new(child.stdout.take().ok_or("no way to hear the peer")?);
        let mut peer = Self { child, requests, answers };
        println!("{}", peer.line()?.trim());
        Ok(peer)
    }

    fn line(&mut self) -> Result<String> {
        let mut line = String::new();
        if self.answers.read_line(&mut line)? == 0 {
            return Err(
                "scripts/bench_network.py ended; it needs torch, numpy and safetensors (--python PROGRAM)".into()
            );
        }
        Ok(line)
    }

    fn ask(&mut self, request: &str) -> Result<Elapsed> {
        writeln!(self.requests, "{request}")?;
        self.requests.flush()?;
        let line = self.line()?;
        let seconds: Vec<f64> = line.split_whitespace().map(str::parse).collect::<std::result::Result<_, _>>()?;
        match seconds[..] {
            [wall_s, cpu_s] => Ok(Elapsed { wall_s, cpu_s }),
            _ => Err(format!("the peer said {line:?}, expected two numbers").into()),
        }
    }

    fn stop(self) -> Result<()> {
        let Self { mut child, requests, .. } = self;
        drop(requests);
        child.wait()?;
        Ok(())
    }
}
