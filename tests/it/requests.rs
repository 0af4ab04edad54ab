//! Are events found by their parameters, counted as they should be, resumed to the same bytes, and generated again?

use crate::support::{Workspace, assert_same, djinn, files, start, wait_for_part};
use djinn::pipeline::stages::{SampleManifest, SampleSidecar, read_requests};
use djinn::scenario::{RequestOutcome, ScenarioRecord};
use djinn::store::{CorpusReader, SceneStore, sample_ids};
use std::collections::BTreeMap;
use std::path::Path;

const PIPELINE: &str = include_str!("../pipelines/requests.toml");

fn records(root: &Path) -> Vec<(SampleSidecar, Vec<ScenarioRecord>)> {
    let (samples, store) = (root.join("samples"), SceneStore::open(&root.join("scenes")).unwrap());
    let manifest = SampleManifest::read(&samples).unwrap();
    let read = |shard: &SampleSidecar| SampleManifest::read_shard(&samples, shard, &store).unwrap();
    manifest.shards.iter().map(|shard| (shard.clone(), read(shard))).collect()
}

#[test]
fn a_request_is_counted_resumed_and_its_rows_are_generated_again() {
    let workspace = Workspace::of(PIPELINE);
    let plan = workspace.run("out", &["--dry-run"]).expect(0).stdout;
    for part in [
        "request tight: 12 scenarios in 4 buckets; 72 samples, 648 evaluations",
        "arm guided@20",
        "time unknown",
        "are counted once scenes and models exist",
    ] {
        assert!(plan.contains(part), "`{part}` is not in\n{plan}");
    }
    workspace.run("out", &["--threads", "1"]).expect(0);
    let root = workspace.run_folder("out");
    let before = files(&root);
    let n_pairs = read_requests(&root.join("samples")).unwrap()[0].buckets[0].n_feasible;
    counts_agree_with_the_rows(&root);
    rows_are_generated_again(&workspace, &root);

    // Killed in the midst of the rounds, it goes on to the same bytes.
    fs_err::remove_dir_all(root.join("samples")).unwrap();
    fs_err::remove_file(root.join("generate.done.json")).unwrap();
    let args = workspace.run_args("out", &[]);
    let mut child = start(&args.iter().map(String::as_str).collect::<Vec<_>>());
    wait_for_part(&root, "generate", "request-00-round-00001.json");
    child.kill().unwrap();
    child.wait().unwrap();
    let plan = workspace.run("out", &["--dry-run"]).expect(0).stdout;
    assert!(plan.contains("#   generate          fresh (resumes"), "{plan}");
    assert!(plan.contains(&format!("3 wanted, {n_pairs} pairs can reach it")), "{plan}");
    workspace.run("out", &[]).expect(0);
    assert_same(&before, &files(&root));
    // No sample is the recording itself: within a limit that requires it nothing is accepted.
    workspace.run("out", &["--set", "generate.requests.0.limits.min_scene_ade_m=0.0"]).expect(0);
    let summary = read_requests(&root.join("samples")).unwrap().remove(0);
    assert!(summary.arms.iter().any(|arm| arm.total.n_beyond_limits > 0), "{summary:?}");
    assert_eq!(summary.n_accepted, 0);
    let far = "generate.requests.0.pairs={ max_distance_m = 0.1 }";
    // The sweeps of the pipeline are sampled all the same.
    let nobody = workspace.run("out", &["--set", far]).expect(0);
    assert!(nobody.stderr.contains("request tight") && nobody.stderr.contains("no pair in them"), "{}", nobody.stderr);
}

