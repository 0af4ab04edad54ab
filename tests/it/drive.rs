//! Does `djinn drive` put planners into the scenarios of a corpus, whatever they answer, and repeat to the same bytes?

use crate::skipped::skipped;
use crate::support::{Outcome, assert_same, command, djinn, files, json, python};
use arrow::array::{ArrayRef, Float64Array, RecordBatch, StringArray, UInt32Array};
use djinn::drive::protocol::protocol_schema;
use djinn::scene::State;
use djinn::store::CorpusReader;
use parquet::arrow::ArrowWriter;
use std::path::Path;
use std::process::Command;
use std::sync::Arc;

pub(crate) const CORPUS: &str = "tests/fixtures/corpus/cut_ins";
pub(crate) const MODEL: &str = "pipelines/models/geometric_two_steps.safetensors";
/// Accepted scenarios of the corpus.
const N_SCENARIOS: u64 = 4;

fn drive(ego: &str, out: &Path, more: &[&str]) -> Outcome {
    let out = out.to_str().unwrap();
    djinn(&[&["drive", CORPUS, "--ego", ego, "--model", MODEL, "--out", out], more].concat())
}

fn report(out: &Path) -> serde_json::Value {
    json(&out.join("drive.json"))
}

fn example(fault: &str) -> String {
    format!("python3 scripts/example_planner.py {fault}")
}

/// A planner in a line of Python: `answer` is what it prints for the observation number `n`.
pub(crate) fn planner(answer: &str) -> String {
    let code = format!(
        "import json, sys, time\nn = 0\nfor line in sys.stdin:\n if json.loads(line)['type'] == 'observation':\n  \
         n += 1\n  {answer}\n  sys.stdout.flush()"
    );
    format!("python3 -c \"{code}\"")
}

#[test]
fn a_drive_has_the_same_bytes_for_any_number_of_threads_and_goes_on_from_saved_states() {
    let dir = tempfile::tempdir().unwrap();
    let [one, two] = ["one", "two"].map(|name| dir.path().join(name));
    let shared = ["--horizon-s", "2", "--save-at", "14", "--threads"];
    drive("model", &one, &[&shared[..], &["1"]].concat()).expect(0);
    let outcome = drive("model", &two, &[&shared[..], &["3"]].concat()).expect(0);
    assert!(outcome.stdout.contains("of 4 scenarios fail ("), "{}", outcome.stdout);
    assert!(outcome.stdout.contains(" of 4 are survived at constant velocity, too"), "{}", outcome.stdout);
    assert_same(&files(&one), &files(&two));
    let (found, tables) = (report(&one), ["drives.parquet", "driven.parquet"]);
    assert!(found["n_scenarios"] == N_SCENARIOS && tables.iter().all(|table| one.join(table).is_file()));
    assert_eq!(found["failures"]["n_scenarios"], N_SCENARIOS);
    let count = |driver: &str| -> u64 {
        found["outcomes"][driver].as_object().unwrap().values().map(|n| n.as_u64().unwrap()).sum()
    };
    assert_eq!(["model", "careful", "constant_velocity"].map(count), [N_SCENARIOS; 3]);

    let state = fs_err::read_dir(one.join("states")).unwrap().next().unwrap().unwrap().path();
    let [fork, again] = ["fork", "again"].map(|name| dir.path().join(name));
    let planner = example("");
    for (out, threads) in [(&fork, "1"), (&again, "2")] {
        drive(&planner, out, &["--horizon-s", "2", "--from", state.to_str().unwrap(), "--threads", threads]).expect(0);
    }
    assert_same(&files(&fork), &files(&again));
    assert_eq!(report(&fork)["n_scenarios"], 1);
    let refused = drive("idm", &dir.path().join("no"), &["--from", "Cargo.toml"]).expect(1);
    assert!(refused.stderr.contains("--save-at"), "{}", refused.stderr);
}

