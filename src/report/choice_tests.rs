//! Are the chosen scenarios those that a reviewer should see?

use super::accepted::{Accepted, HardnessSummary};
use super::choice::{Choice, Chosen};
use super::config::ReportConfig;
use crate::evaluate;
use crate::metrics::MetricRow;
use crate::scenario::{BucketTag, RequestOutcome, RequestTag, ScenarioRecord, VerdictRow};
use crate::scene::testing::{self, Drive};
use crate::scene::{GuidanceLevel, Roles};

fn record(sweep: &str, scene: &str, strength: f64, sample_idx: usize) -> ScenarioRecord {
    let mut record =
        evaluate::testing::record(strength, false, false, testing::scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0)]));
    record.scenario.id = format!("{sweep}-{scene}-{strength}-{sample_idx}");
    let provenance = &mut record.scenario.provenance;
    (provenance.scene_id, provenance.sample_idx) = (scene.into(), sample_idx);
    provenance.guidance.roles = Roles::default();
    ScenarioRecord { sweep: sweep.into(), requested_behavior: None, ..record }
}

fn asked(scene: &str, sample_idx: usize, verified: bool, recorded_event: bool) -> ScenarioRecord {
    let requested_behavior = Some("cut_in".to_owned());
    ScenarioRecord { requested_behavior, verified, recorded_event, ..record("asked", scene, 2.0, sample_idx) }
}

/// Scenes are at the positions of their letters.
fn offer(choice: &mut Choice<'_>, record: &ScenarioRecord) {
    choice.offer(record, usize::from(record.scenario.provenance.scene_id.0.as_bytes()[0]));
}

fn ids(chosen: &[Chosen]) -> Vec<String> {
    let text = |chosen: &Chosen| match chosen {
        Chosen::Alone(record) => record.scenario.id.clone(),
        Chosen::Together(records) => {
            records.iter().map(|record| record.scenario.id.as_str()).collect::<Vec<_>>().join(" ")
        }
    };
    chosen.iter().map(text).collect()
}

fn choose(config: &ReportConfig, records: &[ScenarioRecord]) -> Vec<String> {
    let mut choice = Choice::new(config, None);
    records.iter().for_each(|record| offer(&mut choice, record));
    ids(&choice.finish())
}

#[test]
fn new_scenarios_of_different_scenes_come_first_and_failures_are_shown_too() {
    let config = ReportConfig { n_drawn: 4 };
    let records = [
        asked("a", 0, true, true),
        asked("a", 1, true, false),
        asked("a", 2, true, false),
        asked("a", 3, false, false),
        asked("b", 0, true, false),
        asked("b", 1, false, false),
        asked("c", 0, true, true),
    ];
    let expected = ["asked-a-2-1", "asked-b-2-0", "asked-a-2-2", "asked-a-2-0", "asked-a-2-3", "asked-b-2-1"];
    assert_eq!(choose(&config, &records), expected);
    let nothing_verified = choose(&config, &records[3..4]);
    assert_eq!(nothing_verified, ["asked-a-2-3"], "no sweep goes without a drawing");
}

#[test]
fn the_hardest_accepted_scenarios_come_first_and_rejected_ones_are_few() {
    let records: Vec<ScenarioRecord> = (0..12).map(|i| asked("a", i, i < 8, false)).collect();
    let mut accepted = Accepted::default();
    let id = |i: usize| records[i].scenario.id.clone();
    for i in 0..4 {
        let level = GuidanceLevel::UNGUIDED;
        let (sweep, reasons, not_checked) = ("asked".into(), vec![], vec![]);
        let (preventable, careful_margin_s) = ([None, Some(true), Some(false), Some(true)][i], None);
        let row = VerdictRow {
            scenario_id: id(i),
            sweep,
            level,
            accepted: true,
            kept: true,
            reasons,
            preventable,
            careful_margin_s,
            not_checked,
        };
        accepted.add_verdict(row);
    }
    let metric = |i: usize, metric: &str, value: f64| MetricRow {
        sweep: "asked".into(),
        place: "X".into(),
        scenario_id: Some(id(i)),
        n: 1,
        ..MetricRow::example(metric, value)
    };
    for (i, name, value) in
        [(1, "pair_min_ttc_s", 2.5), (2, "pair_min_ttc_s", 0.5), (3, "pair_min_ttc_s", 4.0), (4, "pair_min_ttc_s", 0.1)]
    {
        accepted.add_metric(&metric(i, name, value));
    }
    let (n_critical, n_without_ttc) = (Some(1), Some(1));
    let summary = HardnessSummary { n_situations: 1, n_critical, n_without_ttc, n_careful: 3, n_not_preventable: 1 };
    assert_eq!(accepted.summary(1), summary);
    let config = ReportConfig { n_drawn: 3 };
    let mut choice = Choice::new(&config, Some(&accepted));
    records.iter().for_each(|record| offer(&mut choice, record));
    let drawn: Vec<_> = choice.drawn().iter().map(|row| (row.n_drawn, row.n_there)).collect();
    assert_eq!(drawn, [(3, 4); 3]);
    let expected = [2, 1, 3, 4, 5, 6, 8, 9, 10].map(|i| format!("asked-a-2-{i}"));
    assert_eq!(ids(&choice.finish()), expected);
}

