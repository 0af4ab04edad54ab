//! Do particles and optimized noise act as the sweep says, whatever the batches, and again to the bit?

use super::*;
use crate::scenario::ScenarioRecord;

const PARTICLES: &str = "
    splits = ['train']
    [[sweeps]]
    name = 'slow'
    n_scenes = 3
    n_samples = 8
    objectives = [{ kind = 'target_speed', speed_mps = 2.0 }]
    sampler = { kind = 'dpmpp_2m', n_steps = 6, eta = 1.0 }
    particles = { n = 4, strength = 20.0 }
";
const OPTIMIZED: &str = "
    splits = ['train']
    [[sweeps]]
    name = 'slow'
    n_scenes = 3
    n_samples = 2
    objectives = [{ kind = 'target_speed', speed_mps = 2.0 }]
    sampler = { kind = 'euler', n_steps = 2, grid = { sigma_max = 20, sigma_min = 1.5 } }
    noise_optimization = { iterations = 8, learning_rate = 0.1 }
    validity_strength = 0.0
";

fn without(toml: &str, key: &str) -> String {
    let keys = [key, "objectives"];
    toml.lines().filter(|line| !keys.iter().any(|key| line.trim().starts_with(key))).collect::<Vec<_>>().join("\n")
}

/// The mean deviation of generated speeds from 2 m/s.
fn deviation_mps(records: &[ScenarioRecord]) -> f64 {
    let tracks = records.iter().flat_map(|record| &record.scenario.scene.tracks);
    let states = tracks.flat_map(|track| track.trajectory.valid().filter(|(t, _)| *t >= N_HISTORY));
    let deviations: Vec<f64> = states.map(|(_, state)| (state.speed_mps() - 2.0).abs()).collect();
    deviations.iter().sum::<f64>() / deviations.len() as f64
}

/// Any sample of any shard, generated again, is the same to the bit.
fn assert_regenerated(toml: &str) {
    with_generator(&config(toml), 0, |generator| {
        for shard in &generator.plan(&index(12)).unwrap().shards {
            for record in &generator.generate(shard, &Silent).unwrap().records {
                let key = SampleKey::of(shard, &record.scenario.provenance).unwrap();
                assert_eq!(generator.regenerate(shard, key).unwrap().unwrap(), *record);
            }
        }
    });
}

#[test]
fn particles_lead_to_the_objective_and_optimized_noise_changes_samples() {
    for (toml, key) in [(PARTICLES, "particles"), (OPTIMIZED, "noise_optimization")] {
        let (steered, free) = (generate(&config(toml)), generate(&config(&without(toml, key))));
        assert_eq!(steered.len(), free.len());
        let (before, after) = (deviation_mps(&free), deviation_mps(&steered));
        // An untrained network is no denoiser, and its slopes need not lead to the wish within a few large steps.
        let is_led = if key == "particles" { after < 0.98 * before } else { after != before };
        assert!(is_led, "{key}: {before} m/s before, {after} m/s after");
        for record in &steered {
            let provenance = &record.scenario.provenance;
            assert_eq!(provenance.guidance.kind, key);
            assert!(!provenance.is_unguided());
            assert!(provenance.settings.contains("target_speed") && provenance.settings.contains(key));
        }
        assert_eq!(free[0].scenario.provenance.guidance.kind, "none");
        assert_regenerated(toml);
    }
}

#[test]
fn groups_are_whole_in_any_batch() {
    let reference = generate(&config(PARTICLES));
    // Batches of 7 rows hold one group each, and those of 100 all groups of a shard.
    for (batch_size, scenes_per_shard) in [(4, 8), (7, 2), (100, 3)] {
        let other = generate(&GenerateConfig { batch_size, scenes_per_shard, ..config(PARTICLES) });
        for (a, b) in reference.iter().zip(&other) {
            let difference_m = difference_m(&a.scenario.scene, &b.scenario.scene);
            assert!(difference_m < ROUNDING_M, "batches of {batch_size}: {difference_m} m apart");
        }
    }
    let alone = generate(&config(&PARTICLES.replace("strength = 20.0", "strength = 1e-9")));
    let changed = reference.iter().zip(&alone).filter(|(a, b)| a.scenario.scene != b.scenario.scene).count();
    assert!(changed >= 6, "{changed} of 24 samples changed");
}

#[test]
fn the_particles_of_a_group_share_their_aim() {
    let toml = PARTICLES.replace("n_samples = 8", "n_samples = 8\nbehavior = 'drift'\nclassifier_scope = 'none'");
    with_generator(&config(&toml), 0, |generator| {
        let plan = generator.plan(&index(12)).unwrap();
        let sweep = &generator.config.sweeps[0];
        assert_eq!((sweep.group_size(), sweep.n_evaluations(), sweep.has_unguided()), (4, 6, false));
        assert_eq!(plan.shards.iter().map(|shard| shard.cells.len()).sum::<usize>(), 3);
    });
    with_generator(&config(OPTIMIZED), 0, |generator| {
        let sweep = &generator.config.sweeps[0];
        // Two steps, and eight times two with derivatives, which cost three each.
        assert_eq!((sweep.n_evaluations(), sweep.has_unguided()), (2 + 8 * 2 * 3, false));
    });
    let through = "strengths = [1.0]
objective_guidance = { gradient = 'through_network' }";
    let through = PARTICLES.replace("particles = { n = 4, strength = 20.0 }", through);
    with_generator(&config(&through), 0, |generator| assert_eq!(generator.config.sweeps[0].n_evaluations(), 6 * 3));
}

#[test]
fn steering_composes_with_the_classifier_and_gradients() {
    let toml = format!("{PARTICLES}\n    behavior = 'drift'\n    strengths = [0.0, 3.0]");
    let records = generate(&config(&toml));
    let mut kinds: Vec<&str> = records.iter().map(|r| r.scenario.provenance.guidance.kind.as_str()).collect();
    kinds.sort_unstable();
    kinds.dedup();
    assert_eq!(kinds, ["classifier:drift+target_speed+particles", "particles"]);
    assert_regenerated(&toml);
}

#[test]
fn what_cannot_be_combined_is_refused_by_its_key() {
    let why = |toml: &str| config(toml).resolve(&drift()).unwrap_err().to_string();
    let behavior = "behavior = 'drift'\nclassifier_scope = 'none'";
    for (toml, words) in [
        (PARTICLES.replace("n_samples = 8", "n_samples = 6"), "n_samples is 6, expected a multiple of particles.n, 4"),
        (PARTICLES.replace(", eta = 1.0", ""), "particles needs a sampler that adds noise"),
        (format!("batch_size = 3\n{PARTICLES}"), "particles.n is 4, expected at most generate.batch_size, 3"),
        (format!("{PARTICLES}\n{behavior}\ntemplate = true"), "particles cannot be combined with template = true"),
        (PARTICLES.replace("objectives =", "# "), "particles needs objectives"),
        (OPTIMIZED.replace("objectives =", "# "), "noise_optimization needs objectives"),
        (OPTIMIZED.replace("'euler'", "'heun'"), "noise_optimization needs a sampler that can be differentiated"),
        (OPTIMIZED.replace("n_steps = 2", "n_steps = 9"), "9 steps at once, expected at most 8"),
        (format!("{OPTIMIZED}\nedit = {{ tau = 0.8 }}"), "noise_optimization has no noise to start from"),
    ] {
        assert!(why(&toml).contains(words), "{words}: {}", why(&toml));
    }
}
