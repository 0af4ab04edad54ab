//! Do the stages work alone and together, and are they redone when, and only when, they must be?

use crate::support::{SMALL_PIPELINE, Workspace, assert_same, djinn, files, json};
use candle_core::Device;
use djinn::model::DenoiserSpec;
use djinn::nn::read_checkpoint;
use djinn::pipeline::stages::SampleManifest;
use djinn::store::sample_ids;
use std::path::Path;

/// One run for several questions: it is the slowest part of these tests.
#[test]
fn a_run_its_stages_alone_and_what_is_said_of_them() {
    let workspace = Workspace::new();
    workspace.run("out", &[]).expect(0);
    let root = workspace.run_folder("out");
    let before = files(&root);

    // Figures over modes are among the metrics.
    let metrics = json(&root.join("metrics.json"));
    let aggregates = metrics["aggregates"].as_array().unwrap();
    let has = |metric: &str| aggregates.iter().any(|row| row["metric"] == metric && row["group"] == "unguided");
    assert!(has("modes1_min_scene_ade_m") && has("modes1_min_fde_m"));

    // A second run of the command does nothing.
    let plan = workspace.run("out", &["--dry-run"]).expect(0).stdout;
    assert_eq!(plan.matches("  cached").count(), 7, "{plan}");
    workspace.run("out", &[]).expect(0);
    assert_same(&before, &files(&root));

    // A changed section redoes its stage and those that depend on it.
    let plan = workspace.run("out", &["--dry-run", "--set", "generate.sweeps.1.n_samples=3"]).expect(0).stdout;
    assert_eq!(plan.matches("  cached").count(), 4, "{plan}");
    assert!(plan.contains("#   generate          fresh (changed: generate.sweeps"), "{plan}");
    assert!(plan.contains("#   evaluate          fresh (changed: input samples)"), "{plan}");

    // The stages one by one, into one folder, write the same files as the run, and leave alone what lies there already.
    let (config, alone) = (workspace.arg("small.toml"), workspace.arg("alone"));
    let foreign = ["thesis.doc", "thesis.partial", "denoiser.doc", "run/thesis.doc", "scenes-00000.arrow.partial"];
    for name in foreign {
        let path = workspace.path("alone").join(name);
        fs_err::create_dir_all(path.parent().unwrap()).unwrap();
        fs_err::write(path, name).unwrap();
    }
    for stage in ["ingest", "mine", "train denoiser", "train classifier", "generate", "evaluate", "report"] {
        let args: Vec<&str> = stage.split(' ').chain(["--config", &config, "--output", &alone, "-q"]).collect();
        let outcome = djinn(&args).expect(0);
        // A model of twelve steps has not learned to use the map; quiet commands print the warning, too.
        let told: Vec<&str> = outcome.stderr.lines().filter(|line| !line.contains("barely uses the map")).collect();
        assert_eq!((outcome.stdout.as_str(), told), ("", vec![]), "quiet");
    }
    let mut whole = before.clone();
    whole.retain(|name, _| !["config.toml", "run.json"].contains(&name.as_str()));
    let mut found = files(&workspace.path("alone"));
    assert!(foreign.iter().all(|name| found.remove(*name).as_deref() == Some(name.as_bytes())));
    assert_same(&whole, &found);

    // Nothing else is written into an output.
    for output in ["corpus", "figures"] {
        let refused =
            djinn(&["report", "--from", root.to_str().unwrap(), "--output", root.join(output).to_str().unwrap(), "-q"])
                .expect(1);
        assert!(refused.stderr.contains(&format!("lies in {output}, an output of stage")), "{}", refused.stderr);
    }
    assert_same(&before, &files(&root));

    // The outputs of a run can be inspected, as text and as JSON.
    for (name, kind) in [
        ("", "run folder"),
        ("scenes", "scene store"),
        ("events.parquet", "event table"),
        ("denoiser", "denoiser checkpoint"),
        ("classifier/model.safetensors", "behavior classifier checkpoint"),
        ("denoiser/state.safetensors", "training state"),
        ("samples", "generated scenarios"),
        ("corpus", "corpus"),
    ] {
        let path = root.join(name);
        let path = path.to_str().unwrap();
        let json = djinn(&["inspect", path, "--json"]).expect(0).stdout;
        let json: serde_json::Value = serde_json::from_str(&json).unwrap();
        assert_eq!(json["kind"], kind, "{name}");
        assert!(djinn(&["inspect", path]).expect(0).stdout.starts_with(kind), "{name}");
    }

    damage_is_seen(&workspace, &root);

    // A gate that is not met ends with code 3, with all results written, and again when nothing is left to do.
    for _ in 0..2 {
        let outcome = workspace.run("out", &["--set", "evaluate.gates.min_new=1000"]).expect(3);
        assert!(outcome.stderr.contains("min_new: at least 1000 required"), "{}", outcome.stderr);
    }
    assert!(fs_err::read_to_string(root.join("report.html")).unwrap().contains("min_new"));

    // A model that was trained elsewhere is taken over, and damaged outputs are made again.
    let checkpoint = format!("train.denoiser.checkpoint={}", workspace.arg("alone/denoiser"));
    let plan = workspace.run("taken", &["--dry-run", "--set", &checkpoint]).expect(0).stdout;
    assert!(plan.contains("checkpoint = "), "{plan}");
    fs_err::remove_file(root.join("samples/samples-00001.parquet")).unwrap();
    let plan = workspace.run("out", &["--dry-run"]).expect(0).stdout;
    assert!(plan.contains("#   generate          fresh (samples is missing or was changed)"), "{plan}");
    workspace.run("out", &[]).expect(0);
    assert_same(&before, &files(&root));
}