/// The counts of `requests.json` are those of the rows, by a count of its own; and the corpus holds what was accepted.
fn counts_agree_with_the_rows(root: &Path) {
    let summaries = read_requests(&root.join("samples")).unwrap();
    let [summary] = summaries.as_slice() else { panic!("{} requests", summaries.len()) };
    assert!(summary.n_accepted > 0 && summary.n_samples <= 72, "{summary:?}");
    let of_request: Vec<ScenarioRecord> = records(root)
        .into_iter()
        .filter(|(shard, _)| shard.request.is_some())
        .flat_map(|(_, records)| records)
        .collect();
    assert_eq!(of_request.len() as u64, summary.n_samples);
    let (mut accepted, mut by_cell) = (vec![0; 4], BTreeMap::<(String, String, usize), u64>::new());
    for record in &of_request {
        let tag = record.request.as_ref().unwrap();
        assert_eq!((tag.request.as_str(), tag.outcome == RequestOutcome::NotFound), ("tight", !record.verified));
        let Some(event) = record.main_event() else { continue };
        let speed_mps = event.parameters["relative_speed_mps"];
        let is_inside = (-900.0..900.0).contains(&speed_mps) && (-4.0..=900.0).contains(&event.parameters["gap_m"]);
        assert_eq!(tag.outcome == RequestOutcome::Outside, !is_inside);
        let Some(bucket) = &tag.bucket else { continue };
        let [speed, side] = [
            if speed_mps < 0.0 { "-900..0" } else { "0..900" },
            if event.parameters["side"] > 0.0 { "left" } else { "right" },
        ];
        assert_eq!(bucket.ranges, format!("relative_speed_mps {speed}, side {side}"));
        assert_eq!(bucket.idx, 2 * usize::from(speed_mps >= 0.0) + usize::from(side == "right"));
        let provenance = &record.scenario.provenance;
        let cell = (provenance.scene_id.0.clone(), format!("{:?}", provenance.guidance.roles), bucket.idx);
        let of_cell = by_cell.entry(cell).or_default();
        if tag.outcome == RequestOutcome::Accepted {
            (accepted[bucket.idx], *of_cell) = (accepted[bucket.idx] + 1, *of_cell + 1);
        }
        match tag.outcome {
            RequestOutcome::Surplus => assert_eq!(accepted[bucket.idx], 3),
            RequestOutcome::Repeated => assert_eq!(*of_cell, 2),
            RequestOutcome::NearDuplicate => assert!(*of_cell < 2),
            _ => assert!(*of_cell <= 2),
        }
    }
    assert_eq!(summary.buckets.iter().map(|bucket| bucket.n_accepted).collect::<Vec<_>>(), accepted);
    let n_found = of_request.iter().filter(|record| record.verified).count() as u64;
    assert_eq!(summary.arms.iter().map(|arm| arm.total.n_found).sum::<u64>(), n_found);
    let sweeps: std::collections::BTreeSet<&str> = of_request.iter().map(|record| record.sweep.as_str()).collect();
    assert_eq!(sweeps.len(), 7, "every arm is tried: {sweeps:?}");

    let corpus = CorpusReader::open(&root.join("corpus")).unwrap();
    let kept = (0..corpus.len()).map(|i| corpus.scenario(i).unwrap());
    let n_kept = kept.filter(|r| r.request.as_ref().is_some_and(|tag| tag.outcome == RequestOutcome::Accepted)).count();
    assert_eq!(n_kept as u64, summary.n_accepted);
    let page = fs_err::read_to_string(root.join("report.html")).unwrap();
    assert!(page.contains("Requested and delivered") && page.contains("Buckets of tight"));
}

/// Rows of every sweep and arm come out as they are stored; changed or missing rows are reported.
fn rows_are_generated_again(workspace: &Workspace, root: &Path) {
    let from = root.to_str().unwrap();
    let mut last_of_sweep = BTreeMap::new();
    for (_, records) in records(root) {
        last_of_sweep.extend(records.into_iter().map(|record| (record.sweep.clone(), record)));
    }
    assert_eq!(last_of_sweep.len(), 9);
    for record in last_of_sweep.values() {
        let outcome = djinn(&["regenerate", &record.scenario.id, "--from", from]).expect(0);
        assert!(outcome.stdout.starts_with("identical"), "{}", outcome.stdout);
        assert!(outcome.stderr.contains(&record.sweep), "{}", outcome.stderr);
    }
    let corpus = root.join("corpus");
    let id = CorpusReader::open(&corpus).unwrap().scenario_ids().unwrap().last().unwrap().to_owned();
    let (again, corpus) = (workspace.arg("again.parquet"), corpus.to_str().unwrap());
    let outcome = djinn(&["regenerate", &id, "--corpus", corpus, "--out", &again, "--threads", "2"]).expect(0);
    assert!(outcome.stdout.starts_with("identical"), "{}", outcome.stdout);
    assert_eq!(sample_ids(Path::new(&again)).unwrap(), std::slice::from_ref(&id));

    let told = |args: &[&str], code: i32, part: &str| {
        let outcome = djinn(&[&["regenerate", &id, "--from", from], args].concat()).expect(code);
        assert!(outcome.stderr.contains(part), "{}", outcome.stderr);
    };
    let unknown = djinn(&["regenerate", "0123", "--from", from]).expect(1);
    assert!(unknown.stderr.contains("scenario 0123 is not among"), "{}", unknown.stderr);
    told(&["--denoiser", &workspace.arg("nowhere")], 2, "the denoiser that generated the scenario is missing");
    told(&["--denoiser", "pipelines/models/simulated_places.safetensors"], 1, "its fingerprint was");
    told(&["--scenes", corpus], 1, "manifest.json");
}
