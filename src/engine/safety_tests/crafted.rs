//! Does a run folder made by somebody else cost files outside of it, whatever its records and lists contain?

use super::toy::{FOREIGN, Toy, put, run, snapshot, toy};
use crate::engine::record::StageRecord;
use crate::engine::testing::kind;
use crate::engine::{Blame, StageKind};
use crate::files::{LIST_FILE, enter_all, files_below, keep_list, stays_below};
use crate::store::write_record;
use fs_err as fs;
use proptest::prelude::*;
use serde_json::json;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Foreign files, beside the folder that holds the run folder.
const THEIRS: [&str; 4] =
    ["victim.txt", "theirs/victim.txt", "theirs/deep/model.safetensors", "theirs/state.safetensors"];
/// Stands for the folder of these files.
const ABSOLUTE: &str = "(absolute)";
const PARTS: [&str; 20] = [
    "..",
    "..",
    "..",
    "..",
    ".",
    "",
    "victim.txt",
    "theirs",
    "deep",
    "model.safetensors",
    "state.safetensors",
    "corpus",
    "denoiser",
    "metrics.json",
    "replaced",
    "link",
    "a\\..\\b",
    "nul\0",
    "denoiser.earlier-..",
    LIST_FILE,
];

/// A file that somebody wrote into a run folder.
#[derive(Debug, Clone, Default)]
struct Crafted {
    is_cheap: bool,
    /// Names in the record of the finished stage, and in that of the stage at work.
    outputs: Vec<String>,
    files: Vec<String>,
    fingerprint: Option<String>,
    /// Names in the list of the work folder, if there is one; whether its work is whole, and which outputs to keep
    /// under which names.
    list: Option<Vec<String>>,
    is_done: bool,
    keep: Vec<(String, String)>,
    /// The place of a link to a foreign folder.
    link: Option<&'static str>,
}

fn name() -> impl Strategy<Value = String> {
    let parts = prop::collection::vec(prop::sample::select(PARTS.to_vec()), 1..6);
    (parts, prop::bool::weighted(0.2)).prop_map(|(parts, is_absolute)| {
        let name = parts.join("/");
        if is_absolute { format!("{ABSOLUTE}/{name}") } else { name }
    })
}

fn names() -> impl Strategy<Value = Vec<String>> {
    prop::collection::vec(name(), 0..3)
}

fn crafted() -> impl Strategy<Value = Crafted> {
    let places = [
        "corpus",
        "corpus/deep",
        "denoiser",
        "denoiser/deep",
        "metrics.json",
        "evaluate.partial",
        "train_denoiser.partial",
        "evaluate.partial/corpus",
        "train_denoiser.partial/denoiser",
        "train_denoiser.partial/replaced",
        "denoiser.earlier-0",
        "train_denoiser.partial/link",
    ];
    let keep = prop::collection::vec((name(), name()), 0..2);
    let link = prop::option::of(prop::sample::select(places.to_vec()));
    let about = (any::<bool>(), names(), names(), prop::option::weighted(0.1, name()));
    (about, prop::option::of(names()), any::<bool>(), keep, link).prop_map(
        |((is_cheap, outputs, files, fingerprint), list, is_done, keep, link)| Crafted {
            is_cheap,
            outputs,
            files,
            fingerprint,
            list,
            is_done,
            keep,
            link,
        },
    )
}

impl Crafted {
    /// Writes it into the finished run folder `root` below `outside`. Returns whether any name leads out of its place.
    fn write(&self, root: &Path, outside: &Path, stage: &'static StageKind) -> bool {
        let named = |name: &String| name.replace(ABSOLUTE, &outside.to_string_lossy());
        let mut record = StageRecord::done(root, stage).unwrap().unwrap();
        let content = record.outputs.values().next().unwrap().clone();
        let own_files = record.files.clone();
        record.outputs.extend(self.outputs.iter().map(|name| (named(name), content.clone())));
        record.files.extend(self.files.iter().map(|name| PathBuf::from(named(name))));
        record.fingerprint = self.fingerprint.clone().unwrap_or(record.fingerprint);
        write_record(&root.join(format!("{stage}.done.json")), &record).unwrap();
        if let Some(list) = &self.list {
            let work = root.join(format!("{stage}.partial"));
            fs::create_dir_all(work.join("denoiser")).unwrap();
            keep_list(&work).unwrap();
            put(&work.join("denoiser/state.safetensors"), "begun");
            let own = ["denoiser/state.safetensors", "started.json", "done.json", "keep.json", "link"];
            let list: Vec<String> = list.iter().map(named).chain(own.map(str::to_owned)).collect();
            enter_all(&work, list.iter().map(Path::new)).unwrap();
            write_record(&work.join(if self.is_done { "done.json" } else { "started.json" }), &record).unwrap();
            let keep: serde_json::Map<_, _> =
                self.keep.iter().map(|(name, to)| (named(name), json!(named(to)))).collect();
            write_record(&work.join("keep.json"), &json!({ "names": keep })).unwrap();
        }
        #[cfg(unix)]
        if let Some(link) = self.link.map(|link| root.join(link)) {
            if link.is_dir() && link.symlink_metadata().unwrap().is_dir() {
                fs::remove_dir_all(&link).unwrap();
            } else if link.exists() {
                fs::remove_file(&link).unwrap();
            }
            fs::create_dir_all(link.parent().unwrap()).unwrap();
            std::os::unix::fs::symlink(outside.join("theirs"), link).unwrap();
        }
        // A record holds each path once: `a` and `a/.` are one, under the name that comes first.
        let mut files: BTreeSet<&Path> = own_files.iter().map(PathBuf::as_path).collect();
        for name in &self.files {
            files.insert(Path::new(name));
        }
        let names = files.into_iter().filter_map(Path::to_str).chain(self.outputs.iter().map(String::as_str));
        names.into_iter().any(|name| !stays_below(name)) || self.fingerprint.is_some()
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]
    #[test]
    fn no_file_outside_is_touched(crafted in crafted()) {
        let dir = tempfile::tempdir().unwrap();
        let outside = dir.path();
        let root = outside.join("output/run");
        fs::create_dir_all(&root).unwrap();
        let toy = |text: &str| Toy { is_cheap: crafted.is_cheap, ..toy(text) };
        run(&root, &toy("old"), &[]).unwrap();
        let stage = if crafted.is_cheap { kind("evaluate") } else { kind("train_denoiser") };
        THEIRS.iter().for_each(|name| put(&outside.join(name), FOREIGN));
        if crafted.list.is_none() {
            fs::write(outside.join("theirs").join(LIST_FILE), "").unwrap();
            enter_all(&outside.join("theirs"), ["victim.txt", "deep/model.safetensors"].map(Path::new).into_iter())
                .unwrap();
        }
        let theirs = || {
            let names = files_below(outside).unwrap().into_iter().filter(|name| !name.starts_with("output/run"));
            names.map(|name| (name.clone(), fs::read(outside.join(name)).unwrap())).collect::<Vec<_>>()
        };
        let before = theirs();
        let leads_out = crafted.write(&root, outside, stage);
        for (text, redo) in [("old", vec![]), ("next", vec![]), ("next", vec![stage])] {
            let outcome = run(&root, &toy(text), &redo);
            prop_assert!(theirs() == before, "{:?} after {text} {redo:?}", outcome.err());
            if leads_out {
                let failure = outcome.err().unwrap();
                let said = format!("{failure:?}");
                prop_assert!(said.contains("nothing was changed"), "{said}");
                // A link in the place of ours is foreign, and may be found first.
                let is_damage =
                    failure.blame == Blame::Fault && said.contains(" is damaged: ") && said.contains(" away");
                prop_assert!(is_damage || crafted.link.is_some(), "{said}");
            }
        }
    }
}