/// A file with a changed byte is detected by the plan, which makes it again.
fn damage_is_seen(workspace: &Workspace, root: &Path) {
    for (file, stage) in [
        ("events.parquet", "mine"),
        ("denoiser/model.safetensors", "train_denoiser"),
        ("denoiser/state.safetensors", "train_denoiser"),
        ("samples/samples-00001.parquet", "generate"),
        ("corpus/lanes.parquet", "evaluate"),
        ("verdicts.parquet", "evaluate"),
    ] {
        let (path, output) = (root.join(file), file.split('/').next().unwrap());
        let whole = fs_err::read(&path).unwrap();
        let mut damaged = whole.clone();
        damaged[whole.len() / 2] ^= 1;
        fs_err::write(&path, damaged).unwrap();
        let plan = workspace.run("out", &["--dry-run"]).expect(0).stdout;
        let told = plan.lines().find(|line| line.starts_with(&format!("#   {stage} "))).unwrap();
        assert!(told.ends_with(&format!("fresh ({output} is missing or was changed)")), "{file}: {told}");
        fs_err::write(&path, whole).unwrap();
    }
}

/// The small pipeline with a baseline in place of the classifier, and a sweep of it in place of the guided one.
fn with_baseline() -> String {
    let (before, rest) = SMALL_PIPELINE.split_once("[train.classifier]").unwrap();
    let (_, after) = rest.split_once("[generate]").unwrap();
    let section = r#"
[train.baseline]
preset = "tiny"
steps = 6
batch_size = 2

[generate]"#;
    let guided = "behavior = \"cut_in\"\nn_scenes = 3\nn_samples = 2\nstrengths = [0.0, 2.0]";
    assert!(after.contains(guided));
    let sweep = "model = \"baseline\"\nn_scenes = 3\nn_samples = 6";
    format!("{before}{section}{}", after.replace(guided, sweep).replace("name = \"cut_ins\"", "name = \"futures\""))
}

