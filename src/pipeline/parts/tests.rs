//! Who samples which shard, and what becomes of shards that cannot be sampled? On shards without scenarios.

use super::Identity;
use super::folder::PartsFolder;
use super::gathering::Gathering;
use super::generation::{SampledShard, gather, work_through};
use super::tries;
use super::work::{Shards, Worker};
use super::{sealed, shard_status};
use crate::generate::{GenerateConfig, Plan, ResolvedGeneration, ShardOutput, ShardPlan};
use crate::pipeline::stages::{SampleFolder, SampleSidecar};
use crate::pipeline::{Blame, Failure, Result, StageId, StageRecord};
use crate::progress::Silent;
use std::cell::{Cell, RefCell};
use std::collections::{BTreeMap, BTreeSet};
use std::panic::{AssertUnwindSafe, catch_unwind};

fn identity() -> Identity {
    let stage = StageRecord {
        stage: StageId::Generate,
        version: 1,
        config: serde_json::json!({ "seed": 1 }),
        inputs: BTreeMap::new(),
        fingerprint: "f".repeat(32),
        outputs: BTreeMap::new(),
        files: BTreeSet::new(),
        summary: serde_json::Value::Null,
        times: BTreeMap::new(),
    };
    Identity { stage, program: "1 (a)".to_owned(), compute: "cpu, f32".to_owned() }
}

/// A plan of two sweeps with `n_shards` each, the second of which needs `enough` verified scenarios.
struct Planned {
    _root: tempfile::TempDir,
    folder: PartsFolder,
    plan: Plan,
    resolved: ResolvedGeneration,
}

impl Planned {
    fn new(n_shards: usize, enough: usize) -> Self {
        let root = tempfile::tempdir().unwrap();
        let text = format!(
            "[[sweeps]]\nname = 'a'\nn_scenes = 4\n[[sweeps]]\nname = 'b'\nn_scenes = 4\nbehavior = 'cut_in'\nstop_after_verified = {enough}"
        );
        let behaviors = crate::pipeline::stages::MineConfig::default().build().unwrap();
        let resolved = toml::from_str::<GenerateConfig>(&text).unwrap().resolve(&behaviors).unwrap();
        let shard = |idx| ShardPlan { idx, sweep_idx: idx / n_shards, cells: Vec::new(), first_sample: 0 };
        let plan = Plan { shards: (0..2 * n_shards).map(shard).collect(), shortfalls: Vec::new() };
        let folder = PartsFolder::write(root.path(), identity(), &plan, plan.shards.len()).unwrap();
        Self { _root: root, folder, plan, resolved }
    }

    fn work(&self, worker: &str, sample: &dyn Fn(&ShardPlan) -> Result<SampleSidecar>) -> Result<()> {
        let shards = Shards::new(&self.folder, worker.parse().unwrap(), &Silent);
        work_through(&shards, &self.plan, &self.resolved, &mut |shard| sample(shard))
    }

    /// Writes an empty shard that claims to hold `n_verified` scenarios.
    fn write(&self, shard: &ShardPlan, n_verified: u64) -> Result<SampleSidecar> {
        let samples = SampleFolder::open_for_writing(self.folder.dir())?;
        let sidecar = samples.write_table(shard.idx, ("a", 1), ShardOutput::default(), None)?;
        Ok(SampleSidecar { n_verified, ..sidecar })
    }

    fn collected(&self) -> Result<Vec<usize>> {
        Ok(self.gathered()?.whole()?.into_iter().map(|(idx, _)| idx).collect())
    }

