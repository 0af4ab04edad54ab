//! Moments that several scenes show.

use super::*;
use crate::behavior::{BehaviorEvent, EventLabel};
use crate::geometry::{Transform2, Vec2};
use crate::rates::{OccurrenceTally, RateMethod, RecordedTraffic, Within};
use crate::scene::testing::{self, Drive};
use crate::scene::{AgentClass, State, Trajectory};
use crate::statistics::clustered_rate;

/// 40 timesteps of a recording from a frame on, in which three vehicles drive at 10, 8 and 6 m/s and one person walks;
/// the frame of coordinates moves along. Recordings with another `lag` show the same with other numbers of frames.
fn window(recording: &str, first_frame: i64, lag: i64) -> Scene {
    let mut scene = testing::scene(&[Drive::straight(0.0, 0.0, 0.0, 1.0)]);
    scene.id = SceneId(format!("interaction/train/A/{recording}@{first_frame}"));
    scene.dt_s = 0.1;
    scene.n_timesteps = 40;
    scene.world_from_scene = Transform2::from_pose(Vec2::new(first_frame as f64, 2.0), 0.3);
    let to_scene = scene.world_from_scene.inverse();
    let template = scene.tracks[0].clone();
    let track = |(i, speed_mps): (usize, f64)| {
        let state = |timestep: i64| {
            let time_s = 0.1 * (first_frame + timestep + lag) as f64;
            let world = State {
                // Uneven motion: at constant speed, moments would be alike.
                position: Vec2::new(speed_mps * time_s + (0.7 * time_s).sin(), 4.0 * i as f64 + (0.3 * time_s).cos()),
                heading_rad: 0.0,
                velocity: Vec2::new(speed_mps, 0.0),
            };
            Some(world.transformed(&to_scene))
        };
        Track {
            id: format!("{recording}-{i}").as_str().into(),
            class: if i == 3 { AgentClass::Pedestrian } else { AgentClass::Vehicle },
            trajectory: Trajectory::new((0..40).map(state).collect()),
            ..template.clone()
        }
    };
    scene.tracks = [10.0, 8.0, 6.0, 1.0].into_iter().enumerate().map(track).collect();
    scene
}

fn event(scene: &Scene, timesteps: [usize; 2], pet_s: f64) -> BehaviorEvent {
    let [start, end] = timesteps;
    let kind = ("near_miss", &["first", "second"][..]);
    BehaviorEvent::new(kind, scene, EventLabel::Positive, &[1, 0], start..=end).with("pet_s", pet_s)
}

fn counted(scenes: Vec<(Scene, Vec<BehaviorEvent>)>) -> (Vec<ExposureRow>, Vec<BehaviorEvent>) {
    let (mut exposure, mut occurrences) = (ExposureTally::default(), OccurrenceTally::default());
    let mut found = Vec::new();
    for (scene, events) in scenes {
        let scene = SceneExposure::of(&scene);
        let shown = exposure.add(&scene).unwrap();
        found.extend(occurrences.add(&scene, shown, &events, &exposure));
    }
    found.extend(occurrences.finish());
    (exposure.rows(), found.into_iter().map(|(event, _)| event).collect())
}

#[test]
fn what_is_in_windows_that_overlap_in_two_recordings_and_in_a_copy_counts_once() {
    let scenes = |recording: &'static str, lag: i64, frames: std::ops::Range<i64>| {
        frames.step_by(10).map(move |first| {
            // Frames 57 to 63 of the traffic; every window shows as much of it as it has.
            let (from, to) = (57 - lag - first, 63 - lag - first);
            let is_seen = from >= 2 && to < 38;
            let scene = window(recording, first, lag);
            let events = is_seen.then(|| event(&scene, [from as usize, to as usize], 0.3));
            (scene, events.into_iter().collect())
        })
    };
    let alone = counted(scenes("000", 0, 0..100).collect());
    let both =
        counted(scenes("000", 0, 0..100).chain(scenes("007", 30, 0..100)).chain(scenes("copy", 0, 0..100)).collect());
    let row = &alone.0[0];
    // Windows begin at frames 0 to 90: 130 frames.
    let hours = 130.0 * 0.1 / 3600.0;
    assert!((row.observed_h - hours).abs() < 1e-12 && row.n_scenes == 10);
    assert!((row.class_h[0] - 3.0 * hours).abs() < 1e-12 && (row.class_h[4] - hours).abs() < 1e-12);
    assert!((row.motorized_km() - 24.0 * 3.6 * hours).abs() < 1e-9);
    assert_eq!(alone.1.len(), 1);
    // The second recording goes on for three seconds after the first; the copy has nothing of its own.
    let total: f64 = both.0.iter().map(|row| row.observed_h).sum();
    assert!((total - 160.0 * 0.1 / 3600.0).abs() < 1e-12, "{total}");
    let km: f64 = both.0.iter().map(ExposureRow::motorized_km).sum();
    assert!((km - 24.0 * 3.6 * total).abs() < 1e-9, "{km}");
    assert_eq!(both.1, alone.1);
    let first = Some("interaction/train/A/000".to_owned());
    assert_eq!(both.0.iter().map(|row| row.shares_with.clone()).collect::<Vec<_>>(), [None, first.clone(), first]);
}

