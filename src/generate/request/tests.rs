//! Are rounds decided from finished shards alone, within the budget, and in favor of what fills open buckets?

use super::ledger::ArmCounts;
use super::*;
use crate::behavior::BehaviorConfig;
use crate::generate::{Cell, GenerateConfig};
use crate::scene::Roles;
use crate::seed::Seed;
use std::collections::{BTreeMap, BTreeSet};

const ARMS: &str = "
    scenes_per_shard = 4
    [[arms]]
    name = 'plain'
    n_samples = 3
    [[arms]]
    name = 'guided'
    n_samples = 3
    strengths = [1.0, 8.0]
    [[arms]]
    name = 'aimed'
    n_samples = 3
    strengths = [5.0]
    classifier_scope = 'none'
    objectives = [{ kind = 'cut_in' }]
";

fn resolve(request: &str) -> ResolvedGeneration {
    let config: GenerateConfig = toml::from_str(&format!("{ARMS}{request}")).unwrap();
    config.resolve(&[BehaviorConfig::from_id("cut_in").unwrap().build()]).unwrap()
}

fn request(more: &str) -> String {
    let base =
        "[[requests]]\nname = 'tight'\nbehavior = 'cut_in'\nbuckets = { gap_m = [0, 5, 10], side = ['left', 'right'] }";
    format!("{base}\n{more}")
}

pub(super) fn tight(more: &str) -> ResolvedRequest {
    let arms = if more.contains("arms") { "" } else { "arms = ['plain', 'guided']\n" };
    resolve(&request(&format!("{arms}{more}"))).requests.remove(0)
}

pub(super) fn pool(n: usize) -> Pool {
    let cell = |i: usize| Cell {
        scene_idx: i,
        scene_id: format!("scene-{i}").as_str().into(),
        roles: Roles::from([("ego", "1"), ("other", "2")]),
        targets: Vec::new(),
    };
    Pool {
        request: "tight".to_owned(),
        cells: (0..n).map(cell).collect(),
        n_scenes: n,
        feasible: vec![(0..4).map(|bucket| (bucket, 0.0)).collect(); n],
        n_infeasible: 0,
        unmet: None,
    }
}

/// Fulfills a request in a world in which `hit` decides into which bucket sample `sample` of an arm in a cell falls.
/// Returns the rounds and their tallies.
pub(super) fn fulfil(
    request: &ResolvedRequest,
    pool: &Pool,
    seed: u64,
    hit: impl Fn(usize, usize, usize) -> Option<usize>,
) -> (Vec<Round>, Vec<ShardTally>, Ledger) {
    fulfil_with(request, (pool, None), seed, hit)
}

