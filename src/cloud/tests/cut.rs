//! A command is killed at every moment of its push: what does the next machine find?

use super::*;

/// A run folder, by name.
type Folder = BTreeMap<String, Vec<u8>>;

fn folder(files: &[(&str, &str)]) -> Folder {
    files.iter().map(|(name, text)| ((*name).to_owned(), text.as_bytes().to_vec())).collect()
}

/// Finished, by earlier settings.
fn before() -> Folder {
    folder(&[
        ("corpus/manifest.json", "old"),
        ("corpus/scenarios/a.parquet", "old"),
        ("corpus/scenarios/b.parquet", "old"),
        ("corpus/scenarios/c.parquet", "same"),
        ("evaluate.done.json", "old"),
        ("metrics.json", "old"),
        ("log.txt", "old"),
        ("evaluate.partial/.djinn-written", "list"),
        ("evaluate.partial/started.json", "begun"),
    ])
}

/// Finished, by later ones: some files changed, one is new, one is gone, one stayed.
fn after() -> Folder {
    folder(&[
        ("corpus/manifest.json", "new"),
        ("corpus/scenarios/a.parquet", "new"),
        ("corpus/scenarios/c.parquet", "same"),
        ("corpus/scenarios/d.parquet", "new"),
        ("evaluate.done.json", "new"),
        ("metrics.json", "new"),
        ("log.txt", "old, new"),
    ])
}

/// Makes the files below `root` equal to `wanted`, touching only those that differ.
fn make(root: &Path, wanted: &Folder) {
    let found = files(root);
    for name in found.keys().filter(|name| !wanted.contains_key(*name)) {
        fs_err::remove_file(root.join(name)).unwrap();
    }
    for (name, bytes) in wanted.iter().filter(|(name, bytes)| found.get(*name) != Some(*bytes)) {
        fs_err::remove_file(root.join(name)).ok();
        put(&root.join(name), bytes);
    }
}

fn outputs(folder: &Folder) -> Folder {
    let is_output = |name: &String| name.starts_with("corpus/") || name == "metrics.json";
    folder.iter().filter(|(name, _)| is_output(name)).map(|(name, bytes)| (name.clone(), bytes.clone())).collect()
}

/// The pipeline's assumption: outputs belong to the record, or are missing, which it notices by the record.
fn assert_state_of_a_run(seen: &Folder, n_writes: u64) {
    let record = seen.get("evaluate.done.json").map(|bytes| String::from_utf8(bytes.clone()).unwrap());
    let of_record = match record.as_deref() {
        Some("old") => before(),
        Some("new") => after(),
        other => panic!("after {n_writes} writes: {other:?}"),
    };
    for (name, bytes) in outputs(seen) {
        assert_eq!(of_record.get(&name), Some(&bytes), "after {n_writes} writes: {name} with record {record:?}");
    }
    if record.as_deref() == Some("new") {
        assert_eq!(outputs(seen), outputs(&after()), "after {n_writes} writes: a new record says that all is there");
        assert!(!seen.contains_key("evaluate.partial/started.json"), "after {n_writes} writes: nothing is at work");
    }
    let has_work = seen.contains_key("evaluate.partial/started.json");
    assert!(!has_work || seen.contains_key("evaluate.partial/.djinn-written"), "after {n_writes} writes: whose is it?");
}

/// A store that holds a folder.
fn store_with(wanted: &Folder) -> Arc<InMemory> {
    let store = Arc::new(InMemory::new());
    wanted.iter().for_each(|(name, bytes)| _ = run_of(&store).write(name, bytes).unwrap());
    store
}

#[test]
fn killed_at_any_moment_the_next_machine_goes_on_to_the_same_bytes() {
    let patience = Patience { n_attempts: 1, first_wait: Duration::ZERO };
    let mut n_seen = BTreeMap::<&str, usize>::new();
    for n_writes in 0.. {
        let store = store_with(&before());
        let killed = Flaky::new(Arc::clone(&store), Failing::WritesFrom(n_writes));
        let bucket = Bucket::in_store(Arc::new(killed.clone()), url("s3://bucket/runs/main"), patience);
        let (_cache, shown) = machine(bucket, Access::Write);
        make(shown.path(), &after());
        let is_done = shown.finish().is_ok();
        drop(shown);

        let (_cache, next) = machine(run_of(&store), Access::Write);
        let seen = files(next.path());
        assert_state_of_a_run(&seen, n_writes);
        let is_old = seen["evaluate.done.json"] == b"old";
        *n_seen.entry(if is_old { "old" } else { "new" }).or_default() += 1;

        // It is killed in turn, early and late, and another one does the same work.
        make(next.path(), &after());
        let (_cache, third) = {
            drop(next);
            let again = Flaky::new(Arc::clone(&store), Failing::WritesFrom(n_writes / 2));
            let bucket = Bucket::in_store(Arc::new(again), url("s3://bucket/runs/main"), patience);
            let (_cache, second) = machine(bucket, Access::Write);
            make(second.path(), &after());
            drop(second.finish());
            drop(second);
            machine(run_of(&store), Access::Write)
        };
        assert_state_of_a_run(&files(third.path()), n_writes);
        make(third.path(), &after());
        third.finish().unwrap();
        assert!(objects(&run_of(&store)) == after(), "after {n_writes} writes: all is there, and nothing else");
        if is_done {
            assert!(killed.n_writes() <= n_writes);
            break;
        }
    }
    // Old: the journal, a manifest, three outputs and the manifest again, and the journal that is the turning point.
    // New: two records, three removals, the end of the journal, and everything.
    assert_eq!((n_seen["old"], n_seen["new"]), (7, 7));
}

#[test]
fn a_folder_without_its_manifest_is_told_from_a_whole_one() {
    let patience = Patience { n_attempts: 1, first_wait: Duration::ZERO };
    for n_writes in 0.. {
        let store = store_with(&before());
        let killed = Flaky::new(Arc::clone(&store), Failing::WritesFrom(n_writes));
        let (_cache, shown) =
            machine(Bucket::in_store(Arc::new(killed), url("s3://bucket/runs/main"), patience), Access::Write);
        make(shown.path(), &after());
        let is_done = shown.finish().is_ok();
        // The objects that a reader without the journal finds.
        let found = objects(&run_of(&store));
        let scenarios = |folder: &Folder| -> Folder {
            let of_table = folder.iter().filter(|(name, _)| name.starts_with("corpus/scenarios/"));
            of_table.map(|(name, bytes)| (name.clone(), bytes.clone())).collect()
        };
        match found.get("corpus/manifest.json").map(Vec::as_slice) {
            None => {}
            Some(b"old") => assert_eq!(scenarios(&found), scenarios(&before()), "after {n_writes} writes"),
            // Files that are gone are removed last.
            Some(_) => scenarios(&after()).iter().for_each(|(name, bytes)| assert_eq!(found.get(name), Some(bytes))),
        }
        if is_done {
            break;
        }
    }
}
