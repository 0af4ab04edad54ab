//! Does running stages again lose anything: foreign files, earlier outputs, trained models? On stages that write a few
//! lines.

mod crafted;
mod toy;

use super::planned::Action;
use super::record::StageRecord;
use super::testing::kind;
use super::work_folder::WorkFolder;
use super::{Blame, StageInput};
use crate::files::{enter_all, write_atomically};
use fs_err as fs;
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;
use toy::{FOREIGN, Toy, put, run, snapshot, text, took, toy};

/// A state in which a folder may be found: its name, and a function that brings a new folder into it.
type State = (&'static str, fn(&Path));

fn states() -> Vec<State> {
    fn finished(root: &Path) {
        run(root, &toy("old"), &[]).unwrap();
        took(root, Some(3.0));
    }
    fn broken(root: &Path) {
        run(root, &Toy { fails: true, ..toy("old") }, &[]).err().unwrap();
    }
    vec![
        ("new", |_| {}),
        ("finished", finished),
        ("interrupted", broken),
        ("interrupted when done again", |root| {
            finished(root);
            run(root, &Toy { fails: true, ..toy("other") }, &[]).err().unwrap();
        }),
        ("damaged", |root| {
            finished(root);
            fs::remove_file(root.join("denoiser/deep/model.safetensors")).unwrap();
        }),
    ]
}

/// Whatever the state of the folder and whatever is run in it, a foreign file stays where it is, byte for byte; and a
/// run that is rejected leaves everything as it was.
#[test]
fn files_of_others_survive_everywhere() {
    let places = [
        "thesis.doc",
        "thesis.partial",
        "denoiser",
        "denoiser/thesis.doc",
        "denoiser/deep/thesis.doc",
        "denoiser/state.safetensors.partial",
        "mine.json",
        "mine.json.d/x",
        "train_denoiser.partial",
        "train_denoiser.partial/thesis.doc",
        "train_denoiser.partial/denoiser/thesis.doc",
        "train_denoiser.partial/replaced/thesis.doc",
        "train_denoiser.done.json",
        "run.json",
        "config.toml",
        "log.txt",
        ".lock",
        "denoiser.earlier-00000000/thesis.doc",
    ];
    let (mut n_done, mut n_refused) = (0, 0);
    for (state, prepare) in states() {
        for place in places {
            for (next, redo) in [("old", vec![]), ("next", vec![]), ("old", vec![kind("train_denoiser")])] {
                let dir = tempfile::tempdir().unwrap();
                let root = dir.path().join("run");
                fs::create_dir(&root).unwrap();
                prepare(&root);
                let path = root.join(place);
                let is_taken = path.symlink_metadata().is_ok() || path.parent().is_some_and(Path::is_file);
                // A file with the taken name is ours; so is the lock file, whatever its content.
                if is_taken && place != ".lock" {
                    continue;
                }
                put(&path, FOREIGN);
                let before = snapshot(&root);
                let outcome = run(&root, &toy(next), &redo);
                let case = format!("{place} in a {state} folder, then {next} {redo:?}");
                assert_eq!(fs::read_to_string(&path).unwrap(), FOREIGN, "{case}");
                match outcome {
                    Ok(_) => {
                        n_done += 1;
                        assert_eq!(text(&root, "denoiser/deep/model.safetensors"), next, "{case}");
                    }
                    Err(failure) => {
                        n_refused += 1;
                        assert_eq!(failure.blame, Blame::Input, "{case}: {failure:?}");
                        assert!(format!("{failure:?}").contains("nothing was changed"), "{case}: {failure:?}");
                        assert!(snapshot(&root) == before, "{case}: {failure:?}");
                    }
                }
            }
        }
    }
    assert!(n_done > 50 && n_refused > 100, "{n_done} done, {n_refused} refused");
}

#[test]
fn a_configuration_of_somebody_stays_beside_any_log() {
    for log in [&b""[..], b"\n", b"\xe9\n", b"my log\n", b"2026-01-01T00:00:00Z djinn 0.1.0 begins in out\n"] {
        let dir = tempfile::tempdir().unwrap();
        put(&dir.path().join("config.toml"), FOREIGN);
        fs::write(dir.path().join("log.txt"), log).unwrap();
        let failure = run(dir.path(), &toy("next"), &[]).err().unwrap();
        assert!(failure.blame == Blame::Input && format!("{failure:?}").contains("config.toml"), "{failure:?}");
        assert_eq!(text(dir.path(), "config.toml"), FOREIGN);
        // An empty file has nothing to lose, and a kill leaves ours empty.
        fs::remove_file(dir.path().join("config.toml")).unwrap();
        let is_nobodys = log.is_empty() || log.ends_with(b"begins in out\n");
        assert_eq!(run(dir.path(), &toy("next"), &[]).is_ok(), is_nobodys, "{}", String::from_utf8_lossy(log));
    }
}

#[cfg(unix)]
#[test]
fn what_cannot_be_read_now_is_not_taken_for_changed() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path();
    run(root, &toy("old"), &[]).unwrap();
    let model = root.join("denoiser/deep/model.safetensors");
    let bytes = fs::read(&model).unwrap();
    fs::remove_file(&model).unwrap();
    // A link that leads to itself cannot be opened, like a file on a broken mount.
    std::os::unix::fs::symlink(&model, &model).unwrap();
    let failure = run(root, &toy("old"), &[]).err().unwrap();
    let said = format!("{failure:?}");
    assert!(failure.blame == Blame::Fault && said.contains("model.safetensors") && !said.contains("damaged"), "{said}");
    fs::remove_file(&model).unwrap();
    fs::write(&model, bytes).unwrap();
    assert_eq!(run(root, &toy("old"), &[]).unwrap().action, Action::Reuse);
}

