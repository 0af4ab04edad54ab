//! Makes a bucket equal to the view, so that it is whole for every reader even if the process is killed.
//!
//! [`View::push`] compares the files with the objects that they showed. Objects that others have written meanwhile are
//! not replaced: the bucket is listed again first, and the push is refused if an object that it would write or remove
//! is not the one that was shown. (Between that listing and the write, others could still write; stores have no locks.)
//! Then, with a [`Journal`] around it:
//!
//! 1. manifests that will change are removed, so that no reader takes a folder for whole;
//! 2. lists of our files are written, then everything else, and manifests after that;
//! 3. the journal is replaced by one that holds the new records of finished stages, and what describes the run: this is
//!    the moment at which the new state begins to count; then these files are written, too;
//! 4. objects that are not among the files any more are removed.
//!
//! A stage at work pushes its commits now and then ([`View::push_work`]), without a journal: in the order of its
//! commits, so that another machine can resume from there.

use super::ObjectUrl;
use super::bucket::Object;
use super::cache::{Content, content_of};
use super::error::{Error, Result};
use super::journal::{JOURNAL, Journal, is_unfinished_work};
use super::side_by_side::side_by_side;
use super::view::{Stamp, State, View, is_list, is_ours_alone, stamp};
use crate::files::{LIST_FILE, files_below};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// A stage at work pushes no more often than this.
const WORK_WAITS: Duration = Duration::from_secs(30);

impl View {
    /// Makes the bucket equal to the view.
    ///
    /// # Errors
    /// [`Error::Changed`]; errors of the store and the file system.
    pub(super) fn push(&self, state: &mut State) -> Result<()> {
        let files = self.files()?;
        let changed: Vec<String> = files
            .iter()
            .filter(|(name, stamp)| state.same.get(*name) != Some(*stamp))
            .map(|(name, _)| name.clone())
            .collect();
        let known = state.shown.keys().chain(state.left.keys());
        let removed: BTreeSet<String> = known.filter(|name| !files.contains_key(*name)).cloned().collect();
        if changed.is_empty() && removed.is_empty() && !state.has_journal {
            return Ok(());
        }
        let now = self.bucket.list("")?;
        self.check_unchanged(changed.iter().chain(&removed), &now, state)?;
        let mut journal = journal_of(&changed, &removed, state);
        let is_kept =
            changed.iter().chain(&journal.removes).any(|name| !is_unfinished_work(name) && Turn::of(name) != Turn::Run);
        if is_kept {
            journal.keep(&self.bucket)?;
            state.has_journal = true;
        }
        for name in changed.iter().filter(|name| is_manifest(name)) {
            if state.shown.remove(name).is_some() {
                self.bucket.remove(name)?;
            }
        }
        let (records, outputs): (Vec<String>, Vec<String>) =
            changed.into_iter().partition(|name| Turn::of(name).is_last());
        self.write_in_order(outputs, &files, state)?;
        if is_kept {
            journal.records = Some(self.texts(&records)?);
            journal.keep(&self.bucket)?;
        }
        self.write_in_order(records, &files, state)?;
        self.remove_in_order(&removed, state)?;
        if std::mem::take(&mut state.has_journal) { self.bucket.remove(JOURNAL) } else { Ok(()) }
    }

    /// Pushes the commits of a stage at work, if it is time; `name` is its newest file.
    ///
    /// # Errors
    /// See [`View::push`].
    pub(super) fn push_work(&self, name: &str, state: &mut State) -> Result<()> {
        state.waiting.retain(|waiting| waiting != name);
        state.waiting.push(name.to_owned());
        let began = state.pushed.get_or_insert_with(std::time::Instant::now);
        if began.elapsed() < WORK_WAITS {
            return Ok(());
        }
        let Some((folder, _)) = name.split_once('/') else { return Ok(()) };
        let is_there = |name: &String| self.root.join(name).is_file();
        let list = format!("{folder}/{LIST_FILE}");
        let waiting = std::mem::take(&mut state.waiting);
        let names: Vec<String> = std::iter::once(list).chain(waiting).filter(is_there).collect();
        let now = self.bucket.list(folder)?;
        let now: Vec<Object> =
            now.into_iter().map(|object| Object { name: format!("{folder}/{}", object.name), ..object }).collect();
        self.check_unchanged(names.iter(), &now, state)?;
        names.iter().try_for_each(|name| self.push_file(name, state))?;
        state.pushed = Some(std::time::Instant::now());
        Ok(())
    }

    /// The files of the view, by name.
    fn files(&self) -> Result<BTreeMap<String, Stamp>> {
        let names = files_below(&self.root)?.into_iter().map(|name| name.to_string_lossy().into_owned());
        names
            .filter(|name| !is_ours_alone(name))
            .map(|name| Ok((name.clone(), stamp(&self.root.join(&name))?)))
            .collect()
    }

