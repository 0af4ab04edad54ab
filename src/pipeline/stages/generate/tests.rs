//! Which shards are sampled, and how are their scenarios judged?

use super::sample_folder::write_table;
use super::sharded::{gather_sweeps, make_sweeps};
use super::*;
use crate::engine::shards::{Gathering, Shards, shard_folder};
use crate::generate::{Plan, ShardOutput, ShardPlan};
use crate::metrics::ValidityConfig;
use crate::progress::Silent;
use crate::scene::MapId;
use crate::store::SceneWriter;
use crate::store::testing::{map, scene};
use std::cell::RefCell;

/// Two sweeps of four shards, the second of which needs three verified scenarios. Every shard has two.
#[test]
fn what_a_single_worker_would_not_have_sampled_is_not_published() {
    let text = "[[sweeps]]\nname = 'a'\nn_scenes = 4\n\
                [[sweeps]]\nname = 'b'\nn_scenes = 4\nbehavior = 'cut_in'\nstop_after_verified = 3";
    let behaviors = MineConfig::default().build().unwrap();
    let resolved = toml::from_str::<GenerateConfig>(text).unwrap().resolve(&behaviors).unwrap();
    let shard = |idx| ShardPlan { idx, sweep_idx: idx / 4, cells: Vec::new(), first_sample: 0 };
    let plan = Plan { shards: (0..8).map(shard).collect(), shortfalls: Vec::new() };
    let root = tempfile::tempdir().unwrap();
    let folder = shard_folder(root.path(), 8, true);
    let sampled = RefCell::new(Vec::new());
    let work = |worker: &str| {
        let shards = Shards::new(&folder, worker.parse().unwrap(), &Silent);
        let mut sample = |shard: &ShardPlan| {
            sampled.borrow_mut().push(shard.idx);
            let sidecar = write_table(shards.dir(), shard.idx, ("a", 1), ShardOutput::default())?;
            Ok(SampleSidecar { n_verified: 2, ..sidecar })
        };
        make_sweeps(&shards, &plan, &resolved, &mut sample).unwrap();
    };
    // The second worker reaches the end of the second sweep before the first one has reached its beginning.
    work("2/2");
    work("1/2");
    let mut shards = Gathering::new(&folder);
    let files: Vec<String> =
        gather_sweeps(&plan, &resolved, &mut shards).unwrap().into_iter().map(|sidecar| sidecar.file).collect();
    shards.check_whole().unwrap();
    let expected: Vec<String> = (0..6).map(|idx| format!("{}.parquet", shard_name(idx))).collect();
    assert_eq!(files, expected, "4 verified in two shards of the second sweep");
    assert!(sampled.borrow().contains(&7), "nobody knew");
    let n_sampled = sampled.borrow().len();
    work("1/1");
    assert_eq!(sampled.borrow().len(), n_sampled, "what is finished or unwanted is not sampled again");
}

#[test]
fn departures_are_judged_and_mended_only_where_the_evaluation_judges_them() {
    let maps = [(MapId::from("PIT"), map(1, 9))];
    let scenes: Vec<_> = (0..5).map(|seed| scene(seed, Some((&maps[0].0, &maps[0].1)))).collect();
    let dir = tempfile::tempdir().unwrap();
    let (mut writer, _) = SceneWriter::resume(dir.path()).unwrap();
    writer.write_batch(&scenes, &maps, Some(0), &json!(0)).unwrap();
    writer.finish(&json!({ "rejects": {} })).unwrap();
    let store = SceneStore::open(dir.path()).unwrap();
    let of_evaluation = MapFits::of(&store, &ValidityConfig::default()).unwrap().settings(&ValidityConfig::default());
    assert!(of_evaluation.map_gaps.places.contains("PIT"), "its map is at random");

    let settings_with = |limits: &str, validity: &ValidityConfig| {
        let text = format!(
            "[[arms]]\nname = 'a'\n[[requests]]\nname = 'r'\nbehavior = 'cut_in'\nper_bucket = 1\narms = ['a']\n\
             buckets = {{ gap_m = [0, 5] }}\nbudget = {{ n_samples = 9 }}\nlimits = {{ {limits} }}"
        );
        let stage = Generate {
            has_situations: false,
            config: &toml::from_str(&text).unwrap(),
            precision: Precision::default(),
            mine: MineConfig::default(),
            metric_settings: MetricSettings { validity: validity.clone(), ..MetricSettings::default() },
            duplicate_distance_m: DUPLICATE_DISTANCE_M,
            classified_behavior: None,
            distill: None,
            horizon: None,
            learns_from: Vec::new(),
            layout: &Layout::below(dir.path()),
        };
        stage.settings_for_maps(&store).unwrap()
    };
    let strict = ValidityConfig { offroad_slack_m: 0.25, ..ValidityConfig::default() };
    let settings_with = |limits: &str| settings_with(limits, &strict);
    let MetricSettings { validity, map_gaps } = settings_with("collision_rate = 0.0");
    assert_eq!((validity.offroad_slack_m, &map_gaps.places), (0.25, &of_evaluation.map_gaps.places));
}