#[test]
fn the_baseline_is_trained_sampled_and_measured_like_the_denoiser() {
    let workspace = Workspace::new();
    workspace.put("baseline.toml", &with_baseline());
    let (config, output) = (workspace.arg("baseline.toml"), workspace.arg("out"));
    let run = |more: &[&str]| djinn(&[&["run", &config, "--output", &output], more].concat());
    run(&[]).expect(0);
    let root = workspace.path("out").join("baseline/main");
    let plan = run(&["--dry-run"]).expect(0).stdout;
    assert!(plan.contains("#   train_baseline    cached") && plan.matches("  cached").count() == 7, "{plan}");

    let metrics = json(&root.join("metrics.json"));
    for sweep in ["as_recorded", "futures"] {
        let is_own = |row: &&serde_json::Value| row["sweep"] == sweep && row["group"] == "unguided";
        let mut own = metrics["aggregates"].as_array().unwrap().iter().filter(is_own);
        let row = own.find(|row| row["metric"] == "min_scene_ade_m").unwrap();
        assert!(row["value"].as_f64().unwrap() > 0.0, "{row}");
    }
    assert!(fs_err::read_to_string(root.join("report.html")).unwrap().contains("baseline (Scene Transformer)"));
    let inspected = djinn(&["inspect", root.join("baseline").to_str().unwrap()]).expect(0).stdout;
    assert!(inspected.starts_with("Scene Transformer checkpoint") && inspected.contains("n_modes: 6"), "{inspected}");

    // Its rows are generated again as they are.
    let samples = root.join("samples");
    let shard = SampleManifest::read(&samples).unwrap().shards.pop().unwrap();
    assert_eq!(shard.sweep, "futures");
    for id in sample_ids(&samples.join(&shard.file)).unwrap().iter().step_by(4) {
        let again = djinn(&["regenerate", id, "--from", root.to_str().unwrap()]).expect(0);
        assert!(again.stdout.starts_with("identical"), "{}", again.stdout);
    }

    // Trained alone, from the same scenes, it is the same.
    let (alone, scenes) = (workspace.arg("alone"), root.join("scenes"));
    let scenes = scenes.to_str().unwrap();
    djinn(&["train", "baseline", "--config", &config, "--scenes", scenes, "--output", &alone, "-q"]).expect(0);
    assert_same(&files(&root.join("baseline")), &files(&workspace.path("alone/baseline")));

    // A sweep that the baseline cannot do is refused before anything runs.
    let guided = run(&["--dry-run", "--set", "generate.sweeps.1.strengths=[1.0]"]).expect(1);
    assert!(
        guided.stderr.contains("strengths is [1.0], but model = \"baseline\" has no such key"),
        "{}",
        guided.stderr
    );
    let lonely = run(&["--dry-run", "--set", "generate.sweeps.1.n_samples=0"]).expect(1);
    assert!(lonely.stderr.contains("n_samples is 0"), "{}", lonely.stderr);
}

#[test]
fn checkpoints_take_the_scales_of_the_scenes_anew_when_these_change() {
    let workspace = Workspace::of(
        r#"
        [ingest]
        dataset = "interaction"
        inputs = ["../fixtures/recordings/interaction/FIX-multi-v1_2.zip"]
        limit = 40

        [train.denoiser]
        checkpoint = "../../pipelines/models/geometric.safetensors"
        calibrate = true

        [train.distill]
        checkpoint = "../../pipelines/models/geometric_two_steps.safetensors"
        calibrate = true
        "#,
    );
    let spec = |path: &Path| read_checkpoint::<DenoiserSpec>(path, &Device::Cpu).unwrap().metadata;
    let scales = |more: &[&str]| {
        workspace.run("out", more).expect(0);
        let root = workspace.run_folder("out");
        let [denoiser, distilled] =
            ["denoiser", "distilled"].map(|name| spec(&root.join(name).join("model.safetensors")).normalizer);
        assert_eq!(denoiser, distilled);
        denoiser
    };
    let of_forty = scales(&[]);
    let root = workspace.run_folder("out");
    let before = files(&root);
    assert_eq!(scales(&[]), of_forty);
    assert_same(&before, &files(&root));
    let bundled = spec(Path::new("pipelines/models/geometric.safetensors")).normalizer;
    let of_twenty = scales(&["--set", "ingest.limit=20"]);
    assert!(of_twenty != of_forty && of_forty != bundled && of_twenty != bundled);
}