#[test]
fn a_drive_that_was_killed_goes_on_to_the_same_bytes() {
    let dir = tempfile::tempdir().unwrap();
    let [whole, killed, kept, begun] = ["whole", "killed", "killed.drives", "begun"].map(|name| dir.path().join(name));
    // It notes each scenario that begins.
    let slow = planner(&format!(
        "n == 1 and print(n, file=open('{}' '/begun', 'a')); time.sleep(0.05)\n  print(json.dumps({{'type': 'action', \
         'acceleration_mps2': 0}}))",
        dir.path().display()
    ))
    .replace("n = 0\nfor", "for")
    .replace("n += 1", "n = int(json.loads(line)['time_s'] == 0)");
    let options = ["--horizon-s", "4", "--threads"];
    drive(&slow, &whole, &[&options[..], &["2"]].concat()).expect(0);
    fs_err::remove_file(&begun).unwrap();
    let run = |threads: &str| {
        let fixed = ["drive", CORPUS, "--ego", &slow, "--model", MODEL, "--out", killed.to_str().unwrap()];
        command(&[&fixed[..], &options[..], &[threads]].concat())
    };
    let mut child = run("1").stderr(std::process::Stdio::null()).spawn().unwrap();
    let n_kept = || fs_err::read_dir(&kept).map_or(0, |entries| entries.filter(is_whole).count());
    while n_kept() == 0 {
        assert!(child.try_wait().unwrap().is_none(), "it ended before it was killed");
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    let (n_kept, n_begun) = (n_kept() as u64, || fs_err::read_to_string(&begun).unwrap().lines().count() as u64);
    let n_before = n_begun();
    assert!((1..N_SCENARIOS).contains(&n_kept) && !killed.exists());
    let said = Outcome::of(&mut run("2")).expect(0).stderr;
    assert!(said.contains(&format!("{n_kept} scenarios were not driven again")), "{said}");
    assert_eq!(n_begun() - n_before, N_SCENARIOS - n_kept);
    assert_same(&files(&whole), &files(&killed));
    assert!(!kept.exists());
}

#[test]
fn a_planner_that_was_edited_meanwhile_begins_anew() {
    let dir = tempfile::tempdir().unwrap();
    let (script, out, kept) = (dir.path().join("p.py"), dir.path().join("out"), dir.path().join("out.drives"));
    let write = |ends: &str| {
        let code = format!(
            "import json, sys, time\nn = 0\nfor line in sys.stdin:\n kind = json.loads(line)['type']\n \
             n += kind == 'hello'\n if kind == 'observation':\n  if n == 2: {ends}\n  \
             print(json.dumps({{'type': 'action', 'acceleration_mps2': 0}}), flush=True)\n"
        );
        fs_err::write(&script, code).unwrap();
    };
    let ego = format!("cd {} && python3 p.py", dir.path().display());
    let args = ["drive", CORPUS, "--ego", &ego, "--model", MODEL, "--out", out.to_str().unwrap(), "--horizon-s", "1"];
    let begin = || command(&[&args[..], &["--threads", "1", "--time-limit-s", "100"]].concat());
    // It stays in its second scenario.
    write("time.sleep(1000)");
    let mut child = begin().stderr(std::process::Stdio::null()).spawn().unwrap();
    let n_kept = || fs_err::read_dir(&kept).map_or(0, |entries| entries.filter(is_whole).count());
    while n_kept() == 0 {
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    assert!(Command::new("kill").args(["-TERM", &child.id().to_string()]).status().unwrap().success());
    assert_eq!(child.wait().unwrap().code(), Some(75));
    write("pass");
    let said = Outcome::of(&mut begin()).expect(0).stderr;
    assert!(said.contains("begins anew: the files of the planner changed"), "{said}");
    assert!(!said.contains("not driven again") && !kept.exists(), "{said}");
}

/// Whether this is a kept drive.
fn is_whole(entry: &std::io::Result<fs_err::DirEntry>) -> bool {
    entry.as_ref().unwrap().file_name().len() == 64
}

#[test]
fn scenarios_are_made_harder_until_a_driver_fails() {
    let dir = tempfile::tempdir().unwrap();
    let [one, two] = ["one", "two"].map(|name| dir.path().join(name));
    for (out, threads) in [(&one, "1"), (&two, "2")] {
        let outcome = drive(&example("--blind"), out, &["--bisect", "--threads", threads]).expect(0);
        assert!(outcome.stdout.contains("it fails before the careful driver in"), "{}", outcome.stdout);
    }
    assert_same(&files(&one), &files(&two));
    // Both drives of each failure that matters are on the page.
    let (page, found) = (fs_err::read_to_string(one.join("drive.html")).unwrap(), report(&one));
    let n_matter = found["that_matter"].as_array().unwrap().len();
    assert!(n_matter > 0 && page.matches("<article").count() == n_matter);
    let n_panels = |title: &str| page.split("[\"").filter(|part| part.starts_with(title)).count();
    // Each title names a panel and its only drive.
    assert_eq!(["careful: survived", "planner: hit"].map(n_panels), [2 * n_matter; 2]);
    assert!(page.contains("a drive ends when it fails") && page.matches("djinn drive").count() >= n_matter);
    assert!(page.contains("Delay of the others survived, median") && page.contains("at constant velocity, too"));
    let margins = &found["margins"];
    assert_eq!(margins["n_scenarios"], N_SCENARIOS);
    let (all, n_sooner) = (margins["scenarios"].as_array().unwrap(), margins["n_sooner"].as_u64().unwrap() as usize);
    let sooner = &all[..n_sooner];
    assert_eq!(all.len() as u64, N_SCENARIOS);
    assert!(!sooner.is_empty() && margins["n_later"] == 0, "{margins}");
    for margin in sooner {
        let delay_s = |driver: &str| margin[driver]["delay_s"].as_f64().unwrap_or(-1.0);
        assert!(delay_s("careful") > delay_s("own"), "{margin}");
    }
    // The event of some is over before the scenario ends.
    let has_gap = |margin: &serde_json::Value| margin["own"]["parameters"]["gap_m"].is_number();
    assert!(all.iter().any(has_gap), "{margins}");
}

#[test]
fn whatever_a_planner_does_is_an_outcome() {
    let dir = tempfile::tempdir().unwrap();
    let nan = planner("print(json.dumps({'type': 'action', 'acceleration_mps2': float('nan')}))");
    let key = planner("print(json.dumps({'type': 'action', 'acceleration_mps2': 0, 'curvature': 0.05}))");
    let late = planner("time.sleep(0 if n < 2 else 60); print(json.dumps({'type': 'action', 'acceleration_mps2': 0}))");
    let far = planner("print(json.dumps({'type': 'action', 'trajectory': [[0, 0, 0]] * 5}))");
    let none = planner("print(json.dumps({'type': 'peek', 'n': 0}))");
    for (name, command, outcome, why) in [
        ("peeks", none.as_str(), "planner_failed", "peeks into 0 futures, expected 1 to 64"),
        ("dies", "read hello; echo no map >&2; (exit 7)", "planner_failed", "exit status 7; its last words: no map"),
        ("killed", "read hello; kill -SEGV $$", "planner_failed", "it ended by signal 11"),
        ("floods", "yes nonsense", "planner_failed", ""),
        ("endless", "cat /dev/zero", "planner_failed", "more than 1048576 bytes"),
        ("nan", nan.as_str(), "planner_failed", "expected an action"),
        ("key", key.as_str(), "planner_failed", "did you mean curvature_1pm?"),
        ("far", far.as_str(), "planner_failed", "point 0 of the trajectory: no vehicle moves"),
        ("late", late.as_str(), "timed_out", "did not answer within 0.3 s"),
    ] {
        let out = dir.path().join(name);
        let said =
            drive(command, &out, &["--horizon-s", "2", "--time-limit-s", "0.3", "--scenario", &ids()[0]]).expect(0);
        let found = report(&out);
        assert_eq!(found["outcomes"]["planner"][outcome], 1, "{name}: {}", found["outcomes"]);
        // The careful driver drives all the same, and what it survives is told.
        let is_told = found["that_matter"].as_array().unwrap().iter().all(|m| m["why"].as_str().unwrap().contains(why));
        assert!(is_told, "{name}: {found}\n{}", said.stdout);
        assert_eq!(found["n_scenarios"], 1, "{name}");
    }
}

#[test]
fn a_planner_that_never_runs_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("out");
    for (command, why) in [
        ("idmm", "did you mean idm?"),
        ("IDM", "did you mean idm?"),
        ("./no-such-planner --fast", "exit status 127"),
        ("./Cargo.toml", "exit status 126"),
        ("python3 no_such_planner.py", "can't open file"),
        ("cd no-such-folder && cat", "no-such-folder"),
        ("", "--ego is empty, expected model, log"),
        (" ", "--ego is empty"),
    ] {
        let refused = drive(command, &out, &["--horizon-s", "1", "--threads", "2"]).expect(1);
        assert!(refused.stderr.contains(why), "{command}: {}", refused.stderr);
        assert_eq!(fs_err::read_dir(dir.path()).unwrap().count(), 0, "{command}");
    }
}

/// Whether a process runs.
fn is_there(pid: &str) -> bool {
    let status = fs_err::read_to_string(format!("/proc/{}/stat", pid.trim())).unwrap_or_default();
    !status.is_empty() && !status.contains(") Z ")
}

#[test]
fn a_command_is_what_one_writes_in_a_shell_and_nothing_of_it_outlives_the_drive() {
    let dir = tempfile::tempdir().unwrap();
    let (out, pid, end) = (dir.path().join("out"), dir.path().join("pid"), dir.path().join("end"));
    // Its child would stay, and it takes a while to end.
    let command = format!(
        "sleep 1000 & echo $! > {}; cd scripts && HOW=--late; echo starts >&2; A=1 python3 example_planner.py $HOW | \
         tee /dev/null; sleep 0.5; touch {}",
        pid.display(),
        end.display()
    );
    drive(&command, &out, &["--horizon-s", "1", "--threads", "1"]).expect(0);
    let found = report(&out);
    assert!(found["outcomes"]["planner"].get("planner_failed").is_none(), "{found}");
    assert!(end.exists() && !is_there(&fs_err::read_to_string(&pid).unwrap()));
    let log = fs_err::read_to_string(out.join("planner.log")).unwrap();
    assert!(log.starts_with("== ") && log.ends_with("\nstarts\n"), "{log}");
    assert_eq!(log.matches("== ").count(), 1, "it starts in the first scenario: {log}");

    // A signal ends all of it, too, and the same command goes on.
    let out = dir.path().join("again");
    fs_err::remove_file(&pid).unwrap();
    let command = format!("echo $$ > {0}.of && mv {0}.of {0}; sleep 1000", pid.display());
    let args = ["drive", CORPUS, "--ego", &command, "--model", MODEL, "--out", out.to_str().unwrap()];
    let child = crate::support::command(&args).stderr(std::process::Stdio::piped()).spawn().unwrap();
    while !pid.exists() {
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    let planner = fs_err::read_to_string(&pid).unwrap();
    assert!(is_there(&planner));
    assert!(Command::new("kill").args(["-TERM", &child.id().to_string()]).status().unwrap().success());
    let ended = child.wait_with_output().unwrap();
    let said = String::from_utf8_lossy(&ended.stderr);
    assert!(ended.status.code() == Some(75) && said.contains("run the same command again"), "{said}");
    assert!(!is_there(&planner));
}

/// The ids of the accepted scenarios.
fn ids() -> Vec<String> {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("out");
    drive("constant_velocity", &out, &["--horizon-s", "0.5", "--save-at", "0"]).expect(0);
    let states = fs_err::read_dir(out.join("states")).unwrap();
    let mut ids: Vec<String> =
        states.map(|entry| entry.unwrap().path().file_stem().unwrap().to_str().unwrap().to_owned()).collect();
    ids.sort();
    ids
}

#[test]
fn a_planner_that_peeks_drives_as_one_that_does_not() {
    let dir = tempfile::tempdir().unwrap();
    let driven = |name: &str, peek: &str| {
        let (script, out) = (dir.path().join(format!("{name}.py")), dir.path().join(name));
        let act = format!(
            "import sys\nsys.path.insert(0, 'scripts')\nfrom djinn.drive import serve, peek\n\
             def act(observation, hello):\n    ids = [a['id'] for a in observation['agents']]\n    {peek}\n    \
             return {{'acceleration_mps2': -1.0}}\nserve(act)\n"
        );
        fs_err::write(&script, act).unwrap();
        drive(&format!("python3 {}", script.display()), &out, &["--horizon-s", "1"]).expect(0);
        (report(&out)["outcomes"]["planner"].clone(), fs_err::read(out.join("driven.parquet")).unwrap())
    };
    let peeks = "for _ in range(2):\n        futures = peek(3)\n        \
                 assert len(futures) == 3 and futures[0] != futures[1]\n        \
                 assert all([a['id'] for a in future] == ids for future in futures)\n        \
                 assert all(len(a['states'][0]) == 5 and len(a['states']) == 30 for a in futures[2])";
    let (with, without) = (driven("with", peeks), driven("without", "pass"));
    assert!(with.0.get("planner_failed").is_none(), "{}", with.0);
    assert!(with == without);
    let (endless, _) = driven("endless", "while True:\n        peek(1)");
    assert_eq!(endless["planner_failed"], N_SCENARIOS, "{endless}");
}

#[test]
fn one_process_serves_all_scenarios_up_to_the_limit() {
    let dir = tempfile::tempdir().unwrap();
    let (out, log) = (dir.path().join("out"), dir.path().join("log"));
    let command = format!("sh -c 'echo start >> {}; exec {}'", log.display(), example("--late"));
    drive(&command, &out, &["--horizon-s", "2", "--threads", "1", "--limit", "3"]).expect(0);
    let found = report(&out);
    assert_eq!(fs_err::read_to_string(log).unwrap(), "start\n");
    assert!(found["outcomes"]["planner"].get("planner_failed").is_none(), "{found}");
    assert_eq!(found["n_scenarios"], 3);
}

#[test]
fn the_gymnasium_environment_repeats_and_comes_to_ends() {
    if !Command::new("python3").args(["-c", "import gymnasium"]).output().unwrap().status.success() {
        return skipped("python-packages", "no gymnasium");
    }
    let dir = tempfile::tempdir().unwrap();
    let code = format!(
        "import sys\nsys.path.insert(0, 'scripts')\nfrom djinn.drive import environment\n\
         env = environment('{CORPUS}', '{}', djinn='{}', options='--model {MODEL} --horizon-s 1')\n\
         first, _ = env.reset(seed=5)\nagain, _ = env.reset(seed=5)\nassert (first == again).all()\n\
         steps = [env.step([0.0, 0.0]) for _ in range(2)]\nassert steps[-1][2] or steps[-1][3], steps\n\
         ids = {{env.reset()[1]['scenario_id'] for _ in range(3)}}\nassert len(ids) == 3, ids\n\
         assert len(env.peek(2)) == 2\nenv.close()",
        dir.path().join("out").display(),
        env!("CARGO_BIN_EXE_djinn"),
    );
    let python = Command::new("python3").args(["-c", &code]).current_dir(env!("CARGO_MANIFEST_DIR")).output().unwrap();
    assert!(python.status.success(), "{}", String::from_utf8_lossy(&python.stderr));
}

#[test]
fn what_cannot_be_driven_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("out");
    for (more, code, why) in [
        (&["--behavior", "tailgating"][..], 1, "none of the 7 scenarios"),
        (&["--ego-track", "nope", "--max-failures", "0"], 1, "none of the 4 chosen scenarios can be driven: 4 times"),
        (&["--replan-s", "20"], 1, "replan_s is 20"),
        (&["--time-limit-s", "0"], 1, "time_limit_s is 0"),
        (&["--model", "Cargo.toml"], 1, "Cargo.toml"),
        (&["--model", "/dev/zero"], 1, "/dev/zero is neither a file nor a folder"),
        (&["--from", "/dev/zero"], 1, "/dev/zero is neither a file nor a folder"),
        (&["--out", CORPUS], 1, CORPUS),
        (&["--scenes", "tests/fixtures"], 1, "tests/fixtures"),
    ] {
        let args = ["drive", CORPUS, "--ego", "idm", "--horizon-s", "0.5"];
        let own = ["--model", MODEL, "--out", out.to_str().unwrap()];
        let own: Vec<&str> = own.chunks(2).filter(|pair| !more.contains(&pair[0])).flatten().copied().collect();
        let refused = djinn(&[&args[..], &own, more].concat()).expect(code);
        assert!(refused.stderr.contains(why), "{more:?}: {}", refused.stderr);
        assert!(!out.exists());
    }
}

#[test]
fn two_drives_are_compared_scenario_by_scenario() {
    // By hand: of three scenarios that both have, the second alone fails in one, has a shorter time to collision in two
    // and a longer one in none, brakes less and survives a shorter delay in the one where
    // others were delayed; a fourth is in one drive only. Three coins fall alike with 1/4.
    let code = "import sys\nsys.path.insert(0, 'scripts')\nfrom compare_drives import by_chance, compare\n\
                def row(outcome, ttc_s, braking, contact, delay_s=None):\n    return dict(outcome=outcome, \
                ego_min_ttc_s=ttc_s, max_braking_mps2=braking, contact_relative_mps=contact, delay_s=delay_s)\n\
                first = {1: row('survived', 3.0, 2.0, None, 0.9), 2: row('hit', 1.0, 4.0, 2.0), \
                3: row('not_sampled', None, 1.0, None), 4: row('hit', 0.0, 9.0, 9.0)}\n\
                second = {1: row('timed_out', 2.8, 2.1, None, -1.0), 2: row('hit', 0.95, 3.0, 2.1), \
                3: row('survived', 9.0, 1.0, None)}\n\
                for name, *found in compare(first, second): print(name.split()[0], *found)\n\
                print(by_chance(3, 0), by_chance(2, 2))";
    let wanted = "fails 3 1 0 1.0\ntime 3 2 0 0.5\nbrakes 3 0 1 1.0\ncontact 3 0 0 1.0\nsurvives 1 1 0 1.0\n0.25 1.0\n";
    assert_eq!(python(&["-c", code]), wanted);
}

#[test]
fn the_published_protocol_is_the_one_that_is_spoken() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("schemas/drive_protocol.v1.json");
    let expected = format!("{}\n", serde_json::to_string_pretty(&protocol_schema()).unwrap());
    if std::env::var_os("DJINN_UPDATE_SCHEMAS").is_some() {
        fs_err::write(&path, &expected).unwrap();
    }
    assert!(
        fs_err::read_to_string(&path).unwrap_or_default() == expected,
        "{} is out of date: set DJINN_UPDATE_SCHEMAS=1 and run again",
        path.display()
    );
}

