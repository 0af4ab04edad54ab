//! How are files damaged: by flipped bits, cut and doubled parts, parts of other files, and numbers at the ends of their ranges.

/// What stands in the place of a number or a word in a text.
const EXTREMES: &[&str] = &[
    "0",
    "-0",
    "-1",
    "1",
    "255",
    "65536",
    "2147483647",
    "-2147483648",
    "4294967296",
    "9223372036854775807",
    "-9223372036854775808",
    "18446744073709551616",
    "1e308",
    "-1e308",
    "1e-320",
    "1e999",
    "NaN",
    "-inf",
    "Infinity",
    "0.1",
    "3.0",
    ".",
    "-",
    "+",
    "e",
    "",
    " ",
    "\"",
    "''",
    "{}",
    "[]",
    "null",
    "true",
    "\u{feff}",
    "\u{1f}",
    "\\",
    "<",
    ">",
    "&",
    "00000000000000000000000000000000000000000001",
    "ä",
    "\r\n",
    ",,,,,,,,",
    ";",
    "\t",
    "#",
    "=",
];

/// What stands in the place of bytes of a binary file: little-endian counts and lengths.
const WORDS: &[u64] =
    &[0, 1, 0x7f, 0x80, 0xff, 0xffff, 0x7fff_ffff, 0x8000_0000, 0xffff_ffff, 1 << 40, i64::MAX as u64, u64::MAX];

/// Most bytes of an input.
const MAX_LEN: usize = 1 << 20;

/// A course of damaged files, the same for the same seed.
pub(super) struct Mutator {
    state: u64,
    seeds: Vec<Vec<u8>>,
}

impl Mutator {
    pub(super) fn new(seed: u64, seeds: Vec<Vec<u8>>) -> Self {
        assert!(!seeds.is_empty(), "a target needs a file to start from");
        Self { state: seed, seeds }
    }

    /// The next file: one of the seeds with a few damages.
    pub(super) fn next_input(&mut self) -> Vec<u8> {
        let idx = self.below(self.seeds.len());
        let mut bytes = self.seeds[idx].clone();
        for _ in 0..1 + self.below(4) {
            self.damage(&mut bytes);
        }
        bytes.truncate(MAX_LEN);
        bytes
    }

    /// SplitMix64 (Steele et al. 2014): all that is asked of it is to reach every place.
    fn next(&mut self) -> u64 {
        self.state = self.state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.state;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// A number below `n`; 0 where there is none.
    fn below(&mut self, n: usize) -> usize {
        (self.next() % n.max(1) as u64) as usize
    }

    fn damage(&mut self, bytes: &mut Vec<u8>) {
        let len = bytes.len();
        let at = self.below(len);
        // Often short, at times long.
        let reach = 1 << self.below(12);
        let part = at..len.min(at + 1 + self.below(reach));
        match self.below(10) {
            0 if len > 0 => bytes[at] ^= 1 << self.below(8),
            1 if len > 0 => bytes[at] = self.next() as u8,
            2 => bytes.truncate(at),
            3 => drop(bytes.drain(part)),
            4 => {
                let copy = bytes[part].to_vec();
                let to = self.below(len);
                drop(bytes.splice(to..to, copy));
            }
            5 => {
                let other = self.below(self.seeds.len());
                let from = self.below(self.seeds[other].len());
                let to = self.seeds[other].len().min(from + self.below(reach));
                let copy = self.seeds[other][from..to].to_vec();
                drop(bytes.splice(part, copy));
            }
            6 => {
                let word = WORDS[self.below(WORDS.len())].to_le_bytes();
                let width = 1 << self.below(4);
                let to = len.min(at + width);
                bytes[at..to].copy_from_slice(&word[..to - at]);
            }
            // The last kilobyte is where Parquet, Arrow and zip say what is where.
            7 if len > 0 => {
                let at = len - 1 - self.below(len.min(1024));
                bytes[at] = self.next() as u8;
            }
            _ => self.exchange_word(bytes, at),
        }
    }

    /// Puts an extreme in the place of the number or word around `at`.
    fn exchange_word(&mut self, bytes: &mut Vec<u8>, at: usize) {
        let is_part = |byte: &u8| byte.is_ascii_alphanumeric() || matches!(byte, b'.' | b'-' | b'+' | b'_');
        let start = bytes[..at].iter().rposition(|byte| !is_part(byte)).map_or(0, |before| before + 1);
        let end = bytes[at..].iter().position(|byte| !is_part(byte)).map_or(bytes.len(), |after| at + after);
        let extreme = EXTREMES[self.below(EXTREMES.len())];
        drop(bytes.splice(start..end.max(start), extreme.bytes()));
    }
}

#[test]
fn courses_are_repeated_by_their_seed_and_change_files() {
    let course = |seed| {
        let mut mutator = Mutator::new(seed, vec![b"case_id,x\n1.0,2.5\n".to_vec(), Vec::new()]);
        (0..500).map(|_| mutator.next_input()).collect::<Vec<_>>()
    };
    assert_eq!(course(1), course(1));
    assert_ne!(course(1), course(2));
    let different: std::collections::BTreeSet<Vec<u8>> = course(1).into_iter().collect();
    assert!(different.len() > 200, "{}", different.len());
    assert!(different.iter().any(|bytes| bytes.windows(5).any(|part| part == b"1e308")));
}