    fn gathered(&self) -> Result<Gathering<'_, SampledShard>> {
        let mut shards = Gathering::new(&self.folder, self.plan.shards.len());
        gather(&self.plan, &self.resolved, &mut shards)?;
        Ok(shards)
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
fn a_shard_that_crashes_is_given_up_by_name_and_the_others_are_sampled() {
    let planned = Planned::new(3, 100);
    assert_eq!(planned.collected().unwrap_err().blame, Blame::Later);
    let n_crashes = Cell::new(0);
    let sample = |shard: &ShardPlan| {
        if shard.idx == 1 {
            n_crashes.set(n_crashes.get() + 1);
            panic!("scene x has no lanes");
        }
        planned.write(shard, 0)
    };
    // Each process ends with the panic and is started again, as a scheduler does.
    let run = || catch_unwind(AssertUnwindSafe(|| planned.work("1/1", &sample)));
    for _ in 0..3 {
        assert!(run().is_err());
    }
    run().unwrap().unwrap();
    assert_eq!(n_crashes.get(), 3);
    let failure = planned.collected().unwrap_err();
    let said = format!("{failure:?}");
    assert_eq!(failure.blame, Blame::Fault);
    assert!(
        said.contains("1 of 6 shards were given up: samples-00001 (failed 3 times, last: a bug: scene x has no lanes)")
    );
    assert!(said.contains("marks *.try-*"), "{said}");
    // Mended, and its marks removed, it is sampled like any other.
    for number in 1..=3 {
        fs_err::remove_file(planned.folder.try_path(1, number)).unwrap();
    }
    let mended = |shard: &ShardPlan| planned.write(shard, 0);
    planned.work("1/1", &mended).unwrap();
    assert_eq!(planned.collected().unwrap(), [0, 1, 2, 3, 4, 5]);
}

#[test]
fn a_stop_is_no_failed_try_and_an_error_is() {
    let planned = Planned::new(1, 100);
    for (failure, n_marks) in [(Failure::later("stopped"), 0), (Failure::fault(anyhow::anyhow!("disk full")), 1)] {
        let failure = RefCell::new(Some(failure));
        let sample = |_: &ShardPlan| Err(failure.take().unwrap());
        assert!(planned.work("1/1", &sample).is_err());
        let marks = (1..=10).filter(|number| planned.folder.try_path(0, *number).exists());
        assert_eq!(marks.count(), n_marks);
    }
    let text = fs_err::read_to_string(planned.folder.try_path(0, 1)).unwrap();
    assert!(text.contains("disk full"), "{text}");
}

#[test]
fn what_one_process_would_not_have_sampled_is_not_published() {
    let planned = Planned::new(4, 3);
    let sampled = RefCell::new(Vec::new());
    let sample = |shard: &ShardPlan| {
        sampled.borrow_mut().push(shard.idx);
        planned.write(shard, 2)
    };
    // The second worker comes to the end of the second sweep before the first one has come to its beginning.
    planned.work("2/2", &sample).unwrap();
    planned.work("1/2", &sample).unwrap();
    assert_eq!(planned.collected().unwrap(), [0, 1, 2, 3, 4, 5], "4 verified in two shards of the second sweep");
    assert!(sampled.borrow().contains(&7), "nobody knew");
    let n_sampled = sampled.borrow().len();
    planned.work("1/1", &sample).unwrap();
    assert_eq!(sampled.borrow().len(), n_sampled, "what is finished or unwanted is not sampled again");
}

#[test]
fn one_process_takes_over_no_shard_that_it_might_not_want() {
    let planned = Planned::new(3, 3);
    // The second shard of either sweep is missing.
    for idx in [0, 2, 3, 5] {
        let sidecar = planned.write(&planned.plan.shards[idx], 1).unwrap();
        planned.folder.finish(idx, "1/1", 1.0, &SampledShard::of_sweep(sidecar)).unwrap();
    }
    let (found, n_shards) = planned.gathered().unwrap().found();
    assert_eq!((found.into_iter().map(|(idx, _)| idx).collect::<Vec<_>>(), n_shards), (vec![0, 2, 3], 6));
}

#[test]
fn a_damaged_shard_is_missing_again() {
    let planned = Planned::new(1, 100);
    let sample = |shard: &ShardPlan| planned.write(shard, 0);
    planned.work("1/1", &sample).unwrap();
    let table = planned.folder.dir().join("samples-00001.parquet");
    let mut bytes = fs_err::read(&table).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs_err::write(&table, bytes).unwrap();
    let failure = planned.collected().unwrap_err();
    assert!(
        failure.blame == Blame::Later && format!("{failure:?}").contains("1 of 2 shards are missing: samples-00001")
    );
    planned.work("1/1", &sample).unwrap();
    assert_eq!(planned.collected().unwrap(), [0, 1]);
}

#[test]
fn what_others_are_at_is_left_to_them_for_a_while() {
    let planned = Planned::new(2, 100);
    fs_err::write(planned.folder.try_path(1, 1), "").unwrap();
    let shards = Shards::new(&planned.folder, worker("1/1"), &Silent);
    let made = RefCell::new(Vec::new());
    let mut make = |idx: usize| {
        made.borrow_mut().push(idx);
        Ok(SampledShard::of_sweep(planned.write(&planned.plan.shards[idx], 0)?))
    };
    assert!(shards.complete(0..3, &|_| 0, &mut make).unwrap());
    assert_eq!(*made.borrow(), [0, 2, 1]);
    // What failed often enough is not waited for.
    (1..=3).for_each(|number| tries::fail(&planned.folder.try_path(3, number), "1/1", "disk full").unwrap());
    assert!(!shards.complete(2..4, &|_| 0, &mut make).unwrap());
    assert_eq!(made.borrow().len(), 3);
}

#[test]
fn a_plan_of_others_is_refused_by_what_differs() {
    let planned = Planned::new(1, 100);
    let root = planned.folder.dir().parent().unwrap().parent().unwrap();
    assert_eq!(PartsFolder::of(root, &identity()).unwrap(), Some(planned.folder.clone()));
    let mut other = [identity(), identity(), identity()];
    other[0].program = "1 (b)".to_owned();
    other[1].compute = "cuda NVIDIA H200, f32".to_owned();
    other[2].stage.fingerprint = "e".repeat(32);
    other[2].stage.config = serde_json::json!({ "seed": 2 });
    let expected = ["program: the plan's is 1 (a), this one is 1 (b)", "device: ", "changed: generate.seed 1 -> 2"];
    for (other, expected) in other.iter().zip(expected) {
        let failure = PartsFolder::of(root, other).unwrap_err();
        let said = format!("{failure:?}");
        assert!(failure.blame == Blame::Input && said.contains(expected) && said.contains("--redo generate"), "{said}");
    }
}

#[test]
fn only_our_files_are_discarded() {
    let planned = Planned::new(2, 100);
    let sample = |shard: &ShardPlan| planned.write(shard, 0);
    planned.work("1/1", &sample).unwrap();
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
    let root = dir.parent().unwrap().parent().unwrap();
    assert!(PartsFolder::all(root, StageId::Generate).unwrap().is_empty());
    sealed(root, StageId::Generate).unwrap();
    assert!(!dir.parent().unwrap().exists());
}

#[cfg(unix)]
#[test]
fn what_systems_and_others_leave_beside_plans_is_passed_over() {
    let planned = Planned::new(1, 100);
    let parts = planned.folder.dir().parent().unwrap();
    let (root, theirs) = (parts.parent().unwrap(), parts.parent().unwrap().join("theirs"));
    fs_err::create_dir(&theirs).unwrap();
    fs_err::write(theirs.join("plan.json"), "years of work").unwrap();
    for name in [".DS_Store", ".nfs0000000012", "0123456789abcdee"] {
        fs_err::write(parts.join(name), "").unwrap();
    }
    fs_err::create_dir(parts.join("notes")).unwrap();
    std::os::unix::fs::symlink(&theirs, parts.join("0123456789abcdef")).unwrap();
    assert_eq!(PartsFolder::all(root, StageId::Generate).unwrap(), std::slice::from_ref(&planned.folder));
    sealed(root, StageId::Generate).unwrap();
    assert!(!planned.folder.is_there() && parts.join(".DS_Store").exists() && theirs.join("plan.json").exists());
    fs_err::rename(parts, root.join("away")).unwrap();
    std::os::unix::fs::symlink(&theirs, parts).unwrap();
    assert_eq!(sealed(root, StageId::Generate).unwrap_err().blame, Blame::Input);
}

#[test]
fn what_leads_out_of_a_plan_counts_for_nothing() {
    let planned = Planned::new(2, 100);
    let sidecar = planned.write(&planned.plan.shards[0], 0).unwrap();
    let finish = |file: &str| {
        let sidecar = SampleSidecar { file: file.to_owned(), ..sidecar.clone() };
        planned.folder.finish(0, "1/1", 1.0, &SampledShard::of_sweep(sidecar)).unwrap();
        planned.folder.finished::<SampledShard>(0).is_some()
    };
    let absolute = planned.folder.dir().join(&sidecar.file);
    assert!(finish(&sidecar.file));
    for file in ["./samples-00000.parquet", &absolute.to_string_lossy(), "samples-00001.parquet", ""] {
        assert!(!finish(file), "{file}");
    }
    // The record of a plan is damaged: nobody takes it for none.
    let root = planned.folder.dir().parent().unwrap().parent().unwrap();
    let path = planned.folder.dir().join("parts.json");
    let text = fs_err::read_to_string(&path).unwrap();
    fs_err::write(&path, text.replacen("cpu", "cpv", 1)).unwrap();
    let failure = PartsFolder::all(root, StageId::Generate).unwrap_err();
    let said = format!("{failure:?}");
    assert!(
        failure.blame == Blame::Fault && said.contains("parts.json is damaged: ") && said.contains("move "),
        "{said}"
    );
}

#[test]
fn the_folder_alone_tells_how_far_the_shards_are() {
    let planned = Planned::new(3, 100);
    let root = planned.folder.dir().parent().unwrap().parent().unwrap();
    let status = || shard_status(root).unwrap().unwrap();
    assert!(status().n_missing == 6 && status().seconds_left.is_none());
    for (idx, seconds) in [(0, 30.0), (5, 50.0)] {
        let sidecar = planned.write(&planned.plan.shards[idx], 0).unwrap();
        planned.folder.finish(idx, "1/2", seconds, &SampledShard::of_sweep(sidecar)).unwrap();
    }
    assert!(status().text().contains("time left         unknown: no worker is at work; a shard takes one 40 s"));
    // Two are at work; one died long ago, in another ten did.
    for mark in [planned.folder.try_path(1, 1), planned.folder.try_path(2, 2), planned.folder.try_path(3, 1)] {
        fs_err::write(mark, "").unwrap();
    }
    let old = std::time::SystemTime::now() - std::time::Duration::from_secs(1_000);
    let mark = fs_err::OpenOptions::new().write(true).open(planned.folder.try_path(3, 1)).unwrap();
    mark.file().set_modified(old).unwrap();
    (1..=10).for_each(|number| fs_err::write(planned.folder.try_path(4, number), "").unwrap());
    let found = status();
    assert_eq!((found.n_shards, found.n_done, found.n_running, found.n_missing), (6, 2, 2, 1));
    assert_eq!(found.given_up, ["samples-00004 (10 workers died in it, or are still at work on it)"]);
    // Three shards of 40 s by two workers.
    assert!((found.seconds_left.unwrap() - 60.0).abs() < 1e-9);
    assert_eq!(
        found.text(),
        "shards            2 of 6 done, 2 running, 1 missing, 1 given up\ntime left         60 s\ngiven up          samples-00004 (10 workers died in it, or are still at work on it)\n"
    );
}
