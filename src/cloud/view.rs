//! A folder of objects, shown on disk while a command works: what is downloaded, and when do others see changes?
//!
//! Each process has a view of its own, which begins as the folder is in the bucket and is removed when the process
//! ends. So a view is never stale, and work that a killed process did not push is done again. [`Access`](super::Access)
//! tells which objects a command needs, and which part of its work is pushed at once.

use super::Access;
use super::bucket::{Bucket, Object};
use super::cache::{Cache, Content, content_of};
use super::error::Result;
use super::journal::{JOURNAL, Journal, is_part, is_unfinished_work, is_work};
use super::side_by_side::side_by_side;
use crate::files::{self, LIST_FILE, LOCK_FILE, Lock, files_below, is_partial_of, remove_listed, unique_partial};
use fs_err as fs;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant, SystemTime};

/// The shortest time between two looks at the work of other workers.
const LEAST_WAIT: Duration = Duration::from_secs(1);
/// At most one part in this many of the time goes into looking.
const LOOKS_COST: u32 = 10;

/// A process has locked its view by then.
const BEGINS: Duration = Duration::from_secs(60);

/// See the module.
#[derive(Debug)]
pub(super) struct View {
    pub(super) bucket: Bucket,
    pub(super) cache: Cache,
    /// The folder on disk.
    pub(super) root: PathBuf,
    pub(super) access: Access,
    pub(super) state: Mutex<State>,
    /// The folder around `root`, and its lock.
    home: PathBuf,
    _lock: Lock,
}

/// The known state of the bucket.
#[derive(Debug, Default)]
pub(super) struct State {
    /// The objects that are shown, as they were then.
    pub(super) shown: BTreeMap<String, Object>,
    /// The files that are as in the bucket, by name.
    pub(super) same: BTreeMap<String, Stamp>,
    /// Objects that are there and not shown, because the command does not need them: their lengths.
    elsewhere: BTreeMap<String, u64>,
    /// Objects that an interrupted push left, and their tags.
    pub(super) left: BTreeMap<String, String>,
    /// Whether its journal is there.
    pub(super) has_journal: bool,
    /// Files of unfinished work that are not pushed yet, in the order in which they were written.
    pub(super) waiting: Vec<String>,
    /// When unfinished work was last pushed.
    pub(super) pushed: Option<Instant>,
    /// Whether the store failed, so that further requests would fail, too.
    pub(super) is_broken: bool,
    /// The time and duration of the last look at others' work.
    looked: Option<(Instant, Duration)>,
}

/// Length and time of a file: while they stay, it is unchanged.
pub(super) type Stamp = (u64, SystemTime);

impl View {
    /// Shows the folder, or for readers the object, at the URL of `bucket`.
    pub(super) fn open(bucket: Bucket, cache: Cache, access: Access) -> Result<Self> {
        let (home, lock) = new_home(&cache)?;
        let url = bucket.url();
        let name = url.key.rsplit('/').next().filter(|name| !name.is_empty()).unwrap_or(&url.bucket);
        let root = home.join(name);
        let view = Self { bucket, cache, root, access, state: Mutex::default(), home, _lock: lock };
        let objects = view.bucket.list("")?;
        let file = if objects.is_empty() && access == Access::Read { view.bucket.itself()? } else { None };
        match file {
            Some(file) => drop(view.cache.bring(&view.bucket, &file, &view.root, Content::Own)?),
            None => {
                fs::create_dir(&view.root)?;
                view.pull(objects)?;
            }
        }
        Ok(view)
    }

    /// Shows the objects.
    fn pull(&self, objects: Vec<Object>) -> Result<()> {
        let state = &mut *self.state();
        state.has_journal = objects.iter().any(|object| object.name == JOURNAL);
        let journal = if state.has_journal { Journal::of(&self.bucket)? } else { None }.unwrap_or_default();
        let mut wanted = Vec::new();
        for object in objects.into_iter().filter(|object| !is_ours_alone(&object.name)) {
            match () {
                () if !journal.counts(&object) => _ = state.left.insert(object.name, object.etag),
                () if self.access.needs(&object.name) => wanted.push(object),
                () => _ = state.elsewhere.insert(object.name, object.n_bytes),
            }
        }
        self.show(&wanted, state)?;
        // Records of outputs that are all there may not be in their own place yet.
        for (name, text) in journal.records.iter().flatten() {
            state.same.remove(name);
            // The file may be that of the cache, which stays as it is.
            remove_file(&self.root.join(name))?;
            fs::write(self.root.join(name), text)?;
        }
        Ok(())
    }

