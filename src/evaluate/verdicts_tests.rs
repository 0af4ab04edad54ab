//! Tests of which scenarios are accepted and kept, and that all of them are counted.

use super::config::{EvaluateConfig, Keep};
use super::testing;
use super::verdicts::{AcceptanceRow, LeftOutRow, Verdicts, left_out_by_sweep};
use crate::behavior::{Behavior, BehaviorEvent, CutIn, EventLabel, LaneChange};
use crate::generate::{RejectedSample, Rejection};
use crate::metrics::{Check, Violation};
use crate::scenario::{Assessment, RequestOutcome, RequestTag, ScenarioRecord, VerdictRow};
use crate::scene::testing::{Drive, scene};
use crate::scene::{GuidanceLevel, TrackId};

/// A scenario of two cars, the second one `offset_m` to the side.
fn record(id: &str, offset_m: f64, verified: bool, violations: &[Check]) -> ScenarioRecord {
    let scene = scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0), Drive::straight(0.0, offset_m, 0.0, 10.0)]);
    let violation =
        |check: &Check| Violation { check: *check, track: TrackId::from("1"), timestep: 5, value: 2.0, limit: 1.0 };
    let violations = violations.iter().map(violation).collect();
    let mut record = testing::record(2.0, verified, false, scene);
    id.clone_into(&mut record.scenario.id);
    "cut_ins".clone_into(&mut record.sweep);
    record.events.clear();
    record.assessment = Some(Assessment { violations, ..Assessment::default() });
    record
}

/// The second car is 0.4 m off throughout, the first one is not: a mean of 0.2 m.
#[test]
fn duplicates_are_nearer_than_the_limit() {
    let repeats = |limit_m: f64| {
        let config = EvaluateConfig { duplicate_distance_m: limit_m, ..EvaluateConfig::default() };
        let mut verdicts = Verdicts::new(&config, &[]);
        assert!(verdicts.decide(&mut record("first", 5.0, true, &[]), &[]).kept);
        let mut second = record("second", 5.4, true, &[]);
        verdicts.decide(&mut second, &[]);
        let assessment = second.assessment.unwrap();
        (assessment.nearest_scenario_m.unwrap(), assessment.near_duplicate_of.is_some())
    };
    let (distance_m, _) = repeats(1.0);
    assert!((distance_m - 0.2).abs() < 1e-6, "{distance_m}");
    assert_eq!((repeats(0.19).1, repeats(0.21).1), (false, true));
}

#[test]
fn what_a_request_has_no_room_for_is_not_kept_as_verified() {
    let config = EvaluateConfig { keep: Keep::Verified, ..EvaluateConfig::default() };
    let is_kept = |outcome: RequestOutcome| {
        let mut record = record("a", 5.0, true, &[]);
        record.request = Some(RequestTag { request: "r".to_owned(), round: 0, outcome, bucket: None });
        Verdicts::new(&config, &[]).decide(&mut record, &[]).kept
    };
    assert!(is_kept(RequestOutcome::Accepted) && !is_kept(RequestOutcome::Surplus));
}

#[test]
fn who_moves_faster_aside_than_drivers_do_or_comes_in_closer_is_not_accepted() {
    let hurry = |hurry: f64| -> [Box<dyn Behavior>; 2] {
        [Box::new(CutIn { hurry, ..CutIn::default() }), Box::new(LaneChange { hurry })]
    };
    let (ordinary, hurried, config) = (hurry(1.0), hurry(1.5), EvaluateConfig::default());
    let cut_in = ("cut_in", &["ego", "other"][..]);
    // The fastest of 346 recorded lane changes moved aside with 1.45 m/s, that of the cut-ins with 1.57 m/s.
    for (behavior, aside_mps, gap_m, expected) in [
        (cut_in, 1.57, 3.0, [true, true]),
        (cut_in, 1.6, 3.0, [false, true]),
        (cut_in, 2.4, 3.0, [false, false]),
        (cut_in, 1.0, 2.4, [false, true]),
        (cut_in, 1.0, -1.0, [false, false]),
        (("lane_change", &["subject"]), 1.45, 0.0, [true, true]),
        (("lane_change", &["subject"]), 1.5, 0.0, [false, true]),
    ] {
        let found = [&ordinary, &hurried].map(|behaviors| {
            let mut record = record("a", 5.0, true, &[]);
            let event = BehaviorEvent::new(behavior, &record.scenario.scene, EventLabel::Positive, &[0, 1], 5..=6);
            let event = event.with("ego_speed_mps", 10.0).with("lateral_speed_mps", aside_mps).with("gap_m", gap_m);
            record.requested_behavior = Some(behavior.0.to_owned());
            record.scenario.provenance.guidance.roles = event.roles.clone();
            record.events.push(event);
            Verdicts::new(&config, behaviors).decide(&mut record, &[]).reasons
        });
        let expected = expected.map(|is_accepted| if is_accepted { vec![] } else { vec!["not_as_driven".to_owned()] });
        assert_eq!(found, expected, "{behavior:?} {aside_mps} m/s, {gap_m} m");
    }
}