#[test]
fn views_of_an_event_become_the_one_that_shows_most() {
    let of = |first: i64, timesteps, pet_s| {
        let scene = window("000", first, 0);
        let events = vec![event(&scene, timesteps, pet_s)];
        (scene, events)
    };
    // Frames 30 to 39, 30 to 44, and 70 to 72: the last one begins over a second later.
    let (_, events) = counted(vec![of(0, [30, 39], 0.1), of(10, [20, 34], 0.2), of(40, [30, 32], 0.3)]);
    assert_eq!(events.iter().map(|event| event.parameters["pet_s"]).collect::<Vec<_>>(), [0.2, 0.3]);
}

#[test]
fn what_was_not_recorded_has_no_exposure() {
    let mut scene = window("000", 0, 0);
    scene.source.situation = SituationKind::Continued;
    assert!(ExposureTally::default().add(&SceneExposure::of(&scene)).is_none());
}

/// Recordings of an hour and 20 km with so many near misses.
fn traffic(counts: &[usize], pet_s: impl Fn(usize) -> f64) -> RecordedTraffic {
    let (rows, _) = counted(vec![(window("000", 0, 0), Vec::new())]);
    let row = |i: usize| ExposureRow {
        recording: format!("interaction/train/A/{i}"),
        observed_h: 1.0,
        class_km: [10.0, 10.0, 0.0, 5.0, 5.0, 5.0, 0.0],
        ..rows[0].clone()
    };
    let mut traffic = RecordedTraffic::new((0..counts.len()).map(row).collect());
    let mut n = 0;
    for (i, count) in counts.iter().enumerate() {
        for _ in 0..*count {
            let mut scene = window("000", 0, 0);
            scene.id = SceneId(format!("interaction/train/A/{i}@{n}"));
            traffic.add(&event(&scene, [3, 4], pet_s(n)));
            n += 1;
        }
    }
    traffic
}

#[test]
fn rates_are_per_hour_and_per_kilometer_and_those_of_buckets_of_their_events() {
    let traffic = traffic(&[4, 0, 2], |n| n as f64);
    let bucket: Within = "pet_s 1..3".parse().unwrap();
    let rows = traffic.rates(&["near_miss", "collision"], &[("near_miss".to_owned(), bucket)]);
    let words: Vec<_> =
        rows.iter().map(|row| (row.behavior.as_str(), row.within.as_str(), row.n_events, row.method)).collect();
    let over = RateMethod::OverRecordings;
    assert_eq!(
        words,
        [("near_miss", "", 6, over), ("near_miss", "pet_s 1..3", 2, over), ("collision", "", 0, RateMethod::NoneFound),]
    );
    let all = &rows[0];
    assert_eq!((all.rate_per_hour, all.rate_per_1000_km), (2.0, Some(100.0)));
    let expected = clustered_rate(&[(4, 0.02), (0, 0.02), (2, 0.02)]).unwrap();
    assert_eq!((all.per_1000_km, all.dispersion), (Some(expected.interval), expected.dispersion));
    assert!((rows[2].per_hour.high - 3.688_879 / 3.0).abs() < 1e-6 && rows[2].per_hour.low == 0.0);
}

#[test]
fn a_level_that_was_not_passed_is_extrapolated_or_not_with_the_reason() {
    // Of times up to 3 s, (t / 3)^4 are below t, mixed over recordings: the least of 400 is 0.56 s.
    let quantile = |n: usize| 3.0 * (((n * 167 % 400) as f64 + 0.5) / 400.0).powf(0.25);
    let traffic = traffic(&[100; 4], quantile);
    let ask = |text: &str| {
        let within: Within = text.parse().unwrap();
        let rows = traffic.rates(&["near_miss"], &[("near_miss".to_owned(), within)]);
        rows.last().unwrap().clone()
    };
    // Of 400 events in four hours.
    let row = ask("pet_s -9..0.5");
    let expected = 100.0 * (0.5_f64 / 3.0).powi(4);
    assert_eq!((row.method, row.n_events), (RateMethod::Extrapolated, 0), "{:?}", row.note);
    assert_eq!(row.note.as_deref(), Some("from 399 events with pet_s beyond 2.999"));
    assert!((row.rate_per_hour / expected).ln().abs() < 1.0, "{} of {expected}", row.rate_per_hour);
    assert!(row.per_hour.low < expected && expected < row.per_hour.high);
    let reasons = [
        ("pet_s -9..0", "no time"),
        ("pet_s -9..0.05", "more than ten times"),
        ("pet_s 0.2..0.3", "far end of the bucket"),
    ];
    for (text, reason) in reasons {
        let row = ask(text);
        assert!(row.method == RateMethod::NoneFound && row.note.as_ref().unwrap().contains(reason), "{:?}", row.note);
    }
    assert_eq!(ask("relative_speed_mps 90..99").note, None);
}