    /// Brings objects to their files.
    fn show(&self, wanted: &[Object], state: &mut State) -> Result<()> {
        let bring = |object: &Object| -> Result<(Object, Stamp)> {
            let to = self.root.join(&object.name);
            // A command that resumes unfinished work may write into its files.
            let content = if is_unfinished_work(&object.name) { Content::Own } else { content_of(&object.name) };
            let found = self.cache.bring(&self.bucket, object, &to, content)?;
            Ok((found, stamp(&to)?))
        };
        for (object, stamp) in side_by_side(wanted, &bring)? {
            state.same.insert(object.name.clone(), stamp);
            state.shown.insert(object.name.clone(), object);
        }
        Ok(())
    }

    /// Shows the work of other workers in the folder `dir` since the last look.
    fn look(&self, dir: &str, state: &mut State) -> Result<()> {
        let began = Instant::now();
        if state.looked.is_some_and(|(at, took)| at.elapsed() < LEAST_WAIT.max(took * LOOKS_COST)) {
            return Ok(());
        }
        let found: BTreeMap<String, Object> =
            self.bucket.list(dir)?.into_iter().map(|object| (format!("{dir}/{}", object.name), object)).collect();
        let gone: Vec<String> = below(&state.shown, dir).filter(|name| !found.contains_key(*name)).cloned().collect();
        for name in gone {
            state.shown.remove(&name);
            state.same.remove(&name);
            // The one that removed it has removed it from the bucket, too.
            remove_file(&self.root.join(name))?;
        }
        let mut wanted = Vec::new();
        for (name, object) in found {
            let object = Object { name, ..object };
            let is_shown = state.shown.get(&object.name).is_some_and(|shown| shown.etag == object.etag);
            match self.access.needs(&object.name) {
                true if is_shown => {}
                true => wanted.push(object),
                false => _ = state.elsewhere.insert(object.name, object.n_bytes),
            }
        }
        self.show(&wanted, state)?;
        state.looked = Some((Instant::now(), began.elapsed()));
        Ok(())
    }

    /// Pushes one file.
    pub(super) fn push_file(&self, name: &str, state: &mut State) -> Result<()> {
        let path = self.root.join(name);
        // If a file changes meanwhile, the next push sees that.
        let stamp = stamp(&path)?;
        let object = self.bucket.upload(name, &path)?;
        state.same.insert(name.to_owned(), stamp);
        state.shown.insert(name.to_owned(), object);
        Ok(())
    }

    pub(super) fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The name of the object that a file shows.
    fn name<'a>(&self, path: &'a Path) -> Option<std::borrow::Cow<'a, str>> {
        Some(path.strip_prefix(&self.root).ok()?.to_string_lossy())
    }

    /// Does something that fails for good once the store has failed.
    fn unless_broken(&self, act: impl FnOnce(&mut State) -> Result<()>) -> std::io::Result<()> {
        let state = &mut *self.state();
        let done = act(state);
        state.is_broken |= done.is_err();
        Ok(done?)
    }
}

#[cfg(test)]
impl State {
    /// Makes the next look happen at once.
    pub(super) fn forget_look(&mut self) {
        self.looked = None;
    }
}

impl files::Mirror for View {
    fn committed(&self, path: &Path) -> std::io::Result<()> {
        let Some(name) = self.name(path) else { return Ok(()) };
        match self.access {
            Access::Work if is_part(&name) => self.unless_broken(|state| self.push_file(&name, state)),
            Access::Write if is_work(&name) => self.unless_broken(|state| self.push_work(&name, state)),
            Access::Read | Access::Look | Access::Work | Access::Write => Ok(()),
        }
    }

    fn removed(&self, path: &Path) -> std::io::Result<()> {
        let Some(name) = self.name(path).filter(|name| self.access == Access::Work && is_part(name)) else {
            return Ok(());
        };
        self.unless_broken(|state| match state.shown.remove(name.as_ref()) {
            Some(_) => self.bucket.remove(&name),
            None => Ok(()),
        })
    }

