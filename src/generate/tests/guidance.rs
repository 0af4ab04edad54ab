//! Do classifier and objectives act as the sweep configures, alone and together, and does the provenance record it?

use super::*;
use crate::behavior::{BehaviorConfig, BehaviorEvent, Outcome, Template};
use crate::diffusion::SamplerConfig;
use crate::guidance::Target;
use crate::metrics::MetricSettings;
use crate::scenario::ScenarioRecord;
use crate::scene::Track;
use std::collections::BTreeSet;

const OBJECTIVES: &str = "
    splits = ['train']
    [[sweeps]]
    name = 'smooth'
    n_scenes = 3
    n_samples = 2
    strengths = [0.0, 1.0]
    objectives = [{ kind = 'acceleration_limit', limit_mps2 = 0.5 }]
";

pub(super) fn kinds(records: &[ScenarioRecord]) -> Vec<&str> {
    let mut kinds: Vec<&str> = records.iter().map(|r| r.scenario.provenance.guidance.kind.as_str()).collect();
    kinds.sort_unstable();
    kinds.dedup();
    kinds
}

/// The mean second difference of generated positions, meters, over the tracks with this role in records of a strength;
/// over all tracks without a role.
fn jolts_m(records: &[ScenarioRecord], strength: f64, role: Option<&str>) -> f64 {
    let own = records.iter().filter(|record| record.scenario.provenance.guidance.level.strength == strength);
    let tracks = own.flat_map(|record| {
        let meant = role.and_then(|role| record.scenario.provenance.guidance.roles.track(role));
        record.scenario.scene.tracks.iter().filter(move |track| meant.is_none_or(|id| track.id == *id))
    });
    let jolts = tracks.flat_map(|track| {
        let at = |t: usize| track.trajectory.get(t).map(|state| state.position);
        let jolt = move |t: usize| Some((at(t - 2)? - at(t - 1)? * 2.0 + at(t)?).norm());
        (N_HISTORY..track.trajectory.n_timesteps()).filter_map(jolt).collect::<Vec<_>>()
    });
    let jolts: Vec<f64> = jolts.collect();
    jolts.iter().sum::<f64>() / jolts.len() as f64
}

#[test]
fn objectives_guide_without_a_behavior() {
    let records = generate(&GenerateConfig { sampler: SamplerConfig::heun(12), ..config(OBJECTIVES) });
    assert_eq!(records.len(), 3 * 2 * 2);
    assert_eq!(kinds(&records), ["acceleration_limit", "none"]);
    assert!(records.iter().all(|r| r.scenario.provenance.classifier.is_none() && r.requested_behavior.is_none()));
    let [before, after] = [0.0, 1.0].map(|strength| jolts_m(&records, strength, None));
    assert!(after < 0.97 * before, "{before} m before, {after} m after");
}

/// Whether two boxes of the scene overlap after the history.
fn collides(scene: &Scene) -> bool {
    let overlap =
        |a: &Track, b: &Track, t: usize| a.footprint_at(t).zip(b.footprint_at(t)).is_some_and(|(a, b)| a.overlaps(&b));
    (N_HISTORY..scene.n_timesteps)
        .any(|t| scene.tracks.iter().enumerate().any(|(i, a)| scene.tracks[..i].iter().any(|b| overlap(a, b, t))))
}

#[test]
fn samples_are_kept_apart_unless_told_otherwise() {
    let n_colliding = |options: &str| {
        let sampler = SamplerConfig::heun(12);
        let toml = format!(
            "{options}\nsplits = ['train']\n[[sweeps]]\nname = 'plain'\nn_scenes = 8\nn_samples = 8\nedit.tau = 2.0\n\
             edit.edits = [{{ kind = 'meet', agent = {{ track = 'ahead' }}, with = {{ track = 'behind' }}, \
             at_s = 0.8 }}]"
        );
        let records = generate(&GenerateConfig { sampler, ..config(&toml) });
        assert_eq!(kinds(&records), ["none"]);
        records.iter().filter(|record| collides(&record.scenario.scene)).count()
    };
    // Two cars are led into each other, and an untrained network knows nothing of cars.
    let (raw, kept) = (n_colliding("validity_strength = 0.0"), n_colliding("validity_strength = 100.0"));
    assert!(raw >= 8 && kept < raw / 2, "{raw} of 64 raw samples collide, {kept} of those that are kept apart");
    let default = n_colliding("");
    assert!(default < raw, "{raw} of 64 raw samples collide, {default} by default");
}

