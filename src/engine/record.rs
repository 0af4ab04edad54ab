//! The record of a stage, by which the next run decides whether to redo it.
//!
//! `<stage>.done.json` is written after the outputs are whole; [`work_folder`](super::work_folder) keeps a record of a
//! stage at work, too. Both hold what the fingerprint was made from, so that a later run can tell what changed. The
//! former lists every file that the stage wrote: these, and no others, may be removed when it is redone.

use super::failure::{Failure, Result};
use super::fingerprint::{PathFingerprint, fingerprint_to, fingerprint_value};
use super::kind::StageKind;
use crate::files::{path_as_text, stays_below};
use crate::store::{Error, read_record, write_record};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// The basis of a stage's run and, once it is done, its results.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StageRecord {
    /// Name of the kind of stage.
    pub stage: String,
    /// The version of its code.
    pub version: u32,
    /// Its section.
    pub config: Value,
    /// Its inputs, by name.
    pub inputs: BTreeMap<String, InputRecord>,
    /// Hash of all of the above.
    pub fingerprint: String,
    /// Hash of the version, and of the section without paths of inputs, which count by their content.
    pub settings: String,
    /// Its outputs, by name within the output folder; empty until it is done.
    pub outputs: BTreeMap<String, PathFingerprint>,
    /// Every file that it wrote, relative to the output folder and sorted; empty until it is done.
    pub files: BTreeSet<PathBuf>,
    /// Its summary; null until it is done.
    pub summary: Value,
    /// By output, a hash of the times at which its large files, which are whole, were written. Two runs of one pipeline
    /// write the same bytes at different times, so `timings.json` keeps this.
    #[serde(skip)]
    pub(super) times: BTreeMap<String, String>,
}

/// An input of a stage.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum InputRecord {
    /// The outputs of another stage, with that stage's fingerprint.
    Stage {
        /// Name of the kind of stage that made it.
        producer: String,
        /// Its fingerprint.
        fingerprint: String,
        /// Hash of its outputs; `None` while unknown. Not a part of the fingerprint: a changed program may write other
        /// bytes from the same settings.
        #[serde(skip_serializing_if = "Option::is_none")]
        content: Option<String>,
    },
    /// A file or folder from outside.
    Path {
        /// Its path, as given.
        #[serde(serialize_with = "path_as_text")]
        path: PathBuf,
        /// Its content.
        content: PathFingerprint,
    },
}

impl InputRecord {
    /// The hash that distinguishes the contents; a path alone does not.
    pub(super) fn identity(&self) -> &str {
        match self {
            Self::Stage { fingerprint, .. } => fingerprint,
            Self::Path { content, .. } => content.identity(),
        }
    }

    /// Whether both have the same content, as far as both know it.
    fn agrees_with(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Path { content, .. }, Self::Path { content: other, .. }) => content.agrees_with(other),
            (own, other) => own.identity() == other.identity(),
        }
    }
}

impl StageRecord {
    /// Whether `earlier` records the same work: the same version, settings and contents, wherever the files were.
    /// Contents are compared as far as both know them.
    pub(super) fn is_same_work(&self, earlier: &Self) -> bool {
        let agree = |(name, input): (&String, &InputRecord)| {
            earlier.inputs.get(name).is_some_and(|then| input.agrees_with(then))
        };
        self.settings == earlier.settings && self.inputs.len() == earlier.inputs.len() && self.inputs.iter().all(agree)
    }

    /// The known content of an input, if its path was the same.
    pub(super) fn known_content(&self, name: &str, path: &Path) -> Option<&PathFingerprint> {
        match self.inputs.get(name)? {
            InputRecord::Path { path: then, content } if then == path => Some(content),
            _ => None,
        }
    }

    /// Hash of its outputs; `None` until it is done.
    pub(super) fn content(&self) -> Option<String> {
        let identities: BTreeMap<&str, &str> =
            self.outputs.iter().map(|(name, written)| (name.as_str(), written.identity())).collect();
        (!identities.is_empty()).then(|| fingerprint_value(&identities).ok()).flatten()
    }

