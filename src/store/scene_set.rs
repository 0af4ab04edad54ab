//! A set of scenes of a store, with one bit for each.

use std::collections::BTreeMap;

/// Scenes by their position in a [`SceneStore`](super::SceneStore).
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct SceneSet {
    /// Blocks of 64 scenes with at least one bit set: the scenes of a place mostly lie together.
    words: BTreeMap<usize, u64>,
    n: usize,
}

impl SceneSet {
    /// Adds the scene at `position` and returns whether it is new.
    pub fn insert(&mut self, position: usize) -> bool {
        let (word, bit) = (position / 64, 1 << (position % 64));
        let word = self.words.entry(word).or_default();
        let is_new = *word & bit == 0;
        *word |= bit;
        self.n += usize::from(is_new);
        is_new
    }

    /// Whether the scene at `position` is in the set.
    pub fn contains(&self, position: usize) -> bool {
        self.words.get(&(position / 64)).is_some_and(|word| word & (1 << (position % 64)) != 0)
    }

    /// The number of scenes.
    pub const fn len(&self) -> usize {
        self.n
    }

    /// Whether there are none.
    pub const fn is_empty(&self) -> bool {
        self.n == 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scenes_count_once() {
        let mut set = SceneSet::default();
        assert!(set.is_empty());
        let were_new = [0, 63, 64, 1000, 63, 0, 65].map(|position| set.insert(position));
        assert_eq!((were_new, set.len()), ([true, true, true, true, false, false, true], 5));
        let found: Vec<usize> = (0..2000).filter(|position| set.contains(*position)).collect();
        assert_eq!(found, [0, 63, 64, 65, 1000]);
        assert_eq!(set.words.len(), 3, "whatever lies between them");
    }
}