#[test]
fn a_record_that_names_files_of_others_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path().join("output/run");
    let victim = dir.path().join("victim.txt");
    fs::create_dir_all(&root).unwrap();
    put(&victim, FOREIGN);
    let toy = |text: &str| Toy { is_cheap: true, ..toy(text) };
    run(&root, &toy("old"), &[]).unwrap();
    let path = root.join("evaluate.done.json");
    let record = StageRecord::done(&root, kind("evaluate")).unwrap().unwrap();
    for name in [
        "../../victim.txt",
        "",
        ".",
        "denoiser",
        "report.html",
        "corpus/../../../victim.txt",
        &victim.to_string_lossy(),
    ] {
        for (in_outputs, in_files) in [(true, true), (true, false), (false, true)] {
            let mut crafted = record.clone();
            let content = record.outputs["corpus"].clone();
            crafted.outputs.extend(in_outputs.then(|| (name.to_owned(), content)));
            crafted.files.extend(in_files.then(|| PathBuf::from(name)));
            write_record(&path, &crafted).unwrap();
            let failure = run(&root, &toy("next"), &[]).err().unwrap();
            let said = format!("{failure:?}");
            assert!(failure.blame == Blame::Fault && said.contains("evaluate.done.json is damaged: "), "{said}");
            assert!(said.contains("is nothing that stage evaluate writes"), "{said}");
            assert!(said.contains("or move it away together with corpus, metrics.json"), "{said}");
            assert_eq!(fs::read_to_string(&victim).unwrap(), FOREIGN);
        }
    }
    write_record(&path, &record).unwrap();
    run(&root, &toy("next"), &[]).unwrap();
}

#[test]
fn outputs_are_kept_under_names_of_their_own_alone() {
    for (name, as_name) in [("denoiser", "corpus"), ("config.toml", "config.toml.earlier-0")] {
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path();
        run(root, &toy("old"), &[]).unwrap();
        let keep = vec![(name.to_owned(), as_name.to_owned())];
        let crafted = Crafted { list: Some(Vec::new()), is_done: true, keep, ..Crafted::default() };
        crafted.write(root, root, kind("train_denoiser"));
        let said = format!("{:?}", run(root, &toy("next"), &[]).err().unwrap());
        assert!(said.contains(&format!("{name:?} cannot stay as {as_name:?}")), "{said}");
    }
}

#[test]
fn damage_in_a_record_is_not_blamed_on_the_user() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path();
    run(root, &toy("old"), &[]).unwrap();
    super::took(root, Some(3.0));
    run(root, &Toy { fails: true, ..toy("next") }, &[]).err().unwrap();
    for name in ["train_denoiser.done.json", "timings.json", "train_denoiser.partial/started.json"] {
        let path = root.join(name);
        let bytes = fs::read(&path).unwrap();
        for i in 0..bytes.len() {
            let mut flipped = bytes.clone();
            flipped[i] ^= 1 << (i % 8);
            fs::write(&path, flipped).unwrap();
            let before = snapshot(root);
            let failure = run(root, &toy("next"), &[]).err().unwrap();
            let said = format!("{failure:?}");
            assert!(failure.blame == Blame::Fault, "byte {i}: {said}");
            assert!(said.contains(&format!("{name} is damaged: ")), "byte {i}: {said}");
            assert!(said.contains("nothing was changed; ") && said.contains("move"), "byte {i}: {said}");
            assert!(snapshot(root) == before, "byte {i}: {said}");
        }
        fs::write(&path, bytes).unwrap();
    }
    run(root, &toy("next"), &[]).unwrap();
}
