//! Do the forms of guidance act together?

use super::guidance::kinds;
use super::*;
use crate::scenario::ScenarioRecord;
use crate::scene::GuidanceLevel;

const GUIDED: &str = "
    splits = ['train']
    [[sweeps]]
    name = 'guided'
    n_scenes = 3
    n_samples = 2
    behavior = 'drift'
";
const GOALS: &str = "classifier_free = { extra = [{ agents = 'all', times = 'goal' }], goal_std_m = 0.5, weights =";

fn at(records: &[ScenarioRecord], strength: f64, weight: f64) -> Vec<&ScenarioRecord> {
    let level = GuidanceLevel { strength, weight };
    records.iter().filter(|record| record.scenario.provenance.guidance.level == level).collect()
}

/// The largest distance of states of the same samples, meters.
fn apart_m(a: &[&ScenarioRecord], b: &[&ScenarioRecord]) -> f64 {
    assert!(!a.is_empty() && a.len() == b.len());
    a.iter().zip(b).map(|(a, b)| difference_m(&a.scenario.scene, &b.scenario.scene)).fold(0.0, f64::max)
}

#[test]
fn classifier_objectives_and_wanted_states_act_together() {
    let run = |rest: &str| generate(&config(&format!("{GUIDED}{rest}")));
    let wish = "objectives = [{ kind = 'no_collision', margin_m = 2.0 }]";
    let both = run(&format!("strengths = [0.0, 3.0]\n{GOALS} [0.7] }}\n{wish}"));
    assert_eq!(kinds(&both), ["classifier:drift+no_collision+classifier_free", "classifier_free"]);
    // Where one of the two is 0, samples are those of the other one alone, to the bit.
    let leaning = run(&format!("{GOALS} [0.7] }}"));
    assert_eq!(apart_m(&at(&both, 0.0, 0.7), &at(&leaning, 0.0, 0.7)), 0.0);
    let guided = run(&format!("strengths = [3.0]\n{wish}"));
    let other_way = run(&format!("strengths = [3.0]\n{GOALS} [0.0, 0.7] }}\n{wish}"));
    assert_eq!(kinds(&other_way), ["classifier:drift+no_collision", "classifier:drift+no_collision+classifier_free"]);
    assert_eq!(apart_m(&at(&other_way, 3.0, 0.0), &at(&guided, 3.0, 0.0)), 0.0);
    assert_eq!(apart_m(&at(&other_way, 3.0, 0.7), &at(&both, 3.0, 0.7)), 0.0);
    for alone in [at(&leaning, 0.0, 0.7), at(&guided, 3.0, 0.0)] {
        assert!(apart_m(&at(&both, 3.0, 0.7), &alone) > 1e-3);
    }
}
