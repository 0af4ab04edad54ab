//! Which stages run again after which changes? On stages that write a line of text.

use super::device::ComputeChoice;
use super::log::LOG_FILE;
use super::plan::plan;
use super::planned::Action;
use super::run_folder::{RUN_FILE, RunAbout, RunFolder, RunManifest, StageStatus, TIMINGS_FILE, run_stages};
use super::shards::Makers;
use super::testing::{KINDS, kind};
use super::timings::Timings;
use super::{Blame, Failure, Result, Stage, StageContext, StageInput, StageKind, Whole, Work};
use crate::files::write_atomically;
use crate::progress::Heard;
use crate::store::read_json;
use serde_json::{Value, json};
use std::cell::RefCell;
use std::io::Write;
use std::path::Path;

/// A stage that writes its text and its inputs into a file.
struct Toy<'a> {
    kind: &'static StageKind,
    text: &'a str,
    version: u32,
    inputs: Vec<StageInput>,
    output: &'static [&'static str],
    ran: &'a RefCell<Vec<&'static StageKind>>,
    fails: bool,
}

impl Stage for Toy<'_> {
    fn kind(&self) -> &'static StageKind {
        self.kind
    }

    fn version(&self) -> u32 {
        self.version
    }

    fn check(&self) -> Result<()> {
        if self.text == "impossible" { Err(Failure::input_message("impossible")) } else { Ok(()) }
    }

    fn config(&self) -> anyhow::Result<Value> {
        Ok(json!({ "text": self.text }))
    }

    fn inputs(&self) -> Vec<StageInput> {
        self.inputs.clone()
    }

    fn outputs(&self) -> &'static [&'static str] {
        self.output
    }

    fn work(&self) -> Work<'_> {
        Work::Whole(self)
    }
}

impl Whole for Toy<'_> {
    fn run(&self, context: &StageContext<'_>) -> Result<Value> {
        self.ran.borrow_mut().push(self.kind);
        context.progress.start("texts", 2, "lines");
        if self.text == "unlike" {
            // As another version of the program would write it.
            write(&context.root.join(self.output[0]), &format!("{:?}", std::time::Instant::now()))?;
            return Ok(json!({}));
        }
        let path = context.root.join(self.output[0]);
        let mut content = fs_err::read_to_string(&path).unwrap_or_default();
        content.push_str(self.text);
        write(&path, &content)?;
        if self.fails {
            return Err(Failure::input_message("broken off"));
        }
        for input in &self.inputs {
            content.push_str(&fs_err::read_to_string(&input.path)?);
        }
        write(&path, &content)?;
        Ok(json!({ "trained": true }))
    }
}

fn write(path: &Path, content: &str) -> std::io::Result<()> {
    write_atomically(path, |file| file.write_all(content.as_bytes())).map(drop)
}

/// Two stages, the second of which reads the output of the first; the first reads `recording`.
struct Pipeline<'a> {
    root: &'a Path,
    first: &'a str,
    second: &'a str,
    version: u32,
    fails: bool,
    redo: Vec<&'static StageKind>,
    kind: &'static StageKind,
    heard: Heard,
}

impl Pipeline<'_> {
    /// Runs it; returns what was planned and what ran.
    fn run(&self) -> (Vec<Action>, Vec<&'static StageKind>, Result<()>) {
        let ran = RefCell::new(Vec::new());
        let recording = self.root.parent().unwrap().join("recording.csv");
        let stages: Vec<Box<dyn Stage + '_>> = vec![
            Box::new(Toy {
                kind: kind("ingest"),
                text: self.first,
                version: self.version,
                inputs: vec![StageInput::external("recording", &recording)],
                output: &["scenes"],
                ran: &ran,
                fails: false,
            }),
            Box::new(Toy {
                kind: self.kind,
                text: self.second,
                version: 1,
                inputs: vec![StageInput::made_by(kind("ingest"), "scenes", &self.root.join("scenes"))],
                output: &self.kind.outputs[..1],
                ran: &ran,
                fails: self.fails,
            }),
        ];
        let mut actions = Vec::new();
        let outcome = RunFolder::open(self.root, &KINDS).and_then(|folder| {
            let planned = plan(self.root, &KINDS, stages, &self.redo)?;
            actions.extend(planned.iter().map(|stage| stage.action.clone()));
            let name = String::new;
            let about = RunAbout { pipeline: name(), seed: 0, device: name(), config: name() };
            run_stages(&folder, Some(&about), (ComputeChoice::default(), Makers::Alone), planned, &self.heard).map(drop)
        });
        (actions, ran.into_inner(), outcome)
    }
}

fn why(action: &Action) -> &str {
    match action {
        Action::Run(why) => why,
        Action::Reuse => "reuse",
        Action::Resume => "resume",
    }
}

