//! Do any number of workers, killed at will, write the bytes of one process? And do they keep away from what is not theirs?

use crate::support::{Outcome, Workspace, assert_same, command, djinn, files, start, wait_for_part};
use djinn::store::{read_record, write_record};
use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

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

/// Starts a part without waiting for it.
fn begin(workspace: &Workspace, output: &str, stage: &str, part: &[&str]) -> Child {
    let args = workspace.run_args(output, &[&SETTINGS[..], &["--stage", stage, "--part"], part].concat());
    start(&args.iter().map(String::as_str).collect::<Vec<_>>())
}

/// Runs a stage in parts by `n` workers. One process that plans is killed, then so many times one of the workers, then one that seals.
fn run_in_parts(workspace: &Workspace, output: &str, stage: &str, (n, n_kills): (usize, usize), draws: &mut Draws) {
    let folder = workspace.run_folder(output);
    let to_its_end = |part: &str| run(workspace, output, &["--stage", stage, "--part", part]).expect(0);
    let mut killed = begin(workspace, output, stage, &["plan"]);
    std::thread::sleep(Duration::from_millis(200));
    killed.kill().unwrap();
    killed.wait().unwrap();
    let began = Instant::now();
    to_its_end("plan");
    let typical = began.elapsed();

    let begin_worker = |k: usize| begin(workspace, output, stage, &["work", "--worker", &format!("{}/{n}", k + 1)]);
    let mut workers: Vec<Child> = (0..n).map(begin_worker).collect();
    for _ in 0..n_kills {
        std::thread::sleep(typical.mul_f64(0.2 + 1.5 * draws.next()));
        let k = (draws.next() * n as f64) as usize;
        workers[k].kill().unwrap();
        workers[k].wait().unwrap();
        workers[k] = begin_worker(k);
    }
    for worker in &mut workers {
        assert_eq!(worker.wait().unwrap().code(), Some(0));
    }
    let mut killed = begin(workspace, output, stage, &["seal"]);
    std::thread::sleep(typical.mul_f64(draws.next()));
    killed.kill().unwrap();
    killed.wait().unwrap();
    to_its_end("seal");
    assert!(!folder.join(format!("{stage}.parts")).exists());
    let log = fs_err::read_to_string(folder.join("log.txt")).unwrap();
    assert!(log.contains("worker 00001: "), "{log}");
    // Who comes late finds nothing to do.
    run(workspace, output, &["--stage", stage, "--part", "work", "--worker", "1/2"]).expect(0);
}

fn copy(from: &Path, to: &Path) {
    for (name, bytes) in files(from) {
        fs_err::create_dir_all(to.join(&name).parent().unwrap()).unwrap();
        fs_err::write(to.join(name), bytes).unwrap();
    }
}

/// Numbers from 0 to 1, the same ones from the same seed.
struct Draws(u64);

impl Draws {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as f64 / (1_u64 << 31) as f64
    }
}

/// Set `DJINN_KILLS=20` for so many kills for each number of workers, seven workers among them.
#[test]
fn any_number_of_workers_killed_at_will_write_the_bytes_of_one_process() {
    let workspace = Workspace::new();
    run(&workspace, "before", &BEFORE).expect(0);
    copy(&workspace.run_folder("before"), &workspace.run_folder("one"));
    run(&workspace, "one", &[]).expect(0);
    let expected = files(&workspace.run_folder("one"));
    let asked: Option<usize> = std::env::var("DJINN_KILLS").ok().map(|kills| kills.parse().unwrap());
    let (numbers, n_kills) = asked.map_or((vec![1, 2, 3], 3), |n_kills| (vec![1, 2, 3, 7], n_kills));
    for n in numbers {
        let output = format!("workers{n}");
        let folder = workspace.run_folder(&output);
        copy(&workspace.run_folder("before"), &folder);
        let mut draws = Draws(n as u64);
        for stage in ["generate", "evaluate"] {
            run_in_parts(&workspace, &output, stage, (n, n_kills), &mut draws);
        }
        run(&workspace, &output, &["--stage", "report"]).expect(0);
        assert_same(&expected, &files(&folder));
    }
    one_process_goes_on(&workspace, &expected);
}

