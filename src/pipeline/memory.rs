//! How much memory does training or sampling need, and does the machine have it?
//!
//! The estimate counts the numbers of four bytes in networks, optimizer and results of operations by the closed forms
//! of [`NumberCounts`], and multiplies them with a measured overhead. pipelines/README.md compares it with measured
//! peaks.

use super::StageId;
use super::config::PipelineConfig;
use super::layout::Layout;
use super::stages::checkpoint_file;
use crate::engine::plan::{Action, PlannedStage};
use crate::engine::{DeviceChoice, Failure, Result};
use crate::ingest::usual_horizon;
use crate::model::{BehaviorClassifierConfig, DenoiserSpec, NetworkConfig, NumberCounts, SceneSize, TrainedModel};
use crate::nn::Compute;
use crate::store::SceneStore;

/// Bytes of a number.
const NUMBER: f64 = 4.0;
/// The program itself with its tables, and the scenes that it keeps, bytes.
const BASE: f64 = 60e6;
/// Copies of the parameters during training: themselves, gradients, two moments, their average, and the saved state.
const TRAINED_COPIES: f64 = 6.0;
/// Results and their gradients, with what the allocator keeps between them, per result of an operation. Measured.
const TRAINED_RESULTS: f64 = 2.2;
/// Agents of a busy scene, for use before scenes are ingested.
const N_AGENTS: usize = 16;

/// The memory of a stage, in bytes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StageMemory {
    /// The stage.
    pub stage: StageId,
    /// Bytes that do not depend on the batch.
    fixed: f64,
    /// Bytes per row of a batch.
    per_row: f64,
    /// Rows of a batch.
    batch_size: usize,
    /// The size of the scenes for which it is estimated.
    scene: SceneSize,
}

impl StageMemory {
    fn trained(stage: StageId, counts: NumberCounts, batch_size: usize, scene: SceneSize) -> Self {
        let fixed = BASE + NUMBER * TRAINED_COPIES * counts.parameters;
        Self { stage, fixed, per_row: NUMBER * TRAINED_RESULTS * counts.activations, batch_size, scene }
    }

    fn sampled(counts: NumberCounts, batch_size: usize, scene: SceneSize) -> Self {
        let (fixed, per_row) = (BASE + NUMBER * counts.parameters, NUMBER * counts.alive);
        Self { stage: StageId::Generate, fixed, per_row, batch_size, scene }
    }

    /// The total.
    pub fn bytes(&self) -> f64 {
        self.fixed + self.per_row * self.batch_size as f64
    }

    /// The estimate for people.
    pub fn describe(&self) -> String {
        let SceneSize { n_agents, n_timesteps, .. } = self.scene;
        format!("about {} of memory, with scenes of {n_agents} agents and {n_timesteps} timesteps", size(self.bytes()))
    }

    /// Refuses estimates beyond the limit.
    fn check(&self, limit: Limit) -> Result<()> {
        if self.bytes() <= limit.bytes {
            return Ok(());
        }
        let section = self.stage.kind().section;
        let fits = ((limit.bytes - self.fixed) / self.per_row).floor();
        let advice = match fits >= 1.0 {
            true => format!("set {section}.batch_size to {fits} or less, or choose a smaller network"),
            false => "not even a batch of one fits: choose a smaller network, or scenes of fewer agents".to_owned(),
        };
        Err(Failure::input_message(format_args!(
            "{section}.batch_size is {}, for which {} takes {}; {} {}",
            self.batch_size,
            self.stage,
            self.describe(),
            limit.whose,
            size(limit.bytes)
        ))
        .with_hint(format!("{advice}; a larger run.memory_limit_gb overrules this estimate")))
    }
}

/// The memory that stages may use.
#[derive(Clone, Copy)]
struct Limit {
    bytes: f64,
    /// The source of the limit, in words before the number.
    whose: &'static str,
}

/// The estimates of the stages that train or sample on the processor, in order.
pub fn estimate_memory(config: &PipelineConfig, layout: &Layout, stages: &[StageId]) -> Result<Vec<StageMemory>> {
    if config.run.device != DeviceChoice::Cpu {
        return Ok(Vec::new());
    }
    let sizes = Sizes::new(config, layout);
    stages.iter().filter_map(|stage| sizes.memory(*stage).transpose()).collect()
}

