//! Reads the lines of a large table one by one.

use super::quotes::append_plain;
use memchr::memchr;
use std::io::{self, BufRead, Read};

/// Maximum length of a line; the tables have lines of about 100 bytes.
const MAX_LINE_BYTES: usize = 64 * 1024;

/// Maximum number of consecutive empty lines; a gigabyte of them compresses to a megabyte.
const MAX_EMPTY_LINES: usize = 100_000;

/// The lines of a stream with their numbers. Lines end in LF or CRLF, the last one may lack its end, and a byte order
/// mark at the start is skipped. Quotes around cells are removed.
pub(crate) struct Lines<'a> {
    reader: &'a mut dyn BufRead,
    /// Bytes of the reader's buffer that were returned as a line and must be skipped.
    n_shown: usize,
    /// A line that is not whole in the reader's buffer, or has quotes.
    line: Vec<u8>,
    number: u64,
    /// Empty lines since the last other one.
    n_empty: usize,
    keeps_quotes: bool,
}

impl<'a> Lines<'a> {
    /// The lines of `reader`, which must stand at the start of the stream.
    pub(crate) fn new(reader: &'a mut dyn BufRead) -> Self {
        Self { reader, n_shown: 0, line: Vec::new(), number: 0, n_empty: 0, keeps_quotes: false }
    }

    /// The same lines with the quotes around their cells.
    pub(crate) fn with_quotes(self) -> Self {
        Self { keeps_quotes: true, ..self }
    }

    /// The next line without its end, and its number, counted from 1; `None` at the end of the stream.
    ///
    /// # Errors
    /// When the stream cannot be read or is not a table: a line is longer than 64 KiB, or 100 000 consecutive lines are
    /// empty.
    pub(crate) fn next(&mut self) -> io::Result<Option<(u64, &[u8])>> {
        self.pass_over_shown();
        let end = loop {
            match self.reader.fill_buf() {
                Ok(buffer) => break memchr(b'\n', &buffer[..buffer.len().min(MAX_LINE_BYTES)]),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        };
        if let Some(end) = end {
            self.n_shown = end + 1;
            self.number += 1;
            // The buffer is still full, so nothing is read here.
            let line = clean(&self.reader.fill_buf()?[..end], self.number);
            self.n_empty = if line.is_empty() { self.n_empty + 1 } else { 0 };
            if self.n_empty > MAX_EMPTY_LINES {
                let message = format!("more than {MAX_EMPTY_LINES} empty lines up to line {}", self.number);
                return Err(io::Error::new(io::ErrorKind::InvalidData, message));
            }
            if self.keeps_quotes || memchr(b'"', line).is_none() {
                return Ok(Some((self.number, line)));
            }
            self.line.clear();
            append_plain(line, &mut self.line);
            return Ok(Some((self.number, &self.line)));
        }
        self.line.clear();
        let n = Read::take(&mut *self.reader, MAX_LINE_BYTES as u64 + 1).read_until(b'\n', &mut self.line)?;
        if n == 0 {
            return Ok(None);
        }
        self.number += 1;
        if n > MAX_LINE_BYTES {
            let message = format!("line {} is longer than {} KiB", self.number, MAX_LINE_BYTES / 1024);
            return Err(io::Error::new(io::ErrorKind::InvalidData, message));
        }
        if !self.keeps_quotes && memchr(b'"', &self.line).is_some() {
            let quoted = std::mem::take(&mut self.line);
            append_plain(clean(&quoted, self.number), &mut self.line);
        }
        Ok(Some((self.number, clean(&self.line, self.number))))
    }

    /// Appends the bytes after the last line to `bytes`.
    ///
    /// # Errors
    /// When the stream cannot be read, or, as [`io::ErrorKind::FileTooLarge`], when more than `max_bytes` follow.
    pub(crate) fn read_rest(&mut self, bytes: &mut Vec<u8>, max_bytes: u64) -> io::Result<()> {
        self.pass_over_shown();
        let n = Read::take(&mut *self.reader, max_bytes + 1).read_to_end(bytes)?;
        if n as u64 > max_bytes {
            let message = format!("more than {} MiB", max_bytes >> 20);
            return Err(io::Error::new(io::ErrorKind::FileTooLarge, message));
        }
        Ok(())
    }

    fn pass_over_shown(&mut self) {
        self.reader.consume(std::mem::take(&mut self.n_shown));
    }
}

/// The lines of bytes in memory, each without its end; none after the last end.
pub(crate) fn lines_of(bytes: &[u8]) -> impl Iterator<Item = &[u8]> {
    bytes.split_inclusive(|byte| *byte == b'\n').map(without_end)
}

/// Replaces `cells` by the cells of a line without quotes, at least one.
pub(super) fn split_cells<'a>(line: &'a [u8], cells: &mut Vec<&'a [u8]>) {
    cells.clear();
    cells.extend(line.split(|byte| *byte == b','));
}