/// The ego of every accepted scenario of a corpus but the first `n_left_out` as planned states, each [timestep, x, y,
/// heading] as it is `told`.
pub(crate) fn planned(path: &Path, corpus: &Path, n_left_out: usize, mut told: impl FnMut([f64; 4]) -> [f64; 4]) {
    let reader = CorpusReader::open(&Path::new(env!("CARGO_MANIFEST_DIR")).join(corpus)).unwrap();
    let (mut ids, mut timesteps, mut numbers) = (Vec::new(), Vec::new(), [Vec::new(), Vec::new(), Vec::new()]);
    let records = (0..reader.len()).map(|i| reader.scenario(i).unwrap());
    let accepted = records.filter(|record| record.assessment.as_ref().is_some_and(|a| a.accepted));
    for record in accepted.skip(n_left_out) {
        let (scene, ego) = (&record.scenario.scene, record.subject_idx().unwrap());
        for timestep in scene.n_history..scene.n_timesteps {
            let State { position, heading_rad, .. } =
                scene.state(ego, timestep).unwrap().transformed(&scene.world_from_scene);
            let [timestep, values @ ..] = told([timestep as f64, position.x, position.y, heading_rad]);
            ids.push(record.scenario.id.clone());
            timesteps.push(timestep as u32);
            numbers.iter_mut().zip(values).for_each(|(column, value)| column.push(value));
        }
    }
    let [x, y, heading] = numbers.map(|column| Arc::new(Float64Array::from(column)) as ArrayRef);
    let ids: ArrayRef = Arc::new(StringArray::from(ids));
    let timesteps: ArrayRef = Arc::new(UInt32Array::from(timesteps));
    let columns = [("scenario_id", ids), ("timestep", timesteps), ("x", x), ("y", y), ("heading", heading)];
    let batch = RecordBatch::try_from_iter(columns).unwrap();
    let (file, _) = fs_err::File::create(path).unwrap().into_parts();
    let mut writer = ArrowWriter::try_new(file, batch.schema(), None).unwrap();
    writer.write(&batch).unwrap();
    writer.close().unwrap();
}