/// The sizes of networks and scenes, as far as they are known before anything runs.
struct Sizes<'a> {
    config: &'a PipelineConfig,
    layout: &'a Layout,
    /// Agents and timesteps of the largest ingested scene.
    largest: Option<(usize, usize)>,
}

impl<'a> Sizes<'a> {
    fn new(config: &'a PipelineConfig, layout: &'a Layout) -> Self {
        let largest = SceneStore::open(&layout.scenes).ok().and_then(|store| {
            let index = store.index();
            let n_agents = index.iter().map(|scene| scene.n_agents as usize).max()?;
            Some((n_agents, index.iter().map(|scene| scene.n_timesteps as usize).max()?))
        });
        Self { config, layout, largest }
    }

    /// The estimate of a stage; `None` if it neither trains nor samples.
    fn memory(&self, stage: StageId) -> Result<Option<StageMemory>> {
        let train = &self.config.train;
        let trained = |counts, batch_size, scene| Some(StageMemory::trained(stage, counts, batch_size, scene));
        Ok(match stage {
            StageId::TrainDenoiser => match &train.denoiser {
                Some(section) if section.checkpoint.is_none() => {
                    let resolved = section.resolve()?;
                    let scene = self.scene(resolved.max_agents, resolved.max_lanes, section.state_dim)?;
                    trained(resolved.network.number_counts(scene), resolved.common.batch_size, scene)
                }
                _ => None,
            },
            StageId::TrainDistill => match &train.distill {
                Some(section) if section.checkpoint.is_none() => self
                    .denoiser()?
                    .and_then(|(network, scene)| trained(network.number_counts(scene), section.batch_size, scene)),
                _ => None,
            },
            StageId::TrainClassifier => match &train.classifier {
                Some(section) if section.checkpoint.is_none() => {
                    let scene = self.scene(N_AGENTS, 0, None)?;
                    trained(BehaviorClassifierConfig::default().number_counts(scene), section.batch_size, scene)
                }
                _ => None,
            },
            StageId::TrainBaseline => match &train.baseline {
                Some(section) if section.checkpoint.is_none() => {
                    let resolved = section.resolve()?;
                    let scene = self.scene(resolved.max_agents, resolved.max_lanes, None)?;
                    trained(resolved.network.number_counts(scene), resolved.common.batch_size, scene)
                }
                _ => None,
            },
            StageId::Generate => match &self.config.generate {
                Some(section) => self.denoiser()?.map(|(network, scene)| {
                    StageMemory::sampled(network.number_counts(scene), section.batch_size, scene)
                }),
                None => None,
            },
            StageId::Ingest | StageId::Mine | StageId::Evaluate | StageId::Report => None,
        })
    }

    /// The largest scene that a network sees.
    fn scene(&self, max_agents: usize, n_lanes: usize, state_dim: Option<usize>) -> Result<SceneSize> {
        let (n_agents, n_timesteps) = match (self.largest, &self.config.ingest) {
            (Some(largest), _) => largest,
            (None, Some(ingest)) => (N_AGENTS.min(ingest.max_agents), usual_horizon(ingest)?.n_timesteps()),
            (None, None) => (N_AGENTS, 40),
        };
        Ok(SceneSize { n_agents: n_agents.min(max_agents), n_timesteps, n_lanes, state_dim: state_dim.unwrap_or(3) })
    }

    /// The denoiser's network and the scenes that it sees: as configured for its training, or from its checkpoint.
    /// `None` if neither is known.
    fn denoiser(&self) -> Result<Option<(NetworkConfig, SceneSize)>> {
        let path = match &self.config.train.denoiser {
            Some(section) => match &section.checkpoint {
                Some(path) => checkpoint_file(path),
                None => {
                    let resolved = section.resolve()?;
                    let scene = self.scene(resolved.max_agents, resolved.max_lanes, section.state_dim)?;
                    return Ok(Some((resolved.network, scene)));
                }
            },
            None => checkpoint_file(&self.layout.denoiser),
        };
        // Errors are reported by the stage that reads the model.
        let Ok(TrainedModel { spec, .. }) = TrainedModel::<DenoiserSpec>::read(&path, &Compute::cpu()) else {
            return Ok(None);
        };
        let scene = self.scene(spec.max_agents, spec.max_lanes, Some(spec.normalizer.state_dim))?;
        Ok(Some((spec.network, scene)))
    }
}