fn records() -> Vec<ScenarioRecord> {
    vec![
        record("unverified", 9.0, false, &[Check::Jerk]),
        record("first", 5.0, true, &[]),
        record("like_the_first", 5.2, true, &[]),
        record("invalid", 20.0, true, &[Check::Collision, Check::Offroad]),
        record("like_the_invalid", 20.0, true, &[]),
        record("like_the_unverified", 9.0, true, &[]),
    ]
}

fn decided(keep: Keep) -> (Vec<ScenarioRecord>, Vec<String>, Vec<AcceptanceRow>, Vec<LeftOutRow>) {
    let config = EvaluateConfig { keep, ..EvaluateConfig::default() };
    let mut verdicts = Verdicts::new(&config, &[]);
    let mut all = records();
    let decided: Vec<VerdictRow> = all.iter_mut().map(|record| verdicts.decide(record, &[])).collect();
    let kept: Vec<String> = decided.iter().filter(|row| row.kept).map(|row| row.scenario_id.clone()).collect();
    let (rows, left_out) = verdicts.finish();
    for (record, row) in all.iter().zip(&decided) {
        let is_accepted = record.assessment.as_ref().is_some_and(|assessment| assessment.accepted);
        assert_eq!((&row.scenario_id, row.accepted), (&record.scenario.id, is_accepted));
    }
    let reasons: Vec<Vec<&str>> = decided.iter().map(|row| row.reasons.iter().map(String::as_str).collect()).collect();
    let expected: [&[&str]; 6] =
        [&["not_verified", "jerk"], &[], &["near_duplicate"], &["collision", "offroad"], &[], &[]];
    assert_eq!(reasons, expected);
    (all, kept, rows, left_out)
}

#[test]
fn of_near_duplicates_the_first_accepted_one_stays() {
    let (all, kept, rows, left_out) = decided(Keep::Accepted);
    assert_eq!(kept, ["first", "like_the_invalid", "like_the_unverified"]);
    let judged = |i: usize| all[i].assessment.as_ref().expect("judged");
    // One of two agents is 0.2 m off.
    assert!((judged(2).nearest_scenario_m.expect("one before") - 0.1).abs() < 1e-6);
    assert_eq!(judged(2).near_duplicate_of.as_deref(), Some("first"));
    assert_eq!((judged(1).nearest_scenario_m, &judged(4).near_duplicate_of), (None, &None));
    assert!((judged(5).nearest_scenario_m.expect("two before") - 2.0).abs() < 1e-6);
    let row = &rows[0];
    assert_eq!((rows.len(), row.n_scenarios, row.n_verified, row.n_valid), (1, 6, 5, 4));
    assert_eq!((row.n_verified_valid, row.n_accepted, row.n_kept), (4, 3, 3));
    let counts: Vec<_> = left_out.iter().map(|row| (row.reason.as_str(), row.n_left_out, row.n_found)).collect();
    let expected =
        [("not_verified", 1, 1), ("jerk", 0, 1), ("near_duplicate", 1, 1), ("collision", 1, 1), ("offroad", 0, 1)];
    assert_eq!(counts, expected);
    let n_left_out: u64 = left_out.iter().map(|row| row.n_left_out).sum();
    assert_eq!(n_left_out + row.n_kept, row.n_scenarios, "everybody is in the corpus or left out for one reason");
    assert_eq!(left_out_by_sweep(&left_out)["cut_ins"].len(), 3);
}

#[test]
fn what_is_kept_is_not_left_out_whatever_was_found() {
    let (_, kept, rows, left_out) = decided(Keep::Verified);
    assert_eq!((kept.len(), rows[0].n_accepted), (5, 3));
    assert_eq!(left_out.iter().map(|row| row.n_left_out).collect::<Vec<_>>(), [1, 0, 0, 0, 0]);
    let (all, kept, _, left_out) = decided(Keep::All);
    assert_eq!(kept.len(), all.len());
    assert!(left_out.iter().all(|row| row.n_left_out == 0 && row.n_found == 1));
    assert!(left_out_by_sweep(&left_out).is_empty());
}

#[test]
fn what_generation_left_out_is_counted_too() {
    let rejected = |sample_idx: usize| RejectedSample {
        scene_id: "a/b/c/d".into(),
        sweep: "cut_ins".to_owned(),
        level: GuidanceLevel::of_strength(2.0),
        sample_idx,
        seed: 1,
        reason: Rejection::Unfit("track 3 is not finite at timestep 12".to_owned()),
    };
    let config = EvaluateConfig::default();
    let mut verdicts = Verdicts::new(&config, &[]);
    let repeated = RejectedSample { reason: Rejection::RepeatedTemplate, ..rejected(2) };
    [rejected(0), rejected(1), repeated].iter().for_each(|rejected| verdicts.count_rejected(rejected));
    let (_, left_out) = verdicts.finish();
    let counts: Vec<_> = left_out.iter().map(|row| (row.reason.as_str(), row.level, row.n_left_out)).collect();
    let level = GuidanceLevel::of_strength(2.0);
    assert_eq!(counts, [("not_finite", level, 2), ("near_duplicate", level, 1)]);
}