#[test]
fn an_output_that_is_read_is_refused_before_anything_happens() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path().join("run");
    fs::create_dir(&root).unwrap();
    run(&root, &toy("old"), &[]).unwrap();
    let before = snapshot(dir.path());
    for input in ["denoiser/deep/model.safetensors", "denoiser", "", "../run/./denoiser/new"] {
        let inputs = vec![StageInput::external("start_from", &root.join(input))];
        let failure = run(&root, &Toy { inputs, ..toy("next") }, &[]).err().unwrap();
        let said = format!("{failure:?}");
        assert!(failure.blame == Blame::Input && said.contains("start_from"), "{said}");
        assert!(said.contains("nothing was changed"), "{said}");
        assert!(snapshot(dir.path()) == before, "{said}");
    }
}

#[test]
fn earlier_outputs_stay_until_the_new_ones_are_whole() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path();
    run(root, &toy("old"), &[]).unwrap();
    took(root, Some(3.0));
    run(root, &Toy { fails: true, ..toy("next") }, &[]).err().unwrap();
    assert_eq!(text(root, "denoiser/deep/model.safetensors"), "old");
    let planned = run(root, &toy("next"), &[]).unwrap();
    assert_eq!(planned.action, Action::Resume);
    assert_eq!(text(root, "denoiser/deep/model.safetensors"), "next");
    assert!(!root.join("train_denoiser.partial").exists());
    // With the old setting again, the existing output is outdated again.
    assert!(matches!(run(root, &toy("old"), &[]).unwrap().action, Action::Run(_)));
    assert_eq!(run(root, &toy("old"), &[]).unwrap().action, Action::Reuse);
}

#[test]
fn what_appears_while_a_stage_works_is_not_replaced_and_the_work_not_lost() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path();
    run(root, &Toy { is_cheap: true, ..toy("old") }, &[]).unwrap();
    let thesis = root.join("corpus/thesis.doc");
    let next = Toy { is_cheap: true, put_meanwhile: Some(thesis.clone()), ..toy("next") };
    let failure = run(root, &next, &[]).err().unwrap();
    assert!(format!("{failure:?}").contains("thesis.doc"), "{failure:?}");
    assert_eq!((text(root, "corpus/thesis.doc"), text(root, "metrics.json")), (FOREIGN.into(), "old".into()));
    // Nothing is computed again once the file is out of the way.
    fs::rename(&thesis, root.join("thesis.doc")).unwrap();
    assert_eq!(run(root, &next, &[]).unwrap().action, Action::Reuse);
    assert_eq!(text(root, "corpus/deep/model.safetensors"), "next");
}

