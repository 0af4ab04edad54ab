//! How are sampled scenarios judged?

use super::*;
use crate::metrics::ValidityConfig;
use crate::scene::MapId;
use crate::store::SceneWriter;
use crate::store::testing::{map, scene};

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
            keeps_duplicates: false,
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