/// What workers had begun, a plain run takes over; what they left goes.
fn one_process_goes_on(workspace: &Workspace, expected: &BTreeMap<String, Vec<u8>>) {
    let folder = workspace.run_folder("taken");
    copy(&workspace.run_folder("before"), &folder);
    for (stage, shard) in [("generate", "samples-00000.json"), ("evaluate", "figures-00000.json")] {
        run(workspace, "taken", &["--stage", stage, "--part", "plan"]).expect(0);
        let mut worker = begin(workspace, "taken", stage, &["work", "--worker", "1/1"]);
        wait_for_part(&folder, stage, shard);
        worker.kill().unwrap();
        worker.wait().unwrap();
        run(workspace, "taken", &["--stage", stage]).expect(0);
        assert!(!folder.join(format!("{stage}.parts")).exists());
    }
    run(workspace, "taken", &["--stage", "report"]).expect(0);
    assert_same(expected, &files(&folder));
}

/// The rounds of a request are decided by whoever sees the one before whole.
#[test]
fn requests_are_fulfilled_by_any_number_of_workers_to_the_same_bytes() {
    let workspace = Workspace::new();
    fs_err::write(workspace.path("small.toml"), crate::requests::pipeline()).unwrap();
    run(&workspace, "before", &BEFORE).expect(0);
    copy(&workspace.run_folder("before"), &workspace.run_folder("one"));
    run(&workspace, "one", &["--stage", "generate"]).expect(0);
    let expected = files(&workspace.run_folder("one"));
    let n_rounds = expected.keys().filter(|name| name.starts_with("samples/request-00-round-")).count();
    assert!(n_rounds > 5, "{n_rounds}");
    for n in [1, 2, 3] {
        let output = format!("workers{n}");
        copy(&workspace.run_folder("before"), &workspace.run_folder(&output));
        run_in_parts(&workspace, &output, "generate", (n, 3), &mut Draws(n as u64));
        assert_same(&expected, &files(&workspace.run_folder(&output)));
    }
    // One process goes on in the midst of the rounds.
    let folder = workspace.run_folder("taken");
    copy(&workspace.run_folder("before"), &folder);
    part(&workspace, "taken", "plan", &[]).expect(0);
    let mut worker = begin(&workspace, "taken", "generate", &["work", "--worker", "1/1"]);
    wait_for_part(&folder, "generate", "request-00-round-00002.json");
    worker.kill().unwrap();
    worker.wait().unwrap();
    let said = part(&workspace, "taken", "seal", &[]).expect(75).stderr;
    assert!(said.contains("are missing"), "{said}");
    run(&workspace, "taken", &["--stage", "generate"]).expect(0);
    assert_same(&expected, &files(&folder));
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
        &["program: the plan's is other, ", "0 finished shards of 7: plan again with --part plan --redo generate"],
    );
    fs_err::write(dir.join("parts.json"), identity).unwrap();
    assert_same(&before, &files(dir));

    // Shards that nobody has sampled may still come; those that are given up will not.
    says(part(&workspace, "out", "seal", &[]).expect(75), &["7 of 7 shards are missing: samples-00000, "]);
    for number in 1..=10 {
        fs_err::write(dir.join(format!("samples-00002.try-{number}")), "").unwrap();
    }
    says(work(&[]).expect(0), &["giving up shard 2: 10 workers died in it"]);
    says(
        part(&workspace, "out", "seal", &[]).expect(2),
        &["1 of 7 shards were given up: samples-00002", "remove the marks"],
    );

    // A worker that is asked to stop leaves no mark, and says that it goes on.
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
