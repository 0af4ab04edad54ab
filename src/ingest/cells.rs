//! Splits a line at its commas, 64 bytes at a time without branches.

/// Replaces `cells` by the cells of `line`, at least one.
pub(super) fn split_cells<'a>(line: &'a [u8], cells: &mut Vec<&'a [u8]>) {
    cells.clear();
    let mut start = 0;
    let mut block_start = 0;
    while block_start < line.len() {
        let rest = &line[block_start..];
        let mut commas = match rest.first_chunk() {
            Some(block) => commas_of(block),
            None => {
                let mut block = [0; 64];
                block[..rest.len()].copy_from_slice(rest);
                commas_of(&block)
            }
        };
        while commas != 0 {
            let end = block_start + commas.trailing_zeros() as usize;
            cells.push(&line[start..end]);
            start = end + 1;
            commas &= commas - 1;
        }
        block_start += 64;
    }
    cells.push(&line[start..]);
}

/// A mask of the commas, one bit for each byte, the first byte in the lowest bit.
fn commas_of(block: &[u8; 64]) -> u64 {
    let mut commas = 0;
    for (i, bytes) in block.as_chunks().0.iter().enumerate() {
        let equal = equal_bytes(u64::from_le_bytes(*bytes), b',');
        // Gathers the eight bits in the highest byte.
        commas |= ((equal >> 7).wrapping_mul(0x0102_0408_1020_4080) >> 56) << (8 * i);
    }
    commas
}

/// `byte` eight times.
const fn each(byte: u8) -> u64 {
    u64::from_ne_bytes([byte; 8])
}

/// The highest bit of each byte of `word` that equals `byte`, and no other bit: nothing is carried from byte to byte.
const fn equal_bytes(word: u64, byte: u8) -> u64 {
    let differing = word ^ each(byte);
    !(((differing & each(0x7f)) + each(0x7f)) | differing | each(0x7f))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn cells_are_what_stands_between_commas(
            line in prop::collection::vec(prop_oneof![Just(b','), Just(b'-'), any::<u8>()], 0..200),
        ) {
            let mut cells = vec![&b"left over"[..]];
            split_cells(&line, &mut cells);
            prop_assert_eq!(cells, line.split(|byte| *byte == b',').collect::<Vec<_>>());
        }
    }
}
