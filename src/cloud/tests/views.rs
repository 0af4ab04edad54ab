//! Several machines on one run folder: what does each see, and what does it refuse?

use super::super::error::Error;
use super::super::journal::{JOURNAL, Journal};
use super::*;
use crate::files::{Mirror, remove_if_present, tell_committed, write_atomically};
use std::io::Write;
use std::time::Instant;

fn commit(path: &Path, text: &str) {
    fs_err::create_dir_all(path.parent().unwrap()).unwrap();
    write_atomically::<std::io::Error>(path, |file| file.write_all(text.as_bytes())).unwrap();
}

/// A look at the bucket that is not put off.
fn refresh(shown: &Mirrored, dir: &str) {
    shown.view.state().forget_look();
    shown.view.refresh(&shown.path().join(dir)).unwrap();
}

#[test]
fn workers_see_the_shards_of_other_machines_and_do_not_download_them() {
    let store = Arc::new(InMemory::new());
    let (_cache, planner) = machine(run_of(&store), Access::Write);
    put(&planner.path().join("generate.parts/0a/plan.json"), b"plan");
    put(&planner.path().join("generate.parts/0a/parts.json"), b"about");
    put(&planner.path().join("scenes/shard.arrow"), b"scenes");
    put(&planner.path().join("evaluate.partial/half.json"), b"work of another stage");
    planner.finish().unwrap();
    drop(planner);

    let (_cache_a, a) = machine(run_of(&store), Access::Work);
    let (_cache_b, b) = machine(run_of(&store), Access::Work);
    assert!(a.path().join("scenes/shard.arrow").is_file() && !a.path().join("evaluate.partial").exists());
    let dir = a.path().join("generate.parts/0a");
    put(&dir.join("samples-00000.try-1"), b"mark");
    tell_committed(&dir.join("samples-00000.try-1")).unwrap();
    refresh(&b, "generate.parts/0a");
    let seen = b.path().join("generate.parts/0a");
    assert!(seen.join("samples-00000.try-1").is_file(), "a try is under way");

    commit(&dir.join("samples-00000.parquet"), "a shard");
    commit(&dir.join("samples-00000.json"), "its record");
    remove_if_present(&dir.join("samples-00000.try-1")).unwrap();
    refresh(&b, "generate.parts/0a");
    assert_eq!(fs_err::read(seen.join("samples-00000.json")).unwrap(), b"its record");
    assert!(!seen.join("samples-00000.try-1").exists(), "the try is over");
    let shard = seen.join("samples-00000.parquet");
    assert!(!shard.exists());
    assert_eq!(b.view.n_bytes_elsewhere(&shard), Some(7));

    // The machine that seals sees everything, and removes it; workers then find no plan.
    let (_cache_c, c) = machine(run_of(&store), Access::Write);
    assert_eq!(fs_err::read(c.path().join("generate.parts/0a/samples-00000.parquet")).unwrap(), b"a shard");
    for name in files(&c.path().join("generate.parts")).keys() {
        fs_err::remove_file(c.path().join("generate.parts").join(name)).unwrap();
    }
    put(&c.path().join("generate.done.json"), b"done");
    c.finish().unwrap();
    refresh(&b, "generate.parts/0a");
    assert!(!seen.join("parts.json").exists());
    let left: Vec<String> = objects(&run_of(&store)).into_keys().collect();
    assert_eq!(left, ["evaluate.partial/half.json", "generate.done.json", "scenes/shard.arrow"]);
}

#[test]
fn looks_cost_a_tenth_of_the_time_at_most() {
    let store = Arc::new(InMemory::new());
    let flaky = Flaky::new(store, Failing::Sometimes(0.0));
    let (_cache, worker) = machine(run_in(&flaky), Access::Work);
    let before = flaky.n_requests();
    for _ in 0..100 {
        worker.view.refresh(&worker.path().join("generate.parts/0a")).unwrap();
    }
    assert_eq!(flaky.n_requests(), before + 1);
}

#[test]
fn what_others_put_into_the_bucket_is_not_replaced() {
    let store = Arc::new(InMemory::new());
    run_of(&store).write("corpus/thesis.doc", b"years of work").unwrap();
    let (_cache, shown) = machine(run_of(&store), Access::Write);
    assert!(shown.path().join("corpus/thesis.doc").is_file(), "it is there to be refused like a file on disk");
    put(&shown.path().join("scenes/a.arrow"), b"ours");
    put(&shown.path().join("run.json"), b"ours");
    run_of(&store).write("scenes/a.arrow", b"theirs").unwrap();
    let before = objects(&run_of(&store));
    let error = shown.finish().unwrap_err();
    assert!(matches!(error, Error::Changed { .. }) && error.is_refusal(), "{error}");
    assert!(error.to_string().contains("s3://bucket/runs/main/scenes/a.arrow"), "{error}");
    assert_eq!(objects(&run_of(&store)), before, "nothing was written");
}

#[test]
fn two_commands_of_two_machines_do_not_mix() {
    let store = Arc::new(InMemory::new());
    let (_cache_a, a) = machine(run_of(&store), Access::Write);
    let (_cache_b, b) = machine(run_of(&store), Access::Write);
    put(&a.path().join("run.json"), b"a");
    put(&b.path().join("run.json"), b"b");
    put(&b.path().join("events.parquet"), b"b");
    a.finish().unwrap();
    assert!(matches!(b.finish(), Err(Error::Changed { .. })));
    assert_eq!(objects(&run_of(&store)), [("run.json".to_owned(), b"a".to_vec())].into());
}