fn in_folder(test: impl FnOnce(Pipeline<'_>)) {
    let folder = tempfile::tempdir().unwrap();
    fs_err::write(folder.path().join("recording.csv"), "1,2").unwrap();
    let root = folder.path().join("run");
    fs_err::create_dir(&root).unwrap();
    test(Pipeline {
        root: &root,
        first: "a",
        second: "b",
        version: 1,
        fails: false,
        redo: Vec::new(),
        kind: kind("mine"),
        heard: Heard::default(),
    });
}

#[test]
fn what_comes_out_differently_is_read_again() {
    in_folder(|mut pipeline| {
        pipeline.first = "unlike";
        pipeline.run().2.unwrap();
        pipeline.redo = vec![kind("ingest")];
        let (_, ran, outcome) = pipeline.run();
        outcome.unwrap();
        assert_eq!(ran, [kind("ingest"), kind("mine")]);
        // A user who stops it in between finds out the next time.
        pipeline.fails = true;
        let (_, ran, outcome) = pipeline.run();
        assert!(outcome.is_err() && ran.len() == 2);
        (pipeline.fails, pipeline.redo) = (false, Vec::new());
        let (actions, ran, outcome) = pipeline.run();
        outcome.unwrap();
        assert_eq!((why(&actions[1]), ran), ("resume", vec![kind("mine")]), "it was begun on what is there");
        assert!(pipeline.run().1.is_empty());
    });
    in_folder(|mut pipeline| {
        pipeline.run().2.unwrap();
        pipeline.redo = vec![kind("ingest")];
        assert_eq!(pipeline.run().1, [kind("ingest")], "the same came out");
        assert!(pipeline.heard.take().is_empty());
    });
}

#[test]
fn a_stage_that_was_interrupted_begins_anew_where_its_input_came_out_differently() {
    in_folder(|mut pipeline| {
        (pipeline.first, pipeline.fails) = ("unlike", true);
        assert!(pipeline.run().2.is_err());
        (pipeline.fails, pipeline.redo) = (false, vec![kind("ingest")]);
        let (actions, _, outcome) = pipeline.run();
        outcome.unwrap();
        assert_eq!(actions[1], Action::Resume, "nobody could know when it was planned");
        let events = fs_err::read_to_string(pipeline.root.join("events.parquet")).unwrap();
        assert!(!events.starts_with("bb"), "nothing was added to what the interrupted run left: {events}");
    });
}

#[test]
fn models_trained_on_what_came_out_differently_are_kept_with_a_warning() {
    in_folder(|mut pipeline| {
        (pipeline.first, pipeline.kind) = ("unlike", kind("train_denoiser"));
        pipeline.run().2.unwrap();
        pipeline.redo = vec![kind("ingest")];
        assert_eq!(pipeline.run().1, [kind("ingest")]);
        let warning = "train_denoiser is kept, but ingest, which it read, has written other bytes since";
        assert!(pipeline.heard.take().concat().contains(warning));
        pipeline.redo = vec![];
        assert!(pipeline.run().1.is_empty());
        assert!(pipeline.heard.take().concat().contains(warning), "it stays true until somebody trains it again");
        pipeline.redo = vec![kind("train_denoiser")];
        assert_eq!(pipeline.run().1, [kind("train_denoiser")]);
        pipeline.redo = vec![];
        assert!(pipeline.run().1.is_empty() && pipeline.heard.take().is_empty());
    });
}

#[test]
fn what_is_done_is_not_done_again() {
    in_folder(|pipeline| {
        let (actions, ran, outcome) = pipeline.run();
        outcome.unwrap();
        assert_eq!((why(&actions[0]), ran.len()), ("not done yet", 2));
        let (actions, ran, outcome) = pipeline.run();
        outcome.unwrap();
        assert_eq!((actions, ran.len()), (vec![Action::Reuse, Action::Reuse], 0));
        let read = |name: &str| fs_err::read_to_string(pipeline.root.join(name)).unwrap();
        assert_eq!(read("events.parquet"), "ba1,2");
        // What was done is told.
        assert!(read(LOG_FILE).contains("Z mine: texts: started (2 lines)\n"), "{}", read(LOG_FILE));
        let timings: Timings = read_json(&pipeline.root.join(TIMINGS_FILE)).unwrap();
        let [timing] = &timings.stages["mine"][..] else { panic!("{timings:?}") };
        assert!(timing.seconds.is_some() && timing.peak_memory_bytes.is_some_and(|n| n > 1 << 20), "{timing:?}");
    });
}

#[test]
fn a_change_reaches_everything_after_it_and_nothing_before_it() {
    in_folder(|pipeline| {
        pipeline.run().2.unwrap();
        let changed_second = Pipeline { second: "c", ..pipeline };
        let (actions, ran, _) = changed_second.run();
        assert_eq!(ran, [kind("mine")]);
        assert_eq!(why(&actions[1]), "changed: mine.text \"b\" -> \"c\"");
        let changed_first = Pipeline { first: "z", ..changed_second };
        let (actions, ran, _) = changed_first.run();
        assert_eq!(ran, [kind("ingest"), kind("mine")]);
        assert_eq!(why(&actions[1]), "changed: input scenes");
        // Old outputs are gone before the stage begins: nothing was appended to them.
        assert_eq!(fs_err::read_to_string(changed_first.root.join("events.parquet")).unwrap(), "cz1,2");
        let (actions, ran, _) = Pipeline { version: 2, ..changed_first }.run();
        assert_eq!(ran.len(), 2);
        assert_eq!(why(&actions[0]), "changed: stage version 1 -> 2");
    });
}

#[test]
fn changed_recordings_and_damaged_outputs_are_noticed() {
    in_folder(|pipeline| {
        pipeline.run().2.unwrap();
        fs_err::write(pipeline.root.join("scenes"), "tampered").unwrap();
        let (actions, ran, _) = pipeline.run();
        assert_eq!(why(&actions[0]), "scenes is missing or was changed");
        assert_eq!(ran, [kind("ingest")], "the same bytes again: what follows stays as it is");
        fs_err::write(pipeline.root.parent().unwrap().join("recording.csv"), "3,4").unwrap();
        let (actions, ran, _) = pipeline.run();
        assert_eq!(why(&actions[0]), "changed: input recording");
        assert_eq!(ran.len(), 2);
    });
}

#[test]
fn large_outputs_count_to_their_last_byte_and_are_read_again_only_when_they_are_others() {
    let large = "a".repeat(3 << 20);
    in_folder(|pipeline| {
        let pipeline = Pipeline { first: &large, ..pipeline };
        pipeline.run().2.unwrap();
        let scenes = pipeline.root.join("scenes");
        let written = fs_err::read(&scenes).unwrap();
        let modified = fs_err::metadata(&scenes).unwrap().modified().unwrap();
        let mut damaged = written.clone();
        damaged[3 << 19] = b'b';
        fs_err::write(&scenes, &damaged).unwrap();
        let (actions, ran, _) = pipeline.run();
        assert_eq!(why(&actions[0]), "scenes is missing or was changed");
        assert_eq!(ran, [kind("ingest")]);

        let set_modified = |time| {
            let file = fs_err::OpenOptions::new().write(true).open(&scenes).unwrap();
            file.file().set_modified(time).unwrap();
        };
        assert_eq!(fs_err::read(&scenes).unwrap(), written);
        set_modified(modified);
        assert_eq!(pipeline.run().0[0], Action::Reuse, "it is of another time, and so read again");
        fs_err::write(&scenes, &damaged).unwrap();
        set_modified(modified);
        assert_eq!(pipeline.run().0[0], Action::Reuse, "size and time are those of before: not read");
        fs_err::remove_file(pipeline.root.join(TIMINGS_FILE)).unwrap();
        assert_eq!(why(&pipeline.run().0[0]), "scenes is missing or was changed");
    });
}

#[test]
fn unfinished_work_is_taken_up_if_nothing_changed_and_dropped_otherwise() {
    in_folder(|pipeline| {
        let broken = Pipeline { fails: true, ..pipeline };
        assert_eq!(broken.run().2.unwrap_err().blame, Blame::Input);
        let manifest: RunManifest = read_json(&broken.root.join(RUN_FILE)).unwrap();
        let status = ["ingest", "mine"].map(|stage| manifest.stages[stage].status);
        assert_eq!(status, [StageStatus::Done, StageStatus::Pending]);
        let whole = Pipeline { fails: false, ..broken };
        let (actions, ran, outcome) = whole.run();
        outcome.unwrap();
        assert_eq!((actions, ran), (vec![Action::Reuse, Action::Resume], vec![kind("mine")]));
        let found = fs_err::read_to_string(whole.root.join("events.parquet")).unwrap();
        assert_eq!(found, "bba1,2", "the first b was kept");
    });
    in_folder(|pipeline| {
        let broken = Pipeline { fails: true, ..pipeline };
        broken.run().2.unwrap_err();
        let other = Pipeline { fails: false, second: "c", ..broken };
        other.run().2.unwrap();
        assert_eq!(fs_err::read_to_string(other.root.join("events.parquet")).unwrap(), "ca1,2");
    });
}

#[test]
fn mistakes_are_found_before_anything_runs() {
    in_folder(|pipeline| {
        let (_, ran, outcome) = Pipeline { second: "impossible", ..pipeline }.run();
        assert_eq!((ran.len(), outcome.unwrap_err().blame), (0, Blame::Input));
    });
    in_folder(|pipeline| {
        fs_err::remove_file(pipeline.root.parent().unwrap().join("recording.csv")).unwrap();
        let failure = pipeline.run().2.unwrap_err();
        assert!(format!("{failure:?}").contains("recording.csv"), "{failure:?}");
    });
}