#[test]
fn sweeps_without_a_behavior_show_samples_of_the_same_scenes() {
    let config = ReportConfig::default();
    let mut records = Vec::new();
    for scene in ["a", "b", "c"] {
        records.extend((0..8).map(|i| record("one", scene, 0.0, i)));
    }
    // The second sweep comes to the scenes in another order, at two strengths, and does not have b.
    for scene in ["d", "c", "a"] {
        records.extend([0.0, 1.0].map(|strength| record("two", scene, strength, 0)));
    }
    let six = |scene: &str| (0..6).map(|i| format!("one-{scene}-0-{i}")).collect::<Vec<_>>().join(" ");
    let (a, b) = (six("a"), six("b"));
    let expected = [&a, &b, "two-a-0-0", "two-a-1-0", "two-d-0-0", "two-d-1-0"];
    assert_eq!(choose(&config, &records), expected);
}

#[test]
fn what_keeps_drawings_from_being_more_is_told() {
    let config = ReportConfig { n_drawn: 1000 };
    let mut choice = Choice::new(&config, None);
    for i in 0..7 {
        offer(&mut choice, &asked("a", i, i < 3, i == 0));
    }
    for (i, scene) in ["a", "b", "c", "c"].into_iter().enumerate() {
        offer(&mut choice, &record("one", scene, 0.0, i));
    }
    let drawn = choice.drawn();
    let told: Vec<_> =
        drawn.iter().map(|row| (row.sweep.as_str(), row.n_drawn, row.n_there, row.limit.as_str())).collect();
    let expected = [("asked", 3, 3, "report.n_drawn = 1000"), ("asked", 3, 4, "3"), ("one", 2, 3, "2")];
    assert_eq!(told, expected);
    assert_eq!(choice.finish().len(), 3 + 3 + 2);
}

#[test]
fn of_each_bucket_of_a_request_some_accepted_scenarios_are_drawn() {
    let taken = |scene: &str, sample_idx: usize, bucket: usize, outcome: RequestOutcome| {
        let bucket = BucketTag { idx: bucket, ranges: format!("gap_m {bucket}..{}", bucket + 1) };
        let tag = RequestTag { request: "gaps".into(), round: 0, outcome, bucket: Some(bucket) };
        ScenarioRecord { request: Some(tag), ..asked(scene, sample_idx, true, false) }
    };
    let (accepted, surplus) = (RequestOutcome::Accepted, RequestOutcome::Surplus);
    let records = [
        taken("a", 0, 1, accepted),
        taken("a", 1, 1, accepted),
        taken("b", 2, 1, accepted),
        taken("a", 3, 0, accepted),
        taken("b", 4, 0, surplus),
    ];
    let config = ReportConfig { n_drawn: 0 };
    let mut choice = Choice::new(&config, None);
    records.iter().for_each(|record| offer(&mut choice, record));
    let row = choice.drawn().into_iter().find(|row| row.sweep == "gaps").unwrap();
    assert_eq!((row.n_drawn, row.n_there, row.limit.as_str()), (3, 4, "2"));
    // The first of each scene before further ones; a scenario whose bucket was full is like any other sample of its
    // sweep.
    assert_eq!(ids(&choice.finish()), ["asked-a-2-3", "asked-a-2-0", "asked-b-2-2"]);
}
