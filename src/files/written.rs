//! Which files of a folder are ours? A list in the folder names every file before it is begun.
//!
//! A folder in which a command works keeps such a list ([`keep_list`]). Every [`AtomicFile`](super::AtomicFile) enters
//! itself in the list of the innermost folder above it that has one, so that writers need not know of it. Files that
//! are not on the list are foreign and are left alone. Folders are not listed: they are removed when they are empty.

use super::atomic::is_partial_of;
use super::error::{Error, Result};
use fs_err as fs;
use std::collections::BTreeSet;
use std::io::{self, Write};
use std::path::{Component, Path, PathBuf};

/// Name of the list in a folder that keeps one. Each line holds a name relative to the folder, as a JSON string, and
/// the beginning of that string's hash.
pub const LIST_FILE: &str = ".djinn-written";

/// Hexadecimal digits of the hash on each line.
const N_DIGITS: usize = 16;

/// Begins the list of `dir`, which must exist.
///
/// # Errors
/// On I/O errors, or if the folder keeps a list already.
pub fn keep_list(dir: &Path) -> Result<()> {
    fs::File::options().write(true).create_new(true).open(dir.join(LIST_FILE))?;
    Ok(())
}

/// The files that the list of `dir` names, whether or not they exist; `None` if the folder keeps no list.
///
/// # Errors
/// [`Error::Damaged`] when it holds entries that this module did not write; errors of the file system.
pub fn listed(dir: &Path) -> Result<Option<BTreeSet<PathBuf>>> {
    let path = dir.join(LIST_FILE);
    if is_link(&path) || !path.is_file() {
        return Ok(None);
    }
    let bytes = fs::read(&path)?;
    let whole = bytes.get(..bytes.len() - n_cut_off(&bytes)).unwrap_or_default();
    let mut names = BTreeSet::new();
    for (i, line) in whole.split_inclusive(|byte| *byte == b'\n').enumerate() {
        let name = name_on(line).ok_or_else(|| Error::Damaged {
            path: path.clone(),
            detail: format!("line {} is not as it was written", i + 1),
        })?;
        names.insert(name);
    }
    Ok(Some(names))
}

/// Whether a name in a list or record, relative to a folder, is that of something below it: plain parts between
/// slashes.
pub fn stays_below(name: &str) -> bool {
    let is_plain = |part: &str| !part.is_empty() && part != "." && !part.contains('\0');
    let is_normal = |part| matches!(part, Component::Normal(_));
    name.split('/').all(is_plain) && Path::new(name).components().all(is_normal)
}

/// The line of a list for a name, without its end.
fn line_of(name: &str) -> io::Result<String> {
    let text = serde_json::to_string(name)?;
    let hash = blake3::hash(text.as_bytes()).to_hex();
    Ok(format!("{text} {}", hash.get(..N_DIGITS).unwrap_or_default()))
}

/// The name on a whole line of a list, if this module wrote it.
fn name_on(line: &[u8]) -> Option<PathBuf> {
    let line = std::str::from_utf8(line).ok()?.strip_suffix('\n')?;
    let (text, _) = line.rsplit_once(' ')?;
    let name: String = serde_json::from_str(text).ok()?;
    (stays_below(&name) && line_of(&name).ok()? == line).then(|| PathBuf::from(name))
}

/// The number of bytes at the end of a list that are the beginning of a line cut off by a kill: the file that it would
/// have named was not begun.
fn n_cut_off(list: &[u8]) -> usize {
    let last = list.rsplit(|byte| *byte == b'\n').next().unwrap_or_default();
    let after_name = last.windows(2).rposition(|pair| pair == b"\" ").map(|at| last.len() - at - 2);
    if after_name.is_some_and(|n_bytes| n_bytes > N_DIGITS) { 0 } else { last.len() }
}

/// Enters a file that is about to be begun in the list of the innermost folder above it that keeps one.
pub(super) fn enter(path: &Path) -> io::Result<()> {
    match list_above(path) {
        Some(dir) => enter_all(&dir, path.strip_prefix(&dir).ok().into_iter()),
        None => Ok(()),
    }
}

/// Enters files of `dir`, given relative to it, in its list.
pub fn enter_all<'a>(dir: &Path, names: impl Iterator<Item = &'a Path>) -> io::Result<()> {
    let mut lines = String::new();
    for name in names {
        lines.push_str(&line_of(&name.to_string_lossy())?);
        lines.push('\n');
    }
    // One write of a short text at the end of a file is not interleaved with those of other threads.
    fs::File::options().append(true).open(dir.join(LIST_FILE))?.write_all(lines.as_bytes())
}

/// The innermost folder above `path` that keeps a list.
pub fn list_above(path: &Path) -> Option<PathBuf> {
    path.ancestors().skip(1).find(|dir| dir.join(LIST_FILE).is_file()).map(Path::to_owned)
}

/// All entries below `dir` other than folders, relative to it and sorted; empty if there is no such folder. Links are
/// not followed: they count as files.
pub fn files_below(dir: &Path) -> Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    let mut pending = vec![PathBuf::new()];
    while let Some(folder) = pending.pop() {
        let entries = match fs::read_dir(dir.join(&folder)) {
            Err(error) if error.kind() == io::ErrorKind::NotFound && folder.as_os_str().is_empty() => break,
            entries => entries?,
        };
        for entry in entries {
            let entry = entry?;
            let name = folder.join(entry.file_name());
            if entry.file_type()?.is_dir() { pending.push(name) } else { found.push(name) }
        }
    }
    found.sort();
    Ok(found)
}

