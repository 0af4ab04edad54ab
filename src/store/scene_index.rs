//! An index of the scenes of a store: facts about each scene without loading it, in some tens of bytes.

use crate::scene::{Dataset, SituationKind, Split};

/// Facts about a scene, known without loading it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SceneIndexEntry<'a> {
    /// The id of the scene.
    pub id: &'a str,
    /// Its dataset.
    pub dataset: Dataset,
    /// Its split.
    pub split: Split,
    /// How its past came about.
    pub situation: SituationKind,
    /// Its place.
    pub place: &'a str,
    /// Number of tracks.
    pub n_agents: u32,
    /// Number of timesteps.
    pub n_timesteps: u32,
}

/// One entry a scene, in the order of ingest. A scene takes 24 bytes beside its id: ids are concatenated in one text,
/// and the name of a place is kept once.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct SceneIndex {
    ids: String,
    places: Vec<String>,
    rows: Vec<IndexEntry>,
}

/// The entry of a scene, without its id.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct IndexEntry {
    /// The end of its id, which begins where the previous one ends.
    id_end: usize,
    /// Position in the list of places.
    place: u32,
    n_agents: u32,
    n_timesteps: u32,
    dataset: Dataset,
    split: Split,
    situation: SituationKind,
}

impl SceneIndex {
    /// Number of scenes.
    pub const fn len(&self) -> usize {
        self.rows.len()
    }

    /// Whether there are no scenes.
    pub const fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// The entry of the scene at `position`, which must be below [`len`](Self::len).
    pub fn get(&self, position: usize) -> SceneIndexEntry<'_> {
        let IndexEntry { place, n_agents, n_timesteps, dataset, split, situation, .. } = self.rows[position];
        let place = &self.places[place as usize];
        SceneIndexEntry { id: self.id(position), dataset, split, situation, place, n_agents, n_timesteps }
    }

    /// The entries, in order.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = SceneIndexEntry<'_>> + DoubleEndedIterator {
        (0..self.len()).map(|position| self.get(position))
    }

    /// The id of the scene at `position`.
    pub(super) fn id(&self, position: usize) -> &str {
        let start = position.checked_sub(1).map_or(0, |before| self.rows[before].id_end);
        &self.ids[start..self.rows[position].id_end]
    }

    /// Adds a scene after the others.
    pub(super) fn push(&mut self, entry: SceneIndexEntry<'_>) {
        let SceneIndexEntry { id, dataset, split, situation, place, n_agents, n_timesteps } = entry;
        self.ids.push_str(id);
        let (id_end, place) = (self.ids.len(), self.number_of(place));
        self.rows.push(IndexEntry { id_end, place, n_agents, n_timesteps, dataset, split, situation });
    }

    /// Frees spare capacity.
    pub(super) fn shrink(&mut self) {
        self.ids.shrink_to_fit();
        self.rows.shrink_to_fit();
    }

    /// The position of a place; a new place becomes the last one. Scenes of a place mostly follow each other.
    fn number_of(&mut self, place: &str) -> u32 {
        if let Some(last) = self.rows.last().filter(|last| self.places[last.place as usize] == place) {
            return last.place;
        }
        let at = self.places.iter().position(|known| known == place).unwrap_or_else(|| {
            self.places.push(place.to_owned());
            self.places.len() - 1
        });
        at as u32
    }
}

impl<'a> FromIterator<SceneIndexEntry<'a>> for SceneIndex {
    fn from_iter<I: IntoIterator<Item = SceneIndexEntry<'a>>>(entries: I) -> Self {
        let mut index = Self::default();
        entries.into_iter().for_each(|entry| index.push(entry));
        index
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn entries_come_back_in_order_whatever_the_order_of_their_places() {
        let entries =
            [("a/b/1", "X", 3), ("", "Y", 0), ("a/b/ü", "Y", 7), ("c", "X", 1)].map(|(id, place, n_agents)| {
                SceneIndexEntry {
                    id,
                    dataset: Dataset::Interaction,
                    split: if n_agents > 2 { Split::Train } else { Split::Val },
                    situation: if n_agents > 5 { SituationKind::Populated } else { SituationKind::Recorded },
                    place,
                    n_agents,
                    n_timesteps: 40 + n_agents,
                }
            });
        let index: SceneIndex = entries.into_iter().collect();
        assert_eq!(index.iter().collect::<Vec<_>>(), entries);
        assert_eq!((index.get(2), index.id(2), index.len()), (entries[2], "a/b/ü", 4));
        assert_eq!(index.places, ["X", "Y"]);
        assert!(SceneIndex::default().is_empty());
    }

    #[test]
    fn a_scene_takes_as_many_bytes_as_the_documents_say() {
        assert_eq!(size_of::<IndexEntry>(), 24);
    }
}
