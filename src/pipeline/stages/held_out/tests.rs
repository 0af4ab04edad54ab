//! Divisions by splits, places, recordings and time.

use super::*;
use crate::scene::{Dataset, SituationKind};

/// Scenes of 40 timesteps, by split, place, and case or window.
fn index(scenes: &[(Split, &str, String)]) -> SceneIndex {
    let ids: Vec<String> =
        scenes.iter().map(|(split, place, case)| format!("{}/{place}/{case}", split.name())).collect();
    let entries = scenes.iter().zip(&ids).map(|((split, place, _), id)| SceneIndexEntry {
        id,
        dataset: Dataset::Interaction,
        split: *split,
        place,
        n_agents: 3,
        situation: SituationKind::Recorded,
        n_timesteps: 40,
    });
    entries.collect()
}

fn cases(split: Split, n: usize) -> Vec<(Split, &'static str, String)> {
    (0..n).map(|case| (split, "A", format!("case-{case}"))).collect()
}

#[test]
fn train_and_val_are_kept_apart_and_places_are_honored() {
    let scene = |split, place| (split, place, String::new());
    let index = index(
        &[(Split::Train, "A"), (Split::Val, "A"), (Split::Train, "B"), (Split::Test, "A")].map(|(s, p)| scene(s, p)),
    );
    let all = TrainingScenes::new(&index, OwnScenes::default());
    assert_eq!((all.train, all.held_out), (vec![0, 2], vec![1]));
    let only_a = TrainingScenes::new(&index, OwnScenes { places: &["A".to_owned()], ..OwnScenes::default() });
    assert_eq!((only_a.train, only_a.held_out), (vec![0], vec![1]));
    let on_val = TrainingScenes::new(&index, OwnScenes { splits: &[Split::Train, Split::Val], ..OwnScenes::default() });
    assert_eq!(on_val.train.len() + on_val.held_out.len(), 3, "one is held out of what is trained on");
}

#[test]
fn about_a_tenth_of_recordings_is_held_out_whatever_others_there_are() {
    let of = |n: usize| TrainingScenes::new(&index(&cases(Split::Unsplit, n)), OwnScenes::default());
    let (many, fewer) = (of(1000), of(600));
    assert!((70..130).contains(&many.held_out.len()) && many.train.len() + many.held_out.len() == 1000);
    let among_fewer: Vec<usize> = many.held_out.iter().copied().filter(|idx| *idx < 600).collect();
    assert_eq!(among_fewer, fewer.held_out);
    // One of any two is on each side.
    for n in 2..12 {
        let few = of(n);
        assert!(!few.train.is_empty() && !few.held_out.is_empty(), "{n} recordings: {few:?}");
    }
    assert_eq!(of(1), TrainingScenes { train: vec![0], ..TrainingScenes::default() });
}

#[test]
fn a_single_recording_is_divided_by_time() {
    let windows = |stride: usize, n: usize| -> Vec<_> {
        (0..n).map(|i| (Split::Unsplit, "A", format!("long@{}", i * stride))).collect()
    };
    let of = |stride, n| TrainingScenes::new(&index(&windows(stride, n)), OwnScenes::default());
    let by_frames = of(10, 20);
    // The last two begin at 180, and windows from 150 on reach beyond that.
    assert_eq!((by_frames.held_out, by_frames.across), (vec![18, 19], vec![15, 16, 17]));
    assert_eq!(by_frames.train, (0..15).collect::<Vec<_>>());
    let overlapping = of(10, 3);
    assert_eq!((overlapping.train.len(), overlapping.held_out.len()), (3, 0));
}
