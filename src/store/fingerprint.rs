//! Short fingerprints of ids and rows, to remember and compare millions of them.

/// A 128-bit hash of an id or a row: the chance that any two of a billion agree is 10⁻²¹.
pub(crate) type Fingerprint = [u8; 16];

pub(crate) fn fingerprint(bytes: &[u8]) -> Fingerprint {
    shortened(blake3::hash(bytes))
}

/// The fingerprint from a longer hash.
pub(crate) fn shortened(hash: blake3::Hash) -> Fingerprint {
    let mut short = [0; 16];
    short.copy_from_slice(&hash.as_bytes()[..16]);
    short
}
