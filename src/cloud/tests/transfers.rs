//! Objects through a store that fails: nothing is lost, and nothing is tried without end.

use super::super::error::Error;
use super::super::recordings::Recordings;
use super::*;
use crate::seed::Seed;

/// Bytes that belong to a name.
fn bytes(name: &str, n: usize) -> Vec<u8> {
    let mut rng = Seed(3).derive_named("content", name).rng();
    (0..n).map(|_| rng.below(256) as u8).collect()
}

#[test]
fn one_fault_in_ten_requests_loses_nothing() {
    let store = Arc::new(InMemory::new());
    let flaky = Flaky::new(Arc::clone(&store), Failing::Sometimes(0.1));
    let (_cache, shown) = machine(run_in(&flaky), Access::Write);
    let mut expected = BTreeMap::new();
    for idx in 0..150 {
        let name = format!("samples/part-{idx:03}.parquet");
        expected.insert(name.clone(), bytes(&name, 1 + 97 * idx));
    }
    // It takes more than one part.
    expected.insert("scenes/large.arrow".to_owned(), bytes("large", 40 << 20));
    expected.iter().for_each(|(name, bytes)| put(&shown.path().join(name), bytes));
    shown.finish().unwrap();
    assert!(objects(&run_of(&store)) == expected, "the bucket holds what the folder held, and no journal");

    let (_cache, again) = machine(run_in(&flaky), Access::Read);
    assert!(files(again.path()) == expected, "another machine sees the same");
    let (n_faults, n_requests) = (flaky.n_faults(), flaky.n_requests());
    assert!(n_faults > 20 && n_faults * 20 > n_requests, "{n_faults} of {n_requests} requests failed");
}

#[test]
fn a_store_that_always_fails_is_given_up() {
    let flaky = Flaky::new(Arc::new(InMemory::new()), Failing::Always);
    let patience = Patience { n_attempts: 4, first_wait: Duration::from_millis(5) };
    let bucket = Bucket::in_store(Arc::new(flaky.clone()), url("s3://bucket/runs/main"), patience);
    let error = bucket.write("log.txt", b"x").unwrap_err();
    assert_eq!(flaky.n_requests(), 4);
    assert!(!error.is_refusal());
    let told = error.to_string();
    for part in ["cannot write s3://bucket/runs/main/log.txt", "tried 4 times", "Busy"] {
        assert!(told.contains(part), "{told}");
    }
}

#[test]
fn a_download_that_ends_early_is_not_taken_for_the_whole() {
    let store = Arc::new(InMemory::new());
    run_of(&store).write("x.parquet", &bytes("x", 1000)).unwrap();
    // Every second read is cut off, half of these with a length that fits.
    let flaky = Flaky::new(Arc::clone(&store), Failing::Sometimes(0.5));
    let cache = tempfile::tempdir().unwrap();
    for attempt in 0..40 {
        let to = cache.path().join(attempt.to_string());
        let object = run_of(&store).list("").unwrap().remove(0);
        run_in(&flaky).download(&object, &to).unwrap();
        assert_eq!(fs_err::read(to).unwrap(), bytes("x", 1000));
        assert_eq!(run_in(&flaky).read("x.parquet").unwrap().unwrap(), bytes("x", 1000));
    }
    assert!(flaky.n_faults() > 30);
}

#[test]
fn a_damaged_object_is_no_answer() {
    let store = Arc::new(InMemory::new());
    let bucket = run_of(&store);
    let good = bucket.write("x", b"good").unwrap();
    // Another program copies other bytes of the same length over it, and leaves the hash beside it.
    let patience = Patience { n_attempts: 2, first_wait: Duration::ZERO };
    let hash = crate::files::FileStamp::of(b"good").checksum;
    let attributes =
        object_store::Attributes::from_iter([(object_store::Attribute::Metadata("djinnblake3".into()), hash)]);
    let options = object_store::PutOptions { attributes, ..Default::default() };
    let place = object_store::path::Path::from("runs/main/x");
    let write = store.put_opts(&place, b"evil".to_vec().into(), options);
    super::super::connect::runtime().unwrap().block_on(write).unwrap();
    let bucket = Bucket::in_store(Arc::clone(&store) as _, url("s3://bucket/runs/main"), patience);
    let cache = tempfile::tempdir().unwrap();
    let error = bucket.download(&good, &cache.path().join("x")).unwrap_err().to_string();
    assert!(error.contains("BLAKE3") && error.contains("tried 2 times"), "{error}");
    assert_eq!(fs_err::read_dir(cache.path()).unwrap().count(), 0, "nothing has the final name, nor any other");
}

#[test]
fn what_is_not_there_is_the_users_to_mend() {
    let bucket = run_of(&Arc::new(InMemory::new()));
    assert!(bucket.read("x").unwrap().is_none() && bucket.itself().unwrap().is_none());
    bucket.remove("x").unwrap();
    let error = Recordings::in_bucket(bucket).unwrap_err();
    assert!(matches!(error, Error::Missing { .. }) && error.is_refusal(), "{error}");
}

#[test]
fn recordings_keep_their_names_and_are_downloaded_once() {
    let store = Arc::new(InMemory::new());
    let at = |key: &str| {
        Bucket::in_store(Arc::new(Flaky::new(Arc::clone(&store), Failing::Sometimes(0.1))), url(key), PATIENCE)
    };
    at("s3://bucket/rec").write("train/a.csv", b"one").unwrap();
    at("s3://bucket/rec").write("train/sub/b.csv", b"two").unwrap();
    // Folder markers as made by some tools, and a neighbor whose name only begins with the same letters.
    at("s3://bucket/rec").write("train/sub", b"").unwrap();
    at("s3://bucket").write("rec/training.csv", b"no").unwrap();
    let folder = tempfile::tempdir().unwrap();
    let cache = Cache::in_dir(folder.path().to_owned());

    let recordings = Recordings::in_bucket(at("s3://bucket/rec/train")).unwrap();
    let place = recordings.in_cache(&cache).unwrap();
    assert!(place.ends_with("bucket/rec/train"), "names of folders tell the split: {}", place.display());
    let expected =
        [("a.csv", "one"), ("sub/b.csv", "two")].map(|(name, text)| (name.to_owned(), text.as_bytes().to_vec()));
    assert_eq!(files(&place), expected.into());
    let one = Recordings::in_bucket(at("s3://bucket/rec/train/a.csv")).unwrap();
    assert_eq!(fs_err::read(one.in_cache(&cache).unwrap()).unwrap(), b"one");

    let down = Bucket::in_store(
        Arc::new(Flaky::new(Arc::clone(&store), Failing::Always)),
        url("s3://bucket/rec/train"),
        PATIENCE,
    );
    let again = Recordings { bucket: down, ..recordings };
    assert_eq!(again.in_cache(&cache).unwrap(), place, "nothing is asked for again");
    let before = again.tag();
    at("s3://bucket/rec").write("train/a.csv", b"new").unwrap();
    let changed = Recordings::in_bucket(at("s3://bucket/rec/train")).unwrap();
    assert_ne!(changed.tag(), before);
    assert_eq!(fs_err::read(changed.in_cache(&cache).unwrap().join("a.csv")).unwrap(), b"new");
    assert_eq!(fs_err::read(place.join("a.csv")).unwrap(), b"one", "whoever reads the old one still does");
}
