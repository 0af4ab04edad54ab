//! How are files damaged: by flipped bits, cut and doubled parts, parts of other files, and numbers at the ends of
//! their ranges.

use proptest::collection::vec;
use proptest::prelude::*;
use proptest::sample::{Index, select};

/// Replacements for a number or a word in a text, between bars.
const EXTREMES: &str = "0|-0|-1|1|255|65536|2147483647|-2147483648|4294967296|9223372036854775807|-9223372036854775808|\
    18446744073709551615|1e308|-1e308|1e-320|1e999|NaN|-inf|Infinity|0.1|3.0|.|-|+|e|| |\"|''|{}|[]|null|true|\u{feff}|\
    \u{1f}|\\|<|>|&|00000000000000000000000000000000000000000001|ä|\r\n|,,,,,,,,|;|\t|#|=";

/// Replacements for bytes of a binary file: little-endian counts and lengths.
const WORDS: [u64; 12] =
    [0, 1, 0x7f, 0x80, 0xff, 0xffff, 0x7fff_ffff, 0x8000_0000, 0xffff_ffff, 1 << 40, i64::MAX as u64, u64::MAX];

/// Most bytes of an input.
const MAX_LEN: usize = 1 << 20;

/// A kind of damage to a part of a file.
#[derive(Debug, Clone)]
enum Damage {
    Flip(u8),
    Set(u8),
    /// Sets a byte of the last kilobyte, where Parquet, Arrow and zip say what is where.
    SetNearEnd(u8),
    CutOff,
    Remove,
    Double(Index),
    /// A part of that file comes in its place.
    Graft(Vec<u8>, Index),
    Word(u64, usize),
    /// The number or word there becomes this one.
    Exchange(&'static str),
}

/// One of the files with a few damages.
pub(super) fn damaged(files: Vec<Vec<u8>>) -> impl Strategy<Value = Vec<u8>> {
    let kind = prop_oneof![
        (0..8u32).prop_map(|bit| Damage::Flip(1 << bit)),
        any::<u8>().prop_map(Damage::Set),
        any::<u8>().prop_map(Damage::SetNearEnd),
        Just(Damage::CutOff),
        Just(Damage::Remove),
        any::<Index>().prop_map(Damage::Double),
        (select(files.clone()), any::<Index>()).prop_map(|(file, from)| Damage::Graft(file, from)),
        (select(&WORDS), select(&[1, 2, 4, 8])).prop_map(|(word, width)| Damage::Word(word, width)),
        select(EXTREMES.split('|').collect::<Vec<_>>()).prop_map(Damage::Exchange),
    ];
    // Often short, at times long.
    let reach = (0..12u32).prop_flat_map(|reach| 1..=1usize << reach);
    (select(files), vec((any::<Index>(), reach, kind), 1..5)).prop_map(|(mut bytes, damages)| {
        for (at, reach, damage) in damages {
            damage.apply(&mut bytes, at, reach);
        }
        bytes.truncate(MAX_LEN);
        bytes
    })
}

impl Damage {
    fn apply(self, bytes: &mut Vec<u8>, at: Index, reach: usize) {
        let len = bytes.len();
        let at = at.index(len.max(1));
        let part = at..len.min(at + reach);
        match self {
            Self::Flip(bit) => bytes[part].iter_mut().take(1).for_each(|byte| *byte ^= bit),
            Self::Set(value) => bytes[part].iter_mut().take(1).for_each(|byte| *byte = value),
            Self::SetNearEnd(value) => bytes.iter_mut().rev().nth(at % 1024).into_iter().for_each(|byte| *byte = value),
            Self::CutOff => bytes.truncate(at),
            Self::Remove => drop(bytes.drain(part)),
            Self::Double(to) => {
                let (copy, to) = (bytes[part].to_vec(), to.index(len + 1));
                drop(bytes.splice(to..to, copy));
            }
            Self::Graft(other, from) => {
                let from = from.index(other.len() + 1);
                drop(bytes.splice(part, other[from..].iter().take(reach).copied()));
            }
            Self::Word(word, width) => {
                bytes[at..].iter_mut().zip(word.to_le_bytes()).take(width).for_each(|(byte, value)| *byte = value);
            }
            Self::Exchange(extreme) => {
                let is_part = |byte: &u8| byte.is_ascii_alphanumeric() || b".-+_".contains(byte);
                let start = at - bytes[..at].iter().rev().take_while(|byte| is_part(byte)).count();
                let end = at + bytes[at..].iter().take_while(|byte| is_part(byte)).count();
                drop(bytes.splice(start..end, extreme.bytes()));
            }
        }
    }
}
