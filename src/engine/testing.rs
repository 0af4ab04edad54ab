//! Kinds of stages for tests, which write a few lines each.

use super::kind::{ShardNames, StageKind};

const fn plain(name: &'static str, section: &'static str, outputs: &'static [&'static str]) -> StageKind {
    StageKind {
        name,
        command: section,
        section,
        places: &["inputs", "checkpoint", "data.scenes"],
        trains: false,
        computes: false,
        outputs,
        is_checked_by_readers: false,
        shards: None,
    }
}

pub(super) static KINDS: [StageKind; 5] = [
    StageKind { is_checked_by_readers: true, ..plain("ingest", "ingest", &["scenes"]) },
    plain("mine", "mine", &["events.parquet", "mining.json"]),
    StageKind { trains: true, ..plain("train_denoiser", "train.denoiser", &["denoiser"]) },
    StageKind {
        shards: Some(ShardNames {
            shard: "samples",
            ending: "parquet",
            is_other: |name| name.starts_with("request-") && name.ends_with("3.json"),
        }),
        ..plain("generate", "generate", &["samples"])
    },
    plain("evaluate", "evaluate", &["corpus", "metrics.json"]),
];

pub(super) fn kind(name: &str) -> &'static StageKind {
    KINDS.iter().find(|kind| kind.name == name).unwrap()
}
