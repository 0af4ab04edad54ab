//! What is lost when stores fail, processes are killed, and others write, too? Nothing, in a store that can be
//! inspected.

mod cut;
mod flaky;
mod transfers;
mod views;

use super::bucket::{Bucket, Patience};
use super::cache::Cache;
use super::mirrored::Mirrored;
use super::{Access, ObjectUrl};
use flaky::{Failing, Flaky};
use object_store::ObjectStore;
use object_store::memory::InMemory;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

const PATIENCE: Patience = Patience { n_attempts: 12, first_wait: Duration::ZERO };

fn url(text: &str) -> ObjectUrl {
    text.parse().unwrap()
}

/// The run folder in a store.
fn run_in(store: &(impl ObjectStore + Clone)) -> Bucket {
    Bucket::in_store(Arc::new(store.clone()), url("s3://bucket/runs/main"), PATIENCE)
}

/// The run folder in a store that works.
fn run_of(store: &Arc<InMemory>) -> Bucket {
    run_in(&Flaky::new(Arc::clone(store), Failing::Sometimes(0.0)))
}

/// A machine: its own cache, and the view of the run folder there.
fn machine(bucket: Bucket, access: Access) -> (tempfile::TempDir, Mirrored) {
    let cache = tempfile::tempdir().unwrap();
    let shown = Mirrored::of(bucket, Cache::in_dir(cache.path().to_owned()), access).unwrap();
    (cache, shown)
}

/// Everything in a folder of a store, except empty names.
fn objects(bucket: &Bucket) -> BTreeMap<String, Vec<u8>> {
    let read = |name: String| {
        let bytes = bucket.read(&name).unwrap().unwrap();
        (name, bytes)
    };
    bucket.list("").unwrap().into_iter().map(|object| read(object.name)).collect()
}

/// All files below a folder.
fn files(dir: &Path) -> BTreeMap<String, Vec<u8>> {
    let names = crate::files::files_below(dir).unwrap().into_iter();
    names.map(|name| (name.to_str().unwrap().to_owned(), fs_err::read(dir.join(name)).unwrap())).collect()
}

fn put(path: &Path, bytes: &[u8]) {
    fs_err::create_dir_all(path.parent().unwrap()).unwrap();
    fs_err::write(path, bytes).unwrap();
}