#[test]
fn one_machine_has_one_writer() {
    let store = Arc::new(InMemory::new());
    let (folder, shown) = machine(run_of(&store), Access::Write);
    let cache = || Cache::in_dir(folder.path().to_owned());
    let busy = Mirrored::of(run_of(&store), cache(), Access::Write).unwrap_err();
    assert!(busy.to_string().contains("s3://bucket/runs/main is in use by process"), "{busy}");
    let other = Mirrored::of(run_of(&store), cache(), Access::Read).unwrap();
    assert_ne!(other.path(), shown.path());
    drop((other, shown));
    Mirrored::of(run_of(&store), cache(), Access::Write).unwrap();
    assert_eq!(files(&folder.path().join("views")).len(), 0, "views go with their processes");
}

#[test]
fn a_stage_at_work_pushes_its_commits_in_their_order() {
    let store = Arc::new(InMemory::new());
    let (_cache, shown) = machine(run_of(&store), Access::Write);
    let dir = shown.path().join("train_denoiser.partial");
    fs_err::create_dir_all(&dir).unwrap();
    crate::files::keep_list(&dir).unwrap();
    commit(&dir.join("started.json"), "begun");
    commit(&dir.join("state"), "step 1");
    assert!(objects(&run_of(&store)).is_empty(), "not yet time");
    shown.view.state().pushed = Instant::now().checked_sub(Duration::from_secs(31));
    commit(&dir.join("state"), "step 2");
    let pushed = objects(&run_of(&store));
    assert_eq!(pushed["train_denoiser.partial/state"], b"step 2");
    assert_eq!(pushed.len(), 3, "with the list of what is ours, and no journal");

    // The process is killed. Another machine has the pushed files, and may write into them.
    let (_cache, next) = machine(run_of(&store), Access::Read);
    assert_eq!(files(next.path())["train_denoiser.partial/state"], b"step 2");
    let listed = crate::files::listed(&next.path().join("train_denoiser.partial")).unwrap().unwrap();
    assert_eq!(listed.len(), 2);
}

#[test]
fn how_far_the_work_is_needs_no_results() {
    let store = Arc::new(InMemory::new());
    for name in ["run.json", "generate.parts/0a/samples-00000.json", "train_denoiser.partial/denoiser/statistics.jsonl"]
    {
        run_of(&store).write(name, b"{}").unwrap();
    }
    for name in
        ["generate.parts/0a/samples-00000.parquet", "corpus/manifest.json", "train_denoiser.partial/denoiser/state"]
    {
        run_of(&store).write(name, b"large").unwrap();
    }
    let (_cache, shown) = machine(run_of(&store), Access::Look);
    let seen: Vec<String> = files(shown.path()).into_keys().collect();
    let expected =
        ["generate.parts/0a/samples-00000.json", "run.json", "train_denoiser.partial/denoiser/statistics.jsonl"];
    assert_eq!(seen, expected);
    assert_eq!(shown.view.n_bytes_elsewhere(&shown.path().join("generate.parts/0a/samples-00000.parquet")), Some(5));
}

#[test]
fn the_cache_gives_what_has_not_changed() {
    let store = Arc::new(InMemory::new());
    let flaky = Flaky::new(Arc::clone(&store), Failing::Sometimes(0.0));
    let folder = tempfile::tempdir().unwrap();
    let cache = || Cache::in_dir(folder.path().to_owned());
    let shown = Mirrored::of(run_in(&flaky), cache(), Access::Write).unwrap();
    put(&shown.path().join("scenes/a.arrow"), b"scenes");
    put(&shown.path().join("log.txt"), b"line\n");
    shown.finish().unwrap();
    drop(shown);
    let before = flaky.n_requests();
    let shown = Mirrored::of(run_in(&flaky), cache(), Access::Write).unwrap();
    assert_eq!(flaky.n_requests(), before + 2, "the listing, and the log, which this machine has not downloaded");
    // Lines that are appended to a log do not get into the cache.
    let mut log = fs_err::OpenOptions::new().append(true).open(shown.path().join("log.txt")).unwrap();
    log.write_all(b"more\n").unwrap();
    drop(shown);
    let shown = Mirrored::of(run_in(&flaky), cache(), Access::Read).unwrap();
    assert_eq!(fs_err::read(shown.path().join("log.txt")).unwrap(), b"line\n");
    assert_eq!(flaky.n_requests(), before + 3);
}

#[test]
fn what_a_journal_says_of_a_record_does_not_get_into_the_cache() {
    let store = Arc::new(InMemory::new());
    run_of(&store).write("evaluate.done.json", b"old").unwrap();
    let records = [("evaluate.done.json".to_owned(), "new".to_owned())].into();
    Journal { records: Some(records), ..Journal::default() }.keep(&run_of(&store)).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let seen = || {
        let shown = Mirrored::of(run_of(&store), Cache::in_dir(folder.path().to_owned()), Access::Read).unwrap();
        fs_err::read(shown.path().join("evaluate.done.json")).unwrap()
    };
    assert_eq!((seen(), seen()), (b"new".to_vec(), b"new".to_vec()));
    run_of(&store).remove(JOURNAL).unwrap();
    assert_eq!(seen(), b"old");
}
