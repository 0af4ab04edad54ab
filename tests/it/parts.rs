//! Do the parts of a stage wait for each other, and refuse what does not fit?

use crate::support::{Outcome, Workspace, assert_same, command, djinn, files, wait_for_part};
use djinn::store::{read_record, write_record};
use std::path::Path;
use std::process::Stdio;

/// Seven shards.
const SETTINGS: [&str; 2] = ["--set", "generate.scenes_per_shard=1"];
const BEFORE: [&str; 8] =
    ["--stage", "ingest", "--stage", "mine", "--stage", "train_denoiser", "--stage", "train_classifier"];

fn run(workspace: &Workspace, output: &str, more: &[&str]) -> Outcome {
    workspace.run(output, &[&SETTINGS[..], more].concat())
}

fn part(workspace: &Workspace, output: &str, part: &str, more: &[&str]) -> Outcome {
    run(workspace, output, &[&["--stage", "generate", "--part", part][..], more].concat())
}

#[test]
fn parts_wait_for_each_other_and_refuse_what_does_not_fit() {
    let workspace = Workspace::new();
    let work = |more: &[&str]| part(&workspace, "out", "work", &[&["--worker", "1/1"][..], more].concat());
    let says = |outcome: Outcome, parts: &[&str]| {
        parts.iter().for_each(|part| assert!(outcome.stderr.contains(part), "`{part}` is not in\n{}", outcome.stderr));
    };
    // Nothing is there that a part could begin with.
    says(part(&workspace, "out", "plan", &[]).expect(75), &["stopped: stage generate waits for stage ingest"]);
    says(work(&[]).expect(75), &["holds no plan to work on yet"]);
    says(run(&workspace, "out", &["--stage", "evaluate"]).expect(75), &["waits for stage"]);
    run(&workspace, "out", &BEFORE).expect(0);
    says(part(&workspace, "out", "seal", &[]).expect(75), &["holds no plan to seal yet"]);
    says(work(&[]).expect(75), &["holds no plan to work on yet"]);
    // Arguments that do not go together.
    says(part(&workspace, "out", "work", &[]).expect(1), &["--worker"]);
    says(part(&workspace, "out", "seal", &["--worker", "1/1"]).expect(1), &["--worker goes with --part work"]);
    says(run(&workspace, "out", &["--stage", "mine", "--part", "plan"]).expect(1), &["needs --stage generate"]);

    part(&workspace, "out", "plan", &[]).expect(0);
    let folder = workspace.run_folder("out").join("generate.parts");
    let plans = || fs_err::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path()).collect::<Vec<_>>();
    let [dir] = &plans()[..] else { panic!("{:?}", plans()) };
    let before = files(dir);
    // Other settings, another checkpoint, another program.
    let more_samples = ["--set", "generate.sweeps.0.n_samples=3"];
    let differs =
        ["this run folder holds another plan of stage generate: changed: generate.sweeps", "nothing was changed"];
    says(work(&more_samples).expect(1), &differs);
    says(part(&workspace, "out", "plan", &more_samples).expect(1), &differs);
    says(part(&workspace, "out", "seal", &more_samples).expect(1), &differs);
    let done = workspace.run_folder("out").join("train_denoiser.done.json");
    let record = fs_err::read_to_string(&done).unwrap();
    let rewrite = |path: &Path, key: &str, value: &str| {
        let mut other: serde_json::Map<_, _> = read_record(path).unwrap().unwrap();
        other.remove("checksum");
        other.insert(key.to_owned(), value.into());
        write_record(path, &other).unwrap();
    };
    rewrite(&done, "fingerprint", &"0".repeat(32));
    says(work(&[]).expect(1), &["another plan of stage generate: changed: input denoiser"]);
    fs_err::write(&done, record).unwrap();
    let identity = fs_err::read_to_string(dir.join("parts.json")).unwrap();
    rewrite(&dir.join("parts.json"), "program", "other");
    says(
        work(&[]).expect(1),
        &["program: the plan's is other, ", "0 finished shards of 6: plan again with --part plan --redo generate"],
    );
    fs_err::write(dir.join("parts.json"), identity).unwrap();
    assert_same(&before, &files(dir));

    // Shards that nobody has sampled may still come; those that are given up will not.
    says(part(&workspace, "out", "seal", &[]).expect(75), &["6 of 6 shards are missing: samples-00000, "]);
    for number in 1..=10 {
        fs_err::write(dir.join(format!("samples-00002.try-{number}")), "").unwrap();
    }
    says(work(&[]).expect(0), &["giving up shard 2: 10 workers died in it"]);
    says(
        part(&workspace, "out", "seal", &[]).expect(2),
        &["1 of 6 shards were given up: samples-00002", "remove the marks"],
    );

    // A worker that is signaled to stop leaves no mark, and says that it goes on.
    (1..=10).for_each(|number| fs_err::remove_file(dir.join(format!("samples-00002.try-{number}"))).unwrap());
    let args = workspace
        .run_args("out", &[&SETTINGS[..], &["--stage", "generate", "--part", "work", "--worker", "1/1"]].concat());
    let args: Vec<&str> = args.iter().map(String::as_str).collect();
    let mut child = command(&args).stderr(Stdio::null()).spawn().unwrap();
    let mark = dir.join("samples-00002.try-1");
    wait_for_part(&workspace.run_folder("out"), "generate", "samples-00002.try-1");
    assert!(std::process::Command::new("kill").arg(child.id().to_string()).status().unwrap().success());
    let code = child.wait().unwrap().code();
    assert!((code == Some(75) && !mark.exists()) || dir.join("samples-00002.json").exists(), "{code:?}");

    // Given up on purpose, another plan takes the place.
    part(&workspace, "out", "plan", &[&more_samples[..], &["--redo", "generate"]].concat()).expect(0);
    assert!(plans().len() == 1 && !dir.exists());
    // One process with other settings does not take the shards of that plan.
    let said = run(&workspace, "out", &["--stage", "generate"]).expect(0);
    says(said, &["generate.parts belong to another plan and are not used: changed: generate.sweeps"]);
    assert_eq!(plans().len(), 1);
    run(&workspace, "out", &["--stage", "generate", "--redo", "generate"]).expect(0);
    assert!(!folder.exists(), "what is done anew gives up what workers had begun");
    djinn(&["inspect", workspace.run_folder("out").to_str().unwrap()]).expect(0);
}
