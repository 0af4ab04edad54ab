//! What does a stage read: which contents are they, are they whole, and does nobody write over them?

use super::failure::{Blame, Failure, Result};
use super::fingerprint::{PathFingerprint, fingerprint_to, fingerprint_value};
use super::kind::StageInput;
use super::planned::PlannedStage;
use super::record::{InputRecord, StageRecord};
use super::stage::Stage;
use crate::cloud::Recordings;
use crate::files::check_overlap;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// The inputs of a stage, by name. If recordings were removed, their record from an earlier run replaces them, and the
/// second value is the failure to find them.
pub(super) fn identify_inputs(
    root: &Path,
    planned: &[PlannedStage<'_>],
    stage: &dyn Stage,
    earlier: Option<&StageRecord>,
) -> Result<(BTreeMap<String, InputRecord>, Option<Failure>)> {
    let (mut inputs, mut missing) = (BTreeMap::new(), None);
    for input in stage.inputs() {
        let record = match identify(root, planned, &input, earlier) {
            Ok(record) => record,
            // Results stay valid when their recordings are removed.
            Err(failure) if failure.blame != Blame::Input => return Err(failure),
            Err(failure) => match earlier.and_then(|earlier| missing_input(earlier, &input)) {
                Some(record) => {
                    missing.get_or_insert(failure);
                    record
                }
                None => return Err(failure),
            },
        };
        inputs.insert(input.name, record);
    }
    Ok((inputs, missing))
}

/// An input from outside that this record has but that no longer exists.
fn missing_input(earlier: &StageRecord, input: &StageInput) -> Option<InputRecord> {
    let record = earlier.inputs.get(&input.name)?;
    let is_same = matches!(record, InputRecord::Path { path, .. } if *path == input.path);
    (input.producer.is_none() && is_same && !input.path.exists()).then(|| record.clone())
}

/// The record that `stage` would have if it ran alone in the folder `root`.
pub(super) fn expected(root: &Path, stage: &dyn Stage) -> Result<StageRecord> {
    let inputs = stage.inputs().into_iter().map(|input| Ok((input.name.clone(), identify(root, &[], &input, None)?)));
    expected_on(stage, inputs.collect::<Result<_>>()?)
}

/// The record of a stage about to run on `inputs`.
pub(super) fn expected_on(stage: &dyn Stage, inputs: BTreeMap<String, InputRecord>) -> Result<StageRecord> {
    let config = stage.config()?;
    let identities: BTreeMap<&str, &str> =
        inputs.iter().map(|(name, input)| (name.as_str(), input.identity())).collect();
    let kind = stage.kind();
    let fingerprint = fingerprint_value(&(kind.name, stage.version(), &config, identities))?;
    let settings = fingerprint_value(&(stage.version(), without_places(&config, kind.places)))?;
    Ok(StageRecord {
        stage: kind.name.to_owned(),
        version: stage.version(),
        config,
        inputs,
        fingerprint,
        settings,
        outputs: BTreeMap::new(),
        files: BTreeSet::new(),
        summary: Value::Null,
        times: BTreeMap::new(),
    })
}

/// A section without the keys `places`, where `list.key` is a key in every item of a list.
fn without_places(config: &Value, places: &[&str]) -> Value {
    let mut config = config.clone();
    for place in places {
        let (list, key) = place.split_once('.').unwrap_or(("", place));
        let items = match list {
            "" => std::slice::from_mut(&mut config),
            list => config.get_mut(list).and_then(Value::as_array_mut).map_or(&mut [][..], Vec::as_mut_slice),
        };
        items.iter_mut().filter_map(Value::as_object_mut).for_each(|item| drop(item.remove(key)));
    }
    config
}

/// The identity of a stage's input: a fingerprint of the stage that makes it, or of its content.
///
/// `earlier` is the record of the stage's last run, which knows the former content of the same files.
fn identify(
    root: &Path,
    planned: &[PlannedStage<'_>],
    input: &StageInput,
    earlier: Option<&StageRecord>,
) -> Result<InputRecord> {
    if let Some(producer) = input.producer {
        let folder = input.path.parent().unwrap_or(Path::new("."));
        let here = planned.iter().find(|other| other.stage.kind() == producer && folder == root);
        let made = match here {
            Some(here) => Some((here.expected.fingerprint.clone(), here.content())),
            None => StageRecord::done(folder, producer)?.map(|done| (done.fingerprint.clone(), done.content())),
        };
        if let Some((fingerprint, content)) = made {
            return Ok(InputRecord::Stage { producer: producer.name.to_owned(), fingerprint, content });
        }
    }
    let known = earlier.and_then(|earlier| earlier.known_content(&input.name, &input.path));
    let content = fingerprint_input(&input.path, known).map_err(|failure| {
        let failure = failure.context(format!("failed to read the input {}", input.name));
        match input.producer {
            Some(producer) => failure
                .with_hint(format!("`djinn {}` writes it; see --help for how to use another path", producer.command)),
            None => failure.with_hint(
                "relative paths are relative to the pipeline file, those of the command line to the current directory",
            ),
        }
    })?;
    Ok(InputRecord::Path { path: input.path.clone(), content })
}

/// The fingerprint of an input from outside. Objects that have not changed since `known` are not downloaded.
fn fingerprint_input(path: &Path, known: Option<&PathFingerprint>) -> Result<PathFingerprint> {
    let Some(recordings) = Recordings::at(path)? else {
        return fingerprint_to(path, None, known).map_err(Failure::input);
    };
    let tag = Some(recordings.tag());
    if let Some(known) = known.filter(|known| known.times == tag) {
        return Ok(known.clone());
    }
    let content = fingerprint_to(&recordings.on_disk()?, None, None).map_err(Failure::input)?;
    Ok(PathFingerprint { times: tag, ..content })
}

/// Rejects damaged results of earlier stages, and of files beside them, such as summaries. Shards have a checksum each,
/// which is compared when they are read.
pub(super) fn check_inputs(stage: &dyn Stage) -> Result<()> {
    for input in stage.inputs() {
        let Some(producer) = input.producer.filter(|producer| !producer.is_checked_by_readers) else {
            continue;
        };
        let folder = input.path.parent().unwrap_or(Path::new("."));
        let Some(record) = StageRecord::done(folder, producer)? else { continue };
        let own = input.path.file_name().unwrap_or_default().to_string_lossy();
        let is_read = |name: &&String| **name == own || folder.join(name).is_file();
        for name in record.outputs.keys().filter(is_read) {
            if record.is_whole(folder, name)? {
                continue;
            }
            let path = folder.join(name);
            let message = format!("{}: it is not what stage {producer} wrote there", path.display());
            return Err(Failure::fault(anyhow::anyhow!(message)).with_hint(format!(
                "the file was changed or the disk is failing; restore it from a copy, or rebuild it with --redo \
                 {producer}"
            )));
        }
    }
    Ok(())
}

/// Rejects stages that would write over an input of one of them: an output that is an input, lies inside one, or
/// contains one.
pub(super) fn check_overlaps(root: &Path, stages: &[Box<dyn Stage + '_>]) -> Result<()> {
    for writer in stages {
        for reader in stages {
            // Outputs of a stage exist to be read by later ones.
            let inputs = reader.inputs().into_iter().filter(|input| input.producer != Some(writer.kind()));
            for input in inputs {
                for name in writer.outputs() {
                    check_overlap(&root.join(name), [(input.name.as_str(), input.path.as_path())]).map_err(
                        |error| {
                            let failure = Failure::from(error).context(format!("stage {} cannot run", writer.kind()));
                            match writer.kind().trains {
                                true => failure.with_hint(
                                    "to continue from a model in this folder, copy it elsewhere and pass the copy",
                                ),
                                false => failure.with_hint("use separate folders for recordings and results"),
                            }
                        },
                    )?;
                }
            }
        }
    }
    Ok(())
}