    /// The content of files that are texts: all that djinn writes in these places are.
    fn texts(&self, names: &[String]) -> Result<BTreeMap<String, String>> {
        let read = |name: &String| -> Result<Option<(String, String)>> {
            let bytes = fs_err::read(self.root.join(name))?;
            Ok(String::from_utf8(bytes).ok().map(|text| (name.clone(), text)))
        };
        names.iter().filter_map(|name| read(name).transpose()).collect()
    }

    /// Refuses to touch objects that have changed since they were seen.
    fn check_unchanged<'a>(
        &self,
        names: impl Iterator<Item = &'a String>,
        now: &[Object],
        state: &State,
    ) -> Result<()> {
        let now: BTreeMap<&str, &Object> = now.iter().map(|object| (object.name.as_str(), object)).collect();
        for name in names {
            let Some(object) = now.get(name.as_str()) else { continue };
            let is_seen = state.shown.get(name).is_some_and(|shown| shown.etag == object.etag)
                || state.left.get(name) == Some(&object.etag);
            if !is_seen {
                return Err(Error::Changed { url: ObjectUrl::clone(&self.bucket.url().join(name)) });
            }
        }
        Ok(())
    }

    /// Writes the changed files; see the module.
    fn write_in_order(&self, changed: Vec<String>, files: &BTreeMap<String, Stamp>, state: &mut State) -> Result<()> {
        let mut by_turn: BTreeMap<Turn, Vec<String>> = BTreeMap::new();
        changed.into_iter().for_each(|name| by_turn.entry(Turn::of(&name)).or_default().push(name));
        for (turn, mut names) in by_turn {
            // By time: a file was written after those on which it depends. Among files of one moment, records come
            // last, and the one that announces a plan.
            let moment = |name: &String| files.get(name).map(|(_, modified)| *modified);
            names.sort_by_key(|name| (moment(name), name.ends_with(".json"), name.ends_with("/parts.json")));
            let in_turn: Vec<&[String]> = match turn {
                Turn::Lists | Turn::Outputs | Turn::Manifests => vec![&names],
                Turn::Work | Turn::Records | Turn::Run => names.chunks(1).collect(),
            };
            for names in in_turn {
                let pushed = side_by_side(names, &|name| self.bucket.upload(name, &self.root.join(name)))?;
                for object in pushed {
                    self.note_pushed(object, files, state)?;
                }
            }
        }
        Ok(())
    }

    fn note_pushed(&self, object: Object, files: &BTreeMap<String, Stamp>, state: &mut State) -> Result<()> {
        let name = object.name.clone();
        if !is_unfinished_work(&name) && content_of(&name) == Content::Shared {
            self.cache.keep(&self.bucket, &object, &self.root.join(&name))?;
        }
        state.same.extend(files.get(&name).map(|stamp| (name.clone(), *stamp)));
        state.left.remove(&name);
        state.shown.insert(name, object);
        Ok(())
    }

    /// Removes deleted objects, first those that others read before anything else.
    fn remove_in_order(&self, removed: &BTreeSet<String>, state: &mut State) -> Result<()> {
        let (first, rest): (Vec<&String>, Vec<&String>) = removed.iter().partition(|name| name.ends_with(".json"));
        for names in [first, rest] {
            side_by_side(&names, &|name| self.bucket.remove(name))?;
        }
        for name in removed {
            state.shown.remove(name);
            state.same.remove(name);
            state.left.remove(name);
        }
        Ok(())
    }
}

/// When a file is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Turn {
    Lists,
    Outputs,
    Work,
    Manifests,
    Records,
    Run,
}

impl Turn {
    /// Whether such files record what was done.
    fn is_last(self) -> bool {
        self >= Self::Records
    }

    fn of(name: &str) -> Self {
        match name {
            _ if is_list(name) => Self::Lists,
            _ if is_unfinished_work(name) => Self::Work,
            _ if is_manifest(name) => Self::Manifests,
            _ if name.contains('/') => Self::Outputs,
            _ if name.ends_with(".done.json") => Self::Records,
            "run.json" | "config.toml" | "timings.json" | "log.txt" => Self::Run,
            _ => Self::Outputs,
        }
    }
}

/// Whether a file declares its folder whole.
fn is_manifest(name: &str) -> bool {
    !is_unfinished_work(name) && name.ends_with("/manifest.json")
}

/// The journal of a push.
fn journal_of(changed: &[String], removed: &BTreeSet<String>, state: &State) -> Journal {
    let is_output = |name: &&String| !is_unfinished_work(name) && !Turn::of(name).is_last();
    let then = |name: &String| state.shown.get(name).map(|object| object.etag.clone());
    let mut writes: BTreeMap<String, Option<String>> =
        changed.iter().filter(is_output).map(|name| (name.clone(), then(name))).collect();
    // Objects that an earlier push left are of no worth, until they are removed.
    writes.extend(state.left.keys().map(|name| (name.clone(), None)));
    Journal { writes, removes: removed.clone(), records: None }
}
