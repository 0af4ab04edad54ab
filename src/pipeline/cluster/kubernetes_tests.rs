//! The content of the JobSet, and what is refused before there is one.

use super::tests::{PIPELINE, assert_golden, graph_for};
use super::{Engine, kubernetes};

const CLUSTER: &str = "[cluster]\nworkers = 7\nretries = 3\npartition = 'night'\ngpus = 1\ncpus = 8\nmemory = '16G'\n\
    image = 'registry.example.org/djinn:0.1'\nvolumes = { homes = '/home', runs = '/data/out' }\n";

#[test]
fn the_job_set_is_as_it_was_read_and_found_good() {
    let overrides = ["run.output='$(HOME)/a'".to_owned()];
    let (graph, cluster) = graph_for(Engine::Kubernetes, &format!("{PIPELINE}{CLUSTER}"), &overrides);
    // `scripts/check_jobset.py tests/golden/jobset.json` looks at it with the schemas of Kubernetes.
    assert_golden("jobset.json", &kubernetes::manifest(&graph, &cluster).unwrap());
}

#[test]
fn names_fit_into_those_of_pods_and_tell_run_folders_apart() {
    for (pipeline, expected) in [
        ("night drive", "djinn-night-drive-"),
        ("Über_#1", "djinn-ber--1-"),
        ("a-very-long-name-of-a-pipeline", "djinn-a-very-long-name-of-a-"),
    ] {
        let (mut graph, _) = graph_for(Engine::Kubernetes, &PIPELINE.replace("night drive", pipeline), &[]);
        let name = kubernetes::name(&graph);
        let mark = name.strip_prefix(expected).unwrap_or_else(|| panic!("{name}"));
        assert!(mark.len() == 6 && name.len() <= 35, "{name}");
        graph.run_folder = "/data/out/other".into();
        assert_ne!(kubernetes::name(&graph), name);
    }
}

#[test]
fn what_pods_could_not_run_is_refused() {
    let refused = |cluster: &str| {
        let (graph, cluster) = graph_for(Engine::Kubernetes, &format!("{PIPELINE}{cluster}"), &[]);
        kubernetes::manifest(&graph, &cluster).unwrap_err().error.to_string()
    };
    for (good, bad, expected) in [
        ("image = 'registry.example.org/djinn:0.1'", "", "cluster.image is empty"),
        ("runs = '/data/out'", "runs = '/data/other'", "/data/out/night drive/main is in none of the volumes"),
        (
            "homes = '/home', ",
            "",
            "/home/ada is in none of the volumes of the jobs (cluster.volumes: runs at /data/out)",
        ),
        ("'16G'", "'16GB'", "cluster.memory is \"16GB\", expected a whole number with K, M, G or T"),
        ("'16G'", "'1.5G'", "cluster.memory is \"1.5G\""),
    ] {
        let said = refused(&CLUSTER.replace(good, bad));
        assert!(said.contains(expected), "{said}");
    }
}
