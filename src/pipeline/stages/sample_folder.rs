//! What does the folder of generated scenarios hold? Shards with what is known of each, the plan, and a manifest last.

use crate::generate::{Plan, RejectedSample, ShardOutput, Shortfall};
use crate::pipeline::{Classify, Result};
use crate::store::{
    FileStamp, MapSource, ScenarioRecord, read_json, read_samples, remove_partials, write_json_atomically,
    write_samples,
};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// What is known of a finished shard; written beside it, after it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SampleSidecar {
    /// Name of the shard's file.
    pub file: String,
    /// Its size and hash.
    pub stamp: FileStamp,
    /// Name of the sweep.
    pub sweep: String,
    /// Calls of the denoiser for one sample.
    pub n_evaluations: u64,
    /// Number of scenarios in it.
    pub n_scenarios: u64,
    /// How many of them are verified.
    pub n_verified: u64,
    /// Samples that came to nothing.
    pub rejected: Vec<RejectedSample>,
    /// Number of samples that the sweep's selection left out, by reason.
    pub unselected: BTreeMap<String, u64>,
}

/// The last file written to the folder.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct SampleManifest {
    /// The finished shards, in the order of the plan; those of a sweep that was stopped early are missing.
    pub shards: Vec<SampleSidecar>,
    /// Number of scenarios.
    pub n_scenarios: u64,
    /// How many of them are verified.
    pub n_verified: u64,
    /// Number of samples that came to nothing.
    pub n_rejected: u64,
    /// Number of samples that selections left out, by sweep and reason.
    pub unselected: BTreeMap<String, BTreeMap<String, u64>>,
    /// How they were sampled.
    pub sampled_with: SampledWith,
}

/// How scenarios were sampled.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct SampledWith {
    /// Fingerprint of the denoiser.
    pub denoiser: String,
    /// Fingerprint of the distilled denoiser, where a sweep is of it.
    #[serde(default)]
    pub distilled: Option<String>,
    /// Fingerprint of the classifier, where there was one.
    pub classifier: Option<String>,
    /// Fingerprint of the baseline, where a sweep is of it.
    pub baseline: Option<String>,
    /// Sweeps for which fewer scenes fit than were asked for.
    pub shortfalls: Vec<Shortfall>,
}

/// A folder of generated scenarios.
#[derive(Debug)]
pub struct SampleFolder {
    dir: PathBuf,
}

impl SampleFolder {
    /// Makes the folder, or takes up an unfinished one.
    pub(super) fn open_for_writing(dir: &Path) -> Result<Self> {
        fs_err::create_dir_all(dir)?;
        remove_partials(dir)?;
        Ok(Self { dir: dir.to_owned() })
    }

    /// The plan of an interrupted run, if there is one.
    pub(super) fn plan(&self) -> Option<Plan> {
        read_json(&self.dir.join(PLAN_FILE)).ok()
    }

    /// Keeps the plan.
    pub(super) fn write_plan(&self, plan: &Plan) -> Result<()> {
        write_json_atomically(&self.dir.join(PLAN_FILE), plan)?;
        Ok(())
    }

    /// What is known of shard `idx`, if it is finished.
    pub(super) fn finished(&self, idx: usize) -> Option<SampleSidecar> {
        let sidecar: SampleSidecar = read_json(&self.dir.join(format!("{}.json", shard_name(idx)))).ok()?;
        let n_bytes = fs_err::metadata(self.dir.join(&sidecar.file)).ok()?.len();
        (n_bytes == sidecar.stamp.n_bytes).then_some(sidecar)
    }

    /// Writes shard `idx` of the plan, of the sweep of this name and this many evaluations of the denoiser a sample.
    pub(super) fn write_shard(
        &self,
        idx: usize,
        (sweep, n_evaluations): (&str, u64),
        output: ShardOutput,
    ) -> Result<SampleSidecar> {
        let name = shard_name(idx);
        let file = format!("{name}.parquet");
        let ShardOutput { records, rejected, unselected } = output;
        let stamp = write_samples(&self.dir.join(&file), &records)?;
        let n_verified = records.iter().filter(|record| record.verified).count() as u64;
        let sweep = sweep.to_owned();
        let sidecar = SampleSidecar {
            file,
            stamp,
            sweep,
            n_evaluations,
            n_scenarios: records.len() as u64,
            n_verified,
            rejected,
            unselected,
        };
        write_json_atomically(&self.dir.join(format!("{name}.json")), &sidecar)?;
        Ok(sidecar)
    }

    /// Declares the folder whole.
    pub(super) fn write_manifest(
        &self,
        shards: Vec<SampleSidecar>,
        sampled_with: SampledWith,
    ) -> Result<SampleManifest> {
        let mut unselected: BTreeMap<String, BTreeMap<String, u64>> = BTreeMap::new();
        for shard in shards.iter().filter(|shard| !shard.unselected.is_empty()) {
            let of_sweep = unselected.entry(shard.sweep.clone()).or_default();
            shard.unselected.iter().for_each(|(reason, n)| *of_sweep.entry(reason.clone()).or_default() += n);
        }
        let manifest = SampleManifest {
            unselected,
            n_scenarios: shards.iter().map(|shard| shard.n_scenarios).sum(),
            n_verified: shards.iter().map(|shard| shard.n_verified).sum(),
            n_rejected: shards.iter().map(|shard| shard.rejected.len() as u64).sum(),
            shards,
            sampled_with,
        };
        write_json_atomically(&self.dir.join(MANIFEST_FILE), &manifest)?;
        Ok(manifest)
    }
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
    ///
    /// # Errors
    /// When the shard is damaged.
    pub fn read_shard(dir: &Path, shard: &SampleSidecar, maps: &dyn MapSource) -> Result<Vec<ScenarioRecord>> {
        Ok(read_samples(&dir.join(&shard.file), maps)?)
    }
}

const PLAN_FILE: &str = "plan.json";
const MANIFEST_FILE: &str = "manifest.json";

fn shard_name(idx: usize) -> String {
    format!("samples-{idx:05}")
}
