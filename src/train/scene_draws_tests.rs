//! Draws follow the weights of sources and places, and do not depend on whether they are made in advance.

use super::testing::{arcs, collator, draws_of_four};
use super::*;
use crate::nn::testing::values;
use crate::seed::Seed;
use crate::tensor::{MaskSampler, StateParametrization, TaskWeights};

fn any_masks() -> MaskSampler {
    MaskSampler::new(&TaskWeights::default()).unwrap()
}

#[test]
fn a_batch_made_in_advance_is_the_one_that_would_be_drawn() {
    let dataset = arcs(20);
    let (collator, masks) = (collator(&dataset, StateParametrization::Motion), any_masks());
    let train = [WeightedGroups::single((0..10).collect())];
    let draws = || draws_of_four(&dataset, &train, &collator, &masks);
    let content = |DrawnBatch { batch, seeds, .. }: DrawnBatch| {
        (values(&batch.x0), values(&batch.latent), values(&batch.lanes), seeds)
    };
    let ahead = draws();
    // Ten scenes in batches of four: step 2 takes the end of one epoch and the beginning of the next.
    for (prepared, requested) in [(2, 2), (3, 7), (8, 2)] {
        ahead.prepare(prepared).unwrap();
        let expected = content(draws().training_batch(requested).unwrap());
        assert!(content(ahead.training_batch(requested).unwrap()) == expected, "{prepared} {requested}");
    }
}

#[test]
fn groups_count_the_same_however_many_scenes_they_have() {
    let dataset = arcs(18);
    let data = TrainingData {
        dataset: &dataset,
        sources: vec![TrainingSource {
            weight: 1.0,
            train: (0..10).collect(),
            places: vec![4, 4, 4, 4, 4, 4, 4, 4, 9, 9],
            held_out: Vec::new(),
        }],
        state_dim: 3,
        fingerprint: String::new(),
    };
    assert_eq!(data.groups(Balance::Scenes), [WeightedGroups::single((0..10).collect())]);
    let places = data.groups(Balance::Places);
    assert_eq!(places[0].groups, [(0..8).collect::<Vec<_>>(), vec![8, 9]]);
    // Every second row is from the small place, whose two scenes take turns.
    let (collator, masks) = (collator(&dataset, StateParametrization::Motion), any_masks());
    let draws = draws_of_four(&dataset, &places, &collator, &masks);
    let drawn: Vec<usize> = (0..4).flat_map(|step| draws.batch_indices(step)).collect();
    let (large, small): (Vec<_>, Vec<_>) = drawn.chunks(2).map(|pair| (pair[0], pair[1])).unzip();
    let sorted = |mut indices: Vec<usize>| {
        indices.sort_unstable();
        indices
    };
    assert_eq!(sorted(large), (0..8).collect::<Vec<_>>());
    assert!(small.chunks(2).all(|epoch| sorted(epoch.to_vec()) == [8, 9]), "{small:?}");
}

#[test]
fn draws_follow_the_weights_of_sources() {
    let dataset = arcs(18);
    let source = |weight, groups: &[(usize, usize)]| WeightedGroups {
        weight,
        groups: groups.iter().map(|(first, end)| (*first..*end).collect()).collect(),
    };
    // Half of the draws, three eighths and one eighth, whatever the number of scenes; the second source has two places.
    let sources = [source(4.0, &[(0, 2)]), source(3.0, &[(2, 3), (3, 10)]), source(1.0, &[(10, 18)])];
    let (collator, masks) = (collator(&dataset, StateParametrization::Motion), any_masks());
    let draws = draws_of_four(&dataset, &sources, &collator, &masks);
    let drawn: Vec<usize> = (0..32).flat_map(|step| draws.batch_indices(step)).collect();
    let n_of =
        |drawn: &[usize], scenes: std::ops::Range<usize>| drawn.iter().filter(|idx| scenes.contains(*idx)).count();
    assert_eq!([n_of(&drawn, 0..2), n_of(&drawn, 2..10), n_of(&drawn, 10..18)], [64, 48, 16]);
    assert_eq!(n_of(&drawn, 2..3), 24, "places of a source count the same");
    // Every stretch of the training is mixed alike, and every scene of a source has its turn.
    assert!(drawn.chunks(8).all(|stretch| n_of(stretch, 0..2) == 4), "{drawn:?}");
    assert!((10..18).all(|idx| n_of(&drawn, idx..idx + 1) == 2), "{drawn:?}");
    // A resumed training draws later steps only.
    assert_eq!(draws_of_four(&dataset, &sources, &collator, &masks).batch_indices(31), drawn[124..]);
}

#[test]
fn scales_and_held_out_scenes_are_of_all_sources_by_their_weights() {
    let dataset = arcs(40);
    let source = |weight, from: usize, n: usize| TrainingSource {
        weight,
        train: (from..from + n).collect(),
        places: vec![0; n],
        held_out: (from + n..from + n + 4).collect(),
    };
    let data = TrainingData {
        dataset: &dataset,
        sources: vec![source(3.0, 0, 20), source(1.0, 24, 4)],
        state_dim: 3,
        fingerprint: String::new(),
    };
    assert_eq!((data.n_train(), data.n_held_out()), (24, 8));
    let chosen = data.chosen_held_out(4, Seed(1));
    assert_eq!(chosen.iter().filter(|idx| (20..24).contains(*idx)).count(), 3);
    assert_eq!(chosen.iter().filter(|idx| (28..32).contains(*idx)).count(), 1);
}
