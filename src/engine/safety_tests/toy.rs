//! A stage that writes a few lines, and ways to change its run folder.

use crate::engine::plan::plan;
use crate::engine::planned::{Action, PlannedStage};
use crate::engine::run_folder::{RunFolder, StageTiming, TIMINGS_FILE, Timings, run_stages};
use crate::engine::shards::Makers;
use crate::engine::testing::{KINDS, kind};
use crate::engine::{ComputeChoice, Failure, Result, Stage, StageContext, StageInput, StageKind, Whole, Work};
use crate::files::write_atomically;
use crate::progress::Silent;
use crate::store::write_record;
use fs_err as fs;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Trains a "model": a folder of two files. A cheap one evaluates: into such a folder, and a file beside it.
#[derive(Clone, Default)]
pub(super) struct Toy {
    pub(super) text: String,
    pub(super) inputs: Vec<StageInput>,
    pub(super) fails: bool,
    /// A foreign file that appears while the stage is at work.
    pub(super) put_meanwhile: Option<PathBuf>,
    pub(super) is_cheap: bool,
}

impl Stage for Toy {
    fn kind(&self) -> &'static StageKind {
        if self.is_cheap { kind("evaluate") } else { kind("train_denoiser") }
    }

    fn version(&self) -> u32 {
        1
    }

    fn check(&self) -> Result<()> {
        Ok(())
    }

    fn config(&self) -> anyhow::Result<Value> {
        Ok(json!({ "text": self.text }))
    }

    fn inputs(&self) -> Vec<StageInput> {
        self.inputs.clone()
    }

    fn outputs(&self) -> &'static [&'static str] {
        if self.is_cheap { &["corpus", "metrics.json"] } else { &["denoiser"] }
    }

    fn work(&self) -> Work<'_> {
        Work::Whole(self)
    }
}

impl Whole for Toy {
    fn run(&self, context: &StageContext<'_>) -> Result<Value> {
        let folder = context.root.join(self.outputs()[0]);
        let file = self.outputs().get(1).map(|name| context.root.join(name));
        for path in [folder.join("state.safetensors"), folder.join("deep/model.safetensors")].into_iter().chain(file) {
            fs::create_dir_all(path.parent().unwrap())?;
            write_atomically::<std::io::Error>(&path, |file| file.write_all(self.text.as_bytes()))?;
            if self.fails {
                return Err(Failure::input_message("broken off"));
            }
        }
        if let Some(path) = &self.put_meanwhile {
            put(path, FOREIGN);
        }
        Ok(json!({ "trained": !self.is_cheap }))
    }
}

pub(super) const FOREIGN: &str = "years of work";

pub(super) fn put(path: &Path, text: &str) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(path, text).unwrap();
}

pub(super) fn toy(text: &str) -> Toy {
    Toy { text: text.to_owned(), ..Toy::default() }
}

/// The plan of the toy.
pub(super) struct Planned {
    pub(super) action: Action,
    pub(super) redone: Option<String>,
}

/// Runs the stage as the program does.
pub(super) fn run(root: &Path, toy: &Toy, redo: &[&'static StageKind]) -> Result<Planned> {
    let folder = RunFolder::open(root, &KINDS)?;
    let mut planned: Vec<PlannedStage<'_>> = plan(root, &KINDS, vec![Box::new(toy.clone())], redo)?;
    let first = planned.first_mut().unwrap();
    let plan = Planned { action: first.action.clone(), redone: first.redone() };
    run_stages(&folder, None, (ComputeChoice::default(), Makers::Alone), planned, &Silent)?;
    Ok(plan)
}

/// Every file by its name, except the lock.
pub(super) fn snapshot(root: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let names = crate::files::files_below(root).unwrap().into_iter().filter(|name| name != Path::new(".lock"));
    names.map(|name| (name.clone(), fs::read(root.join(&name)).unwrap())).collect()
}

pub(super) fn text(root: &Path, name: &str) -> String {
    fs::read_to_string(root.join(name)).unwrap()
}

/// Writes how long the stage took.
pub(super) fn took(root: &Path, seconds: Option<f64>) {
    let timing = StageTiming { started: String::new(), finished: None, seconds, n_threads: 1, peak_memory_bytes: None };
    let timings =
        Timings { stages: BTreeMap::from([("train_denoiser".to_owned(), vec![timing])]), outputs: BTreeMap::new() };
    write_record(&root.join(TIMINGS_FILE), &timings).unwrap();
}