#[test]
fn outputs_that_are_not_written_any_more_go_without_what_others_put_there() {
    for (output, file, theirs, left) in [
        ("metrics.json", "metrics.json", "corpus/thesis.doc", vec!["corpus/thesis.doc", "metrics.json"]),
        ("corpus", "corpus/state.safetensors", "thesis.doc", vec!["corpus/state.safetensors", "thesis.doc"]),
    ] {
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path();
        run(root, &Toy { is_cheap: true, ..toy("old") }, &[]).unwrap();
        put(&root.join(theirs), FOREIGN);
        let earlier = StageRecord::done(root, kind("evaluate")).unwrap().unwrap();
        let expected = StageRecord { outputs: BTreeMap::new(), ..earlier };
        let work = WorkFolder::begin(root, kind("evaluate"), &expected).unwrap();
        fs::create_dir_all(work.path().join("corpus")).unwrap();
        write_atomically::<std::io::Error>(&work.path().join(file), |_| Ok(())).unwrap();
        work.finish(expected, &[output], Value::Null, &[]).unwrap();
        let mut found = snapshot(root);
        let of_the_run = ["evaluate.done.json", "log.txt", "timings.json"].map(Path::new);
        found.retain(|name, _| !of_the_run.contains(&name.as_path()));
        assert!(found.keys().eq(left.iter().map(Path::new)), "{:?}", found.keys());
    }
}

/// The steps by which outputs come to their places, each of which may be the last one before a kill.
#[test]
fn a_kill_while_outputs_come_to_their_places_loses_nothing() {
    for is_cheap in [true, false] {
        let (stage, folder) = if is_cheap { ("evaluate", "corpus") } else { ("train_denoiser", "denoiser") };
        for n_steps in 0..=8 {
            let dir = tempfile::tempdir().unwrap();
            let root = dir.path();
            let work = root.join(format!("{stage}.partial"));
            run(root, &Toy { is_cheap, ..toy("old") }, &[]).unwrap();
            took(root, Some(3.0));
            let thesis = root.join(folder).join("thesis.doc");
            run(root, &Toy { is_cheap, put_meanwhile: Some(thesis.clone()), ..toy("next") }, &[]).err().unwrap();
            fs::remove_file(thesis).unwrap();
            let keep: Value = serde_json::from_str(&text(&work, "keep.json")).unwrap();
            let kept = keep["names"][folder].as_str();
            assert_eq!(kept.is_none(), is_cheap);
            let away = kept.map_or(work.join("replaced").join(folder), |name| root.join(name));
            let (new, place) = (work.join(folder), root.join(folder));
            let half_a_mark = new.join(".djinn-new.0123456789abcdef.partial");
            let steps: [&dyn Fn(); 8] = [
                &|| fs::remove_file(work.join("started.json")).unwrap(),
                &|| {
                    for name in ["state.safetensors", "deep/model.safetensors", ".djinn-new"] {
                        let name = Path::new(folder).join(name);
                        let names = [name.clone(), Path::new("replaced").join(name)];
                        enter_all(&work, names.iter().map(|name| name.as_path())).unwrap();
                    }
                    fs::create_dir_all(work.join("replaced")).unwrap();
                    fs::write(&half_a_mark, "").unwrap();
                },
                &|| {
                    fs::remove_file(&half_a_mark).unwrap();
                    write_atomically::<std::io::Error>(&new.join(".djinn-new"), |_| Ok(())).unwrap();
                },
                &|| {
                    let aside = dir.path().join("aside");
                    fs::rename(&new, &aside).unwrap();
                    fs::rename(&place, &new).unwrap();
                    fs::rename(&aside, &place).unwrap();
                },
                &|| fs::rename(&new, &away).unwrap(),
                &|| fs::remove_file(place.join(".djinn-new")).unwrap(),
                &|| {
                    if is_cheap {
                        fs::rename(work.join("metrics.json"), root.join("metrics.json")).unwrap();
                    }
                },
                &|| fs::rename(work.join("done.json"), root.join(format!("{stage}.done.json"))).unwrap(),
            ];
            steps[..n_steps].iter().for_each(|step| step());
            let model = text(&place, "deep/model.safetensors");
            assert_eq!(model, if n_steps < 4 { "old" } else { "next" }, "{n_steps} steps");
            let planned = run(root, &Toy { is_cheap, ..toy("next") }, &[]).unwrap();
            assert_eq!(planned.action, Action::Reuse, "{n_steps} steps");
            assert_eq!(text(&place, "deep/model.safetensors"), "next");
            assert!(!work.exists(), "{n_steps} steps");
            assert!(!place.join(".djinn-new.0123456789abcdef.partial").exists(), "{n_steps} steps");
            if !is_cheap {
                assert_eq!(fs::read_to_string(away.join("deep/model.safetensors")).unwrap(), "old");
            }
        }
    }
}

