//! Checks that the places which the user names exist.

use super::config::IngestConfig;
use super::error::Error;
use super::raw::RawScene;
use crate::scene::SceneId;
use std::collections::BTreeSet;
use std::sync::{Mutex, PoisonError};

/// The places that files and recordings name, if the configuration names some.
pub(super) struct Places<'a> {
    config: &'a IngestConfig,
    found: Mutex<BTreeSet<String>>,
}

impl<'a> Places<'a> {
    pub(super) fn of(config: &'a IngestConfig) -> Self {
        Self { config, found: Mutex::default() }
    }

    /// Notes the place of a file or a recording, if it names one.
    pub(super) fn note(&self, place: Option<&str>) {
        if let Some(place) = place.filter(|place| !place.is_empty() && !self.config.places.is_empty()) {
            let mut found = self.found.lock().unwrap_or_else(PoisonError::into_inner);
            if !found.contains(place) {
                found.insert(place.to_owned());
            }
        }
    }

    /// The error that none of the places named by the configuration exists, if others do.
    pub(super) fn error(&self) -> Option<Error> {
        let found = self.found.lock().unwrap_or_else(PoisonError::into_inner);
        let is_there = found.iter().any(|place| self.config.wants_place(place));
        (!is_there && !found.is_empty()).then(|| {
            let [wanted, found] = [listed(self.config.places.iter()), listed(found.iter())];
            let detail = format!("names {wanted}, of which there is nothing; there are recordings or maps of {found}");
            Error::Config { key: "places".to_owned(), detail }
        })
    }

    /// A warning about places that the configuration names and that do not exist, if others do.
    pub(super) fn warning(&self) -> Option<String> {
        let found = self.found.lock().unwrap_or_else(PoisonError::into_inner);
        let missing = listed(self.config.places.iter().filter(|place| !found.contains(*place)));
        (!missing.is_empty()).then(|| format!("ingest.places names {missing}, of which there is nothing"))
    }
}

/// The place of recordings that name none.
pub const NO_PLACE: &str = "none";

/// Calls a place without a name so that corpora can have a folder for it.
pub(super) fn name_blank_place(scene: &mut RawScene) {
    if scene.source.place.trim().is_empty() {
        let blank = std::mem::replace(&mut scene.source.place, NO_PLACE.to_owned());
        scene.id = SceneId(scene.id.0.replacen(&format!("/{blank}/"), &format!("/{NO_PLACE}/"), 1));
    }
}

/// The reason why a scene cannot be stored by its place and its name in the dataset, and in words, if any: a folder of
/// a corpus with the name of the place can have at most 255 bytes, and all characters but letters and digits take
/// three.
pub(super) fn flaw_of(place: &str, case_id: &str) -> Option<(&'static str, String)> {
    const MAX_BYTES: usize = 240;
    for (reason, what, name) in [("bad_place", "place", place), ("bad_id", "id", case_id)] {
        if let Some(c) = name.chars().find(|c| c.is_control()) {
            let detail = format!("its {what} has the control character {}, expected a name", c.escape_default());
            return Some((reason, detail));
        }
    }
    let n_bytes: usize = place.bytes().map(|byte| if byte.is_ascii_alphanumeric() { 1 } else { 3 }).sum();
    let detail = || format!("its place has {} bytes, expected a name of at most {}", place.len(), MAX_BYTES / 3);
    (n_bytes > MAX_BYTES).then(|| ("bad_place", detail()))
}

fn listed<'s>(places: impl Iterator<Item = &'s String>) -> String {
    places.map(String::as_str).collect::<Vec<_>>().join(", ")
}
