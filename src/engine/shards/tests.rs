//! Who makes which shard, and what becomes of shards that cannot be made? On shards of a few bytes.

use super::folder::ShardFolder;
use super::gathering::Gathering;
use super::identity::Identity;
use super::make::{LEAST_PATIENCE, Shards, Worker};
use super::{Division, clean_up, shard_status, tries};
use crate::engine::testing::{KINDS, kind};
use crate::engine::{Blame, Failure, Result, StageRecord};
use crate::files::{FileStamp, write_atomically};
use crate::progress::Silent;
use std::cell::{Cell, RefCell};
use std::collections::{BTreeMap, BTreeSet};
use std::io::Write;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::time::{Duration, Instant};

fn identity() -> Identity {
    let stage = StageRecord {
        stage: "generate".to_owned(),
        version: 1,
        config: serde_json::json!({ "seed": 1 }),
        inputs: BTreeMap::new(),
        fingerprint: "f".repeat(32),
        settings: "f".repeat(32),
        outputs: BTreeMap::new(),
        files: BTreeSet::new(),
        summary: serde_json::Value::Null,
        times: BTreeMap::new(),
    };
    Identity { stage, program: "1 (a)".to_owned(), compute: "cpu, f32".to_owned() }
}

/// A new plan of some shards in a run folder.
fn shard_folder(root: &Path, n_shards: usize, is_shared: bool) -> ShardFolder {
    let division = Division::new(n_shards, &serde_json::json!({})).unwrap();
    let folder = ShardFolder::write(root, kind("generate"), identity(), &division).unwrap();
    if is_shared { folder.shared(false).unwrap() } else { folder }
}

/// A plan of some shards.
struct Planned {
    root: tempfile::TempDir,
    folder: ShardFolder,
    n_shards: usize,
}

impl Planned {
    fn new(n_shards: usize) -> Self {
        Self::of(n_shards, true)
    }

    fn of(n_shards: usize, is_shared: bool) -> Self {
        let root = tempfile::tempdir().unwrap();
        Self { folder: shard_folder(root.path(), n_shards, is_shared), root, n_shards }
    }

    fn work(&self, worker: &str, make: &dyn Fn(usize) -> Result<FileStamp>) -> Result<()> {
        let shards = Shards::new(&self.folder, worker.parse().unwrap(), &Silent);
        shards.go_about(0..self.n_shards, &|_| 1, &|_| true, &mut |idx| Ok((make(idx)?, ())))
    }

    fn write(&self, idx: usize) -> Result<FileStamp> {
        let path = self.folder.dir().join(self.folder.file_name(idx));
        Ok(write_atomically::<std::io::Error>(&path, |file| write!(file, "shard {idx}"))?)
    }

    fn finish(&self, idx: usize, seconds: f64) {
        let stamp = self.write(idx).unwrap();
        self.folder.finish(idx, ("1/2", seconds), (stamp, ())).unwrap();
    }

    fn check_whole(&self) -> Result<()> {
        let mut shards = Gathering::new(&self.folder);
        for idx in 0..self.n_shards {
            shards.look_up::<()>(idx)?;
        }
        shards.check_whole()
    }

    fn root(&self) -> &Path {
        self.root.path()
    }

    fn clean_up(&self) -> Result<()> {
        clean_up(self.root(), kind("generate"), &identity().stage)
    }
}

fn worker(text: &str) -> Worker {
    text.parse().unwrap()
}

#[test]
fn every_worker_comes_to_every_shard_once_and_to_its_own_first() {
    let of = |text: &str, n_shards| worker(text).order(n_shards).collect::<Vec<_>>();
    assert_eq!(of("1/2", 5), [0, 2, 4, 3, 1]);
    assert_eq!(of("2/2", 5), [1, 3, 2, 0, 4]);
    assert_eq!(of("1/1", 3), [0, 1, 2]);
    for n in 1..9 {
        for k in 1..=n {
            let mut order = of(&format!("{k}/{n}"), 7);
            order.sort_unstable();
            assert_eq!(order, (0..7).collect::<Vec<_>>(), "{k}/{n}");
        }
    }
    assert_eq!(worker("0/2"), worker("2/2"), "counted from 0, the last one is the first");
    for wrong in ["0/0", "3/2", "1", "1/0", "x/2", "1/200000"] {
        assert!(wrong.parse::<Worker>().is_err(), "{wrong}");
    }
}

