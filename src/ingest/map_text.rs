//! The text of a map in XML, whatever its encoding.

use super::error::Error;
use std::borrow::Cow;
use std::io::{BufRead, Read};

/// The text of the map in `file`, of at most `max_bytes`, without a byte order mark.
pub(super) fn read_text(reader: &mut dyn BufRead, max_bytes: u64, file: &str) -> Result<String, Error> {
    let error = |what: String| Error::map(file, "", what);
    let mut bytes = Vec::new();
    let read = reader.take(max_bytes + 1).read_to_end(&mut bytes);
    read.map_err(|source| error(format!("cannot be read: {source}")))?;
    if bytes.len() as u64 > max_bytes {
        return Err(error(format!("is larger than {} MiB", max_bytes >> 20)));
    }
    let text = decoded(&bytes).map_err(|at| {
        let what = "is not UTF-8 text, and does not declare to be ISO-8859-1; save it as UTF-8";
        Error::map(file, format!("line {}", line_at(&bytes, at)), what)
    })?;
    Ok(text.strip_prefix('\u{feff}').map_or_else(|| text.to_string(), str::to_owned))
}

/// The line of a byte, counted from 1.
pub(super) fn line_at(bytes: &[u8], at: usize) -> usize {
    1 + memchr::memchr_iter(b'\n', &bytes[..at.min(bytes.len())]).count()
}

/// The text of a document in UTF-8, in UTF-16 with a byte order mark, or in ISO-8859-1 if it declares so; or the
/// position of the first byte that cannot be decoded.
fn decoded(bytes: &[u8]) -> Result<Cow<'_, str>, usize> {
    let utf8 = match std::str::from_utf8(bytes) {
        Ok(text) => return Ok(text.into()),
        Err(utf8) => utf8,
    };
    let units = |bytes: &[u8], unit: fn([u8; 2]) -> u16| -> Vec<u16> {
        bytes.chunks_exact(2).map(|pair| unit([pair[0], pair[1]])).collect()
    };
    match bytes {
        [0xff, 0xfe, rest @ ..] => Ok(String::from_utf16_lossy(&units(rest, u16::from_le_bytes)).into()),
        [0xfe, 0xff, rest @ ..] => Ok(String::from_utf16_lossy(&units(rest, u16::from_be_bytes)).into()),
        _ => {
            let declaration = bytes.split(|byte| *byte == b'>').next().unwrap_or_default().to_ascii_lowercase();
            let declaration = String::from_utf8_lossy(&declaration);
            let is_declared = ["iso-8859-1", "latin1", "windows-1252"].iter().any(|name| declaration.contains(name));
            let text = || bytes.iter().copied().map(char::from).collect::<String>().into();
            if is_declared { Ok(text()) } else { Err(utf8.valid_up_to()) }
        }
    }
}