/// The files below `dir` that are neither among `ours`, nor partial files of these, nor the list.
pub fn foreign(dir: &Path, ours: &BTreeSet<PathBuf>) -> Result<Vec<PathBuf>> {
    Ok(files_below(dir)?.into_iter().filter(|name| !is_ours(name, ours)).collect())
}

/// Removes the files below `dir` that are `ours`, and the folders that this leaves empty, including `dir`. Returns the
/// remaining entries.
///
/// # Errors
/// [`Error::Link`] when `dir` is a link, which may lead anywhere; errors of the file system.
pub fn remove_listed(dir: &Path, ours: &BTreeSet<PathBuf>) -> Result<Vec<PathBuf>> {
    check_no_link(dir)?;
    let (removed, kept): (Vec<_>, Vec<_>) = files_below(dir)?.into_iter().partition(|name| is_ours(name, ours));
    // The list last: until then, a second attempt knows our files.
    let (list, files): (Vec<_>, Vec<_>) = removed.into_iter().partition(|name| name == Path::new(LIST_FILE));
    for name in files.iter().chain(if kept.is_empty() { list.iter() } else { [].iter() }) {
        fs::remove_file(dir.join(name))?;
    }
    remove_empty(dir)?;
    Ok(kept)
}

/// Removes the files in the folder `dir` that the list in it or above it names, so that a writer can begin anew;
/// creates the folder if it is missing.
///
/// # Errors
/// [`Error::Foreign`] when it holds anything else, [`Error::Link`] when it is a link; errors of the file system.
pub fn clear(dir: &Path) -> Result<()> {
    check_no_link(dir)?;
    let mut ours = BTreeSet::new();
    if let Some(keeper) = list_above(&dir.join(LIST_FILE)) {
        let below = dir.strip_prefix(&keeper).unwrap_or(Path::new(""));
        let names = listed(&keeper)?.unwrap_or_default();
        ours = names.iter().filter_map(|name| name.strip_prefix(below).ok().map(Path::to_owned)).collect();
    }
    let found = foreign(dir, &ours)?;
    if !found.is_empty() {
        return Err(Error::Foreign { path: dir.to_owned(), found });
    }
    for name in files_below(dir)?.iter().filter(|name| name.as_path() != Path::new(LIST_FILE)) {
        fs::remove_file(dir.join(name))?;
    }
    remove_empty(dir)?;
    Ok(fs::create_dir_all(dir)?)
}

/// Removes the partial files of files that the list of `dir` names, and from the list a line that a kill cut off. No
/// process may be writing there: the files are leftovers then.
///
/// # Errors
/// As [`listed`]; [`Error::Link`] when `dir` is a link.
pub fn remove_leftovers(dir: &Path) -> Result<()> {
    check_no_link(dir)?;
    let Some(ours) = listed(dir)? else { return Ok(()) };
    let list = fs::read(dir.join(LIST_FILE))?;
    let n_cut_off = n_cut_off(&list);
    if n_cut_off > 0 {
        let file = fs::File::options().write(true).open(dir.join(LIST_FILE))?;
        file.set_len((list.len() - n_cut_off) as u64)?;
    }
    for name in files_below(dir)? {
        if !ours.contains(&name) && name != Path::new(LIST_FILE) && is_ours(&name, &ours) {
            fs::remove_file(dir.join(name))?;
        }
    }
    Ok(())
}

/// Whether the path is a symbolic link, wherever that leads.
pub fn is_link(path: &Path) -> bool {
    path.symlink_metadata().is_ok_and(|metadata| metadata.is_symlink())
}

fn check_no_link(path: &Path) -> Result<()> {
    if is_link(path) { Err(Error::Link { path: path.to_owned() }) } else { Ok(()) }
}

/// Brings a folder's entries to the disk: a rename is there only once its folder is.
pub fn sync_folder(dir: &Path) -> io::Result<()> {
    // Elsewhere folders cannot be opened; the system orders renames by itself.
    if cfg!(unix) {
        let dir = if dir.as_os_str().is_empty() { Path::new(".") } else { dir };
        fs::File::open(dir)?.sync_all()?;
    }
    Ok(())
}

fn is_ours(name: &Path, ours: &BTreeSet<PathBuf>) -> bool {
    if ours.contains(name) || name == Path::new(LIST_FILE) {
        return true;
    }
    let Some(file) = name.file_name().and_then(|file| file.to_str()) else { return false };
    let whole = file.strip_suffix(super::PARTIAL_SUFFIX).and_then(|rest| rest.rsplit_once('.'));
    whole.is_some_and(|(whole, _)| is_partial_of(file, whole) && ours.contains(&name.with_file_name(whole)))
}

/// Removes the folders below `dir` that hold no files, and `dir` itself if it holds none.
fn remove_empty(dir: &Path) -> Result<()> {
    let entries = match fs::read_dir(dir) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        entries => entries?,
    };
    for entry in entries {
        let entry = entry?;
        if entry.file_type()?.is_dir() {
            remove_empty(&entry.path())?;
        }
    }
    match fs::remove_dir(dir) {
        Err(error) if error.kind() != io::ErrorKind::DirectoryNotEmpty => Err(error.into()),
        _ => Ok(()),
    }
}
