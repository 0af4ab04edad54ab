//! Does a process that runs a stage alone resume what it had begun? On three shards of a byte.

use super::folder::ShardFolder;
use super::gathering::Gathering;
use super::make::Shards;
use super::{Division, Makers, Sharded};
use crate::engine::plan::plan;
use crate::engine::run_folder::{RunFolder, run_stages};
use crate::engine::testing::{KINDS, kind};
use crate::engine::{ComputeChoice, Failure, Result, Stage, StageContext, StageInput, StageKind, Work};
use crate::files::write_atomically;
use crate::nn::Compute;
use crate::progress::{Heard, Progress};
use crate::store::{read_record, write_record};
use serde_json::Value;
use std::cell::RefCell;
use std::io::Write;
use std::path::Path;

/// Writes three shards, unless it breaks off before the last one, and joins them.
struct Toy {
    breaks_off: bool,
    made: RefCell<Vec<usize>>,
}

impl Stage for &Toy {
    fn kind(&self) -> &'static StageKind {
        kind("generate")
    }

    fn version(&self) -> u32 {
        1
    }

    fn check(&self) -> Result<()> {
        Ok(())
    }

    fn config(&self) -> anyhow::Result<Value> {
        Ok(Value::Null)
    }

    fn inputs(&self) -> Vec<StageInput> {
        Vec::new()
    }

    fn work(&self) -> Work<'_> {
        Work::Sharded(*self)
    }
}

impl Sharded for Toy {
    fn plan(&self, _: &Compute, _: &dyn Progress) -> Result<Division> {
        Division::new(3, &serde_json::json!({}))
    }

    fn make(&self, shards: &Shards<'_>, _: &Compute) -> Result<()> {
        shards.go_about(0..3, &|_| 1, &|_| true, &mut |idx| {
            if idx == 2 && self.breaks_off {
                return Err(Failure::fault(anyhow::anyhow!("disk full")));
            }
            self.made.borrow_mut().push(idx);
            Ok((write_atomically::<std::io::Error>(&shards.file(idx), |file| write!(file, "{idx}"))?, ()))
        })
    }

    fn finish(&self, shards: &mut Gathering<'_>, context: &StageContext<'_>) -> Result<Value> {
        (0..3).try_for_each(|idx| shards.look_up::<()>(idx).map(drop))?;
        shards.check_whole()?;
        let all: String = (0..3).map(|idx| fs_err::read_to_string(shards.file(idx)).unwrap()).collect();
        write_atomically::<std::io::Error>(&context.root.join("samples"), |file| file.write_all(all.as_bytes()))?;
        Ok(Value::Null)
    }
}

/// Runs the toy alone. Returns the shards that it made, its outcome and the warnings.
fn run_alone(root: &Path, breaks_off: bool) -> (Vec<usize>, Result<()>, String) {
    let (toy, heard) = (Toy { breaks_off, made: RefCell::default() }, Heard::default());
    let folder = RunFolder::open(root, &KINDS).unwrap();
    let planned = plan(root, &KINDS, vec![Box::new(&toy)], &[]).unwrap();
    let outcome = run_stages(&folder, None, (ComputeChoice::default(), Makers::Alone), planned, &heard).map(drop);
    let warnings = heard.take().join("\n");
    (toy.made.take(), outcome, warnings)
}

#[test]
fn a_process_alone_goes_on_with_its_shards_and_says_when_it_cannot() {
    for is_other_program in [false, true] {
        let root = tempfile::tempdir().unwrap();
        let (made, outcome, _) = run_alone(root.path(), true);
        assert!(made == [0, 1] && outcome.unwrap_err().error.to_string().contains("failed"));
        let [begun] = &ShardFolder::all(root.path(), kind("generate")).unwrap()[..] else { panic!("one plan") };
        assert!(!begun.is_shared() && begun.tried().unwrap().len() == 1);
        if is_other_program {
            let about = begun.dir().join("parts.json");
            let mut other: serde_json::Map<String, Value> = read_record(&about).unwrap().unwrap();
            other.remove("checksum");
            other.insert("program".to_owned(), "other".into());
            write_record(&about, &other).unwrap();
        }
        let (made, outcome, warnings) = run_alone(root.path(), false);
        outcome.unwrap();
        assert_eq!(made, if is_other_program { vec![0, 1, 2] } else { vec![2] });
        let says = warnings.contains("made again: program: the plan's is other, ");
        assert_eq!(says, is_other_program, "{warnings}");
        assert_eq!(fs_err::read_to_string(root.path().join("samples")).unwrap(), "012");
        assert!(!root.path().join("generate.parts").exists(), "what is finished is removed");
    }
}

#[test]
fn a_plan_to_do_the_stage_again_outlives_runs_that_do_not_ask_for_it() {
    let root = tempfile::tempdir().unwrap();
    run_alone(root.path(), false).1.unwrap();
    assert!(run_alone(root.path(), false).0.is_empty(), "it is done");
    let toy = Toy { breaks_off: false, made: RefCell::default() };
    {
        let folder = RunFolder::open(root.path(), &KINDS).unwrap();
        let planned = plan(root.path(), &KINDS, vec![Box::new(&toy)], &[kind("generate")]).unwrap();
        super::plan(folder.root(), &planned[0], ComputeChoice::default(), &Heard::default()).unwrap();
    }
    let (made, outcome, _) = run_alone(root.path(), false);
    outcome.unwrap();
    assert_eq!(made, [0, 1, 2]);
    assert!(run_alone(root.path(), false).0.is_empty(), "and done again");
}