#[test]
fn a_shard_that_crashes_is_given_up_by_name_and_the_others_are_made() {
    let planned = Planned::new(6);
    assert_eq!(planned.check_whole().unwrap_err().blame, Blame::Later);
    let n_crashes = Cell::new(0);
    let make = |idx: usize| {
        if idx == 1 {
            n_crashes.set(n_crashes.get() + 1);
            panic!("scene x has no lanes");
        }
        planned.write(idx)
    };
    // Each process ends with the panic and is started again, as a scheduler does.
    let run = || catch_unwind(AssertUnwindSafe(|| planned.work("1/1", &make)));
    for _ in 0..3 {
        assert!(run().is_err());
    }
    run().unwrap().unwrap();
    assert_eq!(n_crashes.get(), 3);
    let failure = planned.check_whole().unwrap_err();
    let said = format!("{failure:?}");
    assert_eq!(failure.blame, Blame::Fault);
    assert!(
        said.contains("1 of 6 shards were given up: samples-00001 (failed 3 times, last: a bug: scene x has no lanes)")
    );
    assert!(said.contains("marks *.try-*"), "{said}");
    // Once repaired and its marks removed, it is made like any other.
    for number in 1..=3 {
        fs_err::remove_file(planned.folder.try_path(1, number)).unwrap();
    }
    planned.work("1/1", &|idx| planned.write(idx)).unwrap();
    planned.check_whole().unwrap();
}

#[test]
fn a_stop_is_no_failed_try_and_an_error_is() {
    let planned = Planned::new(1);
    for (failure, n_marks) in [(Failure::later("stopped"), 0), (Failure::fault(anyhow::anyhow!("disk full")), 1)] {
        let failure = RefCell::new(Some(failure));
        let make = |_: usize| Err(failure.take().unwrap());
        assert!(planned.work("1/1", &make).is_err());
        let marks = (1..=10).filter(|number| planned.folder.try_path(0, *number).exists());
        assert_eq!(marks.count(), n_marks);
    }
    let text = fs_err::read_to_string(planned.folder.try_path(0, 1)).unwrap();
    assert!(text.contains("disk full"), "{text}");
}

#[test]
fn a_damaged_shard_is_missing_again() {
    let planned = Planned::new(2);
    let make = |idx: usize| planned.write(idx);
    planned.work("1/1", &make).unwrap();
    fs_err::write(planned.folder.dir().join("samples-00001.parquet"), "shard 2").unwrap();
    let failure = planned.check_whole().unwrap_err();
    assert!(failure.blame == Blame::Later);
    assert!(format!("{failure:?}").contains("1 of 2 shards are missing: samples-00001"));
    planned.work("1/1", &make).unwrap();
    planned.check_whole().unwrap();
}

#[test]
fn a_shard_of_another_plan_counts_for_nothing() {
    let (planned, root) = (Planned::new(1), tempfile::tempdir().unwrap());
    planned.work("1/1", &|idx| planned.write(idx)).unwrap();
    let identity = Identity { program: "1 (b)".to_owned(), ..identity() };
    let division = Division::new(1, &serde_json::json!({})).unwrap();
    let other = ShardFolder::write(root.path(), kind("generate"), identity, &division).unwrap();
    for entry in fs_err::read_dir(planned.folder.dir()).unwrap() {
        let name = entry.unwrap().file_name();
        if name.to_string_lossy().starts_with("samples-") {
            fs_err::copy(planned.folder.dir().join(&name), other.dir().join(&name)).unwrap();
        }
    }
    assert_eq!([&planned.folder, &other].map(|folder| folder.seconds(0).is_some()), [true, false]);
}

