//! Reads the files of the inputs, without unpacking anything to disk.
//!
//! Inputs are folders, single files, and containers: `.zip`, `.tar`, `.tar.gz`, `.tgz`, and `.gz` around one file.
//! Every file is passed on as a stream, one after the other, in an order that depends on the inputs alone: folders by
//! name, archives in the order of their directory. Memory does not grow with the size of a file. Names inside an
//! archive are only names: nothing is ever written, so `..` and absolute paths lead nowhere.

mod folder;
mod tarball;
mod zipped;

use super::Error;
use crate::files::regular;
use std::io::{self, BufRead, Read};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

/// One file of an input.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Entry {
    /// Its path inside the container with `/` between parts, and without the `.gz` of a file that is compressed alone.
    pub path: String,
    /// The archive, or the input folder (for an input that is a file: its folder).
    pub container: PathBuf,
    /// Size in bytes, if the container tells it before the file is read.
    pub size: Option<u64>,
}

/// Callback for every wanted entry: with the entry and its bytes, any number of which may be read.
///
/// An entry that cannot be opened is passed on, too, as a stream whose first read fails, so that the caller decides
/// whether a broken file among many is a reject or the end.
pub type Visitor<'a> = dyn FnMut(&Entry, &mut dyn BufRead) -> Result<ControlFlow<()>, Error> + 'a;

/// Visits the entries of `inputs` whose path is `wanted`, until `visit` breaks off.
///
/// Other entries are not opened (in a `.tar.gz` they still have to be decompressed). Hidden files, links inside
/// archives, and companion files of macOS are skipped.
///
/// # Errors
/// An input that does not exist or cannot be read, a container that is damaged or cut short, and errors of `visit`.
pub fn visit_entries(inputs: &[PathBuf], wanted: &dyn Fn(&str) -> bool, visit: &mut Visitor<'_>) -> Result<(), Error> {
    for input in inputs {
        if visit_input(input, wanted, visit)?.is_break() {
            break;
        }
    }
    Ok(())
}

fn visit_input(input: &Path, wanted: &dyn Fn(&str) -> bool, visit: &mut Visitor<'_>) -> Result<ControlFlow<()>, Error> {
    if fs_err::metadata(input)?.is_dir() {
        return folder::visit(input, wanted, visit);
    }
    // A bare name lies in the current folder, whose name may be the place.
    let folder = input.parent().filter(|folder| *folder != Path::new("")).unwrap_or_else(|| Path::new("."));
    let name = input.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    visit_file(folder, &name, input, wanted, visit)
}

/// Visits the file `path`, named `name` within `root`: itself, or its entries if it is an archive.
fn visit_file(
    root: &Path,
    name: &str,
    path: &Path,
    wanted: &dyn Fn(&str) -> bool,
    visit: &mut Visitor<'_>,
) -> Result<ControlFlow<()>, Error> {
    let lower = name.to_ascii_lowercase();
    let ends_with = |suffix: &str| lower.ends_with(suffix);
    if ends_with(".zip") {
        zipped::visit(path, wanted, visit)
    } else if ends_with(".tar") {
        tarball::visit(path, open(path)?, wanted, visit)
    } else if ends_with(".tar.gz") || ends_with(".tgz") {
        tarball::visit(path, gunzip(open(path)?), wanted, visit)
    } else if ends_with(".gz") {
        let entry =
            Entry { path: clean_name(&name[..name.len() - ".gz".len()]), container: root.to_owned(), size: None };
        if !wanted(&entry.path) {
            return Ok(ControlFlow::Continue(()));
        }
        match open(path) {
            Ok(file) => visit(&entry, &mut io::BufReader::with_capacity(BUFFER_BYTES, Packed(gunzip(file)))),
            Err(error) => visit(&entry, &mut Unopened::because(error)),
        }
    } else {
        if !wanted(name) {
            return Ok(ControlFlow::Continue(()));
        }
        let size = fs_err::metadata(path).ok().map(|metadata| metadata.len());
        let entry = Entry { path: clean_name(name), container: root.to_owned(), size };
        match open(path) {
            Ok(mut file) => visit(&entry, &mut file),
            Err(error) => visit(&entry, &mut Unopened::because(error)),
        }
    }
}

const BUFFER_BYTES: usize = 128 * 1024;

fn open(path: &Path) -> io::Result<io::BufReader<fs_err::File>> {
    regular(path)?;
    Ok(io::BufReader::with_capacity(BUFFER_BYTES, fs_err::File::open(path)?))
}

/// Decompresses consecutive gzip members as one stream, as `gzip` itself does.
fn gunzip(reader: impl BufRead) -> impl Read {
    flate2::bufread::MultiGzDecoder::new(reader)
}

/// A name for messages: `/` between parts, no empty, `.` or `..` parts, no control characters.
fn clean_name(name: &str) -> String {
    let printable: String =
        name.chars().map(|c| if c.is_control() { char::REPLACEMENT_CHARACTER } else { c }).collect();
    let parts: Vec<&str> = printable.split(['/', '\\']).filter(|part| !matches!(*part, "" | "." | "..")).collect();
    parts.join("/")
}

/// Whether a path is hidden, or one of the companion files that macOS adds to archives (`__MACOSX/…`, `._name`).
fn is_hidden(clean_name: &str) -> bool {
    clean_name.split('/').any(|part| part.starts_with('.') || part == "__MACOSX")
}

/// The error for a damaged container; `after` is the last entry that could be read.
fn damaged(container: &Path, after: Option<&str>, error: &io::Error) -> Error {
    let place = after.map_or(String::new(), |entry| format!(" after entry {entry}"));
    let detail = format!("{error}{place}; {DAMAGED}");
    Error::Container { container: container.to_owned(), file: String::new(), detail }
}

const DAMAGED: &str = "the file may be damaged or truncated, download it again";

/// An entry of an archive, with errors that tell what to do.
struct Packed<R>(R);

impl<R: Read> Read for Packed<R> {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        self.0.read(into).map_err(|error| match error.kind() {
            io::ErrorKind::Interrupted => error,
            kind => io::Error::new(kind, format!("{error}; {DAMAGED}")),
        })
    }
}

/// Stands for an entry that could not be opened: the first read gives the reason.
struct Unopened(Option<io::Error>);

impl Unopened {
    fn because(error: io::Error) -> io::BufReader<Self> {
        io::BufReader::new(Self(Some(error)))
    }
}

impl Read for Unopened {
    fn read(&mut self, _: &mut [u8]) -> io::Result<usize> {
        self.0.take().map_or(Ok(0), Err)
    }
}

#[cfg(test)]
mod tests;