/// Refuses planned stages that would need more than `run.memory_limit_gb`, or than the `machine` bytes of memory if
/// that is not set.
///
/// # Errors
/// Names the setting, the estimate, the limit, and which settings to lower.
pub fn check_memory(
    config: &PipelineConfig,
    layout: &Layout,
    planned: &[PlannedStage<'_>],
    machine: Option<u64>,
) -> Result<()> {
    let Some(limit) = limit(config, machine) else { return Ok(()) };
    let run = planned.iter().filter(|planned| planned.action != Action::Reuse);
    let run: Vec<StageId> = run.filter_map(|planned| StageId::of(planned.stage.kind())).collect();
    estimate_memory(config, layout, &run)?.iter().try_for_each(|memory| memory.check(limit))
}

/// The configured limit, or else that of the machine, bytes.
fn limit(config: &PipelineConfig, machine: Option<u64>) -> Option<Limit> {
    let set = config.run.memory_limit_gb.map(|gb| Limit { bytes: 1e9 * gb, whose: "run.memory_limit_gb allows" });
    set.or(machine.map(|bytes| Limit { bytes: bytes as f64, whose: "this machine has" }))
}

/// The memory that the process may use, bytes: the lowest limit of its control groups, or all memory of the machine.
/// `None` if the system does not report it.
pub fn machine_memory() -> Option<u64> {
    memory_limit(&|path| fs_err::read_to_string(path).ok())
}

/// [`machine_memory`], with `read` giving the content of a file.
fn memory_limit(read: &dyn Fn(&str) -> Option<String>) -> Option<u64> {
    let total = read("/proc/meminfo").and_then(|text| {
        let line = text.lines().find_map(|line| line.strip_prefix("MemTotal:"))?.trim().to_owned();
        line.strip_suffix("kB")?.trim().parse::<u64>().ok()?.checked_mul(1024)
    });
    let groups = read("/proc/self/cgroup").unwrap_or_default();
    let mut limits: Vec<u64> = total.into_iter().collect();
    for line in groups.lines() {
        let mut parts = line.splitn(3, ':').skip(1);
        let (Some(controllers), Some(path)) = (parts.next(), parts.next()) else { continue };
        let (root, file) = match controllers {
            "" => ("/sys/fs/cgroup", "memory.max"),
            "memory" => ("/sys/fs/cgroup/memory", "memory.limit_in_bytes"),
            _ => continue,
        };
        // A group has no more memory than those around it. "max" is not a number and means no limit.
        let mut path = path.trim_end_matches('/');
        loop {
            limits.extend(read(&format!("{root}{path}/{file}")).and_then(|text| text.trim().parse::<u64>().ok()));
            match path.rsplit_once('/') {
                Some((parent, _)) => path = parent,
                None => break,
            }
        }
    }
    limits.into_iter().min()
}

/// `640 MB`, `12.3 GB`, `1.2e6 GB`.
fn size(bytes: f64) -> String {
    match bytes {
        b if b < 1e9 => format!("{:.0} MB", b / 1e6),
        b if b < 1e15 => format!("{:.1} GB", b / 1e9),
        b => format!("{:.1e} GB", b / 1e9),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::plan as graph;
    use crate::pipeline::stages;
    use std::collections::BTreeMap;
    use std::path::Path;

    fn config(text: &str) -> PipelineConfig {
        toml::from_str(text).unwrap()
    }

    fn check(text: &str, machine: u64) -> Result<()> {
        let (config, dir) = (config(text), tempfile::tempdir().unwrap());
        let layout = Layout::below(dir.path());
        let planned = graph::plan(dir.path(), &crate::pipeline::KINDS, stages::of_pipeline(&config, &layout)?, &[])?;
        check_memory(&config, &layout, &planned, Some(machine))
    }

    #[test]
    fn what_cannot_fit_is_refused_with_what_would() {
        let recordings = format!("{}/tests/fixtures/recordings/argoverse1", env!("CARGO_MANIFEST_DIR"));
        let text = |batch_size: u64| {
            format!(
                "[ingest]\ndataset = 'argoverse1'\ninputs = ['{recordings}']
                [train.denoiser]\nbatch_size = {batch_size}\n[generate]\nbatch_size = {batch_size}
                [[generate.sweeps]]\nname = 'plain'\nn_scenes = 1"
            )
        };
        check(&text(16), 8 << 30).unwrap();
        let failure = check(&text(10_000), 8 << 30).unwrap_err();
        assert_eq!(failure.blame, crate::engine::Blame::Input);
        let message = format!("{:#}", failure.error);
        for part in ["train.denoiser.batch_size is 10000", "16 agents and 50 timesteps", "this machine has 8.6 GB"] {
            assert!(message.contains(part), "{message}");
        }
        let hint = failure.hint.unwrap();
        let fits: u64 = hint.split(' ').find_map(|word| word.parse().ok()).unwrap();
        assert!(check(&text(fits), 8 << 30).is_ok() && check(&text(fits + 1), 8 << 30).is_err(), "{hint}");
        let failure = check(&text(1), 100 << 20).unwrap_err();
        assert!(failure.hint.unwrap().contains("not even a batch of one fits"));
    }

    #[test]
    fn the_limit_that_is_set_counts_in_place_of_the_machine() {
        let text = |limit_gb: f64| {
            format!("[run]\nmemory_limit_gb = {limit_gb}\n[train.baseline]\nbatch_size = 64\npreset = 'small'")
        };
        let takes = estimate_memory(&config(&text(1.0)), &Layout::below(Path::new("/nowhere")), &StageId::ALL).unwrap();
        let takes_gb = takes[0].bytes() / 1e9;
        let check =
            |limit_gb: f64, machine: u64| takes[0].check(limit(&config(&text(limit_gb)), Some(machine)).unwrap());
        check(takes_gb + 0.01, 1).unwrap();
        let failure = check(takes_gb - 0.01, u64::MAX).unwrap_err();
        assert!(format!("{:#}", failure.error).contains("run.memory_limit_gb allows"), "{:#}", failure.error);
        assert!(failure.hint.unwrap().ends_with("a larger run.memory_limit_gb overrules this estimate"));
        assert!(limit(&config(""), None).is_none());
    }

    #[test]
    fn stages_without_networks_are_not_estimated_and_checkpoints_are_not_trained() {
        let layout = Layout::below(Path::new("/nowhere"));
        let stages = |text: &str| -> Vec<StageId> {
            let found = estimate_memory(&config(text), &layout, &StageId::ALL).unwrap();
            found.iter().map(|found| found.stage).collect()
        };
        let model = format!("{}/pipelines/models/geometric.safetensors", env!("CARGO_MANIFEST_DIR"));
        assert_eq!(
            stages("[mine]\n[evaluate]\n[train.classifier]\n[train.baseline]"),
            [StageId::TrainClassifier, StageId::TrainBaseline]
        );
        let checkpoint = format!("[train.denoiser]\ncheckpoint = '{model}'\n[train.distill]\n[generate]");
        assert_eq!(stages(&checkpoint), [StageId::TrainDistill, StageId::Generate]);
        assert_eq!(stages("[run]\ndevice = 'cuda'\n[train.denoiser]"), []);
        assert_eq!(stages("[generate]"), [], "there is no denoiser to tell");
    }

    #[test]
    fn the_least_limit_counts() {
        let limit = |files: &[(&str, &str)]| {
            let files: BTreeMap<&str, &str> = files.iter().copied().collect();
            memory_limit(&|path| files.get(path).map(|text| (*text).to_owned()))
        };
        let total = ("/proc/meminfo", "MemTotal:       16000 kB\nMemFree:  2 kB\n");
        assert_eq!((limit(&[]), limit(&[total])), (None, Some(16_384_000)));
        let group = ("/proc/self/cgroup", "0::/user/job\n");
        let job = |text| ("/sys/fs/cgroup/user/job/memory.max", text);
        assert_eq!(limit(&[total, group, job("max\n")]), Some(16_384_000));
        assert_eq!(limit(&[total, group, job("1000\n")]), Some(1000));
        let around = ("/sys/fs/cgroup/user/memory.max", "900\n");
        assert_eq!(limit(&[total, group, job("1000\n"), around]), Some(900));
        assert_eq!(limit(&[total, ("/proc/self/cgroup", "0::/\n"), ("/sys/fs/cgroup/memory.max", "800")]), Some(800));
        let first = [
            ("/proc/self/cgroup", "3:cpu:/x\n7:memory:/x\n"),
            ("/sys/fs/cgroup/memory/x/memory.limit_in_bytes", "700"),
        ];
        assert_eq!(limit(&[total, first[0], first[1]]), Some(700));
    }

    #[test]
    fn sizes_are_short() {
        assert_eq!([64e6, 8.6e9, 3.2e17].map(size), ["64 MB", "8.6 GB", "3.2e8 GB"]);
    }
}