    /// A stage that `earlier` read, if it has since written other bytes, as far as both are known.
    pub(super) fn rewritten_since(&self, earlier: &Self) -> Option<&str> {
        self.inputs.iter().find_map(|(name, input)| match (input, earlier.inputs.get(name)?) {
            (
                InputRecord::Stage { producer, content: Some(now), .. },
                InputRecord::Stage { content: Some(then), .. },
            ) => (now != then).then_some(producer.as_str()),
            _ => None,
        })
    }

    /// Fills in the contents written by the stages in `done` that were unknown when this record was made.
    pub(super) fn learn_contents(&mut self, done: &[Self]) {
        for input in self.inputs.values_mut() {
            if let InputRecord::Stage { producer, content: content @ None, .. } = input {
                *content = done.iter().find(|record| record.stage == *producer).and_then(Self::content);
            }
        }
    }

    /// This record of a finished stage, with the present places of its inputs and what is known of them. The contents
    /// of earlier stages stay as they were when it read them.
    pub(super) fn with_inputs_of(mut self, root: &Path, stage: &StageKind, expected: &Self) -> Result<Self> {
        let mut inputs = expected.inputs.clone();
        for (name, input) in &mut inputs {
            if let (InputRecord::Stage { content, .. }, Some(InputRecord::Stage { content: then @ Some(_), .. })) =
                (input, self.inputs.get(name))
            {
                content.clone_from(then);
            }
        }
        if self.inputs != inputs {
            self.inputs = inputs;
            write_record(&done_path(root, stage), &self)?;
        }
        Ok(self)
    }

    /// The record of the finished stage in `root`, if there is one.
    pub fn done(root: &Path, stage: &StageKind) -> Result<Option<Self>> {
        Self::read(&done_path(root, stage), stage).map_err(|error| {
            Failure::unreadable(error, || {
                let outputs = stage.outputs.join(", ");
                format!("restore it from a copy, or move it away together with {outputs}: then {stage} runs again")
            })
        })
    }

    /// The record of the stage at `path`, if there is one.
    ///
    /// # Errors
    /// When it is damaged, or names something that the stage does not write; errors of the file system.
    pub(super) fn read(path: &Path, stage: &StageKind) -> Result<Option<Self>, Error> {
        let record: Option<Self> = read_record(path)?;
        match record.as_ref().and_then(|record| record.impossible(stage)) {
            Some(detail) => Err(Error::Record { path: path.to_owned(), detail }),
            None => Ok(record),
        }
    }

    /// The part of the record that the stage cannot have written: everything it names is replaced and removed.
    fn impossible(&self, stage: &StageKind) -> Option<String> {
        let known = stage.outputs;
        let is_output = |name: &str| known.contains(&name);
        let is_file = |file: &Path| {
            let output = file.iter().next().and_then(|part| part.to_str());
            file.to_str().is_some_and(stays_below) && output.is_some_and(is_output)
        };
        let is_hash = self.fingerprint.len() == 32 && self.fingerprint.bytes().all(|byte| byte.is_ascii_hexdigit());
        if self.stage != stage.name {
            return Some(format!("it is of stage {}", self.stage));
        }
        if !is_hash {
            return Some(format!("{:?} is no fingerprint", self.fingerprint));
        }
        let output = self.outputs.keys().find(|name| !is_output(name)).map(PathBuf::from);
        let file = || self.files.iter().find(|file| !is_file(file)).cloned();
        output.or_else(file).map(|name| format!("{name:?} is nothing that stage {stage} writes"))
    }