#[test]
fn a_process_that_goes_on_alone_tries_again_what_failed_or_was_killed() {
    for (is_shared, n_left) in [(false, 0), (true, 1)] {
        let planned = Planned::of(3, is_shared);
        planned.finish(2, 1.0);
        fs_err::write(planned.folder.dir().join("samples-00002.parquet"), "damage!").unwrap();
        fs_err::write(planned.folder.try_path(0, 1), "").unwrap();
        tries::fail(&planned.folder.try_path(1, 2), "1/1", "disk full").unwrap();
        planned.folder.forget_failures().unwrap();
        // Where there may be other processes, it is unknown whether one is at work on the first shard.
        assert_eq!(planned.folder.tried().unwrap().len(), n_left);
        assert!(planned.folder.seconds(2).is_none());
    }
}

#[test]
fn what_others_are_at_is_left_to_them_for_a_while() {
    let planned = Planned::new(4);
    fs_err::write(planned.folder.try_path(1, 1), "").unwrap();
    let shards = Shards::new(&planned.folder, worker("1/1"), &Silent);
    let made = RefCell::new(Vec::new());
    let mut make = |idx: usize| {
        made.borrow_mut().push(idx);
        Ok((planned.write(idx)?, ()))
    };
    let began = Instant::now();
    assert!(shards.complete(0..3, &|_| 0, &mut make).unwrap());
    assert!(*made.borrow() == [0, 2, 1] && began.elapsed() >= LEAST_PATIENCE, "{made:?}");
    // A shard that failed often enough is not awaited.
    (1..=3).for_each(|number| tries::fail(&planned.folder.try_path(3, number), "1/1", "disk full").unwrap());
    assert!(!shards.complete(2..4, &|_| 0, &mut make).unwrap());
    assert_eq!(made.borrow().len(), 3);
}

#[test]
fn a_plan_of_others_is_refused_by_what_differs() {
    let planned = Planned::new(1);
    let root = planned.root();
    assert!(ShardFolder::of(root, kind("generate"), &identity()).unwrap().is_some());
    let mut other = [identity(), identity(), identity()];
    other[0].program = "1 (b)".to_owned();
    other[1].compute = "cuda NVIDIA H200, f32".to_owned();
    other[2].stage.fingerprint = "e".repeat(32);
    other[2].stage.settings = "e".repeat(32);
    other[2].stage.config = serde_json::json!({ "seed": 2 });
    let expected = ["program: the plan's is 1 (a), this one is 1 (b)", "device: ", "changed: generate.seed 1 -> 2"];
    for (other, expected) in other.iter().zip(expected) {
        let failure = ShardFolder::of(root, kind("generate"), other).unwrap_err();
        let said = format!("{failure:?}");
        assert!(failure.blame == Blame::Input && said.contains(expected) && said.contains("--redo generate"), "{said}");
    }
}

#[test]
fn only_our_files_are_discarded() {
    let planned = Planned::new(4);
    planned.work("1/1", &|idx| planned.write(idx)).unwrap();
    let dir = planned.folder.dir();
    fs_err::write(planned.folder.log(3), "line\n").unwrap();
    fs_err::write(dir.join("samples-00001.try-2"), "").unwrap();
    fs_err::write(dir.join("request-00-round-00003.json"), "{}").unwrap();
    fs_err::write(crate::files::unique_partial(&dir.join("samples-00001.parquet")), "half").unwrap();
    for theirs in ["thesis.doc", "request-00-round-x.json", "samples-1.parquet", "samples-00001.try-11", "worker-3.txt"]
    {
        fs_err::write(dir.join(theirs), "years of work").unwrap();
        assert!(planned.folder.discard().unwrap_err().error.to_string().contains(theirs));
        assert!(planned.folder.is_there());
        fs_err::remove_file(dir.join(theirs)).unwrap();
    }
    // A process that was killed while it removed the plan has removed this first.
    fs_err::remove_file(dir.join("parts.json")).unwrap();
    assert!(ShardFolder::all(planned.root(), kind("generate")).unwrap().is_empty());
    planned.clean_up().unwrap();
    assert!(!dir.parent().unwrap().exists());
}