#[test]
fn planned_trajectories_are_scored_beside_the_careful_driver_the_scenario_and_the_recording() {
    let dir = tempfile::tempdir().unwrap();
    let (file, out) = (dir.path().join("planned.parquet"), dir.path().join("out"));
    let score = |more: &[&str]| {
        let args = ["score", CORPUS, file.to_str().unwrap(), "--out", out.to_str().unwrap()];
        djinn(&[&args, more].concat())
    };
    planned(&file, Path::new(CORPUS), 0, |state| state);
    score(&["--max-unjudged", "0"]).expect(0);
    let found = report(&out);
    let count = |driver: &str| found["outcomes"][driver].as_object().unwrap().values().filter_map(|n| n.as_u64()).sum();
    let counts: [u64; 4] = ["planner", "careful", "constant_velocity", "scenario"].map(count);
    assert_eq!((counts, &found["outcomes"]["planner"]), ([N_SCENARIOS; 4], &found["outcomes"]["scenario"]));
    assert!(found["outcomes"]["recorded"].is_object(), "{found}");
    fs_err::remove_dir_all(&out).unwrap();
    // Nobody drives ten meters aside at once.
    planned(&file, Path::new(CORPUS), 0, |[t, x, y, heading]| [t, x, y + 10.0, heading]);
    let refused = score(&["--max-failures", "0"]).expect(1);
    assert!(refused.stderr.contains("none of the 4 plans can be driven"), "{}", refused.stderr);
    // A gate over a part says so.
    planned(&file, Path::new(CORPUS), 3, |state| state);
    for (more, code) in [
        (&["--max-avoidable", "4"][..], 3),
        (&["--max-avoidable", "4", "--max-unjudged", "3"], 0),
        (&["--max-unjudged", "2"], 3),
        (&[], 0),
    ] {
        drop(fs_err::remove_dir_all(&out));
        let told = score(more).expect(code);
        let said = told.stdout + &told.stderr;
        assert!(said.contains("3 of 4 chosen scenarios were not judged"), "{said}");
        assert_eq!(code == 3, said.contains("--max-unjudged: 3 scenarios"), "{said}");
    }
    let refused = djinn(&["score", CORPUS, "Cargo.toml", "--out", dir.path().join("no").to_str().unwrap()]).expect(1);
    assert!(refused.stderr.contains("Cargo.toml"), "{}", refused.stderr);
}