    /// The record of the stage once its outputs are whole in the folder `dir`; `written` are its own files there.
    pub(super) fn finished(
        mut self,
        dir: &Path,
        outputs: &[&str],
        written: &BTreeSet<PathBuf>,
        summary: Value,
    ) -> Result<Self> {
        let files = written.iter().filter(|file| outputs.iter().any(|name| file.starts_with(name)));
        self.files = files.cloned().collect();
        for name in outputs {
            let mut written = fingerprint_to(&dir.join(name), Some(&self.files_below(name).collect::<Vec<_>>()), None)?;
            self.times.extend(written.times.take().map(|times| ((*name).to_owned(), times)));
            self.outputs.insert((*name).to_owned(), written);
        }
        self.summary = summary;
        Ok(self)
    }

    /// By output, a hash of the times at which its large files were written, if all outputs are as the stage wrote
    /// them; otherwise, as the inner error, the first output that is not. Foreign files beside them do not count.
    /// Outputs that were `seen` whole are not read again while sizes and times of their files stay.
    pub(super) fn whole_since(
        &self,
        root: &Path,
        seen: &BTreeMap<String, String>,
    ) -> Result<Result<BTreeMap<String, String>, &str>> {
        let mut times = BTreeMap::new();
        for (name, written) in &self.outputs {
            let known = PathFingerprint { times: seen.get(name).cloned(), ..written.clone() };
            let found = self.found(root, name, Some(&known))?;
            let Some(found) = found.filter(|found| found.agrees_with(written)) else { return Ok(Err(name)) };
            times.extend(found.times.map(|times| (name.clone(), times)));
        }
        Ok(Ok(times))
    }

    /// The record with outputs that were seen whole when their large files had these times.
    pub(super) fn seen(self, times: BTreeMap<String, String>) -> Self {
        Self { times, ..self }
    }

    /// Whether the output with this name is as it was written, to its last byte. True for names that are not outputs of
    /// the stage.
    pub(super) fn is_whole(&self, root: &Path, name: &str) -> Result<bool> {
        let Some(written) = self.outputs.get(name) else { return Ok(true) };
        Ok(self.found(root, name, None)?.is_some_and(|now| now.agrees_with(written)))
    }

    /// The files of an output, relative to it.
    pub(super) fn files_below(&self, name: &str) -> impl Iterator<Item = PathBuf> {
        self.files.iter().filter_map(move |file| file.strip_prefix(name).ok().map(Path::to_owned))
    }

    /// The present content of the files of an output; `None` if it does not exist, or is neither file nor folder. An
    /// output that cannot be read now may well be whole.
    fn found(&self, root: &Path, name: &str, known: Option<&PathFingerprint>) -> Result<Option<PathFingerprint>> {
        let path = root.join(name);
        if !path.is_file() && !path.is_dir() {
            return Ok(None);
        }
        Ok(Some(fingerprint_to(&path, Some(&self.files_below(name).collect::<Vec<_>>()), known)?))
    }

    /// Whether a setting of the stage's own section differs from `earlier`. Values that come from presets are not the
    /// user's doing.
    pub(super) fn section_differs(&self, earlier: &Self) -> bool {
        let own = |record: &Self| {
            let mut config = record.config.clone();
            // Neither are settings of all stages.
            for key in ["resolved", "precision"] {
                config.as_object_mut().map(|section| section.remove(key));
            }
            config
        };
        own(self) != own(earlier)
    }

    /// Enough of the fingerprint to distinguish the runs of a stage.
    pub(super) fn short_fingerprint(&self) -> &str {
        self.fingerprint.get(..8).unwrap_or(&self.fingerprint)
    }

    /// The differences from `earlier`, in a few words: versions, keys of the section, inputs.
    pub fn changes_since(&self, stage: &StageKind, earlier: &Self) -> String {
        let mut changes = Vec::new();
        if self.version != earlier.version {
            changes.push(format!("stage version {} -> {}", earlier.version, self.version));
        }
        changed_keys(stage.section, &earlier.config, &self.config, &mut changes);
        let names: std::collections::BTreeSet<&String> = self.inputs.keys().chain(earlier.inputs.keys()).collect();
        for name in names {
            let (now, then) = (self.inputs.get(name), earlier.inputs.get(name));
            if !now.zip(then).is_some_and(|(now, then)| now.agrees_with(then)) {
                changes.push(format!("input {name}"));
            }
        }
        let n_more = changes.len().saturating_sub(3);
        changes.truncate(3);
        let more = if n_more > 0 { format!(" and {n_more} more") } else { String::new() };
        format!("changed: {}{more}", changes.join(", "))
    }
}