/// The same with these templates, which bring what they show.
fn fulfil_with(
    request: &ResolvedRequest,
    (pool, templates): (&Pool, Option<&Templates<'_>>),
    seed: u64,
    hit: impl Fn(usize, usize, usize) -> Option<usize>,
) -> (Vec<Round>, Vec<ShardTally>, Ledger) {
    let mut ledger = Ledger::new(request, pool);
    let (mut rounds, mut tallies, mut next_idx) = (Vec::new(), Vec::new(), 0);
    loop {
        let round = rounds.len();
        let context =
            RoundContext { pool, ledger: &ledger, round, next_idx, cells_per_shard: 4, seed: Seed(seed), templates };
        let Some(round) = request.next_round(&context).unwrap() else { break };
        for shard in &round.shards {
            let mut accepted = ledger.accepted.clone();
            let cells = shard.members.iter().zip(&shard.aims).enumerate().map(|(at, (cell, aim))| {
                let n_samples = shard.plan.n_samples_of(at, request.arms[shard.arm].n_samples);
                let planned = shard.plan.templates.get(at).map(|numbers| aim.map(|aim| (aim, numbers)).unwrap());
                let hit = |sample| planned.map_or_else(|| hit(shard.arm, *cell, sample), |(aim, _)| Some(aim.bucket));
                let tried = planned.map(|(aim, numbers)| numbers.iter().map(move |number| (aim.solved_for, *number)));
                let first = shard.plan.first_sample;
                let mut hits: BTreeMap<usize, Hits> = BTreeMap::new();
                for bucket in (first..first + n_samples).filter_map(hit) {
                    let own = hits.entry(bucket).or_default();
                    let is_wanted = accepted[bucket] < ledger.wanted[bucket];
                    if is_wanted && ledger.accepted_of_cell(*cell, bucket) + own.n_accepted < ledger.max_per_scene {
                        own.n_accepted += 1;
                        accepted[bucket] += 1;
                    } else {
                        own.n_surplus += 1;
                    }
                }
                let n_found = hits.values().map(Hits::n).sum();
                let n_samples_drawn = n_samples as u64;
                CellTally {
                    cell: *cell,
                    n_samples: n_samples_drawn,
                    aimed: aim.map(|aim| aim.bucket),
                    tried: tried.into_iter().flatten().collect(),
                    next_sample: first + n_samples,
                    n_found,
                    hits,
                    ..CellTally::default()
                }
            });
            let tally =
                ShardTally { request: "tight".to_owned(), round: round.round, arm: shard.arm, cells: cells.collect() };
            ledger.add(&tally);
            tallies.push(tally);
        }
        next_idx += round.shards.len();
        rounds.push(round);
    }
    (rounds, tallies, ledger)
}

/// Arm 2 hits a bucket in one sample of four, in every third cell; arm 1 in one of forty; arm 0 never.
pub(super) fn world(arm: usize, cell: usize, sample: usize) -> Option<usize> {
    let draw = Seed(9).derive("world", &[arm as u64, cell as u64, sample as u64]).rng().uniform();
    let rate = [0.0, 0.025, if cell.is_multiple_of(3) { 0.25 } else { 0.0 }][arm];
    (draw < rate).then_some((cell / 3) % 4)
}

#[test]
fn arms_become_sweeps_at_each_strength() {
    let resolved = resolve(&request(
        "arms = ['guided', 'plain']\nper_bucket = 2\nbudget = { n_samples = 9 }\nn_scenes = 7\n\
         limits = { pair_min_ttc_s = { at_least = 1 } }\npairs = { per_scene = 2 }",
    ));
    let names: Vec<&str> = resolved.sweeps.iter().map(|sweep| sweep.name.as_str()).collect();
    assert_eq!(names, ["tight/guided@1", "tight/guided@8", "tight/plain"]);
    assert_eq!(resolved.n_sweeps, 0);
    let sweep = &resolved.sweeps[1];
    let found = (sweep.levels()[0].strength, sweep.levels().len(), sweep.n_scenes, sweep.pairs.per_scene);
    assert_eq!(found, (8.0, 1, 7, 2));
    assert_eq!((sweep.behavior.as_deref(), sweep.n_samples), (Some("cut_in"), 3));
    let arms: Vec<(&str, usize, u64)> =
        resolved.requests[0].arms.iter().map(|arm| (arm.name.as_str(), arm.sweep_idx, arm.n_evaluations)).collect();
    assert_eq!(arms, [("guided@1", 0, 39), ("guided@8", 1, 39), ("plain", 2, 39)]);
}

#[test]
fn the_first_round_tries_every_arm_on_the_same_cells_with_the_same_noise() {
    let request = tight("per_bucket = 5\nbudget = { n_samples = 600 }");
    let (rounds, _, _) = fulfil(&request, &pool(30), 1, world);
    assert_eq!(rounds[0].shards.iter().map(|shard| shard.arm).collect::<Vec<_>>(), [0, 1, 2]);
    for shard in &rounds[0].shards {
        assert_eq!((shard.members.as_slice(), shard.plan.first_sample), ([0, 1, 2, 3].as_slice(), 0));
    }
}

#[test]
fn no_noise_is_used_twice_after_the_first_round() {
    for plan in ["", "plan = 'even'\n"] {
        let request = tight(&format!("{plan}per_bucket = 9\nbudget = {{ n_samples = 900 }}"));
        let (rounds, _, _) = fulfil(&request, &pool(7), 1, world);
        assert!(rounds.len() > 5);
        // Each arm comes to all cells in turn, and three arms to the same.
        let shards: Vec<&RoundShard> = rounds.iter().flat_map(|round| &round.shards).collect();
        let in_turn = [[0, 1, 2, 3], [4, 5, 6, 0], [1, 2, 3, 4]].iter().flat_map(|cells| [cells; 3]);
        assert!(plan.is_empty() || in_turn.zip(&shards).all(|(cells, shard)| shard.members == cells), "{shards:?}");
        let mut used = BTreeSet::new();
        for shard in shards {
            let is_first = rounds[0].shards.contains(shard);
            for (cell, sample) in shard.members.iter().flat_map(|cell| (0..3).map(move |sample| (*cell, sample))) {
                let is_new = used.insert((cell, shard.plan.first_sample + sample));
                assert!(is_new || is_first, "cell {cell}, shard {}", shard.plan.idx);
            }
        }
    }
}

#[test]
fn decisions_follow_from_the_seed_and_the_finished_shards() {
    let request = tight("per_bucket = 5\nbudget = { n_samples = 600 }");
    let pool = pool(30);
    let (rounds, tallies, _) = fulfil(&request, &pool, 1, world);
    assert_eq!(rounds, fulfil(&request, &pool, 1, world).0);
    assert_ne!(rounds, fulfil(&request, &pool, 2, world).0);
    // Resumed after any number of rounds, as after an interruption, the next round is the same.
    for n_done in 0..rounds.len() {
        let mut ledger = Ledger::new(&request, &pool);
        tallies.iter().filter(|tally| tally.round < n_done).for_each(|tally| ledger.add(tally));
        let next_idx = rounds[..n_done].iter().map(|round| round.shards.len()).sum();
        let context = RoundContext {
            pool: &pool,
            ledger: &ledger,
            round: n_done,
            next_idx,
            cells_per_shard: 4,
            seed: Seed(1),
            templates: None,
        };
        assert_eq!(request.next_round(&context).unwrap().as_ref(), Some(&rounds[n_done]));
    }
    let indices: Vec<usize> = rounds.iter().flat_map(|round| round.shards.iter().map(|shard| shard.plan.idx)).collect();
    assert_eq!(indices, (0..indices.len()).collect::<Vec<_>>());
}

#[test]
fn the_adaptive_plan_goes_where_open_buckets_fill_and_needs_less_than_the_grid() {
    let pool = pool(30);
    let (mut adaptive_total, mut even_total, mut by_best_arm) = (0, 0, 0);
    for seed in 0..12 {
        let (_, _, adaptive) = fulfil(&tight("per_bucket = 5\nbudget = { n_samples = 6000 }"), &pool, seed, world);
        let (_, _, even) =
            fulfil(&tight("plan = 'even'\nper_bucket = 5\nbudget = { n_samples = 6000 }"), &pool, seed, world);
        assert!(adaptive.is_closed() && even.is_closed());
        by_best_arm += adaptive.arms[2].n_samples;
        adaptive_total += adaptive.spent().0;
        even_total += even.spent().0;
        // No cell gives more than three of a bucket.
        let most = adaptive.cells.iter().flat_map(|cell| cell.hits.values()).map(|hits| hits.n_accepted).max();
        assert!(most.unwrap() <= 3);
    }
    assert!(10 * adaptive_total < 9 * even_total, "{adaptive_total} against {even_total} samples");
    assert!(
        2 * by_best_arm > adaptive_total,
        "{by_best_arm} of {adaptive_total} samples with the arm that fills buckets"
    );
}

#[test]
fn the_budget_is_never_exceeded_and_what_is_full_ends() {
    for (budget, most) in [("n_samples = 100", (100, u64::MAX)), ("n_evaluations = 2000", (u64::MAX, 2000))] {
        let request = tight(&format!("per_bucket = 50\nbudget = {{ {budget} }}"));
        let (_, _, ledger) = fulfil(&request, &pool(30), 1, world);
        let (n_samples, n_evaluations) = ledger.spent();
        assert!(!ledger.is_closed() && n_samples <= most.0 && n_evaluations <= most.1);
        assert!(n_samples + 12 > most.0 || n_evaluations + 12 * 39 > most.1, "nothing is left unused");
    }
    let (rounds, _, ledger) = fulfil(&tight("per_bucket = 1\nbudget = { n_samples = 4000 }"), &pool(30), 1, world);
    assert!(ledger.is_closed() && rounds.len() < 20);
    let request = tight("per_bucket = 1\nbudget = { n_samples = 4000 }");
    let summary = RequestSummary::new(&request, &pool(30), &ledger, rounds.len());
    assert_eq!((summary.ended, summary.n_accepted, summary.short().count()), (Ended::Full, 4, 0));
    let by_arm: u64 = summary.buckets.iter().flat_map(|bucket| &bucket.accepted_by_arm).sum();
    assert_eq!(by_arm, 4);
    assert_eq!(summary.arms.iter().map(|arm| arm.total.n_samples).sum::<u64>(), summary.n_samples);
    assert!(summary.buckets.iter().all(|bucket| bucket.n_samples_while_open <= summary.n_samples));
}

#[test]
fn cheap_arms_are_preferred_where_evaluations_are_counted() {
    let arms = "[[arms]]\nname = 'dear'\nn_samples = 3\nsampler = { kind = 'heun', n_steps = 80 }\n";
    let more = "arms = ['plain', 'dear']\nper_bucket = 30\nbudget = { n_evaluations = 60000 }";
    let request = resolve(&format!("{arms}{}", request(more))).requests.remove(0);
    // Both are as likely to hit.
    let (_, _, ledger) = fulfil(&request, &pool(30), 1, |_, cell, sample| world(2, 3 * cell, sample));
    assert!(ledger.arms[0].n_samples > 2 * ledger.arms[1].n_samples, "{:?}", ledger.arms);
}

#[test]
fn an_arm_that_misses_the_open_bucket_is_left_for_one_that_hits_what_it_aims_at() {
    let other = "[[arms]]\nname = 'other'\nn_samples = 3\nstrengths = [5.0]\nclassifier_scope = 'none'\n\
                 objectives = [{ kind = 'cut_in' }]\n";
    let more = "arms = ['aimed', 'other']\nper_bucket = 5\nbudget = { n_samples = 9000 }";
    let request = resolve(&format!("{other}{}", request(more))).requests.remove(0);
    let pool = pool(30);
    let mut ledger = Ledger::new(&request, &pool);
    let mut add = |arm: usize, aimed: usize, n_samples: u64, hits: Hits| {
        let hits = BTreeMap::from([(aimed, hits)]);
        let cell = CellTally { n_samples, aimed: Some(aimed), hits, ..CellTally::default() };
        ledger.add(&ShardTally { request: "tight".to_owned(), round: 0, arm, cells: vec![cell] });
    };
    // One arm has now and then hit the open bucket, the other has not been tried on it.
    add(0, 3, 1000, Hits { n_accepted: 2, ..Hits::default() });
    (0..3).for_each(|bucket| add(1, bucket, 30, Hits { n_accepted: 5, n_surplus: 22, ..Hits::default() }));
    let context = RoundContext {
        pool: &pool,
        ledger: &ledger,
        round: 1,
        next_idx: 4,
        cells_per_shard: 4,
        seed: Seed(1),
        templates: None,
    };
    let round = request.next_round(&context).unwrap().unwrap();
    assert!(round.shards.len() > 1 && round.shards.iter().all(|shard| shard.arm == 1), "{round:?}");
}

#[test]
fn buckets_that_nobody_can_reach_cost_nothing_and_the_others_decide_the_end() {
    let request = tight("per_bucket = 2\nbudget = { n_samples = 3000 }");
    let pool = Pool {
        feasible: (0..12).map(|cell| std::iter::once((cell % 3, 0.5)).collect()).collect(),
        n_infeasible: 5,
        ..pool(12)
    };
    assert_eq!((0..4).map(|bucket| pool.n_feasible(bucket)).collect::<Vec<_>>(), [4, 4, 4, 0]);
    let (_, _, ledger) = fulfil(&request, &pool, 1, |_, cell, _| Some(cell % 3));
    assert_eq!(ledger.accepted, [2, 2, 2, 0]);
    assert!(ledger.is_closed() && ledger.spent().0 < 300, "{:?}", ledger.spent());
    let summary = RequestSummary::new(&request, &pool, &ledger, 1);
    assert_eq!((summary.ended, summary.n_infeasible), (Ended::Full, 5));
    assert_eq!(summary.infeasible().map(|bucket| bucket.idx).collect::<Vec<_>>(), [3]);
}

#[test]
fn a_bucket_of_which_nothing_comes_is_given_up() {
    // Bucket 3 seems to be within reach of every cell, and is never hit; the others are.
    let request = tight("arms = ['plain', 'aimed']\nper_bucket = 2\nbudget = { n_samples = 30000 }");
    let pool = pool(12);
    let (_, _, ledger) = fulfil(&request, &pool, 1, |_, cell, sample| Some((cell + sample) % 3));
    assert_eq!(ledger.accepted, [2, 2, 2, 0]);
    assert!(ledger.is_closed() && ledger.is_given_up(3) && !ledger.is_given_up(0));
    assert!((200..3000).contains(&ledger.spent().0), "{:?}", ledger.spent());
    let summary = RequestSummary::new(&request, &pool, &ledger, 1);
    assert_eq!(summary.ended, Ended::GivenUp);
    assert_eq!(summary.given_up().map(|bucket| bucket.idx).collect::<Vec<_>>(), [3]);
    // A grid spends its whole budget.
    let even = tight("arms = ['plain', 'aimed']\nplan = 'even'\nper_bucket = 2\nbudget = { n_samples = 3000 }");
    let (_, _, ledger) = fulfil(&even, &pool, 1, |_, cell, sample| Some((cell + sample) % 3));
    assert!(!ledger.is_closed() && ledger.spent().0 > 2900, "{:?}", ledger.spent());
}

#[test]
fn samples_of_arms_that_aim_are_asked_for_an_open_bucket_that_their_cell_can_reach() {
    let request = tight("arms = ['plain', 'aimed']\nper_bucket = 2\nbudget = { n_samples = 300 }");
    assert_eq!(request.arms.iter().map(|arm| arm.aims).collect::<Vec<_>>(), [false, true]);
    // Buckets 0 and 1 hold gaps from 0 to 5 m, the others from 5 to 10 m. Every cell reaches one bucket; none but
    // bucket 0 is ever hit.
    let pool = Pool { feasible: (0..12).map(|cell| std::iter::once((cell % 4, 0.5)).collect()).collect(), ..pool(12) };
    let (rounds, tallies, _) = fulfil(&request, &pool, 1, |_, cell, _| (cell % 4 == 0).then_some(0));
    let mut n_aimed = 0;
    for shard in rounds.iter().flat_map(|round| &round.shards) {
        for (cell, member) in shard.plan.cells.iter().zip(&shard.members) {
            match (shard.arm, cell.target(0).get("gap_m").copied()) {
                (0, None) => {}
                (1, Some([least, most])) => {
                    n_aimed += 1;
                    let low = if member % 4 < 2 { 0.0 } else { 5.0 };
                    assert!(low < least && least < most && most < low + 5.0, "{least} to {most} for cell {member}");
                }
                // A cell whose bucket is full has no target.
                (1, None) => assert_eq!(member % 4, 0),
                (arm, target) => panic!("arm {arm} aims at {target:?}"),
            }
        }
    }
    assert!(n_aimed > 20, "{n_aimed} of {} tallies", tallies.len());
}

#[test]
fn buckets_cost_what_is_spent_while_they_are_open() {
    let request = tight("per_bucket = 1\nbudget = { n_samples = 1000 }");
    let tally = |round: usize, n_accepted: u64| {
        let hits = BTreeMap::from([(1, Hits { n_accepted, n_surplus: 2, ..Hits::default() })]);
        let (n_found, [n_outside, n_beyond_limits]) = (n_accepted + 2, [n_accepted, 2 * n_accepted]);
        let cell = CellTally { n_samples: 6, n_found, n_outside, n_beyond_limits, hits, ..CellTally::default() };
        ShardTally { request: "tight".to_owned(), round, arm: 0, cells: vec![cell] }
    };
    let mut ledger = Ledger::new(&request, &pool(2));
    ledger.add(&tally(0, 1));
    ledger.add(&tally(1, 0));
    let each = request.arms[0].n_evaluations;
    assert_eq!(ledger.spent_while_open[..2], [(12, 12 * each), (6, 6 * each)]);
    let counts = |arm: &ArmCounts| [arm.n_samples, arm.n_found, arm.n_outside, arm.n_beyond_limits];
    assert_eq!([&ledger.first_round[0], &ledger.arms[0]].map(counts), [[6, 3, 1, 2], [12, 5, 1, 2]]);
    assert_eq!([Ledger::new(&request, &pool(2)).n_situations(), ledger.n_situations()], [0, 1]);
    let [empty, one] = [0, 1].map(|i| RequestSummary::new(&request, &pool(2), &ledger, 2).buckets[i].clone());
    assert_eq!((empty.n_evaluations_per_accepted(), one.n_evaluations_per_accepted()), (None, Some(6.0 * each as f64)));
    assert_eq!(BucketSummary { n_accepted: 4, ..one }.n_evaluations_per_accepted(), Some(1.5 * each as f64));

    // A scene that has given a bucket as many scenarios as it may is not drawn for it.
    let request = tight("per_bucket = 5\nmax_per_scene = 1\nbudget = { n_samples = 1000 }");
    let mut ledger = Ledger::new(&request, &pool(2));
    ledger.add(&tally(0, 0));
    assert_eq!(ledger.open_hits_of_cell(0), 2);
    ledger.add(&tally(1, 1));
    assert_eq!(ledger.open_hits_of_cell(0), 0);
    // When all cells that can fall into it have done so, it is closed, although it is not full.
    let narrow = Pool { feasible: vec![BTreeMap::from([(1, 0.0)]), BTreeMap::from([(2, 0.0)])], ..pool(2) };
    let mut ledger = Ledger::new(&request, &narrow);
    assert_eq!([0, 1, 2, 3].map(|bucket| ledger.is_open(bucket)), [false, true, true, false]);
    ledger.add(&tally(0, 1));
    assert_eq!([1, 2].map(|bucket| ledger.is_open(bucket)), [false, true]);
}

#[test]
fn a_pair_that_repeats_itself_or_misses_is_closed_to_the_bucket() {
    let request = tight("arms = ['aimed']\nper_bucket = 2\nbudget = { n_samples = 30000 }");
    let pool = pool(12);
    let after = |hits: Hits, n_shards: usize| {
        let mut ledger = Ledger::new(&request, &pool);
        for round in 0..n_shards {
            let hits = BTreeMap::from([(3, hits)]);
            let cell = CellTally { cell: 5, n_samples: 3, aimed: Some(3), hits, ..CellTally::default() };
            ledger.add(&ShardTally { request: "tight".to_owned(), round, arm: 0, cells: vec![cell] });
        }
        [ledger.is_open_to(5, 3), ledger.is_open_to(5, 0), ledger.is_open_to(4, 3)]
    };
    let alike = Hits { n_near_duplicates: 3, ..Hits::default() };
    assert_eq!([after(alike, 1), after(alike, 2)], [[true; 3], [false, true, true]]);
    // Where nobody hits, misses tell nothing of a pair.
    assert_eq!([after(Hits::default(), 1), after(Hits::default(), 9)], [[true; 3]; 2]);
    let mut ledger = Ledger::new(&request, &pool);
    let mut add = |cell: usize, bucket: usize, n_surplus: u64| {
        let hits = BTreeMap::from([(bucket, Hits { n_surplus, ..Hits::default() })]);
        let cell = CellTally { cell, n_samples: 3, aimed: Some(bucket), hits, ..CellTally::default() };
        ledger.add(&ShardTally { request: "tight".to_owned(), arm: 0, cells: vec![cell], ..ShardTally::default() });
    };
    // Others hit in two of three: of nine samples, more than four usually do.
    (0..20).for_each(|_| add(0, 0, 2));
    (0..3).for_each(|_| add(5, 3, 0));
    assert!(!ledger.is_open_to(5, 3) && ledger.is_open_to(4, 3) && ledger.is_open_to(0, 1));
}

#[test]
fn a_round_aims_no_more_samples_at_a_bucket_than_will_probably_fill_it() {
    let request = tight("arms = ['aimed']\nper_bucket = 2\nbudget = { n_samples = 30000 }");
    let pool = pool(60);
    let mut ledger = Ledger::new(&request, &pool);
    // Bucket 0 lacks one, and every second sample hits; where nothing is known, so many are expected to.
    let hits = BTreeMap::from([(0, Hits { n_accepted: 1, n_surplus: 29, ..Hits::default() })]);
    let cell = CellTally { n_samples: 60, aimed: Some(0), hits, ..CellTally::default() };
    ledger.add(&ShardTally { request: "tight".to_owned(), cells: vec![cell], ..ShardTally::default() });
    let context = RoundContext {
        pool: &pool,
        ledger: &ledger,
        round: 1,
        next_idx: 1,
        cells_per_shard: 4,
        seed: Seed(1),
        templates: None,
    };
    let round = request.next_round(&context).unwrap().unwrap();
    let mut n_cells = [0; 4];
    round.shards.iter().flat_map(|shard| &shard.aims).for_each(|aim| n_cells[aim.unwrap().bucket] += 1);
    assert_eq!(n_cells, [1, 2, 2, 2], "three samples each");
}

/// A request whose samples follow templates.
fn by_template() -> ResolvedRequest {
    let arms = "[[arms]]\nname = 'template'\nn_samples = 3\nclassifier_scope = 'none'\ntemplate = true\n";
    let more = "arms = ['template']\nper_bucket = 4\nbudget = { n_samples = 3000 }";
    resolve(&format!("{arms}{}", request(more))).requests.remove(0)
}

/// A template in which one agent is at `x_m` in half a second.
fn shown(number: usize, bucket: usize, x_m: f64, event: Option<EventValues>) -> Shown {
    let path = serde_json::from_value(serde_json::json!({ "points": [[x_m, 0.0]], "n_agents": 1 })).unwrap();
    Shown { number, bucket: Some(bucket), path, event }
}

#[test]
fn templates_are_sampled_only_for_buckets_that_lack_what_they_show_and_each_motion_once() {
    let request = by_template();
    let pool = pool(6);
    // Whatever the templates of a cell are solved for, they show these buckets; one moves almost as another.
    let all = [(0, 0.0), (1, 10.0), (1, 10.2), (2, 20.0)];
    let all: Vec<Shown> = (0..).zip(all).map(|(number, (bucket, x_m))| shown(number, bucket, x_m, None)).collect();
    let templates = |_: usize, _: usize, _: usize| Ok(Some(all.clone().into()));
    let (rounds, tallies, mut ledger) = fulfil_with(&request, (&pool, Some(&templates)), 1, |_, _, _| None);
    assert_eq!(ledger.accepted, [4, 4, 4, 0]);
    // What fills three buckets, and at most one more of each: where every sample hits, 5 are expected to bring 4.
    assert!((12..=15).contains(&ledger.spent().0), "{:?}", ledger.spent());
    let tried = tallies.iter().flat_map(|tally| &tally.cells).flat_map(|cell| &cell.tried);
    assert!(tried.clone().all(|(_, number)| *number != 2) && tried.count() as u64 == ledger.spent().0);
    // Nothing shows bucket 3: it is given up although the budget lasts.
    assert!(!ledger.is_closed() && !request.has_spent(ledger.spent()));
    ledger.exhaust();
    assert!(ledger.is_closed() && ledger.is_given_up(3));
    assert_eq!(RequestSummary::new(&request, &pool, &ledger, rounds.len()).ended, Ended::GivenUp);
}

#[test]
fn a_motion_that_was_not_accepted_is_sampled_once_more() {
    let (request, pool) = (by_template(), pool(1));
    let event: EventValues = serde_json::from_value(serde_json::json!({ "gap_m": 300 })).unwrap();
    let templates = |_: usize, _: usize, _: usize| Ok(Some(vec![shown(0, 0, 0.0, Some(event.clone()))].into()));
    let goes_on_after = |n_tallies: usize, accepted_events: Vec<EventValues>| {
        let mut ledger = Ledger::new(&request, &pool);
        let cell = CellTally { n_samples: 1, tried: vec![(0, 0)], accepted_events, ..CellTally::default() };
        let tally = ShardTally { request: "tight".to_owned(), cells: vec![cell], ..ShardTally::default() };
        (0..n_tallies).for_each(|_| ledger.add(&tally));
        let (pool, ledger, templates) = (&pool, &ledger, Some(&templates as &Templates<'_>));
        let context =
            RoundContext { pool, ledger, round: 1, next_idx: 1, cells_per_shard: 4, seed: Seed(1), templates };
        request.next_round(&context).unwrap().is_some()
    };
    assert_eq!([0, 1, 2].map(|n| goes_on_after(n, Vec::new())), [true, true, false]);
    assert!(!goes_on_after(1, vec![event.clone()]));
}