    fn refresh(&self, dir: &Path) -> std::io::Result<()> {
        match self.name(dir).filter(|_| self.access == Access::Work) {
            Some(dir) => self.unless_broken(|state| self.look(&dir, state)),
            None => Ok(()),
        }
    }

    fn n_bytes_elsewhere(&self, path: &Path) -> Option<u64> {
        self.state().elsewhere.get(self.name(path)?.as_ref()).copied()
    }

    fn publish(&self) -> std::io::Result<()> {
        match self.access {
            Access::Write => self.unless_broken(|state| self.push(state)),
            Access::Read | Access::Look | Access::Work => Ok(()),
        }
    }
}

impl Drop for View {
    fn drop(&mut self) {
        // A leftover is removed by a later command.
        let _ = remove_home(&self.home);
    }
}

impl Access {
    /// Whether the command reads the object of this name.
    fn needs(self, name: &str) -> bool {
        let is_record = || name.ends_with(".json") || name.contains(".try-");
        match self {
            Self::Read | Self::Write => true,
            // It is enough to know that the shards of other workers exist.
            Self::Work if is_part(name) => is_record(),
            Self::Work => !is_work(name),
            Self::Look if is_part(name) => is_record(),
            Self::Look => {
                !name.contains('/') && is_record() || is_work(name) && (is_record() || name.ends_with(".jsonl"))
            }
        }
    }
}

/// Removes a file, if it is there, without notice to a mirror.
fn remove_file(path: &Path) -> Result<()> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(error.into()),
        _ => Ok(()),
    }
}

/// Length and time of a file.
pub(super) fn stamp(path: &Path) -> Result<Stamp> {
    let metadata = fs::metadata(path)?;
    Ok((metadata.len(), metadata.modified()?))
}

/// Whether a file or object of this name is never pulled or pushed: locks, journals, and files that are being written.
pub(super) fn is_ours_alone(name: &str) -> bool {
    let file = name.rsplit('/').next().unwrap_or(name);
    let whole = file.strip_suffix(files::PARTIAL_SUFFIX).and_then(|rest| rest.rsplit_once('.'));
    [JOURNAL, LOCK_FILE].contains(&name) || whole.is_some_and(|(whole, _)| is_partial_of(file, whole))
}

/// Whether a file with this name lists files of ours: it only grows, and comes first.
pub(super) fn is_list(name: &str) -> bool {
    name.rsplit('/').next() == Some(LIST_FILE)
}

fn below<'a>(objects: &'a BTreeMap<String, Object>, dir: &'a str) -> impl Iterator<Item = &'a String> {
    objects.keys().filter(move |name| name.strip_prefix(dir).is_some_and(|rest| rest.starts_with('/')))
}

/// A new folder for a view, which is locked while its process lives. Removes those of dead processes.
fn new_home(cache: &Cache) -> Result<(PathBuf, Lock)> {
    let views = cache.folder("views")?;
    for entry in fs::read_dir(&views)? {
        let home = entry?.path();
        if is_abandoned(&home) {
            // Another process may be removing it, too.
            let _ = remove_home(&home);
        }
    }
    let name = unique_partial(Path::new("view"));
    let home = views.join(name.with_extension("").file_name().unwrap_or_default());
    fs::create_dir(&home)?;
    let lock = Lock::in_folder(&home)?;
    Ok((home, lock))
}

/// Whether the process that made the folder of a view is gone. One that has just made it may not have locked it yet.
fn is_abandoned(home: &Path) -> bool {
    let is_old =
        |metadata: std::fs::Metadata| metadata.modified().is_ok_and(|at| at.elapsed().is_ok_and(|age| age > BEGINS));
    fs::metadata(home).is_ok_and(is_old)
        && fs::File::open(home.join(LOCK_FILE)).is_ok_and(|lock| lock.try_lock().is_ok())
}

/// Removes the folder of a view: everything in it was put there by the process that created it.
fn remove_home(home: &Path) -> files::Result<()> {
    let all = files_below(home)?.into_iter().collect();
    remove_listed(home, &all).map(drop)
}
