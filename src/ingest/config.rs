//! The `[ingest]` section: which recordings become scenes, and how much of each is kept.

use super::error::Error;
use super::files::split_of_path;
use super::table::TableMapping;
use crate::files::paths_as_text;
use crate::scene::{Dataset, Split};
use crate::settings::{self, Issue};
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Configuration of an ingest.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct IngestConfig {
    /// The dataset that the inputs belong to.
    #[schemars(schema_with = "dataset_schema")]
    pub dataset: Dataset,
    /// Folders, archives (`.zip`, `.tar`, `.tar.gz`, `.tgz`) and files (also `.gz`) to read, as downloaded; with the
    /// feature `cloud`, also such in object stores (`s3://bucket/x.zip`, `gs://bucket/folder`).
    #[serde(serialize_with = "paths_as_text")]
    pub inputs: Vec<PathBuf>,
    /// With `dataset = "table"`: what the columns of the recordings mean.
    #[serde(default)]
    pub table: Option<TableMapping>,
    /// Whether scenes must have maps.
    #[serde(default)]
    pub maps: MapsConfig,
    /// Where to look for maps; empty: among `inputs`. Lanelet2 maps that have latitude and longitude alone have their
    /// origin at the southwest corner of their lanes.
    #[serde(default, serialize_with = "paths_as_text")]
    pub map_inputs: Vec<PathBuf>,
    /// The splits to keep; empty: all.
    #[serde(default)]
    #[schemars(schema_with = "splits_schema")]
    pub splits: Vec<Split>,
    /// The places to keep (cities, or INTERACTION's locations); empty: all.
    #[serde(default)]
    #[schemars(extend("uniqueItems" = true))]
    pub places: Vec<String>,
    /// Observed timesteps of a scene; default: the dataset's (INTERACTION, CommonRoad and tables 10,
    /// Argoverse 1 20, Argoverse 2 50, Waymo Open Motion 11).
    #[serde(default)]
    #[schemars(range(min = 1, max = 10_000))]
    pub n_history: Option<usize>,
    /// Future timesteps of a scene; default: the dataset's (INTERACTION, Argoverse 1,
    /// CommonRoad and tables 30, Argoverse 2 60, Waymo Open Motion 80).
    #[serde(default)]
    #[schemars(range(max = 10_000))]
    pub n_future: Option<usize>,
    /// INTERACTION v1.1 recordings, CommonRoad and tables: timesteps between the starts of consecutive scenes.
    #[serde(default = "default_window_stride")]
    #[schemars(range(min = 1, max = 1_000_000))]
    pub window_stride: usize,
    /// INTERACTION v1.1 recordings and tables: the last share of each recording becomes the val split; scenes across
    /// the cut are dropped.
    #[serde(default = "default_holdout_share")]
    #[schemars(range(min = 0.0, max = 1.0))]
    pub holdout_share: f64,
    /// Argoverse 1: whether tracks, which are recorded with decimeters of noise and at uneven times, are smoothed and
    /// resampled to even times. Default true; false keeps one recorded position per timestep, as in the benchmarks.
    #[serde(default = "default_smooth_tracks")]
    pub smooth_tracks: bool,
    /// Agents of a scene: of those at present, without static objects, the nearest to the ego are kept, the ego always.
    #[serde(default = "default_max_agents")]
    #[schemars(range(min = 1, max = 10_000))]
    pub max_agents: usize,
    /// Lanes with any point within this distance of the ego's present position belong to the scene, and those that any
    /// agent of it can reach, meters.
    #[serde(default = "default_map_radius_m")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub map_radius_m: f64,
    /// Stop after this many scenes; default: no limit.
    #[serde(default)]
    #[schemars(range(min = 1, max = 1_000_000_000_000_u64))]
    pub limit: Option<u64>,
    /// Seed of the choice of an ego if the recording marks none: that of the run.
    #[serde(skip)]
    pub seed: u64,
}

/// Whether scenes must have maps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum MapsConfig {
    /// A place without a map is an error, and a scene without lanes a reject.
    #[default]
    Required,
    /// Maps are not read; scenes have no lanes.
    None,
}

impl IngestConfig {
    /// The default configuration for these inputs.
    pub const fn new(dataset: Dataset, inputs: Vec<PathBuf>) -> Self {
        Self {
            dataset,
            inputs,
            table: None,
            maps: MapsConfig::Required,
            map_inputs: Vec::new(),
            splits: Vec::new(),
            places: Vec::new(),
            n_history: None,
            n_future: None,
            window_stride: default_window_stride(),
            holdout_share: default_holdout_share(),
            smooth_tracks: default_smooth_tracks(),
            max_agents: default_max_agents(),
            map_radius_m: default_map_radius_m(),
            limit: None,
            seed: 0,
        }
    }

    /// Whether scenes of this split are kept.
    pub fn wants_split(&self, split: Split) -> bool {
        self.splits.is_empty() || self.splits.contains(&split)
    }

    /// Whether recordings at this path are read, by the split that its folders name.
    pub(super) fn wants_path(&self, path: &str) -> bool {
        split_of_path(path).is_none_or(|split| self.wants_split(split))
    }

    /// Whether scenes of this place are kept.
    pub fn wants_place(&self, place: &str) -> bool {
        self.places.is_empty() || self.places.iter().any(|wanted| wanted == place)
    }

    /// Whether maps are read.
    pub fn wants_maps(&self) -> bool {
        self.maps == MapsConfig::Required
    }

    /// Refuses values that cannot work, whatever the inputs hold.
    pub fn validate(&self) -> Result<(), Error> {
        let refuse = |key, detail: &str| Err(Error::Config { key: String::from(key), detail: detail.to_owned() });
        if self.inputs.is_empty() {
            return refuse("inputs", "is empty; name at least one folder, archive or file");
        }
        if (1..self.inputs.len()).any(|i| self.inputs[..i].contains(&self.inputs[i])) {
            return refuse("inputs", "names an input twice; its scenes would not be unique");
        }
        match (&self.table, self.dataset) {
            (Some(table), Dataset::Table) => table.validate()?,
            (Some(_), _) => return refuse("table", "is for dataset = \"table\" alone"),
            (None, _) => {}
        }
        settings::check_ranges(self).map_err(|Issue { key, message }| Error::Config { key, detail: message })?;
        super::source_of(self).map(drop)
    }
}

const fn default_window_stride() -> usize {
    40
}

const fn default_holdout_share() -> f64 {
    0.2
}

const fn default_smooth_tracks() -> bool {
    true
}

const fn default_max_agents() -> usize {
    64
}

const fn default_map_radius_m() -> f64 {
    100.0
}

fn dataset_schema(_: &mut SchemaGenerator) -> Schema {
    json_schema!({ "type": "string", "enum": Dataset::ALL.map(Dataset::name) })
}

fn splits_schema(_: &mut SchemaGenerator) -> Schema {
    let names = Split::ALL.map(Split::name);
    json_schema!({ "type": "array", "items": { "type": "string", "enum": names }, "uniqueItems": true })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_of_the_file_are_those_of_the_constructor() {
        let config: IngestConfig =
            toml::from_str("dataset = \"argoverse1\"\ninputs = [\"train.tar.gz\"]").expect("two keys suffice");
        assert_eq!(config, IngestConfig::new(Dataset::Argoverse1, vec!["train.tar.gz".into()]));
        config.validate().expect("defaults are valid");
    }
}
