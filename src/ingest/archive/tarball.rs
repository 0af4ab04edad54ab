//! Reads the entries of a `.tar` stream.
//!
//! Entries are taken raw, and the extension headers that carry long names are read here, because their size is up to
//! the archive: a header that claims to be gigabytes long must not be read into memory.

use super::{BUFFER_BYTES, Entry, Visitor, clean_name, damaged, is_hidden};
use crate::ingest::Error;
use std::io::{self, Read};
use std::ops::ControlFlow;
use std::path::Path;

/// Longest extension header (that is, longest file name) that is accepted.
const MAX_EXTENSION_BYTES: u64 = 64 * 1024;

/// Visits the regular files of the tar stream `reader`, which is the file `path`.
///
/// A stream cannot be entered again after a damaged place, so damage between entries is an error. So is an end without
/// the mark that ends archives, and a wrong checksum of the compression after that mark.
pub(super) fn visit(
    path: &Path,
    reader: impl Read,
    wanted: &dyn Fn(&str) -> bool,
    visit: &mut Visitor<'_>,
) -> Result<ControlFlow<()>, Error> {
    let mut previous: Option<String> = None;
    let mut archive = tar::Archive::new(Tail { inner: io::BufReader::with_capacity(BUFFER_BYTES, reader), n_zeros: 0 });
    let entries = archive.entries().map_err(|error| damaged(path, None, &error))?.raw(true);
    let mut long_name: Option<String> = None;
    for entry in entries {
        let mut file = entry.map_err(|error| damaged(path, previous.as_deref(), &error))?;
        let kind = file.header().entry_type();
        if kind.is_gnu_longname() || kind.is_pax_local_extensions() {
            let extension = read_extension(&mut file).map_err(|error| damaged(path, previous.as_deref(), &error))?;
            let name = if kind.is_gnu_longname() {
                Some(String::from_utf8_lossy(&extension).trim_end_matches('\0').to_owned())
            } else {
                pax_path(&extension).map_err(|error| damaged(path, previous.as_deref(), &error))?
            };
            long_name = name.or(long_name);
            continue;
        }
        if kind.is_gnu_longlink() || kind.is_pax_global_extensions() {
            continue;
        }
        let name =
            clean_name(&long_name.take().unwrap_or_else(|| String::from_utf8_lossy(&file.path_bytes()).into_owned()));
        if (kind.is_file() || kind.is_contiguous()) && !is_hidden(&name) && wanted(&name) {
            let entry = Entry { path: name.clone(), container: path.to_owned(), size: Some(file.size()) };
            let whole = Whole { left: file.size(), inner: file };
            let flow = visit(&entry, &mut io::BufReader::with_capacity(BUFFER_BYTES, whole))?;
            if flow.is_break() {
                return Ok(flow);
            }
        }
        previous = Some(name);
    }
    let mut tail = archive.into_inner();
    if tail.n_zeros < END_BYTES {
        let error = io::Error::new(io::ErrorKind::UnexpectedEof, "the end mark of the archive is missing");
        return Err(damaged(path, previous.as_deref(), &error));
    }
    match io::copy(&mut tail, &mut io::sink()) {
        Err(error) if !is_of_what_follows(&error) => Err(damaged(path, previous.as_deref(), &error)),
        _ => Ok(ControlFlow::Continue(())),
    }
}

/// Whether bytes after a compressed stream, such as zeros or a signature, were mistaken for another stream. `gzip`
/// ignores them, too.
fn is_of_what_follows(error: &io::Error) -> bool {
    error.to_string().contains("invalid gzip header")
}

/// The fewest zeros after the last entry.
const END_BYTES: u64 = 512;

/// A stream that counts the zeros at its end so far.
struct Tail<R> {
    inner: R,
    n_zeros: u64,
}

impl<R: Read> Read for Tail<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let n = self.inner.read(buffer)?;
        let n_zeros = buffer[..n].iter().rev().take_while(|byte| **byte == 0).count();
        self.n_zeros = n_zeros as u64 + if n_zeros == n { self.n_zeros } else { 0 };
        Ok(n)
    }
}

fn read_extension(file: &mut impl Read) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    file.take(MAX_EXTENSION_BYTES + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > MAX_EXTENSION_BYTES {
        return Err(invalid(format!("a file name is longer than {MAX_EXTENSION_BYTES} bytes")));
    }
    Ok(bytes)
}

/// The `path` of a pax header: records of the form `<length> <key>=<value>\n`.
fn pax_path(extension: &[u8]) -> io::Result<Option<String>> {
    let mut path = None;
    for record in tar::PaxExtensions::new(extension) {
        let record = record?;
        match record.key_bytes() {
            b"path" => path = Some(String::from_utf8_lossy(record.value_bytes()).into_owned()),
            // It overrides the size in the plain header, on which raw entries depend.
            b"size" => return Err(invalid("files over 8 GiB are not supported in pax archives; unpack them".into())),
            _ => {}
        }
    }
    Ok(path)
}

fn invalid(message: String) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, message)
}

/// A file of known size: an archive that ends before its end is an error and not a short file.
struct Whole<R> {
    left: u64,
    inner: R,
}

impl<R: Read> Read for Whole<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let n = self.inner.read(buffer)?;
        if n == 0 && self.left > 0 && !buffer.is_empty() {
            let message = format!("the archive ends {} bytes before the end of this file", self.left);
            return Err(io::Error::new(io::ErrorKind::UnexpectedEof, message));
        }
        self.left = self.left.saturating_sub(n as u64);
        Ok(n)
    }
}