fn clean(line: &[u8], number: u64) -> &[u8] {
    let line = without_end(line);
    if number == 1 { line.strip_prefix(b"\xef\xbb\xbf").unwrap_or(line) } else { line }
}

/// A line without its LF or CRLF.
pub(crate) fn without_end(line: &[u8]) -> &[u8] {
    let line = line.strip_suffix(b"\n").unwrap_or(line);
    line.strip_suffix(b"\r").unwrap_or(line)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lines(mut bytes: &[u8]) -> io::Result<Vec<String>> {
        let mut lines = Lines::new(&mut bytes);
        let mut all = Vec::new();
        while let Some((_, line)) = lines.next()? {
            all.push(String::from_utf8_lossy(line).into_owned());
        }
        Ok(all)
    }

    #[test]
    fn byte_order_marks_and_line_ends_are_no_part_of_lines() {
        assert_eq!(lines(b"\xef\xbb\xbfa,b\r\n1,2\r\n\r\n3,4").unwrap(), ["a,b", "1,2", "", "3,4"]);
        assert_eq!(lines(b"a\nb\n").unwrap(), ["a", "b"]);
        assert!(lines(b"").unwrap().is_empty());
        assert_eq!(lines(b"\"a\",b\r\n1,\"2\"").unwrap(), ["a,b", "1,2"]);
    }

    #[test]
    fn lines_are_the_same_whatever_the_reader_holds_at_a_time() {
        let text = b"\xef\xbb\xbffirst,line\r\n\n2,3\nlast one";
        let whole = lines(text).unwrap();
        assert_eq!(whole, ["first,line", "", "2,3", "last one"]);
        for capacity in 1..text.len() {
            let mut reader = io::BufReader::with_capacity(capacity, &text[..]);
            let mut lines = Lines::new(&mut reader);
            let mut all = Vec::new();
            while let Some((number, line)) = lines.next().unwrap() {
                all.push(String::from_utf8_lossy(line).into_owned());
                assert_eq!(number, all.len() as u64);
            }
            assert_eq!(all, whole, "{capacity} bytes");
        }
        let in_memory: Vec<&[u8]> = lines_of(&text[3..]).collect();
        assert_eq!(in_memory, [&b"first,line"[..], b"", b"2,3", b"last one"]);
        assert_eq!(lines_of(b"a\n\n").collect::<Vec<_>>(), [&b"a"[..], b""]);
        assert_eq!(lines_of(b"").count(), 0);
    }

    #[test]
    fn empty_lines_come_to_an_end() {
        let text = |n: usize| [b"a\n".as_slice(), &b"\n".repeat(n), b"b\n"].concat();
        assert_eq!(lines(&text(MAX_EMPTY_LINES)).unwrap().len(), MAX_EMPTY_LINES + 2);
        let why = lines(&text(MAX_EMPTY_LINES + 1)).unwrap_err().to_string();
        assert_eq!(why, "more than 100000 empty lines up to line 100002");
    }

    #[test]
    fn an_error_is_no_end() {
        struct Failing;
        impl Read for Failing {
            fn read(&mut self, _: &mut [u8]) -> io::Result<usize> {
                Err(io::Error::other("the disk is gone"))
            }
        }
        let mut reader = io::BufReader::new(b"a\nb".chain(Failing));
        let mut lines = Lines::new(&mut reader);
        assert!(lines.next().unwrap().is_some());
        assert_eq!(lines.next().unwrap_err().to_string(), "the disk is gone");
    }

    #[test]
    fn the_rest_is_bounded() {
        let mut bytes = &b"a\nb\nc\n"[..];
        let mut lines = Lines::new(&mut bytes);
        lines.next().unwrap();
        let mut rest = Vec::new();
        lines.read_rest(&mut rest, 4).unwrap();
        assert_eq!(rest, b"b\nc\n");
        let mut endless = io::BufReader::new(io::repeat(b'x'));
        let error = Lines::new(&mut endless).read_rest(&mut rest, 1000).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::FileTooLarge);
    }

    #[test]
    fn endless_lines_are_refused_without_reading_them() {
        let mut endless = io::BufReader::new(io::repeat(b'x'));
        let error = Lines::new(&mut endless).next().unwrap_err().to_string();
        assert!(error.contains("line 1 is longer than 64 KiB"), "{error}");
    }
}
