//! The folder of generated scenarios: shards, the decisions on them, and a manifest.

use crate::engine::{Classify, Failure, Result};
use crate::files::{files_below, link_or_copy};
use crate::generate::{
    GenerateConfig, Plan, Pool, RejectedSample, Rejection, RequestSummary, Round, RoundShard, ShardOutput, ShardPlan,
    ShardTally, Shortfall,
};
use crate::metrics::MetricSettings;
use crate::pipeline::stages::MineConfig;
use crate::scenario::{RequestTag, ScenarioRecord};
use crate::store::{
    FileStamp, MapSource, SceneStore, read_if_whole, read_json, read_samples, write_atomically, write_json_atomically,
    write_samples,
};
use serde::{Deserialize, Serialize};
use std::io::Write;
use std::path::{Path, PathBuf};

/// The record of a finished shard.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SampleSidecar {
    /// Name of the shard's file.
    pub file: String,
    /// Its size and hash.
    pub stamp: FileStamp,
    /// Name of the sweep.
    pub sweep: String,
    /// Evaluations of the denoiser for one sample.
    pub n_evaluations: u64,
    /// Number of scenarios in it.
    pub n_scenarios: u64,
    /// The number of verified ones.
    pub n_verified: u64,
    /// Samples without a scenario.
    pub rejected: Vec<RejectedSample>,
    /// Its tally, if it belongs to a request.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub request: Option<ShardTally>,
}

/// A shard of a request with the decisions on its scenarios.
pub(super) struct DecidedShard {
    /// Its index.
    pub(super) idx: usize,
    /// Its record, with its tally, from before the table has the decisions.
    pub(super) sidecar: SampleSidecar,
    /// The decision on each scenario.
    pub(super) tags: Vec<RequestTag>,
}

/// The last file written to the folder.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct SampleManifest {
    /// The finished shards, in the order of the plan.
    pub shards: Vec<SampleSidecar>,
    /// Number of scenarios.
    pub n_scenarios: u64,
    /// The number of verified ones.
    pub n_verified: u64,
    /// Number of samples that did not become scenarios, without those that would have repeated another.
    pub n_rejected: u64,
    /// The models and settings with which they were sampled.
    pub sampled_with: SampledWith,
}

/// The scenes and models from which scenarios were sampled.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct SampledWith {
    /// Fingerprint of the scene store.
    pub scenes: String,
    /// Fingerprint of the denoiser.
    pub denoiser: String,
    /// Fingerprint of the distilled denoiser, if a sweep uses it.
    #[serde(default)]
    pub distilled: Option<String>,
    /// Fingerprint of the classifier, if there was one.
    pub classifier: Option<String>,
    /// Fingerprint of the baseline, if a sweep uses it.
    pub baseline: Option<String>,
    /// Sweeps with fewer suitable scenes than requested.
    pub shortfalls: Vec<Shortfall>,
    /// The number of sampled scenes that models of the run learned from, as `generate.splits` wanted it.
    #[serde(default)]
    pub n_learned: usize,
}

impl SampledWith {
    /// A caution about figures that are not those of held-out scenes.
    pub fn caution(&self) -> Option<String> {
        let n = self.n_learned;
        (n > 0).then(|| {
            format!(
                "models of this run learned from {n} of the scenes that are sampled, as generate.splits wants it: \
                 figures say nothing about scenes that are held out"
            )
        })
    }
}

/// A folder of generated scenarios that is being written.
#[derive(Debug)]
pub(super) struct SampleFolder {
    dir: PathBuf,
}

impl SampleFolder {
    pub(super) fn create(dir: &Path) -> Result<Self> {
        fs_err::create_dir_all(dir)?;
        Ok(Self { dir: dir.to_owned() })
    }

    /// Saves the settings, so that the folder can be understood, and its scenarios generated again, without the run's
    /// configuration.
    pub(super) fn write_settings(&self, settings: &SampleSettings) -> Result<()> {
        let text = toml::to_string(settings).map_err(anyhow::Error::from)?;
        write_atomically::<std::io::Error>(&self.dir.join(SETTINGS_FILE), |file| file.write_all(text.as_bytes()))?;
        Ok(())
    }

    /// Saves the plan of the sweeps.
    pub(super) fn write_plan(&self, plan: &Plan) -> Result<()> {
        write_json_atomically(&self.dir.join(PLAN_FILE), plan)?;
        Ok(())
    }

    pub(super) fn write_requests(&self, requests: &[RequestSummary]) -> Result<()> {
        write_json_atomically(&self.dir.join(REQUESTS_FILE), &requests)?;
        Ok(())
    }

