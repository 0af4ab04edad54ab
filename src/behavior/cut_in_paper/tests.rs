//! Tests of the search for cut-ins; their definition is tested by the example scenes.

use super::*;
use crate::behavior::testing::random_scene;
use crate::geometry::OrientedBox;

/// An ordered pair of agents (ego, other), its label, and (t_other, t_ego) of a cut-in.
type Verdict = (usize, usize, EventLabel, Option<(usize, usize)>);

/// The definition without any pruning: every pair of states of every ordered pair of agents.
fn plain_labels(config: &CutInPaper, scene: &Scene) -> Vec<Verdict> {
    let footprint = |agent_idx: usize, t: usize| -> Option<OrientedBox> { scene.tracks[agent_idx].footprint_at(t) };
    let present = scene.current_timestep();
    let n_agents = scene.tracks.len();
    let mut labels = Vec::new();
    let ordered = (0..n_agents).flat_map(|i| (i + 1..n_agents).flat_map(move |j| [(i, j), (j, i)]));
    for (ego, other) in ordered {
        let Some(initial) = footprint(other, present).filter(|_| footprint(ego, present).is_some()) else {
            continue;
        };
        let judged = 0..scene.n_timesteps;
        let mut first = None;
        for t_other in scene.n_history..scene.n_timesteps {
            for t_ego in scene.n_history..scene.n_timesteps {
                let delay_s = (t_ego as f64 - t_other as f64) * scene.dt_s;
                let (Some(own), Some(theirs)) = (footprint(ego, t_ego), footprint(other, t_other)) else {
                    continue;
                };
                let turned = angle_difference(own.heading_rad, theirs.heading_rad).abs();
                let is_overlap = delay_s > 0.0
                    && delay_s < MAX_DELAY_S - 1e-6
                    && own.overlaps(&theirs)
                    && config.max_heading_difference_rad.is_none_or(|limit| turned < limit);
                if is_overlap && first.is_none() {
                    first = Some((t_other, t_ego));
                }
            }
        }
        let overlaps = |a: Option<OrientedBox>, b: Option<OrientedBox>| a.zip(b).is_some_and(|(a, b)| a.overlaps(&b));
        let follows = judged.clone().any(|t| overlaps(footprint(ego, t), Some(initial)));
        let collides = config.collision_free
            && (present..scene.n_timesteps).any(|t| overlaps(footprint(ego, t), footprint(other, t)));
        let first = first.filter(|_| !follows && !collides);
        let mut distances_m = judged.clone().flat_map(|t| judged.clone().map(move |u| (t, u))).filter_map(|(t, u)| {
            let pair = footprint(ego, t).zip(footprint(other, u)).filter(|_| t == u || !config.same_time);
            pair.map(|(a, b)| a.distance(&b))
        });
        if first.is_some() {
            labels.push((ego, other, EventLabel::Positive, first));
        } else if distances_m.any(|distance_m| distance_m < config.negative_distance_m) {
            labels.push((ego, other, EventLabel::Negative, None));
        }
    }
    labels
}

fn labels(config: &CutInPaper, scene: &Scene) -> Vec<Verdict> {
    let idx = |event: &BehaviorEvent, role: &str| scene.track_idx(event.track(role).expect("role")).expect("track");
    let times = |event: &BehaviorEvent| {
        (event.label == EventLabel::Positive).then_some((event.start_timestep, event.end_timestep))
    };
    let events = config.detect(scene);
    events.iter().map(|e| (idx(e, "ego"), idx(e, "other"), e.label, times(e))).collect()
}

#[test]
fn the_quick_search_agrees_with_the_plain_definition() {
    let paper = CutInPaper::default();
    let configs = [
        CutInPaper { max_heading_difference_rad: Some(std::f64::consts::FRAC_PI_4), ..paper.clone() },
        CutInPaper { same_time: true, ..paper.clone() },
        CutInPaper { negative_distance_m: 2.0, collision_free: true, ..paper.clone() },
        paper,
    ];
    let (mut n_positive, mut n_negative, mut n_far) = (0, 0, 0);
    for seed in 0..16 {
        let scene = random_scene(seed, 9, 28.0);
        for config in &configs {
            let found = labels(config, &scene);
            assert_eq!(found, plain_labels(config, &scene), "seed {seed}, {config:?}");
            let positive = found.iter().filter(|label| label.2 == EventLabel::Positive).count();
            n_positive += positive;
            n_negative += found.len() - positive;
            n_far += 9 * 8 - found.len();
        }
    }
    // The scenes are of no use to this test unless all outcomes are frequent.
    assert!(n_positive > 50 && n_negative > 500 && n_far > 500, "{n_positive} {n_negative} {n_far}");
}

#[test]
fn a_delay_of_exactly_the_limit_is_too_long() {
    assert_eq!([0.1, 1.0, 0.4, 5.0].map(CutInPaper::max_delay), [29, 2, 7, 0]);
}

#[test]
fn scenes_without_a_future_have_no_events() {
    let scene = random_scene(1, 9, 20.0);
    assert!(!CutInPaper::default().detect(&scene).is_empty());
    assert!(CutInPaper::default().detect(&Scene { n_timesteps: scene.n_history, ..scene }).is_empty());
}