#[test]
fn classifier_and_objectives_act_together() {
    let together = config(&format!("{SWEEPS}    objectives = [{{ kind = 'no_collision', margin_m = 2.0 }}]"));
    let (records, classified) = (generate(&together), generate(&config(SWEEPS)));
    let guided = |records: &[ScenarioRecord]| -> Vec<ScenarioRecord> {
        records[15..].iter().filter(|r| r.scenario.provenance.guidance.level.strength == 3.0).cloned().collect()
    };
    let (guided, classified) = (guided(&records), guided(&classified));
    assert_eq!(kinds(&guided), ["classifier:drift+no_collision"]);
    for (a, b) in guided.iter().zip(&classified) {
        assert_eq!(a.scenario.provenance.classifier.as_deref(), Some("classifier"));
        assert_eq!(a.scenario.provenance.guidance.roles, b.scenario.provenance.guidance.roles);
        assert_ne!(a.scenario.id, b.scenario.id);
    }
    assert!(guided.iter().zip(&classified).any(|(a, b)| difference_m(&a.scenario.scene, &b.scenario.scene) > 1e-3));
}

/// An untrained classifier prefers something or other; log odds pull harder than log p, and only this difference is
/// tested here.
#[test]
fn a_classifier_guides_the_pair_by_either_potential() {
    let run = |rest: &str| generate(&config(&format!("{SWEEPS}{rest}"))).split_off(15);
    let (log_p, log_odds) = (run(""), run("    classifier_potential = 'log_odds'"));
    assert_eq!(kinds(&log_p), ["classifier:drift", "none"]);
    assert!(!log_p[0].scenario.provenance.settings.contains("classifier_potential"));
    for (a, b) in log_p.iter().zip(&log_odds) {
        let guided = a.scenario.provenance.guidance.level.strength != 0.0;
        assert_eq!(a.scenario.scene != b.scenario.scene, guided);
        let told = b.scenario.provenance.settings.contains(r#""classifier_potential":"log_odds""#);
        assert_eq!(told, guided);
    }
}

#[test]
fn objectives_alone_may_serve_a_behavior() {
    let toml = format!(
        "{SWEEPS}    classifier_scope = 'none'\n    objectives = [{{ kind = 'acceleration_limit', agents = 'other', \
         limit_mps2 = 0.5 }}]"
    );
    let (denoiser, config) = (denoiser(0), resolve(&toml));
    let models = Models { denoiser: &denoiser, classifiers: &[], distilled: None, baseline: None };
    let behaviors = drift();
    let generator =
        Generator::new(&config, models, &behaviors, &load, MetricSettings::default(), &Device::Cpu).unwrap();
    let plan = generator.plan(&index(12)).unwrap();
    let records = generator.generate(plan.shards.last().unwrap(), &Silent).unwrap().records;
    assert_eq!(kinds(&records), ["acceleration_limit", "none"]);
    let [guided_m, plain_m] = [3.0, 0.0].map(|strength| jolts_m(&records, strength, Some("other")));
    // From the same noise.
    assert!(guided_m < plain_m, "{guided_m} m, unguided {plain_m} m");
}

#[test]
fn each_sample_of_a_pair_aims_at_another_of_its_outcomes_whatever_the_batch() {
    let asked = "behavior = 'drift'\n    classifier_scope = 'none'\n    objectives = [{ kind = 'cut_in' }]\n    \
                 aim = 'feasible'";
    let aimed = SWEEPS.replace("behavior = 'drift'", asked).replace("n_samples = 2", "n_samples = 5");
    let plan = with_generator(&config(&aimed), 0, |generator| generator.plan(&index(12)).unwrap());
    for cell in &plan.shards.last().unwrap().cells {
        let gaps: BTreeSet<u64> = cell.targets.iter().map(|target| target["gap_m"][0].to_bits()).collect();
        assert_eq!((cell.targets.len(), gaps.len()), (5, 5), "{:?}", cell.targets);
        assert!(cell.targets.iter().all(|target| target["gap_m"][1] - target["gap_m"][0] == 1.0));
    }
    let own = |config: &GenerateConfig| generate(config).split_off(15);
    let (reference, same) = (own(&config(&aimed)), own(&config(&aimed.replace("aim = 'feasible'", ""))));
    assert_eq!(reference.len(), 4 * 5 * 2);
    let moved = reference.iter().zip(&same).filter(|(a, b)| difference_m(&a.scenario.scene, &b.scenario.scene) > 1e-3);
    assert!(moved.clone().all(|(a, _)| a.scenario.provenance.guidance.level.strength != 0.0) && moved.count() > 10);
    for batch_size in [1, 2, 7] {
        for (a, b) in reference.iter().zip(&own(&GenerateConfig { batch_size, ..config(&aimed) })) {
            assert!(difference_m(&a.scenario.scene, &b.scenario.scene) < ROUNDING_M, "batches of {batch_size}");
        }
    }
}

#[test]
fn who_follows_a_template_is_observed_and_each_sample_has_its_own_whatever_the_batch() {
    let asked = "behavior = 'drift'\n    classifier_scope = 'none'\n    template = true\n    aim = 'feasible'";
    let templates = SWEEPS.replace("behavior = 'drift'", asked).replace("n_samples = 2", "n_samples = 5");
    let templates = templates.replace("strengths = [0.0, 3.0]", "");
    let own = |config: &GenerateConfig| generate(config).split_off(15);
    let records = own(&config(&templates));
    assert_eq!(records.len(), 4 * 5);
    assert_eq!(kinds(&records), ["template"]);
    for cell in records.chunks(5) {
        let mut ends: Vec<f64> = Vec::new();
        for record in cell {
            let scenario = &record.scenario;
            let performer = &scenario.provenance.guidance.roles.tracks().nth(1).unwrap();
            let idx = scenario.scene.track_idx(performer).unwrap();
            let n_timesteps = scenario.scene.n_timesteps;
            let velocity_mps = |timestep: usize| scenario.scene.state(idx, timestep).unwrap().velocity;
            // It follows its template, which drifts to the right, and is judged like samples.
            let n_history = scenario.scene.n_history;
            let is_observed = |agent: usize| (n_history..n_timesteps).any(|t| scenario.observed.is_observed(agent, t));
            assert!(record.verified && !(0..3).any(is_observed));
            let drifts: Vec<f64> = (n_history..n_timesteps).map(|t| velocity_mps(t).y).collect();
            assert!(drifts.iter().all(|mps| *mps < 0.0), "{drifts:?}");
            assert!(!scenario.provenance.is_unguided());
            ends.push(scenario.scene.state(idx, scenario.scene.n_timesteps - 1).unwrap().position.y);
        }
        ends.sort_by(f64::total_cmp);
        assert!(ends.windows(2).all(|pair| pair[1] - pair[0] > 0.1), "{ends:?}");
    }
    for batch_size in [1, 2, 7] {
        for (a, b) in records.iter().zip(&own(&GenerateConfig { batch_size, ..config(&templates) })) {
            assert!(difference_m(&a.scenario.scene, &b.scenario.scene) < ROUNDING_M, "batches of {batch_size}");
        }
    }
    with_generator(&config(&templates), 0, |generator| {
        let plan = generator.plan(&index(12)).unwrap();
        let shard = plan.shards.last().unwrap();
        let output = generator.generate(shard, &Silent).unwrap();
        for record in &output.records {
            let key = SampleKey::of(shard, &record.scenario.provenance).unwrap();
            assert_eq!(generator.regenerate(shard, key).unwrap().unwrap().scenario, record.scenario);
        }
    });
}

#[test]
fn what_would_repeat_the_template_of_another_sample_is_not_sampled() {
    // Without an aim, every template of a pair is the same.
    let asked = "behavior = 'drift'\n    classifier_scope = 'none'\n    template = true";
    let templates = SWEEPS.replace("behavior = 'drift'", asked).replace("n_samples = 2", "n_samples = 5");
    let templates = templates.replace("strengths = [0.0, 3.0]", "");
    with_generator(&config(&templates), 0, |generator| {
        let plan = generator.plan(&index(12)).unwrap();
        let shard = plan.shards.last().unwrap();
        let output = generator.generate(shard, &Silent).unwrap();
        assert_eq!(output.records.len(), shard.cells.len());
        assert!(output.records.iter().all(|record| record.scenario.provenance.sample_idx == shard.first_sample));
        assert_eq!(output.rejected.len(), 4 * shard.cells.len());
        assert!(output.rejected.iter().all(|sample| sample.reason == Rejection::RepeatedTemplate));
        let key = SampleKey::of(shard, &output.records[0].scenario.provenance).unwrap();
        assert_eq!(generator.regenerate(shard, key).unwrap().unwrap().scenario, output.records[0].scenario);
        let repeated = SampleKey { sample_idx: key.sample_idx + 1, ..key };
        assert!(generator.regenerate(shard, repeated).unwrap().is_none());
        // Where a plan names templates, each cell has a sample for each.
        let planned = ShardPlan { templates: vec![vec![0]; shard.cells.len() - 1], ..shard.clone() };
        let planned = ShardPlan { templates: [planned.templates, vec![Vec::new()]].concat(), ..planned };
        let output = generator.generate(&planned, &Silent).unwrap();
        let counts = (planned.n_samples(generator.config), output.records.len(), output.rejected.len());
        assert_eq!(counts, (shard.cells.len() - 1, shard.cells.len() - 1, 0));
        let again = generator.regenerate(&planned, key).unwrap().unwrap();
        assert_eq!(again.scenario, output.records[key.cell].scenario);
    });
}

/// The drift with two templates, the first of which goes much farther than is wanted.
struct TwoDrifts;

impl Behavior for TwoDrifts {
    fn id(&self) -> &'static str {
        Drift.id()
    }

    fn roles(&self) -> &'static [&'static str] {
        Drift.roles()
    }

    fn detect(&self, scene: &Scene) -> Vec<BehaviorEvent> {
        Drift.detect(scene)
    }

    fn feasible(&self, scene: &Scene, agents: &[usize]) -> Vec<Outcome> {
        Drift.feasible(scene, agents)
    }

    fn template_parameters(&self) -> &'static [&'static str] {
        Drift.template_parameters()
    }

    fn templates(&self, scene: &Scene, agents: &[usize], wanted: &Target, n: usize) -> Vec<Template> {
        let farther = Target::from([("gap_m".to_owned(), [100.0, 100.0])]);
        [&farther, wanted].into_iter().flat_map(|wanted| Drift.templates(scene, agents, wanted, n)).collect()
    }
}

