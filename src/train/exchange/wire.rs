//! The wire format: messages, which may come from anybody, until the ranks have met, and then frames of bytes.

use serde::Serialize;
use serde::de::DeserializeOwned;
use std::io::{Error, ErrorKind, Read, Result, Write};

/// The first bytes of every message of a meeting, by which other programs and versions are recognized.
const MAGIC: [u8; 16] = *b"djinn ranks 1\r\n\0";
/// Maximum length of a message, so that no stranger can exhaust time or memory.
const MAX_MESSAGE: u64 = 1 << 20;
/// Memory that is allocated for a frame before its bytes arrive.
const MAX_RESERVED: u64 = 1 << 26;

/// Sends a message.
pub(super) fn send_message(mut to: impl Write, message: &impl Serialize) -> Result<()> {
    let text = serde_json::to_vec(message)?;
    to.write_all(&[&MAGIC[..], &(text.len() as u64).to_le_bytes(), &text].concat())
}

/// Receives a message, without reading beyond it.
///
/// # Errors
/// When it is not a message of this version.
pub(super) fn receive_message<M: DeserializeOwned>(mut from: impl Read) -> Result<M> {
    let (mut magic, mut length) = ([0; MAGIC.len()], [0; 8]);
    from.read_exact(&mut magic)?;
    if magic != MAGIC {
        return Err(Error::new(
            ErrorKind::InvalidData,
            "received something other than a message of a rank of this version",
        ));
    }
    from.read_exact(&mut length)?;
    let length = u64::from_le_bytes(length);
    if length > MAX_MESSAGE {
        let message = format!("a message of {length} bytes, expected at most {MAX_MESSAGE}");
        return Err(Error::new(ErrorKind::InvalidData, message));
    }
    Ok(serde_json::from_slice(&read_bytes(from, length)?)?)
}

/// Sends a frame: its number in the order of frames, its length, its bytes.
pub(super) fn send_frame(mut to: impl Write, number: u64, bytes: &[u8]) -> Result<()> {
    let mut header = [0; 16];
    header[..8].copy_from_slice(&number.to_le_bytes());
    header[8..].copy_from_slice(&(bytes.len() as u64).to_le_bytes());
    to.write_all(&header)?;
    to.write_all(bytes)
}

/// Receives the frame of this number.
///
/// # Errors
/// When it has another number, because the ranks have not made the same calls.
pub(super) fn receive_frame(mut from: impl Read, number: u64) -> Result<Vec<u8>> {
    let (mut found, mut length) = ([0; 8], [0; 8]);
    from.read_exact(&mut found)?;
    from.read_exact(&mut length)?;
    let found = u64::from_le_bytes(found);
    if found != number {
        let message = format!("exchange {found} was received, expected {number}");
        return Err(Error::new(ErrorKind::InvalidData, message));
    }
    read_bytes(from, u64::from_le_bytes(length))
}

fn read_bytes(from: impl Read, length: u64) -> Result<Vec<u8>> {
    let mut bytes = Vec::with_capacity(length.min(MAX_RESERVED) as usize);
    match from.take(length).read_to_end(&mut bytes)? as u64 == length {
        true => Ok(bytes),
        false => Err(ErrorKind::UnexpectedEof.into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_and_frames_are_read_to_their_ends_and_no_further() {
        let mut wire = Vec::new();
        send_message(&mut wire, &("rank", 3)).unwrap();
        send_frame(&mut wire, 0, b"").unwrap();
        send_frame(&mut wire, 1, b"abc").unwrap();
        let mut rest = &wire[..];
        assert_eq!(receive_message::<(String, usize)>(&mut rest).unwrap(), ("rank".to_owned(), 3));
        assert_eq!(receive_frame(&mut rest, 0).unwrap(), b"");
        assert_eq!(receive_frame(&mut rest, 1).unwrap(), b"abc");
        assert!(rest.is_empty());
    }

    #[test]
    fn what_is_not_ours_is_an_error() {
        let said = |wire: &[u8]| receive_message::<usize>(wire).unwrap_err().to_string();
        assert!(said(b"GET / HTTP/1.1\r\nHost: example.org\r\n\r\n").contains("other than a message of a rank"));
        let huge = [&MAGIC[..], &u64::MAX.to_le_bytes()].concat();
        assert!(said(&huge).contains("expected at most 1048576"), "{}", said(&huge));
        let mut whole = Vec::new();
        send_message(&mut whole, &7).unwrap();
        (0..whole.len()).for_each(|end| drop(receive_message::<usize>(&whole[..end]).unwrap_err()));
        let mut frame = Vec::new();
        send_frame(&mut frame, 5, b"abc").unwrap();
        assert_eq!(receive_frame(&frame[..], 6).unwrap_err().to_string(), "exchange 5 was received, expected 6");
        // A frame may claim any length, so memory grows with the received bytes.
        frame[8..16].copy_from_slice(&u64::MAX.to_le_bytes());
        assert_eq!(receive_frame(&frame[..], 5).unwrap_err().kind(), ErrorKind::UnexpectedEof);
    }
}