/// The path of the record of a finished stage.
pub fn done_path(root: &Path, stage: &StageKind) -> PathBuf {
    root.join(format!("{stage}.done.json"))
}

fn changed_keys(path: &str, earlier: &Value, now: &Value, changes: &mut Vec<String>) {
    match (earlier, now) {
        (Value::Object(earlier), Value::Object(now)) => {
            let keys: std::collections::BTreeSet<&String> = earlier.keys().chain(now.keys()).collect();
            for key in keys {
                let value = |object: &serde_json::Map<String, Value>| object.get(key).cloned().unwrap_or(Value::Null);
                changed_keys(&format!("{path}.{key}"), &value(earlier), &value(now), changes);
            }
        }
        (earlier, now) if earlier == now => {}
        (earlier, now) if earlier.to_string().len() + now.to_string().len() < 40 => {
            changes.push(format!("{path} {earlier} -> {now}"));
        }
        _ => changes.push(path.to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    /// A record with these parts, and otherwise empty.
    fn read(parts: &Value) -> StageRecord {
        let mut record = json!({ "stage": "", "version": 1, "config": null, "inputs": {}, "fingerprint": "",
            "settings": "", "outputs": {}, "files": [], "summary": null });
        record.as_object_mut().unwrap().extend(parts.as_object().unwrap().clone());
        serde_json::from_value(record).unwrap()
    }

    #[test]
    fn whichever_input_was_written_anew_is_named() {
        let input = |producer: &str, content: &str| {
            let stage = json!({ "producer": producer, "fingerprint": "", "content": content });
            json!({ "stage": stage })
        };
        let record = |scenes: &str, events: &str| {
            read(&json!({ "inputs": { "events": input("mine", events), "scenes": input("ingest", scenes) } }))
        };
        let earlier = record("1", "2");
        assert_eq!(record("1", "2").rewritten_since(&earlier), None);
        assert_eq!(record("3", "2").rewritten_since(&earlier), Some("ingest"));
        assert_eq!(record("1", "3").rewritten_since(&earlier), Some("mine"));
    }

    #[test]
    fn what_is_known_of_an_input_is_of_its_path_alone() {
        let content = json!({ "n_bytes": 1, "n_files": 1, "hash": "a" });
        let record = read(&json!({ "inputs": { "recording": { "path": { "path": "here", "content": content } } } }));
        let is_known = |path: &str| record.known_content("recording", Path::new(path)).is_some();
        assert!(is_known("here") && !is_known("there"));
    }

    #[test]
    fn three_changes_are_named_and_the_others_counted() {
        let record = |n: u8| read(&json!({ "config": { "a": n, "b": n, "c": n, "d": n, "e": n } }));
        let said = record(2).changes_since(crate::engine::testing::kind("mine"), &record(1));
        assert_eq!(said, "changed: mine.a 1 -> 2, mine.b 1 -> 2, mine.c 1 -> 2 and 2 more");
    }

    #[test]
    fn presets_and_the_precision_of_the_run_are_not_of_the_section() {
        let record = |config: Value| read(&json!({ "config": config }));
        let earlier = record(json!({ "steps": 10, "precision": "f32", "resolved": { "width": 8 } }));
        let same = record(json!({ "steps": 10, "precision": "bf16", "resolved": { "width": 16 } }));
        assert!(!same.section_differs(&earlier) && record(json!({ "steps": 11 })).section_differs(&earlier));
    }
}