#[test]
fn templates_keep_their_numbers_where_others_are_left_out() {
    let asked = "behavior = 'drift'\n    classifier_scope = 'none'\n    template = true";
    let sweeps = SWEEPS.replace("behavior = 'drift'", asked).replace("strengths = [0.0, 3.0]", "");
    let request = "[[arms]]\nname = 'a'\n[[requests]]\nname = 'r'\nbehavior = 'cut_in'\narms = ['a']\n\
                   per_bucket = 1\nbudget = { n_samples = 9 }\nbuckets = { gap_m = [0, 4] }";
    let config_of_request: GenerateConfig = toml::from_str(request).unwrap();
    let cut_in = BehaviorConfig::from_id("cut_in").unwrap().build();
    let mut request = config_of_request.resolve(&[cut_in]).unwrap().requests.remove(0);
    request.arms[0].sweep_idx = 1;
    let (denoiser, behaviors): (_, [Box<dyn Behavior>; 1]) = (denoiser(0), [Box::new(TwoDrifts)]);
    let config = config(&sweeps).resolve(&behaviors).unwrap();
    let classifiers = [classifier()];
    let models = Models { denoiser: &denoiser, classifiers: &classifiers, distilled: None, baseline: None };
    let generator =
        Generator::new(&config, models, &behaviors, &load, MetricSettings::default(), &Device::Cpu).unwrap();
    let plan = generator.plan(&index(12)).unwrap();
    let shown = generator.shown(&request, 0, &plan.shards.last().unwrap().cells[0], 0).unwrap();
    let found: Vec<_> = shown.iter().map(|shown| (shown.number, shown.bucket)).collect();
    assert_eq!(found, [(1, Some(0))]);
}