#[cfg(unix)]
#[test]
fn what_systems_and_others_leave_beside_plans_is_passed_over() {
    let planned = Planned::new(1);
    let parts = planned.folder.dir().parent().unwrap();
    let (root, theirs) = (planned.root(), planned.root().join("theirs"));
    fs_err::create_dir(&theirs).unwrap();
    fs_err::write(theirs.join("plan.json"), "years of work").unwrap();
    for name in [".DS_Store", ".nfs0000000012", "0123456789abcdee"] {
        fs_err::write(parts.join(name), "").unwrap();
    }
    fs_err::create_dir(parts.join("notes")).unwrap();
    std::os::unix::fs::symlink(&theirs, parts.join("0123456789abcdef")).unwrap();
    assert_eq!(ShardFolder::all(root, kind("generate")).unwrap().len(), 1);
    planned.clean_up().unwrap();
    assert!(!planned.folder.is_there() && parts.join(".DS_Store").exists() && theirs.join("plan.json").exists());
    fs_err::rename(parts, root.join("away")).unwrap();
    std::os::unix::fs::symlink(&theirs, parts).unwrap();
    assert_eq!(planned.clean_up().unwrap_err().blame, Blame::Input);
}

#[test]
fn a_damaged_record_of_a_plan_is_not_taken_for_none() {
    let planned = Planned::new(2);
    let path = planned.folder.dir().join("parts.json");
    let text = fs_err::read_to_string(&path).unwrap();
    fs_err::write(&path, text.replacen("cpu", "cpv", 1)).unwrap();
    let failure = ShardFolder::all(planned.root(), kind("generate")).unwrap_err();
    let said = format!("{failure:?}");
    assert!(failure.blame == Blame::Fault && said.contains("parts.json is damaged: "), "{said}");
    assert!(said.contains("move "), "{said}");
}

#[test]
fn the_folder_alone_tells_how_far_the_shards_are() {
    let planned = Planned::new(6);
    let status = || shard_status(planned.root(), &KINDS).unwrap().unwrap();
    assert!(status().n_missing == 6 && status().seconds_left.is_none());
    for (idx, seconds) in [(0, 30.0), (5, 50.0)] {
        planned.finish(idx, seconds);
    }
    assert!(status().text().contains("time left         unknown: no worker is at work; a shard takes one 40 s"));
    // Two shards are at work, one for less than five times the usual time; one try died long ago, and ten tries of
    // another shard.
    for (idx, number, age_s) in [(1, 1, 0), (2, 2, 190), (3, 1, 210)] {
        let mark = fs_err::File::create(planned.folder.try_path(idx, number)).unwrap();
        mark.file().set_modified(std::time::SystemTime::now() - Duration::from_secs(age_s)).unwrap();
    }
    (1..=10).for_each(|number| fs_err::write(planned.folder.try_path(4, number), "").unwrap());
    let found = status();
    assert_eq!((found.n_shards, found.n_done, found.n_running, found.n_missing), (6, 2, 2, 1));
    assert_eq!(found.given_up, ["samples-00004 (10 workers died in it, or are still at work on it)"]);
    // Three shards of 40 s by two workers.
    assert!((found.seconds_left.unwrap() - 60.0).abs() < 1e-9);
    assert_eq!(
        found.text(),
        "shards            2 of 6 done, 2 running, 1 missing, 1 given up\ntime left         60 s\ngiven up          \
         samples-00004 (10 workers died in it, or are still at work on it)\n"
    );
}