/// The commands on the page, in their order, on the corpus of the tests.
#[test]
fn the_page_for_people_with_a_planner_works_as_it_says() {
    let page = fs_err::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("pipelines/DRIVE.md")).unwrap();
    let dir = tempfile::tempdir().unwrap();
    let bin = Path::new(env!("CARGO_BIN_EXE_djinn")).parent().unwrap().to_owned();
    let path = format!("{}:{}", bin.display(), std::env::var("PATH").unwrap());
    let planned_states = dir.path().join("planned.parquet");
    planned(&planned_states, Path::new(CORPUS), 0, |state| state);
    let mut n_run = 0;
    for block in page.split("```sh\n").skip(1) {
        for line in block.split("```").next().unwrap_or_default().lines().filter(|line| line.starts_with("djinn ")) {
            let mut line = line.split('#').next().unwrap_or_default().trim().to_owned();
            if line.contains("djinn run") {
                continue;
            }
            if line.starts_with("djinn drive") {
                line = format!("{line} --model {MODEL} --horizon-s 1");
            }
            let line = line.replace("output/quickstart/main/corpus", CORPUS);
            let line = line.replace(" planned.parquet", &format!(" {}", planned_states.display()));
            let line = line.replace("output/", &format!("{}/", dir.path().display()));
            let mut shell = Command::new("sh");
            shell.args(["-c", &line]).env("PATH", &path).current_dir(env!("CARGO_MANIFEST_DIR"));
            let output = shell.output().unwrap();
            assert!(output.status.success(), "{line}\n{}", String::from_utf8_lossy(&output.stderr));
            n_run += 1;
        }
    }
    assert!(n_run >= 4, "{n_run} commands");
    // Help names the page.
    let help = command(&["drive", "--help"]).output().unwrap();
    assert!(String::from_utf8_lossy(&help.stdout).contains("pipelines/DRIVE.md"));
}