#[test]
fn templates_show_the_bucket_of_their_event_and_those_of_none_are_left_out() {
    let asked = "behavior = 'drift'\n    classifier_scope = 'none'\n    template = true";
    let templates = SWEEPS.replace("behavior = 'drift'", asked).replace("strengths = [0.0, 3.0]", "");
    let shown = |edges: &str, condition: &str| {
        let request = "[[arms]]\nname = 'a'\n[[requests]]\nname = 'r'\nbehavior = 'cut_in'\narms = ['a']\n\
                       per_bucket = 1\nbudget = { n_samples = 9 }\nbuckets";
        let config_of_request: GenerateConfig =
            toml::from_str(&format!("{request} = {{ gap_m = {edges} }}\n{condition}")).unwrap();
        let cut_in = BehaviorConfig::from_id("cut_in").unwrap().build();
        let mut request = config_of_request.resolve(&[cut_in]).unwrap().requests.remove(0);
        request.arms[0].sweep_idx = 1;
        with_generator(&config(&templates), 0, |generator| {
            let plan = generator.plan(&index(12)).unwrap();
            let shown = |bucket| generator.shown(&request, 0, &plan.shards.last().unwrap().cells[0], bucket).unwrap();
            [0, 1].iter().flat_map(|bucket| shown(*bucket)).map(|shown| shown.bucket).collect::<Vec<_>>()
        })
    };
    // The agent drifts by most of 3 m and a quarter of the sum of the target's ends.
    assert_eq!(shown("[0, 4, 20]", ""), [Some(0), Some(1)]);
    assert_eq!(shown("[0, 0.5, 1]", ""), []);
    // How much time it leaves is not known of an event without a vehicle that it happens to.
    assert_eq!(shown("[0, 4, 20]", "where = { careful_margin_s = [-0.5, 0.5] }"), [None, None]);
}
