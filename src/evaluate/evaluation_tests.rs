//! Does a shard get the same figures in any order of measuring, and do no files of rows stay behind?

use super::config::{EvaluateConfig, Keep};
use super::distinguishability::TrackPool;
use super::evaluation::{Evaluation, EvaluationFiles};
use super::gate_config::GatesConfig;
use super::measure::{MeasuredShard, Measurer, Shard, ShardFigures};
use super::summary::EvaluationSummary;
use crate::generate::{RejectedSample, Rejection};
use crate::metrics::MetricRow;
use crate::progress::Silent;
use crate::scenario::ScenarioRecord;
use crate::scene::{GuidanceLevel, Scene};
use crate::store::testing::{folder_bytes, record, scene};
use crate::store::{self, SceneStore, SceneWriter, read_binary, write_binary_atomically};
use serde_json::json;
use std::path::Path;

const N_SHARDS: usize = 3;

fn store(dir: &Path) -> (SceneStore, Vec<Scene>) {
    let scenes: Vec<Scene> = (0..4).map(|seed| scene(seed, None)).collect();
    let (mut writer, _) = SceneWriter::resume(dir).unwrap();
    writer.write_batch(&scenes, &[], Some(0), &json!(0)).unwrap();
    writer.finish(&json!({ "rejects": {} })).unwrap();
    (SceneStore::open(dir).unwrap(), scenes)
}

/// Two samples of each scene in every shard; later shards repeat the first.
fn records(scenes: &[Scene], shard: usize) -> Vec<ScenarioRecord> {
    let samples =
        scenes.iter().flat_map(|scene| [2 * shard, 2 * shard + 1].map(|sample_idx| record(scene, sample_idx)));
    samples.map(|record| ScenarioRecord { request: None, ..record }).collect()
}

/// The results for the shards when they are measured in this order.
fn evaluated(order: [usize; N_SHARDS]) -> (EvaluationSummary, Vec<MetricRow>, Vec<u8>, Vec<String>) {
    let dir = tempfile::tempdir().unwrap();
    let (store, scenes) = store(&dir.path().join("scenes"));
    let gates = GatesConfig { min_new: Some(25), min_accepted: Some(0), ..GatesConfig::default() };
    let config = EvaluateConfig { keep: Keep::Verified, gates, ..EvaluateConfig::default() };
    let settings = config.metric_settings();
    let mut measurer = Measurer::new(&settings, config.modes, &[], &store, None).unwrap();
    let mut measured: Vec<Option<(ShardFigures, MeasuredShard)>> = (0..N_SHARDS).map(|_| None).collect();
    for idx in order {
        let shard = Shard { sweep: "guided", n_evaluations: 39, records: records(&scenes, idx) };
        let figures = measurer.measure(&shard).unwrap();
        let file = dir.path().join("figures.bin");
        write_binary_atomically(&file, "figures.v2", &figures).unwrap();
        let read: ShardFigures = read_binary(&file, "figures.v2").unwrap();
        assert!(read == figures, "figures are the same when they were in a file");
        measured[idx] = Some((figures, MeasuredShard::new(shard, read, &store).unwrap()));
    }

    let out = dir.path().join("out");
    fs_err::create_dir(&out).unwrap();
    let verdicts = out.join("verdicts.parquet");
    let files = EvaluationFiles { verdicts: &verdicts, scratch: &out };
    let mut tracks = TrackPool::default();
    measured.iter().flatten().for_each(|(figures, _)| figures.pool_tracks(&mut tracks));
    let mut evaluation = Evaluation::new(&config, &[], tracks.tell_apart(&Silent), &files).unwrap();
    let kept = measured.into_iter().flatten().map(|(_, shard)| evaluation.add(shard).unwrap());
    let kept = kept.flat_map(|kept| kept.records).map(|record| record.scenario.id).collect();
    let rejected = RejectedSample {
        scene_id: scenes[0].id.clone(),
        sweep: "guided".to_owned(),
        level: GuidanceLevel::of_strength(2.0),
        sample_idx: 9,
        seed: 1,
        reason: Rejection::Unfit("track 3 is not finite at timestep 12".to_owned()),
    };
    evaluation.count_rejected([rejected].iter());
    let found = evaluation.finish().unwrap();
    let rows = found.all_rows().unwrap().collect::<store::Result<_>>().unwrap();
    let summary = found.remove_rows().unwrap();
    let left = folder_bytes(&out);
    assert_eq!(left.keys().filter(|name| !name.starts_with('.')).collect::<Vec<_>>(), ["verdicts.parquet"]);
    (summary, rows, left["verdicts.parquet"].clone(), kept)
}

#[test]
fn shards_are_measured_in_any_order() {
    let in_order = evaluated([0, 1, 2]);
    assert!(in_order == evaluated([2, 0, 1]));
    let (summary, rows, _, kept) = in_order;
    assert_eq!((summary.n_scenarios, summary.n_verified, kept.len()), (24, 12, 12));
    assert_eq!(summary.sampling[0].n_scenes, 4, "scenes of several shards count once");
    assert_eq!(summary.gates.iter().map(|gate| gate.met).collect::<Vec<_>>(), [false, true]);
    let n_left_out = |reason: &str| summary.left_out.iter().find(|row| row.reason == reason).map(|row| row.n_left_out);
    assert_eq!(n_left_out("not_finite"), Some(1));
    // Each metric that is defined throughout has one mean of all places and one of the one place, in each of three
    // series; a value of each scene and shard there; and one of each scenario.
    let of = |metric: &str| rows.iter().filter(|row| row.metric == metric).collect::<Vec<_>>();
    let rows = of("collision_rate");
    let n = |is_counted: &dyn Fn(&MetricRow) -> bool| rows.iter().filter(|row| is_counted(row)).count();
    assert_eq!(n(&|row| row.scene_id.is_none()), 2 * 3);
    assert_eq!(n(&|row| row.scene_id.is_some() && row.scenario_id.is_none()), 3 * 4 * N_SHARDS);
    assert_eq!(n(&|row| row.scenario_id.is_some()), 24);
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let own: Vec<f64> = rows
        .iter()
        .filter(|row| row.group.name() == "guided" && row.scene_id.is_some() && row.scenario_id.is_none())
        .map(|row| row.value)
        .collect();
    let told = rows.iter().find(|row| row.group.name() == "guided" && row.scene_id.is_none()).expect("a mean");
    assert!((told.value - mean(&own)).abs() < 1e-12 && told.n == own.len() as u64);
}

#[test]
fn figures_of_another_shard_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let (store, scenes) = store(dir.path());
    let config = EvaluateConfig::default();
    let settings = config.metric_settings();
    let mut measurer = Measurer::new(&settings, config.modes, &[], &store, None).unwrap();
    let shard =
        |n_scenes: usize| Shard { sweep: "guided", n_evaluations: 39, records: records(&scenes[..n_scenes], 0) };
    let figures = measurer.measure(&shard(4)).unwrap();
    let refused = MeasuredShard::new(shard(3), figures, &store).err().expect("refused").to_string();
    assert!(refused.contains("figures of 4 cells") && refused.contains("--redo evaluate"), "{refused}");
}
