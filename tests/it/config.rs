//! Are pipeline files read as they should be, and are those that the project carries in order?

use crate::support::{Outcome, Workspace, command, djinn, files, files_below, root};
use djinn::pipeline::config::PipelineConfig;
use std::path::Path;

#[test]
fn the_carried_pipelines_and_configs_are_in_order() {
    let mut files = Vec::new();
    for folder in ["pipelines", "configs", "tests/fixtures/corpus"] {
        files_below(&root().join(folder), "toml", &mut files);
    }
    assert!(files.len() >= 3);
    for path in files {
        let is_explained = fs_err::read_to_string(&path).unwrap().starts_with("# ");
        assert!(is_explained, "{} does not say what it is for", path.display());
        let config = PipelineConfig::load(Some(&path), &[]).unwrap_or_else(|error| panic!("{error:?}"));
        let text = config.to_toml().unwrap();
        let again = djinn::pipeline::config::parse(None, &text, &[]).unwrap();
        assert_eq!(again.to_toml().unwrap(), text, "{}: the resolved configuration reads as itself", path.display());
    }
}

#[test]
fn the_published_schema_is_that_of_the_code() {
    let schema = schemars::schema_for!(PipelineConfig);
    let text = format!("{}\n", serde_json::to_string_pretty(&schema).unwrap());
    let path = root().join("schemas/config.schema.json");
    if std::env::var_os("DJINN_UPDATE_SCHEMAS").is_some() {
        fs_err::write(&path, &text).unwrap();
    }
    let published = fs_err::read_to_string(&path).unwrap_or_default();
    assert!(published == text, "schemas/config.schema.json is out of date; run the tests with DJINN_UPDATE_SCHEMAS=1");
}

#[test]
fn a_saved_configuration_runs_again_from_where_it_lies() {
    let workspace = Workspace::new();
    let [job, elsewhere] = ["job", "elsewhere"].map(|name| workspace.path(name));
    [&job, &elsewhere].into_iter().for_each(|folder| fs_err::create_dir(folder).unwrap());
    let recordings = root().join("tests/fixtures/recordings/interaction/FIX-multi-v1_2.zip");
    fs_err::copy(recordings, job.join("r.zip")).unwrap();
    let pipeline = "[run]\noutput = 'out'\n[ingest]\ndataset = 'interaction'\ninputs = ['r.zip']\n[report]\n";
    fs_err::write(job.join("p.toml"), pipeline).unwrap();
    let run =
        |folder: &Path, pipeline: &str| Outcome::of(command(&["run", pipeline]).current_dir(folder)).expect(0).stderr;
    let is_again = |said: &str| said.contains("everything is up to date");
    assert!(!is_again(&run(&job, "p.toml")));
    let written = || {
        // Records name the inputs as they were called.
        files(&job.join("out")).into_iter().filter(|(name, _)| !name.ends_with(".json") && !name.ends_with("log.txt"))
    };
    let before: Vec<_> = written().collect();
    for pipeline in ["../job/p.toml", "../job/out/p/main/config.toml"] {
        let said = run(&elsewhere, pipeline);
        assert!(is_again(&said) && said.contains("../job/out/p/main/report.html"), "{pipeline}: {said}");
    }
    assert!(written().eq(before) && files(&elsewhere).is_empty());
}

#[test]
fn a_dry_run_prints_the_resolved_configuration_and_the_plan_and_writes_nothing() {
    let workspace = Workspace::new();
    let more = ["--dry-run", "--set", "run.seed=9", "--set", "generate.sweeps.1.strengths=[0.0, 4.0]"];
    let outcome = workspace.run("out", &more).expect(0);
    let printed: toml::Table = outcome.stdout.parse().unwrap();
    assert_eq!(printed["run"]["seed"].as_integer(), Some(9));
    assert_eq!(printed["generate"]["seed"].as_integer(), Some(9), "generation inherits the seed");
    assert_eq!(printed["ingest"]["map_radius_m"].as_float(), Some(100.0), "defaults are spelled out");
    assert_eq!(printed["generate"]["sweeps"][1]["strengths"][1].as_float(), Some(4.0));
    assert!(outcome.stdout.contains("#   report            fresh (not done yet)"), "{}", outcome.stdout);
    assert_eq!(outcome.stderr, "");
    assert!(!workspace.path("out").exists());
}

#[test]
fn mistakes_name_the_place_and_the_nearest_name() {
    let workspace = Workspace::new();
    let cases: [(&[&str], &[&str]); 8] = [
        (
            &["--set", "ingest.max_agent=3"],
            &["--set ingest.max_agent=3", "unknown key `max_agent`", "did you mean `max_agents`"],
        ),
        (&["--set", "train.denoiser.preset=smal"], &["unknown value `smal`", "did you mean `small`"]),
        (&["--set", "mine.behaviors=[{ kind = \"cutin\" }]"], &["did you mean `cut_in`"]),
        (&["--set", "generate.sweeps.7.n_scenes=3"], &["index 7 is out of range for an array of 2"]),
        (&["--set", "generate.sweeps.1.behavior=left_turn"], &["left_turn", "mine.behaviors"]),
        (&["--set", "ingest.inputs=[\"nowhere.zip\"]"], &["nowhere.zip", "the command line to the current directory"]),
        (&["--set", "run.name=a/b"], &["a/b", "cannot name a folder"]),
        (&["--set", "generate.sweeps.0.name=unguided"], &["sweeps.0.name is \"unguided\"", "choose another"]),
    ];
    for (more, expected) in cases {
        let outcome = workspace.run("out", &[more, &["--dry-run"]].concat()).expect(1);
        assert!(outcome.stderr.starts_with("error: "), "{}", outcome.stderr);
        for text in expected {
            assert!(outcome.stderr.contains(text), "{more:?}: `{text}` is missing in\n{}", outcome.stderr);
        }
        assert_eq!(outcome.stdout, "");
    }
    fs_err::write(workspace.path("small.toml"), "[run]\nseed = 1\n[inject]\n").unwrap();
    let outcome = workspace.run("out", &["--dry-run"]).expect(1);
    assert!(outcome.stderr.contains("small.toml:3:2"), "{}", outcome.stderr);
    let outcome = djinn(&["mine", "--output", &workspace.arg("empty")]).expect(1);
    assert!(outcome.stderr.contains("`djinn ingest` writes it"), "{}", outcome.stderr);
    // Before anything is trained for it.
    let pipeline = root().join("pipelines/few_evaluations.toml").display().to_string();
    let outcome = djinn(&["run", &pipeline, "--dry-run", "--set", "train.distill.method.n_steps=3"]).expect(1);
    assert!(outcome.stderr.contains("the sweep through [30.0, 2.5, 0.0]"), "{}", outcome.stderr);
}