#[test]
fn a_model_that_took_hours_is_kept_unless_it_is_asked_for() {
    let dir = tempfile::tempdir().unwrap();
    let (root, data) = (dir.path().join("run"), dir.path().join("data.csv"));
    fs::create_dir(&root).unwrap();
    fs::write(&data, "1").unwrap();
    let toy = |text: &str| Toy { inputs: vec![StageInput::external("data", &data)], ..toy(text) };
    let model = |folder: &str| text(&root, &format!("{folder}/deep/model.safetensors"));
    run(&root, &toy("old"), &[]).unwrap();
    fs::write(&data, "2").unwrap();
    for seconds in [Some(7200.0), None] {
        took(&root, seconds);
        let before = snapshot(&root);
        let failure = run(&root, &toy("old"), &[]).err().unwrap();
        let said = format!("{failure:?}");
        for part in ["changed: input data", "--redo train_denoiser", "train.denoiser.checkpoint", "nothing was changed"]
        {
            assert!(failure.blame == Blame::Input && said.contains(part), "{said}");
        }
        assert!(snapshot(&root) == before);
    }
    // Requested by its name, or by a setting of its own section; then the old one is moved aside, with what it was.
    let planned = run(&root, &toy("old"), &[kind("train_denoiser")]).unwrap();
    let redone = planned.redone.unwrap();
    let first = redone.split("moved to ").nth(1).unwrap();
    assert!(redone.starts_with("train_denoiser runs again: requested") && first.starts_with("denoiser.earlier-"));
    assert_eq!(model(first), "old");
    let record: Value = serde_json::from_str(&text(&root, &format!("{first}/record.json"))).unwrap();
    assert_eq!(record["config"]["text"], "old");
    took(&root, Some(7200.0));
    let redone = run(&root, &toy("next"), &[]).unwrap().redone.unwrap();
    let second = redone.split("moved to ").nth(1).unwrap().to_owned();
    assert!(redone.contains("train.denoiser.text \"old\" -> \"next\"") && second != first, "{redone}");
    assert_eq!((model("denoiser"), model(&second), model(first)), ("next".into(), "old".into(), "old".into()));
    // Minutes of training are not worth a question.
    took(&root, Some(60.0));
    fs::write(&data, "3").unwrap();
    assert!(run(&root, &toy("next"), &[]).unwrap().redone.unwrap().contains("moved to"));
    // An unfinished training is not thrown away either.
    run(&root, &Toy { fails: true, ..toy("third") }, &[]).err().unwrap();
    run(&root, &toy("fourth"), &[]).unwrap();
    let names = fs::read_dir(&root).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let unfinished: Vec<String> = names.filter(|name| name.starts_with("denoiser.unfinished-")).collect();
    assert_eq!(text(&root, &format!("{}/state.safetensors", unfinished[0])), "third");
    assert!(!root.join("train_denoiser.partial").exists());
}