    /// Saves the cells of requests, and the decided rounds from the folder `made`.
    pub(super) fn take_rounds(&self, made: &Path, pools: &[Pool]) -> Result<()> {
        for (request, pool) in pools.iter().enumerate() {
            write_json_atomically(&self.dir.join(pool_file(request)), pool)?;
        }
        let names = files_below(made)?.into_iter().filter_map(|name| Some(name.to_str()?.to_owned()));
        names.filter(|name| is_round_file(name)).try_for_each(|name| self.take(made, &name))
    }

    /// Moves a file here from the folder `made`.
    pub(super) fn take(&self, made: &Path, file: &str) -> Result<()> {
        Ok(link_or_copy(&made.join(file), &self.dir.join(file))?)
    }

    /// Rewrites the table of a shard of a request in the folder `made`, with the decisions on its scenarios.
    pub(super) fn write_decided(
        &self,
        made: &Path,
        DecidedShard { idx, sidecar, tags }: DecidedShard,
        store: &SceneStore,
    ) -> Result<SampleSidecar> {
        let mut records = read_samples(&made.join(&sidecar.file), store)?;
        records.iter_mut().zip(tags).for_each(|(record, tag)| record.request = Some(tag));
        let SampleSidecar { sweep, n_evaluations, rejected, request, .. } = sidecar;
        let output = ShardOutput { records, rejected };
        let written = write_table(&self.dir, idx, (&sweep, n_evaluations), output)?;
        Ok(SampleSidecar { request, ..written })
    }

    /// Declares the folder whole.
    pub(super) fn write_manifest(
        &self,
        shards: Vec<SampleSidecar>,
        sampled_with: SampledWith,
    ) -> Result<SampleManifest> {
        let rejected = shards.iter().flat_map(|shard| &shard.rejected);
        let manifest = SampleManifest {
            n_scenarios: shards.iter().map(|shard| shard.n_scenarios).sum(),
            n_verified: shards.iter().map(|shard| shard.n_verified).sum(),
            n_rejected: rejected.filter(|it| it.reason != Rejection::RepeatedTemplate).count() as u64,
            shards,
            sampled_with,
        };
        write_json_atomically(&self.dir.join(MANIFEST_FILE), &manifest)?;
        Ok(manifest)
    }
}

/// Writes the table of shard `idx` into the folder `dir` and returns its record. `sweep` names its sweep, which takes
/// this many evaluations of the denoiser per sample.
pub(super) fn write_table(
    dir: &Path,
    idx: usize,
    (sweep, n_evaluations): (&str, u64),
    ShardOutput { records, rejected }: ShardOutput,
) -> Result<SampleSidecar> {
    let file = format!("{}.parquet", shard_name(idx));
    Ok(SampleSidecar {
        stamp: write_samples(&dir.join(&file), &records)?,
        file,
        sweep: sweep.to_owned(),
        n_evaluations,
        n_scenarios: records.len() as u64,
        n_verified: records.iter().filter(|record| record.verified).count() as u64,
        rejected,
        request: None,
    })
}

/// Round `round` of request `request` in the folder `dir`, if it has been decided.
pub(super) fn read_round(dir: &Path, request: usize, round: usize) -> Result<Option<Round>> {
    Ok(read_if_whole(&dir.join(round_file(request, round)))?)
}

/// Saves the decisions on a round in the folder `dir`.
pub(super) fn write_round(dir: &Path, request: usize, round: &Round) -> Result<()> {
    write_json_atomically(&dir.join(round_file(request, round.round)), round)?;
    Ok(())
}

impl SampleManifest {
    /// Reads the manifest of a finished folder.
    ///
    /// # Errors
    /// When the folder is not finished.
    pub fn read(dir: &Path) -> Result<Self> {
        let path = dir.join(MANIFEST_FILE);
        if dir.is_dir() && !path.exists() {
            return Err(crate::store::Error::Unfinished { dir: dir.to_owned() }.into());
        }
        read_json(&path).blame_input()
    }

    /// Reads the scenarios of a shard; lanes come from `maps`.
    pub fn read_shard(dir: &Path, shard: &SampleSidecar, maps: &dyn MapSource) -> Result<Vec<ScenarioRecord>> {
        let path = dir.join(&shard.file);
        shard.stamp.verify_file(&path).map_err(|error| {
            Failure::from(error)
                .with_hint("the file was changed or the disk is failing; sample again with --redo generate")
        })?;
        Ok(read_samples(&path, maps)?)
    }
}

