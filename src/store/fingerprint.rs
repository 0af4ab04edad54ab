//! Ids and rows as short fingerprints: how are millions of them remembered and compared without keeping them?

/// A hash that stands for an id or a row: with 128 bits, two of a billion agree by chance once in 10²¹.
pub(crate) type Fingerprint = [u8; 16];

/// The fingerprint of these bytes.
pub(crate) fn fingerprint(bytes: &[u8]) -> Fingerprint {
    shortened(blake3::hash(bytes))
}

/// The fingerprint of what was hashed.
pub(crate) fn shortened(hash: blake3::Hash) -> Fingerprint {
    let mut short = [0; 16];
    short.copy_from_slice(&hash.as_bytes()[..16]);
    short
}
