//! TFRecord: a series of records, each with its length, and checksums of both.

use std::io::{self, BufRead, Read};

/// The largest record that is read: scenarios have one megabyte or two, and some more with the features of sensors.
const MAX_RECORD_BYTES: u64 = 16 << 20;
/// The head of a record: its length, and the checksum of that.
const HEAD_BYTES: usize = 12;
const CHECKSUM_BYTES: u64 = 4;

/// Why a record is left out: reason and detail.
pub(super) type Damage = (&'static str, String);

/// The records of a stream, each with the byte at which it begins.
pub(super) struct Records<'r> {
    reader: &'r mut dyn BufRead,
    offset: u64,
    /// The head of the next record, if it is read already.
    head: Option<[u8; HEAD_BYTES]>,
    is_over: bool,
}

impl<'r> Records<'r> {
    pub(super) fn new(reader: &'r mut dyn BufRead) -> Self {
        Self { reader, offset: 0, head: None, is_over: false }
    }

    /// The content of the next record; `None` at the end.
    fn read(&mut self) -> io::Result<Option<Result<Vec<u8>, Damage>>> {
        let head = match self.head.take() {
            Some(head) => head.to_vec(),
            None => self.read_at_most(HEAD_BYTES as u64)?,
        };
        let Some(head) = head.first_chunk().copied() else {
            return Ok((!head.is_empty()).then(|| Err(broken_off(head.len(), HEAD_BYTES as u64))));
        };
        let Some(n_bytes) = length(head) else { return self.search(head).map(|damage| Some(Err(damage))) };
        if n_bytes > MAX_RECORD_BYTES {
            let n_bytes = n_bytes.saturating_add(CHECKSUM_BYTES);
            self.offset += io::copy(&mut self.reader.take(n_bytes), &mut io::sink())?;
            return Ok(Some(Err(("too_large", format!("has more than {} MiB", MAX_RECORD_BYTES >> 20)))));
        }
        let mut content = self.read_at_most(n_bytes + CHECKSUM_BYTES)?;
        let Some((_, checksum)) = content.split_last_chunk().filter(|(content, _)| content.len() as u64 == n_bytes)
        else {
            return Ok(Some(Err(broken_off(content.len(), n_bytes + CHECKSUM_BYTES))));
        };
        let checksum = u32::from_le_bytes(*checksum);
        content.truncate(n_bytes as usize);
        let damage = || ("damaged_record", "does not have the content that its checksum is of".to_owned());
        Ok(Some((masked_crc(&content) == checksum).then_some(content).ok_or_else(damage)))
    }

    fn read_at_most(&mut self, n_bytes: u64) -> io::Result<Vec<u8>> {
        let mut bytes = Vec::with_capacity(n_bytes as usize);
        self.offset += self.reader.take(n_bytes).read_to_end(&mut bytes)? as u64;
        Ok(bytes)
    }

    /// Goes on to the next head, since the length in this one cannot be trusted.
    fn search(&mut self, mut head: [u8; HEAD_BYTES]) -> io::Result<Damage> {
        let mut n_passed = 0_u64;
        loop {
            let bytes = self.reader.fill_buf()?;
            let found = bytes.iter().position(|byte| {
                head.rotate_left(1);
                head[HEAD_BYTES - 1] = *byte;
                length(head).is_some_and(|n_bytes| n_bytes <= MAX_RECORD_BYTES)
            });
            let n_read = found.map_or(bytes.len(), |at| at + 1);
            let is_over = bytes.is_empty();
            self.reader.consume(n_read);
            self.offset += n_read as u64;
            n_passed += n_read as u64;
            let what = if found.is_some() {
                self.head = Some(head);
                format!("has a damaged head; the next one begins {n_passed} bytes later")
            } else if is_over {
                "has a damaged head, and none follows; is the file a TFRecord, and named .gz if packed?".to_owned()
            } else {
                continue;
            };
            return Ok(("damaged_record", what));
        }
    }
}

impl Iterator for Records<'_> {
    type Item = (u64, Result<Vec<u8>, Damage>);

    fn next(&mut self) -> Option<Self::Item> {
        if self.is_over {
            return None;
        }
        let begin = self.offset - self.head.map_or(0, |head| head.len() as u64);
        let record = self.read().unwrap_or_else(|error| {
            self.is_over = true;
            Some(Err(("unreadable", error.to_string())))
        });
        Some((begin, record?))
    }
}

fn broken_off(n_bytes: usize, expected: u64) -> Damage {
    ("damaged_record", format!("breaks off after {n_bytes} of {expected} bytes; download the file again"))
}

/// The length in a head, if its checksum is right.
fn length(head: [u8; HEAD_BYTES]) -> Option<u64> {
    let (length, checksum) = head.split_last_chunk()?;
    let is_right = masked_crc(length) == u32::from_le_bytes(*checksum);
    length.first_chunk().filter(|_| is_right).map(|length| u64::from_le_bytes(*length))
}

pub(super) fn framed(content: &[u8]) -> Vec<u8> {
    let length = (content.len() as u64).to_le_bytes();
    [&length, &masked_crc(&length).to_le_bytes()[..], content, &masked_crc(content).to_le_bytes()].concat()
}

/// CRC-32C, masked as in TFRecords, since a checksum of data with checksums in it would mean little.
pub(super) fn masked_crc(bytes: &[u8]) -> u32 {
    crc32c::crc32c(bytes).rotate_right(15).wrapping_add(0xa282_ead8)
}