/// The settings with which scenarios were sampled: `settings.toml` in their folder.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct SampleSettings {
    /// The definitions of the behaviors by which they are verified.
    pub mine: MineConfig,
    /// The section of the stage.
    pub generate: GenerateConfig,
    /// The settings by which metrics judged, if they affected the choice of samples and were not the defaults.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub metric_settings: Option<MetricSettings>,
}

impl SampleSettings {
    /// Reads the settings of a folder.
    ///
    /// # Errors
    /// When there are none, or they are of another version.
    pub fn read(dir: &Path) -> Result<Self> {
        let path = dir.join(SETTINGS_FILE);
        let text = fs_err::read_to_string(&path).blame_fault()?;
        toml::from_str(&text).map_err(|error| anyhow::anyhow!("{}: {error}", path.display())).blame_fault()
    }
}

/// The figures of requests; none if the folder has no requests.
pub fn read_requests(dir: &Path) -> Result<Vec<RequestSummary>> {
    let path = dir.join(REQUESTS_FILE);
    if path.exists() { read_json(&path).blame_fault() } else { Ok(Vec::new()) }
}

/// The plan of shard `idx` of a folder: from the plan of its sweeps, or from a round of a request.
pub(in crate::pipeline) fn find_shard(dir: &Path, idx: usize) -> Result<FoundShard> {
    let plan: Plan = read_json(&dir.join(PLAN_FILE)).blame_fault()?;
    if let Some(shard) = plan.shards.into_iter().find(|shard| shard.idx == idx) {
        return Ok(FoundShard::OfSweep(shard));
    }
    for request in 0.. {
        let Ok(pool) = read_json::<Pool>(&dir.join(pool_file(request))) else { break };
        for number in 0.. {
            let Ok(mut round) = read_json::<Round>(&dir.join(round_file(request, number))) else { break };
            if let Some(at) = round.shards.iter().position(|shard| shard.plan.idx == idx) {
                let shard = round.shards.swap_remove(at);
                return Ok(FoundShard::OfRequest { request, round: number, pool, shard });
            }
        }
    }
    Err(Failure::fault(anyhow::anyhow!("{} has no plan of shard {idx}", dir.display())))
}

/// Where a shard comes from.
pub(in crate::pipeline) enum FoundShard {
    /// From the plan of the sweeps.
    OfSweep(ShardPlan),
    /// From a round of a request.
    OfRequest {
        request: usize,
        round: usize,
        /// The request's cells.
        pool: Pool,
        shard: RoundShard,
    },
}

const PLAN_FILE: &str = "plan.json";
const SETTINGS_FILE: &str = "settings.toml";
const REQUESTS_FILE: &str = "requests.json";
const MANIFEST_FILE: &str = "manifest.json";

fn pool_file(request: usize) -> String {
    format!("request-{request:02}-pool.json")
}

fn round_file(request: usize, round: usize) -> String {
    format!("request-{request:02}-round-{round:05}.json")
}

/// Whether a file with this name holds the decisions on a round.
pub(in crate::pipeline) fn is_round_file(name: &str) -> bool {
    let numbers = name.strip_prefix("request-").and_then(|rest| rest.strip_suffix(".json")?.split_once("-round-"));
    let is_number = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    numbers.is_some_and(|(request, round)| is_number(request) && is_number(round))
}

pub(in crate::pipeline) fn shard_name(idx: usize) -> String {
    format!("samples-{idx:05}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::Blame;
    use crate::scene::{LaneGraph, LaneId, MapId};

    struct NoMaps;

    impl MapSource for NoMaps {
        fn map(&self, _: &MapId) -> crate::store::Result<LaneGraph> {
            Ok(LaneGraph::default())
        }

        fn lanes(&self, _: &MapId, _: &[LaneId]) -> crate::store::Result<LaneGraph> {
            Ok(LaneGraph::default())
        }
    }

    #[test]
    fn a_flipped_bit_of_a_shard_is_an_error() {
        let dir = tempfile::tempdir().unwrap();
        let output = ShardOutput { records: Vec::new(), rejected: Vec::new() };
        let sidecar = write_table(dir.path(), 3, ("sweep", 1), output).unwrap();
        assert!(SampleManifest::read_shard(dir.path(), &sidecar, &NoMaps).is_ok());
        let path = dir.path().join(&sidecar.file);
        let mut bytes = fs_err::read(&path).unwrap();
        let middle = bytes.len() / 2;
        bytes[middle] ^= 1;
        fs_err::write(&path, bytes).unwrap();
        let failure = SampleManifest::read_shard(dir.path(), &sidecar, &NoMaps).unwrap_err();
        assert_eq!(failure.blame, Blame::Fault);
        let said = format!("{failure:?}");
        assert!(said.contains(&sidecar.file) && said.contains("--redo generate"), "{said}");
    }
}
