//! Eight bytes in one number, the first the lowest.

/// `byte` eight times.
pub(super) const fn each(byte: u8) -> u64 {
    u64::from_ne_bytes([byte; 8])
}

/// The highest bit of each byte of `word` that is `byte`, and no other bit: nothing is carried from byte to byte.
pub(super) const fn equal_bytes(word: u64, byte: u8) -> u64 {
    let differing = word ^ each(byte);
    !(((differing & each(0x7f)) + each(0x7f)) | differing | each(0x7f))
}
